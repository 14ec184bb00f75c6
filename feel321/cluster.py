"""Jobs on a Dask cluster that a lab already has: sent, awaited, and sent again where a machine was lost.

A scheduler, its workers or the network may fail at any time. What has no result yet is known here, so it is sent again
to the same workers once they are back, or to others: jobs write their files whole or not at all, and their results do
not depend on where they run. Workers that have other versions are refused before they get a job.

Every path in a job is sent as an absolute one. Either all machines see the study's folder under that name, or files
travel through a folder that fsspec opens by URL: what a job names is put there before it is sent, and what it writes is
brought home before its result is used.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import pickle
import sys
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from itertools import islice
from pathlib import Path, PurePath
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from feel321.doors import announce
from feel321.extensions import Method, find_method
from feel321.files import make_folder, replace_bytes, temporary_folder, write_bytes

if TYPE_CHECKING:
    Job = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]

AHEAD = 2
"""Jobs in flight per thread of the cluster: one is done while the next waits beside it."""

PATIENCE_S = 60.0
"""How long a scheduler that is lost, or its first worker, is waited for."""

ANSWER_S = 20.0
"""How long workers have to say which versions they are; one that is slower is asked with its first job."""

SLOWER_S = 3.0
"""How much longer than the first worker the others have for that."""

READ_S = 10.0
"""How long a worker has to hand a result over, before the job is given to another."""

LOOK_S = 0.5
"""Between two looks at the cluster while no result comes."""

OVERDUE = 3.0
"""A job that takes so many times longer than the longest before it, and `LEAST_S` more, is given to a second worker."""

LEAST_S = 5.0

MODULES = ("feel321", "numpy", "scipy", "soxr")
"""What decides the bytes of results; all machines need the same versions, and the same minor version of Python."""

PROBE = (
    f"{{name: __import__(name).__version__ for name in {MODULES}}}"
    " | {'Python': '%d.%d' % __import__('sys').version_info[:2]}"
)
"""Asked of workers as an expression: one that has another feel321 need not know this module."""


def run_on_cluster(
    jobs: Iterable[Job], *, address: str, share: str = ""
) -> Iterator[tuple[int, Any]]:
    """Yield the place of each job and its result, as they are done; only a few jobs are taken ahead of time."""
    _check_certificates(address)
    post = _Post(share)
    with _quiet(), _Link(address) as link, post:
        left, running = enumerate(jobs), dict[int, bytes]()
        while True:
            for place, job in islice(left, max(0, link.room - len(running))):
                running[place] = post.pack(job)
                link.send(place, running[place])
            if not running:
                return
            place, reply = link.receive(running)
            del running[place]
            yield place, post.open(reply)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what distributed logs off stderr: what matters of it is raised, in one line."""
    log = logging.getLogger("distributed")
    loggers = [log, *(logging.getLogger(f"distributed.{name}") for name in ("client", "comm"))]
    levels = [one.level for one in loggers]
    for one in loggers:
        one.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for one, level in zip(loggers, levels, strict=True):
            one.setLevel(level)


def _check_certificates(address: str) -> None:
    """Refuse an encrypted address where Dask's configuration names no certificates."""
    from distributed import Security

    named: Any = Security().get_connection_args("client")  # type: ignore[no-untyped-call]  # distributed's types
    if address.startswith("tls://") and named.get("ssl_context") is None:
        raise ValueError(
            f"{address}: no certificates are named; set distributed.comm.tls in Dask's configuration, such as "
            "~/.config/dask/feel321.yaml"
        )


def find_versions() -> dict[str, str]:
    """Find the versions that all machines must have."""
    found = {name: __import__(name).__version__ for name in MODULES}
    return {**found, "Python": f"{sys.version_info.major}.{sys.version_info.minor}"}


def compare_versions(where: str, theirs: Mapping[str, str], ours: Mapping[str, str]) -> str:
    """Say in which versions a worker differs from the machine that sends jobs; empty if in none."""
    other = [
        f"{name} {theirs.get(name, '(missing)')} instead of {version}"
        for name, version in ours.items()
        if theirs.get(name) != version
    ]
    if not other:
        return ""
    return (
        f"worker {where} has {', '.join(other)}, and its results could differ; "
        "install the same versions there, or stop it"
    )


