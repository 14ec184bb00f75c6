"""What a table of ratings lacks or may have confused: said in a note, never repaired."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.scales import APART

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pandas import DataFrame, Series

NAMED = 3
"""How many names a note lists before it only counts."""


def note_gaps(rows: DataFrame, manifest: DataFrame) -> Iterator[str]:
    """Say which stimuli nobody rated, and which scales have no test stimulus.

    Parameters
    ----------
    rows : DataFrame
        Judgements: stimulus_id, reference_id, scale, role.
    manifest : DataFrame
        Stimuli, indexed by stimulus_id.

    Yields
    ------
    str
        One sentence each.
    """
    rated = set(rows["stimulus_id"]) | set(rows.loc[rows["scale"].isin(APART), "reference_id"])
    unrated = [str(name) for name in manifest.index if name not in rated]
    if unrated:
        yield f"{len(unrated)} of {len(manifest)} stimuli of the manifest were rated by nobody: {_list(unrated)}."
    tested = set(rows.loc[rows["role"] == "test", "scale"])
    for scale in sorted(set(rows["scale"]) - tested - set(APART)):
        yield f"Scale '{scale}' was rated on references and anchors only: it has no association."


def note_lost(participants: Series, rejected: Series) -> Iterator[str]:
    """Say of whom nothing is left.

    Parameters
    ----------
    participants : Series of str
        Who judged.
    rejected : Series of bool
        Whether that judgement is rejected.

    Yields
    ------
    str
        One sentence, or none.
    """
    lost = sorted(set(participants) - set(participants[~rejected]))
    if lost:
        yield f"Participants without a valid judgement, who do not count: {_list(lost)}."


def note_lookalikes(rows: DataFrame) -> Iterator[str]:
    """Say which names differ in capitals only.

    Parameters
    ----------
    rows : DataFrame
        Judgements: participant, stimulus_id, recording, reducer, level, scale.

    Yields
    ------
    str
        One sentence per column that has such names.
    """
    for column in ("participant", "stimulus_id", "recording", "reducer", "level", "scale"):
        names = sorted(rows[column].unique())
        folded = [name.casefold() for name in names]
        alike = [name for name, fold in zip(names, folded, strict=True) if folded.count(fold) > 1]
        if alike:
            yield f"Names in column '{column}' that differ in capitals only are taken as different: {_list(alike)}."


def _list(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(f"'{name}'" for name in names[:NAMED]) + more
