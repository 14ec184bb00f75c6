"""Ratings in memory: the table, the rows that count, and arrays of ratings and metrics per item.

Conventions: an item is a stimulus; a cell is the mean of a participant's repeated ratings of an item, NaN for none;
only items with role ``test`` count, because the hidden reference and the anchors are chosen to be far apart and would
inflate every correlation. The index of a table means nothing (`open_ratings`), a row is one judgement; one marked in a
column ``rejected`` does not count, and the notes count them. A stimulus is named by ``stimulus_id``, or by recording,
reducer and level together, or else by ``stimulus`` or ``item``. Intervals draw sources, with all their recordings, and
mixed models hold what the recordings of a source share.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pandas import DataFrame, Series, factorize

from feel321.analysis.arrays import Values, check_columns, read_numbers
from feel321.analysis.table.schema import APART, HIGHEST, NAMING, NO, PAIRED, RECAST, YES
from feel321.analysis.words import capitalise, format_level, format_name
from feel321.arguments import as_names, check_name
from feel321.records import Result
from feel321.types import MetricInfo

STIMULUS, REJECTED = "stimulus_id", "rejected"
ROLE, TEST = "role", "test"
OTHER = "other_id"  # Column of the second stimulus of a choice
SPOKEN = ("stimulus", "item")  # Other names of the column `stimulus_id`
ARMS = ("scale", "level")  # Columns of which one model or one correlation takes a single value


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Table(Result):
    """Ratings and metrics, side by side.

    Parameters
    ----------
    rows : DataFrame
        One row per judgement: participant, stimulus_id, reference_id, reference_reducer and other_id (which may be
        empty), source, recording, reducer, level, role, matched, scale, repeat, rating, simulated, protocol and
        response_time_s if there are any, one column per metric and further metric, rms_m_s2 if there is one, one per
        label of the participants. The role is the one that the stimulus had in that judgement; matched is whether the
        metrics describe that judgement; a dissimilarity is about the stimulus compared with the reference.
    metrics : tuple of str
        The metrics that the primary analysis is about, as they were declared.
    notes : tuple of str
        What was left out and what was assumed, one sentence each.
    further : tuple of str
        Columns of metrics that are explored only.
    info : Mapping of str to MetricInfo
        What each metric declares of itself: which way it points, its bounds, label and unit.
    stimuli : DataFrame, indexed by stimulus_id, optional
        Every stimulus of the manifest, rated or not: source, recording, reducer, level, role and metrics; where
        dissimilarities were rated, every other numeric column too.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> ratings = pd.DataFrame({"participant": list("aabb"), "stimulus_id": list("xyxy"), "scale": "realism",
    ...     "trial": [1, 2, 1, 2], "rating": [20, 70, 30, 90]})
    >>> manifest = pd.DataFrame({"stimulus_id": list("xy"), "recording": "tap", "reducer": ["mag321", "dft321"],
    ...     "level": "as_is", "role": "test", "temporal_match": [0.2, 0.9]})
    >>> table = analysis.read_table(ratings, manifest)
    >>> table.select(scale="realism").votes()
    participant     a     b
    stimulus_id
    x            20.0  30.0
    y            70.0  90.0
    """

    rows: DataFrame
    metrics: tuple[str, ...]
    notes: tuple[str, ...]
    further: tuple[str, ...] = ()
    info: Mapping[str, MetricInfo] = field(default_factory=dict)
    stimuli: DataFrame | None = None

    def select(self, scale: str | None = None, *, level: str | None = None) -> Table:
        """Select the ratings of one scale or level; metrics and notes are the same.

        Parameters
        ----------
        scale, level : str, optional
            Its name; all if left out.
        """
        return replace(self, rows=_choose(self.rows, scale, level))

    def votes(self) -> DataFrame:
        """Lay ratings of test stimuli out, (items, raters): means over repeats, NaN where there is none."""
        rows, _ = open_tests(self)
        return rows.pivot_table("rating", STIMULUS, "participant", observed=True)

    def to_frame(self) -> DataFrame:
        """Return a copy of the judgements."""
        return self.rows.copy()

    def summary(self) -> str:
        """Write what the table holds: counts, metrics and notes, one per line."""
        names = ("participant", STIMULUS, "recording", "reducer", *ARMS)
        counts = (f"{self.rows[name].nunique()} {name.removesuffix('_id')}s" for name in names)
        held = f"{len(self.rows)} judgements: {', '.join(counts)}"
        return "\n".join((held, f"metrics: {', '.join(self.metrics)}", *self.notes))


def is_tidy(given: object) -> TypeGuard[Table | DataFrame]:
    """Tell whether these are ratings, one row per judgement, and not an array of them."""
    columns = set(getattr(given, "columns", ()))
    return isinstance(given, Table) or {"participant", "rating"} <= columns


def as_votes(given: Table | ArrayLike) -> ArrayLike:
    """Lay ratings of one scale and level out as items by raters; anything else is taken as that already."""
    return make_items(given, ()).ratings.T if is_tidy(given) else given  # type: ignore[return-value]  # no ratings, so an array


def open_ratings(ratings: Table | DataFrame, *, what: str = "ratings") -> DataFrame:
    """Give ratings a plain index, so that no row is matched with another by a label that both happen to have."""
    ratings = ratings.rows if isinstance(ratings, Table) else ratings
    if not isinstance(ratings, DataFrame):
        got = type(ratings).__name__
        raise TypeError(f"{what} must be a Table or a DataFrame, one row per judgement, got {got}")
    named = ratings.index.to_frame(index=False) if any(ratings.index.names) else DataFrame()
    kept = [name for name in named if name in ratings.index.names and name not in ratings]
    table = ratings.reset_index(drop=True).assign(**{str(name): named[name] for name in kept})
    if twice := table.columns[table.columns.duplicated()].tolist():
        raise ValueError(f"{what} must have one column of each name, got two columns {twice[0]!r}")
    return table


def _choose(rows: DataFrame, scale: str | None, level: str | None) -> DataFrame:
    for column, name in zip(ARMS, (scale, level), strict=True):
        if name is not None:
            known = rows[column].astype(str) if column in rows else rows.index.astype(str)[:0]
            rows = rows[known == check_name(name, sorted(known.unique()), column)]
    return rows.reset_index(drop=True)


def choose_arms(
    ratings: Table | DataFrame, scale: str | None = None, level: str | None = None
) -> Table | DataFrame:
    """Take the ratings of one scale and level where these are named; of a DataFrame, with a plain index."""
    if isinstance(ratings, Table):
        return ratings.select(scale, level=level)
    return _choose(open_ratings(ratings), scale, level)


def choose_metrics(ratings: Table | DataFrame, metrics: Iterable[str] | None) -> tuple[str, ...]:
    """Take the metrics that are named, each once, or a Table's own where none are."""
    own = ratings.metrics if isinstance(ratings, Table) else ()
    names = tuple(dict.fromkeys(as_names(own if metrics is None else metrics, "metrics")))
    if not names:
        raise ValueError("metrics must be a list of one name or more, got none; name columns")
    return names


