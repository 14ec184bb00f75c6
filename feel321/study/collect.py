"""Sessions of other stations, collected into one study: only what is verified is copied, and nothing is overwritten.

Every journal's chain is followed before and after the copy. A longer journal takes the place of a shorter one that it
continues; whatever else differs is refused with both names. A file is whole or absent, a journal comes after all files
that it names, and a second run copies what a first one left: killed at any point, the same call continues. Sources are
only read.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from feel321.doors import announce
from feel321.files import hold_lock, make_folder, write_bytes
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.auditing.journals import list_files
from feel321.study.folder import require_study
from feel321.study.ledger import database, progress, slots
from feel321.study.persons import withdrawal
from feel321.study.persons.answers import PERSONAL_FILE
from feel321.study.session import journal as journals
from feel321.study.session.identity import find_differences
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE, require_own_plan
from feel321.study.settings.read import make_design, make_terms, read_settings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    import sqlalchemy as sa

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock

COLLECT_LOCK = ".collect.lock"


@dataclass(slots=True)
class Collected:
    """What was collected: of whom something came, how many files and bytes; what was refused, what else to say."""

    participants: list[str] = field(default_factory=list)
    files: int = 0
    size: int = 0
    refused: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Holding:
    """What one study folder holds of a participant, verified.

    journals: the whole lines of each; files: digests of the files that journals name, or that torn lines were moved to;
    gone: names of files that journals name and that are not there.
    """

    folder: Path
    tombstone: progress.Tombstone | None
    number: int
    simulated: bool
    state: str = "withdrawn"
    plan: bytes = b""
    stimuli_sha256: str = ""
    journals: Mapping[str, bytes] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    gone: frozenset[str] = frozenset()
    personal: str = ""


@dataclass(frozen=True, slots=True)
class Piece:
    """A file that is to be copied: where it is, its digest, and of a journal, which may grow, how much of it."""

    path: Path
    sha256: str
    size: int | None = None


@dataclass(frozen=True, slots=True)
class Gathered:
    """What all folders together hold of a participant.

    take: name of each file that is to be copied -> what of it.
    withdrew: the folder whose tombstone says that the data here are to go.
    """

    number: int
    simulated: bool
    state: str
    is_here: bool
    take: Mapping[str, Piece]
    withdrew: Path | None = None


def collect_sessions(
    study: StudyFolder,
    sources: Sequence[Path],
    *,
    now: Clock,
    follow: Callable[[int, int], None] | None = None,
) -> Collected:
    """Collect the sessions of other stations' study folders into a study."""
    others = [require_study(path) for path in dict.fromkeys(path.resolve() for path in sources)]
    if any(other.path == study.path.resolve() for other in others):
        raise ValueError(f"{study.path}: is the study itself; name the folders of other stations")
    for other in others:
        _check_alike(study, other)
    study.make_sessions()
    busy = "sessions are being collected here; let that finish"
    with hold_lock(study.sessions / COLLECT_LOCK, busy=busy):
        collected = Collected()
        ledger, notice = slots.open_study_ledger(study, now=now)
        gathered = _gather_all(study, others, collected, known=slots.recall(ledger))
        claimed = _claim_first(ledger, gathered)
        for done, (participant, one) in enumerate(gathered.items(), start=1):
            announce(participant)
            _copy_participant(study.sessions / participant, one, collected)
            if follow is not None:
                follow(done, len(gathered))
        if notice:
            collected.notes.append(notice)
        for participant in claimed:
            if not (study.sessions / participant / PLAN_FILE).exists():  # the copy failed
                slots.enter(ledger, participant, None)
        _enter_all(study, ledger, collected, participants=gathered)
        _withdraw_all(study, gathered, collected, now=now)
    return collected


def _check_alike(study: StudyFolder, other: StudyFolder) -> None:
    """Refuse a study that plans sessions otherwise."""
    terms = []
    for one in (study, other):
        settings = read_settings(one.settings)
        terms.append(make_terms(make_design(settings, one.path), settings, one.path))
    if differences := find_differences(*terms):
        raise ValueError(
            f"{other.settings}: differs from {study.settings} ({'; '.join(differences)}); "
            "collect only what was run with the same settings"
        )


# What each folder holds, and what all of them hold together.


