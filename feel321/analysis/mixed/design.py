"""From a formula and a table to matrices, with every refusal made here, in words.

``(1 | g)`` an intercept per level of g; ``(x | g)`` intercept and slope, correlated; ``(x || g)`` the same,
uncorrelated; ``(0 + x | g)`` a slope alone; ``(1 | a:b)`` one per combination; ``(1 | a/b)`` is ``(1 | a) +
(1 | b:a)``. The fixed part is left to formulaic, which knows ``+ - : * / ^ I()`` and functions of columns.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from formulaic.parser.types import Factor as Part
    from numpy.typing import NDArray
    from pandas import DataFrame
    from scipy.sparse import csr_array

# lme4's notation, read: which part of a formula is fixed, and which random terms stand in its brackets.

NAME = r"(?:`[^`]+`|[^\W\d][\w.]*)"
GROUP = re.compile(rf"\s*{NAME}\s*(?:[:/]\s*{NAME}\s*)*")
FORBIDDEN = re.compile(r"\b(offset|weights)\s*\(")


@dataclass(frozen=True, slots=True)
class RandomTerm:
    """One bracket of a formula: what varies, over which groups."""

    effects: str
    group: tuple[str, ...]
    independent: bool = False

    @property
    def name(self) -> str:
        """Name of the grouping factor, such as ``participant:item``."""
        return ":".join(self.group)


@dataclass(frozen=True, slots=True)
class Formula:
    """A formula taken apart."""

    text: str
    response: str
    fixed: str
    random: tuple[RandomTerm, ...]


def parse_formula(text: str) -> Formula:
    """Take a formula apart.

    Examples
    --------
    >>> parsed = parse_formula("y ~ x + (1 + x || subject) + (1 | class/pupil)")
    >>> parsed.fixed
    'x'
    >>> [(term.effects, term.name, term.independent) for term in parsed.random]
    [('1 + x', 'subject', True), ('1', 'class', False), ('1', 'pupil:class', False)]
    """
    if (
        not isinstance(text, str)
        or text.count("~") != 1
        or not all(side.strip() for side in text.split("~"))
    ):
        raise ValueError(
            f"formula: got {text!r}, allowed is 'response ~ fixed + (effects | group)'"
        )
    if found := FORBIDDEN.search(text):
        raise ValueError(
            f"formula: got {found[1]}(...), allowed are models without; every row counts the same here"
        )
    response, right = (side.strip() for side in text.split("~"))
    pieces = list(_split_sum(right))
    random = [term for sign, piece in pieces if _is_bar(piece) for term in _read_bar(sign, piece)]
    fixed = [(sign, piece) for sign, piece in pieces if not _is_bar(piece)]
    if any(piece == "." for _, piece in fixed):
        raise ValueError(
            "formula: got '.', allowed are terms by name; write out which columns predict"
        )
    if stray := next((piece for _, piece in fixed if "|" in piece), None):
        raise ValueError(
            f"formula: got {stray!r}, allowed is a bar inside brackets of its own: + (effects | group)"
        )
    if not random:
        raise ValueError(
            f"formula: got {text!r} without a random term, allowed is at least one (1 | group); "
            "for none, use ordinary regression"
        )
    return Formula(text, response, _join(fixed), tuple(random))


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
        raise ValueError(f"formula: got {what} in {text!r}, allowed is 'fixed + (effects | group)'")
    yield sign, piece.strip()


def _is_bar(piece: str) -> bool:
    return piece.startswith("(") and piece.endswith(")") and "|" in piece and _closes_last(piece)


def _closes_last(piece: str) -> bool:
    """Whether the first bracket is closed by the last letter: not so in (1 | a):(1 | b)."""
    depth = 0
    for place, letter in enumerate(piece):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return place == len(piece) - 1
    return False


def _read_bar(sign: str, piece: str) -> list[RandomTerm]:
    bar = "||" if "||" in piece else "|"
    effects, _, group = piece[1:-1].partition(bar)
    group = re.sub(r"^\s*\((.*)\)\s*$", r"\1", group)
    if sign == "-" or not effects.strip() or not GROUP.fullmatch(group):
        raise ValueError(
            f"formula: got {sign} {piece}, allowed is + (effects | group) with a group such as a, a:b or a/b"
        )
    independent = bar == "||"
    return [RandomTerm(effects.strip(), levels, independent) for levels in _write_out(group)]


def _write_out(group: str) -> list[tuple[str, ...]]:
    """Nesting as a list, named as lme4 names it, the inner first: a/b is a and b:a."""
    steps = [
        tuple(name.strip().strip("`") for name in step.split(":")) for step in group.split("/")
    ]
    return [sum(steps[depth::-1], ()) for depth in range(len(steps))]


def _join(pieces: list[tuple[str, str]]) -> str:
    text = " ".join(f"{sign} {piece}" for sign, piece in pieces)
    return text.removeprefix("+ ") or "1"


DEPENDENT = 1e-9
"""Share of a column's length left over beside the others, below which it is their sum but for rounding."""

