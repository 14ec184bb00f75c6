"""The command line in one process: what each verb prints, and how each refuses."""

from __future__ import annotations

import errno
import json
import re
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.report import association
from feel321.analysis.table.reading import Further
from feel321.files import write_text
from feel321.names import MATCHES
from feel321.stimuli.condition import Conditioning, condition, list_steps
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.match import spectral_match
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rivals.catalog import RIVALS
from feel321.stimuli.synthesis import make_scene
from feel321.stimuli.wav import read_wav, write_wav
from feel321.study import cli
from feel321.study.actuator import doctor
from feel321.study.cli import main
from feel321.study.commands import shared
from feel321.study.folder import read_template

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.study.folder import StudyFolder

    Capture = pytest.CaptureFixture[str]

VERBS = [verb for verbs in cli.GROUPS.values() for verb in verbs]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    bumps = make_scene("bumps", duration_s=0.5)
    path = tmp_path / "bumps.csv"
    table = np.column_stack([np.arange(bumps.n_samples) / bumps.rate_hz, bumps.acceleration.T])
    np.savetxt(path, table, delimiter=",", header="time_s,x_m/s^2,y_m/s^2,z_m/s^2", comments="")
    return path


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_explains_itself_with_an_example(verb: str, capsys: Capture) -> None:
    assert main([verb, "--help"]) == 0
    assert re.search(rf"Example: feel321 {verb} ", capsys.readouterr().out)


