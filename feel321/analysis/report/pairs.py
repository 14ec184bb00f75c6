"""Sections about pairs of stimuli: discrimination in ABX trials, and the map of dissimilarities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from feel321.analysis.contrasts.discrimination import discriminate_pairs
from feel321.analysis.contrasts.told_apart import EVERY, compare_with_original
from feel321.analysis.figures.scatter import draw_discrimination, draw_space
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.report.parts import SIGNIFICANCE
from feel321.analysis.report.section import (
    NAME,
    TEXT,
    Column,
    PageTable,
    Picture,
    Section,
    TableForm,
    make_slug,
    read_methods,
)
from feel321.analysis.space import (
    Ellipses,
    align_spaces,
    bootstrap_space,
    regress_attributes,
    stress_by_dimension,
)
from feel321.analysis.table.metrics import order_reducers
from feel321.analysis.table.schema import ANSWERED, APART, PAIRED
from feel321.analysis.words import (
    COUNT,
    Line,
    capitalise,
    count_number,
    format_name,
    format_number,
    join_words,
)

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.reading import Table

Row = dict[str, Any]

LEVEL = Column("Level", "level", TEXT)

# ABX trials: how well what a reducer made is distinguished from its reference.

RIGHT, WRONG = 100.0, 0.0
WILSON = "95 % interval that follows from Wilson's"
ABX = TableForm(
    "Share of correct answers (guessing: 0.50) with Wilson's 95 % interval, test against guessing, and d'. A "
    "dash for d': infinite, no answer was wrong.",
    (
        Column("Reducer", "reducer", NAME), Column("Level", "level", TEXT),
        Column("Share", "share", end="share", method="share of correct answers", interval=WILSON, ends="wilson_"),
        Column(
            "d'", "d_independent", end="d", method="d', independent observations", interval=WILSON,
            ends="d_independent_",
        ),
        Column("p (Holm)", "p_holm", "p", "p_holm", "exact binomial test, Holm's adjustment"),
        Column("Correct", "n_correct", COUNT, "n_correct"), Column("Trials", "n_trials", COUNT, "n_trials"),
    ),
    path="abx.{level}.{reducer}", n="n_trials",
)  # fmt: skip
CAPTION_D = (
    "d' in ABX trials of each reducer against its reference, with 95 % intervals that follow from Wilson's; 0 is "
    "guessing."
)


def compute_discrimination(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Evaluate ABX trials per reducer, against whatever its reference was."""
    key, title = "discrimination", "Telling stimuli apart (ABX)"
    rows = table.rows[table.rows["scale"] == ANSWERED]
    if strange := int((~rows["rating"].isin([RIGHT, WRONG])).sum()):
        why = f"{strange} answers are neither 100 (right) nor 0 (wrong)"
        return Section(key, title, notes=(f"Scale '{ANSWERED}' is not evaluated: {why}.",))
    trials = rows.assign(first=rows["reducer"], second="reference", correct=rows["rating"] == RIGHT)
    compared = trials[trials["role"] != "reference"].groupby(["level", "reducer"], observed=True)
    found = {names: discriminate_pairs(part)[None] for names, part in compared}
    if not found:
        return Section(key, title)
    adjusted = adjust_holm([one.p for one in found.values()])
    evaluated: list[Row] = [
        {"level": level, "reducer": name, **asdict(one), "p_holm": p}
        for ((level, name), one), p in zip(found.items(), adjusted, strict=True)
    ]
    apart, n = sum(p < SIGNIFICANCE for p in adjusted), len(found)
    others = " For the others neither a difference nor equivalence is shown." * (apart < n)
    answer = (
        f"ABX: {apart} of {n} reducers and anchors were distinguished from their reference above chance "
        f"(p (Holm) < {SIGNIFICANCE}).{others}"
    )
    named = {f"{name} ({format_name(str(level))})": one for (level, name), one in found.items()}
    return Section(
        key=key,
        title=title,
        answers=(answer,),
        verdict=(Line(answer, clause=f"{apart} of {n} reducers and anchors were distinguished from their reference"),),
        unseen=(count_number("abx.n_told_apart", apart, n=n), count_number("abx.n_compared", n, n=n)),
        grids=(ABX.build(evaluated),),
        tables={"discrimination": evaluated},
        pictures=(Picture("discrimination", CAPTION_D, partial(draw_discrimination, named)),),
        notes=tuple(
            f"ABX, {name}, {level}: {note}" for (level, name), one in found.items() for note in one.notes
        ),
        how=read_methods(key),
    )  # fmt: skip


# One axis against three: dissimilarities from the original beside those of identical pairs.

