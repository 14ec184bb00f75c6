"""Independent jobs: done in this process, in several, or on a cluster, always by this one way.

A job is a function and its arguments, all of which can be pickled; it writes its own files whole or not at all, and its
result does not depend on where or when it runs. So results are the same for any number of workers, and a job that was
lost with its process is simply done again.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextvars import copy_context
from dataclasses import dataclass
from itertools import islice
from typing import Any

__all__ = ["Workers"]

Job = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]
"""What is called, its positional and its named arguments."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Who does the jobs: `count` processes of this machine, each with up to as many threads as the jobs allow."""

    count: int = 1

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        if self.count < 1:
            raise ValueError(f"workers must be 1 or more, got {self.count}")


ALONE = Workers()
"""This process only."""


def as_workers(workers: int | Workers) -> Workers:
    """Take a number of processes for that many workers."""
    return Workers(workers) if isinstance(workers, int) else workers


def run_jobs(
    jobs: Iterable[Job], *, workers: Workers = ALONE, threads: int = 1
) -> Iterator[tuple[int, Any]]:
    """Yield the place of each job and its result, as they are done; only a few jobs are taken ahead of time."""
    if workers.count == 1:
        yield from _run_here(jobs, threads=threads)
        return
    from joblib import Parallel, delayed

    numbered = (delayed(_run_numbered)(place, job) for place, job in enumerate(jobs))
    yield from Parallel(n_jobs=workers.count, return_as="generator_unordered")(numbered)


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
