"""Published tables: dissimilarities scaled to a map, and mean ratings related to the metrics, in one call each.

A paper prints means, standard deviations and matrices, not ratings. What needs every rater's ratings cannot be had from
them: no noise ceiling, no screening, no interval over people. What is left, and how far it can be trusted, is said in
the notes of each result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.arrays import FLAT, Values, check_draws, fisher_interval
from feel321.analysis.association.classic import compare_dependent
from feel321.analysis.resampling import bootstrap_margin, draw_counts
from feel321.analysis.space import FEWEST, Space, fit_space
from feel321.analysis.table import metrics as metrics_of
from feel321.analysis.table import schema
from feel321.doors import as_names, as_path, as_rng, check_name
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import PathLike, Rng

MEANS: dict[str, schema.ColumnInfo] = {
    "reducer": schema.ColumnInfo("as in the manifest", kind="name", needed=True),
    "recording": schema.ColumnInfo("as in the manifest; none: means over recordings", kind="name"),
    "mean": schema.ColumnInfo("mean rating, on any scale", kind="known", needed=True),
    "sd": schema.ColumnInfo("standard deviation over raters", kind="known"),
    "n": schema.ColumnInfo("raters", kind="known"),
}
"""One row per stimulus of a published table of means."""

METHODS = ("pearson", "spearman")
FEWEST_ITEMS, FEWEST_RECORDINGS = 4, 4
"""Stimuli that an interval needs, and recordings that can be drawn anew."""

ALIKE = 1e-6
"""Relative difference up to which the two halves of a matrix are the same number."""

_NO_CEILING = (
    "There is no noise ceiling: it needs every rater's ratings, and these are means of them."
)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Published(Result):
    """Correlations of metrics with published mean ratings.

    Parameters
    ----------
    correlations : DataFrame
        A row per metric: ``metric``, ``value``, and the 95 % interval ``low``, ``high``.
    comparisons : DataFrame
        A row per pair of metrics: ``first``, ``second``, ``difference`` of the correlations, ``low``, ``high``.
    n_items, n_recordings : int
        Stimuli, and recordings that they are made from; 0 recordings where the means are over recordings.
    error_share : float
        Mean squared standard error of the means over their variance, from ``sd`` and ``n``; NaN without these.
    method : str
        What was computed.
    notes : tuple of str
        What was left out, and how far the intervals can be trusted.
    """

    correlations: DataFrame
    comparisons: DataFrame
    n_items: int
    n_recordings: int
    error_share: float
    method: str
    notes: tuple[str, ...] = ()

    def to_frame(self) -> DataFrame:
        """Return the correlations as a table.

        Returns
        -------
        DataFrame
            A row per metric.
        """
        return self.correlations


def correlate_published(  # noqa: PLR0913 - which stimuli, and how
    means: PathLike | DataFrame,
    manifest: PathLike | DataFrame,
    *,
    metrics: Sequence[str] | None = None,
    level: str | None = None,
    method: str = "pearson",
    draws: int = 2000,
    rng: Rng = 0,
) -> Published:
    """Correlate published mean ratings with the metrics of the stimuli, and compare the metrics.

    Parameters
    ----------
    means : path or DataFrame
        A row per stimulus: ``reducer`` and ``mean``; ``recording``, unless the means are over recordings; and, where
        the paper gives them, ``sd`` over raters and their number ``n``. Ratings may be on any scale.
    manifest : path or DataFrame
        ``manifest.csv`` of the same recordings and reducers, built from the paper's recordings or from stand-ins.
    metrics : sequence of str, optional
        Numeric columns of the manifest; ``spectral_match_bounded`` and ``temporal_match`` if left out.
    level : str, optional
        Level of the stimuli; needed where the manifest has several.
    method : {"pearson", "spearman"}
        Kind of correlation.
    draws : int
        Bootstrap draws of recordings, at least 2.
    rng : int or Generator
        Seed, or source, of the draws.

    Returns
    -------
    Published
        A correlation per metric, a difference per pair, and what they leave open.

    Raises
    ------
    ValueError
        One line that says which row or column is wrong, and what to do.

    Notes
    -----
    With four recordings or more, the interval is that of a bootstrap of recordings: for R of them, tanh(z ±
    t(.975, R - 1) √(R / (R - 1)) SD(z*)). With fewer, or means over recordings, it is Fisher's (of differences, that of
    Zou [1]_), which takes stimuli for independent and is too narrow. People cannot be drawn anew, so both leave out
    what other raters would say. Means over recordings are related to the metrics' means over recordings.

    ``error_share`` is the mean of sd²/n over the variance of the means. What a rater does alike to all stimuli is in
    sd, but not in the differences between means, so the share is at most that large where the same people rated all.

    References
    ----------
    .. [1] G. Y. Zou, "Toward using confidence intervals to compare correlations", Psychological Methods 12, 2007.
       doi:10.1037/1082-989X.12.4.399

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> means = pd.DataFrame({"reducer": list("abcd"), "mean": [2.0, 3.0, 5.0, 6.5]})
    >>> manifest = pd.DataFrame({"stimulus_id": list("abcd"), "recording": "oak", "reducer": list("abcd"),
    ...     "temporal_match": [0.1, 0.3, 0.4, 0.7]})
    >>> found = analysis.correlate_published(means, manifest, metrics=["temporal_match"])
    >>> bool(0.96 < found.correlations.value[0] < 0.97), found.n_items
    (True, 4)
    """
    check_name(method, METHODS, "method")
    check_draws(draws)
    items, notes = _read_means(means)
    chosen, listed = _read_metrics(manifest, metrics, level)
    values = _join(items, listed, chosen)
    recordings = items["recording"].to_numpy(str) if "recording" in items else None
    given = _Given(items["mean"].to_numpy(np.float64), values, recordings, method)
    share = _find_error_share(items)
    drawn = given.draw(draws, rng) if given.n_recordings >= FEWEST_RECORDINGS else None
    return Published(
        correlations=_tabulate(given, chosen, drawn), comparisons=_compare(given, chosen, drawn),
        n_items=len(items), n_recordings=given.n_recordings, error_share=share, method=method,
        notes=(*notes, *_note_unused(items, listed), *_note_limits(given, share)),
    )  # fmt: skip


def map_published(
    dissimilarities: PathLike | DataFrame,
    *,
    names: Sequence[str] | None = None,
    dimensions: int = 2,
    ordinal: bool = False,
    rng: Rng = 0,
) -> Space:
    """Scale a published matrix of dissimilarities to a map.

    Parameters
    ----------
    dissimilarities : path or DataFrame
        A square CSV table: names of the stimuli in the first line and in the first column, in any order. Numbers are 0
        or more, larger for what differs more. One half may be left empty, and so may the diagonal.
    names : sequence of str, optional
        Take these stimuli only, in this order: that of another map, to be aligned with it.
    dimensions : int
        Of the map, 1 to stimuli - 1.
    ordinal : bool
        Use only the order of the dissimilarities.
    rng : int or Generator
        Seed, or source, of the random starts.

    Returns
    -------
    Space
        The map with the stimuli's names. It has no ellipses: they need every rater's matrix.

    Raises
    ------
    ValueError
        One line that names the row or pair that is wrong, and what to do.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> names = ["dft321", "sax321", "mag321"]
    >>> half = pd.DataFrame([["", 3, 4], ["", "", 5], ["", "", ""]], index=names, columns=names)
    >>> found = analysis.map_published(half)
    >>> found.names, found.stress < 1e-3
    (('dft321', 'sax321', 'mag321'), True)
    """
    labels, matrix = read_matrix(dissimilarities)
    if names is not None:
        wanted = as_names(names, "names")
        places = [labels.index(check_name(name, labels, "names")) for name in wanted]
        labels, matrix = wanted, matrix[np.ix_(places, places)]
    found = fit_space(matrix, dimensions=dimensions, ordinal=ordinal, rng=rng)
    return replace(found, names=tuple(labels))


def read_matrix(source: PathLike | DataFrame) -> tuple[tuple[str, ...], Values]:
    """Read a square labelled matrix; where one half is empty it is that of the other."""
    what, labels, cells = _read_square(source)
    matrix = np.full(cells.shape, np.nan)
    for row, column in np.ndindex(*cells.shape):
        text = str(cells[row, column]).strip()
        pair = f"{what}, row {labels[row]!r}, column {labels[column]!r}"
        matrix[row, column] = _read_cell(text, pair) if text else np.nan
    diagonal = np.diag(matrix)
    if np.nansum(np.abs(diagonal)):
        place = int(np.nanargmax(np.abs(diagonal)))
        raise ValueError(
            f"{what}: {labels[place]!r} differs from itself by {diagonal[place]:g}, must be 0 or empty; similarities "
            "must first be converted to dissimilarities (the largest value minus each)"
        )
    np.fill_diagonal(matrix, 0.0)
    return labels, _fill_halves(matrix, labels, what)


def _fill_halves(matrix: Values, labels: tuple[str, ...], what: str) -> Values:
    """Take an empty cell's number from the other half; both must be the same number."""
    filled: Values = np.where(np.isnan(matrix), matrix.T, matrix)
    for row, column in np.argwhere(~np.isclose(filled, filled.T, rtol=ALIKE, atol=0.0)):
        pair = f"{labels[row]!r} and {labels[column]!r}"
        if np.isnan(filled[row, column]):
            raise ValueError(f"{what}: no number for {pair}; give every pair in one half or both")
        raise ValueError(
            f"{what}: {pair} differ by {matrix[row, column]:g} and by {matrix[column, row]:g}; must be one number, "
            "average the two orders first"
        )
    return filled


