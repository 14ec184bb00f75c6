"""Steps of a study before the sessions: check and build."""

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from feel321.doors import announce
from feel321.jobs import Workers
from feel321.protocols.order import find_crowding
from feel321.protocols.texts import list_borrowed, make_scales
from feel321.protocols.trial import CHOOSING, Item
from feel321.stimuli.condition import condition, fade
from feel321.stimuli.recording import Recording
from feel321.stimuli.sets.anchors import quietest_hz
from feel321.stimuli.sets.build import Foreseen, build_stimuli, foresee_stimuli
from feel321.stimuli.sets.manifest import StimulusSet, check_stimuli, read_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.study import strength
from feel321.study.actuator.certificate import Certificate, judge_certificates, list_certificates
from feel321.study.actuator.render import find_mix
from feel321.study.actuator.rig import FILE_DEVICE, Rig, read_rig
from feel321.study.findings import Problems
from feel321.study.folder import StudyFolder, is_in_use
from feel321.study.methods import list_methods
from feel321.study.minutes import measure_design
from feel321.study.paper import compare_with_paper
from feel321.study.provenance import find_changes
from feel321.study.session.journal import Clock, utc_now
from feel321.study.session.plan import PLAN_FILE, Design, make_plan
from feel321.study.settings.read import (
    find_language,
    list_remarks,
    make_design,
    make_recipe,
    open_recordings,
    read_settings,
    read_study_texts,
    try_recordings,
)
from feel321.study.settings.schema import Settings, count_groups

Progress = Callable[[int, int], None]


def build_study(
    study: StudyFolder,
    *,
    workers: int | Workers = 1,
    page: bool = True,
    progress: Progress | None = None,
) -> tuple[list[Recording], StimulusSet]:
    """Build the stimulus set of a study, and its page."""
    settings = read_settings(study.settings)
    recordings = open_recordings(settings, study.path)
    recipe = make_recipe(settings, study.path)
    _protect_used_set(study, recipe, recordings)
    stimuli = build_stimuli(
        recordings, study.stimuli, recipe=recipe, workers=workers, progress=progress
    )
    if page:
        from feel321.analysis.browser import write_stimulus_page

        announce("page of the set")
        write_stimulus_page(study.stimuli)
    elif (study.stimuli / "index.html").exists():
        from feel321.analysis.browser import remove_stimulus_page

        remove_stimulus_page(study.stimuli)
    return recordings, stimuli


def _protect_used_set(study: StudyFolder, recipe: Recipe, recordings: Sequence[Recording]) -> None:
    """Refuse to replace a set that sessions were run with, or may have been."""
    if not study.stimuli.exists() or not any(study.sessions.glob(f"*/{PLAN_FILE}")):
        return
    try:
        sha256 = read_stimuli(study.stimuli).sha256
        changes = find_changes(
            study.stimuli, recipe, {recording.name: recording.sha256 for recording in recordings}
        )
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{study.stimuli}: sessions may have been run with this set, which cannot be read ({error}); "
            f"restore it from a copy, or move {study.sessions} away"
        ) from None
    if changes and is_in_use(study, sha256):
        remedy = f"sessions were run with this set; make a new study, or move {study.sessions} away"
        raise ValueError("\n".join(f"{change}; {remedy}" for change in changes))


# Everything that stands in the way of a study, found in one go.


def check_study(
    study: StudyFolder, *, progress: Progress | None = None, now: Clock = utc_now
) -> Problems:
    """Check settings, recordings, pictures, texts, strength of the stimuli, rig and, once built, the stimulus set."""
    try:
        settings = read_settings(study.settings)
    except ValueError as error:
        return Problems(tuple(str(error).splitlines()))
    recordings, unread = try_recordings(settings, study.path)
    rig, rigged = _check_conditions(study, settings, recordings, now=now)
    problems = [
        *unread,
        *_check_pictures(study, settings),
        *_check_texts(study, settings),
        *rigged.problems,
    ]
    recipe, unusable = _try_recipe(study, settings, recordings)
    problems += unusable
    found = Problems()
    if recipe is not None and not unread and not unusable:
        try:
            foreseen = foresee_stimuli(recordings, study.stimuli, recipe=recipe, progress=progress)
            found = _find_strength(study, settings, recordings, foreseen=foreseen, rig=rig)
        except ValueError as error:
            problems.append(str(error))
    problems += found.problems
    if study.stimuli.exists():
        problems += _check_set(study, settings, recordings, recipe=recipe)
    elif study.participants:
        problems.append(
            f"{study.stimuli}: missing, but sessions were run with it; put it back or build it again"
        )
    return replace(
        found,
        problems=tuple(problems),
        warnings=found.warnings
        + rigged.warnings
        + tuple([] if problems else find_warnings(study, settings)),
        notes=rigged.notes + found.notes,
        remarks=tuple(f"{one.name}: {text}" for one in recordings for text in one.warnings),
    )


