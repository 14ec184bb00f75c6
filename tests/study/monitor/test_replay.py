from __future__ import annotations

import base64
import io
import json
import re
import wave
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.files import hold_lock
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.monitor.media import SOUND_HZ, SoundBank
from feel321.study.monitor.replay import OWN_PAGE, REHEARSAL, Film, play_in_window, read_film
from feel321.study.screen.input import InputEvent
from feel321.study.session.events import TrialRated
from feel321.study.session.journal import read_journal
from feel321.study.session.ports import Scaled, Tone

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from feel321.study.screen.drawing import Item


@pytest.fixture(scope="module")
def film(made: Path) -> Film:
    return read_film(StudyFolder(made), "sim001")


def list_files(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(path): (path.stat().st_mtime_ns, path.stat().st_size) for path in folder.rglob("*")}


def read_reel(page: str) -> dict[str, Any]:
    found = re.search(r'id="reel">(.*?)</script>', page, re.DOTALL)
    assert found
    assert "<" not in found[1]
    return dict(json.loads(found[1]))


def test_the_page_has_every_screen_answer_and_sound(made: Path, film: Film, tmp_path: Path) -> None:
    before, out = list_files(made), tmp_path / "p.html"
    assert main(["replay", str(made), "--participant", "sim001", "--out", str(out)]) == 0
    listed = list_files(made)
    assert str(out) in (made / "outputs.jsonl").read_text()  # where a withdrawal looks for copies
    assert {path: listed[path] for path in before} == before
    page = out.read_text(encoding="utf-8")
    assert re.findall(r"""(?:src|href)=["'](?!data:|#)""", page) == []
    reel = read_reel(page)
    assert [shot[0] for shot in reel["shots"]] == [round(shot.at_s, 3) for shot in film.shots]
    assert reel["length"] >= film.records.find_elapsed()
    heard = [round(shot.at_s, 3) for shot in film.shots if shot.heard]
    assert [play[0] for play in reel["plays"]] == heard
    assert max(play[2] for play in reel["plays"]) == 1
    rated = list(film.records.find(TrialRated))
    cells = re.findall(r'<td class="text">[^<]*: ([\d.]+)</td><td>([\d.]+)</td>', page)
    assert cells == [
        (f"{next(iter(one.values.values())):g}", f"{one.response_time_s:.1f}") for one in rated
    ]
    names = {row.stimulus_id for row in read_stimuli(film.study.stimuli).stimuli}
    assert not any(name in page for name in names)


def test_a_rehearsal_says_so_on_each_screen_and_writes_nothing(made: Path, tmp_path: Path) -> None:
    before, out = list_files(made), tmp_path / "r.html"
    arguments = ["rehearse", str(made), "--trials", "1", "--out", str(out)]
    assert main(arguments) == 0
    assert list_files(made) == before
    page = out.read_text(encoding="utf-8")
    reel = read_reel(page)
    texts = [shot[2].split("; ") for shot in reel["shots"]]
    assert len(texts) > 20
    assert all(REHEARSAL in words for words in texts)
    starts = [at_s for at_s, title in reel["marks"] if title in {"Your consent", "Welcome"}]
    assert starts[1] - starts[0] >= 5  # long enough to be read
    titles = [title for _, title in reel["marks"]]
    assert sum(title.startswith("Realism, trial") for title in titles) == 1
    # Without a script each screen is there too.
    assert page.count('<li><figure><svg class="screen"') == len(titles)
    assert main(arguments) == 0
    assert out.read_text(encoding="utf-8") == page


