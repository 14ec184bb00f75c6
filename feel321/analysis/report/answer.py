"""The answer that opens the report, what it hinges on, and how large a study would know more.

Every sentence is made from numbers of ``results.json`` and claims no more than they do: a direction only where Holm's p
is below .05, a better metric only where the difference is clear and that metric predicts, and nothing where a slope is
not estimable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.mixed.model import contrast
from feel321.analysis.primary.model import FEW, FEWEST
from feel321.analysis.primary.plan import REDUCER, SCENE, SOURCE, find_recording_slope, make_cells
from feel321.analysis.primary.precision import (
    ENOUGH,
    SlopePrecision,
    find_own,
    find_recording_variance,
    find_variances,
)
from feel321.analysis.primary.sensitivity import (
    LOST,
    MOVED,
    NOT_ESTIMABLE,
    OPEN,
    PREDICTS,
    STIMULUS,
    Influence,
    conclude,
    judge_level,
)
from feel321.analysis.replication.park import explain_spread
from feel321.analysis.report.parts import ITEM, SIGNIFICANCE, RatingsPart, add_step, format_p
from feel321.analysis.report.section import METRIC, RATINGS, Column, TableForm
from feel321.analysis.table.items import format_recordings
from feel321.analysis.table.metrics import Step
from feel321.analysis.words import COUNT, Claim, Line

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.primary.model import Primary
    from feel321.types import MetricInfo

Row = dict[Any, Any]

NEEDS = {
    "detectable": ("Detectable", "slope", "slope per {_per} found with 80 % power"),
    "participants": ("Participants", COUNT, "participants for 80 % power"),
    "recordings": ("Recordings", COUNT, "recordings for 80 % power"),
    "infinite": ("Power at infinity", "correlation", "power of infinitely many participants"),
}
NEEDED = TableForm(
    f"Sample size. Detectable: the smallest slope, in points per +0.1, detectable with {100 * ENOUGH:.0f} % power. "
    "Then, if the slope is what was estimated here: participants needed with these recordings, recordings needed with "
    "these participants (sources, where several recordings come from one), and the power of infinitely many "
    "participants with these recordings; at 5 % over the number of slopes. A dash: more than 10 000, or a slope from "
    "which nothing can be planned.",
    (
        RATINGS, METRIC, *(Column(head, f"_{key}", kind, key, how) for key, (head, kind, how) in NEEDS.items())
    ),
    path="precision.{scale}.{level}.{metric}",
)  # fmt: skip


def find_needs(row: Row, part: RatingsPart, model: Primary, *, n_tests: int) -> dict[str, float]:
    """Find what would settle a slope; NaN where nothing can be planned."""
    if not is_sound(row):
        return dict.fromkeys((f"_{key}" for key in NEEDS), math.nan)
    study, slope = find_precision(row["metric"], part, model, n_tests=n_tests), row["estimate"]
    return {
        "_detectable": study.find_slope() * row["_size"],
        "_participants": study.find_participants(slope),
        "_recordings": study.find_recordings(slope),
        "_infinite": study.enlarge(participants=10**9).find_power(slope),
    }


def is_sound(row: Row) -> bool:
    """Tell whether a study may be planned from a slope: it is estimable, and nothing single turns it."""
    return bool(row["estimable"]) and not row.get("turns", False)


def describe_need(row: Row, *, scenes: str = "recordings") -> str:
    """Say what would settle an inconclusive slope."""
    if row["p_holm"] < SIGNIFICANCE or not is_sound(row):
        return ""
    metric = words.format_name(row["metric"])
    if_so = f"If the true slope on {metric} is the one estimated here,"
    if math.isfinite(row["_participants"]):
        people = words.format_number(row["_participants"], kind=COUNT)
        return f"{if_so} {people} participants with these recordings would give 80 % power."
    if math.isfinite(row["_recordings"]):
        more, most = (
            words.format_number(row["_recordings"], kind=COUNT),
            words.format_number(row["_infinite"]),
        )
        alone = f"adding participants alone would not settle it (power at most {most})"
        return f"{if_so} {alone}; {more} {scenes} with as many participants would give 80 % power."
    return f"A slope on {metric} as small as the one estimated here is out of reach of any study of this kind."


def find_precision(
    metric: str, part: RatingsPart, model: Primary, *, n_tests: int = 1
) -> SlopePrecision:
    """Take the standard error of a slope apart, by the spreads that were estimated."""
    cells = make_cells(part.rows, list(model.slopes.index))
    within = [f"{name}_w" for name in model.slopes.index]
    spreads = {
        (row["group"], row["term"]): float(row["sd"])
        for row in model.fit.variances.to_dict("records")
    }
    found = {group: sd for (group, term), sd in spreads.items() if term == "(Intercept)"}
    repeats = (
        1
        if model.averaged
        else len(part.rows) / len(part.rows.groupby(["participant", ITEM], observed=True))
    )
    items = cells.table.drop_duplicates(ITEM)
    known = REDUCER in found or f"participant:{REDUCER}" in found
    codes = items[REDUCER].factorize()[0] if known else None
    study = SlopePrecision(
        slope_sd=spreads.get(("participant", f"{metric}_w"), 0.0), item_sd=found.get(ITEM, 0.0),
        noise_sd=math.hypot(found.get("participant:item", 0.0), model.fit.residual_sd / math.sqrt(repeats)), square=1.0,
        n_participants=model.n_participants, n_recordings=model.n_sources, n_items=len(items), n_slopes=len(within),
        reducer_sd=found.get(REDUCER, 0.0), rater_reducer_sd=found.get(f"participant:{REDUCER}", 0.0),
        n_reducers=model.n_reducers if known else 0, n_alike=len(items) / model.n_reducers if known else 1.0,
        level=SIGNIFICANCE / n_tests,
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
    together = (
        float((items.assign(own=own).groupby(groups, observed=True)["own"].sum() ** 2).sum())
        / study.square
    )
    shared = found.get(":".join(groups), 0.0) ** 2 * together
    return replace(
        study, item_sd=math.sqrt(study.item_sd**2 + shared), n_items=cells.count(*groups)
    )


LEVELLED = {
    "in_model": "at equal level",
    "alike": "levels within recordings alike or not separable from the metrics",
    "metric": "level among the metrics",
    "unknown": "level not known",
}
"""What became of level in the model -> how the evidence says so."""

UNBOUNDED = "spectral_match"
HIGHER, LOWER = "higher", "lower"
NAMED = 3
"""How many units a sentence names before it only counts."""

RAW = (
    "spectral match is the paper's eq. 1 here, which has no lower bound, so a few stimuli may decide its slope; read "
    "its rank correlation and what single stimuli do to it, or build the stimulus set again and use "
    "spectral_match_bounded."
)


def describe_loss(
    part: RatingsPart, metrics: Sequence[str], reason: str
) -> tuple[Line, list[Claim]]:
    """Say that no model can be fitted to a part, and why."""
    named = words.join_words([words.format_name(name) for name in metrics], "or")
    alike = part.rows["rating"].min() == part.rows["rating"].max()
    why = "all ratings are the same" if alike else reason.removesuffix(".")
    text = f"Whether {named} predicts {part.ratings} cannot be estimated: {why}."
    claims = [
        Claim(*part.place, name, NOT_ESTIMABLE, "", words.name_path("slope", *part.place, name))
        for name in metrics
    ]
    return Line(text, words.capitalise(part.subject)), claims


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """A slope of the primary model and all that its sentence needs."""

    row: Row
    part: RatingsPart
    model: Primary
    influence: Influence
    info: MetricInfo | None = None
    step: Step = field(default_factory=Step)

    @property
    def metric(self) -> str:
        """Name of the metric."""
        return str(self.row["metric"])

    @property
    def verdict(self) -> str:
        """What is concluded."""
        return conclude(self.row["p_holm"])

    @property
    def direction(self) -> str:
        """Where ratings go with a higher metric; empty where nothing is claimed."""
        if self.verdict != PREDICTS:
            return ""
        return HIGHER if self.row["estimate"] > 0 else LOWER

    @property
    def expected(self) -> str:
        """Where ratings go with a higher metric if it works as it declares."""
        return LOWER if self.info is not None and self.info.higher == "worse" else HIGHER

    @property
    def few(self) -> tuple[str, ...]:
        """Units of which there are too few for a slope, or for more than a hint."""
        least = FEWEST if self.verdict == NOT_ESTIMABLE else FEW
        return tuple(
            words.format_count(size, name)
            for name, size in _count_units(self.model).items()
            if size < least
        )

    @property
    def beyond_level(self) -> str:
        """What the verdict owes to level."""
        return judge_level(self.model.level, self.row["p_holm"], self.row["plain_p_holm"])

    @property
    def hinges(self) -> DataFrame:
        """Units without which a metric that predicts does not, or not in this direction; an open verdict has none."""
        turns = self.influence.find_turns(self.metric)
        return turns if self.verdict == PREDICTS else turns.iloc[:0]

    def make_claim(self) -> Claim:
        """State the conclusion for a program."""
        turns = tuple(_name_unit(row) for row in self.hinges.to_dict("records"))
        worse: list[str] = []
        if self.verdict == PREDICTS and self.direction == self.expected and not turns:
            for row in self.model.differences.to_dict("records"):
                pair = [str(row["first"]), str(row["second"])]
                if self.metric in pair and _find_better(row) == self.metric:
                    worse += [name for name in pair if name != self.metric]
        place, found = self.part.place, (self.verdict, self.direction)
        number = words.name_path("slope", *place, self.metric)
        higher = "better" if self.expected == HIGHER else "worse"
        return Claim(
            *place, self.metric, *found, number, turns, tuple(worse), higher, self.hinge, self.few,
            beyond_level=self.beyond_level,
        )  # fmt: skip

    @property
    def hinge(self) -> str:
        """What the verdict hinges on, in a few words."""
        rows, more = self.hinges.to_dict("records"), len(self.hinges) - 1
        return f"the {_name_unit(rows[0])}" + f" and {more} more" * (more > 0) if rows else ""


def describe_findings(found: Sequence[Finding], needs: Sequence[str]) -> Iterator[Line]:
    """Say what the model of a part shows, the finding of each metric first."""
    part, model, influence = found[0].part, found[0].model, found[0].influence
    subject = words.capitalise(part.subject)
    if all(one.verdict == NOT_ESTIMABLE for one in found):
        yield Line(_describe_blank(found), subject)
        return
    for one in found:
        yield Line(_describe_finding(one), subject)
    for row in model.differences.to_dict("records"):
        if told := _compare(row, found):
            yield Line(told, subject, "comparison")
    if told := _describe_exceptions(influence, part):
        yield Line(told, subject, "exceptions")
    spreads = filter(None, (explain_spread(part.rows, one.metric) for one in found))
    yield from (Line(told, subject, "spread over orientations") for told in spreads)
    if told := " ".join(filter(None, needs)):
        yield Line(told, subject, "sample size")
    if any(one.metric == UNBOUNDED for one in found):
        yield Line(RAW, subject, "unbounded metric")
    yield Line(_describe_evidence(found), subject, "evidence")


def _describe_finding(found: Finding) -> str:
    """Say whether a metric predicts ratings, how strongly, and on what that hinges."""
    metric, ratings = words.format_name(found.metric), found.part.ratings
    if found.verdict == NOT_ESTIMABLE:
        return _describe_blank([found])
    hinge = _describe_hinge(found)
    if found.beyond_level == LOST:
        alone = f"without level in the model {metric} would predict {ratings}, with it this is open"
        return f"{words.capitalise(alone)}{hinge}. {_describe_effect(found)}"
    if found.verdict == OPEN:
        return f"Whether {metric} predicts {ratings} is open{hinge}. {_describe_effect(found)}"
    opposite = "" if found.direction == found.expected else " in the opposite direction"
    plain = found.direction == found.expected == HIGHER
    way = "" if plain else f"{opposite} (higher {metric}, {found.direction} ratings)"
    return f"{words.capitalise(metric)} predicts {ratings}{way}{hinge}. {_describe_effect(found)}"


def _describe_blank(found: Sequence[Finding]) -> str:
    """Say that nothing can be estimated, and what there is too little of."""
    names = words.join_words([words.format_name(one.metric) for one in found], "or")
    few = found[0].few
    lack = f" with {' and '.join(few)}: at least {FEWEST} are needed{' of each' * (len(few) > 1)}"
    none = ": too few degrees of freedom are left for a test"
    ratings = found[0].part.ratings
    return f"Whether {names} predicts {ratings} cannot be estimated{lack if few else none}."


def _describe_effect(found: Finding) -> str:
    """Give the effect over the metric's own spread first, per step second."""
    changes = []
    for key, ends in (("quartile_effect", "quartile"), ("_step", "_step")):
        row = found.row
        told, interval = words.format_estimate(
            row[key], row[f"{ends}_low"], row[f"{ends}_high"], kind="rating"
        )
        higher = found.direction == HIGHER
        change = f"ratings {told} points higher" if higher else f"a change of {told} points"
        changes.append((change, interval))
    (span, reach), (change, narrow) = changes
    return (
        "Among stimuli from the same recording, going from its lower to its upper quartile is associated with "
        f"{span} (95 % CI {reach}; {format_p(found.row['p_holm'])}), each {found.step.per} with {change} ({narrow})."
    )


