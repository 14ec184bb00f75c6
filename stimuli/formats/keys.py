"""What the rate and the unit are called, in archives and sidecars alike, and one value where several names say it."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Mapping

Value = TypeVar("Value", float, str)

RATE_KEYS = ("rate_hz", "fs", "rate", "sample_rate", "samplerate", "sampling_rate", "fs_hz")
UNIT_KEYS = ("unit", "units")


def one_value(found: Mapping[str, Value], *, argument: str, requested: Value | None) -> Value | None:
    """Return what all names say; where they differ, what the caller chooses among it.

    Parameters
    ----------
    found : mapping of str to float or str
        What each name says.
    argument : str
        The argument that chooses, for the message.
    requested : float or str, optional
        Its value.

    Returns
    -------
    float or str or None
        The value; None where nothing was found.

    Raises
    ------
    ValueError
        If the names differ, and the caller chooses none of their values.

    Examples
    --------
    >>> one_value({"fs": 100.0, "rate": 200.0}, argument="rate_hz", requested=200.0)
    200.0
    """
    values = set(found.values())
    if len(values) <= 1:
        return next(iter(values), None)
    if requested is not None and requested in values:
        return requested
    said = ", ".join(f"{name} says {value!r}" for name, value in found.items())
    raise ValueError(f"got several values that differ ({said}); choose one of them by {argument}=...")
