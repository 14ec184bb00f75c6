"""The base of every result: data frame, dictionary, summary and a one-line repr; and the claim of a paper.

A result that other code builds on is a frozen dataclass: `@dataclass(frozen=True, slots=True, repr=False, eq=False)`
above `class Name(Result)`. What a statistic finds is a `Statistic`, whose values need no class of their own.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, NoReturn, Self, get_args

from annotated_types import Interval

if TYPE_CHECKING:
    from pandas import DataFrame

REPR_WIDTH = 200  # characters of a result's repr, at most
MOST_ROWS = 60  # rows of a table that a summary shows, at most; half of them from its end


class Result:
    """A result: its fields as a data frame, a dictionary, text and HTML."""

    __slots__ = ()

    @property
    def _kind(self) -> str:
        return type(self).__name__

    def _list_fields(self) -> list[tuple[str, Any]]:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]  # every result but a statistic is a dataclass
        return [(field.name, getattr(self, field.name)) for field in fields]

    def _list_scalars(self) -> list[tuple[str, Any]]:
        import numpy as np

        kinds = bool | int | float | str | np.generic
        return [(name, entry) for name, entry in self._list_fields() if isinstance(entry, kinds)]

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as what JSON can hold."""
        return dict(to_json_value(self))

    def to_frame(self) -> DataFrame:
        """Return the numbers and names as a table."""
        import pandas as pd

        return pd.DataFrame([dict(self._list_scalars())])

    def summary(self) -> str:
        """Write the result for reading."""
        frame, notes, digits = self.to_frame(), getattr(self, "notes", ()), "{:.4g}".format
        if len(frame) == 1:
            table = frame.T.to_string(header=False, float_format=digits)
        else:
            table = frame.to_string(index=False, float_format=digits, max_rows=MOST_ROWS)
        return "\n".join((self._kind, table, *notes))

    def __repr__(self) -> str:
        """Write numbers, names and flags in one line of at most 200 characters."""
        import numpy as np

        known = [
            (name, f"{value:.4g}" if isinstance(value, float | np.floating) else repr(value))
            for name, value in self._list_scalars()
        ]
        sized = [(name, one) for name, one in self._list_fields() if hasattr(one, "__len__")]
        known = known or [(name, f"<{len(one)}>") for name, one in sized if len(one)]
        told = ", ".join(f"{name}={value}" for name, value in known)
        text = f"{self._kind}({told})"
        return text if len(text) <= REPR_WIDTH else f"{text[: REPR_WIDTH - 4]}...)"

    def _repr_html_(self) -> str:
        from html import escape

        frame = self.to_frame()
        if len(frame) == 1:
            frame = frame.T.set_axis([""], axis=1)
        shown = frame.to_html(
            max_rows=20, float_format="{:.4g}".format, border=0, header=len(frame.columns) > 1
        )
        name = f"<caption>{escape(self._kind)}</caption>"
        notes = "".join(f"<p>{escape(str(note))}</p>" for note in getattr(self, "notes", ()))
        table, rest = shown.replace("<th>", '<th scope="row">').split(">", 1)
        return f"{table}>{name}{rest}{notes}"

    def __eq__(self, other: object) -> bool:
        """Compare as JSON holds them; numbers that are not defined are equal."""
        if type(self) is not type(other):
            return NotImplemented
        return bool(to_json_value(self) == to_json_value(other))

    def __hash__(self) -> int:
        """Hash by what the repr shows."""
        return hash((type(self), repr(self)))


