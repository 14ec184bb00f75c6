from __future__ import annotations

import csv
import json
import pickle
import re
import shutil
import subprocess
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.tradeoff.chart.accuracy import ReducerVariant, draw_turns, measure_accuracy
from feel321.analysis.tradeoff.chart.compute import FULL, QUICK, compute_chart, merge_equal
from feel321.analysis.tradeoff.chart.figures import draw_cost, draw_latency, draw_tradeoff
from feel321.analysis.tradeoff.chart.finding import (
    MOST,
    STEADY,
    choose_candidates,
    describe_answers,
    describe_finding,
    find_middle,
    list_candidates,
)
from feel321.analysis.tradeoff.chart.page import collect_notes, dump_data, list_axes
from feel321.analysis.tradeoff.chart.points import (
    ACCURACY,
    GROUPS,
    MEASURES,
    TABLES,
    find_front,
    merge_rows,
    name_point,
)
from feel321.stimuli.reducers.registry import REDUCERS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.analysis.tradeoff.chart.compute import Chart
    from feel321.analysis.tradeoff.chart.points import Tables
    from feel321.stimuli.recording import Recording

SHOWN = tuple(dict.fromkeys(map(name_point, REDUCERS)))
"""What is drawn: methods that are equal by construction once."""

BROWSER = next(
    (
        path
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (path := shutil.which(name))
    ),
    "",
)


def dump(chart: Chart) -> str:
    tables = chart.to_frames()
    return dump_data(tables, merge_equal(tables), list_axes(tables))


def test_every_reducer_scene_measure_and_sweep_is_there(tiny: Chart) -> None:
    points = set(zip(tiny.points["reducer"], tiny.points["measure"], strict=True))
    assert points == set(product(REDUCERS, MEASURES))
    usual = tiny.accuracies[tiny.accuracies["sweep"] == "reducer"]
    assert len(usual) == len(REDUCERS) * 2 * len(MEASURES)
    assert set(tiny.costs["sweep"]) == {"size", "window", "hop", "block", "rate", "bits"}
    assert set(tiny.accuracies["sweep"]) == {"reducer", "window", "hop", "rate"}
    assert (tiny.costs["low"] <= tiny.costs["ns_per_sample"]).all()
    assert (tiny.costs["ns_per_sample"] <= tiny.costs["high"]).all()
    assert tiny.growth["reducer"].tolist() == list(REDUCERS)
    assert tiny.scenes["used_s"].tolist() == [0.3, 0.3]
    assert {name: tuple(frame) for name, frame in tiny.to_frames().items()} == TABLES


def test_strict_front_members_are_marked(tiny: Chart) -> None:
    for _, points in merge_equal(tiny.to_frames())["points"].groupby("measure"):
        strict = find_front(np.c_[points["ns_per_sample"], -points["median"]])
        assert points["on_front"][strict].all()


def test_medians_lie_between_their_scenes_and_known_ones_are_right(tiny: Chart) -> None:
    points = tiny.points
    assert points["median"].between(points["lowest"], points["highest"]).all()
    spectral = points[points["measure"] == "spectral_match"].set_index("reducer")["median"]
    assert spectral["dft321"] == pytest.approx(1.0, abs=1e-9)


def test_equal_by_construction_is_one_point_and_loses_no_name(tiny: Chart) -> None:
    merged = merge_equal(tiny.to_frames())
    points = merged["points"].set_index(["reducer", "measure"])
    assert merged["points"]["reducer"].unique().tolist() == list(SHOWN)
    assert len(SHOWN) == len(REDUCERS) - 6
    own = tiny.points.set_index(["reducer", "measure"])
    usual = tiny.accuracies[tiny.accuracies["sweep"] == "reducer"]
    for (label, members), measure in product(GROUPS.items(), MEASURES):
        same = [own.loc[member, measure] for member in members]
        point = points.loc[label, measure]
        assert {one["group"] for one in same} == {label}
        assert {one["on_front"] for one in same} == {point["on_front"]}
        mean = np.mean([one["ns_per_sample"] for one in same])
        assert point["ns_per_sample"] == pytest.approx(mean)
        rows = usual[usual["reducer"].isin(members) & (usual["measure"] == measure)]
        median = rows.groupby("scene")["mean"].mean().median()
        assert point["median"] == pytest.approx(median)
    alone = tiny.points["reducer"].map(name_point) == tiny.points["reducer"]
    assert set(tiny.points["group"][alone]) == {""}
    assert merge_rows(merged["costs"]).equals(merged["costs"])
    assert {*tiny.dominated["reducer"], *tiny.dominated["by"]} <= set(SHOWN)


