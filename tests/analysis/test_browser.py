"""The page of a stimulus set: its numbers, flags, pictures and sounds, and what its script does."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis import browser
from feel321.analysis.browser import write_stimulus_page
from feel321.stimuli import acceleration_threshold, build_stimuli, make_scene

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.stimuli.sets.manifest import StimulusSet

RATE = 48_000
CHROMIUM = shutil.which("chromium")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> StimulusSet:
    """Two recordings of two reducers in two level arms, each with reference and anchors, and their page."""
    scenes = [make_scene(name, duration_s=0.5) for name in ("bumps", "hard_taps")]
    levels = ["as_is", "equal_intensity"]
    folder = tmp_path_factory.mktemp("set") / "stimuli"
    made = build_stimuli(scenes, folder, reducers=["sax321", "dft321"], levels=levels)
    write_stimulus_page(folder)
    return made


def copy(built: StimulusSet, folder: Path) -> Path:
    return shutil.copytree(built.folder, folder / "copy")


def read_rows(page: Path) -> dict[str, str]:
    """The rows of the page's tables with pictures, by stimulus."""
    text = page.read_text(encoding="utf-8")
    return dict(re.findall(r'<tr id="([^"]*)"(.*?)</tr>', text, flags=re.DOTALL))


def test_numbers_are_those_of_the_manifest(built: StimulusSet) -> None:
    rows = read_rows(built.folder / "index.html")
    assert list(rows) == [row.stimulus_id for row in built]
    for stimulus in built:
        found = re.findall(r'<data value="([^"]*)">([^<]*)</data>', rows[stimulus.stimulus_id])
        exact = [getattr(stimulus, name) for name in browser.NUMBERS]
        assert [float(value) for value, _ in found] == exact
        shown = [float(value.replace("−", "-")) for _, value in found]
        assert shown == pytest.approx(exact, abs=0.051)


@pytest.mark.parametrize(
    ("changes", "flags"),
    [
        ({}, []),
        ({"spectral_match": -0.99}, []),
        ({"spectral_match": -1.01}, ["match"]),
        ({"spectral_match": -1.01, "role": "anchor"}, []),
        ({"spectral_match": np.nan}, ["undefined"]),
        ({"sensation_level_db": 0.1}, []),
        ({"sensation_level_db": -0.1}, ["threshold"]),
        ({"sensation_level_db": np.nan, "rms_m_s2": 0.0}, ["threshold"]),
        (
            {"sensation_level_db": np.nan},
            [],
        ),  # a set of an earlier version, which had no such column
        ({"clipped": 1, "spectral_match": -3.0}, ["match", "clipped"]),
    ],
)
def test_planted_flags_are_found(
    built: StimulusSet, changes: dict[str, object], flags: list[str]
) -> None:
    assert browser.find_flags(replace(built[0], **changes)) == flags


def test_another_page_and_a_damaged_set_are_refused(built: StimulusSet, tmp_path: Path) -> None:
    folder = copy(built, tmp_path)
    (folder / "index.html").write_text("<p>mine</p>", encoding="utf-8")
    with pytest.raises(ValueError, match=r"not written by feel321 .* --no-page"):
        write_stimulus_page(folder)
    browser.remove_stimulus_page(folder)
    assert (folder / "index.html").read_text(encoding="utf-8") == "<p>mine</p>"
    (folder / "index.html").unlink()
    (folder / "manifest.json").write_text("{", encoding="utf-8")
    with pytest.raises(ValueError, match=r"manifest.json: is missing or damaged"):
        write_stimulus_page(folder)


@pytest.mark.parametrize("threshold", ["contactor", "grasped_stylus"])
@pytest.mark.parametrize("hz", [50.0, 160.0, 300.0])
def test_a_tone_stands_over_the_threshold_by_its_sensation_level(hz: float, threshold: str) -> None:
    time_s = np.arange(RATE) / RATE
    limit = acceleration_threshold(hz, threshold=threshold)
    tone = 10 * limit * np.sin(2 * np.pi * hz * time_s)
    found = browser.sketch(tone, RATE, threshold=threshold)
    # The band is 22 % wide, and the threshold is that of its centre, which may lie half a band away.
    assert found.over_db == pytest.approx(20, abs=1.5)
    assert found.strongest_hz == pytest.approx(hz, rel=0.12)
    assert found.highest_db == pytest.approx(20 * np.log10(10 * limit / np.sqrt(2)), abs=0.2)


def test_silence_and_three_axes_are_drawn() -> None:
    silent = browser.sketch(np.zeros(100), RATE, threshold="contactor")
    assert silent.over_db < -100
    tone = np.sin(2 * np.pi * 200 * np.arange(RATE) / RATE)
    one, three = (
        browser.sketch(samples, RATE, threshold="contactor")
        for samples in (tone, np.vstack([tone, tone, tone]))
    )
    assert three.highest_db - one.highest_db == pytest.approx(10 * np.log10(3), abs=1e-6)
    assert three.waveform == one.waveform