def _describe_hinge(found: Finding) -> str:
    """Say which units a verdict hinges on, and what would be concluded without the most influential one."""
    if turns := found.hinges.to_dict("records"):
        without = f"the {_name_unit(turns[0])}: without it {_describe_without(turns[0], found)}"
        others = _list_others(turns, "; the verdict also turns without")
        return f", but this hinges on {without}{others}"
    moves = found.influence.find_moves(found.metric).to_dict("records")
    rows = [row for row in moves if abs(row["shift"]) > MOVED]
    if not rows:
        return ""
    value, interval = _format_step(rows[0], found)
    instead = words.format_number(found.row["_step"], kind="rating")
    others = _list_others(rows, "; also without")
    told = f"{value}, {interval}, instead of {instead} points per {found.step.per}{others}"
    unit = _name_unit(rows[0])
    return f"; the slope changes by more than its standard error without the {unit} ({told})"


def _list_others(rows: Sequence[Row], lead: str) -> str:
    """Name the units after the first, and count those after the third."""
    names, more = [f"the {_name_unit(row)}" for row in rows[1:NAMED]], len(rows) - NAMED
    if not names:
        return ""
    listed = f"{', '.join(names)} and {more} more" if more > 0 else words.join_words(names)
    return f"{lead} {listed}"


