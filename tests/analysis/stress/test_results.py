from __future__ import annotations

import html
import itertools
import json
import math
import pickle
import re
import shutil
import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.tradeoff.face import stress
from feel321.analysis.tradeoff.stress.battery import BATTERY, take_excerpt
from feel321.analysis.tradeoff.stress.diagnosis import find_reason
from feel321.analysis.tradeoff.stress.heatmap import (
    SEVERITY,
    build_map,
    count_failed_scenes,
    describe_finding,
    draw_stress,
    find_undefined,
    format_value,
)
from feel321.analysis.tradeoff.stress.measures import MEASURES
from feel321.analysis.tradeoff.stress.page import build_page, name_anchor
from feel321.analysis.tradeoff.stress.run import stress_reducers
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS

if TYPE_CHECKING:
    from pathlib import Path


def read_page(folder: Path) -> str:
    return (folder / "index.html").read_text(encoding="utf-8")


def test_every_figure_is_there(result: Any) -> None:
    assert len(result.cells) == len(BATTERY) * len(REDUCERS) * len(MEASURES)
    assert len(result.gains) == 2 * len(REDUCERS)
    assert [row.recording for row in result.metrics] == [*BATTERY, "drag", "half"]
    undefined = {
        cell.recording
        for cell in result.cells
        if cell.measure == "fault" and cell.grade != "undefined"
    }
    assert undefined == {name for name, scene in BATTERY.items() if scene.fault}


def test_the_recording_that_comes_near_is_named(result: Any) -> None:
    near = build_page(result)["near"]
    assert any("half (Energy of undetermined phase" in line for line in near["anti_phase"])
    assert any(
        line.split("%")[1].startswith(" of the energy sits where the phase")
        for line in result.warnings["half"]
    )
    assert "drag" not in result.warnings
    assert near["circular"] == []


def test_silence_and_what_conditioning_hides_are_noted(result: Any) -> None:
    assert "nothing: silent, left out." in result.notes
    assert any(
        note.startswith("half: only the conditioned signal was available") for note in result.notes
    )


def test_the_answer_names_what_fails(result: Any) -> None:
    text = " ".join(result.answers)
    gains = [cell for cell in result.cells if cell.measure == "gain"]
    worst = max(gains, key=lambda cell: cell.value)
    title = BATTERY[worst.recording].title
    assert f"amplified most by {worst.reducer}, 1414 times on the scene “{title}”" in text
    steady = text.split("in no scene 10 times or more by ")[1].split(" (median")[0]
    for name in ("mag321", "dft321_principal", "pca321_matched_windowed"):
        highest = max(cell.value for cell in gains if cell.reducer == name)
        assert f"{name} ({highest:.1f})" in steady
    assert not re.search(r"\b(dft321|soc321|pca321|sax321) \(", steady)
    assert "changes the output by less than 22 % in every scene for mag321" in text
    assert len(result.answers) <= 6


def test_the_finding_names_who_fails_least_and_most(result: Any, small: Any, folder: Path) -> None:
    failed = {(cell.reducer, cell.recording) for cell in result.failures}
    counts = {name: sum(one == name for one, _ in failed) for name in REDUCERS}
    assert count_failed_scenes(result.cells, result.reducers) == counts
    assert [*count_failed_scenes(result.cells, result.reducers).values()] == sorted(counts.values())
    content = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert (
        content["headline"]
        == result.answers[0]
        == describe_finding(count_failed_scenes(result.cells, result.reducers))
    )
    best = min(counts, key=counts.get)
    assert content["headline"].startswith(f"{best} fails on {counts[best]} of the 18 stress scenes")
    assert content["failed_scenes"] == counts
    assert content["headline"] in html.unescape(read_page(folder))
    own = count_failed_scenes(small.cells, small.reducers)["mag321"]
    assert small.answers[0] == f"mag321 fails on {own} of the 18 stress scenes."
    many = dict.fromkeys("abcd", 18)
    assert describe_finding(many) == "4 reducers fail on all of the 18 stress scenes."
    assert describe_finding({"my321": 0, **many}) == (
        "my321 fails on none of the 18 stress scenes, the fewest; 4 reducers fail on all."
    )


