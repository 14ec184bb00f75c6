"""Verbs reduce and match: what they write, print and refuse."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feel321.stimuli.condition import Conditioning, condition, list_steps
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.match import spectral_match
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rivals import RIVALS
from feel321.stimuli.synthesis import make_scene
from feel321.stimuli.wav import read_wav, write_wav
from feel321.study.cli import main
from feel321.types import MATCHES

Capture = pytest.CaptureFixture[str]

REDUCE = "reduce {recording} --reducer sax321 -o "


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    bumps = make_scene("bumps", duration_s=0.5)
    return write_csv(tmp_path / "bumps.csv", bumps.acceleration, bumps.rate_hz)


def write_csv(path: Path, acceleration: np.ndarray, rate_hz: float) -> Path:
    table = np.column_stack([np.arange(acceleration.shape[1]) / rate_hz, acceleration.T])
    head = "time_s,x_m/s^2,y_m/s^2,z_m/s^2"
    np.savetxt(path, table, delimiter=",", header=head, comments="")
    return path


@pytest.fixture
def facts(capsys: Capture) -> Callable[..., dict[str, Any]]:
    """Run a verb that succeeds, and read its figures."""

    def run(words: str, *more: object) -> dict[str, Any]:
        assert main([*words.split(), *map(str, more), "--json"]) == 0
        found: dict[str, Any] = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
        return found

    return run


@pytest.mark.parametrize("name", REDUCERS)
def test_reduce_writes_what_the_reducer_gives_and_match_reads_it(
    name: str, recording: Path, tmp_path: Path, facts: Callable[..., dict[str, Any]]
) -> None:
    said = facts(f"reduce {recording} --reducer {name} -o out.wav")
    samples, rate_hz = read_wav(tmp_path / "out.wav")
    bumps = condition(make_scene("bumps", duration_s=0.5), Conditioning()).acceleration
    reduced = REDUCERS[name](bumps, 10000.0)
    assert rate_hz == 10000
    np.testing.assert_allclose(samples, reduced, atol=1e-4)
    assert said == json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert (said["reducer"], said["unit"], said["recording"]) == (name, "m/s^2", "bumps")
    matched = facts(f"match {recording} out.wav")
    for metric in MATCHES:
        assert said[metric] == pytest.approx(METRICS[metric](bumps, reduced, 10000.0), abs=1e-9)
        assert matched[metric] == pytest.approx(said[metric], abs=1e-4)
    details = "n_frequencies n_left_out lowest_hz highest_hz silent_axes n_samples rate_hz"
    assert set(details.split()) <= set(matched)


def test_every_real_recording_goes_through_reduce_and_match(
    shared_recordings: Path, tmp_path: Path, facts: Callable[..., dict[str, Any]]
) -> None:
    kinds = {".csv", ".npz", ".wav"}
    sources = [path for path in sorted(shared_recordings.iterdir()) if path.suffix in kinds]
    assert len(sources) == 11
    for source in sources:
        output = tmp_path / f"{source.stem}.wav"
        facts("reduce --reducer dft321 -o", output, source)
        assert facts("match", source, output)["spectral_match"] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("reduce {recording} --reducer dft -o a.wav", 2, "reducer must be one of sax321, say321,"),
        ("match {recording} short.wav --metric nope", 2, "metric must be one of spectral_match,"),
        *((REDUCE + f"{name} --force", 2, "give it that ending") for name in ("out.json", "out")),
        (REDUCE + "bumps.csv --force", 2, "give it that ending"),
        (REDUCE + "taken.wav", 1, "taken.wav: already exists; name another file or add --force"),
        (REDUCE + "no/out.wav", 1, "feel321: no: there is no such folder; make it first"),
        ("match {recording} gone.wav", 1, "gone.wav: there is no such file; check the name"),
        ("match {recording} short.wav", 1, "short.wav: got 4999 samples, bumps has 5000; both must"),
        ("match {recording} wide.wav", 1, "wide.wav: a reduced signal has 1 channel, got 3; reduce"),
        ("match {recording} slow.wav", 1, "slow.wav: got 8000 Hz, bumps has 10000 Hz; both must"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_line_and_writes_nothing(
    words: str, code: int, message: str, recording: Path, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "taken.wav").write_bytes(b"mine")
    write_wav(tmp_path / "short.wav", np.ones(4999), 10000)
    write_wav(tmp_path / "wide.wav", np.ones((3, 5000)), 10000)
    write_wav(tmp_path / "slow.wav", np.ones(5000), 8000)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert main(words.format(recording=recording).split()) == code
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert message in err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("output", ["raw.wav", "link.wav", "other.wav"])
def test_reduce_never_writes_over_the_recording_or_its_sidecar(
    output: str, tmp_path: Path, capsys: Capture
) -> None:
    source = tmp_path / "raw.wav"
    write_wav(source, np.ones((3, 500)), 1000)
    source.with_suffix(".json").write_text('{"unit": "g"}', encoding="utf-8")
    (tmp_path / "link.wav").symlink_to("raw.wav")
    (tmp_path / "other.json").hardlink_to(tmp_path / "raw.json")
    before = source.read_bytes()
    words = (REDUCE + "{output} --force").format(recording=source, output=tmp_path / output)
    assert main(words.split()) == 2
    assert "belongs to the recording; name another file" in capsys.readouterr().err
    assert source.read_bytes() == before
    assert source.with_suffix(".json").read_text(encoding="utf-8") == '{"unit": "g"}'


def test_match_compares_by_further_metrics_when_asked(
    recording: Path, facts: Callable[..., dict[str, Any]]
) -> None:
    facts(f"reduce {recording} --reducer say321 -o out.wav")
    bumps = condition(make_scene("bumps", duration_s=0.5), Conditioning()).acceleration
    asked = " ".join(f"--metric {name}" for name in RIVALS)
    found = facts(f"match {recording} out.wav {asked}")
    for name in RIVALS:
        assert found[name] == pytest.approx(METRICS[name](bumps, bumps[1], 10000.0), abs=1e-4)


def test_what_is_undefined_is_null_in_json(tmp_path: Path, capsys: Capture) -> None:
    path, output = tmp_path / "silent.csv", tmp_path / "o.wav"
    np.savetxt(path, np.zeros((500, 3)), delimiter=",", header="x_g,y_g,z_g", comments="")
    words = [str(path), "--rate-hz", "1000"]
    assert main(["reduce", *words, "--reducer", "sax321", "-o", str(output), "--json"]) == 0
    for text in (capsys.readouterr().out, output.with_suffix(".json").read_text(encoding="utf-8")):
        assert json.loads(text, parse_constant=pytest.fail)["lowest_hz"] is None
    assert main(["match", *words, str(output), "--json"]) == 1
    shown, blamed = capsys.readouterr()
    found = json.loads(shown, parse_constant=pytest.fail)
    assert [found[name] for name in MATCHES] == [None, None, None]
    assert set(found["reasons"]) == set(MATCHES)
    assert "feel321: silent: spectral_match: the recording has no energy from 20 to" in blamed
    assert main(["match", *words, str(output)]) == 1
    none = "temporal_match all three axes of the recording are silent\n"
    assert none in capsys.readouterr().out


def test_reduce_conditions_as_a_study_does_and_raw_opts_out(
    tmp_path: Path, facts: Callable[..., dict[str, Any]]
) -> None:
    time = np.arange(4000) / 2000
    wanted = make_scene("bumps", duration_s=2.0).acceleration[:, ::5]
    swing = wanted + 9.81 + 3 * np.sin(2 * np.pi * 1.5 * time)
    path, output = write_csv(tmp_path / "swing.csv", swing, 2000.0), tmp_path / "o.wav"
    recording = read_recording(path)
    for options, steps in (("", Conditioning()), ("--raw", None)):
        as_study = recording if steps is None else condition(recording, steps)
        made = facts(f"reduce {path} --reducer say321 --force -o {output} {options}")
        np.testing.assert_allclose(read_wav(output)[0], as_study.acceleration[1], atol=1e-5)
        assert made["conditioning"] == (None if steps is None else asdict(steps))
        assert made["steps"] == ([] if steps is None else list_steps(steps, 2000.0))
        expected = spectral_match(as_study.acceleration, as_study.acceleration[1], 2000.0)
        said = facts(f"match {path} {output}")
        assert said["spectral_match"] == pytest.approx(expected, abs=1e-4)
        assert said["conditioning"] == made["conditioning"]
        assert said["conditioning_from"] == "as o.json says"
        output.with_suffix(".json").rename(tmp_path / "other.json")
        said = facts(f"match {path} {output} {options}")  # nothing says it: as for a study
        assert said["spectral_match"] == pytest.approx(expected, abs=1e-4)
        assumed = "assumed: no o.json of reduce beside it"
        assert said["conditioning_from"] == (options or assumed)


@pytest.mark.parametrize(
    ("change", "options", "code", "message"),
    [
        ({}, "--raw", 2, "--raw: o.json says that its WAV was reduced from the conditioned"),
        ({"conditioning": {"speed": 3}}, "", 1, "feel321: o.json: invalid conditioning ("),
        (
            {"conditioning": {"high_pass_hz": -1}},
            "",
            1,
            "feel321: o.json: invalid conditioning (high_pass_hz must be",
        ),
        ({"recording_sha256": "0"}, "", 0, "feel321: warning: o.json: was written for another"),
        (None, "", 1, "feel321: o.json: not JSON ("),
    ],
)
def test_match_compares_like_with_like_or_says_why_not(
    change: dict[str, Any] | None, options: str, code: int, message: str, recording: Path,
    tmp_path: Path, facts: Callable[..., dict[str, Any]], capsys: Capture,
) -> None:  # fmt: skip
    made = facts(f"reduce {recording} --reducer dft321 -o o.wav")
    text = "{" if change is None else json.dumps(made | change)
    (tmp_path / "o.json").write_text(text, encoding="utf-8")
    assert main(f"match {recording} o.wav {options}".split()) == code
    assert message in capsys.readouterr().err


def test_a_recording_that_cannot_be_conditioned_can_still_be_taken_raw(
    tmp_path: Path, capsys: Capture
) -> None:
    path, noise = tmp_path / "slow.csv", np.random.default_rng(1).normal(size=(50, 3))
    np.savetxt(path, noise, delimiter=",", header="x_g,y_g,z_g", comments="")
    words = f"reduce {path} --rate-hz 30 --reducer sax321 -o {tmp_path / 'o.wav'}".split()
    assert main(words) == 1
    said = "feel321: slow: highpass must be below the Nyquist frequency of 15 Hz, got 20.0 Hz"
    assert capsys.readouterr().err.endswith(f"{said}; or use it as it was measured, with --raw\n")
    assert main([*words, "--raw"]) == 0
    assert "spectral_match the recording is too short" in capsys.readouterr().out


def test_reading_options_reach_the_reader_and_warnings_go_to_stderr(
    tmp_path: Path, capsys: Capture
) -> None:
    path, table = tmp_path / "plain.csv", np.random.default_rng(1).normal(size=(500, 3))
    np.savetxt(path, table, delimiter=",", header="a,b,c", comments="")
    words = f"reduce {path} --rate-hz 5000 --columns 2,b,0 --raw --reducer sax321 --out"
    assert main([*words.split(), str(tmp_path / "o.wav")]) == 0
    assert "feel321: warning: plain: " in capsys.readouterr().err
    np.testing.assert_allclose(read_wav(tmp_path / "o.wav")[0], table[:, 2], atol=1e-6)
    assert main([*words.split(), str(tmp_path / "quiet.wav"), "--quiet"]) == 0
    assert capsys.readouterr().err == ""
