"""Tables of `study.toml` about what participants are asked: `[scales.NAME]` and `[[session.questions]]`."""

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from feel321.protocols.texts import (
    KINDS,
    LEAST_OPTIONS,
    MOST_OPTIONS,
    MOST_QUESTIONS,
    READY,
    TIMES,
    Question,
    check_label,
    check_question,
    label_points,
)
from feel321.study.settings import fields as kinds

Label = Annotated[str, AfterValidator(check_label)]


class ScaleTable(kinds.TomlTable):
    """`[scales.NAME]`: a scale of the lab's own, or other words for one of feel321's."""

    question: kinds.Words
    low: kinds.Words
    high: kinds.Words
    anchors: tuple[kinds.Words, ...] = ()

    @model_validator(mode="after")
    def _check_ends(self) -> Self:
        if self.low == self.high:
            raise ValueError(f"low and high must differ, got {self.low!r} for both")
        return self

    def to_texts(self) -> dict[str, str | list[str]]:
        """Return its texts as a language holds them."""
        texts: dict[str, str | list[str]] = {
            "question": self.question,
            "low_label": self.low,
            "high_label": self.high,
        }
        return texts | ({"anchors": list(self.anchors)} if self.anchors else {})


Scales = dict[Label, ScaleTable]


class QuestionTable(kinds.TomlTable):
    """`[[session.questions]]`: a question page, or a ready one by its name."""

    use: Annotated[str, kinds.one_of(READY)] | None = None
    name: Label | None = None
    kind: Annotated[str, kinds.one_of(KINDS)] | None = None
    question: kinds.Words | None = None
    options: tuple[str, ...] = ()
    points: Annotated[int, Field(ge=LEAST_OPTIONS, le=MOST_OPTIONS)] | None = None
    low: kinds.Finite | str | None = None
    high: kinds.Finite | str | None = None
    when: Annotated[str, kinds.one_of(TIMES)] = TIMES[0]
    personal: bool = False
    required: bool = True

    @model_validator(mode="after")
    def _check_whole(self) -> Self:
        if self.use:
            if others := sorted(self.model_fields_set - {"use", "when"}):
                raise ValueError(
                    f"use = {self.use!r} brings its own questions; remove {', '.join(others)}, or use"
                )
            return self
        for key in ("name", "kind", "question"):
            if getattr(self, key) is None:
                raise ValueError(f"{key} is missing; add it, or use = {next(iter(READY))!r}")
        check_question(self.make_question())
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its questions."""
        return tuple(READY[self.use]) if self.use else (self.name or "",)

    def make_question(self) -> Question:
        """Make the question of a plan."""
        ends = (self.low, self.high)
        options = self.options
        if self.kind == "likert" and not options:
            if self.points is None or not all(isinstance(end, str) for end in ends):
                raise ValueError(
                    "a likert question must have options = [...], or points = 7 with low = '...' and high = '...'"
                )
            options, ends = label_points(self.points, *map(str, ends)), (None, None)
        elif self.points is not None:
            raise ValueError("points is for likert questions without options; remove it")
        if any(isinstance(end, str) for end in ends):
            raise ValueError(
                "low and high must be numbers for kind 'number', or the words at the ends of a likert question "
                "with points"
            )
        low, high = (None if end is None else float(end) for end in ends)
        return Question(
            self.name or "",
            self.kind or "",
            self.question or "",
            options,
            low,
            high,
            when=self.when,
            personal=self.personal,
            required=self.required,
        )


def _check_questions(tables: tuple[QuestionTable, ...]) -> tuple[QuestionTable, ...]:
    names = kinds.check_distinct(tuple(name for table in tables for name in table.names))
    if len(names) > MOST_QUESTIONS:
        raise ValueError(f"must be at most {MOST_QUESTIONS} questions, got {len(names)}")
    return tables


Questions = Annotated[tuple[QuestionTable, ...], AfterValidator(_check_questions)]
