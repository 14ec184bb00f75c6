"""A real PostgreSQL server on a socket of its own, and study folders as stations have them."""

from __future__ import annotations

import hashlib
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.folder import StudyFolder, create_study
from feel321.study.workflow import build_study

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PROGRAMS = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
PASSWORD = "s3same-0pen"  # noqa: S105 - of a server that lives as long as the test

TWO_TRIALS = """
[[recordings]]
scene = "bumps"
duration_s = 0.1
[stimuli]
reducers = ["sax321", "mag321"]
reference = "none"
anchors = false
[session]
protocols = ["realism"]
repeats = 2
[session.rehearsal]
training = 0
practice = 0
[tasks.realism]
explore = "gain"
"""


@dataclass
class Postgres:
    """A server: its folder, and the account that it runs under, for it refuses root."""

    folder: Path

    @property
    def url(self) -> str:
        return f"postgresql+psycopg://lab@/postgres?host={self.folder}"

    @property
    def pid(self) -> int:
        return int((self.folder / "data" / "postmaster.pid").read_text().split()[0])

    def run(self, program: str, *arguments: object) -> None:
        rights: dict[str, Any] = {}
        if os.getuid() == 0:
            entry = pwd.getpwnam(find_user())
            rights = {"user": entry.pw_uid, "group": entry.pw_gid, "extra_groups": []}
        command = [PROGRAMS[-1].with_name(program), *map(str, arguments)]
        with (self.folder / "programs.log").open("ab") as log:
            subprocess.run(
                command,
                check=True,
                stdout=log,
                stderr=log,
                cwd=self.folder,
                env={"LC_ALL": "C"},
                **rights,
            )

    def create(self) -> None:
        (self.folder / "password").write_text(PASSWORD)
        if os.getuid() == 0:
            for path in (self.folder, self.folder / "password"):
                shutil.chown(path, find_user())
        self.run(
            "initdb", "-D", self.folder / "data", "-U", "lab", "-A", "scram-sha-256",
            "--pwfile", self.folder / "password", "--no-sync", "-E", "UTF8",
        )  # fmt: skip
        (self.folder / "password").unlink()
        self.start()

    def start(self) -> None:
        options = f"-k {self.folder} -c listen_addresses='' -c fsync=off -c shared_buffers=16MB"
        log = self.folder / "server.log"
        start = ("-w", "-t", 600, "-l", log, "-o", options, "start")
        self.run("pg_ctl", "-D", self.folder / "data", *start)

    def find_processes(self) -> list[int]:
        """The server and what it forked."""
        found = [self.pid]
        for entry in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):
                if entry.read_text().rpartition(")")[2].split()[1] == str(found[0]):
                    found.append(int(entry.parent.name))
        return found

    def signal(self, number: int) -> None:
        for pid in self.find_processes():
            with suppress(ProcessLookupError):
                os.kill(pid, number)

    def freeze(self) -> None:
        self.signal(signal.SIGSTOP)

    def thaw(self) -> None:
        self.signal(signal.SIGCONT)

    def kill(self) -> None:
        """Kill all of it, and wait until it is gone: a new server is refused while one process of the old is left."""
        found = self.find_processes()
        self.signal(signal.SIGKILL)
        while any(map(is_alive, found)):
            time.sleep(0.01)
        # A process may stay in the table after its end, and its number be taken for a server that runs.
        for path in (self.folder / "data" / "postmaster.pid", *self.folder.glob(".s.PGSQL*")):
            path.unlink(missing_ok=True)

    def stop(self) -> None:
        self.thaw()
        with suppress(subprocess.CalledProcessError):
            self.run("pg_ctl", "-D", self.folder / "data", "-m", "immediate", "-w", "stop")


def is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in {"Z", "X"}


def find_user() -> str:
    known = {entry.pw_name for entry in pwd.getpwall()}
    return next(name for name in ("postgres", "nobody") if name in known)


@pytest.fixture(scope="module")
def server() -> Iterator[Postgres]:
    """One server for a module's tests; each uses a database schema of its own."""
    if not PROGRAMS:
        pytest.skip(
            "NO POSTGRESQL: install Debian's package postgresql, of which initdb is missing"
        )
    # Its socket's name may be 107 letters long, so it is not in pytest's folder.
    with tempfile.TemporaryDirectory(prefix="pg") as folder:
        postgres = Postgres(Path(folder))
        postgres.create()
        try:
            yield postgres
        finally:
            postgres.stop()


@pytest.fixture
def login(server: Postgres, monkeypatch: pytest.MonkeyPatch) -> Postgres:
    monkeypatch.setenv("PGPASSWORD", PASSWORD)
    monkeypatch.setenv("FEEL321_STATION", "one")
    monkeypatch.delenv("FEEL321_LEDGER", raising=False)
    if not (server.folder / "data" / "postmaster.pid").exists():  # A test killed it.
        server.start()
    return server


@pytest.fixture(scope="session")
def built(make_once: Callable[..., Path]) -> Path:
    """A study of four trials, built."""

    def fill(folder: Path) -> None:
        study = create_study(folder / "study")
        study.settings.write_text(TWO_TRIALS, encoding="utf-8")
        build_study(study)

    return make_once("stations", fill) / "study"


@pytest.fixture
def make_station(
    built: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> Callable[..., StudyFolder]:
    """Make the study folder of a station: a copy, with the ledger on a server or not."""
    name = hashlib.sha256(request.node.name.encode()).hexdigest()

    def make(station: str, url: str = "", more: str = "") -> StudyFolder:
        folder = tmp_path / station
        shutil.copytree(built, folder)
        text = f'[study]\nname = "{name}"\n{TWO_TRIALS}'
        ledger = f'[ledger]\nurl = "{url}"\n' if url else ""
        (folder / "study.toml").write_text(text + ledger + more, encoding="utf-8")
        return StudyFolder(folder)

    return make
