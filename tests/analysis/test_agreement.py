"""Krippendorff's alpha, intraclass correlations and the noise ceiling; tables of numbers."""

import math

import numpy as np
import pytest

from feel321.analysis.agreement import LEVELS, intraclass, krippendorff_alpha, noise_ceiling
from feel321.analysis.arrays import read_numbers


def make_table(
    seed: int = 0, *, missing: float = 0.2, targets: int = 14, raters: int = 5
) -> np.ndarray:
    rng = np.random.default_rng(seed)
    table = rng.uniform(0, 6, (targets, 1)) + rng.normal(0, 1, (targets, raters))
    table = np.clip(np.round(table), 0, 7)
    table[rng.uniform(size=table.shape) < missing] = np.nan
    table[0, 0] = table[0, 1] = 3
    return table


def brute_alpha(table: np.ndarray, level: str) -> float:
    """Sum over all pairs, as the definition says."""
    rows = [row[np.isfinite(row)] for row in table]
    rows = [row for row in rows if len(row) > 1]
    pool = np.concatenate(rows)

    def distance(v: float, w: float) -> float:
        if level == "nominal":
            return float(v != w)
        if level == "ordinal":
            between = ((pool >= min(v, w)) & (pool <= max(v, w))).sum()
            return (v != w) * float(between - ((pool == v).sum() + (pool == w).sum()) / 2) ** 2
        return (v - w) ** 2 if level == "interval" else ((v - w) / (v + w)) ** 2 if v + w else 0.0

    def pairs(values: np.ndarray) -> float:
        return sum(
            distance(v, w) for i, v in enumerate(values) for j, w in enumerate(values) if i != j
        )

    observed = sum(pairs(row) / (len(row) - 1) for row in rows) / len(pool)
    return 1 - observed / (pairs(pool) / (len(pool) * (len(pool) - 1)))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("missing", [0.0, 0.35])
def test_alpha_by_its_definition(level: str, missing: float) -> None:
    for seed in range(4):
        table = make_table(seed, missing=missing)
        alpha = krippendorff_alpha(table, level=level)
        assert alpha == pytest.approx(brute_alpha(table, level), abs=1e-12)


@pytest.mark.parametrize("level", LEVELS)
def test_perfect_agreement_is_one_and_noise_is_none(level: str) -> None:
    same = np.repeat(np.arange(8.0)[:, None], 4, axis=1)
    noise = np.random.default_rng(3).integers(1, 6, (400, 4))
    assert krippendorff_alpha(same, level=level) == pytest.approx(1)
    assert krippendorff_alpha(noise, level=level) == pytest.approx(0, abs=0.06)
    assert math.isnan(krippendorff_alpha(np.full((5, 3), 33.3), level=level))


def test_names_agree_as_numbers_do() -> None:
    table = make_table(2)
    names = [[None if np.isnan(one) else f"scene {one:.0f}" for one in row] for row in table]
    assert krippendorff_alpha(names, level="nominal") == krippendorff_alpha(table, level="nominal")
    with pytest.raises(ValueError, match="table must hold numbers: could not convert string"):
        krippendorff_alpha(names, level="ordinal")


def test_a_slider_of_many_values_needs_little_memory() -> None:
    # targets x values x values, as the textbook table has it, would be 500 x 20 000 x 20 000 cells.
    rng = np.random.default_rng(0)
    table = rng.uniform(0, 100, (500, 1)) + rng.normal(0, 10, (500, 40))
    alpha = krippendorff_alpha(table)
    assert krippendorff_alpha(table, level="ordinal") == pytest.approx(alpha, abs=0.03)
    assert math.isfinite(krippendorff_alpha(np.abs(table[:, :6]), level="ratio"))


