"""Results of checking and auditing a study."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pandas import DataFrame


class Findings(Result):
    """Texts of several kinds."""

    __slots__ = ()

    def to_frame(self) -> DataFrame:
        """Return one row per finding, with the columns `kind` and `text`."""
        import pandas as pd

        kinds = {name: value for name, value in self.to_dict().items() if isinstance(value, list)}
        rows = [(kind.rstrip("s"), text) for kind, texts in kinds.items() for text in texts]
        return pd.DataFrame(rows, columns=["kind", "text"])


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Problems(Findings):
    """What stands in the way of a study; what may not be meant; how strong stimuli are; remarks on recordings."""

    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)

    def __add__(self, other: Problems) -> Problems:
        """Put what was found in two parts of a study together."""
        names = ("problems", "warnings", "notes", "remarks")
        texts = {name: getattr(self, name) + getattr(other, name) for name in names}
        return Problems(**texts, figures={**self.figures, **other.figures})


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Audit(Findings):
    """Findings: every gap, duplicate and edit; remarks; what was compared; id of the newest checkpoint, if any."""

    findings: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    sentence: str = ""
    checkpoint: str = ""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Seal(Findings):
    """When, and the checkpoint's id, for the lab book; remotes that have it; problems: why others have not."""

    utc: str
    checkpoint: str
    places: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
