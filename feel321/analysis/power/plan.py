"""How large must a study be? The closed form searches, simulated studies fitted by the primary model check."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321.analysis.power.closed import ClosedForm
from feel321.analysis.power.draw import Scenario
from feel321.analysis.power.simulate import NONE, Power, find_power
from feel321.analysis.power.truth import SIZES, PowerDesign, Truth
from feel321.analysis.words import format_count, format_name
from feel321.doors import follow
from feel321.jobs import ALONE, Workers
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from pandas import DataFrame

    from feel321.types import PathLike, Progress

FACTORS: Mapping[str, tuple[float, ...]] = {
    "participants": (0.5, 0.75, 1, 1.5, 2, 3), "recordings": (0.5, 1, 1.5, 2, 3), "reducers": (0.5, 1, 1.5),
}  # fmt: skip
"""Sizes that are tried, as multiples of the given ones."""

REPEATS = (1, 2, 3, 4)

LEAST = {"participants": 6, "recordings": 4, "reducers": 3}
"""No smaller number is tried unless it is asked for."""

TRIED = 8
"""Designs that are simulated in search of one whose simulation does not contradict the closed form."""

LEAST_TESTED = 0.9
"""Share of simulated studies that must give a test, for a simulation to confirm a design."""

STEPS = 0.5, 0.95
"""Least and largest share of a refuted design's detectable slope that the next one must detect."""

SURE, HOPELESS = 0.99, 0.01

ENOUGH, NOTHING, UNTESTABLE, CEILING, REFUTED, SMALL = (
    "enough", "nothing planted", "not estimable", "ceiling", "refuted", "too small",
)  # fmt: skip
"""Verdicts: a design is enough; or none is, and why."""

SENTENCES = {
    ENOUGH: "Plan {size}: the power to find {slope} is then {power}.",
    NOTHING: "There is nothing to find: the slope planted for {name} is zero.",
    UNTESTABLE: "A slope of {name} is not estimable in any of these designs ({lack}): plan more recordings or "
    "reducers, or fewer metrics.",
    CEILING: "No number of participants is enough: the power to find {slope} is at most {most} in closed form with "
    "{units}; {advice}.",
    REFUTED: "None of these designs is enough: {slope} is found with a power of {most} at most in simulations of "
    "{count} that would be enough in closed form, which knows neither people who lapse nor the ends of the scale.",
    SMALL: "None of these designs is enough: {slope} is found with a power of {most} at most in closed form, with up "
    "to {people}; {advice}.",
}


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class PowerPlan(Result):
    """The power of many designs, and the smallest that is enough.

    Parameters
    ----------
    table : DataFrame
        A row per design: ``participants recordings reducers repeats trials`` (of one person), ``kind`` (given, one
        factor, grid, smallest), of the hypothesis in closed form ``power ceiling detectable width``, by simulation
        where it was simulated ``simulated simulated_low simulated_high``, ``enough`` (in closed form, at least the
        wanted power), ``refuted`` (was simulated, and the whole interval lies below the wanted power or fewer than 90 %
        of the studies gave a test) and ``recommended``.
    powers : tuple of Power
        The given design, and those that were simulated.
    hypothesis : tuple of str
        Attribute and metric that the recommendation is for.
    wanted : float
        Power that is asked for.
    recommended : PowerDesign or None
        The smallest design that is enough: fewest trials of all people together, then fewest participants.
    verdict : str
        ``enough``; or why no design is: ``nothing planted``, ``not estimable``, ``ceiling`` (no number of participants
        is), ``refuted`` (by simulation) or ``too small``.
    lack : str
        Why the given design cannot test the hypothesis; empty where it can.
    notes : tuple of str
        What was assumed and what is unusual, one sentence each.
    """

    table: DataFrame
    powers: tuple[Power, ...]
    hypothesis: tuple[str, str]
    wanted: float
    recommended: PowerDesign | None
    verdict: str
    lack: str = ""
    notes: tuple[str, ...] = ()

    def to_frame(self) -> DataFrame:
        """Return all designs.

        Returns
        -------
        DataFrame
            The columns of `table`.
        """
        return self.table

    @property
    def shown(self) -> Power:
        """The recommended design, or the given one."""
        best = self.recommended
        known = (one for one in self.powers if best and _key(one.design) == _key(best))
        return next(known, self.powers[0])

    @property
    def answer(self) -> str:
        """The recommendation in one sentence, or why there is none."""
        return describe_plan(self)

    def summary(self) -> str:
        """Write the answer for reading.

        Returns
        -------
        str
            The recommendation in one sentence, the designs, and notes.
        """
        shown = self.table.to_string(index=False, float_format="{:.3g}".format)
        return "\n".join([self.answer, "", shown, *self.notes])


