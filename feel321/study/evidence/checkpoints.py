"""Checkpoints: what the files of a study were, committed to a git repository of its own and pushed to its remotes.

The repository is `.evidence` beside `study.toml`, bare, written and read by dulwich, so that no lab computer needs git.
A commit holds one file, `digests`: name, size and SHA-256 of every file that is covered, never contents, so that a
withdrawal leaves no answer in the history. Its subject is the occasion, its body the reason that somebody gave. Each
copy of a study commits to a branch of its own, named after computer and folder, so that copies can share a remote;
where a remote has more of that branch than the folder, a backup was restored, and with a reason for it the study goes
on as another branch. Whoever can write to the folder can make the repository anew; only a remote shows that.
"""

import os
import re
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple, TypeVar

from feel321.files import create_text, make_folder, sync_folder, temporary_folder
from feel321.study.folder import Seal, StudyFolder
from feel321.study.session.journal import SESSION_FILE, Clock, digest, list_journals, utc_now
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE

T = TypeVar("T")

EVIDENCE, DIGESTS, HEADS = ".evidence", b"digests", b"refs/heads/"

LOCK_S, PUSH_S, FETCH_S = 60.0, 15.0, 120.0
"""How long another process may hold the repository, and how long a remote may take."""

ATTRIBUTES = "# Digests are of bytes: git must not convert line endings.\n* -text\n"

COVERED = (
    "*.toml", "frozen.json", "ratings.csv", "participants.csv", "matches.csv",
    "methods/**/*", "calibration/**/*", "stimuli/**/*", "report/**/*",
)  # fmt: skip
"""Covered besides plans, journals and tombstones. Personal answers are not: a digest of so little would tell them."""


class FileMark(NamedTuple):
    """By what a file is known again; of a journal, by its whole lines."""

    size: int
    sha256: str


class Checkpoint(NamedTuple):
    """A commit; by, who: its occasion, such as `session`, `p07`; begins: this was about to begin."""

    id: str
    utc: str
    begins: bool
    by: str
    who: str
    reason: str
    marks: Mapping[str, FileMark]


class Own(NamedTuple):
    """The history in a study's folder, its remotes (URL -> branches pushed there), what is wrong, and its branch."""

    history: list[Checkpoint]
    pushed: dict[str, set[str]]
    problem: str
    branch: str


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
                content = read_lines(path) if is_journal(path.name) else path.read_bytes()
                marks[name.as_posix()] = FileMark(len(content), digest(content))
    return marks


def read_lines(path: Path) -> bytes:
    """Read the whole lines of a journal, with the line ends that it was written with."""
    content = path.read_bytes()
    return content[: content.rfind(b"\n") + 1].replace(b"\r\n", b"\n")


# The repository. `Any` stands for dulwich's own types of repositories and names.


@contextmanager
def _opening(study: StudyFolder) -> Iterator[Any]:
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
    """Make it; a kill leaves no half of one."""
    from dulwich.repo import Repo

    with temporary_folder(beside=home) as made:
        Repo.init_bare(made).close()
        made.rename(home)
    with suppress(FileExistsError):
        create_text(home.with_name(".gitattributes"), ATTRIBUTES)


def _describe_damage(home: Path, error: Exception) -> str:
    return f"{home}: cannot be read ({type(error).__name__}: {error}); restore it from a remote"


def read_own(study: StudyFolder) -> Own:
    """Read the repository in the folder."""
    home, own = study.path / EVIDENCE, Own([], {}, "", "")
    if not home.is_dir():
        return own
    from dulwich.repo import Repo

    host = socket.gethostname()
    place = digest(f"{host}:{study.path.absolute()}")[:8]
    name = f"{re.sub('[^A-Za-z0-9]+', '-', host).strip('-') or 'computer'}-{place}"
    try:
        with Repo(home) as repo:
            head = repo.refs.follow(b"HEAD")[0][-1].removeprefix(HEADS).decode()  # type: ignore[arg-type]
            own = own._replace(branch=head if head.startswith(f"{name}-restored-") else name)
            config = repo.get_config()
            for section in (one for one in config.sections() if one[0] == b"remote"):
                refs = repo.refs.subkeys(b"refs/remotes/" + section[1])  # type: ignore[arg-type]
                there = own.pushed.setdefault(config.get(section, b"url").decode(), set())
                there.update(ref.decode() for ref in refs)  # a URL may stand there twice
            tip = repo.refs.as_dict().get(b"HEAD")  # type: ignore[call-overload]
            return own._replace(history=_read_history(repo, tip))
    except Exception as error:  # noqa: BLE001 - what is damaged raises anything
        return own._replace(problem=_describe_damage(home, error))


