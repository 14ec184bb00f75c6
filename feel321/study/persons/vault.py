"""Personal answers apart from the journal: `personal.jsonl` in the participant's folder, encrypted with a passphrase.

The journal's record of a personal answer holds the salted SHA-256 of it, the file the answer and the salt. So the file
can be removed, and the journal's chain still holds; without the salt the digest does not show what was answered. The
answer is on the disk before the record is: an answer without its record was never given, and is dropped at the next.

With a passphrase each answer is sealed by AES-256-GCM, bound to participant, session, question and occasion; the key is
derived from the passphrase by scrypt [1]_ with N = 2^15, r = 8, p = 1. A passphrase that is lost opens nothing again.

References
----------
.. [1] C. Percival and S. Josefsson, RFC 7914, 2016. https://doi.org/10.17487/RFC7914
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import secrets
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from getpass import getpass
from typing import TYPE_CHECKING, Any

from feel321.files import write_text
from feel321.study.session import events, journal

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from feel321.study.folder import StudyFolder

    Row = dict[str, Any]

UNLOCK_VARIABLE = "FEEL321_PASSPHRASE"

PERSONAL_FILE = "personal.jsonl"

LOST = "without the passphrase nobody can read these answers, not even feel321's authors"

_N, _R, _P = 2**15, 8, 1
_COST = {"name": "scrypt", "n": _N, "r": _R, "p": _P}

_CHECK = b"feel321 personal answers"
"""What every encrypted file holds sealed, by which a wrong passphrase is known."""

_PLACE = ("session", "question", "occasion")


@dataclass(frozen=True, slots=True)
class Vault:
    """A passphrase, and the keys that were derived from it, by their salt."""

    passphrase: str = field(repr=False)
    keys: dict[str, bytes] = field(default_factory=dict, repr=False)

    def find_key(self, cost: Mapping[str, Any]) -> bytes:
        """Derive the key of a file; a tenth of a second, once per salt."""
        from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

        if dict(cost) != {**_COST, "salt": cost.get("salt")}:
            raise ValueError(f"{PERSONAL_FILE} was encrypted with {dict(cost)}, allowed is {_COST}")
        salt = str(cost["salt"])
        if salt not in self.keys:
            kdf = Scrypt(bytes.fromhex(salt), 32, n=_N, r=_R, p=_P)
            self.keys[salt] = kdf.derive(self.passphrase.encode())
        return self.keys[salt]

    def seal(self, text: bytes, about: bytes, cost: Mapping[str, Any]) -> str:
        """Encrypt a text with what it is about, which is not secret and cannot be exchanged."""
        from cryptography.hazmat.primitives.ciphers.aead import AESGCM

        nonce = os.urandom(12)
        sealed = nonce + AESGCM(self.find_key(cost)).encrypt(nonce, text, about)
        return base64.b64encode(sealed).decode()

    def open(self, sealed: str, about: bytes, cost: Mapping[str, Any]) -> bytes | None:
        """Decrypt a text; None if the passphrase is another, or the text or its place was changed."""
        from cryptography.exceptions import InvalidTag
        from cryptography.hazmat.primitives.ciphers.aead import AESGCM

        content = base64.b64decode(sealed)
        try:
            return AESGCM(self.find_key(cost)).decrypt(content[:12], content[12:], about)
        except InvalidTag:
            return None


def find_vault(study: StudyFolder, *, needed: bool = False) -> Vault | None:
    """Take the passphrase of the environment, if there is one, and check that it is the one of the study.

    needed: ask on the terminal, or refuse, if there is none and the study has encrypted answers or wants them to be.
    """
    own = [path for path in _list_files(study) if is_encrypted(path)]
    is_wanted = needed and bool(own or study.asks_for("encrypt_personal"))
    passphrase = os.environ.get(UNLOCK_VARIABLE) or (_ask(is_new=not own) if is_wanted else "")
    if not passphrase:
        if is_wanted:
            raise ValueError(
                f"{own[0] if own else study.settings}: personal answers are encrypted, got no passphrase; "
                f"put it into the environment: {UNLOCK_VARIABLE}"
            )
        return None
    vault = Vault(passphrase)
    if own:
        _check_passphrase(vault, _read(own[0])[0], own[0])
    return vault


def _ask(*, is_new: bool) -> str:
    """Ask for the passphrase on a terminal, without echo; a new one twice."""
    if not (sys.stdin and sys.stdin.isatty()):
        return ""
    passphrase = getpass("Passphrase of the personal answers: ")
    if is_new and getpass("The same again: ") != passphrase:
        raise ValueError("the two passphrases differ; run again")
    return passphrase


def is_encrypted(path: Path) -> bool:
    """Check whether a file of personal answers is encrypted."""
    return bool(_read(path)[0]["cost"])


def has_encrypted(study: StudyFolder) -> bool:
    """Check whether answers of anybody are encrypted; a file that cannot be read counts as such."""
    with suppress(ValueError):
        return any(is_encrypted(path) for path in _list_files(study))
    return True


def _list_files(study: StudyFolder) -> list[Path]:
    return [path for folder in study.participants if (path := folder / PERSONAL_FILE).is_file()]


def _check_passphrase(vault: Vault, head: Row, path: Path) -> None:
    if vault.open(head["check"], _CHECK, head["cost"]) != _CHECK:
        raise ValueError(
            f"{path}: {UNLOCK_VARIABLE} is not the passphrase that it was encrypted with; {LOST}"
        )


def make_keeper(
    folder: Path, own: journal.Journal, *, vault: Vault | None, others: Sequence[Path] = ()
) -> Callable[[str, int, float | str | None], str]:
    """Make what keeps a personal answer of a session before its record is written, and returns the digest for that.

    others: files whose salt a new one takes over, so that one key opens all.
    """
    header = own.records.find_header()
    session = header.session if header else 1

    def keep(question: str, occasion: int, value: float | str | None) -> str:
        known = {event.sha256 for event in own.records.find(events.QuestionAnswered)}
        row = {"session": session, "question": question, "occasion": occasion, "value": value}
        return keep_answer(folder, row, known=known, vault=vault, others=others)

    return keep


def keep_answer(
    folder: Path,
    row: Row,
    *,
    known: Collection[str],
    vault: Vault | None,
    others: Sequence[Path] = (),
) -> str:
    """Add an answer to a participant's file, without those of its session whose records were never written."""
    path, salt = folder / PERSONAL_FILE, secrets.token_hex(16)
    sha256 = _digest(folder.name, row, salt)
    head, rows = _read(path) if path.exists() else (_make_head(folder.name, vault, others), [])
    if head["cost"] and vault is None:
        raise ValueError(f"{path}: is encrypted, got no passphrase; set {UNLOCK_VARIABLE}")
    if vault and not head["cost"]:  # a passphrase was set in mid-study
        head = _make_head(folder.name, vault, others)
        rows = [_seal(one, head, vault) for one in rows]
    rows = [one for one in rows if one["session"] != row["session"] or one["sha256"] in known]
    new = row | {"salt": salt, "sha256": sha256}
    rows.append(_seal(new, head, vault) if vault else new)
    lines = (json.dumps(one, ensure_ascii=False) for one in (head, *rows))
    write_text(path, "".join(f"{line}\n" for line in lines), private=True)
    return sha256


