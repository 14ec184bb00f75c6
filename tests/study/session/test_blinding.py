from __future__ import annotations

from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st

from feel321.study.session.plan import make_codes

if TYPE_CHECKING:
    import pytest


@given(st.sets(st.text(min_size=1), max_size=300), st.text())
def test_every_stimulus_has_a_code_of_its_own(names: set[str], key: str) -> None:
    codes = make_codes(sorted(names), key)
    assert set(codes) == names
    assert len(set(codes.values())) == len(names)


def test_codes_follow_from_name_and_key_and_from_nothing_else() -> None:
    few, many = make_codes(["oak"], "a"), make_codes(["elm", "oak"], "a")
    assert few["oak"] == many["oak"] != make_codes(["oak"], "b")["oak"]


def test_codes_grow_where_short_ones_would_be_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    # Among 2 000 names some sixty share three letters of thirty-two, as among 200 000 some thirty share six.
    monkeypatch.setattr("feel321.study.session.plan.LEAST_LETTERS", 3)
    names = [str(number) for number in range(2_000)]
    codes = make_codes(names, "")
    assert len(set(codes.values())) == len(names)
    assert {len(code) for code in codes.values()} != {3}
