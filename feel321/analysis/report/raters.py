"""Sections on whether the ratings can be trusted: the vibration delivered, raters flagged, slopes without them."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures import kinds
from feel321.analysis.primary.model import adjust_holm, fit_slopes
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import conclude, list_changes
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Picture, Row, Section, list_rows, make_row
from feel321.analysis.screening.consistency import rater_model
from feel321.analysis.screening.rules import RULES
from feel321.analysis.screening.screen import screen_raters
from feel321.analysis.table.items import Part, recast_pairs, split_arms, split_tests
from feel321.analysis.table.schema import APART, ERROR, PAIR, SOURCE
from feel321.analysis.words import SATTERTHWAITE, format_name
from feel321.names import MATCHES

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.records import Statistic

NORMAL = 1.959963984540054
"""Standard errors on either side of an estimate that make a 95 % interval."""

EVERYONE, STANDARD, ANY = "everyone", "standard", "any"
GROUPS = {
    EVERYONE: "everyone",
    STANDARD: "without those flagged by BS.1534-3",
    ANY: "without anyone flagged",
}
"""Groups of raters that the primary slopes are fitted to -> what they are called."""

AGREEMENT = (
    "icc_c_1", "icc_a_1", "icc_c_k", "icc_a_k", "alpha", "n_participants", "n_complete",
)  # fmt: skip
FIT = ("loglikelihood", "aic", "bic", "n_parameters")
Models = list[tuple[Part, "Statistic"]]


def compute(table: Table, choices: Choices) -> Found:
    """Screen raters, measure their agreement, and repeat the primary analysis without those flagged."""
    rows = recast_pairs(table.rows)
    single = rows[~rows["scale"].isin(APART) & (rows["role"] != PAIR)]
    if single.empty:
        return Found(notes=("Raters were not screened: no stimulus was rated by itself.",))
    screening = screen_raters(single, rng=choices.make_rng("raters"))
    models: Models = []
    notes = list(screening.notes)
    for part in split_arms(single):  # hidden references and anchors included
        try:
            model = rater_model(part.rows)
        except ValueError as error:
            notes.append(f"{part.lead}, rater model: none. {error}")
            continue
        models.append((part, model))
        notes += [f"{part.lead}, rater model: {note}" for note in model.notes]
    slopes = conclude_panels(list(_vary(table, screening, choices)))
    changes, several = list(list_changes(slopes)), len({part.level for part, _ in models}) > 1
    facts = {
        **describe_flagged(screening),
        "changes": [list(one) for one in dict.fromkeys(
            (row["metric"], row["scale"], row["level"] * several) for row in changes
        )],
        "models": [_describe_model(part, model) for part, model in models],
        "rules": {
            rule: RULES[rule].says.format(limit=limit) for rule, limit in screening.limits.items()
        },
        "unflagged": [row for row in changes if row["panel"] == ANY],
    }  # fmt: skip
    caption = (
        "Inconsistency of every rater: the standard deviation, in points, about the quality of the stimulus plus the "
        "rater's bias (rater model of ITU-T P.913), with 95 % normal intervals. Filled: flagged by a screening rule. "
        "Flagged raters should be followed up, not automatically excluded."
    )
    flagged = {str(who) for rule in screening.hits.values() for who in rule}
    picture = Picture("raters", caption, partial(_draw_raters, models, flagged))
    listed = _list_screening(screening) | _list_models(models)
    listed |= {
        "repeats": list(_list_repeats(table)),
        "slopes_without_hits": _list_slopes(table, slopes),
    }
    return Found(listed, facts, [picture] if models else [], notes)


def _draw_raters(models: Models, flagged: set[str]) -> Figure:
    from pandas import concat

    frame = concat(model.to_frame().assign(series=part.subject) for part, model in models)
    half = NORMAL * frame["inconsistency_se"]
    frame = frame.assign(low=frame["inconsistency"] - half, high=frame["inconsistency"] + half)
    frame["name"] = frame["participant"].astype(str)
    frame = frame.assign(filled=frame["name"].isin(flagged)).sort_values("name", kind="stable")
    label, columns = "Inconsistency (points)", "inconsistency low high"
    return kinds.draw_estimates(frame, label, columns=columns, series="series")


def list_flagged(screening: Statistic, group: str) -> list[Hashable]:
    """List whom a group leaves out."""
    chosen = {
        EVERYONE: [], ANY: screening.rules,
        STANDARD: [rule for rule in screening.rules if RULES[rule].source.startswith("ITU-R")],
    }[group]  # fmt: skip
    return sorted({who for rule in chosen for who in screening.hits[rule]}, key=str)


def describe_flagged(screening: Statistic) -> Row:
    """Count the flagged raters, and those flagged by rules of BS.1534-3; applied: whether these apply."""
    own = [rule for rule in screening.rules if RULES[rule].source.startswith("ITU-R")]
    shares = screening.table.loc[screening.table["rule"].isin(own), "share"]
    return {
        "flagged": len(list_flagged(screening, ANY)), "by_standard": len(list_flagged(screening, STANDARD)),
        "n_raters": screening.table["participant"].nunique(), "applied": bool(shares.notna().any()),
    }  # fmt: skip


def _list_screening(screening: Statistic) -> dict[str, list[Row]]:
    everyone, rules = screening.table["participant"].nunique(), []
    for rule, hits in screening.hits.items():
        known = RULES[rule]
        share = screening.table.loc[screening.table["rule"] == rule, "share"]
        texts = {
            "source": known.source, "protocols": ", ".join(map(format_name, known.protocols)) or "all",
            "flagged": ", ".join(map(str, hits)) or "–", "n_judged": int(share.notna().sum()),
        }  # fmt: skip
        rules += list_rows([texts], list(texts), rule=rule, n=len(share))
    for group in GROUPS:
        n_flagged = len(list_flagged(screening, group))
        rules.append(make_row("n_flagged", n_flagged, n=everyone, panel=group))
    names = {"without hits": GROUPS[ANY], "everyone": GROUPS[EVERYONE]}
    panel = screening.panel.assign(panel=screening.panel["panel"].map(names))
    keys = {"scale": "scale", "panel": "panel", "n": "n_items"}
    each = {"share": "share", "limit": "limit", "count": "count", "flagged": "hit"}
    expertise = {"expertise": "value - - p", "floor": "floor"}
    shapes = ("multimodality", "outliers", "low_fence", "high_fence")
    return {
        "screening_rules": rules,
        "reliability": list_rows(panel, AGREEMENT, keys),
        "screening": list_rows(screening.table, each, ["rule", "participant", "n"]),
        "expertise": list_rows(screening.gauge, expertise, ["participant", "measure"]),
        "shapes": list_rows(screening.stimuli, shapes, {"stimulus": "item", "n": "n"}),
    }


def _list_models(models: Models) -> dict[str, list[Row]]:
    rows: dict[str, list[Row]] = {"rater_model": [], "rater_model_fit": [], "stimuli_of_raters": []}
    each = {f"{name}": f"{name} {name}_low {name}_high" for name in ("bias", "inconsistency")}
    each |= {"weight": "weight", "n_ratings": "n", "apart": "apart"}
    for part, model in models:
        frame = model.to_frame()
        for name in ("bias", "inconsistency"):
            half = NORMAL * frame[f"{name}_se"]
            ends = {f"{name}_low": frame[name] - half, f"{name}_high": frame[name] + half}
            frame = frame.assign(**ends)
        own = {"interval": "95 % normal interval", **part.keys}
        rows["rater_model"] += list_rows(frame, each, ["participant", "n"], **own)
        sizes = [{name: getattr(model, name) for name in FIT}]
        rows["rater_model_fit"] += list_rows(sizes, FIT, n=model.n_ratings, **part.keys)
        quality = {"quality": "quality", "quality_se": "se", "quality_se_raters": "se_raters"}
        stimuli = model.stimuli.reset_index()
        keys = {"stimulus": "stimulus_id", "n": "n"}
        rows["stimuli_of_raters"] += list_rows(stimuli, quality, keys, **part.keys)
    return rows


def _list_repeats(table: Table) -> Iterator[Row]:
    """Give the pooled standard deviation of a rater's repeated ratings of a stimulus."""
    for part in split_tests(table):
        cells = part.rows.groupby(["participant", "item"], observed=True)["rating"]
        repeated = cells.transform("size") > 1
        if n := int(repeated.sum()):
            groups = part.rows[repeated].groupby(["participant", "item"], observed=True)
            left = (part.rows["rating"] - cells.transform("mean"))[repeated]
            sd = float(np.sqrt((left**2).sum() / (n - len(groups))))
            yield make_row("sd", sd, n=n, **part.keys)


