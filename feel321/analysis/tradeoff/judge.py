"""What the measured frame says: where a reducer fails, what depends on the mounting, and the simplest that suffices.

Everything is decided from the frame of `measure`, by two numbers, both in decibels of energy:

- `TOLERANCE_DB`. A reducer *suffices* where it is within the tolerance of the best reducer in level, spectrum, motion,
  envelope and steadiness; for any mounting of the sensor, and in each half of the recording. The *best* is among
  those that do not fail: "sufficient" means as good as the best single axis, not as good as three.
- `FAILS_DB`. A reducer *fails* where a tenth of the energy (10 dB) is decided by something else than the motion.

Apart from both: a reducer *depends on the mounting* where turning the sensor changes its waveform by more than the
tolerance. What is felt may stay the same.

The simplest of those that suffice is advised: offline by parameters, operations and state; online by delay, state,
operations and parameters. The paper's own metrics are measured and shown,
but do not decide: eq. 1 weighs a band without energy like any other, eq. 2 changes with the mounting.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from operator import itemgetter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.tradeoff.measure import DISTURBED, HALVES, MOUNTED, RECORDED, SHORTEST_S
from feel321.arguments import check_name

if TYPE_CHECKING:
    from pandas import DataFrame, Series

    from feel321.analysis.table.items import Table

Row = Mapping[str, Any]

TOLERANCE_DB = 1.0
"""Ours. Published difference limens for the intensity of vibration lie between 0.4 and 2.3 dB (Craig 1972,
doi:10.3758/BF03210362; Gescheider et al. 1990, doi:10.1121/1.399300): 1 dB is in the cautious half, because
"sufficient" claims that nothing is felt to be missing, and errors of several kinds add up."""

FAILS_DB = 10.0
"""Ours: a tenth of the energy, ten times the tolerance. Nobody would call that the same vibration."""

LATENCY_MS = 45.0
"""Shortest delay between sight and touch that people notice, by the paper: the budget where none is named."""

OVERHEAD_MS = 1000 * 64 / 48_000 + 5.0
"""What a block of 64 samples at 48 kHz and converters take of it; a sound card may need ten times as much."""

WINDOWS_MS = (10.0, 15.0, 20.0, 25.0, 50.0)
"""Further windows that are tried where the delay matters."""

ANY = "any"
MOUNTINGS = (ANY, "recorded")

CRITERIA = ("level", "spectrum", "motion", "envelope", "steadiness")

FAILURES: Mapping[str, tuple[str, str]] = MappingProxyType({
    "level": (RECORDED, "level_db"),
    "pre-echo": (RECORDED, "pre_echo_db"),
    **{name: (name, "change_db") for name in DISTURBED},
})  # fmt: skip
"""What a reducer can fail by -> where the number is in the frame. It keeps less than a tenth of the energy; puts more
than a tenth of an onset's energy before it; or a disturbance changes more than a tenth of the output's energy."""

RATINGS = "ratings"  # What a reducer is said to fail by that only people object to

CLOSE = 0.3
"""A shortfall nearer to the tolerance than this share of it may be on the other side in another take."""

CLOSE_FAIL_DB = 2.0  # As `CLOSE`, for the limit of failing

NO_LEADER = 0.95
"""From this ratio of the second to the first eigenvalue on no direction leads: chance chooses the principal axis."""

SAME_DB = 1e-6  # Shortfalls this close are equal but for rounding


@dataclass(frozen=True, slots=True)
class Context:
    """Where a reducer is to run, and what is good enough.

    online: whether it runs while the vibration is being made. latency_ms: the longest delay online, of reducer, block
    and device together; 45 if left out. mounting: "any" or "recorded": what advice must hold for. tolerance_db: how far
    from the best is as good, in dB of energy.
    """

    online: bool = False
    latency_ms: float | None = None
    mounting: str = ANY
    tolerance_db: float = TOLERANCE_DB

    def __post_init__(self) -> None:
        """Refuse settings that contradict each other."""
        check_name(self.mounting, MOUNTINGS, "mounting")
        if not 0 < self.tolerance_db < FAILS_DB:
            got = f"got {self.tolerance_db:g}"
            raise ValueError(f"tolerance_db must be above 0 and below {FAILS_DB:g}, {got}")
        given = self.latency_ms
        if given is not None and not self.online:
            raise ValueError(f"latency_ms must be left out offline, got {given:g}; set online=True")
        if given is not None and not OVERHEAD_MS <= given < math.inf:
            least = f"{OVERHEAD_MS:.1f}, which block and device alone take"
            raise ValueError(f"latency_ms must be at least {least}, got {given:g}")

    @property
    def room_ms(self) -> float:
        """What is left of the delay for the reducer; infinite offline."""
        if not self.online:
            return math.inf
        return (LATENCY_MS if self.latency_ms is None else self.latency_ms) - OVERHEAD_MS


def judge_reducers(frame: DataFrame, context: Context, people: DataFrame) -> DataFrame:
    """Judge every reducer on every recording and scene: one row each, the simplest first."""
    import pandas as pd

    judged = frame[(frame["reducer"] != "") & (frame["kind"] != "machine")]
    rows = [
        _judge_one(part, context)
        for _, part in judged[judged["condition"] != ""].groupby(["kind", "recording"], sort=False)
    ]
    table = pd.concat(rows) if rows else pd.DataFrame(columns=["kind", "recording", "reducer"])
    needs, keys = judged[judged["condition"] == ""], ["kind", "recording", "reducer"]
    needs = needs[needs["measure"].isin(NEEDS)]
    wide = needs.pivot_table(index=keys, columns="measure", values="value").reset_index()
    table = table.merge(wide, how="left", on=keys)
    if not len(table):
        return table
    table["in_budget"] = table["latency_ms"] <= context.room_ms
    said = {(row["recording"], row["reducer"]): row["agree"] for row in list_rows(people)}
    pairs = zip(table["recording"], table["reducer"], strict=True)
    table["people"] = [said.get(pair, "") for pair in pairs]
    fits = (table["fails"] == "") & (table["shortfall_db"] <= context.tolerance_db)
    table["sufficient"] = fits & (table["people"] != "worse")
    tied = np.round(table["shortfall_db"] / SAME_DB)
    rank = [*RANK[context.online], "tied"]
    ordered = table.assign(tied=tied, place=np.arange(len(table))).sort_values([*rank, "place"])
    ordered["order"] = ordered.groupby(["kind", "recording"], sort=False).cumcount() + 1
    return ordered.drop(columns=["tied", "place"]).sort_index(kind="stable").reset_index(drop=True)


NEEDS = ("parameters", "operations", "state", "latency_ms")
RANK = {
    False: ("parameters", "operations", "state"), True: ("latency_ms", "state", "operations", "parameters"),
}  # fmt: skip
"""Online or not -> what simplicity goes by, first things first."""


def _judge_one(part: DataFrame, context: Context) -> DataFrame:
    """Judge all reducers on one recording."""
    import pandas as pd

    columns, values = ["condition", "measure"], ["low", "high"]
    worst = part.pivot_table(index="reducer", columns=columns, values=values, sort=False)

    def read(condition: str, measure: str, end: str = "high") -> Series:
        key = (end, condition, measure)
        return worst[key] if key in worst else pd.Series(np.nan, index=worst.index)

    margins = {
        name: -read(*place, "low") - FAILS_DB if name == "level" else read(*place) + FAILS_DB
        for name, place in FAILURES.items()
    }
    beyond = pd.DataFrame(margins)
    fails = beyond.apply(lambda row: " ".join(name for name in FAILURES if row[name] >= 0), axis=1)
    healthy = fails == ""
    everywhere = MOUNTED if context.mounting == ANY else RECORDED
    shortfalls = {}
    for criterion in CRITERIA[:-1]:
        behind = []
        for condition in (everywhere, *HALVES):
            high = read(condition, f"{criterion}_db")
            if criterion == "level":  # too loud is as wrong as too weak
                high = high.clip(lower=-read(condition, "level_db", "low"))
            behind.append(high - high[healthy].min())
        shortfalls[criterion] = pd.concat(behind, axis=1).max(axis=1)
    change = to_weight(read("noise", "change_db"))
    shortfalls["steadiness"] = change - change[healthy].min()
    table = pd.DataFrame(shortfalls)
    turned = to_weight(read(MOUNTED, "change_db").fillna(-np.inf))
    return pd.DataFrame({
        "kind": part["kind"].iloc[0], "recording": part["recording"].iloc[0], "reducer": worst.index, "fails": fails,
        "fails_by_db": beyond.max(axis=1), "depends_on_mounting": turned > context.tolerance_db,
        **{f"{name}_db": table[name] for name in CRITERIA},
        # Where every reducer fails there is no best one, and none that suffices.
        "shortfall_db": table.max(axis=1).fillna(np.inf) if healthy.any() else np.inf,
        "criterion": table.fillna(-np.inf).idxmax(axis=1),
    }).reset_index(drop=True)  # fmt: skip


def to_weight(change_db: Series) -> Series:
    """Turn the energy of a change into the most by which it can alter the output's level: in phase, in dB."""
    weight: Series = 20 * np.log10(1 + 10 ** (change_db / 20))
    return weight


