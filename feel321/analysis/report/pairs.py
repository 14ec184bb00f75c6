"""Sections about pairs of stimuli: discrimination in ABX trials, and the space of dissimilarities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.contrasts.discrimination import discriminate_pairs
from feel321.analysis.figures.maps import draw_discrimination, draw_space
from feel321.analysis.primary.influence import adjust
from feel321.analysis.report._old import INTERVAL, Cell, Grid
from feel321.analysis.report.parts import SIGNIFICANCE
from feel321.analysis.report.section import Picture, Section, make_slug
from feel321.analysis.space import (
    align_spaces,
    bootstrap_space,
    regress_attributes,
    stress_by_dimension,
)
from feel321.analysis.table.reading import order_reducers
from feel321.analysis.table.sheet import ANSWERED, APART, PAIRED
from feel321.analysis.words import (
    COUNT,
    Line,
    Number,
    count_number,
    make_interval,
    make_number,
    name_path,
    tell_name,
    tell_number,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.contrasts.discrimination import Discrimination
    from feel321.analysis.report.parts import Choices
    from feel321.analysis.space import Alignment, Ellipses
    from feel321.analysis.table.reading import Table

    Values = NDArray[np.float64]

# ABX trials: how well what a reducer made is told from its reference.

KEY_DISCRIMINATION, TITLE_DISCRIMINATION = "discrimination", "Telling stimuli apart (ABX)"
RIGHT, WRONG = 100.0, 0.0
HOW_DISCRIMINATION = (
    "ABX: share of correct answers with Wilson's interval, exact binomial test against guessing (one-sided, p "
    "adjusted by Holm over reducers), and d' of an observer who judges A, B and X each by itself (Macmillan & "
    "Creelman 2005). Trials are pooled over people and recordings and taken for independent, so that intervals are "
    "about these people.",
)


def compute_discrimination(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Evaluate ABX trials per reducer."""
    rows = table.rows[table.rows["scale"] == ANSWERED]
    if rows.empty:
        return Section(KEY_DISCRIMINATION, TITLE_DISCRIMINATION)
    strange = rows[~rows["rating"].isin([RIGHT, WRONG])]
    if len(strange):
        why = f"got {len(strange)} answers that are neither 100 (right) nor 0 (wrong)"
        return Section(
            KEY_DISCRIMINATION,
            TITLE_DISCRIMINATION,
            notes=(f"Scale '{ANSWERED}' is not evaluated: {why}.",),
        )
    found = _evaluate(rows)
    adjusted = dict(zip(found, adjust([result.p for result in found.values()]), strict=True))
    answer, counts = _judge_discrimination(found, adjusted)
    figure = draw_discrimination({
        f"{name} ({tell_name(level)})": result for (level, name), result in found.items()
    })
    return Section(
        key=KEY_DISCRIMINATION,
        title=TITLE_DISCRIMINATION,
        answers=(answer,),
        verdict=(Line(answer),),
        unseen=counts,
        grids=(_lay(found, adjusted),),
        tables={"discrimination": _tabulate_discrimination(found, adjusted)},
        pictures=(Picture("discrimination", CAPTION, figure),),
        notes=tuple(
            f"ABX, {name}, {level}: {note}"
            for (level, name), one in found.items()
            for note in one.notes
        ),
        how=HOW_DISCRIMINATION,
    )


CAPTION = (
    "d' in ABX trials of each reducer against its reference, with 95 % intervals that follow from Wilson's; 0 is "
    "guessing."
)
Found = dict[tuple[str, str], "Discrimination"]


def _evaluate(rows: DataFrame) -> Found:
    """Discriminate every reducer from whatever its reference was."""
    trials = rows.assign(first=rows["reducer"], second="reference", correct=rows["rating"] == RIGHT)
    return {
        (str(level), str(name)): discriminate_pairs(part)[None]
        for (level, name), part in trials[trials["role"] != "reference"].groupby(
            ["level", "reducer"], observed=True
        )
    }


HEAD = ("Reducer", "Level", "Share", "Interval", "d'", "Interval", "p (Holm)", "Correct", "Trials")


def _lay(found: Found, adjusted: Mapping[tuple[str, str], float]) -> Grid:
    caption = (
        "Share of correct answers (guessing: 0.50) with Wilson's 95 % interval, test against guessing, and d'. A "
        "dash for d': infinite, no answer was wrong."
    )
    rows: list[tuple[str | Cell, ...]] = []
    for (level, reducer), one in found.items():
        name, n = name_path("abx", level, reducer), one.n_trials
        share = _bound(
            f"{name}.share",
            (one.share, one.wilson_low, one.wilson_high),
            "share of correct answers",
            n=n,
        )
        ends = one.d_independent, one.d_independent_low, one.d_independent_high
        distance = _bound(f"{name}.d", ends, "d', independent observations", n=n)
        p = make_number(
            f"{name}.p_holm",
            adjusted[level, reducer],
            "exact binomial test, Holm's adjustment",
            n=n,
        )
        counts = (
            count_number(f"{name}.{key}", getattr(one, key), n=n)
            for key in ("n_correct", "n_trials")
        )
        shown = (
            Cell(number, part=part) for number in (share, distance) for part in ("value", INTERVAL)
        )
        rows.append((
            reducer,
            tell_name(level),
            *shown,
            Cell(p, "p"),
            *(Cell(count, COUNT) for count in counts),
        ))
    return Grid(caption, HEAD, tuple(rows))


