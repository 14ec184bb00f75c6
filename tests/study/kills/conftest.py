"""Processes that die, or run where little is allowed, and the count of what that cost."""

import io
import os
import signal
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest

# Windows has neither forks nor SIGKILL.
collect_ignore_glob = ["sessions/*"] if os.name == "nt" else []

TRACES = frozenset({
    "open",
    "write",
    "fsync",
    "ftruncate",
    "truncate",
    "replace",
    "unlink",
    "mkdir",
    "rmdir",
})
"""Calls into the system that may leave a trace on the disk."""


def leaves_trace(event: str, function: Any) -> bool:
    """Tell whether a profiled event is such a call; strings and files in memory have methods of these names too."""
    if event != "c_call" or function.__name__ not in TRACES:
        return False
    return not isinstance(function.__self__, str | io.StringIO)


def die() -> NoReturn:
    os.kill(os.getpid(), signal.SIGKILL)
    raise SystemExit("outlived SIGKILL")


@dataclass(frozen=True)
class Kill:
    """When a process dies: before its k-th call that leaves a trace, or inside its k-th record.

    `j` is the share of that record that is written, at least a byte and never all of it.
    """

    k: int
    j: float | None = None

    def arm(self) -> None:
        if self.j is None:
            calls = 0

            def count(_frame: object, event: str, function: Any) -> None:
                nonlocal calls
                if leaves_trace(event, function):
                    calls += 1
                    if calls == self.k:
                        die()

            sys.setprofile(count)
        else:
            write, writes, share = os.write, 0, self.j

            def tear(descriptor: int, line: bytes) -> int:
                nonlocal writes
                writes += 1
                if writes < self.k:
                    return write(descriptor, line)
                write(descriptor, line[: min(max(1, round(share * len(line))), len(line) - 1)])
                die()

            os.write = tear


def count_traces(run: Callable[[], None]) -> tuple[int, int]:
    """Count the calls that leave a trace, and the records among them."""
    calls: Counter[str] = Counter()

    def count(_frame: object, event: str, function: Any) -> None:
        if leaves_trace(event, function):
            calls["all"] += 1
            calls["records"] += function is os.write

    sys.setprofile(count)
    try:
        run()
    finally:
        sys.setprofile(None)
    return calls["all"], calls["records"]


def split(run: Callable[[], object], *, kill: Kill | None = None) -> int:
    """Start a process that runs beside this one; what it returns is its code."""
    with warnings.catch_warnings():
        # Later Pythons warn that threads do not come along; those of the linear algebra are not missed.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child:
        return child
    code = 1
    try:  # The fork may not come back into pytest, whatever happens.
        if kill is not None:
            kill.arm()
        code = int(run() or 0)
    except BaseException:  # noqa: BLE001 - told to whoever reads the test's output
        sys.setprofile(None)
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def fork(
    run: Callable[[], object], *, kill: Kill | None = None, until: Callable[[], bool] | None = None
) -> int:
    """Run in a process of its own and tell how it ended; with `until`, it is killed from outside as soon as that is."""
    child = split(run, kill=kill)
    if until is not None:
        while (
            not until() and os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None
        ):
            pass
        os.kill(child, signal.SIGKILL)
    return wait(child)


def wait(child: int) -> int:
    """Wait for a process to end and tell how."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@dataclass(frozen=True)
class Said:
    """What a command said before it ended, and how."""

    code: int
    out: str
    err: str


def speak(*commands: Callable[[], object], path: Path) -> Said:
    """Run commands one after the other in one process of their own and tell what they said; the last code counts."""
    child, said = whisper(*commands, path=path)
    code = wait(child)
    return Said(code, *(file.read_text(encoding="utf-8") for file in said))


def whisper(*commands: Callable[[], object], path: Path) -> tuple[int, tuple[Path, Path]]:
    """Start commands beside this process, their words into files."""
    files = path.with_suffix(".out"), path.with_suffix(".err")

    def run() -> int:
        for number, file in enumerate(files, start=1):
            os.dup2(os.open(file, os.O_CREAT | os.O_TRUNC | os.O_WRONLY), number)
        sys.stdout, sys.stderr = (
            os.fdopen(number, "w", encoding="utf-8", closefd=False) for number in (1, 2)
        )
        codes = [command() for command in commands]
        sys.stdout.flush()
        return codes[-1]

    return split(run), files


@dataclass
class Toll:
    """What sudden deaths cost, counted over all tests, by protocol and presenter."""

    kills: Counter[tuple[str, str]] = field(default_factory=Counter)
    lost: Counter[tuple[str, str]] = field(default_factory=Counter)
    doubled: Counter[tuple[str, str]] = field(default_factory=Counter)


TOLL = pytest.StashKey[Toll]()


@pytest.fixture(scope="session")
def processes(pytestconfig: pytest.Config) -> SimpleNamespace:
    """What there is to start processes and to end them."""
    toll = pytestconfig.stash[TOLL] = Toll()
    return SimpleNamespace(
        Kill=Kill,
        fork=fork,
        speak=speak,
        whisper=whisper,
        wait=wait,
        count_traces=count_traces,
        toll=toll,
    )


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Say what was endured, and what it cost."""
    toll = config.stash.get(TOLL, Toll())
    if not toll.kills:
        return
    terminalreporter.section("sudden deaths")
    for key in sorted(toll.kills):
        name = f"{key[0]}, {key[1]}"
        terminalreporter.line(
            f"{name:32}{toll.kills[key]:6} kills, {toll.lost[key]} lost, {toll.doubled[key]} doubled"
        )
    totals = (sum(counts.values()) for counts in (toll.kills, toll.lost, toll.doubled))
    terminalreporter.line("{:32}{:6} kills, {} lost, {} doubled".format("all", *totals))
