"""Units of acceleration and time as people spell them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from stimuli.recording import UNITS

if TYPE_CHECKING:
    from collections.abc import Container

ACCELERATION_SPELLINGS = {
    "m/s^2": "m/s^2", "m/s2": "m/s^2", "m/s²": "m/s^2", "m/s/s": "m/s^2", "m/s**2": "m/s^2",
    "ms^-2": "m/s^2", "ms-2": "m/s^2", "ms⁻²": "m/s^2", "m·s⁻²": "m/s^2", "m*s^-2": "m/s^2", "ms2": "m/s^2",
    "g": "g", "gn": "g", "g0": "g", "gee": "g", "gees": "g",
    "mg": "mg", "milli-g": "mg", "millig": "mg",
}  # fmt: skip
"""Accepted spellings of a unit of acceleration (case, blanks and underscores aside) and the unit meant."""

TIME_SPELLINGS = {
    "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
    "ms": 1e-3, "msec": 1e-3, "millis": 1e-3, "milliseconds": 1e-3,
    "us": 1e-6, "μs": 1e-6, "usec": 1e-6, "micros": 1e-6, "microseconds": 1e-6,
    "ns": 1e-9, "nsec": 1e-9, "nanoseconds": 1e-9,
}  # fmt: skip
"""Accepted spellings of a unit of time and its size in s."""

NO_UNIT_NOTE = "the file names no unit of acceleration: taken as m/s^2 (unit=... says otherwise)"


def normalise(text: str) -> str:
    """Strip case, blanks and underscores, and make both micro signs one.

    Parameters
    ----------
    text : str
        A unit as written.

    Returns
    -------
    str
        The spelling to look up.

    Examples
    --------
    >>> normalise(" M / s^2 ")
    'm/s^2'
    """
    return re.sub(r"[\s_]+", "", text).casefold()


def split_unit(label: str, spellings: Container[str]) -> tuple[str, str | None]:
    """Split a column's label into its bare name and its unit.

    Parameters
    ----------
    label : str
        A label such as ``x_g``, ``acc x (m/s²)`` or ``time [µs]``.
    spellings : container of str
        Which trailing words count as units; whatever stands in brackets does.

    Returns
    -------
    name : str
        The bare name.
    unit : str or None
        The unit as looked up in `spellings`, or as written in brackets.

    Examples
    --------
    >>> split_unit("acc_x_m_s2", ACCELERATION_SPELLINGS)
    ('acc_x', 'ms2')
    >>> split_unit("x [V]", ACCELERATION_SPELLINGS)
    ('x', 'v')
    """
    label = label.strip()
    if bracketed := re.fullmatch(r"(.+?)[\s_]*[\[(](.*)[\])]", label):
        return bracketed[1], normalise(bracketed[2])
    for gap in re.finditer(r"[\s_]+", label):
        if normalise(label[gap.end() :]) in spellings:
            return label[: gap.start()], normalise(label[gap.end() :])
    return label, None


def parse_unit(text: str) -> str:
    """Return the unit of acceleration meant by a spelling.

    Parameters
    ----------
    text : str
        A unit as written, such as ``m/s2`` or ``G``.

    Returns
    -------
    str
        A key of `stimuli.recording.UNITS`.

    Raises
    ------
    ValueError
        If it is no unit of acceleration.

    Examples
    --------
    >>> parse_unit("m/s²")
    'm/s^2'
    """
    try:
        return ACCELERATION_SPELLINGS[normalise(text)]
    except (KeyError, TypeError):
        raise ValueError(f"got the unit {text!r}, allowed is one of {', '.join(UNITS)}") from None


def settle_unit(own: str | None, requested: str | None) -> tuple[str, tuple[str, ...]]:
    """Decide the unit from what the file and the caller say.

    Parameters
    ----------
    own : str or None
        The unit that the file names.
    requested : str or None
        The unit that the caller names.

    Returns
    -------
    unit : str
        A key of `stimuli.recording.UNITS`.
    notes : tuple of str
        What had to be assumed.

    Raises
    ------
    ValueError
        If the two contradict each other, or the caller's is no unit.
    """
    wanted = None if requested is None else parse_unit(requested)
    if own and wanted and own != wanted:
        raise ValueError(f"got unit={requested!r}, but the file says {own!r}; leave unit out")
    unit = own or wanted
    return (unit, ()) if unit else ("m/s^2", (NO_UNIT_NOTE,))
