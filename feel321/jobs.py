"""Independent jobs: done in this process, in several, or on a Dask cluster, always by this one way.

A job is a function and its arguments, all of which can be pickled; it writes its own files whole or not at all, and its
result does not depend on where or when it runs. So results are the same for any number of workers, and a job that was
lost with its process is simply done again.

On a cluster jobs are futures of `distributed`, not tasks of joblib's backend `dask`: that one (joblib 1.6) waits for
ever for a task that was given up, such as one that takes the memory of four workers in turn.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice, starmap
from pathlib import Path
from re import fullmatch
from types import MappingProxyType
from typing import Any

__all__ = ["Workers"]

Job = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]
"""What is called, its positional and its named arguments."""

Numbered = tuple[int, Any]  # the place of a job and its result
PATIENCE_S = 60.0  # how long a cluster without workers is waited for
AGAIN = "check scheduler and workers and run the command again"


@dataclass(frozen=True, slots=True)
class Workers:
    """Where jobs run: in so many processes of this machine, or on the Dask cluster of a scheduler.

    scheduler: `tcp://HOST:PORT`, or `tls://HOST:PORT` with certificates named in Dask's own configuration. All machines
    must see the study's folder under the same name.
    """

    count: int = 1
    scheduler: str = ""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        if self.count < 1:
            raise ValueError(f"workers must be 1 or more, got {self.count}")
        if self.scheduler and not fullmatch(r"(tcp|tls)://.+:\d+", self.scheduler):
            must = (
                "scheduler must be tcp://HOST:PORT or tls://HOST:PORT, as dask scheduler prints it"
            )
            raise ValueError(f"{must}; got {self.scheduler!r}")


def as_workers(workers: int | Workers, scheduler: str = "") -> Workers:
    """Take a number of processes, or the address of a cluster, for those who do the work."""
    return Workers(workers, scheduler) if isinstance(workers, int) else workers


def run_jobs(
    jobs: Iterable[Job], *, workers: int | Workers = 1, threads: int = 1
) -> Iterator[Numbered]:
    """Yield the place of each job and its result, as they are done; only a few jobs are taken ahead of time."""
    crew = as_workers(workers)
    if crew.scheduler:
        yield from _run_on_cluster(jobs, crew.scheduler)
    elif max(crew.count, threads) == 1:
        yield from starmap(_do, enumerate(jobs))
    else:
        from joblib import Parallel, delayed

        many: dict[str, Any] = {"n_jobs": threads, "backend": "threading"}
        if crew.count > 1:
            # After a kill joblib tidies up, and need not say so between our lines.
            os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")
            many = {"n_jobs": crew.count}
        calls = (delayed(_do)(place, job) for place, job in enumerate(jobs))
        yield from Parallel(**many, return_as="generator_unordered")(calls)


def gather_results(
    jobs: Iterable[Job],
    *,
    workers: int | Workers = 1,
    threads: int = 1,
    done: Callable[[], object] = lambda: None,
) -> list[Any]:
    """Do all jobs and return their results, in the order of the jobs; `done` is called after each."""
    found: dict[int, Any] = {}
    for place, result in run_jobs(jobs, workers=workers, threads=threads):
        found[place] = result
        done()
    return [found[place] for place in sorted(found)]


def _do(place: int, job: Job, versions: Mapping[str, str] = MappingProxyType({})) -> Numbered:
    """Do a job, unless versions are asked for that are not those of this machine."""
    own = _find_versions() if versions else {}
    if other := [f"{k} {own[k]} instead of {v}" for k, v in versions.items() if own[k] != v]:
        message = f"a worker has {', '.join(other)}; install the same versions there, or stop it"
        raise ValueError(message)
    function, arguments, named = job
    return place, function(*arguments, **named)


def _find_versions() -> dict[str, str]:
    """Find the versions that all machines must have, as they decide the bytes of results."""
    modules = ("feel321", "numpy", "scipy", "soxr")
    found = {name: str(__import__(name).__version__) for name in modules}
    return {**found, "Python": f"{sys.version_info.major}.{sys.version_info.minor}"}


def _run_on_cluster(jobs: Iterable[Job], address: str) -> Iterator[Numbered]:
    """Keep two jobs in flight per thread of a cluster."""
    if find_spec("distributed") is None:
        what = "a Dask cluster needs distributed, not installed here"
        raise ModuleNotFoundError(f"{what}; run pip install 'feel321[cluster]'")
    from distributed import CancelledError, Client, as_completed
    from distributed.scheduler import KilledWorker

    try:
        client = Client(address, set_as_default=False)  # type: ignore[no-untyped-call]  # distributed's types
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except (OSError, TypeError, ValueError) as error:
        raise OSError(f"{address}: no Dask cluster answers ({error}); {AGAIN}") from None
    versions = _find_versions()

    def submit() -> Iterator[Any]:
        for place, (function, arguments, named) in enumerate(jobs):
            # A worker is in a folder of its own.
            own = tuple(one.absolute() if isinstance(one, Path) else one for one in arguments)
            yield client.submit(_do, place, (function, own, named), versions, pure=False)

    left = submit()
    running: Any = as_completed(loop=client.loop, with_results=True)  # type: ignore[no-untyped-call]  # distributed's types
    try:
        while True:
            threads = sum(client.nthreads().values())  # type: ignore[no-untyped-call]  # distributed's types
            # One at least: while the cluster has no worker, what is left waits for the next one.
            wanted = max(2 * threads, 1) - running.count()
            running.update(list(islice(left, max(wanted, 0))))
            if running.is_empty():
                return
            _, result = next(running)
            yield result
    except (CancelledError, KilledWorker) as error:
        what = str(error) or "its scheduler is gone"
        raise OSError(f"{address}: the Dask cluster failed ({what}); {AGAIN}") from None
    finally:
        client.close()  # type: ignore[no-untyped-call]  # distributed's types
