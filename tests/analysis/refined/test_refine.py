"""Refined metrics: what is planted is found, noise gains nothing, and who is left out is left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from feel321.analysis.association.correlate import correlate
from feel321.analysis.refined.candidates import (
    EQUAL,
    FOLDS,
    GROUPS,
    SearchData,
    average_groups,
    choose,
    fit_candidate,
    leave_out,
    make_basis,
    make_split,
    score_draws,
    sum_moments,
)
from feel321.analysis.refined.refine import Refined, refine_metric
from feel321.analysis.table.items import make_items

SLOPES = {"noise": (0.0, 0.0), "one": (30.0, 0.0), "both": (30.0, 30.0), "uneven": (45.0, 15.0)}


def make_study(seed: int, slopes: tuple[float, float] = (30.0, 30.0), **sizes: int) -> pd.DataFrame:
    """Ratings that follow two metrics, with slopes that differ between people; stimuli have a spread of their own."""
    people, recordings, reducers = (
        sizes.get(name, own) for name, own in (("people", 10), ("recordings", 8), ("reducers", 6))
    )
    rng = np.random.default_rng(seed)
    scene = np.repeat(np.arange(recordings), reducers)
    metrics = rng.normal(0.5, 0.2, (2, len(scene))) + rng.normal(0, 0.1, (2, recordings))[:, scene]
    own = slopes + rng.normal(0, 6, (people, 2))
    rating = 50 + own @ metrics + rng.normal(0, 3, len(scene)) + rng.normal(0, 5, recordings)[scene]
    rating += rng.normal(0, 8, (people, 1)) + rng.normal(0, 8, (people, len(scene)))
    return pd.DataFrame({
        "participant": np.repeat(np.arange(people), len(scene)), "recording": np.tile(scene, people),
        "reducer": np.tile(np.tile(np.arange(reducers), recordings), people), "sm": np.tile(metrics[0], people),
        "tm": np.tile(metrics[1], people), "rating": rating.ravel(),
    })  # fmt: skip


def search(rows: pd.DataFrame, *, seed: int = 0, draws: int = 60, **choices: Any) -> Refined:
    return refine_metric(
        rows, ["sm", "tm"], draws=draws, rng=np.random.default_rng(seed), **choices
    )


def prepare(rows: pd.DataFrame, *, within: bool) -> SearchData:
    items = make_items(rows, ["sm", "tm"])
    basis = make_basis(
        ["sm", "tm"], items.metrics, n_plain=2, groups=items.recordings if within else None
    )
    return SearchData(items, basis, make_split(items, np.random.default_rng(1)), within)


def test_a_sum_that_people_feel_is_found_and_recommended() -> None:
    found = search(make_study(3))
    assert found.recommended
    assert found.chosen in {EQUAL, "sm + tm"}
    assert (found.gains["low"] > 0).all()
    assert found.low < found.value < found.high
    assert found.rmse_low < found.rmse < found.rmse_high
    assert found.candidates["chosen"].sum() == pytest.approx(1)
    assert (found.n_folds, found.n_items, found.n_participants) == (8 * GROUPS, 48, 10)


def test_uneven_weights_are_recovered() -> None:
    found = search(make_study(5, (45.0, 15.0), people=20, recordings=20))
    weights = found.weights.set_index("term")
    assert found.chosen == "sm + tm"
    assert weights["per_unit"].to_numpy() == pytest.approx([45, 15], abs=7)
    assert (weights["lowest"] <= weights["weight"]).all()
    assert (weights["weight"] <= weights["highest"]).all()


def test_one_metric_that_says_it_all_stays_alone() -> None:
    found = search(make_study(2, (40.0, 0.0)))
    assert found.chosen == "sm"
    assert not found.recommended
    gain = found.gains.set_index("metric").loc["sm"]
    assert gain["value"] <= 0


@pytest.mark.parametrize("within", [False, True])
def test_a_metric_as_it_is_has_its_ordinary_correlation(within: bool) -> None:
    rows = make_study(7)
    found = search(rows, within=within, draws=2)
    plain = found.gains.set_index("metric")["plain"]["sm"]
    if not within:
        assert plain == pytest.approx(
            correlate(rows, "sm", draws=2, rng=np.random.default_rng(0)).value
        )
    means = rows.groupby(["recording", "reducer"])[["sm", "rating"]].mean()
    inside = means - means.groupby("recording").transform("mean") if within else means
    assert plain == pytest.approx(inside.corr().loc["sm", "rating"])


def test_no_rating_has_a_part_in_what_it_is_compared_with() -> None:
    rows = make_study(11)
    data = prepare(rows, within=False)
    everyone = {"people": np.ones((1, 10)), "recordings": np.ones((1, 8))}
    fits = score_draws(data, **everyone).fits
    group, fold = data.split.people[4], data.split.items[data.items.recordings == 2][0]
    for own in (rows["participant"] == 4, rows["recording"] == 2):
        changed = rows.assign(rating=rows["rating"].mask(own, 100 - rows["rating"] ** 2))
        # The grand mean that ratings are taken about moves every intercept, and no weight.
        after = score_draws(data._replace(items=make_items(changed, ["sm", "tm"])), **everyone).fits
        same = np.isclose(fits[..., 1:-1], after[..., 1:-1], rtol=1e-6, atol=1e-6).all(
            axis=(0, 1, -1)
        )
        left_out = np.zeros_like(same)
        left_out[
            (group, slice(None)) if own[rows["participant"] == 4].all() else (slice(None), fold)
        ] = True
        assert (same == left_out).all()


def test_fits_are_those_of_least_squares() -> None:
    data = prepare(make_study(4), within=False)
    rating = data.items.ratings.mean(axis=0)
    moments = sum_moments(data.basis.columns, rating, np.ones_like(rating), folds=data.split.items)
    pair = next(one for one in data.basis.candidates if one.name == "sm + tm")
    fits = fit_candidate(leave_out(moments), pair)
    for fold in range(8):
        rest = data.split.items != fold
        known = np.column_stack([
            np.ones(rest.sum()),
            data.basis.columns[rest][:, list(pair.columns)],
        ])
        wanted = np.linalg.lstsq(known, rating[rest], rcond=None)[0]
        assert fits[fold, [0, *(column + 1 for column in pair.columns)]] == pytest.approx(
            wanted, rel=1e-6
        )


def test_the_simplest_within_one_standard_error_is_chosen() -> None:
    data = prepare(make_study(4, (45.0, 15.0)), within=False)
    rating = data.items.ratings.mean(axis=0)
    moments = sum_moments(data.basis.columns, rating, np.ones_like(rating), folds=data.split.items)
    errors = []
    for one in data.basis.candidates:
        fits = fit_candidate(leave_out(moments), one)
        errors.append([fit @ moment @ fit for fit, moment in zip(fits, moments, strict=True)])
    table = np.array(errors)
    excess = table - table[table.sum(axis=1).argmin()]
    close = excess.mean(axis=1) <= excess.std(axis=1, ddof=1) / np.sqrt(8)
    key = [
        (one.parameters, total) if near else (99, total)
        for one, near, total in zip(data.basis.candidates, close, table.sum(axis=1), strict=True)
    ]
    assert choose(moments, data.basis.candidates) == min(range(len(key)), key=key.__getitem__)


def test_choosing_without_a_fold_is_choosing_from_the_others() -> None:
    data = prepare(make_study(9, (30.0, 20.0)), within=True)
    rating = data.items.ratings.mean(axis=0)
    moments = sum_moments(data.basis.columns, rating, np.ones_like(rating), folds=data.split.items)
    nested = choose(moments, data.basis.candidates, nested=True)
    alone = [choose(np.delete(moments, fold, axis=0), data.basis.candidates) for fold in range(8)]
    assert nested.tolist() == [int(one) for one in alone]


def test_means_of_everyone_else_are_those_of_the_rows() -> None:
    rows = make_study(6).drop(index=[3, 60, 200])
    items = make_items(rows, ["sm", "tm"])
    split = make_split(items, np.random.default_rng(0))
    means = average_groups(items, split, np.ones((1, 10)), within=False)
    middle = items.ratings[np.isfinite(items.ratings)].mean()
    for group in range(GROUPS):
        own = split.people == group
        assert means.own[0, group] == pytest.approx(np.nanmean(items.ratings[own], axis=0) - middle)
        assert means.others[0, group] == pytest.approx(
            np.nanmean(items.ratings[~own], axis=0) - middle
        )
    assert means.share.sum(axis=1) == pytest.approx(1)


def test_recordings_of_one_source_are_left_out_together() -> None:
    rows = make_study(8, recordings=12)
    items = make_items(rows.assign(source=rows["recording"] // 2), ["sm"])
    folds = make_split(items, np.random.default_rng(3)).items
    assert items.n_sources == 6
    assert len(set(zip(items.recordings // 2, folds, strict=True))) == 6
    many = make_items(make_study(8, recordings=25), ["sm"])
    assert make_split(many, np.random.default_rng(3)).items.max() + 1 == FOLDS


def test_other_columns_enter_sums_only() -> None:
    rows = make_study(3)
    level = (
        rows["sm"] * 3
        + np.random.default_rng(1).normal(size=48)[rows["recording"] * 6 + rows["reducer"]]
    )
    found = search(rows.assign(level=level), others=["level"], draws=10)
    names = found.candidates["name"].tolist()
    assert "level" not in names
    assert {"sm + level", "tm + level", "sm + tm + level"} <= set(names)
    assert found.gains["metric"].tolist() == ["sm", "tm"]
    generator = np.random.default_rng(0)
    alone = refine_metric(
        rows.assign(level=level), ["sm"], others=["tm", "level"], draws=2, rng=generator
    )
    assert alone.candidates["name"].tolist() == [
        "sm",
        "sm ^ 0.5",
        "sm ^ 2",
        "sm + tm",
        "sm + level",
        "sm + tm + level",
    ]


def test_metrics_that_say_the_same_share_a_weight_and_flat_ones_are_named() -> None:
    rows = make_study(3, (40.0, 0.0))
    twins = search(rows.assign(tm=rows["sm"]), draws=10)
    assert np.isfinite(twins.value)
    assert not twins.recommended
    flat = search(rows.assign(tm=0.5), draws=10)
    assert flat.notes == ("'tm' does not vary and is left out.",)
    assert flat.gains["metric"].tolist() == ["sm"]


def test_a_perfect_metric_has_no_interval_and_says_so() -> None:
    rows = make_study(3)
    found = search(rows.assign(rating=20 + 50 * rows["sm"]), draws=10)
    assert found.value == pytest.approx(1)
    assert np.isnan(found.low)
    assert any(note.startswith("No interval") for note in found.notes)
    same = search(rows.assign(rating=rows["recording"] * 5.0), draws=10)
    assert np.isnan(same.value)
    assert any(note.startswith("No correlation") for note in same.notes)


def test_the_same_seed_gives_the_same_result_in_any_block(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = make_study(3)
    once, again = search(rows, draws=9), search(rows, draws=9)
    assert (once.low, once.high) == (again.low, again.high)
    monkeypatch.setattr("feel321.analysis.refined.refine.BLOCK", 1)
    assert search(rows, draws=9).value == once.value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"recording": lambda rows: rows["recording"] % 4},
            "5 recordings of their own or more, got 4",
        ),
        (
            {"source": lambda rows: rows["recording"] % 4},
            "5 recordings of their own or more, got 4",
        ),
        ({"participant": lambda rows: rows["participant"] % 2}, "3 participants or more, got 2"),
        ({"sm": 1.0, "tm": 0.5}, "got sm, tm, none of which varies"),
        ({"rating": 50.0}, "the same rating everywhere"),
    ],
)
def test_studies_too_small_or_too_flat_are_refused(change: dict[str, Any], message: str) -> None:
    rows = make_study(1)
    if "recording" in change:
        change = {**change, "reducer": rows["recording"] // 4 * 6 + rows["reducer"]}
    with pytest.raises(ValueError, match=message):
        search(rows.assign(**change))


def test_one_draw_is_refused() -> None:
    with pytest.raises(ValueError, match="draws must be 2 or more, got 1"):
        search(make_study(1), draws=1)


@pytest.mark.parametrize("within", [False, True])
def test_noise_gains_nothing(within: bool) -> None:
    found = [
        search(make_study(seed, SLOPES["noise"]), within=within, draws=30) for seed in range(25)
    ]
    gains = np.array([one.gains["z_value"] for one in found])
    best = gains.min(axis=1)
    assert best.mean() < 0
    assert gains.mean() < 2 * gains.mean(axis=1).std(ddof=1) / 5
    assert not any(one.recommended for one in found)


@pytest.mark.soak
@pytest.mark.parametrize("within", [False, True])
@pytest.mark.parametrize("name", SLOPES)
def test_gains_are_not_optimistic_and_intervals_cover(name: str, within: bool) -> None:
    """The truth of a gain is its mean over studies of this size; intervals may be cautious, never too narrow."""
    studies = 200
    found = [
        search(make_study(seed, SLOPES[name]), within=within, draws=150) for seed in range(studies)
    ]
    gains = np.array([one.gains[["z_value", "z_low", "z_high"]].to_numpy() for one in found])
    truth = gains[:, :, 0].mean(axis=0)
    covered = ((gains[:, :, 1] <= truth) & (truth <= gains[:, :, 2])).mean(axis=0)
    recommended = float(np.mean([one.recommended for one in found]))
    print(  # noqa: T201 - the figure
        f"\n{name}, within {within}: gain in z {truth.round(3)}, covered {covered}, recommended {recommended}"
    )
    assert (covered >= binom.ppf(0.01, studies, 0.93) / studies).all()
    if name in {"noise", "one"}:
        assert truth.min() <= 0
        assert recommended <= 0.05


@pytest.mark.parametrize(
    ("metrics", "error", "message"),
    [([], ValueError, "one name or more"), ("sm", TypeError, r"write \['sm'\]")],
)
def test_metrics_are_a_list_of_names(metrics: object, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        refine_metric(make_study(1), metrics, draws=2, rng=np.random.default_rng(0))
