"""Section: the primary model's slopes, what single stimuli, recordings and reducers do to them, and what they need."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from feel321.analysis.association.correlate import correlate
from feel321.analysis.figures.estimates import draw_slopes
from feel321.analysis.figures.scatter import draw_residuals
from feel321.analysis.primary.model import Primary, fit_primary, fit_slopes, tabulate_slopes
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import PREDICTS, find_candidates, measure_influence
from feel321.analysis.report import parts
from feel321.analysis.report.answer import (
    NEEDED,
    Finding,
    describe_findings,
    describe_loss,
    describe_need,
    find_needs,
    orient_differences,
)
from feel321.analysis.report.section import (
    DF,
    METRIC,
    NAME,
    P_HOLM,
    RATINGS,
    TEXT,
    Column,
    P,
    PageTable,
    Picture,
    Section,
    TableForm,
    estimate,
    read_methods,
    stack,
    word_steps,
)
from feel321.analysis.resampling import Choices
from feel321.analysis.table.metrics import Step
from feel321.analysis.table.reading import Table
from feel321.analysis.table.schema import STAND_INS
from feel321.analysis.words import COUNT, TWO_WAY, Claim, Line, capitalise, format_name

Row = dict[Any, Any]
Fits = Mapping[str, tuple[parts.RatingsPart, Primary]]

PER_STEP = "points of rating per {_per} of the metric"
SLOPE = "slope.{scale}.{level}.{metric}"
SLOPES = TableForm(
    "Slope of ratings on each metric within recordings, from a mixed model that holds all metrics, so at the same "
    "values of the others: points from the lower to the upper quartile of the metric within recordings, and per "
    "+0.1 of it; then per +0.1 with reducers as fixed effects, the metric centred on recordings and on reducers. "
    "95 % t intervals with Satterthwaite's df; p adjusted by Holm over this table's {} slopes. A dash: not estimable.",
    (
        RATINGS, METRIC,
        estimate(
            "Quartile to quartile", "quartile_effect",
            "mixed model, points of rating from the metric's lower to its upper quartile within recordings",
            end="quartile_effect", ends="quartile_",
        ),
        estimate("Points per +0.1", "_step", f"mixed model, {PER_STEP}", ends="_step_"),
        estimate(
            "Reducers fixed", "_centred",
            f"mixed model with reducers fixed, {PER_STEP} centred on recordings and reducers",
            end="centred", ends="_centred_",
        ),
        DF, P_HOLM,
    ),
    path=SLOPE, detail=False,
)  # fmt: skip
IN_SD = "in this study's standard deviations"
STANDARDISED = TableForm(
    "The same slopes in this study's standard deviations, which differ from other studies'. 95 % intervals; p not "
    "adjusted.",
    (
        RATINGS, METRIC,
        estimate("Standardised", "standardised", f"slope {IN_SD}", end="standardised", ends="standardised_"), P,
    ),
    path=SLOPE,
)  # fmt: skip
FIRST, SECOND = Column("First", "first", TEXT), Column("Second", "second", TEXT)
DIFFERENCES = TableForm(
    "Slope on the first metric minus slope on the second, in this study's standard deviations: which matters more when "
    "both are known; slopes of metrics where lower is better are reversed first. 95 % intervals; p not "
    "adjusted.",
    (
        RATINGS, FIRST, SECOND,
        estimate("Difference", "standardised_estimate", f"difference of slopes {IN_SD}", ends="standardised_"),
        Column("df", "standardised_df", "df", "df", DF.method), Column("p", "standardised_p", "p", "p", P.method),
    ),
    path="slope_difference.{scale}.{level}.{first}.{second}",
)  # fmt: skip
MODELS = TableForm(
    "The models. Marginal R²: explained by metrics; conditional: by everything in the model. Between stimuli: "
    "share of the spread between stimuli of a recording that the metrics account for (negative by chance).",
    (
        RATINGS, Column("Fit", "fit", NAME),
        Column("Marginal R²", "marginal_r2", end="marginal_r2", method="Nakagawa's marginal R²"),
        Column("Conditional R²", "conditional_r2", end="conditional_r2", method="Nakagawa's conditional R²"),
        Column(
            "Between stimuli", "item_variance_explained", end="item_variance_explained",
            method="share of the variance between stimuli that metrics explain",
        ),
        Column("Rows", "n_rows", COUNT, "n_rows"), Column("Participants", "n_participants", COUNT, "n_participants"),
        Column("Recordings", "n_recordings", COUNT, "n_recordings"), Column("Sources", "n_sources", COUNT, "n_sources"),
        Column("Stimuli", "n_items", COUNT, "n_items"),
    ),
    path="model.{scale}.{level}", n="n_rows",
)  # fmt: skip
INFLUENCE = TableForm(
    "Without a single recording, reducer or stimulus: slopes within recordings, points per +0.1, with 95 % t "
    "intervals; by how many standard errors the slope changes; the verdict on what is left. ",
    (
        RATINGS, METRIC, Column("Left out", "_unit", NAME),
        estimate("Points per +0.1", "_step", f"mixed model without {{_unit}}, {PER_STEP}", ends="_step_"),
        Column("Change in SE", "shift", "slope", "shift", "change of the slope in standard errors of the whole"),
        Column("p (Holm)", "p_holm", "p", "p_holm", "two-sided t test, Holm's adjustment"),
        Column("Verdict", "verdict", TEXT),
    ),
    path="influence.{scale}.{level}.{metric}.{kind}.{unit}",
)  # fmt: skip
EXCEPTIONS = TableForm(
    "Reducers that the metrics do not account for: points by which a reducer's stimuli were rated above what the "
    "slopes without it predict, relative to the other reducers; p adjusted by Bonferroni over reducers.",
    (
        RATINGS, Column("Reducer", "reducer", NAME),
        Column("Excess", "excess", "rating", method="rated above what slopes without the reducer predict"),
        Column("p", "p", "p", "p", "two-sided t test, Bonferroni over reducers"), Column("Exceptional", "_odd", NAME),
    ),
    path="exception.{scale}.{level}.{reducer}",
)  # fmt: skip


def compute(table: Table, choices: Choices) -> Section:
    """Fit the primary model of every scale and level."""
    fits, notes, lines, claims = _fit_parts(table, choices)
    slopes = tabulate_slopes({lead: model for lead, (_, model) in fits.items()}) if fits else ()
    findings = _list_findings(table, fits, slopes)
    tests = sum(one.row["estimable"] for one in findings)
    verdict = list(_describe_parts(findings, tests))
    first = {one.part.lead: one for one in findings}.values()
    claims = [*(one.make_claim() for one in findings), *claims]
    for lead, (_, model) in fits.items():
        own_notes = (*model.reductions, *model.notes)
        notes += [f"{lead}, primary model: {note}" for note in own_notes]
    return Section(
        key="primary",
        title="Change in rating with each metric, within recordings",
        answers=tuple(map(str, verdict)),
        verdict=(*verdict, *lines),
        claims=claims,
        grids=_build_tables(table, fits, findings, choices=choices),
        tables={
            "slopes": slopes,
            "slopes_between": _stack(fits, lambda model: model.between.reset_index()),
            "slope_differences": _stack(fits, lambda model: model.differences),
            "spreads": _stack(fits, lambda model: model.fit.variances),
            "influence": stack(({"ratings": one.part.lead}, one.influence.table) for one in first),
            "exceptions": stack(
                ({"ratings": one.part.lead}, one.influence.exceptions.reset_index()) for one in first
            ),
        },
        pictures=tuple(_draw_models(fits, parts.find_table_steps(table), describe_claims(claims))),
        notes=notes,
        how=read_methods("primary"),
    )  # fmt: skip


def _describe_parts(findings: list[Finding], tests: int) -> Iterator[Line]:
    """Say what each part's model shows, and what would settle what it does not."""
    for part in dict.fromkeys(one.part for one in findings):
        own = [one for one in findings if one.part is part]
        needs = []
        for one in own:
            one.row.update(find_needs(one.row, part, one.model, n_tests=tests))
            shared = one.model.n_sources < one.model.n_recordings
            needs.append(describe_need(one.row, scenes="sources" if shared else "recordings"))
        yield from describe_findings(own, needs)


