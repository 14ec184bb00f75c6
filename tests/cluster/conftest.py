"""A real Dask cluster on the loopback: a scheduler process and worker processes, on ports that the system chooses."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

LONGEST_S = 90.0


class Cluster:
    """Processes of a cluster; each worker has one thread, and no nanny that would start it again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.workers: list[subprocess.Popen[bytes]] = []
        about = folder / "scheduler.json"
        self.scheduler = self._start(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(about)
        )
        wait_until(lambda: about.is_file() and about.stat().st_size > 0)
        self.address = json.loads(about.read_text())["address"]

    def start_worker(self, *options: str) -> subprocess.Popen[bytes]:
        """Start a worker, and wait until the scheduler knows it."""
        scratch = self.folder / f"worker-{len(self.workers)}"
        known = self._count_workers()
        worker = self._start(
            "worker", self.address, "--no-nanny", "--nthreads", "1", "--host", "127.0.0.1",
            "--memory-limit", "0", "--local-directory", str(scratch), *options,
        )  # fmt: skip
        self.workers.append(worker)
        wait_until(lambda: self._count_workers() > known)
        return worker

    def _count_workers(self) -> int:
        log = (self.folder / "scheduler.log").read_text()
        return log.count("Register worker")

    def _start(self, *command: str) -> subprocess.Popen[bytes]:
        environment = {
            **os.environ, "DASK_TEMPORARY_DIRECTORY": str(self.folder), "OPENBLAS_NUM_THREADS": "1",
        }  # fmt: skip
        words = [sys.executable, "-m", "dask", *command, "--no-dashboard"]
        words += ["--dashboard-address", "127.0.0.1:0"]
        with (self.folder / f"{command[0]}.log").open("ab") as log:
            return subprocess.Popen(
                words,
                stdout=log,
                stderr=log,
                env=environment,
                cwd=self.folder,
                start_new_session=True,
            )

    def stop(self) -> None:
        """Kill all processes."""
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def wait_until(is_so: Callable[[], bool]) -> None:
    """Wait for something that comes in its own time."""
    until = time.monotonic() + LONGEST_S
    while not is_so():
        assert time.monotonic() < until, "did not happen"
        time.sleep(0.05)


@pytest.fixture
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    pytest.importorskip("distributed")
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        yield made
    finally:
        made.stop()