def _make_head(participant: str, vault: Vault | None, others: Sequence[Path]) -> Row:
    head: Row = {"format": 1, "participant": participant, "cost": None}
    if vault is None:
        return head
    costs = (_read(path)[0]["cost"] for path in others if path.is_file())
    cost = next(filter(None, costs), {**_COST, "salt": secrets.token_hex(16)})
    return head | {"cost": cost, "check": vault.seal(_CHECK, _CHECK, cost)}


def _seal(row: Row, head: Row, vault: Vault) -> Row:
    secret = json.dumps({name: row[name] for name in ("value", "salt")}).encode()
    open_part = {name: row[name] for name in (*_PLACE, "sha256")}
    return open_part | {
        "sealed": vault.seal(secret, _about(head["participant"], row), head["cost"])
    }


def _about(participant: str, row: Row) -> bytes:
    return json.dumps([participant, *(row[name] for name in _PLACE), row["sha256"]]).encode()


def _digest(participant: str, row: Row, salt: str) -> str:
    place = [row[name] for name in _PLACE]
    return hashlib.sha256(
        json.dumps([salt, participant, *place, row["value"]]).encode()
    ).hexdigest()


def read_answers_apart(folder: Path, vault: Vault | None) -> dict[str, tuple[str, Any]]:
    """Read the answers of a participant by their digests: how each is stored, and its value where it can be read."""
    path = folder / PERSONAL_FILE
    if not path.is_file():
        return {}
    head, rows = _read(path)
    if head["cost"] and vault:
        _check_passphrase(vault, head, path)
    return {row["sha256"]: _open(row, head, vault, path=path) for row in rows}


def _open(row: Row, head: Row, vault: Vault | None, *, path: Path) -> tuple[str, Any]:
    participant = head["participant"]
    if head["cost"]:
        if vault is None:
            return "encrypted", None
        secret = vault.open(row["sealed"], _about(participant, row), head["cost"])
        row = row | (json.loads(secret) if secret else {"salt": "", "value": None})
    if _digest(participant, row, row["salt"]) != row["sha256"]:
        raise ValueError(
            f"{path}: {row['question']} was changed after it was written; restore it from a copy"
        )
    return ("encrypted" if head["cost"] else "apart"), row["value"]


def _read(path: Path) -> tuple[Row, list[Row]]:
    try:
        head, *rows = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
        needed = {*_PLACE, "sha256"} | ({"sealed"} if head["cost"] else {"salt", "value"})
        is_ours = head["format"] == 1 and all(set(row) == needed for row in rows)
    except (KeyError, TypeError, ValueError):
        is_ours = False
    if not is_ours:
        raise ValueError(f"{path}: not as feel321 wrote it; restore it from a copy")
    return head, rows


def audit_apart(folder: Path, records: journal.Records) -> Iterator[str]:
    """Check that each personal answer which a journal names is in the participant's file, unless they were removed."""
    wanted = [one for one in records.find(events.QuestionAnswered) if one.sha256]
    if not wanted:
        return
    try:
        kept, removed = read_answers_apart(folder, None), list_removed(folder)
    except ValueError as error:
        yield f": {error}"
        return
    if gone := [
        one.question for one in wanted if one.sha256 not in removed and one.sha256 not in kept
    ]:
        yield f": personal answers {', '.join(gone)} are gone from {PERSONAL_FILE}; restore it from a copy"
    if back := [one.question for one in wanted if one.sha256 in removed and one.sha256 in kept]:
        again = f"feel321 withdraw --participant {folder.name} --personal"
        yield f": personal answers {', '.join(back)} were removed, and are there again; finish: {again}"


def list_removed(folder: Path) -> set[str]:
    """List the digests of personal answers that were removed on purpose, by the journals."""
    seen, removed = set[str](), set[str]()
    for path in journal.list_journals(folder):
        records = journal.read_journal(path).records
        for event in records.find(events.QuestionAnswered, events.PersonalRemoved):
            if isinstance(event, events.QuestionAnswered):
                seen.add(event.sha256)
            else:
                removed |= seen
    return removed - {""}
