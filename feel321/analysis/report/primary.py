"""Sections on slopes within recordings: the primary model, all metrics ranked, and the model under other choices."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.association import rivals
from feel321.analysis.association.correlate import correlate
from feel321.analysis.figures import kinds
from feel321.analysis.mixed.model import contrast
from feel321.analysis.primary import sensitivity
from feel321.analysis.primary.model import FEW, FEWEST, fit_primary, fit_slopes, tabulate_slopes
from feel321.analysis.primary.plan import REDUCER, SCENE, SOURCE, make_cells
from feel321.analysis.primary.sensitivity import NOT_ESTIMABLE, PREDICTS, conclude
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Picture, Row, Section, list_rows, make_row
from feel321.analysis.table.items import Part, format_recordings, split_tests
from feel321.analysis.table.metrics import ROTATIONS
from feel321.analysis.table.schema import AMPLITUDE, STAND_INS
from feel321.analysis.words import SATTERTHWAITE, TWO_WAY, format_count, format_name

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.primary.model import Primary
    from feel321.analysis.primary.sensitivity import Influence
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.analysis.table.metrics import Step
    from feel321.records import Statistic
    from feel321.types import MetricInfo

HIGHER, LOWER = "higher", "lower"


@dataclass(frozen=True, slots=True, eq=False)
class Slope:
    """A slope of the primary model: its row, the model, and what single units do to it."""

    row: Row
    part: Part
    model: Primary
    influence: Influence
    step: Step
    info: MetricInfo | None

    @property
    def metric(self) -> str:
        """Name of the metric."""
        return str(self.row["metric"])

    @property
    def keys(self) -> Row:
        """What its rows say of it."""
        keys = {"metric": self.metric, "interval": SATTERTHWAITE, "n": self.model.n_rows}
        return {**self.part.keys, **keys}

    @property
    def hinges(self) -> list[Row]:
        """Units without which a metric that predicts does not, or not in this direction."""
        turns = self.influence.find_turns(self.metric)
        claimed = conclude(self.row["p_holm"]) == PREDICTS
        return list(turns.to_dict("records")) if claimed else []

    def scale(
        self, row: Mapping[Any, Any], name: str = "tenth", *, size: float = 0.1
    ) -> dict[str, float]:
        """Take an estimate with its ends, from per size to per step."""
        ends = {"value": name, "low": f"{name}_low", "high": f"{name}_high"}
        return {key: float(row[end]) * self.step.size / size for key, end in ends.items()}


def compute(table: Table, choices: Choices) -> Found:
    """Fit the primary model of every scale and level."""
    models: dict[Part, Primary] = {}
    notes: list[str] = []
    losses: list[Row] = []
    for part in parts.thin_parts(table, choices):
        notes += [part.thinned] if part.thinned else []
        try:
            model = orient_differences(fit_primary(part.rows, table.metrics), table.info)
        except ValueError as error:
            notes.append(f"{part.lead}: no primary model. {error}")
            losses.append(_lose(part, table.metrics, str(error).removesuffix(".")))
            continue
        models[part] = model
        said = (*model.reductions, *model.notes)
        notes += [f"{part.lead}, primary model: {note}" for note in said]
        for name in (name for name in table.metrics if name not in model.slopes.index):
            varies = part.rows.groupby("recording", observed=True)[name].nunique().max() > 1
            lost = "within recordings it follows from the other metrics"
            same = "the stimuli of a recording do not differ in it"
            losses.append(_lose(part, [name], lost if varies else same))
    slopes = _list_slopes(table, models)
    verdicts = [make_verdict(one) for one in slopes]
    for loss in losses:
        told = {key: loss[key] for key in ("scale", "level", "subject", "ratings")}
        verdicts += [told | {"metric": name} | BLANK for name in loss["metrics"]]
    own = {part: [one for one in slopes if one.part is part] for part in models}
    rows: dict[str, list[Row]] = {name: [] for name in TABLES}
    for part, model in models.items():
        _list_model(part, model, rows)
        for one in own[part]:
            _list_slope(one, rows)
            rows["influence"] += _list_influence(one)
        odd = own[part][0].influence.exceptions.reset_index()
        quantities = {"excess": "excess - - p", "exceptional": "exceptional"}
        rows["exceptions"] += list_rows(odd, quantities, [REDUCER], n=model.n_rows, **part.keys)
    rows["unbounded"] = list(_compare_unbounded(table, models, choices))
    facts: dict[str, Any] = {
        "parts": [_describe_part(part, mine) for part, mine in own.items()],
        "losses": losses,
        "verdicts": verdicts,
    }
    pictures = list(_draw(table, models)) if models else []
    return Found(rows, facts if verdicts else {}, pictures, notes, verdicts)


TABLES = (
    "slopes", "slope_differences", "influence", "exceptions", "unbounded", "models", "spreads", "slopes_between",
)  # fmt: skip


def _lose(part: Part, metrics: Sequence[str], why: str) -> Row:
    alike = part.rows["rating"].min() == part.rows["rating"].max()
    why = "all ratings are the same" if alike else why
    told = {"subject": part.subject, "ratings": part.ratings, "metrics": list(metrics), "why": why}
    return {**part.keys, **told}


def _list_slopes(table: Table, models: Mapping[Part, Primary]) -> list[Slope]:
    """Put every slope together with what single stimuli, recordings and reducers do to it."""
    if not models:
        return []
    found, steps = [], parts.find_table_steps(table)
    slopes = tabulate_slopes({part.lead: model for part, model in models.items()})
    for part, model in models.items():
        own = slopes["attribute"] == part.lead
        others = slopes.loc[~own, "p"].tolist()
        influence = sensitivity.measure_influence(part.rows, table.metrics, model, others=others)
        for row in slopes[own].to_dict("records"):
            name = str(row["metric"])
            found.append(Slope(row, part, model, influence, steps[name], table.info.get(name)))
    return found


def orient_differences(model: Primary, info: Mapping[str, MetricInfo]) -> Primary:
    """Compare slopes each in the direction that its metric declares: one of which lower is better changes its sign."""
    signs = {
        name: -1.0 if name in info and info[name].higher == "worse" else 1.0
        for name in map(str, model.slopes.index)
    }
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


# What is concluded of a slope.

BLANK: Row = {
    "verdict": NOT_ESTIMABLE, "direction": "", "higher": "better", "opposite": False, "hinges_on": [],
    "better_than": [], "few": [], "beyond_level": "",
}  # fmt: skip
"""The verdict on a metric without a slope."""


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
        "beyond_level": sensitivity.judge_level(one.model.level, one.row["p_holm"], one.row["plain_p_holm"]),
    }  # fmt: skip


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


SLOPES = {
    "slope_quartile": "quartile_effect quartile_low quartile_high p_holm", "slope": "value low high p_holm",
    "slope_centred": "centred centred_low centred_high centred_p", "df": "df",
    "standardised": "standardised standardised_low standardised_high p",
    "slope_without_level": "plain - - plain_p_holm",
}  # fmt: skip


def _list_slope(one: Slope, rows: dict[str, list[Row]]) -> None:
    size, row = one.step.size, one.row
    scaled = {name: row[name] * size for name in ("centred", "centred_low", "centred_high", "plain")}  # fmt: skip
    found = list_rows([row | scaled | one.scale(row)], SLOPES, **one.keys)
    rows["slopes"] += found if math.isfinite(row["plain"]) else found[:-1]
    rows["slopes"].append(make_row("step", size, note=one.step.per, **one.keys))
    between = one.model.between
    if one.metric in between.index:
        row = between.loc[one.metric].to_dict()
        row |= {name: row[name] * size for name in ("estimate", "low", "high")}
        quantities = {"slope_between": "estimate low high p"}
        rows["slopes_between"] += list_rows([row], quantities, **one.keys)


SIZES = (
    "marginal_r2", "conditional_r2", "item_variance_explained", "n_rows", "n_participants", "n_recordings",
    "n_sources", "n_items",
)  # fmt: skip


def _list_model(part: Part, model: Primary, rows: dict[str, list[Row]]) -> None:
    keys: Row = {**part.keys, "n": model.n_rows}
    fit = {"fit": "singular" if model.fit.singular else "regular"}
    sizes = {name: getattr(model, name) for name in SIZES}
    rows["models"] += list_rows([fit | sizes], ["fit", *SIZES], **keys)
    rows["spreads"] += list_rows(model.fit.variances, ["sd"], ["group", "term"], **keys)
    standardised = [f"standardised_{end}" for end in ("estimate", "low", "high", "p")]
    quantities = {
        "difference": "estimate low high p", "difference_standardised": " ".join(standardised),
        "df": "standardised_df",
    }  # fmt: skip
    pair = {"metric": "first", "second_metric": "second"}
    rows["slope_differences"] += list_rows(
        model.differences, quantities, pair, interval=SATTERTHWAITE, **keys
    )


def _list_influence(one: Slope) -> list[Row]:
    """List what each unit does, first those that turn a verdict or move a slope."""
    table = one.influence.table
    if table.empty:
        return []
    own = table[table["metric"] == one.metric].sort_values("moves", ascending=False, kind="stable")
    records = [
        row | one.scale(row) | {"verdict": str(row["verdict"]).replace("_", " ")}
        for row in own.to_dict("records")
    ]
    quantities = {"slope": "value low high p_holm", "shift": "shift", "verdict": "verdict"}
    return list_rows(records, quantities, ["kind", "unit"], **one.keys)


BOUNDED = "spectral_match_bounded"
UNBOUNDED = STAND_INS[BOUNDED]


def _compare_unbounded(
    table: Table, models: Mapping[Part, Primary], choices: Choices
) -> Iterator[Row]:
    """Give the paper's own spectral match, where the primary analysis uses the bounded one and both are there."""
    if BOUNDED not in table.metrics or UNBOUNDED not in table.further:
        return
    metrics = [UNBOUNDED if name == BOUNDED else name for name in table.metrics]
    for part in (part for part, model in models.items() if model.slopes["estimable"].any()):
        rng, method = choices.make_rng("paper", *part.place), "within_spearman"
        ranks = correlate(part.rows, UNBOUNDED, method=method, draws=choices.draws, rng=rng)
        cells = make_cells(part.rows, metrics)
        item = sensitivity.find_candidates(cells, count=1)[0]
        keys: Row = {**part.keys, "metric": UNBOUNDED}
        ends: Row = {"low": ranks.low, "high": ranks.high, "n": ranks.n_items, "interval": TWO_WAY}
        yield make_row("ranks", ranks.value, **ends, **keys)
        rest = cells.leave_out("item", item)
        for quantity, some in (("slope", cells), ("slope_without", rest)):
            row = fit_slopes(some).table.loc[UNBOUNDED].to_dict()
            keys |= {"n": len(some.table), "interval": SATTERTHWAITE}
            yield from list_rows([row], {quantity: "tenth tenth_low tenth_high"}, **keys)
        yield make_row("stimulus", item, **keys | {"n": 0})