def _describe_without(row: Row, found: Finding) -> str:
    value, interval = _format_step(row, found)
    evidence = f"{value} points per {found.step.per}, {interval}"
    if row["verdict"] == OPEN:
        return f"the association is open ({evidence})"
    way = HIGHER if row["tenth"] > 0 else LOWER
    return (
        f"a higher {words.format_name(found.metric)} is associated with {way} ratings ({evidence})"
    )


def _format_step(row: Row, found: Finding) -> tuple[str, str]:
    """Write a slope without some unit, per step of its metric."""
    row = add_step(row, found.step)
    return words.format_estimate(row["_step"], row["_step_low"], row["_step_high"], kind="rating")


def _name_unit(row: Row) -> str:
    return f"{row['kind']} {row['unit']}"


def _compare(row: Row, found: Sequence[Finding]) -> str:
    """Say which of two metrics predicts better, in the same model and over the spread of each."""
    by_metric = {one.metric: one for one in found}
    first, second = by_metric[row["first"]], by_metric[row["second"]]
    ends = tuple(row[f"standardised_{end}"] for end in ("estimate", "low", "high"))
    if math.isnan(ends[1]) or NOT_ESTIMABLE in {first.verdict, second.verdict}:
        return ""
    if unsteady := [
        words.format_name(one.metric) for one in (first, second) if not one.hinges.empty
    ]:
        names = words.join_words(unsteady)
        return f"which metric predicts better is left open: the verdict on {names} is not stable."
    evidence = "standardised slopes differ by {}, 95 % CI {}".format(
        *words.format_estimate(*ends, kind="slope")
    )
    better, ratings = _find_better(row), first.part.ratings
    if not better or by_metric[better].direction != by_metric[better].expected:
        names = f"{words.format_name(first.metric)} or {words.format_name(second.metric)}"
        return f"the data do not show whether {names} predicts {ratings} better ({evidence})."
    worse = words.format_name((second if better == first.metric else first).metric)
    return f"{words.format_name(better)} predicts {ratings} better than {worse} does ({evidence})."