def list_rows(frame: DataFrame) -> list[dict[str, Any]]:
    """List the rows of a table."""
    return frame.to_dict("records")  # type: ignore[return-value]  # columns have names


def choose(
    recording: str, verdicts: DataFrame, *, facts: Mapping[str, float], context: Context
) -> dict[str, Any]:
    """Choose the simplest sufficient reducer of a recording, or the closest; and why."""
    problem = "" if facts["felt_level"] > 0 else "silent from 20 to 1000 Hz"
    if facts["duration_s"] < SHORTEST_S:
        problem = f"shorter than {SHORTEST_S:g} s, two periods of 20 Hz"
    chosen: dict[str, Any] = {
        "recording": recording, "answer": "", "closest": "", "ties": "", "problem": problem, "close": "",
        "simpler": "", "simpler_fails": "", "simpler_criterion": "", "simpler_db": math.nan,
        "better": "", "better_criterion": "", "better_db": math.nan, "barred": "", "people": "",
    }  # fmt: skip
    if not len(verdicts):
        return chosen
    rows = sorted(list_rows(verdicts), key=itemgetter("order"))
    running = [row for row in rows if row["in_budget"]]
    suffices = [row for row in running if row["sufficient"]]
    if not running:
        return chosen | {"problem": "no reducer is in time"}
    one = suffices[0] if suffices else min(running, key=order_failing)
    rank = itemgetter(*RANK[context.online])
    alike = [row["reducer"] for row in suffices if row is not one and rank(row) == rank(one)]
    late = [row for row in rows if row["sufficient"] and not row["in_budget"]]
    barred = [row["reducer"] for row in late if row["order"] < one["order"] or not suffices]
    chosen |= {
        "answer": one["reducer"] if suffices else "", "closest": one["reducer"], "people": one["people"],
        "ties": " ".join(alike), "barred": (*barred, "")[0],
        "close": ", ".join(_list_doubts(one, running, facts=facts, context=context)),
    }  # fmt: skip
    simpler = [row for row in running if row["order"] < one["order"] and not row["sufficient"]]
    if simpler:
        # One that only people object to comes first: that disagreement is the reason to be told.
        nearest = min(simpler, key=lambda row: (row["fails"] != "", row["shortfall_db"]))
        fits = not nearest["fails"] and nearest["shortfall_db"] <= context.tolerance_db
        chosen |= {
            "simpler": nearest["reducer"], "simpler_fails": RATINGS if fits else nearest["fails"],
            "simpler_criterion": nearest["criterion"], "simpler_db": nearest["shortfall_db"],
        }  # fmt: skip
    best = min(rows, key=order_failing)
    gain = one[f"{one['criterion']}_db"] - best[f"{one['criterion']}_db"]
    if gain > SAME_DB and not best["fails"] and best["shortfall_db"] < one["shortfall_db"]:
        chosen |= {"better": best["reducer"], "better_criterion": one["criterion"]}
        chosen["better_db"] = gain
    return chosen


