"""The power of one design: in closed form, and of simulated studies fitted by the primary model.

Closed form: the standard error of generalised least squares with the planted spreads, SE² = σ_S²/P + V_C + 1
/ (SS_w/v + SS_r/(v + m v_r)) with σ_S between the slopes of P people, v = σ_I² + (σ_PI² + σ_e²/K)/P of a stimulus
and v_r = σ_R² + σ_PR²/P of a reducer in m recordings; V_C is what slopes that differ between recordings add to an
estimate that does not know it (the whole then is 4 to 9 % more than with the best weights, in designs of 4 to 20
recordings); degrees of freedom by Welch and Satterthwaite, the noncentral t distribution at the level of Holm's
first step. It knows neither the ends of the scale nor lapses, careless people and the penalty of few reducers.

Simulation, in chunks: any number of workers, the same numbers.

Every study has its own seed, of the seed given, the design and its place. A chunk's result is text that holds all its
numbers exactly; in a folder it has the name of what it was computed from (design, truth, seed, places and code), so
that an interrupted call is continued from there.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from feel321 import jobs
from feel321.analysis.mixed.design import MixedDesign, build_design
from feel321.analysis.mixed.model import solve_design
from feel321.analysis.mixed.optimum import hold_threads
from feel321.analysis.power import draw
from feel321.analysis.power.closed import ClosedForm
from feel321.analysis.power.truth import HIGH, LEVEL, LOW
from feel321.analysis.primary.model import FEWEST, FEWEST_DF, adjust_holm
from feel321.analysis.primary.plan import ITEM, SCENE, SOURCE, WHO, Terms, make_cells, plan_terms
from feel321.analysis.screening.screen import screen_raters
from feel321.doors import as_path, follow
from feel321.files import make_folder, write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.power.truth import PowerDesign, Truth
    from feel321.types import PathLike, Progress, Samples

NONE = float("nan")

CHUNK = 50
"""Studies of one job."""

PARTS = {"people", "tests", "outcomes"}
"""What is known of every simulated study."""

FITTED, SINGULAR, NOT_ESTIMABLE, FAILED = "fitted", "singular", "not estimable", "failed"


class Studies(NamedTuple):
    """Results of simulated studies.

    tests: (studies, attributes, metrics, 3), estimate, standard error and degrees of freedom of every slope; people:
    (studies,), who is left by screening; outcomes: what became of every model, and why; damaged: files of kept results
    that could not be read, and were computed anew.
    """

    tests: Samples
    people: NDArray[np.intp]
    outcomes: list[tuple[str, str]]
    damaged: tuple[str, ...] = ()


class Structure(NamedTuple):
    """The primary model of some stimuli and a number of people; rows: (people, n_items), where each stands."""

    design: MixedDesign
    terms: Terms
    rows: NDArray[np.intp]


@dataclass(slots=True)
class Engine:
    """Fits one primary model after the other, and builds it anew only where stimuli or people are others."""

    metrics: tuple[str, ...]
    stimuli: draw.Stimuli | None = None
    people: int = 0
    structure: Structure | str = ""

    def fit(self, stimuli: draw.Stimuli, ratings: Samples) -> dict[str, Any]:
        """Fit the ratings of one attribute, averaged over repeats; (people, n_items)."""
        if self.stimuli is not stimuli or self.people != len(ratings):
            self.stimuli, self.people = stimuli, len(ratings)
            self.structure = self._build(stimuli, len(ratings))
        if isinstance(self.structure, str):
            return self._give_up(self.structure)
        if np.ptp(ratings) == 0:
            return self._give_up("all ratings are the same")
        design, terms, rows = self.structure
        response = np.empty(rows.size)
        response[rows] = ratings
        try:
            solved = solve_design(
                replace(design, response=response), penalty=terms.penalty, most_df=terms.most_df
            )
        except (ValueError, np.linalg.LinAlgError) as error:
            return self._give_up(str(error))
        tests = np.full((len(self.metrics), 3), np.nan)
        for place, name in enumerate(self.metrics):
            column = next((one for one in design.names if one.strip("`") == f"{name}_w"), None)
            if column is not None:
                found = solved.estimate({column: 1.0})
                tests[place] = found.estimate, found.se, found.df
        units = len(ratings), len(np.unique(stimuli.source)), len(np.unique(stimuli.kind))
        tests[~(tests[:, 2] >= FEWEST_DF) | (min(units) < FEWEST), 1:] = np.nan
        outcome = SINGULAR if (solved.best.theta[solved.profile.diagonal] == 0).any() else FITTED
        reason = ""
        if np.isnan(tests[:, 1]).any():
            outcome, reason = NOT_ESTIMABLE, " ".join(terms.reductions) or "too few units"
        return {"tests": tests.tolist(), "outcome": (outcome, reason)}

    def _give_up(self, reason: str) -> dict[str, Any]:
        tests = np.full((len(self.metrics), 3), np.nan).tolist()
        return {"tests": tests, "outcome": (FAILED, reason)}

    def _build(self, stimuli: draw.Stimuli, people: int) -> Structure | str:
        """Build the model as `fit_primary` does; the reason where there is none."""
        if people < FEWEST:
            return "screening leaves fewer than 3 participants"
        blank = np.random.default_rng(0).normal(50, 10, (people, len(stimuli.scene), 1))
        try:
            cells = make_cells(draw.tabulate_ratings(stimuli, blank, self.metrics), self.metrics)
            terms = plan_terms(cells, correlated=False, reducers=True)
            design = build_design(terms.formula, cells.table)
        except ValueError as error:
            return str(error)
        rows = np.empty((people, len(stimuli.scene)), np.intp)
        rows[cells.table[WHO].to_numpy(), cells.table[ITEM].to_numpy()] = np.arange(rows.size)
        return Structure(design, terms, rows)


def simulate_chunk(design: PowerDesign, truth: Truth, seed: int, *, start: int, stop: int) -> str:
    """Simulate some studies, and write their results as text."""
    scenario, engine, key = draw.Scenario(design, truth), Engine(design.metrics), find_key(design)
    with hold_threads(0):
        return json.dumps([
            simulate_study(scenario, engine, np.random.default_rng([seed, key, place]))
            for place in range(start, stop)
        ])


def find_key(design: PowerDesign) -> int:
    """Compute the number of a design, which with the seed and a study's place is that study's seed."""
    return int(sha256(_write_design(design).encode()).hexdigest()[:16], 16)


def simulate_study(
    scenario: draw.Scenario, engine: Engine, rng: np.random.Generator
) -> dict[str, Any]:
    """Draw a study, leave out whom the rules flag, and fit every attribute."""
    stimuli = scenario.draw(rng)
    ratings = _screen(scenario.design, stimuli, draw.draw_ratings(scenario, stimuli, rng))
    fits = [engine.fit(stimuli, one.mean(axis=-1)) for one in ratings]
    return {
        "people": ratings.shape[1],
        "tests": [fit["tests"] for fit in fits],
        "outcomes": [fit["outcome"] for fit in fits],
    }


def _screen(design: PowerDesign, stimuli: draw.Stimuli, ratings: Samples) -> Samples:
    """Leave out whom the rules flag, which see the scale's ends; ratings: (n_attributes, people, n_items, repeats)."""
    if not design.screening:
        return ratings
    tables = [
        draw.tabulate_ratings(stimuli, part, design.metrics).assign(scale=name)
        for name, part in zip(design.attributes, ratings.clip(LOW, HIGH), strict=True)
    ]
    found = screen_raters(pd.concat(tables, ignore_index=True), design.screening)
    flagged = {who for hits in found.hits.values() for who in hits}
    return ratings[:, [who not in flagged for who in range(ratings.shape[1])]]