# Facts for the words.


def _describe_part(part: Part, slopes: Sequence[Slope]) -> Row:
    """Gather what the template says of one scale and level."""
    model, influence = slopes[0].model, slopes[0].influence
    findings = [_describe_slope(one) for one in slopes]
    tried = influence.table
    kinds: Any = (
        [] if tried.empty else tried.loc[tried["verdict"] != NOT_ESTIMABLE, "kind"].unique()
    )
    odd = influence.exceptions.reset_index().to_dict("records")
    return {
        "subject": part.subject, "ratings": part.ratings, "findings": findings,
        "blank": all(one["verdict"] == NOT_ESTIMABLE for one in findings),
        "comparisons": list(_compare_slopes(model, findings)),
        "exceptions": [row for row in odd if row["exceptional"]],
        "spreads": list(filter(None, (_explain_spread(part.rows, one.metric) for one in slopes))),
        "unbounded": any(one.metric == UNBOUNDED for one in slopes),
        "sizes": _count_units(model), "n_items": model.n_items, "n_recordings": model.n_recordings,
        "level": model.level, "tried": [kind for kind in kinds if kind != sensitivity.STIMULUS],
    }  # fmt: skip


def _explain_spread(rows: DataFrame, metric: str) -> str:
    """Say why a spread over orientations may go with ratings the wrong way; of other metrics nothing."""
    if metric not in ROTATIONS:
        return ""
    from feel321.analysis.replication import explain_spread

    return explain_spread(rows, metric)


