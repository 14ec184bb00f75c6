"""How large must a study be? The closed form searches, simulated studies fitted by the primary model check."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from feel321.analysis.page import render_words
from feel321.analysis.power.closed import ClosedForm
from feel321.analysis.power.simulate import Scenario, simulate_studies
from feel321.analysis.power.truth import LEVEL, SIZES, PowerDesign, Truth
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.primary.plan import SCENE, SOURCE
from feel321.analysis.words import format_count, format_name
from feel321.doors import as_path, follow
from feel321.jobs import ALONE, Workers, as_workers
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

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

STEP = 0.8
"""Share of a refuted design's detectable slope that the next one must detect."""

LEAST_TESTED = 0.9
"""Share of simulated studies that must give a test, for a simulation to confirm a design."""

SURE, HOPELESS = 0.99, 0.01

SIMULATED = ("simulated", "simulated_low", "simulated_high")

ENOUGH, NOTHING, UNTESTABLE, CEILING, REFUTED, SMALL = (
    "enough", "nothing planted", "not estimable", "ceiling", "refuted", "too small",
)  # fmt: skip
"""Verdicts: a design is enough; or none is, and why."""


# One design.


@dataclass(frozen=True, slots=True)
class Power:
    """The power of one design; NaN where there is none, or nothing was simulated.

    table: a row per hypothesis, ``attribute metric slope`` (planted, per unit of the metric); in closed form ``se df
    width`` (of the 95 % interval), ``power`` (Holm's first step), ``ceiling`` (with participants without end),
    ``detectable`` (smallest slope found with the wanted power), ``recordings_needed``; ``simulated`` (power, Holm's
    method), ``simulated_low simulated_high`` (95 % Wilson interval) and ``tests`` (studies that gave a test).
    """

    design: PowerDesign
    truth: Truth
    table: DataFrame
    studies: int
    seed: int
    notes: tuple[str, ...] = ()


def find_power(  # noqa: PLR0913 - a design and a truth; how many studies, who does them, where they are kept
    design: PowerDesign,
    truth: Truth,
    *,
    studies: int = 1000,
    seed: int = 0,
    workers: int | Workers = ALONE,
    keep: PathLike | None = None,
    progress: Progress = False,
) -> Power:
    """Find the power of a design; keep: a folder from which an interrupted call is continued."""
    if studies < 0:
        raise ValueError(f"studies must be 0 or more, got {studies}; give 1000")
    scenario = Scenario(design, truth)
    forms = {metric: ClosedForm(scenario, place) for place, metric in enumerate(design.metrics)}
    rows, notes = [], list(_list_notes(design, truth))
    for attribute, metric in design.hypotheses:
        form, slope = forms[metric], truth.find_slope(attribute, metric)
        rows.append(
            {"attribute": attribute, "metric": metric, "slope": slope} | _describe(form, slope)
        )
        if slope and (lack := form.find_lack()):
            notes.append(f"The planted slope of {metric} on {attribute} cannot be tested: {lack}.")
    p = np.empty((0, len(rows)))
    if studies:
        place = None if keep is None else as_path(keep, "keep")
        with follow(progress, "power") as move:
            p = simulate_studies(
                design, truth, studies=studies, seed=seed, workers=as_workers(workers), keep=place, progress=move
            )  # fmt: skip
        if lost := int(np.isnan(p).all(axis=1).sum()):
            notes.append(f"{lost} of {studies} simulated studies gave no test and are excluded.")
    table = pd.DataFrame(rows).join(tabulate_shares(p))
    return Power(design, truth, table, studies, seed, tuple(notes))


def _describe(form: ClosedForm, slope: float) -> dict[str, float]:
    se, df = form.find_errors()
    return {
        "se": se, "df": df, "width": form.find_width(), "power": form.find_power(slope),
        "ceiling": form.find_ceiling(slope), "detectable": form.find_detectable(),
        "recordings_needed": form.find_recordings(slope),
    }  # fmt: skip


def tabulate_shares(p: np.ndarray) -> DataFrame:
    """Tabulate the share of studies that find each slope by Holm's method; p: (studies, n_hypotheses)."""
    from scipy.stats import binomtest

    adjusted = np.array([adjust_holm(row) for row in p.tolist()]).reshape(p.shape)
    rows = []
    for column in adjusted.T:
        known = int(np.isfinite(column).sum())
        share = low = high = math.nan
        if known:
            found = binomtest(int((column < LEVEL).sum()), known)
            share = float(found.statistic)
            low, high = found.proportion_ci(method="wilson")
        rows.append((share, float(low), float(high), known))
    return pd.DataFrame(rows, columns=[*SIMULATED, "tests"])


