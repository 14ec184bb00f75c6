"""Rival metrics of a study's stimuli."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rivals import RIVALS
from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import make_scene
from feel321.study.analyze import measure_rivals

if TYPE_CHECKING:
    from pathlib import Path


def test_rivals_of_a_set_are_those_of_its_reductions(tmp_path: Path) -> None:
    scenes = [make_scene(name, duration_s=0.3) for name in ("bumps", "hard_taps")]
    steps = Conditioning(high_pass_hz=30)
    built = build_stimuli(
        scenes, tmp_path / "set", reducers=["saz321", "dft321"], conditioning=steps
    )
    found = measure_rivals(scenes, built, Recipe(conditioning=steps))
    tests = [one for one in built if one.role == "test"]
    assert found.index.tolist() == [one.stimulus_id for one in tests]
    assert found.columns.tolist() == list(RIVALS)
    for one in tests:
        ready = condition(next(s for s in scenes if s.name == one.recording), steps)
        reduced = REDUCERS[one.reducer](ready.acceleration, ready.rate_hz)
        for name in RIVALS:
            expected = METRICS[name](ready.acceleration, reduced, ready.rate_hz)
            assert found.loc[one.stimulus_id, name] == pytest.approx(expected, rel=1e-9, abs=1e-9)
