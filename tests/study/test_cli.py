"""The command line in one process: its help, how it refuses, and what the verbs of a study print."""

import errno
import gc
import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from cyclopts import Argument
from cyclopts.annotations import resolve_optional

from feel321.analysis.report.write import SECTIONS
from feel321.study import cli
from feel321.study.actuator import doctor
from feel321.study.cli import APP, VERBS, main
from feel321.study.folder import StudyFolder, create_study, read_template

Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_explains_itself_every_option_and_an_example(verb: str, capsys: Capture) -> None:
    said = []
    for option in ("-h", "--help"):
        assert main([verb, option]) == 0
        said.append(capsys.readouterr().out)
    assert said[0] == said[1]
    assert re.search(rf"Example: feel321 {verb} ", said[0])
    rows = [*list_options(verb), "-q, --quiet", "-h, --help"]
    for name in rows:
        assert re.search(rf"^  (-\w, )?{name}[ \n]", said[0], re.MULTILINE), name
    assert "\x1b" not in said[0]
    empty = re.findall(r"^  -\S+( [A-Z/=,.]+)?$\n  -", said[0], re.MULTILINE)
    assert empty == []  # each has its sentence


def find_arguments(verb: str) -> list[Argument]:
    found = APP[verb].assemble_argument_collection(parse_docstring=True)
    return [one for one in found if one.parse and not one.children]


def list_options(verb: str) -> list[str]:
    return [one.name for one in find_arguments(verb) if one.name.startswith("-")]