def _try_recipe(
    study: StudyFolder, settings: Settings, recordings: Sequence[Recording]
) -> tuple[Recipe | None, list[str]]:
    try:
        recipe = make_recipe(settings, study.path)
    except ValueError as error:
        return None, [f"{study.settings.name}: {error}"]
    return recipe, [*_check_recordings(recordings, recipe), *_check_methods(study, settings)]


def _check_methods(study: StudyFolder, settings: Settings) -> list[str]:
    """Check the form of the lab's own reducers, metrics and screening rules, as far as that is quick."""
    from feel321.analysis.screening.rules import find_rules, make_rule
    from feel321.stimuli.conformance import check_method

    try:
        methods = list_methods(settings, study.path)
        for rule in find_rules(settings.analysis.screening, study.path):
            make_rule(rule)
    except (TypeError, ValueError) as error:
        return [f"{study.settings.name}: {error}"]
    return [
        f"{one} ({one.place}), {found.check}: {found.text.removeprefix(f'{one}: ')}; see feel321 check --method"
        for one in methods
        for found in check_method(one, quick=True)
        if not found.passed
    ]


def _find_strength(
    study: StudyFolder,
    settings: Settings,
    recordings: Sequence[Recording],
    *,
    foreseen: Sequence[Foreseen],
    rig: Rig | None,
) -> Problems:
    """Find out how strong stimuli are, how long a session takes, and, with a rig, how it brings them to the hand."""
    recipe = make_recipe(settings, study.path)
    found = strength.find_strength(settings, foreseen, recipe)
    found = _add_minutes(found, settings, recordings, foreseen=foreseen)
    is_built = study.manifest.exists()  # then its files are examined themselves
    problems = [*found.problems, *([] if is_built else strength.find_clipping(foreseen, recipe))]
    if rig is None:
        return replace(found, problems=tuple(problems))
    name = study.rig.name
    limits = [] if is_built else strength.find_rig_limits(rig, foreseen, recipe.reference)
    reach = strength.find_reach(rig, recordings, recipe)
    return Problems(
        problems=(*problems, *(f"{name}: {line}" for line in limits)),
        warnings=(*found.warnings, *(f"{name}: {line}" for line in reach.warnings)),
        notes=(*(f"{name}: {line}" for line in reach.notes), *found.notes),
        figures={**found.figures, **reach.figures},
    )


def _add_minutes(
    found: Problems,
    settings: Settings,
    recordings: Sequence[Recording],
    *,
    foreseen: Sequence[Foreseen],
) -> Problems:
    """Add how long a session takes."""
    design, groups = _keep_choosing(make_design(settings))
    items = [
        Item(one.stimulus_id, one.recording, one.reducer, one.level, one.role) for one in foreseen
    ]
    crop_s = settings.stimuli.conditioning.crop_s
    durations = {
        one.name: crop_s[1] - crop_s[0] if crop_s else one.duration_s for one in recordings
    }
    try:
        length = measure_design(design, items, durations=durations, groups=groups)
    except ValueError:
        return found  # what keeps trials from being made is found by itself
    notes = (*found.notes, f"study.toml: {length.describe()}")
    return replace(found, notes=notes, figures={**found.figures, "session": asdict(length)})


def _keep_choosing(design: Design) -> tuple[Design, int]:
    """Leave out labels, which make no difference to stimuli and tasks; also counts the groups that are left."""
    choosing = {factor: levels for factor, levels in design.between.items() if factor in CHOOSING}
    return replace(design, between=choosing), count_groups(choosing)


def _check_set(
    study: StudyFolder,
    settings: Settings,
    recordings: Sequence[Recording],
    *,
    recipe: Recipe | None,
) -> Iterator[str]:
    """Check the set that is there: its files, that tasks and analysis can use it, and that the settings ask for it."""
    damage = check_stimuli(study.stimuli)
    yield from damage
    if not damage:
        yield from _check_plan(study, settings)
        yield from _check_metrics(study, settings)
    if recipe is None:
        return
    sources = {recording.name: recording.sha256 for recording in recordings}
    named = {entry.title: sources.get(entry.title) for entry in settings.recordings}
    try:
        changes = find_changes(study.stimuli, recipe, named)
    except ValueError as error:
        yield str(error)
    else:
        yield from (f"{change}; run feel321 build" for change in changes)


def _check_plan(study: StudyFolder, settings: Settings) -> Iterator[str]:
    """Check that the tasks of every group find the stimuli that they need."""
    (design, groups), stimuli = (
        _keep_choosing(make_design(settings, study.path)),
        read_stimuli(study.stimuli),
    )
    problems: dict[str, None] = {}
    for number in range(1, groups + 1):
        try:
            make_plan(design, stimuli, "check", number=number, simulated=False)
        except ValueError as error:
            problems[str(error)] = None
    yield from problems


