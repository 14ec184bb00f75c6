"""Power in closed form against brute force and simulation; simulations that are repeatable and can be interrupted."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.stats import binom, nct
from scipy.stats import t as student

from feel321 import analysis
from feel321.analysis.power import draw, simulate
from feel321.analysis.power.closed import ClosedForm
from feel321.analysis.power.simulate import find_power

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.analysis.power.draw import Scenario, Stimuli

    Make = Callable[..., Scenario]

STUDIES = 60
FAR = 1e-4
"""Chance that a right share lies outside the limits of a test."""


def is_likely(share: float, expected: float, count: int, *, off: float = 0.0) -> bool:
    """Check a share against binomial limits, with the expected one known to `off`."""
    low = binom.ppf(FAR, count, max(expected - off, 0)) / count
    high = binom.ppf(1 - FAR, count, min(expected + off, 1)) / count
    return low <= share <= high


def find_covariance(scenario: Scenario, stimuli: Stimuli) -> np.ndarray:
    """Compute the covariance of the stimuli's mean ratings over people and repeats, (n_items, n_items)."""
    truth, people = scenario.truth, scenario.design.participants
    scene, kind = (np.eye(codes.max() + 1)[codes] for codes in (stimuli.scene, stimuli.kind))
    noise = truth.person_item_sd**2 + truth.rating_sd**2 / scenario.design.repeats
    own = stimuli.within * scenario.planted.slope_sds
    theirs = stimuli.within * scenario.planted.recording_sds
    found = (truth.item_sd**2 + noise / people) * np.eye(len(own))
    found += truth.person_sd**2 / people + own @ own.T / people
    found += (truth.recording_sd**2 + truth.person_recording_sd**2 / people) * (scene @ scene.T)
    found += (truth.reducer_sd**2 + truth.person_reducer_sd**2 / people) * (kind @ kind.T)
    return found + (theirs @ theirs.T) * (scene @ scene.T)


def test_closed_form_is_generalised_least_squares(make_scenario: Make) -> None:
    own = {"spectral": 9.0, "temporal": 4.0}
    given = make_scenario(own=(5, 4), repeats=3, slope_sds=own, recording_slope_points=0.0)
    stimuli, people = given.stimuli, given.design.participants
    columns = np.column_stack([stimuli.within, np.eye(5)[stimuli.scene]])
    truth = replace(given.truth, slope_sds=dict.fromkeys(own, 0.0))
    spread = find_covariance(draw.Scenario(given.design, truth), stimuli)
    covariance = np.linalg.inv(columns.T @ np.linalg.solve(spread, columns))[:2, :2]
    covariance += np.diag([81.0, 16.0]) / people
    for place in (0, 1):
        form = ClosedForm(given, place)
        se, df = form.find_errors()
        assert se**2 == pytest.approx(covariance[place, place], rel=1e-6)
        limit = student.ppf(1 - given.design.level / 2, df)
        wanted = nct.sf(limit, df, 3) + nct.cdf(-limit, df, 3)
        assert form.find_power(3 * se) == pytest.approx(wanted, rel=1e-6)
        assert form.find_power(form.find_detectable()) == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize("own", [(4, 6), (11, 9)])
def test_closed_form_knows_that_recordings_differ_in_their_slopes(
    make_scenario: Make, own: tuple[int, int]
) -> None:
    given = make_scenario(own=own, slope_points=0.0, recording_slope_points=3.0)
    stimuli, spread = given.stimuli, find_covariance(given, given.stimuli)
    columns = np.column_stack([stimuli.within, np.eye(own[0])[stimuli.scene]])
    best = np.linalg.inv(columns.T @ np.linalg.solve(spread, columns))[:2, :2]
    for place in (0, 1):
        se, df = ClosedForm(given, place).find_errors()
        assert 1 <= se**2 / best[place, place] < 1.15
        assert df > own[0] - 1


def test_power_grows_with_people_to_the_ceiling_that_stimuli_set(make_scenario: Make) -> None:
    form = ClosedForm(make_scenario(), 0)
    powers = [form.find_power(30.0, participants=people) for people in (4, 8, 16, 64, 1000)]
    assert powers == sorted(powers)
    assert powers[-1] < form.find_ceiling(30.0) < 1
    slope = form.find_detectable()
    needed = int(form.find_participants(slope * 1.1))
    assert form.find_power(slope * 1.1, participants=needed) >= 0.8
    assert form.find_power(slope * 1.1, participants=needed - 1) < 0.8
    assert np.isnan(form.find_participants(slope / 3))


