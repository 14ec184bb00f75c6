import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from feel321.files import hold_lock, write_bytes
from feel321.stimuli.condition import Conditioning
from feel321.stimuli.recording import Recording
from feel321.stimuli.sets.build import (
    BUILT,
    PARTS,
    Facts,
    Foreseen,
    build_stimuli,
    place_surveyed,
    read_history,
    survey_recording,
)  # fmt: skip
from feel321.stimuli.sets.manifest import (
    COLUMN_UNITS,
    Stimulus,
    StimulusSet,
    check_stimuli,
    read_stimuli,
)
from feel321.stimuli.sets.recipe import ANCHORS, GAINS, Recipe
from feel321.stimuli.sets.render import Draft, Measured
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.stimuli.thresholds import THRESHOLDS
from feel321.stimuli.wav import read_wav, write_wav

CONTRACT = [
    "stimulus_id", "recording", "reducer", "level", "role", "file", "rate_hz", "n_samples", "duration_s",
    "peak", "rms_m_s2", "gain", "spectral_match", "temporal_match", "clipped", "sha256", "recording_sha256",
    "spectral_match_bounded", "sensation_level_db", "temporal_match_windowed", "band_high_hz",
]  # fmt: skip
BOTH = ("as_is", "equal_intensity")


def foresee_stimuli(recordings: list[Recording], folder: Path, *, recipe: Recipe) -> list[Foreseen]:
    known = read_history(folder)
    facts = [survey_recording(one, known.get(one.name, ()), recipe=recipe) for one in recordings]
    return [one for own in place_surveyed(facts, recipe).values() for one in own]


@pytest.fixture(scope="module")
def scenes() -> list[Recording]:
    return [
        make_scene(name, duration_s=0.6) for name in ("bumps", "texture_drag", "circular_motion")
    ]


@pytest.fixture(scope="module")
def built(scenes: list[Recording], tmp_path_factory: pytest.TempPathFactory) -> StimulusSet:
    return build_stimuli(scenes, tmp_path_factory.mktemp("set"), recipe=Recipe(levels=BOTH))


def contents(folder: Path) -> dict[str, str]:
    files = [p for p in folder.iterdir() if p.is_file() and p.name != ".lock"]
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def stamps(folder: Path) -> dict[str, int]:
    return {p.name: p.stat().st_mtime_ns for p in folder.glob("*.wav")}


def test_the_manifest_keeps_the_contract(built: StimulusSet) -> None:
    header = (built.folder / "manifest.csv").read_text().splitlines()[0]
    assert (
        header.split(",")
        == CONTRACT
        == [field.name for field in fields(Stimulus) if field.name != "metrics"]
        == list(COLUMN_UNITS)
    )
    assert read_stimuli(built.folder) == built
    details = json.loads((built.folder / "manifest.json").read_text())
    assert details["columns"] == COLUMN_UNITS
    assert set(details["versions"]) == {"feel321", "numpy", "scipy", "soxr"}
    assert details["recipe"]["conditioning"]["high_pass_hz"] == 20.0
    assert [row["stimulus_id"] for row in details["stimuli"]] == [
        s.stimulus_id for s in built.stimuli
    ]


def test_rows_tell_what_the_files_hold(built: StimulusSet) -> None:
    full_scale = Recipe().full_scale_m_s2
    for row in built.stimuli:
        samples, rate = read_wav(built.folder / row.file)
        assert (rate, samples.shape[-1]) == (row.rate_hz, row.n_samples) == (48000, 28800)
        assert samples.ndim == (2 if row.role == "reference" else 1)
        assert np.abs(samples).max() == pytest.approx(row.peak, rel=1e-6)
        rms = np.sqrt((samples**2).sum() / row.n_samples) * full_scale
        assert rms == pytest.approx(row.rms_m_s2, rel=1e-5)
        assert np.abs(samples[..., [0, -1]]).max() < 1e-4  # faded


