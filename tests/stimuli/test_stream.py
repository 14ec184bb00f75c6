from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stimuli.fourier import dft321_windowed
from stimuli.principal import pca321_adaptive
from stimuli.reduce import REDUCERS
from stimuli.stream import WHY_NOT_STREAMING, StreamingReducer

if TYPE_CHECKING:
    from collections.abc import Callable

RATE = 1000.0
STREAMING = [name for name in REDUCERS if name not in WHY_NOT_STREAMING]


def run(stream: StreamingReducer, acceleration: np.ndarray, cuts: list[int]) -> np.ndarray:
    pieces = np.split(acceleration, sorted(cuts), axis=1)
    outputs = [stream.process(piece) for piece in pieces]
    assert [len(out) for out in outputs] == [piece.shape[1] for piece in pieces]
    return np.concatenate([*outputs, stream.flush()])


@pytest.mark.parametrize("name", STREAMING)
@settings(max_examples=60)
@given(data=st.data(), n=st.integers(0, 400), seed=st.integers(0, 99))
def test_any_partition_gives_the_offline_result_after_a_constant_delay(
    name: str, data: st.DataObject, n: int, seed: int
) -> None:
    acceleration = np.random.default_rng(seed).standard_normal((3, n)) + np.array([[9.8], [0.0], [0.0]])
    cuts = data.draw(st.lists(st.integers(0, n), max_size=30))
    stream = StreamingReducer(name, RATE)
    streamed = run(stream, acceleration, cuts)
    assert len(streamed) == n + stream.latency_samples
    offline = REDUCERS[name](acceleration, RATE)
    np.testing.assert_allclose(streamed[stream.latency_samples :], offline, rtol=1e-12, atol=1e-12 * 10)
    np.testing.assert_array_equal(streamed[: min(n, stream.latency_samples)], 0.0)


@pytest.mark.parametrize("offline", [dft321_windowed, pca321_adaptive])
@pytest.mark.parametrize("window_s", [0.002, 0.01, 0.2])
def test_window_length_is_the_offline_one(offline: Callable[..., np.ndarray], window_s: float) -> None:
    acceleration = np.random.default_rng(3).standard_normal((3, 500))
    stream = StreamingReducer(offline.__name__, RATE, window_s)
    streamed = run(stream, acceleration, [7, 8, 8, 300])
    expected = offline(acceleration, RATE, window_s=window_s)
    np.testing.assert_allclose(streamed[stream.latency_samples :], expected, atol=1e-12)
    assert stream.latency_samples == round(window_s * RATE) - 1


def test_no_output_depends_on_input_that_has_not_arrived() -> None:
    first = np.random.default_rng(0).standard_normal((3, 300))
    second = first.copy()
    second[:, 200:] += 100.0
    for name in STREAMING:
        one, two = (StreamingReducer(name, RATE).process(signal)[:200] for signal in (first, second))
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("name", sorted(WHY_NOT_STREAMING))
def test_reducers_that_need_the_whole_recording_say_so(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} cannot stream: .* needs? the whole recording; stream"):
        StreamingReducer(name, RATE)


def test_every_reducer_either_streams_or_says_why_not() -> None:
    assert set(STREAMING) | set(WHY_NOT_STREAMING) == set(REDUCERS)
    for name in STREAMING:
        assert StreamingReducer(name, RATE).process(np.zeros((3, 0))).shape == (0,)


def test_a_flushed_stream_has_ended() -> None:
    stream = StreamingReducer("dft321_windowed", RATE)
    stream.process(np.ones((3, 5)))
    assert len(stream.flush()) == stream.latency_samples
    assert len(stream.flush()) == 0
    with pytest.raises(ValueError, match="make a new StreamingReducer"):
        stream.process(np.ones((3, 5)))


@pytest.mark.parametrize(
    ("block", "message"),
    [(np.ones((2, 5)), "three axes"), (np.ones((4, 3, 5)), "one stream"), (np.full((3, 2), np.nan), "not finite"),
     (np.full((3, 2), 1e160), r"got a peak of 1e\+160, allowed is up to 1e\+60")],
)
def test_bad_blocks_are_refused(block: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StreamingReducer("dft321_windowed", RATE).process(block)


def test_an_unknown_name_is_answered_with_the_list() -> None:
    with pytest.raises(ValueError, match="allowed is one of sax321"):
        StreamingReducer("sum", RATE)
