"""The report's first screen: one sentence, a card per scale, one figure; and the sections by the question they answer.

Whatever a card shows is looked up among the numbers and verdicts of ``results.json``, which lists the cards too. The
sentence follows from the cards and claims nothing that no verdict does.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING

from feel321.analysis import words
from feel321.analysis.primary.model import FEWEST
from feel321.analysis.primary.sensitivity import LOST, NOT_ESTIMABLE, OPEN, PREDICTS, list_changes
from feel321.analysis.report.parts import describe_hint, split_parts
from feel321.analysis.report.section import Picture, Section, make_slug
from feel321.analysis.report.standing import Standing

if TYPE_CHECKING:
    from feel321.analysis.table.items import Table

TITLE = "Do the metrics predict the ratings?"
QUESTIONS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "predict": (TITLE, ("primary", "rivals", "metrics", "further")),
    "differ": ("How do the reducers differ?", ("reducers", "contrasts", "choices", "levels")),
    "apart": (
        "Can people tell them apart?", ("discrimination", "told_apart", "space", "maps"),
    ),
    "trust": ("Can the raters be trusted?", ("raters", "delivered")),
    "hinge": ("How much does it hinge on choices?", ("robustness",)),
    "computed": ("How was it computed?", ("standard",)),
}  # fmt: skip
"""Anchor of each question -> how it is put, and the sections that answer it, by their keys."""

COUNTED = 3
"""Sentences of one kind that a section shows; more of them are folded, and its tables and figures speak."""

SUMMED = 2
"""Sentences that sum up the raters, before those about each scale."""

IN_TABLES = frozenset({"", "comparison", "sample size"})
"""What the primary model's lines say of each metric, each pair and each sample size: its cards and tables show it."""

VERDICTS = {PREDICTS: "predicts", OPEN: "open", NOT_ESTIMABLE: "not estimable"}
OPPOSITE = "opposite"
NAMED = 2
"""Exceptional reducers that the sentence names before it only counts."""


@dataclass(frozen=True, slots=True)
class About:
    """What a report's first screen says of the study.

    Parameters
    ----------
    name : str
        Its name.
    date : str
        Day of the last rating, as 2026-03-01; empty if unknown.
    protocols : tuple of str
        Its protocols, in the order in which the report shows their scales.
    standing : Standing
        What was declared before the ratings.

    Examples
    --------
    >>> from feel321.results import About
    >>> About("pilot", "2026-03-01").date
    '2026-03-01'
    """

    name: str = ""
    date: str = ""
    protocols: tuple[str, ...] = ()
    standing: Standing = field(default_factory=Standing)


def order_scales(table: Table, protocols: Sequence[str]) -> Table:
    """Put the ratings of protocols in the study's order, where the first participant had another."""
    rows = table.rows
    if "protocol" not in rows or not protocols:
        return table
    place = {name: number for number, name in enumerate(protocols)}
    ranks = rows["protocol"].map(place).fillna(len(place))
    if ranks.drop_duplicates().is_monotonic_increasing:
        return table
    order = ranks.sort_values(kind="stable").index
    return replace(table, rows=rows.loc[order].reset_index(drop=True))


