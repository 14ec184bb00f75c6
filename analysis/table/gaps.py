"""What a table of ratings lacks or may have confused: said in a note, never repaired."""

from __future__ import annotations

import unicodedata
from collections import Counter
from typing import TYPE_CHECKING

from analysis.table.scales import APART
from analysis.table.sheet import shorten

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pandas import DataFrame, Series

NAMED = 3
"""How many names a note lists before it only counts."""

SHORT = 10
"""Points below which a scale's highest rating makes one doubt that it went to 100."""


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
    rated = set(rows["stimulus_id"].unique()) | set(rows.loc[rows["scale"].isin(APART), "reference_id"].unique())
    unrated = [str(name) for name in manifest.index if name not in rated]
    if unrated:
        yield f"{len(unrated)} of {len(manifest)} stimuli of the manifest were rated by nobody: {list_names(unrated)}."
    tested = set(rows.loc[rows["role"] == "test", "scale"].unique())
    for scale in sorted(set(rows["scale"].unique()) - tested - set(APART)):
        yield f"Scale {list_names([scale])} was rated on references and anchors only: it has no association."


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
    lost = sorted(set(participants.unique()) - set(participants[~rejected].unique()))
    if lost:
        yield f"Participants without a valid judgement, who do not count: {list_names(lost)}."


def note_lookalikes(rows: DataFrame) -> Iterator[str]:
    """Say which names look alike.

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
        looks = [_look_at(name) for name in names]
        times = Counter(looks)
        alike = [name for name, look in zip(names, looks, strict=True) if times[look] > 1]
        if alike:
            told = f"Names in column '{column}' that differ in capitals, accents or blanks only are taken as different"
            yield f"{told}: {list_names(alike)}."


def note_alike(sheet: DataFrame, key: Sequence[str]) -> Iterator[str]:
    """Say how many judgements repeat another without saying so.

    Parameters
    ----------
    sheet : DataFrame
        Judgements.
    key : sequence of str
        Columns, ``repeat`` among them, that should tell two judgements apart.

    Yields
    ------
    str
        One sentence, or none.
    """
    count = int(sheet.duplicated(list(key)).sum())
    if count:
        yield f"{count} judgements differ from an earlier one in their trial only: each counts as a further repeat."


def note_scales(sheet: DataFrame) -> Iterator[str]:
    """Say which scales may have had other ends, and which were judged in several tasks.

    Parameters
    ----------
    sheet : DataFrame
        Judgements: scale, rating, and protocol if there is one.

    Yields
    ------
    str
        One sentence per such scale.
    """
    ends = sheet.groupby("scale")["rating"].agg(["min", "max"])
    for scale, low, high in ends.itertuples():
        if low < high <= SHORT:
            name, told = list_names([scale]), f"run from {low:g} to {high:g}"
            yield f"Ratings of scale {name} {told}: if 100 was not its upper end, rescale them to 0 to 100."
    if "protocol" not in sheet:
        return
    for scale, tasks in sheet.groupby("scale")["protocol"].unique().items():
        if len(tasks) > 1:
            name, told = list_names([str(scale)]), f"was judged in {len(tasks)} protocols"
            yield f"Scale {name} {told}, which are taken together: {list_names(sorted(tasks))}."


def note_underruns(sheet: DataFrame) -> Iterator[str]:
    """Say how many judgements were made on an interrupted playback.

    Parameters
    ----------
    sheet : DataFrame
        Judgements: participant, underruns.

    Yields
    ------
    str
        One sentence, or none.
    """
    broken = sheet.loc[sheet["underruns"] > 0, "participant"]
    if len(broken):
        told = f"{len(broken)} judgements of {broken.nunique()} participants were made on an interrupted playback"
        yield f"{told} (underruns): they count; mark them as rejected to leave them out."


def list_names(names: Sequence[str]) -> str:
    """List names for a note.

    Parameters
    ----------
    names : sequence of str
        Names.

    Returns
    -------
    str
        The first of them, quoted, and how many more there are.

    Examples
    --------
    >>> list_names(["a", "b", "c", "d", "e"])
    "'a', 'b', 'c' and 2 more"
    """
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(shorten(name) for name in names[:NAMED]) + more


def _look_at(name: str) -> str:
    """Leave out what the eye does not see: format characters, kinds of blanks, how accents are stored, capitals."""
    seen = "".join(letter for letter in unicodedata.normalize("NFKC", name) if unicodedata.category(letter) != "Cf")
    return " ".join(seen.split()).casefold()