def _check_metrics(study: StudyFolder, settings: Settings) -> Iterator[str]:
    """Check that the metrics that the analysis declares are numeric columns of the manifest, or computed by it."""
    from feel321.analysis.table.metrics import ROTATIONS  # build needs nothing of the analysis

    with study.manifest.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    numeric = [name for name in rows[0] if any(_is_number(row[name]) for row in rows)]
    for name in settings.analysis.metrics:
        if name not in numeric and name not in ROTATIONS:
            yield (
                f"{study.settings.name}: analysis.metrics must be numeric columns of {study.manifest}, or rotation "
                f"statistics, got {name!r}; there are: {', '.join([*numeric, *ROTATIONS])}"
            )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _check_recordings(recordings: Sequence[Recording], recipe: Recipe) -> Iterator[str]:
    """Try out what a build does to every recording, but for what takes long."""
    for recording in recordings:
        try:
            ready = condition(recording, recipe.conditioning)
            fade(ready.acceleration, ready.rate_hz, fade_s=recipe.fade_s)
            if recipe.anchors:
                quietest_hz(ready)
        except ValueError as error:
            yield f"recording {recording.name!r}: {error}"


def _check_pictures(study: StudyFolder, settings: Settings) -> list[str]:
    return [
        f"recording {entry.title!r}: {study.path / entry.picture}: no such picture; put it there"
        for entry in settings.recordings
        if entry.picture and not (study.path / entry.picture).is_file()
    ]


def _check_texts(study: StudyFolder, settings: Settings) -> list[str]:
    from feel321.study.screen.layout import find_overflows
    from feel321.study.screen.view import make_screen_texts

    language = find_language(settings, study.path)
    try:
        texts = read_study_texts(settings, study.path)
        questions = make_design(settings, study.path).questions
    except OSError as error:
        return [
            f"{error.filename}: {error.strerror}; put your texts there, or name a language of the catalogue"
        ]
    except ValueError as error:
        return str(error).splitlines()
    return [
        f"texts in {language}: {problem}"
        for problem in find_overflows(
            make_screen_texts(texts),
            make_scales(texts).values(),
            questions,
            together={name for table in settings.tasks.values() for name in table.scales},
        )
    ]


def _check_conditions(
    study: StudyFolder, settings: Settings, recordings: Sequence[Recording], *, now: Clock
) -> tuple[Rig | None, Problems]:
    """Check the rig, and compare the study with that of the paper which it replicates, if it does."""
    rig, rigged = _check_rig(study, settings, now=now)
    return rig, compare_with_paper(settings, recordings, rig, found=rigged)


def _check_rig(
    study: StudyFolder, settings: Settings, *, now: Clock
) -> tuple[Rig | None, Problems]:
    """Check the rig, where there is one, and its certificate. An unusable rig is None."""
    from feel321.study.sessions import list_rig_problems  # brings the ledger's database

    if not study.rig.is_file():
        return None, Problems()
    try:
        rig = read_rig(study.rig)
    except ValueError as error:
        return None, Problems(tuple(str(error).splitlines()))
    try:
        find_mix(rig)
    except ValueError as error:
        return None, Problems((f"{study.rig.name}: {error}",))
    certificate, calibrated = _check_certificate(study, settings, rig, now=now)
    try:
        stimuli = read_stimuli(study.stimuli)
    except (OSError, ValueError):
        return rig, calibrated  # not built yet, or damaged, which is found by itself
    problems = list_rig_problems(
        study, rig, settings=settings, stimuli=stimuli, certificate=certificate
    )
    return rig, replace(calibrated, problems=(*calibrated.problems, *problems))


def _check_certificate(
    study: StudyFolder, settings: Settings, rig: Rig, *, now: Clock
) -> tuple[Certificate | None, Problems]:
    """Find the certificate that a session would use, or why there is none; a rig of files needs none."""
    own = settings.rig
    certificate, faults = judge_certificates(study.path, rig, now=now(), rate_hz=own.rate_hz)
    lines = tuple(f"{study.rig.name}: {fault}" for fault in faults)
    if certificate is not None:
        until = f"valid until {certificate.expires_utc[:10]}"
        note = f"{study.rig.name}: certificate {certificate.id} ({certificate.method}), {until}"
        return certificate, Problems(notes=(note,))
    if own.certificate == "require":
        return None, Problems(problems=lines)
    needs_one = rig.device.name != FILE_DEVICE or list_certificates(study.path)
    return None, Problems(warnings=lines if needs_one else ())


def find_warnings(study: StudyFolder, settings: Settings) -> list[str]:
    """Find what is allowed in a study and still worth knowing."""
    remarks = [f"{study.settings.name}: {remark}" for remark in list_remarks(settings)]
    language = find_language(settings, study.path)
    if isinstance(language, Path) and (borrowed := list_borrowed(language)):
        remarks.append(
            f"{settings.session.language}: has no {', '.join(borrowed)}; the catalogue's is shown there"
        )
    if settings.session.order != "random" or not study.stimuli.exists():
        return remarks
    plan = make_plan(
        make_design(settings), read_stimuli(study.stimuli), "check", number=1, simulated=False
    )
    return remarks + [f"order 'random': {line}" for line in find_crowding(plan.trials)]
