"""Section about choices between two stimuli: which metric predicts them, and what they say of the reducers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis import words
from feel321.analysis.choices.model import fit_votes
from feel321.analysis.choices.predict import CHANCE, VotePrediction, predict
from feel321.analysis.choices.votes import gather_votes
from feel321.analysis.contrasts.bradley_terry import BradleyTerry, bradley_terry
from feel321.analysis.figures.shares import draw_shares
from feel321.analysis.primary.model import FEW
from feel321.analysis.report import section as page
from feel321.analysis.report.parts import SIGNIFICANCE, describe_hint, split_arms
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, Table
from feel321.analysis.table.schema import CHOSEN, HIGHEST

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices

Row = dict[Any, Any]

KEY, TITLE = "choices", "Choices between two stimuli"
ARM = "scale level"
"""Keys of a number of one arm."""
ASKED = {
    "triplet": "which of two stimuli feels more like the reference",
    "preference": "which of two stimuli is preferred",
}
"""Scale -> what people chose, within a sentence."""

BOTH = 2
"""Metrics of which a sentence says "both" or "neither"."""

CLUSTERED = "95 % t interval, clustered by participants and recordings"
BY_RATER = "95 % bootstrap interval over participants only: these stimuli as the only ones"
WHICH = page.Column("Choices", "_choices", page.TEXT)
N = page.Column("Choices", "n_votes", words.COUNT, "n_votes")

PREDICTED = page.TableForm(
    "Share of choices that each metric predicts (chance: 0.50), with 95 % intervals for other people and other "
    "recordings; p against chance, adjusted by Holm over the metrics of its scale and level. Last rows: how often the "
    "majority of the other participants predicts a choice, and the majority of all, which no metric can exceed.",
    (
        WHICH, page.METRIC,
        page.Column("Share", "share", end="share", method="share of choices predicted", interval=CLUSTERED),
        page.Column("p (Holm)", "p_holm", "p", "p_holm", "two-sided t test against chance, Holm's adjustment"), N,
    ),
    path="choices.{scale}.{level}.{metric}", n="n_votes", detail=False,
)  # fmt: skip
COMPARED = page.TableForm(
    "Differences between metrics in the share of choices that they predict; p adjusted by Holm over the pairs.",
    (
        WHICH, page.Column("Metric", "first", page.TEXT), page.Column("Less", "second", page.TEXT),
        page.Column("Difference", "difference", method="difference of shares of choices predicted", interval=CLUSTERED),
        page.Column("p (Holm)", "p_holm", "p", "p_holm", "two-sided t test, Holm's adjustment"),
    ),
    path="choices_difference.{scale}.{level}.{first}.{second}", n="n_votes",
)  # fmt: skip
WEIGHTS = page.TableForm(
    "Weights of the metrics in one logistic model: change in log odds of a choice per typical (root mean square) "
    "difference of the two stimuli. Order: log odds of the one felt first, between equals. Lapses: share of choices "
    "made regardless of what was felt.",
    (
        WHICH, page.Column("Term", "term", page.TEXT),
        page.Column("Weight", "estimate", end="weight", method="logistic regression", interval=CLUSTERED),
        page.Column("p", "p", "p", "p", "two-sided t test"),
    ),
    path="choices_weight.{scale}.{level}.{term}", n="n_votes",
)  # fmt: skip
ABILITIES = page.TableForm(
    "Abilities of the reducers (Bradley-Terry): log odds of being chosen against the first of the table, over all "
    "recordings; intervals over participants, for these recordings.",
    (
        WHICH, page.Column("Reducer", "reducer", page.NAME),
        page.Column("Ability", "estimate", end="ability", method="Bradley-Terry model", interval=BY_RATER),
        page.Column("Chosen", "share", end="share", method="share of its pairs in which it was chosen"), N,
    ),
    path="choices_ability.{scale}.{level}.{reducer}", n="n_votes",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Arm:
    """The choices of one scale and level: as a table of their own, with the metrics asked about them."""

    scale: str
    level: str
    table: Table
    metrics: tuple[str, ...]
    several: bool

    @property
    def subject(self) -> str:
        """How the choices are called where several levels are compared."""
        bracket = f" (level {words.format_name(self.level)})" if self.several else ""
        return f"{words.capitalise(self.scale)}{bracket}"

    @property
    def keys(self) -> Row:
        """What a row of a table says of it."""
        lead = f"{self.scale}, {self.level}"
        return {"scale": self.scale, "level": self.level, "_choices": lead}


def compute_choices(table: Table, choices: Choices) -> page.Section:
    """Evaluate triplets and preferences, per scale and level."""
    arms = list(_split(table))
    if not arms:
        return page.Section(KEY, TITLE)
    answers: list[str] = []
    lines: list[words.Line] = []
    notes: list[str] = []
    grids: list[page.PageTable] = []
    unseen: list[words.Number] = []
    pictures: list[page.Picture] = []
    tables: dict[str, list[Row]] = {}
    for arm in arms:
        notes += list(_describe_catches(arm, unseen))
        for step in (_predict, _weigh, _scale):
            try:
                found = step(arm, choices)
            except ValueError as error:
                notes.append(f"{arm.scale}, {arm.level}: {str(error).removesuffix('.')}.")
                continue
            grids += found.grids
            answers += found.answers
            lines += found.verdict
            notes += [f"{arm.scale}, {arm.level}: {note}" for note in found.notes]
            pictures += found.pictures
            unseen += found.unseen
            for name, rows in found.tables.items():
                tables.setdefault(name, []).extend(rows.to_dict("records"))
    return page.Section(
        key=KEY, title=TITLE, answers=answers, verdict=lines, grids=grids, unseen=unseen, tables=tables,
        pictures=pictures, notes=notes, how=page.read_methods(KEY),
    )  # fmt: skip


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


def _describe_catches(arm: _Arm, unseen: list[words.Number]) -> Iterator[str]:
    """Say how often an anchor was chosen, which nobody should."""
    one, other = _find_roles(arm)
    is_catch = (one == "anchor") != (other == "anchor")
    n = int(is_catch.sum())
    if not n:
        return
    first = (arm.table.rows["rating"] == HIGHEST).to_numpy()
    wrong = int((np.where(first, one, other)[is_catch] == "anchor").sum())
    unseen += [
        words.count_number(
            words.name_path(KEY, arm.scale, arm.level, "anchors_chosen"), wrong, n=n, keys=ARM
        ),
        words.count_number(
            words.name_path(KEY, arm.scale, arm.level, "catch_trials"), n, n=n, keys=ARM
        ),
    ]
    yield f"{arm.scale}, {arm.level}: an anchor was chosen in {wrong} of {n} catch trials."


# Which metric predicts the choices.


def _predict(arm: _Arm, choices: Choices) -> page.Section:  # noqa: ARG001 - every step has this form
    votes = gather_votes(arm.table, metrics=arm.metrics)
    found = predict(votes)
    more = {**arm.keys, "n_votes": found.n_votes}
    rows: list[Row] = [more | row for row in found.to_frame().to_dict("records")]
    ceiling: list[Row] = [
        {"metric": "majority_of_others", "share": found.others, "low": found.others_low, "high": found.others_high},
        {"metric": "majority_of_all", "share": found.majority, "low": np.nan, "high": np.nan},
    ]  # fmt: skip
    rows += [
        more | row | {"p": np.nan, "p_holm": np.nan} for row in ceiling if np.isfinite(row["share"])
    ]
    differences = [more | row for row in found.differences.to_dict("records")]
    line = _describe(arm, found)
    drawing = partial(
        draw_shares, found, [words.format_name(name) for name in found.shares.index], arm.subject
    )
    caption = (
        f"{arm.subject}: share of choices that each metric predicts, with 95 % intervals for other people and other "
        "recordings. Line: chance. Band: the majority of the other participants, and of all."
    )
    sizes = {
        "participants": found.n_participants,
        "recordings": found.n_recordings,
        "pairs": found.n_pairs,
    }
    return page.Section(
        KEY, TITLE, answers=(str(line),), verdict=(line,),
        grids=(PREDICTED.build(rows), COMPARED.build(differences)),
        unseen=tuple(
            words.count_number(
                words.name_path(KEY, arm.scale, arm.level, f"n_{name}"), size, n=found.n_votes, keys=ARM,
            )
            for name, size in sizes.items()
        ),
        tables={"choices_predicted": rows, "choices_differences": differences},
        pictures=(page.Picture(page.make_slug(KEY, arm.scale, arm.level), caption, drawing),), notes=found.notes,
    )  # fmt: skip


def _describe(arm: _Arm, found: VotePrediction) -> words.Line:
    """Say which metrics predict the choices, and whether any predicts more than another."""
    shares, asked = found.shares, ASKED[arm.scale]
    lead = f"{arm.subject}: " if arm.several else ""
    sizes = {"participant": found.n_participants, "recording": found.n_recordings}
    if shares["p"].isna().all():
        units = [words.format_count(size, name) for name, size in sizes.items()]
        clause = (
            f"whether a metric predicts {asked} cannot be estimated with {words.join_words(units)}"
        )
        return words.Line(f"{lead}{words.capitalise(clause)}.", clause=clause)
    clear = shares[shares["p_holm"] < SIGNIFICANCE].sort_values("share", ascending=False)
    right, wrong = clear[clear["share"] > CHANCE], clear[clear["share"] < CHANCE]
    few = [words.format_count(size, name) for name, size in sizes.items() if size < FEW]
    told, where = [], f" (level {words.format_name(arm.level)})" * arm.several
    if right.empty:
        clause = f"no metric is shown to predict {asked}{where}"
        told.append(_describe_null(shares, asked))
    else:
        listed = [
            f"{words.format_name(str(name))} {_format_share(row)}" for name, row in right.iterrows()
        ]
        verb = "predicts" if len(listed) == 1 else "predict"
        clause = f"{words.join_words(listed)} {verb} {asked}{where}{describe_hint(few)}"
        names = words.capitalise(words.join_words(listed))
        told.append(f"{names} {verb} {asked} (chance 50 %){_describe_ceiling(found)}.")
        told += [
            *_describe_turns(arm, str(right.index[0])),
            _describe_better(found, str(right.index[0])),
        ]
    if len(wrong):
        names = words.join_words([
            f"{words.format_name(str(name))} {_format_share(row)}" for name, row in wrong.iterrows()
        ])
        told.append(f"Stimuli with the better value of {names} were chosen less often.")
    return words.Line(lead + " ".join(filter(None, told)), clause=clause)


def _describe_null(shares: DataFrame, asked: str) -> str:
    best = shares.sort_values("share", ascending=False, kind="stable").iloc[0]
    name, share = words.format_name(str(best.name)), _format_share(best)
    if len(shares) == 1:
        return f"It is not shown that {name} {share} predicts {asked} (chance 50 %)."
    none = f"None of {len(shares)} metrics" if len(shares) > BOTH else "Neither metric"
    return f"{none} is shown to predict {asked} (chance 50 %); the highest share is that of {name} {share}."


def _describe_ceiling(found: VotePrediction) -> str:
    if not np.isfinite(found.others):
        return ""
    return f"; the majority of the other participants predicts {_format_percent(found.others)}"


def _describe_better(found: VotePrediction, best: str) -> str:
    """Say than which other metrics the leading one predicts more choices."""
    if found.differences.empty:
        return ""
    rows = found.differences
    clear = rows[rows["p_holm"] < SIGNIFICANCE].to_dict("records")
    worse = [row["second"] for row in clear if row["first"] == best and row["difference"] > 0]
    worse += [row["first"] for row in clear if row["second"] == best and row["difference"] < 0]
    name = words.capitalise(words.format_name(best))
    if not worse:
        others = "any other metric" if len(found.shares) > BOTH else "the other metric"
        return (
            f"It is not shown that {words.format_name(best)} predicts more choices than {others}."
        )
    return f"{name} predicts more choices than {words.join_words([words.format_name(one) for one in worse])}."


def _describe_turns(arm: _Arm, metric: str) -> Iterator[str]:
    """Name the reducers without which the leading metric is no longer shown to predict."""
    rows, stimuli = arm.table.rows, arm.table.stimuli
    if stimuli is None:
        return

    both = [rows[name].map(stimuli["reducer"]) for name in (STIMULUS, OTHER)]
    turns = []
    tested = sorted(stimuli.loc[stimuli[ROLE] == TEST, "reducer"].unique())
    for name in (name for name in tested if any((ids == name).any() for ids in both)):
        rest = rows[(both[0] != name) & (both[1] != name)]
        try:
            votes = gather_votes(replace(arm.table, rows=rest), metrics=arm.metrics)
        except ValueError:
            continue
        left = predict(votes).shares.loc[metric]
        if not (left["p_holm"] < SIGNIFICANCE and left["share"] > CHANCE):
            turns.append(name)
    if turns:
        yield f"Without {words.join_words(turns, 'or')}, this is not shown for {words.format_name(metric)}."


def _format_share(row: Any) -> str:  # noqa: ANN401 - a row of a frame
    share, low, high = (_format_percent(float(row[key])) for key in ("share", "low", "high"))
    if not np.isfinite(row["low"]):
        return f"({share} of the choices)"
    return f"({share} of the choices, 95 % CI {low.removesuffix(' %')} to {high})"


def _format_percent(share: float) -> str:
    return f"{words.format_number(100 * share, kind=words.COUNT)} %"


# What the choices say of metrics together, and of reducers.


def _weigh(arm: _Arm, choices: Choices) -> page.Section:  # noqa: ARG001 - every step has this form
    votes = gather_votes(arm.table, metrics=arm.table.metrics)
    found = fit_votes(votes)
    rows = [
        {**arm.keys, "n_votes": found.n_votes, **row} for row in found.to_frame().to_dict("records")
    ]
    ends = {"low": np.nan, "high": np.nan, "p": np.nan}
    rows.append({
        **arm.keys,
        "n_votes": found.n_votes,
        "term": "lapses",
        "estimate": found.lapse,
        **ends,
    })
    notes = [note for note in found.notes if note not in votes.notes]
    return page.Section(
        KEY, TITLE, grids=(WEIGHTS.build(rows),), tables={"choices_weights": rows}, notes=notes
    )


def _scale(arm: _Arm, choices: Choices) -> page.Section:
    """Scale the reducers by Bradley-Terry; catch trials, which are won nearly always, have no part in it."""
    one, other = _find_roles(arm)
    rows = arm.table.rows[(one != "anchor") & (other != "anchor")]
    stimuli = arm.table.stimuli
    if len(rows["reference_reducer"].unique()) > 1:
        rows = rows[rows["matched"]]  # likeness to one reference is no likeness to another
    if stimuli is None or rows.empty:
        return page.Section(KEY, TITLE)
    first, second = (rows[name].map(stimuli["reducer"]) for name in (STIMULUS, OTHER))
    winner = first.where(rows["rating"] == HIGHEST, second)
    pairs = rows[["participant"]].assign(first=first, second=second, winner=winner)
    fitted = _fit_abilities(pairs, choices.draws, choices.make_rng(KEY, arm.scale, arm.level))
    listed: list[Row] = []
    for row in fitted.to_frame().to_dict("records"):
        if (name := row["item"]) == "order":
            continue
        met = (first == name) | (second == name)
        share = float((winner[met] == name).mean())
        listed.append({
            **arm.keys,
            **row,
            "reducer": name,
            "share": share,
            "n_votes": int(met.sum()),
        })
    return page.Section(
        KEY, TITLE, grids=(ABILITIES.build(listed),), tables={"choices_abilities": listed},
        notes=fitted.notes,
    )  # fmt: skip


def _fit_abilities(pairs: DataFrame, draws: int, rng: np.random.Generator) -> BradleyTerry:
    """Fit abilities with intervals over participants; shrunken ones without, where a reducer always won or lost."""
    try:
        alone = len(pairs["participant"].unique()) == 1
        return bradley_terry(pairs, by_rater=not alone, order_effect=True, draws=draws, rng=rng)
    except ValueError as error:
        if "separation" not in str(error):
            raise
    shrunken = bradley_terry(pairs, prior=0.5, order_effect=True)
    return replace(shrunken, fixed=shrunken.fixed.assign(low=np.nan, high=np.nan))
