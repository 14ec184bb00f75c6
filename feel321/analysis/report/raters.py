"""Section: who was flagged by which screening rule, how far raters agree, and the slopes without those flagged."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures.kinds import draw_raters
from feel321.analysis.primary.model import adjust_holm, fit_slopes
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import conclude, list_changes
from feel321.analysis.report import parts
from feel321.analysis.report.section import Found, Picture, Row, Section, count_rows, make_row
from feel321.analysis.screening.consistency import RaterModel, rater_model
from feel321.analysis.screening.screen import Screening, screen_raters
from feel321.analysis.table.items import recast_pairs
from feel321.analysis.table.schema import APART, PAIR
from feel321.analysis.words import SATTERTHWAITE, format_name

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

KEY = "raters"
ALONE = "One rater is left: an interval would not know how people differ."
NORMAL = 1.959963984540054
"""Standard errors on either side of an estimate that make a 95 % interval."""

EVERYONE, STANDARD, ANY = "everyone", "standard", "any"
GROUPS = {
    EVERYONE: "everyone",
    STANDARD: "without those flagged by BS.1534-3",
    ANY: "without anyone flagged",
}
"""Groups of raters that the primary slopes are fitted to -> what they are called."""

AGREEMENT = {
    "icc_c_1": "ICC(C,1)", "icc_a_1": "ICC(A,1)", "icc_c_k": "ICC(C,k)", "icc_a_k": "ICC(A,k)",
    "alpha": "Krippendorff's α",
}  # fmt: skip


def compute(table: Table, choices: Choices) -> Found:
    """Screen raters, measure their agreement, and repeat the primary analysis without those flagged."""
    rows = recast_pairs(table.rows)
    single = rows[~rows["scale"].isin(APART) & (rows["role"] != PAIR)]
    if single.empty:
        return Found(notes=("Raters were not screened: no stimulus was rated by itself.",))
    screening = screen_raters(single, own=choices.rules, rng=choices.make_rng(KEY))
    models, more_notes = _fit_models(single)
    slopes = conclude_panels(list(_vary(table, screening, choices)))
    steps = parts.find_table_steps(table)
    listed = {
        "screening_rules": list(_list_rules(screening)),
        "reliability": list(_list_agreements(screening)),
        "slopes_without_hits": [row for one in slopes for row in _list_slope(one, steps[one["metric"]].size)],
        "repeats": list(_list_repeats(table)),
        "rater_model": [row for place, model in models for row in _list_raters(place, model)],
        "rater_model_fit": [
            row for place, model in models
            for row in count_rows({key: getattr(model, key) for key in _FIT}, n=model.n_ratings, **place)
        ],
        "screening": list(_list_screened(screening)),
        "expertise": [row for one in screening.gauge.to_dict("records") for row in _list_expertise(one)],
        "stimuli_of_raters": list(_list_stimuli(models, screening)),
        "excerpts": list(_list_excerpts(screening)),
    }  # fmt: skip
    several = len({place["level"] for place, _ in models}) > 1
    changes = dict.fromkeys(
        (row["metric"], row["scale"], row["level"] * several) for row in list_changes(slopes)
    )
    facts = {
        **describe_flagged(screening), "changes": [list(one) for one in changes],
        "models": [_describe_model(place, model, several=several) for place, model in models],
        "rules": {
            rule: screening.known[rule].says.format(limit=limit) for rule, limit in screening.limits.items()
        },
        "unflagged": [row for row in list_changes(slopes) if row["panel"] == ANY],
    }  # fmt: skip
    caption = (
        "Inconsistency of every rater: the standard deviation, in points, about the quality of the stimulus plus the "
        "rater's bias (rater model of ITU-T P.913), with 95 % normal intervals. Filled: flagged by a screening rule. "
        "Flagged raters should be followed up, not automatically excluded."
    )
    flagged = {str(who) for rule in screening.hits.values() for who in rule}
    drawn = [(_name(place, several=several), model) for place, model in models]
    pictures = [Picture(KEY, caption, partial(draw_raters, drawn, flagged))] if drawn else []
    return Found(listed, facts, pictures, (*screening.notes, *more_notes))


_FIT = ("loglikelihood", "aic", "bic", "n_parameters")
Place = dict[str, str]
Models = list[tuple[Place, RaterModel]]


def _name(place: Place, *, several: bool) -> str:
    return format_name(place["scale"]) + f", {format_name(place['level'])}" * several


def _fit_models(single: DataFrame) -> tuple[Models, list[str]]:
    """Fit the rater model to each scale and level, hidden references and anchors included."""
    models: Models = []
    notes: list[str] = []
    for scale, level, rows in parts.split_arms(single):
        lead = f"{scale}, {level}, rater model"
        try:
            model = rater_model(rows)
        except ValueError as error:
            notes.append(f"{lead}: none. {error}")
            continue
        models.append(({"scale": scale, "level": level}, model))
        notes += [f"{lead}: {note}" for note in model.notes]
    return models, notes


def list_flagged(screening: Screening, group: str) -> list[Hashable]:
    """List whom a group leaves out."""
    standard = [
        rule for rule in screening.rules if screening.known[rule].source.startswith("ITU-R")
    ]
    rules: Iterable[str] = {EVERYONE: [], STANDARD: standard}.get(group, list(screening.rules))
    return sorted({who for rule in rules for who in screening.hits[rule]}, key=str)


def describe_flagged(screening: Screening) -> Row:
    """Count the flagged raters, and those flagged by rules of BS.1534-3; applied: whether these apply."""
    own = [rule for rule in screening.rules if screening.known[rule].source.startswith("ITU-R")]
    shares = screening.table.loc[screening.table["rule"].isin(own), "share"]
    standard, whole = (len(list_flagged(screening, group)) for group in (STANDARD, ANY))
    n = screening.table["participant"].nunique()
    return {
        "flagged": whole,
        "by_standard": standard,
        "n_raters": n,
        "applied": bool(shares.notna().any()),
    }


def _list_rules(screening: Screening) -> Iterator[Row]:
    everyone = screening.table["participant"].nunique()
    for rule, hits in screening.hits.items():
        known = screening.known[rule]
        share = screening.table.loc[screening.table["rule"] == rule, "share"]
        texts = {
            "source": known.source, "protocols": ", ".join(map(format_name, known.protocols)) or "all",
            "flagged": ", ".join(map(str, hits)) or "–",
        }  # fmt: skip
        yield from (
            make_row(name, note=text, rule=rule, n=len(share)) for name, text in texts.items()
        )
        yield make_row("n_judged", int(share.notna().sum()), rule=rule, n=len(share))
    for group in GROUPS:
        yield make_row("n_flagged", len(list_flagged(screening, group)), n=everyone, panel=group)


def _list_agreements(screening: Screening) -> Iterator[Row]:
    for row in screening.panel.to_dict("records"):
        panel = GROUPS[ANY if row["panel"] == "without hits" else EVERYONE]
        keys: Row = {"scale": row["scale"], "panel": panel, "n": row["n_items"]}
        yield from count_rows(
            {key: row[key] for key in (*AGREEMENT, "n_participants", "n_complete")}, **keys
        )


def _list_slope(row: Mapping[str, Any], step: float) -> Iterator[Row]:
    keys: Row = {key: row[key] for key in ("scale", "level", "metric")} | {
        "panel": GROUPS[row["panel"]],
        "n": row["n_people"],
    }
    ends = {
        end or "value": row[f"tenth{end and '_'}{end}"] * step / 0.1 for end in ("", "low", "high")
    }
    yield make_row("slope", **ends, p=row["p"], interval=SATTERTHWAITE, note=row["reason"], **keys)
    yield make_row("verdict", note=row["verdict"].replace("_", " "), **keys)
    yield make_row("n_participants", row["n_people"], **keys)


def _list_raters(place: Place, model: RaterModel) -> Iterator[Row]:
    for row in model.to_frame().to_dict("records"):
        keys: Row = {**place, "participant": row["participant"], "n": row["n"]}
        for name in ("bias", "inconsistency"):
            half = NORMAL * row[f"{name}_se"]
            ends = {
                "low": row[name] - half,
                "high": row[name] + half,
                "interval": "95 % normal interval",
            }
            yield make_row(name, row[name], **ends, **keys)
        yield make_row("weight", row["weight"], **keys)
        yield make_row("n_ratings", row["n"], **keys)
        yield make_row("apart", note="yes" if row["apart"] else "no", **keys)


def _list_screened(screening: Screening) -> Iterator[Row]:
    for row in screening.table.to_dict("records"):
        keys: Row = {"rule": row["rule"], "participant": row["participant"], "n": row["n"]}
        yield from count_rows({name: row[name] for name in ("share", "limit", "count")}, **keys)
        yield make_row("flagged", note="yes" if row["hit"] else "no", **keys)


def _list_expertise(row: Mapping[Any, Any]) -> Iterator[Row]:
    keys: Row = {"participant": row["participant"], "measure": row["measure"]}
    yield make_row("expertise", row["value"], p=row["p"], **keys)
    yield make_row("floor", row["floor"], **keys)


def _list_stimuli(models: Models, screening: Screening) -> Iterator[Row]:
    for place, model in models:
        for row in model.stimuli.reset_index().to_dict("records"):
            keys: Row = {**place, "stimulus": row["stimulus_id"], "n": row["n"]}
            names = {"quality": "quality", "quality_se": "se", "quality_se_raters": "se_raters"}
            yield from count_rows({name: row[key] for name, key in names.items()}, **keys)
    for row in screening.items.to_dict("records"):
        keys = {"scale": "", "level": "", "stimulus": str(row["item"]), "n": row["n"]}
        yield from count_rows(
            {name: row[name] for name in ("multimodality", "outliers", "low_fence", "high_fence")},
            **keys,
        )


def _list_excerpts(screening: Screening) -> Iterator[Row]:
    for row in screening.excerpts.reset_index(drop=True).to_dict("records"):
        keys: Row = {name: str(row.get(name, "")) for name in ("scale", "level", "recording")}
        yield make_row("mid_above_90", row["mid_above_90"], **keys)
        yield make_row("counts", note="yes" if row["counts"] else "no", **keys)


def _list_repeats(table: Table) -> Iterator[Row]:
    for part in parts.split_parts(table):
        sd, n = _find_repeat_sd(part.rows)
        if n:
            yield make_row("sd", sd, n=n, **part.keys)


def _find_repeat_sd(rows: DataFrame) -> tuple[float, int]:
    """Find the standard deviation of a rater's repeated ratings (NaN without repeats), and how many are repeated."""
    cells = rows.groupby(["participant", "item"], observed=True)["rating"]
    repeated = cells.transform("size") > 1
    n = int(repeated.sum())
    freedom = n - len(rows[repeated].groupby(["participant", "item"], observed=True))
    left = (rows["rating"] - cells.transform("mean"))[repeated]
    return (float(np.sqrt((left**2).sum() / freedom)) if freedom else float("nan")), n