@dataclass(frozen=True, slots=True)
class MetricCard:
    """What the first screen shows of one metric on one scale and level; a row of ``cards`` in ``results.json``.

    effect: points of rating from the metric's lower to its upper quartile within recordings. correlation: Pearson's,
    within recordings; its ceiling: the highest that the noise in the ratings allows. hinge: in a few words. few: units
    of which there are so few that a finding is a hint, or that there is none. given: the other metrics at equal values
    of which the effect is; the correlation is that of the metric alone. unflagged: another verdict without the raters
    whom screening rules flag.
    """

    scale: str
    level: str
    subject: str
    metric: str
    verdict: str
    direction: str
    higher: str
    hinge: str
    effect: float
    effect_low: float
    effect_high: float
    correlation: float
    correlation_low: float
    correlation_high: float
    ceiling: float
    better_than: tuple[str, ...] = ()
    few: tuple[str, ...] = ()
    given: tuple[str, ...] = ()
    unflagged: str = ""
    status: str = words.EXPLORATORY
    reason: str = ""

    @property
    def outcome(self) -> str:
        """The verdict, or that the metric predicts against the direction that it declares."""
        as_declared = (self.direction == "higher") == (self.higher == "better")
        return self.verdict if self.verdict != PREDICTS or as_declared else OPPOSITE

    @property
    def is_turned(self) -> bool:
        """Whether the metric predicts one way at equal values of the others, and correlates the other way alone."""
        return self.verdict == PREDICTS and self.effect * self.correlation < 0

    @property
    def points(self) -> str:
        """The effect with its interval, for the page; empty where there is none, or no test of it."""
        ends = (self.effect, self.effect_low, self.effect_high)
        value, interval = words.format_estimate(*ends, kind="rating")
        sign = "+" if self.effect > 0 and value[0].isdigit() else ""
        return f"{sign}{value} points ({interval})" if math.isfinite(self.effect_low) else ""

    @property
    def condition(self) -> str:
        """What the effect is at equal values of, for the page; empty where the metric is the only one."""
        names = [words.format_name(name) for name in self.given]
        return f"at equal {words.join_words(names)}" if names else ""

    @property
    def r(self) -> str:
        """The correlation with its interval, for the page; empty where there is none."""
        value, interval = words.format_estimate(
            self.correlation, self.correlation_low, self.correlation_high
        )
        known, alone = math.isfinite(self.correlation), ", metric alone" * bool(self.given)
        return f"r = {value} ({interval}){alone}" if known else ""

    @property
    def described(self) -> str:
        """What the strip draws, for who does not see it."""
        limit = f"; noise ceiling {words.format_number(self.ceiling)}"
        return self.r + (limit if math.isfinite(self.ceiling) else "")


def make_cards(
    table: Table, sections: Iterable[Section], numbers: Iterable[words.Number]
) -> tuple[MetricCard, ...]:
    """Make a card of every metric of the primary analysis, scale by scale in the study's order."""
    sections, found = list(sections), {number.name: number for number in numbers}
    claims = {
        (one.scale, one.level, one.metric): one for section in sections for one in section.claims
    }
    unflagged = dict(_list_unflagged(sections))
    cards = []
    for part in split_parts(table):
        subject = words.capitalise(part.subject)
        effects = {
            metric: found.get(words.name_path("slope", *part.place, metric) + ".quartile_effect")
            for metric in table.metrics
        }
        for metric, effect in effects.items():
            place = (*part.place, metric)
            if (claim := claims.get(place)) is None:
                continue
            r = found.get(words.name_path("association", *place, "within"))
            ceiling = found.get(words.name_path("association", *place, "within", "ceiling"))
            found_here = *_find_ends(effect), *_find_ends(r), _find_ends(ceiling)[0]
            said = claim.verdict, claim.direction, claim.higher, claim.hinge
            cards.append(
                MetricCard(
                    *part.place,
                    subject,
                    metric,
                    *said,
                    *found_here,
                    claim.better_than,
                    few=claim.few,
                    given=tuple(name for name, one in effects.items() if one and name != metric),
                    unflagged=unflagged.get(place, ""),
                    status=claim.status,
                    reason=claim.reason,
                )
            )
    return tuple(cards)


def _list_unflagged(sections: Iterable[Section]) -> Iterator[tuple[tuple[str, ...], str]]:
    """List the verdicts that are others without anyone flagged, by scale, level and metric."""
    name = "slopes_without_hits"
    for slopes in [section.tables[name] for section in sections if name in section.tables]:
        changes = list_changes(slopes.to_dict("records"))
        yield from (
            ((row["scale"], row["level"], row["metric"]), row["verdict"])
            for row in changes
            if row["panel"] == "any"
        )


def _find_ends(number: words.Number | None) -> tuple[float, float, float]:
    return (number.value, number.low, number.high) if number else (math.nan, math.nan, math.nan)


# The sentence.


