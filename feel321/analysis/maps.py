"""Maps of dissimilarities per interaction and surface: how they agree, and what their axes are associated with.

Conventions: as in `feel321.analysis.space`. A map is of one group of recordings; every map has the same stimuli
(reducers) in the same order, and is turned onto the map of all recordings, so that its axes mean the same. Attributes
are compared within recordings: with every map centred, what differs between recordings has no part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.space import (
    align_spaces,
    bootstrap_space,
    fit_space,
    gather_dissimilarities,
    make_space,
)
from feel321.analysis.table.schema import LABELS, PAIRED
from feel321.names import METRIC_INFO, REDUCER_NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.arrays import Values
    from feel321.records import Statistic

ALL, BOTH, RECORDING = "all", "interaction and sample", "recording"
"""Kinds of groups: every recording, every interaction at every sample, each recording; others are `LABELS`."""

FEWEST = 5
"""Stimuli below which no permutation of them can show much: 1 / 4! = 0.042 is the least p of four."""

ENOUGH = 10  # Points for each attribute that a regression wants
MOST_GROUPS = 24  # Interactions at samples beyond which these are not mapped one by one
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class GroupMap:
    """The map of a group of recordings: the kind of group, its name, and each participant's dissimilarities.

    matrices: (participants, n, n); space: turned onto the map of all recordings; ellipses: of an interaction or a
    sample, where the stimuli would lie with other participants.
    """

    kind: str
    name: str
    names: tuple[str, ...]
    matrices: Values
    space: Statistic
    ellipses: Statistic | None = None
    n_recordings: int = 0


def split_groups(rows: DataFrame) -> Iterator[tuple[str, str, DataFrame]]:
    """Split dissimilarities by interaction, by sample and by both, as far as recordings differ in them."""
    labels = [name for name in LABELS if name in rows and len(rows[name].unique()) > 1]
    for kind in labels:
        for name, part in rows[rows[kind] != ""].groupby(kind, observed=True):
            yield kind, str(name), part
    cells = rows.groupby(labels, observed=True) if len(labels) == len(LABELS) else ()
    if labels and len(cells) <= MOST_GROUPS:
        for names, part in cells:
            if all(names):
                yield BOTH, ", ".join(map(str, names)), part


def map_groups(rows: DataFrame, *, draws: int, rng: np.random.Generator) -> list[GroupMap]:
    """Map all recordings, and each group of them whose pairs were all rated; the map of all comes first."""
    rows = rows[(rows["scale"] == PAIRED) & (rows["reference_reducer"] != "")]
    found = [map_all(rows, rng=rng)]
    names, whole = found[0].names, found[0].space
    for kind, name, part in split_groups(rows):
        try:
            own_names, own = gather_dissimilarities(part)
            space, ellipses = _place(own, whole, draws=0 if kind == BOTH else draws, rng=rng)
        except ValueError:
            continue
        if own_names == names:
            n = len(part[RECORDING].unique())
            found.append(GroupMap(kind, name, names, own, space, ellipses, n))
    return found


def map_all(rows: DataFrame, *, rng: np.random.Generator) -> GroupMap:
    """Map all recordings together."""
    names, matrices = gather_dissimilarities(rows)
    space, n = fit_space(matrices, rng=rng), len(rows[RECORDING].unique())
    return GroupMap(ALL, ALL, names, matrices, space, n_recordings=n)


def _place(
    matrices: Values, whole: Statistic, *, draws: int, rng: np.random.Generator
) -> tuple[Statistic, Statistic | None]:
    """Map a group and turn its map, with its ellipses if there are draws, onto the map of all."""
    ellipses = bootstrap_space(matrices, draws=draws, rng=rng) if draws else None
    space = ellipses.space if ellipses else fit_space(matrices, rng=rng)
    if len(space.positions) != len(whole.positions):
        raise ValueError("the group lacks a stimulus")
    turned, (start, sign) = turn_map(space, whole)
    if ellipses:
        ellipses = ellipses.replace(space=turned, angle=(start + sign * ellipses.angle) % 180)
    return turned, ellipses


def turn_map(space: Statistic, reference: Statistic) -> tuple[Statistic, tuple[float, float]]:
    """Turn and mirror a map onto another, its size as it is; also what becomes of an angle a in degrees: c + s a."""
    one, other = (place - place.mean(axis=0) for place in (space.positions, reference.positions))
    left, _, right = np.linalg.svd(one.T @ other)
    turn = left @ right
    # A row vector at angle a goes to a + c under a rotation, and to c - a under a mirror.
    angle = math.degrees(math.atan2(turn[0, 1], turn[0, 0]))
    sign = float(np.sign(np.linalg.det(turn)))
    turned = make_space(one @ turn, space.stress, ordinal=space.ordinal, names=space.names)
    return turned, (angle, sign)


def compare_groups(
    maps: Sequence[GroupMap], *, permuted: int, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Compare the map of each group with that of all recordings, and those of one kind with each other."""
    whole, *others = maps
    pairs = [(one, whole) for one in others]
    pairs += [
        (one, two)
        for one, two in combinations(others, 2)
        if one.kind == two.kind and one.kind != BOTH
    ]
    rows = []
    for one, two in pairs:
        found = align_spaces(one.space, two.space, permutations=permuted, rng=rng)
        rows.append({
            "kind": one.kind, "first": one.name, "second": two.name, "correlation": found.correlation,
            "disparity": found.disparity, "p": found.p, "permutations": permuted, "n": len(one.names),
        })  # fmt: skip
    return rows


