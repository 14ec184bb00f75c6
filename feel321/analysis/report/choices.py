"""Section: choices between two stimuli: which metric predicts them, and what they say of the reducers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.choices import CHANCE, fit_votes, gather_votes, predict
from feel321.analysis.contrasts.bradley_terry import bradley_terry
from feel321.analysis.figures.kinds import draw_shares
from feel321.analysis.primary.model import FEW
from feel321.analysis.report.parts import SIGNIFICANCE, split_arms
from feel321.analysis.report.section import (
    Found,
    Picture,
    Row,
    Section,
    count_rows,
    make_row,
    make_slug,
    name_subject,
)
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, Table
from feel321.analysis.table.schema import CHOSEN, HIGHEST
from feel321.analysis.words import ONE_WAY, format_count, format_name, format_number, join_words

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.records import Statistic

KEY = "choices"
CLUSTERED = "95 % t interval, clustered by participants and recordings"


@dataclass(frozen=True, slots=True, eq=False)
class _Arm:
    """The choices of one scale and level: as a table of their own, with the metrics asked about them."""

    scale: str
    level: str
    table: Table
    metrics: tuple[str, ...]
    several: bool

    @property
    def keys(self) -> Row:
        """What a row says of it."""
        return {"scale": self.scale, "level": self.level}


def compute(table: Table, choices: Choices) -> Found:
    """Evaluate triplets and preferences, per scale and level."""
    names = ("predicted", "differences", "weights", "abilities", "sizes")
    rows: dict[str, list[Row]] = {f"choices_{name}": [] for name in names}
    told: list[Row] = []
    notes: list[str] = []
    pictures: list[Picture] = []
    for arm in _split(table):
        lead = f"{arm.scale}, {arm.level}"
        notes += _count_catches(arm, rows["choices_sizes"])
        try:
            found = predict(gather_votes(arm.table, metrics=arm.metrics))
        except ValueError as error:
            notes.append(f"{lead}: {str(error).removesuffix('.')}.")
        else:
            _list_predicted(arm, found, rows)
            told.append(describe_prediction(arm, found))
            pictures.append(_draw(arm, found))
            notes += [f"{lead}: {note}" for note in found.notes]
        for step in (_weigh, _scale):
            try:
                notes += [f"{lead}: {note}" for note in step(arm, choices, rows)]
            except ValueError as error:
                notes.append(f"{lead}: {str(error).removesuffix('.')}.")
    return Found(
        rows,
        {"parts": told} if any(rows.values()) else {},
        pictures,
        notes,
        clauses=[_claim(one) for one in told],
    )


def _split(table: Table) -> Iterator[_Arm]:
    rows = table.rows[table.rows["scale"].isin(CHOSEN)]
    metrics = tuple(dict.fromkeys([*table.metrics, *table.rivals]))
    several = len(rows["level"].unique()) > 1
    for scale, level, part in split_arms(rows):
        own = replace(table, rows=part.reset_index(drop=True))
        yield _Arm(scale, level, own, metrics, several)


def _find_roles(arm: _Arm) -> tuple[Any, Any]:
    """Find the roles of both stimuli of each choice."""
    rows, stimuli = arm.table.rows, arm.table.stimuli
    roles: Any = {} if stimuli is None else stimuli[ROLE]
    return rows[STIMULUS].map(roles).to_numpy(), rows[OTHER].map(roles).to_numpy()


def _count_catches(arm: _Arm, rows: list[Row]) -> Iterator[str]:
    """Count how often an anchor was chosen, which nobody should."""
    one, other = _find_roles(arm)
    is_catch = (one == "anchor") != (other == "anchor")
    if n := int(is_catch.sum()):
        first = (arm.table.rows["rating"] == HIGHEST).to_numpy()
        wrong = int((np.where(first, one, other)[is_catch] == "anchor").sum())
        rows += count_rows({"anchors_chosen": wrong, "catch_trials": n}, n=n, **arm.keys)
        yield f"{arm.scale}, {arm.level}: an anchor was chosen in {wrong} of {n} catch trials."


# Which metric predicts the choices.


def _list_predicted(arm: _Arm, found: Statistic, rows: dict[str, list[Row]]) -> None:
    keys: Row = {**arm.keys, "n": found.n_votes, "interval": CLUSTERED}
    for row in found.to_frame().to_dict("records"):
        ends = {"low": row["low"], "high": row["high"], "p": row["p_holm"]}
        rows["choices_predicted"].append(
            make_row("share", row["share"], **ends, metric=row["metric"], **keys)
        )
        rows["choices_predicted"].append(
            make_row("n_choices", found.n_votes, metric=row["metric"], **keys)
        )
    ceiling = {
        "majority_of_others": (found.others, found.others_low, found.others_high),
        "majority_of_all": (found.majority, np.nan, np.nan),
    }  # fmt: skip
    for name, (value, low, high) in ceiling.items():
        if np.isfinite(value):
            rows["choices_predicted"].append(
                make_row("share", value, low=low, high=high, metric=name, **keys)
            )
    for row in found.differences.to_dict("records"):
        ends = {"low": row["low"], "high": row["high"], "p": row["p_holm"]}
        pair = {"metric": row["first"], "second_metric": row["second"]}
        rows["choices_differences"].append(
            make_row("difference", row["difference"], **ends, **pair, **keys)
        )
    sizes = {
        "n_participants": found.n_participants,
        "n_recordings": found.n_recordings,
        "n_pairs": found.n_pairs,
    }
    rows["choices_sizes"] += count_rows(sizes, n=found.n_votes, **arm.keys)


def describe_prediction(arm: _Arm, found: Statistic) -> Row:
    """Decide which metrics may be said to predict the choices, and whether any predicts more than another."""
    shares = found.shares
    sizes = {"participant": found.n_participants, "recording": found.n_recordings}
    told: Row = {
        "scale": arm.scale, "subject": name_subject(arm.scale, arm.level * arm.several),
        "level": arm.level * arm.several, "compared": len(found.differences),
        "estimable": not shares["p"].isna().all(), "units": [format_count(size, name) for name, size in sizes.items()],
        "few": [format_count(size, name) for name, size in sizes.items() if size < FEW], "n_metrics": len(shares),
        "others": found.others, "right": [], "wrong": [], "worse": [], "without": [],
    }  # fmt: skip
    listed = [{"metric": str(name), **row} for name, row in shares.to_dict("index").items()]
    listed.sort(key=lambda row: -row["share"])
    clear = [row for row in listed if row["p_holm"] < SIGNIFICANCE]
    told["highest"] = listed[0]
    told["right"] = [row for row in clear if row["share"] > CHANCE]
    told["wrong"] = [row for row in clear if row["share"] < CHANCE]
    if told["right"]:
        best = told["right"][0]["metric"]
        rows = [row for row in found.differences.to_dict("records") if row["p_holm"] < SIGNIFICANCE]
        told["worse"] = [
            row["second"] for row in rows if row["first"] == best and row["difference"] > 0
        ]
        told["worse"] += [
            row["first"] for row in rows if row["second"] == best and row["difference"] < 0
        ]
        told["without"] = list(_find_turns(arm, best))
    return told


def _claim(told: Row) -> str:
    """Say for the headline which metrics predict these choices."""
    asked = ASKED[told["scale"]]
    where = f" (level {format_name(told['level'])})" if told["level"] else ""
    if not told["estimable"]:
        return f"whether a metric predicts {asked} cannot be estimated with {join_words(told['units'])}"
    if not told["right"]:
        return f"no metric is shown to predict {asked}{where}"
    names = [
        f"{format_name(row['metric'])} ({format_number(100 * row['share'], kind='count')} % of the choices)"
        for row in told["right"]
    ]
    hint = f" (with {join_words(told['few'])}, a hint rather than a result)" if told["few"] else ""
    return f"{join_words(names)} predict{'s' * (len(names) == 1)} {asked}{where}{hint}"


ASKED = {
    "triplet": "which of two stimuli feels more like the reference",
    "preference": "which of two stimuli is preferred",
}
"""Scale -> what people chose, within a sentence."""


def _find_turns(arm: _Arm, metric: str) -> Iterator[str]:
    """Name the reducers without which the leading metric is no longer shown to predict."""
    rows, stimuli = arm.table.rows, arm.table.stimuli
    if stimuli is None:
        return
    both = [rows[name].map(stimuli["reducer"]) for name in (STIMULUS, OTHER)]
    tested = sorted(stimuli.loc[stimuli[ROLE] == TEST, "reducer"].unique())
    for name in (name for name in tested if any((ids == name).any() for ids in both)):
        rest = rows[(both[0] != name) & (both[1] != name)]
        try:
            votes = gather_votes(replace(arm.table, rows=rest), metrics=arm.metrics)
        except ValueError:
            continue
        left = predict(votes).shares.loc[metric]
        if not (left["p_holm"] < SIGNIFICANCE and left["share"] > CHANCE):
            yield name


def _draw(arm: _Arm, found: Statistic) -> Picture:
    subject = name_subject(arm.scale, arm.level * arm.several)
    caption = (
        f"{subject}: share of {found.n_votes} choices that each metric predicts, with 95 % intervals for other people "
        f"and other recordings ({found.n_participants} participants, {found.n_recordings} recordings). Line: chance. "
        "Band: the majority of the other participants, and of all."
    )
    return Picture(make_slug(KEY, arm.scale, arm.level), caption, partial(draw_shares, found))


# What the choices say of metrics together, and of reducers.


def _weigh(arm: _Arm, choices: Choices, rows: dict[str, list[Row]]) -> list[str]:  # noqa: ARG001 - both steps have this form
    votes = gather_votes(arm.table, metrics=arm.table.metrics)
    found = fit_votes(votes)
    keys: Row = {**arm.keys, "n": found.n_votes, "interval": CLUSTERED}
    for row in found.to_frame().to_dict("records"):
        ends = {"low": row["low"], "high": row["high"], "p": row["p"]}
        rows["choices_weights"].append(
            make_row("weight", row["estimate"], **ends, term=row["term"], **keys)
        )
    rows["choices_weights"].append(make_row("weight", found.lapse, term="lapses", **keys))
    return [note for note in found.notes if note not in votes.notes]


def _scale(arm: _Arm, choices: Choices, rows: dict[str, list[Row]]) -> list[str]:
    """Scale the reducers by Bradley-Terry; catch trials, which are won nearly always, have no part in it."""
    one, other = _find_roles(arm)
    votes = arm.table.rows[(one != "anchor") & (other != "anchor")]
    stimuli = arm.table.stimuli
    if len(votes["reference_reducer"].unique()) > 1:
        votes = votes[votes["matched"]]  # likeness to one reference is no likeness to another
    if stimuli is None or votes.empty:
        return []
    first, second = (votes[name].map(stimuli["reducer"]) for name in (STIMULUS, OTHER))
    winner = first.where(votes["rating"] == HIGHEST, second)
    pairs = votes[["participant"]].assign(first=first, second=second, winner=winner)
    fitted = _fit_abilities(pairs, choices.draws, choices.make_rng(KEY, arm.scale, arm.level))
    for row in fitted.to_frame().to_dict("records"):
        if (name := row["item"]) == "order":
            continue
        met = (first == name) | (second == name)
        keys: Row = {**arm.keys, "reducer": name, "n": int(met.sum())}
        ends = {"low": row["low"], "high": row["high"], "interval": ONE_WAY}
        rows["choices_abilities"].append(make_row("ability", row["estimate"], **ends, **keys))
        shares = {"share_chosen": float((winner[met] == name).mean()), "n_choices": int(met.sum())}
        rows["choices_abilities"] += count_rows(shares, **keys)
    return list(fitted.notes)


def _fit_abilities(pairs: DataFrame, draws: int, rng: np.random.Generator) -> Statistic:
    """Fit abilities with intervals over participants; shrunken ones without, where a reducer always won or lost."""
    try:
        alone = len(pairs["participant"].unique()) == 1
        return bradley_terry(pairs, by_rater=not alone, order_effect=True, draws=draws, rng=rng)
    except ValueError as error:
        if "separation" not in str(error):
            raise
    shrunken = bradley_terry(pairs, prior=0.5, order_effect=True)
    return shrunken.replace(fixed=shrunken.fixed.assign(low=np.nan, high=np.nan))


SECTION = Section(KEY, "Choices between two stimuli", "differ", compute)
