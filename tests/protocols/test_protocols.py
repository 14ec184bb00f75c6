from __future__ import annotations

import pytest

from protocols.realism import REALISM
from protocols.registry import PROTOCOLS
from protocols.similarity import SIMILARITY
from protocols.texts import list_languages, read_scales
from protocols.trial import Item


def test_registry_lists_every_protocol_under_its_own_name() -> None:
    assert list(PROTOCOLS) == ["realism", "similarity"]
    assert all(name == protocol.name for name, protocol in PROTOCOLS.items())
    with pytest.raises(TypeError, match="does not support item assignment"):
        PROTOCOLS["realism"] = SIMILARITY  # type: ignore[index] - that it is refused is the point


def test_realism_judges_every_item_without_reference(items: list[Item]) -> None:
    pairs = REALISM.compare(items)
    assert [pair.stimulus_id for pair in pairs] == [item.stimulus_id for item in items]
    assert {pair.reference_id for pair in pairs} == {None}


def test_similarity_judges_every_item_against_the_reference_and_the_reference_against_itself(items: list[Item]) -> None:
    bumps = [item for item in items if item.recording == "bumps"]
    pairs = SIMILARITY.compare(bumps)
    assert [pair.stimulus_id for pair in pairs] == [item.stimulus_id for item in bumps]
    assert {pair.reference_id for pair in pairs} == {"bumps-original"}


def test_similarity_takes_the_reference_of_the_items_own_level() -> None:
    levels = ("as_is", "equal_intensity")
    own = [Item(f"{role}-{level}", "tap", level, role) for level in levels for role in ("test", "reference")]
    assert {pair.stimulus_id: pair.reference_id for pair in SIMILARITY.compare(own)} == {
        f"{role}-{level}": f"reference-{level}" for level in levels for role in ("test", "reference")
    }


def test_similarity_falls_back_on_the_only_reference() -> None:
    shared = [Item("test", "tap", "equal_intensity", "test"), Item("original", "tap", "as_is", "reference")]
    assert SIMILARITY.compare(shared)[0].reference_id == "original"


def test_similarity_without_a_reference_is_refused(items: list[Item]) -> None:
    alone = [item for item in items if item.role != "reference"]
    with pytest.raises(ValueError, match="level 'as_is': got 0 reference stimuli, similarity needs exactly one"):
        SIMILARITY.compare(alone)


@pytest.mark.parametrize("language", list_languages())
def test_every_language_has_every_scale(language: str) -> None:
    scales = read_scales(language)
    assert {protocol.scale for protocol in PROTOCOLS.values()} <= set(scales)
    assert all(scale.question and scale.low_label != scale.high_label for scale in scales.values())


def test_unknown_language_is_refused_with_the_list() -> None:
    with pytest.raises(ValueError, match="language: got 'xx', allowed: en"):
        read_scales("xx")
