"""From a tidy table to arrays: ratings and metrics per item, and the sources of recordings.

Conventions: an item is a stimulus; a cell is the mean of a participant's repeated ratings of an item, NaN
where they gave none; only items with role ``test`` count, because the hidden reference and the anchors are
chosen to be far apart and would inflate every correlation.

Conventions: every public function that takes such a table passes it through `open_ratings` first. The index of a table
means nothing; a row is one judgement. A judgement marked in a column ``rejected`` does not count, whatever its rating;
the notes count them. A stimulus is named by ``stimulus_id``, or by recording, reducer and level together, or else by
``stimulus`` or ``item``.

Whatever is said about other recordings rests on how many different things were recorded. Where several recordings come
from one source, intervals draw sources, with all their recordings, mixed models hold what the recordings of a source
share, and the count of sources is told.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import read_numbers
from feel321.analysis.table.sheet import NAMING, NO, YES, refuse_lines

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame, Series

# Tidy tables in memory, from anywhere: what they may look like, which judgements count, what names the stimulus.

STIMULUS, REJECTED = "stimulus_id", "rejected"
ROLE, TEST = "role", "test"

SPOKEN = ("stimulus", "item")
"""What else the column is called."""


ARMS = ("scale", "level")
"""Columns of which one model or one correlation takes a single value."""


def open_ratings(ratings: DataFrame, *, what: str = "ratings") -> DataFrame:
    """Give a table a plain index, so that no row is matched with another by a label that both happen to have.

    Returns the same rows in the same order, numbered from 0.

    Examples
    --------
    >>> import pandas as pd
    >>> day = pd.DataFrame({"rating": [40.0, 60.0]})
    >>> open_ratings(pd.concat([day, day])).index.tolist()
    [0, 1, 2, 3]
    """
    from pandas import DataFrame

    if not isinstance(ratings, DataFrame):
        raise TypeError(
            f"{what}: got {type(ratings).__name__}, allowed is a pandas DataFrame, one row per judgement"
        )
    named = ratings.index.to_frame(index=False) if any(ratings.index.names) else DataFrame()
    kept = [name for name in named if name in ratings.index.names and name not in ratings]
    table = ratings.reset_index(drop=True).assign(**{str(name): named[name] for name in kept})
    if twice := table.columns[table.columns.duplicated()].tolist():
        raise ValueError(
            f"{what}: got two columns {twice[0]!r}, allowed is one of each name; rename or drop one"
        )
    return table


def refuse_pooled(rows: DataFrame, *, metrics: Collection[str] = (), what: str = "ratings") -> None:
    """Refuse rows of several scales or several levels: their ratings are not about one thing."""
    for column in ARMS:
        names = (
            sorted(map(str, rows[column].unique()))
            if column in rows and column not in metrics
            else []
        )
        if len(names) > 1:
            raise ValueError(
                f"{what}: got the {column}s {', '.join(names)}, allowed is one {column}; select its rows first, or fit "
                f"a model to each with fit_attributes(..., attribute={column!r})"
            )


def leave_rejected(ratings: DataFrame) -> tuple[DataFrame, tuple[str, ...]]:
    """Leave out judgements that are marked as rejected.

    Examples
    --------
    >>> import pandas as pd
    >>> table = pd.DataFrame({"rating": [40.0, None, 60.0], "rejected": [False, True, False]})
    >>> rows, notes = leave_rejected(table)
    >>> rows["rating"].tolist(), notes
    ([40.0, 60.0], ('1 judgement marked as rejected is left out.',))
    """
    if REJECTED not in ratings:
        return ratings, ()
    rejected = _read_marks(ratings[REJECTED])
    n = int(rejected.sum())
    if not n:
        return ratings, ()
    if n == len(ratings):
        raise ValueError(f"ratings: all {n} judgements are marked as rejected; one must be valid")
    told = "judgement marked as rejected is" if n == 1 else "judgements marked as rejected are"
    return ratings[~rejected], (f"{n} {told} left out.",)


def leave_untested(ratings: DataFrame) -> tuple[DataFrame, tuple[str, ...]]:
    """Leave out hidden references and anchors: chosen to be far apart, they would inflate every slope.

    Examples
    --------
    >>> import pandas as pd
    >>> rows, notes = leave_untested(pd.DataFrame({"rating": [40.0, 99.0], "role": ["test", "reference"]}))
    >>> rows["rating"].tolist(), notes
    ([40.0], ('1 rating of other stimuli than test stimuli (hidden references, anchors) is left out.',))
    """
    if ROLE not in ratings:
        return ratings, ()
    tested = ratings[ROLE] == TEST
    n = int((~tested).sum())
    if not n:
        return ratings, ()
    if n == len(ratings):
        raise ValueError(
            f"ratings: got no row with role 'test' among {n}; it takes rated test stimuli"
        )
    what = "of other stimuli than test stimuli (hidden references, anchors)"
    return ratings[tested], (
        f"{n} rating {what} is left out." if n == 1 else f"{n} ratings {what} are left out.",
    )


def _read_marks(marks: Series) -> Series:
    if marks.dtype == bool:
        return marks
    words = (
        marks
        .astype(object)
        .where(marks.notna(), "")
        .astype(str)
        .str.strip()
        .str.lower()
        .str.removesuffix(".0")
    )
    odd = marks[~words.isin(YES | NO)]
    if len(odd):
        got = f"{odd.iloc[0]!r} in column '{REJECTED}'"
        raise ValueError(f"ratings: got {got}, allowed is true, false, 1, 0, yes, no or nothing")
    return words.isin(YES)


def name_stimuli(ratings: DataFrame) -> DataFrame:
    """Give a table the column ``stimulus_id`` where another column is meant as that.

    Examples
    --------
    >>> import pandas as pd
    >>> name_stimuli(pd.DataFrame({"stimulus": ["a", "b"], "recording": "tap"}))["stimulus_id"].tolist()
    ['a', 'b']
    """
    spoken = [name for name in SPOKEN if name in ratings]
    if STIMULUS in ratings or not spoken:
        return ratings
    named = [name for name in NAMING if name in ratings]
    if {"recording", "reducer"} <= set(named):
        _refuse_finer(ratings, spoken, named)
        return ratings
    if len(spoken) > 1:
        _refuse_finer(ratings, spoken[1:], spoken[:1])
        _refuse_finer(ratings, spoken[:1], spoken[1:])
    return ratings.assign(**{STIMULUS: ratings[spoken[0]]})


def _refuse_finer(ratings: DataFrame, spoken: list[str], named: list[str]) -> None:
    """Refuse a column that tells apart what others call one stimulus."""
    for name in spoken:
        pairs = ratings[[*named, name]].drop_duplicates()
        twice = pairs[pairs.duplicated(named)]
        if len(twice):
            of = "/".join(map(str, twice[named].iloc[0]))
            raise ValueError(
                f"ratings: got several values of '{name}' for {' x '.join(named)} {of}; which of them names the "
                f"stimulus cannot be told: call its column '{STIMULUS}'"
            )


def name_items(ratings: DataFrame) -> DataFrame:
    """Give a table the column ``item``, a stimulus, as models take it."""
    if "item" in ratings:
        return ratings
    named = name_stimuli(ratings)
    if STIMULUS in named:
        return named.assign(item=named[STIMULUS])
    if not {"recording", "reducer"} <= set(named):
        return named
    keys = [name for name in NAMING if name in named]
    return named.assign(item=named.groupby(keys, observed=True, dropna=False).ngroup())


# Recordings made from one another: turned, cut or edited, they are several signals of one thing that happened.


def read_sources(sheet: DataFrame, sources: Mapping[str, str], *, what: str) -> Series:
    """Find what every stimulus's recording was made from.

    sources: recording -> source, where the manifest does not tell it.
    """
    if "source" not in sheet:
        return sheet["recording"].map(lambda name: sources.get(name, name))
    found = sheet["source"].mask(sheet["source"] == "", sheet["recording"])
    first = found.groupby(sheet["recording"]).transform("first")
    otherwise = (
        "in column 'source', but an earlier line of its recording has another; a recording has one"
    )
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
    pairs = (
        rows[["recording"]]
        .assign(source=told)
        .drop_duplicates()
        .astype(object)
        .sort_values("recording")
    )
    unsaid = pairs["source"].isna() | (pairs["source"] == "")
    pairs["source"] = pairs["source"].mask(unsaid, pairs["recording"])
    twice = pairs.loc[pairs["recording"].duplicated(), "recording"]
    if len(twice):
        raise ValueError(
            f"ratings: got two sources of recording {twice.iloc[0]}; a recording has one"
        )
    return pairs.set_index("recording")["source"]


def tell_recordings(recordings: int, sources: int) -> str:
    """Say how many recordings there are, and how many things happened that they record.

    Examples
    --------
    >>> tell_recordings(12, 4), tell_recordings(3, 1), tell_recordings(1, 1)
    ('12 recordings of 4 sources', '3 recordings of 1 source', '1 recording')
    """
    told = f"{recordings} recording{'s' if recordings != 1 else ''}"
    return (
        told
        if sources >= recordings
        else f"{told} of {sources} source{'s' if sources != 1 else ''}"
    )


def note_sources(rows: DataFrame) -> Iterator[str]:
    """Say how many independent sources the rated recordings come from, where they are fewer."""
    tests = rows["role"] == "test"
    recordings, sources = (rows.loc[tests, name].nunique() for name in ("recording", "source"))
    if sources < recordings:
        told = f"The {recordings} recordings come from {{}}, turned, cut or edited: they are not independent"
        if sources == 1:
            yield told.format("1 source") + ", and nothing here speaks of other sources."
            return
        yield (
            told.format(f"{sources} sources")
            + ", and what is said of others rests on sources. Two-way intervals draw "
            "them; mixed models hold what the recordings of a source share, as a whole and reducer by reducer."
        )


# From a tidy table to arrays: what each participant gave each stimulus, and what each metric says of it.


@dataclass(frozen=True, slots=True, eq=False)
class Items:
    """Ratings and metrics of the items of one scale.

    ratings: (n_participants, n_items), naN where there is none; metrics: (n_metrics, n_items);
    recordings: (n_items,), number of the recording that each item was made from, counted from 0;
    sources: (n_recordings,), number of the source that each recording comes from, counted from 0:
    several may be one, turned, cut or edited.
    """

    names: tuple[str, ...]
    ratings: NDArray[np.float64]
    metrics: NDArray[np.float64]
    recordings: NDArray[np.intp]
    sources: NDArray[np.intp] | None = None
    notes: tuple[str, ...] = ()

    @property
    def n_participants(self) -> int:
        """Number of participants."""
        return int(self.ratings.shape[0])

    @property
    def n_items(self) -> int:
        """Number of items."""
        return int(self.ratings.shape[1])

    @property
    def n_recordings(self) -> int:
        """Number of recordings."""
        return int(self.recordings.max()) + 1

    @property
    def of_source(self) -> NDArray[np.intp]:
        """Number of every recording's source."""
        return np.arange(self.n_recordings) if self.sources is None else self.sources

    @property
    def n_sources(self) -> int:
        """Number of sources: what is independent of each other among recordings."""
        return int(self.of_source.max()) + 1

    @property
    def n_missing(self) -> int:
        """Number of cells without a rating."""
        return int(np.isnan(self.ratings).sum())


