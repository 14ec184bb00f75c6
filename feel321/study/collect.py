"""Sessions of other stations, collected into one study: only what is verified is copied, and nothing is overwritten.

A longer journal takes the place of one that it continues; whatever else differs is refused with both names. A file is
whole or absent, a journal comes after all files that it names, and a second run copies what a first one left: killed
at any point, the same call continues. Sources are only read.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from feel321.files import digest_file, hold_lock, make_folder, sweep, write_bytes
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import withdrawal
from feel321.study.folder import Outcome, StudyFolder, list_delivered, require_study
from feel321.study.participants import roster
from feel321.study.participants.answers import PERSONAL_FILE, read_personal
from feel321.study.participants.roster import find_doubles, hold_numbers, read_holder, read_holders
from feel321.study.session import journal as journals
from feel321.study.session.journal import Clock, digest
from feel321.study.session.opening import find_differences
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE, require_own_plan
from feel321.study.settings.read import make_design, make_identity, read_settings

COLLECT_LOCK = ".collect.lock"


@dataclass(slots=True)
class Collected:
    """What was collected: of whom something came, how many files and bytes; what was refused, what else to say."""

    participants: list[str] = field(default_factory=list)
    files: int = 0
    size: int = 0
    refused: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def report(self, study: StudyFolder) -> Outcome:
        """Say what was done."""
        size, who = f"{self.size / 1e6:.1f} MB", ", ".join(self.participants)
        copied = f"{self.files} files ({size}) of {who}" if self.files else "nothing to copy"
        refused = [f"refused: {line}" for line in self.refused]
        lines = [f"{study.path}: {copied}", *refused, *self.notes]
        return Outcome(asdict(self), lines, failed=bool(refused))

    def copy(self, path: Path, content: bytes) -> None:
        """Write a file whole or not at all, and read it back."""
        make_folder(path.parent, private=True)
        write_bytes(path, content, private=True)
        if (written := path.read_bytes()) != content:
            text = f"reads back as {len(written)} different bytes; check the disk"
            raise OSError(f"{path}: {text}")
        self.files, self.size = self.files + 1, self.size + len(content)


def collect_sessions(
    study: StudyFolder,
    sources: Sequence[Path],
    *,
    now: Clock,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Collected:
    """Collect the sessions of other stations' study folders into a study."""
    others = [require_study(path) for path in dict.fromkeys(path.resolve() for path in sources)]
    if any(other.path == study.path.resolve() for other in others):
        raise ValueError(f"{study.path}: is the study itself; name the folders of other stations")
    terms = {one.path: _read_terms(one) for one in (study, *others)}
    for other in others:
        if differences := find_differences(terms[study.path], terms[other.path]):
            raise ValueError(
                f"{other.settings}: differs from {study.settings} ({'; '.join(differences)}); "
                "collect only what was run with the same settings"
            )
    stimuli_sha256 = read_stimuli(study.stimuli).sha256
    study.make_sessions()
    collected, here = Collected(), {folder.name for folder in study.participants}
    # Those who withdrew or are here already may leave a number to others.
    everybody = sorted(
        (folder for other in others for folder in other.participants),
        key=lambda one: (not (one / TOMBSTONE_FILE).exists(), one.name not in here, one.name),
    )
    busy = "sessions are being collected here; let that finish"
    with hold_lock(study.sessions / COLLECT_LOCK, busy=busy):
        for done, there in enumerate(everybody, start=1):
            _collect_one(study, there, collected, stimuli_sha256=stimuli_sha256, now=now)
            progress(done, len(everybody))
    return collected


def _collect_one(
    study: StudyFolder, there: Path, collected: Collected, *, stimuli_sha256: str, now: Clock
) -> None:
    """Collect one participant of another folder, or say why not."""
    here, before = study.sessions / there.name, collected.files
    try:
        if not _take_withdrawal(study, there, collected, now=now):
            _require_same_plan(here, there, stimuli_sha256)
            _take_session(study, there, collected)
    except (OSError, ValueError) as error:
        collected.refused.append(f"participant {there.name}: {error}")
    if collected.files > before and there.name not in collected.participants:
        collected.participants.append(there.name)


def _read_terms(study: StudyFolder) -> Mapping[str, Any]:
    """Read what all stations of a study have to agree on: all that decides about the sessions."""
    settings = read_settings(study.settings)
    own = asdict(make_design(settings))
    own["tasks"] = {task["protocol"]: task for task in own["tasks"]}
    identity = make_identity(settings, study.path, {})
    return own | {name: identity.get(name) for name in ("locale", "texts_sha256", "rig", "methods")}


def _take_withdrawal(study: StudyFolder, there: Path, collected: Collected, *, now: Clock) -> bool:
    """Withdraw here who withdrew elsewhere; whether the participant withdrew at all."""
    here = study.sessions / there.name
    stone, own = roster.read_tombstone(there), roster.read_tombstone(here)
    if own is not None and own.state == roster.REMOVED:
        if stone is None:
            text = f"participant withdrew, see {here}; remove the data there too: feel321 withdraw"
            collected.notes.append(f"{there}: {text}")
        return True
    if stone is None:
        return own is not None
    if stone.state != roster.REMOVED:
        raise ValueError(f"{there}: a withdrawal was interrupted; finish it there first")
    if there.name not in {folder.name for folder in study.participants}:
        collected.copy(here / TOMBSTONE_FILE, (there / TOMBSTONE_FILE).read_bytes())
        return True
    reason, say = f"withdrew in {there}", collected.notes.append
    removed = withdrawal.withdraw_participant(study, there.name, now=now, reason=reason, warn=say)
    say(f"participant {there.name}: {reason}; {len(removed)} files were removed here")
    return True


