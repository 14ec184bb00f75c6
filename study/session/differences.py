"""In which values two records of the same form differ, named by their keys."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping


def find_differences(old: Mapping[str, Any], new: Mapping[str, Any], *, ignore: Collection[str] = ()) -> list[str]:
    """Say in which values two nested mappings differ.

    Parameters
    ----------
    old, new : mapping
        What JSON can hold.
    ignore : collection of str
        Keys of the outermost level that do not count.

    Returns
    -------
    list of str
        One entry per value. What only one of them knows is a difference as well.

    Examples
    --------
    >>> find_differences({"seed": 1, "rig": {"rate_hz": 48000}}, {"seed": 2, "rig": {"rate_hz": 48000}})
    ['seed 1 -> 2']
    """
    before, after = (_flatten({k: v for k, v in entry.items() if k not in ignore}) for entry in (old, new))
    names = [name for name in before | after if before.get(name) != after.get(name)]
    return [f"{name} {before.get(name)!r} -> {after.get(name)!r}" for name in names]


def _flatten(entry: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Name every value of nested mappings by its keys, joined with dots."""
    flat: dict[str, Any] = {}
    for name, value in entry.items():
        flat |= _flatten(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat
