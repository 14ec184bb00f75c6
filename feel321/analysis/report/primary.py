"""Section: the primary model's slopes, what single stimuli, recordings and reducers do to them, and what they need."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from feel321.analysis.association.correlate import correlate
from feel321.analysis.figures.kinds import draw_residuals, draw_slopes
from feel321.analysis.mixed.model import contrast
from feel321.analysis.primary.model import (
    FEW,
    FEWEST,
    Primary,
    fit_primary,
    fit_slopes,
    tabulate_slopes,
)
from feel321.analysis.primary.plan import REDUCER, SCENE, SOURCE, find_recording_slope, make_cells
from feel321.analysis.primary.precision import (
    SlopePrecision,
    find_own,
    find_recording_variance,
    find_variances,
)
from feel321.analysis.primary.sensitivity import (
    MOVED,
    NOT_ESTIMABLE,
    PREDICTS,
    STIMULUS,
    Influence,
    conclude,
    find_candidates,
    judge_level,
    measure_influence,
)
from feel321.analysis.replication.measures import explain_spread
from feel321.analysis.report import parts
from feel321.analysis.report.section import NONE, Found, Picture, Row, Section, count_rows, make_row
from feel321.analysis.table.schema import STAND_INS
from feel321.analysis.words import SATTERTHWAITE, TWO_WAY, format_count

if TYPE_CHECKING:
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.analysis.table.metrics import Step
    from feel321.types import MetricInfo

HIGHER, LOWER = "higher", "lower"


@dataclass(frozen=True, slots=True, eq=False)
class Slope:
    """A slope of the primary model: its row, the model, and what single units do to it."""

    row: Row
    part: parts.RatingsPart
    model: Primary
    influence: Influence
    step: Step
    info: MetricInfo | None

    @property
    def metric(self) -> str:
        """Name of the metric."""
        return str(self.row["metric"])

    @property
    def hinges(self) -> list[Row]:
        """Units without which a metric that predicts does not, or not in this direction."""
        turns = self.influence.find_turns(self.metric)
        claimed = conclude(self.row["p_holm"]) == PREDICTS
        return list(turns.to_dict("records")) if claimed else []

    def scale(
        self, row: Mapping[Any, Any], name: str = "tenth", *, size: float | None = None
    ) -> dict[str, float]:
        """Take an estimate with its ends, from per 0.1 (or per size) to per step."""
        share = self.step.size / (0.1 if size is None else size)
        return {
            end or "value": float(row[f"{name}_{end}" if end else name]) * share
            for end in ("", "low", "high")
        }


def compute(table: Table, choices: Choices) -> Found:
    """Fit the primary model of every scale and level."""
    models: dict[parts.RatingsPart, Primary] = {}
    notes: list[str] = []
    losses: list[Row] = []
    for part in parts.thin_parts(table, choices):
        notes += [part.thinned] if part.thinned else []
        try:
            model = orient_differences(fit_primary(part.rows, table.metrics), table.info)
        except ValueError as error:
            notes.append(f"{part.lead}: no primary model. {error}")
            losses.append(_lose(part, table.metrics, str(error)))
            continue
        models[part] = model
        notes += [
            f"{part.lead}, primary model: {note}" for note in (*model.reductions, *model.notes)
        ]
        lost = [name for name in table.metrics if name not in model.slopes.index]
        losses += [_lose(part, [name], _explain_loss(part, name)) for name in lost]
    slopes = _list_slopes(table, models)
    verdicts = [make_verdict(one) for one in slopes]
    for loss in losses:
        verdicts += [_blank_verdict(loss, name) for name in loss["metrics"]]
    n_tests = sum(bool(one.row["estimable"]) for one in slopes)
    needs = {(*one.part.place, one.metric): find_needs(one, n_tests=n_tests) for one in slopes}
    told = [
        _describe_part(part, [one for one in slopes if one.part is part], needs) for part in models
    ]
    rows = {
        "slopes": [row for one in slopes for row in _list_estimates(one)],
        "slope_differences": [row for part, model in models.items() for row in _list_differences(part, model)],
        "influence": [row for one in slopes for row in _list_influence(one)],
        "exceptions": [row for one in _take_first(slopes) for row in _list_exceptions(one)],
        "unbounded": list(_compare_unbounded(table, models, choices)),
        "models": [row for part, model in models.items() for row in _describe_model(part, model)],
        "spreads": [
            make_row("sd", row["sd"], n=model.n_rows, group=row["group"], term=row["term"], **part.keys)
            for part, model in models.items() for row in model.fit.variances.to_dict("records")
        ],
        "slopes_between": [row for one in slopes for row in _list_between(one)],
        "precision": [
            row for one in slopes
            for row in count_rows(
                needs[*one.part.place, one.metric], n=one.model.n_rows, metric=one.metric, **one.part.keys
            )
        ],
    }  # fmt: skip
    facts: dict[str, Any] = {"parts": told, "losses": losses, "verdicts": verdicts}
    pictures = tuple(_draw(table, models)) if models else ()
    return Found(rows, facts if verdicts else {}, pictures, notes, verdicts)


def _lose(part: parts.RatingsPart, metrics: Sequence[str], reason: str) -> Row:
    alike = part.rows["rating"].min() == part.rows["rating"].max()
    why = "all ratings are the same" if alike else reason.removesuffix(".")
    return {
        **part.keys,
        "subject": part.subject,
        "ratings": part.ratings,
        "metrics": list(metrics),
        "why": why,
    }


def _explain_loss(part: parts.RatingsPart, metric: str) -> str:
    varies = part.rows.groupby("recording", observed=True)[metric].nunique().max() > 1
    if varies:
        return "within recordings it follows from the other metrics"
    return "the stimuli of a recording do not differ in it"


def _list_slopes(table: Table, models: Mapping[parts.RatingsPart, Primary]) -> list[Slope]:
    """Put every slope together with what single stimuli, recordings and reducers do to it."""
    if not models:
        return []
    found, steps = [], parts.find_table_steps(table)
    slopes = tabulate_slopes({part.lead: model for part, model in models.items()})
    for part, model in models.items():
        own = slopes["attribute"] == part.lead
        others = slopes.loc[~own, "p"].tolist()
        influence = measure_influence(part.rows, table.metrics, model, others=others)
        for row in slopes[own].to_dict("records"):
            name = str(row["metric"])
            found.append(Slope(row, part, model, influence, steps[name], table.info.get(name)))
    return found


def _take_first(slopes: Sequence[Slope]) -> list[Slope]:
    return list({one.part.place: one for one in reversed(slopes)}.values())[::-1]


def orient_differences(model: Primary, info: Mapping[str, MetricInfo]) -> Primary:
    """Compare slopes each in the direction that its metric declares: one of which lower is better changes its sign."""
    worse = {name for name in model.slopes.index if name in info and info[name].higher == "worse"}
    if not worse:
        return model
    scales, rows = (model.slopes["standardised"] / model.slopes["estimate"]).to_dict(), []
    for row in model.differences.to_dict("records"):
        one, other = str(row["first"]), str(row["second"])
        signs = [-1.0 if name in worse else 1.0 for name in (one, other)]
        for prefix, sizes in (("", (1.0, 1.0)), ("standardised_", (scales[one], scales[other]))):
            weights = {f"{one}_w": signs[0] * sizes[0], f"{other}_w": -signs[1] * sizes[1]}
            found = dict(contrast(model.fit, weights)) if math.isfinite(row["low"]) else {}
            row |= {f"{prefix}{key}": value for key, value in found.items()}
        rows.append(row)
    return model.replace(differences=type(model.differences)(rows))


# What is concluded of a slope.


def make_verdict(one: Slope) -> Row:
    """Conclude about a slope, as data: a program reads it, the templates put it into words."""
    verdict = conclude(one.row["p_holm"])
    expected = LOWER if one.info is not None and one.info.higher == "worse" else HIGHER
    direction = ""
    if verdict == PREDICTS:
        direction = HIGHER if one.row["estimate"] > 0 else LOWER
    hinges = [f"{row['kind']} {row['unit']}" for row in one.hinges]
    least = FEWEST if verdict == NOT_ESTIMABLE else FEW
    units = _count_units(one.model).items()
    steady = verdict == PREDICTS and direction == expected and not hinges
    better = [
        str(row["second"] if row["first"] == one.metric else row["first"])
        for row in one.model.differences.to_dict("records")
        if steady and one.metric == find_better(row)
    ]
    return {
        **one.part.keys, "metric": one.metric, "subject": one.part.subject, "ratings": one.part.ratings,
        "verdict": verdict, "direction": direction, "higher": "better" if expected == HIGHER else "worse",
        "opposite": verdict == PREDICTS and direction != expected, "hinges_on": hinges, "better_than": better,
        "few": [format_count(size, name) for name, size in units if size < least],
        "beyond_level": judge_level(one.model.level, one.row["p_holm"], one.row["plain_p_holm"]),
    }  # fmt: skip


def _blank_verdict(loss: Row, metric: str) -> Row:
    blank = {"verdict": NOT_ESTIMABLE, "direction": "", "higher": "better", "opposite": False}
    more = {"hinges_on": [], "better_than": [], "few": [], "beyond_level": "", "metric": metric}
    return {key: loss[key] for key in ("scale", "level", "subject", "ratings")} | more | blank


def find_better(row: Mapping[Any, Any]) -> str:
    """Find which of two metrics has the stronger standardised slope, each in the direction that it declares."""
    low, high = row["standardised_low"], row["standardised_high"]
    if math.isnan(low) or low <= 0 <= high:
        return ""
    return str(row["first"] if low > 0 else row["second"])


def _count_units(model: Primary) -> dict[str, int]:
    scene = SOURCE if model.n_sources < model.n_recordings else SCENE
    reducers = {REDUCER: model.n_reducers} if model.n_reducers else {}
    return {"participant": model.n_participants, scene: model.n_sources} | reducers


# Rows.


def _list_estimates(one: Slope) -> Iterator[Row]:
    row, n = one.row, one.model.n_rows
    keys: Row = {**one.part.keys, "metric": one.metric, "interval": SATTERTHWAITE, "n": n}
    quartile = {end: row[f"quartile_{end}"] for end in ("low", "high")}
    yield make_row("slope_quartile", row["quartile_effect"], **quartile, p=row["p_holm"], **keys)
    yield make_row("slope", **one.scale(row), p=row["p_holm"], **keys)
    yield make_row("step", one.step.size, note=one.step.per, **keys)
    yield make_row("slope_centred", **one.scale(row, "centred", size=1), p=row["centred_p"], **keys)
    if math.isfinite(row["plain"]):
        yield make_row(
            "slope_without_level", row["plain"] * one.step.size, p=row["plain_p_holm"], **keys
        )
    yield make_row("df", row["df"], **keys)
    yield make_row(
        "standardised", **one.scale(row, "standardised", size=one.step.size), p=row["p"], **keys
    )


def _list_between(one: Slope) -> Iterator[Row]:
    between = one.model.between
    if one.metric in between.index:
        row = between.loc[one.metric].to_dict()
        ends = {end: row[end] * one.step.size for end in ("low", "high")}
        keys: Row = {**one.part.keys, "metric": one.metric, "interval": SATTERTHWAITE}
        value = row["estimate"] * one.step.size
        yield make_row("slope_between", value, **ends, p=row["p"], n=one.model.n_rows, **keys)


def _list_differences(part: parts.RatingsPart, model: Primary) -> Iterator[Row]:
    for row in model.differences.to_dict("records"):
        keys: Row = {
            **part.keys,
            "metric": row["first"],
            "second_metric": row["second"],
            "interval": SATTERTHWAITE,
        }
        for quantity, lead in (("difference", ""), ("difference_standardised", "standardised_")):
            ends = {end: row[f"{lead}{end}"] for end in ("low", "high", "p")}
            yield make_row(quantity, row[f"{lead}estimate"], **ends, n=model.n_rows, **keys)
        yield make_row("df", row["standardised_df"], n=model.n_rows, **keys)


def _list_influence(one: Slope) -> Iterator[Row]:
    table = one.influence.table
    if table.empty:
        return
    # Those first that turn a verdict or move a slope.
    own = table[table["metric"] == one.metric].sort_values("moves", ascending=False, kind="stable")
    for row in own.to_dict("records"):
        keys: Row = {
            **one.part.keys,
            "metric": one.metric,
            "kind": row["kind"],
            "unit": row["unit"],
            "n": one.model.n_rows,
        }
        yield make_row("slope", **one.scale(row), p=row["p_holm"], interval=SATTERTHWAITE, **keys)
        yield make_row("shift", row["shift"], **keys)
        yield make_row("verdict", note=str(row["verdict"]).replace("_", " "), **keys)


def _list_exceptions(one: Slope) -> Iterator[Row]:
    for row in one.influence.exceptions.reset_index().to_dict("records"):
        keys: Row = {**one.part.keys, "reducer": row["reducer"], "n": one.model.n_rows}
        yield make_row("excess", row["excess"], p=row["p"], **keys)
        yield make_row("exceptional", note="yes" if row["exceptional"] else "no", **keys)


_SIZES = ("marginal_r2", "conditional_r2", "item_variance_explained")


def _describe_model(part: parts.RatingsPart, model: Primary) -> Iterator[Row]:
    yield make_row(
        "fit", note="singular" if model.fit.singular else "regular", n=model.n_rows, **part.keys
    )
    names = (
        *_SIZES,
        *(f"n_{name}" for name in ("rows", "participants", "recordings", "sources", "items")),
    )
    yield from count_rows(
        {name: getattr(model, name) for name in names}, n=model.n_rows, **part.keys
    )


BOUNDED = "spectral_match_bounded"
UNBOUNDED = STAND_INS[BOUNDED]


def _compare_unbounded(
    table: Table, models: Mapping[parts.RatingsPart, Primary], choices: Choices
) -> Iterator[Row]:
    """Give the paper's own spectral match, where the primary analysis uses the bounded one and both are there."""
    if BOUNDED not in table.metrics or UNBOUNDED not in table.further:
        return
    metrics = [UNBOUNDED if name == BOUNDED else name for name in table.metrics]
    for part, model in models.items():
        if not model.slopes["estimable"].any():
            continue
        rng = choices.make_rng("paper", *part.place)
        ranks = correlate(
            part.rows, UNBOUNDED, method="within_spearman", draws=choices.draws, rng=rng
        )
        cells = make_cells(part.rows, metrics)
        item = find_candidates(cells, count=1)[0]
        keys: Row = {**part.keys, "metric": UNBOUNDED}
        yield make_row(
            "ranks",
            ranks.value,
            low=ranks.low,
            high=ranks.high,
            n=ranks.n_items,
            interval=TWO_WAY,
            **keys,
        )
        for quantity, some in (
            ("slope", cells),
            ("slope_without", cells.leave_out(parts.ITEM, item)),
        ):
            row: Any = fit_slopes(some).table.loc[UNBOUNDED]
            ends = {"low": row["tenth_low"], "high": row["tenth_high"], "n": len(some.table)}
            yield make_row(quantity, row["tenth"], **ends, interval=SATTERTHWAITE, **keys)
        yield make_row("stimulus", note=item, **keys)