FLAT = 1e-12
"""Share of a response's size below which what the fixed effects leave over is rounding."""


@dataclass(frozen=True, slots=True)
class Term:
    """Effects that vary together over the levels of a grouping factor, correlated with each other.

    columns: (n_rows, n_effects).
    """

    names: tuple[str, ...]
    columns: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Factor:
    """A grouping factor with all terms that vary over it.

    index: (n_rows,).
    """

    name: str
    levels: tuple[str, ...]
    index: NDArray[np.intp]
    terms: tuple[Term, ...]

    @property
    def width(self) -> int:
        """Number of effects per level."""
        return sum(len(term.names) for term in self.terms)

    @property
    def columns(self) -> NDArray[np.float64]:
        """Columns of all its effects, shape (n_rows, width)."""
        return np.hstack([term.columns for term in self.terms])


@dataclass(frozen=True, slots=True)
class Design:
    """A model's data.

    response: (n_rows,); fixed: (n_rows, n_fixed).
    """

    response: NDArray[np.float64]
    names: tuple[str, ...]
    fixed: NDArray[np.float64]
    factors: tuple[Factor, ...]


def build_design(formula: str, data: DataFrame) -> Design:
    """Build a model's matrices."""
    parsed = parse_formula(formula)
    _check_table(data)
    if data.empty:
        raise ValueError("data: got no rows, allowed is a table with one row per observation")
    clean = _settle_types(data)
    response = _read_response(parsed, clean)
    names, fixed = _expand(parsed.fixed, clean, "the fixed part")
    factors = _read_factors(parsed, clean)
    design = Design(response, names, fixed, factors)
    _check_fixed(design)
    return design


def _check_table(data: DataFrame) -> None:
    import pandas as pd

    if not isinstance(data, pd.DataFrame):
        raise TypeError(
            f"data: got {type(data).__name__}, allowed is a pandas DataFrame, one row per observation"
        )
    if not data.columns.is_unique:
        twice = data.columns[data.columns.duplicated()][0]
        raise ValueError(
            f"data: got column {twice!r} twice, allowed is each name once; rename or drop one"
        )


def _settle_types(data: DataFrame) -> DataFrame:
    """Make numbers numbers and words words, whatever pandas keeps them in."""
    settled = data.reset_index(drop=True).infer_objects()
    # Unused categories would ask for an effect without data; true and false are named as R does.
    new = {
        name: settled[name].cat.remove_unused_categories()
        for name in settled.select_dtypes("category")
    }
    new |= {
        name: settled[name].map({False: "FALSE", True: "TRUE"})
        for name in settled.select_dtypes("bool")
    }
    new |= {
        name: settled[name].astype(object)
        for name in settled
        if str(settled[name].dtype) == "string"
    }
    return settled.assign(**{str(name): column for name, column in new.items()}) if new else settled


