"""The power of many designs around one, and the smallest that is enough."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.power import closed, draw, find
from feel321.analysis.power.design import SIZES, Power, PowerDesign, PowerPlan, Truth
from feel321.doors import follow
from feel321.jobs import ALONE, Workers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from pandas import DataFrame, Series

    from feel321.types import PathLike, Progress

FACTORS: Mapping[str, tuple[float, ...]] = {
    "participants": (0.5, 0.75, 1, 1.5, 2, 3), "recordings": (0.5, 1, 1.5, 2, 3), "reducers": (0.5, 1, 1.5),
}  # fmt: skip
"""Sizes that are tried, as multiples of the given ones."""

REPEATS = (1, 2, 3, 4)

LEAST = {"participants": 6, "recordings": 4, "reducers": 3}
"""No smaller number is tried unless it is asked for."""

FURTHER = 3
"""Designs that are simulated beside the given and the recommended one."""

TRIED = 8
"""Designs that are simulated in search of one whose simulation does not contradict the closed form."""

LEAST_TESTED = 0.9
"""Share of simulated studies that must give a test, for a simulation to confirm a design."""

STEPS = 0.5, 0.95
"""Least and largest share of a refuted design's detectable slope that the next one must detect."""


class Aim(NamedTuple):
    """The hypothesis that the recommendation is for, and where its attribute and metric stand."""

    attribute: str
    metric: str
    row: int
    column: int

    def compute(self, design: PowerDesign, truth: Truth) -> tuple[closed.ClosedForm, float]:
        """Compute the closed form of a design, and the planted slope."""
        scenario = draw.Scenario(design, truth)
        weights = np.eye(len(design.metrics))[self.column]
        form = closed.ClosedForm(scenario, closed.draw_sets(scenario), weights, design.level)
        return form, float(scenario.planted.slopes[self.row, self.column])


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
        Simulated studies of the given design, of the recommended one and of three more; 0 for the closed form alone.
    seed : int
        Random seed.
    workers : int or Workers
        Number of processes, or what else simulates.
    keep : path, optional
        A folder for what is done, as for `find_power`.
    progress : bool or callable
        Whether to show a progress bar; or called with the numbers of steps done and to do.

    Returns
    -------
    PowerPlan
        All designs, those simulated, and the recommended one.

    Raises
    ------
    ValueError
        If the hypothesis is not one of the design, or as for `find_power`.

    Notes
    -----
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
    rows = list(_tabulate(_list_designs(design, wanted), truth, aim=aim))
    allowed = set(participants) or {row.design.participants for row in rows}
    rows = [row._replace(allowed=row.design.participants in allowed) for row in rows]
    enough = sorted(filter(_Row.is_enough, rows), key=lambda row: _rank(row, design))
    chosen = next(iter(enough), None)
    runs: dict[tuple[int, ...], Power] = {}

    def run(one: PowerDesign) -> Power:
        key, done, total = _key(one), len(runs), 2 + FURTHER
        if key not in runs:
            runs[key] = find.find_power(
                one, truth, studies=studies, seed=seed, workers=workers, keep=keep,
                progress=lambda part, whole: move(min(done, total - 1) * whole + part, total * whole),
            )  # fmt: skip
        return runs[key]

    with follow(progress, "power") as move:
        if studies:
            run(design)
            chosen = _confirm(enough, run, aim)
            for row in [row for row in rows if _is_further(row.design, design)][:FURTHER]:
                run(row.design)
    untested = find.note_untested(draw.Scenario(design, truth))
    return _build_plan(rows, runs, chosen=chosen, aim=aim, notes=untested)


class _Row(NamedTuple):
    """A design in closed form."""

    kind: str
    design: PowerDesign
    power: float
    ceiling: float
    detectable: float
    width: float
    lack: str
    allowed: bool = True

    def is_enough(self) -> bool:
        """Check for the wanted power in closed form, with numbers that are allowed."""
        return self.allowed and self.power >= self.design.wanted


def _key(design: PowerDesign) -> tuple[int, ...]:
    return tuple(getattr(design, name) for name in SIZES)


def _rank(row: _Row, given: PowerDesign) -> tuple[int, int, int]:
    """Rank by the changes to the given stimuli and repeats, then by the trials of all participants together."""
    changes = sum(
        one != own for one, own in zip(_key(row.design)[1:], _key(given)[1:], strict=True)
    )
    return changes, row.design.trials * row.design.participants, row.design.participants


def _is_further(one: PowerDesign, given: PowerDesign) -> bool:
    """Check for a design that differs from the given one in participants alone."""
    return _key(one)[1:] == _key(given)[1:] and one.participants != given.participants