# What a larger study would know.


def find_needs(one: Slope, *, n_tests: int) -> dict[str, float]:
    """Find what would settle a slope; NaN where nothing can be planned from it."""
    turns = not one.influence.find_moves(one.metric).empty
    if not one.row["estimable"] or turns:
        return dict.fromkeys(("detectable", "participants", "recordings", "power_infinite"), NONE)
    study, slope = (
        find_precision(one.metric, one.part, one.model, n_tests=n_tests),
        one.row["estimate"],
    )
    return {
        "detectable": study.find_slope() * one.step.size,
        "participants": study.find_participants(slope),
        "recordings": study.find_recordings(slope),
        "power_infinite": study.enlarge(participants=10**9).find_power(slope),
    }


def find_precision(
    metric: str, part: parts.RatingsPart, model: Primary, *, n_tests: int = 1
) -> SlopePrecision:
    """Take the standard error of a slope apart, by the spreads that were estimated."""
    cells = make_cells(part.rows, list(model.slopes.index))
    within = [f"{name}_w" for name in model.slopes.index]
    variances = model.fit.variances.to_dict("records")
    spreads = {(row["group"], row["term"]): float(row["sd"]) for row in variances}
    found = {group: sd for (group, term), sd in spreads.items() if term == "(Intercept)"}
    pairs = part.rows.groupby(["participant", parts.ITEM], observed=True)
    repeats = 1 if model.averaged else len(part.rows) / len(pairs)
    items = cells.table.drop_duplicates(parts.ITEM)
    known = REDUCER in found or f"participant:{REDUCER}" in found
    codes = items[REDUCER].factorize()[0] if known else None
    study = SlopePrecision(
        slope_sd=spreads.get(("participant", f"{metric}_w"), 0.0), item_sd=found.get(parts.ITEM, 0.0),
        noise_sd=math.hypot(found.get("participant:item", 0.0), model.fit.residual_sd / math.sqrt(repeats)), square=1.0,
        n_participants=model.n_participants, n_recordings=model.n_sources, n_items=len(items), n_slopes=len(within),
        reducer_sd=found.get(REDUCER, 0.0), rater_reducer_sd=found.get(f"participant:{REDUCER}", 0.0),
        n_reducers=model.n_reducers if known else 0, n_alike=len(items) / model.n_reducers if known else 1.0,
        level=parts.SIGNIFICANCE / n_tests,
    )  # fmt: skip
    place, values = within.index(f"{metric}_w"), items[within].to_numpy()
    own, alike = find_own(values, place, codes, variances=find_variances(study))
    study = replace(study, square=float((own**2).sum()), reducer_square=float((alike**2).sum()))
    sds = [find_recording_slope(spreads, name) for name in model.slopes.index]
    scenes = items[SOURCE if cells.shared else SCENE].factorize()[0]
    theirs = find_recording_variance(study, own, alike, scenes=scenes, spreads=values * sds)
    study = replace(study, recording_variance=theirs)
    if not cells.shared:
        return study
    # Of stimuli that share a residual, metrics that they share too add up before they are squared.
    groups = [SOURCE, REDUCER]
    sums = items.assign(own=own).groupby(groups, observed=True)["own"].sum()
    shared = found.get(":".join(groups), 0.0) ** 2 * float((sums**2).sum()) / study.square
    n_items = cells.count(*groups)
    return replace(study, item_sd=math.sqrt(study.item_sd**2 + shared), n_items=n_items)


