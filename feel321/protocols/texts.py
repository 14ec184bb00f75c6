"""What participants read: texts, one TOML file per language in `catalog/` or a file of the lab's own; and questions.

Every language has the keys, lists and {placeholders} of the English one. A lab's own file may hold only the texts that
it changes; it is checked when it is read, so that no gap turns up in the middle of a session.

A question is a page of its own: a choice of one option, a number, a text, or a Likert item, whose ordered points have
words at the ends at least and whose answer is the number of the point, from 1. Its texts are stored in the plan as they
are shown, so that a journal can be read without the language's file.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.resources import files
from math import inf
from numbers import Real
from pathlib import Path
from string import Formatter
from typing import TYPE_CHECKING, Any, Literal, get_args

from feel321.arguments import check_name
from feel321.files import read_small
from feel321.protocols.trial import Page, Scale
from feel321.records import Number  # noqa: TC001 - pydantic reads it

if TYPE_CHECKING:
    from feel321.types import PathLike

CATALOG = files("feel321.protocols") / "catalog"
MODEL = "en"  # the language that every other one is compared with
MOST_GUESSES = 20  # unknown texts that are told what they may have meant, some milliseconds each


def list_languages() -> tuple[str, ...]:
    """List the language codes of the catalogue."""
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in CATALOG.iterdir()))


def read_scales(language: str | PathLike = MODEL) -> dict[str, Scale]:
    """Read the texts of all scales, by name."""
    return make_scales(read_texts(language))


def make_scales(texts: Mapping[str, Any]) -> dict[str, Scale]:
    """Make the scales of all texts of a language, by name."""
    scales = {}
    for name, own in texts["scales"].items():
        words: dict[str, Any] = {k: tuple(t) if isinstance(t, list) else t for k, t in own.items()}
        scales[name] = Scale(name, **words)
    return scales


def read_texts(language: str | PathLike = MODEL) -> dict[str, Any]:
    """Read all texts of a language, by kind: scales, pages, refusals, prompts, parts, keys."""
    if not (isinstance(language, os.PathLike) or str(language).endswith(".toml")):
        check_name(language, list_languages(), "language")
        return tomllib.loads((CATALOG / f"{language}.toml").read_text(encoding="utf-8"))
    path = Path(language)
    try:
        own = tomllib.loads(read_small(path))
        dict(_flatten(own))  # tables in tables without end exceed the recursion here
    except (ValueError, RecursionError) as error:  # TOML's own errors and those of the encoding
        raise ValueError(f"{path}: not valid TOML ({error}); fix it there") from None
    changed = own.pop("language", MODEL)
    if changed not in list_languages():
        must = f"{path}: language must be one of {', '.join(list_languages())}, got {changed!r}"
        raise ValueError(f"{must}; it gives the texts that the file leaves out")
    base = read_texts(changed)
    texts, known, lines = _merge(base, own), dict(_flatten(base)), list[str]()
    for place, fault in find_gaps(texts, read_texts()):
        guess = place not in known and len(lines) < MOST_GUESSES
        near = get_close_matches(place, known, n=1, cutoff=0.5) if guess else []
        hint = f", did you mean {near[0]}?" if near else ""
        lines.append(f"{path}: {place} {fault}{hint}; compare protocols/catalog/{MODEL}.toml")
    if lines:
        raise ValueError("\n".join(lines))
    return texts


def find_gaps(texts: dict[str, Any], model: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Compare the texts of a language with those of another: places, and what is wrong with them."""
    own, wanted = dict(_flatten(texts)), dict(_flatten(model))
    for place, words in wanted.items():
        if fault := _find_fault(place, own[place], words) if place in own else "is missing":
            yield place, fault
    yield from ((place, "is not a known text") for place in own if place not in wanted)


