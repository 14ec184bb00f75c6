from __future__ import annotations

import pytest

from protocols.trial import Item

NAMES = ("sax321", "soc321", "dft321", "dft321_windowed", "original", "low")
ROLES = {"original": "reference", "low": "anchor"}


@pytest.fixture
def items() -> list[Item]:
    """Three recordings of six stimuli each: four reducers, a reference, an anchor."""
    return [
        Item(f"{recording}-{name}", recording, "as_is", ROLES.get(name, "test"))
        for recording in ("bumps", "drag", "taps")
        for name in NAMES
    ]