def _find_better(row: Row) -> str:
    """Find which of two metrics has the stronger standardised slope, each in the direction that it declares."""
    low, high = row["standardised_low"], row["standardised_high"]
    if math.isnan(low) or low <= 0 <= high:
        return ""
    return str(row["first"] if low > 0 else row["second"])


def orient_differences(model: Primary, info: Mapping[str, MetricInfo]) -> Primary:
    """Compare slopes each in the direction that its metric declares: one of which lower is better changes its sign."""
    worse = {name for name in model.slopes.index if name in info and info[name].higher == "worse"}
    if not worse:
        return model
    scales, rows = (model.slopes["standardised"] / model.slopes["estimate"]).to_dict(), []
    for row in model.differences.to_dict("records"):
        one, other = (f"{row[key]}_w" for key in ("first", "second"))
        signs = [-1.0 if row[key] in worse else 1.0 for key in ("first", "second")]
        for prefix, sizes in (
            ("", (1.0, 1.0)),
            ("standardised_", (scales[row["first"]], scales[row["second"]])),
        ):
            weights = {one: signs[0] * sizes[0], other: -signs[1] * sizes[1]}
            found = asdict(contrast(model.fit, weights)) if math.isfinite(row["low"]) else {}
            row |= {f"{prefix}{key}": value for key, value in found.items()}
        rows.append(row)
    return replace(model, differences=type(model.differences)(rows))


