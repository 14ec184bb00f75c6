"""Sections on slopes within recordings: the primary model, and the same under other choices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pandas import DataFrame

from feel321.analysis.mixed.model import contrast
from feel321.analysis.primary import sensitivity
from feel321.analysis.primary.model import FEW, FEWEST, Primary, fit_primary, tabulate_slopes
from feel321.analysis.primary.plan import REDUCER, SCENE, SOURCE
from feel321.analysis.primary.sensitivity import NOT_ESTIMABLE, PREDICTS, Influence, conclude
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Row, read_ends
from feel321.analysis.table.columns import ROTATIONS, TENTH, Step
from feel321.analysis.table.items import Part, Table, split_tests
from feel321.analysis.table.schema import STAND_INS
from feel321.analysis.words import format_name

if TYPE_CHECKING:
    from feel321.analysis.resampling import Choices
    from feel321.types import MetricInfo

HIGHER, LOWER = "higher", "lower"
PLACE = ("scale", "level", "metric")
# The verdict on a metric without a slope
BLANK: Row = {
    "verdict": NOT_ESTIMABLE, "direction": "", "higher": "better", "opposite": False, "hinges_on": [],
    "better_than": [], "few": [], "beyond_level": "",
}  # fmt: skip
# What programs are told of a slope; the words need more
VERDICT = ("scale", "level", "metric", "subject", "ratings", *BLANK)


def per_step(slopes: DataFrame, steps: Mapping[str, Step]) -> DataFrame:
    """Add to slopes per 0.1 of metrics, with their ends, the same per step, and the step."""
    size = slopes["metric"].map({name: step.size for name, step in steps.items()})
    names = "tenth", "tenth_low", "tenth_high"
    value, low, high = (slopes[name] * size / TENTH for name in names)
    per = slopes["metric"].map({name: step.per for name, step in steps.items()})
    return slopes.assign(value=value, low=low, high=high, size=size, per=per)


def compute(table: Table, choices: Choices) -> Found:
    """Fit the primary model of every scale and level."""
    found = Found(key="primary")
    models, losses = _fit(found, table, choices)
    steps = parts.find_table_steps(table) if models else {}
    slopes, told = list[Row](), list[Row]()
    if models:
        tabulated = per_step(tabulate_slopes({one.lead: fit for one, fit in models.items()}), steps)
        names = ["centred", "centred_low", "centred_high", "plain"]
        tabulated[names] = tabulated[names].mul(tabulated["size"], axis=0)
        slopes = tabulated.to_dict("records")
    for part, model in models.items():
        others = [row["p"] for row in slopes if row["attribute"] != part.lead]
        influence = sensitivity.measure_influence(part.rows, table.metrics, model, others=others)
        if not influence.table.empty:
            influence = replace(influence, table=per_step(influence.table, steps))
        scene = SOURCE if model.n_sources < model.n_recordings else SCENE
        units = {"participant": model.n_participants, scene: model.n_sources}
        units |= {REDUCER: model.n_reducers} if model.n_reducers else {}
        rows = [row for row in slopes if row["attribute"] == part.lead]
        of_part = {**part.keys, "subject": part.subject, "ratings": part.ratings}
        findings = keep_steady([
            of_part | conclude_slope(row, model, influence, info=table.info, units=units)
            for row in rows
        ])
        found.verdicts += [{key: one[key] for key in VERDICT} for one in findings]
        _add_rows(found, part, model, influence=influence, slopes=rows)
        told.append(_describe_part(part, model, influence, findings=findings))
    for loss in losses:
        keys = {key: loss[key] for key in ("scale", "level", "subject", "ratings")}
        found.verdicts += [keys | {"metric": name} | BLANK for name in loss["metrics"]]
    if found.verdicts:
        found.facts = {"parts": told, "losses": losses, "verdicts": found.verdicts}
    if models:
        _draw_slopes(found, models, steps)
        drawn = {part.subject: model for part, model in models.items()}
        found.draw("residuals", "residuals", drawn, says={})
    return found


def _draw_slopes(found: Found, models: Mapping[Part, Primary], steps: Mapping[str, Step]) -> None:
    """Draw the slopes as the table has them: a heading per scale and level, a row per metric."""
    kinds, rows = {step.per for step in steps.values()}, []
    fits = {part.place: (part.subject, not model.fit.singular) for part, model in models.items()}
    for row in (row for row in found.rows["slopes"] if row["quantity"] == "slope"):
        subject, filled = fits[row["scale"], row["level"]]
        name = format_name(row["metric"]) + f", per {steps[row['metric']].per}" * (len(kinds) > 1)
        rows.append(row | {"name": name, "subject": subject, "filled": filled})
    per = kinds.pop() if len(kinds) == 1 else "step"
    label = f"Points of rating per {per} of metric"
    found.draw("slopes", "slopes", DataFrame(rows), label, says={"per": per})


def _fit(found: Found, table: Table, choices: Choices) -> tuple[dict[Part, Primary], list[Row]]:
    """Fit the models; also list which metrics have no slope, and why."""
    models: dict[Part, Primary] = {}
    losses: list[Row] = []

    def lose(part: Part, metrics: Sequence[str], why: str) -> None:
        if part.rows["rating"].min() == part.rows["rating"].max():
            why = "all ratings are the same"
        told = {"subject": part.subject, "ratings": part.ratings, "metrics": list(metrics)}
        losses.append({**part.keys, **told, "why": why})

    for part in parts.thin_parts(table, choices):
        found.notes += [part.thinned] if part.thinned else []
        try:
            model = orient_differences(fit_primary(part.rows, table.metrics), table.info)
        except ValueError as error:
            found.notes.append(f"{part.lead}: no primary model. {error}")
            lose(part, table.metrics, str(error).removesuffix("."))
            continue
        models[part] = model
        said = (*model.reductions, *model.notes)
        found.notes += [f"{part.lead}, primary model: {note}" for note in said]
        for name in (name for name in table.metrics if name not in model.slopes.index):
            varies = part.rows.groupby("recording", observed=True)[name].nunique().max() > 1
            lost = "within recordings it follows from the other metrics"
            lose(part, [name], lost if varies else "the stimuli of a recording do not differ in it")
    return models, losses


def orient_differences(model: Primary, info: Mapping[str, MetricInfo]) -> Primary:
    """Compare slopes each in the direction that its metric declares: one of which lower is better changes its sign."""
    worse = {name for name, one in info.items() if one.higher == "worse"}
    signs = {name: -1.0 if name in worse else 1.0 for name in map(str, model.slopes.index)}
    if min(signs.values(), default=1.0) > 0:
        return model
    scales = (model.slopes["standardised"] / model.slopes["estimate"]).to_dict()
    rows = []
    for row in model.differences.to_dict("records"):
        one, other = str(row["first"]), str(row["second"])
        for prefix, sizes in (("", (1.0, 1.0)), ("standardised_", (scales[one], scales[other]))):
            weights = {f"{one}_w": signs[one] * sizes[0], f"{other}_w": -signs[other] * sizes[1]}
            found = dict(contrast(model.fit, weights)) if math.isfinite(row["low"]) else {}
            row |= {f"{prefix}{key}": value for key, value in found.items()}
        rows.append(row)
    return model.replace(differences=type(model.differences)(rows))


def conclude_slope(
    row: Row, model: Primary, influence: Influence, *, info: Mapping[str, MetricInfo], units: Mapping[str, int]
) -> Row:  # fmt: skip
    """Conclude about a slope, as data: a program reads the verdict, the templates put all of it into words."""

    def describe(unit: Row) -> Row:
        direction = HIGHER if unit["tenth"] > 0 else LOWER
        named = {"name": f"{unit['kind']} {unit['unit']}", "verdict": unit["verdict"]}
        return named | {"direction": direction, "step": read_ends(unit)}

    metric, verdict, direction = str(row["metric"]), conclude(row["p_holm"]), ""
    expected = LOWER if metric in info and info[metric].higher == "worse" else HIGHER
    if verdict == PREDICTS:
        direction = HIGHER if row["estimate"] > 0 else LOWER
    # The units without which a metric that predicts does not, or not in this direction.
    moves = influence.find_moves(metric).to_dict("records")
    hinges = [describe(unit) for unit in moves if unit["turns"] and verdict == PREDICTS]
    moved = [describe(unit) for unit in moves if abs(unit["shift"]) > sensitivity.MOVED]
    steady = verdict == PREDICTS and direction == expected and not hinges
    pairs = model.differences.to_dict("records") if steady else []
    return {
        "metric": metric, "verdict": verdict, "direction": direction,
        "higher": "better" if expected == HIGHER else "worse",
        "opposite": verdict == PREDICTS and direction != expected,
        "hinges_on": [unit["name"] for unit in hinges],
        "better_than": [
            str(pair["second"] if pair["first"] == metric else pair["first"])
            for pair in pairs if metric == find_better(pair)
        ],
        "few": parts.list_few(units, FEWEST if verdict == NOT_ESTIMABLE else FEW),
        "beyond_level": sensitivity.judge_level(model.level, row["p_holm"], row["plain_p_holm"]),
        "quartile": read_ends(row, "quartile_effect quartile_low quartile_high"), "p": row["p_holm"],
        "step": read_ends(row), "per": row["per"], "hinges": hinges, "moves": [] if hinges else moved,
    }  # fmt: skip


def keep_steady(verdicts: Sequence[Row]) -> list[Row]:
    """Let no metric be better than one whose verdict a single unit turns: which is better is then left open."""
    unsteady = {one["metric"] for one in verdicts if one["hinges_on"]}
    return [
        one | {"better_than": [name for name in one["better_than"] if name not in unsteady]}
        for one in verdicts
    ]


def find_better(row: Mapping[Any, Any]) -> str:
    """Find which of two metrics has the stronger standardised slope, each in the direction that it declares."""
    low, high = row["standardised_low"], row["standardised_high"]
    if math.isnan(low) or low <= 0 <= high:
        return ""
    return str(row["first"] if low > 0 else row["second"])


def _add_rows(
    found: Found, part: Part, model: Primary, *, influence: Influence, slopes: Sequence[Row]
) -> None:
    """Add the rows of one model and its slopes; of units, first those that turn a verdict or move a slope."""
    keys: Row = {**part.keys, "n": model.n_rows}
    found.add("models", [{**model, "fit": "singular" if model.fit.singular else "regular"}], **keys)
    found.add("spreads", model.fit.variances, **keys)
    found.add("slope_differences", model.differences, **keys)
    found.add("slopes", slopes, **keys)
    order = {row["metric"]: (place, row["size"]) for place, row in enumerate(slopes)}
    between = model.between[model.between.index.isin(order)].reset_index()
    size = between["metric"].map(lambda name: order[name][1])
    ends = {name: between[name] * size for name in ("estimate", "low", "high")}
    found.add("slopes_between", between.assign(**ends), **keys)
    if not influence.table.empty:
        units = influence.table.assign(verdict=influence.table["verdict"].str.replace("_", " "))
        place = units["metric"].map(lambda name: order[name][0])
        units = units.assign(place=place, stays=~units["moves"])
        found.add("influence", units.sort_values(["place", "stays"], kind="stable"), **keys)
    found.add("exceptions", influence.exceptions.reset_index(), **keys)


def _describe_part(
    part: Part, model: Primary, influence: Influence, *, findings: Sequence[Row]
) -> Row:
    """Gather what the template says of one scale and level."""
    kinds, spreads = list[str](), list[str]()
    if not influence.table.empty:
        tried = influence.table["verdict"] != NOT_ESTIMABLE
        kinds = list(influence.table.loc[tried, "kind"].unique())
    for name in (one["metric"] for one in findings if one["metric"] in ROTATIONS):
        from feel321.analysis.replication import explain_spread

        spreads.append(explain_spread(part.rows, name))
    odd = influence.exceptions.reset_index().to_dict("records")
    return {
        "subject": part.subject, "ratings": part.ratings, "findings": findings,
        "blank": all(one["verdict"] == NOT_ESTIMABLE for one in findings),
        "exceptions": [row for row in odd if row["exceptional"]],
        "spreads": list(filter(None, spreads)),
        "unbounded": any(one["metric"] in STAND_INS.values() for one in findings),
        "n_items": model.n_items, "level": model.level,
        "tried": [kind for kind in kinds if kind != sensitivity.STIMULUS],
    }  # fmt: skip


# The primary slopes under other choices.

MOST_CELLS = 20_000  # Participants x stimuli beyond which the models would take many minutes


def compute_robustness(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Repeat the primary analysis under other choices."""
    found = Found(key="robustness")
    for part in split_tests(table):
        cells = len(part.rows.groupby(["participant", "item"], observed=True))
        if cells > MOST_CELLS or parts.is_large(part.rows, len(table.metrics)):
            why = f"{cells} participant x stimulus cells are too many."
            found.notes.append(f"{part.lead}: no variants. {why}")
            continue
        lead = f"{part.lead}: no variants."
        varied = found.attempt(lead, sensitivity.vary_primary, part.rows, table.metrics)
        if varied is None:
            continue
        found.add("variants", varied, **part.keys, n=len(part.rows))
        frame = varied.rename(columns={"variant": "name"}).assign(filled=~varied["singular"])
        slug, says = parts.make_slug("variants", *part.place), {"ratings": part.ratings}
        found.draw("variants", slug, frame, says=says, detail=bool(found.pictures))
        own = varied.drop_duplicates("variant").set_index("variant")["reason"]
        # What the primary model lacks is said in its own section.
        others = own[(own != "") & (own != own["primary"])]
        for reason, names in others.groupby(others, sort=False).groups.items():
            found.notes.append(f"{part.lead}, {'; '.join(names)}: {reason}")
    # Slopes whose interval excludes zero in the primary model, and not so under another choice.
    rows = [row for row in found.rows["variants"] if row["quantity"] == "standardised"]
    signs = {tuple(row[key] for key in (*PLACE, "variant")): find_sign(row) for row in rows}
    known = [row for row in rows if math.isfinite(row["low"])]
    turned = [
        row for row in known if find_sign(row) != signs[*(row[key] for key in PLACE), "primary"]
    ]
    if rows:
        found.facts |= {"turned": turned, "known": bool(known)}
    return found


def find_sign(row: Row) -> int:
    """Find on which side of zero an interval lies; 0 where it covers it."""
    return int(row["low"] > 0) - int(row["high"] < 0)