def test_anchors_are_as_strong_as_their_recording(built: StimulusSet) -> None:
    levels = {
        (row.recording, row.level, row.reducer): row.sensation_level_db for row in built.stimuli
    }
    anchors = [key for key in levels if key[2] in ANCHORS]
    assert len(anchors) == 12
    for recording, level, reducer in anchors:
        assert levels[recording, level, reducer] == pytest.approx(
            levels[recording, level, "original"], abs=1e-6
        )


@pytest.mark.parametrize("gain", [*GAINS, 1.5])
def test_an_anchor_never_sets_a_gain_and_is_kept_inside_the_headroom(gain: float | str) -> None:
    recipe = Recipe(levels=BOTH, gain=gain, full_scale_m_s2=100.0, headroom=0.9)
    peaks = {"test": 45.0, "fits": 30.0, "high": 900.0}
    roles = {"test": "test", "fits": "anchor", "high": "anchor"}
    measured = {
        key: Measured(peak, dict.fromkeys(THRESHOLDS, 10.0), 1.0, 1.0, 1.0, 1.0)
        for key, peak in peaks.items()
    }
    drafts = tuple(Draft("oak", key, role, key) for key, role in roles.items())
    placed = place_surveyed([Facts("oak", drafts=drafts, measured=measured)], recipe)["oak"]
    for level in BOTH:
        # A gain that is given is that of the level as it is.
        common = gain if isinstance(gain, float) and level == "as_is" else 90 / 45
        found = {one.key: one.gain for one in placed if one.level == level}
        assert found == {"test": common, "fits": common, "high": 0.1}


def test_a_recording_may_have_a_crop_a_corner_and_a_gain_of_its_own(tmp_path: Path) -> None:
    drag = make_scene("texture_drag", duration_s=0.6)
    soft, loud = replace(drag, name="soft"), replace(drag, name="loud")
    own = {"soft": {"crop_s": (0.1, 0.4), "high_pass_hz": 100.0}, "loud": {"gain": 0.25}}
    recipe = Recipe(reducers=("sax321",), levels=BOTH, anchors=False)
    plain = build_stimuli([drag, soft, loud], tmp_path / "plain", recipe)
    made = build_stimuli([drag, soft, loud], tmp_path / "own", recipe, exceptions=own)
    assert made["soft__sax321__as_is"].duration_s == pytest.approx(0.3)
    assert made["loud__sax321__as_is"].gain == made["loud__reference__as_is"].gain == 0.25
    assert made["texture_drag__sax321__as_is"].gain == plain["texture_drag__sax321__as_is"].gain
    levels = {one.sensation_level_db for one in made if one.level == "equal_intensity"}
    assert max(levels) - min(levels) < 0.01
    samples, rate_hz = made.read("soft__sax321__as_is")
    energy = np.abs(np.fft.rfft(samples)) ** 2
    low = np.fft.rfftfreq(len(samples), 1 / rate_hz) < 60
    whole = np.abs(np.fft.rfft(plain.read("soft__sax321__as_is")[0])) ** 2
    assert energy[low].sum() / energy.sum() < 0.05 * whole[: 2 * low.sum()].sum() / whole.sum()
    said = json.loads((tmp_path / "own" / "manifest.json").read_text(encoding="utf-8"))
    assert said["recipe"]["exceptions"]["loud"] == {"gain": 0.25}
    assert "high-pass 100 Hz" in said["conditioning"]["soft"]
    with pytest.raises(ValueError, match="gain of loud must be a finite number above 0, got 0"):
        Recipe(exceptions={"loud": {"gain": 0.0}})


