"""Whole studies simulated, in chunks: any number of workers, the same numbers; what is done is kept.

Every study has its own seed, of the seed given, the design and its place. A chunk's result is text that holds all its
numbers exactly; in a folder it has the name of what it was computed from (design, truth, seed, places and code), so
that another call takes it from there, whatever became of the first.
"""

from __future__ import annotations

import json
from collections import Counter
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321 import jobs
from feel321.analysis.mixed import optimum
from feel321.analysis.power import draw, engine
from feel321.analysis.power.design import HIGH, LOW
from feel321.analysis.screening.screen import screen_raters
from feel321.files import make_folder, write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.power.design import PowerDesign, Truth
    from feel321.types import Samples

CHUNK = 50
"""Studies of one job."""

ARMS = ("planted", "null")
"""Every study is simulated with the planted slopes and without any."""

PARTS = {"kept", "people", "tests", "outcomes"}
"""What is known of every simulated study."""

FEWEST_PEOPLE = 3
"""Fewer than this left by screening carry no model."""


class Studies(NamedTuple):
    """Results of simulated studies.

    tests: (studies, arms, attributes, n_tests, 3), estimate, standard error and degrees of freedom of every slope and
    every difference; kept: (studies, attributes, n_tests), their true values; people: (studies, arms), who is left by
    screening; counts: arm, outcome and reason -> number of models; damaged: files of kept results that could not be
    read, and were computed anew.
    """

    tests: Samples
    kept: Samples
    people: NDArray[np.intp]
    counts: Counter[tuple[str, str, str]]
    damaged: tuple[str, ...] = ()


def simulate_chunk(design: PowerDesign, truth: Truth, seed: int, *, start: int, stop: int) -> str:
    """Simulate some studies, and write their results as text."""
    scenario, fits = draw.Scenario(design, truth), engine.Engine(design.metrics)
    key = find_key(design)
    with optimum.hold_threads(0):
        return json.dumps([
            _simulate_study(scenario, fits, np.random.default_rng([seed, key, place]))
            for place in range(start, stop)
        ])


def find_key(design: PowerDesign) -> int:
    """Compute the number of a design, which with the seed and a study's place is that study's seed."""
    return int(sha256(_write_design(design).encode()).hexdigest()[:16], 16)


def _simulate_study(
    scenario: draw.Scenario, fits: engine.Engine, rng: np.random.Generator
) -> dict[str, Any]:
    stimuli = scenario.draw(rng)
    spreads = stimuli.within.std(axis=0, ddof=1)
    kept = draw.keep_slopes(scenario, stimuli)
    pairs = engine.list_pairs(kept.shape[1])
    gaps = [kept[:, one] * spreads[one] - kept[:, two] * spreads[two] for one, two in pairs]
    arms = [
        _screen(scenario.design, stimuli, ratings)
        for ratings in draw.draw_ratings(scenario, stimuli, rng)
    ]
    found = [[_fit(fits, stimuli, one) for one in ratings] for ratings in arms]
    return {
        "kept": np.column_stack([kept, *gaps]).tolist(),
        "people": [ratings.shape[1] for ratings in arms],
        "tests": [[fit.tests.tolist() for fit in arm] for arm in found],
        "outcomes": [[(fit.outcome, fit.reason) for fit in arm] for arm in found],
    }


def _fit(fits: engine.Engine, stimuli: draw.Stimuli, ratings: Samples) -> engine.Fit:
    if len(ratings) < FEWEST_PEOPLE:
        return fits.give_up("screening leaves fewer than 3 participants")
    return fits.fit(stimuli, ratings.mean(axis=-1))


def _screen(design: PowerDesign, stimuli: draw.Stimuli, ratings: Samples) -> Samples:
    """Leave out whom the rules flag, which see the scale's ends; ratings: (n_attributes, people, n_items, repeats)."""
    if not design.screening:
        return ratings
    import pandas as pd

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
    files = {} if keep is None else _name_files(spans, _describe(design, truth, seed), keep)
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
    found = _gather([one for span in spans for one in chunks[span]])
    return found._replace(damaged=damaged)


def _read_chunk(file: Path, count: int) -> list[dict[str, Any]] | None:
    """Read the studies of a kept chunk; None where the file does not hold all of them."""
    try:
        found = json.loads(file.read_text("utf-8"))
    except ValueError:
        return None
    whole = isinstance(found, list) and len(found) == count
    return (
        found if whole and all(isinstance(one, dict) and {*one} >= PARTS for one in found) else None
    )


def _name_files(
    spans: list[tuple[int, int]], digest: str, folder: Path
) -> dict[tuple[int, int], Path]:
    make_folder(folder)
    return {span: folder / f"studies-{digest}-{span[0]:06d}-{span[1]:06d}.json" for span in spans}


def _describe(design: PowerDesign, truth: Truth, seed: int) -> str:
    """Digest everything that results follow from."""
    text = "\n".join([_write_design(design), _write_truth(truth), str(seed), _read_code()])
    return sha256(text.encode()).hexdigest()[:16]


def _write_design(design: PowerDesign) -> str:
    sizes = (design.metrics, design.attributes, design.screening, design.participants)
    more = (design.recordings, design.reducers, design.repeats)
    return f"{design.items.to_csv(index=False)}\n{sizes}\n{more}"


def _write_truth(truth: Truth) -> str:
    values = {name: getattr(truth, name) for name in truth.__dataclass_fields__ if name != "source"}
    by_metric = ("slopes", "slope_sds", "recording_slope_sds")
    return json.dumps(
        values | {name: dict(getattr(truth, name)) for name in by_metric}, sort_keys=True
    )


def _read_code() -> str:
    """Digest the code that simulates and fits; another version's results are not taken for this one's."""
    folder = Path(__file__).parents[1]
    folders = [folder / name for name in ("mixed", "power", "primary", "screening")]
    files = [path for each in folders for path in sorted(each.glob("*.py"))]
    return sha256(b"\n".join(path.read_bytes() for path in files)).hexdigest()


def _gather(studies: list[dict[str, Any]]) -> Studies:
    counts = Counter(
        (arm, outcome, reason)
        for one in studies
        for arm, outcomes in zip(ARMS, one["outcomes"], strict=True)
        for outcome, reason in outcomes
    )
    tests, kept, people = (
        np.array([one[name] for one in studies]) for name in ("tests", "kept", "people")
    )
    return Studies(tests.astype(np.float64), kept.astype(np.float64), people, counts)


def tabulate_counts(counts: Mapping[tuple[str, str, str], int]) -> DataFrame:
    """List what became of the models."""
    import pandas as pd

    rows = [(*key, number) for key, number in sorted(counts.items(), key=lambda one: one[0])]
    return pd.DataFrame(rows, columns=["arm", "outcome", "reason", "models"])
