"""Maps per interaction and surface: planted places lie within their ellipses; attributes within recordings."""

from __future__ import annotations

import math
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis import maps
from feel321.analysis.report import pairs as report
from feel321.analysis.resampling import Choices
from feel321.analysis.space import align_spaces, bootstrap_space, make_space
from feel321.analysis.table.reading import Further, read_table

if TYPE_CHECKING:
    from feel321.analysis.table.items import Table
    from feel321.records import Statistic

NAMES = ("saz321", "soc321", "mag321", "dft321", "pca321", "original")
PLACES = {
    "tap": np.array([[30, 0], [10, 20], [-25, 15], [-15, -25], [20, -20], [-20, 10.0]]),
    "drag": np.array([[-30, 5], [25, 15], [0, 35], [10, -30], [30, -10], [-35, -15.0]]),
}
"""Where stimuli are planted: another shape for each interaction."""

PEOPLE, SURFACES = 15, 4


def plant(*, noise: float = 6.0, seed: int = 0, labelled: bool = True) -> Table:
    """Make judgements of 15 people of every pair on both interactions and four surfaces."""
    rng = np.random.default_rng(seed)
    rows, stimuli = [], []
    for interaction, surface in product(PLACES, range(1, SURFACES + 1)):
        places, recording = PLACES[interaction], f"{interaction}-{surface}"
        for number, name in enumerate(NAMES):
            role = "reference" if name == "original" else "test"
            about = (recording, name, role, *places[number], rng.uniform())
            stimuli.append((f"{recording}-{name}", *about))
        for two, one in combinations(range(len(NAMES)), 2):
            ids = (f"{recording}-{NAMES[one]}", f"{recording}-{NAMES[two]}")
            apart = np.hypot(*(places[one] - places[two]))
            felt = np.clip(apart + rng.normal(0, noise, PEOPLE), 0, 100)
            rows += [(f"p{who:02d}", *ids, rating) for who, rating in enumerate(felt)]
    ratings = pd.DataFrame(rows, columns=["participant", "stimulus_id", "reference_id", "rating"])
    ratings = ratings.assign(scale="dissimilarity", trial=range(1, len(rows) + 1))
    columns = ["stimulus_id", "recording", "reducer", "role", "temporal_match", "roughness", "chance"]  # fmt: skip
    manifest = pd.DataFrame(stimuli, columns=columns).assign(level="as_is")
    manifest["temporal_match"] = 0.5 + manifest["temporal_match"] / 100
    recordings = manifest["recording"].unique()
    split = [name.split("-") for name in recordings]
    said = pd.DataFrame(split, columns=["interaction", "sample"], index=recordings)
    further = Further(pd.DataFrame(), labels=said) if labelled else None
    return read_table(ratings, manifest, further=further)


@pytest.fixture(scope="module")
def planted() -> Table:
    return plant()


@pytest.fixture(scope="module")
def groups(planted: Table) -> list[maps.GroupMap]:
    return maps.map_groups(planted.rows, draws=60, rng=np.random.default_rng(1))


def order(names: tuple[str, ...]) -> list[int]:
    return [NAMES.index(name) for name in names]


def test_the_groups_are_all_each_label_and_both(groups: list[maps.GroupMap]) -> None:
    kinds = [(one.kind, one.name) for one in groups]
    assert kinds[:3] == [("all", "all"), ("interaction", "drag"), ("interaction", "tap")]
    assert [name for kind, name in kinds if kind == "sample"] == ["1", "2", "3", "4"]
    assert sum(kind == maps.BOTH for kind, _ in kinds) == 2 * SURFACES
    assert [one.n_recordings for one in groups][:4] == [8, 4, 4, 2]


@pytest.mark.parametrize("interaction", ["tap", "drag"])
def test_planted_places_lie_within_the_ellipses_of_their_interaction(
    groups: list[maps.GroupMap], interaction: str
) -> None:
    (found,) = (one for one in groups if one.name == interaction)
    truth = PLACES[interaction][order(found.names)]
    turned, _ = maps.turn_map(make_space(truth - truth.mean(axis=0), 0.0), found.space)
    assert found.ellipses is not None
    off = turned.positions - found.space.positions
    angle = np.radians(found.ellipses.angle)
    along = off[:, 0] * np.cos(angle) + off[:, 1] * np.sin(angle)
    across = off[:, 1] * np.cos(angle) - off[:, 0] * np.sin(angle)
    far = (along / found.ellipses.half_axes[:, 0]) ** 2
    far += (across / found.ellipses.half_axes[:, 1]) ** 2
    assert (far <= 1).sum() >= len(NAMES) - 1
    assert found.ellipses.half_axes.max() < 8
    assert np.hypot(*off.T).max() < 4