def _choose_aim(design: PowerDesign, truth: Truth, hypothesis: tuple[str, str] | None) -> Aim:
    """Choose the hypothesis: the one that is named, or the planted slope that has the least power."""
    if hypothesis is None:
        table = find.find_power(design, truth, studies=0).table
        planted = table[table["slope"] != 0]
        if planted.empty:
            raise ValueError("slopes must hold one that is not 0, got none; plant one")
        row = planted.sort_values("power", kind="stable").iloc[0]
        hypothesis = (row["attribute"], row["metric"])
    if tuple(hypothesis) not in design.hypotheses:
        known = ", ".join("/".join(one) for one in design.hypotheses)
        raise ValueError(f"hypothesis must be one of {known}; got {'/'.join(hypothesis)}")
    attribute, metric = hypothesis
    return Aim(attribute, metric, design.attributes.index(attribute), design.metrics.index(metric))


def _list_designs(
    design: PowerDesign, wanted: Mapping[str, Sequence[int]]
) -> Iterator[tuple[str, PowerDesign]]:
    """List the given design, others by one factor at a time, and participants x recordings; each once."""
    sizes = {name: _list_sizes(name, design, wanted[name]) for name in SIZES}
    seen = {_key(design)}
    yield "given", design
    changes = [("one factor", {name: size}) for name in SIZES for size in sizes[name]]
    pairs = product(sizes["participants"], sizes["recordings"])
    changes += [("grid", {"participants": one, "recordings": two}) for one, two in pairs]
    for kind, change in changes:
        other = design.change(**change)
        if _key(other) not in seen:
            seen.add(_key(other))
            yield kind, other


def _list_sizes(name: str, design: PowerDesign, wanted: Sequence[int]) -> list[int]:
    """List the sizes of one factor that are tried."""
    if wanted:
        return sorted(set(wanted))
    if name == "repeats":
        return list(REPEATS)
    own = getattr(design, name)
    least = min(LEAST[name], own)
    return sorted({max(least, round(own * factor)) for factor in FACTORS[name]})


def _tabulate(
    designs: Iterator[tuple[str, PowerDesign]], truth: Truth, *, aim: Aim
) -> Iterator[_Row]:
    """Compute every design, and with the recordings, reducers and repeats of each the fewest participants."""
    known = set()
    for kind, design in designs:
        form, slope = aim.compute(design, truth)
        yield _make_row(kind, form, slope)
        others = _key(design)[1:]
        number = math.nan
        if others not in known:
            number = form.find_participants(slope, design.wanted)
        known.add(others)
        if math.isfinite(number) and number != design.participants:
            form, slope = aim.compute(design.change(participants=int(number)), truth)
            yield _make_row("smallest", form, slope)


def _make_row(kind: str, form: closed.ClosedForm, slope: float) -> _Row:
    design = form.scenario.design
    return _Row(
        kind, design, form.find_power(slope), form.find_ceiling(slope), form.find_detectable(design.wanted),
        form.find_width(), form.find_lack(),
    )  # fmt: skip


def _confirm(enough: list[_Row], run: Callable[[PowerDesign], Power], aim: Aim) -> _Row | None:
    """Find the smallest design that its simulation does not refute; after each refusal, one with clearly more power."""
    left, most = enough, math.inf
    for _ in range(TRIED if enough else 0):
        strongest = min(left, key=lambda row: row.detectable)
        row = next((row for row in left if row.detectable <= most), strongest)
        found = run(row.design)
        if not _is_refuted(found, aim):
            return row
        left = [one for one in left if one.detectable < row.detectable]
        most = row.detectable * _find_step(found, aim)
        if not left:
            break
    return None


def _find_step(found: Power, aim: Aim) -> float:
    """Find the share of a refuted design's detectable slope that the next one must detect, from its simulation."""
    from scipy.stats import norm

    seen = found.table["simulated"].iloc[_find_place(found.design, aim)]
    share = min(max(np.nan_to_num(seen), 0.5 / found.studies), found.design.wanted)
    limit = norm.isf(found.design.level / 2)
    shifts = [float(limit + norm.ppf(one)) for one in (share, found.design.wanted)]
    return min(max(shifts[0] / shifts[1], STEPS[0]), STEPS[1])


def _is_refuted(power: Power, aim: Aim) -> bool:
    """Check whether a simulation lies below the wanted power as a whole, or gives hardly any test."""
    found = power.table.iloc[_find_place(power.design, aim)]
    enough = found["simulated_high"] >= power.design.wanted
    return not (enough and found["tests"] >= LEAST_TESTED * power.studies)


def _find_place(design: PowerDesign, aim: Aim) -> int:
    return aim.row * len(design.metrics) + aim.column