def test_the_recordings_that_are_said_to_be_enough_are_enough(make_scenario: Make) -> None:
    given = make_scenario(own=(4, 3), slopes={"spectral": 30.0}, participants=16)
    number = int(find_power(given.design, given.truth, studies=0).table.loc[0, "recordings_needed"])
    large = given.design.change(recordings=number)
    assert find_power(large, given.truth, studies=0).table.loc[0, "power"] >= 0.8


@pytest.mark.parametrize(("own", "few"), [((3, 2), 2), ((5, 1), 1)])
def test_what_the_report_refuses_has_no_power(
    make_scenario: Make, own: tuple[int, int], few: int
) -> None:
    """Two reducers do not show how reducers differ; one reducer leaves nothing."""
    given = make_scenario(own=own, slopes={"spectral": 500.0})
    power = find_power(given.design, given.truth, studies=0)
    assert power.table[["power", "ceiling", "detectable"]].isna().all(axis=None)
    assert f"cannot be tested: reducers number {few}, where 3 are needed" in " ".join(power.notes)


def test_sets_without_a_test_count_as_no_power(make_scenario: Make) -> None:
    given = make_scenario()
    twin = replace(given.stimuli, metrics=given.stimuli.metrics[:, [0, 0]])
    one, both = ClosedForm(given, 0), ClosedForm(given, 0)
    both.__dict__["sets"] = [given.stimuli, twin]
    assert both.find_power(40.0) == pytest.approx(one.find_power(40.0) / 2)
    assert np.isnan(both.find_detectable())


def test_more_hypotheses_are_tested_at_a_lower_level(make_scenario: Make) -> None:
    one = make_scenario()
    two = replace(one.design, attributes=("real", "like"))
    found = [find_power(design, one.truth, studies=0).table for design in (one.design, two)]
    assert len(found[1]) == 2 * len(found[0]) == 4
    for table, level in zip(found, (0.05 / 2, 0.05 / 4), strict=True):
        se, df, power = table.loc[0, ["se", "df", "power"]]
        limit = student.ppf(1 - level / 2, df)
        assert power == pytest.approx(nct.sf(limit, df, 25 / se) + nct.cdf(-limit, df, 25 / se))


def test_points_of_another_size_change_no_power(make_scenario: Make) -> None:
    """Everything in points times ten, where neither ends nor steps of the scale count."""
    free = {"bounded": False, "step": 0.0}
    one = make_scenario(**free)
    names = [name for name in one.truth.__dataclass_fields__ if name.endswith("_sd")]
    names += ["slope_points", "recording_slope_points"]
    points = {name: 10 * getattr(one.truth, name) for name in names}
    ten = make_scenario(**free, **points, slopes={"spectral": 250.0})
    small, large = (find_power(case.design, case.truth, studies=6).table for case in (one, ten))
    for column, factor in (
        ("power", 1),
        ("ceiling", 1),
        ("se", 10),
        ("detectable", 10),
        ("simulated", 1),
    ):
        assert (small[column] * factor).tolist() == pytest.approx(large[column].tolist(), rel=1e-6)


def test_simulated_studies_have_the_power_of_the_closed_form_and_few_false_positives(
    make_scenario: Make,
) -> None:
    for slope in (45.0, 0.0):
        case = make_scenario(slopes={"spectral": slope}, participants=10)
        power = find_power(case.design, case.truth, studies=STUDIES, seed=5)
        row = power.table.loc[0]
        assert row["tests"] == STUDIES
        assert power.counts["models"].sum() == STUDIES
        assert is_likely(row["simulated"], max(row["power"], 0.025), STUDIES, off=0.06)
        assert row["simulated_low"] <= row["simulated"] < row["simulated_high"]


