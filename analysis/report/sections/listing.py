"""SECTIONS: the one list of a report's sections, in its order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.report.sections import (
    association,
    contrasts,
    discrimination,
    further,
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

    from analysis.report.sections.choices import Choices
    from analysis.report.sections.section import Section
    from analysis.table.reading import Table

SECTIONS: tuple[Callable[[Table, Choices], Section], ...] = (
    primary.compute, association.compute, levels.compute, profile.compute, contrasts.compute, discrimination.compute,
    space.compute, refined.compute, further.compute, raters.compute, robustness.compute, standard.compute,
)  # fmt: skip
"""Each takes all ratings and gives one section, or the reason why there is none."""
