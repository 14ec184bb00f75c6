"""Question pages: what a lab asks besides the trials, what counts as an answer, and where each page comes.

A question is a page of its own: a choice of one option, a number, a text, or a Likert item. Its texts are stored in the
plan as they are shown, so that a journal can be read without the language's file.

Likert items have ordered points of which at least the ends are named [1]_; the answer is the number of the point,
from 1.

References
----------
.. [1] Likert, R. (1932). A technique for the measurement of attitudes. Archives of Psychology, 140, 1-55.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import inf
from numbers import Real
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from feel321.doors import check_name
from feel321.protocols.trial import Page

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

KINDS = ("choice", "number", "text", "likert")
"""Kinds of questions."""

TIMES = ("before", "between", "after")
"""When a question is asked: after the consent, before each rest between trials, or at the end."""

READY: Mapping[str, Mapping[str, Mapping[str, Any]]] = MappingProxyType({
    "demographics": {
        "age": {"kind": "number", "low": 5.0, "high": 120.0},
        "gender": {"kind": "choice"},
        "handedness": {"kind": "choice"},
        "touch": {"kind": "choice"},
        "experience": {"kind": "choice"},
    }
})
"""Ready question pages, by name: their questions, without the texts, which every language of the catalogue holds."""

PREFIX = "question."
"""What the key of a question's page begins with; its name follows."""

LABEL = re.compile(r"[a-z][a-z0-9_]{0,39}")
"""Names of questions and of a lab's own scales: they stand in tables."""

LEAST_OPTIONS, MOST_OPTIONS = 2, 9  # each has a digit
MOST_QUESTIONS = 60
MOST_LETTERS = 500  # of a text, which is shown on one screen

Answer = float | str | None
"""An option, a number, a text, the number of a point; None where the question was left open."""


@dataclass(frozen=True, slots=True)
class Question:
    """A question page.

    name: as in `answers.csv`. kind: `choice`, `number`, `text` or `likert`. options: what can be chosen; the words of a
    Likert item's points, empty where a point has none. low, high: least and largest number, None for any. personal:
    whether the answer is personal data, which journal and table then mark so. required: whether it must be answered.

    Examples
    --------
    >>> Question("age", "number", "How old are you?", low=18, high=99).key
    'question.age'
    """

    name: str
    kind: str
    question: str
    options: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None
    when: str = TIMES[0]
    personal: bool = False
    required: bool = True

    @property
    def key(self) -> str:
        """The key of its page."""
        return f"{PREFIX}{self.name}"

    @property
    def choices(self) -> tuple[float | str | None, ...]:
        """The answers to choose from: options, or numbers of points from 1; empty where an answer is typed."""
        if self.kind == "likert":
            return tuple(float(point) for point in range(1, len(self.options) + 1))
        return self.options

    def find_fault(self, answer: float | str | None) -> str:
        """Check an answer: `unanswered`, `out_of_range`, `too_long` or `not_offered`; empty if it is one."""
        if answer is None or answer == "":
            return "unanswered" if self.required else ""
        if self.choices:
            return "" if answer in self.choices else "not_offered"
        if self.kind == "text":
            is_text = isinstance(answer, str) and answer.isprintable() and bool(answer.strip())
            return "" if is_text and len(str(answer)) <= MOST_LETTERS else "too_long"
        is_number = isinstance(answer, Real) and not isinstance(answer, bool)
        low, high = -inf if self.low is None else self.low, inf if self.high is None else self.high
        return "" if is_number and low <= float(answer) <= high else "out_of_range"

    def describe_range(self) -> str:
        """Describe the numbers that are answers, such as `18 – 99`, or `≥ 18` where there is no largest."""
        ends = ["" if end is None else f"{end:g}" for end in (self.low, self.high)]
        if all(ends):
            return " – ".join(ends)
        return f"≥ {ends[0]}" if ends[0] else f"≤ {ends[1]}" if ends[1] else "0–9 . -"


def check_label(name: str) -> str:
    """Demand a name that can stand in a table."""
    if not LABEL.fullmatch(name):
        raise ValueError(
            "must be up to 40 lower-case letters (a-z), digits and _, beginning with a letter"
        )
    return name


def check_question(question: Question) -> None:
    """Refuse a question that nobody could answer."""
    kind, low, high = question.kind, question.low, question.high
    options, named = question.options, [text for text in question.options if text.strip()]
    has_options, is_number = kind in {"choice", "likert"}, kind == "number"
    check_name(kind, KINDS, "kind")
    check_name(question.when, TIMES, "when")
    faults = {
        "question must be what the participant reads, got nothing; write question = '...'": (
            not question.question.strip()
        ),
        f"options must be {LEAST_OPTIONS} to {MOST_OPTIONS} texts for kind {kind!r}, got {len(options)}": (
            has_options and not LEAST_OPTIONS <= len(options) <= MOST_OPTIONS
        ),
        "options must be different texts, none of them empty": (
            kind == "choice" and len(set(named)) < len(options)
        ),
        "options must name both ends; set low and high, or every option": (
            kind == "likert" and not all(text.strip() for text in (*options[:1], *options[-1:]))
        ),
        f"options must be left out for kind {kind!r}, got {len(options)}; remove them": (
            not has_options and bool(options)
        ),
        f"low and high must not be numbers for kind {kind!r}; use kind 'number', or remove them": (
            not is_number and (low is not None or high is not None)
        ),
    }
    if fault := next((words for words, holds in faults.items() if holds), ""):
        raise ValueError(fault)
    if low is not None and high is not None and low >= high:
        raise ValueError(f"low must be below high, got {low:g} and {high:g}")


def read_ready(name: str, texts: Mapping[str, Any], *, when: str = TIMES[0]) -> list[Question]:
    """Read the questions of a ready page, which are personal and may be left open; texts: all of a language."""
    own = texts["questions"][check_name(name, READY, "use")]
    return [
        Question(
            key,
            question=own[key]["question"],
            options=tuple(own[key].get("options", ())),
            when=when,
            personal=True,
            required=False,
            **facts,
        )
        for key, facts in READY[name].items()
    ]


def list_pages(questions: Iterable[Question], when: str) -> list[Page]:
    """List the pages of the questions that are asked at a time."""
    return [Page(question.key) for question in questions if question.when == when]


def find_question(questions: Sequence[Question], page: Page | str) -> Question | None:
    """Find the question of a page; None where it asks nothing."""
    key = page if isinstance(page, str) else page.key
    return next((question for question in questions if question.key == key), None)
