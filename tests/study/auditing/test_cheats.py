"""Every way to falsify a study that changes data is seen with a remote."""

import random
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from feel321.study.evidence.audit import examine
from feel321.study.evidence.checkpoints import take_checkpoint
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import utc_now
from tests.study.auditing.cheats import CHEATS, falsify
from tests.study.auditing.finished import make_real, make_simulated

REMARKED = {
    "a bad rater is withdrawn, by the verb",
    "a number is edited after an analysis that was killed",
}
"""Remarks, not findings: to withdraw is a right, and what a kill left half-written may differ."""


@pytest.fixture(scope="session")
def put(tmp_path_factory: pytest.TempPathFactory, scripted: type) -> Callable[[bool], StudyFolder]:
    """Put a finished study, simulated or real, into its place, with a remote beside it."""
    home = tmp_path_factory.mktemp("bench")
    for is_real in (False, True):
        place = home / str(is_real) / "place"
        study = make_real(place, scripted) if is_real else make_simulated(place)
        take_checkpoint(study, "seal", remote=str(place.parent / "remote.git"), now=utc_now)
        assert examine(study).findings == ()
        shutil.copytree(place.parent, home / f"kept {is_real}")

    def take(is_real: bool) -> StudyFolder:
        own: Path = home / str(is_real)
        shutil.rmtree(own)
        shutil.copytree(home / f"kept {is_real}", own)
        return StudyFolder(own / "place")

    return take


def look(names: Iterable[str], put: Callable[[bool], StudyFolder]) -> dict[str, tuple[int, int]]:
    """Falsify the study in each way; how many findings and new remarks there are, by the names of the ways."""
    seen = {}
    for name in names:
        cheat = CHEATS[name]
        study = put(cheat.is_real)
        usual = len(examine(study).remarks)
        falsify(study, cheat)
        # A reviewer names the remote: a cheat need not leave it in the folder.
        found = examine(study, remotes=[str(study.path.parent / "remote.git")])
        seen[name] = len(found.findings), len(found.remarks) - usual
    return seen


def check(seen: dict[str, tuple[int, int]]) -> None:
    unseen = {name for name, (findings, _) in seen.items() if not findings}
    assert unseen <= REMARKED
    assert all(seen[name][1] > 0 for name in unseen)


def test_a_remote_shows_cheats(put: Callable[[bool], StudyFolder]) -> None:
    check(look(random.SystemRandom().sample(list(CHEATS), 10), put))


@pytest.mark.soak
def test_a_remote_shows_every_cheat(put: Callable[[bool], StudyFolder]) -> None:
    assert len(CHEATS) > 45
    check(look(CHEATS, put))