def _judge_discrimination(
    found: Found, adjusted: Mapping[tuple[str, str], float]
) -> tuple[str, tuple[Number, ...]]:
    told, n = sum(p < SIGNIFICANCE for p in adjusted.values()), len(found)
    numbers = count_number("abx.n_told_apart", told, n=n), count_number("abx.n_compared", n, n=n)
    apart = f"ABX: {told} of {n} reducers and anchors are told from their reference better than by guessing"
    return (
        f"{apart} (p (Holm) < {SIGNIFICANCE}). Of the others neither that nor likeness is shown.",
        numbers,
    )


def _bound(name: str, numbers: tuple[float, float, float], method: str, *, n: int) -> Number:
    value, low, high = numbers
    number = make_number(name, value, method, n=n)
    return make_interval(number, low, high, uncertainty="95 % interval that follows from Wilson's")


def _tabulate_discrimination(found: Found, adjusted: Mapping[tuple[str, str], float]) -> DataFrame:
    from dataclasses import asdict

    import pandas as pd

    rows: list[dict[str, Any]] = [
        {
            "level": level,
            "reducer": name,
            **asdict(one),
            "p_holm": adjusted[level, name],
            "notes": " ".join(one.notes),
        }
        for (level, name), one in found.items()
    ]
    return pd.DataFrame(rows)


# Dissimilarities: the map of what people tell apart, and what its axes go with.

KEY_SPACE, TITLE_SPACE = "space", "The space of what was felt"
DRAWS = 200
"""Maps drawn anew; each takes a fit."""

HOW_SPACE = (
    "Dissimilarities, averaged over recordings, are placed on a map by multidimensional scaling (SMACOF) of the "
    "mean over participants, as Lee et al. (2022, doi 10.1109/TOH.2022.3174229) did; ellipses: 95 % by a bootstrap "
    "over participants. The map is set against the stimuli's metrics (Procrustes, permutation test), and metrics "
    "and mean ratings are regressed on its axes (p adjusted by Holm). Reducers are few, so that only large "
    "agreement can show.",
)


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """Dissimilarities of one level arm."""

    level: str
    names: tuple[str, ...]
    matrices: Values
    attributes: DataFrame


def compute_space(table: Table, choices: Choices) -> Section:
    """Map the dissimilarities of every level."""
    rows = table.rows[table.rows["scale"] == PAIRED]
    notes: list[str] = []
    answers: list[str] = []
    grids: list[Grid] = []
    pictures: list[Picture] = []
    tables: dict[str, DataFrame] = {}
    for level in sorted(rows["level"].unique()):
        try:
            found = _gather(table, rows[rows["level"] == level], level)
            ellipses = bootstrap_space(
                found.matrices,
                draws=min(DRAWS, max(choices.draws, 3)),
                rng=choices.make_rng(KEY_SPACE, level),
            )
            stress = stress_by_dimension(
                found.matrices, rng=choices.make_rng(KEY_SPACE, level, "stress")
            )
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: no map. {error}")
            continue
        grids += [
            _lay_stress(found, stress),
            *_lay_meaning(found, ellipses, choices, notes, answers),
        ]
        pictures.append(_draw(found, ellipses, stress))
        tables[f"space_{make_slug(level)}"] = _tabulate_space(found, ellipses)
    return Section(
        key=KEY_SPACE,
        title=TITLE_SPACE,
        answers=tuple(answers),
        verdict=tuple(map(Line, answers)),
        grids=tuple(grids),
        pictures=tuple(pictures),
        tables=tables,
        notes=tuple(notes),
        how=HOW_SPACE if grids else (),
    )


def _gather(table: Table, rows: DataFrame, level: str) -> _Level:
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
        index = tuple(
            apart[key].map(of).to_numpy()
            for key, of in (("participant", people), (one, place), (two, place))
        )
        np.add.at(sums, index, apart["rating"].to_numpy())
        np.add.at(counts, index, 1)
    matrices = np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
    matrices[:, np.arange(len(names)), np.arange(len(names))] = 0
    return _Level(level, tuple(names), matrices, _measure(table, names, level))


def _measure(table: Table, names: list[str], level: str) -> DataFrame:
    """Average metrics and ratings per reducer; NaN where there are none."""
    import pandas as pd

    rows = table.rows[table.rows["level"] == level]
    metrics = (
        rows
        .drop_duplicates("stimulus_id")
        .groupby("reducer", observed=True)[list(table.metrics)]
        .mean()
    )
    single = rows[~rows["scale"].isin(APART)]
    ratings = (
        single.pivot_table("rating", "reducer", "scale", observed=True)
        if len(single)
        else pd.DataFrame()
    )
    return metrics.join(ratings.add_prefix("rated ")).reindex(names)


