"""Motion sources, tracks on the disk, and explored playbacks through an output, a simulated study and the settings."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321.stimuli.sets.manifest import Stimulus
from feel321.stimuli.wav import read_wav
from feel321.study.actuator.output import FileOutput
from feel321.study.actuator.rig import ActuatorTable, LimitsTable, Rig
from feel321.study.auditing.study import audit_study
from feel321.study.exploration.explorer import make_explorer
from feel321.study.exploration.motion import STILL_S, Pointer, Strokes, check_track, open_tracker
from feel321.study.exploration.track import (
    HEAD,
    Exploration,
    describe_track,
    find_latencies,
    write_track,
)
from feel321.study.folder import StudyFolder, create_study
from feel321.study.session.events import PartPlayed
from feel321.study.session.journal import list_journals, read_journal
from feel321.study.session.ports import Playback
from feel321.study.settings.read import find_modes, read_settings
from feel321.study.simulation import simulate_study
from feel321.study.workflow import build_study

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.session.journal import Records

RATE = 8000


@dataclass
class Clock:
    """A clock that is set by hand."""

    now: float = 10.0

    def __call__(self) -> float:
        return self.now


def stroke(pointer: Pointer, clock: Clock, *, speed_m_s: float, n: int = 20) -> None:
    """Move to the right at a constant speed, reported 125 times per s; 1 pixel is 0.25 mm."""
    for number in range(n):
        clock.now += 0.008
        pointer.move(400 * 0.1 + number * speed_m_s * 0.008 / 0.25e-3, 40.0)


def test_a_pointer_has_place_and_speed_in_metres() -> None:
    clock = Clock()
    pointer = Pointer(clock, m_per_pixel=0.25e-3)
    assert pointer.read().speed_m_s == 0.0
    stroke(pointer, clock, speed_m_s=0.1)
    motion = pointer.read()
    assert motion.speed_m_s == pytest.approx(0.1, rel=1e-9)
    assert motion.x_m_s == pytest.approx(0.1, rel=1e-9)
    assert motion.x_m == pytest.approx(0.01 + 19 * 0.1 * 0.008)
    assert motion.y_m == pytest.approx(0.01)
    pointer.begin()
    stroke(pointer, clock, speed_m_s=-0.2)
    assert pointer.read().speed_m_s == pytest.approx(0.2)
    assert pointer.read().x_m_s == pytest.approx(-0.2)


def test_a_pointer_that_reports_nothing_is_at_rest() -> None:
    clock = Clock()
    pointer = Pointer(clock, m_per_pixel=0.25e-3)
    stroke(pointer, clock, speed_m_s=0.1)
    last_s = clock.now
    clock.now = last_s + 0.9 * STILL_S
    assert pointer.read().speed_m_s > 0
    clock.now = last_s + 1.1 * STILL_S
    assert (pointer.read().speed_m_s, pointer.read().x_m_s) == (0.0, 0.0)
    assert pointer.read().time_s == pytest.approx(last_s + STILL_S)
    clock.now += 5  # a first report after a rest has no speed yet
    pointer.move(90.0, 40.0)
    assert pointer.read().speed_m_s == 0.0


def test_a_track_is_kept_at_the_rate_of_its_source(tmp_path: Path) -> None:
    clock = Clock()
    pointer = Pointer(clock, m_per_pixel=0.25e-3)
    stroke(pointer, clock, speed_m_s=0.1)
    clock.now += 1
    pointer.begin()
    stroke(pointer, clock, speed_m_s=0.1, n=51)
    track = check_track(pointer.take())
    assert track.shape == (51, 4)
    found = describe_track(track, duration_s=0.4)
    assert found["distance_m"] == pytest.approx(0.04)
    assert found["mean_speed_m_s"] == pytest.approx(0.1)
    assert found["reports_per_s"] == pytest.approx(51 / 0.4)
    number, sha256 = write_track(tmp_path / "motion", track)
    assert write_track(tmp_path / "motion", track)[0] == number + 1 == 2
    content = (tmp_path / "motion" / "00001.csv").read_bytes()
    assert hashlib.sha256(content).hexdigest() == sha256
    table = pd.read_csv(tmp_path / "motion" / "00001.csv")
    assert ",".join(table.columns) == HEAD
    np.testing.assert_allclose(table.to_numpy(), track, atol=1e-6)


@pytest.mark.parametrize(
    "track", [np.zeros(4), np.zeros((3, 3)), np.full((2, 4), np.nan), np.eye(4)[::-1]]
)
def test_what_is_no_track_is_refused_and_costs_no_playback(track: Any, tmp_path: Path) -> None:
    if track.shape == (4, 4):
        track = track[:, ::-1]
    with pytest.raises(ValueError, match="motion source must give"):
        check_track(np.sort(track, axis=0)[::-1] if track.shape == (4, 4) else track)

    class Broken(Strokes):
        def take(self) -> Any:
            return np.zeros(4)

    hand = Broken(Clock(), np.random.default_rng(0), speed_m_s=0.1)
    own = Exploration(hand, {"realism": "gain"}, 0.1, RATE, tmp_path)
    playback = own.finish(Playback(0.0, 0.0))
    assert playback.error.startswith("motion: a motion source must give finite values")
    assert own.begin("mushra") is None


def test_strokes_are_the_same_again_and_their_speed_is_that_of_their_path() -> None:
    tracks = []
    for _ in range(2):
        clock = Clock(0.0)
        hand = Strokes(clock, np.random.default_rng([1, 2]), speed_m_s=0.1)
        hand.begin()
        clock.now = 2.0
        tracks.append(hand.take())
    np.testing.assert_array_equal(*tracks)
    time_s, x_m, _, speed = tracks[0].T
    assert len(time_s) == 251
    slopes = np.abs(np.gradient(x_m, time_s))
    np.testing.assert_allclose(slopes[1:-1], speed[1:-1], atol=3e-3)
    assert speed.min() < 0.01
    assert 0.08 <= speed.max() <= 0.16


def test_a_tracker_of_a_lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mylab_tracking.py").write_text(
        "class Good:\n"
        "    closed = 0\n"
        "    def read(self): return (1.0, 0.0, 0.0, 0.1, 0.1)\n"
        "    def begin(self): pass\n"
        "    def take(self): return [[1.0, 0, 0, 0.1]]\n"
        "    def close(self): Good.closed += 1\n"
        "class Lacking:\n    def read(self): return (1.0, 0.0, 0.0, 0.1, 0.1)\n"
        "class Short(Good):\n    def read(self): return (1.0,)\n"
        "def absent(): raise OSError('no tracker on USB')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with open_tracker("mylab_tracking:Good") as tracker:
        assert tracker.read()[3] == 0.1
    import mylab_tracking

    assert mylab_tracking.Good.closed == 1
    for name, message in {
        "Lacking": "must have read, begin, take and close; it lacks begin, take, close",
        "Short": "does not open",
        "absent": "does not open: no tracker on USB",
        "nothing": "cannot be imported",
    }.items():
        with pytest.raises(ValueError, match=message), open_tracker(f"mylab_tracking:{name}"):
            pass


STIMULUS = Stimulus(
    "s", "r", "d", "as_is", "test", "s.wav", RATE, 4000, 0.5, 1, 1, 1, 1, 1, 0, "", ""
)


def make_output(folder: Path, clock: Clock, sound: np.ndarray) -> FileOutput:
    rig = Rig(
        actuators=(ActuatorTable(name="left", channel=1),),
        limits=LimitsTable(peak_m_s2=100.0, rms_m_s2=100.0, duration_s=60.0),
    )
    return FileOutput(rig, {"s": sound}, rate_hz=RATE, folder=folder / "delivered", clock=clock)


@pytest.mark.parametrize("mode", ["gain", "speed", "window"])
def test_an_output_plays_as_the_hand_moves(mode: str, tmp_path: Path) -> None:
    """At rest, then at the reference speed, then at rest; what is late is reported as late as it is."""
    wave = 0.4 * np.sin(2 * np.pi * 200 * np.arange(4000) / RATE)
    sound = wave.astype(np.float32)[:, None]
    clock = Clock()
    output = make_output(tmp_path, clock, sound)
    pointer = Pointer(clock, m_per_pixel=0.25e-3)
    own = Exploration(pointer, {"realism": mode}, 0.1, RATE, tmp_path / "motion")
    explorer = own.begin("realism")
    output.start(STIMULUS, gap_s=0.1, explorer=explorer)
    x_px = 0.0
    while output.is_playing:
        clock.now += 0.004
        if 10.25 <= clock.now < 10.45:
            x_px += 0.1 * 0.004 / 0.25e-3
            pointer.move(x_px, 0.0)
    playback = own.finish(output.collect())
    assert playback.completed
    assert playback.delivered == {}
    samples = read_wav(tmp_path / "delivered" / "0001.wav")[0]
    played = np.ravel(samples)[800:4800]
    moving = np.abs(played) > 1e-3
    first, last = np.flatnonzero(moving)[[0, -1]] / RATE + 10.1
    # A file's block of 512 samples (64 ms) is written as it ends; a pointer counts as moving for 50 ms.
    assert 10.25 - 0.064 <= first <= 10.25 + 0.02
    assert 10.45 - 0.064 <= last <= 10.45 + STILL_S + 0.03
    assert playback.motion["distance_m"] == pytest.approx(0.1 * 0.196, abs=0.001)
    assert playback.motion["file_number"] == 1
    assert "motion_latency_ms" not in playback.measured  # no device, no latency


def test_latencies_are_those_of_reports_that_waited() -> None:
    clock = Clock()
    hand = Strokes(clock, np.random.default_rng(0), speed_m_s=0.1)
    explorer = make_explorer("gain", hand, reference_m_s=0.1, rate_hz=1000)
    explorer.uses[:3] = (9.0, 0), (10.1, 120), (10.2, 240)
    explorer.n_uses = 3
    found = find_latencies(explorer, first_s=10.0, rate_hz=1000)
    assert found == pytest.approx({"motion_latency_ms": 30.0, "motion_latency_ms_max": 40.0})
    explorer.n_uses = 1
    assert find_latencies(explorer, first_s=10.0, rate_hz=1000) == {}


EXPLORING = """
[[recordings]]
scene = "bumps"
duration_s = 0.3
[stimuli]
reducers = ["sax321", "dft321"]
[session]
protocols = ["realism", "mushra"]
[session.rehearsal]
training = 0
practice = 0
[tasks.realism]
explore = "gain"
"""


def list_played(study: StudyFolder, participant: str) -> tuple[Records, list[PartPlayed]]:
    records = read_journal(list_journals(study.sessions / participant)[-1]).records
    return records, [one.content for one in records if isinstance(one.content, PartPlayed)]


def test_simulated_participants_move_too(tmp_path: Path) -> None:
    study = create_study(tmp_path / "study")
    study.settings.write_text(EXPLORING, encoding="utf-8")
    build_study(study)

    def simulate() -> None:
        simulate_study(study, participants=1, seed=None, now=lambda: datetime.now(UTC))

    simulate()
    rows = pd.read_csv(study.ratings)
    realism, other = rows[rows.protocol == "realism"], rows[rows.protocol == "mushra"]
    assert len(realism)
    assert realism.motion_distance_m.between(0.001, 0.2).all()
    np.testing.assert_allclose(
        realism.motion_distance_m / realism.motion_mean_speed_m_s, 0.3, rtol=1e-2
    )
    assert other.motion_distance_m.isna().all()
    _, played = list_played(study, "sim001")
    tracks = sorted((study.sessions / "sim001" / "motion").glob("*.csv"))
    explored = [one for one in played if one.motion]
    assert len(tracks) == len(explored) > 0
    for one, path in zip(explored, tracks, strict=True):
        assert hashlib.sha256(path.read_bytes()).hexdigest() == one.motion_sha256
    assert not audit_study(study)
    before = tracks[0].read_text(encoding="utf-8")
    tracks[0].write_text(before + "\n", encoding="utf-8")
    assert any("motion/00001.csv was changed" in str(one) for one in audit_study(study))
    tracks[1].unlink()
    assert any("motion/00002.csv is gone" in str(one) for one in audit_study(study))


def test_what_explores_stands_in_the_header_and_cannot_change(tmp_path: Path) -> None:
    study = create_study(tmp_path / "study")
    study.settings.write_text(EXPLORING, encoding="utf-8")
    settings = read_settings(study.settings)
    assert find_modes(settings) == {"realism": "gain"}
    build_study(study)
    simulate_study(study, participants=1, seed=None, now=lambda: datetime.now(UTC))
    header = list_played(study, "sim001")[0].find_header()
    assert header is not None
    assert header.identity["exploration"] == {
        "source": "mouse", "reference_m_s": 0.1, "mm_per_pixel": 0.25, "modes": {"realism": "gain"},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"gain"', '"loudness"', "explore"),
        ("[tasks.realism]", "[tasks.mushra]", "tasks.mushra.explore is for realism and similarity only"),
        ("[tasks.realism]", "[session.exploration]\nreference_m_s = 0\n[tasks.realism]", "reference_m_s"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "study.toml"
    path.write_text(EXPLORING.replace(old, new), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read_settings(path)


def test_a_copy_of_a_playback_keeps_its_motion() -> None:
    playback = Playback(0.0, 0.0, motion={"distance_m": 1.0}, motion_sha256="5" * 64)
    assert replace(playback, error="x").motion == {"distance_m": 1.0}
