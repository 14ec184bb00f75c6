"""Sections on slopes within recordings: the primary model, and the model under other choices."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feel321.analysis.mixed.model import contrast
from feel321.analysis.primary import sensitivity
from feel321.analysis.primary.model import FEW, FEWEST, fit_primary, fit_slopes, tabulate_slopes
from feel321.analysis.primary.plan import REDUCER, SCENE, SOURCE, make_cells
from feel321.analysis.primary.sensitivity import NOT_ESTIMABLE, PREDICTS, conclude
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Row, make_row
from feel321.analysis.table.items import Part, split_tests
from feel321.analysis.table.metrics import ROTATIONS
from feel321.analysis.table.schema import STAND_INS
from feel321.analysis.words import INTERVALS, format_count

if TYPE_CHECKING:
    from feel321.analysis.primary.model import Primary
    from feel321.analysis.primary.sensitivity import Influence
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.analysis.table.metrics import Step
    from feel321.types import MetricInfo

HIGHER, LOWER = "higher", "lower"

BLANK: Row = {
    "verdict": NOT_ESTIMABLE, "direction": "", "higher": "better", "opposite": False, "hinges_on": [],
    "better_than": [], "few": [], "beyond_level": "",
}  # fmt: skip
"""The verdict on a metric without a slope."""


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
    def units(self) -> dict[str, int]:
        """How many participants, recordings (or the sources of them) and reducers it rests on."""
        scene = SOURCE if self.model.n_sources < self.model.n_recordings else SCENE
        reducers = {REDUCER: self.model.n_reducers} if self.model.n_reducers else {}
        return {"participant": self.model.n_participants, scene: self.model.n_sources} | reducers

    @property
    def hinges(self) -> list[Row]:
        """Units without which a metric that predicts does not, or not in this direction."""
        claimed = conclude(self.row["p_holm"]) == PREDICTS
        turns = self.influence.find_turns(self.metric)
        return list(turns.to_dict("records")) if claimed else []

    def scale(self, row: Mapping[Any, Any]) -> dict[str, float]:
        """Take an estimate per 0.1, with its ends, to one per step."""
        names = {"value": "tenth", "low": "tenth_low", "high": "tenth_high"}
        return {end: float(row[name]) * self.step.size / 0.1 for end, name in names.items()}

    def conclude(self) -> Row:
        """Conclude about it, as data: a program reads it, the templates put it into words."""
        verdict = conclude(self.row["p_holm"])
        expected = LOWER if self.info is not None and self.info.higher == "worse" else HIGHER
        direction = ""
        if verdict == PREDICTS:
            direction = HIGHER if self.row["estimate"] > 0 else LOWER
        hinges = [f"{row['kind']} {row['unit']}" for row in self.hinges]
        least = FEWEST if verdict == NOT_ESTIMABLE else FEW
        steady = verdict == PREDICTS and direction == expected and not hinges
        pairs = self.model.differences.to_dict("records") if steady else []
        better = [
            str(row["second"] if row["first"] == self.metric else row["first"])
            for row in pairs
            if self.metric == find_better(row)
        ]
        level = sensitivity.judge_level(
            self.model.level, self.row["p_holm"], self.row["plain_p_holm"]
        )
        return {
            **self.part.keys, "metric": self.metric, "subject": self.part.subject, "ratings": self.part.ratings,
            "verdict": verdict, "direction": direction, "higher": "better" if expected == HIGHER else "worse",
            "opposite": verdict == PREDICTS and direction != expected, "hinges_on": hinges,
            "better_than": better,
            "few": [format_count(size, name) for name, size in self.units.items() if size < least],
            "beyond_level": level,
        }  # fmt: skip


def find_better(row: Mapping[Any, Any]) -> str:
    """Find which of two metrics has the stronger standardised slope, each in the direction that it declares."""
    low, high = row["standardised_low"], row["standardised_high"]
    if math.isnan(low) or low <= 0 <= high:
        return ""
    return str(row["first"] if low > 0 else row["second"])


def compute(table: Table, choices: Choices) -> Found:
    """Fit the primary model of every scale and level."""
    found = Found(key="primary")
    models, losses = _fit(found, table, choices)
    slopes = list(_gather_slopes(table, models))
    found.verdicts = [one.conclude() for one in slopes]
    for loss in losses:
        told = {key: loss[key] for key in ("scale", "level", "subject", "ratings")}
        found.verdicts += [told | {"metric": name} | BLANK for name in loss["metrics"]]
    own = {part: [one for one in slopes if one.part is part] for part in models}
    for part, mine in own.items():
        _add_rows(found, part, mine)
    found.rows["unbounded"] += _compare_unbounded(table, models, choices)
    if found.verdicts:
        described = [_describe_part(part, mine) for part, mine in own.items()]
        found.facts = {"parts": described, "losses": losses, "verdicts": found.verdicts}
    if models:
        drawn = {part.subject: model for part, model in models.items()}
        steps = parts.find_table_steps(table)
        per = {step.per for step in steps.values()}
        says = {"per": per.pop() if len(per) == 1 else "step"}
        found.draw("slopes", "slopes", drawn, steps, says=says)
        found.draw("residuals", "residuals", drawn, says={})
    return found


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


def _gather_slopes(table: Table, models: Mapping[Part, Primary]) -> Iterator[Slope]:
    """Put every slope together with what single stimuli, recordings and reducers do to it."""
    if not models:
        return
    steps = parts.find_table_steps(table)
    slopes = tabulate_slopes({part.lead: model for part, model in models.items()})
    for part, model in models.items():
        own = slopes["attribute"] == part.lead
        others = slopes.loc[~own, "p"].tolist()
        influence = sensitivity.measure_influence(part.rows, table.metrics, model, others=others)
        for row in slopes[own].to_dict("records"):
            name = str(row["metric"])
            yield Slope(row, part, model, influence, steps[name], table.info.get(name))


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


def _add_rows(found: Found, part: Part, slopes: Sequence[Slope]) -> None:
    """Add the rows of one model and its slopes; of units, first those that turn a verdict or move a slope."""
    model, influence = slopes[0].model, slopes[0].influence
    keys: Row = {**part.keys, "n": model.n_rows}
    fit = {"fit": "singular" if model.fit.singular else "regular"}
    found.add("models", [{**model, **fit}], **keys)
    found.add("spreads", model.fit.variances, **keys)
    found.add("slope_differences", model.differences, **keys)
    for one in slopes:
        own, row, size = keys | {"metric": one.metric}, one.row, one.step.size
        scaled = {name: row[name] * size for name in ("centred", "centred_low", "centred_high")}
        if math.isfinite(row["plain"]):
            scaled["plain"] = row["plain"] * size
        kept = {name: value for name, value in row.items() if name != "plain"}
        found.add(
            "slopes", [kept | scaled | one.scale(row) | {"size": size, "per": one.step.per}], **own
        )
        if one.metric in model.between.index:
            row = model.between.loc[one.metric].to_dict()
            row |= {name: row[name] * size for name in ("estimate", "low", "high")}
            found.add("slopes_between", [row], **own)
        if not influence.table.empty:
            units = influence.table[influence.table["metric"] == one.metric]
            moving = units.sort_values("moves", ascending=False, kind="stable")
            for unit in moving.to_dict("records"):
                verdict = str(unit["verdict"]).replace("_", " ")
                found.add("influence", [{**unit, **one.scale(unit), "verdict": verdict}], **own)
    found.add("exceptions", influence.exceptions.reset_index(), **keys)


BOUNDED = "spectral_match_bounded"
UNBOUNDED = STAND_INS[BOUNDED]


def _compare_unbounded(
    table: Table, models: Mapping[Part, Primary], choices: Choices
) -> Iterator[Row]:
    """Give the paper's own spectral match, where the primary analysis uses the bounded one and both are there."""
    from feel321.analysis.association.correlate import correlate

    if BOUNDED not in table.metrics or UNBOUNDED not in table.further:
        return
    metrics = [UNBOUNDED if name == BOUNDED else name for name in table.metrics]
    for part in (part for part, model in models.items() if model.slopes["estimable"].any()):
        rng, method = choices.make_rng("paper", *part.place), "within_spearman"
        ranks = correlate(part.rows, UNBOUNDED, method=method, draws=choices.draws, rng=rng)
        cells = make_cells(part.rows, metrics)
        item = sensitivity.find_candidates(cells, count=1)[0]
        keys: Row = {**part.keys, "metric": UNBOUNDED}
        ends: Row = {"low": ranks.low, "high": ranks.high, "interval": INTERVALS["two-way"]}
        yield make_row("ranks", ranks.value, n=ranks.n_items, **ends, **keys)
        for quantity, some in (("slope", cells), ("slope_without", cells.leave_out("item", item))):
            row = fit_slopes(some).table.loc[UNBOUNDED]
            ends = {"low": row["tenth_low"], "high": row["tenth_high"], "n": len(some.table)}
            yield make_row(
                quantity, row["tenth"], interval=INTERVALS["satterthwaite"], **ends, **keys
            )
        yield make_row("stimulus", item, **keys)