def _list_slopes(table: Table, slopes: Sequence[Row]) -> list[Row]:
    steps, records = parts.find_table_steps(table), []
    for row in slopes:
        share = steps[row["metric"]].size / 0.1
        scaled = {name: row[name] * share for name in ("tenth", "tenth_low", "tenth_high")}
        told = {"panel": GROUPS[row["panel"]], "verdict": row["verdict"].replace("_", " ")}
        records.append(row | scaled | told)
    keys = {key: key for key in ("scale", "level", "metric", "panel")} | {"n": "n_people"}
    quantities = {"slope": "tenth tenth_low tenth_high p"}
    rows = list_rows(records, quantities, keys | {"note": "reason"}, interval=SATTERTHWAITE)
    return rows + list_rows(records, {"verdict": "verdict", "n_participants": "n_people"}, keys)


# The primary slopes without flagged raters.


def _vary(table: Table, screening: Statistic, choices: Choices) -> Iterator[Row]:
    """Fit each part without those whom each group leaves out; the same people are fitted once."""
    for part in parts.thin_parts(table, choices):
        fitted: dict[tuple[Hashable, ...], list[Row]] = {}
        for group in GROUPS:
            out = tuple(list_flagged(screening, group))
            if out not in fitted:
                fitted[out] = _fit(part, out, table.metrics)
            yield from ({**row, "panel": group, **part.keys} for row in fitted[out])


