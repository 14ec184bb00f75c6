"""Checkpoints and anchors: what was honestly done gives no finding; what contradicts an anchor gives one."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.auditing import anchors, codes, keys, sealing
from feel321.study.auditing.checkpoints import (
    Tip,
    find_chain,
    note_analysis,
    read_tip,
    take_checkpoint,
)
from feel321.study.auditing.study import examine
from feel321.study.cli import main
from feel321.study.collect import collect_sessions
from feel321.study.folder import StudyFolder, create_study
from feel321.study.ledger.progress import write_roster
from feel321.study.ledger.slots import rebuild_ledger
from feel321.study.persons.withdrawal import take_note, withdraw_participant
from feel321.study.session.journal import utc_now
from feel321.study.simulation import simulate_study
from feel321.study.workflow import build_study

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

SETTINGS = """
[study]
name = "anchored"
[[recordings]]
scene = "bumps"
duration_s = 0.1
[stimuli]
reducers = ["sax321", "mag321"]
reference = "none"
anchors = false
[session]
protocols = ["realism"]
[session.rehearsal]
training = 0
practice = 0
"""


def simulate(study: StudyFolder, participants: int) -> None:
    simulate_study(study, participants=participants, seed=SEED, now=utc_now)


SEED = random.SystemRandom().randrange(10**6)
"""Another one each time: what is honest is so at any seed."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """Two participants, sealed; to be copied, not touched."""
    study = StudyFolder(tmp_path_factory.mktemp("whole") / "study")
    study.path.mkdir()
    study.settings.write_text(SETTINGS, encoding="utf-8")
    build_study(study)
    simulate(study, 2)
    return study


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place outside, chosen by this rig."""
    monkeypatch.setenv("FEEL321_CONFIG", str(tmp_path / "config"))
    anchors.add_rules(folder=tmp_path / "anchors")
    return tmp_path / "anchors"


@pytest.fixture
def study(whole: StudyFolder, home: Path, tmp_path: Path) -> StudyFolder:
    shutil.copytree(whole.path, tmp_path / "study")
    study = StudyFolder(tmp_path / "study")
    assert seal(study).places == (str(home),)
    return study


def seal(study: StudyFolder, reason: str = "") -> Any:
    return sealing.seal_study(study, reason=reason, now=utc_now)


def find(study: StudyFolder, **options: Any) -> tuple[str, ...]:
    return examine(study, **options).findings


def append(path: Path, content: bytes) -> None:
    with path.open("ab") as file:
        file.write(content)


# What is honest.


def move(study: StudyFolder) -> StudyFolder:
    return StudyFolder(Path(shutil.move(study.path, study.path.with_name("elsewhere"))))


def copy_without_times(study: StudyFolder) -> StudyFolder:
    target = study.path.with_name("copied")
    shutil.copytree(study.path, target, copy_function=shutil.copyfile)
    return StudyFolder(target)


def decide(study: StudyFolder) -> None:
    append(study.settings, b"\n[analysis]\ndraws = 200\n")
    seal(study, reason="more draws, as planned")


def tear_journal(study: StudyFolder) -> None:
    append(study.journals[0], b'{"sequence": 99')
    take_note(study, "sim001", "after a power cut", now=utc_now)


def add_files(study: StudyFolder) -> None:
    (study.path / "methods").mkdir()
    (study.path / "methods" / "mine.py").write_text("def mine(a, r): return a[0]\n")
    study.calibration.mkdir(exist_ok=True)
    (study.calibration / "one.json").write_text("{}")


def collect_another(study: StudyFolder) -> None:
    other = replace(study, path=study.path.with_name("station"))
    shutil.copytree(study.path, other.path)
    simulate(other, 3)
    collect_sessions(study, [other.path], now=utc_now)
    write_roster(study)