def _read_history(repo: Any, tip: Any) -> list[Checkpoint]:  # noqa: ANN401
    """Read all checkpoints up to a commit, the oldest first; what is not as its id says is refused."""
    from dulwich.objects import ShaFile

    def read(name: Any) -> Any:  # noqa: ANN401
        kind, content = repo.object_store.get_raw(name)
        return ShaFile.from_raw_string(kind, content, verify_sha=name)

    history = []
    while tip is not None:
        commit = read(tip)
        text = read(read(commit.tree)[DIGESTS][1]).data.decode()
        lines = (line.split("\t") for line in text.splitlines())
        marks = {name: FileMark(int(size), sha256) for name, size, sha256 in lines}
        subject, _, reason = commit.message.decode().partition("\n\n")
        by, _, who = subject.removeprefix("before ").partition(" ")
        utc = datetime.fromtimestamp(commit.commit_time, UTC).isoformat()
        begins = subject.startswith("before ")
        history.append(Checkpoint(tip.decode(), utc, begins, by, who, reason, marks))
        tip = next(iter(commit.parents), None)
    return history[::-1]


def find_newest(study: StudyFolder, by: str = "", who: str = "") -> Checkpoint | None:
    """Find the newest checkpoint in the folder, of one occasion if it is named."""
    every = read_own(study).history[::-1]
    return next((one for one in every if not by or (one.by, one.who) == (by, who)), None)


def take_checkpoint(
    study: StudyFolder, by: str, *, who: str = "", reason: str = "", remote: str = "", now: Clock
) -> Seal:
    """Commit what the files of a study are now, and push it.

    by, who: the occasion (`session`, `simulate`, `analyze`, `build`, `withdraw`, `seal`; `before ...`); remote: a
    further one, which is kept if it takes this.
    """
    remote = remote and _prepare_remote(remote, study)
    ahead = _find_ahead(read_own(study)) if reason else []
    with _opening(study) as repo:
        moment, own, marks = now(), read_own(study), take_marks(study)
        if own.problem:
            raise ValueError(own.problem)
        branch = own.branch
        if ahead:
            lost = "; ".join(_list_lost(ahead[-1].marks, marks)) or "no session"
            by, reason = "restored", f"{reason} (restored, lost: {lost})"
            branch = f"{branch.partition('-restored-')[0]}-restored-{ahead[-1].id[:8]}"
        message = "\n\n".join(filter(None, [f"{by} {who}".strip(), reason]))
        done = _commit(repo, branch, marks, message=message, utc=moment)
        pushed = {} if by.startswith("before") else _push_all(repo, own, branch, new=remote)
    places = tuple(url for url, problem in pushed.items() if not problem)
    problems = tuple(f"{url}: takes no checkpoint ({why})" for url, why in pushed.items() if why)
    return Seal(moment.astimezone(UTC).isoformat(timespec="seconds"), done, places, problems)


def _find_ahead(own: Own) -> list[Checkpoint]:
    """Find the history of this branch at a remote that has more of it: the folder was restored from a backup."""
    known = {one.id for one in own.history}
    for url in own.pushed:
        with suppress(OSError):  # said when it is pushed to
            theirs = fetch_branches(url, own.history).get(own.branch, [])
            if theirs and theirs[-1].id not in known:
                return theirs
    return []


def _list_lost(before: Mapping[str, FileMark], now: Mapping[str, FileMark]) -> Iterator[str]:
    """List the sessions that were there and are not, or not to their end; withdrawn participants have lost none."""
    for name in filter(is_journal, sorted(before)):
        who, session = name.split("/")[1], int(name[-8:-6])
        size = now[name].size if name in now else 0
        if size < before[name].size and f"sessions/{who}/{TOMBSTONE_FILE}" not in {*before, *now}:
            yield f"{'the end of ' if size else ''}session {session} of {who}"


def _commit(
    repo: Any,  # noqa: ANN401
    branch: str,
    marks: Mapping[str, FileMark],
    *,
    message: str,
    utc: datetime,
) -> str:
    from dulwich.objects import Blob, Commit, Tree

    lines = [f"{name}\t{mark.size}\t{mark.sha256}\n" for name, mark in marks.items()]
    blob, tree, commit = Blob.from_string("".join(lines).encode()), Tree(), Commit()
    tree.add(DIGESTS, 0o100644, blob.id)
    tip = repo.refs.as_dict().get(b"HEAD")
    commit.tree, commit.parents = tree.id, [tip] if tip else []
    commit.author = commit.committer = b"feel321 <feel321@localhost>"
    commit.author_time = commit.commit_time = int(utc.timestamp())
    commit.author_timezone = commit.commit_timezone = 0
    commit.message = message.encode()
    objects = Path(repo.path) / "objects"
    for one in (blob, tree, commit):
        repo.object_store.add_object(one)
        sync_folder(objects / one.id[:2].decode())
    sync_folder(objects)
    repo.refs[HEADS + branch.encode()] = commit.id
    repo.refs.set_symbolic_ref(b"HEAD", HEADS + branch.encode())
    return commit.id.decode()


