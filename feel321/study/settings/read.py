"""Read and edit `study.toml`; turn it into recordings, methods, recipe, texts and design; check it as a whole."""

import hashlib
import json
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, fields, replace
from difflib import get_close_matches
from inspect import signature
from itertools import product
from pathlib import Path
from shlex import quote
from typing import Any

from feel321.arguments import describe, name_of, refuse_name
from feel321.extensions import FORMS, Method, find_method, is_given, list_entry_points
from feel321.files import create_text, make_folder, read_small, temporary_folder, write_text
from feel321.protocols.tasks import PROTOCOLS, digest_protocols
from feel321.protocols.texts import read_texts
from feel321.protocols.threshold import MatchingBlock
from feel321.protocols.trial import CHOOSING, SURFACE, Flow, Item, Task, select_group
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.own_methods import OwnMetric, OwnReducer
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets import render
from feel321.stimuli.sets.manifest import read_details
from feel321.stimuli.sets.recipe import (
    NO_REFERENCE,
    ORIGINAL,
    Recipe,
    StimulusSettings,
    Unread,
    check_names,
    describe_recipe,
)
from feel321.study import own_protocols
from feel321.study.folder import SETTINGS_FILE, TEMPLATES, StudyFolder
from feel321.study.session.journal import digest
from feel321.study.session.opening import flatten, identify_frozen
from feel321.study.session.plan import Design
from feel321.study.session.ports import Surface
from feel321.study.settings.fields import parse_toml
from feel321.study.settings.schema import (
    LANGUAGE_FILE,
    SCENE_RATE_HZ,
    MethodTable,
    RecordingTable,
    Settings,
    TaskTable,
)
from feel321.types import ANCHOR_NAMES, METRIC_INFO, WRITTEN, Metric, Reducer

CONSENT = "consent"  # the page whose text a lab can set by itself

MOST_TRIALS = 10_000  # in a session; people do a few hundred, simulated participants some more

Group = tuple[tuple[Item, ...], tuple[Task, ...]]  # what its participants feel, and do


def read_settings(path: Path, folder: Path | None = None) -> Settings:
    """Read and check a `study.toml`; folder: of the study, if the file is a draft. Own methods get short names."""
    settings = parse_toml(path, Settings)
    home = folder or path.parent
    entries: list[RecordingTable] = []
    for number, entry in enumerate(settings.recordings, start=1):
        try:
            entries += entry.list_entries(home)
        except (NotImplementedError, ValueError) as error:
            raise ValueError(f"{path.name}: recordings[{number}].files {error}") from None
    try:
        check_names([entry.title for entry in entries])
        names = own_protocols.admit_protocols(settings.session.protocols, home)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path.name}: {error}") from None
    # A build measures the metrics that only the analysis names, which knows all by their short names.
    wanted, measured = settings.analysis.metrics, settings.stimuli.metrics
    coded = {name: one.use for name, one in settings.metrics.items() if one.use or one.command}
    known = {*measured, *map(name_of, measured), *(coded.get(name) for name in measured), *WRITTEN}
    lacking = [name for name in wanted if name not in known]
    new = [name for name in lacking if name in METRICS or is_given("metric", name, coded)]
    own: dict[str, dict[str, Any]] = {
        "study": {"name": settings.study.name or home.resolve().name},
        "session": {"protocols": names},
        "analysis": {"metrics": tuple(dict.fromkeys(map(name_of, wanted)))},
    }
    tables = {name: getattr(settings, name).model_copy(update=one) for name, one in own.items()}
    stimuli = replace(settings.stimuli, metrics=(*measured, *new))
    tables |= {"stimuli": stimuli, "recordings": tuple(entries)}
    settings = settings.model_copy(update=tables)
    if mistakes := find_conflicts(settings):
        raise ValueError("\n".join(f"{path.name}: {mistake}" for mistake in mistakes))
    return settings


