"""`check` and `build`: the steps of a study before its sessions."""

import csv
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from feel321.arguments import follow
from feel321.files import open_text
from feel321.jobs import Workers, as_workers
from feel321.protocols.order import find_crowding
from feel321.protocols.texts import make_scales
from feel321.protocols.trial import CHOOSING, Item
from feel321.stimuli.condition import condition
from feel321.stimuli.match import HIGHEST_HZ
from feel321.stimuli.sets import build as sets
from feel321.stimuli.sets.manifest import StimulusSet, check_stimuli, read_stimuli
from feel321.stimuli.sets.recipe import Recipe, find_conditioning
from feel321.study import strength
from feel321.study.actuator.certificate import judge_certificates, list_certificates
from feel321.study.actuator.rig import FILE_DEVICE, Rig, read_rig
from feel321.study.evidence.checkpoints import declaring
from feel321.study.folder import Problems, StudyFolder
from feel321.study.minutes import Pace, measure_length
from feel321.study.session.journal import Clock, utc_now
from feel321.study.session.plan import PLAN_FILE, Design, make_plan, make_trials
from feel321.study.settings import read
from feel321.study.settings.schema import Settings, count_groups

Progress = Callable[[int, int], None]
# Recording -> covariance of its axes as they are felt, (3, 3).
Covariances = dict[str, NDArray[np.float64]]


def build_study(
    study: StudyFolder, *, workers: int | Workers = 1, progress: Progress | None = None
) -> tuple[list[sets.Facts], StimulusSet]:
    """Build the stimulus set of a study; also gives what was found of its recordings."""
    if as_workers(workers).scheduler:
        study = StudyFolder(study.path.absolute())  # as all machines see it
    settings = read.read_settings(study.settings)
    sources = read.list_unread(settings, study.path)
    recipe = read.make_recipe(settings, study.path)
    _protect_used_set(study, settings, recipe)
    with declaring(study, "build"), follow(progress or False, "build") as move:
        facts, stimuli = sets.build_set(sources, study.stimuli, recipe, workers=workers, move=move)
    return facts, stimuli


def _protect_used_set(study: StudyFolder, settings: Settings, recipe: Recipe) -> None:
    """Refuse to replace a set that sessions were run with, or may have been."""
    if not study.stimuli.exists() or not any(study.sessions.glob(f"*/{PLAN_FILE}")):
        return
    # What cannot be read is reported by the build.
    found = read.try_recordings(settings, study.path)
    digests = {source.name: getattr(one, "sha256", None) for source, one in found}
    try:
        sha256 = read_stimuli(study.stimuli).sha256.encode()
        changes = read.find_changes(study.stimuli, recipe, digests)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{study.stimuli}: sessions may have been run with this set, which cannot be read ({error}); "
            f"restore it from a copy, or move {study.sessions} away"
        ) from None
    # By the bare text, so that damaged plans and journals count too.
    files = [path for path in study.sessions.glob("*/*.json*") if path.is_file()]
    if changes and any(sha256 in path.read_bytes() for path in files):
        remedy = f"sessions were run with this set; make a new study, or move {study.sessions} away"
        raise ValueError("\n".join(f"{change}; {remedy}" for change in changes))


# Everything that stands in the way of a study, found in one go.


def check_own_method(name: str, folder: Path, kind: str | None) -> Problems:
    """Check whether a reducer or metric of the lab's own meets the requirements."""
    from feel321.stimuli.conform import check_method

    method = read.open_method(name, folder, kind)
    found, subject = check_method(method), f"{method.kind} {method.name}"
    failed = [f"FAILED  {one.check}: {one.text}" for one in found if not one.passed]
    count = f"{len(failed)} of {len(found)} checks failed"
    outcome = count if failed else f"all {len(found)} checks passed"
    passed = [f"  ok  {one.check}: {one.text}" for one in found if one.passed]
    facts = {"kind": method.kind, "name": method.name, **method.to_json()}
    facts |= {"checks": found, "failed": len(failed)}
    notes = (f"{subject}: {outcome}", *passed)
    return Problems(tuple(failed), notes=notes, figures=facts, subject=subject)


