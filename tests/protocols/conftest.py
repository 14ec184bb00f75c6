from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.protocols.trial import Item

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

NAMES = ("sax321", "soc321", "dft321", "dft321_windowed", "original", "low")
ROLES = {"original": "reference", "low": "anchor", "mid": "anchor"}


def name_items(
    recording: str, names: Iterable[str], levels: Iterable[str] = ("as_is",)
) -> list[Item]:
    return [
        Item(f"{recording}-{name}-{level}", recording, name, level, ROLES.get(name, "test"))
        for level in levels
        for name in names
    ]


@pytest.fixture
def items() -> list[Item]:
    """Three recordings of six stimuli each: four reducers, a reference, an anchor."""
    return [
        item for recording in ("bumps", "drag", "taps") for item in name_items(recording, NAMES)
    ]


@pytest.fixture(scope="session")
def make_items() -> Callable[..., list[Item]]:
    """Stimuli of one recording, named `recording-name-level`: `original`, anchors `low` and `mid`, else reducers."""
    return name_items