def change_settings(text: str, changes: Mapping[str, object]) -> str:
    """Change settings by their dotted names; None takes a setting out, so that its default holds."""
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
        if value is None:
            place.pop(key, None)
            continue
        item = tomlkit.item(_make_plain(name, value))
        if hasattr(before := place.get(key), "trivia"):  # the comment behind it stays
            item.trivia.comment = before.trivia.comment
            item.trivia.comment_ws = before.trivia.comment_ws
        place[key] = item
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
    before = read_small(path)
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
    text = change_settings(read_small(study.settings), changes)
    tables = (TEMPLATES / "methods" / "tables.toml").read_text(encoding="utf-8")
    write_text(study.settings, text + tables)


# Recordings: read as `[[recordings]]` say, turned, and what they are of.


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


def list_unread(settings: Settings, folder: Path) -> list[Unread]:
    """List the recordings of a study as they are to be read."""
    return [Unread(entry.title, _open_entry, (entry, folder)) for entry in settings.recordings]


def try_recordings(settings: Settings, folder: Path) -> Iterator[tuple[Unread, Recording | str]]:
    """Read each recording of a study in turn; gives its fault instead where it cannot be read."""
    for source in list_unread(settings, folder):
        try:
            yield source, source.read()
        except (OSError, TypeError, ValueError) as error:
            yield source, f"recording {source.name!r}: {error}"


def open_recordings(settings: Settings, folder: Path) -> list[Recording]:
    """Read every recording of a study; all that cannot be read are named at once."""
    found = [one for _, one in try_recordings(settings, folder)]
    if mistakes := [one for one in found if isinstance(one, str)]:
        raise ValueError("\n".join(mistakes))
    return [one for one in found if isinstance(one, Recording)]


def _open_entry(entry: RecordingTable, folder: Path) -> Recording:
    """Read a recording as its table says."""
    from feel321.stimuli.formats.read import read_recording
    from feel321.stimuli.synthesis import make_scene

    if entry.scene:
        rate_hz = entry.rate_hz or SCENE_RATE_HZ
        recording = make_scene(
            entry.scene, rng=entry.seed, rate_hz=rate_hz, duration_s=entry.duration_s
        )
    else:
        own = entry.model_dump(include={"rate_hz", "unit", "columns", "full_scale", "resample"})
        recording = read_recording(folder / (entry.file or ""), **own)
    return recording if entry.rotation is None else turn_recording(recording, entry.rotation)


def turn_recording(recording: Recording, rotation: int) -> Recording:
    """Turn a recording as if its sensor had been mounted in another orientation, which the number seeds."""
    import numpy as np

    from feel321.stimuli.rotation import random_rotations

    turn = random_rotations(1, np.random.default_rng(rotation))[0]
    turned = np.einsum("ij,jn->in", turn, recording.acceleration)
    sha256 = hashlib.sha256(f"{recording.sha256} rotation {rotation}".encode()).hexdigest()
    return replace(recording, acceleration=turned, sha256=sha256)


# Reducers and metrics, by the names that settings and the command line use.


def find_own(settings: Settings, kind: str, name: str, *, folder: Path | None) -> str | Method:
    """Find a reducer or metric of the lab's own; a name of feel321's stays a name."""
    is_metric = kind == "metric"
    taken: Collection[str] = METRICS if is_metric else REDUCERS
    if name in taken or (not is_metric and name in {ORIGINAL, NO_REFERENCE}):
        return name
    tables: Mapping[str, MethodTable] = settings.metrics if is_metric else settings.reducers
    declared = {key: table.to_facts() for key, table in tables.items()}
    return find_method(kind, name, taken=taken, folder=folder, declared=declared)


def open_reducer(name: str, folder: Path) -> Reducer:
    """Open a reducer: feel321's, or one of the study in a folder, of its files, or of an installed package."""
    settings = _read_if_there(folder)
    if name in {ORIGINAL, NO_REFERENCE}:
        allowed = (*REDUCERS, *settings.reducers)
        raise ValueError(f"{refuse_name(name, allowed, 'reducer')}; {FORMS}")
    found = find_own(settings, "reducer", name, folder=folder)
    return REDUCERS[name] if isinstance(found, str) else OwnReducer(found)