def _stack(fits: Fits, choose: Any) -> Any:  # noqa: ANN401 - a table of a model, or nothing
    return stack(({"ratings": lead}, choose(model)) for lead, (_, model) in fits.items())


def _fit_parts(table: Table, choices: Choices) -> tuple[Fits, list[str], list[Line], list[Claim]]:
    """Fit every part that can be fitted; say why another part, or a metric of one, cannot."""
    fits, notes, lines, claims = {}, [], [], []
    for part in parts.thin_parts(table, choices):
        notes += [part.thinned] if part.thinned else []
        try:
            model = orient_differences(fit_primary(part.rows, table.metrics), table.info)
            fits[part.lead] = part, model
            lost = [name for name in table.metrics if name not in model.slopes.index]
            told = [describe_loss(part, [name], _explain_loss(part, name)) for name in lost]
        except ValueError as error:
            notes.append(f"{part.lead}: no primary model. {error}")
            told = [describe_loss(part, table.metrics, str(error))]
        lines += [line for line, _ in told]
        claims += [claim for _, own in told for claim in own]
    return fits, notes, lines, claims


def _explain_loss(part: parts.RatingsPart, metric: str) -> str:
    varies = part.rows.groupby("recording", observed=True)[metric].nunique().max() > 1
    return (
        "within recordings it follows from the other metrics"
        if varies
        else "the stimuli of a recording do not differ in it"
    )