def test_single_axes_are_equal_over_many_orientations(
    make_recording: Callable[[str], Recording],
) -> None:
    """The law that the groups rest on; as mounted, the axes are far from equal."""
    variants = [ReducerVariant(name) for members in GROUPS.values() for name in members]
    rows = measure_accuracy(make_recording("bumps"), variants, turns=draw_turns(300, 5))
    for members, measure in product(GROUPS.values(), MEASURES[1:3]):
        own = [row for row in rows if row["reducer"] in members and row["measure"] == measure]
        error = max(row["sd"] for row in own) / np.sqrt(300)
        assert np.ptp([row["mean"] for row in own]) < 6 * error
        assert np.ptp([row["as_mounted"] for row in own]) > 6 * error


def test_rated_members_of_a_point_stand_beside_it(rated: Chart) -> None:
    first = rated.rated.iloc[[0, 0]]
    chart = replace(rated, rated=first.assign(reducer=["sax321", "saz321"], mean=[40.0, 60.0]))
    members = [entry for entry in json.loads(dump(chart))["methods"] if entry["member"]]
    assert [(entry["label"], *entry["ratings"].values()) for entry in members] == [
        ("sax321", [40.0, 55.0, 70.0, 50.0, 75.0]),
        ("saz321", [60.0, 55.0, 70.0, 50.0, 75.0]),
    ]
    assert {entry["reducer"] for entry in members} == {name_point("sax321")}


def test_a_chart_is_small_to_look_at_and_goes_through_pickle(rated: Chart) -> None:
    assert pickle.loads(pickle.dumps(rated)) == rated  # noqa: S301 - our own bytes
    assert len(repr(rated)) <= 200
    tables = rated.to_frames()
    assert rated.summary().splitlines() == list(describe_answers(tables, merge_equal(tables)))


def test_recordings_need_names_of_their_own(make_recording: Callable[[str], Recording]) -> None:
    with pytest.raises(ValueError, match="recordings must be one or more, got none"):
        compute_chart([])
    with pytest.raises(ValueError, match="must have different names, got 'bumps' twice"):
        compute_chart([make_recording("bumps")] * 2)


def test_efforts_differ_in_everything() -> None:
    assert QUICK.rotations < FULL.rotations == 200
    assert (QUICK.largest_n, FULL.largest_n) == (10**6, 10**7)


def test_answers_name_the_front_and_the_dominated(rated: Chart) -> None:
    text, dominated = rated.summary(), rated.dominated
    front = text.split("On the front of cost and a match: ")[1].split(". No other")[0]
    points = merge_equal(rated.to_frames())["points"]
    assert {one.split(" (")[0] for one in front.split("; ")} == {
        *points[points["on_front"]]["reducer"]
    }
    named = text.split("both of the paper's metrics together: ")[1].split("\n")[0]
    clear = dominated[dominated["clear"]]
    assert {one.split(" (")[0] for one in named.split("; ")} == {*clear["reducer"]}
    best = "Best mean realism rating (as is): dft321, 71.0 (95 % two-way interval 60.0 to 80.0;"
    assert best in text
    none = replace(rated, dominated=dominated[:0])
    assert "No reducer is clearly dominated" in none.summary()
    unclear = replace(rated, dominated=dominated.assign(clear=False))
    assert "No reducer is clearly dominated" in unclear.summary()
    assert len(rated.summary().splitlines()) == 6


