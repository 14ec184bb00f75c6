"""lme4's notation, read: which part of a formula is fixed, and which random terms stand in its brackets.

``(1 | g)`` an intercept per level of g; ``(x | g)`` intercept and slope, correlated; ``(x || g)`` the same,
uncorrelated; ``(0 + x | g)`` a slope alone; ``(1 | a:b)`` one per combination; ``(1 | a/b)`` is ``(1 | a) +
(1 | b:a)``. The fixed part is left to formulaic, which knows ``+ - : * / ^ I()`` and functions of columns.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

NAME = r"(?:`[^`]+`|[^\W\d][\w.]*)"
GROUP = re.compile(rf"\s*{NAME}\s*(?:[:/]\s*{NAME}\s*)*")
FORBIDDEN = re.compile(r"\b(offset|weights)\s*\(")


@dataclass(frozen=True, slots=True)
class RandomTerm:
    """One bracket of a formula: what varies, over which groups.

    Parameters
    ----------
    effects : str
        The left side of the bar, such as ``1 + x``.
    group : tuple of str
        Columns whose combinations are the levels.
    independent : bool
        Whether the bar was double: no correlations.
    """

    effects: str
    group: tuple[str, ...]
    independent: bool = False

    @property
    def name(self) -> str:
        """Name of the grouping factor, such as ``participant:item``."""
        return ":".join(self.group)


@dataclass(frozen=True, slots=True)
class Formula:
    """A formula taken apart.

    Parameters
    ----------
    text : str
        As it was given.
    response : str
        The left side of the tilde.
    fixed : str
        The right side without its brackets.
    random : tuple of RandomTerm
        The brackets, nesting written out.
    """

    text: str
    response: str
    fixed: str
    random: tuple[RandomTerm, ...]


def parse_formula(text: str) -> Formula:
    """Take a formula apart.

    Parameters
    ----------
    text : str
        In lme4's notation.

    Returns
    -------
    Formula
        Response, fixed part and random terms.

    Raises
    ------
    ValueError
        If the text is not of the form ``response ~ fixed + (effects | group)``.

    Examples
    --------
    >>> parsed = parse_formula("y ~ x + (1 + x || subject) + (1 | class/pupil)")
    >>> parsed.fixed
    'x'
    >>> [(term.effects, term.name, term.independent) for term in parsed.random]
    [('1 + x', 'subject', True), ('1', 'class', False), ('1', 'pupil:class', False)]
    """
    if not isinstance(text, str) or text.count("~") != 1 or not all(side.strip() for side in text.split("~")):
        raise ValueError(f"formula: got {text!r}, allowed is 'response ~ fixed + (effects | group)'")
    if found := FORBIDDEN.search(text):
        raise ValueError(f"formula: got {found[1]}(...), allowed are models without; every row counts the same here")
    response, right = (side.strip() for side in text.split("~"))
    pieces = list(_split_sum(right))
    random = [term for sign, piece in pieces if _is_bar(piece) for term in _read_bar(sign, piece)]
    fixed = [(sign, piece) for sign, piece in pieces if not _is_bar(piece)]
    if any(piece == "." for _, piece in fixed):
        raise ValueError("formula: got '.', allowed are terms by name; write out which columns predict")
    if stray := next((piece for _, piece in fixed if "|" in piece), None):
        raise ValueError(f"formula: got {stray!r}, allowed is a bar inside brackets of its own: + (effects | group)")
    if not random:
        raise ValueError(
            f"formula: got {text!r} without a random term, allowed is at least one (1 | group); "
            "for none, use ordinary regression"
        )
    return Formula(text, response, _join(fixed), tuple(random))


def _split_sum(text: str) -> Iterator[tuple[str, str]]:
    """Cut at plus and minus signs outside of brackets and quotes."""
    depth, sign, piece, quoted = 0, "+", "", False
    for letter in text:
        quoted ^= letter == "`"
        depth += (letter == "(") - (letter == ")")
        if depth < 0:
            break
        if letter in "+-" and depth == 0 and not quoted:
            yield from [(sign, piece.strip())] if piece.strip() else []
            sign, piece = letter, ""
        else:
            piece += letter
    if depth or not piece.strip():
        what = "brackets that do not match" if depth else "a sign with nothing after it"
        raise ValueError(f"formula: got {what} in {text!r}, allowed is 'fixed + (effects | group)'")
    yield sign, piece.strip()


def _is_bar(piece: str) -> bool:
    return piece.startswith("(") and piece.endswith(")") and "|" in piece and _closes_last(piece)


def _closes_last(piece: str) -> bool:
    """Whether the first bracket is closed by the last letter: not so in (1 | a):(1 | b)."""
    depth = 0
    for place, letter in enumerate(piece):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return place == len(piece) - 1
    return False


def _read_bar(sign: str, piece: str) -> list[RandomTerm]:
    bar = "||" if "||" in piece else "|"
    effects, _, group = piece[1:-1].partition(bar)
    group = re.sub(r"^\s*\((.*)\)\s*$", r"\1", group)
    if sign == "-" or not effects.strip() or not GROUP.fullmatch(group):
        raise ValueError(
            f"formula: got {sign} {piece}, allowed is + (effects | group) with a group such as a, a:b or a/b"
        )
    independent = bar == "||"
    return [RandomTerm(effects.strip(), levels, independent) for levels in _write_out(group)]


def _write_out(group: str) -> list[tuple[str, ...]]:
    """Nesting as a list, named as lme4 names it, the inner first: a/b is a and b:a."""
    steps = [tuple(name.strip().strip("`") for name in step.split(":")) for step in group.split("/")]
    return [sum(steps[depth::-1], ()) for depth in range(len(steps))]


def _join(pieces: list[tuple[str, str]]) -> str:
    text = " ".join(f"{sign} {piece}" for sign, piece in pieces)
    return text.removeprefix("+ ") or "1"
