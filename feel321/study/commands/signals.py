"""Verbs for single recordings: reduce, match."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feel321.study.commands import shared

if TYPE_CHECKING:
    from feel321.stimuli.condition import Conditioning
    from feel321.stimuli.recording import Recording
    from feel321.types import Samples

RATE_TOLERANCE_HZ = 1.0
"""A WAV header holds whole Hz only; a recording's true rate may lie between."""

raw_option = shared.flag(
    "--raw",
    "Use the recording as it was measured; a study removes the offset and keeps 20 to 1000 Hz.",
)


class ReducerName(click.ParamType[str]):
    """A reducer's name or place; the registry, which takes numpy, is read only where the names are wanted."""

    name = "reducer"

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:  # noqa: ARG002 - click's form
        """List the names, for the help."""
        from feel321.names import REDUCER_NAMES

        return f"[{'|'.join(REDUCER_NAMES)}|PLACE:NAME]"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """Check a name; a lab's own method is found, but not yet imported."""
        from feel321.study.methods import open_reducer

        try:
            open_reducer(str(value), Path())
        except ValueError as error:
            self.fail(str(error), param, ctx)
        return str(value)


def _check_wav(_context: click.Context, _parameter: click.Parameter, path: Path) -> Path:
    if path.suffix.lower() != ".wav":
        raise click.BadParameter(f"must end in .wav, got {str(path)!r}; give it that ending")
    return path