def make_items(ratings: DataFrame, metrics: Sequence[str]) -> Items:
    """Gather a tidy table of one scale into arrays."""
    ratings, notes = leave_rejected(name_stimuli(open_ratings(ratings)))
    keys = _check_columns(ratings, metrics)
    rows = ratings[ratings["role"] == "test"] if "role" in ratings else ratings
    if rows.empty:
        raise ValueError(
            "ratings: got no row with role 'test'; an association needs rated test stimuli"
        )
    refuse_pooled(rows, metrics=metrics)
    _check_names(rows, ["participant", "recording"])
    rows = rows.assign(**_read_values(rows, ["rating", *metrics]))
    # Sorting by rating too makes the sums below, and so the last digit of every result, independent of row
    # order.
    rows = rows.sort_values([*keys, "participant", "rating"])
    cells = rows.pivot_table("rating", index=keys, columns="participant", observed=True)
    items = rows.groupby(keys, observed=True)[["recording", *metrics]].agg(["first", "nunique"])
    _check_constant(items, ["recording", *metrics])
    return Items(
        names=tuple(
            "/".join(map(str, key)) if isinstance(key, tuple) else str(key) for key in cells.index
        ),
        ratings=cells.to_numpy(np.float64).T.copy(),
        metrics=np.array([items[name, "first"].to_numpy(np.float64) for name in metrics]),
        recordings=np.unique(items["recording", "first"].to_numpy(), return_inverse=True)[1],
        sources=_number_sources(rows) if "source" in rows else None,
        notes=notes,
    )


