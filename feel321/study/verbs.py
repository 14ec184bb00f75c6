"""Verbs that need no study to be there: `new`; `reduce`, `match`, `tradeoff` of recordings."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from feel321.arguments import as_path, follow, name_of
from feel321.jobs import as_workers
from feel321.study.folder import Outcome, StudyFolder, UsageError, create_study, require_study
from feel321.study.options import AS_IT_SAYS
from feel321.study.terminal import cap, dump_json, echo, format_facts, wants_bar, warn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from typing import TypeVar

    from feel321.stimuli.condition import Conditioning
    from feel321.stimuli.recording import Recording
    from feel321.study import options
    from feel321.types import Samples

    Chosen = TypeVar("Chosen")

RATE_TOLERANCE_HZ = 1.0  # A WAV header holds whole Hz only; a recording's true rate may lie between


def new(
    folder: options.Folder | None = None,
    /,
    *,
    study: options.Ready = None,
    methods: bool = False,
    all_settings: bool = False,
) -> None:
    """Begin a study: a commented study.toml, ready to use.

    Example: feel321 new my-study
             feel321 new my-study --study park2019
             feel321 new --all-settings

    Parameters
    ----------
    folder : str or path, optional
        The folder of the study.
    study : str, optional
        Start from this ready design.
    methods : bool
        Add working examples of your own methods, in methods/.
    all_settings : bool
        Only print every setting.
    """
    if all_settings:
        from feel321.study.all_settings import FILES, write_list

        echo("\n".join(map(write_list, FILES)).rstrip("\n"))
    elif folder is None:
        raise UsageError("name the folder of the new study")
    elif study and methods:
        raise UsageError("--methods adds to a study of your own; leave out --study")
    else:
        made = create_study(as_path(folder), bundled=study)
        if methods:
            from feel321.study.settings.read import add_methods

            add_methods(made)
        echo(f"{made.settings}: edit it, then: feel321 check {quote(str(folder))}")


def reduce(
    recording: options.File,
    /,
    *,
    reducer: options.Reducer,
    out: options.Target,
    source: options.Reading = AS_IT_SAYS,
    raw: bool = False,
    force: bool = False,
) -> Outcome:
    """Reduce a recording to one axis.

    The recording is conditioned as for a study: offset removed, 20 to 1000 Hz. The result is a float32 WAV file in
    m/s^2 with a JSON file that says how it was made.

    Example: feel321 reduce oak.csv --reducer dft321 -o oak-dft321.wav

    Parameters
    ----------
    recording : str or path
        The recording.
    reducer : str
        The 321 transform (a wrong name lists all), or your own: methods/my321.py:my321
    out : str or path
        A .wav file; a JSON file goes beside it.
    source : Reading
        How the recording is read.
    raw : bool
        As measured: no offset removed, all frequencies kept.
    force : bool
        Replace files that exist.
    """
    from feel321 import __version__
    from feel321.files import write_text
    from feel321.stimuli.condition import Conditioning
    from feel321.stimuli.wav import write_wav
    from feel321.study.settings.read import open_reducer

    reduce_it, path, target = _choose(open_reducer, reducer), as_path(recording), as_path(out)
    if target.suffix.lower() != ".wav":
        raise UsageError(f"--out must end in .wav, got {str(target)!r}; give it that ending")
    read, sidecar = source.read(path), target.with_suffix(".json")
    _report_warnings([read])
    _check_output(path, target, sidecar, force=force)
    conditioned, said = _condition(read, None if raw else Conditioning())
    method = getattr(reduce_it, "method", None)
    try:
        reduced = reduce_it(conditioned.acceleration, conditioned.rate_hz)
    except ValueError as error:
        place = f"recording {read.name!r}: " if method else ""
        raise ValueError(f"{place}{error}") from None
    facts = {
        "recording": read.name,
        "recording_sha256": read.sha256,
        "reducer": name_of(reducer),
        **(method.to_json() if method else {}),
        "unit": "m/s^2",
        "version": __version__,
        **said,
        **_match(conditioned, reduced),
    }
    write_wav(target, reduced, round(read.rate_hz))
    write_text(sidecar, dump_json(facts) + "\n")
    done = f"{read.name} through {name_of(reducer)}, {read.n_samples} samples, m/s^2"
    return Outcome(facts, [f"{target}: {done}", *format_facts(facts)])


def match(
    recording: options.File,
    reduced: options.Reduced,
    /,
    *,
    source: options.Reading = AS_IT_SAYS,
    metric: options.Metrics = (),
    raw: bool = False,
) -> Outcome:
    """Match a reduced WAV file, in m/s^2, against its recording.

    The recording is conditioned as the JSON file beside the WAV says; without one, as for a study: offset removed, 20
    to 1000 Hz. The exit code is 1 if there is nothing to match; --json then holds null and the reason.

    Example: feel321 match oak.csv oak-dft321.wav --json

    Parameters
    ----------
    recording : str or path
        The recording.
    reduced : str or path
        The WAV file.
    source : Reading
        How the recording is read.
    metric : sequence of str
        Also this metric (a wrong name lists all), or your own: methods/snr.py:snr; repeatable.
    raw : bool
        As measured: no offset removed, all frequencies kept.
    """
    from feel321.stimuli.wav import read_wav
    from feel321.study.settings.read import open_metric

    further = {name_of(name): _choose(open_metric, name) for name in metric}
    read, path = source.read(as_path(recording)), as_path(reduced)
    _report_warnings([read])
    if not path.exists():
        raise FileNotFoundError(f"{path}: there is no such file; check the name")
    samples, rate_hz = read_wav(path)
    _check_pair(read, samples, rate_hz=rate_hz, name=path.name)
    steps, origin = _find_steps(read, path.with_suffix(".json"), raw=raw)
    ready, said = _condition(read, steps)
    facts = {**said, "conditioning_from": origin, **_match(ready, samples)}
    for name, measure in further.items():
        facts[name] = measure(ready.acceleration, samples, ready.rate_hz)
    reasons = "; ".join(f"{name}: {reason}" for name, reason in facts["reasons"].items())
    faults = [f"{read.name}: {reasons}"] if reasons else []
    return Outcome(facts, [*format_facts(facts)], faults=faults)


def _report_warnings(recordings: Iterable[Recording]) -> None:
    for line in cap([f"{one.name}: {text}" for one in recordings for text in one.warnings]):
        warn(line)


def _choose(find: Callable[[str, Path], Chosen], name: str) -> Chosen:
    """Find a method that was named on the command line; a wrong name is wrong use."""
    try:
        return find(name, Path())
    except ValueError as error:
        raise UsageError(str(error)) from None


def _check_output(source: Path, *targets: Path, force: bool) -> None:
    """Refuse to write over the recording or what is read beside it, by whatever name, or over other files unasked."""
    own = [path for path in (source, *map(source.with_suffix, (".json", ".toml"))) if path.exists()]
    taken = [target for target in targets if target.exists()]
    for target in taken:
        if any(target.samefile(path) for path in own):
            raise UsageError(f"--out: {target} belongs to the recording; name another file")
    if taken and not force:
        names = ", ".join(map(str, taken))
        raise FileExistsError(f"{names}: already exists; name another file or add --force")
    if not targets[0].parent.is_dir():
        raise FileNotFoundError(f"{targets[0].parent}: there is no such folder; make it first")


def _condition(
    recording: Recording, steps: Conditioning | None
) -> tuple[Recording, dict[str, Any]]:
    """Condition a recording; also returns what is said of it."""
    from feel321.stimuli.condition import condition, list_steps

    if steps is None:
        return recording, {"conditioning": None, "steps": []}
    said = {"conditioning": asdict(steps), "steps": list_steps(steps, recording.rate_hz)}
    try:
        return condition(recording, steps), said
    except ValueError as error:
        remedy = "or use it as it was measured, with --raw"
        raise ValueError(f"{recording.name}: {error}; {remedy}") from None


def _find_steps(
    recording: Recording, sidecar: Path, *, raw: bool
) -> tuple[Conditioning | None, str]:
    """Find out how the recording was conditioned before it was reduced, and where that is known from."""
    from feel321.stimuli.condition import Conditioning

    try:
        facts = json.loads(sidecar.read_bytes()) if sidecar.is_file() else None
    except (ValueError, RecursionError) as error:
        remedy = "remove it, or reduce the recording again"
        raise ValueError(f"{sidecar.name}: not JSON ({error}); {remedy}") from None
    if not isinstance(facts, dict) or not {"recording_sha256", "reducer"} <= set(facts):
        assumed = f"assumed: no {sidecar.name} of reduce beside it"
        return (None, "--raw") if raw else (Conditioning(), assumed)
    if facts["recording_sha256"] != recording.sha256:
        warn(f"{sidecar.name}: was written for another recording or file than {recording.name}")
    origin, steps = f"as {sidecar.name} says", facts.get("conditioning")
    if steps is None:  # it was reduced with --raw
        return None, origin
    if raw:
        raise UsageError(
            f"--raw: {sidecar.name} says that its WAV was reduced from the conditioned recording; leave out --raw, or "
            "reduce the recording again with --raw"
        )
    try:
        return Conditioning(**steps), origin
    except (TypeError, ValueError) as error:
        remedy = "reduce the recording again"
        raise ValueError(f"{sidecar.name}: invalid conditioning ({error}); {remedy}") from None


def _check_pair(recording: Recording, samples: Samples, *, rate_hz: int, name: str) -> None:
    fault = ""
    if samples.ndim != 1:
        fault = f"a reduced signal has 1 channel, got {len(samples)}; reduce it first"
    elif len(samples) != recording.n_samples:
        fault = (
            f"got {len(samples)} samples, {recording.name} has {recording.n_samples}; "
            "both must cover the same samples, nothing is cut"
        )
    elif abs(rate_hz - recording.rate_hz) > RATE_TOLERANCE_HZ:
        fault = f"got {rate_hz} Hz, {recording.name} has {recording.rate_hz:g} Hz; both must have one rate"
    if fault:
        raise ValueError(f"{name}: {fault}")


def _match(recording: Recording, samples: Samples) -> dict[str, Any]:
    from feel321.stimuli.match import spectral_match_details, temporal_match_details

    conditioned, rate_hz = recording.acceleration, recording.rate_hz
    details = asdict(spectral_match_details(conditioned, samples, rate_hz))
    spectral = {name: value for name, value in details.items() if isinstance(value, float | int)}
    temporal = asdict(temporal_match_details(conditioned, samples))
    reasons = {"spectral_match": details["reason"], "temporal_match": temporal.pop("reason")}
    if math.isnan(spectral["bounded"]):
        reasons["spectral_match_bounded"] = reasons["spectral_match"]
    return {
        "spectral_match": spectral.pop("value"),
        "temporal_match": temporal.pop("value"),
        "spectral_match_bounded": spectral.pop("bounded"),
        "rate_hz": recording.rate_hz,
        "n_samples": recording.n_samples,
        **spectral,
        **temporal,
        "reasons": {name: reason for name, reason in reasons.items() if reason},
    }


def tradeoff(  # noqa: PLR0913 - one per option
    *places: options.Places,
    scenes: bool = False,
    thorough: bool = False,
    online: bool = False,
    latency_ms: options.Number | None = None,
    mounting: options.Mounting = "any",
    tolerance_db: options.Number | None = None,
    out: options.Out = None,
    seed: options.WholeSeed = None,
    workers: options.Crew = 1,
    scheduler: options.Scheduler = "",
) -> Outcome:
    """Compare reducers: speed, accuracy, where they fail, and the simplest that suffices.

    Writes one page into STUDY/tradeoff. Times are measured on this machine: leave it idle.

    Example: feel321 tradeoff my-study
             feel321 tradeoff oak.csv pine.csv --online --latency-ms 45

    Parameters
    ----------
    *places : str or path
        A study, recordings, or both.
    scenes : bool
        Include the bundled scenes.
    thorough : bool
        Whole recordings, 72 mountings, hard scenes.
    online : bool
        Only reducers that run while the vibration is made.
    latency_ms : float, optional
        Longest delay of reducer, block and device together. [default: 45]
    mounting : str
        Mountings of the sensor that the advice must hold for.
    tolerance_db : float, optional
        How far from the best still suffices, in dB of energy. [default: 1]
    out : str or path, optional
        Folder of the results.
    seed : int, optional
        Random seed; the study's by default.
    workers : int or Workers
        Number of processes.
    scheduler : str
        A Dask cluster instead: tls://HOST:PORT, or tcp://HOST:PORT (whoever reaches it can run programs).
    """
    from feel321.analysis.report.folder import check_target
    from feel321.analysis.tradeoff import judge
    from feel321.analysis.tradeoff.measure import measure_tradeoff
    from feel321.analysis.tradeoff.page import advise_tradeoff
    from feel321.stimuli.reducers.registry import REDUCERS
    from feel321.study.analyze import find_ratings, gather_recordings
    from feel321.study.participants.traces import recording_output
    from feel321.study.session.journal import utc_now
    from feel321.study.settings.read import list_for_tradeoff, read_settings

    folder, extra = _find_places([as_path(one) for one in places], scenes=scenes)
    try:
        tolerance = judge.TOLERANCE_DB if tolerance_db is None else tolerance_db
        context = judge.Context(online, latency_ms, mounting, tolerance)
    except ValueError as error:
        text = f"--{error}".replace("set online=True", "add --online")
        text = text.replace("latency_ms", "latency-ms").replace("tolerance_db", "tolerance-db")
        raise UsageError(text) from None
    output = (folder or Path()) / "tradeoff" if out is None else as_path(out)
    check_target(output)
    # Recordings that were named without a study belong to none, whatever the current folder is.
    study = StudyFolder(folder or output)
    with follow(wants_bar(), "tradeoff") as progress:
        recordings = gather_recordings(study.path, scenes=scenes, extra=extra)
        _report_warnings(recordings)
        settings = read_settings(study.settings) if study.settings.is_file() else None
        reducers, metrics = list_for_tradeoff(settings, study.path) if settings else ({}, {})
        windows = [one for one in judge.WINDOWS_MS if one <= context.room_ms]
        frame = measure_tradeoff(
            recordings,
            reducers=dict(REDUCERS) | reducers,
            metrics=metrics,
            windows_ms=windows if context.online else (),
            thorough=thorough,
            rng=(settings.study.seed if settings else 0) if seed is None else seed,
            workers=as_workers(workers, scheduler),
            progress=progress,
        )
        margin = settings.analysis.margin if settings else None
        result = advise_tradeoff(frame, context, ratings=find_ratings(study), margin=margin)
    with recording_output(study, "tradeoff", output, now=utc_now):
        result.write(output)
    return Outcome(output / "results.json", [result.summary(), str(output / "index.html")])


def _find_places(places: Sequence[Path], *, scenes: bool) -> tuple[Path | None, tuple[Path, ...]]:
    """Tell the folder of a study from recordings; the current folder is the study where nothing else was named."""
    if not places and not scenes:
        return require_study(Path()).path, ()
    studies = [one for one in places if (one / "study.toml").is_file()]
    extra = tuple(one for one in places if one not in studies)
    if len(studies) > 1:
        raise UsageError(f"name one study, got {', '.join(map(str, studies))}")
    for one in extra:
        if one.is_dir():
            raise IsADirectoryError(
                f"{one}: a folder without study.toml; name a study, or recordings one by one"
            )
        if not one.is_file():
            raise FileNotFoundError(f"{one}: no such study or recording; check the name")
    return (studies[0] if studies else None), extra
