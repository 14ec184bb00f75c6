"""Steps of a study before the sessions: check and build."""

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from inspect import signature
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from feel321 import intake
from feel321.doors import announce, follow
from feel321.jobs import Workers
from feel321.protocols.order import find_crowding
from feel321.protocols.texts import list_borrowed, make_scales
from feel321.protocols.trial import CHOOSING, Item
from feel321.stimuli.condition import condition, fade
from feel321.stimuli.match import HIGHEST_HZ
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.anchors import weigh_bands
from feel321.stimuli.sets.build import (
    Facts,
    Foreseen,
    Survey,
    build_set,
    find_copies,
    place_surveyed,
    read_history,
    survey_recording,
)
from feel321.stimuli.sets.manifest import StimulusSet, check_stimuli, read_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.sets.unread import Unread
from feel321.study import strength
from feel321.study.actuator.certificate import Certificate, judge_certificates, list_certificates
from feel321.study.actuator.render import find_mix
from feel321.study.actuator.rig import FILE_DEVICE, Rig, read_rig
from feel321.study.checkpoints import declaring
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
    list_unread,
    make_design,
    make_recipe,
    read_settings,
    read_study_texts,
)
from feel321.study.settings.schema import Settings, count_groups

Progress = Callable[[int, int], None]


def build_study(
    study: StudyFolder,
    *,
    workers: int | Workers = 1,
    page: bool = True,
    progress: Progress | None = None,
) -> tuple[list[Facts], StimulusSet]:
    """Build the stimulus set of a study, and its page; also gives what was found of its recordings."""
    settings = read_settings(study.settings)
    sources = list_unread(settings, study.path)
    recipe = make_recipe(settings, study.path)
    _protect_used_set(study, recipe, sources)
    with declaring(study, "build"):
        with follow(progress or False, "build") as move:
            facts, stimuli = build_set(sources, study.stimuli, recipe, workers=workers, move=move)
        if page:
            from feel321.analysis.browser import write_stimulus_page

            announce("page of the set")
            write_stimulus_page(study.stimuli)
        elif (study.stimuli / "index.html").exists():
            from feel321.analysis.browser import remove_stimulus_page

            remove_stimulus_page(study.stimuli)
    return facts, stimuli


def _protect_used_set(study: StudyFolder, recipe: Recipe, sources: Sequence[Unread]) -> None:
    """Refuse to replace a set that sessions were run with, or may have been."""
    if not study.stimuli.exists() or not any(study.sessions.glob(f"*/{PLAN_FILE}")):
        return
    digests = dict(map(_digest_unread, sources))
    try:
        sha256 = read_stimuli(study.stimuli).sha256
        changes = find_changes(study.stimuli, recipe, digests)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{study.stimuli}: sessions may have been run with this set, which cannot be read ({error}); "
            f"restore it from a copy, or move {study.sessions} away"
        ) from None
    if changes and is_in_use(study, sha256):
        remedy = f"sessions were run with this set; make a new study, or move {study.sessions} away"
        raise ValueError("\n".join(f"{change}; {remedy}" for change in changes))


def _digest_unread(source: Unread) -> tuple[str, str | None]:
    """Digest a recording; None if it cannot be read, which is reported by itself."""
    try:
        return source.name, source.read().sha256
    except (OSError, TypeError, ValueError):
        return source.name, None


# Everything that stands in the way of a study, found in one go.


@dataclass(frozen=True, slots=True)
class _Examined:
    """What one look at each recording gave; faults: why some cannot be read; problems: why some cannot be used."""

    surveyed: tuple[Survey, ...] = ()
    covariances: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def facts(self) -> list[Facts]:
        return [one.facts for one in self.surveyed if one.facts]


