"""Every way to falsify a study that changes data is seen, as `docs/audit.md` says, or named there as out of reach."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterable

OUT_OF_REACH = {"times of files are changed"}
"""Changes nothing that anything is derived from."""


def test_the_page_lists_every_cheat(cheats: Any, table: Any) -> None:
    rows = table.read_table()
    assert list(rows) == list(cheats.CHEATS)
    assert len(rows) >= 60
    unseen = {name for name, row in rows.items() if row[-1] == table.NO}
    assert unseen == OUT_OF_REACH
    before = table.read_before()
    assert {name: row[1:3] for name, row in rows.items()} == before


def look(bench: Any, cheats: Any, table: Any, names: Iterable[str]) -> None:
    """Compare what an anchor outside shows, though the checkpoints were made anew, with the page."""
    rows = table.read_table()
    for name in names:
        one = cheats.CHEATS[name]
        after = cheats.begin_anew if one.is_data else table.leave
        assert bench.look(one, after, is_anchored=True) == rows[name][-1], name


def test_an_anchor_outside_sees_cheats(bench: Any, cheats: Any, table: Any) -> None:
    few = random.SystemRandom().sample(list(cheats.CHEATS), 12)
    look(bench, cheats, table, few)


@pytest.mark.soak
def test_an_anchor_outside_sees_every_cheat(bench: Any, cheats: Any, table: Any) -> None:
    look(bench, cheats, table, cheats.CHEATS)


@pytest.mark.soak
def test_the_page_says_what_is_seen_without_an_anchor(bench: Any, cheats: Any, table: Any) -> None:
    rows = table.read_table()
    for place, after in ((-3, table.forget), (-2, table.leave)):
        seen = {
            name: bench.look(one, after, is_anchored=False) for name, one in cheats.CHEATS.items()
        }
        assert seen == {name: row[place] for name, row in rows.items()}