def find_row(plan: PowerPlan, hypothesis: tuple[str, str] | None = None) -> dict[str, Any]:
    """Find what is known of a hypothesis, that of the recommendation by default, in the design that is shown."""
    power = plan.shown
    place = power.design.hypotheses.index(hypothesis or plan.hypothesis)
    return {str(name): value for name, value in power.table.iloc[place].to_dict().items()}


def describe_plan(plan: PowerPlan, *, share: int = 1, size: float = 1.0, per: str = "unit") -> str:
    """Write the recommendation in a sentence, or why there is none.

    share: as many times the participants take part; size, per: the step of the metric that slopes are told for.
    """
    row, design, table = find_row(plan), plan.shown.design, plan.table
    name = f"{format_name(row['metric'])} on {format_name(row['attribute'])}"
    slope = f"a slope of {row['slope'] * size:.2g} points per {per} of {name}"
    people = format_count(design.participants * share, "participant")
    often = {1: "once", 2: "twice"}.get(design.repeats, f"{design.repeats} times")
    advice = "plan more recordings or reducers"
    if math.isfinite(row["recordings_needed"]):
        needed = format_count(int(row["recordings_needed"]), "recording")
        advice = f"{needed} would be enough with {people}"
    elif math.isfinite(found := row["detectable"] * size):
        advice = f"{people} can find slopes of {found:.2g} points per {per} or more"
    power, refuted = format_power(row["power"]), table[table["enough"] & table["refuted"]]
    if math.isfinite(row["simulated"]):
        ends = "{simulated_low:.2f} to {simulated_high:.2f}".format(**row)
        power = f"{format_power(row['simulated'])} (95 % Monte Carlo interval {ends})"
    best = table.sort_values("ceiling", na_position="first").iloc[-1]
    tried = table[table["kind"] != "smallest"]
    most = {
        CEILING: best["ceiling"], REFUTED: refuted["simulated"].max(), SMALL: tried["power"].max(),
    }.get(plan.verdict, NONE)  # fmt: skip
    return SENTENCES[plan.verdict].format(
        name=name, slope=slope, power=power, most=format_power(float(most)), advice=advice, lack=plan.lack,
        size=f"{people}, {describe_units(design.recordings, design.reducers)}, each rated {often}",
        units=describe_units(int(best["recordings"]), int(best["reducers"])),
        count=format_count(len(refuted), "design"),
        people=format_count(int(tried["participants"].max()) * share, "participant"),
    )  # fmt: skip


def format_power(power: float) -> str:
    """Write a power without claiming certainty.

    Examples
    --------
    >>> format_power(0.812), format_power(0.998), format_power(0.004), format_power(float("nan"))
    ('0.81', '> 0.99', '< 0.01', 'not estimable')
    """
    if not math.isfinite(power):
        return "not estimable"
    if power > SURE:
        return f"> {SURE}"
    return f"{power:.2f}" if power >= HOPELESS else f"< {HOPELESS}"


def describe_units(recordings: int, reducers: int) -> str:
    """Describe how many stimuli a design has."""
    return f"{format_count(recordings, 'recording')} × {format_count(reducers, 'reducer')}"


