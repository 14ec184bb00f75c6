from __future__ import annotations

import pytest

from protocols.trial import Item

REDUCERS = ("sax321", "soc321", "dft321", "dft321_windowed")


@pytest.fixture
def items() -> list[Item]:
    """Three recordings of six stimuli each: four reducers, a reference, an anchor."""
    return [
        Item(f"{recording}-{name}", recording, "as_is", {"original": "reference", "low": "anchor"}.get(name, "test"))
        for recording in ("bumps", "drag", "taps")
        for name in (*REDUCERS, "original", "low")
    ]
