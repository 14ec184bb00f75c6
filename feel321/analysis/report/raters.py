"""The raters: who was flagged by which screening rule, how far they agree, and the slopes without those flagged."""

from collections.abc import Hashable, Iterator
from functools import partial
from typing import Any

from feel321.analysis.contrasts.compare import find_repeat_sd
from feel321.analysis.figures.choices import draw_raters
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.report.parts import (
    Choices,
    RatingsPart,
    add_step,
    find_table_steps,
    fit_rest,
    split_parts,
    thin_parts,
    word_steps,
)
from feel321.analysis.report.section import (
    METRIC,
    NAME,
    RATINGS,
    TEXT,
    Column,
    P,
    Picture,
    Section,
    TableForm,
    estimate,
    read_methods,
)
from feel321.analysis.screening.rules import RULES
from feel321.analysis.screening.screen import Screening, screen_raters
from feel321.analysis.table.reading import Table
from feel321.analysis.table.schema import APART, PAIR
from feel321.analysis.words import COUNT, count_number, format_name, name_path

KEY, TITLE = "raters", "Raters"
GROUPS = {
    "everyone": "everyone",
    "standard": "without those flagged by BS.1534-3",
    "any": "without anyone flagged",
}
"""Groups of raters that the primary slopes are fitted to -> what they are called."""

CAPTION = (
    "Every rater under every screening rule: share of judgements (or the rule's correlation or standard deviation), "
    "the rule's limit, and flagged raters as crosses. The values describe what was rated and have no intervals."
)
RULES_APPLIED = TableForm(
    "Screening rules, their source, the protocols they apply to, and the raters they flagged; a dash: "
    "nobody.",
    (
        Column("Rule", "rule", TEXT), Column("Source", "source", NAME), Column("Protocols", "protocols", NAME),
        Column("Flagged", "flagged", NAME), Column("Raters screened", "n_judged", COUNT, "n_judged"),
    ),
    path="screening.{rule}",
)  # fmt: skip
AGREEMENT = {
    "icc_c_1": "ICC(C,1)", "icc_a_1": "ICC(A,1)", "icc_c_k": "ICC(C,k)", "icc_a_k": "ICC(A,k)",
    "alpha": "Krippendorff's α",
}  # fmt: skip
AGREEMENTS = TableForm(
    "Agreement of all raters, and of those not flagged by any rule. The values describe these raters and "
    "these stimuli and have no intervals: the usual ones treat stimuli of one recording as independent "
    "and are too narrow. A dash: fewer than two raters or stimuli.",
    (
        Column("Scale", "scale", TEXT), Column("Raters", "whose", NAME),
        *(Column(head, key, end=key, method=head, n="n_complete") for key, head in AGREEMENT.items()),
        Column("Participants", "n_participants", COUNT, "n_participants"),
        Column("Stimuli rated by all", "n_complete", COUNT, "n_complete"),
    ),
    path="reliability.{scale}.{who}", n="n_items",
)  # fmt: skip
SLOPES = TableForm(
    "Slopes of the primary analysis (points per +0.1) with and without flagged raters; 95 % t intervals "
    "with Satterthwaite's df, p not adjusted. A dash: too few raters are left to fit the model.",
    (
        RATINGS, METRIC, Column("Raters", "_whose", NAME),
        estimate("Points per +0.1", "_step", "mixed model, points per {_per}", ends="_step_"), P,
        Column("Participants", "n_people", COUNT, "n_participants"),
    ),
    path="panel.{scale}.{level}.{metric}.{panel}", n="n_people", detail=False,
)  # fmt: skip
REPEATS = "rating, pooled standard deviation of repeats of a stimulus by a rater"
REPEATED = TableForm(
    "Standard deviation, in points, of a rater's repeated ratings of the same stimulus.",
    (
        RATINGS, Column("SD of repeats", "sd", "rating", method=REPEATS),
    ),
    path="repeat_sd.{scale}.{level}",
)  # fmt: skip


def compute(table: Table, choices: Choices) -> Section:
    """Screen raters, measure their agreement, and repeat the primary analysis without those flagged."""
    rows = table.rows
    single = rows[~rows["scale"].isin(APART) & (rows["role"] != PAIR)]
    if single.empty:
        why = "Raters were not screened: no stimulus was rated by itself."
        return Section(KEY, TITLE, notes=(why,))
    screening = screen_raters(single, rng=choices.make_rng(KEY))
    everyone = screening.table["participant"].nunique()
    slopes, steps = list(_vary(table, screening, choices)), find_table_steps(table)
    return Section(
        key=KEY,
        title=TITLE,
        answers=(_describe_flagged(screening),),
        grids=(
            RULES_APPLIED.build(_list_rules(screening)),
            AGREEMENTS.build(_list_agreements(screening)),
            word_steps(SLOPES, steps).build(add_step(row, steps[row["metric"]]) for row in slopes),
            REPEATED.build(_list_repeats(table)),
        ),
        unseen=tuple(
            count_number(name_path("screening_panel", group), len(_list_flagged(screening, group)), n=everyone)
            for group in GROUPS
        ),
        tables={
            "screening": screening.table, "screening_items": screening.items,
            "screening_excerpts": screening.excerpts, "expertise": screening.gauge, "reliability": screening.panel,
            "slopes_without_hits": slopes,
        },
        pictures=(Picture("raters", CAPTION, partial(draw_raters, screening)),),
        notes=screening.notes,
        how=(*read_methods(KEY), _describe_rules(screening)),
    )  # fmt: skip