def order_failing(row: Row) -> tuple[bool, bool, float]:
    """Order reducers by how near they come: who is not rated worse and does not fail, then the shortfall."""
    return row["people"] == "worse", row["fails"] != "", row["shortfall_db"]


def _list_doubts(
    one: Row, running: list[dict[str, Any]], *, facts: Mapping[str, float], context: Context
) -> list[str]:
    """List why another take could reverse the choice: who is near a limit, and whether no direction leads."""
    tolerance, doubts = context.tolerance_db, []
    for row in running[: running.index(dict(one)) + 1]:
        behind, narrowly = row["shortfall_db"], abs(row["fails_by_db"]) < CLOSE_FAIL_DB
        if not row["fails"] and abs(behind - tolerance) < CLOSE * tolerance:
            doubts.append(f"{row['reducer']} is {behind:.1f} dB behind in {row['criterion']}")
        elif narrowly and behind <= (1 + CLOSE) * tolerance:
            how = f"fails narrowly ({row['fails']})" if row["fails"] else "nearly fails"
            doubts.append(f"{row['reducer']} {how}")
    if facts.get("eigenvalue_ratio", 0.0) > NO_LEADER:
        doubts.append(f"no direction leads (λ₂/λ₁ = {facts['eigenvalue_ratio']:.2f})")
    return doubts