def refuse_pooled(rows: DataFrame, *, metrics: Collection[str] = (), what: str = "ratings") -> None:
    """Refuse rows of several scales or several levels: their ratings are not about one thing."""
    for column in (name for name in ARMS if name in rows and name not in metrics):
        names = sorted(map(str, rows[column].unique()))
        if len(names) > 1:
            got = f"{what} must be of one {column}, got the {column}s {', '.join(names)}"
            how = f"select one, as with table.select({column}=...), or use fit_attributes"
            raise ValueError(f"{got}; {how}")


def leave_rejected(
    ratings: DataFrame, *, what: str = "ratings"
) -> tuple[DataFrame, tuple[str, ...]]:
    """Leave out judgements that are marked as rejected."""
    if REJECTED not in ratings:
        return ratings, ()
    marks = ratings[REJECTED]
    words = marks.astype(object).where(marks.notna(), "").astype(str).str.strip().str.lower()
    words = words.str.removesuffix(".0")
    if len(odd := marks[~words.isin(YES | NO)]):
        must = "true, false, 1, 0, yes, no or empty"
        raise ValueError(f"ratings: column '{REJECTED}' must be {must}, got {odd.iloc[0]!r}")
    rejected = words.isin(YES)
    if not (n := int(rejected.sum())):
        return ratings, ()
    if n == len(ratings):
        raise ValueError(f"{what}: all {n} judgements are marked as rejected; one must be valid")
    left = "judgement marked as rejected is" if n == 1 else "judgements marked as rejected are"
    return ratings[~rejected], (f"{n} {left} left out.",)


