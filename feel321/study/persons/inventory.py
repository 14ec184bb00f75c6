"""What a study keeps of people, for an ethics form: what, where, of whom, since when, how open.

It is read from the registry of places, so nothing that `withdraw` knows is missing here.
"""

from __future__ import annotations

import os
import stat
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.records import Result
from feel321.study.ledger.slots import find_place
from feel321.study.persons import modes, places, retention, vault

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from datetime import date

    from feel321.study.folder import StudyFolder

OUT_OF_REACH = (
    "what is removed may stay in snapshots and backups of the disk, in spare cells of an SSD and in the journal of the "
    "file system: encrypt the disk, and ask those who run its backups",
    "copies that people made by hand (mail, USB, cloud folders) are unknown to feel321",
)

LEAVES = {
    "ratings": "with every export, by code", "roster": "with export, by code", "matches": "no",
    "answers": "no; personal ones never", "output": "it is an export, or may be shared", "backup": "it is a copy",
    "results": "if the report is shared: figures and tables, by code",
}  # fmt: skip
"""Kind of place -> what of it leaves the lab with an export; all others stay."""


@dataclass(frozen=True, slots=True)
class InventoryRow:
    """All places of a kind.

    modes: who may read them. encrypted: "yes", "no", or "-" if there is nothing personal. until: from `[data]`.
    """

    kind: str
    where: str
    holds: str
    origin: str
    at_withdrawal: str
    participants: tuple[str, ...]
    files: int
    size: int
    since: str
    until: str
    modes: tuple[str, ...]
    encrypted: str
    leaves: str


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Inventory(Result):
    """What a study keeps of people.

    wide: places that more people may read than the settings say. notes: what is out of feel321's reach.
    """

    rows: tuple[InventoryRow, ...]
    due: tuple[str, ...]
    wide: tuple[str, ...]
    notes: tuple[str, ...]

    def summary(self) -> str:
        """Write what `feel321 inventory` prints."""
        lines = [line for row in self.rows for line in _describe(row)]
        named = {"due": self.due, "open": self.wide, "out of reach": self.notes}
        lines += [f"{name}: {line}" for name, found in named.items() for line in found]
        return "\n".join(lines) if self.rows else "\n".join(["no personal data are kept", *lines])


def _describe(row: InventoryRow) -> Iterator[str]:
    yield f"{row.kind}: {row.where}"
    yield f"    holds       {row.holds} ({row.origin})"
    yield f"    of          {', '.join(row.participants) or 'all participants'}"
    yield f"    kept        {row.files} files, {row.size} bytes, since {row.since}, until {row.until}"
    yield f"    readable    {', '.join(row.modes)}; encrypted: {row.encrypted}"
    yield f"    leaves      {row.leaves}"
    yield f"    withdrawal  {row.at_withdrawal}"


def read_inventory(study: StudyFolder, *, today: date, participant: str = "") -> Inventory:
    """Read what is kept of everybody, or of one participant; what is of nobody in particular is of everybody."""
    found: dict[str, list[places.DataPlace]] = defaultdict(list)
    for place in places.list_places(study):
        if participant in {"", *place.participants} or not place.participants:
            found[place.kind].append(place)
    until = _find_until(study)
    rows = [_make_row(kept, until) for kind in places.KINDS if (kept := _read_facts(found[kind]))]
    due = tuple(retention.describe_due(study, today=today))
    wide = [
        f"{path}: {mode:04o}, should be {least:04o}" for path, mode, least in modes.list_wide(study)
    ]
    mend = ["mend: feel321 inventory --tighten"] if wide else []
    return Inventory(tuple(rows), due, (*wide, *mend), tuple(_list_notes(study)))


def _find_until(study: StudyFolder) -> dict[str, str]:
    from feel321.study.settings.read import read_settings

    table = read_settings(study.settings).data
    until = {"": table.keep_until or "no date is set ([data] keep_until)"}
    if table.keep_personal_months is not None:
        until["personal"] = f"{table.keep_personal_months} months after the last session"
    return until


def _read_facts(found: Sequence[places.DataPlace]) -> dict[places.DataPlace, os.stat_result]:
    """Read what the system says of places; what another process has just removed is not there."""
    stats = {}
    for place in found:
        with suppress(FileNotFoundError):
            stats[place] = place.path.lstat()
    return stats


def _make_row(
    known: Mapping[places.DataPlace, os.stat_result], until: dict[str, str]
) -> InventoryRow:
    found, stats = list(known), known.values()
    kind = found[0].kind
    facts = places.KINDS[kind]
    since = datetime.fromtimestamp(min(one.st_mtime for one in stats), UTC)
    named = found[0].path if kind in {"output", "backup"} else facts.pattern
    return InventoryRow(
        kind=kind,
        where=str(named),
        holds=facts.holds,
        origin=facts.origin,
        at_withdrawal=facts.at_withdrawal,
        participants=tuple(sorted({name for place in found for name in place.participants})),
        files=len(found),
        size=sum(one.st_size for one in stats),
        since=since.date().isoformat(),
        until=until.get(kind, until[""]),
        modes=tuple(sorted({stat.filemode(one.st_mode) for one in stats})),
        encrypted=_find_encryption([place.path for place in found]) if kind == "personal" else "no",
        leaves=LEAVES.get(kind, "no"),
    )


def _find_encryption(paths: Sequence[Path]) -> str:
    kept = {vault.is_encrypted(path) for path in paths}
    return {frozenset({True}): "yes", frozenset({False}): "no"}.get(frozenset(kept), "some")


def _list_notes(study: StudyFolder) -> Iterator[str]:
    if not isinstance(place := find_place(study), Path):
        yield (
            f"the ledger on the server {place.url} holds code, number, state, station and digests; a withdrawal "
            "rewrites the rows, but the server's write-ahead log, its dead rows until VACUUM FULL, and its backups stay"
        )
    if os.name == "nt":
        yield "Windows has no file modes: set who may read the folder in its properties"
    yield from OUT_OF_REACH
