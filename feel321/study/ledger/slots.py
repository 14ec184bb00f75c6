"""The ledger: who takes part under which number, and how far each session is.

A slot is a number in the design; simulated and real people are counted apart. It is claimed in one transaction,
confirmed when the session finishes, and free again when the participant is given up or withdraws. The ledger only
remembers: plans, journals and tombstones are the truth, from which it can be rebuilt.

Stations that share a ledger on a server have a study folder each. What a participant of another station did is not
here until it is collected, and is not missed.

This module imports SQLAlchemy; import it where it is used, so that the command line answers at once.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from shlex import quote
from typing import Any

import sqlalchemy as sa

from feel321.files import is_held
from feel321.study import server
from feel321.study.folder import StudyFolder
from feel321.study.ledger import database, progress, stations
from feel321.study.ledger.database import LIVE, Entry, read_ledger, rewrite_ledger
from feel321.study.ledger.keeper import check_live
from feel321.study.session.journal import (
    PARTICIPANT_ID,
    Clock,
    create_journal,
    find_cut,
    list_journals,
    read_journal,
    require_journal,
    utc_now,
)
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE, require_own_plan

# Claims.


@dataclass(frozen=True, slots=True)
class Station:
    """Where claims come from, and which numbers are its to give: the `place`th block of every `of`, from 1."""

    # A block has one number of each group, so that every station has all groups.

    name: str = ""
    place: int = 1
    of: int = 1
    block: int = 1

    def list_numbers(self) -> Iterator[int]:
        """List the numbers that are this station's to give, without end."""
        for turn in count(self.place - 1, self.of):
            yield from range(turn * self.block + 1, (turn + 1) * self.block + 1)


ALONE = Station()


def claim_slots(
    ledger: sa.Engine,
    participants: Sequence[str],
    *,
    simulated: bool,
    now: Clock,
    station: Station = ALONE,
) -> dict[str, int]:
    """Give each participant a number, from 1, all in one transaction."""
    for participant in participants:
        if not PARTICIPANT_ID.fullmatch(participant):
            raise ValueError(
                f"participant must be letters, digits, - and _, got {participant!r}; use another code"
            )
    with database.transact(ledger) as connection:
        utc = stations.tell_time(connection, now=now)
        known = {entry.participant: entry for entry in database.read_entries(connection)}
        taken = {
            entry.number
            for entry in known.values()
            if entry.simulated == simulated and entry.state in LIVE
        }
        free = (number for number in station.list_numbers() if number not in taken)
        numbers = {
            name: _keep_slot(known[name], simulated=simulated, station=station)
            if name in known
            else next(free)
            for name in dict.fromkeys(participants)
        }
        _check_capitals([*known, *numbers])
        claimed = [
            Entry(name, simulated, number, "claimed", claimed_utc=utc, station=station.name)
            for name, number in numbers.items()
            if name not in known
        ]
        database.write_entries(connection, claimed)
    return numbers


def claim_numbers(
    study: StudyFolder,
    ledger: sa.Engine,
    participants: Sequence[str],
    *,
    simulated: bool,
    now: Clock,
) -> dict[str, int]:
    """Give participants of a study their numbers; those who were planned here keep theirs without the ledger, too."""
    planned = [name for name in participants if (study.sessions / name / PLAN_FILE).is_file()]
    station = Station(database.get_station(ledger), *server.find_share(study.settings))
    try:
        return claim_slots(ledger, participants, simulated=simulated, now=now, station=station)
    except ConnectionError as error:
        if missing := [name for name in participants if name not in planned]:
            raise ConnectionError(
                f"{error}. Until then, only participants planned at this station can continue, got "
                f"{', '.join(missing)}"
            ) from None
        plans = [require_own_plan(study.sessions / name) for name in planned]
        return {plan.participant: plan.number for plan in plans}