def _describe_exceptions(influence: Influence, part: RatingsPart) -> str:
    told = [
        f"{row['reducer']} was rated {words.format_number(abs(row['excess']), kind='rating')} points "
        f"{HIGHER if row['excess'] > 0 else LOWER} than the metrics predict from the other reducers"
        for row in influence.exceptions.reset_index().to_dict("records")
        if row["exceptional"]
    ]
    return f"{'; '.join(told)} ({part.ratings})." if told else ""


def _count_units(model: Primary) -> dict[str, int]:
    scene = "source" if model.n_sources < model.n_recordings else "recording"
    reducers = {REDUCER: model.n_reducers} if model.n_reducers else {}
    return {"participant": model.n_participants, scene: model.n_sources} | reducers


def _describe_evidence(found: Sequence[Finding]) -> str:
    """Say what the findings are based on, and how far they reach."""
    model, n = found[0].model, found[0].model.n_participants
    people, reducers = f"{n} participant{'s' * (n != 1)}", ""
    if model.n_reducers:
        reducers = f", {model.n_reducers} reducer{'s' * (model.n_reducers != 1)}"
    scenes = format_recordings(model.n_recordings, model.n_sources)
    sizes = f"{people}, {scenes}{reducers}, {model.n_items} stimuli"
    together = "one mixed model with all metrics" if len(found) > 1 else "mixed model"
    claims = [one for one in found if one.verdict == PREDICTS]
    told = ""
    if claims and (few := claims[0].few):
        told = f" With {words.join_words(few)} this is a hint rather than a result."
    steady = [words.format_name(one.metric) for one in claims if one.hinges.empty]
    if steady and len(table := found[0].influence.table):
        tried = table.loc[table["verdict"] != NOT_ESTIMABLE, "kind"].unique()
        units = words.join_words([kind for kind in tried if kind != STIMULUS], "or")
        units = (
            f"No single {units}, and none of the most influential stimuli,"
            if units
            else ("None of the most influential stimuli")
        )
        names = words.join_words(steady, "or")
        told += f" {units} changes the verdict on {names}."
    return f"{sizes}; {together}, {LEVELLED[model.level]}.{told}"
