"""What a power analysis of a study found, without its words and page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feel321.records import Result

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.power.design import Power, PowerDesign, PowerPlan


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Planned(Result):
    """The fields of a `StudyPower`."""

    plan: PowerPlan
    name: str
    effects: DataFrame
    share: int
    notes: tuple[str, ...] = ()

    @property
    def shown(self) -> Power:
        """The design that the page opens with: the recommended one, or the study's own."""
        best = self.plan.recommended
        sizes = find_sizes(best) if best else {}
        powers = self.plan.powers
        return next((one for one in powers if find_sizes(one.design) == sizes), powers[0])

    def find_row(self, power: Power, hypothesis: tuple[str, str]) -> dict[str, Any]:
        """Find everything that is known of a hypothesis in a simulated design."""
        table, sizes = self.plan.table, find_sizes(power.design)
        designs = table[(table[list(sizes)] == list(sizes.values())).all(axis=1)]
        found: dict[str, Any] = {}
        for frame in (designs, select(power.table, hypothesis), select(self.effects, hypothesis)):
            found |= {str(name): value for name, value in frame.iloc[0].to_dict().items()}
        return found


def find_sizes(design: PowerDesign) -> dict[str, int]:
    """Return what identifies a design among those of a plan."""
    names = ("participants", "recordings", "reducers", "repeats")
    return {name: int(getattr(design, name)) for name in names}


def select(table: DataFrame, hypothesis: tuple[str, str]) -> DataFrame:
    """Select the rows of a hypothesis."""
    attribute, metric = hypothesis
    return table[(table["attribute"] == attribute) & (table["metric"] == metric)]
