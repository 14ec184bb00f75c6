"""The page: the frontier, the one row of single axes, the files, the words."""

import json
import re
from pathlib import Path

import pandas as pd
import pytest

from feel321.analysis.tradeoff.measure import measure_tradeoff
from feel321.analysis.tradeoff.page import (
    Tradeoff,
    advise_tradeoff,
    describe_choice,
    list_reducers,
    map_battery,
    mark_frontier,
    place_points,
)
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from tests.analysis.test_dictionary import hold_to_dictionary
from tests.analysis.tradeoff.test_people import rate


@pytest.mark.parametrize(
    ("points", "sign", "front"),
    [
        ([(1, 0.2), (2, 0.5), (3, 0.4)], 1, "TTF"),
        ([(1, 0.2), (1, 0.2), (1, 0.3)], 1, "FFT"),
        ([(1, 0.5), (1, 0.5)], 1, "TT"),
        ([(1, 0.2), (2, 0.5), (3, 0.1)], -1, "TFT"),
        ([(1, 0.9, "fails"), (2, 0.5)], 1, "FT"),
        ([], 1, ""),
    ],
)
def test_the_frontier_holds_who_does_not_fail_and_is_not_beaten(
    points: list, sign: int, front: str
) -> None:
    rows = [{"cost_ratio": one[0], "accuracy": one[1], "fails": len(one) > 2} for one in points]
    marked = mark_frontier(rows, sign=sign)
    assert "".join("FT"[one["on_frontier"]] for one in marked) == front


def test_single_axes_are_one_row(result: Tradeoff) -> None:
    points = place_points(result.frame, result.verdicts)
    shown = set(points["reducer"])
    assert len(shown) == len(REDUCERS) - 6
    assert {"sax/say/saz321", "sax/say/saz321_matched", "sax/say/saz321_matched_running"} <= shown
    rows = {row["reducer"]: row for row in list_reducers(result, points)}
    assert set(rows) == shown
    assert sum(row["chosen"] for row in rows.values()) == 3
    assert rows["dft321"]["turned"] == 3
    assert rows["dft321_principal"]["turned"] == 0


def test_the_folder_holds_page_numbers_and_tables(result: Tradeoff, tmp_path: Path) -> None:
    page = result.write(tmp_path / "out")
    content = json.loads((page.parent / "results.json").read_text(encoding="utf-8"))
    for name in content["files"]:
        assert (page.parent / name).is_file(), name
    hold_to_dictionary(page.parent / "tables")
    assert content["headline"] == result.headline
    assert [one["recording"] for one in content["choices"]] == list(result.choices["recording"])
    text = page.read_text(encoding="utf-8")
    words = re.sub(r"<(style|svg).*?</\1>|<[^>]+>", " ", text, flags=re.DOTALL)
    assert not re.search(r"\b(nan|None|inf)\b", words)
    assert len(words.split()) < 1500
    for one in content["choices"]:
        assert one["closest"] in words
    assert "Ratings were not used" in words


def test_a_close_call_says_nothing_twice() -> None:
    doubt = "pca321 is 1.1 dB behind in level"
    row = dict.fromkeys(("problem", "simpler_fails", "ties", "better", "barred", "people"), "")
    row |= {"recording": "oak", "answer": "dft321", "closest": "dft321", "better_db": 0.0}
    row |= {"simpler": "pca321", "simpler_db": 1.1, "simpler_criterion": "level"}
    said = describe_choice({**row, "close": doubt})
    assert (said["simpler"], said["close"]) == (doubt, "close call")
    assert describe_choice({**row, "close": "soc321"})["close"] == "close call: soc321"
    assert describe_choice({**row, "close": ""})["close"] == ""


def test_people_appear_where_they_were_asked(result: Tradeoff, tmp_path: Path) -> None:
    names = {"best": "dft321_principal", "alike": "dft321", "worse": "pca321", "unsure": "soc321"}
    ratings = rate(recording="bumps").assign(simulated=True)
    ratings["reducer"] = ratings["reducer"].replace(names)
    heard = advise_tradeoff(result.frame, ratings=ratings, margin=5.0)
    text = heard.write(tmp_path / "out").read_text(encoding="utf-8")
    assert "Ratings come from simulated participants" in text
    assert "people" in {path.stem for path in (tmp_path / "out" / "tables").iterdir()}
    assert ">People<" in text


def test_own_metrics_have_a_panel_and_the_battery_a_map(
    recordings: list[Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from feel321.analysis.tradeoff import measure

    monkeypatch.setattr(measure, "THOROUGH", measure.QUICK._replace(takes=2))
    monkeypatch.setattr(
        measure, "BATTERY", {name: measure.BATTERY[name] for name in ("ordinary_drag", "one_axis")}
    )
    few = ["sax321", "say321", "dft321_principal"]
    frame = measure_tradeoff(recordings[0], reducers=few, metrics=["st_sim"], thorough=True)
    result = advise_tradeoff(frame)
    assert set(place_points(frame, result.verdicts)["metric"]) == {
        "spectral_match_bounded", "temporal_match", "st_sim",
    }  # fmt: skip
    found = map_battery(result.verdicts)
    assert found["scenes"] == ["ordinary_drag", "one_axis"]
    assert "level" in found["cells"]["one_axis", "sax/say/saz321"]["fails"].split()
    assert found["cells"]["ordinary_drag", "dft321_principal"] == {"fails": "", "turned": False}
    assert "One axis only" in result.write(tmp_path / "out").read_text(encoding="utf-8")
    # The battery decides nothing about the lab's own recordings.
    own = frame[frame["kind"] != "battery"]
    pd.testing.assert_frame_equal(advise_tradeoff(own).choices, result.choices)
