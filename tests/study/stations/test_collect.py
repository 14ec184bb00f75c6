"""Sessions of several stations collected into one study."""

import hashlib
import json
import os
import re
import shutil
import signal
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import cli
from feel321.study.collect import Collected, collect_sessions
from feel321.study.folder import StudyFolder, name_delivered
from feel321.study.participants.answers import PERSONAL_FILE, make_keeper
from feel321.study.participants.roster import read_holders
from feel321.study.ratings import write_ratings
from feel321.study.session.journal import (
    START,
    Record,
    digest,
    list_journals,
    read_chain,
    require_journal,
    write_line,
)
from feel321.study.session.plan import PLAN_FILE, create_plan, require_plan
from feel321.study.simulate import simulate_study
from feel321.study.status import read_status
from feel321.study.withdrawal import release_participant, withdraw_participant
from tests.study.conftest import audit_study


def tell_time() -> datetime:
    return datetime.now(UTC)


def read_files(study: StudyFolder) -> dict[str, bytes]:
    """All files of participants, without locks."""
    return {
        path.relative_to(study.sessions).as_posix(): path.read_bytes()
        for path in sorted(study.sessions.glob("*/**/*"))
        if path.is_file() and not path.name.startswith(".")
    }


def read_sources(*sources: StudyFolder) -> dict[str, bytes]:
    return {name: content for one in sources for name, content in read_files(one).items()}


def collect(study: StudyFolder, *sources: StudyFolder) -> Collected:
    return collect_sessions(study, [one.path for one in sources], now=tell_time)