# Facts for the words.


def _describe_part(part: Part, slopes: Sequence[Slope]) -> Row:
    """Gather what the template says of one scale and level."""
    model, influence = slopes[0].model, slopes[0].influence
    findings = [_describe_slope(one) for one in slopes]
    kinds: list[str] = []
    if not influence.table.empty:
        tried = influence.table["verdict"] != NOT_ESTIMABLE
        kinds = list(influence.table.loc[tried, "kind"].unique())
    spreads: list[str] = []
    for name in (one.metric for one in slopes if one.metric in ROTATIONS):
        from feel321.analysis.replication import explain_spread

        spreads.append(explain_spread(part.rows, name))
    odd = influence.exceptions.reset_index().to_dict("records")
    return {
        "subject": part.subject, "ratings": part.ratings, "findings": findings,
        "blank": all(one["verdict"] == NOT_ESTIMABLE for one in findings),
        "comparisons": list(_compare_slopes(model, findings)),
        "exceptions": [row for row in odd if row["exceptional"]],
        "spreads": [text for text in spreads if text],
        "unbounded": any(one.metric == UNBOUNDED for one in slopes),
        "sizes": slopes[0].units, "n_items": model.n_items, "n_recordings": model.n_recordings,
        "level": model.level, "tried": [kind for kind in kinds if kind != sensitivity.STIMULUS],
    }  # fmt: skip