class _Link:
    """A connection to a scheduler, made anew where it is lost; it knows which jobs are with it."""

    def __init__(self, address: str) -> None:
        """Connect, or refuse a cluster that does not answer or has workers of another version."""
        self._address, self._slowest, self.room = address, 0.0, 0
        self._client: Any = None  # distributed's own types are incomplete
        self._seen = 0.0
        self._connect()

    def __enter__(self) -> _Link:
        """Return it, connected."""
        return self

    def __exit__(self, *_: object) -> None:
        """Cancel what still waits, and disconnect."""
        self._drop()

    def send(self, place: int, content: bytes, others: Iterable[str] = ()) -> None:
        """Send a job; others: the workers that may do it."""
        done, token, chosen = self._done, uuid.uuid4().hex, list(others) or None
        futures = self._sent.setdefault(place, (time.monotonic(), []))[1]
        with warnings.catch_warnings(), suppress(OSError, RuntimeError):
            # A job may hold a long recording. A connection that is lost here is found when results are awaited.
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            future = self._client.submit(
                do_job, content, find_versions(), key=(f"{self._name}", token), pure=False, workers=chosen
            )  # fmt: skip
            futures.append(future)
            future.add_done_callback(lambda one: done.put((place, one)))

    def receive(self, running: Mapping[int, bytes]) -> tuple[int, bytes]:
        """Wait for a result, whatever happens meanwhile; running: the jobs that have none yet."""
        while True:
            try:
                place, future = self._done.get(timeout=LOOK_S)
            except Empty:
                self._look(running)
                continue
            if place not in running:  # done by another worker before
                continue
            reply = self._read(place, future, running)
            if reply is not None and self._counts(place, future, reply):
                return place, reply

    def _counts(self, place: int, future: Any, reply: bytes) -> bool:  # noqa: ANN401 - a future of distributed
        """Whether a reply counts: of two workers with one job, the second may fail because the first is through."""
        since, futures = self._sent[place]
        if len(futures) > 1 and pickle.loads(reply).error:  # noqa: S301 - from the lab's own worker
            futures.remove(future)
            return False
        if len(futures) == 1:
            self._slowest = max(self._slowest, time.monotonic() - since)
        del self._sent[place]
        return True

    def _read(self, place: int, future: Any, running: Mapping[int, bytes]) -> bytes | None:  # noqa: ANN401 - a future of distributed
        """Read the reply of a job; None if it was lost, and the job is sent again."""
        from concurrent.futures import CancelledError

        if future.status == "error":
            raise OSError(self._explain(future.exception()))
        try:
            reply: bytes = future.result(timeout=READ_S)
        except TimeoutError:  # its worker does not hand it over
            self._copy(place, running[place])
        except (OSError, CancelledError):
            self._connect_again(running)
        else:
            return reply
        return None

    def _explain(self, error: Exception) -> str:
        lost = getattr(error, "allowed_failures", None)
        if lost is None:
            return f"{self._address}: {error}"
        return (
            f"{self._address}: {lost + 1} workers were lost one after the other while doing the same job, perhaps for "
            "lack of memory; start workers with fewer threads or a higher --memory-limit and run the command again: "
            "what is finished is kept"
        )

    def _look(self, running: Mapping[int, bytes]) -> None:
        """Look after the cluster while nothing comes: it may be lost, or without workers, or one may be stuck."""
        if self._client.status != "running":
            self._connect_again(running)
            return
        now = time.monotonic()
        try:
            self._seen = now if self._count() else self._seen
            self._help(running, now)
        except (OSError, RuntimeError):
            self._connect_again(running)
        if now - self._seen > PATIENCE_S:
            raise OSError(self._miss("has had no worker"))

    def _help(self, running: Mapping[int, bytes], now: float) -> None:
        """Give what is long overdue to a second worker: the first to finish counts."""
        for place, content in running.items():
            since, futures = self._sent[place]
            if not futures:  # the connection was lost while it was sent
                self.send(place, content)
            elif (
                len(futures) == 1
                and self._slowest > 0
                and now - since > OVERDUE * self._slowest + LEAST_S
            ):
                self._copy(place, content)

    def _copy(self, place: int, content: bytes) -> None:
        """Send a job once more, to workers that do not have it, if there are any."""
        keys = {one.key for one in self._sent[place][1]}
        doing, done = self._client.processing(), self._client.has_what()
        others = [name for name in doing if keys.isdisjoint((*doing[name], *done[name]))]
        self.send(place, content, others)

    def _connect_again(self, running: Mapping[int, bytes]) -> None:
        """Connect anew and send all that has no result."""
        self._drop()
        announce(f"waiting for {self._address}")
        self._connect()
        for place, content in running.items():
            self.send(place, content)

    def _connect(self) -> None:
        from distributed import Client

        open_client: Any = Client  # distributed's own types are incomplete
        self._done: SimpleQueue[tuple[int, Any]] = SimpleQueue()
        self._sent: dict[int, tuple[float, list[Any]]] = {}
        self._name = f"feel321-{uuid.uuid4().hex}"
        self._seen = time.monotonic()
        until = self._seen + PATIENCE_S
        while True:
            try:
                with (
                    warnings.catch_warnings()
                ):  # of other versions of Dask; those that matter are compared below
                    warnings.simplefilter("ignore")
                    self._client = open_client(self._address, timeout=5, set_as_default=False)
                break
            except (OSError, TimeoutError) as error:
                if time.monotonic() > until:
                    raise OSError(self._miss("has not answered")) from error
                time.sleep(LOOK_S)
        self._meet(until)

    def _meet(self, until: float) -> None:
        """Wait for the first worker, and refuse those that have other versions."""
        while not self._count():
            if time.monotonic() > until:
                self._drop()
                raise OSError(self._miss("has had no worker"))
            time.sleep(LOOK_S)
        try:
            self._compare()
        except BaseException:
            self._drop()
            raise

    def _compare(self) -> None:
        names = [*self._client.nthreads()]
        asked = {
            name: self._client.submit(eval, PROBE, workers=[name], pure=False)  # noqa: S307 - our own text
            for name in names
        }
        until = time.monotonic() + ANSWER_S
        while (
            late := sum(one.status == "pending" for one in asked.values())
        ) and time.monotonic() < until:
            if late < len(asked):
                until = min(until, time.monotonic() + SLOWER_S)
            time.sleep(LOOK_S / 10)
        problems = []
        for name, answer in asked.items():
            if answer.status == "error":
                lacks = f"worker {name} cannot do jobs of feel321 ({answer.exception()})"
                problems.append(f"{lacks}; install it there, or stop the worker")
            elif answer.status == "finished":
                problems.append(compare_versions(name, answer.result(), find_versions()))
        if text := "\n".join(filter(None, problems)):
            raise ValueError(text)

    def _count(self) -> int:
        self.room = AHEAD * sum(self._client.nthreads().values())
        return self.room

    def _miss(self, what: str) -> str:
        return (
            f"{self._address}: {what} for {PATIENCE_S:g} s; start it (dask scheduler, dask worker) or leave out "
            "--dask, and run the command again: what is finished is kept"
        )

    def _drop(self) -> None:
        with suppress(OSError, RuntimeError, TimeoutError):
            if self._client.status == "running":
                waiting = [one for _, futures in self._sent.values() for one in futures]
                self._client.cancel(waiting, force=True)
        with suppress(OSError, RuntimeError, TimeoutError):
            self._client.close(timeout=2)