def open_metric(name: str, folder: Path) -> Metric:
    """Open a metric likewise."""
    found = find_own(_read_if_there(folder), "metric", name, folder=folder)
    return METRICS[name] if isinstance(found, str) else OwnMetric(found)


def open_method(name: str, folder: Path, kind: str | None = None) -> Method:
    """Open one of the lab's own methods; without a kind, a metric is what takes three arguments."""
    settings = _read_if_there(folder)
    if kind is None and name not in settings.reducers:
        takes_pair = name in {*settings.metrics, *METRICS, *list_entry_points("metric")}
        if ":" in name and not takes_pair:
            own = find_method("reducer", name, folder=folder)
            with suppress(ValueError, TypeError):  # whatever is wrong with it is found again
                takes_pair = len(signature(own.load()).parameters) == 3  # noqa: PLR2004 - and the rate
        kind = "metric" if takes_pair else None
    found = find_own(settings, kind or "reducer", name, folder=folder)
    if isinstance(found, str):
        raise ValueError(f"{name} is feel321's own; name a reducer or metric of yours")  # noqa: TRY004
    return found


def _read_if_there(folder: Path) -> Settings:
    path = folder / SETTINGS_FILE
    there = path.is_file()
    return read_settings(path) if there else Settings(recordings=(RecordingTable(scene="bumps"),))


def list_methods(settings: Settings, folder: Path) -> list[Method]:
    """List the lab's own reducers and metrics that a study uses or declares."""
    stimuli = settings.stimuli
    # Tables without code say what a column means.
    declared = [name for name, table in settings.metrics.items() if table.use or table.command]
    names = {
        "reducer": (*stimuli.reducers, stimuli.reference, *settings.reducers),
        "metric": (*stimuli.metrics, *declared),
    }
    found = [find_own(settings, kind, one, folder=folder) for kind in names for one in names[kind]]
    return list({(one.kind, one.name): one for one in found if not isinstance(one, str)}.values())


def list_for_tradeoff(
    settings: Settings, folder: Path
) -> tuple[dict[str, Reducer], dict[str, Metric]]:
    """List the lab's own reducers, and the metrics besides those that are always measured."""
    asked = [name for name in settings.stimuli.metrics if name in METRICS and name not in WRITTEN]
    own = list_methods(settings, folder)
    metrics: dict[str, Metric] = {name: METRICS[name] for name in asked}
    metrics |= {one.name: OwnMetric(one) for one in own if one.kind == "metric"}
    return {one.name: OwnReducer(one) for one in own if one.kind == "reducer"}, metrics


def make_recipe(settings: Settings, folder: Path | None = None) -> Recipe:
    """Make the recipe of the stimuli: each setting of `[stimuli]` and `[rig]` is a field of it by name."""
    stimuli = settings.stimuli
    given = {one.name: getattr(stimuli, one.name) for one in fields(StimulusSettings)}
    own = {
        "reducers": [
            find_own(settings, "reducer", name, folder=folder) for name in stimuli.reducers
        ],
        "metrics": [find_own(settings, "metric", name, folder=folder) for name in stimuli.metrics],
        "reference": find_own(settings, "reducer", stimuli.reference, folder=folder),
    }
    exceptions = {one.title: one.exceptions for one in settings.recordings if one.exceptions}
    rig, seed = settings.rig.of_stimuli(), settings.study.seed
    return Recipe(**(given | own), **rig, seed=seed, exceptions=exceptions)


def find_language(settings: Settings, folder: Path) -> str | Path:
    """Find the texts of a study: the name of a language, or the path of the lab's own file."""
    language = settings.session.language
    return folder / language if language.endswith(LANGUAGE_FILE) else language


def read_study_texts(settings: Settings, folder: Path) -> dict[str, Any]:
    """Read all texts of a study, the lab's own scales and consent among them."""
    texts = read_texts(find_language(settings, folder))
    if mute := list(_find_mute_scales(settings, texts["scales"])):
        raise ValueError("\n".join(f"study.toml: {line}" for line in mute))
    texts["scales"] |= {name: table.to_texts() for name, table in settings.scales.items()}
    own_protocols.add_texts(texts, settings.session.protocols)
    if consent := settings.session.consent:
        texts["pages"][CONSENT]["text"] = consent
    return texts