def test_a_gain_per_recording_spares_the_others_the_cost_of_a_spike(
    scenes: list[Recording], tmp_path: Path
) -> None:
    spike = scenes[1].acceleration.copy()
    spike[0, 3000:3020] += 40 * np.abs(spike).max() * np.hanning(20)
    spiked = [scenes[0], replace(scenes[1], acceleration=spike, sha256="spiked")]
    recipe = Recipe(reducers=("sax321", "dft321"), levels=BOTH)
    gains, levels = {}, {}
    for gain in GAINS:
        rows = build_stimuli(spiked, tmp_path / gain, recipe=replace(recipe, gain=gain)).stimuli
        for name in ("bumps", "texture_drag"):
            own = [row for row in rows if row.recording == name]
            (gains[gain, name],) = {row.gain for row in own if row.level == "as_is"}
            equal = [row.sensation_level_db for row in own if row.level == "equal_intensity"]
            assert max(equal) - min(equal) < 1e-9
            levels[gain, name] = equal[0]
        quiet = max(row.peak for row in rows if (row.recording, row.level) == ("bumps", "as_is"))
        assert quiet == pytest.approx(0.9, rel=1e-6) if gain == "per_recording" else quiet < 0.1
    assert (
        gains["set", "bumps"]
        == gains["set", "texture_drag"]
        == gains["per_recording", "texture_drag"]
    )
    assert levels["per_recording", "bumps"] > levels["set", "bumps"] + 3
    foreseen = foresee_stimuli(spiked, tmp_path / "set", recipe=replace(recipe, levels=("as_is",)))
    names = ("bumps", "texture_drag")
    peaks = {
        name: max(one.peak_m_s2 for one in foreseen if one.recording == name) for name in names
    }
    cost = gains["per_recording", "bumps"] / gains["set", "bumps"]
    assert peaks["texture_drag"] / peaks["bumps"] == pytest.approx(cost)


def test_what_is_foreseen_is_what_is_built(scenes: list[Recording], tmp_path: Path) -> None:
    recipe = Recipe(reducers=("sax321", "dft321_windowed"), levels=BOTH, gain="per_recording")
    foreseen = foresee_stimuli(scenes, tmp_path, recipe=recipe)
    assert not list(tmp_path.iterdir())
    rows = build_stimuli(scenes, tmp_path, recipe=recipe).stimuli
    assert {(one.recording, one.reducer, one.level, one.role, one.gain) for one in foreseen} == {
        (row.recording, row.reducer, row.level, row.role, row.gain) for row in rows
    }
    for one, row in zip(foreseen, rows_by_recording(rows), strict=True):
        assert one.sensation_levels_db["contactor"] == row.sensation_level_db
        assert one.peak_m_s2 == pytest.approx(row.peak * recipe.full_scale_m_s2, rel=1e-6)
    # From what the build remembers.
    assert foresee_stimuli(scenes, tmp_path, recipe=recipe) == foreseen


def rows_by_recording(rows: tuple[Stimulus, ...]) -> list[Stimulus]:
    names = list(dict.fromkeys(row.recording for row in rows))
    return sorted(rows, key=lambda row: names.index(row.recording))


def test_two_builds_and_two_workers_give_the_same_bytes(
    built: StimulusSet, scenes: list[Recording], tmp_path: Path
) -> None:
    steps: list[tuple[int, int]] = []
    again = build_stimuli(
        scenes, tmp_path, levels=BOTH, workers=2, progress=lambda *s: steps.append(s)
    )
    assert contents(tmp_path) == contents(built.folder)
    assert steps == [(done, 6) for done in range(1, 7)]
    assert again.stimuli == built.stimuli


WITH_OFFSET = Conditioning(high_pass_hz=None)
"""A high-pass filter removes the offset too; without one, only a nonlinear reducer such as `mag321` depends on it."""


@pytest.mark.parametrize(
    "changes",
    [
        {"gain": 2.0},
        {"fade_s": 0.02},
        {"full_scale_m_s2": 50.0},
        {"rate_hz": 44100.0},
        {"conditioning": replace(WITH_OFFSET, high_pass_hz=30.0)},
        {"conditioning": replace(WITH_OFFSET, low_pass_hz=800.0)},
        {"conditioning": replace(WITH_OFFSET, remove_offset=False)},
        {"conditioning": replace(WITH_OFFSET, crop_s=(0.1, 0.5))},
    ],
    ids=str,
)
def test_every_setting_that_decides_a_file_makes_it_again(
    changes: dict[str, object], scenes: list[Recording], tmp_path: Path
) -> None:
    offset = Recording(scenes[0].acceleration + 3.0, scenes[0].rate_hz, "with_offset")
    base = Recipe(
        reducers=("mag321",), reference="none", anchors=False, gain=1.0, conditioning=WITH_OFFSET
    )
    (row,) = build_stimuli([offset], tmp_path / "set", recipe=base).stimuli
    before, samples = contents(tmp_path / "set"), read_wav(tmp_path / "set" / row.file)[0]
    changed = replace(base, **changes)
    build_stimuli([offset], tmp_path / "set", recipe=changed)
    after = read_wav(tmp_path / "set" / row.file)[0]
    assert not set(before.values()) & set(contents(tmp_path / "set").values())
    # Far above rounding, so that the answer is the same on every processor.
    assert (
        len(after) != len(samples) or np.abs(after - samples).max() > 1e-3 * np.abs(samples).max()
    )
    build_stimuli([offset], tmp_path / "fresh", recipe=changed)
    assert contents(tmp_path / "fresh") == contents(tmp_path / "set")


