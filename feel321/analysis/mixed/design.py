"""From a formula and a table to matrices; everything that cannot be fitted is refused here.

``(1 | g)`` an intercept per level of g; ``(x | g)`` intercept and slope, correlated; ``(x || g)`` the same,
uncorrelated; ``(0 + x | g)`` a slope alone; ``(1 | a:b)`` one per combination; ``(1 | a/b)`` is ``(1 | a) +
(1 | b:a)``. The fixed part is left to formulaic, which knows ``+ - : * / ^ I()`` and functions of columns.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

    Matrix = NDArray[np.float64]

NAME = r"(?:`[^`]+`|[^\W\d][\w.]*)"
GROUP = re.compile(rf"\s*{NAME}\s*(?:[:/]\s*{NAME}\s*)*")
WRITE_SO = "write 'response ~ fixed + (effects | group)', groups such as a, a:b or a/b"

DEPENDENT = 1e-9
"""Share of a column's length left over beside the others, below which it is their sum but for rounding."""

FLAT = 1e-12
"""Share of a response's size below which what the fixed effects leave over is rounding."""


class RandomTerm(NamedTuple):
    """One bracket of a formula: what varies, over which groups, and whether independently."""

    effects: str
    group: tuple[str, ...]
    independent: bool = False

    @property
    def name(self) -> str:
        """Name of the grouping factor, such as ``participant:item``."""
        return ":".join(self.group)


class Formula(NamedTuple):
    """A formula taken apart."""

    response: str
    fixed: str
    random: tuple[RandomTerm, ...]


def parse_formula(text: str) -> Formula:
    """Take a formula apart."""
    sides = [side.strip() for side in text.split("~")] if isinstance(text, str) else []
    if len(sides) != 2 or not all(sides):  # noqa: PLR2004 - left and right
        raise ValueError(f"formula must have one ~ between two sides, got {text!r}; {WRITE_SO}")
    if found := re.search(r"\b(offset|weights)\s*\(", text):
        raise ValueError(
            f"formula must be without {found[1]}(...), every row counts the same; leave it out"
        )
    fixed, random = "", list[RandomTerm]()
    for sign, piece in _split_sum(sides[1]):
        depths = np.cumsum([(letter == "(") - (letter == ")") for letter in piece])
        # One pair of brackets around a bar, as in (1 | a), not (1 | a):(1 | b).
        if piece.startswith("(") and "|" in piece and int(depths.argmin()) == len(piece) - 1:
            random += _read_bar(sign, piece)
        elif "|" in piece or piece == ".":
            why = "each bar in brackets of its own" if "|" in piece else "its terms by name"
            raise ValueError(f"formula must have {why}, got {piece!r}; {WRITE_SO}")
        else:
            fixed += f"{sign} {piece} "
    if not random:
        raise ValueError(
            f"formula must have a random term such as (1 | group), got {text!r} without; "
            "for none, use ordinary regression"
        )
    return Formula(sides[0], fixed.strip().removeprefix("+ ") or "1", tuple(random))


def _split_sum(text: str) -> Iterator[tuple[str, str]]:
    """Cut at plus and minus signs outside of brackets and quotes."""
    depth, sign, piece, quoted = 0, "+", "", False
    for letter in text:
        quoted ^= letter == "`"
        depth += (letter == "(") - (letter == ")")
        if depth < 0:
            break
        if letter in "+-" and depth == 0 and not quoted:
            yield from [(sign, piece.strip())] if piece.strip() else []
            sign, piece = letter, ""
        else:
            piece += letter
    if depth or not piece.strip():
        what = "brackets that do not match" if depth else "a sign with nothing after it"
        raise ValueError(f"formula must be complete, got {what} in {text!r}; {WRITE_SO}")
    yield sign, piece.strip()


def _read_bar(sign: str, piece: str) -> Iterator[RandomTerm]:
    """Read one bracket; nesting is named as lme4 names it, the inner first: a/b is a and b:a."""
    bar = "||" if "||" in piece else "|"
    effects, _, group = piece[1:-1].partition(bar)
    group = re.sub(r"^\s*\((.*)\)\s*$", r"\1", group)
    if sign == "-" or not effects.strip() or not GROUP.fullmatch(group):
        raise ValueError(f"formula must have + (effects | group), got {sign} {piece}; {WRITE_SO}")
    steps = [[name.strip().strip("`") for name in step.split(":")] for step in group.split("/")]
    for depth in range(len(steps)):
        levels = tuple(name for step in steps[depth::-1] for name in step)
        yield RandomTerm(effects.strip(), levels, independent=bar == "||")