def make_design(settings: Settings) -> Design:
    """Make the design of the sessions."""
    session = settings.session
    matching, rules = session.matching, (session.breaks, session.rehearsal, session.quality)
    told = {name: value for table in rules for name, value in asdict(table).items()}
    # The last of the set's levels is matched where none is named.
    level = (matching and matching.level) or settings.stimuli.levels[-1]
    return Design(
        seed=settings.study.seed,
        order=session.order,
        task_order=session.task_order,
        repeats=session.repeats,
        recordings_per_participant=session.recordings_per_participant,
        tasks=settings.list_tasks(),
        between=dict(settings.between),
        flow=Flow(**{one.name: told[one.name] for one in fields(Flow)}),
        threshold=session.threshold.make_block() if session.threshold else None,
        matching=MatchingBlock(level, matching.repeats) if matching else None,
        questions=session.questions,
    )


def make_identity(
    settings: Settings,
    folder: Path,
    presenter: dict[str, Any],
    *,
    calibration: dict[str, str] | str | None = None,
) -> dict[str, Any]:
    """List what must not change within a session besides its plan, for the header of its journal."""
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


# Whether a built set is that of the settings.


def require_current_set(study: StudyFolder, settings: Settings) -> None:
    """Refuse a stimulus set that is not the one of the settings."""
    named = dict.fromkeys(entry.title for entry in settings.recordings)
    if changes := find_changes(study.stimuli, make_recipe(settings, study.path), named):
        remedy = f"run feel321 build {quote(str(study.path))}"
        raise ValueError("\n".join(f"{change}; {remedy}" for change in changes))


def find_changes(folder: Path, recipe: Recipe, recordings: Mapping[str, str | None]) -> list[str]:
    """Compare a built set with the settings; recordings: name -> digest of its source, None where it is not known."""
    built = read_details(folder)
    origins = {row.get("recording", ""): row.get("recording_sha256", "") for row in built.stimuli}
    wanted, own = json.loads(json.dumps([describe_recipe(recipe), render.list_methods(recipe)]))
    methods = {"reducers": built.reducers, "metrics": built.metrics}
    old = dict([*flatten(built.recipe), *flatten(methods)])
    new = dict([*flatten(wanted), *flatten(own)])
    changes = [
        f"{name}: built with {json.dumps(old.get(name))}; the settings say {json.dumps(new.get(name))}"
        for name in sorted(old | new)
        if old.get(name) != new.get(name)
    ]
    if set(origins) != set(recordings):
        was, named = (", ".join(sorted(names)) for names in (origins, recordings))
        changes.append(f"recordings: built from {was}; the settings name {named}")
    changes += [
        f"recording {name!r}: is not the one that the set was built from"
        for name, sha256 in recordings.items()
        if sha256 is not None and origins.get(name, sha256) != sha256
    ]
    return [f"{folder}: {change}" for change in changes]


# Settings that do not go together, though each is allowed by itself.


def find_conflicts(settings: Settings) -> list[str]:
    """Find settings that do not go together."""
    # A mistake is reported where it is made, not again, and less clearly, in what follows from it.
    checks = (_check_methods, _check_stimuli, _check_tasks)
    if found := [line for check in checks for line in check(settings)]:
        return found
    # The stimuli, as built from the first recording, and the tasks of the groups that differ in them.
    stimuli, recording = settings.stimuli, settings.recordings[0].title
    made = [(name_of(name), "test") for name in stimuli.reducers]
    made += [(name_of(stimuli.reference), "reference")] * (stimuli.reference != NO_REFERENCE)
    made += [(name, "anchor") for name in ANCHOR_NAMES] * stimuli.anchors
    items = [
        Item(f"{recording}-{role}-{reducer}-{level}", recording, reducer, level, role)
        for level in stimuli.levels
        for reducer, role in made
    ]
    factors = {name: settings.between[name] for name in CHOOSING if name in settings.between}
    groups = [
        select_group(items, settings.list_tasks(), dict(zip(factors, levels, strict=True)))
        for levels in product(*factors.values())
    ]
    found = list(dict.fromkeys(_check_comparisons(settings, groups)))
    return found or list(_check_length(settings, groups))