def _prepare_remote(remote: str, study: StudyFolder) -> str:
    """Refuse a remote that must not be one; a folder that is not there, or empty, becomes a repository."""
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
        from dulwich.repo import Repo

        make_folder(folder, private=True)
        Repo.init_bare(folder).close()
    return str(folder)


def _push_all(repo: Any, own: Own, branch: str, *, new: str) -> dict[str, str]:  # noqa: ANN401
    """Push a branch to every remote, and keep a new one that took it; returns what went wrong, by URL."""
    ref, problems = HEADS + branch.encode(), dict[str, str]()
    tip, known = repo.refs[ref], {one.id.encode() for one in own.history}

    def push(url: str, there: set[str]) -> None:
        def choose(refs: Mapping[bytes, bytes]) -> dict[bytes, bytes]:
            if any(HEADS + one.encode() not in refs for one in there):
                raise ValueError("what was pushed there is gone; see feel321 audit")
            if refs.get(ref, tip) not in {*known, tip}:
                raise ValueError(
                    "it has checkpoints that are not here; see feel321 audit, and if this folder was restored from a "
                    "backup, say so: feel321 seal --reason TEXT"
                )
            return {ref: tip}

        with suppress(OSError):  # of a push that was killed: nobody else has this branch
            Path(url, f"{ref.decode()}.lock").unlink()
        client, path = _find_client(url)
        client.send_pack(path, choose, repo.generate_pack_data)

    urls = dict.fromkeys([*own.pushed, *filter(None, [new])])
    for url in urls:
        there = set() if url == new else own.pushed[url]
        try:
            _limit(PUSH_S / len(urls), partial(push, url, there))  # others wait for the lock
        except OSError as error:
            problems[url] = str(error)
            continue
        problems[url] = ""
        if branch not in there:
            name, config = digest(url)[:12].encode(), repo.get_config()
            config.set((b"remote", name), b"url", url.encode())
            config.write_to_path()
            repo.refs[b"refs/remotes/" + name + b"/" + branch.encode()] = tip
    return problems


def _find_client(url: str) -> tuple[Any, str]:
    """Find how to talk to a remote: by the user's configuration of git, never by that of a study's folder."""
    from dulwich.client import get_transport_and_path
    from dulwich.config import StackedConfig

    ssh = os.environ.get("GIT_SSH_COMMAND", "ssh -oBatchMode=yes")
    return get_transport_and_path(url, config=StackedConfig.default(), ssh_command=ssh)


def _limit(seconds: float, work: Callable[[], T]) -> T:
    """Do what waits for another computer, for so long at most; whatever goes wrong is an OSError."""
    done: list[T] = []
    problem = f"no answer within {seconds:g} s"

    def run() -> None:
        nonlocal problem
        try:
            done.append(work())
        except Exception as error:  # noqa: BLE001 - a transport raises anything
            problem = f"{type(error).__name__}: {error}"

    thread = Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds)
    if not done:
        raise OSError(problem)
    return done[0]


def fetch_branches(url: str, known: Sequence[Checkpoint]) -> dict[str, list[Checkpoint]]:
    """Fetch the history of each branch of a remote, into memory; known: what is here need not be fetched."""
    from dulwich.repo import MemoryRepo

    ends = {one.id.encode(): number for number, one in enumerate(known, start=1)}

    def fetch() -> dict[str, list[Checkpoint]]:
        repo, found = MemoryRepo(), dict[str, list[Checkpoint]]()
        client, path = _find_client(url)

        def choose(refs: Mapping[bytes, bytes], *_: object, **__: object) -> list[bytes]:
            return [tip for ref, tip in refs.items() if ref.startswith(HEADS) and tip not in ends]

        refs = client.fetch(path, repo, determine_wants=choose).refs
        for ref in filter(lambda ref: ref.startswith(HEADS), refs):
            tip, branch = refs[ref], ref.removeprefix(HEADS).decode()
            with suppress(KeyError, ValueError):  # what is not ours
                found[branch] = list(known[: ends.get(tip, 0)]) or _read_history(repo, tip)
        return found

    return _limit(FETCH_S, fetch)


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
    if not (study.path / EVIDENCE).is_dir():
        yield
        return
    before = note_checkpoint(study, f"before {by}", who=who)
    yield  # what fails or is killed here may have done half, and no checkpoint says that it ended
    for problem in filter(None, (before, note_checkpoint(study, by, who=who))):
        warn(problem)
