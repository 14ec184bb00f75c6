"""Read and edit `study.toml`; turn it into recordings, recipe, texts and design; check it as a whole."""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from difflib import get_close_matches
from itertools import product
from pathlib import Path
from typing import Any

from feel321 import intake
from feel321.doors import describe, name_of, refuse_name
from feel321.extensions import Method, find_method, is_given
from feel321.files import create_text, make_folder, temporary_folder, write_text
from feel321.names import METRIC_INFO, WRITTEN
from feel321.protocols.tasks import PROTOCOLS, digest_protocols
from feel321.protocols.texts import MODEL, Question, read_ready, read_texts
from feel321.protocols.trial import CHOOSING, SURFACE, Flow, Item, Task, select_group
from feel321.stimuli.condition import Conditioning
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.recipe import NO_REFERENCE, ORIGINAL, Recipe, Unread, check_names
from feel321.stimuli.synthesis import make_scene
from feel321.study import admission
from feel321.study.folder import TEMPLATES, StudyFolder
from feel321.study.session.journal import digest
from feel321.study.session.opening import identify_frozen
from feel321.study.session.plan import Design
from feel321.study.session.ports import Surface
from feel321.study.settings.fields import parse_toml
from feel321.study.settings.schema import (
    LANGUAGE_FILE,
    SCENE_RATE_HZ,
    RecordingTable,
    Settings,
    TaskTable,
)

MOST_TRIALS = 10_000
"""Trials in a session; people do a few hundred, simulated participants somewhat more."""


def read_settings(path: Path, folder: Path | None = None) -> Settings:
    """Read and check a `study.toml`; folder: of the study, where the file is no more than a draft of its settings.

    Protocols and metrics of the lab's own have their short names in it.
    """
    settings = parse_toml(path, Settings)
    session, home = settings.session, folder or path.parent
    entries: list[RecordingTable] = []
    for number, entry in enumerate(settings.recordings, start=1):
        try:
            entries += entry.list_entries(home)
        except (NotImplementedError, ValueError) as error:
            raise ValueError(f"{path.name}: recordings[{number}].files {error}") from None
    try:
        check_names([entry.title for entry in entries])
        names = admission.admit_protocols(session.protocols, home)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path.name}: {error}") from None
    name = settings.study.name or home.resolve().name
    settings = settings.model_copy(
        update={
            "study": settings.study.model_copy(update={"name": name}),
            "recordings": tuple(entries),
            "session": session.model_copy(update={"protocols": names}),
        }
    )
    settings = _declare_metrics(settings)
    if mistakes := find_conflicts(settings):
        raise ValueError("\n".join(f"{path.name}: {mistake}" for mistake in mistakes))
    return settings


def _declare_metrics(settings: Settings) -> Settings:
    """Let a build measure the metrics that only the analysis names, which knows all by their short names."""
    wanted, measured = settings.analysis.metrics, settings.stimuli.metrics
    coded = {name: one.use for name, one in settings.metrics.items() if one.use or one.command}
    known = {*measured, *map(name_of, measured), *(coded.get(name) for name in measured), *WRITTEN}
    lacking = [name for name in wanted if name not in known]
    new = [name for name in lacking if name in METRICS or is_given("metric", name, coded)]
    short = tuple(dict.fromkeys(map(name_of, wanted)))
    tables = {
        "stimuli": settings.stimuli.model_copy(update={"metrics": (*measured, *new)}),
        "analysis": settings.analysis.model_copy(update={"metrics": short}),
    }
    return settings.model_copy(update=tables)


def change_settings(text: str, changes: Mapping[str, object]) -> str:
    r"""Change settings by their dotted names; None takes a setting out, so that its default holds.

    Examples
    --------
    >>> print(change_settings("[rig]\nheadroom = 0.9  # of full scale", {"rig.headroom": 0.5}))
    [rig]
    headroom = 0.5  # of full scale
    """
    import tomlkit

    document = tomlkit.parse(text)
    for name, value in changes.items():
        if not re.fullmatch(r"[\w-]+(\.[\w-]+)+", name):
            raise ValueError(f"settings must have names such as 'session.repeats', got {name!r}")
        *tables, key = name.split(".")
        place: Any = document
        for table in tables:
            if value is not None and table not in place:
                place[table] = tomlkit.table()
            place = place.get(table, {})
            if not isinstance(place, dict):
                where = f"{name}: {table} is not a table of settings"
                raise ValueError(f"{where}; edit study.toml")  # noqa: TRY004 - of the file
        before = place.get(key)
        if value is None:
            place.pop(key, None)
        else:
            place[key] = item = tomlkit.item(_make_plain(name, value))
            if hasattr(before, "trivia"):  # the comment behind it stays
                item.trivia.comment = before.trivia.comment
                item.trivia.comment_ws = before.trivia.comment_ws
    return tomlkit.dumps(document)


