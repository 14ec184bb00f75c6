"""A day in the lab: twelve people at two stations, compressed in time, with everything that goes wrong in one.

    python tests/soak/lab_day.py --hours 8 --speed 60

Sessions are processes of their own (`seat.py`) on real files, with one PostgreSQL server for both stations; time passes
`--speed` times as fast. They are killed, terminated, lose their device, their server, their network and their disk; the
clock is set back, people come back late, one withdraws. Then everything that the engine ever acknowledged must be
there exactly once (`lab_checks.py`). The small disk of station one is a tmpfs in a mount namespace of this process,
which root may make; others are told that this event is left out.
"""

from __future__ import annotations

import argparse
import heapq
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import lab_checks
import numpy as np

HERE = Path(__file__).parent
FEEL321 = Path(sys.executable).with_name("feel321")
PEOPLE = 12
SMALL_DISK_MIB = 24
IDLE_LOOKS = 300
REMARKS = ("seal: ", "no checkpoints were kept")

STUDY = """
[study]
name = "{name}"
{recordings}
[stimuli]
reducers = ["sax321", "mag321", "pca321", "dft321"]
[session]
protocols = ["realism", "similarity"]
repeats = {repeats}
[session.stale]
after_h = 2.0
policy = "warm_up"
[[session.questions]]
use = "demographics"
"""
SCENES = ("bumps", "texture_drag", "hard_taps", "isotropic_rumble")