def keep(tables: Tables, *reducers: str) -> dict[str, pd.DataFrame]:
    return {
        name: frame[frame["reducer"].isin(reducers)] if "reducer" in frame else frame
        for name, frame in tables.items()
    }


def test_the_sentence_is_about_what_the_results_hold(rated: Chart, written: Path) -> None:
    content = json.loads((written / "results.json").read_text(encoding="utf-8"))
    headline, merged = content["headline"], merge_equal(rated.to_frames())
    points = merged["points"][merged["points"]["measure"] == ACCURACY].set_index("reducer")
    highest = points["median"].round(2) == points["median"].round(2).max()
    best = points[highest]["ns_per_sample"].idxmin()
    assert headline.startswith(f"{best} is the ")
    assert f"(bounded spectral match {points['median'][best]:.2f})" in headline
    if found := re.search(
        r"; (\S+) is ([\d.]+) times faster and loses (less than )?([\d.]+)\.$", headline
    ):
        other, times, _, lost = found.groups()
        ratio = points["ns_per_sample"][best] / points["ns_per_sample"][other]
        assert float(times) == pytest.approx(ratio, rel=0.06)
        assert float(lost) == pytest.approx(
            points["median"][best] - points["median"][other], abs=0.0051
        )
    else:
        assert headline.endswith("; no other is clearly faster.")
    assert content["answers"][0] == headline
    assert headline in (written / "index.html").read_text(encoding="utf-8")


def test_candidates_are_few_and_each_is_what_it_is_said_to_be(tiny: Chart, written: Path) -> None:
    merged = merge_equal(tiny.to_frames())
    every = list_candidates(merged)
    found = choose_candidates(merged)
    assert len({one.reducer for one in found}) == len(found) <= MOST
    said = {why: one for one in found for why in one.why.split(", ")}
    assert said["fastest"].ns_per_sample == min(one.ns_per_sample for one in every)
    highest = max(round(one.accuracy, 2) for one in every)
    assert round(said["most accurate"].accuracy, 2) == highest
    live = [one for one in every if np.isfinite(one.latency_s)]
    if np.isinf(said["most accurate"].latency_s):
        best = said["most accurate live"]
        assert np.isfinite(best.latency_s)
        assert round(best.accuracy, 2) == max(round(one.accuracy, 2) for one in live)
    content = json.loads((written / "results.json").read_text(encoding="utf-8"))
    assert [one["reducer"] for one in content["candidates"]] == [one.reducer for one in found]


def test_few_reducers_and_an_unsteady_one_are_described_truly(tiny: Chart) -> None:
    merged = merge_equal(tiny.to_frames())
    alone = keep(merged, "dft321")
    assert describe_finding(alone).startswith("dft321 is the most accurate (bounded spectral")
    assert [one.why for one in choose_candidates(alone)] == [
        "most accurate, fastest, keeps the time course best"
    ]
    two = keep(merged, "dft321", "mag321")
    assert re.fullmatch(
        r"dft321 is the most accurate \(bounded spectral match 1\.00\) .*; "
        r"(mag321 is [\d.]+ times faster and loses 0\.\d\d|no other is clearly faster)\.",
        describe_finding(two),
    )
    noisy = {**two, "stability": two["stability"].assign(gain=1234.5)}
    assert "but amplifies sensor noise up to 1200 times" in describe_finding(noisy)
    calm = two["stability"]["reducer"] == "mag321"
    noisy["stability"] = two["stability"].assign(gain=np.where(calm, STEADY / 2, STEADY))
    said = {why: one.reducer for one in choose_candidates(noisy) for why in one.why.split(", ")}
    assert said["most accurate of the steady"] == "mag321"
    still = {**two, "stability": two["stability"][:0]}
    assert "steady" not in describe_finding(still)