def _describe_slope(one: Slope) -> Row:
    def describe(unit: Mapping[Any, Any]) -> Row:
        direction = HIGHER if unit["tenth"] > 0 else LOWER
        named = {"name": f"{unit['kind']} {unit['unit']}", "verdict": unit["verdict"]}
        return named | {"direction": direction, "step": one.scale(unit)}

    row, moves = one.row, one.influence.find_moves(one.metric).to_dict("records")
    quartile = {"value": row["quartile_effect"], "low": row["quartile_low"], "high": row["quartile_high"]}  # fmt: skip
    moved = [describe(unit) for unit in moves if abs(unit["shift"]) > sensitivity.MOVED]
    return make_verdict(one) | {
        "quartile": quartile, "step": one.scale(row), "per": one.step.per, "p": row["p_holm"],
        "hinges": [describe(unit) for unit in one.hinges], "moves": [] if one.hinges else moved,
        "scenes": "sources" if one.model.n_sources < one.model.n_recordings else "recordings",
    }  # fmt: skip


def _compare_slopes(model: Primary, findings: Sequence[Row]) -> Iterator[Row]:
    """Say which of two metrics predicts better, in the same model and over the spread of each."""
    by_metric = {one["metric"]: one for one in findings}
    for row in model.differences.to_dict("records"):
        pair = [by_metric[str(row["first"])], by_metric[str(row["second"])]]
        names = {"value": "estimate", "low": "low", "high": "high"}
        ends = {end: row[f"standardised_{name}"] for end, name in names.items()}
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