def _require_same_plan(here: Path, there: Path, stimuli_sha256: str) -> None:
    if require_own_plan(there).stimuli_sha256 != stimuli_sha256:
        raise ValueError(f"{there}: was planned with another stimulus set; keep it apart")
    if here.is_symlink():
        raise ValueError(f"{here}: is a link, so data would go elsewhere; put a folder there")
    plan, own = there / PLAN_FILE, here / PLAN_FILE
    if own.exists() and own.read_bytes() != plan.read_bytes():
        raise ValueError(f"{here} and {there}: have different plans; keep the right one")


def _take_session(study: StudyFolder, there: Path, collected: Collected) -> None:
    """Copy what another folder holds of a participant, and this one does not."""
    here = study.sessions / there.name
    plan, own = there / PLAN_FILE, here / PLAN_FILE
    files, grown = _compare_journals(here, there)
    missing, gone = _list_missing(here, there, files)
    collected.notes += gone
    if own.exists() and not missing and not grown:
        return
    with withdrawal.hold_folder(here):
        sweep(here)  # what a kill left
        _, grown = _compare_journals(here, there)  # something may have been written meanwhile
        personal = _compare_personal(here, there)
        if not own.exists():
            with hold_numbers(study):
                _check_number(study, there)
                collected.copy(own, plan.read_bytes())
        contents = {name: (there / name).read_bytes() for name in missing}
        if odd := [name for name, content in contents.items() if digest(content) != files[name]]:
            raise ValueError(f"{there / odd[0]}: changed while it was collected; run again")
        if grown and personal:
            contents[PERSONAL_FILE] = personal
        for name, content in (contents | grown).items():
            collected.copy(here / name, content)


def _check_number(study: StudyFolder, there: Path) -> None:
    """Check that nobody here has the number and the code of a newcomer."""
    known = [one for one in read_holders(study) if one.participant != there.name]
    newcomer, before = read_holder(there), set(find_doubles(known))
    doubles = find_doubles([*known, *filter(None, [newcomer])])
    if double := next((line for line in doubles if line not in before), ""):
        raise ValueError(double)


def _compare_journals(here: Path, there: Path) -> tuple[dict[str, str], dict[str, bytes]]:
    """Compare the journals of two folders: digests of the files that belong to them, and those that have grown."""
    files = {path.name: digest_file(path) for path in sorted(there.glob("session-*.torn*"))}
    grown: dict[str, bytes] = {}
    for path in journals.list_journals(there):
        content, own = _read_lines(path), _read_lines(here / path.name)
        for _, file, sha256 in list_delivered(
            journals.read_chain(content, str(path)).records, there
        ):
            files[file.relative_to(there).as_posix()] = sha256
        if content.startswith(own):
            grown |= {path.name: content} if content != own else {}
        elif not own.startswith(content):
            pairs = zip(own.splitlines(), content.splitlines(), strict=False)
            line = next(n for n, (left, right) in enumerate(pairs, start=1) if left != right)
            raise ValueError(
                f"{here / path.name} and {path}: differ from line {line} on; keep the right one, move the other away"
            )
    return files, grown


def _read_lines(path: Path) -> bytes:
    """Read the whole lines of a journal, if it is there: a session may be writing one."""
    content = path.read_bytes() if path.exists() else b""
    return content[: content.rfind(b"\n") + 1]


def _compare_personal(here: Path, there: Path) -> bytes:
    """Return the personal answers of another folder, which must hold those that are here; none that were removed."""
    theirs = read_personal(there)
    if read_personal(here).keys() - theirs.keys():
        files = f"{here / PERSONAL_FILE} and {there / PERSONAL_FILE}"
        raise ValueError(f"{files}: differ; keep the one that has all answers")
    own = [_read_lines(path) for path in journals.list_journals(here)]
    is_known = any(sha256.encode() in content for content in own for sha256 in theirs)
    was_removed = is_known and not (here / PERSONAL_FILE).is_file()
    return b"" if was_removed or not theirs else (there / PERSONAL_FILE).read_bytes()


def _list_missing(here: Path, there: Path, files: dict[str, str]) -> tuple[list[str], list[str]]:
    """List the files that are not here yet, and say which are gone there; one that is here must be the same."""
    missing, gone = [], []
    for name, sha256 in files.items():
        if (here / name).is_file():
            if digest_file(here / name) != sha256:
                raise ValueError(f"{here / name} and {there / name}: differ; keep the right one")
        elif not (there / name).is_file():
            text = "is gone, though a journal names it; restore it from a copy"
            gone.append(f"{there / name}: {text}")
        elif digest_file(there / name) != sha256:
            text = "was changed since it was written; restore it from a copy"
            raise ValueError(f"{there / name}: {text}")
        else:
            missing.append(name)
    return missing, gone