def _lay_stress(found: _Level, stress: tuple[float, ...]) -> Grid:
    caption = f"Stress of maps of one dimension and more ({tell_name(found.level)}): how badly they fit; 0.05 is good."
    rows = []
    for number, value in enumerate(stress, start=1):
        name = name_path("stress", found.level, str(number))
        dimension = count_number(f"{name}.dimensions", number, n=len(found.names))
        rows.append((
            tell_name(found.level),
            Cell(dimension, COUNT),
            Cell(_number(name, value, "Kruskal's stress-1", found)),
        ))
    return Grid(caption, ("Level", "Dimensions", "Stress"), tuple(rows))


def _number(name: str, value: float, method: str, found: _Level) -> Number:  # noqa: PLR0917 - as a table reads
    return make_number(name, value, method, n=len(found.names))


def _lay_meaning(  # noqa: PLR0917 - lists that every level adds to
    found: _Level, ellipses: Ellipses, choices: Choices, notes: list[str], answers: list[str]
) -> Iterator[Grid]:
    known = found.attributes.notna().all(axis=1).to_numpy()
    attributes_of = found.attributes[known]
    varied = [name for name in map(str, attributes_of.columns) if attributes_of[name].std() > 0]
    positions, attributes = ellipses.space.positions[known], attributes_of[varied]
    metrics = attributes[[name for name in varied if not name.startswith("rated ")]]
    try:
        scaled = ((metrics - metrics.mean()) / metrics.std()).to_numpy()
        rng = choices.make_rng(KEY_SPACE, found.level, "procrustes")
        aligned = align_spaces(positions, scaled, permutations=choices.draws, rng=rng)
        name = name_path("procrustes", found.level)
        correlation = _number(
            name, aligned.correlation, "Procrustes correlation of map and metrics", found
        )
        p = _number(
            f"{name}.p", aligned.p, f"permutation test, {aligned.permutations} pairings", found
        )
        answers.append(_judge_space(found, aligned))
        caption = "Agreement of the map with the stimuli's metrics, standardised, after shifting, turning and scaling."
        yield Grid(
            caption,
            ("Level", "Correlation", "p"),
            ((tell_name(found.level), Cell(correlation), Cell(p, "p")),),
        )
        yield _lay_attributes(
            found, regress_attributes(positions, {name: attributes[name] for name in varied})
        )
    except ValueError as error:
        notes.append(f"{PAIRED}, {found.level}: the map is set against nothing more. {error}")


def _judge_space(found: _Level, aligned: Alignment) -> str:
    what = f"their places on the map of dissimilarities (level {tell_name(found.level)})"
    r, p = tell_number(aligned.correlation), tell_number(aligned.p, kind="p")
    evidence = f"Procrustes correlation {r}, permutation p {p if p.startswith('<') else f'= {p}'}"
    if aligned.p < SIGNIFICANCE:
        return f"Metrics of reducers agree with {what} better than by chance ({evidence})."
    return f"Whether metrics of reducers agree with {what} is undecided ({evidence})."


def _lay_attributes(found: _Level, table: DataFrame) -> Grid:
    caption = "What grows along a direction of the map: share of its variance between reducers that the map explains."
    rows = []
    for attribute, p_holm, row in zip(
        table.index, adjust(table["p"].tolist()), table.to_dict("records"), strict=True
    ):
        name = name_path("property", found.level, str(attribute))
        r2 = _number(name, row["r2"], "R² of a regression on the map's axes", found)
        p = _number(f"{name}.p_holm", p_holm, "F test, Holm's adjustment", found)
        rows.append((tell_name(found.level), tell_name(str(attribute)), Cell(r2), Cell(p, "p")))
    return Grid(caption, ("Level", "Of", "R²", "p (Holm)"), tuple(rows))


def _draw(found: _Level, ellipses: Ellipses, stress: tuple[float, ...]) -> Picture:
    caption = (
        f"Map of the dissimilarities at level {tell_name(found.level)}, with 95 % bootstrap ellipses over "
        "participants; only distances have a meaning. Beside it, the stress of maps by their dimensions."
    )
    figure = draw_space(ellipses, found.names, stress=stress)
    return Picture(make_slug("space", found.level), caption, figure)


def _tabulate_space(found: _Level, ellipses: Ellipses) -> DataFrame:
    import pandas as pd

    columns: dict[str, Any] = {
        "level": found.level, "reducer": found.names,
        "x": ellipses.space.positions[:, 0], "y": ellipses.space.positions[:, 1],
        "half_axis_1": ellipses.half_axes[:, 0], "half_axis_2": ellipses.half_axes[:, 1], "angle": ellipses.angle,
    }  # fmt: skip
    return pd.DataFrame(columns)