def interrupt(study: StudyFolder) -> None:
    def stop(done: int, _total: int) -> None:
        if done > 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_study(study, participants=4, seed=SEED, now=utc_now, progress=stop)
    seal(study)
    simulate(study, 4)


def write_report(study: StudyFolder, text: str) -> None:
    study.report.mkdir(exist_ok=True)
    (study.report / "results.json").write_text(
        json.dumps({"headline": text, "files": ["results.json", "index.html"]})
    )
    (study.report / "index.html").write_text(f"<p>{text}</p>")


def analyse_again(study: StudyFolder) -> None:
    for text in ("first", "second"):
        with sealing.sealing_analysis(study):
            write_report(study, text)


def kill_analysis(study: StudyFolder) -> None:
    analyse_again(study)
    note_analysis(study, now=utc_now)
    write_report(study, "third")


def build_otherwise(study: StudyFolder) -> StudyFolder:
    other = StudyFolder(study.path.with_name("begun"))
    create_study(other.path)
    for duration in ("0.1", "0.12"):
        other.settings.write_text(SETTINGS.replace("0.1", duration), encoding="utf-8")
        build_study(other)
        seal(other, reason="the beginning")
    simulate(other, 2)
    return other


HONEST: dict[str, Callable[[StudyFolder], StudyFolder | None]] = {
    "nothing": lambda _: None,
    "sealed twice": lambda study: seal(study) and None,
    "more sessions": lambda study: simulate(study, 4),
    "a session that was interrupted, sealed and resumed": interrupt,
    "a withdrawal": lambda study: withdraw_participant(study, "sim002", now=utc_now) and None,
    "a note": lambda study: take_note(study, "sim001", "was quick", now=utc_now) and None,
    "the ledger rebuilt": lambda study: rebuild_ledger(study) and None,
    "the folder moved": move,
    "the folder copied without times": copy_without_times,
    "settings changed, with a reason": decide,
    "a line that a kill tore": tear_journal,
    "new methods and a new certificate": add_files,
    "the set built again": lambda study: build_study(study) and None,
    "tables removed": lambda study: study.ratings.unlink(),
    "a participant of another station": collect_another,
    "two analyses": analyse_again,
    "an analysis that was killed": kill_analysis,
    "a checkpoint that was killed": lambda study: append(
        find_chain(study), b'{"sequence": 9, "pre'
    ),
    "the set built anew before anybody came": build_otherwise,
    "an anchor that was killed": lambda study: append(
        next((study.path.parent / "anchors").glob("*/anchors.jsonl")), b'{"chain": "'
    ),
}


ALWAYS = {
    "more sessions", "a withdrawal", "a line that a kill tore", "a participant of another station",
    "the set built anew before anybody came",
    "an analysis that was killed", "a checkpoint that was killed", "an anchor that was killed",
}  # fmt: skip
"""Also in a run that shall be short."""


@pytest.mark.parametrize(
    "what", [pytest.param(one, marks=[] if one in ALWAYS else pytest.mark.soak) for one in HONEST]
)
def test_what_is_honest_gives_no_finding(study: StudyFolder, what: str) -> None:
    study = HONEST[what](study) or study
    assert find(study) == ()
    assert seal(study).problems == ()
    assert find(study) == (), "nor does it later"
    withdraw_participant(study, "sim001", now=utc_now)
    simulate(study, 2)
    assert find(study) == ()