# Facts for the words.


def _describe_part(
    part: parts.RatingsPart,
    slopes: Sequence[Slope],
    needs: Mapping[tuple[str, str, str], dict[str, float]],
) -> Row:
    """Gather what the template says of one scale and level."""
    model, influence = slopes[0].model, slopes[0].influence
    findings = [_describe_slope(one, needs[*part.place, one.metric]) for one in slopes]
    tried = influence.table
    kinds: Any = (
        [] if tried.empty else tried.loc[tried["verdict"] != NOT_ESTIMABLE, "kind"].unique()
    )
    return {
        "subject": part.subject, "ratings": part.ratings, "findings": findings,
        "blank": all(one["verdict"] == NOT_ESTIMABLE for one in findings),
        "comparisons": list(_compare_slopes(model, findings)),
        "exceptions": [
            row for row in influence.exceptions.reset_index().to_dict("records") if row["exceptional"]
        ],
        "spreads": list(filter(None, (explain_spread(part.rows, one.metric) for one in slopes))),
        "unbounded": any(one.metric == UNBOUNDED for one in slopes),
        "sizes": _count_units(model), "n_items": model.n_items, "n_recordings": model.n_recordings,
        "level": model.level, "tried": [kind for kind in kinds if kind != STIMULUS],
    }  # fmt: skip