def test_sounds_keep_their_strength_to_one_another(film: Film) -> None:
    bank = SoundBank(film.study.stimuli, film.settings.rig.full_scale_m_s2)
    stimuli = read_stimuli(film.study.stimuli).stimuli
    single = next(row for row in stimuli if row.role == "test")
    key, peak = bank.add(single)
    assert peak == pytest.approx(single.peak, rel=0.05)
    assert bank.add(Scaled(single, -20.0)) == (key, pytest.approx(peak / 10))
    assert bank.add(Tone(160.0, 0.5, None)) is None
    tone, strong = bank.add(Tone(160.0, 0.5, 0.0))
    assert strong == pytest.approx(np.sqrt(2) / film.settings.rig.full_scale_m_s2, rel=0.01)
    with wave.open(io.BytesIO(base64.b64decode(bank.sounds[tone]))) as file:
        assert (file.getframerate(), file.getnframes()) == (SOUND_HZ, SOUND_HZ // 2)
        samples = np.frombuffer(file.readframes(SOUND_HZ), dtype="<i2")
    crossings = np.count_nonzero(np.diff(np.signbit(samples)))
    assert crossings == pytest.approx(160, abs=2)  # two per period, for half a second
    assert bank.add(replace(single, stimulus_id="gone", file="gone.wav")) is None


@dataclass
class FilmedWindow:
    """A window of which each frame takes as long as it is told to; at some frames something is done."""

    acts: dict[int, InputEvent] = field(default_factory=dict)
    frame_s: float = 1 / 60
    size: tuple[int, int] = (1280, 800)
    frames: int = 0
    seen: list[tuple[float, Sequence[Item]]] = field(default_factory=list)

    def clock(self) -> float:
        return self.frames * self.frame_s

    def show(self, items: Sequence[Item]) -> list[InputEvent]:
        if not self.seen or self.seen[-1][1] != items:
            self.seen.append((self.clock(), items))
        self.frames += 1
        return [self.acts[self.frames]] if self.frames in self.acts else []


@pytest.mark.parametrize("speed", [1.0, 8.0])
def test_the_window_shows_each_screen_at_its_time(film: Film, speed: float) -> None:
    window = FilmedWindow(frame_s=1 / 60 / speed)
    assert play_in_window(film, window, clock=window.clock, speed=speed)
    expected = [(shot.at_s / speed, film.compose(shot, window.size).items) for shot in film.shots]
    seen = iter(expected)
    late = [
        next(at_s for at_s, sheet in seen if sheet == items) - time_s
        for time_s, items in window.seen
    ]
    assert max(map(abs, late)) <= 2 * window.frame_s
    assert window.clock() == pytest.approx(film.length_s / speed, abs=2 * window.frame_s)


def test_keys_pause_and_turn_the_pages(film: Film) -> None:
    press = lambda key: InputEvent("press", 0.0, key)  # noqa: E731 - as short as it is
    window = FilmedWindow({
        1: press("space"),
        2: press("right"),
        3: press("right"),
        600: press("escape"),
    })
    assert not play_in_window(film, window, clock=window.clock, speed=1.0)
    third = sorted({shot.at_s for shot in film.shots})[2]
    stands = next(shot for shot in reversed(film.shots) if shot.at_s == third)
    assert window.seen[-1][1] == film.compose(stands, window.size).items
    assert window.frames == 600


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--participant", "p99"], "no session of p99; there is sim001, sim002"),
        (["--participant", "sim001", "--session", "4"], "--session must be one of 1, got 4"),
        (["--participant", "../sessions/sim001"], "must be letters, digits, - and _, got '../"),
    ],
)
def test_what_is_not_there_is_refused(
    made: Path, arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(made), *arguments, "--out", "never.html"]) == 1
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("verb", [["replay", "--participant", "sim001"], ["rehearse"]])
def test_no_file_but_such_a_page_is_written_over(
    copied: StudyFolder, verb: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before, page = list_files(copied.path), copied.path / "page.html"
    inside = [copied.path / name / "x.html" for name in ("stimuli", "sessions", "rehearsals/p01")]
    for place in (copied.settings, copied.ratings, *inside):
        assert main([verb[0], str(copied.path), *verb[1:], "--out", str(place)]) == 1
        assert "not overwritten" in (told := capsys.readouterr().err) or "must not lie in" in told
    assert list_files(copied.path) == before
    page.write_text(f"<!DOCTYPE html>{OWN_PAGE}", encoding="utf-8")
    assert main([verb[0], str(copied.path), *verb[1:], "--out", str(page)]) == 0
    assert OWN_PAGE in page.read_text(encoding="utf-8")[:4096]


def test_what_changed_since_the_session_is_told(
    copied: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, verb = tmp_path / "p.html", ["replay", str(copied.path), "--participant", "sim001"]
    assert read_film(copied, "sim001").changes == []
    settings = copied.settings.read_text(encoding="utf-8")
    copied.settings.write_text(f'{settings}\n[session]\nlanguage = "de"\n', encoding="utf-8")
    assert main([*verb, "--out", str(out)]) == 0
    told, page = capsys.readouterr().err, out.read_text(encoding="utf-8")
    assert told.count("\n") == 3
    assert "locale 'en' -> 'de'" in told
    for line in ("other texts for participants", "another text of consent"):
        assert line in told
        assert f"<li>{line}</li>" in page


def test_a_running_session_is_not_replayed_unless_asked(made: Path) -> None:
    folder = made / "sessions" / "sim002"
    with hold_lock(folder / ".lock", busy=""):
        with pytest.raises(BlockingIOError, match="--while-running"):
            read_film(StudyFolder(made), "sim002")
        film = read_film(StudyFolder(made), "sim002", while_running=True)
    assert film.records == read_journal(folder / "session-01.jsonl").records