def test_a_study_on_another_computer_is_compared_with_anchors_that_were_given(
    study: StudyFolder, home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FEEL321_CONFIG", str(tmp_path / "reviewer"))
    study = move(study)
    assert find(study, extra=[home]) == ()
    simulate(study, 3)
    seal(study)
    assert find(study, extra=[home]) == (), "a copy that goes on"
    study.ledger_log.unlink(missing_ok=True)
    find_chain(study).unlink()
    shutil.rmtree(study.sessions)
    assert any("no anchor of this chain is in" in text for text in find(study, extra=[home]))
    simulate_study(study, participants=2, seed=SEED + 1, now=utc_now)
    assert find(study) == (), "nothing was given"
    findings = find(study, extra=[home])
    assert any("no anchor of this chain is in" in text for text in findings)
    assert any(text.startswith(str(study.journals[0])) for text in findings), "the copy names files"


def test_a_rig_that_has_only_anchors_of_others_says_so(study: StudyFolder, tmp_path: Path) -> None:
    other = move(study)
    find_chain(other).unlink()
    take_checkpoint(other, by="seal", now=utc_now)
    other.path.rename(tmp_path / "renamed")
    found = examine(StudyFolder(tmp_path / "renamed"))
    assert found.findings == ()
    assert any("no anchor of this chain is in" in text for text in found.remarks)


def test_a_set_may_be_built_anew_when_everybody_has_withdrawn_not_before(
    study: StudyFolder,
) -> None:
    first, *others = study.participants
    withdraw_participant(study, first.name, now=utc_now)
    before = study.manifest.read_bytes()
    append(study.manifest, b"\n")
    assert any("manifest.csv" in text and "; restore it" in text for text in find(study))
    study.manifest.write_bytes(before)
    for folder in others:
        withdraw_participant(study, folder.name, now=utc_now)
    study.settings.write_text(SETTINGS.replace("0.1", "0.12"), encoding="utf-8")
    build_study(study)
    assert all("feel321 seal --reason" in text for text in find(study))
    seal(study, reason="the real study begins")
    assert find(study) == ()
    simulate(study, 4)
    assert find(study) == ()


def test_an_analysis_that_was_killed_opens_nothing_for_ever(study: StudyFolder) -> None:
    kill_analysis(study)
    (remark,) = (one for one in examine(study).remarks if "did not finish" in one)
    assert remark.startswith(f"{study.report}: was changed after the analysis that began at ")
    seal(study)
    assert remark in examine(study).remarks
    write_report(study, "edited")
    assert any("not by an analysis" in text for text in find(study))
    write_report(study, "third")
    with sealing.sealing_analysis(study):
        write_report(study, "fourth")
    assert not any("did not finish" in one for one in examine(study).remarks)


# What contradicts.


def test_a_change_names_file_line_and_anchor(study: StudyFolder) -> None:
    append(study.settings, b"# changed\n")
    (finding,) = find(study)
    line = len(study.settings.read_text().splitlines())
    assert finding.startswith(
        f"{study.settings}, line {line}: was changed since the checkpoint of "
    )
    seal(study)
    assert find(study) == (finding,), "another checkpoint does not cover it up"
    seal(study, reason="a comment")
    found = examine(study)
    assert found.findings == ()
    assert any(text.endswith("(a comment)") for text in found.remarks)


@pytest.mark.parametrize("damage", ["gone", "cut", "other"])
def test_a_chain_that_is_not_the_anchored_one_is_found(study: StudyFolder, damage: str) -> None:
    path, content = find_chain(study), find_chain(study).read_bytes()
    assert examine(study).sentence.startswith("nothing was changed since the anchor of ")
    path.unlink()
    if damage == "cut":
        path.write_bytes(b"".join(content.splitlines(keepends=True)[:-1]))
    if damage == "other":
        study.journals[0].write_bytes(study.journals[0].read_bytes()[:-300])
        seal(study)
    findings = find(study)
    assert any(text.startswith(f"{path}: ") for text in findings)
    if damage == "other":
        assert any(text.startswith(str(study.journals[0])) for text in findings)


def test_a_signed_anchor_cannot_be_edited_nor_a_bare_one_put_after_it(
    study: StudyFolder, home: Path
) -> None:
    path, fingerprint = sealing.choose_key()
    assert path.stat().st_mode & 0o777 == 0o600
    seal(study, reason="signed")
    (file,) = home.glob("*/anchors.jsonl")
    assert [p.stem for p in file.parent.glob("rig-*.pub")] == [f"rig-{fingerprint}"]
    bare, signed = file.read_bytes().splitlines(keepends=True)
    assert find(study) == ()
    file.write_bytes(bare + signed.replace(b'"lines": ', b'"lines": 1'))
    assert any("the signature is wrong" in text for text in find(study))
    file.write_bytes(bare + signed + bare)
    assert any("is not signed, those before it are" in text for text in find(study))
    file.write_bytes(bare + signed)
    path.unlink()
    sealing.choose_key()
    seal(study, reason="another rig")
    found = examine(study)
    assert found.findings == ()
    assert any("signed with several keys" in text for text in found.remarks)


def test_a_copy_goes_on_for_itself_and_a_chain_that_was_turned_back_contradicts(
    study: StudyFolder, tmp_path: Path
) -> None:
    twin = StudyFolder(tmp_path / "twin")
    shutil.copytree(study.path, twin.path)
    before = find_chain(study).read_bytes()
    for one in (twin, study):
        assert seal(one, reason="each for itself").problems == ()
    assert find(twin) == find(study) == ()
    find_chain(study).write_bytes(before)
    assert "takes no anchor" in seal(study, reason="another way").problems[0]
    (finding,) = find(study)
    assert "is not the one anchored in" in finding
    assert find(twin) == ()


def test_a_passphrase_protects_a_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "rig.key"
    keys.make_key(path, passphrase="correct horse")  # noqa: S106 - of this test
    with pytest.raises(FileExistsError):
        keys.make_key(path)
    with pytest.raises(ValueError, match="needs its passphrase"):
        keys.open_key(path)
    monkeypatch.setenv(keys.PASSPHRASE, "wrong")
    with pytest.raises(ValueError, match="another passphrase"):
        keys.open_key(path)
    monkeypatch.setenv(keys.PASSPHRASE, "correct horse")
    assert keys.is_signed(
        b"x", keys.open_key(path).sign(b"x").hex(), keys.export_public(keys.open_key(path))
    )
    (tmp_path / "study.toml").touch()
    with pytest.raises(ValueError, match="must not be in a study's folder"):
        keys.make_key(tmp_path / "deep" / "rig.key")


def test_a_git_remote_keeps_anchors(study: StudyFolder, tmp_path: Path) -> None:
    remote = tmp_path / "remote.git"
    subprocess.run(["git", "init", "-q", "--bare", str(remote)], check=True)
    anchors.add_rules(remote=str(remote))
    assert seal(study, reason="pushed").places[-1] == str(remote)
    shutil.rmtree(tmp_path / "anchors")
    shutil.rmtree(tmp_path / "config" / "git")  # another computer
    found = examine(study)
    assert (found.findings, str(remote) in found.sentence) == ((), True)
    find_chain(study).unlink()
    seal(study)
    assert any("is another chain than the one anchored" in text for text in find(study))
    shutil.rmtree(remote)
    assert any("could not be looked at" in text for text in examine(study).remarks)


def test_a_code_is_compared_and_its_errors_are_found(
    study: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    code = seal(study).code
    tip = read_tip(study)
    assert tip is not None
    assert codes.read_code(code.lower().replace("-", " ")) == (tip.lines, tip.sha256[:20])
    rng = random.SystemRandom()
    place = rng.choice([n for n, letter in enumerate(code) if letter != "-"])
    wrong = code[:place] + next(c for c in codes.ALPHABET if c != code[place]) + code[place + 1 :]
    with pytest.raises(ValueError, match="a character is wrong"):
        codes.read_code(wrong)
    assert main(["audit", str(study.path), "--code", code]) == 0
    other = codes.write_code(Tip("", tip.lines, "0" * 64, ""))
    assert main(["audit", str(study.path), "--code", other]) == 1
    assert "is not the one of the code" in capsys.readouterr().out


def test_seal_and_audit_on_the_command_line(
    study: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(study.path)
    assert main(["seal", folder, "--make-key", "--to", str(tmp_path / "usb"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["places"] == [str(tmp_path / "anchors"), str(tmp_path / "usb")]
    assert main(["audit", folder]) == 0
    assert "nothing was changed since the anchor of " in capsys.readouterr().out
    study.settings.write_text(SETTINGS + "\n" * 3)
    assert main(["audit", folder, "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["sentence"].startswith("compared with the anchor")


# Places.


def test_a_place_that_is_not_there_is_not_made_anew(study: StudyFolder, home: Path) -> None:
    home.rename(home.with_name("unplugged"))
    (problem,) = seal(study, reason="one").problems
    assert "there is no such folder now" in problem
    home.mkdir()  # a mount point
    (problem,) = seal(study, reason="two").problems
    assert "connect the drive" in problem
    assert not list(home.iterdir())
    assert any("could not be looked at" in text for text in examine(study).remarks)
    home.rmdir()
    home.with_name("unplugged").rename(home)
    assert (seal(study).problems, find(study)) == ((), ())


def test_a_place_that_takes_no_anchor_is_not_kept(
    study: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = anchors.read_rules()
    assert main(["seal", str(study.path), "--git", str(tmp_path / "nowhere.git")]) == 0
    assert "takes no anchor" in capsys.readouterr().err
    assert anchors.read_rules() == before
    assert not list((tmp_path / "config" / "git").glob("*/.git")), "nor half a clone"
    url = "https://joe:s3cret@localhost:1/x.git"
    assert main(["seal", str(study.path), "--git", url]) != 0
    said = "".join(capsys.readouterr())
    assert "must hold no password" in said
    assert "s3cret" not in said
    assert main(["seal", str(study.path), "--to", str(study.path / "inside")]) != 0
    assert not (study.path / "inside").exists()
    assert anchors.read_rules() == before


def test_places_are_lists(study: StudyFolder, tmp_path: Path) -> None:
    (tmp_path / "config" / "anchors.toml").write_text('folders = "/tmp/q"\n', encoding="utf-8")
    with pytest.raises(ValueError, match=r"anchors\.toml: .*folders must be a list"):
        seal(study)


@pytest.mark.skipif(os.name == "nt", reason="no modes")
def test_nobody_else_may_read_anchors(study: StudyFolder, home: Path, tmp_path: Path) -> None:
    assert study.path.is_dir()
    (folder,) = (one for one in home.iterdir() if one.is_dir())
    found = {one.name: one.stat().st_mode & 0o077 for one in folder.iterdir()}
    assert found == {"checkpoints.jsonl": 0, "anchors.jsonl": 0}
    assert not folder.stat().st_mode & 0o077
    assert not (tmp_path / "config" / "anchors.toml").stat().st_mode & 0o077


def test_an_anchor_tells_when_it_was_put_and_by_which_key(study: StudyFolder, home: Path) -> None:
    _, fingerprint = sealing.choose_key()
    tip = take_checkpoint(study, by="seal", reason="first", now=utc_now)
    time.sleep(0.02)
    begun = utc_now().isoformat(timespec="milliseconds")
    assert seal(study).utc == tip.utc
    own = max(anchors.read_kept().witnesses, key=lambda one: one.utc)
    assert own.utc >= begun > own.checkpoint_utc == tip.utc
    said = examine(study).sentence
    assert (
        f"anchor of {own.utc} in {home} (checkpoint of {tip.utc}, signed by {fingerprint}" in said
    )
    (file,) = home.glob("*/anchors.jsonl")
    content = file.read_bytes()
    assert seal(study).problems == ()
    assert file.read_bytes() == content, "the older date is kept"
    bare = replace(own, key="", signature="", place="")
    (line,) = (one for one in content.splitlines() if own.key.encode() in one)
    entry = {k: v for k, v in asdict(bare).items() if k != "place"}
    file.write_bytes(content.replace(line, json.dumps(entry).encode()))
    assert any("is not signed; this rig signs with" in text for text in find(study))
    assert "not signed)" in examine(study).sentence


def test_an_anchor_that_cannot_be_read_stops_no_audit(study: StudyFolder, home: Path) -> None:
    append(study.journals[0], b"{}\n")
    (file,) = home.glob("*/anchors.jsonl")
    file.unlink()
    file.mkdir()
    found = find(study)
    assert any(str(study.journals[0]) in text for text in found)
    assert any(text.startswith(f"{file}: could not be looked at") for text in found), "its own"
    other = home / "of somebody else" / "anchors.jsonl"
    other.mkdir(parents=True)
    assert any(text.startswith(str(other)) for text in examine(study).remarks)


def test_a_certificate_may_be_tidied_away_as_long_as_no_session_used_it(study: StudyFolder) -> None:
    study.calibration.mkdir()
    used = json.loads(study.journals[0].read_bytes().splitlines()[0])["previous"]
    names = [study.calibration / f"{name}.json" for name in ("unused-2026", used)]
    for path in names:
        path.write_text("{}")
    seal(study)
    for path in names:
        path.unlink()
    seal(study, reason="tidied")
    (finding,) = find(study)
    assert finding.startswith(f"{names[1]}: is gone")


def test_a_damaged_chain_is_named_and_so_is_its_copy(study: StudyFolder, home: Path) -> None:
    append(find_chain(study), b"x\n")
    (finding,) = find(study)
    assert finding.startswith(f"{find_chain(study)}, line ")
    assert finding.endswith(f"{home} holds one")
    with pytest.raises(ValueError, match="audit tells which anchors hold one"):
        seal(study)
    shutil.rmtree(home)
    assert examine(study).sentence.startswith("the checkpoints cannot be read")


def test_two_rigs_push_to_one_remote(
    study: StudyFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    remote, other = tmp_path / "remote.git", StudyFolder(tmp_path / "other")
    subprocess.run(["git", "init", "-q", "--bare", str(remote)], check=True)
    shutil.copytree(study.path, other.path)
    anchors.add_rules(remote=str(remote))
    assert seal(study, reason="a first one").problems == ()
    update = anchors._update_clone

    def be_slow(place: str) -> Path:
        """Let the other rig push between this rig's pull and its push."""
        clone = update(place)
        monkeypatch.setattr(anchors, "_update_clone", update)
        with monkeypatch.context() as patch:
            patch.setenv("FEEL321_CONFIG", str(tmp_path / "rig 2"))
            anchors.add_rules(remote=str(remote))
            assert seal(other, reason="of the other").problems == ()
        return clone

    monkeypatch.setattr(anchors, "_update_clone", be_slow)
    assert seal(study, reason="of this one").problems == ()
    assert (find(study), find(other)) == ((), ())


# Kills.


def seal_forever(path: Path) -> None:
    study = StudyFolder(path)
    for number in range(10_000):
        seal(study, reason=f"{number}")


@pytest.fixture
def forked() -> Iterator[Callable[[Path], Any]]:
    children = []

    def fork(path: Path) -> Any:
        child = multiprocessing.get_context("fork").Process(target=seal_forever, args=(path,))
        child.start()
        children.append(child)
        return child

    yield fork
    for child in children:
        child.kill()
        child.join()


@pytest.mark.skipif(os.name == "nt", reason="no fork")
def test_a_kill_while_sealing_accuses_nobody(study: StudyFolder, forked: Any) -> None:
    rng = random.SystemRandom()
    for _ in range(6):
        child = forked(study.path)
        time.sleep(rng.uniform(0.005, 0.15))
        os.kill(child.pid, signal.SIGKILL)
        child.join()
        assert find(study) == ()
    assert seal(study, reason="after all").problems == ()
    assert find(study) == ()
