"""How large must a study be? The closed form searches, simulated studies fitted by the primary model check.

Every study has its own seed, of the seed given, the design and its place: any number of workers gives the same numbers.
A study of 16 people and 72 stimuli takes half a second.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import count, product
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from feel321 import jobs
from feel321.analysis.mixed.optimum import hold_threads
from feel321.analysis.power.design import LEAST, LEVEL, SIZES, ClosedForm, PowerDesign, Stimuli
from feel321.analysis.primary.model import adjust_holm, fit_slopes
from feel321.analysis.primary.plan import ITEM, RATING, REDUCER, SCENE, SOURCE, WHO, make_cells
from feel321.analysis.table.schema import HIGHEST, LOWEST
from feel321.analysis.words import ABSENT, format_count
from feel321.types import Samples

# Sizes that are tried, as multiples of the given ones.
FACTORS: Mapping[str, tuple[float, ...]] = {
    "participants": (0.5, 0.75, 1, 1.5, 2, 3), "recordings": (0.5, 1, 1.5, 2, 3), "reducers": (0.5, 1, 1.5),
}  # fmt: skip
REPEATS = (1, 2, 3, 4)
CHUNK = 50  # Simulated studies of one job
TRIED = 8  # Designs that are simulated in search of one that its simulation does not refute
STEP = 0.8  # Share of a refuted design's detectable slope that the next one must detect
LEAST_TESTED = 0.9  # Share of simulated studies that must give a test, to confirm a design
SURE, HOPELESS = 0.99, 0.01
# Verdicts: a design is enough; or none is, and why (ceiling: no number of participants is)
ENOUGH, NOTHING, UNTESTABLE, CEILING, REFUTED, SMALL = (
    "enough", "nothing planted", "not estimable", "ceiling", "refuted", "too small",
)  # fmt: skip
Simulate = Callable[[PowerDesign], Samples]  # Gives p of every test, (studies, n_hypotheses)


@dataclass(frozen=True, slots=True, eq=False)
class Power:
    """The power of one design: a row per hypothesis.

    ``attribute metric slope`` (planted, per unit of the metric); what `ClosedForm.describe` gives, with the power of
    Holm's first step; ``recordings_needed``; and by simulation the columns of `tabulate_shares`.
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
    forms = {metric: ClosedForm(design, place) for place, metric in enumerate(design.metrics)}
    shared = SOURCE in design.items and not design.items.drop_duplicates(SCENE)[SOURCE].is_unique
    said = {
        f"Standard deviations: {design.truth.source}.": True,
        f"The closed form is at a level of {design.level:.3g}, the first step of Holm's method over "
        f"{len(design.hypotheses)} tests.": len(design.hypotheses) > 1,
        "Attributes are taken to be independent of each other, although the same people rate them.":
            len(design.attributes) > 1,
        "Recordings and reducers are drawn from those of the stimulus set anew for every study; where there are more "
        "than the set has, some are used more than once, with the same metrics.": not design.is_own,
        "Several recordings come from one source; what else they share is not simulated, so actual power is lower.":
            shared,
    }  # fmt: skip
    rows, notes = [], [note for note, holds in said.items() if holds]
    for attribute, metric in design.hypotheses:
        form, slope = forms[metric], design.truth.find_slope(attribute, metric)
        rows.append({
            "attribute": attribute, "metric": metric, "slope": slope, **form.describe(slope),
            "recordings_needed": form.find_least("recordings", slope),
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
    width``, by simulation where it was simulated ``simulated`` with its ends, ``enough`` (in closed form, at least the
    wanted power), ``refuted`` and ``recommended``. powers: the given design, and those that were simulated.
    recommended: the smallest that is enough. verdict: one of `ENOUGH` and so on. lack: why the given design cannot test
    the hypothesis.
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
    slopes = [design.truth.find_slope(*hypothesis) for hypothesis in design.hypotheses]
    # Hypotheses are attribute by attribute, each with every metric.
    forms = [ClosedForm(design, place % len(design.metrics)) for place in range(len(slopes))]
    own = [form.find_power(slope) for form, slope in zip(forms, slopes, strict=True)]
    aim = min(aims, key=lambda one: (math.isnan(own[one]), own[one]))
    slope = slopes[aim]
    tried = list(_list_forms(forms[aim], sizes, slope))
    table = pd.DataFrame([
        {**form.design.sizes, "trials": form.design.trials, "kind": kind, **form.describe(slope)}
        for kind, form in tried
    ]).drop(columns=["se", "df"])  # fmt: skip
    table["enough"] = table["power"] >= design.wanted
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
        candidate = tried[place][1].design
        known = (one for one in powers if one.design.sizes == candidate.sizes)
        power = next(known, None) or find_power(candidate, simulate)
        powers += [] if power in powers else [power]
        if not power.is_refuted(aim):
            chosen = place
            break
        left = [one for one in left if detectable[one] < detectable[place]]
        most = detectable[place] * STEP
    columns = ["simulated", "simulated_low", "simulated_high"]
    runs = pd.DataFrame([
        one.design.sizes | {"refuted": one.is_refuted(aim)} | one.table[columns].loc[aim].to_dict()
        for one in powers
    ])  # fmt: skip
    table = table.merge(runs, how="left", on=list(SIZES))
    table["refuted"] = table["refuted"].eq(True)  # noqa: FBT003 - what was not simulated is not refuted
    table["recommended"] = table.index == (-1 if chosen is None else chosen)
    refuted = table[table["enough"] & table["refuted"]]
    verdicts = {
        ENOUGH: chosen is not None,
        NOTHING: not slope,
        UNTESTABLE: table["power"].isna().all(),
        REFUTED: len(refuted) > 0,
        SMALL: table["ceiling"].max() >= design.wanted,
        CEILING: True,
    }
    notes = [note for power in powers for note in power.notes]
    notes += [
        f"Simulation contradicts the closed form of {row['participants']} participants, "
        f"{describe_units(row['recordings'], row['reducers'])}: {format_power(row['power'])} in closed form, "
        f"{format_power(row['simulated']).replace('not estimable', 'no test')} in simulated studies."
        for row in refuted.to_dict("records")
    ]
    return PowerPlan(
        table=table, powers=tuple(powers), hypothesis=design.hypotheses[aim],
        recommended=None if chosen is None else tried[chosen][1].design,
        verdict=next(verdict for verdict, holds in verdicts.items() if holds),
        lack=forms[aim].find_lack(), notes=tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def _list_forms(
    given: ClosedForm, wanted: Mapping[str, Sequence[int]], slope: float
) -> Iterator[tuple[str, ClosedForm]]:
    """List the given design, others by one factor at a time, and participants x recordings; each once.

    The first with its recordings, reducers and repeats comes with the fewest people that are enough, too.
    """
    sizes: dict[str, Sequence[int]] = {"repeats": REPEATS}
    for name, factors in FACTORS.items():
        own = given.design.sizes[name]
        least = min(LEAST[name], own)
        sizes[name] = sorted({max(least, round(own * factor)) for factor in factors})
    sizes |= {name: sorted(set(asked)) for name, asked in wanted.items() if asked}
    changes = [("given", dict[str, int]())]
    changes += [("one factor", {name: size}) for name in SIZES for size in sizes[name]]
    pairs = product(sizes["participants"], sizes["recordings"])
    changes += [("grid", {"participants": one, "recordings": two}) for one, two in pairs]
    seen, known = list[dict[str, int]](), set[tuple[int, ...]]()
    for kind, change in changes:
        design = replace(given.design, **change)  # type: ignore[arg-type]  # sizes are numbers
        if design.sizes in seen:
            continue
        seen.append(design.sizes)
        form, units = ClosedForm(design, given.place), tuple(design.sizes.values())[1:]
        yield kind, form
        number = math.nan if units in known else form.find_least("participants", slope)
        known.add(units)
        if math.isfinite(number) and number != design.participants:
            yield "smallest", replace(form, design=replace(design, participants=int(number)))


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


def draw_ratings(design: PowerDesign, stimuli: Stimuli, rng: np.random.Generator) -> Samples:
    """Draw ratings with the planted slopes and spreads, (n_attributes, people, n_items, repeats)."""
    truth, (people_sds, scene_sds) = design.truth, design.slope_sds
    people, scene, kind, n = design.participants, stimuli.scene, stimuli.kind, len(stimuli.scene)
    scenes, kinds, metrics = scene.max() + 1, kind.max() + 1, stimuli.metrics.shape[1]

    def draw(spread: float, *shape: int) -> Samples:
        return rng.normal(0, spread, (len(design.attributes), *shape))

    everybody = truth.mean + draw(truth.item_sd, 1, n)
    everybody += draw(truth.recording_sd, 1, scenes)[..., scene]
    everybody += draw(truth.reducer_sd, 1, kinds)[..., kind]
    own = draw(truth.person_sd, people, 1) + draw(truth.person_item_sd, people, n)
    own += draw(truth.person_recording_sd, people, scenes)[..., scene]
    own += draw(truth.person_reducer_sd, people, kinds)[..., kind]
    own += (draw(1.0, people, metrics) * people_sds) @ stimuli.within.T
    theirs = (draw(1.0, scenes, metrics) * scene_sds)[:, scene]
    everybody += (theirs * stimuli.within).sum(axis=-1)[:, None]
    points = (everybody + own)[..., None] + draw(truth.rating_sd, people, n, design.repeats)
    centred = stimuli.metrics - design.stimuli.metrics.mean(axis=0)
    found = [truth.find_slope(*hypothesis) for hypothesis in design.hypotheses]
    slopes = np.array(found, np.float64).reshape(len(design.attributes), -1)
    points += (slopes @ centred.T)[:, None, :, None]
    if truth.step:
        points = np.round(points / truth.step) * truth.step
    return points.clip(LOWEST, HIGHEST) if truth.bounded else points


def simulate_studies(
    design: PowerDesign,
    *,
    studies: int,
    seed: int = 0,
    workers: int | jobs.Workers = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Samples:
    """Simulate studies: p of every test, (studies, n_hypotheses)."""
    listed = [design.items.to_csv(index=False), design.metrics, design.attributes, design.sizes]
    key = int(sha256(repr(listed).encode()).hexdigest()[:16], 16)
    chunks = [range(start, min(start + CHUNK, studies)) for start in range(0, studies, CHUNK)]
    todo: list[jobs.Job] = [(_fit_studies, (design, [seed, key], places), {}) for places in chunks]
    step = count(1)
    progress(0, len(todo))
    found = jobs.gather_results(todo, workers=workers, done=lambda: progress(next(step), len(todo)))
    return np.concatenate([np.empty((0, len(design.hypotheses))), *found])


@hold_threads(0)
def _fit_studies(design: PowerDesign, seed: list[int], places: range) -> Samples:
    """Draw studies and fit every attribute: p of every test, NaN without one; (studies, n_hypotheses)."""
    metrics, found = design.metrics, list[float]()
    for place in places:
        rng = np.random.default_rng([*seed, place])
        stimuli = design.draw(rng)
        drawn = draw_ratings(design, stimuli, rng)
        who, item, _ = (axis.ravel() for axis in np.indices(drawn.shape[1:]))
        table = pd.DataFrame({
            WHO: who, SCENE: stimuli.scene[item], REDUCER: stimuli.kind[item], ITEM: item,
            SOURCE: stimuli.source[item], **dict(zip(metrics, stimuli.metrics[item].T, strict=True)),
        })  # fmt: skip
        for ratings in drawn:
            try:
                cells = make_cells(table.assign(**{RATING: ratings.ravel()}), metrics)
                found += fit_slopes(cells).table["p"].reindex(metrics).tolist()
            except (ValueError, np.linalg.LinAlgError):  # all ratings alike, or too few units
                found += [math.nan] * len(metrics)
    return np.array(found, np.float64).reshape(len(places), len(design.hypotheses))


def tabulate_shares(p: Samples) -> pd.DataFrame:
    """Tabulate the share of studies that find each slope by Holm's method; p: (studies, n_hypotheses).

    ``simulated`` with its 95 % Wilson interval ``simulated_low simulated_high``, NaN without studies; ``tests``: the
    studies that gave a test.
    """
    adjusted = np.array([adjust_holm(row) for row in p.tolist()]).reshape(p.shape)
    rows = []
    for column in adjusted.T:
        known = int(np.isfinite(column).sum())
        share = low = high = math.nan
        if known:
            found = binomtest(int((column < LEVEL).sum()), known)
            share, (low, high) = float(found.statistic), found.proportion_ci(method="wilson")
        rows.append((share, float(low), float(high), known))
    return pd.DataFrame(rows, columns=["simulated", "simulated_low", "simulated_high", "tests"])