@pytest.mark.parametrize(
    ("middle", "fast", "said"),
    [
        ((0.94, 85, 70, 110), (0.506, 1, 0.9, 1.1), "pca321 is 100 times faster and loses 0.45."),
        ((0.936, 20, 19, 21), (0.5, 1, 0.9, 120), "mag321 is 5.0 times faster and loses 0.02."),
        ((0.954, 20, 19, 21), (0.5, 19, 0.9, 120), "mag321 is 5.0 times faster and loses less than 0.01."),
        ((0.94, 85, 70, 110), (0.5, 84, 80, 120), "no other is clearly faster."),
    ],
)  # fmt: skip
def test_whoever_is_clearly_faster_is_named(
    tiny: Chart, middle: tuple[float, ...], fast: tuple[float, ...], said: str
) -> None:
    """Accuracy, cost, and the quartiles of the cost are planted."""
    rows = keep(merge_equal(tiny.to_frames()), "dft321", "mag321", "pca321")
    planted = {"dft321": (0.956, 100, 90, 130), "mag321": middle, "pca321": fast}
    points = rows["points"].assign(on_front=True)
    for column, name in enumerate(("median", "ns_per_sample", "low", "high")):
        points[name] = points["reducer"].map({key: own[column] for key, own in planted.items()})
    assert describe_finding({**rows, "points": points}).endswith(f"; {said}")


def test_the_middle_lies_on_the_front_above_the_line(tiny: Chart) -> None:
    every = list_candidates(merge_equal(tiny.to_frames()))
    one = replace(every[0], on_front=True)
    best, fast = (replace(one, ns_per_sample=x, accuracy=y) for x, y in ((100.0, 1.0), (1.0, 0.2)))
    high, low = (replace(one, ns_per_sample=10.0, accuracy=value) for value in (0.7, 0.5))
    off = replace(high, accuracy=0.9, on_front=False)
    assert find_middle([best, off, high, low, fast]) == high
    assert find_middle([best, off, low, fast]) is None
    assert find_middle([best]) is None


def test_the_picture_has_a_row_per_reducer_and_draws_the_front(tiny: Chart) -> None:
    merged = merge_equal(tiny.to_frames())
    accuracy, cost, gain = draw_tradeoff(merged).axes
    points = merged["points"][merged["points"]["measure"] == ACCURACY].set_index("reducer")
    names = [label.get_text() for label in accuracy.get_yticklabels()]
    assert sorted(names) == sorted(SHOWN)
    assert [*points["median"].round(2)[names]] == sorted(points["median"].round(2), reverse=True)
    bold = {
        label.get_text() for label in accuracy.get_yticklabels() if label.get_fontweight() == "bold"
    }
    assert bold == {*points[points["on_front"]].index}
    front = next(
        line
        for line in cost.lines
        if len(line.get_xdata()) == len(bold) and line.get_linestyle() != "None"
    )
    assert {*front.get_xdata()} == {*points[points["on_front"]]["ns_per_sample"]}
    for axes, values in ((accuracy, points["median"]), (cost, points["ns_per_sample"])):
        marks = {
            round(line.get_ydata()[0]): line.get_xdata()[0]
            for line in axes.lines
            if line.get_marker() != "None"
        }
        assert [marks[row] for row in range(len(names))] == [*values[names]]
    assert len(gain.collections) == merged["stability"]["reducer"].nunique()


def test_of_dissimilarities_the_lowest_is_best(rated: Chart) -> None:
    apart = replace(rated, rated=rated.rated.assign(scale="dissimilarity"))
    assert "Best mean dissimilarity from the reference (as is): soc321, 62.5" in apart.summary()
    assert [list_axes(one.to_frames())[-1]["better"] for one in (apart, rated)] == ["low", "high"]


def test_spreads_of_a_group_are_merged_as_variances() -> None:
    rows = [
        {"method": name, "reducer": name, "scene": "oak", "sd": sd, "mean": sd}
        for name, sd in zip(GROUPS["sax/say/saz321"], (3.0, 4.0, 5.0), strict=True)
    ]
    (merged,) = merge_rows(pd.DataFrame(rows)).to_dict("records")
    assert (merged["mean"], merged["sd"]) == pytest.approx((4.0, np.sqrt(50 / 3)))