def test_what_is_not_defined_is_neither_good_nor_counted(small: Any, tmp_path: Path) -> None:
    def lack(cell: Any) -> Any:
        return replace(cell, reducer="own", value=math.nan, worst=math.nan, p90=math.nan)

    both = replace(small, reducers=("own", "mag321"), cells=(*map(lack, small.cells), *small.cells))
    found = build_map(both.cells, both.reducers)
    assert [*found["anti_phase"]] == ["mag321", "own"]
    assert {(row["own"].grade, row["own"].shown) for row in found.values()} == {("undefined", "–")}
    assert both.answers[0] == f"{small.answers[0][:-1]}; own is not defined on all of them."
    assert all("own" not in line for line in both.answers[1:])
    page = read_page(both.write(tmp_path / "both").parent)
    assert page.count('<span class="quiet">not defined') == len(BATTERY)
    alone = replace(small, reducers=("own",), cells=tuple(map(lack, small.cells)))
    assert alone.answers[0].startswith("No reducer can be judged on the 18 stress scenes: own ")
    assert not re.search(r"nan|amplified most|every scene for own", " ".join(alone.answers))
    partly = tuple(map(lack, small.cells[: len(MEASURES)])) + tuple(
        replace(cell, reducer="own") for cell in small.cells[len(MEASURES) :]
    )
    assert find_undefined(partly) == {"own": 1}
    loud = tuple(replace(cell, value=20.0) for cell in small.cells)
    said = replace(small, cells=loud).answers[1]
    assert said.endswith(
        "; every reducer amplifies it 10 times or more in some scene (median takes)."
    )
    weak = tuple(replace(cell, value=min(cell.value, 0.5)) for cell in small.cells)
    said = replace(small, cells=weak).answers[1]
    assert said == "Sensor noise is amplified by no reducer in any scene (median takes)."


def test_a_cell_has_the_grade_of_its_worst_measure_and_names_it(result: Any) -> None:
    found = build_map(result.cells, result.reducers)
    for scene, name in itertools.product(BATTERY, REDUCERS):
        own = [cell for cell in result.cells if (cell.recording, cell.reducer) == (scene, name)]
        worst = max(SEVERITY[cell.grade] for cell in own)
        cell = found[scene][name]
        assert SEVERITY[cell.grade] == worst
        letters = {MEASURES[one.measure].letter for one in own if SEVERITY[one.grade] == worst > 0}
        assert set(cell.letters) == letters
        assert len(cell.letters) == len(letters)
    assert re.fullmatch(
        r"mag321 on anti-phase axes: fails, energy error −\d\.\d dB.*",
        found["anti_phase"]["mag321"].label,
    )
    assert found["anti_phase"]["dft321"].letters[0] == MEASURES["gain"].letter


def test_the_figure_has_the_maps_colours_and_letters(result: Any) -> None:
    (axes,) = draw_stress(result.cells, result.reducers).axes
    cells = [
        cell for row in build_map(result.cells, result.reducers).values() for cell in row.values()
    ]
    drawn = [text.get_text() for text in axes.texts]
    assert drawn == [cell.shown for cell in cells]
    assert all(set(cell.shown) - {"+"} <= set(cell.letters) for cell in cells)
    fills = {cell.grade: box.get_facecolor() for cell, box in zip(cells, axes.patches, strict=True)}
    assert len({*map(tuple, fills.values())}) == len(fills) == 3