def _read_square(source: PathLike | DataFrame) -> tuple[str, tuple[str, ...], NDArray[np.str_]]:
    """Read names and cells, and put the columns into the order of the rows."""
    from pandas import DataFrame

    what = "dissimilarities"
    if isinstance(source, DataFrame):
        table = schema.read_cells(source.rename_axis(None).reset_index())
    else:
        path = as_path(source, what)
        what, table = path.name, _read_text(path)
    rows = tuple(table.iloc[:, 0].str.strip())
    columns = tuple(str(name).strip() for name in table.columns[1:])
    doubled = {name for names in (rows, columns) for name in names if names.count(name) > 1}
    if doubled or sorted(rows) != sorted(columns) or len(rows) < FEWEST:
        odd = sorted(doubled or set(rows) ^ set(columns))
        told = (
            f"; not once in both: {', '.join(map(schema.shorten, odd[:FEWEST_ITEMS]))}"
            if odd
            else ""
        )
        raise ValueError(
            f"{what}: must be square, with the same {FEWEST} or more names in the first line and the first column, got "
            f"{len(rows)} rows and {len(columns)} columns{told}"
        )
    order = [columns.index(name) for name in rows]
    return what, rows, table.iloc[:, 1:].to_numpy(str)[:, order]


def _read_text(path: Path) -> DataFrame:
    import pandas as pd

    try:
        return schema.read_cells(path)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path.name}: not a regular CSV file in UTF-8 ({reason})") from None


