"""What the tests of every room share: the real recordings, and the rule for tests that take minutes."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("feel321", deadline=None)
settings.load_profile("feel321")
"""No deadlines: how long an example takes says how busy the machine is."""

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "recordings"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the tests marked `soak` out, unless `-m` speaks of them."""
    if "soak" in config.option.markexpr:
        return
    soaking = [item for item in items if item.get_closest_marker("soak")]
    if soaking:
        config.hook.pytest_deselected(items=soaking)
        items[:] = [item for item in items if item not in soaking]


@pytest.fixture(scope="session")
def shared_recordings() -> Path:
    """The folder of real recordings that lies beside the project."""
    if not RECORDINGS.is_dir():
        pytest.skip("NO REAL RECORDINGS: the folder shared/recordings beside the project is missing")
    return RECORDINGS