class Statistic(Result, Mapping[str, Any]):
    """What a statistic found: its values by name, as attributes and as a mapping."""

    __slots__ = ("_kind", "_values")
    _kind: str
    _values: dict[str, Any]

    def __init__(self, kind: str, /, **values: Any) -> None:  # noqa: ANN401 - values of any kind
        object.__setattr__(self, "_kind", kind)
        object.__setattr__(self, "_values", values)

    def _list_fields(self) -> list[tuple[str, Any]]:
        return list(self._values.items())

    def to_frame(self) -> DataFrame:
        """Return the first table, or the numbers and names in one row."""
        from pandas import DataFrame

        tables = (value for value in self._values.values() if isinstance(value, DataFrame))
        table = next(tables, None)
        if table is None:
            return super().to_frame()
        return table.reset_index() if table.index.name else table

    def replace(self, **values: Any) -> Self:  # noqa: ANN401 - values of any kind
        """Return the same statistic with other values."""
        return type(self)(self._kind, **{**self._values, **values})

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - values of any kind
        """Look up a value."""
        if name.startswith("_") or name not in self._values:
            raise AttributeError(f"{self._kind} has no value {name!r}; it has {', '.join(self)}")
        return self._values[name]

    def __setattr__(self, name: str, value: object) -> NoReturn:
        """Refuse every change."""
        raise AttributeError(f"{self._kind} is frozen: {name} cannot be set")

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401 - values of any kind
        """Look up a value."""
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        """List the names of the values."""
        return iter(self._values)

    def __len__(self) -> int:
        """Count the values."""
        return len(self._values)

    def __dir__(self) -> list[str]:
        """List values and methods."""
        return [*self._values, *(name for name in super().__dir__() if name not in self._values)]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a kind and its values."""
        return partial(type(self), self._kind, **self._values), ()


def to_json_value(value: object) -> Any:  # noqa: ANN401 - whatever JSON holds
    """Turn a value into what JSON can hold; numbers that are not finite become None."""
    from pydantic_core import to_jsonable_python

    return to_jsonable_python(value, inf_nan_mode="null", fallback=_unpack)


def _unpack(value: Any) -> object:  # noqa: ANN401 - what pydantic does not know
    import numpy as np

    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "to_frame"):  # a column of pandas, which is not imported for this
        value = value.to_frame()
    return value.reset_index().to_dict("records") if hasattr(value, "reset_index") else str(value)


Number = Annotated[float, Interval(ge=-1e9, le=1e9)]


# The claims of a paper.

Measure = Literal[
    "metric_of_reducer", "rating_of_reducer", "slope", "one_axis_against_three", "map_attribute", "correlation",
    "rating_excess",
]  # fmt: skip
"""What a paper's claim can be examined with."""

MEASURES: Mapping[str, str] = dict(zip(get_args(Measure), (
    "measure_metric", "measure_rating", "measure_slope", "measure_told_apart", "measure_attribute",
    "measure_correlation", "measure_rating_excess",
), strict=True))  # fmt: skip
"""The function of `feel321.analysis.replication` for each."""

Expectation = Literal["positive", "negative", "near", "highest", "lowest"]
"""What a paper's claim says of its number: on which side of zero, near the paper's, or above or below all others."""

Provenance = Literal["full text", "abstract", "ours", "unknown"]
"""Where a statement about a paper was seen."""

Option = Literal[
    "scale", "level", "metric", "metrics", "reducer", "among", "recording", "method", "attribute"
]
"""What a measure may need to know; `scale` and `level` choose the ratings."""


class PaperNumber(NamedTuple):
    """A paper's number and its range; NaN where it is not known."""

    value: Number = math.nan
    low: Number = math.nan
    high: Number = math.nan


NO_NUMBER = PaperNumber()


@dataclasses.dataclass(frozen=True, slots=True)
class PaperClaim:
    """A claim of a paper, `[[paper.claims]]` of study.toml.

    exceptions: reducers that the paper names as exceptions.
    """

    name: str
    claim: str
    source: Provenance
    measure: Measure
    expect: Expectation = "positive"
    paper: PaperNumber = NO_NUMBER
    exceptions: tuple[str, ...] = ()
    options: Mapping[Option, str | tuple[str, ...]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse names that are none, and numbers out of order."""
        if empty := [what for what in ("name", "claim") if not getattr(self, what).strip()]:
            raise ValueError(f"{empty[0]} must not be empty; fill it in")
        value, low, high = self.paper
        if self.expect == "near" and not math.isfinite(low + high):
            must = "must give the paper's low and high where it expects near"
            raise ValueError(f"{must}; add paper = {{ low = ..., high = ... }}")
        known = [one for one in (low, value, high) if not math.isnan(one)]
        if math.isnan(low) != math.isnan(high) or known != sorted(known):
            rule = "must have a value, or low and high, or all three in that order"
            raise ValueError(f"paper {rule}, got {known}")
        for name, own in self.options.items():
            if name != "metrics" and isinstance(own, str) == (name == "among"):
                what = "a list of names" if name == "among" else "a text"
                raise ValueError(f"options.{name} must be {what}, got {own!r}")
            if not all(text.strip() for text in ((own,) if isinstance(own, str) else own)):
                raise ValueError(f"options.{name} must not be empty; fill it in")
        told = {text for text in self.exceptions if text.strip()}
        if len(told) < len(self.exceptions):
            rule = "must be different names, none of them empty"
            raise ValueError(f"exceptions {rule}, got {[*self.exceptions]}")
