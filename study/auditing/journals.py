"""The journals of one participant: each chain, its header and times, and how one session follows another."""

from __future__ import annotations

from datetime import datetime
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from study.auditing.steps import MALFORMED, MENDING, audit_steps
from study.session.journal import read_journal
from study.session.replay import find_header, list_journals, name_journal

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from study.session.chain import Chain, Record
    from study.session.plan import Plan


def audit_journals(folder: Path, plan: Plan) -> Iterator[str]:
    """Verify all journals of a participant.

    Parameters
    ----------
    folder : Path
        The participant's folder.
    plan : Plan
        The plan in it.

    Yields
    ------
    str
        One finding per line.
    """
    chains = {}
    for path in sorted(folder.glob("session-*.jsonl")):  # Copies under other names too.
        try:
            chains[path] = read_journal(path)
        except (OSError, ValueError) as error:
            yield str(error)
        else:
            yield from (f"{path}{finding}" for finding in _audit_journal(chains[path], plan, name=path.name))
    yield from _audit_succession(list_journals(folder), chains)


def _audit_journal(chain: Chain, plan: Plan, *, name: str) -> Iterator[str]:
    if chain.torn:
        yield f": ends in {len(chain.torn)} bytes of a line that was never finished; resuming moves them aside"
    header = find_header(chain.records)
    if header is None:
        # A crash may have come before it, and nobody come back.
        if not {record.event for record in chain.records} <= MENDING | {"released"}:
            yield ": has no header"
        return
    try:
        yield from _audit_header(header, plan, name=name)
        yield from _audit_times(chain.records)
    except (*MALFORMED, ValueError):
        yield ": has a header or a time of day that is none as feel321 writes them"
        return
    yield from audit_steps(chain.records, plan)


def _audit_header(header: Mapping[str, Any], plan: Plan, *, name: str) -> Iterator[str]:
    if (header["participant"], name_journal(header["session"])) != (plan.participant, name):
        yield f": is session {header['session']} of {header['participant']!r}, it was copied here"
    if header["plan_sha256"] != plan.sha256:
        yield ": was begun with another plan than the one beside it"


def _audit_times(records: Sequence[Record]) -> Iterator[str]:
    for before, record in pairwise(records):
        if datetime.fromisoformat(record.utc) < datetime.fromisoformat(before.utc) and record.event != "clock_stepped":
            yield f", line {record.sequence + 1}: is older than the line before, and nothing says why"


def _audit_succession(journals: Sequence[Path], chains: Mapping[Path, Chain]) -> Iterator[str]:
    """Demand that sessions are numbered on, and that each but the newest says which one took its place."""
    for session, path in enumerate(journals, start=1):
        if path.name != name_journal(session):
            yield f"{path}: is there without {name_journal(session)} before it"
            return
    for session, path in enumerate(journals[:-1], start=2):
        if path in chains and not any(
            record.event == "superseded" and record.data.get("by") == session for record in chains[path].records
        ):
            yield f"{path}: says nothing of {name_journal(session)}, which stands beside it"
