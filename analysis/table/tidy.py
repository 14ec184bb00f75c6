"""Tidy tables in memory, from anywhere: what they may look like, which judgements count, what names the stimulus.

Conventions: every public function that takes such a table passes it through `open_ratings` first. The index of a table
means nothing; a row is one judgement. A judgement marked in a column ``rejected`` does not count, whatever its rating;
the notes count them. A stimulus is named by ``stimulus_id``, or by recording, reducer and level together, or else by
``stimulus`` or ``item``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.table.sheet import NO, YES

if TYPE_CHECKING:
    from collections.abc import Collection

    from pandas import DataFrame, Series

STIMULUS, REJECTED = "stimulus_id", "rejected"
ROLE, TEST = "role", "test"
NAMING = ("recording", "reducer", "level")
"""Columns that together name a stimulus where there is no stimulus_id."""

SPOKEN = ("stimulus", "item")
"""What else the column is called."""


ARMS = ("scale", "level")
"""Columns of which one model or one correlation takes a single value."""


def open_ratings(ratings: DataFrame, *, what: str = "ratings") -> DataFrame:
    """Give a table a plain index, so that no row is matched with another by a label that both happen to have.

    Parameters
    ----------
    ratings : DataFrame
        One row per judgement, with any index: tables put together by ``pandas.concat`` repeat theirs.
    what : str
        What to call it in a message.

    Returns
    -------
    DataFrame
        The same rows in the same order, numbered from 0. A level of the index that has a name which no column has
        becomes a column.

    Raises
    ------
    TypeError
        If it is no DataFrame.
    ValueError
        If two columns have one name.

    Examples
    --------
    >>> import pandas as pd
    >>> day = pd.DataFrame({"rating": [40.0, 60.0]})
    >>> open_ratings(pd.concat([day, day])).index.tolist()
    [0, 1, 2, 3]
    """
    from pandas import DataFrame

    if not isinstance(ratings, DataFrame):
        raise TypeError(f"{what}: got {type(ratings).__name__}, allowed is a pandas DataFrame, one row per judgement")
    named = ratings.index.to_frame(index=False) if any(ratings.index.names) else DataFrame()
    kept = [name for name in named if name in ratings.index.names and name not in ratings]
    table = ratings.reset_index(drop=True).assign(**{str(name): named[name] for name in kept})
    if twice := table.columns[table.columns.duplicated()].tolist():
        raise ValueError(f"{what}: got two columns {twice[0]!r}, allowed is one of each name; rename or drop one")
    return table


def refuse_pooled(rows: DataFrame, *, metrics: Collection[str] = (), what: str = "ratings") -> None:
    """Refuse rows of several scales or several levels: their ratings are not about one thing.

    Parameters
    ----------
    rows : DataFrame
        Judgements that count: scale and level, where there are such columns.
    metrics : collection of str
        Columns that are used as metrics; a level among them (in dB, say) is a number and no arm of a study.
    what : str
        What to call the table in the message.

    Raises
    ------
    ValueError
        If there are two or more of either.
    """
    for column in ARMS:
        names = sorted(map(str, rows[column].unique())) if column in rows and column not in metrics else []
        if len(names) > 1:
            raise ValueError(
                f"{what}: got the {column}s {', '.join(names)}, allowed is one {column}; select its rows first, or fit "
                f"a model to each with fit_attributes(..., attribute={column!r})"
            )


def leave_rejected(ratings: DataFrame) -> tuple[DataFrame, tuple[str, ...]]:
    """Leave out judgements that are marked as rejected.

    Parameters
    ----------
    ratings : DataFrame
        One row per judgement; rejected, if there is one: true, false, 1, 0, yes, no or nothing.

    Returns
    -------
    rows : DataFrame
        Those that count.
    notes : tuple of str
        How many do not; empty if all do.

    Raises
    ------
    ValueError
        If a mark is anything else, or no judgement is left.

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

    Parameters
    ----------
    ratings : DataFrame
        One row per judgement; role, if there is one.

    Returns
    -------
    rows : DataFrame
        Those with role ``test``; all, where no role is told.
    notes : tuple of str
        How many are left out; empty if none is.

    Raises
    ------
    ValueError
        If no test stimulus is left.

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
        raise ValueError(f"ratings: got no row with role 'test' among {n}; it takes rated test stimuli")
    what = "of other stimuli than test stimuli (hidden references, anchors)"
    return ratings[tested], (f"{n} rating {what} is left out." if n == 1 else f"{n} ratings {what} are left out.",)


def _read_marks(marks: Series) -> Series:
    if marks.dtype == bool:
        return marks
    words = marks.astype(object).where(marks.notna(), "").astype(str).str.strip().str.lower().str.removesuffix(".0")
    odd = marks[~words.isin(YES | NO)]
    if len(odd):
        got = f"{odd.iloc[0]!r} in column '{REJECTED}'"
        raise ValueError(f"ratings: got {got}, allowed is true, false, 1, 0, yes, no or nothing")
    return words.isin(YES)


def name_stimuli(ratings: DataFrame) -> DataFrame:
    """Give a table the column ``stimulus_id`` where another column is meant as that.

    Parameters
    ----------
    ratings : DataFrame
        One row per judgement.

    Returns
    -------
    DataFrame
        With stimulus_id from ``stimulus`` or ``item``; as it was where it has one, or where recording and reducer name
        stimuli.

    Raises
    ------
    ValueError
        If two columns say different things about what a stimulus is.

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
    """Give a table the column ``item``, a stimulus, as models take it.

    Parameters
    ----------
    ratings : DataFrame
        One row per judgement.

    Returns
    -------
    DataFrame
        As it was where it has one; else with that of `name_stimuli`, or one per recording, reducer and level.
    """
    if "item" in ratings:
        return ratings
    named = name_stimuli(ratings)
    if STIMULUS in named:
        return named.assign(item=named[STIMULUS])
    if not {"recording", "reducer"} <= set(named):
        return named
    keys = [name for name in NAMING if name in named]
    return named.assign(item=named.groupby(keys, observed=True, dropna=False).ngroup())