def plan_power(  # noqa: PLR0913 - what varies, for what; how many studies, who does them, who watches
    design: PowerDesign,
    truth: Truth,
    *,
    participants: Sequence[int] = (),
    recordings: Sequence[int] = (),
    reducers: Sequence[int] = (),
    repeats: Sequence[int] = (),
    hypothesis: tuple[str, str] | None = None,
    studies: int = 1000,
    seed: int = 0,
    workers: int | Workers = ALONE,
    keep: PathLike | None = None,
    progress: Progress = False,
) -> PowerPlan:
    """Find the power of designs around a given one, and recommend the smallest that is enough.

    Parameters
    ----------
    design : PowerDesign
        The given study, whose `wanted` power is asked for.
    truth : Truth
        Planted slopes, and how people, stimuli and ratings differ.
    participants, recordings, reducers, repeats : sequence of int, optional
        Sizes to try, one factor at a time, and participants x recordings together; multiples of the given ones, and 1
        to 4 repeats, if left out.
    hypothesis : tuple of str, optional
        Attribute and metric that the recommendation is for; the planted slope with the least power if left out.
    studies : int
        Simulated studies of the given design and of the recommended one; 0 for the closed form alone.
    seed : int
        Random seed.
    workers : int or Workers
        Number of processes, or what else simulates.
    keep : path, optional
        A folder that keeps results: an interrupted call resumes from there, a completed one is not recomputed.
    progress : bool or callable
        Whether to show a progress bar; or called with the numbers of steps done and to do.

    Returns
    -------
    PowerPlan
        All designs, those simulated, and the recommended one.

    Raises
    ------
    ValueError
        If the hypothesis is not one of the design, slopes name no metric of it, or a number is too small.

    Notes
    -----
    Closed form: standard errors of generalised least squares with the planted spreads, Welch's and Satterthwaite's
    degrees of freedom, the noncentral t distribution at the level of Holm's first step. Simulation: studies are drawn,
    fitted as `fit_primary` fits them, and tested by Holm's method over attributes x metrics.

    For every combination of recordings, reducers and repeats that is tried, the smallest number of participants that
    is enough in closed form is added to the table (``kind`` is smallest). The recommended design changes as few of
    recordings, reducers and repeats as is needed, then takes the fewest trials of all participants together; where
    numbers of participants are named, it has one of these. It is simulated: where the simulation refutes it (its whole
    interval lies below the wanted power, or fewer than 90 % of the studies give a test), the next one is simulated that
    detects a slope smaller by as much as the simulation lacked, or where there is none the one that detects the
    smallest; up to 8 of them.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from feel321 import analysis
    >>> rng = np.random.default_rng(1)
    >>> items = pd.DataFrame({"recording": np.repeat(range(6), 4), "reducer": list(range(4)) * 6,
    ...     "match": rng.uniform(0, 1, 24)})
    >>> design = analysis.PowerDesign(items, ["match"], participants=12)
    >>> plan = analysis.plan_power(design, analysis.Truth({"match": 20.0}), studies=0)
    >>> plan.recommended.n_items, plan.hypothesis
    (72, ('rating', 'match'))
    """
    aim = _choose_aim(design, truth, hypothesis)
    wanted = dict(zip(SIZES, (participants, recordings, reducers, repeats), strict=True))
    rows = list(_tabulate(_list_designs(design, wanted), truth, aim))
    allowed = set(participants) or {row.design.participants for row in rows}
    enough = [row for row in rows if row.is_enough and row.design.participants in allowed]
    enough.sort(key=lambda row: _rank(row.design, design))
    runs: dict[tuple[int, ...], Power] = {}

    def run(one: PowerDesign) -> Power:
        done, total = len(runs), 2 + TRIED
        if _key(one) not in runs:
            runs[_key(one)] = find_power(
                one, truth, studies=studies, seed=seed, workers=workers, keep=keep,
                progress=lambda part, whole: move(min(done, total - 1) * whole + part, total * whole),
            )  # fmt: skip
        return runs[_key(one)]

    with follow(progress, "power") as move:
        run(design)
        chosen = _confirm(enough, run, aim)
    return _build_plan(rows, runs, chosen=chosen, aim=aim)