def _fit(part: Part, out: Sequence[Hashable], metrics: Sequence[str]) -> list[Row]:
    left = part.rows.loc[~part.rows["participant"].isin(out), "participant"].nunique()
    own: Row = {"n_people": left, "reason": ""}
    try:
        rest = make_cells(part.rows, metrics).leave_out("participant", *out)
        if rest.count("participant") == 1 < part.rows["participant"].nunique():
            why = "One rater is left: an interval would not know how people differ."
            raise ValueError(why)  # noqa: TRY301 - a reason like those of the model
        slopes = fit_slopes(rest).table.reset_index().to_dict("records")
    except ValueError as error:
        own |= dict.fromkeys(("tenth", "tenth_low", "tenth_high", "p"), np.nan)
        return [own | {"metric": name, "reason": str(error)} for name in metrics]
    return [row | own for row in slopes]


def conclude_panels(slopes: Sequence[Row]) -> list[Row]:
    """Give every slope its verdict, adjusted as in the primary analysis: over all slopes of the same raters."""
    rows = []
    for panel in GROUPS:
        own = [row for row in slopes if row["panel"] == panel]
        adjusted = adjust_holm([row["p"] for row in own])
        rows += [row | {"verdict": conclude(p)} for row, p in zip(own, adjusted, strict=True)]
    return rows


def _describe_model(part: Part, model: Statistic) -> Row:
    """Find who rates high or low, and whether somebody's ratings are unlike all others in consistency."""
    from scipy.special import ndtri

    rows = model.to_frame().sort_values("bias").to_dict("records")
    limit = -float(ndtri(parts.SIGNIFICANCE / 2 / len(rows)))
    biased = [
        {"participant": row["participant"], "bias": row["bias"]}
        for row in (rows[-1], rows[0])
        if abs(row["bias"]) > limit * row["bias_se"]
    ]
    spread = model.raters["inconsistency"]
    rest, apart = spread[~model.raters["apart"]], spread[model.raters["apart"]]
    return {
        "scale": part.scale, "level": part.level * part.several, "biased": biased, "apart": list(model.apart),
        "range": [rest.min(), rest.max()], "apart_range": [apart.min(), apart.max()] if len(apart) else [],
    }  # fmt: skip


# The vibration that was delivered to the hand, beside what was intended.

SUFFIX, UNKNOWN = "_delivered", "unknown"
LEVELS = ("n_judgements", "median", "q05", "q95", "largest")
MATCHED = ("n_stimuli", "intended", "delivered", "difference", "largest", "stimulus")


def compute_delivered(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Compare the metrics of what was delivered with those intended, and describe the level errors."""
    rows = table.rows[table.rows["role"] == "test"]
    names = [name for name in MATCHES if name in rows and name + SUFFIX in rows]
    errors = rows[rows[ERROR].notna()] if ERROR in rows else rows[:0]
    if not names and errors.empty:
        return Found()
    items = rows.drop_duplicates("stimulus_id").set_index("stimulus_id")
    matched = [_compare(items, name) for name in names]
    source = errors.get(SOURCE, errors["role"].mask(errors["role"] != "", ""))
    levels = [
        _describe_levels(part, str(name))
        for name, part in errors.groupby(source.replace("", UNKNOWN), observed=True)
    ]
    listed = {
        "delivered": list_rows(matched, MATCHED, {"metric": "metric", "n": "n_stimuli"}),
        "level_errors": list_rows(levels, LEVELS, {"source": "source", "n": "n_judgements"}),
    }
    caption = (
        "What was delivered against what was intended: match metrics of each test stimulus (on the line: as intended), "
        "and level errors of all judgements of test stimuli."
    )
    columns = ["reducer", *names, *(name + SUFFIX for name in names)]
    values = errors[ERROR].to_numpy(np.float64) if levels else np.zeros(0)
    draw = partial(kinds.draw_delivered, items[columns], names, values)
    facts = {"levels": levels, "matched": matched, "n": len(rows)}
    return Found(listed, facts, [Picture("delivered", caption, draw)])


def _compare(items: DataFrame, name: str) -> Mapping[str, Any]:
    intended, delivered = (items[column].to_numpy(np.float64) for column in (name, name + SUFFIX))
    difference = delivered - intended
    largest = int(np.argmax(np.abs(difference)))
    return {
        "metric": name, "n_stimuli": len(items), "intended": intended.mean(), "delivered": delivered.mean(),
        "difference": difference.mean(), "largest": difference[largest], "stimulus": str(items.index[largest]),
    }  # fmt: skip


def _describe_levels(part: DataFrame, source: str) -> Mapping[str, Any]:
    values = part[ERROR].to_numpy(np.float64)
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
    largest = values[int(np.argmax(np.abs(values)))]
    ends = {"median": middle, "q05": low, "q95": high, "largest": largest}
    return {"source": source, "n_judgements": len(values), **ends}


SECTIONS = (
    Section("delivered", "Delivered vibration", "trust", compute_delivered),
    Section("raters", "Raters", "trust", compute),
)