def _describe_slope(one: Slope, needs: dict[str, float]) -> Row:
    row, moves = one.row, one.influence.find_moves(one.metric).to_dict("records")
    moved = [unit for unit in moves if abs(unit["shift"]) > MOVED]
    return make_verdict(one) | {
        "quartile": {"value": row["quartile_effect"], "low": row["quartile_low"], "high": row["quartile_high"]},
        "step": one.scale(row), "per": one.step.per, "p": row["p_holm"], "needs": needs,
        "hinges": [_describe_unit(one, unit) for unit in one.hinges],
        "moves": [] if one.hinges else [_describe_unit(one, unit) for unit in moved],
        "scenes": "sources" if one.model.n_sources < one.model.n_recordings else "recordings",
    }  # fmt: skip


def _describe_unit(one: Slope, unit: Mapping[Any, Any]) -> Row:
    named = {"name": f"{unit['kind']} {unit['unit']}", "verdict": unit["verdict"]}
    return named | {"direction": HIGHER if unit["tenth"] > 0 else LOWER, "step": one.scale(unit)}


def _compare_slopes(model: Primary, findings: Sequence[Row]) -> Iterator[Row]:
    """Say which of two metrics predicts better, in the same model and over the spread of each."""
    by_metric = {one["metric"]: one for one in findings}
    for row in model.differences.to_dict("records"):
        pair = [by_metric[str(row["first"])], by_metric[str(row["second"])]]
        ends = {
            end or "value": row[f"standardised_{end or 'estimate'}"] for end in ("", "low", "high")
        }
        if math.isnan(ends["low"]) or NOT_ESTIMABLE in {one["verdict"] for one in pair}:
            continue
        better = find_better(row)
        settled = better and by_metric[better]["direction"] and not by_metric[better]["opposite"]
        others = [one["metric"] for one in pair if one["metric"] != better]
        yield {
            "metrics": [one["metric"] for one in pair], "difference": ends,
            "unsteady": [one["metric"] for one in pair if one["hinges"]],
            "better": better if settled else "", "worse": others[0],
        }  # fmt: skip


def _draw(table: Table, models: Mapping[parts.RatingsPart, Primary]) -> Iterator[Picture]:
    steps = parts.find_table_steps(table)
    caption = (
        f"Slope within recordings of ratings on each metric, points per {parts.join_steps(steps)} of it, mixed model; "
        "bars: 95 % Satterthwaite intervals, not adjusted; hollow: singular fit."
    )
    drawn = {part.subject: model for part, model in models.items()}
    yield Picture("slopes", caption, partial(draw_slopes, drawn, steps))
    caption = "Residuals of the primary models: left against normal quantiles, right against fitted values."
    yield Picture("residuals", caption, partial(draw_residuals, drawn), detail=True)


SECTION = Section(
    "primary", "Change in rating with each metric, within recordings", "predict", compute
)
