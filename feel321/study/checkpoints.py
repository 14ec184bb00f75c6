"""Checkpoints: what the files of a study were, committed to a git repository of its own and pushed to its remotes.

The repository is `.evidence` beside `study.toml`, bare, written and read by dulwich, so that no lab computer needs git.
A commit holds one file, `digests`: name, size and SHA-256 of every file that is covered, never contents, so that a
withdrawal leaves no answer in the history. Its subject is the occasion, its body the reason that somebody gave. Each
copy of a study commits to a branch of its own, named after computer and folder, so that copies can share a remote.
Whoever can write to the folder can make the repository anew; only a remote where they cannot write shows that.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from queue import Empty, Queue
from threading import Thread
from typing import TYPE_CHECKING, Any

from feel321.files import digest_file, make_folder, sync_folder, temporary_folder
from feel321.study.findings import Seal
from feel321.study.session.journal import SESSION_FILE, digest, list_journals, utc_now
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE

if TYPE_CHECKING:
    from dulwich.repo import BaseRepo, Repo

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock

EVIDENCE, DIGESTS, HEADS = ".evidence", b"digests", b"refs/heads/"

LOCK_S, PUSH_S, FETCH_S = 60.0, 15.0, 120.0
"""How long another process may hold the repository, and how long a remote may take: no session waits for a network."""

COVERED = (
    "*.toml", "frozen.json", "ratings.csv", "participants.csv", "matches.csv",
    "methods/**/*", "calibration/**/*", "stimuli/**/*", "report/**/*",
)  # fmt: skip
"""Covered besides plans, journals and tombstones. Personal answers are not: a digest of so little would tell them."""


@dataclass(frozen=True, slots=True)
class FileMark:
    """By what a file is known again; of a journal, by its whole lines."""

    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A commit; by, who: its occasion, such as `session`, `p07`; begins: this was about to begin."""

    id: str
    utc: str
    begins: bool
    by: str
    who: str
    reason: str
    marks: Mapping[str, FileMark]


def is_journal(name: str) -> bool:
    """Check whether a file is a journal, which only grows."""
    return SESSION_FILE.fullmatch(name.rpartition("/")[2]) is not None


def take_marks(study: StudyFolder) -> dict[str, FileMark]:
    """Take the marks of all covered files as they are now."""
    paths = [path for pattern in COVERED for path in study.path.glob(pattern)]
    for folder in study.participants:
        paths += [folder / PLAN_FILE, folder / TOMBSTONE_FILE, *list_journals(folder)]
    marks = {}
    for path in sorted(paths):
        name = path.relative_to(study.path)
        if path.is_file() and not any(part.startswith((".", "__pycache__")) for part in name.parts):
            with suppress(FileNotFoundError):  # replaced at this moment
                marks[name.as_posix()] = _take_mark(path)
    return marks


def _take_mark(path: Path) -> FileMark:
    if not is_journal(path.name):
        return FileMark(path.stat().st_size, digest_file(path))
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    return FileMark(len(whole), digest(whole))


# The repository.


def name_branch(study: StudyFolder) -> str:
    """Name the branch of this copy of a study."""
    host = socket.gethostname()
    place = digest(f"{host}:{study.path.absolute()}")[:8]
    return f"{re.sub('[^A-Za-z0-9]+', '-', host).strip('-') or 'computer'}-{place}"


@contextmanager
def _opening(study: StudyFolder) -> Iterator[Repo]:
    """Open the repository for writing, alone; it is made where there is none."""
    from dulwich.repo import Repo
    from filelock import FileLock

    home = study.path / EVIDENCE
    try:
        with FileLock(home.with_name(f"{EVIDENCE}.lock"), timeout=LOCK_S):
            if not home.is_dir():
                _make_repository(home)
            for left in home.rglob("*.lock"):  # by a process that was killed
                left.unlink()
            with Repo(home) as repo:
                repo.object_store.fsync_object_files = True
                yield repo
    except OSError:
        raise
    except Exception as error:
        raise ValueError(_describe_damage(home, error)) from error


def _make_repository(home: Path) -> None:
    from dulwich.repo import Repo

    with temporary_folder(beside=home) as made:  # a kill leaves no half of one
        Repo.init_bare(made).close()
        made.rename(home)


def _describe_damage(home: Path, error: Exception) -> str:
    return f"{home}: cannot be read ({type(error).__name__}: {error}); restore it from a remote"


def _refs(repo: BaseRepo) -> Any:  # noqa: ANN401 - dulwich has types of its own for names
    return repo.refs


