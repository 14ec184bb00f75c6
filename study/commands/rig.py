"""The verb for the rig: what hangs on this machine, and whether it plays in time."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from study.commands.shared import FILE, find_study, json_option, print_json, show_progress, warn
from study.folder import StudyFolder

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from study.actuator.doctor import Examination
    from study.actuator.rig import Rig

RATE_HZ = 48000.0
"""At which a device is tried that belongs to no study."""


@click.command(epilog="Example: feel321 doctor my-study --seconds 10")
@click.argument("folder", metavar="[STUDY]", type=FILE, required=False)
@click.option("--device", help="Another device than the rig's: its name, or a part of it that no other one has.")
@click.option("--seconds", type=click.FloatRange(0, 3600), default=5.0, show_default=True, help="So long pulses play.")
@json_option
@click.pass_context
def doctor(context: click.Context, *, folder: Path | None, device: str | None, seconds: float, as_json: bool) -> None:
    """List audio devices, check rig.toml, and measure latency and jitter.

    Quiet pulses are played on every actuator, through the same stream as in a session. Without a study, or where the
    rig plays to files, --device names what to play on.
    """
    from study.actuator.doctor import survey_devices

    rig, rate_hz = _find_rig(folder, device=device)
    devices = survey_devices()
    examination = _examine(rig, rate_hz=rate_hz, seconds=seconds) if rig is not None and seconds else None
    if as_json:
        print_json({"devices": devices, "examination": None if examination is None else asdict(examination)})
    else:
        _print_devices(devices)
        _print_examination(examination)
    if examination is not None and (examination.n_failed or examination.n_underruns):
        context.exit(1)


def _find_rig(folder: Path | None, *, device: str | None) -> tuple[Rig | None, float]:
    """Read the study's rig, or make one of two coils for a device; None if there is nothing to play on."""
    from study.actuator.rig import FILE_DEVICE, LimitsTable, Rig, read_rig, take_device
    from study.settings.reading import read_settings

    study = StudyFolder(Path()) if folder is None else find_study(folder)
    rate_hz = read_settings(study.settings).rig.rate_hz if study.settings.is_file() else RATE_HZ
    if study.rig.is_file():
        rig = read_rig(study.rig)
    elif device is not None:
        rig = Rig(limits=LimitsTable(peak_m_s2=100.0, rms_m_s2=50.0, duration_s=30.0))
    else:
        return None, rate_hz
    rig = rig if device is None else take_device(rig, device)
    return (None if rig.device.name == FILE_DEVICE else rig), rate_hz


def _examine(rig: Rig, *, rate_hz: float, seconds: float) -> Examination:
    from study.actuator.doctor import examine_rig

    with show_progress("pulses") as progress:
        return examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=progress)


def _print_devices(devices: Sequence[Mapping[str, Any]]) -> None:
    for device in devices:
        rates = ", ".join(f"{rate_hz:g}" for rate_hz in device["rates_hz"]) or "none of those tried"
        channels = f"{device['outputs']} out, {device['inputs']} in"
        program = "; through a program" if device["is_program"] else ""
        click.echo(f"{device['name']} ({device['host_api']}): {channels}; plays at {rates} Hz{program}")


def _print_examination(found: Examination | None) -> None:
    if found is None:
        click.echo("nothing was played; name a device with --device, or in the study's rig.toml")
        return
    click.echo(f"{found.device} ({found.host_api}) played at {found.rate_hz:g} Hz; latency {found.latency_ms:.1f} ms")
    click.echo(f"pulses {found.n_pulses}, failed {found.n_failed}, underruns {found.n_underruns}")
    jitter = f"jitter {found.jitter_ms:.2f} ms (median), {found.jitter_99_ms:.2f} ms (99 %)"
    click.echo(f"requested to onset {found.onset_ms:.1f} ms, {jitter}; longest block {found.callback_ms_max:.2f} ms")
    if found.sensed_ms is not None:
        jitter = f"jitter {found.sensed_jitter_ms:.2f} ms (median), {found.sensed_jitter_99_ms:.2f} ms (99 %)"
        click.echo(f"onset's block to sensor {found.sensed_ms:.1f} ms, {jitter}")
    if found.stop_ms is not None:
        click.echo(f"a stop is silence after {found.stop_ms:.0f} ms at most; latency_s in rig.toml shortens it")
    if found.is_program:
        warn(
            f"{found.device}: a program plays it (a sound server, say), which may convert the rate, and copy channels "
            "to others, without saying so; name the card itself, or give it as many channels there as the rig has"
        )
    if found.error:
        warn(found.error)
