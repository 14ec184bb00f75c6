"""Evidence in git: what was honestly done gives no finding; what contradicts a checkpoint gives one."""

import json
import random
import shutil
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from feel321.study.check import build_study
from feel321.study.cli import main
from feel321.study.evidence import checkpoints
from feel321.study.evidence.audit import examine
from feel321.study.evidence.checkpoints import (
    EVIDENCE,
    declaring,
    find_newest,
    note_checkpoint,
    read_own,
    take_checkpoint,
)
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import utc_now
from feel321.study.simulate import simulate_study
from feel321.study.withdrawal import withdraw_participant
from tests.study.conftest import SMALLEST_STUDY

SEED = random.SystemRandom().randrange(10**6)
"""Another one each time: what is honest is so at any seed."""


def simulate(study: StudyFolder, participants: int) -> None:
    simulate_study(study, participants=participants, seed=SEED, now=utc_now)


def seal(study: StudyFolder, reason: str = "", remote: str = "") -> Any:
    return take_checkpoint(study, "seal", reason=reason, remote=remote, now=utc_now)


def find(study: StudyFolder, *remotes: Path) -> tuple[str, ...]:
    return examine(study, remotes=[str(one) for one in remotes]).findings


def append(path: Path, content: bytes) -> None:
    with path.open("ab") as file:
        file.write(content)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """Two participants; to be copied, not touched."""
    study = StudyFolder(tmp_path_factory.mktemp("whole") / "study")
    study.path.mkdir()
    study.settings.write_text(SMALLEST_STUDY, encoding="utf-8")
    build_study(study)
    simulate(study, 2)
    return study


@pytest.fixture
def remote(tmp_path: Path) -> Path:
    return tmp_path / "elsewhere" / "study.git"


@pytest.fixture
def study(whole: StudyFolder, remote: Path, tmp_path: Path) -> StudyFolder:
    """A copy of it, sealed, with a remote in a folder."""
    shutil.copytree(whole.path, tmp_path / "study")
    study = StudyFolder(tmp_path / "study")
    assert seal(study, remote=str(remote)).places == (str(remote),)
    return study


# What is honest.


def withdraw(study: StudyFolder, name: str = "sim002") -> None:
    withdraw_participant(study, name, now=utc_now)


def kill_withdrawal(study: StudyFolder) -> None:
    take_checkpoint(study, "before withdraw", who="sim002", now=utc_now)
    study.journals[1].unlink()
    seal(study)
    withdraw(study)


def kill_before_the_last_checkpoint(study: StudyFolder) -> None:
    def note(own: StudyFolder, by: str, **options: Any) -> str:
        if by == "withdraw":
            raise KeyboardInterrupt
        return note_checkpoint(own, by, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checkpoints, "note_checkpoint", note)
        with pytest.raises(KeyboardInterrupt):
            withdraw(study)
    withdraw(study)
    with pytest.raises(ValueError, match="all data are gone"):
        withdraw(study)


def move(study: StudyFolder) -> StudyFolder:
    return StudyFolder(Path(shutil.move(study.path, study.path.with_name("moved"))))


def copy_and_go_on(study: StudyFolder) -> None:
    twin = StudyFolder(study.path.with_name("twin"))
    shutil.copytree(study.path, twin.path, copy_function=shutil.copyfile)
    simulate(twin, 3)
    assert seal(twin).problems == ()
    assert find(twin) == ()


def set_clock_back(study: StudyFolder) -> None:
    def now() -> Any:
        return utc_now() - timedelta(hours=3)

    simulate_study(study, participants=3, seed=SEED, now=now)
    take_checkpoint(study, "seal", now=now)


def decide(study: StudyFolder) -> None:
    append(study.settings, b"\n[analysis]\ndraws = 200\n")
    seal(study, "more draws, as planned")


def build_otherwise(study: StudyFolder) -> None:
    shutil.rmtree(study.path)
    study.path.mkdir()
    for duration in ("0.1", "0.12"):
        study.settings.write_text(SMALLEST_STUDY.replace("0.1", duration), encoding="utf-8")
        build_study(study)
        seal(study, "the beginning")
    simulate(study, 2)