def simulate_studies(  # noqa: PLR0913 - what, how many, who does it, where it is kept, who watches
    design: PowerDesign,
    truth: Truth,
    *,
    studies: int,
    seed: int = 0,
    workers: jobs.Workers = jobs.ALONE,
    keep: Path | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Studies:
    """Simulate studies, or take those that an earlier call kept."""
    spans = [(start, min(start + CHUNK, studies)) for start in range(0, studies, CHUNK)]
    files: dict[tuple[int, int], Path] = {}
    if keep is not None:
        make_folder(keep)
        digest = _describe(design, truth, seed)
        files = {
            span: keep / "studies-{}-{:06d}-{:06d}.json".format(digest, *span) for span in spans
        }
    there = {span: file for span, file in files.items() if file.is_file()}
    done = {span: _read_chunk(file, span[1] - span[0]) for span, file in there.items()}
    damaged = tuple(there[span].name for span, chunk in done.items() if chunk is None)
    chunks = {span: chunk for span, chunk in done.items() if chunk is not None}
    left = [span for span in spans if span not in chunks]
    progress(len(chunks), len(spans))
    todo: list[jobs.Job] = [
        (simulate_chunk, (design, truth, seed), {"start": start, "stop": stop})
        for start, stop in left
    ]
    for place, text in jobs.run_jobs(todo, workers=workers):
        chunks[left[place]] = json.loads(text)
        if files:
            write_text(files[left[place]], text)
        progress(len(chunks), len(spans))
    found = [one for span in spans for one in chunks[span]]
    return Studies(
        np.array([one["tests"] for one in found], np.float64),
        np.array([one["people"] for one in found]),
        [(outcome, reason) for one in found for outcome, reason in one["outcomes"]],
        damaged,
    )


def _read_chunk(file: Path, count: int) -> list[dict[str, Any]] | None:
    """Read the studies of a kept chunk; None where the file does not hold all of them."""
    try:
        found = json.loads(file.read_text("utf-8"))
    except ValueError:
        return None
    if not isinstance(found, list) or len(found) != count:
        return None
    return found if all(isinstance(one, dict) and {*one} >= PARTS for one in found) else None


def _describe(design: PowerDesign, truth: Truth, seed: int) -> str:
    """Digest everything that results follow from, the code that simulates and fits among it."""
    values = {name: getattr(truth, name) for name in truth.__dataclass_fields__ if name != "source"}
    written = json.dumps(values, sort_keys=True, default=dict)
    folder = Path(__file__).parents[1]
    folders = [folder / name for name in ("mixed", "power", "primary", "screening")]
    code = b"\n".join(path.read_bytes() for each in folders for path in sorted(each.glob("*.py")))
    text = "\n".join([_write_design(design), written, str(seed), sha256(code).hexdigest()])
    return sha256(text.encode()).hexdigest()[:16]


def _write_design(design: PowerDesign) -> str:
    sizes = (design.metrics, design.attributes, design.screening, design.participants)
    more = (design.recordings, design.reducers, design.repeats)
    return f"{design.items.to_csv(index=False)}\n{sizes}\n{more}"


@dataclass(frozen=True, slots=True)
class Power:
    """The power of one design; NaN where there is none, or nothing was simulated.

    table: a row per hypothesis, ``attribute metric slope`` (planted, per unit of the metric); in closed form ``se df
    width`` (of the 95 % interval), ``power`` (Holm's first step), ``ceiling`` (with participants without end),
    ``detectable`` (smallest slope found with the wanted power), ``detectable_points`` (the same per standard deviation
    of the metric within recordings), ``participants_needed recordings_needed``; simulated, ``simulated`` (power,
    Holm's method), ``simulated_low simulated_high`` (95 % Wilson interval) and ``tests`` (studies that gave a test).
    counts: ``outcome reason models``; singular fits are fitted ones with a spread of zero and count, failed ones and
    those without a test are in no share.
    """

    design: PowerDesign
    truth: Truth
    table: DataFrame
    studies: int
    counts: DataFrame
    seed: int
    notes: tuple[str, ...] = ()


def find_power(  # noqa: PLR0913 - a design and a truth; how many studies, who does them, where they are kept
    design: PowerDesign,
    truth: Truth,
    *,
    studies: int = 1000,
    seed: int = 0,
    workers: int | jobs.Workers = jobs.ALONE,
    keep: PathLike | None = None,
    progress: Progress = False,
) -> Power:
    """Find the power of a design; keep: a folder from which an interrupted call is continued."""
    if studies < 0:
        raise ValueError(f"studies must be 0 or more, got {studies}; give 1000")
    forms = _list_forms(design, truth)
    table = pd.DataFrame([
        {"attribute": attribute, "metric": metric, **_list_slope(forms[metric], row)}
        for row, (attribute, metric) in enumerate(design.hypotheses)
    ])
    found = None
    if studies:
        place = None if keep is None else as_path(keep, "keep")
        with follow(progress, "power") as move:
            found = simulate_studies(
                design, truth, studies=studies, seed=seed, workers=jobs.as_workers(workers), keep=place, progress=move
            )  # fmt: skip
    counts = Counter(found.outcomes if found else [])
    notes = [*_list_notes(design, truth), *_note_untested(forms, design, truth)]
    notes += _note_simulation(found, design) if found else ()
    return Power(
        design=design, truth=truth, table=table.join(_tabulate_shares(found, design)), studies=studies,
        counts=pd.DataFrame(
            [(*key, number) for key, number in sorted(counts.items())], columns=["outcome", "reason", "models"]
        ),
        seed=seed, notes=tuple(notes),
    )  # fmt: skip


def _list_forms(design: PowerDesign, truth: Truth) -> dict[str, ClosedForm]:
    scenario = draw.Scenario(design, truth)
    return {metric: ClosedForm(scenario, place) for place, metric in enumerate(design.metrics)}


def _list_slope(form: ClosedForm, hypothesis: int) -> dict[str, float]:
    """List what the closed form gives of one slope."""
    scenario = form.scenario
    slope = float(scenario.planted.slopes.ravel()[hypothesis])
    spread, (se, df) = scenario.stimuli.within[:, form.place].std(ddof=1), form.find_errors()
    detectable = form.find_detectable()
    return {
        "slope": slope, "se": se, "df": df, "width": form.find_width(), "power": form.find_power(slope),
        "ceiling": form.find_ceiling(slope), "detectable": detectable, "detectable_points": detectable * spread,
        "participants_needed": form.find_participants(slope), "recordings_needed": form.find_recordings(slope),
    }  # fmt: skip


def _tabulate_shares(found: Studies | None, design: PowerDesign) -> DataFrame:
    """Tabulate the share of studies that find each slope by Holm's method; NaN without any."""
    from scipy.stats import binomtest, t

    count = len(design.hypotheses)
    tests = found.tests.reshape(-1, count, 3) if found else np.empty((0, count, 3))
    estimate, se, df = np.moveaxis(tests, -1, 0)
    p = np.array([adjust_holm(row) for row in (2 * t.sf(np.abs(estimate / se), df)).tolist()])
    rows = []
    for column in p.reshape(-1, count).T:
        known = int(np.isfinite(column).sum())
        share = low = high = NONE
        if known:
            number = int((column < LEVEL).sum())
            share, (low, high) = (
                number / known,
                binomtest(number, known).proportion_ci(method="wilson"),
            )
        rows.append((share, float(low), float(high), known))
    return pd.DataFrame(rows, columns=["simulated", "simulated_low", "simulated_high", "tests"])


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


def _note_simulation(found: Studies, design: PowerDesign) -> Iterator[str]:
    """Say what became of simulated studies."""
    if design.screening:
        people = f"{found.people.mean():.1f} of {design.participants} participants"
        yield f"Screening ({', '.join(design.screening)}) leaves {people} on average."
    if found.damaged:
        yield f"Kept results that could not be read were computed anew: {', '.join(found.damaged)}."
    lost = [why for what, why in found.outcomes if what in {NOT_ESTIMABLE, FAILED}]
    if lost:
        of = f"Of {len(found.outcomes)} simulated models, {len(lost)} gave no test and are excluded"
        yield f"{of} ({'; '.join(dict.fromkeys(filter(None, lost)))})."


def _note_untested(
    forms: Mapping[str, ClosedForm], design: PowerDesign, truth: Truth
) -> Iterator[str]:
    """Name planted slopes that cannot be tested in the study, and why."""
    for attribute, metric in design.hypotheses:
        if truth.find_slope(attribute, metric) and (lack := forms[metric].find_lack()):
            yield f"The planted slope of {metric} on {attribute} cannot be tested: {lack}."