def _list_findings(table: Table, fits: Fits, slopes: Any) -> list[Finding]:  # noqa: ANN401 - a table, or none
    """Put every slope together with what single stimuli, recordings and reducers do to it."""
    found: list[Finding] = []
    steps = parts.find_table_steps(table)
    for lead, (part, model) in fits.items():
        own = slopes["attribute"] == lead
        others = slopes.loc[~own, "p"].tolist()
        influence = measure_influence(part.rows, table.metrics, model, others=others)
        for row in slopes[own].to_dict("records"):
            step, info = steps[row["metric"]], table.info.get(row["metric"])
            centred = {
                f"_centred{end}": row[f"centred{end}"] * step.size for end in ("", "_low", "_high")
            }
            turns = {"turns": not influence.find_moves(row["metric"]).empty}
            more = {**part.keys, "n": model.n_rows, **centred}
            told = parts.add_step({**turns, **row, **more}, step)
            found.append(Finding(told, part, model, influence, info, step))
    return found


def _build_tables(
    table: Table, fits: Fits, findings: list[Finding], *, choices: Choices
) -> tuple[PageTable, ...]:
    rows, steps = [one.row for one in findings], parts.find_table_steps(table)
    models = [
        part.keys | {key: getattr(model, key) for key in _MODEL_KEYS}
        | {"fit": "singular" if model.fit.singular else "regular"}
        for part, model in fits.values()
    ]  # fmt: skip
    slopes = word_steps(SLOPES, steps)
    differences = [
        part.keys | {"n": model.n_rows} | row
        for part, model in fits.values()
        for row in model.differences.to_dict("records")
    ]
    return (
        slopes.build(rows, caption=slopes.caption.format(len(rows))),
        DIFFERENCES.build(differences),
        *_build_influence({one.part.lead: one for one in findings}, steps),
        *_build_paper(table, fits, choices),
        STANDARDISED.build(rows),
        MODELS.build(models),
        word_steps(NEEDED, steps).build(rows),
    )


_MODEL_KEYS = (
    "marginal_r2", "conditional_r2", "item_variance_explained", "n_rows", "n_participants", "n_recordings",
    "n_sources", "n_items",
)  # fmt: skip


def _build_influence(
    found: Mapping[str, Finding], steps: Mapping[str, Step]
) -> Iterator[PageTable]:
    """Build the tables of slopes without each unit, those first that turn a verdict, and of exceptional reducers."""
    rows, odd, form = [], [], word_steps(INFLUENCE, steps)
    for one in found.values():
        more = {**one.part.keys, "n": one.model.n_rows}
        rows += [
            parts.add_step(more | row, steps[row["metric"]])
            | {"_unit": f"{row['kind']} {row['unit']}"}
            for row in one.influence.table.to_dict("records")
        ]
        odd += [
            more | row | {"_odd": "yes" if row["exceptional"] else "no"}
            for row in one.influence.exceptions.reset_index().to_dict("records")
        ]
    which = {
        True: "Here: where the verdict or the sign turns, or the slope moves by more than its standard error.",
        False: "Here: all others; the file tables/influence.csv has every one.",
    }
    for moves, told in which.items():
        shown = [row for row in rows if bool(row["moves"]) == moves]
        caption = f"{form.caption}{told}"
        yield replace(form, detail=not moves).build(shown, caption=caption)
    yield EXCEPTIONS.build(odd)