def _read_response(parsed: Formula, data: DataFrame) -> NDArray[np.float64]:
    plain = re.fullmatch(r"[\w.]+|`[^`]+`", parsed.response)
    # Arithmetic, not formula operators: y / 10 is no nesting.
    names, values = _expand(
        f"0 + {parsed.response if plain else f'I({parsed.response})'}", data, "the response"
    )
    if len(names) != 1:
        raise ValueError(
            f"formula: got {len(names)} columns for {parsed.response!r}, allowed is a response of numbers"
        )
    return values[:, 0]


def _expand(text: str, data: DataFrame, what: str) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Columns of one side of a formula, named as R names them."""
    from formulaic import model_matrix
    from formulaic.errors import FormulaicError
    from formulaic.transforms import C

    functions = {
        "np": np,
        "sqrt": np.sqrt,
        "sin": np.sin,
        "cos": np.cos,
        "factor": C,
        "as_factor": C,
    }
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            matrix = model_matrix(_write_python(text), data, context=functions, na_action="ignore")
    except (FormulaicError, SyntaxError, TypeError, ValueError, KeyError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(
            f"formula: could not make sense of {what}, {text!r} ({reason}); allowed are columns of the table "
            f"({', '.join(map(str, data.columns))}) and functions of them"
        ) from error
    # Rows whose category is missing come out as zeros, as if they were of the first one.
    gaps = [
        name
        for name in matrix.model_spec.required_variables
        if name in data and data[name].isna().any()
    ]
    if gaps:
        raise ValueError(
            f"data: got {data[gaps[0]].isna().sum()} rows without {gaps[0]!r}, allowed is a value in every row; "
            "leave such rows out yourself"
        )
    values = np.asarray(matrix, dtype=np.float64).reshape(len(data), -1)
    names = tuple(_name_like_r(str(name)) for name in matrix.columns)
    _check_finite(names, values, what)
    return names, values


def _name_like_r(name: str) -> str:
    if name == "Intercept":
        return "(Intercept)"
    plain = re.sub(r"\[(?:T\.)?([^\]]*?)(?:\.0)?\]", r"\1", name)
    return plain.replace("as_factor(", "as.factor(").replace(" ** ", "^")


def _check_finite(names: Sequence[str], values: NDArray[np.float64], what: str) -> None:
    bad = ~np.isfinite(values)
    if bad.any():
        column = int(np.flatnonzero(bad.any(axis=0))[0])
        raise ValueError(
            f"data: got {bad[:, column].sum()} values that are missing or not finite in {what}, {names[column]!r}, "
            f"first in row {np.flatnonzero(bad[:, column])[0]}; allowed are numbers only, leave such rows out yourself"
        )


def _read_factors(parsed: Formula, data: DataFrame) -> tuple[Factor, ...]:
    """One factor per group, holding all its terms, because their levels are the same."""
    merged: dict[str, Factor] = {}
    for bracket in parsed.random:
        terms = _read_terms(bracket, data)
        name = bracket.name
        before = merged.get(name)
        if before is None:
            index, levels = _read_levels(bracket, data)
            merged[name] = Factor(name, levels, index, terms)
        else:
            merged[name] = Factor(name, before.levels, before.index, (*before.terms, *terms))
    for factor in merged.values():
        _check_factor(factor)
    return tuple(merged.values())


def _read_terms(bracket: RandomTerm, data: DataFrame) -> tuple[Term, ...]:
    parts = _split_effects(bracket.effects) if bracket.independent else [bracket.effects]
    what = f"the random effects over {bracket.name}"
    terms = tuple(Term(*_expand(part, data, what)) for part in parts)
    if not all(term.names for term in terms) or not terms:
        raise ValueError(
            f"formula: got no effect in ({bracket.effects} | {bracket.name}), allowed is 1, x or 0 + x"
        )
    return terms


def _split_effects(effects: str) -> list[str]:
    """Write a double bar out as lme4 does: term by term, so that the levels of one category stay together."""
    from formulaic import Formula
    from formulaic.errors import FormulaicError

    try:
        terms = [":".join(map(_quote, term.factors)) for term in Formula(_write_python(effects))]
    except (FormulaicError, SyntaxError) as error:
        raise ValueError(
            f"formula: could not make sense of the effects {effects!r} ({str(error).splitlines()[0]}), "
            "allowed are such as 1 + x"
        ) from error
    return [term if term == "1" else f"0 + {term}" for term in terms]


def _quote(part: Part) -> str:
    """Write a column's name so that it may hold blanks."""
    return f"`{part.expr}`" if part.eval_method.value == "lookup" else str(part.expr)