# What is sent, and what comes back.

_HOME: ContextVar[str] = ContextVar("_HOME", default="")
"""Folder under which a worker keeps the files of the job that it does; empty where paths are the same everywhere."""


def _arrive(path: str) -> Path:
    """Make the path of a job that has arrived on a worker."""
    return Path(_HOME.get() + path)


@dataclass(frozen=True, slots=True)
class Parcel:
    """A job on its way.

    job: pickled; paths: those that must be there; methods: kind, place and digest of those from installed packages;
    files: path -> its name in `share`.
    """

    job: bytes
    paths: tuple[str, ...]
    methods: tuple[tuple[str, str, str], ...] = ()
    share: str = ""
    files: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Reply:
    """What became of a job: its result, or why there is none; files: path -> name in `share` of what it wrote."""

    where: str
    result: Any = None
    error: Exception | None = None
    files: dict[str, str] = field(default_factory=dict)


def _make_packer(file: io.BytesIO, paths: set[Path], methods: list[Method]) -> pickle.Pickler:
    """Make what pickles a job, and notes all paths in it, which it makes absolute, and a lab's own methods."""
    from cloudpickle import Pickler

    class Packer(Pickler):  # type: ignore[misc]  # cloudpickle has no types
        def reducer_override(self, obj: Any) -> Any:  # noqa: ANN401 - anything in a job
            if isinstance(obj, PurePath):
                paths.add(Path(os.path.abspath(obj)))  # noqa: PTH100 - links stay as they are
                return _arrive, (os.path.abspath(obj),)  # noqa: PTH100 - links stay as they are
            if isinstance(obj, Method):
                paths.update(_list_code(obj))
                methods.extend([obj] if obj.origin == "module" else [])
            return super().reducer_override(obj)

    made: pickle.Pickler = Packer(file, protocol=pickle.HIGHEST_PROTOCOL)
    return made