def read_process(pid: int) -> tuple[float, int]:
    """Resident memory of a process in MiB, and how many files it has open."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    n_files = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    return pages * os.sysconf("SC_PAGESIZE") / 2**20, n_files


def load_postgres() -> Any:
    """The server that the stations' tests start."""
    path = HERE.parent / "study" / "stations" / "conftest.py"
    spec = importlib.util.spec_from_file_location("stations", path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["stations"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass
class Station:
    """A station: its folder, how it reaches the server, who waits, and who sits there."""

    name: str
    folder: Path
    url: str
    people: list[str] = field(default_factory=list)
    queue: list[str] = field(default_factory=list)
    seat: subprocess.Popen[str] | None = None
    person: str = ""
    retry_h: float = 0.0


@dataclass
class Day:
    """The day: its clock, its stations, what is to happen, and what did."""

    root: Path
    hours: float
    speed: float
    server: Any
    password: str
    stations: list[Station]
    has_small_disk: bool
    began_s: float = 0.0
    agenda: list[tuple[float, int, Callable[[], None]]] = field(default_factory=list)
    order: Iterator[int] = field(default_factory=count)
    errands: list[tuple[str, float, subprocess.Popen[str]]] = field(default_factory=list)
    events: Counter[str] = field(default_factory=Counter)
    ends: Counter[str] = field(default_factory=Counter)
    said: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    samples: dict[str, list[tuple[float, float, int]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    watched: dict[str, subprocess.Popen[str]] = field(default_factory=dict)
    finished: set[str] = field(default_factory=set)
    address: str = ""
    spared: frozenset[str] = frozenset({"p05", "p06"})

    @property
    def control(self) -> Path:
        return self.root / "control"

    @property
    def hour(self) -> float:
        return (time.time() - self.began_s) * self.speed / 3600

    def at(self, hour: float, act: Callable[[], None]) -> None:
        heapq.heappush(self.agenda, (hour, next(self.order), act))

    def environment(self, station: Station | None = None) -> dict[str, str]:
        own = station or Station("office", self.root / "office", self.server.url)
        return os.environ | {
            "FEEL321_STATION": own.name,
            "FEEL321_LEDGER": own.url,
            "PGPASSWORD": self.password,
            "TMPDIR": str(self.root / "tmp"),
            "OPENBLAS_NUM_THREADS": "1",
        }

    def call(self, station: Station | None, *words: str | Path) -> subprocess.CompletedProcess[str]:
        """Run a verb to its end."""
        command = [str(FEEL321), *map(str, words)]
        environment = self.environment(station)
        return subprocess.run(command, env=environment, text=True, capture_output=True, check=False)

    def start(self, station: Station | None, *command: object) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*map(str, command)],
            env=self.environment(station),
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )

    # Sessions.

    def tend(self, station: Station) -> None:
        """Look after a seat: take note of how a session ended, and begin or resume the next."""
        if station.seat is not None and station.seat.poll() is not None:
            self.take_end(station)
        if station.seat is None and station.queue and self.hour >= station.retry_h:
            station.person = station.queue[0]
            station.seat = self.start(
                station, sys.executable, HERE / "seat.py", station.folder,
                station.person, int(station.person[1:]), self.control,
            )  # fmt: skip

    def take_end(self, station: Station) -> None:
        seat, station.seat = station.seat, None
        assert seat is not None
        printed, complained = seat.communicate()
        code = seat.returncode
        self.ends[f"exit {code}"] += 1
        outcome = json.loads(printed) if code == 0 else {}
        complained += outcome.get("notice", "")
        if code == 0 and not outcome["stopped"]:
            self.finished.add(station.queue.pop(0))
        elif code == 0:  # tired: back in three hours, after whoever is next
            person = station.queue.pop(0)
            (self.control / f"tired-{person}").unlink()
            self.at(self.hour + 3 * self.hours / 8, lambda: station.queue.append(person))
        else:
            station.retry_h = self.hour + (0.08 if code == 1 else 0.03)
        if complained.strip():
            self.said.append(f"{self.hour:5.2f} h {station.name} {station.person}: {complained}")

    def is_seated(self, station: Station) -> bool:
        """Whether a session is under way there, beyond its start."""
        seat = station.seat
        return seat is not None and (self.control / f"seated-{seat.pid}").exists()

    def meet(self, hour: float, station: Station, act: Callable[[], None]) -> None:
        """Let something happen to a session: at that hour, or as soon as one is under way."""

        def wait() -> None:
            if self.is_seated(station):
                act()
            else:
                self.at(self.hour + 0.01, wait)

        self.at(hour, wait)

    def signal(self, station: Station, number: signal.Signals) -> None:
        """Signal the session that runs, unless its person is spared; then later."""
        if station.person in self.spared:
            self.meet(self.hour + 0.07, station, lambda: self.signal(station, number))
            return
        assert station.seat is not None
        (self.control / f"seated-{station.seat.pid}").unlink()
        station.seat.send_signal(number)
        self.events[f"{number.name} to a session"] += 1

    # What goes wrong.

    def lose_device(self, station: Station, duration_h: float) -> None:
        self.events["device lost and back"] += 1
        path = self.control / f"lost-{station.name}"
        path.touch()
        self.at(self.hour + duration_h, path.unlink)

    def tire(self, station: Station) -> None:
        self.events["person leaves, back hours later"] += 1
        (self.control / f"tired-{station.queue[0]}").touch()

    def step_clock(self, station: Station, seconds: float) -> None:
        self.events["clock set"] += 1
        (self.control / f"clock-{station.name}").write_text(str(seconds))

    def pull_cable(self, duration_h: float) -> None:
        self.events["station offline"] += 1
        cable = self.watched.pop("cable")
        cable.kill()
        cable.communicate()
        self.at(self.hour + duration_h, self.plug_cable)

    def plug_cable(self) -> None:
        near = Path(self.root / "wire" / ".s.PGSQL.5432")
        near.unlink(missing_ok=True)
        far = self.server.folder / near.name
        self.watched["cable"] = self.start(None, sys.executable, HERE / "cable.py", near, far)

    def kill_server(self, duration_h: float) -> None:
        self.events["server killed"] += 1
        self.server.kill()
        self.at(self.hour + duration_h, self.server.start)

    def fill_disk(self, duration_h: float) -> None:
        if not self.has_small_disk:
            print("LEFT OUT: only root may make a small disk to be filled")
            return
        self.events["disk full"] += 1
        ballast = self.stations[0].folder / "ballast"
        with suppress(OSError), ballast.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))
        self.at(self.hour + duration_h, ballast.unlink)

    def withdraw(self, person: str) -> None:
        if person not in self.finished:
            self.at(self.hour + 0.05, lambda: self.withdraw(person))
            return
        station = next(one for one in self.stations if (one.folder / "sessions" / person).exists())
        self.send("withdraw", station, "--participant", person, "--yes")

    def audit(self) -> None:
        """Status and audit of both stations while sessions run there."""
        for station in self.stations:
            self.send("status", station)
            self.send("audit", station)

    def send(self, verb: str, station: Station, *words: str) -> None:
        """Run a verb beside the sessions."""
        self.events[f"{verb} beside sessions"] += 1
        process = self.start(station, FEEL321, verb, station.folder, *words)
        self.errands.append((f"{verb} {station.name}", self.hour, process))

    def greet(self) -> None:
        """Hear what the verbs said: without their server they may say so, and nothing else."""
        for errand in [one for one in self.errands if one[2].poll() is not None]:
            self.errands.remove(errand)
            name, hour, process = errand
            words = "".join(process.communicate())
            if not process.returncode and "raceback" not in words:
                continue
            lines = [one for one in words.splitlines() if not one.startswith(REMARKS)]
            if all("out of reach" in one for one in lines):
                self.events["verb told that the server is out of reach"] += 1
                if "withdraw" in name:  # whoever reads that line calls it again
                    self.at(self.hour + 0.1, partial(self.withdraw, "p01"))
            else:
                self.faults.append(f"{hour:.2f} h {name}: {words}")

    # Watching.

    def sample(self) -> None:
        watched = {name: one.pid for name, one in self.watched.items()}
        watched |= {
            f"session {one.person}": one.seat.pid
            for one in self.stations
            if one.seat and self.is_seated(one)
        }
        with suppress(OSError):
            watched["server"] = self.server.pid
        for name, pid in watched.items():
            with suppress(OSError, TypeError):
                own = name if "session" not in name else f"{name} ({pid})"
                self.samples[own].append((self.hour, *read_process(pid)))

    def look(self, address: str) -> None:
        """Look at the live page, as the experimenter's browser does."""
        try:
            with urllib.request.urlopen(address.replace("/?", "/state.json?"), timeout=60) as page:  # noqa: S310 - our own server
                json.loads(page.read())
            self.events["looks at the live page"] += 1
        except (OSError, ValueError) as error:
            self.faults.append(f"{self.hour:.2f} h monitor: {error}")

    def rest(self, monitor: subprocess.Popen[str]) -> None:
        """Look at the live page while nothing happens: what then grows would grow for ever."""
        for _ in range(IDLE_LOOKS):
            self.look(self.address)
            rss_mib, n_files = read_process(monitor.pid)
            self.samples["monitor, nobody there"].append((self.hour, rss_mib, n_files))
        monitor.send_signal(signal.SIGINT)
        monitor.communicate()

    # The whole.

    def plan(self, rng: np.random.Generator) -> None:
        """Plan what happens, in shares of the day."""
        one, two = self.stations
        for station in self.stations:
            for number, hour in enumerate(np.sort(rng.uniform(0.02, 0.8, 14))):
                kind = signal.SIGTERM if number % 7 == 6 else signal.SIGKILL
                act = partial(self.signal, station, kind)
                self.meet(hour * self.hours, station, act)
        share = self.hours / 8
        for station in self.stations:
            for number, person in enumerate(station.people):
                self.at(number * 1.25 * share, partial(station.queue.append, person))
        for hour, station, act in (
            (0.4, one, lambda: self.lose_device(one, 0.2 * share)),
            (0.5, two, lambda: self.tire(two)),
            (1.1, two, lambda: self.lose_device(two, 0.25 * share)),
            (2.0, two, lambda: self.pull_cable(0.6 * share)),
            (2.2, one, lambda: self.tire(one)),
            (3.0, one, lambda: self.fill_disk(0.25 * share)),
            (3.5, two, lambda: self.kill_server(0.15 * share)),
            (4.3, one, lambda: self.lose_device(one, 0.2 * share)),
            (5.0, two, lambda: self.step_clock(two, -1800)),
            (5.6, two, lambda: self.lose_device(two, 0.2 * share)),
            (6.0, two, lambda: self.step_clock(two, 0)),
        ):
            self.meet(hour * share, station, act)
        for hour in (1.5, 3.2, 5.2, 7.0):
            self.at(hour * share, self.audit)
        self.at(4.0 * share, lambda: self.withdraw("p01"))

    def run(self, rng: np.random.Generator) -> None:
        """Let the day pass, until everybody is done."""
        self.plug_cable()
        self.began_s = time.time()
        began = datetime.now(UTC) - timedelta(hours=self.hours * 1.2)
        about = {"began_s": self.began_s, "began": began.isoformat(), "speed": self.speed}
        (self.control / "day.json").write_text(json.dumps(about))
        monitor = self.start(None, FEEL321, "monitor", *(one.folder for one in self.stations))
        self.watched["monitor"] = monitor
        assert monitor.stdout is not None
        self.address = monitor.stdout.readline().strip()
        self.plan(rng)
        next_s = 0.0
        while len(self.finished) < PEOPLE and self.hour < 2.5 * self.hours:
            while self.agenda and self.agenda[0][0] <= self.hour:
                heapq.heappop(self.agenda)[2]()
            for station in self.stations:
                self.tend(station)
            self.greet()
            if time.time() >= next_s:
                next_s = time.time() + 2.0
                self.sample()
                self.look(self.address)
            time.sleep(0.02)
        self.end()

    def end(self) -> None:
        for station in self.stations:
            if station.seat:
                station.seat.kill()
                station.seat.communicate()
        self.rest(self.watched.pop("monitor"))
        for *_, act in sorted(self.agenda):  # what is still broken is mended
            if act.__name__ in {"plug_cable", "start", "unlink"}:
                act()
        while self.errands:
            self.errands[0][2].wait()
            self.greet()
        if missing := {f"p{n:02d}" for n in range(1, PEOPLE + 1)} - self.finished:
            self.faults.append(f"did not finish: {sorted(missing)}")