def _merge(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Put texts into tables in place of those of the same name; lists are replaced as a whole."""
    merged = base | own
    for key in base.keys() & own.keys():
        if isinstance(base[key], dict) and isinstance(own[key], dict):
            merged[key] = _merge(base[key], own[key])
    return merged


def _flatten(texts: object, place: str = "") -> Iterator[tuple[str, object]]:
    """Name every text by its keys as TOML does, and lists and tables that are empty; lists are counted from 1."""
    if isinstance(texts, dict) and texts:
        for key, entry in texts.items():
            name = f'"{key}"' if "." in key else key
            yield from _flatten(entry, f"{place}.{name}".removeprefix("."))
    elif isinstance(texts, list) and texts:
        for number, entry in enumerate(texts, start=1):
            yield from _flatten(entry, f"{place}[{number}]")
    else:
        yield place, texts


def _find_fault(place: str, text: object, model: object) -> str:
    if not isinstance(text, str) or not text.strip():
        return f"must be a text, got {text!r}"
    if ".choices[" in place and text != model:
        return f"must be {model!r}, got {text!r}: choices are names of parts, the same in every language"
    got, wanted = _list_placeholders(text), _list_placeholders(str(model))
    if got == wanted:
        return ""
    return f"must have {f'the placeholders {wanted}' if wanted else 'no placeholders'}, got {got or 'none'}"


def _list_placeholders(text: str) -> str:
    try:
        names = {name for _, name, _, _ in Formatter().parse(text) if name is not None}
    except ValueError as error:
        return str(error)
    return ", ".join(sorted(f"{{{name}}}" for name in names))


Kind = Literal["choice", "number", "text", "likert"]
When = Literal["before", "between", "after"]
"""When a question is asked: after the consent, before each rest between trials, at the end."""

KINDS: tuple[Kind, ...] = get_args(Kind)
TIMES: tuple[When, ...] = get_args(When)

PREFIX = "question."  # what the key of a question's page begins with; its name follows
LABEL = re.compile(r"[a-z][a-z0-9_]{0,39}")
LABEL_RULE = "must be up to 40 lower-case letters (a-z), digits and _, beginning with a letter"
"""Names of questions and own scales: they stand in tables."""

LEAST_OPTIONS, MOST_OPTIONS = 2, 9  # each has a digit
MOST_QUESTIONS = 60
MOST_LETTERS = 500  # of a text, which is shown on one screen

Answer = float | str | None  # an option, a text, a number, that of a point; None where left open


@dataclass(frozen=True, slots=True)
class Question:
    """A question page, `[[session.questions]]`; options: of a choice, or the words of a Likert item's points."""

    name: str
    kind: Kind
    question: str
    options: tuple[str, ...] = ()
    low: Number | None = None
    high: Number | None = None
    when: When = "before"
    personal: bool = False
    required: bool = True

    def __post_init__(self) -> None:
        """Refuse a question that nobody could answer."""
        if fault := next(_find_question_faults(self), ""):
            raise ValueError(fault)

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
        raise ValueError(LABEL_RULE)
    return name


def _find_question_faults(question: Question) -> Iterator[str]:
    kind, options, low, high = question.kind, question.options, question.low, question.high
    has_options, n_options = kind in {"choice", "likert"}, len(options)
    if not (LABEL.fullmatch(question.name) and question.question.strip()):
        yield f"name {LABEL_RULE}, and question not be empty; got {question.name!r} and {question.question!r}"
    if options and not has_options:
        yield f"options must be left out for kind {kind!r}, got {n_options}; remove them"
    if has_options and not LEAST_OPTIONS <= n_options <= MOST_OPTIONS:
        yield f"options must be {LEAST_OPTIONS} to {MOST_OPTIONS} texts for kind {kind!r}, got {n_options}"
    if kind == "choice" and len({text for text in options if text.strip()}) < n_options:
        yield "options must be different texts, none of them empty"
    if kind == "likert" and not all(text.strip() for text in (options[0], options[-1])):
        yield "options must name both ends; set low and high, or every option"
    if kind != "number" and (low is not None or high is not None):
        yield f"low and high must not be numbers for kind {kind!r}; use kind 'number', or remove them"
    if low is not None and high is not None and low >= high:
        yield f"low must be below high, got {low:g} and {high:g}"


def list_pages(questions: Iterable[Question], when: str) -> list[Page]:
    """List the pages of the questions that are asked at a time."""
    return [Page(question.key) for question in questions if question.when == when]


def find_question(questions: Iterable[Question], page: Page | str) -> Question | None:
    """Find the question of a page; None where it asks nothing."""
    key = page if isinstance(page, str) else page.key
    return next((question for question in questions if question.key == key), None)
