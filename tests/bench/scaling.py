"""What workers bring: build and tradeoff in one process, in two, and on a Dask cluster of two.

    python tests/bench/scaling.py [VERB ...]

Each command runs as a user starts it, on the bundled scenes. Ratios are to one process in the same run: elapsed time,
processor time of all processes together (what is added is start, transport and waiting), and the largest memory of any
one process. Elapsed times mean something on an idle machine only: the load is printed beside them.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

TICK_S = 0.05
FEEL321 = [str(Path(sys.executable).with_name("feel321"))]
VERBS = {
    "build": ["build", "study", "--no-page"],
    "tradeoff": ["tradeoff", "study", "--out", "out"],
}


class Cost(NamedTuple):
    """What a command took; memory is that of the largest process."""

    elapsed_s: float
    cpu_s: float
    memory_mib: float


def list_tree(roots: list[int]) -> list[int]:
    """List processes and all that they started."""
    parents: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        parents.setdefault(int(fields[1]), []).append(int(stat.parent.name))
    found = [*roots]
    for pid in found:
        found += parents.get(pid, [])
    return found


def look(pid: int) -> tuple[float, float]:
    """Processor seconds and peak memory in MiB of a process until now; zero if it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0, 0.0
    peak = next((line for line in status.splitlines() if line.startswith("VmHWM")), "x 0 kB")
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK"), int(peak.split()[1]) / 1024


def run(command: list[str], folder: Path, others: list[int]) -> Cost:
    """Run a command, and count what it, its children and others took meanwhile."""
    before = {pid: look(pid)[0] for pid in list_tree(others)}
    cpu, memory, begun = dict[int, float](), 0.0, time.perf_counter()
    process = subprocess.Popen([*FEEL321, *command], cwd=folder, stdout=subprocess.DEVNULL)
    while process.poll() is None:
        for pid in list_tree([process.pid, *others]):
            used, peak = look(pid)
            cpu[pid] = max(cpu.get(pid, 0.0), used)
            memory = max(memory, peak)
        time.sleep(TICK_S)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}")
    total = sum(used - before.get(pid, 0.0) for pid, used in cpu.items())
    return Cost(time.perf_counter() - begun, total, memory)


def start_cluster(folder: Path) -> tuple[str, list[subprocess.Popen[bytes]]]:
    """Start a scheduler and two workers of one thread each, on ports that the system chooses."""
    about = folder / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    quiet = ["--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
    options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    place = ["--host", "127.0.0.1", *quiet]
    scheduler = [*dask, "scheduler", "--port", "0", "--scheduler-file", str(about), *place]
    made = [subprocess.Popen(scheduler, **options)]
    while not (about.is_file() and about.stat().st_size):
        time.sleep(TICK_S)
    address: str = json.loads(about.read_text())["address"]
    worker = [*dask, "worker", address, "--no-nanny", "--nthreads", "1", *place]
    made += [
        subprocess.Popen([*worker, "--local-directory", str(folder / f"worker-{n}")], **options)
        for n in range(2)
    ]
    return address, made


def main(chosen: list[str]) -> None:
    """Measure, and print a table."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the cluster ends too
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        address, cluster = start_cluster(folder)
        pids = [process.pid for process in cluster]
        print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
        print("verb    workers   elapsed s  ratio   CPU s  ratio   peak MiB  ratio")
        try:
            for verb in chosen or [*VERBS]:
                measure(verb, folder, address=address, pids=pids)
        finally:
            for process in cluster:
                process.kill()
                process.wait()


def measure(verb: str, folder: Path, *, address: str, pids: list[int]) -> None:
    """Measure a verb in one process, in two, and on the cluster."""
    ways = {"1": [], "2": ["--workers", "2"], "dask 2": ["--scheduler", address]}
    first: Cost | None = None
    for way, options in ways.items():
        place = folder / f"{verb}-{way.replace(' ', '-')}"
        place.mkdir()
        subprocess.run([*FEEL321, "new", "study"], cwd=place, check=True, capture_output=True)
        cost = run([*VERBS[verb], *options], place, pids if "dask" in way else [])
        first = first or cost
        ratios = [now / then for now, then in zip(cost, first, strict=True)]
        cells = zip(cost, ratios, strict=True)
        row = "  ".join(f"{value:9.1f}  {ratio:5.2f}" for value, ratio in cells)
        print(f"{verb:7} {way:7} {row}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