def _read_history(repo: BaseRepo, tip: Any) -> list[Checkpoint]:  # noqa: ANN401 - an id, or None
    """Read all checkpoints up to a commit, the oldest first; what is not as its id says is refused."""
    from dulwich.objects import ShaFile

    def read(name: Any) -> Any:  # noqa: ANN401 - dulwich's own
        kind, content = repo.object_store.get_raw(name)
        return ShaFile.from_raw_string(kind, content, verify_sha=name)

    history = []
    while tip is not None:
        commit = read(tip)
        text = read(read(commit.tree)[DIGESTS][1]).data.decode()
        lines = (line.split("\t") for line in text.splitlines())
        marks = {name: FileMark(int(size), sha256) for name, size, sha256 in lines}
        subject, _, reason = commit.message.decode().partition("\n\n")
        begins, occasion = subject.startswith("before "), subject.removeprefix("before ")
        by, _, who = occasion.partition(" ")
        utc = datetime.fromtimestamp(commit.commit_time, UTC).isoformat()
        history.append(Checkpoint(tip.decode(), utc, begins, by, who, reason, marks))
        tip = next(iter(commit.parents), None)
    return history[::-1]


def read_own(study: StudyFolder) -> tuple[list[Checkpoint], dict[str, set[str]], str]:
    """Read the history in the folder, its remotes (URL -> branches that were pushed there), and what is wrong."""
    from dulwich.repo import Repo

    home, remotes = study.path / EVIDENCE, {}
    if not home.is_dir():
        return [], {}, ""
    try:
        with Repo(home) as repo:
            remotes = {url: _list_pushed(repo, name) for url, name in _list_remotes(repo).items()}
            return _read_history(repo, _refs(repo).as_dict().get(b"HEAD")), remotes, ""
    except Exception as error:  # noqa: BLE001 - what is damaged raises anything
        return [], remotes, _describe_damage(home, error)


def find_newest(study: StudyFolder) -> str:
    """Find the id of the newest checkpoint in the folder; empty if there is none."""
    return next((one.id for one in read_own(study)[0][::-1]), "")


def _list_remotes(repo: Repo) -> dict[str, bytes]:
    config = repo.get_config()
    names = [section[1] for section in config.sections() if section[0] == b"remote"]
    return {config.get((b"remote", name), b"url").decode(): name for name in names}


def _list_pushed(repo: Repo, name: bytes) -> set[str]:
    return {ref.decode() for ref in _refs(repo).subkeys(b"refs/remotes/" + name)}


def take_checkpoint(
    study: StudyFolder, by: str, *, who: str = "", reason: str = "", remote: str = "", now: Clock
) -> Seal:
    """Commit what the files of a study are now, and push it.

    by, who: the occasion (`session`, `simulate`, `analyze`, `build`, `withdraw`, `seal`; `before ...`, `failed ...`);
    remote: a further one, which is kept if it takes this.
    """
    from dulwich.objects import Blob, Commit, Tree

    remote = remote and _prepare_remote(remote, study)
    with _opening(study) as repo:
        marks = take_marks(study).items()
        lines = [f"{name}\t{mark.size}\t{mark.sha256}\n" for name, mark in marks]
        blob, tree, commit = Blob.from_string("".join(lines).encode()), Tree(), Commit()
        tree.add(DIGESTS, 0o100644, blob.id)
        tip = _refs(repo).as_dict().get(b"HEAD")
        commit.tree, commit.parents = tree.id, [tip] if tip else []
        commit.author = commit.committer = b"feel321 <feel321@localhost>"
        commit.author_time = commit.commit_time = int(now().timestamp())
        commit.author_timezone = commit.commit_timezone = 0
        commit.message = "\n\n".join(filter(None, [f"{by} {who}".strip(), reason])).encode()
        objects = study.path / EVIDENCE / "objects"
        for one in (blob, tree, commit):
            repo.object_store.add_object(one)
            sync_folder(objects / one.id[:2].decode())
        sync_folder(objects)
        branch = name_branch(study).encode()
        _refs(repo)[HEADS + branch] = commit.id
        _refs(repo).set_symbolic_ref(b"HEAD", HEADS + branch)
        pushed = {} if by.startswith("before") else _push_all(repo, branch, new=remote)
    utc = datetime.fromtimestamp(commit.commit_time, UTC).isoformat()
    places = tuple(url for url, problem in pushed.items() if not problem)
    problems = tuple(f"{url}: takes no checkpoint ({why})" for url, why in pushed.items() if why)
    return Seal(utc, commit.id.decode(), places, problems)


# Remotes.


def _prepare_remote(remote: str, study: StudyFolder) -> str:
    """Refuse a remote that must not be one; a folder that is not there, or empty, becomes a repository."""
    from dulwich.repo import Repo

    if ":" in remote.partition("://")[2].rpartition("@")[0]:
        raise ValueError(
            "remote: must hold no password, got one; take it out, and use a key of ssh"
        )
    if "://" in remote or re.match(r"[^/\\]{2,}:", remote):
        return remote
    folder = Path(remote).absolute()
    if folder.resolve().is_relative_to(study.path.resolve()):
        raise ValueError(f"{folder}: is in {study.path}; choose one that others cannot write to")
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        make_folder(folder, private=True)
        Repo.init_bare(folder).close()
    return str(folder)