def agree(study: StudyFolder, ledger: sa.Engine, terms: Mapping[str, Any]) -> None:
    """Refuse to plan sessions otherwise than the other stations do; a server out of reach cannot say."""
    remedy = (
        "is it another study of the same name? then give it a name of its own ([study] name). Otherwise make both "
        f"folders alike; or, where this one is right: {_write_rebuild(study)}"
    )
    with suppress(ConnectionError):
        stations.agree_on(ledger, terms, remedy=remedy)


def recall(ledger: sa.Engine, participant: str | None = None) -> list[Entry]:
    """Read what the ledger knows of one participant, or all, which is nothing while its server is out of reach."""
    try:
        return read_ledger(ledger, participant)
    except ConnectionError:
        return []


def _keep_slot(entry: Entry, *, simulated: bool, station: Station) -> int:
    if entry.simulated != simulated:
        got, known = ("simulated", "real") if simulated else ("real", "simulated")
        raise ValueError(
            f"participant {entry.participant}: {known} in the ledger, got a {got} one; use another code"
        )
    check_live(entry)
    if entry.station not in {"", station.name}:
        raise ValueError(
            f"participant {entry.participant}: the session is at station {entry.station}, this one is {station.name}; "
            f"go on there, or, if it never will and all of it was collected here: {server.take_over(entry.station)}"
        )
    return entry.number


def _check_capitals(participants: Sequence[str]) -> None:
    """Refuse codes that differ in capitals only: on many systems they name one folder."""
    named: dict[str, str] = {}
    for name in participants:
        if (other := named.setdefault(name.lower(), name)) != name:
            raise ValueError(
                f"participant {name}: differs from {other} in capitals only; use another code"
            )


# The ledger of a study, rebuilt from its files.

FOLDER_ID = "ledger.folder"
"""File in `sessions/` that tells this study folder from any other in a shared ledger."""

WAS_MISSING = "all that it had seen, for it was missing"


def find_place(study: StudyFolder) -> Path | server.Server:
    """Find where the ledger of a study is."""
    # Rehearsals take no slot, and are nobody else's.
    own = None if study.is_rehearsal else server.find_server(study.settings)
    return own or study.ledger


def name_place(study: StudyFolder) -> str:
    """Name the ledger of a study: its file, or its URL."""
    place = find_place(study)
    return str(place) if isinstance(place, Path) else place.url


def open_study_ledger(study: StudyFolder, *, now: Clock = utc_now) -> tuple[sa.Engine, str]:
    """Open the ledger of a study to write in it; one that is missing is rebuilt, and the log beside it says so.

    A server that is out of reach is said, not raised: sessions that were begun here can go on.
    """
    ledger = _connect(study)
    try:
        database.make_tables(ledger)
        _introduce(ledger, study)
        if known := read_ledger(ledger):
            return ledger, "; ".join(_catch_up(ledger, study, known))
        return ledger, _fill(ledger, study, now=now)
    except ConnectionError as error:
        return ledger, str(error)


def _introduce(ledger: sa.Engine, study: StudyFolder) -> None:
    """Refuse a station's name that another study folder has, but where it was given on purpose."""
    if not database.is_shared(ledger):
        return
    is_own = stations.introduce(ledger, study.sessions / FOLDER_ID)
    if not (is_own or server.is_station_named()):
        name = database.get_station(ledger)
        raise ValueError(
            f"station {name}: another study folder has this name in the ledger, and this computer has the same; give "
            f"this one a name of its own: {server.STATION_VARIABLE}. Where it is the same station, moved or restored: "
            f"{server.take_over(name)}"
        )


def _fill(ledger: sa.Engine, study: StudyFolder, *, now: Clock) -> str:
    """Enter all participants in an empty ledger; returns what to say of it."""
    entries = settle(ledger, _read_disk(study)[0])
    # On the first day on a server, the file is still there: what it saw is compared, and its claims are kept.
    was_moved = database.is_shared(ledger) and study.ledger.exists()
    old = database.read_place(study.ledger)[1] if was_moved else []
    lost = [line for entry in old for line in _find_lost_of(entry, study)]
    entries = merge_entries(settle(ledger, old), entries, station=database.get_station(ledger))

    def change(known: list[Entry]) -> list[Entry]:
        # Another process may have found it missing first, and claimed slots since.
        if not known:
            _log_forgotten(study, lost if was_moved else [WAS_MISSING], now=now)
        return known or entries

    if not (entries or lost) or rewrite_ledger(ledger, change):
        return ""
    done = f"{len(entries)} participants were entered from their plans and journals"
    return f"{database.name_ledger(ledger)}: was {'empty' if was_moved else 'missing'}; {done}"