def _list_flagged(screening: Screening, group: str) -> list[Hashable]:
    """List whom a group leaves out."""
    standard = [rule for rule in screening.rules if RULES[rule].source.startswith("ITU-R")]
    rules = {"everyone": [], "standard": standard}.get(group, list(screening.rules))
    return sorted({who for rule in rules for who in screening.hits[rule]}, key=str)


def _list_rules(screening: Screening) -> Iterator[dict[str, Any]]:
    for rule, hits in screening.hits.items():
        share = screening.table.loc[screening.table["rule"] == rule, "share"]
        yield {
            "rule": rule, "source": RULES[rule].source,
            "protocols": ", ".join(map(format_name, RULES[rule].protocols)) or "all",
            "flagged": ", ".join(map(str, hits)) or "–", "n_judged": int(share.notna().sum()), "n": len(share),
        }  # fmt: skip


def _list_agreements(screening: Screening) -> Iterator[dict[Any, Any]]:
    for row in screening.panel.to_dict("records"):
        whose = GROUPS["any" if row["panel"] == "without hits" else "everyone"]
        yield row | {"whose": whose, "who": row["panel"].replace(" ", "_")}


def _list_repeats(table: Table) -> Iterator[dict[str, Any]]:
    for part in split_parts(table):
        sd, n = find_repeat_sd(part.rows)
        if n:
            yield part.keys | {"sd": sd, "n": n}


def _vary(table: Table, screening: Screening, choices: Choices) -> Iterator[dict[str, Any]]:
    """Fit each part without those whom each group leaves out; the same people are fitted once."""
    for part in thin_parts(table, choices):
        fitted: dict[tuple[Hashable, ...], list[dict[Any, Any]]] = {}
        for group, whose in GROUPS.items():
            out = tuple(_list_flagged(screening, group))
            if out not in fitted:
                fitted[out] = list(_fit(part, out, table.metrics))
            place = {"panel": group, **part.keys, "_whose": whose}
            yield from (row | place for row in fitted[out])


def _fit(
    part: RatingsPart, out: tuple[Hashable, ...], metrics: tuple[str, ...]
) -> Iterator[dict[Any, Any]]:
    left = part.rows[~part.rows["participant"].isin(out)]
    n_people = len(left["participant"].unique())
    try:
        people = part.rows["participant"].nunique()
        slopes = fit_rest(make_cells(part.rows, metrics), out, people=people)
    except ValueError as error:
        empty = dict.fromkeys(("tenth", "tenth_low", "tenth_high", "p"), float("nan"))
        for name in metrics:
            yield {**empty, "metric": name, "n_people": n_people, "reason": str(error)}
        return
    for row in slopes.reset_index().to_dict("records"):
        yield row | {"n_people": n_people, "reason": ""}


def _describe_rules(screening: Screening) -> str:
    says = [
        f"{format_name(rule)}: {RULES[rule].says.format(limit=limit)}"
        for rule, limit in screening.limits.items()
    ]
    return f"Screening rules: {'; '.join(says)}."


def _describe_flagged(screening: Screening) -> str:
    standard, whole = (len(_list_flagged(screening, group)) for group in ("standard", "any"))
    everyone = screening.table["participant"].nunique()
    own = [rule for rule in screening.rules if RULES[rule].source.startswith("ITU-R")]
    shares = screening.table.loc[screening.table["rule"].isin(own), "share"]
    of_standard = f"{standard} of them by ITU-R BS.1534-3 rules"
    if not shares.notna().any():
        of_standard = "the ITU-R BS.1534-3 rules do not apply to these ratings"
    elif standard == whole:
        included = "those of ITU-R BS.1534-3 included"
        of_standard = "all by ITU-R BS.1534-3 rules" if whole else included
    raters = f"{whole or 'None'} of {everyone} raters {'was' if whole == 1 else 'were'} flagged"
    if everyone == 1:
        raters = f"The only rater was {'' if whole else 'not '}flagged"
    return f"{raters} by screening rules ({of_standard}). Nobody was removed."
