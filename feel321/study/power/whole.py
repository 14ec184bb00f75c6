"""Whole studies on paper: plans, engine, observers, decoding and analysis are the real ones, only the disk is left out.

A journal that is kept in memory costs a sixth of one that is written, read and verified; a test holds both against each
other, row by row. What cannot change the ratings of a slider is left out too: thresholds, matched strength, questions.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

import feel321
from feel321.analysis.power import find
from feel321.analysis.power.design import LEVEL
from feel321.analysis.primary import model as primary
from feel321.analysis.report import parts
from feel321.analysis.screening import screen
from feel321.analysis.table import reading
from feel321.files import make_folder, write_text
from feel321.jobs import Job, run_jobs
from feel321.protocols.texts import make_scales
from feel321.protocols.trial import RATING_RANGE
from feel321.records import to_json_value
from feel321.study.observer import casting, participant, simulated
from feel321.study.ratings import decode_judgements
from feel321.study.session import codes, engine, events, journal, plan
from feel321.study.settings import read

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

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
UNBUILT = "0" * 64
"""Digest of a stimulus set that is not built."""

PERCEIVED = ("threshold_spectral", "envelope", "level", "direction", "vector_magnitude")
"""What observers feel that no table of stimuli tells."""

FITTED = ("estimate", "se", "df", "p", "low", "high", "estimable")


class PaperJournal(journal.Journal):
    """A journal that is never written: of a session that is over when it has been counted."""

    __slots__ = ()

    def _keep(self, record: Record) -> None:
        self.records.append(record)


@dataclass(frozen=True, slots=True)
class ExpectedRater(participant.Rater):
    """Gives the mean rating of the study's simulated participants: what is planted, without any noise."""

    model: ObserverModel

    def rate(
        self,
        percept: float,
        *,
        sure: float = RATING_RANGE[0],
        shift: float,
        growth: float,
        rng: np.random.Generator,
    ) -> float:
        """Average over participants; who takes the ends of the scale for each other does so to the mean, too."""
        del shift, growth, rng
        model, top = self.model, sum(RATING_RANGE)
        careful = participant.expect_rating(model, [percept], sure=sure)[0]
        idle, turned = model.straight_liners + model.random_clickers, model.scale_reversers
        return (1 - idle - turned) * careful + turned * (top - careful) + idle * top / 2


class WholeFit(NamedTuple):
    """The slopes of one whole study: a row per attribute and metric; participants left out; fits that failed."""

    slopes: pd.DataFrame
    screened: int
    failed: tuple[str, ...]


@dataclass(frozen=True)
class PaperStudy:
    """A study that can be run again and again without a disk.

    plans: those of all participants, the same in every run; further: metrics that the manifest lacks; screening: rules
    by which participants are left out.
    """

    settings: Settings
    folder: Path
    stimuli: StimulusSet
    plans: tuple[Plan, ...]
    further: Further | None = None
    screening: tuple[str, ...] = ()

    @classmethod
    def draw(
        cls,
        settings: Settings,
        folder: Path,
        stimuli: StimulusSet,
        *,
        participants: int,
        further: Further | None = None,
        screening: tuple[str, ...] = (),
    ) -> PaperStudy:
        """Plan the sessions of so many participants."""
        design = read.make_design(settings, folder)
        design = replace(design, threshold=None, matching=None, questions=())
        plans = (
            plan.make_plan(design, stimuli, f"sim{number:03d}", number=number, simulated=True)
            for number in range(1, participants + 1)
        )
        return cls(settings, folder, stimuli, tuple(plans), further, screening)

    @cached_property
    def _scales(self) -> Mapping[str, Any]:
        return make_scales(read.read_study_texts(self.settings, self.folder))

    @cached_property
    def _casting(self) -> casting.Casting:
        if self.stimuli.sha256 == UNBUILT and casting.make_model(self.settings).uses_percepts:
            raise ValueError(
                f"build the set first: simulated observers with {', '.join(PERCEIVED)} in [observer] feel the built "
                "stimuli, and there are none yet"
            )
        return casting.cast_observers(self.settings, self.stimuli, seed=0)

    def simulate(self, seed: int, *, expected: bool = False) -> pd.DataFrame:
        """Run the sessions of simulated participants of this seed; one row per judgement, as in `ratings.csv`.

        expected: everybody gives the mean rating instead.
        """
        cast = replace(self._casting, seed=seed)
        rows = [row for one in self.plans for row in self._run(one, cast, expected=expected)]
        return pd.DataFrame(rows)

    def _run(self, own: Plan, cast: casting.Casting, *, expected: bool) -> list[dict[str, Any]]:
        number = casting.find_person(own.participant)
        observer = simulated.SimulatedObserver(
            cast.model, seed=cast.seed, number=number, percepts=cast.percepts
        )
        if expected:
            careful = participant.NORMAL, 0.0, 1.0, 0.0, 0.0, 0.5
            observer.rater = ExpectedRater(*careful, cast.model)
        kept = self._begin_journal(own, cast)
        engine.run_session(own, observer, stimuli=self.stimuli, journal=kept, scales=self._scales)
        by_code = codes.list_by_code(self.stimuli, seed=own.seed)
        return decode_judgements(own, kept.records, by_code, levels={}, path=kept.path)

    def _begin_journal(self, own: Plan, cast: casting.Casting) -> PaperJournal:
        identity = {"presenter": participant.identify_observer(cast.model, seed=cast.seed)}
        digests = own.sha256, own.stimuli_sha256
        kept = PaperJournal(self.folder / own.participant, journal.utc_now)
        kept.write(
            events.SessionBegun(
                plan.JOURNAL_FORMAT, own.participant, *digests, own.seed, identity, 1, {}, "", {}
            )
        )
        return kept

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

    def analyze(self, seed: int) -> WholeFit:
        """Run a study and analyse it: screening, the primary model of every attribute, Holm's method."""
        table = self.tabulate(self.simulate(seed))
        out = self._screen(table)
        table = replace(table, rows=table.rows[~table.rows[WHO].isin(out)])
        found, failed = [], []
        for part in parts.split_parts(table):
            try:
                found.append(_fit_part(part, table.metrics))
            except ValueError as error:
                failed.append(f"{part.lead}: {error}")
        if not found:
            return WholeFit(pd.DataFrame(), len(out), tuple(failed))
        slopes = pd.concat(found, ignore_index=True)
        adjusted = primary.adjust_holm(slopes["p"].tolist())
        return WholeFit(slopes.assign(p_holm=adjusted), len(out), tuple(failed))

    def _screen(self, table: Table) -> set[object]:
        """Find the participants whom the rules flag."""
        if not self.screening:
            return set()
        found = screen.screen_raters(table, self.screening)
        return {who for hit in found.hits.values() for who in hit}