def open_page(page: Path, profile: Path) -> tuple[str, str]:
    """The document after its scripts ran, and what the browser's console said."""
    command = [
        CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0",
        "--autoplay-policy=no-user-gesture-required", f"--user-data-dir={profile}", "--virtual-time-budget=3000",
        "--window-size=420,900", "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return done.stdout, "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)


BEFORE = """<script>
  window.made = []; const Real = window.Audio;
  window.Audio = function () { const audio = new Real(); window.made.push(audio); return audio; };
</script>"""
AFTER = """<script>
  const say = (name, value) => document.body.setAttribute(`data-${name}`, JSON.stringify(value));
  const rows = ".recording:not([hidden]) .stimuli tbody tr:not([hidden])";
  const shown = () => [...document.querySelectorAll(rows)].map((row) => row.id);
  const form = document.getElementById("filter");
  const choose = (name, value) => { form.elements[name].value = value; form.dispatchEvent(new Event("change")); };
  const press = (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
  say("all", shown());
  choose("reducer", "dft321"); choose("level", "as_is"); say("reducer", shown());
  choose("recording", "bumps"); say("recording", shown());
  choose("recording", ""); choose("reducer", ""); choose("level", ""); choose("flag", "any"); say("flagged", shown());
  choose("flag", ""); choose("sort", "0"); say("sorted", shown());
  choose("sort", ""); say("again", shown());
  const row = document.getElementById("hard_taps__dft321__as_is");
  row.querySelector('button[data-action="a"]').click();
  row.nextElementSibling.querySelector('button[data-action="b"]').click();
  say("sources", made.map((audio) => audio.src.split("/").pop()));
  const muted = () => made.map((audio) => audio.muted);
  say("first", muted());
  made[0].addEventListener("canplay", () => {
    made[0].currentTime = 0.25;
    press("x"); say("second", muted()); say("position", made.map((audio) => audio.currentTime));
    document.getElementById("keys").click(); press("x"); say("deaf", muted());
    document.getElementById("keys").click();
    const play = row.querySelector('button[data-action="play"]');
    const space = (button) => {
      const event = new KeyboardEvent("keydown", { key: " ", bubbles: true, cancelable: true });
      return [button.dispatchEvent(event), made[0].paused];
    };
    play.click();
    say("space", [space(play), space(play), space(row.nextElementSibling.querySelector("button"))]);
    document.querySelector('#bumps__dft321__as_is button[data-action="a"]').click();
    say("cleared", [document.getElementById("pick-b").textContent.trim(), made[1].getAttribute("src")]);
    say("wide", [document.documentElement.scrollWidth, innerWidth]);
  }, { once: true });
</script>"""


@pytest.mark.skipif(not CHROMIUM, reason="PAGE NOT OPENED: chromium is not installed")
def test_a_browser_filters_sorts_and_switches(built: StimulusSet, tmp_path: Path) -> None:
    folder = copy(built, tmp_path)
    text = (folder / "index.html").read_text(encoding="utf-8")
    text = text.replace("<body>", f"<body>{BEFORE}").replace("</body>", f"{AFTER}</body>")
    (folder / "index.html").write_text(text, encoding="utf-8")
    document, console = open_page(folder / "index.html", tmp_path / "profile")
    assert console == ""
    body = re.search(r"<body([^>]*)>", document)[1]
    said = {
        name: json.loads(html.unescape(value))
        for name, value in re.findall(r'data-([a-z]+)="([^"]*)"', body)
    }
    order = [row.stimulus_id for row in built]
    assert said["all"] == said["again"] == order
    assert said["reducer"] == ["bumps__dft321__as_is", "hard_taps__dft321__as_is"]
    assert said["recording"] == ["bumps__dft321__as_is"]
    assert said["flagged"] == [row.stimulus_id for row in built if browser.find_flags(row)]
    matches = {row.stimulus_id: row.spectral_match for row in built}
    worst = min(matches, key=matches.__getitem__)
    assert said["sorted"][0] == worst  # recordings follow their own lowest
    first = [name for name in said["sorted"] if name.startswith(worst.split("__")[0])]
    assert first == sorted(first, key=matches.__getitem__) == said["sorted"][: len(first)]
    row = order.index("hard_taps__dft321__as_is")
    assert said["sources"] == [f"{order[row]}.wav", f"{order[row + 1]}.wav"]
    assert (said["first"], said["second"], said["deaf"]) == (
        [False, True],
        [True, False],
        [True, False],
    )
    assert said["position"] == [0.25, 0.25]
    assert said["space"] == [[False, True], [False, False], [True, False]]  # pauses, plays, presses
    assert said["cleared"] == ["B", None]
    assert said["wide"][0] <= said["wide"][1]
