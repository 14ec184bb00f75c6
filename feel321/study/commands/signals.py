"""Verbs for single recordings: reduce one, match one."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from functools import partial
from inspect import signature
from typing import TYPE_CHECKING, Any

import click

from feel321.study.commands.shared import (
    FILE,
    dump_json,
    json_option,
    print_json,
    recording_argument,
    warn,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from feel321.stimuli.condition import Conditioning
    from feel321.stimuli.recording import Recording

    Samples = NDArray[np.float64]

RAW = "Take the recording as it was measured; a study removes the offset and keeps 20 to 1000 Hz."

RATE_TOLERANCE_HZ = 1.0
"""A WAV header holds whole Hz only; a recording's true rate may lie between."""


class ReducerName(click.ParamType[str]):
    """The name of a reducer; the registry, which takes numpy, is read only where the names are wanted."""

    name = "reducer"

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:  # noqa: ARG002 - click's form
        """List the names, for the help."""
        from feel321.stimuli.reducers.registry import REDUCERS

        return f"[{'|'.join(REDUCERS)}]"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """Check a name."""
        from feel321.stimuli.reducers.registry import REDUCERS

        name = str(value)
        if name not in REDUCERS:
            self.fail(f"got {name!r}, allowed: {', '.join(REDUCERS)}", param, ctx)
        return name


def _check_wav(_context: click.Context, _parameter: click.Parameter, path: Path) -> Path:
    if path.suffix.lower() != ".wav":
        raise click.BadParameter(
            f"got {str(path)!r}, allowed is a name that ends in .wav; give it that ending"
        )
    return path


@click.command(epilog="Example: feel321 reduce oak.csv --reducer dft321 -o oak-dft321.wav")
@recording_argument
@click.option("--reducer", type=ReducerName(), required=True, help="The 321 transform.")
@click.option(
    "-o",
    "--output",
    type=FILE,
    callback=_check_wav,
    required=True,
    help="The .wav file to write; a JSON file goes beside it.",
)
@click.option(
    "--window-ms", type=float, help="Window of the reducers that have one.  [default: 35]"
)
@click.option("--raw", is_flag=True, help=RAW)
@click.option("--force", is_flag=True, help="Replace the output if it is there.")
@json_option
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
    from feel321.files import write_text
    from feel321.stimuli.condition import Conditioning
    from feel321.stimuli.wav import write_wav

    sidecar = output.with_suffix(".json")
    _spare_source(click.get_current_context().params["recording"], output, sidecar)
    taken = [str(path) for path in (output, sidecar) if path.exists()]
    if taken and not force:
        raise FileExistsError(
            f"{', '.join(taken)}: is there already; name another file or add --force"
        )
    if not output.parent.is_dir():
        raise FileNotFoundError(f"{output.parent}: there is no such folder; make it first")
    reduce_it, steps = _choose(reducer, window_ms), None if raw else Conditioning()
    conditioned = _condition(recording, steps)
    reduced = reduce_it(conditioned.acceleration, conditioned.rate_hz)
    facts = (
        _describe(recording, reducer, window_ms)
        | _tell_steps(recording, steps)
        | _match(conditioned, reduced)
    )
    write_wav(output, reduced, round(recording.rate_hz))
    write_text(sidecar, dump_json(facts) + "\n")
    if as_json:
        print_json(facts)
    else:
        click.echo(
            f"{output}: {recording.name} through {reducer}, {recording.n_samples} samples, m/s^2"
        )
        _print_matches(facts)


@click.command(epilog="Example: feel321 match oak.csv oak-dft321.wav --json")
@recording_argument
@click.argument("reduced", metavar="REDUCED.wav", type=FILE)
@click.option("--raw", is_flag=True, help=RAW)
@json_option
def match(*, recording: Recording, reduced: Path, raw: bool, as_json: bool) -> None:
    """Match a reduced WAV file, in m/s^2, against its recording.

    The recording is conditioned as the JSON file beside the WAV says; without one, as for a study: offset removed, 20
    to 1000 Hz. The exit code is 1 if there is nothing to match; --json then holds null and the reason.
    """
    from feel321.stimuli.wav import read_wav

    samples, rate_hz = read_wav(reduced)
    _check_pair(recording, samples, rate_hz=rate_hz, name=reduced.name)
    steps, source = _settle_steps(recording, reduced.with_suffix(".json"), raw=raw)
    facts = _tell_steps(recording, steps) | {"conditioning_from": source}
    facts |= _match(_condition(recording, steps), samples)
    if as_json:
        print_json(facts)
    else:
        _print_matches(facts)
    if facts["reasons"]:
        told = "; ".join(f"{name}: {reason}" for name, reason in facts["reasons"].items())
        raise ValueError(f"{recording.name}: {told}")


def _spare_source(source: Path, *targets: Path) -> None:
    """Refuse to write over a recording or what is read beside it, by whatever name."""
    own = [path for path in (source, *map(source.with_suffix, (".json", ".toml"))) if path.exists()]
    for target in targets:
        if target.exists() and any(target.samefile(path) for path in own):
            raise click.UsageError(
                f"--output: got {target}, which belongs to the recording; name another file"
            )