def write_headline(
    cards: Sequence[MetricCard], sections: Iterable[Section], numbers: Iterable[words.Number]
) -> str:
    """State the findings in one sentence: of every metric and scale, and of every protocol that has no card."""
    sections = list(sections)
    alike: dict[tuple[object, ...], list[str]] = {}
    for metric in dict.fromkeys(card.metric for card in cards):
        own = tuple((card.outcome, card.is_turned) for card in cards if card.metric == metric)
        alike.setdefault(own, []).append(metric)
    clauses = [part for group in alike.values() for part in _describe_group(cards, group)]
    clauses += _describe_exceptions(cards, sections)
    clauses += _describe_level(cards, sections)
    clauses += _describe_unflagged(cards, numbers)
    lines = [line for section in sections for line in section.verdict]
    clauses += [line.clause for line in lines if line.clause]
    if not clauses:
        return (
            words.capitalise(lines[0].text)
            if lines
            else "These ratings do not answer the question."
        )
    return words.capitalise("; ".join(clauses)) + "."


def _describe_group(cards: Sequence[MetricCard], metrics: Sequence[str]) -> Iterator[str]:
    """Say what metrics have in common that have the same verdicts on all scales."""
    one = [card for card in cards if card.metric == metrics[0]]
    names = [words.format_name(name) for name in metrics]
    verb = "predict" if len(metrics) > 1 else "predicts"
    for status, turned in product((PREDICTS, OPPOSITE, OPEN, NOT_ESTIMABLE), (False, True)):
        own = [card for card in one if (card.outcome, card.is_turned) == (status, turned)]
        if not own:
            continue
        what, subjects = _name_ratings(own, one), {card.subject for card in own}
        same = [card for card in cards if card.metric in metrics and card.subject in subjects]
        few = list(dict.fromkeys(unit for card in same for unit in card.few))
        if status in {PREDICTS, OPPOSITE}:
            text = f"{words.join_words(names)} {verb} {what}{describe_hint(few)}"
            text += ", but in the direction opposite to the one declared" * (status == OPPOSITE)
            text += _describe_turns(same) + _describe_best(same, metrics)
        else:
            lack = "cannot be estimated" + (f" with {words.join_words(few)}" if few else "")
            is_open = "is open" if status == OPEN else lack
            text = f"whether {what} follow {words.join_words(names, 'or')} {is_open}"
        yield text + _describe_hinges(same)


def describe_turn(card: MetricCard) -> str:
    """Say how ratings go with a metric at equal values of the others and alone, where these ways differ."""
    if not card.is_turned:
        return ""
    known = card.correlation_low * card.correlation_high > 0
    alone = f"with {'higher' if card.correlation > 0 else 'lower'} ratings"
    return (
        f"{card.condition or 'in the model'}, higher {words.format_name(card.metric)} goes with "
        f"{card.direction} ratings; alone, {alone if known else 'its direction is open'}"
    )


def _describe_turns(same: Sequence[MetricCard]) -> str:
    """Say it in a bracket: once where all cards have it in common."""
    told = list(dict.fromkeys(filter(None, map(describe_turn, same))))
    if not told:
        return ""
    mixed = "which way differs between the metric alone and at equal values of the others"
    return f" ({told[0].replace('; alone,', ', but alone') if len(told) == 1 else mixed})"


def _name_ratings(own: Sequence[MetricCard], every: Sequence[MetricCard]) -> str:
    """Name the ratings of some scales and levels, or say that it is all of them."""
    if len(own) == len(every) > 1:
        scales, levels = ({getattr(card, name) for card in own} for name in ("scale", "level"))
        if len(scales) * len(levels) != len(own):
            return "all ratings"
        where = f" at {_count_all(len(levels))} levels" if len(levels) > 1 else ""
        if len(scales) > 1:
            return f"the ratings on {_count_all(len(scales))} rating scales{where}"
        return f"{words.format_name(own[0].scale)} ratings{where}"
    names = _list_subjects([card.subject for card in own])
    return f"ratings of {names}" if "(" in names else f"{names} ratings"


def _count_all(count: int) -> str:
    return {2: "both"}.get(count, f"all {count}")


def _list_subjects(subjects: Sequence[str]) -> str:
    """List scales within a sentence, in lower case but for abbreviations."""
    names = [name[:1].lower() + name[1:] if name[1:2].islower() else name for name in subjects]
    return words.join_words(names)


