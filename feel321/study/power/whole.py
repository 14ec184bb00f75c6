"""Whole studies on paper: plans, engine, observers, decoding and analysis are the real ones, only the disk is left out.

A journal that is kept in memory costs a sixth of one that is written, read and verified; a test holds both against each
other, row by row. What cannot change the ratings of a slider is left out too: thresholds, matched strength, questions.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from feel321 import __version__
from feel321.analysis.primary import model as primary
from feel321.analysis.report import parts
from feel321.analysis.screening import rules, screen
from feel321.analysis.table import reading
from feel321.files import write_text
from feel321.jobs import Job, run_jobs
from feel321.protocols.texts import make_scales
from feel321.records import to_json_value
from feel321.study import simulation
from feel321.study.observer import participant, simulated
from feel321.study.ratings import decode_judgements
from feel321.study.session import codes, engine, events, journal, plan
from feel321.study.settings import read

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from feel321.analysis.report.parts import RatingsPart
    from feel321.analysis.table.metrics import Step
    from feel321.analysis.table.reading import Further, Table
    from feel321.jobs import Workers
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.observer.participant import ObserverModel
    from feel321.study.session.journal import Record
    from feel321.study.session.plan import Plan
    from feel321.study.settings.schema import Settings

WHO, ITEM, RATING = "participant", "item", "rating"
FITTED = ("estimate", "se", "df", "p", "low", "high", "estimable")


class PaperJournal(journal.Journal):
    """A journal that is never written: of a session that is over when it has been counted."""

    __slots__ = ()

    def _keep(self, record: Record) -> None:
        self.records.append(record)


class ExpectedRater(participant.Rater):
    """Gives the mean rating that the study's simulated participants give: what is planted, without any noise."""

    __slots__ = ("model",)

    def __init__(self, model: ObserverModel) -> None:
        super().__init__(participant.NORMAL, 0.0, 1.0, 0.0, 0.0, 0.5)
        object.__setattr__(self, "model", model)

    def rate(self, percept: float, *, sure: float = 0.0, **_: Any) -> float:  # type: ignore[override]  # noqa: ANN401
        """Average over participants; who reverses the scale does so to the mean, too."""
        model = self.model
        careful = participant.expect_rating(model, [percept], sure=sure)[0]
        idle, reversed_ = model.straight_liners + model.random_clickers, model.scale_reversers
        top = sum(participant.RATING_RANGE)
        return (1 - idle - reversed_) * careful + reversed_ * (top - careful) + idle * top / 2


class Fit(NamedTuple):
    """The slopes of one whole study: a row per attribute and metric; participants left out; fits that failed."""

    slopes: pd.DataFrame
    screened: int
    failed: tuple[str, ...]


@dataclass(frozen=True)
class PaperStudy:
    """A study that can be run again and again without a disk.

    plans: those of all participants, the same in every run; further: metrics that the manifest lacks.
    """

    settings: Settings
    folder: Path
    stimuli: StimulusSet
    plans: tuple[Plan, ...]
    further: Further | None = None

    @classmethod
    def draw(
        cls,
        settings: Settings,
        folder: Path,
        stimuli: StimulusSet,
        *,
        participants: int,
        further: Further | None = None,
    ) -> PaperStudy:
        """Plan the sessions of so many participants."""
        design = read.make_design(settings, folder)
        design = replace(design, threshold=None, matching=None, questions=())
        plans = (
            plan.make_plan(design, stimuli, f"sim{number:03d}", number=number, simulated=True)
            for number in range(1, participants + 1)
        )
        return cls(settings, folder, stimuli, tuple(plans), further)

    @cached_property
    def _scales(self) -> Mapping[str, Any]:
        return make_scales(read.read_study_texts(self.settings, self.folder))

    @cached_property
    def _casting(self) -> simulation.Casting:
        return simulation.cast_observers(self.settings, self.stimuli, seed=0)

    def simulate(self, seed: int, *, expected: bool = False) -> pd.DataFrame:
        """Run the sessions of simulated participants of this seed; one row per judgement, as in `ratings.csv`.

        expected: everybody gives the mean rating instead.
        """
        casting = replace(self._casting, seed=seed)
        rows = [row for one in self.plans for row in self._run(one, casting, expected=expected)]
        return pd.DataFrame(rows)

    def _run(self, own: Plan, casting: simulation.Casting, *, expected: bool) -> list[dict[str, Any]]:
        observer = simulated.SimulatedObserver(
            casting.model, seed=casting.seed, number=simulation.find_person(own.participant),
            percepts=casting.percepts,
        )  # fmt: skip
        if expected:
            observer.rater = ExpectedRater(casting.model)
        kept = PaperJournal(self.folder / own.participant, journal.utc_now)
        identity = {"presenter": participant.identify_observer(casting.model, seed=casting.seed)}
        kept.write(
            events.SessionBegun(
                plan.JOURNAL_FORMAT, own.participant, own.sha256, own.stimuli_sha256, own.seed, identity, 1, {}, "", {}
            )
        )  # fmt: skip
        engine.run_session(own, observer, stimuli=self.stimuli, journal=kept, scales=self._scales)
        by_code = codes.list_by_code(self.stimuli, seed=own.seed)
        return decode_judgements(own, kept.records, by_code, levels={}, path=kept.path)

    def tabulate(self, rows: pd.DataFrame) -> Table:
        """Join ratings with the metrics that the analysis declares."""
        return reading.read_table(
            rows,
            self.stimuli.to_frame(),
            metrics=self.settings.analysis.metrics,
            sources=read.list_origins(self.settings),
            further=self.further,
        )

    def split(self, rows: pd.DataFrame) -> list[RatingsPart]:
        """Split ratings by attribute: scale and level."""
        return list(parts.split_parts(self.tabulate(rows)))

    def analyze(self, seed: int) -> Fit:
        """Run a study and analyse it: screening as declared, the primary model of every attribute, Holm's adjustment."""
        table = self.tabulate(self.simulate(seed))
        out = self._screen(table)
        table = replace(table, rows=table.rows[~table.rows[WHO].isin(out)])
        found, failed = [], []
        for part in parts.split_parts(table):
            try:
                fit = primary.fit_primary(part.rows, table.metrics, explain=False)
            except ValueError as error:
                failed.append(f"{part.lead}: {error}")
                continue
            own = fit.slopes.reindex(list(table.metrics))[list(FITTED)].reset_index()
            found.append(own.assign(part=part.lead, singular=fit.fit.singular))
        if not found:
            return Fit(pd.DataFrame(), len(out), tuple(failed))
        slopes = pd.concat(found, ignore_index=True)
        return Fit(slopes.assign(p_holm=primary.adjust_holm(slopes["p"])), len(out), tuple(failed))

    def _screen(self, table: Table) -> set[object]:
        """Find the participants whom the declared rules flag."""
        declared = rules.find_rules(self.settings.analysis.screening, self.folder)
        if not declared:
            return set()
        found = screen.screen_raters(table, [], own=declared)
        return {who for hit in found.hits.values() for who in hit}