def leave_untested(ratings: DataFrame) -> tuple[DataFrame, tuple[str, ...]]:
    """Leave out hidden references and anchors: chosen to be far apart, they would inflate every slope."""
    if ROLE not in ratings or (tested := ratings[ROLE] == TEST).all():
        return ratings, ()
    n = int((~tested).sum())
    if n == len(ratings):
        raise ValueError(f"ratings must be of test stimuli, got no row with role 'test' among {n}")
    what = f"rating{'s' * (n > 1)} of other stimuli than test stimuli (hidden references, anchors)"
    return ratings[tested], (f"{n} {what} {'are' if n > 1 else 'is'} left out.",)


def name_stimuli(ratings: DataFrame) -> DataFrame:
    """Give a table the column ``stimulus_id``, where recording, reducer and level, or another column, name stimuli."""
    if STIMULUS in ratings:
        return ratings
    if {"recording", "reducer"} <= set(ratings):
        parts = ratings[[name for name in NAMING if name in ratings]]
        written = parts.astype(str)
        names = written.iloc[:, 0].str.cat(written.iloc[:, 1:], sep="/")
        return ratings.assign(**{STIMULUS: names.where(parts.notna().all(axis=1))})
    spoken = next((name for name in SPOKEN if name in ratings), None)
    return ratings.assign(**{STIMULUS: ratings[spoken]}) if spoken else ratings


def name_items(ratings: DataFrame) -> DataFrame:
    """Give a table the column ``item``, a stimulus, as models take it."""
    if "item" in ratings:
        return ratings
    named = name_stimuli(ratings)
    return named.assign(item=named[STIMULUS]) if STIMULUS in named else named


def open_tests(
    ratings: Table | DataFrame, metrics: Iterable[str] = (), *, named: Sequence[str] = ()
) -> tuple[DataFrame, tuple[str, ...]]:
    """Open the ratings of test stimuli of one scale and level, with finite ratings and metrics; also notes."""
    metrics = as_names(metrics, "metrics")
    table, notes = leave_rejected(name_stimuli(open_ratings(ratings)))
    names = ["participant", *named, *[STIMULUS] * ("recording" in named)]
    check_columns(table, [*names, "rating", *metrics], "ratings")
    rows = table[table[ROLE] == TEST] if ROLE in table else table
    if isinstance(ratings, Table) and not (matched := rows["matched"]).all():
        rows = rows[matched]
        notes += (f"{(~matched).sum()} judgements against other references are left out.",)
    if rows.empty:
        raise ValueError("ratings must be of test stimuli, got no row with role 'test'")
    refuse_pooled(rows, metrics=metrics)
    refuse_unnamed(rows, names)
    return read_finite(rows, ["rating", *metrics]), notes


def refuse_unnamed(rows: DataFrame, names: Iterable[str], *, what: str = "ratings") -> None:
    """Refuse rows without a name: grouped by it they would be dropped in silence."""
    for name in names:
        if missing := int(rows[name].isna().sum()):
            must, do = f"{what} must name a {name} in each row", "name it or leave them out"
            raise ValueError(f"{must}, got {missing} without; {do}")