def test_what_rounding_left_of_axes_that_cancelled_is_silence(tmp_path: Path) -> None:
    x, y = make_scene("texture_drag", duration_s=0.5).acceleration[:2]
    cancelling = Recording(np.array([x, y, -(x + y)]), 10000.0, "cancelling")
    recipe = Recipe(reducers=("soc321", "dft321"), levels=BOTH, anchors=False)
    with pytest.raises(ValueError, match="1 stimuli are silent"):
        build_stimuli([cancelling], tmp_path, recipe=recipe)
    rows = build_stimuli([cancelling], tmp_path, recipe=replace(recipe, levels=("as_is",))).stimuli
    # Neither 0 nor infinity.
    assert [np.isnan(row.sensation_level_db) for row in rows] == [True, False, False]
    assert "Infinity" not in (tmp_path / "manifest.json").read_text()


def test_two_builds_in_one_folder_do_not_meet(scenes: list[Recording], tmp_path: Path) -> None:
    recipe = Recipe(reducers=("dft321",), anchors=False)
    with (
        hold_lock(tmp_path / ".lock", busy="x"),
        pytest.raises(BlockingIOError, match="another build is running here"),
    ):
        build_stimuli(scenes[:1], tmp_path, recipe=recipe)
    build_stimuli(scenes[:1], tmp_path, recipe=recipe)


