"""SECTIONS: the one list of a report's sections, in its order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.sections import association, primary, profile

if TYPE_CHECKING:
    from collections.abc import Callable

    from analysis.sections.choices import Choices
    from analysis.sections.section import Section
    from analysis.table import Table

SECTIONS: tuple[Callable[[Table, Choices], Section], ...] = (primary.compute, association.compute, profile.compute)
"""Each takes all ratings and gives one section, or the reason why there is none."""