def check_study(
    study: StudyFolder, *, progress: Progress | None = None, now: Clock = utc_now
) -> Problems:
    """Check settings, recordings, pictures, texts, strength of the stimuli, rig and, once built, the stimulus set."""
    try:
        settings = read_settings(study.settings)
    except ValueError as error:
        return Problems(tuple(str(error).splitlines()))
    recipe, unusable = _try_recipe(study, settings)
    examined = _examine(study, settings, None if unusable else recipe, progress=progress)
    rig, rigged = _check_conditions(study, settings, examined.facts, now=now)
    problems = [
        *examined.faults,
        *_check_pictures(study, settings),
        *_check_texts(study, settings),
        *rigged.problems,
        *examined.problems,
        *unusable,
    ]
    found = Problems()
    if recipe is not None and not (examined.faults or examined.problems or unusable):
        try:
            found = _find_strength(study, settings, examined, recipe=recipe, rig=rig)
        except ValueError as error:
            problems.append(str(error))
    problems += found.problems
    if study.stimuli.exists():
        problems += _check_set(study, settings, examined.facts, recipe=recipe)
    elif study.participants:
        problems.append(
            f"{study.stimuli}: missing, but sessions were run with it; put it back or build it again"
        )
    return replace(
        found,
        problems=tuple(problems),
        warnings=found.warnings
        + rigged.warnings
        + tuple([] if problems else find_warnings(study, settings, examined.facts)),
        notes=rigged.notes + found.notes,
        remarks=tuple(f"{one.name}: {text}" for one in examined.facts for text in one.warnings),
    )


def _try_recipe(study: StudyFolder, settings: Settings) -> tuple[Recipe | None, list[str]]:
    try:
        recipe = make_recipe(settings, study.path)
    except ValueError as error:
        return None, [f"{study.settings.name}: {error}"]
    return recipe, _check_methods(study, settings)


def _examine(
    study: StudyFolder, settings: Settings, recipe: Recipe | None, *, progress: Progress | None
) -> _Examined:
    """Read each recording once, try out what a build does to it, and measure its stimuli; keep no samples."""
    history, sources = read_history(study.stimuli), list_unread(settings, study.path)
    surveyed: list[Survey] = []
    covariances: dict[str, NDArray[np.float64]] = {}
    problems: list[str] = []
    for done, source in enumerate(sources, start=1):
        try:
            recording = source.read()
        except (OSError, TypeError, ValueError) as error:
            surveyed.append(Survey(None, {}, f"recording {source.name!r}: {error}"))
            continue
        own = Survey(Facts.find(recording), {})
        try:
            if recipe is not None:
                covariances[source.name] = _try_recording(recording, recipe)
                known = history[source.name].measured
                found = survey_recording(recording, known, recipe=recipe)
                own = found if found.facts else own
                problems += [found.fault] if found.fault else []
        except ValueError as error:
            problems.append(str(error))
        surveyed.append(own)
        if progress:
            progress(done, len(sources))
    faults = tuple(one.fault for one in surveyed if one.fault)
    return _Examined(tuple(surveyed), covariances, faults, tuple(problems))


def _try_recording(recording: Recording, recipe: Recipe) -> NDArray[np.float64]:
    """Try out what a build does to a recording, but for what takes long; returns the covariance of its axes."""
    try:
        ready = condition(recording, recipe.conditioning)
        fade(ready.acceleration, ready.rate_hz, fade_s=recipe.fade_s)
        if recipe.anchors:
            weigh_bands(ready)
    except ValueError as error:
        raise ValueError(f"recording {recording.name!r}: {error}") from None
    return np.asarray(np.einsum("in,jn->ij", ready.acceleration, ready.acceleration))