# What people's ratings say of the reducers of each recording, if a margin was fixed beforehand: a model of ratings of a
# recording on reducer, with a spread between participants. *Equivalent* to the one rated highest: two one-sided tests
# place the difference within the margin. *Worse*: the 90 % interval of the difference lies beyond it. *Open* otherwise:
# "not significantly different" shows nothing. On several scales and levels the least favourable counts.

NEEDED = ("participant", "recording", "reducer", "scale", "level", "rating")
COLUMNS = ("recording", "reducer", "agree", "best", "difference", "low", "high", "simulated")

BEST, EQUIVALENT, OPEN, WORSE = "best", "equivalent", "open", "worse"
FAVOUR = (BEST, EQUIVALENT, OPEN, WORSE)
"""What ratings say of a reducer, from the most favourable on."""

SIGNIFICANCE = 0.05


def compare_rated(ratings: Table | DataFrame | None, *, margin: float | None = None) -> DataFrame:
    """Compare the reducers of every recording with the best-rated: one row each; none without ratings or margin."""
    import pandas as pd

    from feel321.analysis.table.items import split_arms

    found: list[dict[str, Any]] = []
    rows = None if ratings is None else read_ratings(ratings)
    if margin is not None and not (math.isfinite(margin) and margin > 0):
        raise ValueError(f"margin must be a number of points above 0, got {margin:g}")
    if rows is not None and margin is not None:
        for part in split_arms(rows):
            for recording, own in part.rows.groupby(part.rows["recording"].astype(str), sort=False):
                found += [{"recording": str(recording), **one} for one in _compare(own, margin)]
    frame = pd.DataFrame(found, columns=list(COLUMNS))
    place = frame["agree"].map({name: number for number, name in enumerate(FAVOUR)})
    order = frame.assign(place=place).sort_values("place", kind="stable")
    worst = order.groupby(["recording", "reducer"], sort=False).tail(1)
    return worst.drop(columns="place").reset_index(drop=True)


def read_ratings(ratings: Table | DataFrame) -> DataFrame:
    """Take ratings of test stimuli; of a data frame every row is one, and nobody simulated, if not said."""
    from feel321.analysis.arrays import check_columns
    from feel321.analysis.table import items

    if isinstance(ratings, items.Table):
        return items.select_tests(ratings)
    rows, _ = items.leave_rejected(items.name_items(items.open_ratings(ratings)))
    check_columns(rows, NEEDED, "ratings")
    return rows.assign(simulated=rows.get("simulated", False))


def _compare(rows: DataFrame, margin: float) -> list[dict[str, Any]]:
    """Compare the reducers of one recording; of fewer than two there is nothing to compare."""
    from feel321.analysis.contrasts.compare import equivalence
    from feel321.analysis.mixed.model import contrast, fit_mixed

    named, keys = rows.astype({"reducer": str}), ["participant", "reducer"]
    data = named.groupby(keys, observed=True)["rating"].mean().reset_index()
    means = data.groupby("reducer")["rating"].mean()
    if len(means) < 2:  # noqa: PLR2004 - one reducer has no other
        return []
    best = str(means.idxmax())
    codes = {name: f"c{number}" for number, name in enumerate(means.index)}
    data["which"] = data["reducer"].map(codes)
    try:
        fit = fit_mixed("rating ~ 0 + which + (1 | participant)", data)
    except ValueError:  # too few ratings leave no error to test with
        fit = None
    found = []
    for name, code in codes.items():
        row = {"reducer": name, "agree": BEST if name == best else OPEN, "best": best}
        row["simulated"] = bool(rows["simulated"].any())
        row["difference"] = float(means[name] - means[best])
        found.append(row)
        if fit is None or name == best:
            continue
        one = contrast(fit, {f"which{code}": 1, f"which{codes[best]}": -1})
        if 0 < one.se < math.inf:
            test = equivalence(one.estimate, one.se, one.df, low=-margin, high=margin)
            row |= {"difference": one.estimate, "low": test.low90, "high": test.high90}
            row["agree"] = WORSE if test.high90 < -margin else OPEN
            if test.p < SIGNIFICANCE:
                row["agree"] = EQUIVALENT
    return found