def regress_expected(rated: Sequence[RatingsPart], steps: Mapping[str, Step]) -> pd.DataFrame:
    """Find the slopes that mean ratings have, in points per step of each metric: a row per part, a column per metric.

    One regression, within recordings, of the mean rating of every stimulus. Of the ratings that everybody is expected
    to give they are what simulated participants plant, after clipping at the ends of the scale.
    """
    names, rows = list(steps), {}
    for part in rated:
        means = part.rows.groupby(ITEM)[[RATING, *names]].mean()
        scene = part.rows.groupby(ITEM)["recording"].first()
        own = (means - means.groupby(scene).transform("mean")).to_numpy()
        slopes = np.linalg.lstsq(own[:, 1:], own[:, 0], rcond=None)[0]
        rows[part.lead] = slopes * [steps[name].size for name in names]
    return pd.DataFrame.from_dict(rows, orient="index", columns=names)


# Many of them: the check of the fast simulation by the real thing.

CHUNK = 5
"""Studies that one job runs."""


@dataclass(frozen=True, slots=True)
class Wholes:
    """Many whole studies: slopes, a row per study, part and metric; screened participants; reasons of failed fits."""

    slopes: pd.DataFrame
    studies: int
    screened: int
    failed: tuple[str, ...]


def run_wholes(
    paper: PaperStudy,
    studies: int,
    *,
    seed: int,
    workers: Workers,
    keep: Path,
    progress: Callable[[int, int], None] | None = None,
) -> Wholes:
    """Run whole studies, each with a seed of its own; those that an interrupted call had run are kept."""
    place = keep / f"whole-{_digest(paper, seed)}"
    place.mkdir(parents=True, exist_ok=True)
    chunks = [range(first, min(first + CHUNK, studies)) for first in range(0, studies, CHUNK)]
    files = [place / f"{chunk.start}-{chunk.stop}.json" for chunk in chunks]
    left = [(chunk, file) for chunk, file in zip(chunks, files, strict=True) if not file.is_file()]
    todo: list[Job] = [(_run_chunk, (paper, seed, chunk), {}) for chunk, _ in left]
    done = len(chunks) - len(left)
    for turn, found in run_jobs(todo, workers=workers):
        write_text(left[turn][1], json.dumps(found))
        done += 1
        if progress:
            progress(done, len(chunks))
    return _gather([one for file in files for one in json.loads(file.read_text("utf-8"))])


def _digest(paper: PaperStudy, seed: int) -> str:
    """Digest what decides the results of whole studies."""
    known = (paper.settings.model_dump_json(), paper.stimuli.sha256, len(paper.plans), seed, __version__)
    return hashlib.sha256(repr(known).encode()).hexdigest()[:16]


def _run_chunk(paper: PaperStudy, seed: int, studies: range) -> list[dict[str, Any]]:
    """Run some studies; what JSON can hold of each."""
    found = []
    for number in studies:
        fit = paper.analyze(int(np.random.SeedSequence([seed, number]).generate_state(1)[0]))
        rows = fit.slopes.assign(study=number).to_dict("records")
        found.append({"rows": rows, "screened": fit.screened, "failed": fit.failed})
    json_rows: list[dict[str, Any]] = to_json_value(found)
    return json_rows


def _gather(found: list[dict[str, Any]]) -> Wholes:
    slopes = pd.DataFrame([row for one in found for row in one["rows"]])
    failed = tuple(reason for one in found for reason in one["failed"])
    return Wholes(slopes, len(found), sum(one["screened"] for one in found), failed)