def _describe_slope(one: Slope) -> Row:
    def describe(unit: Mapping[Any, Any]) -> Row:
        direction = HIGHER if unit["tenth"] > 0 else LOWER
        named = {"name": f"{unit['kind']} {unit['unit']}", "verdict": unit["verdict"]}
        return named | {"direction": direction, "step": one.scale(unit)}

    row, moves = one.row, one.influence.find_moves(one.metric).to_dict("records")
    quartile = {"value": row["quartile_effect"], "low": row["quartile_low"], "high": row["quartile_high"]}  # fmt: skip
    moved = [describe(unit) for unit in moves if abs(unit["shift"]) > sensitivity.MOVED]
    return one.conclude() | {
        "quartile": quartile, "step": one.scale(row), "per": one.step.per, "p": row["p_holm"],
        "hinges": [describe(unit) for unit in one.hinges], "moves": [] if one.hinges else moved,
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


# The primary slopes under other choices.

MOST_CELLS = 20_000
"""Participants x stimuli beyond which the models would take many minutes."""


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
    if rows := found.rows["variants"]:
        found.facts["turned"] = find_turned(rows)
    return found


def find_turned(rows: Sequence[Row]) -> list[Row]:
    """Find the slopes whose interval excludes zero in the primary model, and not so under another choice."""

    def sign(row: Row) -> int:
        return int(row["low"] > 0) - int(row["high"] < 0)

    def place(row: Row) -> tuple[str, str, str]:
        return row["scale"], row["level"], row["metric"]

    own = [row for row in rows if row["quantity"] == "standardised"]
    whole = {place(row): sign(row) for row in own if row["variant"] == "primary"}
    return [row for row in own if math.isfinite(row["low"]) and sign(row) != whole[place(row)]]