def _list_notes(design: PowerDesign, truth: Truth) -> Iterator[str]:
    """Say what was assumed."""
    yield f"Standard deviations: {truth.source}."
    if len(design.hypotheses) > 1:
        first = f"{design.level:.3g}, the first step of Holm's method over {len(design.hypotheses)} tests"
        yield f"The closed form is at a level of {first}."
    if len(design.attributes) > 1:
        yield "Attributes are taken to be independent of each other, although the same people rate them."
    if not design.is_own:
        yield (
            "Recordings and reducers are drawn from those of the stimulus set anew for every study; where there are "
            "more than the set has, some are used more than once, with the same metrics."
        )
    if SOURCE in design.items and not design.items.drop_duplicates(SCENE)[SOURCE].is_unique:
        yield (
            "Several recordings come from one source; what else they share is not simulated, so actual "
            "power is lower."
        )


# Many designs.


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
        best = self.recommended and self.recommended.sizes
        return next((one for one in self.powers if one.design.sizes == best), self.powers[0])

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
    best = table.sort_values("ceiling", na_position="first").iloc[-1]
    tried, refuted = table[table["kind"] != "smallest"], table[table["enough"] & table["refuted"]]
    most = {CEILING: best["ceiling"], REFUTED: refuted["simulated"].max()}
    detectable = row["detectable"] * size
    return " ".join(render_words(
        "power", verdict=plan.verdict, lack=plan.lack,
        what=f"{format_name(row['metric'])} on {format_name(row['attribute'])}",
        slope=f"{row['slope'] * size:.2g}", per=per, power=format_simulated(row),
        most=format_power(float(most.get(plan.verdict, tried["power"].max()))),
        people=design.participants * share, units=describe_units(design.recordings, design.reducers),
        repeats=design.repeats, tried=len(refuted), largest=int(tried["participants"].max()) * share,
        needed=row["recordings_needed"] if math.isfinite(row["recordings_needed"]) else 0,
        detectable=f"{detectable:.2g}" if math.isfinite(detectable) else "",
        best_units=describe_units(int(best["recordings"]), int(best["reducers"])),
    ))  # fmt: skip


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


def format_simulated(row: Mapping[Any, Any]) -> str:
    """Write the simulated power with its interval; that of the closed form where nothing was simulated."""
    if not math.isfinite(row["simulated"]):
        return format_power(row["power"])
    ends = "{simulated_low:.2f} to {simulated_high:.2f}".format(**row)
    return f"{format_power(row['simulated'])} (95 % Monte Carlo interval {ends})"


def describe_units(recordings: int, reducers: int) -> str:
    """Describe how many stimuli a design has."""
    return f"{format_count(recordings, 'recording')} × {format_count(reducers, 'reducer')}"


class Row(NamedTuple):
    """A design in closed form, for the hypothesis that is planned for."""

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
    detects a slope at least a fifth smaller, or where there is none the one that detects the smallest; up to 8 of them.

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
    runs: dict[tuple[int, ...], Power] = {}

    def run(one: PowerDesign) -> Power:
        done, key = len(runs), _key(one)
        if key not in runs:
            runs[key] = find_power(
                one, truth, studies=studies, seed=seed, workers=workers, keep=keep,
                progress=lambda part, whole: move(min(done, TRIED) * whole + part, (TRIED + 1) * whole),
            )  # fmt: skip
        return runs[key]

    def rank(row: Row) -> tuple[int, int, int]:
        pairs = zip(_key(row.design)[1:], _key(design)[1:], strict=True)
        people = row.design.participants
        return sum(size != own for size, own in pairs), row.design.trials * people, people

    allowed = set(participants) or {row.design.participants for row in rows}
    left = [row for row in rows if row.is_enough and row.design.participants in allowed]
    left.sort(key=rank)
    chosen, most = None, math.inf
    with follow(progress, "power") as move:
        run(design)
        for _ in range(TRIED):
            if not left:
                break
            strongest = min(left, key=lambda row: row.detectable)
            row = next((one for one in left if one.detectable <= most), strongest)
            if not _is_refuted(run(row.design), aim[0]):
                chosen = row
                break
            left = [one for one in left if one.detectable < row.detectable]
            most = row.detectable * STEP
    return _build_plan(rows, runs, chosen=chosen, aim=aim)


