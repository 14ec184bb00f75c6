import math
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from sklearn.manifold import smacof

from feel321.analysis.report.pairs import compute_space
from feel321.analysis.resampling import Choices
from feel321.analysis.space import align_spaces, fit_space, gather_points, regress_points
from feel321.analysis.table.items import Table
from feel321.analysis.table.reading import read_table


def apart(place: np.ndarray) -> np.ndarray:
    return np.sqrt(((place[:, None] - place) ** 2).sum(axis=-1))


def make_people(
    n: int = 12, *, noise: float = 0.3, seed: int = 0, stimuli: int = 8
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    place = rng.normal(size=(stimuli, 2)) * [2, 1]
    people = np.abs(apart(place) + noise * rng.normal(size=(n, stimuli, stimuli)))
    people = (people + people.transpose(0, 2, 1)) / 2
    people[:, np.arange(stimuli), np.arange(stimuli)] = 0
    return place, people


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_distances_are_recovered(dimensions: int) -> None:
    rng = np.random.default_rng(dimensions)
    place = rng.normal(size=(9, dimensions))
    space = fit_space(apart(place), dimensions=dimensions, rng=rng)
    assert space.stress < 1e-3
    assert apart(space.positions) == pytest.approx(apart(place), abs=5e-3)
    assert space.positions.mean(axis=0) == pytest.approx(0, abs=1e-9)


def test_a_group_map_recovers_the_planted_one() -> None:
    place, people = make_people()
    group = fit_space(people, rng=0).positions
    result = align_spaces(group, place, rng=1)
    assert result.correlation > 0.95
    assert result.p == pytest.approx(1 / 2001)
    assert result.aligned == pytest.approx(place, abs=0.8)


def test_procrustes_is_scipys() -> None:
    from scipy.spatial import procrustes

    rng = np.random.default_rng(3)
    one, other = rng.normal(size=(9, 3)), rng.normal(size=(9, 3))
    result = align_spaces(one, other, permutations=5, rng=rng)
    assert result.disparity == pytest.approx(procrustes(other, one)[2])
    whole = ((other - other.mean(axis=0)) ** 2).sum()
    assert ((result.aligned - other) ** 2).sum() == pytest.approx(result.disparity * whole)


def test_ellipses_shrink_with_participants_and_follow_the_movement() -> None:
    few = fit_space(make_people(6, noise=0.6)[1], draws=40, rng=0).ellipses
    many = fit_space(make_people(48, noise=0.6)[1], draws=40, rng=0).ellipses
    assert many.half_axes.mean() < 0.6 * few.half_axes.mean()
    assert (few.half_axes[:, 0] >= few.half_axes[:, 1]).all()
    assert ((few.angle >= 0) & (few.angle < 180)).all()
    assert (few.draws, few.n_participants) == (40, 6)


def test_an_ellipse_by_its_definition() -> None:
    _, people = make_people(7, noise=0.5)
    result = fit_space(people, draws=60, rng=5)
    rng = np.random.default_rng(5)
    group = fit_space(people, rng=rng)
    assert result.positions == pytest.approx(group.positions)
    drawn = rng.multinomial(7, np.full(7, 1 / 7), size=60)
    maps = [
        smacof(
            np.average(people, axis=0, weights=row), n_components=2, init=group.positions, n_init=1,
            max_iter=300, eps=1e-6,
        )[0]
        for row in drawn
    ]  # fmt: skip
    laid = [align_spaces(place, group.positions, permutations=1, rng=rng).aligned for place in maps]
    for stimulus, (long, short) in enumerate(result.ellipses.half_axes):
        covariance = np.cov(np.stack(laid)[:, stimulus].T)
        least, most = np.linalg.eigvalsh(covariance)
        # 95 % of a plane's normal distribution lie within chi-square(2) = -2 log(.05); P / (P - 1) for P people.
        scale = -2 * np.log(0.05) * 7 / 6
        assert [long**2, short**2] == pytest.approx([scale * most, scale * least], rel=1e-6)
        angle = np.radians(result.ellipses.angle[stimulus])
        along = np.array([np.cos(angle), np.sin(angle)])
        assert along @ covariance @ along == pytest.approx(most, rel=1e-6)


NAMES = ("saz321", "soc321", "mag321", "dft321", "pca321", "original")
PLACES = np.array([[30, 0], [10, 20], [-25, 15], [-15, -25], [20, -20], [-20, 10.0]])
PEOPLE, RECORDINGS = 15, 4


@pytest.fixture(scope="module")
def planted() -> Table:
    """Judgements of 15 people of every pair of the planted places, on four recordings."""
    rng = np.random.default_rng(0)
    rows, stimuli = [], []
    for recording in map(str, range(RECORDINGS)):
        for number, name in enumerate(NAMES):
            role = "reference" if name == "original" else "test"
            about = (recording, name, role, *PLACES[number], rng.uniform())
            stimuli.append((f"{recording}-{name}", *about))
        for two, one in combinations(range(len(NAMES)), 2):
            ids = (f"{recording}-{NAMES[one]}", f"{recording}-{NAMES[two]}")
            felt = np.hypot(*(PLACES[one] - PLACES[two])) + rng.normal(0, 6, PEOPLE)
            rows += [(f"p{who:02d}", *ids, rating) for who, rating in enumerate(felt.clip(0, 100))]
    ratings = pd.DataFrame(rows, columns=["participant", "stimulus_id", "reference_id", "rating"])
    ratings = ratings.assign(scale="dissimilarity", trial=range(1, len(rows) + 1))
    columns = ["stimulus_id", "recording", "reducer", "role", "temporal_match", "roughness", "chance"]  # fmt: skip
    manifest = pd.DataFrame(stimuli, columns=columns).assign(level="as_is")
    manifest["temporal_match"] = 0.5 + manifest["temporal_match"] / 100
    return read_table(ratings, manifest)


def test_attributes_that_make_the_axes_are_found_and_chance_is_not(planted: Table) -> None:
    rng = np.random.default_rng(2)
    places, attributes = gather_points(planted.rows, planted.stimuli, rng=rng)
    assert places.shape == (RECORDINGS, len(NAMES), 2)
    rows = regress_points(places, attributes, draws=100, rng=rng)
    found = pd.DataFrame(rows).set_index("property")
    assert (found.loc[["temporal_match", "roughness"], "r2"] > 0.9).all()
    # The original has no match of its own: five stimuli are permuted.
    assert found.loc["temporal_match", "p"] <= 3 / 120
    assert found.loc["roughness", "p"] <= 3 / 720
    assert found.loc["chance", "r2"] < 0.5
    # The planted attributes are orthogonal directions of the plane.
    axes = found.loc[["temporal_match", "roughness"], ["axis_1", "axis_2"]].to_numpy(float)
    assert abs(axes[0] @ axes[1]) < 0.25
    # One original among six: its five others may be permuted at will.
    assert found.loc["directions", "p_least"] == pytest.approx(1 / 6)


def test_a_stimulus_without_a_number_is_left_out_of_that_attribute_only(planted: Table) -> None:
    assert planted.stimuli is not None
    stimuli = planted.stimuli.copy()
    stimuli.loc[stimuli["role"] == "reference", "roughness"] = np.nan
    rng = np.random.default_rng(3)
    places, attributes = gather_points(planted.rows, stimuli, rng=rng)
    rows = regress_points(places, attributes, draws=10, rng=rng)
    found = pd.DataFrame(rows).set_index("property")
    assert found["n"].to_dict() == {"temporal_match": 20, "chance": 24, "directions": 24, "roughness": 20}  # fmt: skip
    assert found.loc["roughness", "permutations"] == math.factorial(5)


def test_the_section_says_what_its_points_allow(planted: Table) -> None:
    section = compute_space(planted, Choices(draws=5))
    assert section.rows["space_attributes"]
    assert any("cannot show an association of the axes with directions" in note for note in section.notes)  # fmt: skip
    assert any("4 attributes are compared with 24 points" in note for note in section.notes)
