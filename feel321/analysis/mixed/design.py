"""From a formula and a table to matrices; everything that cannot be fitted is refused here.

``(1 | g)`` an intercept per level of g; ``(x | g)`` intercept and slope, correlated; ``(x || g)`` the same,
uncorrelated; ``(0 + x | g)`` a slope alone; ``(1 | a:b)`` one per combination; ``(1 | a/b)`` is ``(1 | a) +
(1 | b:a)``. The fixed part is left to formulaic, which knows ``+ - : * / ^ I()`` and functions of columns.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas import DataFrame

Matrix = NDArray[np.float64]

NAME = r"(?:`[^`]+`|[^\W\d][\w.]*)"
INNER = r"(?:`[^`]*`|[^()|`]|\([^()|]*\))"
PIECE = rf"((?:`[^`]*`|[^()|`]|\({INNER}*\))+)"
BRACKET = re.compile(rf"(?:^|\+)\s*\({PIECE}(\|\|?){PIECE}\)\s*(?=[+-]|$)")
GROUP = re.compile(rf"\s*{NAME}\s*(?:[:/]\s*{NAME}\s*)*")
# What no part of a formula may hold once names in backticks and random terms are taken out.
UNREAD = r"[|]|~.*~|(offset|weights)\s*\(|(^|[~\s])\.(\s|$)"
DEPENDENT = 1e-9  # Share of a column's length below which what others leave of it is rounding
FLAT = 1e-12  # Share of a response's size below which what the fixed effects leave over is rounding


class Columns(NamedTuple):
    """One side of a formula written out, names as in R; columns: (n_rows, n_columns)."""

    names: tuple[str, ...]
    columns: Matrix


@dataclass(frozen=True, slots=True)
class Factor:
    """A grouping factor and its effects; index: (n_rows,). Effects of one term vary together, correlated."""

    name: str
    n_levels: int
    index: NDArray[np.intp]
    terms: tuple[Columns, ...] = ()

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


def build_design(formula: str, data: DataFrame) -> MixedDesign:
    """Build a model's matrices."""
    if not isinstance(data, pd.DataFrame):
        got = type(data).__name__
        raise TypeError(f"data must be a pandas DataFrame, one row per observation, got {got}")
    if data.empty or not data.columns.is_unique:
        twice = data.columns[data.columns.duplicated()]
        got = f"column {twice[0]!r} twice; rename or drop one" if len(twice) else "no rows"
        raise ValueError(f"data must have rows, and each column once, got {got}")
    response, fixed, brackets = _read_formula(formula)
    values = _expand(f"0 + {response}", formula, data).columns
    if values.shape[1] != 1:
        raise _refuse(formula, "name a response of numbers, not of categories")
    names, columns = _expand(fixed, formula, data)
    _check_fixed(names, columns, values[:, 0])
    # One factor per group, holding all its terms, because their levels are the same.
    factors: dict[str, Factor] = {}
    for effects, bar, group in brackets:
        parts = _split_effects(effects, formula) if bar == "||" else [effects]
        terms = tuple(_expand(part, formula, data) for part in parts)
        if not terms or not all(term.names for term in terms) or not GROUP.fullmatch(group):
            why = "brackets hold an effect such as 1, x or 0 + x, then groups such as a, a:b or a/b"
            raise _refuse(formula, why)
        steps = [[name.strip("` ") for name in step.split(":")] for step in group.split("/")]
        for depth in range(len(steps)):
            own = [name for step in steps[depth::-1] for name in step]
            factor = factors.get(":".join(own)) or _number_levels(own, formula, data)
            factors[factor.name] = replace(factor, terms=(*factor.terms, *terms))
    for factor in factors.values():
        _check_factor(factor)
    return MixedDesign(values[:, 0], names, columns, tuple(factors.values()))