def _write_python(text: str) -> str:
    """Write R's powers and names as formulaic understands them."""
    return re.sub(r"\bas\.factor\(", "as_factor(", text.replace("^", "**"))


def _read_levels(bracket: RandomTerm, data: DataFrame) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    import pandas as pd

    if missing := [name for name in bracket.group if name not in data]:
        raise ValueError(
            f"formula: got the group {missing[0]!r}, allowed is a column of the table "
            f"({', '.join(map(str, data.columns))})"
        )
    keys = data[list(bracket.group)]
    if keys.isna().any(axis=None):
        raise ValueError(
            f"data: got rows without {bracket.name}, allowed is a level in every row; leave them out"
        )
    # A plain tuple of columns groups numbers, words and categories alike; observed levels only.
    grouped = keys.groupby(list(bracket.group), observed=True, sort=True)
    index: NDArray[np.intp] = grouped.ngroup().to_numpy().astype(np.intp)
    first = pd.Series(np.arange(len(keys))).groupby(index).first().to_numpy()
    parts = [keys.iloc[first][name].astype(str) for name in bracket.group]
    return index, tuple(":".join(level) for level in zip(*parts, strict=True))


def _check_factor(factor: Factor) -> None:
    n_levels, n_rows = len(factor.levels), len(factor.index)
    if n_levels < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(
            f"data: got one level of {factor.name}, allowed are two or more; leave out its brackets"
        )
    names = [name for term in factor.terms for name in term.names]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ValueError(
            f"formula: got {twice!r} twice over {factor.name}, allowed is each effect once per group"
        )
    for term in factor.terms:
        if n_levels * len(term.names) >= n_rows:
            raise ValueError(
                f"data: got {n_rows} rows for {n_levels} levels of {factor.name} with {len(term.names)} effects each, "
                "allowed are fewer levels x effects than rows; the effects and the residual cannot be told apart"
            )
        if not term.columns.any(axis=0).all():
            raise ValueError(
                f"data: got only zeros for an effect over {factor.name}, allowed is a column that varies"
            )


def _check_fixed(design: Design) -> None:
    n_rows, n_fixed = design.fixed.shape
    if not n_fixed:
        raise ValueError(
            "formula: got no fixed effect, allowed is at least an intercept (1) or a slope"
        )
    if n_rows <= n_fixed:
        raise ValueError(
            f"data: got {n_rows} rows for {n_fixed} fixed effects, allowed are more rows than effects"
        )
    _check_rank(design)
    residual = (
        design.response
        - design.fixed @ np.linalg.lstsq(design.fixed, design.response, rcond=None)[0]
    )
    if np.linalg.norm(residual) <= FLAT * np.linalg.norm(design.response) or not np.any(
        design.response
    ):
        raise ValueError(
            "data: got a response that is constant, or that the fixed effects give exactly, allowed is one with scatter"
        )


def _check_rank(design: Design) -> None:
    lengths = np.linalg.norm(design.fixed, axis=0)
    scaled = design.fixed / np.where(lengths > 0, lengths, 1)
    diagonal = np.abs(np.diag(np.linalg.qr(scaled, mode="r")))
    if (diagonal < DEPENDENT).any():
        name = design.names[int(np.flatnonzero(diagonal < DEPENDENT)[0])]
        raise ValueError(
            f"data: got {name!r}, which is a sum of the fixed effects before it (or constant), "
            "allowed are effects that the data can tell apart; leave it out of the formula"
        )


