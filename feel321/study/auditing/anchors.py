"""Anchors: the end of a study's chain of checkpoints, kept outside its folder, and signed if the rig has a key.

Where anchors go is the rig's choice, not the study's: `anchors.toml` in the user's configuration (`FEEL321_CONFIG`
names another folder) lists `folders`, git `remotes`, and the `key`. In each place, every chain has a folder: a copy of
its checkpoints, so that a finding can name file and line even where the study's own chain was written anew; the
anchors, one JSON object per line; and the public keys.
"""

from __future__ import annotations

import json
import os
import subprocess
import tomllib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from socket import gethostname
from typing import TYPE_CHECKING, Any

from feel321.files import make_folder, sync_folder, write_bytes, write_text
from feel321.study.auditing import keys
from feel321.study.auditing.checkpoints import CHECKPOINTS, Tip, find_chain
from feel321.study.session.journal import digest

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from feel321.study.folder import StudyFolder

CONFIG = "FEEL321_CONFIG"
CONFIG_FILE, ANCHORS_FILE = "anchors.toml", "anchors.jsonl"
GIT_S = 15.0
"""How long git may take for one step, so that no session's end waits for a network."""


@dataclass(frozen=True, slots=True)
class Rules:
    """Where the anchors of this rig go, and with which key they are signed."""

    folders: tuple[str, ...] = ()
    remotes: tuple[str, ...] = ()
    key: str = ""


@dataclass(frozen=True, slots=True)
class Witness:
    """An anchor: which chain ended where and when, of which folder, by which key (all hexadecimal; empty: unsigned)."""

    chain: str
    lines: int
    sha256: str
    utc: str
    folder: str
    host: str
    key: str = ""
    signature: str = ""
    place: str = field(default="", compare=False)

    def to_signed(self) -> bytes:
        """Return what is signed."""
        own = asdict(self)
        return json.dumps({k: own[k] for k in own if k not in {"signature", "place"}}).encode()


def find_config() -> Path:
    """Find the folder of this rig's configuration."""
    if given := os.environ.get(CONFIG):
        return Path(given)
    import click

    return Path(click.get_app_dir("feel321"))


def read_rules() -> Rules:
    """Read where anchors go; nowhere as long as nobody chose."""
    path = find_config() / CONFIG_FILE
    if not path.is_file():
        return Rules()
    try:
        entry = tomllib.loads(path.read_text(encoding="utf-8"))
        return Rules(
            tuple(entry.get("folders", ())),
            tuple(entry.get("remotes", ())),
            str(entry.get("key", "")),
        )
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"{path}: cannot be read ({error}); it has folders, remotes and key"
        ) from None


def add_rules(*, folder: Path | None = None, remote: str = "", key: Path | None = None) -> Rules:
    """Add a place for anchors, or choose the key, and keep that for all studies of this rig."""
    rules = read_rules()
    folders = [*rules.folders, *([str(folder.absolute())] if folder else [])]
    remotes = [*rules.remotes, *([remote] if remote else [])]
    rules = Rules(
        tuple(dict.fromkeys(folders)), tuple(dict.fromkeys(remotes)), str(key or rules.key)
    )
    make_folder(find_config())
    lines = [f"{name} = {json.dumps(value)}" for name, value in asdict(rules).items()]
    write_text(find_config() / CONFIG_FILE, "\n".join(lines) + "\n")
    return rules


# Writing.


def put_anchors(
    study: StudyFolder, tip: Tip, *, passphrase: str = ""
) -> tuple[list[str], list[str]]:
    """Put the end of a chain into all places that were chosen; returns these, and what went wrong."""
    rules = read_rules()
    problems = []
    key = None
    if rules.key and (rules.folders or rules.remotes):
        try:
            key = keys.open_key(Path(rules.key), passphrase=passphrase)
        except (OSError, ValueError) as error:
            problems.append(f"{error}; the anchor is not signed")
    own = Witness(
        tip.chain, tip.lines, tip.sha256, tip.utc, str(study.path.absolute()), gethostname()
    )
    done = []
    for place in (*rules.folders, *rules.remotes):
        try:
            _put(study, _sign(own, key), place, is_remote=place in rules.remotes)
            done.append(place)
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            problems.append(f"{place}: takes no anchor ({error})")
    return done, problems


def _sign(own: Witness, key: Ed25519PrivateKey | None) -> Witness:
    if key is None:
        return own
    own = replace(own, key=keys.export_public(key))
    return replace(own, signature=key.sign(own.to_signed()).hex())


def _put(study: StudyFolder, own: Witness, place: str, *, is_remote: bool) -> None:
    if not is_remote:
        _put_files(study, own, Path(place))
        return
    clone = _update_clone(place)
    _put_files(study, own, clone)
    _git(clone, "add", "--all")
    if _git(clone, "status", "--porcelain"):
        _git(
            clone,
            "-c",
            "user.name=feel321",
            "-c",
            "user.email=feel321@localhost",
            "commit",
            "-qm",
            f"anchor {own.utc}",
        )
    _git(clone, "push", "-q", "origin", "HEAD")


