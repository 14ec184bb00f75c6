from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.people import REMOVED, Tombstone, find_leftovers, read_tombstone, write_tombstone
from feel321.study.session.journal import Anchor

if TYPE_CHECKING:
    from pathlib import Path

TOMBSTONE = Tombstone(
    "p01", 1, False, "2026-01-01T12:00:00+00:00", "zog weg, müde", (Anchor("a", 1, "0"),), REMOVED
)


def test_what_was_written_is_read(tmp_path: Path) -> None:
    assert read_tombstone(tmp_path) is None
    write_tombstone(tmp_path, TOMBSTONE)
    assert read_tombstone(tmp_path) == TOMBSTONE


FORGED = ({"number": 2}, {"journals": []}, {"sha256": "0"}, {"more": 1}, "", "[" * 99999, "{}")


@pytest.mark.parametrize("change", FORGED)
def test_an_edit_is_one_line(tmp_path: Path, change: dict[str, Any] | str) -> None:
    write_tombstone(tmp_path, TOMBSTONE)
    path = tmp_path / "withdrawn.json"
    is_text = isinstance(change, str)
    path.write_text(change if is_text else json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(
        ValueError, match=r"withdrawn\.json: changed after it was written"
    ) as caught:
        read_tombstone(tmp_path)
    assert "\n" not in str(caught.value)


def test_whatever_lies_beside_a_tombstone_is_named(tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    for name in ("plan.json", ".lock", ".plan.json.part", "notes/age.txt"):
        (tmp_path / name).touch()
    assert find_leftovers(tmp_path) == []
    write_tombstone(tmp_path, TOMBSTONE)
    ending = "lies beside a tombstone, the participant withdrew; remove it"
    names = (".plan.json.part", "notes/age.txt", "plan.json")
    assert find_leftovers(tmp_path) == [f"{tmp_path / name}: {ending}" for name in names]