def read_finite(rows: DataFrame, names: Iterable[str], *, what: str = "ratings") -> DataFrame:
    """Read columns of numbers, none of them missing."""
    for name in names:
        numbers = read_numbers(rows[name], what=f"{what}, {name!r}")
        if bad := int((~np.isfinite(numbers)).sum()):
            got = f"got {bad} values that are not finite; leave them out"
            raise ValueError(f"{what}: column '{name}' must be finite, {got}")
        rows = rows.assign(**{name: numbers})
    return rows


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Ratings on one scale and one level; several: whether there are other levels; thinned: a note."""

    scale: str
    level: str
    rows: DataFrame
    several: bool = False
    thinned: str = ""

    @property
    def ratings(self) -> str:
        """How to call it within a sentence."""
        return f"{format_name(self.scale)} ratings" + format_level(self.level * self.several)

    @property
    def subject(self) -> str:
        """How to call it at the head of a line."""
        return capitalise(format_name(self.scale)) + format_level(self.level * self.several)

    @property
    def place(self) -> tuple[str, str]:
        """Scale and level."""
        return self.scale, self.level

    @property
    def lead(self) -> str:
        """What leads a note."""
        return f"{self.scale}, {self.level}"

    @property
    def keys(self) -> dict[str, str]:
        """What a row says of it."""
        return {"scale": self.scale, "level": self.level}


def split_arms(rows: DataFrame) -> Iterator[Part]:
    """Split rows by scale, in their order, and level, by name."""
    arms = dict(tuple(rows.groupby(list(ARMS), observed=True)))
    order = {scale: place for place, scale in enumerate(rows["scale"].unique())}
    several = len({level for _, level in arms}) > 1
    for scale, level in sorted(arms, key=lambda arm: (order[arm[0]], arm[1])):
        yield Part(str(scale), str(level), arms[scale, level], several)


def select_tests(ratings: Table | DataFrame, *, matched: bool = True) -> DataFrame:
    """Select the ratings of single test stimuli; matched: those that the metrics describe."""
    rows = open_ratings(ratings)
    rows = rows.assign(**{name: "" for name in ARMS if name not in rows})
    refuse_unnamed(rows, ARMS)
    rows = recast_pairs(rows)
    rated = ~rows["scale"].isin(APART)
    if ROLE in rows:
        rated &= rows[ROLE] == TEST
    if matched and "matched" in rows:
        rated &= rows["matched"]
    rows = rows[rated]
    return rows.assign(item=rows[STIMULUS]) if STIMULUS in rows else rows


def split_tests(ratings: Table | DataFrame, *, matched: bool = True) -> Iterator[Part]:
    """Split the ratings of test stimuli by scale and level."""
    return split_arms(select_tests(ratings, matched=matched))


def recast_pairs(rows: DataFrame) -> DataFrame:
    """Let a dissimilarity from the original be a rating of what was compared with it: 100 less the dissimilarity."""
    if ROLE not in rows or not (turned := (rows["scale"] == PAIRED) & (rows[ROLE] == TEST)).any():
        return rows
    scale = rows["scale"].mask(turned, RECAST)
    return rows.assign(scale=scale, rating=rows["rating"].mask(turned, HIGHEST - rows["rating"]))


def find_sources(rows: Table | DataFrame) -> Series:
    """Find what each recording of a tidy table was made from, itself where nothing is said; indexed by recording."""
    table = open_ratings(rows, what="rows")
    check_columns(table, ["recording"], "rows")
    named = [name for name in ("recording", "source") if name in table]
    pairs = table[named].drop_duplicates().astype(object).sort_values("recording")
    found = pairs.set_index("recording", drop=False)[named[-1]].rename("source")
    if len(twice := found.index[found.index.duplicated()]):
        got = f"got two sources of recording {twice[0]}"
        raise ValueError(f"ratings must have one source per recording, {got}")
    return found.where(found.notna() & (found != ""), found.index)


def format_recordings(recordings: int, sources: int) -> str:
    """Say how many recordings there are, and of how many sources: "12 recordings of 4 sources"."""
    of = "" if sources >= recordings else f" of {sources} source{'s' if sources != 1 else ''}"
    return f"{recordings} recording{'s' if recordings != 1 else ''}{of}"


@dataclass(frozen=True, slots=True, eq=False)
class Items:
    """Ratings and metrics of the items of one scale.

    ratings: (n_participants, n_items), NaN where there is none; metrics: (n_metrics, n_items); recordings: (n_items,),
    number of the recording that each item was made from, from 0; sources: (n_recordings,), number of the source of each
    recording, from 0.
    """

    names: tuple[str, ...]
    ratings: Values
    metrics: Values
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


def make_items(ratings: Table | DataFrame, metrics: Sequence[str]) -> Items:
    """Gather a tidy table of one scale into arrays."""
    rows, notes = open_tests(ratings, metrics, named=["recording"])
    item, names = factorize(rows[STIMULUS], sort=True)
    person = factorize(rows["participant"], sort=True)[0]
    rating = rows["rating"].to_numpy()
    # Sorting by rating too makes the sums below, and so the last digit of every result, independent of row order.
    order = np.lexsort((rating, person, item))
    item, person = item[order], person[order]
    first = np.searchsorted(item, np.arange(len(names)))
    facts = {}
    for name in ("recording", *metrics):
        values = rows[name].to_numpy()[order]
        facts[name] = values[first]
        if len(varying := item[values != facts[name][item]]):
            must = f"ratings: column '{name}' must be the same in all rows of a stimulus"
            raise ValueError(f"{must}, got several for {names[varying[0]]}")
    cells = np.full((person.max() + 1, len(names)), np.nan)
    means = Series(rating[order]).groupby(item * len(cells) + person).mean()
    cells[means.index % len(cells), means.index // len(cells)] = means
    recordings = np.unique(facts["recording"], return_inverse=True)[1]
    sources = None
    if "source" in rows:
        sources = factorize(find_sources(rows).to_numpy(), sort=True)[0]
    values = np.array([facts[name] for name in metrics])
    return Items(tuple(map(str, names)), cells, values, recordings, sources, notes)
