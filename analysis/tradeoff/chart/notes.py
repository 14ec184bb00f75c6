"""What a chart leaves out or takes for granted, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.tradeoff.chart.axes import tell_plainly
from analysis.tradeoff.chart.cost import CALLS, RATE_HZ, REFERENCE_N

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.tradeoff.chart.records import Machine, Precision
    from stimuli.recording import Recording


def list_notes(
    recordings: Sequence[Recording], longest_s: float, *, precision: Sequence[Precision], machine: Machine
) -> tuple[str, ...]:
    """Say what was left out and what was assumed.

    Parameters
    ----------
    recordings : sequence of Recording
        The scenes.
    longest_s : float
        How much of each is used.
    precision : sequence of Precision
        What became of 32-bit input.
    machine : Machine
        What times were taken on.

    Returns
    -------
    tuple of str
        Sentences.
    """
    return (
        "Times are those of this run on this machine and differ from run to run; all other figures come out again from "
        "the same recordings and seed.",
        *_note_load(machine),
        f"Methods are compared at {tell_plainly(REFERENCE_N)} samples; × real time is told for {RATE_HZ / 1000:g} kHz. "
        "The signals that are timed are white noise.",
        "Over scenes the median is told and compared, not the mean: spectral match has no lower bound, so that one "
        "scene with a band nearly without energy would decide. The means stand in tables/points.csv.",
        *_note_pieces(recordings, longest_s),
        "sax/say/saz321 is any single axis: averaged over sensor orientations the three are equal by construction, and "
        "so are their matched and their running forms. Each kind is one point, the mean of its three members; tables "
        "and results.json keep all names. Ratings are those of the axes as mounted.",
        "Scenes were resampled to every sampling rate and compared with the recording at that rate: above a "
        "recording's own rate nothing is added, below it what lies above half the new rate is lost to both.",
        *_note_precision(precision),
        "The hop of every windowed reducer is half its window. Smaller hops of dft321_windowed are the mean of runs "
        "over shifted signals, which is the same output; an implementation of its own could be a little cheaper.",
        f"Block sizes: time of {CALLS} calls or more at {RATE_HZ / 1000:g} kHz, the stream being under way. "
        "A block of k samples adds (k - 1) / rate of waiting to the algorithmic latency.",
        "Memory is what numpy asks for beside the input, the output included; what a Fourier transform keeps inside is "
        "not seen.",
    )


def _note_load(machine: Machine) -> list[str]:
    if machine.load is None or machine.load <= machine.cores:
        return []
    busy = f"{machine.load:.1f} programs for {machine.cores} cores"
    return [f"The machine was busy when this began ({busy}): times are longer than on an idle one, ratios less so."]


def _note_pieces(recordings: Sequence[Recording], longest_s: float) -> list[str]:
    cut = sum(recording.duration_s > longest_s for recording in recordings)
    if not cut:
        return []
    longer = f"{cut} of {len(recordings)} recordings are longer than {longest_s:g} s"
    return [f"{longer}: their middle was used; --full uses all."]


def _note_precision(precision: Sequence[Precision]) -> list[str]:
    kinds = sorted({row.output for row in precision})
    if kinds != ["float64"]:
        return [f"Output for 32-bit input: {', '.join(kinds)}."]
    return [
        "32-bit input is not computed in 32 bit: every reducer turns it into float64 first and answers in float64. "
        "What changes is the rounding of the input, and the time that the conversion takes.",
        *_note_arithmetic(precision),
    ]


def _note_arithmetic(precision: Sequence[Precision]) -> list[str]:
    losses = [(row.arithmetic_db, row) for row in precision if row.arithmetic_db is not None]
    if not losses:
        return []
    loss, worst = max(losses, key=lambda one: one[0])
    return [
        "In 32-bit arithmetic throughout (samples, coefficients and transforms) the error is at worst "
        f"{loss:.0f} dB relative to the output in 64 bits, of {worst.reducer} on {worst.worst}."
    ]
