"""The raters: who was flagged by which screening rule, how far they agree, and the slopes without those flagged."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis import words
from feel321.analysis.figures.raters import draw_raters
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import conclude, list_changes
from feel321.analysis.report import parts
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
    stack,
    word_steps,
)
from feel321.analysis.screening.consistency import RaterModel, rater_model
from feel321.analysis.screening.screen import Screening, screen_raters
from feel321.analysis.table.items import recast_pairs
from feel321.analysis.table.schema import APART, PAIR

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.reading import Table

KEY, TITLE = "raters", "Raters"
NORMAL = 1.959963984540054
"""Standard errors on either side of an estimate that make a 95 % interval."""

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
        Column("Flagged", "flagged", NAME), Column("Raters screened", "n_judged", words.COUNT, "n_judged"),
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
        Column("Participants", "n_participants", words.COUNT, "n_participants"),
        Column("Stimuli rated by all", "n_complete", words.COUNT, "n_complete"),
    ),
    path="reliability.{scale}.{who}", n="n_items",
)  # fmt: skip
SLOPES = TableForm(
    "Slopes of the primary analysis (points per +0.1) with and without flagged raters; 95 % t intervals "
    "with Satterthwaite's df, p not adjusted. A dash: too few raters are left to fit the model.",
    (
        RATINGS, METRIC, Column("Raters", "_whose", NAME),
        estimate("Points per +0.1", "_step", "mixed model, points per {_per}", ends="_step_"), P,
        Column("Participants", "n_people", words.COUNT, "n_participants"),
    ),
    path="panel.{scale}.{level}.{metric}.{panel}", n="n_people",
)  # fmt: skip
OF_MODEL = "rater model of ITU-T P.913"
NORMAL_INTERVAL = "95 % normal interval"
MODEL = TableForm(
    "Rater model (ITU-T P.913), in points: bias, how far a rater's ratings lie above the panel's; inconsistency, the "
    "standard deviation of the rater's ratings about the quality of the stimulus plus that bias; 95 % intervals. "
    "Apart: whether the inconsistency is an outlier.",
    (
        RATINGS, Column("Rater", "participant", NAME),
        Column(
            "Bias", "bias", "rating", "bias", f"{OF_MODEL}, points above the panel", NORMAL_INTERVAL, ends="bias_"
        ),
        Column(
            "Inconsistency", "inconsistency", "rating", "inconsistency", f"{OF_MODEL}, standard deviation",
            NORMAL_INTERVAL, ends="inconsistency_",
        ),
        Column("Weight", "weight", end="weight", method=f"{OF_MODEL}, share in the qualities of stimuli"),
        Column("Ratings", "n", words.COUNT, "n"), Column("Apart", "_apart", NAME),
    ),
    path="rater_model.{scale}.{level}.{participant}",
)  # fmt: skip
LIKELIHOOD = TableForm(
    "Rater model: how likely the ratings are, per rating; of two models of the same ratings the one with the lower BIC "
    "describes them better.",
    (
        RATINGS,
        *(
            Column(head, key, "slope", key, f"{OF_MODEL}, per rating")
            for head, key in (("Log-likelihood", "loglikelihood"), ("AIC", "aic"), ("BIC", "bic"))
        ),
        Column("Parameters", "n_parameters", words.COUNT, "n_parameters"),
    ),
    path="rater_model_fit.{scale}.{level}", n="n_ratings",
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
    rows = recast_pairs(table.rows)
    single = rows[~rows["scale"].isin(APART) & (rows["role"] != PAIR)]
    if single.empty:
        why = "Raters were not screened: no stimulus was rated by itself."
        return Section(KEY, TITLE, notes=(why,))
    screening = screen_raters(single, own=choices.rules, rng=choices.make_rng(KEY))
    models, more_notes = _fit_models(single)
    slopes = _conclude_panels(list(_vary(table, screening, choices)))
    steps = parts.find_table_steps(table)
    return Section(
        key=KEY,
        title=TITLE,
        answers=(_describe_flagged(screening), _describe_changes(slopes), *_describe_models(models)),
        grids=(
            RULES_APPLIED.build(_list_rules(screening)),
            AGREEMENTS.build(_list_agreements(screening)),
            word_steps(SLOPES, steps).build(parts.add_step(row, steps[row["metric"]]) for row in slopes),
            REPEATED.build(_list_repeats(table)),
            MODEL.build(_list_raters(models)),
            LIKELIHOOD.build(
                place | {key: getattr(model, key) for key in _FIT} for place, model in models
            ),
        ),
        unseen=tuple(_count_flagged(screening)),
        tables={
            "screening": screening.table, "screening_items": screening.items,
            "screening_excerpts": screening.excerpts, "expertise": screening.gauge, "reliability": screening.panel,
            "slopes_without_hits": slopes, "rater_model": list(_list_raters(models)),
            "rater_model_stimuli": stack(
                ({"ratings": place["_ratings"]}, model.stimuli.reset_index()) for place, model in models
            ),
        },
        pictures=(Picture("raters", CAPTION, partial(draw_raters, screening)),),
        notes=(*screening.notes, *more_notes),
        how=(*read_methods(KEY), _describe_rules(screening)),
    )  # fmt: skip


_FIT = ("loglikelihood", "aic", "bic", "n_parameters", "n_ratings")
Models = list[tuple[dict[str, str], RaterModel]]


def _fit_models(single: DataFrame) -> tuple[Models, list[str]]:
    """Fit the rater model to each scale and level, hidden references and anchors included."""
    models: Models = []
    notes = []
    for scale, level, rows in parts.split_arms(single):
        lead = f"{scale}, {level}"
        try:
            model = rater_model(rows)
        except ValueError as error:
            notes.append(f"{lead}, rater model: none. {error}")
            continue
        models.append(({"scale": scale, "level": level, "_ratings": lead}, model))
        notes += [f"{lead}, rater model: {note}" for note in model.notes]
    return models, notes


def _list_raters(models: Models) -> Iterator[dict[Any, Any]]:
    for place, model in models:
        for row in model.to_frame().to_dict("records"):
            ends = {
                f"{name}_{end}": row[name] + sign * NORMAL * row[f"{name}_se"]
                for name in ("bias", "inconsistency")
                for end, sign in (("low", -1), ("high", 1))
            }
            yield place | row | ends | {"_apart": "yes" if row["apart"] else "no"}


def _describe_models(models: Models) -> Iterator[str]:
    """Say in words who rates high or low, and whether somebody's ratings are unlike all others in consistency."""
    several = len({place["level"] for place, _ in models}) > 1
    for place, model in models:
        subject = words.format_name(place["scale"])
        subject += f" (level {words.format_name(place['level'])})" if several else ""
        told = f"Rater model of {words.format_ratings(subject)}: {_describe_biases(model)}"
        yield f"{told}; {_describe_consistency(model)}."