def settle(ledger: sa.Engine, entries: Iterable[Entry]) -> list[Entry]:
    """Make entries those of this station."""
    return [replace(entry, station=database.get_station(ledger)) for entry in entries]


def _catch_up(ledger: sa.Engine, study: StudyFolder, known: Iterable[Entry]) -> Iterator[str]:
    """Enter what sessions of this station did while the server was out of reach; yield what cannot be read."""
    station = database.get_station(ledger)
    for entry in known:
        folder = study.sessions / entry.participant
        own = entry.station == station and entry.state in {"claimed", "running"}
        if station and own and list_journals(folder) and not is_held(folder / progress.LOCK_FILE):
            try:
                done = progress.read_progress(folder)
            except (OSError, ValueError) as error:
                yield str(error)  # of one participant, who keeps nobody else from a session
                continue
            if not (done.problem or any(find_cut(anchor, folder) for anchor in entry.anchors)):
                enter(ledger, entry.participant, make_entry(done))


def enter(ledger: sa.Engine, participant: str, entry: Entry | None) -> None:
    """Replace the ledger's entry of a participant, as one of this station; None takes it out."""
    entries = settle(ledger, [entry] if entry else [])
    with database.transact(ledger) as connection:
        database.write_entries(connection, entries, instead_of=[participant])


def read_study_ledger(study: StudyFolder) -> list[Entry]:
    """Read the ledger of a study and write nothing."""
    place = find_place(study)
    if not isinstance(place, Path):
        if entries := database.read_place(place)[1]:
            return entries
    elif place.exists():
        return database.read_place(place)[1]
    if any(map(_is_begun, study.participants)):
        raise FileNotFoundError(
            f"{name_place(study)}: is missing, so losses cannot be detected; rebuild it: {_write_rebuild(study)}"
        )
    return []


def read_others(study: StudyFolder) -> tuple[list[Entry], tuple[str, ...]]:
    """Read who is at other stations, and what there is to say: clocks that are off, or a server out of reach."""
    try:
        ledger, entries = database.read_place(find_place(study))
        clocks = stations.read_clocks(ledger) if entries else []
        away = [entry for entry in entries if is_absent(entry, study)]
        return away, tuple(stations.describe_clocks(clocks))
    except (OSError, ValueError) as error:
        return [], (str(error),)


def rebuild_ledger(study: StudyFolder, *, now: Clock = utc_now) -> list[str]:
    """Make the ledger of a study anew from plans, journals and tombstones.

    Slots claimed by participants without a plan so far are kept: they are recorded nowhere else. So is what other
    stations did; and how sessions are planned is settled anew by the next claim. What is forgotten is recorded for good
    in a log beside the ledger.
    """
    place = find_place(study)
    is_file, ledger = isinstance(place, Path), _connect(study)
    was_missing = isinstance(place, Path) and not place.exists()
    database.make_tables(ledger)
    _introduce(ledger, study)
    was_missing = was_missing if is_file else not read_ledger(ledger)
    lost, wrong = ([], []) if was_missing else _compare(study)
    problems: list[str] = []
    # A server waits for nobody's disk.
    read = _read_disk(study) if database.is_shared(ledger) else None

    def change(known: list[Entry]) -> list[Entry]:
        entries, found = read or _read_disk(study)
        problems.extend(found)
        merged = merge_entries(known, settle(ledger, entries), station=database.get_station(ledger))
        _log_forgotten(study, [WAS_MISSING] if was_missing and entries else lost, now=now)
        return merged

    rewrite_ledger(ledger, change)
    stations.forget_terms(ledger)
    return lost + wrong + problems


