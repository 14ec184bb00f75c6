"""Factors in which participants differ: what they may be called, and how many groups they may make."""

from __future__ import annotations

import re
from math import prod
from typing import TYPE_CHECKING

from protocols.groups import CHOOSING
from study import ratings
from study.ledger import roster

if TYPE_CHECKING:
    from collections.abc import Mapping

MOST_GROUPS = 64
"""A balanced design wants several participants in each group; more groups than this are a slip."""

TAKEN = frozenset({*roster.COLUMNS, *roster.LAST_COLUMNS, *ratings.COLUMNS}) - set(CHOOSING)
"""Names of columns: a factor becomes one of `participants.csv`, which is joined with `ratings.csv`."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")


def check_factor(name: str) -> str:
    """Demand a name that can head a column of its own.

    Parameters
    ----------
    name : str
        The factor's name.

    Returns
    -------
    str
        The same.

    Raises
    ------
    ValueError
        If it cannot, or it is only almost one of the names that choose what is felt.

    Examples
    --------
    >>> check_factor("Levels")
    Traceback (most recent call last):
    ValueError: did you mean level? Allowed is that, or a label of your own
    """
    plain = name.casefold()
    if name not in CHOOSING and plain.removesuffix("s") in CHOOSING:
        raise ValueError(f"did you mean {plain.removesuffix('s')}? Allowed is that, or a label of your own")
    if not _NAME.fullmatch(name):
        raise ValueError("allowed are up to 40 letters (A-Z), digits and _, beginning with a letter")
    if plain in TAKEN:
        raise ValueError("is a column of participants.csv or ratings.csv already, allowed is a name of its own")
    return name


def check_groups(between: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Demand that the factors do not make more groups than a study can fill.

    Parameters
    ----------
    between : dict of str to tuple of str
        Levels of each factor.

    Returns
    -------
    dict
        The same.

    Raises
    ------
    ValueError
        If there are too many combinations.
    """
    if (groups := count_groups(between)) > MOST_GROUPS:
        raise ValueError(f"got {groups} groups, allowed are at most {MOST_GROUPS}; use fewer factors or levels")
    return between


def count_groups(between: Mapping[str, tuple[str, ...]]) -> int:
    """Count the groups that factors make.

    Parameters
    ----------
    between : mapping of str to tuple of str
        Levels of each factor.

    Returns
    -------
    int
        Number of their combinations.
    """
    return prod(len(levels) for levels in between.values())