def _list_code(method: Method) -> list[Path]:
    """List the files that a lab's own method may need: its folder's Python, or what was made elsewhere."""
    folder = method.folder or Path()
    if method.origin == "file":
        return [*(folder / method.place.rpartition(":")[0]).parent.rglob("*.py")]
    if method.origin == "made":
        return [*folder.glob(method.place.replace("{recording}", "*"))]
    return []


class _Post:
    """Sends jobs and opens replies; files go by a folder at a URL, if one is given, and that is emptied in the end."""

    def __init__(self, share: str) -> None:
        """Open the folder."""
        self._share = f"{share.rstrip('/')}/feel321-{uuid.uuid4().hex}" if share else ""
        self._there: dict[Path, tuple[tuple[int, int], str]] = {}

    def __enter__(self) -> _Post:
        """Make the folder."""
        if self._share:
            files, root = _open_share(self._share)
            files.makedirs(root, exist_ok=True)
        return self

    def __exit__(self, *_: object) -> None:
        """Remove what is left in the folder."""
        if self._share:
            files, root = _open_share(self._share)
            with suppress(OSError):
                files.rm(root, recursive=True)

    def pack(self, job: Job) -> bytes:
        """Pickle a job, and put the files that it names where its worker finds them."""
        content, paths, methods = io.BytesIO(), set[Path](), list[Method]()
        _make_packer(content, paths, methods).dump(job)
        there = sorted(path for path in paths if path.exists())
        shared = [path for path in there if path.is_file()] if self._share else []
        files = {str(path): self._put(path) for path in shared}
        installed = tuple((one.kind, one.place, one.sha256) for one in methods)
        return pickle.dumps(
            Parcel(content.getvalue(), tuple(map(str, there)), installed, self._share, files)
        )

    def _put(self, path: Path) -> str:
        about = path.stat()
        stamp = about.st_mtime_ns, about.st_size
        if path not in self._there or self._there[path][0] != stamp:
            self._there[path] = stamp, _put_content(self._share, path.read_bytes())
        return self._there[path][1]

    def open(self, content: bytes) -> Any:  # noqa: ANN401 - whatever the job returns
        """Return the result of a job whose files are home, or raise what it raised."""
        reply: Reply = pickle.loads(content)  # noqa: S301 - from the lab's own worker
        if reply.error is not None:
            raise reply.error
        for path, place in reply.files.items():
            write_bytes(Path(path), _take_content(self._share, place, where=reply.where))
            files, root = _open_share(self._share)
            with suppress(OSError):
                files.rm_file(f"{root}/{place}")
        return reply.result


def do_job(content: bytes, versions: Mapping[str, str]) -> bytes:
    """Do a job on a worker, and pickle what became of it."""
    from distributed import get_worker

    where = str(get_worker().address)
    try:
        if text := compare_versions(where, find_versions(), versions):
            raise ValueError(text)  # noqa: TRY301 - told like all other failures of a job
        parcel: Parcel = pickle.loads(content)  # noqa: S301 - what a worker is there for
        result, files = _do(parcel, where) if parcel.share else (_do_here(parcel, where), {})
        return pickle.dumps(Reply(where, result, files=files))
    except Exception as error:  # noqa: BLE001 - whatever a job raises is raised where it was sent from
        return _pickle_error(where, error)