def test_help_lists_every_verb_by_group_and_version_answers(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    for width in ("100", "50"):
        monkeypatch.setenv("COLUMNS", width)
        assert main(["--help"]) == 0
        shown = capsys.readouterr().out
        listed = re.findall(r"^  (\w+)  ", shown, flags=re.MULTILINE)
        assert listed == [*VERBS]
        assert "Relate the ratings to the match metrics and write the report." in " ".join(
            shown.split()
        )
        assert max(map(len, shown.splitlines())) <= int(width)
    assert len(VERBS) <= 21
    assert re.findall(r"^(\w+):$", shown, flags=re.MULTILINE) == ["Options", *cli.GROUPS]
    assert main(["--version"]) == 0
    assert re.fullmatch(r"feel321, version \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)


def test_a_shell_completes_verbs_and_choices() -> None:
    script = APP.generate_completion(shell="bash")  # noqa: S604 - the name of a shell
    for word in (*VERBS, "landin2010", "--participants"):
        assert word in script


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("biuld", 'Unknown command "biuld". Did you mean "build"?; see: feel321 --help'),
        ("", "Missing command; see: feel321 --help"),
        ("match", " requires an argument; see: feel321 match --help, for example: feel321 match "),
        ("run", "--participant requires an argument; see: feel321 run --help"),
        ("run --participant", "requires an argument; see: feel321 run --help, for example: "),
        ("status --rehearsals=", "see: feel321 status --help"),
        ("status one two", "got 'two', which is one argument too many"),
        ("build --wrokers 2", "Unknown option: --wrokers. Did you mean --workers?"),
        ("build --workers 0", 'Invalid value "0" for --workers. Allowed: 1 to 1024'),
        ("build --workers x", 'unable to convert "x" into int'),
        (
            "build --scheduler nowhere",
            "for --scheduler. scheduler must be tcp://HOST:PORT or tls://HOST:PORT",
        ),
        ("simulate --participants 10001", "Allowed: 1 to 10000"),
        ("simulate --seed -1", "Allowed: 0 or more"),
        ("check --kind colour", 'Choose from: "reducer", "metric"'),
        ("new a --study landin", 'Did you mean "landin2010"?'),
        ("new a --study park2019 --methods", "--methods adds to a study of your own"),
        ("new", "name the folder of the new study"),
        ("analyze --manifest m.csv", "--manifest needs --ratings; give both"),
        ("analyze --ratings r.csv", "add --manifest FILE, or name the study first"),
        ("power --participants 8,x", "must be whole numbers from 1 to 100000 with commas"),
        ("power --participants 0", "must be whole numbers from 1 to 100000 with commas"),
        ("match a.csv b.wav --unit kg", 'Choose from: "m/s^2", "g", "mg"'),
        (
            "run --participant ../x",
            "for --participant. must be letters (A-Z), digits, - and _, got",
        ),
        (
            "note --participant p1",
            "TEXT requires an argument; see: feel321 note --help, for example: ",
        ),
        ("note a b c --participant p1", "takes a study and TEXT, got 3 words"),
        ("collect", "FROM... requires an argument; see: feel321 collect --help, for example: "),
    ],
)
def test_wrong_use_is_one_line_and_exit_2(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 2
    out, err = capsys.readouterr()
    assert (out, len(err.splitlines())) == ("", 1)
    assert err.startswith("feel321: ")
    assert message in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("run . --participant p1 --seed 1", "--seed needs --simulate-participant"),
        ("export . b --r --simulated", "--simulated is for BIDS"),
        ("status . --watch page.html --notes", "--watch does not go with --notes"),
        ("withdraw . --participant p1", "no terminal to ask for confirmation; add --yes"),
        ("note . --participant p1", ". is a study; name TEXT, too: feel321 note . TEXT"),
    ],
)
def test_options_that_do_not_go_together_are_wrong_use(
    words: str, message: str, study: StudyFolder, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(study.path)
    assert main(words.split()) == 2
    assert capsys.readouterr().err.startswith(f"feel321: {message}")


@pytest.mark.parametrize("words", [["new", ""], ["build", ""], ["demo", "--out", ""]])
def test_an_empty_name_is_not_this_folder(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert "a name must not be empty" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


BAD = ["1e12", "-1e12", "nan", "inf", "-inf", "9" * 10**6]
NUMBERS = [
    (verb, one)
    for verb in VERBS
    for one in find_arguments(verb)
    if resolve_optional(one.hint) in {int, float}
]


@pytest.mark.parametrize(("verb", "option"), NUMBERS)
def test_every_number_of_an_option_has_both_bounds(
    verb: str, option: Argument, capsys: Capture
) -> None:
    assert len(NUMBERS) >= 15
    for text in BAD:
        seed = option.name == "--seed" and text.startswith(("1", "9"))  # any of 64 bits
        if seed and not math.isinf(float(text)):
            continue
        assert main([verb, f"{option.name}={text}"]) == 2
        assert max(map(len, capsys.readouterr().err.splitlines())) < 1100


@pytest.mark.parametrize("verb", ["check", "build", "simulate", "status", "audit", "analyze"])
def test_verbs_on_a_folder_that_is_no_study_say_so(
    verb: str, tmp_path: Path, capsys: Capture
) -> None:
    assert main([verb, str(tmp_path)]) == 1
    message = f"feel321: no study.toml in {tmp_path}; name a study, or begin one with: feel321 new"
    assert capsys.readouterr().err.startswith(message)


def test_a_study_from_new_to_report(
    study: StudyFolder, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = str(study.path)

    def run(*words: str) -> str:
        assert main([*words]) == 0
        return capsys.readouterr().out

    assert run("check", folder).splitlines()[0] == f"{folder}: no problems"
    assert json.loads(run("build", folder, "--json"))["stimuli"] == 2 * (3 + 1 + 2)
    assert "12 stimuli, set " in run("build", folder)
    facts = json.loads(run("simulate", folder, "--participants", "4", "--json"))
    planted = facts.pop("planted")
    assert facts == {"participants": 4, "ratings": 96, "file": str(study.ratings)}
    usual = {"spectral_match_bounded": 4.5, "temporal_match": 3.5}
    assert planted == pytest.approx(usual, rel=0.05)
    said = ", ".join(f"{slope:.2f} per +0.1 of {name}" for name, slope in planted.items())
    again = run("simulate", folder, "--participants", "4")
    assert again == f"{study.ratings}: 96 ratings\nplanted in realism, in points: {said}\n"
    people = json.loads(run("status", folder, "--json"))["participants"]
    assert [entry["answered"] for entry in people] == [24] * 4
    with study.journals[0].open("ab") as file:
        file.write(b"{}")
    table = run("status", folder)
    assert "2 bytes of an unfinished line, moved aside on resuming" in table
    finished = re.findall(r"^sim00\d +finished +24 +0 .*\(simulated\)", table, flags=re.MULTILINE)
    assert len(finished) == 4
    assert main(["simulate", folder, "--participants", "4"]) == 0
    err = capsys.readouterr().err
    assert "feel321: warning: " in err
    assert "2 bytes of an unfinished line were moved to" in err
    clean, compared = run("audit", folder).splitlines()
    assert compared.startswith("compared with 3 checkpoints, the last ")
    assert clean == f"{folder}: 4 journals, no contradiction in them"
    assert run("audit", folder, "--rehearsals").startswith(
        f"{folder}: 0 journals, no contradiction"
    )
    # What follows is about files only: whole reports are written in tests/analysis.
    monkeypatch.setattr("feel321.analysis.report.write.SECTIONS", SECTIONS[2:3])
    assert run("analyze", folder) == f"{study.report / 'index.html'}\n"
    assert (study.report / "index.html").stat().st_size > 1000
    journals = "".join(path.read_text(encoding="utf-8") for path in study.journals)
    records = [json.loads(line) for line in journals.splitlines()]
    day = max(one["utc"] for one in records if one["event"] == "rated")[:10]
    about = json.loads((study.report / "results.json").read_text(encoding="utf-8"))["about"]
    assert about == {"name": study.path.name, "date": day}
    tables = ["--ratings", str(study.ratings), "--manifest", str(study.manifest)]
    shown = run("analyze", *tables, "-o", str(tmp_path / "else"), "--json")
    assert json.loads(shown) == json.loads((tmp_path / "else" / "results.json").read_text())
    run("analyze", folder, *tables[:2])


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


def test_new_begins_a_study_once_and_the_next_command_can_be_pasted(
    tmp_path: Path, capsys: Capture
) -> None:
    folder = tmp_path / "my study"
    assert main(["new", str(folder)]) == 0
    assert capsys.readouterr().out.endswith(f"then: feel321 check '{folder}'\n")
    assert (folder / "study.toml").read_text(encoding="utf-8") == read_template()
    assert main(["new", str(folder)]) == 1
    said = "study.toml: already exists and is not overwritten; move it away or use it"
    assert said in capsys.readouterr().err


def add_a_person(folder: Path) -> None:
    plan = create_study(folder).sessions / "p07" / "plan.json"
    plan.parent.mkdir(parents=True)
    plan.write_text("{}", encoding="utf-8")


def edit_the_settings(folder: Path) -> None:
    create_study(folder).settings.write_text(f"{read_template()}# mine\n", encoding="utf-8")


def add_a_thesis(folder: Path) -> None:
    folder.mkdir()
    (folder / "thesis.txt").write_text("dear", encoding="utf-8")


@pytest.mark.parametrize(
    ("prepare", "message"),
    [
        (add_a_thesis, ": holds files that demo did not write; name another folder with --out"),
        (edit_the_settings, "/study.toml: edited, or written by another version of feel321; name"),
        (add_a_person, ": holds a session of p07, who is no simulated participant; name another"),
    ],
)
def test_demo_leaves_what_it_did_not_begin_alone(
    prepare: Callable[[Path], None], message: str, tmp_path: Path, capsys: Capture
) -> None:
    prepare(tmp_path / "oak")
    before = sorted(tmp_path.rglob("*"))
    assert main(["demo", "--out", str(tmp_path / "oak")]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"feel321: {tmp_path}/oak{message}")
    assert sorted(tmp_path.rglob("*")) == before


def fail_with(error: BaseException) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


KEPT = "; what is done is kept, the same command continues"


@pytest.mark.parametrize(
    ("place", "verb", "kept"),
    [
        ("status.read_status", "status", ""),
        ("check.build_study", "build", ""),
        ("power.set_up", "power", ""),
        ("simulate.simulate_study", "simulate", KEPT),
    ],
)
def test_ctrl_c_is_one_line_and_exit_130(
    place: str, verb: str, kept: str, study: StudyFolder, monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:  # fmt: skip
    monkeypatch.setattr(f"feel321.study.{place}", fail_with(KeyboardInterrupt()))
    assert main([verb, str(study.path)]) == 130
    assert capsys.readouterr().err == f"feel321: interrupted{kept}\n"


FULL = OSError(errno.ENOSPC, "No space left on device")
ROOM = "No space left on device; make room there and run again"


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (KeyError("no\nway"), "unexpected KeyError: 'no\\nway'; run again with feel321 --traceback"),
        (RecursionError("deep\ndown"), "unexpected RecursionError: deep down; run again with"),
        (ValueError("nothing\x1b[2J there"), "nothing\\u001b[2J there"),
        (FULL, ROOM),
        (OSError(errno.EIO, "Input/output error", "a.csv"), "a.csv: Input/output error; check the"),
    ],
)  # fmt: skip
def test_whatever_goes_wrong_is_one_line_and_exit_1(
    error: Exception, message: str, study: StudyFolder, monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:  # fmt: skip
    monkeypatch.setattr("feel321.study.status.read_status", fail_with(error))
    assert main(["status", str(study.path)]) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"feel321: {message}")
    assert err.count("\n") == 1
    with pytest.raises(type(error)):
        main(["--traceback", "status", str(study.path)])


def test_a_place_that_cannot_be_is_named(
    study: StudyFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    nowhere, new = tmp_path / "no where", tmp_path / "new"
    monkeypatch.chdir(study.path)
    start = f"{nowhere}: no such folder; begin a study with: feel321 new '{nowhere}'\n"
    file = f"{study.settings}: a study must be a folder, got a file; try {study.path}\n"
    for words, said in (
        (["new", str(tmp_path / "file" / "study")], f"{tmp_path / 'file'}: File exists;"),
        (["check", str(nowhere)], start),
        (["analyze", str(study.settings)], file),
        (["export", str(study.path)], f"{study.path} is a study; name DIR, too: feel321 export"),
        (["note", "", "--participant", "p1"], "a note must have 1 to 1000 characters, got 0"),
    ):
        assert main(words) in {1, 2}
        assert capsys.readouterr().err.startswith(f"feel321: {said}")
    monkeypatch.setattr("feel321.files.os.fsync", fail_with(FULL))
    assert main(["new", str(new)]) == 1
    assert capsys.readouterr().err == f"feel321: {new}: {ROOM}\n"
    assert not [*new.iterdir()]


COUNTS = (
    "onset_ms onset_jitter_ms onset_jitter_99_ms sensed_jitter_ms sensed_jitter_99_ms n_estimated "
    "callback_ms_max latency_ms sensed_ms"
)


@pytest.mark.parametrize(("failed", "underruns", "code"), [(0, 0, 0), (1, 0, 1), (0, 1, 1)])
def test_doctor_fails_where_a_pulse_failed_or_the_device_ran_dry(
    failed: int, underruns: int, code: int, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    found = {"device": "coil", "host_api": "ALSA", "is_program": False, "rate_hz": 48000.0}
    found |= {"error": "", "n_failed": failed, "n_underruns": underruns}
    found |= {**dict.fromkeys(COUNTS.split(), 0), "n_pulses": 10, "n_sensed": 10}
    monkeypatch.setattr(doctor, "survey_devices", list)
    monkeypatch.setattr(doctor, "examine_rig", lambda *_, **__: found)
    assert main(["doctor", "--device", "coil"]) == code
    assert f"n_failed {failed}\n  n_underruns {underruns}\n" in capsys.readouterr().out


def test_who_calls_it_from_python_keeps_their_own_garbage_collection() -> None:
    usual = gc.get_threshold()
    assert main(["--version"]) == 0
    assert gc.get_threshold() == usual
