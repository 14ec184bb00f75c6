import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from feel321.files import hold_lock
from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.participants.roster import (
    Holder,
    find_leftovers,
    read_holders,
    read_tombstone,
    write_roster,
)
from feel321.study.session.journal import create_journal, digest, read_journal
from feel321.study.session.plan import PLAN_FILE
from feel321.study.withdrawal import release_participant, withdraw_participant

DYING = """
import os, signal, sys
from datetime import UTC, datetime
from pathlib import Path
from feel321.study.folder import StudyFolder
from feel321.study.withdrawal import withdraw_participant
import feel321.analysis.report.folder, feel321.files, feel321.stimuli.sets.manifest, feel321.study.ratings, filelock
root, steps = Path(sys.argv[1]), {"open", "os.remove", "os.rename", "os.rmdir", "os.truncate"}
def now():
    return datetime(2026, 1, 1, 12, tzinfo=UTC)
def die_at(last):
    left = last
    def count(event, arguments):
        nonlocal left
        if event in steps and root.name in str(arguments[0]):
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(count)
for step in range(1000):
    study = StudyFolder(root / str(step))
    if not study.path.exists():
        break
    child = os.fork()
    if not child:
        die_at(step)
        withdraw_participant(study, "p01", now=now)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    print(step, "whole" if os.WIFEXITED(status) else "killed", flush=True)
"""


def holders(study: StudyFolder) -> dict[str, Holder]:
    return {holder.participant: holder for holder in read_holders(study)}


def read_files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def write_report_files(folder: Path) -> None:
    """Write a report's files, and one that is not its own though the list names it."""
    files = ["results.json", "index.html", "figures/a.svg", "tables/raters.csv"]
    (folder / "figures").mkdir(parents=True)
    (folder / "tables").mkdir()
    for name in [*files, "mine.csv"]:
        (folder / name).write_text("p01")
    (folder / "results.json").write_text(json.dumps({"files": [*files, "mine.csv"]}))


@pytest.fixture
def two(lab: Any) -> Any:
    """A study in which p01 and p02 have finished."""
    for name in ("p01", "p02"):
        lab.begin(name)
        lab.work(name)
    return lab


def test_all_data_go_and_a_tombstone_stays(two: Any, now: Any) -> None:
    folder = two.study.sessions / "p01"
    last = (folder / "session-01.jsonl").read_bytes().splitlines()[-1]
    (folder / "session-01.jsonl.torn1").write_bytes(b"{")
    (folder / "notes").mkdir()
    (folder / "notes" / "age.txt").write_text("44")
    elsewhere = two.study.path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept.txt").write_text("not ours")
    (folder / "shortcut").symlink_to(elsewhere)
    others = read_files(two.study.sessions / "p02")
    removed = withdraw_participant(two.study, "p01", now=now, reason="moved away")
    assert removed == [
        "notes",
        "notes/age.txt",
        "plan.json",
        "session-01.jsonl",
        "session-01.jsonl.torn1",
        "shortcut",
    ]
    assert read_files(elsewhere) == {"kept.txt": b"not ours"}
    (folder / "shortcut").symlink_to(
        elsewhere
    )  # A copy that came back is found, links to folders too.
    assert find_leftovers(folder) == [
        f"{folder / 'shortcut'}: lies beside a tombstone, the participant withdrew; remove it"
    ]
    (folder / "shortcut").unlink()
    assert [path.name for path in folder.iterdir()] == ["withdrawn.json"]
    stored = json.loads((folder / "withdrawn.json").read_bytes())
    assert len(stored.pop("sha256")) == 64
    assert stored == {
        "participant": "p01",
        "number": 1,
        "simulated": False,
        "utc": "2026-01-01T12:00:00+00:00",
        "reason": "moved away",
        "journals": [{"journal": "session-01.jsonl", "lines": 11, "tip": digest(last)}],
        "state": "removed",
    }
    assert read_files(two.study.sessions / "p02") == others
    assert read_journal(two.study.sessions / "p02" / "session-01.jsonl").torn == b""
    assert find_leftovers(folder) == []


def test_the_slot_is_free_and_the_code_is_not(two: Any, now: Any) -> None:
    withdraw_participant(two.study, "p01", now=now)
    holder = holders(two.study)["p01"]
    assert (holder.state, holder.number) == ("withdrawn", 1)
    with pytest.raises(
        ValueError, match="participant p01: was withdrawn; no code is used twice, use another"
    ):
        two.claim("p01")
    assert two.claim("p03") == 1


