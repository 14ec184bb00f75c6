"""Verbs for single recordings: reduce one, match one."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import partial
from inspect import signature
from typing import TYPE_CHECKING, Any

import click

from study.commands.shared import FILE, dump_json, json_option, print_json, recording_argument

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from stimuli.recording import Recording

    Samples = NDArray[np.float64]

RATE_TOLERANCE_HZ = 1.0
"""A WAV header holds whole Hz only; a recording's true rate may lie between."""


class ReducerName(click.ParamType[str]):
    """The name of a reducer; the registry, which takes numpy, is read only where the names are wanted."""

    name = "reducer"

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:  # noqa: ARG002 - click's form
        """List the names, for the help.

        Parameters
        ----------
        param : click.Parameter
            The option.
        ctx : click.Context
            The call.

        Returns
        -------
        str
            The names as click writes choices.
        """
        from stimuli.reduce import REDUCERS

        return f"[{'|'.join(REDUCERS)}]"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Check a name.

        Parameters
        ----------
        value : object
            The name.
        param : click.Parameter
            The option.
        ctx : click.Context
            The call.

        Returns
        -------
        str
            The same name.
        """
        from stimuli.reduce import REDUCERS

        name = str(value)
        if name not in REDUCERS:
            self.fail(f"got {name!r}, allowed: {', '.join(REDUCERS)}", param, ctx)
        return name


def _check_wav(_context: click.Context, _parameter: click.Parameter, path: Path) -> Path:
    if path.suffix.lower() != ".wav":
        raise click.BadParameter(f"got {str(path)!r}, allowed is a name that ends in .wav; give it that ending")
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
@click.option("--window-ms", type=float, help="Window of the reducers that have one.  [default: 35]")
@click.option("--force", is_flag=True, help="Replace the output if it is there.")
@json_option
def reduce(
    *, recording: Recording, reducer: str, output: Path, window_ms: float | None, force: bool, as_json: bool
) -> None:
    """Reduce a recording to one axis.

    The result is a float32 WAV file in m/s^2, unconditioned, with a JSON file that says how it was made.
    """
    from stimuli.wav import write_wav
    from study.files import write_text

    sidecar = output.with_suffix(".json")
    _spare_source(click.get_current_context().params["recording"], output, sidecar)
    taken = [str(path) for path in (output, sidecar) if path.exists()]
    if taken and not force:
        raise FileExistsError(f"{', '.join(taken)}: is there already; name another file or add --force")
    if not output.parent.is_dir():
        raise FileNotFoundError(f"{output.parent}: there is no such folder; make it first")
    reduced = _choose(reducer, window_ms)(recording.acceleration, recording.rate_hz)
    facts = _describe(recording, reducer, window_ms) | _match(recording, reduced)
    write_wav(output, reduced, round(recording.rate_hz))
    write_text(sidecar, dump_json(facts) + "\n")
    if as_json:
        print_json(facts)
    else:
        click.echo(f"{output}: {recording.name} through {reducer}, {recording.n_samples} samples, m/s^2")
        _print_matches(facts)


@click.command(epilog="Example: feel321 match oak.csv oak-dft321.wav --json")
@recording_argument
@click.argument("reduced", metavar="REDUCED.wav", type=FILE)
@json_option
def match(*, recording: Recording, reduced: Path, as_json: bool) -> None:
    """Match a reduced WAV file, in m/s^2, against its recording."""
    from stimuli.wav import read_wav

    samples, rate_hz = read_wav(reduced)
    _check_pair(recording, samples, rate_hz=rate_hz, name=reduced.name)
    facts = _match(recording, samples)
    if as_json:
        print_json(facts)
    else:
        _print_matches(facts)


def _spare_source(source: Path, *targets: Path) -> None:
    """Refuse to write over a recording or what is read beside it, by whatever name."""
    own = [path for path in (source, *map(source.with_suffix, (".json", ".toml"))) if path.exists()]
    for target in targets:
        if target.exists() and any(target.samefile(path) for path in own):
            raise click.UsageError(f"--output: got {target}, which belongs to the recording; name another file")


def _choose(name: str, window_ms: float | None) -> Callable[..., Samples]:
    from stimuli.reduce import REDUCERS

    if window_ms is None:
        return REDUCERS[name]
    windowed = [other for other, reducer in REDUCERS.items() if "window_s" in signature(reducer).parameters]
    if name not in windowed:
        raise click.UsageError(f"--window-ms: {name} has no window, allowed with: {', '.join(windowed)}")
    if not 0 < window_ms < math.inf:
        raise click.UsageError(f"--window-ms: got {window_ms:g}, allowed is a finite time above 0 ms")
    chosen: Callable[..., Samples] = REDUCERS[name]
    return partial(chosen, window_s=window_ms / 1000)


def _check_pair(recording: Recording, samples: Samples, *, rate_hz: int, name: str) -> None:
    if samples.ndim != 1:
        raise ValueError(f"{name}: got {len(samples)} channels, a reduced signal has 1; reduce it first")
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
    from stimuli.version import __version__

    return {
        "recording": recording.name,
        "recording_sha256": recording.sha256,
        "reducer": reducer,
        "window_ms": window_ms,
        "unit": "m/s^2",
        "version": __version__,
    }


def _match(recording: Recording, samples: Samples) -> dict[str, Any]:
    from stimuli.match import spectral_match_details, temporal_match_details

    spectral = asdict(spectral_match_details(recording.acceleration, samples, recording.rate_hz))
    temporal = asdict(temporal_match_details(recording.acceleration, samples))
    return {
        "spectral_match": spectral.pop("value"),
        "temporal_match": temporal.pop("value"),
        "spectral_match_bounded": spectral.pop("bounded"),
        "rate_hz": recording.rate_hz,
        "n_samples": recording.n_samples,
        **spectral,
        **temporal,
    }


def _print_matches(facts: dict[str, Any]) -> None:
    click.echo(
        f"spectral match {facts['spectral_match']:.4f} ({facts['n_frequencies']} frequencies, "
        f"{facts['lowest_hz']:.1f} to {facts['highest_hz']:.1f} Hz, {facts['n_left_out']} left out)"
    )
    click.echo(f"spectral match, bounded {facts['spectral_match_bounded']:.4f}")
    silent = ", ".join("xyz"[axis] for axis in facts["silent_axes"]) or "none"
    click.echo(f"temporal match {facts['temporal_match']:.4f} (silent axes: {silent})")
