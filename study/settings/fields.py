"""What the tables of `study.toml` are made of: the closed table, and kinds of values.

Each kind refuses by saying what is allowed; `settings` adds the place and what was got.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, WrapValidator
from pydantic_core import PydanticCustomError

if TYPE_CHECKING:
    from collections.abc import Collection

    from pydantic import ValidatorFunctionWrapHandler

OFF = "off"
"""What switches something off: TOML has no null."""


class Table(BaseModel):
    """A table of `study.toml`: no unknown keys, no guessing of types, no changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def one_of(names: Collection[str]) -> AfterValidator:
    """Make the rule that a name is one of a registry's.

    Parameters
    ----------
    names : collection of str
        The registry, or its names.

    Returns
    -------
    AfterValidator
        The rule, for an annotation.
    """

    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"allowed: {', '.join(names)}")
        return name

    return AfterValidator(check)


def check_distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    """Demand each name once.

    Parameters
    ----------
    names : tuple of str
        The names.

    Returns
    -------
    tuple of str
        The same.

    Raises
    ------
    ValueError
        If one stands there more than once.
    """
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"allowed is each name once; more than once: {', '.join(doubled)}")
    return names


def check_some(names: tuple[str, ...]) -> tuple[str, ...]:
    """Demand one name or more, each once.

    Parameters
    ----------
    names : tuple of str
        The names.

    Returns
    -------
    tuple of str
        The same.

    Raises
    ------
    ValueError
        If there is none, or one stands there more than once.
    """
    if not names:
        raise ValueError("allowed is one name or more")
    return check_distinct(names)


def check_words(text: str) -> str:
    """Demand a text that says something.

    Parameters
    ----------
    text : str
        The text.

    Returns
    -------
    str
        The same.

    Raises
    ------
    ValueError
        If it is empty.
    """
    if not text.strip():
        raise ValueError("allowed is a text that is not empty")
    return text


def number_or(names: Collection[str], *, least: float, most: float) -> WrapValidator:
    """Make the rule that a value is a number in a range, or one of some words.

    Parameters
    ----------
    names : collection of str
        The words.
    least, most : float
        The range.

    Returns
    -------
    WrapValidator
        The rule, for an annotation.
    """
    number = TypeAdapter(Annotated[float, Field(ge=least, le=most)])

    def check(value: object, _read: ValidatorFunctionWrapHandler) -> object:
        if isinstance(value, str) and value in names:
            return value
        try:
            return number.validate_python(value, strict=True)
        except ValidationError as error:
            raise _refuse(error, names) from None

    return WrapValidator(check)


def _take_off(value: object, read: ValidatorFunctionWrapHandler) -> object:
    if value == OFF:
        return None
    try:
        return read(value)
    except ValidationError as error:
        raise _refuse(error, [OFF]) from None


def _refuse(error: ValidationError, words: Collection[str]) -> PydanticCustomError:
    allowed = {"reason": error.errors()[0]["msg"], "words": " or ".join(f'"{word}"' for word in words)}
    return PydanticCustomError("word_or", "{reason}, or {words}", allowed)


Distinct = AfterValidator(check_distinct)
Some = AfterValidator(check_some)
OrOff = WrapValidator(_take_off)
Words = Annotated[str, AfterValidator(check_words)]
Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
PositiveOrOff = Annotated[Positive | None, OrOff]