def test_withdraw_wants_to_be_meant(
    two: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ["withdraw", str(two.study.path), "--participant", "p01"]
    assert main(command) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "no terminal to ask for confirmation; add --yes" in err
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    for answer, expected in (("", 1), ("n", 1), ("y", 0)):
        monkeypatch.setattr(sys.stdin, "readline", lambda answer=answer: f"{answer}\n")
        assert main(command) == expected
        assert (two.study.sessions / "p01" / "plan.json").exists() == (answer != "y")
        assert ("nothing was removed" in capsys.readouterr().out) == (answer != "y")


def test_a_running_session_is_not_pulled_away(two: Any, now: Any) -> None:
    before = read_files(two.study.path)
    message = "p01: a session is running here; let it finish or stop it first"
    with hold_lock(two.study.sessions / "p01" / ".lock", busy=""):
        for leave in (withdraw_participant, release_participant):
            with pytest.raises(BlockingIOError, match=message):
                leave(two.study, "p01", now=now)
    after = read_files(two.study.path)
    assert {name: after[name] for name in before} == before


@pytest.mark.parametrize("leave", [withdraw_participant, release_participant])
@pytest.mark.parametrize("name", ["p09", "../sessions/p01", ""])
def test_nobody_else_can_leave(two: Any, now: Any, leave: Callable[..., Any], name: str) -> None:
    before = read_files(two.study.path)
    with pytest.raises(
        ValueError, match=f"participant '{name}' has no session here; known: p01, p02"
    ):
        leave(two.study, name, now=now)
    assert read_files(two.study.path) == before


def test_a_table_that_cannot_be_written_anew_is_removed(two: Any, now: Any) -> None:
    write_roster(two.study)
    (two.study.sessions / "p02" / "plan.json").write_bytes(b"{}")
    two.study.ratings.write_text("participant\np01\n")  # And no stimulus set is built.
    warnings: list[str] = []
    withdraw_participant(two.study, "p01", now=now, warn=warnings.append)
    assert [line.partition(" (")[0] for line in warnings] == [
        f"{two.study.ratings}: was removed, because it could not be rewritten",
        f"{two.study.path / 'participants.csv'}: was removed, because it could not be rewritten",
    ]
    assert not two.study.ratings.exists()
    withdraw_participant(two.study, "p02", now=now)  # Nobody has to listen.


def test_a_kill_at_any_step_leaves_everything_or_a_tombstone_and_the_same_call_finishes(
    make_lab: Any, now: Any, tmp_path: Path
) -> None:
    (root := tmp_path / "kills").mkdir()
    lab = make_lab()
    for name in ("p01", "p02"):
        lab.begin(name)
        lab.work(name, 2)
    write_roster(lab.study)
    write_report_files(lab.study.report)
    for step in range(50):
        shutil.copytree(lab.study.path, root / str(step))
    folder = type(lab.study)
    before = read_files(root / "0")
    done = subprocess.run(
        [sys.executable, "-c", DYING, root], capture_output=True, text=True, check=True
    )
    ends = [line.split()[1] for line in done.stdout.splitlines()]
    assert len(ends) == 50
    assert ends[-1] == "whole"
    assert ends.count("killed") > 20
    for step, end in enumerate(ends):
        study = folder(root / str(step))
        check_after_kill(study, before, is_whole=end == "whole")
        with suppress(ValueError):  # Had it finished, but for its last breath.
            withdraw_participant(study, "p01", now=now)
        assert read_tombstone(study.sessions / "p01").state == "removed"
        assert {path.name for path in (study.sessions / "p01").iterdir()} - {".lock"} == {
            "withdrawn.json"
        }
        assert {name: one.state for name, one in holders(study).items()} == {
            "p01": "withdrawn",
            "p02": "planned",
        }
        assert "p01" not in (study.path / "participants.csv").read_text()
        assert list(read_files(study.report)) == ["mine.csv"]
        assert find_leftovers(study.sessions / "p01") == []


def check_after_kill(study: StudyFolder, before: dict[str, bytes], *, is_whole: bool) -> None:
    after = read_files(study.path)
    assert all(after[name] == content for name, content in before.items() if "/p02/" in name)
    tombstone = read_tombstone(study.sessions / "p01")
    if tombstone is None:
        assert not is_whole
        assert all(after[name] == content for name, content in before.items() if "/p01/" in name)
        return
    assert [anchor.lines for anchor in tombstone.journals] == [7]
    if tombstone.state == "removing":
        (line,) = find_leftovers(study.sessions / "p01")
        finish = f"feel321 withdraw {study.path} --participant p01"
        assert line.endswith(f"the withdrawal was interrupted; finish it: {finish}")


def test_release_keeps_the_data_and_frees_the_slot(lab: Any, now: Any) -> None:
    lab.begin("p01")
    journal = lab.work("p01", 2)
    before = journal.read_bytes()
    assert release_participant(lab.study, "p01", now=now) == 1
    assert journal.read_bytes().startswith(before)
    assert read_journal(journal).records[-1].event == "released"
    assert holders(lab.study)["p01"].state == "released"
    assert lab.claim("p02") == 1
    with pytest.raises(ValueError, match="participant p01: was released before; number 1 is free"):
        release_participant(lab.study, "p01", now=now)
    withdraw_participant(lab.study, "p01", now=now)  # That is still possible.
    with pytest.raises(ValueError, match="participant p01: withdrew, there is nothing to release"):
        release_participant(lab.study, "p01", now=now)


@pytest.mark.parametrize("left", ["plan", "empty journal"])
def test_of_someone_who_never_began_nothing_is_kept(lab: Any, now: Any, left: str) -> None:
    folder = lab.study.sessions / "p01"
    lab.claim("p01")
    if left == "empty journal":
        create_journal(folder / "session-01.jsonl", now=now)
    assert release_participant(lab.study, "p01", now=now) == 1
    assert not folder.exists()
    assert holders(lab.study) == {}
    assert (lab.begin("p01") / PLAN_FILE).exists()  # The code may be used again.