def _describe_best(same: Sequence[MetricCard], metrics: Sequence[str]) -> str:
    """Name the metric that predicts better than each other one of its group on all of these scales."""
    for metric in metrics if len(metrics) > 1 else ():
        others = set(metrics) - {metric}
        if all(others <= set(card.better_than) for card in same if card.metric == metric):
            return f", {words.format_name(metric)} more strongly"
    return ""


def _describe_hinges(same: Sequence[MetricCard]) -> str:
    """Say on what a finding hinges, or on how many cards it does."""
    hinges = dict.fromkeys(card.hinge for card in same if card.hinge)
    if not hinges:
        return ""
    some = "" if all(card.hinge for card in same) else "in part "
    which = next(iter(hinges)) if len(hinges) == 1 else "single stimuli, recordings or reducers"
    return f", which {some}hinges on {which}"


def _describe_level(cards: Sequence[MetricCard], sections: Iterable[Section]) -> Iterator[str]:
    """Say which metrics would predict ratings if level were not in the model."""
    lost = {
        (one.scale, one.level, one.metric)
        for section in sections
        for one in section.claims
        if one.beyond_level == LOST
    }
    for metric in dict.fromkeys(card.metric for card in cards):
        every = [card for card in cards if card.metric == metric]
        own = [card for card in every if (card.scale, card.level, metric) in lost]
        if own:
            what = _name_ratings(own, every)
            yield f"without level in the model {words.format_name(metric)} would predict {what}"


def _describe_exceptions(cards: Sequence[MetricCard], sections: Iterable[Section]) -> Iterator[str]:
    """Name the reducers, and on which scales, that were rated otherwise than metrics suggest that predict there."""
    subjects = {
        f"{card.scale}, {card.level}": card.subject for card in cards if card.verdict == PREDICTS
    }
    tables = [one.tables["exceptions"] for one in sections if "exceptions" in one.tables]
    rows = [row for table in tables for row in table.to_dict("records") if row["exceptional"]]
    rows = [row for row in rows if row["ratings"] in subjects]
    ways: dict[tuple[str, bool], dict[str, float]] = {}
    for row in rows:
        found = ways.setdefault((str(row["reducer"]), row["excess"] > 0), {})
        found[subjects[row["ratings"]]] = abs(row["excess"])
    if len(ways) > NAMED:
        reducers = words.join_words(list(dict.fromkeys(name for name, _ in ways)))
        where = _list_subjects(list(dict.fromkeys(subjects[row["ratings"]] for row in rows)))
        yield f"ratings of {reducers} depart on {where} from what their metrics would suggest"
        return
    for (name, above), points in ways.items():
        ends = [words.format_number(end(points.values()), kind="rating") for end in (min, max)]
        size = ends[0] if ends[0] == ends[1] else " to ".join(ends)
        way = f"{'higher' if above else 'lower'} on {_list_subjects(list(points))}"
        yield f"{name} was rated {size} points {way} than its metrics would suggest"


def _describe_unflagged(
    cards: Sequence[MetricCard], numbers: Iterable[words.Number]
) -> Iterator[str]:
    """Say which verdicts are others without the raters whom screening rules flag."""
    ways: dict[tuple[str, str], list[str]] = {}
    for metric in dict.fromkeys(card.metric for card in cards):
        every = [card for card in cards if card.metric == metric]
        for way in dict.fromkeys(card.unflagged for card in every if card.unflagged):
            own = [card for card in every if card.unflagged == way]
            turned = way == PREDICTS and own[0].verdict == PREDICTS
            key = OPPOSITE if turned else way, _name_ratings(own, every)
            ways.setdefault(key, []).append(words.format_name(metric))
    if not ways:
        return
    (flagged,) = [one for one in numbers if one.name == "screening_panel.any"]
    told = []
    for (way, what), names in ways.items():
        verb = "predict" if len(names) > 1 else "predicts"
        claim = f"{words.join_words(names)} {verb} {what}"
        whether = f"whether {what} follow {words.join_words(names, 'or')}"
        told.append({
            PREDICTS: claim, OPPOSITE: f"{claim} in the opposite direction", OPEN: f"{whether} is open",
            NOT_ESTIMABLE: f"{whether} cannot be estimated",
        }[way])  # fmt: skip
    who = f"the {flagged.value:.0f} of {words.format_count(flagged.n, 'rater')} whom screening rules flag"
    yield f"without {who}, {words.join_words(told)}"