def _check_methods(settings: Settings) -> Iterator[str]:
    """Refuse unknown metrics, and tables that would replace a method of feel321's: they would be left unread."""
    coded = [name for name, one in settings.metrics.items() if one.use or one.command]
    taken = {"reducers": (*REDUCERS, ORIGINAL, NO_REFERENCE), "metrics": METRICS}
    for kind, names in (("reducers", settings.reducers), ("metrics", coded)):
        for name in (one for one in names if one in taken[kind]):
            yield f"{kind}.{name}: the name is taken by one of feel321's own; give yours another"
    for name, table in settings.metrics.items():
        if name in METRIC_INFO and table.higher not in {None, (right := METRIC_INFO[name].higher)}:
            yield f"metrics.{name}.higher must be {right!r} for this metric, got {table.higher!r}; remove it"
    # A lab's own is not imported yet.
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
    # Words in a file of the lab's own are found when it is read.
    if not settings.session.language.endswith(LANGUAGE_FILE):
        yield from _find_mute_scales(settings, read_texts(settings.session.language)["scales"])
    places = {
        "level": ("stimuli.levels", settings.stimuli.levels),
        "protocol": ("session.protocols", settings.session.protocols),
    }
    for factor, (place, allowed) in places.items():
        for name in settings.between.get(factor, ()):
            if name not in allowed:
                rule = f"must be one of {', '.join(allowed)}, got {name!r}"
                yield f"between.{factor} {rule}; or add it to {place}"


def _find_mute_scales(settings: Settings, texts: Mapping[str, Any]) -> Iterator[str]:
    """Find scales that are asked and have no words, and words for scales that are no sliders."""
    for name in settings.scales:
        if texts.get(name, {}).get("choices"):
            yield f"scales.{name}: must not be set, the answer to {name} is a choice; remove it"
    known = {*texts, *settings.scales}
    asked = [(task, name) for task, table in settings.tasks.items() for name in table.scales]
    for task, name in (one for one in asked if one[1] not in known):
        near = get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}? Or " if near else ""
        remedy = f"{hint}add [scales.{name}] with question, low and high"
        yield f"tasks.{task}.scales: {name!r} has no words; {remedy}"


def _check_comparisons(settings: Settings, groups: list[Group]) -> Iterator[str]:
    """Check that surfaces have names, and that the stimuli to be built are what the tasks need."""
    tasks = dict.fromkeys(task for _, own in groups for task in own)
    on_surfaces = [task.protocol for task in tasks if task.surface or task.reference == SURFACE]
    for number, recording in enumerate(settings.recordings, start=1):
        if on_surfaces and not recording.sample:
            yield (
                f"recordings[{number}].sample: missing, but participants touch the real surface in "
                f"{' and '.join(on_surfaces)}; add the name that it has in the lab"
            )
    for items, own in groups:
        for task in own:
            try:
                PROTOCOLS[task.protocol].make_lessons(items, task)
                PROTOCOLS[task.protocol].compare(items, task)
            except (TypeError, ValueError) as error:
                yield f"tasks.{task.protocol}: {error}"


def _check_length(settings: Settings, groups: list[Group]) -> Iterator[str]:
    """Count the trials of each group, which are as many for each recording."""
    everything, share = len(settings.recordings), settings.session.recordings_per_participant
    if share and share > everything:
        yield (
            f"session.recordings_per_participant must be at most the {everything} recordings of the study, "
            f"got {share}; leave it out, and everybody feels them all"
        )
    counts = [
        sum(len(PROTOCOLS[task.protocol].compare(items, task)) for task in own)
        for items, own in groups
    ]
    repeats = settings.session.repeats
    if (trials := max(counts) * repeats * (share or everything)) > MOST_TRIALS:
        yield (
            f"a session must have at most {MOST_TRIALS} trials, got {trials} with session.repeats = {repeats}; use "
            "fewer repeats, reducers or recordings, or let each participant feel a share of them: "
            "session.recordings_per_participant"
        )