def _make_plain(name: str, value: object) -> Any:  # noqa: ANN401 - whatever TOML holds
    """Make lists of tuples and Python's numbers of NumPy's; refuse what TOML cannot hold."""
    try:
        return json.loads(json.dumps(value, allow_nan=False, default=lambda one: one.tolist()))
    except (AttributeError, TypeError, ValueError):
        allowed = "text, a number, true or false, or a list or table of these"
        raise ValueError(f"{name} must be {allowed}; got {describe(value)}") from None


def edit_settings(path: Path, changes: Mapping[str, object]) -> None:
    """Change settings in a `study.toml`, which is left as it is if a setting is refused."""
    read_settings(path)
    before = intake.read_small(path)
    newline = "\r\n" if "\r\n" in before else "\n"
    text = change_settings(before.replace("\r\n", "\n"), changes).replace("\n", newline)
    with temporary_folder() as folder:
        write_text(folder / path.name, text)
        read_settings(folder / path.name, path.parent)
    write_text(path, text)


def add_methods(study: StudyFolder) -> None:
    """Add an example of every kind of method of a lab's own to a study that was just begun."""
    home = study.path / "methods"
    make_folder(home)
    for entry in (TEMPLATES / "methods").iterdir():
        if entry.name.endswith(".py.txt"):
            create_text(home / entry.name.removesuffix(".txt"), entry.read_text(encoding="utf-8"))
    taps = [100 * 0.9 ** (n % 250) * (-1) ** (n // 4) for n in range(2000)]
    lines = ["x,y,z", *(f"{0.4 * one:.4f},{-0.3 * one:.4f},{one:.4f}" for one in taps)]
    create_text(study.path / "recordings" / "tap.csv", "\n".join(lines) + "\n")
    changes = {
        "stimuli.reducers": ["say321", "pca321", "dft321", "my321", "wav321"],
        "stimuli.metrics": ["snr"],
        "session.protocols": ["realism", "similarity", "methods/roughness.py:roughness"],
    }
    text = change_settings(intake.read_small(study.settings), changes)
    tables = (TEMPLATES / "methods" / "tables.toml").read_text(encoding="utf-8")
    write_text(study.settings, text + tables)


# From settings to signals: recordings and the recipe for the stimuli.


def list_surfaces(settings: Settings, folder: Path) -> dict[str, Surface]:
    """List the surfaces that participants touch or see, by the names of their recordings."""
    return {
        entry.title: Surface(entry.sample, folder / entry.picture if entry.picture else None)
        for entry in settings.recordings
    }


def list_origins(settings: Settings) -> dict[str, str]:
    """List what recordings were made from: one source, rotated, gives recordings that are not independent."""
    return {
        entry.title: f"{entry.scene} {entry.seed}" if entry.scene else entry.file or ""
        for entry in settings.recordings
    }


def open_recordings(settings: Settings, folder: Path) -> list[Recording]:
    """Read every recording of a study; all that cannot be read are named at once."""
    recordings: list[Recording] = []
    mistakes: list[str] = []
    for source in list_unread(settings, folder):
        try:
            recordings.append(source.read())
        except (OSError, TypeError, ValueError) as error:
            mistakes.append(f"recording {source.name!r}: {error}")
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return recordings


def list_unread(settings: Settings, folder: Path) -> list[Unread]:
    """List the recordings of a study as they are to be read."""
    return [Unread(entry.title, open_entry, (entry, folder)) for entry in settings.recordings]


def open_entry(entry: RecordingTable, folder: Path) -> Recording:
    """Read a recording as its table says."""
    path = folder / (entry.file or "")
    own = entry.model_dump(include={"rate_hz", "unit", "columns", "full_scale", "resample"})
    if entry.scene:
        length = {"rate_hz": entry.rate_hz or SCENE_RATE_HZ, "duration_s": entry.duration_s}
        recording = make_scene(entry.scene, rng=entry.seed, **length)
    else:
        recording = read_recording(path, **own)
    return recording if entry.rotation is None else turn_recording(recording, entry.rotation)


def turn_recording(recording: Recording, rotation: int) -> Recording:
    """Turn a recording, before any other step, as if its sensor had been mounted in another orientation.

    The number seeds an orientation uniform over all rotations: the same number turns every recording alike.
    """
    import numpy as np

    from feel321.stimuli.rotation import random_rotations

    turn = random_rotations(1, np.random.default_rng(rotation))[0]
    turned = np.einsum("ij,jn->in", turn, recording.acceleration)
    sha256 = hashlib.sha256(f"{recording.sha256} rotation {rotation}".encode()).hexdigest()
    return replace(recording, acceleration=turned, sha256=sha256)


def make_recipe(settings: Settings, folder: Path | None = None) -> Recipe:
    """Make the recipe of the stimuli: each setting of `[stimuli]` and `[rig]` is a field of it by name.

    folder: of the study, where files of its own reducers and metrics are; the current one if left out.
    """
    stimuli = settings.stimuli.model_dump(exclude={"conditioning", "below_threshold"})
    own = {
        "reducers": [find_reducer(settings, name, folder) for name in settings.stimuli.reducers],
        "metrics": [find_metric(settings, name, folder) for name in settings.stimuli.metrics],
        "reference": find_reducer(settings, settings.stimuli.reference, folder),
    }
    steps = Conditioning(**settings.stimuli.conditioning.model_dump())
    rig, seed = settings.rig.of_stimuli(), settings.study.seed
    return Recipe(conditioning=steps, **(stimuli | own), **rig, seed=seed)


def find_reducer(settings: Settings, name: str, folder: Path | None) -> str | Method:
    """Find one of the lab's own reducers; a name of feel321's stays a name."""
    declared = {key: table.to_facts() for key, table in settings.reducers.items()}
    if name in {*REDUCERS, ORIGINAL, NO_REFERENCE}:
        return name
    return find_method("reducer", name, taken=REDUCERS, folder=folder, declared=declared)


def find_metric(settings: Settings, name: str, folder: Path | None) -> str | Method:
    """Find one of the lab's own metrics; a name of feel321's stays a name."""
    declared = {key: table.to_facts() for key, table in settings.metrics.items()}
    if name in METRICS:
        return name
    return find_method("metric", name, taken=METRICS, folder=folder, declared=declared)


# From settings to sessions: texts, design, and what a journal's header says of them.

CONSENT = "consent"
"""The page whose text a lab can set by itself."""


def find_language(settings: Settings, folder: Path) -> str | Path:
    """Find the texts of a study: the name of a language, or the path of the lab's own file."""
    language = settings.session.language
    return folder / language if language.endswith(LANGUAGE_FILE) else language


def read_study_texts(settings: Settings, folder: Path) -> dict[str, Any]:
    """Read all texts of a study, the lab's own scales and consent among them."""
    language = find_language(settings, folder)
    texts = read_texts(language)
    if mute := list(_find_mute_scales(settings, texts["scales"])):
        raise ValueError("\n".join(f"study.toml: {line} (here, or in {language})" for line in mute))
    texts["scales"] |= {name: table.to_texts() for name, table in settings.scales.items()}
    admission.add_texts(texts, settings.session.protocols)
    if consent := settings.session.consent:
        texts["pages"][CONSENT]["text"] = consent
    return texts


def make_design(settings: Settings, folder: Path | None = None) -> Design:
    """Make the design: all that a study decides about the sessions of its participants.

    folder: that of the study, where a file of its own may hold the texts of ready questions.
    """
    session = settings.session
    rehearsal = session.rehearsal.model_dump(by_alias=True)
    rounds = {name: rehearsal.pop(name) for name in ("training", "practice")}
    tables = {name: settings.tasks.get(name, TaskTable()) for name in session.protocols}
    breaks, quality = session.breaks.model_dump(by_alias=True), session.quality.model_dump()
    questions: list[Question] = []
    for table in session.questions:
        if table.use:
            texts = read_texts(MODEL if folder is None else find_language(settings, folder))
            questions += read_ready(table.use, texts, when=table.when)
        else:
            questions.append(table.make_question())
    return Design(
        seed=settings.study.seed,
        order=session.order,
        task_order=session.task_order,
        repeats=session.repeats,
        recordings_per_participant=session.recordings_per_participant,
        tasks=tuple(table.make_task(name, **rounds) for name, table in tables.items()),
        between=dict(settings.between),
        flow=Flow(**rehearsal, **breaks, **quality),
        threshold=session.threshold.make_block() if session.threshold else None,
        matching=session.matching.make_block(settings.stimuli.levels) if session.matching else None,
        questions=tuple(questions),
    )


def make_identity(
    settings: Settings,
    folder: Path,
    presenter: dict[str, Any],
    *,
    calibration: dict[str, str] | str | None = None,
) -> dict[str, Any]:
    """List what must not change within a session besides its plan, for the header of its journal.

    calibration: identity of the rig's certificate, or that there is none; None where no rig plays.
    """
    texts = read_study_texts(settings, folder)
    methods = {one.name: one.sha256 for one in make_recipe(settings, folder).methods}
    methods |= digest_protocols(settings.session.protocols)
    return {
        "locale": settings.session.language,
        "texts_sha256": digest(json.dumps(texts, sort_keys=True)),
        "consent": texts["pages"][CONSENT]["text"],
        "rig": settings.rig.of_stimuli(),
        "calibration": calibration,
        "presenter": presenter,
        **({"methods": methods} if methods else {}),
        **identify_frozen(folder),
    }


def make_terms(design: Design, settings: Settings, folder: Path) -> dict[str, Any]:
    """List what all stations of a study have to agree on, as JSON can hold it: all that decides about the sessions."""
    own = asdict(design)
    own["tasks"] = {task["protocol"]: task for task in own["tasks"]}
    identity = make_identity(settings, folder, {})
    return own | {name: identity.get(name) for name in ("locale", "texts_sha256", "rig", "methods")}


# What each table of `study.toml` may say by itself, but not together with the others.


def find_conflicts(settings: Settings) -> list[str]:
    """Find settings that do not go together."""
    # A mistake is reported where it is made, not again, and less clearly, in what follows from it.
    checks = (
        _check_methods, _check_metrics, _check_stimuli, _check_tasks, _check_scales, _check_between,
    )  # fmt: skip
    if found := [line for check in checks for line in check(settings)]:
        return found
    tasks = make_design(settings).tasks
    return list(dict.fromkeys(_check_comparisons(settings, tasks))) or list(
        _check_length(settings, tasks)
    )


def _check_methods(settings: Settings) -> Iterator[str]:
    """Refuse tables that would replace a method of feel321's: they would be left unread."""
    taken = {"reducers": {*REDUCERS, ORIGINAL, NO_REFERENCE}, "metrics": METRICS}
    for kind, names in taken.items():
        for name, table in getattr(settings, kind).items():
            if name in names and (kind == "reducers" or table.use or table.command):
                yield f"{kind}.{name}: the name is taken by one of feel321's own; give yours another"
    for name, table in settings.metrics.items():
        if name in METRIC_INFO and table.higher not in {None, METRIC_INFO[name].higher}:
            right = METRIC_INFO[name].higher
            yield f"metrics.{name}.higher must be {right!r} for this metric, got {table.higher!r}; remove it"


def _check_metrics(settings: Settings) -> Iterator[str]:
    """Refuse unknown names of further metrics; a lab's own is not imported yet."""
    further = [name for name in METRICS if name not in WRITTEN]
    for number, name in enumerate(settings.stimuli.metrics, start=1):
        if name in WRITTEN:
            yield f"stimuli.metrics[{number}] must be a further metric, got {name!r}, which every set has; remove it"
        elif name not in METRICS and not is_given("metric", name, settings.metrics):
            yield refuse_name(name, further, f"stimuli.metrics[{number}]")


def _check_stimuli(settings: Settings) -> Iterator[str]:
    """Check that there is what is to be compared or matched."""
    stimuli, matching = settings.stimuli, settings.session.matching
    if (reference := stimuli.reference) in stimuli.reducers:
        rule = "must not be one of stimuli.reducers too"
        yield f"stimuli.reference {rule}, got {reference!r}; take it out of the reducers"
    if matching and matching.level not in {None, *stimuli.levels}:
        rule = f"must be one of stimuli.levels, got {matching.level!r}"
        yield f"session.matching.level {rule}; add it there"
    if matching and reference == NO_REFERENCE:
        yield f"session.matching needs a reference, got stimuli.reference = {reference!r}; set another one"


def _check_tasks(settings: Settings) -> Iterator[str]:
    """Try each setting of a task by itself, so that every mistake is found; then all together."""
    for name, table in settings.tasks.items():
        alone = [TaskTable(**{key: value}) for key, value in table if key in table.model_fields_set]
        faults = []
        for one in (*alone, table):
            try:
                one.make_task(name)
            except ValueError as error:
                faults.append(str(error))
        yield from dict.fromkeys(faults[:-1] or faults)


def _check_scales(settings: Settings) -> Iterator[str]:
    """Check that every scale has its words; those in a file of the lab's own are found when it is read."""
    if not settings.session.language.endswith(LANGUAGE_FILE):
        yield from _find_mute_scales(settings, read_texts(settings.session.language)["scales"])


def _find_mute_scales(settings: Settings, texts: Mapping[str, Any]) -> Iterator[str]:
    """Find scales that are asked and have no words, and words for scales that are no sliders."""
    for name in settings.scales:
        if texts.get(name, {}).get("choices"):
            yield f"scales.{name}: must not be set, the answer to {name} is a choice; remove it"
    known = {*texts, *settings.scales}
    asked = [(task, name) for task, table in settings.tasks.items() for name in table.scales]
    for task, name in asked:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}? Or " if near else ""
            remedy = f"{hint}add [scales.{name}] with question, low and high"
            yield f"tasks.{task}.scales: {name!r} has no words; {remedy}"


def _check_between(settings: Settings) -> Iterator[str]:
    places = {
        "level": ("stimuli.levels", settings.stimuli.levels),
        "protocol": ("session.protocols", settings.session.protocols),
    }
    for factor, (place, allowed) in places.items():
        for name in settings.between.get(factor, ()):
            if name not in allowed:
                rule = f"must be one of {', '.join(allowed)}, got {name!r}"
                yield f"between.{factor} {rule}; or add it to {place}"


def _check_comparisons(settings: Settings, tasks: tuple[Task, ...]) -> Iterator[str]:
    """Check that surfaces have names, and that the stimuli to be built are what the tasks need."""
    on_surfaces = [task.protocol for task in tasks if task.surface or task.reference == SURFACE]
    for number, recording in enumerate(settings.recordings, start=1):
        if on_surfaces and not recording.sample:
            yield (
                f"recordings[{number}].sample: missing, but participants touch the real surface in "
                f"{' and '.join(on_surfaces)}; add the name that it has in the lab"
            )
    for items, own in _list_groups(settings, tasks):
        for task in own:
            try:
                PROTOCOLS[task.protocol].make_lessons(items, task)
                PROTOCOLS[task.protocol].compare(items, task)
            except (TypeError, ValueError) as error:
                yield f"tasks.{task.protocol}: {error}"


def _check_length(settings: Settings, tasks: tuple[Task, ...]) -> Iterator[str]:
    """Count the trials of each group, which are as many for each recording."""
    everything, share = len(settings.recordings), settings.session.recordings_per_participant
    if share and share > everything:
        yield (
            f"session.recordings_per_participant must be at most the {everything} recordings of the study, "
            f"got {share}; leave it out, and everybody feels them all"
        )
    repeats = settings.session.repeats
    trials = max(
        sum(len(PROTOCOLS[task.protocol].compare(items, task)) for task in own)
        for items, own in _list_groups(settings, tasks)
    ) * (repeats * (share or everything))
    if trials > MOST_TRIALS:
        yield (
            f"a session must have at most {MOST_TRIALS} trials, got {trials} with session.repeats = {repeats}; use "
            "fewer repeats, reducers or recordings, or let each participant feel a share of them: "
            "session.recordings_per_participant"
        )


def _list_groups(
    settings: Settings, tasks: tuple[Task, ...]
) -> Iterator[tuple[tuple[Item, ...], tuple[Task, ...]]]:
    """List the stimuli, as built from the first recording, and the tasks of the groups that differ in them."""
    from feel321.stimuli.sets.recipe import ANCHORS

    stimuli, recording = settings.stimuli, settings.recordings[0].title
    made = [(name_of(name), "test") for name in stimuli.reducers]
    made += [(name_of(stimuli.reference), "reference")] * (stimuli.reference != NO_REFERENCE)
    made += [(name, "anchor") for name in ANCHORS] * stimuli.anchors
    items = [
        Item(f"{recording}-{role}-{reducer}-{level}", recording, reducer, level, role)
        for level in stimuli.levels
        for reducer, role in made
    ]
    factors = {name: settings.between[name] for name in CHOOSING if name in settings.between}
    for levels in product(*factors.values()):
        yield select_group(items, tasks, dict(zip(factors, levels, strict=True)))