def explain_blank(card: MetricCard) -> str:
    """Say in a few words why a slope cannot be estimated."""
    need = f"{words.join_words(card.few)}: at least {FEWEST} are needed" if card.few else ""
    return need or "too few degrees of freedom are left for a test"


# What stands where on the page.


def choose_picture(cards: Sequence[MetricCard], sections: Iterable[Section]) -> Picture | None:
    """Choose the figure beside the cards: the first scale's ratings over the metric that correlates most with them."""
    pictures = [one for section in sections for one in section.pictures if not one.detail]
    own = [card for card in cards if card.subject == cards[0].subject]
    known = [card for card in own if math.isfinite(card.correlation)] or own
    for card in sorted(known, key=lambda card: -abs(card.correlation)):
        slug = make_slug("scatter", card.scale, card.level, card.metric)
        if chosen := [one for one in pictures if one.name.startswith(slug)]:
            return chosen[0]
    return pictures[0] if pictures else None


@dataclass(frozen=True, slots=True, eq=False)
class PageBlock:
    """A question of the page and the sections that answer it."""

    key: str
    title: str
    sections: tuple[Section, ...]


def group_sections(sections: Iterable[Section]) -> tuple[PageBlock, ...]:
    """Put sections under the questions that they answer; one that no question names has a block of its own."""
    left = {section.key: section for section in sections if not section.is_empty or section.verdict}
    asked = {key for _, keys in QUESTIONS.values() for key in keys}
    own = [
        PageBlock(f"on-{key}", one.title, (one,)) for key, one in left.items() if key not in asked
    ]
    blocks = [
        PageBlock(anchor, title, tuple(left[key] for key in keys if key in left))
        for anchor, (title, keys) in QUESTIONS.items()
    ]
    return (*own, *blocks)


def list_others(sections: Iterable[Section]) -> list[str]:
    """List what choices and paired judgements show, which have no card."""
    return [str(line) for section in sections for line in section.verdict if line.clause]


def split_lines(section: Section, subjects: Iterable[str] = ()) -> tuple[list[str], list[str]]:
    """Split what a section says into what stands above its tables and what is folded.

    What several subjects have in common is said once. Where every scale has its own sentence, tables go first.
    """
    primary, merged = section.key == "primary", dict[tuple[str, str], list[words.Line]]()
    for line in dict.fromkeys(section.verdict or _read_answers(section, set(subjects))):
        merged.setdefault((line.lead, line.text), []).append(line)
    kinds = Counter(lead for lead, _ in merged)
    shown: list[str] = []
    told = set[str]()
    for (lead, text), lines in merged.items():
        whole = section.key == "paper" or (section.key == "raters" and len(shown) < SUMMED)
        if not whole and ((primary and lead in IN_TABLES) or kinds[lead] > COUNTED):
            continue
        own = [line.subject for line in lines if line.subject not in {"", section.title}]
        subject = words.capitalise(_list_subjects(own)) if own else ""
        shown.append(words.capitalise(str(words.Line(text, subject, lead))))
        told |= set(map(str, lines))
    every = dict.fromkeys([*map(str, section.verdict), *section.answers])
    return shown, [one for one in every if one not in told]


def _read_answers(section: Section, subjects: Collection[str]) -> Iterator[words.Line]:
    """Read the sentences of a section as lines, about the scale that leads each."""
    for answer in section.answers:
        subject, _, text = answer.partition(": ")
        yield words.Line(text, subject) if subject in subjects else words.Line(answer)


def name_fold(lines: Sequence[str], tables: Sequence[object], pictures: Sequence[Picture]) -> str:
    """Name a fold by what is in it."""
    sizes = {"sentence": len(lines), "table": len(tables), "figure": len(pictures)}
    held = [f"{size} {name}{'s' * (size > 1)}" for name, size in sizes.items() if size]
    return f"More: {words.join_words(held)}"