def _fit_part(part: RatingsPart, metrics: Sequence[str]) -> pd.DataFrame:
    fit = primary.fit_primary(part.rows, metrics, explain=False)
    slopes = fit.slopes.reindex(list(metrics))[list(FITTED)].reset_index()
    return slopes.assign(part=part.lead, singular=fit.fit.singular)


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
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Wholes:
    """Run whole studies, each with a seed of its own; those that an interrupted call had run are kept."""
    place = keep / f"whole-{_digest(paper, seed)}"
    make_folder(place)
    chunks = [range(first, min(first + CHUNK, studies)) for first in range(0, studies, CHUNK)]
    files = [place / f"{chunk.start}-{chunk.stop}.json" for chunk in chunks]
    left = [place for place, file in enumerate(files) if not file.is_file()]
    todo: list[Job] = [(_run_chunk, (paper, seed, chunks[place]), {}) for place in left]
    for done, (turn, found) in enumerate(run_jobs(todo, workers=workers), start=1):
        write_text(files[left[turn]], json.dumps(found))
        progress(len(files) - len(left) + done, len(files))
    return _gather([one for file in files for one in json.loads(file.read_text("utf-8"))])


def _digest(paper: PaperStudy, seed: int) -> str:
    """Digest what decides the results of whole studies: settings, texts, plans, stimuli with their metrics, code."""
    further = paper.further
    known = (
        paper.settings.model_dump_json(),
        repr(read.read_study_texts(paper.settings, paper.folder)),
        paper.stimuli.sha256,
        paper.stimuli.to_frame().to_csv(index=False),
        "" if further is None else further.metrics.to_csv(),
        *(one.sha256 for one in paper.plans),
        repr((paper.screening, seed)),
        _read_code(),
    )
    return hashlib.sha256("\n".join(known).encode()).hexdigest()[:16]


def _read_code() -> str:
    """Digest the code; another version's results are not taken for this one's."""
    files = sorted(Path(feel321.__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"\n".join(path.read_bytes() for path in files)).hexdigest()


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
    rows = [row for one in found for row in one["rows"]]
    slopes = pd.DataFrame(
        rows or {name: [] for name in ("part", "metric", "singular", "p_holm", *FITTED)}
    )
    failed = tuple(reason for one in found for reason in one["failed"])
    return Wholes(slopes, len(found), sum(one["screened"] for one in found), failed)


def compare(wholes: Wholes, fast: pd.DataFrame, names: Mapping[str, str]) -> pd.DataFrame:
    """Put whole studies beside the fast simulation and the closed form: a row per hypothesis.

    fast: the table of a `Power`; names: what the report calls an attribute -> what the design calls it.
    """
    slopes = wholes.slopes.assign(attribute=wholes.slopes["part"].map(names))
    rows = []
    for row in fast.to_dict("records"):
        same = (slopes["attribute"] == row["attribute"]) & (slopes["metric"] == row["metric"])
        own = slopes[same & slopes["estimable"].astype(bool)]
        given = {name: row[column] for name, column in BESIDE.items()}
        rows.append({**given, **_describe_whole(wholes, own, slope=row["slope"])})
    return pd.DataFrame(rows)


BESIDE = {
    "attribute": "attribute", "metric": "metric", "slope": "slope", "closed": "power", "fast": "simulated",
    "fast_low": "simulated_low", "fast_high": "simulated_high", "closed_width": "width",
    "fast_width": "simulated_width", "fast_coverage": "coverage",
}  # fmt: skip
"""Column of the comparison -> that of a Power's table."""


def _describe_whole(wholes: Wholes, own: pd.DataFrame, *, slope: float) -> dict[str, float]:
    known = np.ones(len(own), dtype=bool)
    power = find.find_share((own["p_holm"] < LEVEL).to_numpy(bool), known)
    held = ((own["low"] <= slope) & (own["high"] >= slope)).to_numpy(bool)
    coverage = find.find_share(held, known)
    return {
        "studies": wholes.studies, "tests": len(own), "failed": len(wholes.failed), "screened": wholes.screened,
        "singular": int(own["singular"].sum()), "mean": float(own["estimate"].mean()),
        "whole": power.share, "whole_low": power.low, "whole_high": power.high,
        "whole_width": float((own["high"] - own["low"]).median()),
        "coverage": coverage.share, "coverage_low": coverage.low, "coverage_high": coverage.high,
    }  # fmt: skip
