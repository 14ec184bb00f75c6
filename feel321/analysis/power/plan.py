"""How large must a study be? The closed form searches, simulated studies fitted by the primary model check."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from feel321.analysis.page import render_words
from feel321.analysis.power.closed import ClosedForm
from feel321.analysis.power.simulate import Scenario, simulate_studies
from feel321.analysis.power.truth import LEAST, LEVEL, SIZES, PowerDesign, Truth
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.primary.plan import SCENE, SOURCE
from feel321.analysis.words import format_count, format_name
from feel321.doors import as_path, follow
from feel321.jobs import ALONE, Workers, as_workers
from feel321.records import Result

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.types import PathLike, Progress

FACTORS: Mapping[str, tuple[float, ...]] = {
    "participants": (0.5, 0.75, 1, 1.5, 2, 3), "recordings": (0.5, 1, 1.5, 2, 3), "reducers": (0.5, 1, 1.5),
}  # fmt: skip
"""Sizes that are tried, as multiples of the given ones."""

REPEATS = (1, 2, 3, 4)

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

    def is_refuted(self, place: int) -> bool:
        """Check whether a simulation lies below the wanted power as a whole, or gives hardly any test."""
        row = self.table.iloc[place]
        confirmed = row["simulated_high"] >= self.design.wanted
        return bool(
            self.studies and not (confirmed and row["tests"] >= LEAST_TESTED * self.studies)
        )


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
        se, df = form.find_errors()
        rows.append({
            "attribute": attribute, "metric": metric, "slope": slope, "se": se, "df": df,
            "width": form.find_width(), "power": form.find_power(slope), "ceiling": form.find_ceiling(slope),
            "detectable": form.find_detectable(), "recordings_needed": form.find_recordings(slope),
        })  # fmt: skip
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
    """Write a power without claiming certainty."""
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
    Closed form: generalised least squares with the planted spreads, the noncentral t distribution at the level of
    Holm's first step. Simulation: studies are drawn, fitted as `fit_primary` fits them, and tested by Holm's method.

    For every combination of recordings, reducers and repeats, the smallest number of participants that is enough in
    closed form is added to the table. The recommended design changes as few of recordings, reducers and repeats as is
    needed, then takes the fewest trials of all participants together; where numbers of participants are named, it has
    one of these. Where its simulation refutes it, the next one is simulated that detects a slope at least a fifth
    smaller, or where there is none the one that detects the smallest; up to 8 of them.

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
    search = _Search(truth, *aim, rows=[], runs={})
    for kind, one in _list_designs(design, wanted):
        search.add(one, kind)
    allowed = set(participants) or {one.participants for one, _ in search.rows}
    left = [
        (one, row)
        for one, row in search.rows
        if row["power"] >= one.wanted and one.participants in allowed
    ]
    own = list(design.sizes.values())[1:]

    def rank(found: tuple[PowerDesign, Mapping[str, Any]]) -> tuple[int, int, int]:
        one = found[0]
        changed = sum(
            size != same for size, same in zip([*one.sizes.values()][1:], own, strict=True)
        )
        return changed, one.trials * one.participants, one.participants

    left.sort(key=rank)
    with follow(progress, "power") as move:

        def run(one: PowerDesign) -> Power:
            done, key = len(search.runs), tuple(one.sizes.values())
            if key not in search.runs:
                search.runs[key] = find_power(
                    one, truth, studies=studies, seed=seed, workers=workers, keep=keep,
                    progress=lambda part, whole: move(min(done, TRIED) * whole + part, (TRIED + 1) * whole),
                )  # fmt: skip
            return search.runs[key]

        run(design)
        most, chosen = math.inf, None
        for _ in range(TRIED if left else 0):
            strongest = min(left, key=lambda found: found[1]["detectable"])
            one, row = next((each for each in left if each[1]["detectable"] <= most), strongest)
            if not run(one).is_refuted(aim[0]):
                chosen = one
                break
            left = [each for each in left if each[1]["detectable"] < row["detectable"]]
            most = row["detectable"] * STEP
            if not left:
                break
    return search.conclude(chosen)


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
    seen: list[dict[str, int]] = []
    for kind, change in changes:
        other = replace(design, **change)  # type: ignore[arg-type]  # sizes are numbers
        if other.sizes not in seen:
            seen.append(other.sizes)
            yield kind, other


@dataclass(frozen=True, slots=True)
class _Search:
    """Designs in closed form for one hypothesis, by its place and that of its metric, and those simulated by size."""

    truth: Truth
    place: int
    metric: int
    rows: list[tuple[PowerDesign, dict[str, Any]]]
    runs: dict[tuple[int, ...], Power]
    known: set[tuple[int, ...]] = field(default_factory=set)

    def add(self, design: PowerDesign, kind: str) -> None:
        """Compute a design; the first with its recordings, reducers and repeats, with the fewest participants too."""
        form = ClosedForm(Scenario(design, self.truth), self.metric)
        slope = float(form.scenario.planted.slopes.ravel()[self.place])
        power = form.find_power(slope)
        self.rows.append((design, {
            **design.sizes, "trials": design.trials, "kind": kind, "power": power,
            "ceiling": form.find_ceiling(slope), "detectable": form.find_detectable(), "width": form.find_width(),
        }))  # fmt: skip
        others = tuple(design.sizes.values())[1:]
        if others in self.known:
            return
        self.known.add(others)
        number = form.find_participants(slope)
        if math.isfinite(number) and number != design.participants:
            self.add(replace(design, participants=int(number)), "smallest")

    def conclude(self, chosen: PowerDesign | None) -> PowerPlan:
        """Put what was simulated beside the closed form, and say why no design is enough where none is."""
        first = next(iter(self.runs.values()))
        notes = [note for power in self.runs.values() for note in power.notes]
        listed = []
        for design, row in self.rows:
            power, enough = (
                self.runs.get(tuple(design.sizes.values())),
                row["power"] >= design.wanted,
            )
            found, refuted = dict.fromkeys(SIMULATED, math.nan), False
            if power:
                found = {name: float(power.table[name].iloc[self.place]) for name in SIMULATED}
                refuted = power.is_refuted(self.place)
            judged = {"enough": enough, "refuted": refuted, "recommended": design is chosen}
            listed.append(row | found | judged)
            if enough and refuted:
                units = describe_units(design.recordings, design.reducers)
                share = format_power(found["simulated"]).replace("not estimable", "no test")
                notes.append(
                    f"Simulation contradicts the closed form of {design.participants} participants, {units}: "
                    f"{format_power(row['power'])} in closed form, {share} in simulated studies."
                )
        table = pd.DataFrame(listed)
        verdicts = {
            ENOUGH: chosen is not None,
            NOTHING: not first.table["slope"].iloc[self.place],
            UNTESTABLE: table["power"].isna().all(),
            REFUTED: (table["enough"] & table["refuted"]).any(),
            SMALL: table["ceiling"].max() >= first.design.wanted,
            CEILING: True,
        }
        return PowerPlan(
            table=table, powers=tuple(self.runs.values()), hypothesis=first.design.hypotheses[self.place],
            wanted=first.design.wanted, recommended=chosen,
            verdict=next(one for one, holds in verdicts.items() if holds),
            lack=ClosedForm(Scenario(first.design, self.truth), self.metric).find_lack(),
            notes=tuple(dict.fromkeys(notes)),
        )  # fmt: skip
