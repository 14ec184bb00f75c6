"""Sections on whether the ratings can be trusted: the vibration delivered, raters flagged, slopes without them."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from pandas import DataFrame

from feel321.analysis.agreement import rater_model
from feel321.analysis.primary.model import adjust_holm, fit_slopes
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import conclude, list_changes
from feel321.analysis.report import section as parts
from feel321.analysis.report.primary import per_step
from feel321.analysis.report.section import Found, Row, make_row
from feel321.analysis.screening import RULES, screen_raters
from feel321.analysis.table.items import Part, Table, recast_pairs, split_arms, split_tests
from feel321.analysis.table.schema import APART, ERROR, PAIR, SOURCE
from feel321.analysis.words import format_name
from feel321.types import MATCHES

if TYPE_CHECKING:
    from feel321.analysis.resampling import Choices

# Standard errors on either side of an estimate that make a 95 % interval
NORMAL = 1.959963984540054
EVERYONE, STANDARD, ANY = "everyone", "standard", "any"
# Groups of raters that the primary slopes are fitted to -> what they are called
GROUPS = {
    EVERYONE: "everyone", STANDARD: "without those flagged by BS.1534-3", ANY: "without anyone flagged",
}  # fmt: skip


def compute(table: Table, choices: Choices) -> Found:
    """Screen raters, measure their agreement, and repeat the primary analysis without those flagged."""
    found, rows = Found(key="raters"), recast_pairs(table.rows)
    single = rows[~rows["scale"].isin(APART) & (rows["role"] != PAIR)]
    if single.empty:
        found.notes.append("Raters were not screened: no stimulus was rated by itself.")
        return found
    screening = screen_raters(single, rng=choices.make_rng("raters"))
    found.notes += screening.notes
    standard = [rule for rule in screening.rules if RULES[rule].source.startswith("ITU-R")]
    rules = {EVERYONE: (), STANDARD: standard, ANY: screening.rules}
    flagged: dict[str, list[Hashable]] = {
        group: sorted({who for rule in own for who in screening.hits[rule]}, key=str)
        for group, own in rules.items()
    }
    for rule, hits in screening.hits.items():
        share = screening.table.loc[screening.table["rule"] == rule, "share"]
        found.add("screening_rules", [{
            "rule": rule, "n": len(share), "source": RULES[rule].source,
            "protocols": ", ".join(map(format_name, RULES[rule].protocols)) or "all",
            "flagged": ", ".join(map(str, hits)) or "–", "n_judged": int(share.notna().sum()),
        }])  # fmt: skip
    names = {"without hits": GROUPS[ANY], "everyone": GROUPS[EVERYONE]}
    found.add("reliability", screening.panel.assign(panel=screening.panel["panel"].map(names)))
    found.add("screening", screening.table)
    n_raters = screening.table["participant"].nunique()
    found.rows["screening_rules"] += [
        make_row("n_flagged", len(who), n=n_raters, panel=group) for group, who in flagged.items()
    ]
    _add_models(found, single, {str(who) for who in flagged[ANY]})
    for part in split_tests(table):
        cells = part.rows.groupby(["participant", "item"], observed=True)["rating"]
        repeats = cells.agg(["var", "size"]).query("size > 1")
        if n := int(repeats["size"].sum()):
            sd = math.sqrt(np.average(repeats["var"], weights=repeats["size"] - 1))
            found.rows["repeats"].append(make_row("sd", sd, n=n, **part.keys))
    slopes = []
    for part in parts.thin_parts(table, choices):
        left_out = dict.fromkeys(map(tuple, flagged.values()))  # the same people once
        fitted = {out: _fit_without(part, out, table.metrics) for out in left_out}
        for group, who in flagged.items():
            slopes += [{**row, "panel": group, **part.keys} for row in fitted[tuple(who)]]
    slopes = conclude_panels(slopes)
    changes = list(list_changes(slopes))
    shares = screening.table.loc[screening.table["rule"].isin(standard), "share"]
    several = len(single["level"].unique()) > 1
    where = [(row["metric"], row["scale"], row["level"] * several) for row in changes]
    found.facts = {
        "flagged": len(flagged[ANY]), "by_standard": len(flagged[STANDARD]), "n_raters": n_raters,
        "applied": bool(shares.notna().any()), "changes": list(map(list, dict.fromkeys(where))),
        "rules": {
            rule: RULES[rule].says.format(limit=limit) for rule, limit in screening.limits.items()
        },
        "unflagged": [row for row in changes if row["panel"] == ANY],
    }  # fmt: skip
    if slopes:
        shown = per_step(pd.DataFrame(slopes), parts.find_table_steps(table))
        shown["verdict"] = shown["verdict"].str.replace("_", " ")
        found.add("slopes_without_hits", shown.assign(panel=shown["panel"].map(GROUPS)))
    return found


def _add_models(found: Found, single: DataFrame, hit: set[str]) -> None:
    """Fit the rater model to every scale and level, hidden references and anchors included."""
    drawn = []
    for part in split_arms(single):
        model = found.attempt(f"{part.lead}, rater model: none.", rater_model, part.rows)
        if model is None:
            continue
        found.notes += [f"{part.lead}, rater model: {note}" for note in model.notes]
        frame: DataFrame = model.to_frame()
        for name in ("bias", "inconsistency"):
            half = NORMAL * frame[f"{name}_se"]
            frame[[f"{name}_low", f"{name}_high"]] = np.c_[frame[name] - half, frame[name] + half]
        found.add("rater_model", frame, **part.keys)
        drawn.append(frame.assign(series=part.subject, name=frame["participant"].astype(str)))
    if drawn:
        frame = pd.concat(drawn)
        frame = frame.assign(filled=frame["name"].isin(hit)).sort_values("name", kind="stable")
        found.draw("inconsistency", "raters", frame, says={})


def _fit_without(part: Part, out: Sequence[Hashable], metrics: Sequence[str]) -> list[Row]:
    """Fit the primary slopes without flagged raters."""
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


# The vibration that was delivered to the hand, beside what was intended.

SUFFIX, UNKNOWN = "_delivered", "unknown"


def compute_delivered(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Compare the metrics of what was delivered with those intended, and describe the level errors."""
    found, rows = Found(key="delivered"), table.rows[table.rows["role"] == "test"]
    names = [name for name in MATCHES if name in rows and name + SUFFIX in rows]
    errors = rows[rows[ERROR].notna()] if ERROR in rows else rows[:0]
    if not names and errors.empty:
        return found
    items = rows.drop_duplicates("stimulus_id").set_index("stimulus_id")
    matched, levels = [], []
    for name in names:
        intended, delivered = items[name].astype(float), items[name + SUFFIX].astype(float)
        difference = delivered - intended
        stimulus = str(difference.abs().idxmax())
        matched.append({
            "metric": name, "n_stimuli": len(items), "intended": intended.mean(), "delivered": delivered.mean(),
            "difference": difference.mean(), "largest": difference[stimulus], "stimulus": stimulus,
        })  # fmt: skip
    source = errors.get(SOURCE, errors["role"].mask(errors["role"] != "", ""))
    for name, part in errors.groupby(source.replace("", UNKNOWN), observed=True):
        values = part[ERROR].astype(float)
        low, middle, high = values.quantile((0.05, 0.5, 0.95))
        levels.append({
            "source": str(name), "n_judgements": len(values), "median": middle, "q05": low, "q95": high,
            "largest": max(values, key=abs),
        })  # fmt: skip
    found.add("delivered", matched)
    found.add("level_errors", levels)
    found.facts = {"levels": levels, "matched": matched, "n": len(rows)}
    return found
