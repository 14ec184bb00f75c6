"""Changes of valid files that find more than random bytes do: cuts, splices, edited numbers, hostile characters."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from random import Random

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
WORD = re.compile(rb'"[^"\n]{0,60}"|[A-Za-z_]{2,}')

NUMBERS: Final = (
    b"0", b"-0", b"-1", b"1e309", b"-1e309", b"nan", b"NaN", b"inf", b"Infinity", b"1e12", b"1e-320", b"2147483648",
    b"-9223372036854775809", b"18446744073709551616", b"1" + b"0" * 400, b"0x10", b"1_000", b"true", b"null", b"1,5",
)  # fmt: skip
TEXTS: Final = (
    b"", b"\0", b"\x1b[31m", b"\xff", b"\xc3\x28", "\u202e".encode(), "\u2028".encode(), "\U0010ffff".encode(),
    b"\\ud800", b"\\u0000", b"../../etc/passwd",
    b"=1+1", b"@x", b"[[[[", b"{" * 200, b"[" * 5000,
    b"]", b"}", b'"', b"'",
    b"\r", b"\n", b"\r\n\r\n", b",", b";", b"\t", b"#", b"%s%n", b"{0.__class__}", b"null", b"[]", b"{}", b'""',
)  # fmt: skip
EDGES: Final = (
    0,
    1,
    2,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0x8000,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
)


def _place(rng: Random, content: bytes) -> tuple[int, int]:
    start = rng.randrange(len(content) + 1)
    return start, min(len(content), start + rng.choice((0, 1, 2, 4, 8, 16, 64, 512)))


def flip(rng: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    """Flip one bit."""
    if not content:
        return content
    at = rng.randrange(len(content))
    return content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]


def cut(rng: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    """Take a piece out, or all from some place on."""
    start, end = _place(rng, content)
    return content[:start] + (b"" if rng.random() < 0.3 else content[end:])


def double(rng: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    """Repeat a piece."""
    start, end = _place(rng, content)
    return content[:end] + content[start:end] * rng.choice((1, 1, 2, 100)) + content[end:]


def splice(rng: Random, content: bytes, others: Sequence[bytes]) -> bytes:
    """Put a piece of another file in."""
    (start, end), other = _place(rng, content), rng.choice(others)
    first, last = _place(rng, other)
    return content[:start] + other[first:last] + content[end:]


def overwrite(rng: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    """Set a binary number to an extreme."""
    start, _end = _place(rng, content)
    size = rng.choice((1, 2, 4, 8))
    number = (rng.choice(EDGES) % 256**size).to_bytes(size, rng.choice(("little", "big")))
    return content[:start] + number + content[start + size :]


def insert(rng: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    """Put a hostile text in."""
    start, end = _place(rng, content)
    return content[:start] + rng.choice(TEXTS) + content[rng.choice((start, end)) :]


def _edit(pattern: re.Pattern[bytes], values: Sequence[bytes]) -> Callable[..., bytes]:
    def edit(rng: Random, content: bytes, _: Sequence[bytes]) -> bytes:
        found = list(pattern.finditer(content))
        if not found:
            return content
        one = rng.choice(found)
        value = rng.choice((*values, rng.choice(found)[0]))
        return content[: one.start()] + value + content[one.end() :]

    return edit


MUTATIONS: Final = (
    flip, flip, cut, double, splice, overwrite, insert, *[_edit(NUMBER, NUMBERS)] * 3, *[_edit(WORD, TEXTS)] * 2,
)  # fmt: skip


def mutate(rng: Random, content: bytes, others: Sequence[bytes]) -> bytes:
    """Change a file in one to four places."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 4))):
        content = rng.choice(MUTATIONS)(rng, content, others)
    return content
