"""What the tests of every room share: the real recordings, and the rule for tests that take minutes."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from filelock import FileLock
from hypothesis import settings

from feel321.protocols.tasks import PROTOCOLS

settings.register_profile("feel321", deadline=None, max_examples=25)
settings.register_profile("soak", deadline=None)
settings.load_profile("feel321")
"""No deadlines: how long an example takes says how busy the machine is. `make soak` tries 100 examples of each law."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts what runs in its background deaf to Ctrl-C; sessions that tests start would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)

collect_ignore = ["bench"]
"""Scripts beside each other, which `make bench` and people run; they hold no tests."""


RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "recordings"


DEVICES = {"seat", "screen", "sound", "pulse", "pulses"}
"""Fixtures that start a participant's screen or a sound server."""


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark what runs in real time; that runs on one worker, and so does what shares a fixture of its module."""
    fixtures = item._fixtureinfo.name2fixturedefs if isinstance(item, pytest.Function) else {}
    if DEVICES & set(getattr(item, "fixturenames", ())):
        item.add_marker("realtime")
        item.add_marker(pytest.mark.xdist_group("realtime"))
    elif any(found[-1].scope == "module" for found in fixtures.values()):
        item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the tests marked `soak` out, unless `-m` speaks of them."""
    if "soak" in config.option.markexpr:
        return
    soaking = [item for item in items if item.get_closest_marker("soak")]
    if soaking:
        config.hook.pytest_deselected(items=soaking)
        items[:] = [item for item in items if item not in soaking]


@pytest.fixture(scope="session")
def make_once(
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[[str, Callable[[Path], object]], Path]:
    """Makes a folder that all workers of a run read; the first that needs it fills it."""
    root = tmp_path_factory.getbasetemp()
    root = root.parent if "PYTEST_XDIST_WORKER" in os.environ else root

    def make(name: str, fill: Callable[[Path], object]) -> Path:
        folder = root / f"shared-{name}"
        with FileLock(folder.with_suffix(".lock")):
            if not (done := folder.with_suffix(".done")).exists():
                folder.mkdir()
                fill(folder)
                done.touch()
        return folder

    return make


@pytest.fixture(scope="session")
def shared_recordings() -> Path:
    """The folder of real recordings that lies beside the project."""
    if not RECORDINGS.is_dir():
        pytest.skip(
            "NO REAL RECORDINGS: the folder shared/recordings beside the project is missing"
        )
    return RECORDINGS


@pytest.fixture(autouse=True)
def _feel321s_protocols_only() -> Iterator[None]:
    """Take out protocols of a lab's own after each test."""
    ours = dict(PROTOCOLS)
    yield
    PROTOCOLS.clear()
    PROTOCOLS.update(ours)