class Row(NamedTuple):
    """A design in closed form."""

    design: PowerDesign
    kind: str
    power: float
    ceiling: float
    detectable: float
    width: float

    @property
    def is_enough(self) -> bool:
        """Whether it has the wanted power in closed form."""
        return self.power >= self.design.wanted


def find_sizes(design: PowerDesign) -> dict[str, int]:
    """Find the sizes that identify a design among those of a plan."""
    return {name: int(getattr(design, name)) for name in SIZES}


def _key(design: PowerDesign) -> tuple[int, ...]:
    return tuple(find_sizes(design).values())


def _rank(one: PowerDesign, given: PowerDesign) -> tuple[int, int, int]:
    """Rank by the changes to the given stimuli and repeats, then by the trials of all participants together."""
    changes = sum(size != own for size, own in zip(_key(one)[1:], _key(given)[1:], strict=True))
    return changes, one.trials * one.participants, one.participants


def _choose_aim(
    design: PowerDesign, truth: Truth, hypothesis: tuple[str, str] | None
) -> tuple[int, int]:
    """Choose the hypothesis, by its place, and its metric: the one that is named, or what has the least power."""
    if hypothesis is None:
        table = find_power(design, truth, studies=0).table
        planted = table[table["slope"] != 0]
        if planted.empty:
            raise ValueError("slopes must hold one that is not 0, got none; plant one")
        row = planted.sort_values("power", kind="stable").iloc[0]
        hypothesis = (row["attribute"], row["metric"])
    if tuple(hypothesis) not in design.hypotheses:
        known = ", ".join("/".join(one) for one in design.hypotheses)
        raise ValueError(f"hypothesis must be one of {known}; got {'/'.join(hypothesis)}")
    return design.hypotheses.index(tuple(hypothesis)), design.metrics.index(hypothesis[1])


def _list_designs(
    design: PowerDesign, wanted: Mapping[str, Sequence[int]]
) -> Iterator[tuple[str, PowerDesign]]:
    """List the given design, others by one factor at a time, and participants x recordings; each once."""
    sizes = {"repeats": list(REPEATS)}
    for name, factors in FACTORS.items():
        own = getattr(design, name)
        sizes[name] = sorted({
            max(min(LEAST[name], own), round(own * factor)) for factor in factors
        })
    sizes |= {name: sorted(set(given)) for name, given in wanted.items() if given}
    changes = [("given", dict[str, int]())]
    changes += [("one factor", {name: size}) for name in SIZES for size in sizes[name]]
    pairs = product(sizes["participants"], sizes["recordings"])
    changes += [("grid", {"participants": one, "recordings": two}) for one, two in pairs]
    seen = set()
    for kind, change in changes:
        other = design.change(**change)
        if _key(other) not in seen:
            seen.add(_key(other))
            yield kind, other


def _tabulate(
    designs: Iterator[tuple[str, PowerDesign]], truth: Truth, aim: tuple[int, int]
) -> Iterator[Row]:
    """Compute every design, and with the recordings, reducers and repeats of each the fewest participants."""
    known = set()
    for kind, design in designs:
        form = ClosedForm(Scenario(design, truth), aim[1])
        slope = float(form.scenario.planted.slopes.ravel()[aim[0]])
        yield _make_row(kind, form, slope)
        others = _key(design)[1:]
        number = NONE if others in known else form.find_participants(slope)
        known.add(others)
        if math.isfinite(number) and number != design.participants:
            smallest = Scenario(design.change(participants=int(number)), truth)
            yield _make_row("smallest", ClosedForm(smallest, aim[1]), slope)


