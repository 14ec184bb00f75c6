"""A small study from build to table, in one process; what is broken off goes on; audit and status tell the truth."""

import json
import shutil
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.check import build_study, find_warnings
from feel321.study.folder import StudyFolder
from feel321.study.participants.roster import Tombstone, write_tombstone
from feel321.study.ratings import write_ratings
from feel321.study.session.events import SessionReleased
from feel321.study.session.journal import create_journal
from feel321.study.settings.read import read_settings
from feel321.study.simulate import SIDE_BY_SIDE, list_participants, simulate_study
from feel321.study.status import read_status
from tests.study.conftest import audit_study


def simulate(
    study: StudyFolder, *, participants: int = 3, seed: int | None = None, **options: Any
) -> int:
    return simulate_study(
        study, participants=participants, seed=seed, now=lambda: datetime.now(UTC), **options
    )


def test_build_and_simulate_load_nothing_that_they_do_not_need(tmp_path: Path) -> None:
    left_out = ("feel321.analysis", "pandas", "statsmodels", "matplotlib", "sklearn", "formulaic")
    recording = '[[recordings]]\nscene = "bumps"\nduration_s = 0.3\n'
    (tmp_path / "study.toml").write_text(recording + '[stimuli]\nreducers = ["sax321", "dft321"]\n')
    code = (
        "import sys\nfrom feel321.study.cli import main\n"
        f"assert [main([*verb, sys.argv[1]]) for verb in (['build'], ['simulate', '--participants', '1'])] == [0, 0]\n"
        f"print([name for name in sys.modules if name.startswith({left_out})])"
    )
    done = [sys.executable, "-c", code, str(tmp_path)]
    assert subprocess.check_output(done, text=True).splitlines()[-1] == "[]"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A study that three participants have finished; to be copied, not touched."""
    study = StudyFolder(tmp_path_factory.mktemp("whole"))
    text = '[[recordings]]\nscene = "bumps"\nduration_s = 0.5\n[[recordings]]\nscene = "hard_taps"\nduration_s = 0.5\n'
    study.settings.write_text(
        f'{text}[stimuli]\nreducers = ["sax321", "dft321"]\n', encoding="utf-8"
    )
    build_study(study)
    simulate(study)
    return study


@pytest.fixture
def copy(whole: StudyFolder, tmp_path: Path) -> StudyFolder:
    shutil.copytree(whole.path, tmp_path / "copy")
    for name in ("ratings.csv", "participants.csv"):  # of what is cut afterwards
        (tmp_path / "copy" / name).unlink()
    shutil.rmtree(tmp_path / "copy" / ".evidence")
    return StudyFolder(tmp_path / "copy")


def test_progress_counts_what_earlier_runs_did(copy: StudyFolder) -> None:
    lines = copy.journals[0].read_bytes().splitlines(keepends=True)
    events = [(number, json.loads(line)) for number, line in enumerate(lines, start=1)]
    # Trials of the main phase are numbered first.
    rated = [
        number
        for number, event in events
        if event["event"] == "rated" and event["data"]["trial"] <= 20
    ]
    copy.journals[0].write_bytes(b"".join(lines[: rated[4]]))
    steps: list[tuple[int, int]] = []
    simulate(copy, participants=4, progress=lambda done, total: steps.append((done, total)))
    assert steps[-1] == (80, 80)
    # Two were finished and one was rated to its fifth trial: 15 and 20 trials are left, three sessions are found.
    assert len(steps) == 15 + 20 + 3


def test_who_was_released_or_withdrew_is_not_simulated_again(copy: StudyFolder) -> None:
    path = copy.sessions / "sim001" / "session-02.jsonl"  # the newest journal counts
    create_journal(path, now=lambda: datetime.now(UTC)).write(SessionReleased())
    gone = Tombstone("sim003", 3, True, "2026-01-01", "", (), "removed")
    write_tombstone(copy.sessions / "sim003", gone)
    assert list_participants(copy, 3) == ["sim002", "sim004", "sim005"]


def test_what_was_mended_on_resuming_is_reported(copy: StudyFolder) -> None:
    torn = copy.journals[1]
    torn.write_bytes(torn.read_bytes()[:-9])
    notices: list[str] = []
    simulate(copy, participants=3, warn=notices.append)
    (mended,) = notices
    assert mended.startswith(f"{torn}: ")
    assert mended.endswith("were moved to session-01.jsonl.torn1")
    simulate(copy, participants=3, warn=notices.append)
    assert len(notices) == 1


def test_an_error_in_one_session_ends_the_others_with_the_trial_that_they_are_in(
    copy: StudyFolder,
) -> None:
    shutil.rmtree(copy.sessions)

    fault = iter([RuntimeError("a fault in one of them")])

    def fail_once(done: int, total: int) -> None:
        assert (done < 240, total) == (True, 240)
        for error in fault:
            raise error

    with pytest.raises(RuntimeError, match="a fault in one of them"):
        simulate(copy, participants=12, progress=fail_once)
    assert sum(entry.done for entry in read_status(copy).participants) <= 4 * SIDE_BY_SIDE
    assert audit_study(copy) == []
    assert simulate(copy, participants=12) == 240


def test_resuming_from_any_record_gives_the_same_table(
    whole: StudyFolder, copy: StudyFolder
) -> None:
    journal = copy.journals[1]
    lines = journal.read_bytes().splitlines(keepends=True)
    for kept in range(0, len(lines), 5):
        shutil.rmtree(copy.path / ".evidence", ignore_errors=True)
        journal.write_bytes(b"".join(lines[:kept]) + lines[kept][:9])
        assert (
            read_status(copy).participants[1].warnings[0]
            == "9 bytes of an unfinished line, moved aside on resuming"
        )
        simulate(copy)
        assert copy.ratings.read_bytes() == whole.ratings.read_bytes()
        assert audit_study(copy) == []


@pytest.mark.parametrize(
    ("added", "seed", "message"),
    [
        ("", 4, r"begun otherwise \(presenter.seed 321 -> 4\)"),
        ("[study]\nseed = 9\n", None, "seed: built with 321; the settings say 9; run feel321 build"),
        ("[session]\nconsent = 'We record nothing.'\n", None,
         r"\(other texts for participants; consent 'Taking part.*' -> 'We record nothing.'\); change that back, begin"),
        ("[observer]\nnoise_sd = 9\n", None,
         r"begun otherwise \(presenter\.observer\.noise_sd 8\.0 -> 9\.0\); .* or move sessions/ away"),
    ],
)  # fmt: skip
def test_what_was_changed_is_named_to_sessions_that_began(
    copy: StudyFolder, added: str, seed: int | None, message: str
) -> None:
    copy.settings.write_text(copy.settings.read_text(encoding="utf-8") + added, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        simulate(copy, seed=seed)


def test_a_set_built_anew_from_other_reducers_is_refused(copy: StudyFolder) -> None:
    text = copy.settings.read_text(encoding="utf-8").replace("sax321", "say321")
    copy.settings.write_text(text, encoding="utf-8")
    # A build refuses to replace a set that was judged, so the sessions come back after it.
    copy.sessions.rename(copy.path / "aside")
    build_study(copy)
    (copy.path / "aside").rename(copy.sessions)
    with pytest.raises(ValueError, match=r"stimuli_sha256 '.*' -> '.*'"):
        simulate(copy)
    assert any(
        "names another stimulus set than the one that is built" in line
        for line in audit_study(copy)
    )
    with pytest.raises(ValueError, match="was planned with stimulus set"):
        write_ratings(copy, read_stimuli(copy.stimuli))


def test_check_warns_of_an_order_that_cannot_be_kept(copy: StudyFolder) -> None:
    assert find_warnings(copy, read_settings(copy.settings)) == []  # Squares have no such rule.
    taps = '[[recordings]]\nscene = "hard_taps"\nduration_s = 0.5\n'
    text = copy.settings.read_text(encoding="utf-8").replace(taps, "")
    copy.settings.write_text(text + '[session]\norder = "random"\n', encoding="utf-8")
    shutil.rmtree(copy.sessions)
    build_study(copy)
    assert find_warnings(copy, read_settings(copy.settings)) == [
        f"order 'random': {task}: 4 of 5 trials follow one of the same recording"
        for task in ("realism", "similarity")
    ]
    shutil.rmtree(copy.stimuli)
    assert find_warnings(copy, read_settings(copy.settings)) == []
