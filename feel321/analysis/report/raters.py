"""The raters: who was flagged by which screening rule, how far they agree, and the slopes without those flagged."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from feel321.analysis.figures.choices import draw_raters
from feel321.analysis.report._old import Cell, Grid, lay_estimate, name_estimate
from feel321.analysis.report.parts import find_repeat_sd, fit_rest, split_parts, thin_parts
from feel321.analysis.report.section import Picture, Section
from feel321.analysis.screening.rules import RULES
from feel321.analysis.screening.screen import screen_raters
from feel321.analysis.table.sheet import APART, PAIR
from feel321.analysis.words import COUNT, count_number, make_number, name_path, tell_name

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

    from pandas import DataFrame

    from feel321.analysis.report.parts import Choices
    from feel321.analysis.report.parts import RatingsPart as Part
    from feel321.analysis.screening.screen import Screening
    from feel321.analysis.table.reading import Table

    Row = dict[Hashable, Any]

KEY, TITLE = "raters", "Raters"
HOW = (
    "Raters are screened by the rules of ITU-R BS.1534-3, where the protocol is MUSHRA, and by extensions of them, "
    "each named; limits were fixed beforehand and allow for the rounding of a scale with few steps. A flagged rater "
    "should be followed up, not automatically excluded: all results above include everyone, and the primary slopes are "
    "also shown without raters flagged by a rule of the standard, and without raters flagged by any rule. Agreement: "
    "intraclass correlations (two-way; C consistency, A absolute agreement; of one rater, and of the mean of k) over "
    "stimuli rated by everyone, and Krippendorff's alpha for interval ratings, repeats averaged.",
)
PANELS = {
    "everyone": "everyone",
    "standard": "without those flagged by BS.1534-3",
    "any": "without anyone flagged",
}
FIGURES = {
    "icc_c_1": "ICC(C,1)", "icc_a_1": "ICC(A,1)", "icc_c_k": "ICC(C,k)", "icc_a_k": "ICC(A,k)",
    "alpha": "Krippendorff's α",
}  # fmt: skip


def compute(table: Table, choices: Choices) -> Section:
    """Screen raters, measure their agreement, and repeat the primary analysis without those flagged."""
    rows = table.rows
    single = rows[~rows["scale"].isin(APART) & (rows["role"] != PAIR)]
    if single.empty:
        return Section(
            KEY, TITLE, notes=("Raters were not screened: no stimulus was rated by itself.",)
        )
    screening = screen_raters(single, rng=choices.make_rng(KEY))
    slopes = list(_vary(table, screening, choices))
    grids = [_lay_rules(screening), _lay_panel(screening.panel)]
    noise = list(_name_noise(table))
    return Section(
        key=KEY,
        title=TITLE,
        answers=(_judge(screening),),
        grids=(
            *grids,
            *([_lay_slopes(slopes)] if slopes else []),
            *([_lay_noise(noise)] if noise else []),
        ),
        unseen=tuple(_count_hit(screening)),
        tables=_make_tables(screening, slopes),
        pictures=(Picture("raters", CAPTION, draw_raters(screening)),),
        notes=screening.notes,
        how=(*HOW, _tell_rules(screening)),
    )


CAPTION = (
    "Every rater under every screening rule: share of judgements (or the rule's correlation or standard deviation), "
    "the rule's limit, and flagged raters as crosses. The values describe what was rated and have no intervals."
)


def _hit(screening: Screening, panel: str) -> list[Hashable]:
    """List whom a panel leaves out."""
    rules = {
        "everyone": [],
        "standard": [rule for rule in screening.rules if RULES[rule].source.startswith("ITU-R")],
    }
    chosen = rules.get(panel, list(screening.rules))
    return sorted({who for rule in chosen for who in screening.hits[rule]}, key=str)


def _vary(table: Table, screening: Screening, choices: Choices) -> Iterator[Row]:
    for part in thin_parts(table, choices):
        fitted: dict[tuple[Hashable, ...], list[Row]] = {}
        for panel in PANELS:
            out = tuple(_hit(screening, panel))
            if out not in fitted:
                fitted[out] = list(_fit(part, out, table.metrics))
            yield from (
                row | {"panel": panel, "scale": part.scale, "level": part.level}
                for row in fitted[out]
            )


def _fit(part: Part, out: tuple[Hashable, ...], metrics: tuple[str, ...]) -> Iterator[Row]:
    left = part.rows[~part.rows["participant"].isin(out)]
    n_people = len(left["participant"].unique())
    try:
        model = fit_rest(left, metrics, people=part.rows["participant"].nunique())
    except ValueError as error:
        empty: Row = dict.fromkeys(("tenth", "tenth_low", "tenth_high", "p"), float("nan"))
        yield from (
            empty | {"metric": name, "n_people": n_people, "reason": str(error)} for name in metrics
        )
        return
    for row in model.slopes.reset_index().to_dict("records"):
        yield row | {"n_people": n_people, "reason": ""}


def _lay_slopes(rows: list[Row]) -> Grid:
    caption = (
        "Slopes of the primary analysis (points per +0.1) with and without flagged raters; 95 % t intervals with "
        "Satterthwaite's df, p not adjusted. A dash: too few raters are left to fit the model."
    )
    head = ("Ratings", "Metric", "Raters", "Points per +0.1", "Interval", "p", "Participants")
    laid = []
    for row in rows:
        name, n = (
            name_path("panel", row["scale"], row["level"], row["metric"], row["panel"]),
            row["n_people"],
        )
        value = name_estimate(name, row, "mixed model, points per +0.1", n=n, prefix="tenth")
        p = make_number(f"{name}.p", row["p"], "two-sided t test", n=n)
        count = Cell(count_number(f"{name}.n_participants", n, n=n), COUNT)
        names = (
            tell_name(f"{row['scale']}, {row['level']}"),
            tell_name(row["metric"]),
            PANELS[row["panel"]],
        )
        laid.append((*names, *lay_estimate(value, "slope"), Cell(p, "p"), count))
    return Grid(caption, head, tuple(laid), detail=False)


def _lay_rules(screening: Screening) -> Grid:
    caption = "Screening rules, their source, the protocols they apply to, and the raters they flagged; a dash: nobody."
    head = ("Rule", "Source", "Protocols", "Flagged", "Raters screened")
    rows = []
    for rule, hits in screening.hits.items():
        own = screening.table[screening.table["rule"] == rule]
        judged, name = int(own["share"].notna().sum()), name_path("screening", rule)
        count = Cell(count_number(f"{name}.n_judged", judged, n=len(own)), COUNT)
        protocols = ", ".join(map(tell_name, RULES[rule].protocols)) or "all"
        rows.append((
            tell_name(rule),
            RULES[rule].source,
            protocols,
            ", ".join(map(str, hits)) or "–",
            count,
        ))
    return Grid(caption, head, tuple(rows))


def _tell_rules(screening: Screening) -> str:
    says = {rule: RULES[rule].says.format(limit=limit) for rule, limit in screening.limits.items()}
    return f"Screening rules: {'; '.join(f'{tell_name(rule)}: {told}' for rule, told in says.items())}."


def _lay_panel(panel: DataFrame) -> Grid:
    caption = (
        "Agreement of all raters, and of those not flagged by any rule. The values describe these raters and these "
        "stimuli and have no intervals: the usual ones treat stimuli of one recording as independent and are too "
        "narrow. A dash: fewer than two raters or stimuli."
    )
    counts = {"n_participants": "Participants", "n_complete": "Stimuli rated by all"}
    head = ("Scale", "Raters", *FIGURES.values(), *counts.values())
    rows: list[tuple[str | Cell, ...]] = []
    for row in panel.to_dict("records"):
        name, n = (
            name_path("reliability", row["scale"], row["panel"].replace(" ", "_")),
            row["n_complete"],
        )
        values = [
            Cell(make_number(f"{name}.{key}", row[key], told, n=n)) for key, told in FIGURES.items()
        ]
        sizes = [
            Cell(count_number(f"{name}.{key}", row[key], n=row["n_items"]), COUNT) for key in counts
        ]
        whose = PANELS["any" if row["panel"] == "without hits" else "everyone"]
        rows.append((tell_name(row["scale"]), whose, *values, *sizes))
    return Grid(caption, head, tuple(rows))


def _name_noise(table: Table) -> Iterator[tuple[str | Cell, ...]]:
    for part in split_parts(table):
        sd, n = find_repeat_sd(part.rows)
        if n:
            method = "rating, pooled standard deviation of repeats of a stimulus by a rater"
            number = make_number(name_path("repeat_sd", *part.place), sd, method, n=n)
            yield tell_name(part.lead), Cell(number, "rating")


def _lay_noise(rows: list[tuple[str | Cell, ...]]) -> Grid:
    caption = "Standard deviation, in points, of a rater's repeated ratings of the same stimulus."
    return Grid(caption, ("Ratings", "SD of repeats"), tuple(rows))


def _judge(screening: Screening) -> str:
    standard, everyone = len(_hit(screening, "standard")), screening.table["participant"].nunique()
    whole = len(_hit(screening, "any"))
    own = screening.table["rule"].isin([
        rule for rule in screening.rules if RULES[rule].source.startswith("ITU-R")
    ])
    applied = bool(screening.table.loc[own, "share"].notna().any())
    of_standard = f"{standard} of them by ITU-R BS.1534-3 rules"
    if not applied:
        of_standard = "the ITU-R BS.1534-3 rules do not apply to these ratings"
    elif standard == whole:
        of_standard = (
            "all by ITU-R BS.1534-3 rules" if whole else "those of ITU-R BS.1534-3 included"
        )
    raters = f"{whole or 'None'} of {everyone} raters {'was' if whole == 1 else 'were'} flagged"
    return f"{raters} by screening rules ({of_standard}). Nobody was removed."


def _count_hit(screening: Screening) -> Iterator[Any]:
    everyone = screening.table["participant"].nunique()
    for panel in PANELS:
        yield count_number(
            name_path("screening_panel", panel), len(_hit(screening, panel)), n=everyone
        )


def _make_tables(screening: Screening, slopes: list[Row]) -> dict[str, DataFrame]:
    import pandas as pd

    tables = {
        "screening": screening.table, "screening_items": screening.items, "screening_excerpts": screening.excerpts,
        "expertise": screening.gauge, "reliability": screening.panel, "slopes_without_hits": pd.DataFrame(slopes),
    }  # fmt: skip
    return {name: rows for name, rows in tables.items() if len(rows)}
