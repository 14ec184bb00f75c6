from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.measures import compare_metrics_under_rotation
from feel321.analysis.tradeoff.stress.page import describe_metrics
from feel321.stimuli.reducers.registry import REDUCERS


def compare(recording: Any, **changes: Any) -> Any:
    return compare_metrics_under_rotation(
        recording, REDUCERS, rng=np.random.default_rng(0), **changes
    )


def test_the_temporal_match_moves_with_the_mounting_and_its_counterpart_does_not(drag: Any) -> None:
    row = compare(drag)
    assert row.moves
    assert row.temporal_high - row.temporal_low > 0.2
    assert row.invariant_high - row.invariant_low < 1e-9


def test_the_spectral_match_explodes_in_empty_bands_and_its_counterpart_does_not(made: Any) -> None:
    time = np.arange(4000) / 4000
    rng = np.random.default_rng(0)
    tone = np.array([[1.0], [0.5], [0.2]]) * np.sin(2 * np.pi * 100 * time)
    row = compare(made(tone + 1e-6 * rng.standard_normal((3, 4000)), rate_hz=4000))
    assert row.explodes
    assert row.worst_reducer == "mag321"  # rectified: all its energy in bands that are empty
    assert 0 <= row.spectral_bounded <= 1
    assert 0 <= row.spectral_energy_weighted <= 1
    assert f"({row.spectral_bounded:.2f} there)" in [*describe_metrics([row])][1]


def test_another_reducer_is_held_where_the_usual_one_is_not_there(drag: Any) -> None:
    few = {"soc321": REDUCERS["soc321"]}
    row = compare_metrics_under_rotation(drag, few, rng=np.random.default_rng(0))
    assert (row.held, row.worst_reducer) == ("soc321", "soc321")


def test_without_a_frequency_there_is_no_spectral_match(made: Any) -> None:
    slow = made(np.random.default_rng(0).standard_normal((3, 4)), rate_hz=30.0)
    row = compare_metrics_under_rotation(
        slow, {"sax321": REDUCERS["sax321"]}, rng=np.random.default_rng(0)
    )
    assert row.worst_reducer == ""
    assert np.isnan([row.spectral, row.spectral_bounded, row.spectral_energy_weighted]).all()
    assert not row.explodes


def test_sentences_count(drag: Any) -> None:
    still, moving = compare(BATTERY["near_silence"].make(0)), compare(drag)
    lines = [*describe_metrics([still, moving])]
    assert "of 2 scenes and recordings" in lines[0]
    assert len([*describe_metrics([compare(drag)])]) == 1 + moving.explodes


@pytest.mark.parametrize("name", BATTERY)
def test_counterparts_stand_still_in_every_scene(name: str, result: Any) -> None:
    row = next(row for row in result.metrics if row.recording == name)
    assert row.invariant_high - row.invariant_low < 1e-9