def test_notes_tell_what_was_cut_and_a_busy_machine(
    tiny: Chart, make_recording: Callable[[str], Recording]
) -> None:
    recordings, rows = [make_recording("bumps")], tiny.precision.to_dict("records")
    idle, busy = ({**tiny.machine, "load": load} for load in (0.0, 99.0))
    odd = [{"reducer": "soc321", "output": "float32", "arithmetic_db": None}]
    whole = "\n".join(collect_notes(recordings, 1.0, precision=rows, machine=idle))
    assert "32-bit input is not computed in 32 bit" in whole
    assert "their middle was used" not in whole
    assert "busy" not in whole
    cut = "\n".join(collect_notes(recordings, 0.1, precision=odd, machine=busy))
    assert "1 of 1 recordings are longer than 0.1 s" in cut
    assert "(99.0 programs for" in cut
    assert "Output for 32-bit input: float32." in cut


def test_everything_is_written(rated: Chart, written: Path) -> None:
    content = json.loads((written / "results.json").read_text(encoding="utf-8"))
    files = {str(path.relative_to(written)) for path in written.rglob("*") if path.is_file()}
    assert files == set(content["files"])
    whole = rated.to_dict()
    assert {name: content[name] for name in whole if name not in TABLES} == {
        name: value for name, value in whole.items() if name not in TABLES
    }
    for name, frame in rated.to_frames().items():
        read = pd.DataFrame(content[name], columns=list(frame)).astype(frame.dtypes)
        pd.testing.assert_frame_equal(read, frame)
        with (written / "tables" / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            assert len(list(csv.DictReader(file))) == len(frame)


def test_a_former_chart_is_replaced_and_nothing_else(
    tiny: Chart, written: Path, tmp_path: Path
) -> None:
    target = tmp_path / "chart"
    shutil.copytree(written, target)
    before = set(json.loads((target / "results.json").read_text(encoding="utf-8"))["files"])
    (target / "notes.txt").write_text("mine")
    tiny.write(target)
    gone = before - set(json.loads((target / "results.json").read_text(encoding="utf-8"))["files"])
    assert gone == {"figures/rated_realism_as_is.svg", "figures/rated_realism_as_is.png"}
    assert not any((target / name).exists() for name in gone)
    assert (target / "notes.txt").read_text() == "mine"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "index.html").write_text("mine")
    with pytest.raises(FileExistsError, match="exists and is not of a former report"):
        tiny.write(tmp_path / "other")
    assert (tmp_path / "other" / "index.html").read_text() == "mine"


def test_no_mean_hides_its_scenes(tiny: Chart) -> None:
    merged = merge_equal(tiny.to_frames())
    for axes, measure in zip(draw_cost(merged).axes, MEASURES[:2], strict=True):
        dots = [line for line in axes.lines if line.get_marker() == "."]
        assert len(dots) == 2 * len(SHOWN)
        rows = merged["accuracies"].query("sweep == 'reducer'")
        rows = rows[rows["measure"] == measure]
        shown = {float(dot.get_ydata()[0]) for dot in dots}
        assert shown == set(rows["mean"].clip(-1.0))


def test_every_window_stands_in_the_figure_of_latency(tiny: Chart) -> None:
    (above, _) = draw_latency(merge_equal(tiny.to_frames())).axes
    assert [len(line.get_xdata()) for line in above.lines if len(line.get_xdata()) == 6]


def test_no_name_can_end_the_pages_data(tiny: Chart) -> None:
    text = dump(replace(tiny, scenes=tiny.scenes[:1].assign(name="</script><b>")))
    assert "<" not in text
    assert json.loads(text)["scenes"] == ["</script><b>"]