@dataclass(frozen=True, slots=True)
class EffectGroup:
    """Effects that vary together over the levels of a grouping factor, correlated; columns: (n_rows, n_effects)."""

    names: tuple[str, ...]
    columns: Matrix


@dataclass(frozen=True, slots=True)
class Factor:
    """A grouping factor with all effects that vary over it; index: (n_rows,)."""

    name: str
    levels: tuple[str, ...]
    index: NDArray[np.intp]
    terms: tuple[EffectGroup, ...]

    @property
    def width(self) -> int:
        """Number of effects per level."""
        return sum(len(term.names) for term in self.terms)

    @property
    def columns(self) -> Matrix:
        """Columns of all its effects, shape (n_rows, width)."""
        return np.hstack([term.columns for term in self.terms])


@dataclass(frozen=True, slots=True)
class MixedDesign:
    """A model's data; response: (n_rows,), fixed: (n_rows, n_fixed)."""

    response: Matrix
    names: tuple[str, ...]
    fixed: Matrix
    factors: tuple[Factor, ...]
    coding: Any = None


def build_design(formula: str, data: DataFrame) -> MixedDesign:
    """Build a model's matrices."""
    parsed = parse_formula(formula)
    _check_table(data)
    plain = re.fullmatch(r"[\w.]+|`[^`]+`", parsed.response)
    # Arithmetic, not formula operators: y / 10 is no nesting.
    response = parsed.response if plain else f"I({parsed.response})"
    values = _expand(f"0 + {response}", data, "the response").columns
    if values.shape[1] != 1:
        raise ValueError(
            f"formula must have a response of numbers, got {values.shape[1]} columns for {parsed.response!r}"
        )
    names, fixed, coding = _expand(parsed.fixed, data, "the fixed part")
    design = MixedDesign(values[:, 0], names, fixed, _read_factors(parsed, data), coding)
    _check_fixed(design)
    return design


def read_new_rows(names: Sequence[str], coding: Any, data: DataFrame) -> Matrix:  # noqa: ANN401 - formulaic has no types
    """Compute the columns of a fixed part for new rows, coded as those that were fitted."""
    _check_table(data)
    try:
        if coding is None:
            plain = data.assign(**{"(Intercept)": 1.0})[list(names)]
            return plain.to_numpy(np.float64)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a level that was not fitted is only warned of
            settled = _settle_types(data)
            return np.asarray(coding.get_model_matrix(settled, context=_list_functions()), float)
    except Exception as error:
        raise ValueError(
            f"data must have the columns of the fixed part and levels that were fitted; {error}"
        ) from error


def _check_table(data: DataFrame) -> None:
    import pandas as pd

    if not isinstance(data, pd.DataFrame):
        raise TypeError(
            f"data must be a pandas DataFrame, one row per observation, got {type(data).__name__}"
        )
    if data.empty or not data.columns.is_unique:
        raise ValueError(
            "data must have one row per observation and each column once, got no rows, or one of "
            f"{', '.join(map(str, data.columns))} twice; rename or drop it"
        )


def _settle_types(data: DataFrame) -> DataFrame:
    """Make numbers numbers and words words, whatever pandas keeps them in."""
    settled = data.reset_index(drop=True).infer_objects()
    new = {}
    for name, column in settled.items():
        kind = str(column.dtype)
        # Unused categories would ask for an effect without data; true and false are named as R does.
        if kind == "category":
            new[str(name)] = column.cat.remove_unused_categories()
        elif kind == "bool":
            new[str(name)] = column.map({False: "FALSE", True: "TRUE"})
        elif kind == "string":
            new[str(name)] = column.astype(object)
    return settled.assign(**new) if new else settled


class Expanded(NamedTuple):
    """One side of a formula, written out: names as in R, and formulaic's coding, None for columns as they are."""

    names: tuple[str, ...]
    columns: Matrix
    coding: Any = None