# The primary slopes without flagged raters.


def _vary(table: Table, screening: Screening, choices: Choices) -> Iterator[Row]:
    """Fit each part without those whom each group leaves out; the same people are fitted once."""
    for part in parts.thin_parts(table, choices):
        fitted: dict[tuple[Hashable, ...], list[Row]] = {}
        for group in GROUPS:
            out = tuple(list_flagged(screening, group))
            if out not in fitted:
                fitted[out] = list(_fit(part, out, table.metrics))
            yield from ({**row, "panel": group, **part.keys} for row in fitted[out])


def _fit(
    part: parts.RatingsPart, out: tuple[Hashable, ...], metrics: tuple[str, ...]
) -> Iterator[Row]:
    n_people = part.rows.loc[~part.rows["participant"].isin(out), "participant"].nunique()
    try:
        rest = make_cells(part.rows, metrics).leave_out(parts.WHO, *out)
        if rest.count(parts.WHO) == 1 < part.rows[parts.WHO].nunique():
            raise ValueError(ALONE)  # noqa: TRY301 - a reason like those of the model
        slopes = fit_slopes(rest).table
    except ValueError as error:
        empty = dict.fromkeys(("tenth", "tenth_low", "tenth_high", "p"), float("nan"))
        yield from (
            {**empty, "metric": name, "n_people": n_people, "reason": str(error)}
            for name in metrics
        )
        return
    for row in slopes.reset_index().to_dict("records"):
        yield {str(key): value for key, value in row.items()} | {"n_people": n_people, "reason": ""}