@pytest.mark.parametrize(
    ("table", "level", "message"),
    [
        ([[1, 2]], "cardinal", "level must be one of nominal, ordinal, interval, ratio"),
        ([1, 2], "interval", "table must have shape .targets, raters., got shape .2,."),
        ([[1, math.inf]], "interval", "table must be finite, got 1 infinite values, first in row 0"),
        ([[1, -2]], "ratio", "table must not be negative on a ratio scale, got -2.0"),
        ([[1, math.nan], [math.nan, 2]], "interval", "must have a target with two ratings, got 2 without"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_words(table: list[object], level: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        krippendorff_alpha(table, level=level)


BOOK = (
    [63, 67, 76, 63], [46, 51, 53, 62], [69, 64, 73, 52], [42, 36, 49, 21], [59, 43, 49, 52],
    [50, 45, 40, 39], [38, 63, 64, 49], [45, 47, 56, 56], [75, 55, 47, 51], [54, 33, 48, 30],
)  # fmt: skip


APART = [[9, 2], [6, 1], [8, 4], [7, 1], [10, 5], [6, 2]]  # negative, and all the same
NOISE = [[1, 2, 6], [2, 1, 1], [3, 4, 5], [4, 3, 2], [5, 6, 4], [6, 5, 3]]


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        (BOOK, {
            "1_1": (0.454497049297, 0.145819315599, 0.782916945134),
            "a_1": (0.458913072820, 0.156326281572, 0.783671038625),
            "c_1": (0.474270569899, 0.158196467885, 0.795070040905),
            "1_k": (0.769196110089, 0.405769966137, 0.935174915801),
            "a_k": (0.772340640918, 0.425673336643, 0.935443713917),
            "c_k": (0.783008548292, 0.429126826743, 0.939463149504),
        }),
        (APART, {
            "1_1": (-0.496415770609, -0.8935730402821, 0.402661387942),
            "a_1": (0.125654450262, -0.0236532215433, 0.599851484038),
            "c_1": (0.745341614907, -0.0209087462971, 0.959983081508),
            "1_k": (-1.971530249110, -16.7922308905665, 0.574139120680),
            "a_k": (0.223255813953, -0.0484525008228, 0.749883961134),
            "c_k": (0.854092526690, -0.0427105159361, 0.979583028614),
        }),
        (NOISE, {
            "a_1": (0.314079422383, -0.246073886494, 0.840727243567),
            "a_k": (0.578713968958, -1.453615087652, 0.940602103374),
            "c_k": (0.533742331288, -0.975107428112, 0.929559329581),
        }),
    ],
    ids=["ten targets", "two raters", "noise"],
)  # fmt: skip
def test_every_form_and_interval_against_psych(
    table: list[list[int]], expected: dict[str, tuple[float, ...]]
) -> None:
    # R 4.2.2, psych 2.2.9: ICC(x, lmer = FALSE)$results
    icc = intraclass(table)
    for form, printed in expected.items():
        got = tuple(getattr(icc, f"icc_{form}{end}") for end in ("", "_low", "_high"))
        assert got == pytest.approx(printed, abs=1e-9)


def test_ceiling_recovers_the_correlation_with_the_truth() -> None:
    rng = np.random.default_rng(5)
    truth = rng.normal(size=4000)
    table = truth[:, None] + rng.normal(0, 2, (4000, 8))
    reached = np.corrcoef(truth, table.mean(axis=1))[0, 1]
    assert noise_ceiling(table) == pytest.approx(reached, abs=0.01)
    assert reached == pytest.approx(math.sqrt(1 / (1 + 4 / 8)), abs=0.01)


def test_noise_alone_has_no_ceiling() -> None:
    # Raters who contradict each other: targets differ less than noise would let them.
    assert math.isnan(noise_ceiling([[0, 10], [10, 0.5], [0, 10]]))


@pytest.mark.parametrize("rating", [50.0, 33.3, 71.7, 99.9])
@pytest.mark.parametrize("offset", [0.0, -11.1])
def test_equal_ratings_are_undefined_not_perfect(rating: float, offset: float) -> None:
    for shape in ((3, 3), (36, 6), (48, 7)):
        table = np.full(shape, rating) + offset * np.arange(shape[1]) / 3
        assert math.isnan(intraclass(table).icc_c_k)
        assert math.isnan(noise_ceiling(table))


def test_a_negative_variance_of_means_is_no_reliability_of_two() -> None:
    # Targets that do not differ at all, raters who contradict each other: (R - E) / (R + (C - E)/n) would be 2.
    icc = intraclass([[1, 2], [2, 1]])
    assert math.isnan(icc.icc_a_k)
    assert (icc.icc_1_1, icc.icc_c_1) == (-1, -1)


def planted(n: int, k: int, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(n, 1)) + rng.normal(0, 0.5, (1, k)) + rng.normal(size=(n, k))


def test_intervals_cover_the_truth() -> None:
    # Planted: targets 1, raters .25, error 1, drawn anew in every study.
    rng = np.random.default_rng(4)
    studies = [intraclass(planted(15, 12, rng)) for _ in range(400)]
    truth = {"icc_a_1": 1 / 2.25, "icc_c_1": 1 / 2, "icc_a_k": 12 / 13.25, "icc_c_k": 12 / 13}
    for name, value in truth.items():
        covered = [icc[f"{name}_low"] <= value <= icc[f"{name}_high"] for icc in studies]
        assert 0.925 < np.mean(covered) < 0.975


@pytest.mark.parametrize("given", [[[1, 2], [3]], [np.zeros((2, 2)), np.zeros((2, 3))]])
def test_what_has_no_shape_is_refused_in_words(given: object) -> None:
    with pytest.raises(ValueError, match="table must hold numbers: "):
        read_numbers(given, what="table")
