from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.tradeoff.chart.axes import GROUPS, merge_equal, merge_rows, name_point
from feel321.analysis.tradeoff.chart.compute import FULL, QUICK, compute_chart
from feel321.analysis.tradeoff.chart.drawing import draw_cost, draw_latency
from feel321.analysis.tradeoff.chart.explore import dump_data, list_choices
from feel321.analysis.tradeoff.chart.measure import Method, draw_turns, measure_accuracy
from feel321.analysis.tradeoff.chart.page import write_chart
from feel321.analysis.tradeoff.chart.records import (
    MEASURES,
    SWEEPS,
    TABLES,
    Chart,
    Precision,
    find_front,
    read_json,
)
from feel321.analysis.tradeoff.chart.tables import list_notes, tell_answers
from feel321.stimuli.reducers.registry import REDUCERS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

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


def test_every_reducer_scene_measure_and_sweep_is_there(tiny: Chart) -> None:
    points = {(point.reducer, point.measure) for point in tiny.points}
    assert points == {(reducer, measure) for reducer in REDUCERS for measure in MEASURES}
    usual = [row for row in tiny.accuracies if row.sweep == "reducer"]
    assert len(usual) == len(REDUCERS) * 2 * len(MEASURES)
    assert {cost.sweep for cost in tiny.costs} == set(SWEEPS)
    assert {row.sweep for row in tiny.accuracies} == {"reducer", "window", "hop", "rate"}
    assert all(cost.low <= cost.ns_per_sample <= cost.high for cost in tiny.costs)
    assert [row.reducer for row in tiny.growth] == list(REDUCERS)
    assert [scene.used_s for scene in tiny.scenes] == [0.3, 0.3]


def test_strict_front_members_are_marked(tiny: Chart) -> None:
    for measure in MEASURES:
        points = [point for point in merge_equal(tiny).points if point.measure == measure]
        strict = find_front([[point.ns_per_sample, -point.median] for point in points])
        assert all(point.on_front for point, on in zip(points, strict, strict=True) if on)


def test_medians_lie_between_their_scenes_and_known_ones_are_right(tiny: Chart) -> None:
    assert all(point.lowest <= point.median <= point.highest for point in tiny.points)
    spectral = {
        point.reducer: point.median for point in tiny.points if point.measure == "spectral_match"
    }
    assert spectral["dft321"] == pytest.approx(1.0, abs=1e-9)


def test_equal_by_construction_is_one_point_and_loses_no_name(tiny: Chart) -> None:
    merged = merge_equal(tiny)
    assert [point.reducer for point in merged.points if point.measure == MEASURES[0]] == list(SHOWN)
    assert len(SHOWN) == len(REDUCERS) - 6
    own = {(point.reducer, point.measure): point for point in tiny.points}
    for label, members in GROUPS.items():
        for member, measure in product(members, MEASURES):
            assert own[member, measure].group == label
            (point,) = [
                one for one in merged.points if (one.reducer, one.measure) == (label, measure)
            ]
            assert own[member, measure].on_front == point.on_front
            assert point.ns_per_sample == pytest.approx(
                np.mean([own[one, measure].ns_per_sample for one in members])
            )
            means = [
                [
                    row.mean
                    for row in tiny.accuracies
                    if row.sweep == "reducer"
                    and row.reducer in members
                    and (row.measure, row.scene) == (measure, scene.name)
                ]
                for scene in tiny.scenes
            ]
            assert point.median == pytest.approx(np.median(np.mean(means, axis=1)))
    assert {point.group for point in tiny.points if point.reducer == name_point(point.reducer)} == {
        ""
    }
    assert merge_rows(merged.costs) == list(merged.costs)
    assert {name for row in tiny.dominated for name in (row.reducer, row.by)} <= set(SHOWN)


def test_single_axes_are_equal_over_many_orientations(
    make_recording: Callable[[str], Recording],
) -> None:
    """The law that the groups rest on; as mounted, the axes are far from equal."""
    methods = [Method(name) for members in GROUPS.values() for name in members]
    rows = measure_accuracy(make_recording("bumps"), methods, turns=draw_turns(300, 5))
    for members, measure in product(GROUPS.values(), MEASURES[1:3]):
        own = [row for row in rows if row.reducer in members and row.measure == measure]
        error = max(row.sd for row in own) / np.sqrt(300)
        assert np.ptp([row.mean for row in own]) < 6 * error
        assert np.ptp([row.as_mounted for row in own]) > 6 * error


def test_rated_members_of_a_point_stand_beside_it(rated: Chart) -> None:
    means = {"sax321": 40.0, "saz321": 60.0}
    rows = tuple(replace(rated.rated[0], reducer=name, mean=mean) for name, mean in means.items())
    chart = replace(rated, rated=rows)
    members = [
        entry
        for entry in json.loads(dump_data(chart, list_choices(chart)))["methods"]
        if entry["member"]
    ]
    assert [(entry["label"], *entry["ratings"].values()) for entry in members] == [
        ("sax321", [40.0, 55.0, 70.0, 50.0, 75.0]),
        ("saz321", [60.0, 55.0, 70.0, 50.0, 75.0]),
    ]
    assert {entry["reducer"] for entry in members} == {name_point("sax321")}


def test_json_gives_the_same_chart_back(rated: Chart) -> None:
    assert read_json(rated.to_json(files=["results.json"])) == rated


@pytest.mark.parametrize("text", ["{}", "[]", '{"machine": 1}'])
def test_other_json_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="chart: got JSON that is no chart"):
        read_json(text)


