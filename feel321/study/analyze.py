"""Steps of a study that need the analysis: the report, and the recordings for the trade-off."""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import fields, replace
from itertools import chain, count
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import pandas as pd

from feel321.analysis.report.standing import About
from feel321.analysis.report.write import Results, write_report
from feel321.analysis.table.dictionary import DICTIONARY, make_dictionary
from feel321.analysis.table.items import Table
from feel321.analysis.table.metrics import make_info
from feel321.analysis.table.reading import ROSTER_FILE, Further, read_table
from feel321.doors import announce
from feel321.files import write_text
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import Recording
from feel321.stimuli.sets.manifest import find_methods, read_stimuli
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.study.checkpoints import declaring
from feel321.study.folder import StudyFolder, require_study
from feel321.study.freeze import make_standing
from feel321.study.metrics import add_rivals, measure_declared, measure_rotations
from feel321.study.people import list_progress, note_estimates, note_given_up, write_roster
from feel321.study.persons.answers import ANSWERS_FILE, write_answers
from feel321.study.persons.withdrawal import closing_results
from feel321.study.ratings import MATCHES_FILE, describe_matches, write_matches, write_ratings
from feel321.study.settings.read import list_origins, make_recipe, open_recordings, read_settings
from feel321.study.settings.schema import AnalysisTable, Settings
from feel321.types import MetricInfo

if TYPE_CHECKING:
    from feel321.analysis.replication import Paper

Progress = Callable[[int, int], None]

# The report: of a study's own ratings, or of tables from elsewhere.


def analyze_study(  # noqa: PLR0913 - one per choice
    study: StudyFolder,
    *,
    ratings: Path | None = None,
    manifest: Path | None = None,
    metrics: Sequence[str] | None = None,
    draws: int | None = None,
    rivals: bool = False,
    out: Path | None = None,
    progress: Progress | None = None,
    finish: Callable[[Path], None] | None = None,
) -> Results:
    """Derive the table of ratings, or take one from elsewhere, and write the report as the study declares it.

    finish: writes what else belongs into the folder of the report, before the checkpoint.
    """
    settings = _read_settings(study, ratings, manifest)
    chosen = settings.analysis if settings else AnalysisTable()
    further, about, asked = Further(pd.DataFrame(), ()), About(), metrics or ()
    if settings:
        day = ""
        if ratings is None:
            further, day = _derive_tables(study, settings, metrics or chosen.metrics)
        if asked and set(asked) != set(chosen.metrics):
            said = f"{study.settings.name} declares {', '.join(chosen.metrics)}."
            note = f"Metrics {', '.join(asked)} were asked for with this analysis; {said}"
            further = replace(further, notes=(*further.notes, note))
        own = not (ratings or manifest)
        standing = make_standing(study, settings, metrics=asked, draws=draws, own=own)
        protocols = tuple(settings.session.protocols)
        about = About(settings.study.name, day, protocols, standing=standing)
    listed, folder = manifest or study.manifest, out or study.report
    if rivals:
        further = add_rivals(study, None if manifest else settings, listed, further=further)
    declared = declaring(study, "analyze") if out is None else nullcontext()
    with closing_results(study, folder), declared:
        results = write_report(
            ratings or study.ratings,
            listed,
            folder,
            draws=draws or chosen.draws,
            margin=chosen.margin,
            metrics=metrics or chosen.metrics,
            further=further,
            about=about,
            sources=list_origins(settings) if settings else {},
            info=list_info(settings) if settings else {},
            paper=make_paper(settings, further.mountings) if settings else None,
            rng=settings.study.seed if settings else 0,
            progress=progress,
        )
        if finish:
            finish(folder)
    return results


def _read_settings(study: StudyFolder, *inputs: Path | None) -> Settings | None:
    """Read the settings of a study; where ratings and manifest come from elsewhere, there may be none."""
    if None in inputs:
        require_study(study.path)
    return read_settings(study.settings) if study.settings.is_file() else None


def read_study_table(study: StudyFolder) -> tuple[Table, int]:
    """Read the ratings that a report would be about, and the seed of that report."""
    settings = read_settings(require_study(study.path).settings)
    if not write_ratings(study, read_stimuli(study.stimuli)):
        raise ValueError(f"{study.path}: no ratings yet; run sessions first")
    table = read_table(
        study.ratings,
        study.manifest,
        metrics=settings.analysis.metrics,
        sources=list_origins(settings),
        further=measure_declared(study, settings),
        info=list_info(settings),
    )
    return table, settings.study.seed


def _derive_tables(
    study: StudyFolder, settings: Settings, metrics: Sequence[str]
) -> tuple[Further, str]:
    """Derive all tables of the study's own journals; returns what else is known of its stimuli, and the last day."""
    announce("ratings from the journals")
    everybody = list_progress(study)
    write_roster(study, everybody)
    stimuli = read_stimuli(study.stimuli)
    if not write_ratings(study, stimuli):
        simulate = f"feel321 simulate {quote(str(study.path))}"
        raise ValueError(f"{study.path}: no ratings yet; run sessions first, or {simulate}")
    write_answers(study)
    matched = write_matches(study, stimuli)
    _write_dictionary(study, settings)
    announce("metrics over orientations of the sensor")
    further = measure_rotations(study, settings, stimuli, metrics=metrics)
    notes = [
        *further.notes,
        *describe_matches(matched),
        *note_estimates(everybody),
        *note_given_up(everybody),
    ]
    if methods := [f"{name} {digest}" for name, digest in find_methods(study.stimuli).items()]:
        said = "Reducers and metrics of the lab's own, with the SHA-256 of their code"
        notes.append(f"{said}: {', '.join(methods)}.")
    day = max((one.rated_utc[:10] for one in everybody), default="")
    return replace(further, notes=tuple(notes)), day


