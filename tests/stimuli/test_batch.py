"""Many recordings at once give what one at a time gives: reducers bit for bit, metrics but for the last digits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321 import stimuli

PRIMES = (2, 3, 17, 101, 349, 997)
LENGTHS = st.one_of(st.integers(1, 400), st.sampled_from(PRIMES))


@st.composite
def batches(draw: st.DrawFn) -> tuple[np.ndarray, float]:
    """Noise of very different strengths, with silent signals, silent axes, equal axes and axes that cancel."""
    k, n, seed = draw(st.integers(1, 6)), draw(LENGTHS), draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    samples = rng.standard_normal((k, 3, n)) * 10.0 ** rng.integers(-3, 4, (k, 1, 1))
    turns = {
        "silent": [0, 0, 0],
        "silent axis": [1, 0, 1],
        "equal": [1, 1, 1],
        "cancel": [1, -1, 0],
    }
    for place in range(k):
        kind = draw(st.sampled_from(["as it is", *turns]))
        if kind in turns:
            samples[place] = np.multiply.outer(turns[kind], samples[place, 0])
    return samples, draw(st.sampled_from([1000.0, 3200.0, 44_100.0]))


@pytest.mark.parametrize("name", stimuli.REDUCERS)
@given(given=batches())
@settings(max_examples=4)
def test_reduced_together_or_one_by_one_is_the_same_bit_for_bit(
    name: str, given: tuple[np.ndarray, float]
) -> None:
    samples, rate_hz = given
    wanted = [stimuli.reduce(one, name, rate_hz=rate_hz).samples for one in samples]
    given = [stimuli.Recording(one, rate_hz) for one in samples]
    assert np.array_equal(stimuli.reduce_many(given, name), wanted)
    assert np.array_equal(stimuli.REDUCERS[name](samples, rate_hz), wanted)


def recordings() -> list[stimuli.Recording]:
    """Unequal lengths and rates, in no order, some equal."""
    rng = np.random.default_rng(5)
    kinds = [(300, 1000.0), (299, 1000.0), (300, 1000.0), (300, 2000.0), (1, 1000.0), (300, 1000.0)]
    return [
        stimuli.Recording(rng.standard_normal((3, n)), rate, f"r{place}")
        for place, (n, rate) in enumerate(kinds)
    ]


def test_recordings_of_all_kinds_keep_their_order() -> None:
    given = recordings()
    found = stimuli.reduce_many(given, "dft321_windowed", window_s=0.02, workers=2)
    for one, own in zip(given, found, strict=True):
        alone = stimuli.reduce(one, "dft321_windowed", window_s=0.02)
        assert np.array_equal(own, alone)
        assert (own.rate_hz, own.reducer, own.recording) == (one.rate_hz, alone.reducer, one.name)


def test_what_is_no_batch_is_refused() -> None:
    scene = stimuli.make_scene("bumps", duration_s=0.1)
    with pytest.raises(TypeError, match=r"one Recording; write \[recording\]"):
        stimuli.reduce_many(scene)
    with pytest.raises(TypeError, match="each be a Recording, got ndarray"):
        stimuli.reduce_many([scene, np.ones((3, 10))])
    with pytest.raises(ValueError, match="has no window"):
        stimuli.reduce_many([scene], "sax321", window_s=0.1)
    with pytest.raises(ValueError, match=r"recording 'bumps': reducer .* must return the shape"):
        stimuli.reduce_many([scene], lambda one, _: one)
    assert stimuli.reduce_many([]) == []