def _draw(table: Table, models: Mapping[Part, Primary]) -> Iterator[Picture]:
    steps = parts.find_table_steps(table)
    per = {step.per for step in steps.values()}
    caption = (
        f"Slope within recordings of ratings on each metric, points per {per.pop() if len(per) == 1 else 'step'} of "
        "it, mixed model; bars: 95 % Satterthwaite intervals, not adjusted; hollow: singular fit."
    )
    drawn = {part.subject: model for part, model in models.items()}
    yield Picture("slopes", caption, partial(kinds.draw_slopes, drawn, steps))
    caption = "Residuals of the primary models: left against normal quantiles, right against fitted values."
    yield Picture("residuals", caption, partial(kinds.draw_residuals, drawn), detail=True)


# All metrics, the best first: out of fold and corrected for how many were tried.

STRENGTH = "level_as_played"
JOINT = "simultaneous 95 % interval, for other participants, recordings and reducers"


def compute_rivals(table: Table, choices: Choices) -> Found:
    """Rank all metrics on every scale and level, where a comparison was asked for."""
    told: list[Row] = []
    notes: list[str] = []
    pictures: list[Picture] = []
    rows: dict[str, list[Row]] = {"rivals": [], "rivals_picked": []}
    for part in split_tests(table) if table.rivals else ():
        try:
            ranking = _rank(part, table, choices)
        except ValueError as error:  # it was asked for, so the answer says why there is none
            told.append({"subject": part.subject, "why": str(error)})
            continue
        told.append({"subject": part.subject, "why": "", **describe_ranking(part, ranking)})
        notes += [f"{part.lead}, metrics ranked: {note}" for note in ranking.notes]
        pictures.append(_draw_ranking(part, ranking, detail=bool(pictures)))
        over = {"over_baseline": "over_baseline over_low over_high over_p"}
        quantities = {
            "r_out_of_fold": "value low high p", "r_over_ceiling": "share", **(over if ranking.baseline else {}),
            "may_be_best": "may_be_best", "chosen": "chosen", "r_in_fold": "fitted",
        }  # fmt: skip
        keys: Row = {**part.keys, "n": ranking.n_items}
        frame = ranking.to_frame()
        rows["rivals"] += list_rows(frame, quantities, ["metric"], interval=JOINT, **keys)
        rows["rivals_picked"].append(make_row("r_picked", ranking.honest_value, **keys))
        names = ("ceiling", "n_items", "n_participants", "n_sources")
        sizes = {name: getattr(ranking, name) for name in names} | {"n_metrics": len(frame)}
        rows["rivals_picked"] += parts.count_rows(sizes, **keys)
    return Found(rows, {"parts": told} if told else {}, pictures, notes)


def _rank(part: Part, table: Table, choices: Choices) -> Statistic:
    rows, names = part.rows, list(table.rivals)
    # Where no metric of the set is about level alone, the level as played is.
    if not set(rivals.BASELINES) & set(names) and AMPLITUDE in rows and (rows[AMPLITUDE] > 0).all():
        rows = rows.assign(**{STRENGTH: 20 * np.log10(rows[AMPLITUDE])})
        names.append(STRENGTH)
    rng = choices.make_rng("rivals", *part.place)
    return rivals.rank_metrics(rows, names, rng=rng, info=table.info)


def _draw_ranking(part: Part, one: Statistic, *, detail: bool) -> Picture:
    caption = (
        f"How well each metric predicts {part.ratings} within recordings, out of fold: correlation with simultaneous "
        "95 % intervals; hollow: not in the confidence set of the best metric. Dashed: noise ceiling; dotted: level "
        "alone."
    )
    level = one.table["value"].to_dict().get(one.baseline, np.nan)
    scenes = format_recordings(one.n_recordings, one.n_sources)
    size = f"{one.n_participants} participants, {scenes}, {one.n_items} stimuli"
    frame = one.to_frame().rename(columns={"may_be_best": "filled"})
    frame["name"] = frame["metric"].map(format_name)
    lines = {"-": 0.0, "--": one.ceiling, ":": level}
    title, label = f"{len(frame)} metrics, {size}.", "Correlation within recordings, out of fold"
    draw = partial(kinds.draw_estimates, frame, label, lines=lines, title=title)
    return Picture(parts.make_slug("rivals", *part.place), caption, draw, detail)