def test_shares_are_those_of_a_loop_over_studies(make_scenario: Make) -> None:
    given = make_scenario(
        attributes=("real", "like"), slopes={"spectral": 60.0, "like/temporal": 40.0}
    )
    found = simulate.simulate_studies(given.design, given.truth, studies=8)
    found.tests[0, 1] = np.nan  # as of an attribute that has no model
    table = simulate._tabulate_shares(found, given.design)
    hits, counts = np.zeros((2, 4))
    for study in range(8):
        estimate, se, df = found.tests[study].reshape(4, 3).T
        p = 2 * student.sf(abs(estimate / se), df)
        order = [place for place in np.argsort(p) if np.isfinite(p[place])]
        for step, place in enumerate(order):
            if p[place] * (len(order) - step) >= 0.05:
                break
            hits[place] += 1
        counts += np.isfinite(p)
    assert table["tests"].tolist() == counts.tolist()
    assert counts[2] < 8
    assert table["simulated"].tolist() == pytest.approx((hits / counts).tolist())


def test_a_damaged_result_is_computed_anew(make_scenario: Make, tmp_path: Path) -> None:
    given = make_scenario(own=(3, 3), participants=4)
    first = find_power(given.design, given.truth, studies=2, keep=tmp_path)
    (file,) = tmp_path.iterdir()
    whole = file.read_text()
    for text in ("", whole[:-9], "[]", "[1, 2]"):
        file.write_text(text)
        again = find_power(given.design, given.truth, studies=2, keep=tmp_path)
        assert again.table.equals(first.table)
        assert file.name in " ".join(again.notes)
        assert file.read_text() == whole


def test_the_same_bytes_for_any_number_of_workers(
    make_scenario: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulate, "CHUNK", 4)
    given = make_scenario(own=(4, 4), participants=4, recordings=5)
    folders = [tmp_path / name for name in ("one", "two")]
    found = [
        find_power(given.design, given.truth, studies=8, workers=count, keep=folder)
        for count, folder in zip((1, 2), folders, strict=True)
    ]
    one, two = ({file.name: file.read_bytes() for file in folder.iterdir()} for folder in folders)
    assert len(one) == 2
    assert one == two
    assert found[0].table.equals(found[1].table)
    assert found[0].table.equals(find_power(given.design, given.truth, studies=8).table)
    # Another truth is not taken for this one, a longer simulation is the same and more.
    other = replace(given.truth, rating_sd=1.0)
    find_power(given.design, other, studies=4, keep=folders[0])
    assert len(list(folders[0].iterdir())) == 3
    longer = find_power(given.design, given.truth, studies=10, keep=folders[0])
    assert longer.table["tests"].tolist() == [10, 10]
    assert one.items() <= {file.name: file.read_bytes() for file in folders[0].iterdir()}.items()


PROGRAM = """
import sys
import pandas as pd
from pathlib import Path
from feel321 import analysis
from feel321.analysis.power import simulate
from feel321.analysis.power.simulate import find_power
simulate.CHUNK = 4
design = analysis.PowerDesign(pd.read_csv(sys.argv[1]), ["spectral", "temporal"], participants=4)
find_power(design, analysis.Truth({"spectral": 25.0}), studies=32, keep=sys.argv[2])
"""


