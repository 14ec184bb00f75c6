from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from feel321.study.session.plan import make_codes


@given(st.sets(st.text(min_size=1), max_size=300), st.text())
def test_every_stimulus_has_a_code_of_its_own(names: set[str], key: str) -> None:
    codes = make_codes(sorted(names), key)
    assert set(codes) == names
    assert len(set(codes.values())) == len(names)


def test_codes_follow_from_name_and_key_and_from_nothing_else() -> None:
    few, many = make_codes(["oak"], "a"), make_codes(["elm", "oak"], "a")
    assert few["oak"] == many["oak"] != make_codes(["oak"], "b")["oak"]


def test_codes_grow_where_short_ones_would_be_the_same() -> None:
    # Of 200 000 numbers, the first two that share six letters.
    codes = make_codes(["214", "38803", "7"], "study 321")
    assert len(set(codes.values())) == 3
    assert {len(code) for code in codes.values()} == {7}
    assert codes["214"][:6] == codes["38803"][:6] == make_codes(["214"], "study 321")["214"]