def test_help_lists_every_verb_and_version_answers(capsys: Capture) -> None:
    assert main(["--help"]) == 0
    listed = re.findall(r"^  (\w+)  ", capsys.readouterr().out, flags=re.MULTILINE)
    assert listed == VERBS
    assert len(VERBS) <= 21
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert "..." not in shown.partition("Design:")[2]
    groups = re.findall(r"^(\w+):$", shown, flags=re.MULTILINE)
    assert groups == ["Options", *cli.GROUPS]
    assert main(["--version"]) == 0
    assert re.fullmatch(r"feel321, version \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["biuld"], "No such command 'biuld'. Did you mean 'build'?; see: feel321 --help"),
        ([], "Missing command; see: feel321 --help"),
        (
            ["match"],
            "Missing argument 'RECORDING'; see: feel321 match --help, for example: feel321 match ",
        ),
        (["status", "--rehearsals="], "see: feel321 status --help"),
        (["run", "--participant"], "requires an argument; see: feel321 run --help, for example: "),
        (["build", "--wrokers", "2"], "No such option '--wrokers'. Did you mean"),
        (
            ["build", "--workers", "0"],
            "Invalid value for '--workers': 0 is not in the range 1 to 1024",
        ),
        (["simulate", "--participants", "10001"], "10001 is not in the range 1 to 10000"),
        (["analyze", "--manifest", "m.csv"], "--manifest needs --ratings; give both"),
        (["analyze", "--ratings", "r.csv"], "add --manifest FILE, or name the study first"),
        (
            ["reduce", "{recording}", "--reducer", "dft", "-o", "a.wav"],
            f"reducer must be one of {', '.join(REDUCERS)}; got 'dft'",
        ),
        (
            ["reduce", "{recording}", "--reducer", "sax321", "-o", "a.wav", "--window-ms", "20"],
            "--window-ms: sax321 has no window; those with one: pca321_adaptive, dft321_windowed, "
            "dft321_principal_windowed",
        ),
        (
            [
                "reduce",
                "{recording}",
                "--reducer",
                "dft321_windowed",
                "-o",
                "a.wav",
                "--window-ms",
                "0",
            ],
            "--window-ms must be a finite time above 0 ms, got 0; see: feel321 reduce --help",
        ),
    ],
)
def test_wrong_use_is_one_line_and_exit_2(
    arguments: list[str], message: str, recording: Path, capsys: Capture
) -> None:
    assert main([argument.format(recording=recording) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert err.startswith("feel321: ")
    assert message in err


@pytest.mark.parametrize("verb", ["check", "build", "simulate", "status", "audit", "analyze"])
def test_verbs_on_a_folder_that_is_no_study_say_so(
    verb: str, tmp_path: Path, capsys: Capture
) -> None:
    assert main([verb, str(tmp_path)]) == 1
    message = f"feel321: no study.toml in {tmp_path}; name a study, or begin one with: feel321 new"
    assert capsys.readouterr().err.startswith(message)


def test_the_hidden_switch_shows_where_an_error_comes_from(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no study\.toml in"):
        main(["--traceback", "status", str(tmp_path)])


@pytest.mark.parametrize("name", REDUCERS)
def test_reduce_writes_what_the_reducer_gives_and_match_reads_it(
    name: str, recording: Path, tmp_path: Path, capsys: Capture
) -> None:
    output = tmp_path / "out.wav"
    assert main(["reduce", str(recording), "--reducer", name, "-o", str(output), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    samples, rate_hz = read_wav(output)
    bumps = condition(make_scene("bumps", duration_s=0.5), Conditioning())
    assert rate_hz == 10000
    np.testing.assert_allclose(samples, REDUCERS[name](bumps.acceleration, 10000.0), atol=1e-4)
    assert facts == json.loads(output.with_suffix(".json").read_text(encoding="utf-8"))
    assert (facts["reducer"], facts["unit"], facts["recording"]) == (name, "m/s^2", "bumps")
    assert main(["match", str(recording), str(output), "--json"]) == 0
    matches = json.loads(capsys.readouterr().out)
    assert matches["spectral_match"] == pytest.approx(facts["spectral_match"], abs=1e-4)
    assert matches["temporal_match"] == pytest.approx(facts["temporal_match"], abs=1e-4)
    for metric in MATCHES:
        direct = METRICS[metric](
            bumps.acceleration, REDUCERS[name](bumps.acceleration, 10000.0), 10000.0
        )
        assert facts[metric] == pytest.approx(direct, abs=1e-9)
    details = {
        "n_frequencies",
        "n_left_out",
        "lowest_hz",
        "highest_hz",
        "silent_axes",
        "n_samples",
        "rate_hz",
    }
    assert details <= set(matches)


def test_every_real_recording_goes_through_reduce_and_match(
    shared_recordings: Path, tmp_path: Path, capsys: Capture
) -> None:
    sources = [
        path
        for path in sorted(shared_recordings.iterdir())
        if path.suffix in {".csv", ".npz", ".wav"}
    ]
    assert len(sources) == 11
    for source in sources:
        output = tmp_path / f"{source.stem}.wav"
        assert main(["reduce", str(source), "--reducer", "dft321", "-o", str(output)]) == 0
        capsys.readouterr()
        assert main(["match", str(source), str(output), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["spectral_match"] == pytest.approx(1.0, abs=1e-4)


def test_reduce_and_match_speak_in_words_too(
    recording: Path, tmp_path: Path, capsys: Capture
) -> None:
    output = str(tmp_path / "out.wav")
    assert main(["reduce", str(recording), "--reducer", "dft321", "-o", output]) == 0
    words = capsys.readouterr().out
    assert "bumps through dft321, 5000 samples, m/s^2" in words
    assert "spectral match 1.0000" in words
    assert main(["match", str(recording), output]) == 0
    assert "temporal match" in capsys.readouterr().out


def test_the_window_is_that_of_the_option(recording: Path, tmp_path: Path) -> None:
    for window in ("20", "50"):
        options = [
            "--reducer",
            "dft321_windowed",
            "--window-ms",
            window,
            "-o",
            str(tmp_path / f"{window}.wav"),
        ]
        assert main(["reduce", str(recording), *options]) == 0
    short, long = (read_wav(tmp_path / f"{window}.wav")[0] for window in ("20", "50"))
    assert np.abs(short - long).max() > 0.01
    bumps = condition(make_scene("bumps", duration_s=0.5), Conditioning())
    expected = REDUCERS["dft321_windowed"](bumps.acceleration, 10000.0, window_s=0.02)  # type: ignore[call-arg] - not in the common calling form
    np.testing.assert_allclose(short, expected, atol=1e-4)


def test_reduce_overwrites_only_when_told(recording: Path, tmp_path: Path, capsys: Capture) -> None:
    output = tmp_path / "out.wav"
    output.write_bytes(b"mine")
    arguments = ["reduce", str(recording), "--reducer", "sax321", "-o", str(output)]
    assert main(arguments) == 1
    assert "out.wav: already exists; name another file or add --force" in capsys.readouterr().err
    assert output.read_bytes() == b"mine"
    assert main([*arguments, "--force"]) == 0
    assert len(read_wav(output)[0]) == 5000


@pytest.mark.parametrize("name", ["out.json", "out.csv", "out", "bumps.csv"])
def test_reduce_writes_nothing_but_wav(
    name: str, recording: Path, tmp_path: Path, capsys: Capture
) -> None:
    before = recording.read_bytes()
    arguments = [
        "reduce",
        "-o",
        str(tmp_path / name),
        str(recording),
        "--reducer",
        "sax321",
        "--force",
    ]
    assert main(arguments) == 2
    assert "give it that ending" in capsys.readouterr().err
    assert recording.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["bumps.csv"]


@pytest.mark.parametrize("output", ["raw.wav", "link.wav", "other.wav"])
def test_reduce_never_writes_over_the_recording_or_its_sidecar(
    output: str, tmp_path: Path, capsys: Capture
) -> None:
    write_wav(tmp_path / "raw.wav", np.ones((3, 500)), 1000)
    (tmp_path / "raw.json").write_text('{"unit": "g"}', encoding="utf-8")
    (tmp_path / "link.wav").symlink_to("raw.wav")
    (tmp_path / "other.json").hardlink_to(tmp_path / "raw.json")
    before = (tmp_path / "raw.wav").read_bytes()
    arguments = [
        "reduce",
        str(tmp_path / "raw.wav"),
        "--reducer",
        "sax321",
        "-o",
        str(tmp_path / output),
        "--force",
    ]
    assert main(arguments) == 2
    assert "belongs to the recording; name another file" in capsys.readouterr().err
    assert (tmp_path / "raw.wav").read_bytes() == before
    assert (tmp_path / "raw.json").read_text(encoding="utf-8") == '{"unit": "g"}'


def test_match_compares_by_rivals_when_asked(
    recording: Path, tmp_path: Path, capsys: Capture
) -> None:
    output = tmp_path / "out.wav"
    assert main(["reduce", str(recording), "--reducer", "say321", "-o", str(output)]) == 0
    capsys.readouterr()
    assert main(["match", str(recording), str(output), "--rivals", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    bumps = condition(make_scene("bumps", duration_s=0.5), Conditioning())
    assert list(facts["rivals"]) == list(RIVALS)
    for name, value in facts["rivals"].items():
        direct = METRICS[name](bumps.acceleration, bumps.acceleration[1], 10000.0)
        assert value == pytest.approx(direct, abs=1e-4)
    assert main(["match", str(recording), str(output), "--rivals"]) == 0
    shown = capsys.readouterr().out
    assert f"level difference {facts['rivals']['level_difference']:.4f} dB (lower is" in shown
    assert "envelope correlation 0." in shown
    assert main(["match", str(recording), str(output), "--json"]) == 0
    assert "rivals" not in json.loads(capsys.readouterr().out)


def test_what_is_undefined_is_null_in_json(tmp_path: Path, capsys: Capture) -> None:
    path, output = tmp_path / "silent.csv", tmp_path / "o.wav"
    np.savetxt(path, np.zeros((500, 3)), delimiter=",", header="x_g,y_g,z_g", comments="")
    arguments = [str(path), "--rate-hz", "1000", "--json"]
    assert main(["reduce", *arguments, "--reducer", "sax321", "-o", str(output)]) == 0
    for text in (capsys.readouterr().out, output.with_suffix(".json").read_text(encoding="utf-8")):
        assert json.loads(text, parse_constant=pytest.fail)["lowest_hz"] is None
    assert main(["match", *arguments[:1], str(output), *arguments[1:]]) == 1
    shown, blamed = capsys.readouterr()
    facts = json.loads(shown, parse_constant=pytest.fail)
    assert [facts[name] for name in MATCHES] == [None, None, None]
    assert set(facts["reasons"]) == set(MATCHES)
    assert blamed.splitlines()[-1].startswith(
        "feel321: silent: spectral_match: the recording has no energy from 20 to"
    )
    assert main(["match", *arguments[:1], str(output), *arguments[1:-1]]) == 1
    assert (
        "temporal match none: all three axes of the recording are silent\n"
        in capsys.readouterr().out
    )


def test_reduce_conditions_as_a_study_does_and_raw_opts_out(
    tmp_path: Path, capsys: Capture
) -> None:
    path, output = tmp_path / "swing.csv", tmp_path / "o.wav"
    time = np.arange(4000) / 2000
    wanted = make_scene("bumps", duration_s=2.0).acceleration[:, ::5]
    swing = wanted + 9.81 + 3 * np.sin(2 * np.pi * 1.5 * time)
    head = "time_s,x_m/s^2,y_m/s^2,z_m/s^2"
    np.savetxt(path, np.column_stack([time, swing.T]), delimiter=",", header=head, comments="")
    reduce, match = (
        ["reduce", str(path), "--reducer", "say321", "--force", "-o", str(output)],
        ["match", str(path)],
    )

    def run(*arguments: str) -> dict[str, Any]:
        assert main([*arguments, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    recording = read_recording(path)
    for options, steps, source in (([], Conditioning(), recording), (["--raw"], None, recording)):
        as_study = source if steps is None else condition(source, steps)
        facts = run(*reduce, *options)
        np.testing.assert_allclose(read_wav(output)[0], as_study.acceleration[1], atol=1e-5)
        assert facts["conditioning"] == (None if steps is None else asdict(steps))
        assert facts["steps"] == ([] if steps is None else list_steps(steps, 2000.0))
        expected = spectral_match(as_study.acceleration, as_study.acceleration[1], 2000.0)
        told = run(*match, str(output))  # as the JSON beside it says
        assert told["spectral_match"] == pytest.approx(expected, abs=1e-4)
        assert (told["conditioning"], told["conditioning_from"]) == (
            facts["conditioning"],
            "as o.json says",
        )
        output.with_suffix(".json").rename(tmp_path / "other.json")
        told = run(*match, str(output), *options)  # nothing says it: as for a study, unless --raw
        assert told["spectral_match"] == pytest.approx(expected, abs=1e-4)
        assert told["conditioning_from"] == (
            "assumed: no o.json of reduce beside it" if steps else "--raw"
        )


def test_match_compares_like_with_like_or_says_why_not(
    recording: Path, tmp_path: Path, capsys: Capture
) -> None:
    output, sidecar = tmp_path / "o.wav", tmp_path / "o.json"
    assert main(["reduce", str(recording), "--reducer", "dft321", "-o", str(output)]) == 0
    done = "conditioning of the recording: offset removed, high-pass 20 Hz, low-pass 1000 Hz\n"
    assert done in capsys.readouterr().out
    match = ["match", str(recording), str(output)]
    assert main([*match, "--raw"]) == 2
    assert (
        "--raw: o.json says that its WAV was reduced from the conditioned recording"
        in capsys.readouterr().err
    )
    facts = json.loads(sidecar.read_text(encoding="utf-8"))
    for change, code, message in (
        ({"conditioning": {"speed": 3}}, 1, "feel321: o.json: invalid conditioning ("),
        (
            {"conditioning": {"high_pass_hz": -1}},
            1,
            "feel321: o.json: invalid conditioning (high_pass_hz must be",
        ),
        (
            {"recording_sha256": "0"},
            0,
            "feel321: warning: o.json: was written for another recording or file than",
        ),
    ):
        sidecar.write_text(json.dumps(facts | change), encoding="utf-8")
        assert main(match) == code
        assert capsys.readouterr().err.startswith(message)
    sidecar.write_text("{", encoding="utf-8")
    assert main(match) == 1
    assert capsys.readouterr().err.startswith("feel321: o.json: not JSON (")
    sidecar.write_text('{"unit": "g"}', encoding="utf-8")
    assert main([*match, "--json"]) == 0
    assert (
        json.loads(capsys.readouterr().out)["conditioning_from"]
        == "assumed: no o.json of reduce beside it"
    )
    older = {name: value for name, value in facts.items() if name not in {"conditioning", "steps"}}
    sidecar.write_text(json.dumps(older), encoding="utf-8")
    assert main([*match, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["conditioning"] is None


def test_a_recording_that_cannot_be_conditioned_can_still_be_taken_raw(
    tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / "slow.csv"
    np.savetxt(
        path,
        np.random.default_rng(1).normal(size=(50, 3)),
        delimiter=",",
        header="x_g,y_g,z_g",
        comments="",
    )
    arguments = [
        "reduce",
        str(path),
        "--rate-hz",
        "30",
        "--reducer",
        "sax321",
        "-o",
        str(tmp_path / "o.wav"),
    ]
    assert main(arguments) == 1
    told = "feel321: slow: highpass must be below the Nyquist frequency of 15 Hz, got 20.0 Hz"
    assert capsys.readouterr().err.endswith(f"{told}; or use it as it was measured, with --raw\n")
    assert main([*arguments, "--raw"]) == 0
    assert (
        "spectral match none: the recording is too short, or its rate too low"
        in capsys.readouterr().out
    )


def test_reading_options_reach_the_reader_and_warnings_go_to_stderr(
    tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / "plain.csv"
    np.savetxt(
        path,
        np.random.default_rng(1).normal(size=(500, 3)),
        delimiter=",",
        header="a,b,c",
        comments="",
    )
    options = [
        "--rate-hz",
        "5000",
        "--columns",
        "2,b,0",
        "--raw",
        "--reducer",
        "sax321",
        "-o",
        str(tmp_path / "o.wav"),
    ]
    assert main(["reduce", str(path), *options]) == 0
    assert "feel321: warning: plain: " in capsys.readouterr().err
    third = np.loadtxt(path, delimiter=",", skiprows=1)[:, 2]
    np.testing.assert_allclose(read_wav(tmp_path / "o.wav")[0], third, atol=1e-6)


def test_reduce_into_a_folder_that_is_not_there_says_so(
    recording: Path, tmp_path: Path, capsys: Capture
) -> None:
    output = tmp_path / "no" / "out.wav"
    assert main(["reduce", str(recording), "--reducer", "sax321", "-o", str(output)]) == 1
    assert (
        capsys.readouterr().err
        == f"feel321: {output.parent}: there is no such folder; make it first\n"
    )


def test_an_error_of_the_system_names_the_file(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert main(["new", str(tmp_path / "file" / "study")]) == 1
    place = tmp_path / "file"
    assert capsys.readouterr().err.startswith(f"feel321: {place}: File exists;")


@pytest.mark.parametrize(
    ("samples", "rate_hz", "message"),
    [
        (
            np.ones(4999),
            10000,
            "got 4999 samples, bumps has 5000; both must cover the same samples, nothing is cut",
        ),
        (np.ones((3, 5000)), 10000, "a reduced signal has 1 channel, got 3; reduce it first"),
        (np.ones(5000), 8000, "got 8000 Hz, bumps has 10000 Hz; both must have one rate"),
    ],
)
def test_match_refuses_what_does_not_belong_together(
    samples: np.ndarray,
    rate_hz: int,
    message: str,
    recording: Path,
    tmp_path: Path,
    capsys: Capture,
) -> None:
    write_wav(tmp_path / "r.wav", samples, rate_hz)
    assert main(["match", str(recording), str(tmp_path / "r.wav")]) == 1
    assert capsys.readouterr().err == f"feel321: r.wav: {message}\n"


def test_a_study_from_new_to_report(
    study: StudyFolder, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = str(study.path)
    assert main(["check", folder]) == 0
    assert capsys.readouterr().out.splitlines()[0] == f"{folder}: no problems"
    assert main(["build", folder, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["stimuli"] == 2 * (3 + 1 + 2)
    assert main(["build", folder]) == 0
    assert "12 stimuli, set " in capsys.readouterr().out
    assert main(["simulate", folder, "--participants", "4", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    planted = facts.pop("planted")
    assert facts == {"participants": 4, "ratings": 96, "file": str(study.ratings)}
    assert planted == pytest.approx(
        {"spectral_match_bounded": 4.5, "temporal_match": 3.5}, rel=0.05
    )
    assert main(["simulate", folder, "--participants", "4"]) == 0
    said = f"{planted['spectral_match_bounded']:.2f} per +0.1 of spectral_match_bounded, "
    said += f"{planted['temporal_match']:.2f} per +0.1 of temporal_match"
    assert (
        capsys.readouterr().out
        == f"{study.ratings}: 96 ratings\nplanted in realism, in points: {said}\n"
    )
    assert main(["status", folder, "--json"]) == 0
    assert [entry["done"] for entry in json.loads(capsys.readouterr().out)["participants"]] == [
        24
    ] * 4
    with study.journals[0].open("ab") as file:
        file.write(b"{}")
    assert main(["status", folder]) == 0
    assert "2 bytes of an unfinished line, moved aside on resuming" in (
        table := capsys.readouterr().out
    )
    assert (
        len(re.findall(r"^sim00\d +finished +24 +0 .*\(simulated\)", table, flags=re.MULTILINE))
        == 4
    )
    assert main(["simulate", folder, "--participants", "4"]) == 0
    assert "feel321: warning: " in (err := capsys.readouterr().err)
    assert "2 bytes of an unfinished line were moved to" in err
    assert main(["audit", folder]) == 0
    clean, compared = capsys.readouterr().out.splitlines()
    assert compared.startswith("compared with 3 checkpoints, the last ")
    assert clean == f"{folder}: 4 journals, no contradiction in them"
    # What follows is about files only: whole reports are written in tests/analysis.
    monkeypatch.setattr(
        "feel321.analysis.report.write.SECTIONS", (association.compute_association,)
    )
    assert main(["analyze", folder]) == 0
    assert capsys.readouterr().out == f"{study.report / 'index.html'}\n"
    assert (study.report / "index.html").stat().st_size > 1000
    journals = [path.read_text(encoding="utf-8") for path in study.path.glob("sessions/*/*.jsonl")]
    rated = [json.loads(line) for text in journals for line in text.splitlines()]
    day = max(one["utc"] for one in rated if one["event"] == "rated")[:10]
    about = json.loads((study.report / "results.json").read_text(encoding="utf-8"))["about"]
    assert about == {"name": study.path.name, "date": day}
    tables = [
        "--ratings",
        str(study.ratings),
        "--manifest",
        str(study.manifest),
        "--out",
        str(tmp_path / "else"),
    ]
    assert main(["analyze", *tables, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(
        (tmp_path / "else" / "results.json").read_text()
    )
    assert main(["analyze", folder, "--ratings", str(study.ratings)]) == 0


def test_findings_are_printed_and_the_exit_code_is_1(study: StudyFolder, capsys: Capture) -> None:
    folder = str(study.path)
    main(["build", folder])
    main(["simulate", folder, "--participants", "1"])
    last = len(study.journals[0].read_bytes().splitlines()) + 1
    with study.journals[0].open("ab") as file:
        file.write(b"{}\n")
    study.settings.write_text("[rig]\nzzz = 1\n[[recordings]]\nscene = 'x'\n", encoding="utf-8")
    capsys.readouterr()
    assert main(["audit", folder]) == 1
    assert f"line {last}: was changed after it was written" in capsys.readouterr().out
    assert main(["audit", folder, "--json"]) == 1
    broken, changed = json.loads(capsys.readouterr().out)["findings"]
    assert f"line {last}: was changed" in broken
    assert changed.startswith(f"{study.settings}: was changed since the checkpoint of ")
    assert main(["check", folder]) == 1
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert main(["check", folder, "--json"]) == 1
    assert len(json.loads(capsys.readouterr().out)["problems"]) == 2


def test_status_shows_a_broken_participant_beside_the_others_and_the_balance(
    study: StudyFolder, capsys: Capture
) -> None:
    (study.sessions / "p01").mkdir(parents=True)
    (study.sessions / "p01" / "plan.json").write_text("null", encoding="utf-8")
    assert main(["status", str(study.path)]) == 0
    _, broken, balance = capsys.readouterr().out.splitlines()
    assert re.match(r"p01 +\? +\?  .*plan\.json", broken)
    assert balance == "balance: no trial was run yet"


def test_new_begins_a_study_and_refuses_to_begin_it_twice(tmp_path: Path, capsys: Capture) -> None:
    assert main(["new", str(tmp_path / "a")]) == 0
    assert (tmp_path / "a" / "study.toml").read_text(encoding="utf-8") == read_template()
    assert main(["new", str(tmp_path / "a")]) == 1
    assert (
        "study.toml: already exists and is not overwritten; move it away or use it"
        in capsys.readouterr().err
    )


def test_the_next_command_can_be_pasted(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "my study"
    assert main(["new", str(folder)]) == 0
    assert capsys.readouterr().out.endswith(f"then: feel321 check '{folder}'\n")


def test_an_empty_name_is_not_this_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", ""]) == 2
    assert "a name must not be empty" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_study_that_is_not_there_or_a_file_is_told_from_a_folder(
    study: StudyFolder, capsys: Capture
) -> None:
    nowhere = study.path / "no where"
    assert main(["check", str(nowhere)]) == 1
    message = f"{nowhere}: no such folder; begin a study with: feel321 new '{nowhere}'"
    assert capsys.readouterr().err == f"feel321: {message}\n"
    assert main(["analyze", str(study.settings)]) == 1
    message = f"{study.settings}: a study must be a folder, got a file; try {study.path}"
    assert capsys.readouterr().err == f"feel321: {message}\n"


def test_draws_and_seed_of_a_study_reach_its_report(
    study: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[dict[str, int]] = []

    def write_report(_ratings: Path, _manifest: Path, folder: Path, **choices: Any) -> None:
        calls.append({name: choices[name] for name in ("draws", "rng")})
        folder.mkdir(exist_ok=True)

    monkeypatch.setattr("feel321.analysis.report.write.write_report", write_report)
    monkeypatch.setattr("feel321.study.analyze.write_report", write_report)
    monkeypatch.setattr("feel321.study.export.narrative.write_methods", lambda *_: None)
    monkeypatch.setattr("feel321.study.analyze.read_stimuli", lambda _: None)
    monkeypatch.setattr("feel321.study.analyze.write_ratings", lambda *_: 1)
    monkeypatch.setattr(
        "feel321.study.analyze.measure_rotations", lambda *_, **__: Further(pd.DataFrame())
    )
    elsewhere = study.path / "else"
    elsewhere.mkdir()
    tables = ["--ratings", "r.csv", "--manifest", "m.csv"]
    assert main(["analyze", str(study.path)]) == 0
    assert main(["analyze", str(study.path), *tables[:2]]) == 0
    assert main(["analyze", str(elsewhere), *tables]) == 0
    assert calls == [{"draws": 200, "rng": 5}, {"draws": 200, "rng": 5}, {"draws": 2000, "rng": 0}]


def test_a_table_that_would_be_the_same_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "ratings.csv"
    write_text(path, "ä\r\n")
    before = path.stat()
    write_text(path, "ä\r\n")
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    write_text(path, "b\n")
    assert path.read_bytes() == b"b\n"


def test_demo_leaves_other_peoples_folders_alone(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "thesis.txt").write_text("dear", encoding="utf-8")
    assert main(["demo", "--out", str(tmp_path)]) == 1
    assert (
        "holds files that demo did not write; name another folder with --out"
        in capsys.readouterr().err
    )
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_demo_leaves_a_study_of_another_version_or_an_edited_one_alone(
    tmp_path: Path, capsys: Capture
) -> None:
    assert main(["new", str(tmp_path)]) == 0
    with (tmp_path / "study.toml").open("a", encoding="utf-8") as file:
        file.write("# mine\n")
    capsys.readouterr()
    assert main(["demo", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == (
        f"feel321: {tmp_path}/study.toml: edited, or written by another version of feel321, so this is not the study "
        "that demo runs; name another folder with --out, or delete this one\n"
    )
    assert not (tmp_path / "stimuli").exists()


def test_demo_adds_nobody_to_a_study_in_which_people_took_part(
    tmp_path: Path, capsys: Capture
) -> None:
    assert main(["new", str(tmp_path / "oak")]) == 0
    own = tmp_path / "oak" / "sessions" / "p07" / "plan.json"
    own.parent.mkdir(parents=True)
    own.write_text("{}", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    capsys.readouterr()
    assert main(["demo", "--out", str(tmp_path / "oak")]) == 1
    assert capsys.readouterr() == (
        "",
        f"feel321: {tmp_path}/oak: holds a session of p07, who is no simulated participant; "
        "name another folder with --out\n",
    )
    assert sorted(tmp_path.rglob("*")) == before


def fail_with(error: BaseException) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def test_ctrl_c_is_one_line_and_exit_130(
    study: StudyFolder, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr("feel321.study.status.read_status", fail_with(KeyboardInterrupt()))
    assert main(["status", str(study.path)]) == 130
    assert capsys.readouterr().err == "feel321: interrupted\n"
    monkeypatch.setattr("feel321.study.workflow.build_study", fail_with(KeyboardInterrupt()))
    assert main(["build", str(study.path)]) == 130
    assert (
        capsys.readouterr().err
        == "feel321: interrupted; what is done is kept, the same command continues\n"
    )


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            KeyError("no\nway"),
            "unexpected KeyError: 'no\\nway'; run again with feel321 --traceback and report it",
        ),
        (
            RecursionError("deep\ndown"),
            "unexpected RecursionError: deep down; run again with feel321 --traceback",
        ),
        (
            OSError(errno.ENOSPC, "No space left on device"),
            "No space left on device; make room there and run again",
        ),
        (
            OSError(errno.EIO, "Input/output error", "a.csv"),
            "a.csv: Input/output error; check the name",
        ),
    ],
)
def test_whatever_goes_wrong_is_one_line_and_exit_1(
    error: Exception,
    message: str,
    study: StudyFolder,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    monkeypatch.setattr("feel321.study.status.read_status", fail_with(error))
    assert main(["status", str(study.path)]) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"feel321: {message}")
    assert err.count("\n") == 1
    with pytest.raises(type(error)):
        main(["--traceback", "status", str(study.path)])


def test_a_full_disk_names_the_file_that_was_to_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    folder = tmp_path / "new"
    monkeypatch.setattr(
        "feel321.files.os.fsync", fail_with(OSError(errno.ENOSPC, "No space left on device"))
    )
    assert main(["new", str(folder)]) == 1
    message = f"feel321: {folder}: No space left on device; make room there and run again\n"
    assert capsys.readouterr().err == message
    assert not [*folder.iterdir()]


def test_progress_needs_no_stderr(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    with shared.show_progress("build") as progress:
        progress(1, 2)


def test_progress_is_drawn_on_a_terminal_only(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    for terminal in (True, False):
        monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
        with shared.show_progress("build") as progress:
            progress(1, 2)
            progress(2, 2)
        assert ("build: " in capsys.readouterr().err) == terminal


def test_every_exit_code_is_documented() -> None:
    assert cli.__doc__ is not None
    codes = (cli.DONE, cli.COULD_NOT, cli.WRONG_USE, cli.INTERRUPTED)
    assert all(str(code) in cli.__doc__ for code in codes)


@pytest.mark.parametrize(("failed", "underruns", "code"), [(0, 0, 0), (1, 0, 1), (0, 1, 1)])
def test_doctor_fails_where_a_pulse_failed_or_the_device_ran_dry(
    failed: int, underruns: int, code: int, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    found = doctor.Examination(
        "coil", "ALSA", 48000.0, 20.0, 10, failed, underruns, 30.0, 0.1, 0.2, None, None, None, None, 1.0,
        is_program=False, error="",
    )  # fmt: skip
    monkeypatch.setattr(doctor, "survey_devices", list)
    monkeypatch.setattr(doctor, "examine_rig", lambda *_, **__: found)
    assert main(["doctor", "--device", "coil"]) == code
    assert f"pulses 10, failed {failed}, underruns {underruns}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("estimated", "told"),
    [
        (0, "; onset times are the device's own\n"),
        (4, "; 4 of 10 onset times are estimated from the latency: the device gives none\n"),
    ],
)
@pytest.mark.parametrize("as_json", [[], ["--json"]])
def test_doctor_says_how_onset_times_were_got_and_fails_on_a_faulty_sensor(
    estimated: int, told: str, as_json: list[str], monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    sensor = doctor.SensorCheck((), 10, 0.01, 0.01, fault="sensor on channel 3: got no pulse")
    found = doctor.Examination(
        "coil", "ALSA", 48000.0, 20.0, 10, 0, 0, 30.0, 0.1, 0.2, None, None, None, None, 1.0,
        is_program=False, error="", n_estimated=estimated, sensor=sensor,
    )  # fmt: skip
    monkeypatch.setattr(doctor, "survey_devices", list)
    monkeypatch.setattr(doctor, "examine_rig", lambda *_, **__: found)
    assert main(["doctor", "--device", "coil", *as_json]) == 1
    printed = capsys.readouterr()
    assert printed.err == "feel321: sensor on channel 3: got no pulse\n"
    if as_json:
        assert json.loads(printed.out)["examination"]["sensor"]["lags_ms"] == []
    else:
        assert told in printed.out
        assert "sensor: pulse found in 0 of 10 recordings, 0.01 m/s² RMS" in printed.out
