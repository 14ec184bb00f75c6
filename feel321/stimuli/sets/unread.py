"""Recordings as a set is made of them: given with their samples, or as sources that are read where they are used."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.stimuli.recording import Recording


@dataclass(frozen=True, slots=True)
class Unread:
    """A recording that is not read yet: its name, and a function with its arguments, all of which can be pickled.

    size: number of its samples of all axes, once it is known.
    """

    name: str
    open: Callable[..., Recording]
    given: tuple[Any, ...] = ()
    size: int = 0

    def read(self) -> Recording:
        """Read the recording."""
        return replace(self.open(*self.given), name=self.name)


def read_given(given: Recording | Unread) -> Recording:
    """Read a recording that is not read yet."""
    return given.read() if isinstance(given, Unread) else given