def read_holding(folder: Path) -> Holding:
    """Read what a study folder holds of a participant; what is not as it was written is refused."""
    tombstone = progress.read_tombstone(folder)
    if tombstone is not None:
        if tombstone.state != progress.REMOVED:
            raise ValueError(f"{folder}: a withdrawal was interrupted; finish it there first")
        return Holding(folder, tombstone, tombstone.number, tombstone.simulated)
    plan, found, chains = require_own_plan(folder), {}, list[journals.Chain]()
    gone: set[str] = set()
    files = {path.name: _digest(path) for path in sorted(folder.glob("session-*.torn*"))}
    for path in journals.list_journals(folder):
        found[path.name] = read_lines(path)
        chains.append(journals.read_chain(found[path.name], str(path)))
        for _, file, sha256 in list_files(chains[-1].records, folder):
            name = file.relative_to(folder).as_posix()
            if file.is_file():
                files[name] = _check_digest(file, sha256)
            else:
                gone.add(name)
    state = progress.find_state(chains[-1].records) if chains else "claimed"
    text = (folder / PLAN_FILE).read_bytes()
    facts = (plan.number, plan.simulated, state, text, plan.stimuli_sha256)
    apart = folder / PERSONAL_FILE
    personal = _digest(apart) if apart.is_file() else ""
    return Holding(folder, None, *facts, found, files, frozenset(gone), personal)


def read_lines(path: Path) -> bytes:
    """Read the whole lines of a journal: a session may be writing one."""
    content = path.read_bytes()
    return content[: content.rfind(b"\n") + 1]


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _check_digest(path: Path, sha256: str) -> str:
    if _digest(path) != sha256:
        raise ValueError(f"{path}: was changed since it was written; restore it from a copy")
    return sha256


def _gather_all(
    study: StudyFolder,
    others: Iterable[StudyFolder],
    collected: Collected,
    *,
    known: Sequence[database.Entry],
) -> dict[str, Gathered]:
    """Gather what is held of every participant, without those of whom the folders contradict each other."""
    folders: dict[str, list[Path]] = defaultdict(list)
    for one in (study, *others):
        for folder in one.participants:
            folders[folder.name].append(folder)
    stimuli_sha256 = read_stimuli(study.stimuli).sha256
    gathered = {}
    for participant in sorted(folders):
        try:
            held = [read_holding(folder) for folder in folders[participant]]
            gathered[participant] = _gather(
                held, study.sessions, stimuli_sha256=stimuli_sha256, notes=collected.notes
            )
        except (OSError, ValueError) as error:
            collected.refused.append(f"participant {participant}: {error}")
    for participant, reason in _find_doubles(gathered, known):
        if gathered.pop(participant, None):
            collected.refused.append(f"participant {participant}: {reason}")
    return gathered


def _gather(
    held: Sequence[Holding], home: Path, *, stimuli_sha256: str, notes: list[str]
) -> Gathered:
    """Gather what several folders hold of one participant; where they contradict each other, both are named."""
    first = held[0]
    own = first if first.folder.parent == home else None
    if any(one.tombstone for one in held):
        return _gather_withdrawn(held, own, notes)
    for one in held:
        if one.plan != first.plan:
            raise ValueError(f"{_name(first, one)}: have different plans; keep the right one")
        if one.stimuli_sha256 != stimuli_sha256:
            raise ValueError(f"{one.folder}: was planned with another stimulus set; keep it apart")
    take: dict[str, Piece] = {}
    if own is None:
        take[PLAN_FILE] = _cut_piece(first.folder / PLAN_FILE, first.plan)
    take |= _choose_files(held, own)
    notes += _find_gone(held)
    newest = first
    for name in sorted({name for one in held for name in one.journals}, key=_sort_sessions):
        newest = _find_longest(name, [one for one in held if name in one.journals])
        if newest is not own and (own is None or own.journals.get(name) != newest.journals[name]):
            take[name] = _cut_piece(newest.folder / name, newest.journals[name])
    take |= _take_personal(newest, own)
    return Gathered(first.number, first.simulated, newest.state, own is not None, take)


def _take_personal(newest: Holding, own: Holding | None) -> dict[str, Piece]:
    """Take the personal answers from where the newest journal is longest, for that names them."""
    if not newest.personal or (own and own.personal == newest.personal):
        return {}
    return {PERSONAL_FILE: Piece(newest.folder / PERSONAL_FILE, newest.personal)}


def _cut_piece(path: Path, content: bytes) -> Piece:
    return Piece(path, hashlib.sha256(content).hexdigest(), len(content))


def _find_gone(held: Sequence[Holding]) -> Iterator[str]:
    """Find files that journals name and no folder holds; all else of the participant is still worth collecting."""
    there = {name for one in held for name in one.files}
    for one in held:
        for name in sorted(one.gone - there):
            yield f"{one.folder / name}: is gone, though a journal names it; restore it from a copy"


def _name(*held: Holding) -> str:
    return " and ".join(str(one.folder) for one in held)


def _sort_sessions(name: str) -> tuple[int, str]:
    return len(name), name


def _gather_withdrawn(held: Sequence[Holding], own: Holding | None, notes: list[str]) -> Gathered:
    stones = [one for one in held if one.tombstone]
    first = min(stones, key=lambda one: (one is not own, str(one.tombstone and one.tombstone.utc)))
    for one in held:
        if (one.number, one.simulated) != (first.number, first.simulated):
            raise ValueError(f"{_name(first, one)}: have different numbers; keep the right one")
        if one is not own and not one.tombstone:
            notes.append(
                f"{one.folder}: participant withdrew, see {first.folder}; remove the data there too: feel321 withdraw"
            )
    facts = first.number, first.simulated, "withdrawn", own is not None
    if own is None:
        path = first.folder / TOMBSTONE_FILE
        return Gathered(*facts, {TOMBSTONE_FILE: Piece(path, _digest(path))})
    return Gathered(*facts, {}, None if own.tombstone else first.folder)


def _choose_files(held: Sequence[Holding], own: Holding | None) -> dict[str, Piece]:
    chosen: dict[str, Piece] = {}
    for one in held:
        for name, sha256 in one.files.items():
            other = chosen.setdefault(name, Piece(one.folder / name, sha256))
            if other.sha256 != sha256:
                raise ValueError(
                    f"{other.path} and {one.folder / name}: differ; keep the right one"
                )
    return {name: chosen[name] for name in sorted(chosen) if own is None or name not in own.files}


def _find_longest(name: str, held: Sequence[Holding]) -> Holding:
    longest = max(held, key=lambda one: len(one.journals[name]))
    whole = longest.journals[name]
    for one in held:
        if not whole.startswith(one.journals[name]):
            pairs = zip(whole.splitlines(), one.journals[name].splitlines(), strict=False)
            line = next(n for n, (left, right) in enumerate(pairs, start=1) if left != right)
            raise ValueError(
                f"{_name(longest, one)}: {name} differs from line {line} on; keep the right one, move the other away"
            )
    return longest


def _find_doubles(
    gathered: Mapping[str, Gathered], known: Sequence[database.Entry]
) -> Iterator[tuple[str, str]]:
    """Find participants whose number or code another one has, here or in another folder; those who are here stay."""
    for entry in known:
        one = gathered.get(entry.participant)
        if one and (one.number, one.simulated) != (entry.number, entry.simulated):
            reason = f"has number {entry.number} in the ledger, {one.number} in the plan"
            yield entry.participant, f"{reason}; move the wrong one away"
    others = [entry for entry in known if entry.participant not in gathered]
    held: list[tuple[str, Gathered | database.Entry]] = list(gathered.items())
    held += [(entry.participant, entry) for entry in others]
    holders: dict[str, set[str]] = defaultdict(set)
    for name, holder in held:
        holders[f"the code {name.lower()!r}, but for capitals"].add(name)
        if holder.state in database.LIVE:
            kind = "of simulated ones" if holder.simulated else "in the design"
            holders[f"number {holder.number} {kind}"].add(name)
    for what, names in holders.items():
        for name in sorted(names) if len(names) > 1 else ():
            if name in gathered and not gathered[name].is_here:
                rest = ", ".join(sorted(names - {name}))
                yield (
                    name,
                    f"has {what}, and so has {rest}; withdraw one with --keep-data where the session was held",
                )


# Copies, and the ledger.