def _build_plan(
    rows: list[_Row],
    runs: Mapping[tuple[int, ...], Power],
    *,
    chosen: _Row | None,
    aim: Aim,
    notes: list[str],
) -> PowerPlan:
    import pandas as pd

    given = rows[0].design
    table = pd.DataFrame([_list_row(row, runs.get(_key(row.design)), aim) for row in rows])
    table["recommended"] = [row is chosen for row in rows]
    answer = _recommend(chosen, table, aim) if chosen else _explain(rows, table, aim)
    return PowerPlan(
        table=table, powers=tuple(runs.values()), hypothesis=(aim.attribute, aim.metric), wanted=given.wanted,
        recommended=chosen.design if chosen else None, answer=answer,
        notes=tuple(dict.fromkeys([*notes, *_list_notes(runs, given), *_note_refuted(rows, table)])),
    )  # fmt: skip


def _list_row(row: _Row, power: Power | None, aim: Aim) -> dict[str, object]:
    known = ("simulated", "simulated_low", "simulated_high")
    found = (
        power.table.iloc[_find_place(row.design, aim)] if power else dict.fromkeys(known, math.nan)
    )
    sizes = {name: getattr(row.design, name) for name in SIZES}
    closed_form = {name: getattr(row, name) for name in ("power", "ceiling", "detectable", "width")}
    return {
        **sizes, "trials": row.design.trials, "kind": row.kind, **closed_form,
        **{name: found[name] for name in known},
        "enough": row.power >= row.design.wanted,
        "refuted": bool(power and power.studies and _is_refuted(power, aim)),
    }  # fmt: skip


def _recommend(row: _Row, table: DataFrame, aim: Aim) -> str:
    """Describe the recommended design in a sentence."""
    found = table[table["recommended"]].iloc[0]
    power = f"{row.power:.0%}"
    if not math.isnan(found["simulated"]):
        low, high = 100 * found["simulated_low"], 100 * found["simulated_high"]
        power += f" in closed form, {found['simulated']:.0%} simulated ({low:.0f} to {high:.0f} %),"
    return (
        f"Recommended: {find.describe_design(row.design)} ({row.design.trials} trials per participant), with a power "
        f"of {power} to find the planted slope of {aim.metric} on {aim.attribute}."
    )


def _explain(rows: list[_Row], table: DataFrame, aim: Aim) -> str:
    """Say why no design is enough."""
    given, best = rows[0], max(rows, key=lambda row: (row.allowed, np.nan_to_num(row.power)))
    wanted, slope = given.design.wanted, f"the planted slope of {aim.metric} on {aim.attribute}"
    none = f"None of the {len(rows)} designs finds {slope} with a power of {wanted:.0%}"
    if math.isnan(best.power):
        return f"{none}: it is not estimable with the given one, because {given.lack}."
    refuted = int((table["enough"] & table["refuted"]).sum())
    if refuted:
        return (
            f"{none}: the closed form promises more, but the simulations of {refuted} designs that it "
            f"takes for enough lie below {wanted:.0%}, or give too few tests."
        )
    smallest = "the given one finds no slope with that power"
    if given.lack:
        smallest = f"the given one cannot test it: {given.lack}"
    elif math.isfinite(given.detectable):
        smallest = (
            f"the given one finds a slope of {given.detectable:.3g} points per unit with that power"
        )
    most = f"the best, {find.describe_design(best.design)}, has {best.power:.0%}"
    return f"{none}: {most}; {_explain_ceiling(rows, wanted)}; {smallest}."


def _explain_ceiling(rows: list[_Row], wanted: float) -> str:
    """Say what closed form power is possible with the stimuli that were tried."""
    ceiling = np.nanmax([(row.ceiling, row.power) for row in rows])
    if ceiling < wanted:
        return f"even with infinitely many participants their stimuli allow at most {ceiling:.0%}"
    return "in closed form, more participants or recordings than were tried reach it"


def _note_refuted(rows: list[_Row], table: DataFrame) -> list[str]:
    """Name the designs whose simulation contradicts the closed form."""
    return [
        f"Simulation contradicts the closed form of {find.describe_design(row.design)}: a power of "
        f"{row.power:.0%} in closed form, {_describe_simulated(found)}."
        for row, (_, found) in zip(rows, table.iterrows(), strict=True)
        if row.power >= row.design.wanted and found["refuted"]
    ]


def _describe_simulated(found: Series) -> str:
    if math.isnan(found["simulated"]):
        return "no test in any simulated study"
    low, high = 100 * found["simulated_low"], 100 * found["simulated_high"]
    return f"{found['simulated']:.0%} in the simulated studies that gave a test ({low:.0f} to {high:.0f} %)"


def _list_notes(runs: Mapping[tuple[int, ...], Power], given: PowerDesign) -> list[str]:
    """List the notes of all simulations, each once."""
    notes = dict.fromkeys(note for power in runs.values() for note in power.notes)
    adjusted = f"Power is at {given.level:.3g}, the first step of Holm's method over {len(given.hypotheses)} tests."
    return [*notes, adjusted] if len(given.hypotheses) > 1 else [*notes]