def describe_ranking(part: Part, ranking: Statistic) -> Row:
    """Decide which metric may be said to predict best: verdict, and the numbers that its sentence needs."""
    table, row = ranking.table, ranking.to_frame().to_dict("records")[0]
    shown = list(map(str, table.index[(table["p"] < rivals.LEVEL) & (table["value"] > 0)]))
    if 0 < ranking.n_reducers < rivals.FEWEST_REDUCERS:
        verdict = "few_reducers"
    elif ranking.baseline and not ranking.better:
        verdict = "not_above_level"
    elif not ranking.baseline and not shown:
        verdict = "none"
    else:
        verdict = "alone" if ranking.alone else "unresolved"
    return {
        "verdict": verdict, "ratings": part.ratings, "best": ranking.best, "baseline": ranking.baseline,
        "better": list(ranking.better) if ranking.baseline else shown, "n_metrics": len(table),
        "n_candidates": len(ranking.candidates), "n_reducers": ranking.n_reducers, "needed": rivals.FEWEST_REDUCERS,
        "r": {"value": row["value"], "low": row["low"], "high": row["high"]}, "ceiling": ranking.ceiling,
        "picked": ranking.honest_value,
    }  # fmt: skip


# The primary slopes under other choices.

MOST_CELLS = 20_000
"""Participants x stimuli beyond which the models would take many minutes."""


def compute_robustness(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Repeat the primary analysis under other choices."""
    notes: list[str] = []
    rows: list[Row] = []
    pictures: list[Picture] = []
    for part in split_tests(table):
        cells = len(part.rows.groupby(["participant", "item"], observed=True))
        try:
            if cells > MOST_CELLS or parts.is_large(part.rows, len(table.metrics)):
                raise ValueError(f"{cells} participant x stimulus cells are too many.")  # noqa: TRY301 - as a model's reasons
            varied = sensitivity.vary_primary(part.rows, table.metrics)
        except ValueError as error:
            notes.append(f"{part.lead}: no variants. {error}")
            continue
        caption = (
            f"Standardised slopes of {part.ratings} within recordings under other choices; 95 % Satterthwaite "
            "intervals; hollow: singular fit."
        )
        slug = parts.make_slug("variants", *part.place)
        frame = varied.rename(columns={"variant": "name"}).assign(filled=~varied["singular"])
        columns = "standardised standardised_low standardised_high"
        label = "SD of ratings per SD of metric"
        draw = partial(kinds.draw_estimates, frame, label, columns=columns, series="metric")
        pictures.append(Picture(slug, caption, draw, detail=bool(pictures)))
        rows += _list_variants(part, varied)
        own = varied.drop_duplicates("variant").set_index("variant")["reason"]
        # What the primary model lacks is said in its own section.
        others = own[(own != "") & (own != own["primary"])]
        for reason, names in others.groupby(others, sort=False).groups.items():
            notes.append(f"{part.lead}, {'; '.join(names)}: {reason}")
    return Found({"variants": rows}, {"turned": find_turned(rows)} if rows else {}, pictures, notes)


def _list_variants(part: Part, varied: DataFrame) -> Iterator[Row]:
    keys: Row = {**part.keys, "n": len(part.rows), "interval": SATTERTHWAITE}
    columns = {"variant": "variant", "metric": "metric"}
    ends = "standardised standardised_low standardised_high p"
    with_reason = columns | {"note": "reason"}
    yield from list_rows(varied, {"standardised": ends}, with_reason, **keys)
    yield from list_rows(varied, {"slope": "estimate"}, columns | {"note": "unit"}, **keys)


def find_turned(rows: Sequence[Row]) -> list[Row]:
    """Find the slopes whose interval excludes zero in the primary model, and not so under another choice."""

    def sign(row: Row) -> int:
        return int(row["low"] > 0) - int(row["high"] < 0)

    def place(row: Row) -> tuple[str, str, str]:
        return row["scale"], row["level"], row["metric"]

    own = [row for row in rows if row["quantity"] == "standardised"]
    whole = {place(row): sign(row) for row in own if row["variant"] == "primary"}
    return [row for row in own if math.isfinite(row["low"]) and sign(row) != whole[place(row)]]


SECTIONS = (
    Section("primary", "Change in rating with each metric, within recordings", "predict", compute),
    Section("rivals", "Which metric predicts best?", "predict", compute_rivals),
    Section("robustness", "Robustness to other choices", "hinge", compute_robustness),
)