def _describe_biases(model: RaterModel) -> str:
    """Name the raters with the highest and the lowest bias, where these are more than chance among so many."""
    from scipy.stats import norm

    rows = model.to_frame().sort_values("bias").to_dict("records")
    limit = float(norm.isf(parts.SIGNIFICANCE / 2 / len(rows)))
    told = [
        f"{row['participant']} rates {words.format_number(abs(row['bias']), kind='rating')} points {way}"
        for row, way in ((rows[-1], "higher"), (rows[0], "lower"))
        if abs(row["bias"]) > limit * row["bias_se"]
    ]
    if not told:
        return "no rater rates clearly higher or lower than the panel"
    return f"{' and '.join(told)} than the panel"


def _describe_consistency(model: RaterModel) -> str:
    """Name the raters whose inconsistency is unlike the others', and give the range of the rest."""
    spread = model.raters["inconsistency"]
    rest = spread[~model.raters["apart"]]
    reach = words.format_interval(rest.min(), rest.max(), kind="rating")
    if not model.apart:
        return f"inconsistency ranges from {reach} points, without outliers"
    names = words.join_words(model.apart)
    own = words.format_interval(spread[list(model.apart)].min(), spread.max(), kind="rating")
    one = len(model.apart) == 1
    if one:
        own = words.format_number(spread.max(), kind="rating")
    who = f"{names} {'is' if one else 'are'} far less consistent than the others"
    return f"{who} (a standard deviation of {own} points; the others {reach})"


def _count_flagged(screening: Screening) -> Iterator[words.Number]:
    everyone = screening.table["participant"].nunique()
    for group in GROUPS:
        size = len(_list_flagged(screening, group))
        yield words.count_number(
            words.name_path("screening_panel", group), size, n=everyone, keys="panel"
        )


def _list_flagged(screening: Screening, group: str) -> list[Hashable]:
    """List whom a group leaves out."""
    standard = [
        rule for rule in screening.rules if screening.known[rule].source.startswith("ITU-R")
    ]
    rules = {"everyone": [], "standard": standard}.get(group, list(screening.rules))
    hits = screening.hits
    return sorted({who for rule in rules for who in hits[rule]}, key=str)


