from __future__ import annotations

import csv
import json
import pickle
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.tradeoff.advise.page import (
    MARKS,
    advise_recordings,
    build_content,
    draw_advice,
    find_state,
)
from feel321.analysis.tradeoff.advise.scene import Context, Rated
from feel321.analysis.tradeoff.face import advise
from feel321.analysis.words import keep_together
from feel321.stimuli.recording import Recording
from feel321.stimuli.synthesis import make_scene

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.analysis.tradeoff.advise.page import Advice

ONLINE = Context(online=True, latency_ms=5, block_ms=0, device_ms=0)


def scenes() -> list[Recording]:
    drag, circle = (
        make_scene(name, duration_s=1.0) for name in ("constrained_drag", "circular_motion")
    )
    return [drag, circle, Recording(np.zeros((3, 4000)), 4000.0, "calm <b>")]


@pytest.fixture(scope="module")
def study() -> Advice:
    return advise_recordings(scenes(), Context())


@pytest.fixture(scope="module")
def late() -> Advice:
    """The same two scenes with a budget in which nothing suffices for one of them."""
    return advise_recordings(scenes()[:2], ONLINE)


@pytest.fixture(scope="module")
def written(study: Advice, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study.write(tmp_path_factory.mktemp("written") / "advice").parent


def test_the_order_of_recordings_does_not_matter(study: Advice) -> None:
    turned = advise_recordings(scenes()[::-1], Context())
    assert sorted(advice.line for advice in turned.advices) == sorted(
        advice.line for advice in study.advices
    )
    assert turned.common == study.common


def test_one_reducer_for_all_scenes_is_named(study: Advice, late: Advice) -> None:
    assert study.common[0] == "pca321_matched"
    assert study.headline == (
        "pca321_matched suffices for both scenes with vibration; "
        "for 1 of them a simpler one is enough; 1 of 3 is silent."
    )
    assert late.headline == (
        "No one reducer suffices for both scenes; nothing suffices for 1 of them."
    )
    moving = study.advices[:2]
    eager = tuple(replace(one, answer="sax321") for one in moving)
    assert replace(study, advices=eager).headline == (
        "pca321_matched suffices for both scenes; for each of them a simpler one is enough."
    )
    brief = replace(study.advices[2], reason="it lasts 0.010 s and 20 Hz need 0.05 s")
    assert replace(study, advices=(moving[0], brief)).headline.endswith(
        " suffices for the one scene that can be judged; 1 of 2 is silent or too short."
    )
    assert replace(late, advices=late.advices[1:]).headline in {
        f"{(late.advices[1].answer)} suffices for the one scene.",
        "No reducer suffices for the one scene.",
    }
    answers = [advice.answer for advice in study.advices if advice.verdicts]
    assert answers.count(study.common[0]) == 1
    assert [advice.answer for advice in late.advices].count(None) == 1
    lines = [advice.line for advice in study.advices]
    assert study.summary().splitlines() == [*lines, study.headline]


def test_segments_of_one_recording_may_differ() -> None:
    rng = np.random.default_rng(1)
    line, noise = rng.standard_normal(4000), rng.standard_normal((3, 4000))
    both = np.concatenate([np.array([0 * line, line, 0 * line]) + 0.01 * noise, noise], axis=1)
    study = advise_recordings(
        [Recording(both, 4000.0, "oak")], Context(mounting="recorded"), segment_s=1.0
    )
    assert [advice.scene.name for advice in study.advices] == ["oak 0.00-1.00 s", "oak 1.00-2.00 s"]
    assert [advice.answer for advice in study.advices] == ["say321", "sax321_matched"]


def test_ratings_are_heard_for_whole_recordings_only() -> None:
    said = {"circular_motion": {"dft321": Rated(is_best=True, best="dft321", p=float("nan"))}}
    whole = advise_recordings(scenes()[:2], Context(), ratings=said)
    assert whole.rated == ("circular_motion",)
    assert [row["basis"] for row in build_content(whole)["scenes"]] == [
        "metrics",
        "metrics and ratings",
    ]
    assert whole.note.startswith("Not rated everywhere, and not advised where others were rated: s")
    assert "dft321," not in whole.note
    robots = {
        "circular_motion": {
            "dft321": Rated(is_best=True, best="dft321", p=float("nan"), simulated=True)
        }
    }
    content = build_content(advise_recordings(scenes()[1:2], Context(), ratings=robots))
    assert (content["simulated"], content["scenes"][0]["basis"]) == (
        True,
        "metrics and simulated ratings",
    )
    assert not build_content(whole)["simulated"]
    assert advise_recordings(scenes()[:1], Context()).note == ""


def test_ratings_that_are_not_heard_are_told_of(tmp_path: Path) -> None:
    said = {"constrained_drag": {"dft321": Rated(is_best=True, best="dft321", p=float("nan"))}}
    notes = {
        "whole recordings, not segments": advise_recordings(
            scenes()[:1], Context(), ratings=said, segment_s=0.5
        ),
        "the output of one axis of an actuator": advise_recordings(
            scenes()[:1], Context(axes=2), ratings=said
        ),
        "two rated reducers and a margin": advise_recordings(scenes()[:1], Context(), ratings={}),
    }
    for words, study in notes.items():
        assert study.rated == ()
        assert study.advices[0].answer == "pca321"
        assert study.note.startswith("Ratings were not used: ")
        assert words in study.note
        study.write(tmp_path / "advice")
        assert study.note in (tmp_path / "advice" / "index.html").read_text(
            encoding="utf-8"
        ).replace("&#39;", "'")


def test_progress_counts_scenes() -> None:
    steps: list[tuple[int, int]] = []
    advise_recordings(
        scenes()[:1],
        Context(),
        segment_s=0.5,
        progress=lambda done, total: steps.append((done, total)),
    )
    assert steps == [(1, 2), (2, 2)]


def test_nothing_to_advise_on_is_refused() -> None:
    with pytest.raises(ValueError, match="recordings must be one or more, got none"):
        advise([])
    with pytest.raises(
        ValueError, match=r"must have motion from 20 to 1000 Hz, got none that has .calm <b>: it is"
    ):
        advise(scenes()[2:])


def test_the_face_says_the_same(study: Advice) -> None:
    assert advise(scenes()) == study
    assert pickle.loads(pickle.dumps(study)) == study  # noqa: S301 - our own bytes
    assert len(repr(study)) <= 200
    assert list(study.to_frames()) == ["advice", "measures"]


def test_files_hold_the_same_as_the_json(study: Advice, written: Path) -> None:
    read = json.loads((written / "results.json").read_text(encoding="utf-8"))
    files, version = read.pop("files"), read.pop("schema_version")
    assert version == 1
    assert read == json.loads(json.dumps(build_content(study)))
    assert all((written / name).is_file() for name in files)
    with (written / "tables" / "advice.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["answer"] for row in rows] == ["pca321", "pca321_matched", ""]
    assert [row["line"] for row in rows] == [advice.line for advice in study.advices]
    with (written / "tables" / "measures.csv").open(encoding="utf-8", newline="") as file:
        measures = list(csv.DictReader(file))
    assert len(measures) == 2 * len(study.advices[0].verdicts)
    assert next(row for row in measures if row["reducer"] == "dft321")["latency_ms"] == ""


def test_the_page_shows_all_and_escapes_names(study: Advice, written: Path) -> None:
    page = (written / "index.html").read_text(encoding="utf-8")
    assert "calm &lt;b&gt;" in page
    assert "calm <b>" not in page
    for advice in study.advices[:2]:
        assert advice.answer is not None
        assert keep_together(advice.reason) in page
        first = page.split('<table class="first">')[1].split("</table>")[0]
        assert f"<b>{advice.answer.replace('_', '_<wbr>')}</b>" in first
        assert keep_together(advice.why) in first
    assert "whole recording" in page
    assert "<svg role=" in page


def test_the_page_shows_a_budget_and_what_is_closest(late: Advice, tmp_path: Path) -> None:
    page = late.write(tmp_path / "advice").read_text(encoding="utf-8")
    assert "at most 5 ms delay" in page
    assert "ranked by latency, then memory, operations" in page


def test_writing_twice_gives_the_same_bytes_and_spares_what_is_not_ours(
    study: Advice, tmp_path: Path
) -> None:
    folder = tmp_path / "advice"
    study.write(folder)
    first = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    (folder / "notes.txt").write_text("mine")
    study.write(folder)
    assert {path: path.read_bytes() for path in first} == first
    assert (folder / "notes.txt").read_text() == "mine"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "index.html").write_text("mine")
    with pytest.raises(FileExistsError, match="not of a former report"):
        study.write(tmp_path / "other")
    assert (tmp_path / "other" / "index.html").read_text() == "mine"


def test_the_figure_shows_every_state_once_per_scene(study: Advice, late: Advice) -> None:
    states = {
        find_state(advice, each)
        for each_study in (study, late)
        for advice in each_study.advices
        for each in advice.verdicts
    }
    assert states == set(MARKS)
    (axes,) = draw_advice(study.advices).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        advice.scene.name for advice in study.advices
    ]
    assert [label.get_text() for label in axes.get_xticklabels()] == [
        each.name for each in study.advices[0].verdicts
    ]
    assert len(axes.lines) == sum(len(advice.verdicts) for advice in study.advices)