STUDENT_T = "95 % t interval over participants"
TOLD = TableForm(
    "One axis against three: dissimilarity of each reducer's stimuli from the original, less that of identical pairs, "
    "in points; and d' from how often a participant rates a pair with the original above an identical one. 95 % t "
    "intervals over participants: other people, these recordings. A dash for d': infinite.",
    (
        Column("Reducer", "reducer", NAME), LEVEL,
        Column(
            "Difference", "difference", "rating", method="dissimilarity from the original less that of identical pairs",
            interval=STUDENT_T,
        ),
        Column("t", "t", "df", "t", "paired t test over participants"), Column("df", "df", "df", "df", "paired t test"),
        Column("p (Holm)", "p_holm", "p", "p_holm", "two-sided paired t test, Holm's adjustment over reducers"),
        Column(
            "Area", "area", end="area", method="area under the ROC curve, mean over participants", interval=STUDENT_T,
            ends="area_",
        ),
        Column("d'", "d_prime", end="d", method="d' of that area", interval=STUDENT_T, ends="d_prime_"),
        Column("Participants", "n_participants", COUNT, "n_participants"),
        Column("Pairs", "n_judgements", COUNT, "n_judgements"),
        Column("Identical", "n_identical", COUNT, "n_identical"),
    ),
    path="told_apart.{level}.{reducer}", n="n_judgements",
)  # fmt: skip