def _key(design: PowerDesign) -> tuple[int, ...]:
    return tuple(design.sizes.values())


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
        least = min(LEAST[name], own)
        sizes[name] = sorted({max(least, round(own * factor)) for factor in factors})
    sizes |= {name: sorted(set(given)) for name, given in wanted.items() if given}
    changes = [("given", dict[str, int]())]
    changes += [("one factor", {name: size}) for name in SIZES for size in sizes[name]]
    pairs = product(sizes["participants"], sizes["recordings"])
    changes += [("grid", {"participants": one, "recordings": two}) for one, two in pairs]
    seen = set()
    for kind, change in changes:
        other = replace(design, **change)  # type: ignore[arg-type]  # sizes are numbers
        if _key(other) not in seen:
            seen.add(_key(other))
            yield kind, other


def _tabulate(
    designs: Iterator[tuple[str, PowerDesign]], truth: Truth, aim: tuple[int, int]
) -> Iterator[Row]:
    """Compute every design, and with the recordings, reducers and repeats of each the fewest participants."""
    known = set()

    def make_row(design: PowerDesign, kind: str) -> tuple[Row, float]:
        form = ClosedForm(Scenario(design, truth), aim[1])
        slope = float(form.scenario.planted.slopes.ravel()[aim[0]])
        found = form.find_power(slope), form.find_ceiling(slope)
        row = Row(design, kind, *found, form.find_detectable(), form.find_width())
        others, number = _key(design)[1:], math.nan
        if others not in known:
            known.add(others)
            number = form.find_participants(slope)
        return row, number

    for kind, design in designs:
        row, number = make_row(design, kind)
        yield row
        if math.isfinite(number) and number != design.participants:
            yield make_row(replace(design, participants=int(number)), "smallest")[0]


def _is_refuted(power: Power, place: int) -> bool:
    """Check whether a simulation lies below the wanted power as a whole, or gives hardly any test."""
    row = power.table.iloc[place]
    confirmed = row["simulated_high"] >= power.design.wanted
    return bool(power.studies and not (confirmed and row["tests"] >= LEAST_TESTED * power.studies))


def _build_plan(
    rows: list[Row],
    runs: Mapping[tuple[int, ...], Power],
    *,
    chosen: Row | None,
    aim: tuple[int, int],
) -> PowerPlan:
    first = next(iter(runs.values()))
    given, notes = first.design, [note for power in runs.values() for note in power.notes]
    listed = []
    for row in rows:
        power = runs.get(_key(row.design))
        seen = dict.fromkeys(SIMULATED, math.nan)
        if power:
            seen = {name: float(power.table[name].iloc[aim[0]]) for name in SIMULATED}
        is_refuted = bool(power and _is_refuted(power, aim[0]))
        listed.append(
            row.design.sizes
            | {"trials": row.design.trials, **row._asdict(), **seen, "enough": row.is_enough}
            | {"refuted": is_refuted, "recommended": row is chosen}
        )
        if row.is_enough and is_refuted:
            units = describe_units(row.design.recordings, row.design.reducers)
            found = format_power(seen["simulated"]).replace("not estimable", "no test")
            notes.append(
                f"Simulation contradicts the closed form of {row.design.participants} participants, {units}: "
                f"{format_power(row.power)} in closed form, {found} in simulated studies."
            )
    table = pd.DataFrame(listed).drop(columns="design")
    verdict = ENOUGH
    if not chosen:
        verdicts = {
            NOTHING: not first.table["slope"].iloc[aim[0]],
            UNTESTABLE: table["power"].isna().all(),
            REFUTED: (table["enough"] & table["refuted"]).any(),
            SMALL: table["ceiling"].max() >= given.wanted,
            CEILING: True,
        }
        verdict = next(name for name, holds in verdicts.items() if holds)
    return PowerPlan(
        table=table, powers=tuple(runs.values()), hypothesis=given.hypotheses[aim[0]], wanted=given.wanted,
        recommended=chosen.design if chosen else None, verdict=verdict,
        lack=ClosedForm(Scenario(given, first.truth), aim[1]).find_lack(), notes=tuple(dict.fromkeys(notes)),
    )  # fmt: skip