def write_report(study: StudyFolder, text: str) -> None:
    (study.report / "figures").mkdir(parents=True, exist_ok=True)
    listed = {"headline": text, "files": ["results.json", "index.html", "figures/one.svg"]}
    (study.report / "results.json").write_text(json.dumps(listed))
    for name in ("index.html", "figures/one.svg"):
        (study.report / name).write_text(f"<p>{text}</p>")


def analyse(study: StudyFolder) -> None:
    for text in ("first", "second"):
        with declaring(study, "analyze"):
            write_report(study, text)
            simulate(study, 3)  # a session that ends meanwhile sees half of it


def kill_analysis(study: StudyFolder) -> None:
    analyse(study)
    take_checkpoint(study, "before analyze", now=utc_now)
    write_report(study, "third")
    seal(study)


def kill_session(study: StudyFolder) -> None:
    def stop(done: int, _total: int) -> None:
        if done > 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_study(study, participants=4, seed=SEED, now=utc_now, progress=stop)
    append(study.journals[-1], b'{"sequence": 99')
    seal(study)
    simulate(study, 4)


def change_line_ends(study: StudyFolder) -> None:
    plans = [folder / "plan.json" for folder in study.participants]
    for path in (study.settings, *plans, *study.journals):
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    said = [one for one in examine(study).remarks if "has other line endings" in one]
    assert len(said) == 1 + len(plans) + len(study.journals)


def unplug(study: StudyFolder) -> None:
    study.path.parent.joinpath("elsewhere").rename(study.path.parent / "unplugged")


HONEST: dict[str, Callable[[StudyFolder], Any]] = {
    "more sessions": lambda study: simulate(study, 4),
    "a session that was killed, sealed and resumed": kill_session,
    "a withdrawal": withdraw,
    "a withdrawal that was killed and repeated": kill_withdrawal,
    "a withdrawal that was killed before its last checkpoint": kill_before_the_last_checkpoint,
    "a folder that was moved": move,
    "a copy without times that went on beside it": copy_and_go_on,
    "a clock that was set back": set_clock_back,
    "settings changed, with a reason": decide,
    "line ends converted": change_line_ends,
    "the set built otherwise before anybody came": build_otherwise,
    "reports while sessions end": analyse,
    "an analysis that was killed": kill_analysis,
    "a remote that is away": unplug,
}


@pytest.mark.parametrize("what", HONEST)
def test_what_is_honest_gives_no_finding(study: StudyFolder, what: str) -> None:
    study = HONEST[what](study) or study
    assert find(study) == ()
    is_away = any("could not be looked at" in one for one in examine(study).remarks)
    assert bool(seal(study).problems) == is_away == (what == "a remote that is away")
    assert find(study) == (), "nor does it later"
    withdraw(study, "sim001")
    simulate(study, 2)
    assert find(study) == ()