def _write_dictionary(study: StudyFolder, settings: Settings) -> None:
    """Describe the columns of the study's own tables, beside them."""
    own = [study.path / name for name in (ROSTER_FILE, ANSWERS_FILE, MATCHES_FILE)]
    paths = (path for path in (study.ratings, *own, study.manifest) if path.is_file())
    tables = {path.name: pd.read_csv(path) for path in paths}
    rows = make_dictionary(tables, list_info(settings))
    groups = rows["column"].isin(settings.between) & (rows["meaning"] == "")
    rows.loc[groups, "meaning"] = "group of the participant, a factor of [between]"
    write_text(study.path / DICTIONARY, rows.to_csv(index=False, lineterminator="\n"))


def list_info(settings: Settings) -> dict[str, MetricInfo]:
    """List what `[metrics.NAME]` declares; a table that only says where a metric's code is declares nothing."""
    facts = {name: table.to_facts() for name, table in settings.metrics.items()}
    declared = {field.name for field in fields(MetricInfo)}
    return {name: make_info(name, one) for name, one in facts.items() if declared & set(one)}


def make_paper(settings: Settings, mountings: pd.DataFrame | None = None) -> "Paper | None":
    """Make the paper that the report answers; mountings: metrics over orientations of the sensor."""
    if (paper := settings.paper) is None:
        return None
    from feel321.analysis.replication import Paper, PaperClaim

    claims = []
    for table in paper.claims:
        number = table.paper.model_dump() if table.paper else {}
        ends = [number.get(key) for key in ("value", "low", "high")]
        value, low, high = (float("nan") if one is None else float(one) for one in ends)
        own = table.model_dump(exclude={"paper"}) | {
            "options": table.options.model_dump(exclude_none=True)
        }
        claims.append(PaperClaim(paper=(value, low, high), **own))
    published = [
        {**one.model_dump(exclude={"numbers"}), "reducer": reducer, "paper": value}
        for one in paper.published
        for reducer, value in one.numbers.items()
    ]
    frame = pd.DataFrame(published) if published else None
    return Paper(paper.citation, paper.doi, paper.seen, tuple(claims), frame, mountings)


# What the trade-off works on: a study's recordings, the bundled scenes, recordings from elsewhere.

SUFFIXES = frozenset({".wav", ".csv", ".tsv", ".txt", ".npz", ".npy", ".mat", ".xml", ".ide"})
"""Files in a folder that are taken for recordings; a single file is read whatever it is called."""


def gather_recordings(
    folder: Path, *, scenes: bool = False, extra: Sequence[Path] = ()
) -> tuple[Recording, ...]:
    """Gather the recordings that methods are compared on.

    All are conditioned as the study's own, because that is what participants feel; its crop, which names times in the
    study's recordings, is done to those alone. Of equal recordings the first is kept; a name that is taken gets a
    number.
    """
    study = StudyFolder(folder) if scenes or extra else require_study(folder)
    found: list[Recording] = []
    mistakes: list[str] = []
    steps = Conditioning()
    if study.settings.is_file():
        settings = read_settings(study.settings)
        found = open_recordings(settings, folder)
        steps = make_recipe(settings, folder).conditioning
    n_own = len(found)
    others = [make_scene(name) for name in SCENES] if scenes else []
    others += (read_recording(path) for path in _list_files(extra))
    for one in others:
        if one.sha256 not in {former.sha256 for former in found}:
            found.append(replace(one, name=_name_apart(one.name, {each.name for each in found})))
    ready = []
    for place, recording in enumerate(found):
        try:
            crop_s = steps.crop_s if place < n_own else None
            ready.append(condition(recording, replace(steps, crop_s=crop_s)))
        except ValueError as error:
            mistakes.append(f"recording {recording.name!r}: {error}")
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return tuple(ready)


def _name_apart(name: str, taken: Collection[str]) -> str:
    numbered = (f"{name} ({number})" for number in count(2))
    return next(one for one in chain([name], numbered) if one not in taken)


def find_ratings(study: StudyFolder) -> Table | None:
    """Find the ratings of a study, as analyze does: derived from its journals, or a table that was put there."""
    if study.journals:
        rated = write_ratings(study, read_stimuli(study.stimuli)) > 0
    else:
        rated = study.ratings.is_file() and study.manifest.is_file()
    return read_table(study.ratings, study.manifest) if rated else None


def _list_files(paths: Sequence[Path]) -> Iterator[Path]:
    for path in paths:
        entries = [path]
        if path.is_dir():
            own = path.glob("[!.]*")
            entries = sorted(one for one in own if one.is_file() and one.suffix.lower() in SUFFIXES)
        if not entries:
            suffixes = " ".join(sorted(SUFFIXES))
            raise FileNotFoundError(
                f"{path}: no recordings in this folder; name another, or files ending in {suffixes}"
            )
        yield from entries