def _pickle_error(where: str, error: Exception) -> bytes:
    try:
        content = pickle.dumps(Reply(where, error=error))
        pickle.loads(content)  # noqa: S301 - one that can be written need not be readable
    except Exception:  # noqa: BLE001 - a lab's own error may hold anything
        content = pickle.dumps(Reply(where, error=ValueError(f"{type(error).__name__}: {error}")))
    return content


def _do_here(parcel: Parcel, where: str) -> Any:  # noqa: ANN401 - whatever the job returns
    """Do a job whose files have the same names on all machines."""
    if missing := [path for path in parcel.paths if not Path(_HOME.get() + path).exists()]:
        raise FileNotFoundError(
            f"{missing[0]}: not there on worker {where}; let all machines see the study's folder under the same name, "
            "or give --share URL"
        )
    for kind, place, sha256 in parcel.methods:
        _check_method(kind, place, sha256, where=where)
    try:
        function, arguments, named = pickle.loads(parcel.job)  # noqa: S301 - what a worker is there for
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f"worker {where} lacks code that the job needs ({error}); install it there, or put it into the study's "
            "folder as methods/NAME.py"
        ) from None
    return function(*arguments, **named)


@cache
def _check_method(kind: str, place: str, sha256: str, *, where: str) -> None:
    """Refuse to use a method of an installed package that is missing on a worker, or another one there."""
    try:
        found = find_method(kind, place)
    except ValueError as error:
        raise ValueError(f"worker {where}: {error}") from None
    if found.sha256 != sha256:
        raise ValueError(
            f"worker {where} has other code of {kind} {place!r} than this machine; install the same version there"
        )


def _do(parcel: Parcel, where: str) -> tuple[Any, dict[str, str]]:
    """Do a job in a folder of its own, to which its files are brought; also returns what it wrote."""
    with temporary_folder() as folder:
        home = str(folder)
        token = _HOME.set(home)
        try:
            _bring(parcel, home, where)
            result = _do_here(parcel, where)
        finally:
            _HOME.reset(token)
        written = {str(path)[len(home) :]: path for path in Path(home).rglob("*") if path.is_file()}
        return result, {
            name: _put_content(parcel.share, path.read_bytes())
            for name, path in written.items()
            if name not in parcel.files
        }


def _bring(parcel: Parcel, home: str, where: str) -> None:
    """Make the folders that a job names, and bring its files."""
    for name in parcel.paths:
        path = Path(home + name)
        if name in parcel.files:
            make_folder(path.parent)
            replace_bytes(path, _take_content(parcel.share, parcel.files[name], where=where))
        else:
            make_folder(path)


def _hide(url: str) -> str:
    """Write scheme and host of a URL only: what else it holds may be secret."""
    scheme, _, rest = url.partition("://")
    return f"{scheme}://{rest.rpartition('@')[2].partition('/')[0]}"


def _open_share(url: str) -> tuple[Any, str]:
    """Open a folder by its URL."""
    from fsspec.core import url_to_fs

    try:
        files, root = url_to_fs(url)
    except (ImportError, ValueError) as error:
        why = str(error).replace(url, _hide(url))
        raise ValueError(
            f"--share {_hide(url)}: {why}; give a URL that fsspec opens, such as file:///data or "
            "s3://bucket/folder"
        ) from None
    return files, str(root)


def _put_content(share: str, content: bytes) -> str:
    """Put content into a shared folder, under a name of its own that ends in its digest."""
    files, root = _open_share(share)
    place = f"{uuid.uuid4().hex}-{hashlib.sha256(content).hexdigest()}"
    files.pipe_file(f"{root}/{place}", content)
    return place


def _take_content(share: str, place: str, *, where: str) -> bytes:
    """Take content from a shared folder, whole."""
    files, root = _open_share(share)
    try:
        content: bytes = files.cat_file(f"{root}/{place}")
    except FileNotFoundError:
        content = b""
    if hashlib.sha256(content).hexdigest() != place.rpartition("-")[2]:
        raise FileNotFoundError(
            f"{_hide(share)}: worker {where} does not see what was put there; give a --share that all machines see"
        )
    return content