def test_json_holds_what_was_measured_and_no_nan(result: Any, folder: Path) -> None:
    content = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert len(content["cells"]) == len(result.cells)
    assert content["answers"] == list(result.answers)
    assert {cell["value"] for cell in content["cells"] if cell["grade"] == "undefined"} == {None}
    assert all((folder / name).is_file() for name in content["files"])


def test_tables_hold_the_cells(result: Any, folder: Path) -> None:
    table = pd.read_csv(folder / "tables" / "cells.csv")
    assert table["grade"].tolist() == [cell.grade for cell in result.cells]
    assert np.allclose(table["value"], [cell.value for cell in result.cells], equal_nan=True)
    assert pd.read_csv(folder / "tables" / "recordings.csv")["recording"].tolist() == [
        "drag",
        "half",
    ]


def test_every_link_leads_somewhere_and_every_failure_is_linked_and_explained(
    result: Any, folder: Path
) -> None:
    page = read_page(folder)
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(set(ids)) == len(ids)
    links = re.findall(r'href="#([^"]+)"', page)
    assert "_blank" not in page
    assert set(links) <= set(ids)
    body = page.split("</style>", 1)[1]
    for cell in result.failures:
        anchor = name_anchor(cell.recording, cell.reducer)
        entry = body.split(f'<h4 id="{anchor}">', 1)[1].split("</ul>", 1)[0]
        assert MEASURES[cell.measure].title in entry
        assert (
            html.escape(find_reason(cell.measure, cell.reducer), quote=False).split("'")[0] in entry
        )
    table = re.findall(r'<td class="fails"><a href="#(stress-[^"]+)">', page)
    assert len(table) == len(result.failures)
    named = dict(re.findall(r'<a href="#(stress-[^"]+)"><span class="quiet">([^<]+)', page))
    shown = {name_anchor(cell.recording, cell.reducer): cell for cell in result.failures}
    assert set(named) == set(shown)
    for anchor, cell in shown.items():
        title = BATTERY[cell.recording].title.casefold()
        label = named[anchor].casefold()
        assert label.startswith(f"{cell.reducer} on {title}: fails, ")
        assert MEASURES[cell.measure].title.casefold() in label


@pytest.mark.skipif(
    not shutil.which("chromium"), reason="PAGE NOT RENDERED: chromium is not installed"
)
@pytest.mark.parametrize("width", [500, 1400])
def test_a_browser_shows_it_without_overflow_and_follows_a_cell(
    folder: Path, tmp_path: Path, width: int
) -> None:
    """The browser clicks the cell of dft321 on anti-phase axes, and finds its explanation."""
    probe = (
        "document.querySelector('.map a[href=\"#stress-anti_phase-dft321\"]')"
        ".dispatchEvent(new MouseEvent('click', {bubbles: true, cancelable: true}));"
        "setTimeout(() => {const t = document.querySelector(':target');"
        "document.title = document.documentElement.scrollWidth + ' of ' + innerWidth + ' at ' + t?.textContent}, 50)"
    )
    text = read_page(folder).replace("</body>", f"<script>{probe}</script></body>")
    (tmp_path / "probe.html").write_text(text, encoding="utf-8")
    quiet = [
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync",
        "--disable-component-update", "--no-first-run", f"--user-data-dir={tmp_path / 'profile'}",
        "--virtual-time-budget=2000",
    ]  # fmt: skip
    command = [
        "chromium",
        *quiet,
        f"--window-size={width},900",
        "--dump-dom",
        (tmp_path / "probe.html").as_uri(),
    ]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    wide, window, target = re.search(r"<title>(\d+) of (\d+) at (.*?)</title>", shown).groups()
    assert target == "dft321"
    assert int(wide) <= int(window)


def test_the_same_seed_writes_the_same_bytes(result: Any, folder: Path, tmp_path: Path) -> None:
    again = result.write(tmp_path / "again").parent
    for name in json.loads((folder / "results.json").read_text(encoding="utf-8"))["files"]:
        assert (again / name).read_bytes() == (folder / name).read_bytes()