def _claim_first(ledger: sa.Engine, gathered: Mapping[str, Gathered]) -> list[str]:
    """Enter who will come in an empty ledger: beside files that are there already, it would pass for a lost one."""
    if database.is_shared(ledger) or slots.recall(ledger):
        return []
    claimed = {name: one for name, one in gathered.items() if one.state in database.LIVE}
    for participant, one in claimed.items():
        entry = database.Entry(participant, one.simulated, one.number, "claimed")
        slots.enter(ledger, participant, entry)
    return list(claimed)


def _copy_participant(folder: Path, one: Gathered, collected: Collected) -> None:
    if not one.take:
        return
    try:
        _refuse_link(folder)
        with withdrawal.hold_folder(folder):
            for unfinished in folder.rglob(".*.part"):  # what a kill left
                unfinished.unlink()
            for name, piece in one.take.items():
                content = _read_verified(piece, before=folder / name)
                _write_verified(folder / name, content)
                collected.files, collected.size = collected.files + 1, collected.size + len(content)
    except (OSError, ValueError) as error:
        collected.refused.append(f"participant {folder.name}: {error}")
    else:
        collected.participants.append(folder.name)


def _refuse_link(folder: Path) -> None:
    if folder.is_symlink():
        raise ValueError(f"{folder}: is a link, so data would go elsewhere; put a folder there")


def _read_verified(piece: Piece, *, before: Path) -> bytes:
    """Read a file as it was surveyed: what a journal has gained since may name files that were not copied."""
    content = piece.path.read_bytes()[: piece.size]
    if hashlib.sha256(content).hexdigest() != piece.sha256:
        raise ValueError(f"{piece.path}: changed while it was collected; run again")
    if piece.size and before.exists() and not content.startswith(read_lines(before)):
        raise ValueError(f"{piece.path}: does not continue {before}; run again")
    return content


def _write_verified(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, and read it back."""
    make_folder(path.parent, private=True)
    write_bytes(path, content, private=True)
    if (written := path.read_bytes()) != content:
        raise OSError(f"{path}: reads back as {len(written)} different bytes; check the disk")


def _enter_all(
    study: StudyFolder, ledger: sa.Engine, collected: Collected, *, participants: Iterable[str]
) -> None:
    """Enter what the folders hold in the ledger, but nothing of which it saw more."""
    known = {entry.participant: entry for entry in slots.recall(ledger)}
    own = {}
    for participant in participants:
        folder = study.sessions / participant
        if not any((folder / name).exists() for name in (PLAN_FILE, TOMBSTONE_FILE)):
            continue  # the copy failed, which was said
        entry = known.get(participant)
        cuts = [journals.find_cut(anchor, folder) for anchor in entry.anchors] if entry else []
        if (folder / TOMBSTONE_FILE).exists() or not any(cuts):
            try:
                own[participant] = slots.read_entry(folder)
            except (OSError, ValueError) as error:
                collected.refused.append(f"participant {participant}: {error}")
        else:
            collected.notes.append(f"{next(filter(None, cuts))}; collect it from where it was seen")
    if all(known.get(name) == entry for name, entry in own.items()):
        return

    def change(before: list[database.Entry]) -> list[database.Entry]:
        station = database.get_station(ledger)
        named = [entry for entry in before if entry.participant in own]
        others = [entry for entry in before if entry.participant not in own]
        return others + slots.merge_entries(
            named, slots.settle(ledger, own.values()), station=station
        )

    try:
        database.rewrite_ledger(ledger, change)
    except ConnectionError as error:
        # Said already, if it was so at the beginning; the next run enters what is here.
        collected.notes += [str(error)] if str(error) not in collected.notes else []


def _withdraw_all(
    study: StudyFolder, gathered: Mapping[str, Gathered], collected: Collected, *, now: Clock
) -> None:
    """Remove the data of those who withdrew elsewhere: a tombstone wins over what a copy still holds."""
    for participant, one in gathered.items():
        if TOMBSTONE_FILE in one.take and (study.sessions / participant).is_dir():
            stone = progress.read_tombstone(study.sessions / participant)
            collected.notes += withdrawal.clear_derived(study, stone) if stone else ()
        if one.withdrew is not None:
            removed = withdrawal.withdraw_participant(
                study,
                participant,
                now=now,
                reason=f"withdrew in {one.withdrew}",
                warn=collected.notes.append,
            )
            collected.notes.append(
                f"participant {participant}: withdrew in {one.withdrew}; {len(removed)} files were removed here"
            )
