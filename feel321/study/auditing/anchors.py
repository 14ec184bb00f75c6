"""Anchors: the end of a study's chain of checkpoints, kept outside its folder, and signed if the rig has a key.

Where anchors go is the rig's choice, not the study's: `anchors.toml` in the user's configuration (`FEEL321_CONFIG`
names another folder) lists `folders`, git `remotes`, the `key`, and since when it signs. In each place, every chain has
a folder: a copy of its checkpoints, so that a finding can name file and line even where the study's own chain was
written anew; the anchors, one JSON object per line; and the public keys.
"""

from __future__ import annotations

import json
import os
import subprocess
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from socket import gethostname
from typing import TYPE_CHECKING, Any

from feel321.files import create_file, make_folder, temporary_folder, write_bytes, write_text
from feel321.study import server
from feel321.study.auditing import keys
from feel321.study.auditing.checkpoints import CHECKPOINTS, Tip, find_chain
from feel321.study.session.journal import digest, utc_now

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from feel321.study.folder import StudyFolder

CONFIG = "FEEL321_CONFIG"
CONFIG_FILE, ANCHORS_FILE = "anchors.toml", "anchors.jsonl"
PLACE_FILE = "feel321-anchors.txt"
"""By which a folder for anchors is known again: an empty mount point, or a folder made anew, is not one."""

GIT_S = 15.0
"""How long git may take for one step, so that no session's end waits for a network."""


@dataclass(frozen=True, slots=True)
class Rules:
    """Where the anchors of this rig go, and with which key they are signed, since when."""

    folders: tuple[str, ...] = ()
    remotes: tuple[str, ...] = ()
    key: str = ""
    since: str = ""


@dataclass(frozen=True, slots=True)
class Witness:
    """An anchor: which chain ended where, of which folder, by which key (all hexadecimal; empty: unsigned).

    utc: when it was put there, by the rig's clock; checkpoint_utc: when the chain's last line was written.
    """

    chain: str
    lines: int
    sha256: str
    utc: str
    folder: str
    host: str
    checkpoint_utc: str = ""
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
        folders, remotes = (_require_texts(entry, name) for name in ("folders", "remotes"))
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"{path}: cannot be read ({error}); it has folders, remotes, key and since"
        ) from None
    return Rules(folders, remotes, str(entry.get("key", "")), str(entry.get("since", "")))


def _require_texts(entry: dict[str, Any], name: str) -> tuple[str, ...]:
    own = entry.get(name, [])
    if not isinstance(own, list) or not all(isinstance(one, str) and one for one in own):
        raise TypeError(f'{name} must be a list of texts, ["..."], got {own!r}')
    return tuple(own)


def add_rules(*, folder: Path | None = None, remote: str = "", key: Path | None = None) -> Rules:
    """Add a place for anchors, or choose the key, and keep that for all studies of this rig."""
    if remote and server.holds_password(remote):
        raise ValueError(
            "git remote: must hold no password, got one; take it out: ssh keys and git's credential helpers keep it"
        )
    rules = read_rules()
    if folder is not None:
        folder = folder.absolute()
        _mark_place(folder)
        rules = replace(rules, folders=tuple(dict.fromkeys([*rules.folders, str(folder)])))
    if remote:
        rules = replace(rules, remotes=tuple(dict.fromkeys([*rules.remotes, remote])))
    if key is not None:
        rules = replace(rules, key=str(key), since=_tell_time())
    return _write_rules(rules)


def settle_rules(before: Rules, done: Sequence[str]) -> None:
    """Keep of the places that were added only those that took an anchor."""
    now = read_rules()
    folders = [one for one in now.folders if one in {*before.folders, *done}]
    remotes = [one for one in now.remotes if one in {*before.remotes, *done}]
    settled = replace(now, folders=tuple(folders), remotes=tuple(remotes))
    if settled != now:
        _write_rules(settled)


def _write_rules(rules: Rules) -> Rules:
    make_folder(find_config(), private=True)
    lines = [f"{name} = {json.dumps(value)}" for name, value in asdict(rules).items()]
    write_text(find_config() / CONFIG_FILE, "\n".join(lines) + "\n", private=True)
    return rules


def _mark_place(folder: Path) -> None:
    for parent in (folder, *folder.parents):
        if (parent / "study.toml").is_file():
            raise ValueError(f"{folder}: is in {parent}; choose one that others cannot write to")
    make_folder(folder, private=True)
    if not (folder / PLACE_FILE).is_file():
        write_text(folder / PLACE_FILE, "Anchors of studies: feel321 audit --anchors DIR\n")


def _require_place(place: Path) -> None:
    if not place.is_dir():
        raise FileNotFoundError("there is no such folder now")
    if not (place / PLACE_FILE).is_file():
        raise FileNotFoundError(
            f"has no {PLACE_FILE}, which feel321 seal --to put there; connect the drive"
        )