def check_study(
    study: StudyFolder, *, progress: Progress | None = None, now: Clock = utc_now
) -> Problems:
    """Check settings, recordings, pictures, texts, strength of the stimuli, rig and, once built, the stimulus set."""
    from feel321.stimuli.conform import check_method

    try:
        settings = read.read_settings(study.settings)
    except ValueError as error:
        return Problems(tuple(str(error).splitlines()))
    recipe, unusable = None, []
    try:
        recipe = read.make_recipe(settings, study.path)
        unusable = [
            f"{one} ({one.place}), {found.check}: {found.text.removeprefix(f'{one}: ')}; see feel321 check --method"
            for one in read.list_methods(settings, study.path)
            for found in check_method(one, quick=True)
            if not found.passed
        ]
    except (TypeError, ValueError) as error:
        unusable = [f"{study.settings.name}: {error}"]
    own = None if unusable else recipe
    seen, covariances, faults = _examine(study, settings, own, progress=progress)
    facts = [one for one in seen if not one.fault]
    unread = [one.fault for one in seen if one.fault]
    rig, found = _check_rig(study, settings, now=now)
    found = Problems((*unread, *_check_texts(study, settings))) + found
    found += Problems((*faults, *unusable))
    if own is not None and not (unread or faults):
        try:
            if rig:
                found += strength.find_reach(rig, covariances, own, name=study.rig.name)
            found += _foresee(study, settings, seen, recipe=own)
        except ValueError as error:
            found += Problems((str(error),))
    if study.stimuli.exists():
        found += Problems(tuple(_check_set(study, settings, facts, recipe=recipe)))
    elif study.participants:
        lost = "missing, but sessions were run with it; put it back or build it again"
        found += Problems((f"{study.stimuli}: {lost}",))
    warnings = [f"{one.name}: {text}" for one in facts for text in one.warnings]
    warnings += [] if found.problems else find_warnings(study, settings, facts)
    return found + Problems(warnings=tuple(warnings))


def _examine(
    study: StudyFolder, settings: Settings, recipe: Recipe | None, *, progress: Progress | None
) -> tuple[list[sets.Facts], Covariances, list[str]]:
    """Read each recording once, and measure its stimuli as a build does; keep no samples."""
    history, count = sets.read_history(study.stimuli), len(settings.recordings)
    seen, covariances, faults = list[sets.Facts](), Covariances(), list[str]()
    for done, (source, recording) in enumerate(read.try_recordings(settings, study.path), start=1):
        if isinstance(recording, str):
            own = sets.Facts(source.name, fault=recording)
        elif recipe is None:
            own = sets.Facts.find(recording)
        else:
            own = sets.survey_recording(recording, history.get(source.name, ()), recipe=recipe)
            if own.fault:
                faults.append(own.fault)
                own = sets.Facts.find(recording)
            else:
                felt = condition(recording, find_conditioning(recipe, source.name)).acceleration
                covariances[source.name] = np.asarray(np.einsum("in,jn->ij", felt, felt))
        seen.append(own)
        if progress:
            progress(done, count)
    return seen, covariances, faults


def _foresee(
    study: StudyFolder, settings: Settings, seen: Sequence[sets.Facts], *, recipe: Recipe
) -> Problems:
    """Find out how strong stimuli are, and how long a session takes."""
    foreseen = [one for own in sets.place_surveyed(seen, recipe).values() for one in own]
    found = strength.find_strength(settings, foreseen, recipe)
    if not study.manifest.exists():  # else the files are examined themselves
        found += Problems(tuple(strength.find_clipping(foreseen, recipe)))
    design, groups = _keep_choosing(read.make_design(settings))
    items = [
        Item(one.stimulus_id, one.recording, one.reducer, one.level, one.role) for one in foreseen
    ]
    crops = {one.name: find_conditioning(recipe, one.name).crop_s for one in seen}
    durations = {
        one.name: crop[1] - crop[0] if (crop := crops[one.name]) else one.duration_s for one in seen
    }
    with suppress(ValueError):  # what keeps trials from being made is found by itself
        plans = [make_trials(design, items, number=number) for number in range(1, groups + 1)]
        length = measure_length(plans, durations, Pace())
        note = f"{study.settings.name}: {length.describe()}"
        found += Problems(notes=(note,), figures={"session": asdict(length)})
    return found


def _keep_choosing(design: Design) -> tuple[Design, int]:
    """Leave out labels, which make no difference to stimuli and tasks; also counts the groups that are left."""
    choosing = {factor: levels for factor, levels in design.between.items() if factor in CHOOSING}
    return replace(design, between=choosing), count_groups(choosing)


def _check_set(
    study: StudyFolder,
    settings: Settings,
    recordings: Sequence[sets.Facts],
    *,
    recipe: Recipe | None,
) -> Iterator[str]:
    """Check the set that is there: its files, that tasks and analysis can use it, and that the settings ask for it."""
    damage = check_stimuli(study.stimuli)
    yield from damage
    if not damage:
        # The tasks of every group must find the stimuli that they need.
        design, groups = _keep_choosing(read.make_design(settings))
        stimuli = read_stimuli(study.stimuli)
        problems: dict[str, None] = {}
        for number in range(1, groups + 1):
            try:
                make_plan(design, stimuli, "check", number=number, simulated=False)
            except ValueError as error:
                problems[str(error)] = None
        yield from problems
        yield from _check_metrics(study, settings)
    if recipe is not None:
        sources = {recording.name: recording.sha256 for recording in recordings}
        named = {entry.title: sources.get(entry.title) for entry in settings.recordings}
        try:
            changes = read.find_changes(study.stimuli, recipe, named)
        except ValueError as error:
            yield str(error)
        else:
            yield from (f"{change}; run feel321 build" for change in changes)


