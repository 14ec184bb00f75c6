"""How large must a study be? The closed form searches, simulated studies fitted by the primary model check."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from feel321.analysis.power.closed import ClosedForm
from feel321.analysis.power.design import LEAST, SIZES, PowerDesign
from feel321.analysis.power.simulate import SIMULATED, tabulate_shares
from feel321.analysis.primary.plan import SCENE, SOURCE
from feel321.analysis.words import ABSENT, format_count
from feel321.types import Samples

FACTORS: Mapping[str, tuple[float, ...]] = {
    "participants": (0.5, 0.75, 1, 1.5, 2, 3), "recordings": (0.5, 1, 1.5, 2, 3), "reducers": (0.5, 1, 1.5),
}  # fmt: skip
"""Sizes that are tried, as multiples of the given ones."""

REPEATS = (1, 2, 3, 4)

TRIED = 8
"""Designs that are simulated in search of one whose simulation does not contradict the closed form."""

STEP = 0.8  # Share of a refuted design's detectable slope that the next one must detect

LEAST_TESTED = 0.9
"""Share of simulated studies that must give a test, for a simulation to confirm a design."""

SURE, HOPELESS = 0.99, 0.01

ENOUGH, NOTHING, UNTESTABLE, CEILING, REFUTED, SMALL = (
    "enough", "nothing planted", "not estimable", "ceiling", "refuted", "too small",
)  # fmt: skip
"""Verdicts: a design is enough; or none is, and why (ceiling: no number of participants is)."""

Simulate = Callable[[PowerDesign], "Samples"]
"""Gives p of every test of simulated studies, (studies, n_hypotheses)."""


@dataclass(frozen=True, slots=True, eq=False)
class Power:
    """The power of one design: a row per hypothesis.

    ``attribute metric slope`` (planted, per unit of the metric); in closed form ``se df width`` (of the 95 % interval),
    ``power`` (Holm's first step), ``ceiling`` (with participants without end), ``detectable`` (smallest slope found
    with the wanted power), ``recordings_needed``; and by simulation the columns of `tabulate_shares`.
    """

    design: PowerDesign
    table: pd.DataFrame
    studies: int = 0
    notes: tuple[str, ...] = ()

    def is_refuted(self, place: int) -> bool:
        """Check whether a simulation lies below the wanted power as a whole, or gives hardly any test."""
        row = self.table.iloc[place]
        is_known = row["tests"] >= LEAST_TESTED * self.studies
        return self.studies > 0 and not (is_known and row["simulated_high"] >= self.design.wanted)


def find_power(design: PowerDesign, simulate: Simulate | None = None) -> Power:
    """Find the power of a design, in closed form and, where something simulates, in simulated studies."""
    truth = design.truth
    forms = {metric: ClosedForm(design, place) for place, metric in enumerate(design.metrics)}
    notes = [f"Standard deviations: {design.truth.source}."]
    if len(design.hypotheses) > 1:
        first = f"{design.level:.3g}, the first step of Holm's method over {len(design.hypotheses)} tests"
        notes.append(f"The closed form is at a level of {first}.")
    if len(design.attributes) > 1:
        apart = "independent of each other, although the same people rate them"
        notes.append(f"Attributes are taken to be {apart}.")
    if not design.is_own:
        notes.append(
            "Recordings and reducers are drawn from those of the stimulus set anew for every study; where there are "
            "more than the set has, some are used more than once, with the same metrics."
        )
    if SOURCE in design.items and not design.items.drop_duplicates(SCENE)[SOURCE].is_unique:
        lower = "what else they share is not simulated, so actual power is lower"
        notes.append(f"Several recordings come from one source; {lower}.")
    rows = []
    for attribute, metric in design.hypotheses:
        form, slope = forms[metric], truth.find_slope(attribute, metric)
        se, df = form.find_error()
        rows.append({
            "attribute": attribute, "metric": metric, "slope": slope, "se": se, "df": df,
            "width": form.find_width(), "power": form.find_power(slope), "ceiling": form.find_ceiling(slope),
            "detectable": form.find_detectable(), "recordings_needed": form.find_recordings(slope),
        })  # fmt: skip
        if slope and (lack := form.find_lack()):
            notes.append(f"The planted slope of {metric} on {attribute} cannot be tested: {lack}.")
    p = np.empty((0, len(rows))) if simulate is None else simulate(design)
    if lost := int(np.isnan(p).all(axis=1).sum()):
        notes.append(f"{lost} of {len(p)} simulated studies gave no test and are excluded.")
    table = pd.DataFrame(rows).join(tabulate_shares(p))
    return Power(design, table, len(p), tuple(notes))


@dataclass(frozen=True, slots=True, eq=False)
class PowerPlan:
    """The power of many designs, and the smallest that is enough.

    table: a row per design: ``participants recordings reducers repeats trials`` (of one person), ``kind`` (given, one
    factor, grid, smallest), of the hypothesis that the recommendation is for, in closed form ``power ceiling detectable
    width``, by simulation where it was simulated `SIMULATED`, ``enough`` (in closed form, at least the wanted power),
    ``refuted`` and ``recommended``. powers: the given design, and those that were simulated. recommended: the smallest
    that is enough. verdict: one of `ENOUGH` and so on. lack: why the given design cannot test the hypothesis.
    """

    table: pd.DataFrame
    powers: tuple[Power, ...]
    hypothesis: tuple[str, str]
    recommended: PowerDesign | None
    verdict: str
    lack: str
    notes: tuple[str, ...]

    @property
    def shown(self) -> Power:
        """The recommended design, or the given one."""
        best = self.recommended and self.recommended.sizes
        return next((one for one in self.powers if one.design.sizes == best), self.powers[0])


def plan_power(
    design: PowerDesign, sizes: Mapping[str, Sequence[int]],
    *, aims: Sequence[int] = (0,), simulate: Simulate | None = None,
) -> PowerPlan:  # fmt: skip
    """Find the power of designs around a given one, and recommend the smallest that is enough.

    sizes: numbers to try, by the names of `SIZES`, one factor at a time, and participants x recordings together;
    multiples of the given ones, and 1 to 4 repeats, where left out. aims: places of the hypotheses that the
    recommendation may be for: that with the least power of the given design.

    For every combination of recordings, reducers and repeats, the smallest number of participants that is enough in
    closed form is added. The recommended design changes as few of recordings, reducers and repeats as is needed, then
    takes the fewest trials of all participants together; where numbers of participants are named, it has one of these.
    Where its simulation refutes it, the next one is simulated that detects a slope at least a fifth smaller, or where
    there is none the one that detects the smallest; up to 8 of them.
    """
    forms = [ClosedForm(design, place) for place in range(len(design.metrics))]

    def find_weakness(aim: int) -> tuple[bool, float]:
        attribute, metric = design.hypotheses[aim]
        form = forms[design.metrics.index(metric)]
        power = form.find_power(design.truth.find_slope(attribute, metric))
        return math.isnan(power), power

    aim = min(aims, key=find_weakness)
    designs, table = _tabulate_designs(design, sizes, aim)
    ranked = table.assign(
        changed=sum((table[name] != design.sizes[name]).astype(int) for name in SIZES[1:]),
        cost=table["trials"] * table["participants"],
    ).sort_values(["changed", "cost", "participants"], kind="stable")
    named = sizes.get("participants") or table["participants"]
    left = list(ranked.index[ranked["enough"] & ranked["participants"].isin(named)])
    detectable = table["detectable"].to_dict()
    powers, most, chosen = [find_power(design, simulate)], math.inf, None
    for _ in range(TRIED):
        if not left:
            break
        strongest = min(left, key=lambda place: detectable[place])
        place = next((one for one in left if detectable[one] <= most), strongest)
        known = (one for one in powers if one.design.sizes == designs[place].sizes)
        power = next(known, None) or find_power(designs[place], simulate)
        powers += [] if power in powers else [power]
        if not power.is_refuted(aim):
            chosen = place
            break
        left = [one for one in left if detectable[one] < detectable[place]]
        most = detectable[place] * STEP
    runs = pd.DataFrame([
        one.design.sizes | {"refuted": one.is_refuted(aim)} | one.table[list(SIMULATED)].loc[aim].to_dict()
        for one in powers
    ])  # fmt: skip
    table = table.merge(runs, how="left", on=list(SIZES))
    table["refuted"] = table["refuted"].eq(True)  # noqa: FBT003 - what was not simulated is not refuted
    table["recommended"] = table.index == (-1 if chosen is None else chosen)
    notes = [note for power in powers for note in power.notes]
    metric = design.metrics.index(design.hypotheses[aim][1])
    return PowerPlan(
        table=table, powers=tuple(powers), hypothesis=design.hypotheses[aim],
        recommended=None if chosen is None else designs[chosen], verdict=_judge(table, powers[0], aim),
        lack=forms[metric].find_lack(), notes=tuple(dict.fromkeys([*notes, *_note_refuted(table)])),
    )  # fmt: skip


def _tabulate_designs(
    design: PowerDesign, sizes: Mapping[str, Sequence[int]], aim: int
) -> tuple[list[PowerDesign], pd.DataFrame]:
    """Compute designs in closed form; the first with its recordings, reducers and repeats, with fewest people too."""
    attribute, metric = design.hypotheses[aim]
    slope, place = design.truth.find_slope(attribute, metric), design.metrics.index(metric)
    designs: list[PowerDesign] = []
    rows: list[dict[str, Any]] = []

    def compute(one: PowerDesign, kind: str) -> ClosedForm:
        form = ClosedForm(one, place)
        power = form.find_power(slope)
        designs.append(one)
        rows.append({
            **one.sizes, "trials": one.trials, "kind": kind, "power": power, "ceiling": form.find_ceiling(slope),
            "detectable": form.find_detectable(), "width": form.find_width(), "enough": power >= one.wanted,
        })  # fmt: skip
        return form

    known: set[tuple[int, ...]] = set()
    for kind, one in _list_designs(design, sizes):
        form, others = compute(one, kind), (one.recordings, one.reducers, one.repeats)
        if others in known:
            continue
        known.add(others)
        number = form.find_participants(slope)
        if math.isfinite(number) and number != one.participants:
            compute(replace(one, participants=int(number)), "smallest")
    return designs, pd.DataFrame(rows)


def _list_designs(
    design: PowerDesign, wanted: Mapping[str, Sequence[int]]
) -> Iterator[tuple[str, PowerDesign]]:
    """List the given design, others by one factor at a time, and participants x recordings; each once."""
    sizes: dict[str, Sequence[int]] = {"repeats": REPEATS}
    for name, factors in FACTORS.items():
        own = design.sizes[name]
        least = min(LEAST[name], own)
        sizes[name] = sorted({max(least, round(own * factor)) for factor in factors})
    sizes |= {name: sorted(set(given)) for name, given in wanted.items() if given}
    changes = [("given", dict[str, int]())]
    changes += [("one factor", {name: size}) for name in SIZES for size in sizes[name]]
    pairs = product(sizes["participants"], sizes["recordings"])
    changes += [("grid", {"participants": one, "recordings": two}) for one, two in pairs]
    seen: list[dict[str, int]] = []
    for kind, change in changes:
        other = replace(design, **change)  # type: ignore[arg-type]  # sizes are numbers
        if other.sizes not in seen:
            seen.append(other.sizes)
            yield kind, other


def _judge(table: pd.DataFrame, given: Power, aim: int) -> str:
    """Say whether a design is enough, or why none is."""
    verdicts = {
        ENOUGH: table["recommended"].any(),
        NOTHING: not given.table["slope"].iloc[aim],
        UNTESTABLE: table["power"].isna().all(),
        REFUTED: (table["enough"] & table["refuted"]).any(),
        SMALL: table["ceiling"].max() >= given.design.wanted,
        CEILING: True,
    }
    return next(one for one, holds in verdicts.items() if holds)


def _note_refuted(table: pd.DataFrame) -> Iterator[str]:
    for row in table[table["enough"] & table["refuted"]].to_dict("records"):
        units = describe_units(row["recordings"], row["reducers"])
        share = format_power(row["simulated"]).replace("not estimable", "no test")
        yield (
            f"Simulation contradicts the closed form of {row['participants']} participants, {units}: "
            f"{format_power(row['power'])} in closed form, {share} in simulated studies."
        )


def format_power(power: float) -> str:
    """Write a power without claiming certainty."""
    if not math.isfinite(power):
        return "not estimable"
    if power > SURE:
        return f"> {SURE}"
    return f"{power:.2f}" if power >= HOPELESS else f"< {HOPELESS}"


def format_simulated(row: Mapping[Any, Any], otherwise: str = ABSENT) -> str:
    """Write the simulated power with its interval; something else where nothing was simulated."""
    if not math.isfinite(row["simulated"]):
        return otherwise
    ends = "{simulated_low:.2f} to {simulated_high:.2f}".format(**row)
    return f"{format_power(row['simulated'])} (95 % Monte Carlo interval {ends})"


def describe_units(recordings: int, reducers: int) -> str:
    """Describe how many stimuli a design has."""
    return f"{format_count(recordings, 'recording')} × {format_count(reducers, 'reducer')}"
