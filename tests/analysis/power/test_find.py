"""Power in closed form against brute force and simulation; simulated studies have the planted truth."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import binom, nct
from scipy.stats import t as student

from feel321.analysis.power import plan
from feel321.analysis.power.design import ClosedForm, PowerDesign, Stimuli
from feel321.analysis.power.plan import find_power, simulate_studies, tabulate_shares
from feel321.jobs import Workers

Make = Callable[..., PowerDesign]

STUDIES = 60
FAR = 1e-4
"""Chance that a right share lies outside the limits of a test."""


def find_covariance(design: PowerDesign, stimuli: Stimuli) -> np.ndarray:
    """Compute the covariance of the stimuli's mean ratings over people and repeats, (n_items, n_items)."""
    truth, people = design.truth, design.participants
    scene, kind = (np.eye(codes.max() + 1)[codes] for codes in (stimuli.scene, stimuli.kind))
    noise = truth.person_item_sd**2 + truth.rating_sd**2 / design.repeats
    own, theirs = (stimuli.within * sds for sds in design.slope_sds)
    found = (truth.item_sd**2 + noise / people) * np.eye(len(own))
    found += truth.person_sd**2 / people + own @ own.T / people
    found += (truth.recording_sd**2 + truth.person_recording_sd**2 / people) * (scene @ scene.T)
    found += (truth.reducer_sd**2 + truth.person_reducer_sd**2 / people) * (kind @ kind.T)
    return found + (theirs @ theirs.T) * (scene @ scene.T)


def test_closed_form_is_generalised_least_squares(make_design: Make) -> None:
    own = {"spectral": 9.0, "temporal": 4.0}
    given = make_design(own=(5, 4), repeats=3, slope_sds=own, recording_slope_points=0.0)
    stimuli, people = given.stimuli, given.participants
    columns = np.column_stack([stimuli.within, np.eye(5)[stimuli.scene]])
    truth = replace(given.truth, slope_sds=dict.fromkeys(own, 0.0))
    spread = find_covariance(replace(given, truth=truth), stimuli)
    covariance = np.linalg.inv(columns.T @ np.linalg.solve(spread, columns))[:2, :2]
    covariance += np.diag([81.0, 16.0]) / people
    for place in (0, 1):
        form = ClosedForm(given, place)
        found = form.describe(0.0)
        se, df = found["se"], found["df"]
        assert se**2 == pytest.approx(covariance[place, place], rel=1e-6)
        limit = student.ppf(1 - given.level / 2, df)
        wanted = nct.sf(limit, df, 3) + nct.cdf(-limit, df, 3)
        assert form.find_power(3 * se) == pytest.approx(wanted, rel=1e-6)
        assert form.find_power(found["detectable"]) == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize("own", [(4, 6), (11, 9)])
def test_closed_form_knows_that_recordings_differ_in_their_slopes(
    make_design: Make, own: tuple[int, int]
) -> None:
    given = make_design(own=own, slope_points=0.0, recording_slope_points=3.0)
    stimuli, spread = given.stimuli, find_covariance(given, given.stimuli)
    columns = np.column_stack([stimuli.within, np.eye(own[0])[stimuli.scene]])
    best = np.linalg.inv(columns.T @ np.linalg.solve(spread, columns))[:2, :2]
    for place in (0, 1):
        found = ClosedForm(given, place).describe(0.0)
        assert 1 <= found["se"] ** 2 / best[place, place] < 1.15
        assert found["df"] > own[0] - 1


def test_power_grows_with_people_to_the_ceiling_that_stimuli_set(make_design: Make) -> None:
    form = ClosedForm(make_design(), 0)
    powers = [form.find_power(30.0, participants=people) for people in (4, 8, 16, 64, 1000)]
    assert powers == sorted(powers)
    found = form.describe(30.0)
    assert powers[-1] < found["ceiling"] < 1
    slope = found["detectable"] * 1.1
    needed = int(form.find_least("participants", slope))
    assert form.find_power(slope, participants=needed) >= 0.8
    assert form.find_power(slope, participants=needed - 1) < 0.8
    assert np.isnan(form.find_least("participants", slope / 3))


def test_the_recordings_that_are_said_to_be_enough_are_enough(make_design: Make) -> None:
    given = make_design(own=(4, 3), slopes={"spectral": 30.0}, participants=16)
    number = int(find_power(given).table.loc[0, "recordings_needed"])
    assert find_power(replace(given, recordings=number)).table.loc[0, "power"] >= 0.8


@pytest.mark.parametrize(("own", "few"), [((3, 2), 2), ((5, 1), 1)])
def test_what_the_report_refuses_has_no_power(
    make_design: Make, own: tuple[int, int], few: int
) -> None:
    """Two reducers do not show how reducers differ; one reducer leaves nothing."""
    power = find_power(make_design(own=own, slopes={"spectral": 500.0}))
    assert power.table[["power", "ceiling", "detectable"]].isna().all(axis=None)
    assert f"cannot be tested: reducers number {few}, where 3 are needed" in " ".join(power.notes)


def test_sets_without_a_test_count_as_no_power(make_design: Make) -> None:
    given = make_design()
    twin = replace(given.stimuli, metrics=given.stimuli.metrics[:, [0, 0]])
    one, both = ClosedForm(given, 0), ClosedForm(given, 0)
    both.__dict__["sets"] = [given.stimuli, twin]
    assert both.find_power(40.0) == pytest.approx(one.find_power(40.0) / 2)
    assert np.isnan(both.describe(40.0)["detectable"])


