"""Tables of `study.toml` about a paper that is replicated: `[paper]`, its conditions, claims and published numbers.

Every statement says where it was seen. Settings never follow from these tables: `check` compares the study with the
conditions, and the report answers the claims.
"""

from typing import Annotated, Generic, Self, TypeVar

from pydantic import Field, model_validator

from feel321.doors import check_name
from feel321.names import EXPECTATIONS, MEASURES, PROVENANCE
from feel321.study.settings import fields as kinds

Value = TypeVar("Value")
Provenance = Annotated[str, kinds.one_of(PROVENANCE)]


class Condition(kinds.TomlTable, Generic[Value]):
    """`[paper.conditions]`: a condition of the paper's study, with where it was seen; no value where it is unknown."""

    value: Value | None = None
    source: Provenance

    @model_validator(mode="after")
    def _check_known(self) -> Self:
        if (self.value is None) != (self.source == "unknown"):
            raise ValueError(
                'must have a value, or source = "unknown" and none; add the value, or say that it is unknown'
            )
        return self


Names = Condition[tuple[kinds.Words, ...]]


class ConditionsTable(kinds.TomlTable):
    """`[paper.conditions]`: what the paper's study was; what is left out is not compared."""

    participants: Condition[kinds.AtLeastOne] | None = None
    reducers: Names | None = None
    protocols: Names | None = None
    levels: Names | None = None
    recordings: Condition[kinds.AtLeastOne] | None = None
    rate_hz: Condition[kinds.Positive] | None = None
    band_hz: Condition[tuple[kinds.Positive, kinds.Positive]] | None = None
    window_ms: Condition[kinds.Positive] | None = None
    channels: Condition[kinds.AtLeastOne] | None = None
    order: Condition[kinds.Words] | None = None
    gain: Condition[kinds.Positive] | None = None
    surface: Condition[bool] | None = None
    repeats: Condition[kinds.AtLeastOne] | None = None
    anchors: Condition[bool] | None = None


class NumberTable(kinds.TomlTable):
    """A paper's number: a value, a range, or both."""

    value: kinds.Finite | None = None
    low: kinds.Finite | None = None
    high: kinds.Finite | None = None

    @model_validator(mode="after")
    def _check_ends(self) -> Self:
        if (self.low is None) != (self.high is None):
            raise ValueError("must have low and high, or neither; add the other one")
        if self.value is None and self.low is None:
            raise ValueError("must have a value, or low and high; add one of them")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"must have low at most high, got {self.low:g} and {self.high:g}")
        if None not in {self.value, self.low} and not self.low <= self.value <= self.high:  # type: ignore[operator]  # three numbers
            raise ValueError(f"must have the value within low and high, got {self.value:g}")
        return self


OPTIONS = {
    **dict.fromkeys(("scale", "level", "metric", "reducer", "recording", "method", "attribute"), "words"),
    "metrics": "words or a list of names", "among": "a list of names",
}  # fmt: skip
"""Option of a measure -> what it is."""


def _check_option(name: str, value: object) -> None:
    check_name(name, OPTIONS, "options")
    is_list = isinstance(value, tuple | list)
    if (isinstance(value, str) and name == "among") or (not is_list and not isinstance(value, str)):
        raise ValueError(f"options.{name} must be {OPTIONS[name]}, got {value!r}")
    if is_list and name not in {"metrics", "among"}:
        raise ValueError(f"options.{name} must be {OPTIONS[name]}, got {value!r}")


Option = str | float | bool | tuple[str, ...]


class ClaimTable(kinds.TomlTable):
    """`[[paper.claims]]`: what the paper says, and what it is examined with here."""

    name: kinds.Words
    claim: kinds.Words
    source: Provenance
    measure: Annotated[str, kinds.one_of(MEASURES)]
    expect: Annotated[str, kinds.one_of(EXPECTATIONS)] = EXPECTATIONS[0]
    paper: NumberTable | None = None
    exceptions: Annotated[tuple[kinds.Words, ...], kinds.Distinct] = ()
    options: dict[str, Option] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_options(self) -> Self:
        for name, value in self.options.items():
            _check_option(name, value)
        if self.source == "unknown" and self.paper is not None:
            raise ValueError(
                'must not give the paper\'s number where source = "unknown"; remove one'
            )
        return self

    @model_validator(mode="after")
    def _check_near(self) -> Self:
        if self.expect == "near" and (self.paper is None or self.paper.low is None):
            raise ValueError(
                "must give the paper's low and high where it expects near; add paper = { low = ..., high = ... }"
            )
        return self


class PublishedTable(kinds.TomlTable):
    """`[[paper.published]]`: numbers of a metric that the paper gives for one of its recordings."""

    table: kinds.Words
    source: Provenance
    recording: kinds.Words
    shown: kinds.Words = "a recording of the paper"
    metric: kinds.Words
    numbers: Annotated[dict[str, kinds.Finite], Field(min_length=1)]


class PaperTable(kinds.TomlTable):
    """`[paper]`: the paper that is replicated."""

    citation: kinds.Words
    doi: kinds.Words
    seen: Annotated[str, kinds.one_of(PROVENANCE[:2])]
    conditions: ConditionsTable = ConditionsTable()
    claims: tuple[ClaimTable, ...] = ()
    published: tuple[PublishedTable, ...] = ()

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        kinds.check_distinct(tuple(claim.name for claim in self.claims))
        told = [(one, reducer) for one in self.published for reducer in one.numbers]
        kinds.check_distinct(
            tuple(f"{one.recording}, {one.metric}, {reducer}" for one, reducer in told)
        )
        return self