def _read_cell(text: str, pair: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 <= value < float("inf"):
        raise ValueError(
            f"{pair}: must be a number of 0 or more, or empty, got {schema.shorten(text)}"
        )
    return value


def is_matrix(path: PathLike) -> bool:
    """Find out whether a file is a matrix rather than a table of means, by its first line."""
    return not {"reducer", "mean"} <= set(schema.read_header(as_path(path)))


# Means, joined with the metrics.


def _open(source: PathLike | DataFrame, what: str) -> tuple[Path | DataFrame, str]:
    """Find a table's file, or the table in memory, and what messages call it."""
    from pandas import DataFrame

    given = source if isinstance(source, DataFrame) else as_path(source, what)
    return given, what if isinstance(given, DataFrame) else given.name


def _read_means(source: PathLike | DataFrame) -> tuple[DataFrame, list[str]]:
    given, what = _open(source, "means")
    table, notes = schema.read_sheet(given, what, MEANS)
    for name, column in MEANS.items():
        schema.read_column(table, name, what, kind=column.kind, empty=name != "mean")
    for name, least in (("sd", 0), ("n", 2)):
        if name in table:
            bad = table.loc[table[name] < least, name]
            schema.refuse_lines(bad, what, must=f"be {least} or more, or empty")
    keys = [name for name in ("recording", "reducer") if name in table]
    twice = table.loc[table.duplicated(keys), "reducer"]
    schema.refuse_lines(twice, what, must="occur once (per recording)", do="keep one of the rows")
    return table, notes


def _read_metrics(
    source: PathLike | DataFrame, metrics: Sequence[str] | None, level: str | None
) -> tuple[tuple[str, ...], DataFrame]:
    """Read the test stimuli of one level and their metrics."""
    given, what = _open(source, "manifest")
    names = None if metrics is None else as_names(metrics, "metrics")
    known = metrics_of.describe_manifest(names or schema.PLANNED)
    table, _ = schema.read_sheet(given, what, known)
    chosen = names or tuple(
        name if name in table else schema.STAND_INS.get(name, name) for name in schema.PLANNED
    )
    if absent := [name for name in chosen if name not in table]:
        raise ValueError(f"{what}: no column {', '.join(absent)}; name others with metrics")
    if "role" in table:
        table = table[table["role"] == "test"]
    levels = sorted(set(table["level"])) if "level" in table else []
    if level is not None or len(levels) > 1:
        table = table[table["level"] == check_name(level or "", levels, "level")]
    table = table.copy()
    for name in chosen:
        schema.read_column(table, name, what, kind="metric", empty=False)
    return chosen, table


def _join(means: DataFrame, listed: DataFrame, metrics: Sequence[str]) -> Values:
    """Find the metrics, (n_metrics, n_items), of every published mean."""
    keys = ["recording", "reducer"] if "recording" in means else ["reducer"]
    found = listed.groupby(keys)[list(metrics)].mean()
    wanted = list(means[keys].itertuples(index=False, name=None))
    rows = [row if len(keys) > 1 else row[0] for row in wanted]
    if lacking := [row for row in rows if row not in found.index]:
        name = " of ".join(reversed(lacking[0])) if len(keys) > 1 else lacking[0]
        have = ", ".join(sorted(set(listed["reducer"])))
        raise ValueError(
            f"means: the manifest has no test stimulus {name!r}; its reducers are {have}, its recordings "
            f"{', '.join(sorted(set(listed['recording'])))}; rename the rows, or build the stimuli"
        )
    values = found.loc[rows].to_numpy(np.float64).T
    _check_varied(
        {"mean": means["mean"].to_numpy(np.float64)} | dict(zip(metrics, values, strict=True))
    )
    return values


def _check_varied(columns: Mapping[str, Values]) -> None:
    for name, row in columns.items():
        if len(row) < FEWEST_ITEMS:
            raise ValueError(
                f"means: got {len(row)} rows, a correlation needs {FEWEST_ITEMS} or more"
            )
        if not np.ptp(row):
            raise ValueError(
                f"{name} is {row[0]:g} for every stimulus; its correlation is undefined"
            )


class _Given(NamedTuple):
    """Mean ratings, (n_items,), metrics, (n_metrics, n_items), and the recordings of the items, if they are known."""

    means: Values
    values: Values
    recordings: NDArray[np.str_] | None
    method: str

    @property
    def n_recordings(self) -> int:
        return 0 if self.recordings is None else len(set(self.recordings))

    def correlate(self, places: Values | slice = slice(None)) -> Values:
        """Correlate every row, means and metrics, with every other; NaN where one is constant."""
        rows = np.vstack([self.means, self.values])[:, places]
        if self.method == "spearman":
            from scipy.stats import rankdata

            rows = rankdata(rows, axis=1)
        flat = np.ptp(rows, axis=1) <= FLAT * np.abs(rows).max(axis=1)
        rows = rows - rows.mean(axis=1, keepdims=True)
        norms = np.sqrt(np.square(rows).sum(axis=1))
        norms[flat] = np.nan
        return np.asarray(np.clip(rows @ rows.T / np.outer(norms, norms), -1, 1))

    def draw(self, draws: int, rng: Rng) -> Values:
        """Draw recordings anew: Fisher's z of every metric, (n_metrics, draws)."""
        names = sorted(set(() if self.recordings is None else self.recordings.tolist()))
        members = [np.flatnonzero(self.recordings == name) for name in names]
        found = np.full((len(self.values), draws), np.nan)
        for place, counts in enumerate(draw_counts(len(names), draws, rng=as_rng(rng))):
            items = np.concatenate([
                np.repeat(one, n) for one, n in zip(members, counts, strict=True)
            ])
            found[:, place] = self.correlate(items)[0, 1:]
        with np.errstate(divide="ignore"):
            z = np.arctanh(found)
        return np.where(np.isfinite(z), z, np.nan)


def _tabulate(given: _Given, metrics: Sequence[str], drawn: Values | None) -> DataFrame:
    from pandas import DataFrame

    rows = []
    for place, (name, r) in enumerate(zip(metrics, given.correlate()[0, 1:], strict=True)):
        if drawn is None:
            low, high = fisher_interval(r, len(given.means) - 3)
        else:
            margin = bootstrap_margin(drawn[place], given.n_recordings)
            low, high = np.tanh(np.arctanh(r) + np.array([-margin, margin]))
        rows.append({"metric": name, "value": float(r), "low": float(low), "high": float(high)})
    return DataFrame(rows, columns=["metric", "value", "low", "high"])


def _compare(given: _Given, metrics: Sequence[str], drawn: Values | None) -> DataFrame:
    from pandas import DataFrame

    found, n, rows = given.correlate(), len(given.means), []
    for first, second in combinations(range(len(metrics)), 2):
        r_first, r_second = float(found[0, first + 1]), float(found[0, second + 1])
        if drawn is None:
            tested = compare_dependent(r_first, r_second, float(found[first + 1, second + 1]), n)
            low, high = tested.zou_low, tested.zou_high
        else:
            margin = bootstrap_margin(drawn[first] - drawn[second], given.n_recordings)
            z, middle = np.arctanh(r_first), np.arctanh(r_second)
            ends = z - middle + np.array([-margin, margin])
            middle = (z + middle) / 2
            low, high = np.tanh(middle + ends / 2) - np.tanh(middle - ends / 2)
        rows.append({
            "first": metrics[first], "second": metrics[second], "difference": r_first - r_second,
            "low": float(low), "high": float(high),
        })  # fmt: skip
    return DataFrame(rows, columns=["first", "second", "difference", "low", "high"])


def _find_error_share(items: DataFrame) -> float:
    if "sd" not in items or "n" not in items:
        return float("nan")
    errors = (items["sd"] ** 2 / items["n"]).dropna()
    return float(errors.mean() / items["mean"].var(ddof=1)) if len(errors) else float("nan")


def _note_unused(items: DataFrame, listed: DataFrame) -> list[str]:
    lost = sorted(set(listed["reducer"]) - set(items["reducer"]))
    return (
        [f"Reducers of the manifest without a published mean: {', '.join(lost)}."] if lost else []
    )


def _note_limits(given: _Given, share: float) -> Iterable[str]:
    yield _NO_CEILING
    if not np.isnan(share):
        bound = max(0.0, 1 - share) ** 0.5
        yield (
            f"Standard errors account for at most about {100 * share:.2g} % of the variance between means if the same "
            f"people rated everything; a perfect metric would then reach about {bound:.2f} or more."
        )
    if given.recordings is None:
        yield "Means are over recordings: they are related to the metrics' means over the manifest's recordings."
    if given.n_recordings < FEWEST_RECORDINGS:
        yield "Intervals take stimuli for independent draws; they are too narrow for stimuli of few recordings."
    else:
        yield "Intervals are over recordings only: variation between people is not included."
