"""Verbs for single recordings: reduce, match."""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from feel321.study.commands import shared
from feel321.study.commands.shared import AS_IT_SAYS, File, Json, Reading, Several

if TYPE_CHECKING:
    from feel321.stimuli.condition import Conditioning
    from feel321.stimuli.recording import Recording
    from feel321.types import Samples

RATE_TOLERANCE_HZ = 1.0
"""A WAV header holds whole Hz only; a recording's true rate may lie between."""

Raw = Annotated[bool, Parameter(help="As measured: no offset removed, all frequencies kept.")]


def reduce(  # noqa: PLR0913 - one per option
    recording: File,
    /,
    *,
    reducer: Annotated[str, Parameter(metavar="NAME")],
    output: Annotated[File, Parameter(name=["--out", "-o"])],
    source: Reading = AS_IT_SAYS,
    window_ms: Annotated[float | None, Parameter(metavar="MS")] = None,
    raw: Raw = False,
    force: bool = False,
    as_json: Json = False,
) -> None:
    """Reduce a recording to one axis.

    The recording is conditioned as for a study: offset removed, 20 to 1000 Hz. The result is a float32 WAV file in
    m/s^2 with a JSON file that says how it was made.

    Example: feel321 reduce oak.csv --reducer dft321 -o oak-dft321.wav

    Parameters
    ----------
    reducer
        The 321 transform (a wrong name lists all), or one of your own: methods/my321.py:my321.
    output
        The .wav file; a JSON file goes beside it.
    window_ms
        Window of the reducers that have one.  [default: 35]
    force
        Replace the output if it exists.
    """
    from feel321 import __version__
    from feel321.doors import name_of
    from feel321.files import write_text
    from feel321.stimuli.condition import Conditioning
    from feel321.stimuli.wav import write_wav

    reduce_it = _choose_reducer(reducer, window_ms)
    if output.suffix.lower() != ".wav":
        shared.refuse_use(f"--out must end in .wav, got {str(output)!r}; give it that ending")
    read, sidecar = source.read(recording), output.with_suffix(".json")
    _check_output(recording, output, sidecar, force=force)
    steps = None if raw else Conditioning()
    conditioned = _condition(read, steps)
    reduced, origin = _reduce(conditioned, reduce_it)
    facts = {
        "recording": read.name,
        "recording_sha256": read.sha256,
        "reducer": name_of(reducer),
        **origin,
        "window_ms": window_ms,
        "unit": "m/s^2",
        "version": __version__,
        **_list_steps(read, steps),
        **_match(conditioned, reduced),
    }
    write_wav(output, reduced, round(read.rate_hz))
    write_text(sidecar, shared.dump_json(facts) + "\n")
    if as_json:
        shared.print_json(facts)
    else:
        done = f"{read.name} through {name_of(reducer)}, {read.n_samples} samples, m/s^2"
        shared.echo("\n".join([f"{output}: {done}", *_describe_matches(facts)]))


def match(  # noqa: PLR0913 - one per option
    recording: File,
    reduced: Annotated[File, Parameter(name="REDUCED.wav")],
    /,
    *,
    source: Reading = AS_IT_SAYS,
    metric: Several = (),
    raw: Raw = False,
    rivals: bool = False,
    as_json: Json = False,
) -> None:
    """Match a reduced WAV file, in m/s^2, against its recording.

    The recording is conditioned as the JSON file beside the WAV says; without one, as for a study: offset removed, 20
    to 1000 Hz. The exit code is 1 if there is nothing to match; --json then holds null and the reason.

    Example: feel321 match oak.csv oak-dft321.wav --json

    Parameters
    ----------
    metric
        Also this metric, or your own (mylab.haptics:psnr); repeatable.
    rivals
        Also rival metrics: level, spectra, envelopes.
    """
    from feel321.doors import name_of
    from feel321.stimuli.wav import read_wav
    from feel321.study.methods import open_metric

    read = source.read(recording)
    samples, rate_hz = read_wav(reduced)
    _check_pair(read, samples, rate_hz=rate_hz, name=reduced.name)
    steps, origin = _find_steps(read, reduced.with_suffix(".json"), raw=raw)
    ready = _condition(read, steps)
    facts = {**_list_steps(read, steps), "conditioning_from": origin, **_match(ready, samples)}
    if rivals:
        facts |= _compare_by_rivals(ready, samples)
    further = {
        name_of(name): open_metric(name, Path())(ready.acceleration, samples, ready.rate_hz)
        for name in metric
    }
    facts |= further
    if as_json:
        shared.print_json(facts)
    else:
        own = [f"{name.replace('_', ' ')} {value:.4f}" for name, value in further.items()]
        shared.echo("\n".join([*_describe_matches(facts), *own]))
    if facts["reasons"]:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in facts["reasons"].items())
        raise ValueError(f"{read.name}: {reasons}")


def _choose_reducer(name: str, window_ms: float | None) -> "Callable[..., Samples]":
    from feel321.stimuli.reducers.registry import REDUCERS
    from feel321.study.methods import open_reducer

    try:
        chosen: Callable[..., Samples] = open_reducer(name, Path())
    except ValueError as error:
        shared.refuse_use(str(error))
    if window_ms is None:
        return chosen
    windowed = [
        other for other, reducer in REDUCERS.items() if "window_s" in signature(reducer).parameters
    ]
    if name not in windowed:
        shared.refuse_use(
            f"--window-ms: {name} has no window; those with one: {', '.join(windowed)}"
        )
    if not 0 < window_ms < math.inf:
        shared.refuse_use(f"--window-ms must be a finite time above 0 ms, got {window_ms:g}")
    return partial(chosen, window_s=window_ms / 1000)