def _make_row(kind: str, form: ClosedForm, slope: float) -> Row:
    power, ceiling = form.find_power(slope), form.find_ceiling(slope)
    return Row(
        form.scenario.design, kind, power, ceiling, form.find_detectable(), form.find_width()
    )


def _confirm(
    enough: list[Row], run: Callable[[PowerDesign], Power], aim: tuple[int, int]
) -> Row | None:
    """Find the smallest design that its simulation does not refute; after each refusal, one with clearly more power."""
    left, most = enough, math.inf
    for _ in range(TRIED):
        if not left:
            break
        strongest = min(left, key=lambda row: row.detectable)
        row = next((one for one in left if one.detectable <= most), strongest)
        found = run(row.design)
        if not _is_refuted(found, aim):
            return row
        left = [one for one in left if one.detectable < row.detectable]
        most = row.detectable * _find_step(found, aim)
    return None


def _find_step(found: Power, aim: tuple[int, int]) -> float:
    """Find the share of a refuted design's detectable slope that the next one must detect, from its simulation."""
    from scipy.stats import norm

    seen, wanted = found.table["simulated"].iloc[aim[0]], found.design.wanted
    share = min(max(np.nan_to_num(seen), 0.5 / found.studies), wanted)
    limit = float(norm.isf(found.design.level / 2))
    shifts = [limit + float(norm.ppf(one)) for one in (share, wanted)]
    return min(max(shifts[0] / shifts[1], STEPS[0]), STEPS[1])


def _is_refuted(power: Power, aim: tuple[int, int]) -> bool:
    """Check whether a simulation lies below the wanted power as a whole, or gives hardly any test."""
    row = power.table.iloc[aim[0]]
    confirmed = row["simulated_high"] >= power.design.wanted
    return bool(power.studies and not (confirmed and row["tests"] >= LEAST_TESTED * power.studies))


def _build_plan(
    rows: list[Row],
    runs: Mapping[tuple[int, ...], Power],
    *,
    chosen: Row | None,
    aim: tuple[int, int],
) -> PowerPlan:
    import pandas as pd

    given, listed = rows[0].design, []
    for row in rows:
        power = runs.get(_key(row.design))
        seen = {"simulated": NONE, "simulated_low": NONE, "simulated_high": NONE}
        if power:
            seen = {name: float(power.table[name].iloc[aim[0]]) for name in seen}
        listed.append(
            find_sizes(row.design)
            | {"trials": row.design.trials, **row._asdict(), **seen, "enough": row.is_enough}
            | {"refuted": bool(power and _is_refuted(power, aim)), "recommended": row is chosen}
        )
    table = pd.DataFrame(listed).drop(columns="design")
    first = runs[_key(given)]
    form = ClosedForm(Scenario(given, first.truth), aim[1])
    notes = [note for power in runs.values() for note in power.notes]
    for row, found in zip(rows, listed, strict=True):
        if found["enough"] and found["refuted"]:
            seen_power = format_power(found["simulated"]).replace("not estimable", "no test")
            design = f"{row.design.participants} participants, " + describe_units(
                *_key(row.design)[1:3]
            )
            notes.append(
                f"Simulation contradicts the closed form of {design}: {format_power(row.power)} in closed form, "
                f"{seen_power} in simulated studies."
            )
    return PowerPlan(
        table=table, powers=tuple(runs.values()), hypothesis=given.hypotheses[aim[0]], wanted=given.wanted,
        recommended=chosen.design if chosen else None, verdict=ENOUGH if chosen else _judge(table, first, aim),
        lack=form.find_lack(), notes=tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def _judge(table: DataFrame, given: Power, aim: tuple[int, int]) -> str:
    """Say why no design is enough."""
    if not given.table["slope"].iloc[aim[0]]:
        return NOTHING
    if table["power"].isna().all():
        return UNTESTABLE
    if (table["enough"] & table["refuted"]).any():
        return REFUTED
    return SMALL if table["ceiling"].max() >= given.design.wanted else CEILING