def spread(ellipses: Statistic) -> np.ndarray:
    """The matrix of each ellipse: its axes turned by its angle."""
    angle = np.radians(ellipses.angle)
    axes = np.stack([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.einsum("ain,ajn,na->nij", axes, axes, ellipses.half_axes**2)


def test_ellipses_turn_with_their_map(groups: list[maps.GroupMap]) -> None:
    whole, drag = groups[0], groups[1]
    mirror = make_space(whole.space.positions * [-1, 1], 0.0)
    for onto in (whole.space, mirror):
        space, turned = maps._place(drag.matrices, onto, draws=8, rng=np.random.default_rng(4))
        assert turned is not None
        plain = bootstrap_space(drag.matrices, draws=8, rng=np.random.default_rng(4))
        turn = np.linalg.lstsq(plain.space.positions, space.positions, rcond=None)[0]
        expected = turn.T @ spread(plain) @ turn
        assert spread(turned) == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_maps_of_one_interaction_agree_and_those_of_two_do_less(
    groups: list[maps.GroupMap],
) -> None:
    found = maps.compare_groups(groups, permuted=50, rng=np.random.default_rng(0))
    found = pd.DataFrame(found).set_index(["kind", "first", "second"])["correlation"]
    truth = align_spaces(PLACES["drag"], PLACES["tap"], permutations=1).correlation
    assert found["interaction", "drag", "tap"] == pytest.approx(truth, abs=0.08)
    samples = found["sample"].drop("all", level="second")
    assert len(samples) == 6
    assert samples.min() > 0.97


def test_attributes_that_make_the_axes_are_found_and_chance_is_not(planted: Table) -> None:
    rows = planted.rows[planted.rows["interaction"] == "tap"]
    rng = np.random.default_rng(2)
    whole = maps.map_groups(rows, draws=3, rng=rng)[0]
    points = maps.gather_points(rows, planted.stimuli, whole, rng=rng)
    assert points.size == SURFACES * len(NAMES)
    found = pd.DataFrame(maps.regress_points(points, draws=100, rng=rng)).set_index("property")
    assert (found.loc[["temporal_match", "roughness"], "r2"] > 0.9).all()
    # The original has no match of its own: five stimuli are permuted.
    assert found.loc["temporal_match", "p"] <= 3 / 120
    assert found.loc["roughness", "p"] <= 3 / 720
    assert found.loc["chance", "r2"] < 0.5
    # The planted attributes are orthogonal directions of the plane.
    first, second = (
        found.loc[name, ["axis_1", "axis_2"]] for name in ("temporal_match", "roughness")
    )
    assert abs(float(first.to_numpy(float) @ second.to_numpy(float))) < 0.25
    # One original among six: its five others may be permuted at will.
    assert found.loc["directions", "p_least"] == pytest.approx(1 / 6)


def test_a_stimulus_without_a_number_is_left_out_of_that_attribute_only(
    planted: Table, groups: list[maps.GroupMap]
) -> None:
    assert planted.stimuli is not None
    stimuli = planted.stimuli.copy()
    stimuli.loc[stimuli["role"] == "reference", "roughness"] = np.nan
    rng = np.random.default_rng(3)
    points = maps.gather_points(planted.rows, stimuli, groups[0], rng=rng)
    found = pd.DataFrame(maps.regress_points(points, draws=10, rng=rng)).set_index("property")
    assert found["n"].to_dict() == {"temporal_match": 40, "chance": 48, "directions": 48, "roughness": 40}  # fmt: skip
    assert found.loc["roughness", "permutations"] == math.factorial(5)


def test_a_section_says_what_its_points_allow() -> None:
    section = report.compute_maps(plant(labelled=False), Choices(draws=5))
    assert all(section.rows[f"maps{part}"] for part in ("", "_groups", "_attributes"))
    assert any("name `interaction` and `sample`" in note for note in section.notes)
    assert any("cannot show an association of the axes with directions" in note for note in section.notes)  # fmt: skip
    assert not any("attributes are compared with" in note for note in section.notes)