def compute_told_apart(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Compare dissimilarities from the original with those of identical pairs."""
    key, title = "told_apart", "One axis against three"
    rows = table.rows[table.rows["scale"] == PAIRED]
    notes, lines = [], []
    found: list[dict[Any, Any]] = []
    several = len(rows["level"].unique()) > 1
    for level, part in rows.groupby("level", observed=True):
        try:
            own = compare_with_original(part).assign(level=level).to_dict("records")
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: one axis is not compared with three. {error}")
            continue
        found += own
        single = [row for row in own if row["reducer"] != EVERY]
        apart = [row for row in single if row["p_holm"] < SIGNIFICANCE and row["difference"] > 0]
        where = f" (level {format_name(str(level))})" if several else ""
        rest = [str(row["reducer"]) for row in single if row not in apart]
        told = (
            f" No difference was shown for {join_words(rest)}; this does not show equality."
            if rest
            else ""
        )
        clause = f"one axis was distinguished from three{where} for {len(apart)} of {len(single)} reducers"
        lines.append(
            Line(
                f"{capitalise(clause)}: dissimilarity from the original is above that of identical pairs "
                f"(p (Holm) < {SIGNIFICANCE}).{told}",
                clause=clause,
            )
        )
    return Section(
        key, title, answers=tuple(map(str, lines)), verdict=lines, grids=(TOLD.build(found),), notes=notes,
        tables={key: found}, how=read_methods(key),
    )  # fmt: skip


# Dissimilarities: the perceptual map, and what its axes are associated with.

KEY = "space"
DRAWS = 200
"""Maps drawn anew; each takes a fit."""

STRESS = TableForm(
    "Stress of maps of one dimension and more ({}): how badly they fit; 0.05 is good.",
    (
        LEVEL, Column("Dimensions", "dimensions", COUNT, "dimensions"),
        Column("Stress", "stress", method="Kruskal's stress-1"),
    ),
    path="stress.{level}.{dimensions}",
)  # fmt: skip
PROCRUSTES = TableForm(
    "Agreement of the map with the stimuli's metrics, standardised, after shifting, turning and scaling.",
    (
        LEVEL, Column("Correlation", "correlation", method="Procrustes correlation of map and metrics"),
        Column("p", "p", "p", "p", "permutation test, {permutations} pairings"),
    ),
    path="procrustes.{level}",
)  # fmt: skip
PROPERTIES = TableForm(
    "What increases along a direction of the map: share of its variance between reducers that the map explains.",
    (
        LEVEL, Column("Of", "property", TEXT), Column("R²", "r2", method="R² of a regression on the map's axes"),
        Column("p (Holm)", "p_holm", "p", "p_holm", "F test, Holm's adjustment"),
    ),
    path="property.{level}.{property}",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Arm:
    """Dissimilarities of one level arm, and metrics and mean ratings of its reducers."""

    level: str
    names: tuple[str, ...]
    matrices: NDArray[np.float64]
    attributes: DataFrame


def compute_space(table: Table, choices: Choices) -> Section:
    """Map the dissimilarities of every level."""
    rows = table.rows[table.rows["scale"] == PAIRED]
    notes, grids, pictures = [], [], []
    lines: list[Line] = []
    tables: dict[str, list[Row]] = {}
    for level in sorted(rows["level"].unique()):
        try:
            arm = _gather(table, rows[rows["level"] == level], level)
            rng, draws = choices.make_rng(KEY, level), min(DRAWS, max(choices.draws, 3))
            ellipses = bootstrap_space(arm.matrices, draws=draws, rng=rng)
            rng = choices.make_rng(KEY, level, "stress")
            stress = stress_by_dimension(arm.matrices, rng=rng)
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: no map. {error}")
            continue
        caption = (
            f"Map of the dissimilarities at level {format_name(level)}, with 95 % bootstrap ellipses over "
            "participants; only distances have a meaning. Beside it, the stress of maps by their dimensions."
        )
        draw = partial(draw_space, ellipses, arm.names, stress=stress)
        pictures.append(Picture(make_slug(KEY, level), caption, draw))
        tables[f"space_{make_slug(level)}"] = list(_list_places(arm, ellipses))
        grids.append(_build_stress(arm, stress))
        try:
            line, own = _relate(arm, ellipses, choices)
            lines.append(line)
            grids += own
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: the map is compared with nothing else. {error}")
    return Section(
        key=KEY,
        title="The space of what was felt",
        answers=tuple(map(str, lines)),
        verdict=lines,
        grids=grids,
        pictures=pictures,
        tables=tables,
        notes=notes,
        how=read_methods(KEY),
    )


def _gather(table: Table, rows: DataFrame, level: str) -> _Arm:
    """Average each participant's ratings of every pair of reducers over recordings and both orders."""
    known = rows[rows["reference_reducer"] != ""].rename(columns={"reference_reducer": "other"})
    apart = known[known["reducer"] != known["other"]]
    if apart.empty:
        raise ValueError(
            "No judgement names two stimuli of different reducers, in stimulus_id and reference_id."
        )
    names = order_reducers([*apart["reducer"], *apart["other"]])
    place = {name: number for number, name in enumerate(names)}
    people = {name: number for number, name in enumerate(sorted(apart["participant"].unique()))}
    sums, counts = (np.zeros((len(people), len(names), len(names))) for _ in range(2))
    for one, two in (("reducer", "other"), ("other", "reducer")):
        axes = (("participant", people), (one, place), (two, place))
        index = tuple(apart[key].map(of).to_numpy() for key, of in axes)
        np.add.at(sums, index, apart["rating"].to_numpy())
        np.add.at(counts, index, 1)
    matrices = np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
    matrices[:, np.arange(len(names)), np.arange(len(names))] = 0
    return _Arm(level, tuple(names), matrices, _measure(table, names, level))


def _measure(table: Table, names: list[str], level: str) -> DataFrame:
    """Average metrics and ratings per reducer; NaN where there are none."""
    import pandas as pd

    rows = table.rows[table.rows["level"] == level]
    stimuli = rows.drop_duplicates("stimulus_id").groupby("reducer", observed=True)
    single, ratings = rows[~rows["scale"].isin(APART)], pd.DataFrame()
    if len(single):
        ratings = single.pivot_table("rating", "reducer", "scale", observed=True)
    metrics = stimuli[list(table.metrics)].mean()
    return metrics.join(ratings.add_prefix("rated ")).reindex(names)


def _build_stress(arm: _Arm, stress: Sequence[float]) -> PageTable:
    rows = [
        {"level": arm.level, "dimensions": number, "stress": value, "n": len(arm.names)}
        for number, value in enumerate(stress, start=1)
    ]
    return STRESS.build(rows, caption=STRESS.caption.format(format_name(arm.level)))


def _relate(arm: _Arm, ellipses: Ellipses, choices: Choices) -> tuple[Line, list[PageTable]]:
    """Compare the map with metrics and mean ratings."""
    known = arm.attributes.notna().all(axis=1).to_numpy()
    attributes = arm.attributes[known]
    attributes = attributes.loc[:, attributes.std() > 0]
    metrics = attributes[[name for name in attributes if not str(name).startswith("rated ")]]
    positions, more = ellipses.space.positions[known], {"level": arm.level, "n": len(arm.names)}
    scaled = ((metrics - metrics.mean()) / metrics.std()).to_numpy()
    rng = choices.make_rng(KEY, arm.level, "procrustes")
    aligned = align_spaces(positions, scaled, permutations=choices.draws, rng=rng)
    agreement = {key: getattr(aligned, key) for key in ("correlation", "p", "permutations")}
    found = regress_attributes(positions, {str(name): attributes[name] for name in attributes})
    adjusted = found.assign(p_holm=adjust_holm(found["p"].tolist()), property=found.index)
    r, p = format_number(aligned.correlation), format_number(aligned.p, kind="p")
    evidence = f"Procrustes r = {r}, permutation p {p if p.startswith('<') else f'= {p}'}"
    what = f"align with the perceptual map (level {format_name(arm.level)})"
    shown = aligned.p < SIGNIFICANCE
    clause = f"the metrics {what}" if shown else f"it is unclear whether the metrics {what}"
    properties = [more | row for row in adjusted.to_dict("records")]
    grids = [PROCRUSTES.build([more | agreement]), PROPERTIES.build(properties)]
    return Line(f"{capitalise(clause)} ({evidence}).", clause=clause), grids


def _list_places(arm: _Arm, ellipses: Ellipses) -> Iterator[Row]:
    places = zip(
        arm.names, ellipses.space.positions, ellipses.half_axes, ellipses.angle, strict=True
    )
    for name, (x, y), (one, two), angle in places:
        yield {
            "level": arm.level, "reducer": name, "x": x, "y": y, "half_axis_1": one, "half_axis_2": two,
            "angle": angle,
        }  # fmt: skip