def make_stations(root: Path, url: str, *, repeats: int, small: bool) -> list[Station]:
    """Build the study once, then copy it to two stations and the office."""
    built = root / "built"
    subprocess.run([FEEL321, "new", built], check=True, capture_output=True)
    scenes = "".join(f'[[recordings]]\nscene = "{one}"\nduration_s = 0.5\n' for one in SCENES)
    name = f"day-{root.name}"
    (built / "study.toml").write_text(STUDY.format(name=name, recordings=scenes, repeats=repeats))
    subprocess.run([FEEL321, "build", built], check=True, capture_output=True)
    stations = []
    for number, station in enumerate(("one", "two"), 1):
        folder = root / station
        folder.mkdir()
        if small and number == 1:
            options = ["-o", f"size={SMALL_DISK_MIB}m,mode=700"]
            subprocess.run(["mount", "-t", "tmpfs", *options, "labday", folder], check=True)
        shutil.copytree(built, folder, dirs_exist_ok=True)
        people = [f"p{one:02d}" for one in range(number, PEOPLE + 1, 2)]
        stations.append(Station(station, folder, url if number == 1 else "", people))
    stations[1].url = url.rpartition("=")[0] + f"={root / 'wire'}"
    shutil.copytree(built, root / "office")
    return stations


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--speed", type=float, default=60.0, help="lab time over real time")
    parser.add_argument("--seed", type=int, default=19)
    parser.add_argument(
        "--repeats", type=int, default=12, help="of each trial: sets the sessions' length"
    )
    parser.add_argument("--keep", action="store_true", help="keep the folder")
    given = parser.parse_args()
    small = os.geteuid() == 0
    if small and "LAB_DAY" not in os.environ:
        # In a mount namespace of its own: the small disk goes with the process, whatever happens.
        os.execvpe(
            "unshare", ["unshare", "-m", sys.executable, *sys.argv], os.environ | {"LAB_DAY": "1"}
        )
    root = Path(tempfile.mkdtemp(prefix="labday-"))
    stations_tests = load_postgres()
    (root / "pg").mkdir()
    root.chmod(0o711)
    server = stations_tests.Postgres(root / "pg")
    for name in ("control", "wire", "tmp"):
        (root / name).mkdir()
    server.create()
    day = None
    try:
        stations = make_stations(root, server.url, repeats=given.repeats, small=small)
        day = Day(root, given.hours, given.speed, server, stations_tests.PASSWORD, stations, small)
        day.run(np.random.default_rng(given.seed))
        good = lab_checks.check(day)
    finally:
        for process in day.watched.values() if day else ():
            process.kill()
        server.stop()
        if not given.keep:
            shutil.rmtree(root, ignore_errors=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