def test_a_disk_that_fills_up_leaves_the_old_set_whole(
    scenes: list[Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = Recipe(reducers=("sax321", "dft321"), gain=1.0)
    build_stimuli(scenes, tmp_path, recipe=base)
    before = contents(tmp_path)
    calls = iter(range(10_000))

    def write_until_full(path: Path, content: bytes) -> None:
        if next(calls) > 7:
            raise OSError(28, "No space left on device")
        write_bytes(path, content)

    monkeypatch.setattr("feel321.files.write_bytes", write_until_full)
    with pytest.raises(OSError, match="No space left"):
        build_stimuli(scenes, tmp_path, recipe=replace(base, gain=2.0))
    monkeypatch.undo()
    assert contents(tmp_path) == before
    assert check_stimuli(tmp_path) == []
    build_stimuli(scenes, tmp_path, recipe=replace(base, gain=2.0))
    build_stimuli(scenes, tmp_path / "fresh", recipe=replace(base, gain=2.0))
    assert contents(tmp_path) == contents(tmp_path / "fresh")


def test_a_set_that_is_being_replaced_has_no_manifest(
    scenes: list[Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = Recipe(reducers=("sax321",), gain=1.0)
    build_stimuli(scenes, tmp_path, recipe=base)

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("feel321.stimuli.sets.build.write_manifest", stop)
    with pytest.raises(KeyboardInterrupt):
        build_stimuli(scenes, tmp_path, recipe=replace(base, gain=2.0))
    assert "there is no manifest" in check_stimuli(tmp_path)[0]


def test_a_damaged_memory_costs_only_work(scenes: list[Recording], tmp_path: Path) -> None:
    recipe = Recipe(reducers=("dft321",), anchors=False)
    build_stimuli(scenes[:1], tmp_path, recipe=recipe)
    good, memory = contents(tmp_path), tmp_path / BUILT
    kept = memory.read_bytes()
    for damage in (b"", b"{", b"[1]\n", kept[:-20], kept.replace(b"{", b"[", 1), b"[" * 9000):
        memory.write_bytes(damage)
        build_stimuli(scenes[:1], tmp_path, recipe=recipe)
        assert contents(tmp_path) == good


def test_an_earlier_manifest_cannot_reach_outside_its_folder(
    scenes: list[Recording], tmp_path: Path
) -> None:
    precious = tmp_path / "precious.txt"
    precious.write_text("mine")
    folder = tmp_path / "set"
    recipe = Recipe(reducers=("dft321",), anchors=False, reference="none")
    build_stimuli(scenes[:1], folder, recipe=recipe)
    for name in (BUILT, "manifest.json", "manifest.csv"):
        text = (folder / name).read_text()
        (folder / name).write_text(text.replace("bumps__dft321__as_is.wav", "../precious.txt"))
    (problem,) = check_stimuli(folder)
    assert "file must be a name in the set's own folder, got '../precious.txt'" in problem
    build_stimuli(scenes[1:2], folder, recipe=recipe)
    assert precious.read_text() == "mine"


def test_a_damaged_file_is_found_and_mended(scenes: list[Recording], tmp_path: Path) -> None:
    recipe = Recipe(reducers=("sax321", "dft321"))
    build_stimuli(scenes, tmp_path, recipe=recipe)
    good = contents(tmp_path)
    victim = tmp_path / "bumps__sax321__as_is.wav"
    samples, rate = read_wav(victim)
    samples[100] += 1e-3
    write_wav(victim, samples, rate)
    (tmp_path / "bumps__dft321__as_is.wav").unlink()
    write_wav(tmp_path / "stray.wav", samples, rate)
    problems = check_stimuli(tmp_path)
    assert [p.split(";")[0] for p in problems] == [
        "bumps__sax321__as_is.wav: was changed after it was built (its SHA-256 differs)",
        "bumps__dft321__as_is.wav: missing",
        "stray.wav: not in the manifest",
    ]
    (tmp_path / "stray.wav").unlink()
    build_stimuli(scenes, tmp_path, recipe=recipe)
    assert contents(tmp_path) == good


SOME = Recipe(reducers=("sax321", "dft321", "mag321"), levels=BOTH)
KILLED = """
import sys
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.synthesis import SCENES, make_scene
scenes = [make_scene(name, duration_s=0.5) for name in list(SCENES)[:3]]
print("ready", flush=True)
recipe = Recipe(reducers=("sax321", "dft321", "mag321"), levels=("as_is", "equal_intensity"))
build_stimuli(scenes, sys.argv[1], recipe, workers=int(sys.argv[2]))
"""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What the killed builds are to hold in the end."""
    folder = tmp_path_factory.mktemp("undisturbed")
    scenes = [make_scene(name, duration_s=0.5) for name in list(SCENES)[:3]]
    build_stimuli(scenes, folder, SOME)
    return contents(folder)


@pytest.mark.parametrize(("delay_s", "workers"), [(0.05, 1), (0.2, 1), (0.5, 1), (1.5, 2)])
def test_a_killed_build_leaves_no_half_file_and_is_continued(
    tmp_path: Path, delay_s: float, workers: int, undisturbed: dict[str, str]
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path), str(workers)],
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    time.sleep(delay_s)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    for path in tmp_path.rglob("*.wav"):
        read_wav(path)  # refuses a file that is shorter than its header says
    scenes = [make_scene(name, duration_s=0.5) for name in list(SCENES)[:3]]
    build_stimuli(scenes, tmp_path, SOME)
    assert contents(tmp_path) == undisturbed
    assert not [*tmp_path.glob(f"{PARTS}*")]


# --- anchors ----------------------------------------------------------------------------------------------------


def test_a_set_whose_anchor_is_no_anchor_is_refused(
    scenes: list[Recording], tmp_path: Path
) -> None:
    build_stimuli(scenes[:1], tmp_path, recipe=Recipe(reducers=("sax321",)))
    table = (tmp_path / "manifest.csv").read_text()
    line = next(row for row in table.splitlines() if "anchor_mid" in row)
    test = next(row for row in table.splitlines() if ",test," in row).split(",")
    equal = test[CONTRACT.index("spectral_match")]
    for column, value in (
        ("spectral_match", "0.99"),
        ("spectral_match", equal),
        ("temporal_match", "0.99"),
    ):
        row = line.split(",")
        row[CONTRACT.index(column)] = value
        (tmp_path / "manifest.csv").write_text(table.replace(line, ",".join(row)))
        (problem,) = check_stimuli(tmp_path)
        assert "anchor_mid" in problem
        assert "must be worse than every test" in problem


# --- refusals ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"reducers": ("dft",)}, "must be one of sax321"),
        ({"reducers": ("dft321", "dft321")}, "each once"),
        ({"levels": ("loud",)}, "must be one of as_is, equal_intensity"),
        ({"reference": "best"}, "must be one of original, none, sax321"),
        ({"rate_hz": 44100.5}, "whole number of Hz"),
        ({"headroom": 1.5}, "at most 1"),
        ({"gain": float("inf")}, "gain must be a finite number above 0, 'set' or 'per_recording', got inf"),
        ({"threshold": "finger"}, "threshold must be one of contactor, grasped_stylus; got 'finger'"),
    ],
)  # fmt: skip
def test_recipes_that_cannot_be_cooked_are_refused(
    changes: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Recipe(**changes)


def test_names_must_be_file_names_and_differ(scenes: list[Recording], tmp_path: Path) -> None:
    for recordings, message in (
        ([], "got none"),
        ([replace(scenes[0], name="a/b")], r"letters \(A-Z\), digits"),
        ([replace(scenes[0], name="a" * 101)], "up to 100 letters"),
        ([scenes[0], replace(scenes[1], name="BUMPS")], "'BUMPS' is there twice"),
    ):
        with pytest.raises(ValueError, match=message):
            build_stimuli(recordings, tmp_path, recipe=Recipe())


def test_a_gain_that_clips_is_counted_and_reported(scenes: list[Recording], tmp_path: Path) -> None:
    recipe = Recipe(reducers=("dft321",), anchors=False, reference="none", gain=10.0)
    (row,) = build_stimuli(scenes[:1], tmp_path, recipe=recipe).stimuli
    samples, _ = read_wav(tmp_path / row.file)
    assert row.clipped == np.count_nonzero(np.abs(samples) == 1.0) > 0
    (problem,) = check_stimuli(tmp_path)
    assert (
        problem
        == f"{row.file}: {row.clipped} samples clipped; lower the gain or raise full_scale_m_s2"
    )


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("", "holds no stimulus"),
        ("a,b\n1,2\n", "line 2: stimulus_id: "),
        (",".join(CONTRACT) + "\n" + "x," * 6 + "fast" + ",1" * 14 + "\n", "line 2: rate_hz: "),
        (b"\xff\xfe", "UTF-8"),
        ('stimulus_id\n"a"b\n', "not a CSV table"),
    ],
)
def test_a_manifest_that_is_none_is_refused(
    table: str | bytes, message: str, tmp_path: Path
) -> None:
    (tmp_path / "manifest.csv").write_bytes(table if isinstance(table, bytes) else table.encode())
    with pytest.raises(ValueError, match=message):
        read_stimuli(tmp_path)
    (problem,) = check_stimuli(tmp_path)
    assert message.rsplit(":", maxsplit=1)[-1].strip() in problem


@pytest.mark.parametrize("anchors", [True, False])
@pytest.mark.parametrize(
    "steps", [Conditioning(), Conditioning(remove_offset=False, high_pass_hz=None)]
)
def test_a_recording_without_anything_to_match_is_refused(
    steps: Conditioning, anchors: bool, tmp_path: Path
) -> None:
    still = Recording(np.outer((0.0, 9.81, 0.0), np.ones(3000)), 3000.0, "still")
    recipe = Recipe(conditioning=steps, anchors=anchors)
    with pytest.raises(
        ValueError,
        match=r"^recording 'still': the recording has no energy from 20 .*, leave it out$",
    ):
        build_stimuli([still], tmp_path, recipe=recipe)
    assert not (tmp_path / "manifest.csv").exists()