def _expand(text: str, data: DataFrame, what: str) -> Expanded:
    """Write out a sum of columns of numbers without formulaic, which takes a tenth of a fit; all else with it."""
    pieces = text.split(" + ")
    names = [piece.strip("`") for piece in pieces[pieces[0] in {"0", "1"} :]]
    plain = all(re.fullmatch(NAME, f"`{name}`") and name in data for name in names)
    if text == "0" or not plain or len(set(names)) < len(names):
        return _run_formulaic(text, data, what)
    columns = [data[name] for name in names]
    ones = () if pieces[0] == "0" else ("(Intercept)",)
    if all(column.dtype in (float, int) for column in columns):
        parts = [np.ones(len(data)) for _ in ones]
        values = np.stack([*parts, *(column.to_numpy(np.float64) for column in columns)], axis=1)
        if np.isfinite(values).all():
            return Expanded((*ones, *names), values)
    return _run_formulaic(text, data, what)


def _run_formulaic(text: str, data: DataFrame, what: str) -> Expanded:
    from formulaic import model_matrix
    from formulaic.errors import FormulaicError

    data = _settle_types(data)
    known = (FormulaicError, SyntaxError, TypeError, ValueError, LookupError, AttributeError)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            matrix = model_matrix(
                _write_python(text), data, context=_list_functions(), na_action="ignore"
            )
    except known as error:
        raise ValueError(
            f"formula must be made of columns of the table ({', '.join(map(str, data.columns))}) and functions of "
            f"them; cannot read {what}, {text!r}: {str(error).splitlines()[0]}"
        ) from error
    # Rows whose category is missing come out as zeros, as if they were of the first one.
    for name in matrix.model_spec.required_variables:
        if name in data and (gaps := int(data[name].isna().sum())):
            raise ValueError(
                f"data must have a value in every row, got {gaps} rows without {name!r}; leave them out"
            )
    names = tuple(_name_like_r(str(name)) for name in matrix.columns)
    values = np.asarray(matrix, dtype=np.float64).reshape(len(data), -1)
    bad = ~np.isfinite(values)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ValueError(
            f"data must be finite in {what}, got {bad[:, column].sum()} values of {names[column]!r} that are missing "
            f"or not finite, first in row {row}; leave such rows out"
        )
    return Expanded(names, values, matrix.model_spec)


def _list_functions() -> dict[str, Any]:
    """List R's functions that formulaic does not know by itself."""
    from formulaic.transforms import C

    plain = {name: getattr(np, name) for name in ("sqrt", "sin", "cos")}
    return {"np": np, **plain, "factor": C, "as_factor": C}


def _name_like_r(name: str) -> str:
    if name == "Intercept":
        return "(Intercept)"
    plain = re.sub(r"\[(?:T\.)?([^\]]*?)(?:\.0)?\]", r"\1", name)
    return plain.replace("as_factor(", "as.factor(").replace(" ** ", "^")


def _write_python(text: str) -> str:
    """Write R's powers and names as formulaic understands them."""
    return re.sub(r"\bas\.factor\(", "as_factor(", text.replace("^", "**"))


def _read_factors(parsed: Formula, data: DataFrame) -> tuple[Factor, ...]:
    """Build one factor per group, holding all its terms, because their levels are the same."""
    merged: dict[str, Factor] = {}
    groups = dict.fromkeys(name for bracket in parsed.random for name in bracket.group)
    known = {name: _number_levels(data, name) for name in groups}
    for bracket in parsed.random:
        name, what = bracket.name, f"the random effects over {bracket.name}"
        parts = _split_effects(bracket.effects) if bracket.independent else [bracket.effects]
        terms = tuple(EffectGroup(*_expand(part, data, what)[:2]) for part in parts)
        if not terms or not all(term.names for term in terms):
            raise ValueError(
                f"formula must have an effect such as 1, x or 0 + x in ({bracket.effects} | {name}), got none"
            )
        before = merged.get(name) or Factor(name, *_combine_levels(bracket, known), ())
        merged[name] = replace(before, terms=(*before.terms, *terms))
    for factor in merged.values():
        _check_factor(factor)
    return tuple(merged.values())


def _split_effects(effects: str) -> list[str]:
    """Write a double bar out as lme4 does: term by term, so that the levels of one category stay together."""
    if re.fullmatch(rf"1( \+ {NAME})*", effects):
        return ["1", *(f"0 + {name}" for name in effects.split(" + ")[1:])]
    from formulaic import Formula as Parser
    from formulaic.errors import FormulaicError

    def quote(factor: Any) -> str:  # noqa: ANN401 - formulaic has no types
        """Write a column's name so that it may hold blanks."""
        return f"`{factor.expr}`" if factor.eval_method.value == "lookup" else str(factor.expr)

    try:
        terms = [":".join(map(quote, term.factors)) for term in Parser(_write_python(effects))]
    except (FormulaicError, SyntaxError, AttributeError) as error:  # the last at a part with sides
        raise ValueError(
            f"formula must have effects such as 1 + x; cannot read {effects!r}: {str(error).splitlines()[0]}"
        ) from error
    return [term if term == "1" else f"0 + {term}" for term in terms]