def _check_methods(study: StudyFolder, settings: Settings) -> list[str]:
    """Check the form of the lab's own reducers, metrics and screening rules, as far as that is quick."""
    from feel321.analysis.screening.rules import find_rules, make_rule
    from feel321.stimuli.conform import check_method

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
    study: StudyFolder, settings: Settings, examined: _Examined, *, recipe: Recipe, rig: Rig | None
) -> Problems:
    """Find out how strong stimuli are, how long a session takes, and, with a rig, how it brings them to the hand."""
    foreseen = place_surveyed(examined.surveyed, recipe)
    found = strength.find_strength(settings, foreseen, recipe)
    found = _add_minutes(found, settings, examined.facts, foreseen=foreseen)
    is_built = study.manifest.exists()  # then its files are examined themselves
    problems = [*found.problems, *([] if is_built else strength.find_clipping(foreseen, recipe))]
    if rig is None:
        return replace(found, problems=tuple(problems))
    name = study.rig.name
    limits = [] if is_built else strength.find_rig_limits(rig, foreseen, recipe.reference)
    reach = strength.find_reach(rig, examined.covariances, recipe)
    return Problems(
        problems=(*problems, *(f"{name}: {line}" for line in limits)),
        warnings=(*found.warnings, *(f"{name}: {line}" for line in reach.warnings)),
        notes=(*(f"{name}: {line}" for line in reach.notes), *found.notes),
        figures={**found.figures, **reach.figures},
    )


def _add_minutes(
    found: Problems,
    settings: Settings,
    recordings: Sequence[Facts],
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
    study: StudyFolder, settings: Settings, recordings: Sequence[Facts], *, recipe: Recipe | None
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

    with intake.open_text(study.manifest) as file:
        known = dict.fromkeys(csv.DictReader(file).fieldnames or (), False)
        file.seek(0)
        for row in csv.DictReader(file):
            known |= {
                name: True for name, seen in known.items() if not seen and _is_number(row[name])
            }
    numeric = [name for name, seen in known.items() if seen]
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
    study: StudyFolder, settings: Settings, recordings: Sequence[Facts], *, now: Clock
) -> tuple[Rig | None, Problems]:
    """Check the rig, and compare the study with that of the paper which it replicates, if it does."""
    rig, rigged = _check_rig(study, settings, now=now)
    return rig, compare_with_paper(settings, recordings, rig, found=rigged)


def _check_rig(
    study: StudyFolder, settings: Settings, *, now: Clock
) -> tuple[Rig | None, Problems]:
    """Check the rig, where there is one, and its certificate. An unusable rig is None."""
    from feel321.study.sessions import list_rig_problems

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


def find_warnings(
    study: StudyFolder, settings: Settings, recordings: Sequence[Facts] = ()
) -> list[str]:
    """Find what is allowed in a study and still worth knowing."""
    remarks = [f"{study.settings.name}: {remark}" for remark in list_remarks(settings)]
    remarks += find_copies(recordings)
    remarks += _find_slow(settings, recordings)
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


LEAST_WINDOW = 16
"""Samples: the main lobe is 3 bins wide, so offset and Nyquist frequency reach 4 of 9 bins; of fewer, half or more."""


def _find_slow(settings: Settings, recordings: Sequence[Facts]) -> Iterator[str]:
    """Name recordings whose rate narrows the band of the matches, or leaves windows few samples."""
    windowed = [
        name
        for name in settings.stimuli.reducers
        if name in REDUCERS and "window_s" in signature(REDUCERS[name]).parameters
    ]
    for one in recordings:
        where = f"recording {one.name!r}, at {one.rate_hz:g} Hz"
        if (high_hz := one.rate_hz / 2) < HIGHEST_HZ:
            yield (
                f"{where}: holds nothing above {high_hz:g} Hz, so its matches compare less than 20 to "
                f"{HIGHEST_HZ:g} Hz; use a recording of {2 * HIGHEST_HZ:g} Hz or more, or report the band"
            )
        samples = window_samples(DEFAULT_WINDOW_S, one.rate_hz)
        if windowed and samples < LEAST_WINDOW:
            yield (
                f"{where}: a window of {1e3 * DEFAULT_WINDOW_S:g} ms has {samples} samples, {LEAST_WINDOW} are the "
                f"least that resolve a spectrum; leave out {', '.join(windowed)}, or record faster"
            )