def test_the_page_holds_every_method_and_spans_that_rise(rated: Chart) -> None:
    data = json.loads(dump(rated))
    merged = merge_equal(rated.to_frames())
    measured = {
        (row["sweep"], row["method"], row["rate_hz"] if row["sweep"] == "rate" else 0)
        for row in merged["accuracies"].to_dict("records")
    }
    streams = merged["costs"].query("sweep == 'block'")
    assert len(data["methods"]) == len(measured) + len(streams)
    for method in data["methods"]:
        for value, low, high in (method["speed"]["cost"], method["speed"]["real_time"]):
            assert low <= value <= high
    assert [axis["key"] for axis in data["axes"]][-1] == "Mean realism rating, as is (0 to 100)"
    found = {method["label"]: method for method in data["methods"]}
    plain, stream = found["dft321_windowed"], found["dft321_windowed, blocks of 64"]
    assert stream["scores"] == plain["scores"]
    assert stream["speed"]["latency"][0] == pytest.approx(plain["speed"]["latency"][0] + 6.3)
    assert found["soc321, 2 kHz"]["speed"]["latency"][0] == 0
    ratings = {
        method["reducer"]: method["ratings"]
        for method in data["methods"]
        if method["kind"] == "reducer"
    }
    assert ratings["dft321"] == {
        "Mean realism rating, as is (0 to 100)": [71.0, None, None, 60.0, 80.0]
    }
    assert ratings[name_point("sax321")] == {}


def open_page(page: Path, tmp_path: Path) -> tuple[str, str]:
    """The document after its scripts ran, and what the browser's console said."""
    command = [
        BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0",
        f"--user-data-dir={tmp_path / 'browser'}", "--virtual-time-budget=2000", "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return done.stdout, "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)


@pytest.mark.skipif(
    not BROWSER, reason="NO BROWSER: chromium is not installed, the page was NOT opened"
)
def test_the_page_opens_in_a_real_browser_and_its_script_works(
    rated: Chart, written: Path, tmp_path: Path
) -> None:
    page = tmp_path / "index.html"
    shutil.copy(written / "index.html", page)
    document, console = open_page(page, tmp_path)
    assert console == ""
    assert len(re.findall(r'<polygon[^>]*class="point', document)) == len(SHOWN)
    assert len(re.findall(r"<circle", document)) == 2 * len(SHOWN)
    assert "On the front, by the values as drawn: " in document
    assert "Off it: " in document  # no claim of dominance: the answer above minds the noise
    assert "Dominated in this plane" not in document
    # The reader's choices, made by a script: latency against a rating, all sweeps too, then no scene at all.
    steps = """<script>
      const set = (id, value) => { const e = document.getElementById(id); e.value = value;
        e.dispatchEvent(new Event("change")); };
      for (const box of document.querySelectorAll('input[name="sweep"]')) box.click();
      for (const x of ["cost", "real_time", "latency", "temporal_match"])
        for (const y of document.querySelectorAll("#y-axis option")) { set("x-axis", x); set("y-axis", y.value); }
      set("x-axis", "latency"); set("y-axis", "spectral_match");
      document.querySelector(".point").dispatchEvent(new Event("focus"));
      document.body.dataset.tip = document.getElementById("tip").textContent;
      document.body.dataset.points = document.querySelectorAll(".point").length;
      document.body.style.width = "388px";
      const controls = document.getElementById("controls");
      document.body.dataset.fits = controls.scrollWidth <= controls.clientWidth;
      document.querySelector('button[data-of="scene"]').click();
    </script></body>"""
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", steps), encoding="utf-8")
    document, console = open_page(page, tmp_path)
    assert console == ""
    points = len(json.loads(dump(rated))["methods"])
    assert f'data-points="{points}"' in document
    assert 'data-fits="true"' in document  # a telephone does not scroll the page sideways
    assert re.search(
        r'data-tip="sax/say/saz321[^"]*Cost of one sample \(ns\): [\d.]+ \[[\d.]+ to', document
    )
    assert "Nothing to show: choose at least one reducer and one scene." in document