def conclude_panels(slopes: Sequence[Row]) -> list[Row]:
    """Give every slope its verdict, adjusted as in the primary analysis: over all slopes of the same raters."""
    rows = []
    for panel in GROUPS:
        own = [row for row in slopes if row["panel"] == panel]
        adjusted = adjust_holm([row["p"] for row in own])
        rows += [row | {"verdict": conclude(p)} for row, p in zip(own, adjusted, strict=True)]
    return rows


# Facts for the words.


def _describe_model(place: Place, model: RaterModel, *, several: bool) -> Row:
    """Find who rates high or low, and whether somebody's ratings are unlike all others in consistency."""
    from scipy.stats import norm

    rows = model.to_frame().sort_values("bias").to_dict("records")
    limit = float(norm.isf(parts.SIGNIFICANCE / 2 / len(rows)))
    biased = [
        {"participant": row["participant"], "bias": row["bias"]}
        for row in (rows[-1], rows[0])
        if abs(row["bias"]) > limit * row["bias_se"]
    ]
    spread = model.raters["inconsistency"]
    rest, apart = spread[~model.raters["apart"]], spread[model.raters["apart"]]
    return {
        "scale": place["scale"], "level": place["level"] * several, "biased": biased, "apart": list(model.apart),
        "range": [rest.min(), rest.max()], "apart_range": [apart.min(), apart.max()] if len(apart) else [],
    }  # fmt: skip


SECTION = Section(KEY, "Raters", "trust", compute)