# Where each grouping factor stands in the equations, and its columns of Z.


@dataclass(frozen=True)
class Block:
    """A grouping factor's place in the equations.

    scale: (width,).
    """

    factor: Factor
    scale: NDArray[np.float64]
    theta: slice
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    @property
    def n_levels(self) -> int:
        """Number of levels."""
        return len(self.factor.levels)

    @property
    def width(self) -> int:
        """Effects per level."""
        return len(self.scale)

    def triangle(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Write a factor's parameters as a triangle.

        theta: (n_theta,); returns (width, width).
        """
        lower = np.zeros((self.width, self.width))
        lower[self.rows, self.columns] = theta[self.theta]
        return lower


def lay_out(factors: tuple[Factor, ...]) -> Iterator[Block]:
    """Place the factors, most effects first; parameters follow term by term, each a lower triangle."""
    start = 0
    for factor in sorted(factors, key=lambda factor: -len(factor.levels) * factor.width):
        rows, columns, corner = [], [], 0
        for term in factor.terms:
            row, column = np.tril_indices(len(term.names))
            rows.append(row + corner)
            columns.append(column + corner)
            corner += len(term.names)
        size = sum(map(len, rows))
        scale = np.sqrt(np.mean(factor.columns**2, axis=0))
        yield Block(
            factor, scale, slice(start, start + size), np.concatenate(rows), np.concatenate(columns)
        )
        start += size


def find_penalised(blocks: Sequence[Block], names: Sequence[str]) -> NDArray[np.bool_]:
    """Find the parameters whose logarithm is penalised: the spreads of the factors named.

    Returns (n_theta,).
    """
    if strangers := [name for name in names if name not in {block.factor.name for block in blocks}]:
        allowed = ", ".join(block.factor.name for block in blocks)
        raise ValueError(
            f"penalty: got {strangers[0]!r}, allowed are the formula's groups: {allowed}"
        )
    chosen = [np.full(len(block.rows), block.factor.name in names) for block in blocks]
    if any(
        one.any() and (block.rows != block.columns).any()
        for one, block in zip(chosen, blocks, strict=True)
    ):
        raise ValueError(
            "penalty: got a group with correlated effects, allowed are uncorrelated ones: (1 + x || g)"
        )
    return np.concatenate(chosen)


def spread_columns(block: Block) -> csr_array:
    """Build a factor's columns of Z, level by level.

    Returns (n_rows, n_levels * width).
    """
    from scipy.sparse import csr_array

    values, width = block.factor.columns / block.scale, block.width
    places = block.factor.index[:, None] * width + np.arange(width)
    starts = np.arange(len(values) + 1) * width
    return csr_array(
        (values.ravel(), places.ravel(), starts), shape=(len(values), block.n_levels * width)
    )


def pick_blocks(first: csr_array, block: Block) -> NDArray[np.float64]:
    """Pick the blocks on the diagonal of a factor's cross products.

    first: (n_rows, n_levels * width); returns (n_levels, width, width).
    """
    products = (first.T @ first).tocsr()
    starts = np.arange(block.n_levels) * block.width
    blocks = np.empty((block.n_levels, block.width, block.width))
    for row in range(block.width):
        for column in range(block.width):
            blocks[:, row, column] = products[starts + row, starts + column]
    return blocks


def scale_columns(matrix: NDArray[np.float64], lower: NDArray[np.float64]) -> NDArray[np.float64]:
    """Multiply every level's columns by a triangle.

    matrix: (n, n_levels * width); lower: (width, width); returns (n, n_levels * width).
    """
    levels = matrix.reshape(len(matrix), -1, len(lower))
    scaled: NDArray[np.float64] = levels * lower[0, 0] if len(lower) == 1 else levels @ lower
    return scaled.reshape(matrix.shape)