def read_public() -> tuple[str, str]:
    """Read the public half of this rig's key, and since when it signs; empty where there is none."""
    rules = read_rules()
    path = Path(rules.key).with_suffix(".pub") if rules.key else None
    if path is None or not path.is_file():
        return "", ""
    return path.read_text(encoding="utf-8").strip(), rules.since


def _tell_time() -> str:
    return utc_now().isoformat(timespec="milliseconds")


# Writing.


def put_anchors(
    study: StudyFolder, tip: Tip, *, passphrase: str = ""
) -> tuple[list[str], list[str]]:
    """Put the end of a chain into all places that were chosen; returns these, and what went wrong."""
    rules = read_rules()
    problems: list[str] = []
    key = None
    if rules.key and (rules.folders or rules.remotes):
        try:
            key = keys.open_key(Path(rules.key), passphrase=passphrase)
        except (OSError, ValueError) as error:
            return [], [f"{error}; no anchor was put"]  # one that is not signed proves less
    own = Witness(
        tip.chain,
        tip.lines,
        tip.sha256,
        _tell_time(),
        str(study.path.absolute()),
        gethostname(),
        tip.utc,
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
        _require_place(Path(place))
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
    try:
        _git(clone, "push", "-q", "origin", "HEAD")
    except OSError:  # another rig was faster
        _update_clone(place)
        _git(clone, "push", "-q", "origin", "HEAD")


def _put_files(study: StudyFolder, own: Witness, place: Path) -> None:
    if place.resolve().is_relative_to(study.path.resolve()):
        raise ValueError(f"is in {study.path}; choose a folder that others cannot write to")
    folder = place / own.chain
    make_folder(folder, private=True)
    content, copy = read_lines(find_chain(study)), folder / CHECKPOINTS
    before = copy.read_bytes() if copy.is_file() else b""
    if not content.startswith(before):
        raise ValueError(
            "the checkpoints there are not the beginning of those here; see feel321 audit"
        )
    write_bytes(copy, content, private=True)
    if own.key:
        write_text(folder / f"rig-{keys.name_key(own.key)}.pub", f"{own.key}\n")
    _add_line(folder / ANCHORS_FILE, own)


def _add_line(path: Path, own: Witness) -> None:
    """Append an anchor; of one that is there already the older date is kept, which says more."""
    entry = asdict(own)
    del entry["place"]
    if not path.is_file():
        create_file(path, private=True)
    with path.open("ab+") as file:
        file.seek(0)
        known = file.read()
        *_, last, unfinished = [b"", *known.split(b"\n")]
        before = _read_witness(last)
        if (
            before
            and not unfinished
            and replace(before, utc=own.utc, signature=own.signature) == own
        ):
            return
        file.truncate(len(known) - len(unfinished))  # what a kill left
        file.write(json.dumps(entry).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())


def read_lines(path: Path) -> bytes:
    """Read the whole lines of a file that another process may be writing."""
    content = path.read_bytes()
    return content[: content.rfind(b"\n") + 1]


def _find_clone(remote: str) -> Path:
    return find_config() / "git" / digest(remote)[:16]


def _update_clone(remote: str) -> Path:
    """Bring this rig's clone of a remote up to date."""
    clone = _find_clone(remote)
    if not clone.is_dir():
        make_folder(clone.parent, private=True)
        with temporary_folder(beside=clone) as made:  # a kill leaves no half of a clone
            _git(made, "clone", "-q", "--", remote, "clone")
            (made / "clone").rename(clone)
    elif _git(clone, "ls-remote", "--heads", "origin"):
        try:
            _git(clone, "pull", "-q", "--no-rebase", "--no-edit")
        except OSError:
            with suppress(OSError):
                _git(clone, "merge", "--abort")
            raise
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
        folder = _find_clone(place) if place in rules.remotes else Path(place)
        try:
            _look(place, rules)
        except (OSError, subprocess.SubprocessError) as error:
            problems.append(f"{place}: could not be looked at ({error})")
        for path in sorted(folder.glob(f"*/{ANCHORS_FILE}")):
            try:
                found += _read_witnesses(path, place, problems)
            except OSError as error:
                problems.append(f"{path}: could not be looked at ({error.strerror})")
            copies.append((path.parent.name, path.with_name(CHECKPOINTS)))
    return Kept(tuple(found), tuple(copies), (*places, *rules.remotes), tuple(problems))


def _look(place: str, rules: Rules) -> None:
    """Demand that a place can be looked at; a folder that was given needs no mark."""
    if place in rules.remotes:
        _update_clone(place)
    elif place in rules.folders:
        _require_place(Path(place))
    elif not Path(place).is_dir():
        raise FileNotFoundError("there is no such folder now")


def _read_witnesses(path: Path, place: str, problems: list[str]) -> Iterator[Witness]:
    """Read the anchors of one chain; one whose signature is wrong is not used."""
    signers: set[str] = set()
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
        elif own.host in signers and not own.key:
            problems.append(f"{path}, line {number}: is not signed, those before it are")
        else:
            signers |= {own.host} if own.key else set()
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
