"""A small study from build to table, in one process; what is broken off goes on; audit and status tell the truth."""

from __future__ import annotations

import json
import shutil
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import pytest

from stimuli.manifest import read_stimuli
from study.audit import audit_study
from study.check import check_study
from study.folder import StudyFolder
from study.journal import create_journal, read_journal
from study.ratings import write_ratings
from study.settings import read_settings
from study.simulate import SIDE_BY_SIDE, Simulation, run_simulation
from study.status import read_status
from study.workflow import analyze_study, build_study, simulate_study

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Edit = Callable[[list[bytes]], list[bytes]]


def simulate(study: StudyFolder, *, participants: int = 3, seed: int | None = None, **options: Any) -> int:
    return simulate_study(study, participants=participants, seed=seed, now=lambda: datetime.now(UTC), **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A study that three participants have finished; to be copied, not touched."""
    study = StudyFolder(tmp_path_factory.mktemp("whole"))
    text = '[[recordings]]\nscene = "bumps"\nduration_s = 0.5\n[[recordings]]\nscene = "hard_taps"\nduration_s = 0.5\n'
    study.settings.write_text(f'{text}[stimuli]\nreducers = ["sax321", "dft321"]\n', encoding="utf-8")
    build_study(study)
    simulate(study)
    return study


@pytest.fixture
def copy(whole: StudyFolder, tmp_path: Path) -> StudyFolder:
    shutil.copytree(whole.path, tmp_path / "copy")
    return StudyFolder(tmp_path / "copy")


def test_three_participants_judge_everything_twice(whole: StudyFolder) -> None:
    n_stimuli = len(read_stimuli(whole.stimuli).stimuli)
    assert n_stimuli == 2 * (2 + 1 + 2)
    status = read_status(whole)
    assert [(s.participant, s.done, s.left) for s in status] == [
        (f"sim00{n}", 2 * n_stimuli, 0) for n in (1, 2, 3)
    ]
    assert all(s.finished and s.simulated and s.last_activity > "2026" for s in status)
    assert audit_study(whole) == []
    assert check_study(whole)[1] == []


def test_progress_counts_every_trial_up_to_the_last(copy: StudyFolder) -> None:
    steps: list[tuple[int, int]] = []
    shutil.rmtree(copy.sessions)
    simulate(copy, progress=lambda done, total: steps.append((done, total)))
    assert steps == [(done, 60) for done in range(1, 61)]


def test_progress_counts_what_earlier_runs_did(copy: StudyFolder) -> None:
    lines = copy.journals[0].read_bytes().splitlines(keepends=True)
    rated = [number for number, line in enumerate(lines, start=1) if b'"event": "rated"' in line]
    copy.journals[0].write_bytes(b"".join(lines[: rated[4]]))
    steps: list[tuple[int, int]] = []
    simulate(copy, participants=4, progress=lambda done, total: steps.append((done, total)))
    assert steps[-1] == (80, 80)
    # Two were finished and one was rated to its fifth trial: 15 and 20 trials are left, three sessions are found.
    assert len(steps) == 15 + 20 + 3


def test_what_was_mended_on_resuming_is_reported(copy: StudyFolder) -> None:
    torn = copy.journals[1]
    torn.write_bytes(torn.read_bytes()[:-9])
    settings, stimuli = read_settings(copy.settings), read_stimuli(copy.stimuli)
    simulation = Simulation(copy, settings, stimuli, settings.study.seed, lambda: datetime.now(UTC))
    notices = run_simulation(simulation, 3)
    assert len(notices) == 1
    assert notices[0].startswith(f"{torn}: ")
    assert notices[0].endswith("were moved to session-01.jsonl.torn1")
    assert run_simulation(simulation, 3) == []


def test_an_error_in_one_session_ends_the_others_with_the_trial_that_they_are_in(copy: StudyFolder) -> None:
    shutil.rmtree(copy.sessions)

    fault = iter([RuntimeError("a fault in one of them")])

    def fail_once(done: int, total: int) -> None:
        assert (done < 240, total) == (True, 240)
        for error in fault:
            raise error

    with pytest.raises(RuntimeError, match="a fault in one of them"):
        simulate(copy, participants=12, progress=fail_once)
    assert sum(entry.done for entry in read_status(copy)) <= 4 * SIDE_BY_SIDE
    assert audit_study(copy) == []
    assert simulate(copy, participants=12) == 240


def test_more_participants_can_join_and_the_first_are_kept(copy: StudyFolder) -> None:
    before = {path: path.read_bytes() for path in copy.journals}
    assert simulate(copy, participants=4) == 80
    assert {path: path.read_bytes() for path in copy.journals if path in before} == before


def test_resuming_from_any_record_gives_the_same_table(whole: StudyFolder, copy: StudyFolder) -> None:
    journal = copy.journals[1]
    lines = journal.read_bytes().splitlines(keepends=True)
    for kept in range(0, len(lines), 5):
        journal.write_bytes(b"".join(lines[:kept]) + lines[kept][:9])
        assert read_status(copy)[1].torn_bytes == 9
        simulate(copy)
        assert copy.ratings.read_bytes() == whole.ratings.read_bytes()
        assert audit_study(copy) == []


def test_another_seed_for_the_same_participants_is_refused(copy: StudyFolder) -> None:
    with pytest.raises(ValueError, match=r"begun otherwise \(presenter.seed 321 -> 4\)"):
        simulate(copy, seed=4)


def test_changed_settings_are_refused_for_sessions_that_began(copy: StudyFolder) -> None:
    copy.settings.write_text(copy.settings.read_text(encoding="utf-8") + "[study]\nseed = 9\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"the study was changed since this plan was stored \(seed 321 -> 9\)"):
        simulate(copy)


def test_another_observer_is_refused_and_only_what_differs_is_named(copy: StudyFolder) -> None:
    copy.settings.write_text(copy.settings.read_text(encoding="utf-8") + "[observer]\nnoise_sd = 9\n", encoding="utf-8")
    message = r"begun otherwise \(presenter\.observer\.noise_sd 8\.0 -> 9\.0\); .* or move sessions/ away"
    with pytest.raises(ValueError, match=message):
        simulate(copy)


def test_a_set_built_anew_from_other_reducers_is_refused(copy: StudyFolder) -> None:
    text = copy.settings.read_text(encoding="utf-8").replace("sax321", "say321")
    copy.settings.write_text(text, encoding="utf-8")
    # A build refuses to replace a set that was judged, so the sessions come back after it.
    copy.sessions.rename(copy.path / "aside")
    build_study(copy)
    (copy.path / "aside").rename(copy.sessions)
    with pytest.raises(ValueError, match=r"stimuli_sha256 '.*' -> '.*'"):
        simulate(copy)
    assert any("names another stimulus set than the one that is built" in line for line in audit_study(copy))
    with pytest.raises(ValueError, match="was written with stimulus set"):
        write_ratings(copy, read_stimuli(copy.stimuli))


@pytest.mark.parametrize(
    ("edit", "finding"),
    [
        (lambda lines: [*lines[:3], lines[3].replace(b'rating": ', b'rating": 1'), *lines[4:]], "line 4: was changed"),
        (lambda lines: lines[:5] + lines[6:], "line 6: does not follow"),
        (lambda lines: [*lines[:5], lines[6], lines[5], *lines[7:]], "line 6: does not follow"),
        (lambda lines: [*lines, lines[-1]], "does not follow"),
        (lambda lines: [*lines, b'{"torn'], "ends in 6 bytes of a line that was never finished"),
    ],
)
def test_audit_names_file_and_line_of_what_was_edited(copy: StudyFolder, edit: Edit, finding: str) -> None:
    journal = copy.journals[0]
    journal.write_bytes(b"".join(edit(journal.read_bytes().splitlines(keepends=True))))
    findings = audit_study(copy)
    assert len(findings) == 1
    assert str(journal) in findings[0]
    assert finding in findings[0]


def test_audit_finds_a_copied_journal_and_a_copied_participant(copy: StudyFolder) -> None:
    shutil.copy(copy.journals[0], copy.sessions / "sim001" / "session-02.jsonl")
    shutil.copytree(copy.sessions / "sim002", copy.sessions / "sim009")
    findings = audit_study(copy)
    assert any("session-02.jsonl: is session 1 of 'sim001', it was copied here" in line for line in findings)
    assert any("sim009/plan.json: is the plan of 'sim002', it was copied here" in line for line in findings)


def test_audit_finds_a_journal_of_another_participant(copy: StudyFolder) -> None:
    shutil.copy(copy.journals[0], copy.journals[1])
    findings = "\n".join(audit_study(copy))
    assert "is session 1 of 'sim001', it was copied here" in findings
    assert "was begun with another plan than the one beside it" in findings
    assert "shows a trial that the plan does not hold" in findings


def test_audit_finds_a_changed_or_missing_plan_and_wav(copy: StudyFolder) -> None:
    plan = copy.sessions / "sim001" / "plan.json"
    entry = json.loads(plan.read_text(encoding="utf-8"))
    entry["seed"] = 4
    plan.write_text(json.dumps(entry), encoding="utf-8")
    (copy.sessions / "sim002" / "plan.json").unlink()
    wav = next(copy.stimuli.glob("*.wav"))
    content = bytearray(wav.read_bytes())
    content[-5] ^= 1
    wav.write_bytes(content)
    findings = audit_study(copy)
    assert any("sim001/plan.json: got no plan, or one that was changed" in line for line in findings)
    assert any("sim002/plan.json" in line for line in findings)
    assert any(wav.name in line for line in findings)


@pytest.mark.parametrize(
    ("events", "finding"),
    [
        ([("rated", {"trial": 1})], ": has no header"),
        ([("begun", None), ("rated", {"trial": 1}), ("rated", {"trial": 1})], ", line 3: rates trial 1, expected 2"),
        ([("begun", None), ("rated", {"trial": 2})], ", line 2: rates trial 2, expected 1"),
        ([("begun", None), ("finished", {})], ", line 2: finished after 0 of 20 trials"),
    ],
)
def test_audit_finds_gaps_and_doubles_in_a_chain_that_holds(
    copy: StudyFolder, events: list[tuple[str, Any]], finding: str
) -> None:
    header = read_journal(copy.journals[0]).records[0].data
    copy.journals[0].unlink()
    journal = create_journal(copy.sessions / "sim001" / "session-01.jsonl", now=lambda: datetime.now(UTC))
    for event, data in events:
        journal.write(event, header if data is None else data)
    assert audit_study(copy) == [f"{journal.path}{finding}"]


def test_a_journal_that_never_got_its_header_is_no_finding(copy: StudyFolder) -> None:
    copy.journals[0].write_bytes(b"")
    assert audit_study(copy) == []


def test_a_session_that_never_got_its_journal_is_shown_as_not_begun(copy: StudyFolder) -> None:
    copy.journals[0].unlink()
    first = read_status(copy)[0]
    assert (first.done, first.left, first.finished, first.simulated, first.last_activity) == (0, 20, False, False, "")


def test_check_finds_every_problem_at_once(copy: StudyFolder) -> None:
    text = '[[recordings]]\nfile = "a.csv"\n[[recordings]]\nfile = "b.csv"\n[rig]\nrate_hz = 44100.5\n'
    copy.settings.write_text(text, encoding="utf-8")
    next(copy.stimuli.glob("*.wav")).unlink()
    problems = check_study(copy)[1]
    for words in ("recording 'a'", "recording 'b'", "study.toml: rate_hz: got 44100.5", ".wav"):
        assert any(words in problem for problem in problems)


def test_check_finds_that_a_protocol_lacks_its_reference(copy: StudyFolder) -> None:
    shutil.rmtree(copy.sessions)
    text = copy.settings.read_text(encoding="utf-8") + 'reference = "none"\n'
    copy.settings.write_text(text, encoding="utf-8")
    build_study(copy)
    assert any("similarity needs exactly one" in problem for problem in check_study(copy)[1])


def test_check_reports_mistakes_in_the_settings_alone(copy: StudyFolder) -> None:
    copy.settings.write_text("[rig]\nzzz = 1", encoding="utf-8")
    assert len(check_study(copy)[1]) == 2


def test_nothing_can_be_analysed_before_anybody_rated(copy: StudyFolder) -> None:
    shutil.rmtree(copy.sessions)
    with pytest.raises(ValueError, match="holds no ratings yet; run sessions first"):
        analyze_study(copy)