@pytest.fixture(scope="module")
def held(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two stations with two simulated participants each, of four trials; odd and even numbers."""

    root = tmp_path_factory.mktemp("held")
    for station in (1, 2):
        study = StudyFolder(root / f"s{station}")
        shutil.copytree(built, study.path)
        with study.settings.open("a") as file:
            file.write(f"[stations]\nthis = {station}\nof = 2\n")
        simulate_study(study, participants=4 if station == 2 else 2, seed=1, now=tell_time)
        if station == 2:  # codes of its own
            for name in ("sim001", "sim002"):
                withdraw_participant(study, name, now=tell_time)
                shutil.rmtree(study.sessions / name)
    return root


@pytest.fixture
def stations(
    held: Path, built: Path, tmp_path: Path
) -> tuple[StudyFolder, StudyFolder, StudyFolder]:
    """Two stations, and a study without sessions."""

    for name in ("s1", "s2"):
        shutil.copytree(held / name, tmp_path / name)
    shutil.copytree(built, tmp_path / "main")
    one, two, main = (StudyFolder(tmp_path / name) for name in ("s1", "s2", "main"))
    return one, two, main


def test_all_that_stations_hold_is_there_once_and_the_study_works(stations: Any) -> None:
    one, two, main = stations
    before = [read_files(one), read_files(two)]
    found = collect(main, one, two)
    assert (found.refused, found.notes) == ([], [])
    assert found.participants == ["sim001", "sim002", "sim003", "sim004"]
    assert read_files(main) == read_sources(one, two)
    assert [read_files(one), read_files(two)] == before
    assert sorted(one.number for one in read_holders(main)) == [1, 3, 6, 8]
    assert audit_study(main) == []
    assert [one.state for one in read_status(main).participants] == ["finished"] * 4
    assert write_ratings(main, read_stimuli(main.stimuli)) == 16


def cut(study: StudyFolder, participant: str, lines: int) -> Path:
    """Leave a journal as it was when it had fewer lines."""
    (path,) = list_journals(study.sessions / participant)
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:lines]))
    return path


def test_a_longer_journal_takes_the_place_of_one_that_it_continues(stations: Any) -> None:
    one, _, main = stations
    whole = read_files(one)
    cut(one, "sim001", 4)
    with (one.sessions / "sim001" / "session-01.jsonl").open("ab") as file:
        file.write(b'{"sequence": 4, "prev')  # a session is running there
    assert collect(main, one).participants == ["sim001", "sim002"]
    (path,) = list_journals(main.sessions / "sim001")
    assert path.read_bytes().count(b"\n") == 4
    assert path.read_bytes().endswith(b"\n")
    assert audit_study(main) == []
    (one.sessions / "sim001" / "session-01.jsonl").write_bytes(whole["sim001/session-01.jsonl"])
    found = collect(main, one)
    assert (found.participants, found.files) == (["sim001"], 1)
    assert read_files(main) == whole
    cut(one, "sim001", 4)  # A copy that is older brings nothing back.
    assert collect(main, one).files == 0
    assert read_files(main) == whole
    assert audit_study(main) == []


def test_personal_answers_are_neither_overwritten_nor_brought_back(stations: Any) -> None:
    one, _, main = stations
    (path,) = list_journals(one.sessions / "sim001")
    answer = make_keeper(path.parent, require_journal(path, now=tell_time))("age", 1, 40)
    whole = (one.sessions / "sim001" / "session-01.jsonl").read_bytes()
    kept = (one.sessions / "sim001" / PERSONAL_FILE).read_bytes()
    cut(one, "sim001", 4)
    collect(main, one)
    here = main.sessions / "sim001" / PERSONAL_FILE
    assert here.read_bytes() == kept
    (one.sessions / "sim001" / "session-01.jsonl").write_bytes(whole)
    (one.sessions / "sim001" / PERSONAL_FILE).write_text("from a bad stick")
    (problem,) = [line for line in collect(main, one).refused if "sim001" in line]
    assert "not as feel321 wrote it" in problem
    assert here.read_bytes() == kept
    (one.sessions / "sim001" / PERSONAL_FILE).write_text("")
    (problem,) = [line for line in collect(main, one).refused if "sim001" in line]
    assert "keep the one that has all answers" in problem
    (one.sessions / "sim001" / PERSONAL_FILE).write_bytes(kept)
    assert collect(main, one).refused == []
    assert answer in here.read_text()


def deliver(study: StudyFolder, participant: str) -> list[Path]:
    """Let a journal name a measured file for each playback, as that of a real rig does."""
    (path,) = list_journals(study.sessions / participant)
    records, tip, lines, files = read_chain(path.read_bytes(), "").records, START, [], []
    for record in records:
        data = dict(record.data)
        if record.event == "played":
            files.append(path.parent / "delivered" / name_delivered(len(files) + 1))
            files[-1].parent.mkdir(exist_ok=True)
            files[-1].write_bytes(f"samples {len(files)}".encode())
            data["measured"] = {"file_number": float(len(files))}
            data["delivered_sha256"] = hashlib.sha256(files[-1].read_bytes()).hexdigest()
        lines.append(write_line(replace(record, data=data), tip))
        tip = digest(lines[-1].rstrip(b"\n"))
    path.write_bytes(b"".join(lines))
    return files


def test_what_journals_name_comes_with_them_and_what_is_wrong_with_it_is_said(
    stations: Any,
) -> None:
    one, _, main = stations
    files, gone = deliver(one, "sim001"), deliver(one, "sim002")[0]
    content = gone.read_bytes()
    gone.unlink()
    found = collect(main, one)
    assert found.notes == [f"{gone}: is gone, though a journal names it; restore it from a copy"]
    assert read_files(main) == read_files(one)
    gone.write_bytes(content)
    assert collect(main, one).files == 1
    assert collect(main, one) == Collected()
    shutil.rmtree(main.sessions / "sim001")
    files[0].write_bytes(b"other samples")
    assert collect(main, one).refused == [
        f"participant sim001: {files[0]}: was changed since it was written; restore it from a copy"
    ]
    assert not list((main.sessions / "sim001").glob("*"))


def fork(study: StudyFolder, participant: str, lines: int) -> None:
    """Let a journal go on otherwise from some line, with a chain that holds."""
    path = cut(study, participant, lines)
    chain = read_chain(path.read_bytes(), "")
    other = Record(lines, chain.records[-1].utc, "note", {"text": "another way"})
    with path.open("ab") as file:
        file.write(write_line(other, chain.tip))


def double_slot(one: StudyFolder, two: StudyFolder) -> None:
    plan = require_plan(one.sessions / "sim001" / PLAN_FILE)
    (two.sessions / "sim009").mkdir()
    create_plan(two.sessions / "sim009" / PLAN_FILE, replace(plan, participant="sim009"))


def double_code(one: StudyFolder, two: StudyFolder) -> None:
    plan = require_plan(one.sessions / "sim001" / PLAN_FILE)
    (two.sessions / "SIM001").mkdir()
    create_plan(two.sessions / "SIM001" / PLAN_FILE, replace(plan, participant="SIM001", number=50))


def change_line(one: StudyFolder, _two: StudyFolder) -> None:
    path = one.sessions / "sim001" / "session-01.jsonl"
    path.write_bytes(path.read_bytes().replace(b"sim001", b"sim00X", 1))


def conflict_journals(one: StudyFolder, two: StudyFolder) -> None:
    shutil.copytree(one.sessions / "sim001", two.sessions / "sim001")
    fork(two, "sim001", 5)


def conflict_plans(one: StudyFolder, two: StudyFolder) -> None:

    plan = require_plan(one.sessions / "sim001" / PLAN_FILE)
    (two.sessions / "sim001").mkdir()
    create_plan(two.sessions / "sim001" / PLAN_FILE, replace(plan, number=plan.number + 10))


def conflict_sets(one: StudyFolder, _two: StudyFolder) -> None:

    path = one.sessions / "sim001" / PLAN_FILE
    plan = require_plan(path)
    shutil.rmtree(path.parent)
    path.parent.mkdir()
    create_plan(path, replace(plan, stimuli_sha256="0" * 64))


@pytest.mark.parametrize(
    ("spoil", "who", "reason"),
    [
        (conflict_journals, "sim001", "main/sessions/sim001/.* and .*s2/sessions/sim001/.*: differ from line 6 on"),
        (conflict_plans, "sim001", "main/sessions/sim001 and .*s2/sessions/sim001: have different plans"),
        (double_slot, "sim009", "number 1 of simulated ones is that of sim001 and sim009"),
        (double_code, "sim001", "code 'sim001', but for capitals is that of SIM001 and sim001"),
        (change_line, "sim001", "sim001/session-01.jsonl, line 1: was changed after it was written"),
        (conflict_sets, "sim001", "was planned with another stimulus set"),
    ],
)  # fmt: skip
def test_every_collision_is_named_and_keeps_nobody_else_out(
    stations: Any, spoil: Callable[..., None], who: str, reason: str
) -> None:
    one, two, main = stations
    spoil(one, two)
    found = collect(main, one, two)
    (line,) = found.refused
    assert line.startswith(f"participant {who}: ")
    assert re.search(reason, line)
    assert {"sim002", "sim003", "sim004"} <= {*found.participants}
    assert {path.name for path in main.participants} == {*found.participants}
    before = read_files(main)
    again = collect(main, two, one)
    assert (again.files, again.refused) == (0, [line])
    assert read_files(main) == before
    assert audit_study(main) == []


def test_a_tombstone_wins_wherever_it_is(stations: Any) -> None:
    one, two, main = stations
    collect(main, one, two)
    withdraw_participant(one, "sim001", now=tell_time, reason="asked to")
    withdraw_participant(main, "sim003", now=tell_time)
    found = collect(main, one, two)
    told = "\n".join(found.notes)
    assert "participant sim001: withdrew in" in told
    assert "s2/sessions/sim003: participant withdrew, see" in told
    assert [name for name in read_files(main) if "sim001" in name or "sim003" in name] == [
        "sim001/withdrawn.json", "sim003/withdrawn.json",
    ]  # fmt: skip
    assert audit_study(main) == []
    states = {one.participant: one.state for one in read_holders(main)}
    assert (states["sim001"], states["sim003"]) == ("withdrawn", "withdrawn")
    fresh = replace(main, path=main.path.with_name("fresh"))
    shutil.copytree(two.path, fresh.path)
    shutil.rmtree(fresh.sessions)
    for name in ("ratings.csv", "participants.csv"):
        (fresh.path / name).unlink(missing_ok=True)
    shutil.rmtree(fresh.path / "data")
    shutil.rmtree(fresh.path / ".evidence")
    collect(fresh, one, main)
    assert read_files(fresh)["sim001/withdrawn.json"] in {
        read_files(one)["sim001/withdrawn.json"], read_files(main)["sim001/withdrawn.json"],
    }  # fmt: skip
    assert audit_study(fresh) == []


def test_what_was_released_leaves_its_number(stations: Any) -> None:
    one, two, main = stations
    cut(one, "sim001", 5)
    release_participant(one, "sim001", now=tell_time)
    double_slot(one, two)
    found = collect(main, one, two)
    assert found.refused == []
    states = {one.participant: (one.number, one.state) for one in read_holders(main)}
    assert (states["sim001"], states["sim009"]) == ((1, "released"), (1, "planned"))


def kill_at(moment: int, work: Callable[[], object]) -> bool:
    """Do something in a child that is killed at a moment of its work with files; whether it came to its end."""
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", DeprecationWarning
        )  # of threads, which the child does not need
        child = os.fork()
    if not child:
        ticks = count(1)

        def watch(function: Callable[..., Any]) -> Callable[..., Any]:
            def call(*arguments: Any, **options: Any) -> Any:
                if next(ticks) == moment:
                    os.kill(os.getpid(), signal.SIGKILL)
                return function(*arguments, **options)

            return call

        for owner, name in ((os, "fsync"), (Path, "replace"), (Path, "unlink"), (Path, "mkdir")):
            setattr(owner, name, watch(getattr(owner, name)))
        try:
            work()
        finally:
            os._exit(0)
    return os.waitpid(child, 0)[1] == 0


def check_whole(main: StudyFolder, whole: Mapping[str, bytes]) -> None:
    """Every file is as in its source, or not there; a journal may be as it was before."""
    for name, content in read_files(main).items():
        if name in whole:
            assert whole[name].startswith(content)
            assert content == whole[name] or name == "sim001/session-01.jsonl"


@pytest.mark.parametrize("step", [11, pytest.param(1, marks=pytest.mark.soak)])
def test_killed_at_any_moment_the_same_call_continues(stations: Any, step: int) -> None:
    one, two, main = stations
    whole = read_sources(one, two)
    early = whole["sim001/session-01.jsonl"].splitlines(keepends=True)[:4]
    shutil.copytree(one.sessions / "sim001", main.sessions / "sim001")
    (main.sessions / "sim001" / "session-01.jsonl").write_bytes(b"".join(early))
    deliver(one, "sim002")
    whole |= read_sources(one)
    begun = read_files(main)
    start = main.path.with_name("start")
    main.path.rename(start)
    kills = 0
    for moment in count(1, step):
        shutil.copytree(start, main.path)
        is_done = kill_at(moment, lambda: collect(main, one, two))
        kills += not is_done
        check_whole(main, whole)
        if not is_done:
            assert collect(main, one, two).refused == []
        assert read_files(main) == whole != begun
        assert audit_study(main) == []
        assert not list(main.sessions.glob("*/.*.part"))
        shutil.rmtree(main.path)
        if is_done:
            break
    assert kills > 40 / step


def test_the_verb_says_what_it_did(stations: Any, capsys: pytest.CaptureFixture[str]) -> None:
    one, two, main = stations
    command = ["collect", str(one.path), str(two.path), "--into", str(main.path)]
    assert cli.main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["files"], found["participants"]) == (8, ["sim001", "sim002", "sim003", "sim004"])
    fork(one, "sim001", 5)
    assert cli.main(command) == 1
    first, second = capsys.readouterr().out.splitlines()
    assert first == f"{main.path}: nothing to copy"
    assert second.startswith("refused: participant sim001: ")