def test_recordings_need_names_of_their_own(make_recording: Callable[[str], Recording]) -> None:
    with pytest.raises(ValueError, match="recordings: got none, allowed is one or more"):
        compute_chart([])
    with pytest.raises(
        ValueError, match="recordings: got 'bumps' twice, allowed is a name for each"
    ):
        compute_chart([make_recording("bumps")] * 2)


def test_efforts_differ_in_everything() -> None:
    assert QUICK.rotations < FULL.rotations == 200
    assert (QUICK.largest_n, FULL.largest_n) == (10**6, 10**7)


def test_answers_name_the_front_and_the_dominated(rated: Chart) -> None:
    text = "\n".join(tell_answers(rated))
    assert re.search(r"Spectral match against cost: on the front are .*dft321 \(1\.00\)", text)
    for row in rated.dominated:
        assert row.reducer in text
    assert (
        "Best mean realism rating (as is): dft321, 71.0 (95 % two-way interval 60.0 to 80.0;"
        in text
    )
    assert "No reducer is clearly dominated" in "\n".join(
        tell_answers(replace(rated, dominated=()))
    )
    unclear = tuple(replace(row, clear=False) for row in rated.dominated)
    assert "cannot be told apart from" in "\n".join(tell_answers(replace(rated, dominated=unclear)))


def test_notes_tell_what_was_cut_and_a_busy_machine(
    tiny: Chart, make_recording: Callable[[str], Recording]
) -> None:
    recordings, idle = [make_recording("bumps")], replace(tiny.machine, load=0.0)
    busy = replace(tiny.machine, load=99.0)
    odd = [Precision("soc321", "float32", None)]
    whole = "\n".join(list_notes(recordings, 1.0, precision=tiny.precision, machine=idle))
    assert "32-bit input is not computed in 32 bit" in whole
    assert "their middle was used" not in whole
    assert "busy" not in whole
    cut = "\n".join(list_notes(recordings, 0.1, precision=odd, machine=busy))
    assert "1 of 1 recordings are longer than 0.1 s" in cut
    assert "(99.0 programs for" in cut
    assert "Output for 32-bit input: float32." in cut


def test_everything_is_written_and_a_former_chart_replaced(
    rated: Chart, tiny: Chart, tmp_path: Path
) -> None:
    target = tmp_path / "chart"
    files = write_chart(rated, target)
    assert {str(path.relative_to(target)) for path in target.rglob("*") if path.is_file()} == set(
        files
    )
    content = json.loads((target / "results.json").read_text(encoding="utf-8"))
    assert read_json(json.dumps(content)) == rated
    assert content["files"] == list(files)
    for name in TABLES:
        with (target / "tables" / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            assert len(list(csv.DictReader(file))) == len(getattr(rated, name))
    (target / "notes.txt").write_text("mine")
    fewer = write_chart(tiny, target)
    assert set(files) - set(fewer) == {
        "figures/rated_realism_as_is_7.svg",
        "figures/rated_realism_as_is_7.png",
    }
    assert {path.name for path in (target / "figures").iterdir()}.isdisjoint(
        set(files) - set(fewer)
    )
    assert (target / "notes.txt").read_text() == "mine"


def test_what_is_not_a_former_chart_is_not_replaced(tiny: Chart, tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(FileExistsError, match="exists and is not of a former report"):
        write_chart(tiny, tmp_path)
    assert (tmp_path / "index.html").read_text() == "mine"


def test_no_mean_hides_its_scenes(tiny: Chart) -> None:
    for axes, measure in zip(draw_cost(tiny).axes, MEASURES[:2], strict=True):
        dots = [line for line in axes.lines if line.get_marker() == "."]
        assert len(dots) == 2 * len(SHOWN)
        means = {
            row.mean
            for row in merge_equal(tiny).accuracies
            if row.sweep == "reducer" and row.measure == measure
        }
        shown = {float(dot.get_ydata()[0]) for dot in dots}
        assert shown == {max(mean, -1.0) for mean in means}


def test_every_window_stands_in_the_figure_of_latency(tiny: Chart) -> None:
    (above, _) = draw_latency(tiny).axes
    assert [len(line.get_xdata()) for line in above.lines if len(line.get_xdata()) == 6]


def test_no_name_can_end_the_pages_data(tiny: Chart) -> None:
    evil = replace(tiny, scenes=(replace(tiny.scenes[0], name="</script><b>"),))
    text = dump_data(evil, list_choices(evil))
    assert "<" not in text
    assert json.loads(text)["scenes"] == ["</script><b>"]


def test_the_page_holds_every_method_and_spans_that_rise(rated: Chart) -> None:
    data = json.loads(dump_data(rated, list_choices(rated)))
    merged = merge_equal(rated)
    measured = {
        (row.sweep, row.method, row.rate_hz if row.sweep == "rate" else 0)
        for row in merged.accuracies
    }
    streams = [cost for cost in merged.costs if cost.sweep == "block"]
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
    rated: Chart, tmp_path: Path
) -> None:
    write_chart(rated, tmp_path / "chart")
    page = tmp_path / "chart" / "index.html"
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
      document.querySelector('button[data-of="scene"]').click();
    </script></body>"""
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", steps), encoding="utf-8")
    document, console = open_page(page, tmp_path)
    assert console == ""
    points = len(json.loads(dump_data(rated, list_choices(rated)))["methods"])
    assert f'data-points="{points}"' in document
    assert re.search(
        r'data-tip="sax/say/saz321[^"]*Cost of one sample \(ns\): [\d.]+ \[[\d.]+ to', document
    )
    assert "Nothing to show: choose at least one reducer and one scene." in document