def _check_metrics(study: StudyFolder, settings: Settings) -> Iterator[str]:
    """Check that the metrics that the analysis declares are numeric columns of the manifest, or computed by it."""
    from feel321.analysis.table.columns import ROTATIONS  # build needs nothing of the analysis

    known: dict[str, None] = {}
    with open_text(study.manifest) as file:
        for name, cell in (pair for row in csv.DictReader(file) for pair in row.items()):
            with suppress(ValueError):
                float(cell)
                known[name] = None
    known |= dict.fromkeys(ROTATIONS)
    for name in (one for one in settings.analysis.metrics if one not in known):
        yield (
            f"{study.settings.name}: analysis.metrics must be numeric columns of {study.manifest}, or rotation "
            f"statistics, got {name!r}; there are: {', '.join(known)}"
        )


def _check_texts(study: StudyFolder, settings: Settings) -> Iterator[str]:
    """Check that pictures are there, and that all texts fit on the screen."""
    from feel321.study.screen.input import make_screen_texts
    from feel321.study.screen.layout import find_overflows

    for entry in settings.recordings:
        if entry.picture and not (place := study.path / entry.picture).is_file():
            yield f"recording {entry.title!r}: {place}: no such picture; put it there"
    try:
        texts = read.read_study_texts(settings, study.path)
        questions = read.make_design(settings).questions
    except OSError as error:
        remedy = "put your texts there, or name a language of the catalogue"
        yield f"{error.filename}: {error.strerror}; {remedy}"
        return
    except ValueError as error:
        yield from str(error).splitlines()
        return
    together = {name for table in settings.tasks.values() for name in table.scales}
    scales = make_scales(texts).values()
    for problem in find_overflows(make_screen_texts(texts), scales, questions, together=together):
        yield f"texts in {read.find_language(settings, study.path)}: {problem}"


def _check_rig(
    study: StudyFolder, settings: Settings, *, now: Clock
) -> tuple[Rig | None, Problems]:
    """Check the rig, where there is one, and the certificate that a session would use. An unusable rig is None."""
    from feel321.study.actuator import render

    if not study.rig.is_file():
        return None, Problems()
    name, own = study.rig.name, settings.rig
    try:
        rig = read_rig(study.rig)
        render.find_mix(rig)
    except ValueError as error:
        return None, Problems(tuple(str(error).splitlines()))
    certificate, faults = judge_certificates(study.path, rig, now=now(), rate_hz=own.rate_hz)
    lines, found = tuple(f"{name}: {fault}" for fault in faults), Problems()
    if certificate is not None:
        until = f"valid until {certificate.expires_utc[:10]}"
        note = f"{name}: certificate {certificate.id} ({certificate.method}), {until}"
        found = Problems(notes=(note,))
    elif own.certificate == "require":
        found = Problems(problems=lines)
    elif rig.device.name != FILE_DEVICE or list_certificates(study.path):  # files need none
        found = Problems(warnings=lines)
    try:
        stimuli = read_stimuli(study.stimuli)
    except (OSError, ValueError):
        return rig, found  # not built yet, or damaged, which is found by itself
    problems, _ = render.find_rig_problems(rig, stimuli, settings, certificate=certificate)
    return rig, found + Problems(tuple(problems))


def find_copies(facts: Iterable[sets.Facts]) -> list[str]:
    """Name recordings whose files hold the same, bytes for bytes: people would judge one of them twice as often."""
    names: defaultdict[str, list[str]] = defaultdict(list)
    for one in facts:
        names[one.sha256].append(one.name)
    return [
        f"recordings {' and '.join(same)} hold the same; leave one out, unless that is meant"
        for sha256, same in names.items()
        if sha256 and len(same) > 1
    ]


def find_warnings(
    study: StudyFolder, settings: Settings, recordings: Sequence[sets.Facts] = ()
) -> list[str]:
    """Find what is allowed in a study and still worth knowing."""
    remarks = [
        f"{study.settings.name}: tasks.{name}: has no effect, {name} is not in session.protocols; add it there"
        for name in settings.tasks
        if name not in settings.session.protocols
    ]
    remarks += find_copies(recordings)
    remarks += [
        f"recording {one.name!r}, at {one.rate_hz:g} Hz: holds nothing above {one.rate_hz / 2:g} Hz, so its matches "
        f"compare less than 20 to {HIGHEST_HZ:g} Hz; record at {2 * HIGHEST_HZ:g} Hz or more, or report the band"
        for one in recordings
        if one.rate_hz / 2 < HIGHEST_HZ
    ]
    if settings.session.order == "random" and study.stimuli.exists():
        design, stimuli = read.make_design(settings), read_stimuli(study.stimuli)
        plan = make_plan(design, stimuli, "check", number=1, simulated=False)
        remarks += [f"order 'random': {line}" for line in find_crowding(plan.trials)]
    return remarks
