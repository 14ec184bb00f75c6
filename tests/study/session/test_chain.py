from __future__ import annotations

import json
from typing import Any

import pytest

from feel321.study.session.journal import START, Record, digest, read_chain, write_line

RECORD = Record(0, "2026-01-01T12:00:00.000+00:00", "begun", {"words": "müde"})
ENTRY = {"sequence": 0, "previous": START, "utc": RECORD.utc, "event": "begun", "data": {}}


def seal(body: str) -> bytes:
    return f'{body[:-1]}, "sha256": "{digest(body)}"}}\n'.encode()


def test_what_was_written_is_read() -> None:
    chain = read_chain(write_line(RECORD, START) + b"{", "j")
    assert (chain.records, chain.torn) == ([RECORD], b"{")
    assert chain.tip == digest(write_line(RECORD, START)[:-1])


@pytest.mark.parametrize(
    "change",
    [
        {"sequence": "0"},
        {"sequence": False},
        {"previous": None},
        {"event": 1},
        {"data": []},
        {"data": None},
        {"utc": 0},
        {"utc": ""},
        {"utc": "2026-01-01T12:00:00"},
        {"utc": "yesterday"},
        {"more": 1},
    ],
)
def test_a_line_with_other_fields_is_refused_though_its_digest_is_right(
    change: dict[str, Any],
) -> None:
    assert read_chain(seal(json.dumps(ENTRY)), "j").records[0].event == "begun"
    with pytest.raises(
        ValueError, match="j, line 1: is not a record as feel321 writes them; restore the file"
    ):
        read_chain(seal(json.dumps(ENTRY | change)), "j")


@pytest.mark.parametrize("name", list(ENTRY))
def test_a_line_without_a_field_is_refused(name: str) -> None:
    entry = {key: value for key, value in ENTRY.items() if key != name}
    with pytest.raises(ValueError, match="j, line 1: is not a record as feel321 writes them"):
        read_chain(seal(json.dumps(entry)), "j")


@pytest.mark.parametrize("body", ["{" + '"a": [' * 99999 + "}", '{"sequence": NaN}'])
def test_what_is_no_object_is_refused(body: str) -> None:
    with pytest.raises(ValueError, match="j, line 1: is not a record as feel321 writes them"):
        read_chain(seal(body), "j")