def _number_sources(rows: DataFrame) -> NDArray[np.intp]:
    from pandas import factorize

    return factorize(find_sources(rows).to_numpy(), sort=True)[0]


def _check_columns(ratings: DataFrame, metrics: Sequence[str]) -> list[str]:
    named = (
        ["stimulus_id"]
        if "stimulus_id" in ratings
        else [name for name in NAMING if name in ratings]
    )
    keys = named if named != ["recording"] else [*named, "reducer"]
    needed = dict.fromkeys(("participant", "recording", "rating", *keys, *metrics))
    missing = ", ".join(name for name in needed if name not in ratings)
    if missing:
        got = ", ".join(map(str, ratings.columns))
        raise ValueError(f"ratings: column {missing} is missing; got {got}")
    return keys


def _check_names(rows: DataFrame, names: Sequence[str]) -> None:
    for name in names:
        missing = int(rows[name].isna().sum())
        if missing:
            raise ValueError(
                f"ratings: got {missing} rows without a {name}; name it or leave them out"
            )


def _read_values(rows: DataFrame, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    found = {name: read_numbers(rows[name], what=f"ratings, {name!r}") for name in names}
    for name, values in found.items():
        if bad := int((~np.isfinite(values)).sum()):
            raise ValueError(
                f"ratings: got {bad} values of '{name}' that are not finite; leave them out"
            )
    return found


def _check_constant(items: DataFrame, names: Sequence[str]) -> None:
    for name in names:
        varying = items.index[items[name, "nunique"] > 1]
        if len(varying):
            stimulus = varying[0]
            raise ValueError(
                f"ratings: '{name}' differs between rows of stimulus {stimulus}; it must not"
            )