def _read_formula(formula: str) -> tuple[str, str, list[tuple[str, str, str]]]:
    """Take a formula apart: response, fixed part, and effects, bar and group of each bracket."""
    left, tilde, right = formula.partition("~") if isinstance(formula, str) else ("", "", "")
    left = left.strip()
    if not left or not tilde:
        raise _refuse(formula, "write 'response ~ fixed + (effects | group)'")
    # Brackets are taken out with their plus sign; what is left is the fixed part.
    fixed = BRACKET.sub(" ", right).strip().removeprefix("+").strip()
    if re.search(UNREAD, re.sub("`[^`]*`", "", f"{left}~{fixed}")):
        why = "write each bar in brackets of its own after a plus, one ~, no . or offset"
        raise _refuse(formula, why)
    brackets = [(effects.strip(), bar, group) for effects, bar, group in BRACKET.findall(right)]
    if not brackets:
        raise _refuse(formula, "add a random term such as (1 | group)")
    # Arithmetic, not formula operators: y / 10 is no nesting.
    response = left if re.fullmatch(r"[\w.]+|`[^`]+`", left) else f"I({left})"
    return response, fixed or "1", brackets


def _refuse(formula: str, why: str) -> ValueError:
    return ValueError(f"formula {formula!r} cannot be fitted: {why}")


def _expand(text: str, formula: str, data: DataFrame) -> Columns:
    """Write out a sum of columns without formulaic, which takes a tenth of a fit; all else with it."""
    pieces = text.split(" + ")
    names = [piece.strip("`") for piece in pieces[pieces[0] in {"0", "1"} :]]
    plain = all(re.fullmatch(NAME, f"`{name}`") and name in data for name in names)
    if text != "0" and plain and len(set(names)) == len(names):
        parts = {} if pieces[0] == "0" else {"(Intercept)": np.ones(len(data))}
        for name in names:
            column = data[name]
            if column.dtype in (float, int):
                parts[name] = column.to_numpy(np.float64)
            elif pieces[0] != "0" and str(column.dtype) == "str" and column.notna().all():
                codes, levels = column.factorize(sort=True)
                marks = np.eye(len(levels))[:, codes]
                parts |= {f"{name}{level}": marks[k] for k, level in enumerate(levels) if k}
            else:
                break
        else:
            values = np.stack(list(parts.values()), axis=1)
            if np.isfinite(values).all():
                return Columns(tuple(parts), values)
    return _run_formulaic(text, formula, data)


def _run_formulaic(text: str, formula: str, data: DataFrame) -> Columns:
    from formulaic import model_matrix
    from formulaic.errors import FormulaicError
    from formulaic.transforms import C

    # R's functions that formulaic does not know by itself.
    functions = {name: getattr(np, name) for name in ("sqrt", "sin", "cos")}
    functions |= {"np": np, "factor": C, "as_factor": C}
    data = _settle_types(data)
    known = (FormulaicError, SyntaxError, TypeError, ValueError, LookupError, AttributeError)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            matrix = model_matrix(_write_python(text), data, context=functions, na_action="ignore")
    except known as error:
        why = "".join(str(error).splitlines()[:1])
        if missing := re.search("NameError: `([^`]+)`", why):
            why = f"no column {missing[1]!r}; columns are {', '.join(map(str, data))}"
            raise _refuse(formula, why) from error
        raise _refuse(formula, f"cannot read {text!r} ({why})") from error
    # Rows whose category is missing come out as zeros, as if they were of the first one.
    for name in matrix.model_spec.required_variables:
        if name in data and (gaps := int(data[name].isna().sum())):
            got = f"got {gaps} rows without {name!r}; leave them out"
            raise ValueError(f"data must have a value in every row, {got}")
    values = np.asarray(matrix, dtype=np.float64).reshape(len(data), -1)
    # As R names them: recipe[T.B] is recipeB.
    names = [re.sub(r"\[(?:T\.)?([^\]]*?)(?:\.0)?\]", r"\1", str(name)) for name in matrix.columns]
    names = [name.replace("as_factor(", "as.factor(").replace(" ** ", "^") for name in names]
    names = ["(Intercept)" if name == "Intercept" else name for name in names]
    bad = ~np.isfinite(values)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        got = f"got {bad[:, column].sum()} values of {names[column]!r} that are not"
        raise ValueError(f"data must be finite, {got}, first in row {row}; leave such rows out")
    return Columns(tuple(names), values)


