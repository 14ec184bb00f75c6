"""Recordings made from one another: turned, cut or edited, they are several signals of one thing that happened.

Whatever is said about other recordings rests on how many different things were recorded. Where several recordings come
from one source, intervals draw sources, with all their recordings, mixed models hold what the recordings of a source
share, and the count of sources is told.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.table.sheet import refuse_lines
from analysis.table.tidy import open_ratings

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


def find_sources(rows: DataFrame) -> Series:
    """Find what each recording of a tidy table was made from.

    Parameters
    ----------
    rows : DataFrame
        Judgements: recording, and source where that is told.

    Returns
    -------
    Series
        The source, indexed by recording in alphabetical order; the recording itself where nothing is said.

    Raises
    ------
    ValueError
        If there is no column of recordings, or a recording has two sources.

    Examples
    --------
    >>> import pandas as pd
    >>> find_sources(pd.DataFrame({"recording": ["b-r1", "b-r2", "c"], "source": ["b", "b", None]})).to_dict()
    {'b-r1': 'b', 'b-r2': 'b', 'c': 'c'}
    """
    rows = open_ratings(rows, what="rows")
    if "recording" not in rows:
        raise ValueError(f"rows: column recording is missing; got {', '.join(map(str, rows))}")
    told = rows["source"] if "source" in rows else rows["recording"]
    pairs = rows[["recording"]].assign(source=told).drop_duplicates().astype(object).sort_values("recording")
    unsaid = pairs["source"].isna() | (pairs["source"] == "")
    pairs["source"] = pairs["source"].mask(unsaid, pairs["recording"])
    twice = pairs.loc[pairs["recording"].duplicated(), "recording"]
    if len(twice):
        raise ValueError(f"ratings: got two sources of recording {twice.iloc[0]}; a recording has one")
    return pairs.set_index("recording")["source"]


def tell_recordings(recordings: int, sources: int) -> str:
    """Say how many recordings there are, and how many things happened that they record.

    Parameters
    ----------
    recordings, sources : int
        How many.

    Returns
    -------
    str
        Sources only where they are fewer.

    Examples
    --------
    >>> tell_recordings(12, 4), tell_recordings(3, 1), tell_recordings(1, 1)
    ('12 recordings of 4 sources', '3 recordings of 1 source', '1 recording')
    """
    told = f"{recordings} recording{'s' if recordings != 1 else ''}"
    return told if sources >= recordings else f"{told} of {sources} source{'s' if sources != 1 else ''}"


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
        told = f"The {recordings} recordings come from {{}}, turned, cut or edited: they are not independent"
        if sources == 1:
            yield told.format("1 source") + ", and nothing here speaks of other sources."
            return
        yield (
            told.format(f"{sources} sources") + ", and what is said of others rests on sources. Two-way intervals draw "
            "them; mixed models hold what the recordings of a source share, as a whole and reducer by reducer."
        )