@click.command(epilog="Example: feel321 reduce oak.csv --reducer dft321 -o oak-dft321.wav")
@shared.recording_argument
@click.option(
    "--reducer",
    type=ReducerName(),
    required=True,
    help="The 321 transform: a name, or one of your own, as mylab.haptics:my321 or methods/my321.py:my321.",
)
@click.option(
    "-o",
    "--out",
    "output",
    type=shared.FILE,
    callback=_check_wav,
    required=True,
    help="The .wav file to write; a JSON file goes beside it.",
)
@shared.number_option("--window-ms", "Window of the reducers that have one.", "35")
@raw_option
@shared.flag("--force", "Replace the output if it exists.")
@shared.json_option
def reduce(  # noqa: PLR0913 - one per option
    *,
    recording: Recording,
    reducer: str,
    output: Path,
    window_ms: float | None,
    raw: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Reduce a recording to one axis.

    The recording is conditioned as for a study: offset removed, 20 to 1000 Hz. The result is a float32 WAV file in
    m/s^2 with a JSON file that says how it was made.
    """
    from feel321 import __version__
    from feel321.doors import name_of
    from feel321.files import write_text
    from feel321.stimuli.condition import Conditioning
    from feel321.stimuli.wav import write_wav

    sidecar = output.with_suffix(".json")
    _check_output(output, sidecar, force=force)
    reduce_it, steps = _choose_reducer(reducer, window_ms), None if raw else Conditioning()
    conditioned = _condition(recording, steps)
    reduced, origin = _reduce(conditioned, reduce_it)
    facts = {
        "recording": recording.name,
        "recording_sha256": recording.sha256,
        "reducer": name_of(reducer),
        **origin,
        "window_ms": window_ms,
        "unit": "m/s^2",
        "version": __version__,
        **_list_steps(recording, steps),
        **_match(conditioned, reduced),
    }
    write_wav(output, reduced, round(recording.rate_hz))
    write_text(sidecar, shared.dump_json(facts) + "\n")
    if as_json:
        shared.print_json(facts)
    else:
        shared.echo(
            f"{output}: {recording.name} through {name_of(reducer)}, {recording.n_samples} samples, m/s^2"
        )
        _print_matches(facts)


@click.command(epilog="Example: feel321 match oak.csv oak-dft321.wav --json")
@shared.recording_argument
@click.argument("reduced", metavar="REDUCED.wav", type=shared.FILE)
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="NAME",
    help="Also this metric: a name, or one of your own, as mylab.haptics:psnr; repeatable.",
)
@raw_option
@shared.flag(
    "--rivals", "Also compute the rivals of the match metrics: level, spectra and envelopes."
)
@shared.json_option
def match(
    *,
    recording: Recording,
    reduced: Path,
    metrics: tuple[str, ...],
    raw: bool,
    rivals: bool,
    as_json: bool,
) -> None:
    """Match a reduced WAV file, in m/s^2, against its recording.

    The recording is conditioned as the JSON file beside the WAV says; without one, as for a study: offset removed, 20
    to 1000 Hz. The exit code is 1 if there is nothing to match; --json then holds null and the reason.
    """
    from feel321.stimuli.wav import read_wav

    samples, rate_hz = read_wav(reduced)
    _check_pair(recording, samples, rate_hz=rate_hz, name=reduced.name)
    steps, source = _find_steps(recording, reduced.with_suffix(".json"), raw=raw)
    facts = _list_steps(recording, steps) | {"conditioning_from": source}
    ready = _condition(recording, steps)
    facts |= _match(ready, samples)
    if rivals:
        facts |= _compare_by_rivals(ready, samples)
    further = _match_further(ready, samples, metrics)
    facts |= further
    if as_json:
        shared.print_json(facts)
    else:
        _print_matches(facts)
        for name, value in further.items():
            shared.echo(f"{name.replace('_', ' ')} {value:.4f}")
    if facts["reasons"]:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in facts["reasons"].items())
        raise ValueError(f"{recording.name}: {reasons}")


def _reduce(
    recording: Recording, reducer: Callable[..., Samples]
) -> tuple[Samples, dict[str, str]]:
    """Reduce a recording; also return what a reducer of the lab's own is."""
    method = getattr(reducer, "method", None)
    try:
        reduced = reducer(recording.acceleration, recording.rate_hz)
    except ValueError as error:
        if method is None:
            raise
        raise ValueError(f"recording {recording.name!r}: {error}") from None
    return reduced, {} if method is None else method.to_json()


def _check_output(*targets: Path, force: bool) -> None:
    """Refuse to write over the recording or what is read beside it, by whatever name, or over other files unasked."""
    source = click.get_current_context().params["recording"]
    own = [path for path in (source, *map(source.with_suffix, (".json", ".toml"))) if path.exists()]
    taken = [target for target in targets if target.exists()]
    for target in taken:
        if any(target.samefile(path) for path in own):
            raise click.UsageError(f"--out: {target} belongs to the recording; name another file")
    if taken and not force:
        names = ", ".join(map(str, taken))
        raise FileExistsError(f"{names}: already exists; name another file or add --force")
    if not targets[0].parent.is_dir():
        raise FileNotFoundError(f"{targets[0].parent}: there is no such folder; make it first")


def _choose_reducer(name: str, window_ms: float | None) -> Callable[..., Samples]:
    from feel321.stimuli.reducers.registry import REDUCERS
    from feel321.study.methods import open_reducer

    chosen: Callable[..., Samples] = open_reducer(name, Path())
    if window_ms is None:
        return chosen
    windowed = [
        other for other, reducer in REDUCERS.items() if "window_s" in signature(reducer).parameters
    ]
    if name not in windowed:
        raise click.UsageError(
            f"--window-ms: {name} has no window; those with one: {', '.join(windowed)}"
        )
    if not 0 < window_ms < math.inf:
        raise click.UsageError(f"--window-ms must be a finite time above 0 ms, got {window_ms:g}")
    return partial(chosen, window_s=window_ms / 1000)


def _condition(recording: Recording, steps: Conditioning | None) -> Recording:
    from feel321.stimuli.condition import condition

    try:
        return recording if steps is None else condition(recording, steps)
    except ValueError as error:
        raise ValueError(
            f"{recording.name}: {error}; or use it as it was measured, with --raw"
        ) from None


def _list_steps(recording: Recording, steps: Conditioning | None) -> dict[str, Any]:
    from feel321.stimuli.condition import list_steps

    if steps is None:
        return {"conditioning": None, "steps": []}
    return {"conditioning": asdict(steps), "steps": list_steps(steps, recording.rate_hz)}


def _find_steps(
    recording: Recording, sidecar: Path, *, raw: bool
) -> tuple[Conditioning | None, str]:
    """Find out how the recording was conditioned before it was reduced, and where that is known from."""
    from feel321.stimuli.condition import Conditioning

    facts = _read_sidecar(sidecar)
    if facts is None and raw:
        return None, "--raw"
    if facts is None:
        return Conditioning(), f"assumed: no {sidecar.name} of reduce beside it"
    if facts["recording_sha256"] != recording.sha256:
        shared.warn(
            f"{sidecar.name}: was written for another recording or file than {recording.name}"
        )
    # None for --raw, and in the files of versions that conditioned nothing.
    source, steps = f"as {sidecar.name} says", facts.get("conditioning")
    if steps is None:
        return None, source
    if raw:
        raise click.UsageError(
            f"--raw: {sidecar.name} says that its WAV was reduced from the conditioned recording; leave out --raw, or "
            "reduce the recording again with --raw"
        )
    try:
        return Conditioning(**steps), source
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
    return (
        facts if isinstance(facts, dict) and {"recording_sha256", "reducer"} <= set(facts) else None
    )


def _check_pair(recording: Recording, samples: Samples, *, rate_hz: int, name: str) -> None:
    if samples.ndim != 1:
        raise ValueError(
            f"{name}: a reduced signal has 1 channel, got {len(samples)}; reduce it first"
        )
    if len(samples) != recording.n_samples:
        raise ValueError(
            f"{name}: got {len(samples)} samples, {recording.name} has {recording.n_samples}; "
            "both must cover the same samples, nothing is cut"
        )
    if abs(rate_hz - recording.rate_hz) > RATE_TOLERANCE_HZ:
        raise ValueError(
            f"{name}: got {rate_hz} Hz, {recording.name} has {recording.rate_hz:g} Hz; both must have one rate"
        )


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


def _compare_by_rivals(recording: Recording, samples: Samples) -> dict[str, Any]:
    """Rival metrics by name, and why one is not known."""
    from feel321.stimuli.rivals.catalog import RIVALS, measure_batch

    measured = measure_batch(recording.acceleration, samples, recording.rate_hz)
    values = {name: float(value) for name, value in measured.items()}
    missing = {name: RIVALS[name].reason for name, value in values.items() if math.isnan(value)}
    return {"rivals": values, "rivals_reasons": missing}


def _match_further(
    recording: Recording, samples: Samples, metrics: tuple[str, ...]
) -> dict[str, float]:
    """Compute further metrics, the lab's own among them."""
    from feel321.doors import name_of
    from feel321.study.methods import open_metric

    return {
        name_of(name): open_metric(name, Path())(recording.acceleration, samples, recording.rate_hz)
        for name in metrics
    }


def _print_matches(facts: dict[str, Any]) -> None:
    from feel321.names import MATCHES

    steps = ", ".join(facts["steps"]) or "none, as it was measured"
    source = f" ({facts['conditioning_from']})" if "conditioning_from" in facts else ""
    shared.echo(f"conditioning of the recording: {steps}{source}")
    compared = (
        f"{facts['n_frequencies']} frequencies, {facts['lowest_hz']:.1f} to {facts['highest_hz']:.1f} Hz, "
        f"{facts['n_left_out']} left out"
    )
    silent = ", ".join("xyz"[axis] for axis in facts["silent_axes"]) or "none"
    details = {"spectral_match": compared, "temporal_match": f"silent axes: {silent}"}
    for name in MATCHES:
        detail = f" ({details[name]})" if name in details else ""
        value = (
            f"none: {facts['reasons'][name]}"
            if name in facts["reasons"]
            else f"{facts[name]:.4f}{detail}"
        )
        shared.echo(f"{name.replace('_', ' ')} {value}")
    for name, value in facts.get("rivals", {}).items():
        _print_rival(name, value, reason=facts["rivals_reasons"].get(name))


def _print_rival(name: str, value: float, *, reason: str | None) -> None:
    from feel321.names import METRIC_INFO

    info = METRIC_INFO[name]
    sense = "higher is better" if info.higher == "better" else "lower is better"
    unit = f" {info.unit}" if info.unit else ""
    shared.echo(
        f"{info.label} " + (f"none: {reason}" if reason else f"{value:.4f}{unit} ({sense})")
    )