def _write_python(text: str) -> str:
    """Write R's powers and names as formulaic understands them."""
    return re.sub(r"\bas\.factor\(", "as_factor(", text.replace("^", "**"))


def _settle_types(data: DataFrame) -> DataFrame:
    """Make numbers numbers and words words, whatever pandas keeps them in."""
    settled, new = data.reset_index(drop=True).infer_objects(), {}
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


def _split_effects(effects: str, formula: str) -> list[str]:
    """Write a double bar out as lme4 does: term by term, so that the levels of one category stay together."""
    if re.fullmatch(rf"1( \+ {NAME})*", effects):
        return ["1", *(f"0 + {name}" for name in re.findall(NAME, effects[1:]))]
    from formulaic import Formula
    from formulaic.errors import FormulaicError

    def quote(factor: Any) -> str:  # noqa: ANN401 - formulaic has no types
        """Write a column's name so that it may hold blanks."""
        return f"`{factor.expr}`" if factor.eval_method.value == "lookup" else str(factor.expr)

    try:
        terms = [":".join(map(quote, term.factors)) for term in Formula(_write_python(effects))]
    except (FormulaicError, SyntaxError, AttributeError) as error:  # the last at a part with sides
        raise _refuse(formula, f"cannot read {effects!r}") from error
    return [term if term == "1" else f"0 + {term}" for term in terms]


def _number_levels(names: Sequence[str], formula: str, data: DataFrame) -> Factor:
    """Combine some columns, and number the combinations that occur."""
    combined = np.zeros(len(data), dtype=np.intp)
    for name in names:
        if name not in data:
            raise _refuse(formula, f"no column {name!r}; columns are {', '.join(map(str, data))}")
        codes, values = data[name].factorize(sort=True)
        if (codes < 0).any():
            got = f"got {int((codes < 0).sum())} rows without; leave them out"
            raise ValueError(f"data must have a level of {name} in every row, {got}")
        combined = combined * len(values) + codes
    levels, index = np.unique(combined, return_inverse=True)
    return Factor(":".join(names), len(levels), index)


def _check_factor(factor: Factor) -> None:
    n_rows = len(factor.index)
    names = [name for term in factor.terms for name in term.names]
    most = max(len(term.names) for term in factor.terms)
    if factor.n_levels < 2 or factor.n_levels * most >= n_rows:  # noqa: PLR2004 - a spread needs two
        got = f"got {n_rows} rows for {factor.n_levels} levels with {most} effects each"
        rule = f"two or more levels of {factor.name}, and more rows than levels x effects"
        raise ValueError(f"data must have {rule}, {got}; leave its brackets out")
    if len(set(names)) < len(names) or not factor.columns.any(axis=0).all():
        rule = "each effect once per group, and data vary in it"
        raise ValueError(f"formula must have {rule}, got {', '.join(names)} over {factor.name}")


def _check_fixed(names: tuple[str, ...], fixed: Matrix, response: Matrix) -> None:
    n_rows, n_fixed = fixed.shape
    if not 0 < n_fixed < n_rows:
        rule = "a fixed effect, an intercept (1) or a slope, and data more rows than effects"
        raise ValueError(f"formula must have {rule}, got {n_rows} rows for {n_fixed} fixed effects")
    lengths = np.linalg.norm(fixed, axis=0)
    basis, triangle = np.linalg.qr(fixed / np.where(lengths > 0, lengths, 1))
    dependent = np.abs(np.diag(triangle)) < DEPENDENT
    if dependent.any():
        got = f"got {names[int(dependent.argmax())]!r}, which is a sum of those before it"
        do = "leave it out of the formula"
        raise ValueError(f"data must tell the fixed effects apart, {got} (or constant); {do}")
    left = response - basis @ (basis.T @ response)
    size = np.linalg.norm(response)
    if size == 0 or np.linalg.norm(left) <= FLAT * size:
        got = "got one that is constant, or that the fixed effects give exactly"
        raise ValueError(f"data must have a response with scatter, {got}")