def _choose(name: str, window_ms: float | None) -> Callable[..., Samples]:
    from feel321.stimuli.reducers.registry import REDUCERS

    if window_ms is None:
        return REDUCERS[name]
    windowed = [
        other for other, reducer in REDUCERS.items() if "window_s" in signature(reducer).parameters
    ]
    if name not in windowed:
        raise click.UsageError(
            f"--window-ms: {name} has no window, allowed with: {', '.join(windowed)}"
        )
    if not 0 < window_ms < math.inf:
        raise click.UsageError(
            f"--window-ms: got {window_ms:g}, allowed is a finite time above 0 ms"
        )
    chosen: Callable[..., Samples] = REDUCERS[name]
    return partial(chosen, window_s=window_ms / 1000)


def _condition(recording: Recording, steps: Conditioning | None) -> Recording:
    from feel321.stimuli.condition import condition

    try:
        return recording if steps is None else condition(recording, steps)
    except ValueError as error:
        raise ValueError(
            f"{recording.name}: {error}; or take it as it was measured, with --raw"
        ) from None


def _tell_steps(recording: Recording, steps: Conditioning | None) -> dict[str, Any]:
    from feel321.stimuli.condition import list_steps

    if steps is None:
        return {"conditioning": None, "steps": []}
    return {"conditioning": asdict(steps), "steps": list_steps(steps, recording.rate_hz)}


def _settle_steps(
    recording: Recording, sidecar: Path, *, raw: bool
) -> tuple[Conditioning | None, str]:
    """Find out how the recording was conditioned before it was reduced, and where that is known from."""
    from feel321.stimuli.condition import Conditioning

    facts = _read_sidecar(sidecar)
    if facts is None:
        return (
            (None, "--raw")
            if raw
            else (Conditioning(), f"assumed: no {sidecar.name} of reduce beside it")
        )
    if facts["recording_sha256"] != recording.sha256:
        warn(f"{sidecar.name}: was written for another recording or file than {recording.name}")
    # None for --raw, and in the files of versions that conditioned nothing.
    source, told = f"as {sidecar.name} says", facts.get("conditioning")
    if told is None:
        return None, source
    if raw:
        raise click.UsageError(
            f"--raw: {sidecar.name} says that its WAV was reduced from the conditioned recording; leave out --raw, or "
            "reduce the recording again with --raw"
        )
    try:
        return Conditioning(**told), source
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{sidecar.name}: no conditioning ({error}); reduce the recording again"
        ) from None


def _read_sidecar(path: Path) -> dict[str, Any] | None:
    """Read what `reduce` wrote beside a WAV file; None where there is no such file, or it is of another kind."""
    if not path.is_file():
        return None
    try:
        facts = json.loads(path.read_bytes())
    except ValueError as error:
        raise ValueError(
            f"{path.name}: not JSON ({error}); remove it, or reduce the recording again"
        ) from None
    return (
        facts if isinstance(facts, dict) and {"recording_sha256", "reducer"} <= set(facts) else None
    )


def _check_pair(recording: Recording, samples: Samples, *, rate_hz: int, name: str) -> None:
    if samples.ndim != 1:
        raise ValueError(
            f"{name}: got {len(samples)} channels, a reduced signal has 1; reduce it first"
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


def _describe(recording: Recording, reducer: str, window_ms: float | None) -> dict[str, Any]:
    from feel321.stimuli.version import __version__

    return {
        "recording": recording.name,
        "recording_sha256": recording.sha256,
        "reducer": reducer,
        "window_ms": window_ms,
        "unit": "m/s^2",
        "version": __version__,
    }


def _match(recording: Recording, samples: Samples) -> dict[str, Any]:
    from feel321.stimuli.match import spectral_match_details, temporal_match_details

    conditioned, rate_hz = recording.acceleration, recording.rate_hz
    details = asdict(spectral_match_details(conditioned, samples, rate_hz))
    spectral = {name: value for name, value in details.items() if isinstance(value, float | int)}
    temporal = asdict(temporal_match_details(conditioned, samples))
    told = {"spectral_match": details["reason"], "temporal_match": temporal.pop("reason")}
    if math.isnan(spectral["bounded"]):
        told["spectral_match_bounded"] = told["spectral_match"]
    return {
        "spectral_match": spectral.pop("value"),
        "temporal_match": temporal.pop("value"),
        "spectral_match_bounded": spectral.pop("bounded"),
        "rate_hz": recording.rate_hz,
        "n_samples": recording.n_samples,
        **spectral,
        **temporal,
        "reasons": {name: reason for name, reason in told.items() if reason},
    }


def _print_matches(facts: dict[str, Any]) -> None:
    from feel321.stimuli.match import METRICS

    told = ", ".join(facts["steps"]) or "none, as it was measured"
    source = f" ({facts['conditioning_from']})" if "conditioning_from" in facts else ""
    click.echo(f"conditioning of the recording: {told}{source}")
    compared = (
        f"{facts['n_frequencies']} frequencies, {facts['lowest_hz']:.1f} to {facts['highest_hz']:.1f} Hz, "
        f"{facts['n_left_out']} left out"
    )
    silent = ", ".join("xyz"[axis] for axis in facts["silent_axes"]) or "none"
    details = {"spectral_match": compared, "temporal_match": f"silent axes: {silent}"}
    for name in METRICS:
        detail = f" ({details[name]})" if name in details else ""
        value = (
            f"none: {facts['reasons'][name]}"
            if name in facts["reasons"]
            else f"{facts[name]:.4f}{detail}"
        )
        click.echo(f"{name.replace('_', ' ')} {value}")