def test_points_of_another_size_change_no_power(make_design: Make) -> None:
    """Everything in points times ten, where neither ends nor steps of the scale count."""
    free = {"bounded": False, "step": 0.0}
    one = make_design(**free)
    names = [name for name in one.truth.__dataclass_fields__ if name.endswith("_sd")]
    names += ["slope_points", "recording_slope_points"]
    points = {name: 10 * getattr(one.truth, name) for name in names}
    ten = make_design(**free, **points, slopes={"spectral": 250.0})
    small, large = (
        find_power(case, partial(simulate_studies, studies=6)).table for case in (one, ten)
    )
    factors = {"power": 1, "ceiling": 1, "se": 10, "detectable": 10, "simulated": 1}
    for column, factor in factors.items():
        assert (small[column] * factor).tolist() == pytest.approx(large[column].tolist(), rel=1e-6)


@pytest.mark.parametrize("slope", [45.0, 0.0])
def test_simulated_studies_have_the_power_of_the_closed_form_and_few_false_positives(
    make_design: Make, slope: float
) -> None:
    case = make_design(slopes={"spectral": slope}, participants=10)
    row = find_power(case, partial(simulate_studies, studies=STUDIES, seed=5)).table.loc[0]
    expected = max(row["power"], 0.025)
    low, high = expected - 0.06, expected + 0.06  # how far the closed form is known
    assert row["tests"] == STUDIES
    assert binom.ppf(FAR, STUDIES, max(low, 0)) <= row["simulated"] * STUDIES
    assert row["simulated"] * STUDIES <= binom.ppf(1 - FAR, STUDIES, min(high, 1))
    assert row["simulated_low"] <= row["simulated"] < row["simulated_high"]


def test_shares_are_those_of_a_loop_over_studies() -> None:
    p = np.random.default_rng(3).uniform(0, 0.08, (40, 4))
    p[0, 2:] = np.nan  # as of an attribute that has no model
    table, hits = tabulate_shares(p), np.zeros(4)
    for study in p:
        order = [place for place in np.argsort(study) if np.isfinite(study[place])]
        for step, place in enumerate(order):
            if study[place] * (len(order) - step) >= 0.05:
                break
            hits[place] += 1
    assert table["tests"].tolist() == [40, 40, 39, 39]
    assert table["simulated"].tolist() == pytest.approx((hits / table["tests"]).tolist())


def test_studies_are_alike_for_any_number_of_workers(
    make_design: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "CHUNK", 4)
    run = partial(simulate_studies, make_design(own=(4, 4), participants=4, recordings=5), seed=2)
    one, two = (run(studies=8, workers=Workers(count)) for count in (1, 2))
    assert np.array_equal(one, two)
    assert np.array_equal(run(studies=10)[:8], one)


def test_larger_designs_use_every_recording_about_as_often(make_design: Make) -> None:
    given = make_design(own=(5, 4), recordings=12, reducers=3)
    drawn = [given.draw(np.random.default_rng(seed)) for seed in range(12)]
    own = given.stimuli.metrics[:, 0].reshape(5, 4)
    for stimuli in drawn:
        metrics = stimuli.metrics[:, 0].reshape(12, 3)
        whose = [np.flatnonzero(np.isin(own, row).any(axis=1))[0] for row in metrics]
        assert sorted(np.bincount(whose)) == [2, 2, 2, 3, 3]
        assert len(np.unique(stimuli.source)) == 12
    assert len({hash(stimuli.metrics.tobytes()) for stimuli in drawn}) > 6


def test_drawn_ratings_have_the_planted_spreads_and_slopes(make_design: Make) -> None:
    """Each spread is planted alone and found again in means that nothing else can move."""
    where = {
        "person_sd": (1,), "item_sd": (2,), "person_item_sd": (1, 2), "rating_sd": (1, 2, 3),
    }  # fmt: skip
    spreads = ("recording_sd", "reducer_sd", "person_recording_sd", "person_reducer_sd")
    own = ("slope_points", "recording_slope_points")
    none = dict.fromkeys((*spreads, *where, *own), 0.0) | {"slopes": {}, "bounded": False}
    for name, axes in where.items():
        given = make_design(participants=60, repeats=4, **(none | {name: 4.0, "step": 0.0}))
        ratings = plan.draw_ratings(given, given.stimuli, np.random.default_rng(2))
        others = tuple(set(range(1, 4)) - set(axes))
        found = ratings.mean(axis=others) if others else ratings
        assert np.std(found) == pytest.approx(4.0, rel=0.35 if name == "item_sd" else 0.25)
        if others:
            assert np.ptp(ratings, axis=others).max() < 1e-9
    slopes = make_design(**(none | {"slopes": {"spectral": 30.0}, "step": 0.0}))
    planted = plan.draw_ratings(slopes, slopes.stimuli, np.random.default_rng(2))
    metric = slopes.stimuli.metrics[:, 0]
    assert planted[0, 0, :, 0] == pytest.approx(50 + 30 * (metric - metric.mean()))


def test_ratings_have_the_ends_and_steps_of_the_scale(make_design: Make) -> None:
    given = make_design(participants=400, mean=85.0, person_sd=40.0)
    ratings = plan.draw_ratings(given, given.stimuli, np.random.default_rng(4))
    assert (ratings.min(), ratings.max()) == (0.0, 100.0)
    assert np.abs(ratings * 10 - np.round(ratings * 10)).max() < 1e-6


def test_a_power_that_is_no_aim_is_refused(make_design: Make) -> None:
    with pytest.raises(ValueError, match=r"wanted must be between 0\.05 and 1, got 1\.0"):
        make_design(wanted=1.0)