def _check_output(source: Path, *targets: Path, force: bool) -> None:
    """Refuse to write over the recording or what is read beside it, by whatever name, or over other files unasked."""
    own = [path for path in (source, *map(source.with_suffix, (".json", ".toml"))) if path.exists()]
    taken = [target for target in targets if target.exists()]
    for target in taken:
        if any(target.samefile(path) for path in own):
            shared.refuse_use(f"--out: {target} belongs to the recording; name another file")
    if taken and not force:
        names = ", ".join(map(str, taken))
        raise FileExistsError(f"{names}: already exists; name another file or add --force")
    if not targets[0].parent.is_dir():
        raise FileNotFoundError(f"{targets[0].parent}: there is no such folder; make it first")


def _reduce(
    recording: "Recording", reducer: "Callable[..., Samples]"
) -> "tuple[Samples, dict[str, str]]":
    """Reduce a recording; also return what a reducer of the lab's own is."""
    method = getattr(reducer, "method", None)
    try:
        reduced = reducer(recording.acceleration, recording.rate_hz)
    except ValueError as error:
        if method is None:
            raise
        raise ValueError(f"recording {recording.name!r}: {error}") from None
    return reduced, {} if method is None else method.to_json()


def _condition(recording: "Recording", steps: "Conditioning | None") -> "Recording":
    from feel321.stimuli.condition import condition

    try:
        return recording if steps is None else condition(recording, steps)
    except ValueError as error:
        raise ValueError(
            f"{recording.name}: {error}; or use it as it was measured, with --raw"
        ) from None


def _list_steps(recording: "Recording", steps: "Conditioning | None") -> dict[str, Any]:
    from feel321.stimuli.condition import list_steps

    if steps is None:
        return {"conditioning": None, "steps": []}
    return {"conditioning": asdict(steps), "steps": list_steps(steps, recording.rate_hz)}


def _find_steps(
    recording: "Recording", sidecar: Path, *, raw: bool
) -> "tuple[Conditioning | None, str]":
    """Find out how the recording was conditioned before it was reduced, and where that is known from."""
    from feel321.stimuli.condition import Conditioning

    facts = _read_sidecar(sidecar)
    if facts is None:
        assumed = f"assumed: no {sidecar.name} of reduce beside it"
        return (None, "--raw") if raw else (Conditioning(), assumed)
    if facts["recording_sha256"] != recording.sha256:
        shared.warn(
            f"{sidecar.name}: was written for another recording or file than {recording.name}"
        )
    origin, steps = f"as {sidecar.name} says", facts.get("conditioning")
    if steps is None:  # it was reduced with --raw
        return None, origin
    if raw:
        shared.refuse_use(
            f"--raw: {sidecar.name} says that its WAV was reduced from the conditioned recording; leave out --raw, or "
            "reduce the recording again with --raw"
        )
    try:
        return Conditioning(**steps), origin
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{sidecar.name}: invalid conditioning ({error}); reduce the recording again"
        ) from None


def _read_sidecar(path: Path) -> dict[str, Any] | None:
    """Read what `reduce` wrote beside a WAV file; None where there is no such file, or it is of another kind."""
    if not path.is_file():
        return None
    try:
        facts = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise ValueError(
            f"{path.name}: not JSON ({error}); remove it, or reduce the recording again"
        ) from None
    is_ours = isinstance(facts, dict) and {"recording_sha256", "reducer"} <= set(facts)
    return facts if is_ours else None


def _check_pair(recording: "Recording", samples: "Samples", *, rate_hz: int, name: str) -> None:
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


def _match(recording: "Recording", samples: "Samples") -> dict[str, Any]:
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


def _compare_by_rivals(recording: "Recording", samples: "Samples") -> dict[str, Any]:
    """Rival metrics by name, and why one is not known."""
    from feel321.stimuli.rivals import RIVALS, measure_batch

    measured = measure_batch(recording.acceleration, samples, recording.rate_hz)
    values = {name: float(value) for name, value in measured.items()}
    missing = {name: RIVALS[name].reason for name, value in values.items() if math.isnan(value)}
    return {"rivals": values, "rivals_reasons": missing}


def _describe_matches(facts: dict[str, Any]) -> Iterator[str]:
    from feel321.names import MATCHES, METRIC_INFO

    steps = ", ".join(facts["steps"]) or "none, as it was measured"
    source = f" ({facts['conditioning_from']})" if "conditioning_from" in facts else ""
    yield f"conditioning of the recording: {steps}{source}"
    compared = (
        f"{facts['n_frequencies']} frequencies, {facts['lowest_hz']:.1f} to {facts['highest_hz']:.1f} Hz, "
        f"{facts['n_left_out']} left out"
    )
    silent = ", ".join("xyz"[axis] for axis in facts["silent_axes"]) or "none"
    details = {"spectral_match": f" ({compared})", "temporal_match": f" (silent axes: {silent})"}
    for name in MATCHES:
        reason, detail = facts["reasons"].get(name), details.get(name, "")
        value = f"none: {reason}" if reason else f"{facts[name]:.4f}{detail}"
        yield f"{name.replace('_', ' ')} {value}"
    for name, value in facts.get("rivals", {}).items():
        info, reason = METRIC_INFO[name], facts["rivals_reasons"].get(name)
        sense = "higher is better" if info.higher == "better" else "lower is better"
        unit = f" {info.unit}" if info.unit else ""
        yield f"{info.label} " + (f"none: {reason}" if reason else f"{value:.4f}{unit} ({sense})")
