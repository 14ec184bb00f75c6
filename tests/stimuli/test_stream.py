import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.stimuli.reducers.registry import REDUCERS, WHY_NOT_STREAMING, StreamingReducer

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
    acceleration = np.random.default_rng(seed).standard_normal((3, n)) + np.array([
        [9.8],
        [0.0],
        [0.0],
    ])
    cuts = data.draw(st.lists(st.integers(0, n), max_size=30))
    stream = StreamingReducer(name, RATE)
    streamed = run(stream, acceleration, cuts)
    assert len(streamed) == n + stream.latency_samples
    offline = REDUCERS[name](acceleration, RATE)
    np.testing.assert_allclose(
        streamed[stream.latency_samples :], offline, rtol=1e-12, atol=1e-12 * 10
    )
    np.testing.assert_array_equal(streamed[: min(n, stream.latency_samples)], 0.0)


@pytest.mark.parametrize("name", sorted(WHY_NOT_STREAMING))
def test_reducers_that_need_the_whole_recording_say_so(name: str) -> None:
    with pytest.raises(
        ValueError, match=f"{name} cannot stream: .* needs? the whole recording; stream"
    ):
        StreamingReducer(name, RATE)


def test_every_reducer_either_streams_or_says_why_not() -> None:
    assert set(STREAMING) | set(WHY_NOT_STREAMING) == set(REDUCERS)
    for name in STREAMING:
        assert StreamingReducer(name, RATE).process(np.zeros((3, 0))).shape == (0,)


@pytest.mark.parametrize(
    ("block", "message"),
    [
        (np.ones((2, 5)), "three axes"),
        (np.ones((4, 3, 5)), "one stream"),
        (np.full((3, 2), np.nan), "must be finite"),
        (np.full((3, 2), 1e160), r"at most 1e\+60, got 1e\+160"),
    ],
)
def test_bad_blocks_are_refused(block: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StreamingReducer("dft321_windowed", RATE).process(block)


def test_a_refused_block_changes_nothing() -> None:
    bad = np.ones((3, 4))
    stream, samples = (
        StreamingReducer("say321_matched_running", RATE),
        np.random.default_rng(1).standard_normal((3, 30)),
    )
    for value, message in ((np.nan, "must be finite"), (1e160, "peak of at most")):
        bad[0, 1] = value
        with pytest.raises(ValueError, match=message):
            stream.process(bad)
    fresh = StreamingReducer("say321_matched_running", RATE)
    np.testing.assert_array_equal(stream.process(samples), fresh.process(samples))


@pytest.mark.parametrize("name", STREAMING)
def test_a_buffer_that_the_driver_fills_anew_changes_nothing_that_was_fed(name: str) -> None:
    samples = np.random.default_rng(0).standard_normal((3, 200))
    fresh, reused = (StreamingReducer(name, RATE) for _ in range(2))
    buffer = np.empty((3, 20))
    for start in range(0, 200, 20):
        buffer[:] = samples[:, start : start + 20]
        got = reused.process(buffer).copy()
        buffer[:] = 1e9
        expected = fresh.process(samples[:, start : start + 20])
        np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(reused.flush(), fresh.flush())
