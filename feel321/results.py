"""Results: the records that functions of the faces return, for annotations in a lab's own code."""

from __future__ import annotations

__all__: list[str] = []