def merge_entries(known: Iterable[Entry], own: Sequence[Entry], *, station: str) -> list[Entry]:
    """Put what a disk says in place of what the ledger knew, but for claims, and for what other stations did since."""
    merged = {entry.participant: entry for entry in own}
    for entry in known:
        ours = merged.get(entry.participant)
        is_away = entry.station != station
        is_claim = entry.state == "claimed" and not entry.anchors
        if ours is None:
            if is_away or is_claim:
                merged[entry.participant] = entry
        elif is_away and ours.state != "withdrawn":
            is_ahead = entry.state == "withdrawn" or _has_seen(entry, ours)
            merged[entry.participant] = entry if is_ahead else replace(ours, station=entry.station)
    _check_slots(merged.values())
    return list(merged.values())


def _has_seen(entry: Entry, other: Entry) -> bool:
    """Check whether an entry knows at least as much of all journals as another one."""
    seen = {anchor.journal: anchor.lines for anchor in entry.anchors}
    return all(seen.get(anchor.journal, -1) >= anchor.lines for anchor in other.anchors)


def find_lost(study: StudyFolder) -> list[str]:
    """Find what the ledger once saw and the disk no longer holds, the reverse, and what it ever forgot."""
    lost, wrong = _compare(study)
    return lost + wrong + list_forgotten(study)


def make_entry(own: progress.Progress) -> Entry:
    """Make the entry of a participant from plan and journals."""
    # The ledger learns the total with the first line that it sees.
    total = own.total if own.anchors else 0
    known = (own.participant, own.simulated, own.number, own.state, own.done, total, own.anchors)
    return Entry(*known, claimed_utc=own.first_utc)


def _log_forgotten(study: StudyFolder, lines: Sequence[str], *, now: Clock) -> None:
    """Log for good what the ledger forgets with a rebuild: without that, a journal could be cut unseen."""
    if lines:
        begin = require_journal if study.ledger_log.exists() else create_journal
        # The folder may be moved, its log with it.
        forgot = [line.replace(f"{study.path}/", "") for line in lines]
        begin(study.ledger_log, now=now).write("rebuilt", {"forgot": forgot})


def list_forgotten(study: StudyFolder) -> list[str]:
    """List what the ledger ever forgot with a rebuild."""
    if not study.ledger_log.exists():
        return []
    try:
        records = read_journal(study.ledger_log).records
    except (OSError, ValueError) as error:
        return [str(error)]
    return [
        f"{name_place(study)}: was rebuilt at {record.utc}, and forgot: {line}"
        for record in records
        for line in record.data.get("forgot", ())
    ]


def _write_rebuild(study: StudyFolder) -> str:
    return f"feel321 ledger {quote(str(study.path))} --rebuild"


def _connect(study: StudyFolder) -> sa.Engine:
    study.make_sessions()
    return database.connect_ledger(find_place(study))


def _read_disk(study: StudyFolder) -> tuple[list[Entry], list[str]]:
    """Read the entries of all participants, and what is wrong with their journals."""
    everybody = progress.list_progress(study)
    stones = [folder for folder in study.participants if (folder / TOMBSTONE_FILE).exists()]
    entries = [*map(make_entry, everybody), *map(read_entry, stones)]
    _check_slots(entries)
    return entries, [own.problem for own in everybody if own.problem]


def read_entry(folder: Path) -> Entry:
    """Read the entry of a participant from plan and journals, or from the tombstone."""
    if (stone := progress.read_tombstone(folder)) is not None:
        return Entry(stone.participant, stone.simulated, stone.number, "withdrawn")
    return make_entry(progress.read_progress(folder))


def _check_slots(entries: Iterable[Entry]) -> None:
    holders: dict[tuple[bool, int], str] = {}
    for entry in entries:
        if entry.state in LIVE:
            holder = holders.setdefault((entry.simulated, entry.number), entry.participant)
            if holder != entry.participant:
                raise ValueError(
                    f"number {entry.number} must be held by one participant, got {holder} and {entry.participant}; "
                    "withdraw one with --keep-data, or move one's folder out of sessions/"
                )


