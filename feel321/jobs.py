"""Independent jobs: done in this process, in several, or on a cluster, always by this one way.

A job is a function and its arguments, all of which can be pickled; it writes its own files whole or not at all, and its
result does not depend on where or when it runs. So results are the same for any number of workers, and a job that was
lost with its process is simply done again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextvars import copy_context
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from re import fullmatch, search
from typing import Any

__all__ = ["Workers"]

Job = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]
"""What is called, its positional and its named arguments."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Where jobs run: in processes of this machine, or on a Dask cluster.

    Parameters
    ----------
    count : int
        Number of processes of this machine.
    dask : str
        Instead, the scheduler of a Dask cluster: `tcp://HOST:PORT`, or `tls://HOST:PORT` with certificates named in
        Dask's own configuration.
    share : str
        With `dask`: URL of a folder, opened by fsspec, through which files travel. If left out, all machines must see
        the study's folder under the same name.

    Raises
    ------
    ValueError
        If the number is below 1, the address is not of that form, or the URL holds a password.

    Examples
    --------
    >>> Workers(2).count
    2
    """

    count: int = 1
    dask: str = ""
    share: str = ""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        if self.count < 1:
            raise ValueError(f"workers must be 1 or more, got {self.count}")
        if self.dask and not fullmatch(r"(tcp|tls)://.+:\d+", self.dask):
            raise ValueError(
                f"dask must be tcp://HOST:PORT or tls://HOST:PORT, as dask scheduler prints it; got {self.dask!r}"
            )
        if self.share and not self.dask:
            raise ValueError("share is for a Dask cluster; give dask too, or leave share out")
        if search(r"://[^/@:]*:(?!\d*(/|$))[^@]*@", self.share):
            raise ValueError(
                "share must hold no password; use a key, or put it into fsspec's configuration on all machines "
                "(~/.config/fsspec/conf.json)"
            )

    def stay_here(self) -> Workers:
        """Keep to the processes of this machine, where a job's files would travel farther than it is long."""
        return Workers(self.count) if self.share else self


ALONE = Workers()
"""This process only."""


def as_workers(workers: int | Workers) -> Workers:
    """Take a number of processes for that many workers."""
    return Workers(workers) if isinstance(workers, int) else workers


def run_jobs(
    jobs: Iterable[Job], *, workers: Workers = ALONE, threads: int = 1
) -> Iterator[tuple[int, Any]]:
    """Yield the place of each job and its result, as they are done; only a few jobs are taken ahead of time."""
    if workers.dask:
        yield from _run_on_cluster(jobs, workers)
        return
    if workers.count == 1:
        yield from _run_here(jobs, threads=threads)
        return
    from joblib import Parallel, delayed

    numbered = (delayed(_run_numbered)(place, job) for place, job in enumerate(jobs))
    yield from Parallel(n_jobs=workers.count, return_as="generator_unordered")(numbered)


def _run_on_cluster(jobs: Iterable[Job], workers: Workers) -> Iterator[tuple[int, Any]]:
    missing = [name for name in ("distributed", "fsspec") if find_spec(name) is None]
    if missing:
        raise ModuleNotFoundError(
            f"a Dask cluster needs {' and '.join(missing)}, not installed here; run pip install 'feel321[cluster]'"
        )
    from feel321.cluster import run_on_cluster

    return run_on_cluster(jobs, address=workers.dask, share=workers.share)


def gather_results(
    jobs: Iterable[Job], *, workers: Workers = ALONE, done: Callable[[], object] = lambda: None
) -> list[Any]:
    """Do all jobs and return their results, in the order of the jobs; `done` is called after each."""
    found: dict[int, Any] = {}
    for place, result in run_jobs(jobs, workers=workers):
        found[place] = result
        done()
    return [found[place] for place in sorted(found)]


def _run_numbered(place: int, job: Job) -> tuple[int, Any]:
    function, arguments, named = job
    return place, function(*arguments, **named)


def _run_here(jobs: Iterable[Job], *, threads: int) -> Iterator[tuple[int, Any]]:
    """Run jobs in threads of this process; each has a context of its own, in which it can say what is being done."""
    left = enumerate(jobs)
    with ThreadPoolExecutor(threads) as pool:
        running: set[Future[tuple[int, Any]]] = set()
        while True:
            for place, job in islice(left, 2 * threads - len(running)):
                running.add(pool.submit(copy_context().run, _run_numbered, place, job))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for one in done:
                yield one.result()
