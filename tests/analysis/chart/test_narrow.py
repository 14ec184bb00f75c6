from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import scipy.fft
import scipy.signal

from feel321.analysis.tradeoff.chart.cost import measure_loss, reduce_in_32_bit
from feel321.analysis.tradeoff.chart.page import collect_notes, tabulate
from feel321.stimuli.reducers import axes, fourier
from feel321.stimuli.reducers.registry import REDUCERS

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.analysis.tradeoff.chart.compute import Chart
    from feel321.stimuli.recording import Recording


@pytest.fixture
def noise(make_recording: Callable[[str], Recording]) -> Recording:
    samples = np.random.default_rng(6).standard_normal((3, 20_000))
    return replace(make_recording("bumps"), name="noise", acceleration=samples, sha256="")


def test_the_error_is_that_of_32_bits(noise: Recording) -> None:
    loss, worst = measure_loss("dft321", [noise])
    assert loss is not None
    assert -170 < loss < -100
    assert worst == "noise"
    rounding, _ = measure_loss("sax321", [noise])
    exact = noise.acceleration[0]
    rounded = exact.astype(np.float32).astype(np.float64)
    assert rounding == pytest.approx(
        10 * np.log10(np.sum((rounded - exact) ** 2) / np.sum(exact**2))
    )


@pytest.mark.parametrize("name", REDUCERS)
def test_transforms_and_recursions_see_nothing_wider_than_32_bits(
    name: str, noise: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every output is checked where it is made; so is what goes in and comes out of scipy."""
    seen: set[str] = set()

    def spy(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: object, **named: object) -> object:
            result = function(*given, **named)
            every = (*given, *named.values(), *(result if isinstance(result, tuple) else (result,)))
            seen.update(str(one.dtype) for one in every if isinstance(one, np.ndarray))
            return result

        return call

    for module, used in ((scipy.fft, "rfft"), (scipy.fft, "irfft"), (scipy.signal, "lfilter")):
        monkeypatch.setattr(module, used, spy(getattr(module, used)))
    reduced = reduce_in_32_bit(name, noise)
    assert seen <= {"float32", "complex64"}
    assert bool(seen) == any(
        part in name for part in ("dft", "running", "matched_windowed", "carrier")
    )
    exact = REDUCERS[name](noise.acceleration, noise.rate_hz)
    assert 1e-17 < np.sum((reduced - exact) ** 2) / np.sum(exact**2) < 1e-8


def test_the_error_does_not_depend_on_the_unit(noise: Recording) -> None:
    """Powers of two are exact in both widths."""
    loud = replace(noise, acceleration=2.0**9 * noise.acceleration, sha256="")
    for name in ("dft321", "pca321", "saz321_matched_running"):
        assert measure_loss(name, [loud])[0] == measure_loss(name, [noise])[0]


def test_the_reducers_themselves_are_left_alone(noise: Recording) -> None:
    before = REDUCERS["dft321"](noise.acceleration, noise.rate_hz)
    reduce_in_32_bit("dft321", noise)
    assert (fourier.np, axes.np) == (np, np)
    assert np.array_equal(REDUCERS["dft321"](noise.acceleration, noise.rate_hz), before)


def test_the_worst_recording_is_named_and_silence_left_out(noise: Recording, tiny: Chart) -> None:
    silent = replace(noise, name="silent", acceleration=np.zeros((3, 100)), sha256="")
    exact = replace(noise, name="exact", acceleration=np.ones((3, 64)), sha256="")
    assert measure_loss("soc321", [silent, exact]) == (None, "")
    assert measure_loss("soc321", [silent, noise, exact])[1] == "noise"
    rows = tiny.precision.to_dict("records")
    worst = tiny.precision.loc[tiny.precision["arithmetic_db"].idxmax()]
    notes = "\n".join(collect_notes([noise], 9.0, precision=rows, machine=tiny.machine))
    level = f"{worst['arithmetic_db']:.0f} dB relative to the output in 64 bits"
    assert f"{level}, of {worst['reducer']} on" in notes
    (table,) = [one for one in tabulate(tiny.to_frames()) if "Worst recording" in one.head]
    assert {row[-1] for row in table.rows} <= set(tiny.scenes["name"])