# What the axes are associated with: every stimulus of every recording is a point.


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Stimuli of each recording on the recording's own map, turned onto the map of all; and what they are like.

    places: (n_maps, n_stimuli, 2); attributes: by name, (n_maps, n_stimuli), NaN where a stimulus has no such number.
    """

    places: Values
    attributes: dict[str, Values]
    stimuli: tuple[str, ...]

    @property
    def size(self) -> int:
        """How many points there are."""
        return int(self.places.shape[0] * self.places.shape[1])

    def select(self, name: str) -> Points:
        """Keep one attribute."""
        return replace(self, attributes={name: self.attributes[name]})


DIRECTIONS = "directions"
"""Attribute that every stimulus has: the number of directions in which it vibrates, 3 for the original and else 1."""


def gather_points(
    rows: DataFrame, stimuli: DataFrame | None, whole: GroupMap, *, rng: np.random.Generator
) -> Points:
    """Map every recording by itself and gather every number that is known of its stimuli."""
    if stimuli is None:
        raise ValueError("Nothing is known of the stimuli.")
    rows = rows[rows["scale"] == PAIRED]
    means, places, values = _average_attributes(rows, stimuli), [], []
    for recording, part in rows.groupby(RECORDING, observed=True):
        try:
            names, matrices = gather_dissimilarities(part)
            space = fit_space(matrices, rng=rng)
        except ValueError:
            continue
        if names == whole.names:
            places.append(turn_map(space, whole.space)[0].positions)
            values.append(means.loc[recording].reindex(names).to_numpy(np.float64))
    if not places:
        raise ValueError("No recording has ratings of every pair.")
    found = {str(name): np.stack(values)[..., place] for place, name in enumerate(means)}
    return Points(np.stack(places), {k: v for k, v in found.items() if _varies(v)}, whole.names)


def _average_attributes(rows: DataFrame, stimuli: DataFrame) -> DataFrame:
    """Average every number that is known of the stimuli of the rated levels, by recording and reducer.

    The original matches itself by definition: it would lie at the end of every metric, as it lies at the edge of every
    map, and make any metric seem to contribute. It has no matches here.
    """
    is_whole = (stimuli["role"] == "reference") & ~stimuli["reducer"].isin(REDUCER_NAMES)
    numbers = stimuli.select_dtypes("number").assign(**{DIRECTIONS: np.where(is_whole, 3.0, 1.0)})
    numbers.loc[is_whole, numbers.columns.intersection([*METRIC_INFO])] = np.nan
    own = numbers[stimuli["level"].isin(rows["level"].unique())]
    return own.groupby([stimuli.loc[own.index, name] for name in (RECORDING, "reducer")]).mean()


def _varies(values: Values) -> bool:
    """Whether enough stimuli have a number, and those of a recording differ in it."""
    known = values[:, np.isfinite(values).all(axis=0)]
    spread = known.std(axis=1) if known.shape[1] >= FEWEST - 1 else np.zeros(1)
    return bool((spread > ROUNDING * np.abs(known).max(initial=0)).any())


def regress_points(points: Points, *, draws: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Regress every attribute on the axes of the maps, within recordings.

    p: share of permutations of the stimuli (one for all maps, because a reducer is the same in each) that explain as
    much: all of them, or `draws` where there are more. p_least: the smallest that this attribute could have had.
    chance, chance_low, chance_high: mean, 5 % and 95 % quantiles of R² of the permutations.
    """
    rows = []
    for name, values in points.attributes.items():
        known = np.isfinite(values).all(axis=0)
        places, kept = (_centre(of[:, known]) for of in (points.places, values))
        orders, design = _list_orders(int(known.sum()), draws, rng), places.reshape(-1, 2)
        r2, slope = _explain(kept.ravel(), design)
        tried = np.array([_explain(kept[:, order].ravel(), design)[0] for order in orders])
        alike = np.array([np.allclose(kept[:, order], kept) for order in orders])
        one, two = slope / (float(np.hypot(*slope)) or 1.0)
        chance = {
            f"chance{end}": float(np.quantile(tried, q))
            for end, q in (("_low", 0.05), ("_high", 0.95))
        }
        rows.append({
            "property": name, "r2": r2, "p": float((tried >= r2 - ROUNDING).mean()), "p_least": float(alike.mean()),
            "axis_1": one, "axis_2": two, "n": kept.size, "permutations": len(orders),
            "chance": float(tried.mean()), **chance,
        })  # fmt: skip
    return rows


def _centre(values: Values) -> Values:
    """Take out what the stimuli of a map share."""
    centred: Values = values - values.mean(axis=1, keepdims=True)
    return centred


def _explain(values: Values, design: Values) -> tuple[float, Values]:
    """Explain centred values by least squares: R² and the slopes."""
    slope = np.linalg.lstsq(design, values, rcond=None)[0]
    left: Values = values - design @ slope
    return 1 - float(left @ left) / float(values @ values), np.asarray(slope, dtype=np.float64)


def _list_orders(n: int, draws: int, rng: np.random.Generator) -> list[NDArray[np.intp]]:
    if math.factorial(n) <= max(draws, math.factorial(FEWEST + 1)):
        return [np.array(order) for order in permutations(range(n))]
    return [np.arange(n), *(rng.permutation(n) for _ in range(draws))]