def is_away(entry: Entry) -> bool:
    """Check whether a participant is at another station, whatever of it was copied or collected here."""
    return bool(entry.station) and entry.station != server.find_station()


def is_absent(entry: Entry, study: StudyFolder) -> bool:
    """Check whether a participant is at another station, and nothing of it was collected here."""
    return is_away(entry) and not _is_begun(study.sessions / entry.participant)


def _is_begun(folder: Path) -> bool:
    return any(folder.glob("*.json*"))


def _compare(study: StudyFolder) -> tuple[list[str], list[str]]:
    """Find what the ledger saw and the disk does not hold, and what a rebuild only corrects."""
    try:
        entries = {entry.participant: entry for entry in read_study_ledger(study)}
    except (OSError, ValueError) as error:
        return [str(error)], []
    lost: list[str] = []
    wrong: list[str] = []
    for entry in entries.values():
        if is_absent(entry, study):
            continue
        lines = list(_find_lost_of(entry, study))
        lost += lines
        wrong += [] if lines else _find_edited(entry, study)
    wrong += [
        f"{folder}: is not in the ledger; enter it: {_write_rebuild(study)}"
        for folder in study.participants
        if folder.name not in entries and _is_begun(folder)
    ]
    return lost, wrong


def _find_lost_of(entry: Entry, study: StudyFolder) -> Iterator[str]:
    folder = study.sessions / entry.participant
    try:
        tombstone = progress.read_tombstone(folder)
    except ValueError as error:
        yield str(error)
        return
    if tombstone is not None:
        yield from _find_unlike(tombstone, entry, study)
    elif entry.state == "withdrawn" and entry.station and _is_begun(folder):
        again = f"feel321 withdraw {quote(str(study.path))} --participant {entry.participant}"
        yield f"{folder}: the participant was withdrawn at station {entry.station}; remove the data here too: {again}"
    elif entry.state == "withdrawn":
        yield f"{folder}: the participant was withdrawn, the tombstone is gone; restore it from a copy"
    elif entry.anchors and not _is_begun(folder):
        lines = sum(anchor.lines for anchor in entry.anchors)
        yield f"{folder}: is gone without a tombstone, {lines} lines of its journals were seen; restore it from a copy"
    else:
        yield from filter(None, (find_cut(anchor, folder) for anchor in entry.anchors))


def _find_unlike(tombstone: progress.Tombstone, entry: Entry, study: StudyFolder) -> Iterator[str]:
    folder = study.sessions / entry.participant
    if (tombstone.state, entry.state) != (progress.REMOVED, "withdrawn"):
        again = f"feel321 withdraw {quote(str(study.path))} --participant {entry.participant}"
        yield f"{folder}: the withdrawal was interrupted; finish it: {again}"
    elif (tombstone.number, tombstone.simulated) != (entry.number, entry.simulated):
        yield f"{folder}: the tombstone is not the one that the ledger knows; restore both from a copy"


def _find_edited(entry: Entry, study: StudyFolder) -> Iterator[str]:
    """Find what the ledger says of a participant and neither plan nor journals ever said."""
    folder = study.sessions / entry.participant
    if (folder / TOMBSTONE_FILE).exists() or not _is_begun(folder):
        return
    try:
        own = progress.read_progress(folder)
    except (OSError, ValueError):
        return  # What is wrong with plan or journals is reported by whoever reads them.
    names = ["number", "simulated"]
    # The ledger may lag behind a journal, but what ends a session it only knows from there.
    ended = entry.anchors == own.anchors or entry.state in {"finished", "released"}
    for name in [*names, "state"] if ended and not own.problem else names:
        got, expected = getattr(entry, name), getattr(own, name)
        if got != expected:
            yield (
                f"{name_place(study)}: {entry.participant} has {name} {got}, plan and journals say {expected}; "
                f"rebuild it: {_write_rebuild(study)}"
            )