@pytest.mark.parametrize(
    "how", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.soak)]
)
def test_a_killed_simulation_goes_on_where_it_was(
    make_scenario: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: signal.Signals
) -> None:
    monkeypatch.setattr(simulate, "CHUNK", 4)
    given = make_scenario(own=(3, 3), participants=4)
    given.design.items.to_csv(tmp_path / "items.csv", index=False)
    folder = tmp_path / "kept"
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, str(tmp_path / "items.csv"), str(folder)],
                               stderr=subprocess.DEVNULL)  # fmt: skip
    while process.poll() is None and len(list(folder.glob("*.json"))) < 2:
        time.sleep(0.02)
    process.send_signal(how)
    assert process.wait() != 0
    kept = {
        file.name: (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.glob("*.json")
    }
    assert 2 <= len(kept) < 8
    design = analysis.PowerDesign(given.design.items, given.design.metrics, participants=4)
    steps: list[tuple[int, int]] = []
    again = find_power(
        design, given.truth, studies=32, keep=folder, progress=lambda *step: steps.append(step)
    )
    assert steps[0] == (len(kept), 8)
    assert len(list(folder.glob("*.json"))) == 8
    assert (
        kept.items()
        <= {
            file.name: (file.read_bytes(), file.stat().st_mtime_ns)
            for file in folder.glob("*.json")
        }.items()
    )
    steps.clear()
    last = find_power(
        design, given.truth, studies=32, keep=folder, progress=lambda *step: steps.append(step)
    )
    assert steps == [(8, 8)]
    assert last.table.equals(again.table)


def test_screening_leaves_out_whom_the_rules_flag(make_scenario: Make) -> None:
    careless = {"straight_liners": 0.4, "participants": 10, "slopes": {"spectral": 60.0}}
    plain = make_scenario(**careless)
    screened = make_scenario(**careless, screening=("straight_lining",))
    found = [
        simulate.simulate_studies(one.design, one.truth, studies=4) for one in (plain, screened)
    ]
    assert (found[0].people == 10).all()
    assert 3 < found[1].people.mean() < 9
    # A straight liner has no slope: with them the mean slope is smaller.
    means = [one.tests[:, 0, 0, 0].mean() for one in found]
    assert means[1] > means[0] * 1.1
    # Ratings of a scale without ends are screened at its ends.
    open_ended = make_scenario(**careless | {"mean": 90.0}, bounded=False, screening=("outliers",))
    find_power(open_ended.design, open_ended.truth, studies=1)
    alone = make_scenario(straight_liners=1.0, screening=("straight_lining",))
    none = find_power(alone.design, alone.truth, studies=1)
    assert none.table["tests"].tolist() == [0, 0]
    assert none.table["simulated"].isna().all()
    assert "screening leaves fewer than 3 participants" in " ".join(none.notes)


def test_pilot_data_give_the_spreads(make_scenario: Make) -> None:
    given = make_scenario(own=(12, 10), participants=40, repeats=4, step=0.0, bounded=False)
    rng = np.random.default_rng(8)
    ratings = draw.draw_ratings(given, given.stimuli, rng)
    table = draw.tabulate_ratings(given.stimuli, ratings[0], given.design.metrics)
    primary = analysis.fit_primary(table, given.design.metrics, explain=False)
    truth = analysis.Truth.from_fit(primary, repeats=4, rating_sd=12.5, mean=60.0)
    assert truth.slopes["spectral"] == pytest.approx(25, abs=20)
    assert (truth.mean, truth.rating_sd, truth.source) == (
        60.0,
        12.5,
        "the primary model of 40 people's ratings",
    )
    for name in ("item_sd", "person_sd", "person_recording_sd", "person_item_sd"):
        assert getattr(truth, name) == pytest.approx(getattr(given.truth, name), rel=0.35)
    one = find_power(given.design, analysis.Truth.from_fit(primary), studies=0).table.loc[0]
    assert one["se"] == pytest.approx(primary.slopes.loc["spectral", "se"], rel=0.05)


def test_designs_and_truths_that_cannot_be_are_refused(make_scenario: Make) -> None:
    given = make_scenario()
    design, items = given.design, given.design.items
    for change, why in (
        ({"participants": 2}, "participants must be 3 or more, got 2"),
        ({"repeats": 0}, "repeats must be 1 or more"),
        ({"metrics": ("spectral", "none")}, "column none is missing"),
        ({"items": items.iloc[[0, 0]]}, "once more"),
        ({"items": items.assign(spectral=np.nan)}, "36 stimuli"),
        ({"wanted": 1.0}, "wanted"),
        ({"screening": ("too_fast",)}, "too_fast"),
    ):
        with pytest.raises(ValueError, match=why):
            replace(design, **change)
    for change, why in (
        ({"item_sd": -1.0}, "item_sd must be 0 or more"),
        ({"lapse_rate": 2.0}, "lapse_rate must be from 0 to 1"),
        ({"random_clickers": 0.6, "straight_liners": 0.6}, "at most 1 together"),
    ):
        with pytest.raises(ValueError, match=why):
            replace(given.truth, **change)
    with pytest.raises(ValueError, match="got 'other'"):
        find_power(design, analysis.Truth({"other": 1.0}), studies=0)
    with pytest.raises(ValueError, match="studies must be 0 or more"):
        find_power(design, given.truth, studies=-1)