def _number_levels(data: DataFrame, name: str) -> tuple[NDArray[np.intp], NDArray[np.object_]]:
    """Give a number to every row's value of a column, and a name to every number."""
    import pandas as pd

    if name not in data:
        raise ValueError(
            f"formula must group by columns of the table ({', '.join(map(str, data.columns))}), got {name!r}"
        )
    codes, values = pd.factorize(data[name], sort=True)
    if (codes < 0).any():
        raise ValueError(
            f"data must have a level of {name} in every row, got rows without; leave them out"
        )
    return codes, np.array(list(map(str, values)), dtype=object)


def _combine_levels(
    bracket: RandomTerm, known: Mapping[str, tuple[NDArray[np.intp], NDArray[np.object_]]]
) -> tuple[tuple[str, ...], NDArray[np.intp]]:
    """Name the observed combinations of a bracket's columns, in their order, and number every row's."""
    columns = [known[name] for name in bracket.group]
    combined = np.zeros(len(columns[0][0]), dtype=np.intp)
    for codes, names in columns:
        combined = combined * len(names) + codes
    _, first, index = np.unique(combined, return_index=True, return_inverse=True)
    parts = [names[codes[first]] for codes, names in columns]
    return tuple(":".join(level) for level in zip(*parts, strict=True)), index


def _check_factor(factor: Factor) -> None:
    n_levels, n_rows = len(factor.levels), len(factor.index)
    if n_levels < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(
            f"data must have two or more levels of {factor.name}, got one; leave out its brackets"
        )
    names = [name for term in factor.terms for name in term.names]
    if len(set(names)) < len(names):
        twice = max(names, key=names.count)
        raise ValueError(
            f"formula must have each effect once per group, got {twice!r} twice over {factor.name}"
        )
    for term in factor.terms:
        if n_levels * len(term.names) >= n_rows:
            raise ValueError(
                f"data must have more rows than levels x effects of {factor.name}, or they cannot be told from the "
                f"residual; got {n_rows} rows for {n_levels} levels with {len(term.names)} effects each"
            )
        if not term.columns.any(axis=0).all():
            raise ValueError(f"data must vary in an effect over {factor.name}, got only zeros")


def _check_fixed(design: MixedDesign) -> None:
    n_rows, n_fixed = design.fixed.shape
    if not 0 < n_fixed < n_rows:
        raise ValueError(
            f"formula must have a fixed effect, an intercept (1) or a slope at least, and data more rows than effects, "
            f"got {n_rows} rows for {n_fixed} fixed effects"
        )
    lengths = np.linalg.norm(design.fixed, axis=0)
    scaled = design.fixed / np.where(lengths > 0, lengths, 1)
    basis, triangle = np.linalg.qr(scaled)
    dependent = np.abs(np.diag(triangle)) < DEPENDENT
    if dependent.any():
        raise ValueError(
            f"data must tell the fixed effects apart, got {design.names[int(dependent.argmax())]!r}, which is a sum "
            "of those before it (or constant); leave it out of the formula"
        )
    left = design.response - basis @ (basis.T @ design.response)
    size = np.linalg.norm(design.response)
    if size == 0 or np.linalg.norm(left) <= FLAT * size:
        raise ValueError(
            "data must have a response with scatter, got one that is constant, or that the fixed effects give exactly"
        )


Codes: TypeAlias = "NDArray[np.intp]"


class Nested(NamedTuple):
    """The unit of every level of a factor, and its number among the unit's levels, (n_levels,) each."""

    unit: Codes
    place: Codes


def nest(factor: Factor, unit: Factor) -> Nested | None:
    """Find the unit of every level of a factor; None where one belongs to several."""
    owner = np.empty(len(factor.levels), np.intp)
    owner[factor.index] = unit.index
    if (owner[factor.index] != unit.index).any():
        return None
    sizes, place = np.bincount(owner), np.empty(len(owner), np.intp)
    first = np.repeat(np.cumsum(sizes) - sizes, sizes)
    place[np.argsort(owner, kind="stable")] = np.arange(len(owner)) - first
    return Nested(owner, place)