def _list_rules(screening: Screening) -> Iterator[dict[str, Any]]:
    for rule, hits in screening.hits.items():
        share = screening.table.loc[screening.table["rule"] == rule, "share"]
        yield {
            "rule": rule, "source": screening.known[rule].source,
            "protocols": ", ".join(map(words.format_name, screening.known[rule].protocols)) or "all",
            "flagged": ", ".join(map(str, hits)) or "–", "n_judged": int(share.notna().sum()), "n": len(share),
        }  # fmt: skip


def _list_agreements(screening: Screening) -> Iterator[dict[Any, Any]]:
    for row in screening.panel.to_dict("records"):
        whose = GROUPS["any" if row["panel"] == "without hits" else "everyone"]
        yield row | {"whose": whose, "who": row["panel"].replace(" ", "_")}


def _list_repeats(table: Table) -> Iterator[dict[str, Any]]:
    for part in parts.split_parts(table):
        sd, n = _find_repeat_sd(part.rows)
        if n:
            yield part.keys | {"sd": sd, "n": n}


def _find_repeat_sd(rows: DataFrame) -> tuple[float, int]:
    """Find the standard deviation of a rater's repeated ratings (NaN without repeats), and how many are repeated."""
    cells = rows.groupby(["participant", "item"], observed=True)["rating"]
    repeated = cells.transform("size") > 1
    n = int(repeated.sum())
    freedom = n - len(rows[repeated].groupby(["participant", "item"], observed=True))
    left = (rows["rating"] - cells.transform("mean"))[repeated]
    return (float(np.sqrt((left**2).sum() / freedom)) if freedom else float("nan")), n


def _vary(table: Table, screening: Screening, choices: Choices) -> Iterator[dict[str, Any]]:
    """Fit each part without those whom each group leaves out; the same people are fitted once."""
    for part in parts.thin_parts(table, choices):
        fitted: dict[tuple[Hashable, ...], list[dict[Any, Any]]] = {}
        for group, whose in GROUPS.items():
            out = tuple(_list_flagged(screening, group))
            if out not in fitted:
                fitted[out] = list(_fit(part, out, table.metrics))
            place = {"panel": group, **part.keys, "_whose": whose}
            yield from (row | place for row in fitted[out])


def _fit(
    part: parts.RatingsPart, out: tuple[Hashable, ...], metrics: tuple[str, ...]
) -> Iterator[dict[Any, Any]]:
    left = part.rows[~part.rows["participant"].isin(out)]
    n_people = len(left["participant"].unique())
    try:
        people = part.rows["participant"].nunique()
        slopes = parts.fit_rest(make_cells(part.rows, metrics), out, people=people)
    except ValueError as error:
        empty = dict.fromkeys(("tenth", "tenth_low", "tenth_high", "p"), float("nan"))
        for name in metrics:
            yield {**empty, "metric": name, "n_people": n_people, "reason": str(error)}
        return
    for row in slopes.reset_index().to_dict("records"):
        yield row | {"n_people": n_people, "reason": ""}


def _describe_rules(screening: Screening) -> str:
    says = [
        f"{words.format_name(rule)}: {screening.known[rule].says.format(limit=limit)}"
        for rule, limit in screening.limits.items()
    ]
    return f"Screening rules: {'; '.join(says)}."


def _conclude_panels(slopes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Give every slope its verdict, adjusted as in the primary analysis: over all slopes of the same raters."""
    rows = []
    for panel in GROUPS:
        own = [row for row in slopes if row["panel"] == panel]
        adjusted = adjust_holm([row["p"] for row in own])
        rows += [row | {"verdict": conclude(p)} for row, p in zip(own, adjusted, strict=True)]
    return rows


def _describe_changes(slopes: Sequence[Mapping[str, Any]]) -> str:
    """Say which verdicts are others without flagged raters."""
    changed = dict.fromkeys(
        f"{words.format_name(row['metric'])} ({words.format_name(row['scale'])}"
        f"{words.format_level(row['level'])})"
        for row in list_changes(slopes)
    )
    if changed:
        return (
            f"Leaving out flagged raters changes the verdict on {words.join_words(list(changed))}."
        )
    return "Leaving out flagged raters changes no verdict."


def _describe_flagged(screening: Screening) -> str:
    standard, whole = (len(_list_flagged(screening, group)) for group in ("standard", "any"))
    everyone = screening.table["participant"].nunique()
    own = [rule for rule in screening.rules if screening.known[rule].source.startswith("ITU-R")]
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