def test_a_lost_disk_from_the_loss_to_the_next_withdrawal(
    study: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    """The drill: lose the disk, restore a backup, explain, go on, check, withdraw."""
    backup = study.path.with_name("backup")
    shutil.copytree(study.path, backup)
    simulate(study, 3)
    withdraw(study, "sim002")
    shutil.rmtree(study.path)
    backup.rename(study.path)
    # Audit names what is lost, and who withdrew since and is back with the command that removes them again.
    again = f"remove again: feel321 withdraw {study.path} --participant sim002"
    assert any(one.endswith(again) for one in find(study))
    assert any("lacks " in one and "seal --reason" in one for one in find(study))
    (problem,) = seal(study).problems
    assert "if this folder was restored" in problem
    folder = str(study.path)
    assert main(["seal", folder, "--reason", "the disk failed"]) == 0
    (finding,) = find(study)
    assert finding.endswith(again)
    withdraw(study, "sim002")
    said = "declares: the disk failed (restored, lost: session 1 of sim003)"
    assert any(one.endswith(said) for one in examine(study).remarks)
    # The study goes on, checkpoints are accepted, and nothing is held against it.
    simulate(study, 4)
    assert [one.name for one in study.participants] == [f"sim00{n}" for n in range(1, 6)]
    assert seal(study).problems == ()
    for verb in ("check", "status", "audit"):
        assert main([verb, folder]) == 0, capsys.readouterr()
    withdraw(study, "sim001")
    assert seal(study).problems == ()
    assert find(study) == ()


# What contradicts.


def test_a_change_without_a_reason_is_not_covered_up_by_later_checkpoints(
    study: StudyFolder,
) -> None:
    before = study.settings.read_bytes()
    append(study.settings, b"# changed\n")
    (finding,) = find(study)
    assert finding.startswith(f"{study.settings}: was changed since the checkpoint of ")
    seal(study)
    study.settings.write_bytes(before)
    assert find(study) == (finding,), "nor by being changed back"
    seal(study, "a comment")
    found = examine(study)
    assert found.findings == ()
    assert any(text.endswith("declares: a comment") for text in found.remarks)


def test_a_lost_journal_person_or_line_names_what_is_gone(study: StudyFolder) -> None:
    simulate(study, 4)
    names = {one.name: one for one in study.journals}
    assert len(study.journals) == 4, names
    cut, gone = study.journals[0], study.participants[1]
    lines = cut.read_bytes().splitlines(keepends=True)
    cut.write_bytes(b"".join(lines[:-2]))
    shutil.rmtree(gone)
    found = find(study)
    assert any(text.startswith(f"{cut}: was cut, ") for text in found)
    assert sum(text.startswith(f"{gone}/") and ": is gone since" in text for text in found) == 2


def test_what_goes_while_a_withdrawal_has_begun_and_not_ended_is_remarked(
    study: StudyFolder,
) -> None:
    take_checkpoint(study, "before withdraw", who="sim002", now=utc_now)
    shutil.rmtree(gone := study.sessions / "sim002")
    found = [one for one in examine(study).remarks if one.startswith(f"{gone}/")]
    assert len(found) == 2
    assert all("is gone" in one and one.endswith("by what did not end") for one in found)


def rewind(study: StudyFolder) -> None:
    """Bring back what the folder was before, evidence too."""
    shutil.copytree(study.path, study.path.with_name("old"))
    simulate(study, 4)
    shutil.rmtree(study.path)
    study.path.with_name("old").rename(study.path)


def begin_anew(study: StudyFolder) -> None:
    config = (study.path / EVIDENCE / "config").read_bytes()
    shutil.rmtree(study.path / EVIDENCE)
    shutil.rmtree(study.sessions)
    simulate_study(study, participants=2, seed=SEED + 1, now=utc_now)
    (study.path / EVIDENCE / "config").write_bytes(config)


@pytest.mark.parametrize(
    ("act", "said"), [(rewind, "lacks "), (begin_anew, "shares none of the checkpoints")]
)
def test_a_history_that_was_made_anew_or_turned_back_contradicts_the_remote(
    study: StudyFolder, act: Callable[[StudyFolder], None], said: str
) -> None:
    before = find_newest(study).id
    assert main(["audit", str(study.path), "--expect", before[:12]]) == 0
    lost = 4 if act is rewind else 2
    act(study)
    (problem,) = seal(study).problems
    assert "checkpoints that are not here" in problem, "and the remote keeps them"
    found = find(study)
    assert any(text.startswith(f"{study.path / EVIDENCE}: {said}") for text in found)
    files = {text.partition(": ")[0].partition(",")[0] for text in found}
    assert len([one for one in files if "sim00" in one]) >= lost / 2, "and files are named"
    assert main(["audit", str(study.path), "--expect", before[:12]]) == 1


def test_a_remote_that_git_knows_by_two_names_keeps_all_that_was_pushed(
    study: StudyFolder, remote: Path
) -> None:
    own = read_own(study)
    home = ["git", "-C", str(study.path / EVIDENCE)]
    subprocess.run([*home, "remote", "add", "lab", str(remote)], check=True)
    subprocess.run([*home, "update-ref", "refs/remotes/lab/other", own.history[-1].id], check=True)
    assert read_own(study).pushed == {str(remote): {own.branch, "other"}}


def test_a_remote_that_lost_its_checkpoints_is_found_and_not_filled_again(
    study: StudyFolder, remote: Path
) -> None:
    shutil.rmtree(remote)
    subprocess.run(["git", "init", "-q", "--bare", str(remote)], check=True)
    (problem,) = seal(study).problems
    assert "what was pushed there is gone" in problem
    (finding,) = find(study)
    assert finding.startswith(f"{remote}: had the checkpoints of ")
    assert seal(study, remote=str(remote)).problems == (), "asked for by name"
    assert find(study) == ()


def test_an_object_that_is_not_as_its_name_says_is_refused(
    study: StudyFolder, remote: Path
) -> None:
    paths = [one for one in (study.path / EVIDENCE / "objects").rglob("*") if one.is_file()]
    path = next(one for one in paths if b"study.toml" in zlib.decompress(one.read_bytes()))
    content = zlib.decompress(path.read_bytes())
    path.chmod(0o600)
    path.write_bytes(zlib.compress(content.replace(b"study.toml\t", b"study.tomb\t")))
    found = examine(study)
    assert any(
        text.startswith(f"{study.path / EVIDENCE}: cannot be read") for text in found.findings
    )
    assert any("compared with the checkpoints of" in text for text in found.remarks), remote
    with pytest.raises(ValueError, match="cannot be read"):
        seal(study)


# Words, and what is refused.


def test_seal_and_audit_on_the_command_line(
    study: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, further = str(study.path), tmp_path / "usb" / "further.git"
    assert main(["seal", folder, "--to", str(further), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["places"][-1] == str(further)
    assert main(["audit", folder]) == 0
    said = capsys.readouterr().out
    assert f"{told['checkpoint'][:12]} of " in said
    assert f"{further} has those until " in said
    assert "nothing was changed" not in said
    shutil.rmtree(study.path / EVIDENCE)
    assert main(["audit", folder]) == 0
    assert "without evidence" in capsys.readouterr().out
    append(study.settings, b"# changed\n")
    assert main(["audit", folder, "--remote", str(further)]) == 1
    assert f"{study.settings}: was changed since" in capsys.readouterr().out


def test_git_reads_what_was_written(study: StudyFolder, remote: Path) -> None:
    for place in (study.path / EVIDENCE, remote):
        subprocess.run(["git", "-C", str(place), "fsck", "--strict"], check=True)
    words = ["git", "-C", str(remote), "log", "--all", "--format=%s"]
    said = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    assert said.split() == ["seal", "simulate"]


# Other processes.


def start(study: StudyFolder) -> subprocess.Popen[bytes]:
    code = (
        "import sys; from pathlib import Path; from feel321.study.folder import StudyFolder\n"
        "from feel321.study.evidence.checkpoints import take_checkpoint\n"
        "from feel321.study.session.journal import utc_now\n"
        "study = StudyFolder(Path(sys.argv[1])); print(flush=True)\n"
        "while True: take_checkpoint(study, 'seal', now=utc_now)"
    )
    return subprocess.Popen([sys.executable, "-c", code, str(study.path)], stdout=subprocess.PIPE)


def test_a_kill_while_sealing_accuses_nobody(study: StudyFolder) -> None:
    rng = random.SystemRandom()
    for _ in range(4):
        with start(study) as child:
            assert child.stdout is not None
            child.stdout.read(1)
            time.sleep(rng.uniform(0.0, 0.15))
            child.send_signal(signal.SIGKILL)
        assert find(study) == ()
    assert seal(study).problems == ()
    assert find(study) == ()


def test_processes_that_seal_at_once_make_one_history(study: StudyFolder) -> None:
    before = len(read_own(study)[0])
    with start(study) as one, start(study) as other:
        while len(read_own(study)[0]) < before + 20:
            time.sleep(0.05)
        for child in (one, other):
            child.kill()
    assert seal(study).problems == ()
    assert find(study) == ()
