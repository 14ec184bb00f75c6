"""SECTIONS: the one list of a report's sections, in its order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.sections import (
    association,
    contrasts,
    discrimination,
    levels,
    primary,
    profile,
    raters,
    refined,
    robustness,
    space,
    standard,
)  # fmt: skip

if TYPE_CHECKING:
    from collections.abc import Callable

    from analysis.sections.choices import Choices
    from analysis.sections.section import Section
    from analysis.table import Table

SECTIONS: tuple[Callable[[Table, Choices], Section], ...] = (
    primary.compute, association.compute, levels.compute, profile.compute, contrasts.compute, discrimination.compute,
    space.compute, refined.compute, raters.compute, robustness.compute, standard.compute,
)  # fmt: skip
"""Each takes all ratings and gives one section, or the reason why there is none."""
