"""Verdicts and choices: planted numbers, the battery's known failures, and the settings."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.tradeoff.battery import BATTERY
from feel321.analysis.tradeoff.judge import FAILS_DB, FAILURES, Context
from feel321.analysis.tradeoff.measure import measure_tradeoff
from feel321.analysis.tradeoff.page import Tradeoff, advise_tradeoff
from feel321.stimuli.recording import Recording
from tests.analysis.tradeoff.made import judge, make_frame, read_verdicts

KNOWN = [(scene.name, *one) for scene in BATTERY.values() for one in scene.failing]


@pytest.fixture(scope="module")
def battery() -> Tradeoff:
    return advise_tradeoff(measure_tradeoff([scene.make(7) for scene in BATTERY.values()]))


@pytest.mark.parametrize(("scene", "reducer", "kind"), KNOWN)
def test_what_must_fail_fails(scene: str, reducer: str, kind: str, battery: Tradeoff) -> None:
    own = battery.verdicts[battery.verdicts["recording"] == scene]
    assert kind in read_fails(own)[reducer].split()


def read_fails(rows: pd.DataFrame) -> dict[str, str]:
    return dict(zip(rows["reducer"], rows["fails"], strict=True))


def test_on_the_control_nobody_fails_and_some_depend_on_the_mounting(battery: Tradeoff) -> None:
    own = battery.verdicts[battery.verdicts["recording"] == "ordinary_drag"]
    assert set(own["fails"]) == {""}
    turned = set(own[own["depends_on_mounting"]]["reducer"])
    assert {"sax321", "soc321", "dft321", "dft321_windowed"} <= turned
    assert turned.isdisjoint({"pca321", "mag321", "dft321_principal", "dft321_principal_windowed"})


@pytest.mark.parametrize("kind", FAILURES)
def test_a_reducer_fails_from_a_tenth_of_the_energy_on(kind: str) -> None:
    name = "level_db" if kind == "level" else kind
    for db, fails in ((-FAILS_DB + 0.1, kind), (-FAILS_DB - 0.1, "")):
        given = {name: -FAILS_DB - (db + FAILS_DB) if kind == "level" else db}
        result = judge({"one": given, "sound": {}})
        assert read_verdicts(result, "fails") == {"one": fails, "sound": ""}
        assert not (fails and read_verdicts(result, "sufficient")["one"])


@pytest.mark.parametrize("criterion", ["level", "spectrum", "motion", "envelope"])
def test_a_reducer_suffices_up_to_the_tolerance_from_the_best(criterion: str) -> None:
    for behind, suffices in ((0.99, True), (1.01, False)):
        result = judge({"one": {f"{criterion}_db": 2.0 + behind}, "best": {f"{criterion}_db": 2.0}})
        assert read_verdicts(result, "sufficient")["one"] == suffices
        assert read_verdicts(result, "shortfall_db")["one"] == pytest.approx(behind)
        assert read_verdicts(result, "criterion")["one"] == criterion
        assert list(result.choices["answer"]) == ["one" if suffices else "best"]


def test_too_loud_is_as_wrong_as_too_weak_and_one_half_is_enough() -> None:
    for wrong in ({"level_db": 1.5}, {"level_db": -1.5}, {"half": {"motion_db": 1.5}}):
        assert read_verdicts(judge({"one": wrong, "best": {}}), "shortfall_db")["one"] == 1.5


def test_steadiness_is_the_most_that_noise_can_add() -> None:
    # A change of a quarter of the amplitude adds up to 25 % of it: 1.9 dB.
    result = judge({"one": {"noise": 20 * np.log10(0.25)}, "best": {"noise": -200.0}})
    assert read_verdicts(result, "steadiness_db")["one"] == pytest.approx(20 * np.log10(1.25))
    assert read_verdicts(result, "fails")["one"] == ""


def test_the_best_is_one_that_does_not_fail() -> None:
    result = judge({"one": {"motion_db": 3.0}, "brilliant": {"noise": -5.0}})
    assert list(result.choices["answer"]) == ["one"]
    result = judge({"one": {"noise": -5.0}, "two": {"gaps": -5.0}})
    assert list(result.choices["answer"]) == [""]
    assert list(result.choices["closest"]) == ["one"]
    assert result.headline == "No reducer suffices for the recording."


def test_depending_on_the_mounting_is_no_failure() -> None:
    result = judge({"turning": {"turned": -5.0}, "still": {}})
    assert read_verdicts(result, "depends_on_mounting") == {"turning": True, "still": False}
    assert list(result.choices["answer"]) == ["turning"]


def test_a_choice_says_what_is_wrong_with_the_simpler_and_what_a_better_one_would_gain() -> None:
    result = judge({
        "poor": {"level_db": -6.0}, "near": {"motion_db": 1.6}, "one": {"motion_db": 0.4}, "best": {},
    })  # fmt: skip
    (choice,) = result.choices.to_dict("records")
    assert (choice["answer"], choice["simpler"], choice["simpler_criterion"]) == (
        "one",
        "near",
        "motion",
    )
    assert (choice["simpler_db"], choice["better"]) == (pytest.approx(1.6), "best")
    assert (choice["better_criterion"], choice["better_db"]) == ("motion", pytest.approx(0.4))
    assert choice["close"] == ""


@pytest.mark.parametrize(
    ("reducers", "doubt"),
    [
        ({"near": {"motion_db": 1.2}, "best": {}}, "near is 1.2 dB behind in motion"),
        ({"one": {"motion_db": 0.8}, "best": {}}, "one is 0.8 dB behind in motion"),
        ({"one": {"gaps": -9.0}, "best": {}}, "one fails narrowly (gaps)"),
        ({"one": {"gaps": -11.0}, "best": {}}, "one nearly fails"),
        ({"one": {}, "late": {"motion_db": 1.1}}, ""),
    ],
)
def test_close_calls_are_named(reducers: Any, doubt: str) -> None:
    assert list(judge(reducers).choices["close"]) == [doubt]


def test_ties_are_named_and_the_first_is_advised() -> None:
    alike = {"operations": 4}
    result = judge({"a": alike | {"motion_db": 0.1}, "b": alike, "c": {"operations": 9}})
    (choice,) = result.choices.to_dict("records")
    assert (choice["answer"], choice["ties"]) == ("b", "a")


def test_online_only_what_is_in_time_is_advised_and_the_delay_decides_first() -> None:
    given = {
        "whole": {"latency_ms": np.inf},
        "slow": {"latency_ms": 30.0},
        "soon": {"latency_ms": 5.0},
    }
    assert list(judge(given).choices["answer"]) == ["whole"]
    assert list(judge(given, online=True).choices["answer"]) == ["soon"]
    result = judge({"whole": {"latency_ms": np.inf}, "poor": {"motion_db": 4.0}}, online=True)
    (choice,) = result.choices.to_dict("records")
    assert (choice["answer"], choice["closest"], choice["barred"]) == ("", "poor", "whole")
    late = judge(given, online=True, latency_ms=7.0).choices
    assert list(late["problem"]) == ["no reducer is in time"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"latency_ms": 5}, "latency_ms must be left out offline, got 5; set online=True"),
        ({"online": True, "latency_ms": 5}, "latency_ms must be at least 6.3, .* got 5"),
        ({"online": True, "latency_ms": np.nan}, "latency_ms must be at least 6.3"),
        ({"tolerance_db": 22}, "^tolerance_db must be above 0 and below 10, got 22"),
        ({"mounting": "some"}, "^mounting must be one of any, recorded; got 'some'"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(options: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Context(**options)


def test_what_cannot_be_judged_is_said(result: Tradeoff) -> None:
    problems = dict(zip(result.choices["recording"], result.choices["problem"], strict=True))
    assert problems["calm"] == "silent from 20 to 1000 Hz"
    assert "all 3 recordings" in result.headline
    judged = result.choices[result.choices["problem"] == ""]
    assert "for both recordings" in replace(result, choices=judged.head(2)).headline
    short = Recording(np.ones((3, 100)), 4000.0, "short")
    with pytest.raises(ValueError, match=r"from 20 to 1000 Hz, got none \(short: shorter"):
        advise_tradeoff(measure_tradeoff(short))


def test_the_recorded_mounting_may_be_asked_for() -> None:
    frame = make_frame({"one": {}, "two": {}})
    worse = (
        frame["condition"].eq("mounting")
        & frame["reducer"].eq("one")
        & frame["measure"].eq("motion_db")
    )
    frame.loc[worse, "high"] = 5.0
    assert list(advise_tradeoff(frame).choices["answer"]) == ["two"]
    assert list(advise_tradeoff(frame, Context(mounting="recorded")).choices["answer"]) == ["one"]


def test_known_scenes_need_what_they_are_known_to_need(result: Tradeoff) -> None:
    needed = dict(zip(result.choices["recording"], result.choices["answer"], strict=True))
    assert needed["constrained_drag"] in {"pca321", "pca321_matched"}
    # One principal axis of a circle is chance: no projection suffices.
    assert needed["circular_motion"].startswith("dft321")
    assert "no direction leads" in result.choices.set_index("recording")["close"]["circular_motion"]