def test_a_former_test_is_replaced_and_foreign_files_stay(small: Any, tmp_path: Path) -> None:
    target = tmp_path / "stress"
    small.write(target)
    (target / "notes.txt").write_text("mine", encoding="utf-8")
    small.write(target)
    assert (target / "notes.txt").read_text(encoding="utf-8") == "mine"
    other = tmp_path / "other"
    other.mkdir()
    (other / "index.html").write_text("mine", encoding="utf-8")
    with pytest.raises(FileExistsError, match="exists and is not of a former report"):
        small.write(other)


def test_progress_reaches_the_end(drag: Any) -> None:
    told: list[tuple[int, int]] = []
    few = ["sax321", "mag321"]
    done = stress([drag], reducers=few, takes=2, draws=2, progress=lambda *step: told.append(step))
    assert told[-1] == (38, 38)
    assert [step for step, _ in told] == list(range(1, 39))
    assert set(done.reducers) == set(few)


def test_without_recordings_the_page_is_about_the_battery(tmp_path: Path) -> None:
    alone = stress(reducers=["mag321"], takes=2)
    page = alone.write(tmp_path / "out").read_text(encoding="utf-8")
    assert "Recordings that come near" not in page
    assert "No reducer fails here." in page
    assert "Map of failures" in page


def test_a_harmless_recording_comes_near_nothing(small: Any, tmp_path: Path) -> None:
    page = small.write(tmp_path / "out").read_text(encoding="utf-8")
    assert "<p>None does.</p>" in page
    assert "No recording comes near." in page


def test_the_strongest_part_is_taken(made: Any) -> None:
    loud = np.zeros((3, 5000))
    loud[:, 3000:3200] = 1
    part = take_excerpt(made(loud), duration_s=0.5)
    assert part.n_samples == 500
    assert part.acceleration[0].sum() == 200
    short = made(loud[:, :10])
    assert take_excerpt(short, duration_s=0.5) is short


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"recordings": 2}, "recordings must have different names, got 'drag' twice"),
        ({"reducers": []}, "reducers must be one or more, got none"),
        ({"reducers": "dft321"}, "reducers must be a list of names, got the text 'dft321'"),
        ({"reducers": ["dft320"]}, "dft320"),
        ({"draws": 1}, "draws must be a whole number of 2 or more, got 1"),
        ({"takes": 1}, "takes must be a whole number of 2 or more, got 1"),
        ({"rng": -1}, "rng must be a whole number from 0"),
    ],
)
def test_doors(drag: Any, options: dict[str, Any], message: str) -> None:
    recordings = [drag] * options.pop("recordings", 1)
    with pytest.raises((ValueError, TypeError), match=message):
        stress(recordings, **options)


def test_the_function_of_the_verb_does_the_same(small: Any, drag: Any) -> None:
    few = {"mag321": REDUCERS["mag321"]}
    assert stress_reducers([drag], few, seeds=2, draws=2, seed=0) == small


def test_a_result_is_small_to_look_at_and_goes_through_pickle(small: Any) -> None:
    assert pickle.loads(pickle.dumps(small)) == small  # noqa: S301 - our own bytes
    assert len(repr(small)) <= 200
    assert small.summary().splitlines() == list(small.answers)
    assert list(small.to_frames()) == ["cells", "metrics", "recordings", "gains"]


def test_warnings_of_the_reader_are_passed_on(drag: Any) -> None:
    warned = Recording(drag.acceleration, drag.rate_hz, "warned", warnings=("x is saturated",))
    assert "warned: x is saturated" in stress([warned], reducers=["mag321"], takes=2, draws=2).notes


def test_figures_in_words() -> None:
    assert [format_value(value) for value in (float("nan"), 2e7, -735.0)] == [
        "–",
        "2.00e+07",
        "−735",
    ]
    assert find_reason("gain", "my321") == "the output depends on something that noise determines."
