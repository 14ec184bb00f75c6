from itertools import product

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.report import section as parts
from feel321.analysis.report.section import thin_rows


def make_rows(people: int, scenes: int, *, repeats: int = 1) -> pd.DataFrame:
    cells = product(range(people), range(scenes), "xyz", range(repeats))
    rows = pd.DataFrame(cells, columns=["participant", "recording", "item", "repeat"])
    rows["item"] = rows["recording"].astype(str) + rows["item"]
    return rows


def thin(rows: pd.DataFrame, seed: int = 0) -> tuple[pd.DataFrame, str]:
    return thin_rows(rows, n_slopes=2, rng=np.random.default_rng(seed))


def test_what_can_be_carried_stays_as_it_is() -> None:
    rows = make_rows(20, 10)
    left, told = thin(rows)
    assert left is rows
    assert not told


@pytest.mark.parametrize(
    ("people", "scenes", "kept"), [(64, 20, (32, 20)), (20, 64, (20, 32)), (64, 64, (32, 64))]
)
def test_the_longer_side_is_halved(
    monkeypatch: pytest.MonkeyPatch, people: int, scenes: int, kept: object
) -> None:
    rows = make_rows(people, scenes)
    # Just below what the whole has, so that one halving does.
    whole = people * 3 + scenes + scenes * 3 + people * scenes
    monkeypatch.setattr(parts, "MOST_DENSE", whole - max(people * scenes, people * 3) - 1)
    left, told = thin(rows)
    assert (left["participant"].nunique(), left["recording"].nunique()) == kept
    assert told == (
        f"mixed models use {kept[0]} of {people} participants and {kept[1]} of {scenes} recordings, drawn at "
        f"random: {len(rows)} ratings are too many for one fit."
    )


def test_copies_go_before_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    # 12 sources: one of 20 recordings, one of 10, ten of one or two. Drawn without a look, some would be lost.
    sources = {
        scene: 0 if scene < 20 else 1 if scene < 30 else 2 + scene % 10 for scene in range(45)
    }
    rows = make_rows(20, 45).assign(source=lambda own: own["recording"].map(sources))
    monkeypatch.setattr(parts, "is_large", lambda left, _: left["recording"].nunique() > 12)
    for seed in range(5):
        left, told = thin(rows, seed)
        assert (left["recording"].nunique(), left["source"].nunique()) == (11, 11)
        assert "20 of 20 participants and 11 of 45 recordings, drawn at random" in told
    monkeypatch.setattr(parts, "is_large", lambda left, _: left["recording"].nunique() > 22)
    per_source = thin(rows)[0].groupby("source")["recording"].nunique()
    assert len(per_source) == 12
    assert per_source[[0, 1]].min() >= per_source.max() - 1