def _put_files(study: StudyFolder, own: Witness, place: Path) -> None:
    if place.resolve().is_relative_to(study.path.resolve()):
        raise ValueError(f"is in {study.path}; choose a folder that others cannot write to")
    folder = place / own.chain
    make_folder(folder)
    content, copy = read_lines(find_chain(study)), folder / CHECKPOINTS
    before = copy.read_bytes() if copy.is_file() else b""
    if not content.startswith(before):
        raise ValueError(
            "the checkpoints there are not the beginning of those here; see feel321 audit"
        )
    write_bytes(copy, content)
    if own.key:
        write_text(folder / f"rig-{keys.name_key(own.key)}.pub", f"{own.key}\n")
    entry = asdict(own)
    del entry["place"]
    line = json.dumps(entry) + "\n"
    with (folder / ANCHORS_FILE).open("ab+") as file:
        file.seek(0)
        known = file.read()
        if known.endswith(line.encode()):
            return
        file.truncate(known.rfind(b"\n") + 1)  # what a kill left unfinished
        file.write(line.encode())
        file.flush()
        os.fsync(file.fileno())
    sync_folder(folder)


def read_lines(path: Path) -> bytes:
    """Read the whole lines of a file that another process may be writing."""
    content = path.read_bytes()
    return content[: content.rfind(b"\n") + 1]


def _update_clone(remote: str) -> Path:
    """Bring this rig's clone of a remote up to date."""
    clone = find_config() / "git" / digest(remote)[:16]
    if not clone.is_dir():
        make_folder(clone.parent)
        _git(clone.parent, "clone", "-q", remote, str(clone))
    elif _git(clone, "ls-remote", "--heads", "origin"):
        _git(clone, "pull", "-q", "--no-rebase", "--no-edit")
    return clone


def _git(folder: Path, *words: str) -> str:
    quiet = {**os.environ, "GIT_TERMINAL_PROMPT": "0", "GIT_SSH_COMMAND": "ssh -oBatchMode=yes"}
    try:
        return subprocess.run(  # noqa: S603 - our own words
            ["git", *words], cwd=folder, env=quiet, timeout=GIT_S, check=True, capture_output=True, text=True,  # noqa: S607 - the user's git
        ).stdout  # fmt: skip
    except subprocess.CalledProcessError as error:
        reason = (str(error.stderr).strip().splitlines() or ["no reason given"])[-1]
        raise OSError(f"git {words[0]}: {reason}") from None


# Reading.


@dataclass(frozen=True, slots=True)
class Kept:
    """What the places hold: anchors, copies of chains by chain, the places that were looked at, and what was wrong."""

    witnesses: tuple[Witness, ...] = ()
    copies: tuple[tuple[str, Path], ...] = ()
    places: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def read_kept(extra: tuple[Path, ...] = ()) -> Kept:
    """Read all anchors in the places of this rig, and in further folders."""
    rules = read_rules()
    found: list[Witness] = []
    copies: list[tuple[str, Path]] = []
    problems: list[str] = []
    places = [*rules.folders, *map(str, extra)]
    for place in (*places, *rules.remotes):
        try:
            folder = _update_clone(place) if place in rules.remotes else Path(place)
            if not folder.is_dir():
                raise FileNotFoundError("there is no such folder now")
        except (OSError, subprocess.SubprocessError) as error:
            problems.append(f"{place}: could not be looked at ({error})")
            folder = find_config() / "git" / digest(place)[:16]
        for path in sorted(folder.glob(f"*/{ANCHORS_FILE}")):
            found += _read_witnesses(path, place, problems)
            copies.append((path.parent.name, path.with_name(CHECKPOINTS)))
    return Kept(tuple(found), tuple(copies), (*places, *rules.remotes), tuple(problems))


def _read_witnesses(path: Path, place: str, problems: list[str]) -> Iterator[Witness]:
    """Read the anchors of one chain; one whose signature is wrong is not used."""
    is_key_known = False
    *lines, _unfinished = path.read_bytes().split(b"\n")
    for number, line in enumerate(lines, start=1):
        own = _read_witness(line)
        if own is None or own.chain != path.parent.name:
            problems += (
                [f"{path}, line {number}: is no anchor of this chain"] if line.strip() else []
            )
        elif own.key and not keys.is_signed(own.to_signed(), own.signature, own.key):
            problems.append(
                f"{path}, line {number}: the signature is wrong, so the anchor was changed"
            )
        elif is_key_known and not own.key:
            problems.append(f"{path}, line {number}: is not signed, those before it are")
        else:
            is_key_known |= bool(own.key)
            yield replace(own, place=place)


def _read_witness(line: bytes) -> Witness | None:
    try:
        entry: Any = json.loads(line)
        own = Witness(**entry)
    except (TypeError, ValueError, RecursionError):
        return None
    kinds = {name: type(value) for name, value in asdict(own).items()}
    return (
        own
        if {k for k, v in kinds.items() if v is not str} == {"lines"} and kinds["lines"] is int
        else None
    )
