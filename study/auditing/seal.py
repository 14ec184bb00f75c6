"""One digest of everything that a study's results rest on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.ledger.sightings import read_anchor
from study.provenance import MANIFEST_JSON
from study.session.chain import digest
from study.session.opening import PLAN_FILE, TOMBSTONE_FILE
from study.session.replay import list_journals

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from study.folder import StudyFolder


def make_seal(study: StudyFolder) -> str:
    """Digest all plans, tombstones, ends of journals and the stimulus set.

    Whoever can write to a study can write all of it anew, ledger and digests included. Who kept the seal elsewhere
    sees it: it changes with every record, and with every record that was changed.

    Parameters
    ----------
    study : StudyFolder
        The study.

    Returns
    -------
    str
        64 digits; those of the same content are the same wherever the study lies.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    manifests = [study.manifest, study.stimuli / MANIFEST_JSON]
    lines = [line for path in manifests for line in _digest_file(path, study.path)]
    lines += [line for folder in study.participants for line in _digest_participant(folder, study.path)]
    return digest("\n".join(lines))


def _digest_participant(folder: Path, root: Path) -> Iterator[str]:
    for name in (PLAN_FILE, TOMBSTONE_FILE):
        yield from _digest_file(folder / name, root)
    for path in list_journals(folder):
        if path.is_file():
            anchor = read_anchor(path)
            yield f"{path.relative_to(root).as_posix()} {anchor.lines} {anchor.tip}"


def _digest_file(path: Path, root: Path) -> Iterator[str]:
    if path.is_file():
        yield f"{path.relative_to(root).as_posix()} {digest(path.read_bytes())}"
