"""Results of checking and auditing a study."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pandas import DataFrame


class Findings(Result):
    """Texts of several kinds; a table has one row per text, with the columns `kind` and `text`."""

    __slots__ = ()

    def to_frame(self) -> DataFrame:
        """Return one row per finding, with the columns `kind` and `text`."""
        import pandas as pd

        kinds = {name: value for name, value in self.to_dict().items() if isinstance(value, list)}
        rows = [(kind.rstrip("s"), text) for kind, texts in kinds.items() for text in texts]
        return pd.DataFrame(rows, columns=["kind", "text"])


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Problems(Findings):
    """What `Study.check` found, as a whole or in one part of a study.

    problems: what stands in the way of the study; warnings: what is allowed and may not be meant; notes: how strongly
    the stimuli are played; remarks: what was noticed in the recordings; figures: the numbers behind them.
    """

    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)

    def __add__(self, other: Problems) -> Problems:
        """Put what was found in two parts of a study together."""
        return Problems(
            self.problems + other.problems,
            self.warnings + other.warnings,
            self.notes + other.notes,
            self.remarks + other.remarks,
            {**self.figures, **other.figures},
        )


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Audit(Findings):
    """What `Study.audit` found.

    findings: every gap, duplicate and edit; remarks: what is as it was written and worth knowing, such as participants
    on another rig; sentence: what the study was compared with, and what came after; checkpoint: id of the newest one
    in the study's folder, empty if there is none.
    """

    findings: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    sentence: str = ""
    checkpoint: str = ""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Seal(Findings):
    """What `Study.seal` recorded.

    utc, checkpoint: when, and its id, to write into the lab book; places: the remotes that have it; problems: why
    others have not.
    """

    utc: str
    checkpoint: str
    places: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
