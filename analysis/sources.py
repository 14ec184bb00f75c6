"""Recordings made from one another: turned, cut or edited, they are several signals of one thing that happened.

Whatever is said about other recordings rests on how many different things were recorded. Where several recordings come
from one source, intervals draw sources, with all their recordings, and the count of sources is told.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.sheet import refuse_lines

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pandas import DataFrame, Series


def read_sources(sheet: DataFrame, sources: Mapping[str, str], *, what: str) -> Series:
    """Find what every stimulus's recording was made from.

    Parameters
    ----------
    sheet : DataFrame
        Stimuli, indexed by line number: recording, and source where the manifest tells it.
    sources : Mapping of str to str
        Recording -> source, where the manifest does not tell it.
    what : str
        The manifest's name, for the message.

    Returns
    -------
    Series of str
        The source; the recording itself where nothing is said.

    Raises
    ------
    ValueError
        If a recording has two sources; names the lines.
    """
    if "source" not in sheet:
        return sheet["recording"].map(lambda name: sources.get(name, name))
    found = sheet["source"].mask(sheet["source"] == "", sheet["recording"])
    first = found.groupby(sheet["recording"]).transform("first")
    otherwise = "in column 'source', but an earlier line of its recording has another; a recording has one"
    refuse_lines(found[found != first].rename("source"), what, why=otherwise)
    return found


def note_sources(rows: DataFrame) -> Iterator[str]:
    """Say how many independent sources the rated recordings come from, where they are fewer.

    Parameters
    ----------
    rows : DataFrame
        Judgements: recording, source, role.

    Yields
    ------
    str
        One sentence, or none.
    """
    tests = rows["role"] == "test"
    recordings, sources = (rows.loc[tests, name].nunique() for name in ("recording", "source"))
    if sources < recordings:
        yield (
            f"The {recordings} recordings come from {sources} sources, turned, cut or edited: they are not "
            "independent. Two-way intervals of associations draw sources. Mixed models, contrasts and what a larger "
            "study would add take recordings for independent: their intervals are too narrow and their p too small, "
            f"because n is {sources} rather than {recordings}."
        )