def describe_claims(claims: Sequence[Claim]) -> str:
    """Count the verdicts on each metric over scales and levels, in their own words."""
    scales, levels = ({getattr(one, name) for one in claims} for name in ("scale", "level"))
    number, nouns = len({(one.scale, one.level) for one in claims}), ("scale", "level")
    some = [noun for noun, of in zip(nouns, (scales, levels), strict=True) if len(of) > 1]
    all_of = f" of {number} {' and '.join(f'{noun}s' for noun in some)}"
    told = []
    for metric in dict.fromkeys(one.metric for one in claims):
        counts = Counter(
            f"predicts {one.direction} ratings" if one.verdict == PREDICTS else one.verdict.replace("_", " ")
            for one in claims if one.metric == metric
        )  # fmt: skip
        first = next(iter(counts))
        if len(counts) == 1 and number > 1:
            every = "both" if number == 2 else f"all {number}"  # noqa: PLR2004 - what both means
            told.append(
                f"{format_name(metric)}: {first} on {every}{all_of.removeprefix(f' of {number}')}"
            )
            continue
        own = [
            f"{verdict} on {count}{all_of * (verdict == first)}"
            if number > 1
            else f"{verdict} on the scale"
            for verdict, count in counts.items()
        ]
        told.append(f"{format_name(metric)}: {', '.join(own)}")
    return capitalise("; ".join(told))


def _draw_models(fits: Fits, steps: Mapping[str, Step], title: str) -> Iterator[Picture]:
    if not fits:
        return
    per = parts.join_steps(steps)
    caption = (
        f"Slope within recordings of ratings on each metric, points per {per} of it, mixed model; bars are 95 % "
        "Satterthwaite intervals; hollow: singular fit."
    )
    models = {lead: model for lead, (_, model) in fits.items()}
    yield Picture("slopes", caption, partial(draw_slopes, models, steps=steps, title=title))
    caption = (
        "Residuals of the primary models: left against normal quantiles with a pointwise 95 % band, right against "
        "fitted values."
    )
    names = [part.subject for part, _ in fits.values()]
    draw = partial(draw_residuals, *(model.fit for _, model in fits.values()), names=names)
    yield Picture("residuals", caption, draw, detail=True)


# The paper's own spectral match beside the bounded one: by ranks, and raw with what a single stimulus does to it.

BOUNDED = "spectral_match_bounded"
RAW = STAND_INS[BOUNDED]
OF_RAW = "mixed model, points of rating per +0.1 of eq. 1"
PAPER = TableForm(
    "Spectral match as in the paper (eq. 1), in place of the bounded one. It has no lower bound, so a few stimuli may "
    "decide its slope: Spearman's correlation within recordings with the two-way interval; the slope, in points per "
    "+0.1, and the same without the stimulus that moves it most; 95 % intervals.",
    (
        RATINGS,
        Column(
            "By ranks", "ranks", end="ranks", interval=TWO_WAY, ends="ranks_",
            method="Spearman's correlation within recordings of mean ratings with eq. 1", n="n_items",
        ),
        estimate("Raw slope", "raw", OF_RAW, end="raw", ends="raw_", n="raw_n"), Column("Without", "item", NAME),
        estimate("Raw slope", "rest", OF_RAW, end="raw_without", ends="rest_", n="rest_n"),
    ),
    path="paper.{scale}.{level}.{metric}",
)  # fmt: skip


def _build_paper(table: Table, fits: Fits, choices: Choices) -> Iterator[PageTable]:
    """Build the table of the paper's metric, where the primary analysis uses the bounded one and both are there."""
    if BOUNDED not in table.metrics or RAW not in table.further:
        return
    metrics = [RAW if name == BOUNDED else name for name in table.metrics]
    rows = [
        _compare_paper(part, metrics, choices)
        for part, model in fits.values()
        if model.slopes["estimable"].any()
    ]
    yield PAPER.build(rows)


def _compare_paper(part: parts.RatingsPart, metrics: list[str], choices: Choices) -> Row:
    rng = choices.make_rng("paper", *part.place)
    ranks = correlate(part.rows, RAW, method="within_spearman", draws=choices.draws, rng=rng)
    cells = make_cells(part.rows, metrics)
    item = find_candidates(cells, count=1)[0]
    row: Row = {
        **part.keys, "metric": RAW, "item": item, "ranks": ranks.value, "ranks_low": ranks.low,
        "ranks_high": ranks.high, "n_items": ranks.n_items,
    }  # fmt: skip
    for name, some in (("raw", cells), ("rest", cells.leave_out(parts.ITEM, item))):
        slope = fit_slopes(some).table.loc[RAW]
        row |= {f"{name}{end}": slope[f"tenth{end}"] for end in ("", "_low", "_high")}
        row[f"{name}_n"] = len(some.table)
    return row
