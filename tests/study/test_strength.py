"""How strongly stimuli are felt: what `check`, `build`, `run` and `simulate` say of it."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feel321.stimuli.sets.build import Foreseen
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.sets.render import Measured
from feel321.stimuli.synthesis import make_scene
from feel321.stimuli.thresholds import THRESHOLDS, acceleration_threshold
from feel321.stimuli.wav import write_wav
from feel321.study.check import build_study, check_study
from feel321.study.cli import main
from feel321.study.folder import StudyFolder, create_study
from feel321.study.settings.read import read_settings
from feel321.study.strength import describe_built, find_strength

Capture = pytest.CaptureFixture[str]


def set_up(study: StudyFolder, lines: str) -> StudyFolder:
    """Add lines under [stimuli]."""
    text = study.settings.read_text(encoding="utf-8").replace("[stimuli]", f"[stimuli]\n{lines}")
    study.settings.write_text(text, encoding="utf-8")
    return study


def test_what_cannot_be_felt_is_a_problem_until_it_is_accepted(
    study: StudyFolder, capsys: Capture
) -> None:
    set_up(study, "gain = 0.01")
    assert main(["check", str(study.path)]) == 1
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith(
        "recording 'bumps': 6 of 6 stimuli below the detection threshold (contactor), not to be"
    )
    assert 'gain = "per_recording" plays this recording' in out[0]
    assert out[0].endswith('or accept it: below_threshold = "accept" under [stimuli]')
    set_up(study, 'below_threshold = "accept"')
    assert main(["check", str(study.path)]) == 0
    shown = capsys.readouterr()
    assert shown.out.splitlines()[0] == f"{study.path}: no problems, 2 warnings"
    assert f"feel321: warning: {out[0]}" in shown.err
    assert main(["check", str(study.path), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert (figures["problems"], figures["below_threshold"], figures["stimuli"]) == ([], 12, 12)
    assert figures["warnings"][0] == out[0]
    assert set(figures["sensation_levels_db"]["bumps"]) == {"contactor", "grasped_stylus"}


def test_check_says_the_same_before_and_after_the_build(
    study: StudyFolder, capsys: Capture
) -> None:
    set_up(study, 'gain = 0.2\nthreshold = "grasped_stylus"')
    before = check_study(study)
    build_study(study)
    assert check_study(study) == before
    rows = read_stimuli(study.stimuli).stimuli
    low, high = before.figures["sensation_levels_db"]["hard_taps"]["grasped_stylus"]
    levels = [row.sensation_level_db for row in rows if row.recording == "hard_taps"]
    assert (min(levels), max(levels)) == (low, high)
    weak = [
        row.reducer
        for row in rows
        if 0 <= row.sensation_level_db < 10 and row.recording == "hard_taps"
    ]
    lines = [line for line in before.warnings if line.startswith("recording 'hard_taps'")]
    assert bool(weak) == bool(lines)
    assert all(name in lines[0] for name in weak)
    assert main(["build", str(study.path)]) == 0
    assert (
        "gain, as given in study.toml: 0.2 m/s² played per m/s² recorded" in capsys.readouterr().out
    )


def test_one_spike_costs_the_other_recordings_headroom(study: StudyFolder, capsys: Capture) -> None:
    samples = make_scene("texture_drag", duration_s=0.5).acceleration.copy()
    samples[:, 2000:2020] += 300 * np.hanning(20)
    write_wav(study.path / "spike.wav", samples, 10_000)
    text = (
        study.settings.read_text(encoding="utf-8")
        + '[[recordings]]\nfile = "spike.wav"\nunit = "m/s^2"\n'
    )
    study.settings.write_text(text, encoding="utf-8")
    levels = {}
    for gain in ("set", "per_recording"):
        set_up(study, "") if gain == "set" else set_up(study, 'gain = "per_recording"')
        assert main(["check", str(study.path), "--json"]) == 0
        levels[gain] = json.loads(capsys.readouterr().out)
    (line,) = [line for line in levels["set"]["notes"] if line.startswith("headroom: ")]
    cost = float(line.split(" dB weaker")[0].rsplit(" ", 1)[1])
    said = "headroom: the peak of recording 'spike' sets the gain; all other recordings are played "
    assert line.startswith(said)
    assert line.endswith('gain = "per_recording" avoids that')
    gained = {
        name: levels["per_recording"]["sensation_levels_db"][name]["contactor"][1]
        - levels["set"]["sensation_levels_db"][name]["contactor"][1]
        for name in ("bumps", "hard_taps", "spike")
    }
    assert gained["spike"] == pytest.approx(0, abs=1e-6)
    # Of whose peak comes next.
    assert min(gained["bumps"], gained["hard_taps"]) == pytest.approx(cost, abs=0.06)
    assert not any(line.startswith("headroom") for line in levels["per_recording"]["notes"])


def test_beside_a_real_surface_the_gain_is_one_or_named(study: StudyFolder) -> None:
    text = study.settings.read_text(encoding="utf-8").replace(
        "duration_s = 0.5", 'duration_s = 0.5\nsample = "oak"'
    )
    text += "[tasks.realism]\nsurface = true\n[rig]\nfull_scale_m_s2 = 20\n"
    study.settings.write_text(text, encoding="utf-8")
    (line,) = check_study(study).warnings
    assert line.startswith("tasks realism: the real surface is felt, but stimuli are played at 0.")
    assert line.endswith('set gain = 1.0 and levels = ["as_is"] under [stimuli]')
    _, stimuli = build_study(study)
    assert line in describe_built(read_settings(study.settings), stimuli)
    shutil.rmtree(study.stimuli)
    checked = check_study(set_up(study, "gain = 1.0"))
    assert checked.warnings == ()
    assert len(checked.problems) == 2
    assert "stimuli will be clipped at full scale (20 m/s²), by up to " in checked.problems[0]
    study.settings.write_text(
        study.settings.read_text(encoding="utf-8").replace("= 20\n", "= 400\n"), encoding="utf-8"
    )
    assert list(check_study(study).problems) == []
    build_study(study)
    assert list(check_study(study).problems) == []


def test_the_rig_is_compared_before_anything_is_built(tmp_path: Path) -> None:
    study = create_study(tmp_path / "study")
    study.settings.write_text(
        '[[recordings]]\nscene = "bumps"\nduration_s = 0.5\n', encoding="utf-8"
    )
    checked = check_study(study)
    assert checked.problems == ()
    assert checked.notes[0].endswith(
        "reference reach the hand with equal energy (difference 0.0 dB)"
    )
    text = study.rig.read_text(encoding="utf-8")
    study.rig.write_text(text.replace("[0, 1, 0]", "[-1, 0, 0]"), encoding="utf-8")
    (problem,) = check_study(study).problems
    assert problem.startswith(
        "rig.toml: 'left coil' and 'right coil' play 'reduced' in opposite directions"
    )


def foresee(recording: str = "oak", reducer: str = "dft321", **own: float) -> Foreseen:
    """A stimulus without samples."""
    levels = dict.fromkeys(THRESHOLDS, 10 ** (own.get("level_db", 20.0) / 20))
    measured = Measured(own.get("peak_m_s2", 1.0), levels, 1.0, 1.0, 1.0, 1.0)
    return Foreseen(recording, reducer, "test", "", measured, "as_is", gain=1.0)


def test_a_recording_that_is_raised_by_more_than_40_db_is_named_before_the_build(
    study: StudyFolder,
) -> None:
    foreseen = [replace(foresee(name), gain=gain) for name, gain in (("oak", 99.0), ("ash", 200.0))]
    (line,) = find_strength(read_settings(study.settings), foreseen, Recipe()).warnings
    assert line.startswith("ash: played 46 dB stronger than it was recorded")


def test_thresholds_that_may_lie_beyond_the_levels_are_told(study: StudyFolder) -> None:
    text = study.settings.read_text(encoding="utf-8")
    peak_m_s2 = acceleration_threshold(160.0, threshold="grasped_stylus")
    level_db = 20 * np.log10(peak_m_s2 / 2**0.5)  # dB re 1 m/s², RMS

    def warn(below_db: float, above_db: float) -> list[str]:
        own = f"lowest_db = {level_db - below_db}\nhighest_db = {level_db + above_db}\nstart_db = {level_db}\n"
        block = f"[session.threshold]\nfrequencies_hz = [160.0]\n{own}"
        study.settings.write_text(
            text.replace("[stimuli]", f'{block}[stimuli]\nthreshold = "grasped_stylus"'),
            encoding="utf-8",
        )
        return [line for line in check_study(study).warnings if "thresholds are expected" in line]

    assert warn(13, 13) == []
    for line in (*warn(11, 13), *warn(13, 11)):
        assert f"at 160 Hz thresholds are expected around {level_db:.0f} dB" in line
    assert len(warn(11, 13)) == len(warn(13, 11)) == 1