def _push_all(repo: Repo, branch: bytes, *, new: str) -> dict[str, str]:
    """Push a branch to every remote, and keep a new one that took it; returns what went wrong, by URL."""
    remotes = _list_remotes(repo)
    tip = _refs(repo)[HEADS + branch]
    known = {one.id.encode() for one in _read_history(repo, tip)} if remotes or new else set()
    done = {}
    for url in dict.fromkeys([*remotes, *filter(None, [new])]):
        name = remotes.get(url, b"remote%d" % (len(remotes) + 1))
        pushed = set() if url == new else _list_pushed(repo, name)
        with suppress(OSError):  # of a push that was killed: nobody else has this branch
            Path(url, f"{(HEADS + branch).decode()}.lock").unlink()

        def choose(refs: Mapping[bytes, bytes], pushed: set[str] = pushed) -> dict[bytes, bytes]:
            if any(HEADS + one.encode() not in refs for one in pushed):
                raise ValueError("what was pushed there is gone; see feel321 audit")
            if refs.get(HEADS + branch, tip) not in known:
                raise ValueError("it has checkpoints that are not here; see feel321 audit")
            return {HEADS + branch: tip}

        try:
            client, path = _find_client(url)
            _within(PUSH_S, client.send_pack, path, choose, repo.generate_pack_data)
        except (OSError, ValueError) as error:
            done[url] = str(error)
            continue
        done[url] = ""
        config = repo.get_config()
        config.set((b"remote", name), b"url", url.encode())
        config.write_to_path()
        _refs(repo)[b"refs/remotes/" + name + b"/" + branch] = tip
    return done


def _find_client(url: str) -> tuple[Any, str]:
    """Find how to talk to a remote: by the user's configuration of git, never by that of a study's folder."""
    from dulwich.client import get_transport_and_path
    from dulwich.config import StackedConfig

    ssh = os.environ.get("GIT_SSH_COMMAND", "ssh -oBatchMode=yes")
    return get_transport_and_path(url, config=StackedConfig.default(), ssh_command=ssh)


def _within(seconds: float, act: Callable[..., Any], *given: Any) -> Any:  # noqa: ANN401 - whatever it takes and gives
    """Do what waits for another computer, for so long at most."""
    done: Queue[tuple[Any, str]] = Queue()

    def work() -> None:
        try:
            done.put((act(*given), ""))
        except Exception as error:  # noqa: BLE001 - a transport raises anything
            done.put((None, f"{type(error).__name__}: {error}"))

    Thread(target=work, daemon=True).start()
    try:
        value, problem = done.get(timeout=seconds)
    except Empty:
        raise TimeoutError(f"no answer within {seconds:g} s") from None
    if problem:
        raise OSError(problem)
    return value


def fetch_branches(url: str, known: Sequence[Checkpoint]) -> dict[str, list[Checkpoint]]:
    """Fetch the history of each branch of a remote, into memory; known: what is here need not be fetched."""
    from dulwich.repo import MemoryRepo

    ends = {one.id.encode(): number for number, one in enumerate(known, start=1)}

    def choose(refs: Mapping[bytes, bytes], *_: object, **__: object) -> list[bytes]:
        return [tip for ref, tip in refs.items() if ref.startswith(HEADS) and tip not in ends]

    def fetch() -> dict[str, list[Checkpoint]]:
        repo = MemoryRepo()
        client, path = _find_client(url)
        refs = client.fetch(path, repo, determine_wants=choose).refs
        found = {}
        for ref in filter(lambda ref: ref.startswith(HEADS), refs):
            tip, branch = refs[ref], ref.removeprefix(HEADS).decode()
            with suppress(KeyError, ValueError):  # what is not ours
                found[branch] = list(known[: ends.get(tip, 0)]) or _read_history(repo, tip)
        return found

    branches: dict[str, list[Checkpoint]] = _within(FETCH_S, fetch)
    return branches


# Occasions.


def note_checkpoint(study: StudyFolder, by: str, *, who: str = "", now: Clock = utc_now) -> str:
    """Take a checkpoint of what must not fail because of it; returns what went wrong."""
    if study.is_rehearsal:
        return ""
    try:
        return "; ".join(take_checkpoint(study, by, who=who, now=now).problems)
    except (OSError, ValueError) as error:
        return f"no checkpoint was taken ({error}); take it later: feel321 seal"


@contextmanager
def declaring(
    study: StudyFolder, by: str, *, who: str = "", warn: Callable[[str], None] = lambda _: None
) -> Iterator[None]:
    """Take checkpoints before and after something that may change files, where a study has some."""
    has_evidence = (study.path / EVIDENCE).is_dir()
    before = note_checkpoint(study, f"before {by}", who=who) if has_evidence else ""
    try:
        yield
    except Exception:  # else it was killed, and may have done half
        if has_evidence:
            note_checkpoint(study, f"failed {by}", who=who)
        raise
    after = note_checkpoint(study, by, who=who) if has_evidence else ""
    for problem in filter(None, (before, after)):
        warn(problem)
