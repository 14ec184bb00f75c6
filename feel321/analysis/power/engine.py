"""The primary model fitted thousands of times: to other ratings, and to other stimuli, of one design.

Terms, penalty and matrices come from the same functions as in `fit_primary`, once for every structure (people,
recordings x reducers); a study with other stimuli puts its metrics in place of those. What is fitted is the same
function of the same numbers, so standard errors, degrees of freedom and probabilities are those of `fit_primary`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.mixed import design as matrices
from feel321.analysis.mixed import model
from feel321.analysis.power.draw import Stimuli, tabulate_ratings
from feel321.analysis.primary.model import FEWEST, FEWEST_DF
from feel321.analysis.primary.plan import DEPENDENT, ITEM, WHO, Terms, make_cells, plan_terms

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from feel321.types import Samples

FITTED, SINGULAR, NOT_ESTIMABLE, FAILED = "fitted", "singular", "not estimable", "failed"


class Fit(NamedTuple):
    """Estimate, standard error and degrees of freedom of every test, (n_tests, 3); NaN where there is no test."""

    tests: Samples
    outcome: str
    reason: str = ""


class Structure(NamedTuple):
    """A model for one number of people and one arrangement of stimuli; rows: (people, n_items), where each stands."""

    design: matrices.MixedDesign
    terms: Terms
    rows: NDArray[np.intp]


def list_pairs(count: int) -> list[tuple[int, int]]:
    """List the two metrics of every comparison, in the order of the primary model."""
    return list(combinations(range(count), 2))


@dataclass(slots=True)
class Engine:
    """Fits one primary model after the other; metrics: names, all of one model."""

    metrics: tuple[str, ...]
    known: dict[object, Structure | str] = field(default_factory=dict)
    latest: tuple[Stimuli, int, Structure | str] | None = None

    def fit(self, stimuli: Stimuli, ratings: Samples) -> Fit:
        """Fit the ratings of one attribute, averaged over repeats; (people, n_items)."""
        people = len(ratings)
        if not self.latest or self.latest[0] is not stimuli or self.latest[1] != people:
            self.latest = stimuli, people, self._find_structure(stimuli, people)
        structure = self.latest[2]
        if isinstance(structure, str):
            return self.give_up(structure)
        if np.ptp(ratings) == 0:
            return self.give_up("all ratings are the same")
        try:
            solved = _solve(structure, ratings)
        except (ValueError, np.linalg.LinAlgError) as error:
            return self.give_up(str(error))
        return self._read(structure, solved, stimuli, people=people)

    def give_up(self, reason: str) -> Fit:
        """Report that a model failed."""
        count = len(self.metrics)
        return Fit(np.full((count + len(list_pairs(count)), 3), np.nan), FAILED, reason)

    def _find_structure(self, stimuli: Stimuli, people: int) -> Structure | str:
        """Look a structure up, or build it; the reason where there is no model."""
        key = (people, *describe_stimuli(stimuli))
        if key not in self.known:
            try:
                self.known[key] = _build_structure(stimuli, people, self.metrics)
            except ValueError as error:
                self.known[key] = str(error)
        found = self.known[key]
        return found if isinstance(found, str) else _put_metrics(found, stimuli, self.metrics)

    def _read(
        self, structure: Structure, solved: model.Solved, stimuli: Stimuli, *, people: int
    ) -> Fit:
        """Estimate all slopes, and all differences of slopes per standard deviation of their metric."""
        names = [name.strip("`") for name in solved.profile.design.names]
        places = [names.index(f"{one}_w") if f"{one}_w" in names else -1 for one in self.metrics]
        spreads, unit = stimuli.within.std(axis=0, ddof=1), np.eye(len(names))
        slopes = [unit[place] if place >= 0 else None for place in places]
        pairs = [
            None if slopes[one] is None or slopes[two] is None
            else spreads[one] * unit[places[one]] - spreads[two] * unit[places[two]]
            for one, two in list_pairs(len(places))
        ]  # fmt: skip
        tests = np.array([
            (np.nan,) * 3 if weights is None
            else _measure(solved, weights)
            for weights in (*slopes, *pairs)
        ])  # fmt: skip
        units = people, len(np.unique(stimuli.source)), len(np.unique(stimuli.kind))
        tests[~(tests[:, 2] >= FEWEST_DF) | (min(units) < FEWEST), 1:] = np.nan
        return _name_outcome(structure, solved, tests)


def _measure(solved: model.Solved, weights: Samples) -> tuple[float, float, float]:
    found = model.estimate_sum(solved.coefficients, weights, solved.uncertainty)
    return found.estimate, found.se, found.df


def _solve(structure: Structure, ratings: Samples) -> model.Solved:
    response = np.empty(structure.rows.size)
    response[structure.rows] = ratings
    design, penalty = replace(structure.design, response=response), structure.terms.penalty
    return model.solve_design(design, penalty=penalty, most_df=structure.terms.most_df)


def _name_outcome(structure: Structure, solved: model.Solved, tests: Samples) -> Fit:
    """Name what became of a fit, by its first test that has no result or by its spreads of zero."""
    if np.isnan(tests[:, 1]).any():
        return Fit(tests, NOT_ESTIMABLE, " ".join(structure.terms.reductions) or "too few units")
    zero = solved.best.theta[solved.profile.diagonal] == 0
    return Fit(tests, SINGULAR if zero.any() else FITTED)


def describe_stimuli(stimuli: Stimuli) -> Iterator[object]:
    """Describe what the terms of a model depend on: the arrangement, and which metrics can be told apart."""
    codes = (stimuli.scene, stimuli.kind, stimuli.source)
    yield from (one.astype(np.intp).tobytes() for one in codes)
    marks = [np.eye(one.max() + 1)[one] for one in codes[:2]]
    within = _scale(stimuli.within)
    yield int(np.linalg.matrix_rank(np.hstack([marks[0], within, marks[1]])))
    for part in (within, _scale(stimuli.between)):
        clear = np.abs(np.diag(np.linalg.qr(part, mode="r"))) > DEPENDENT * np.sqrt(len(part))
        yield tuple(clear.tolist())
        # What cannot be told apart may be left out in several ways: such stimuli are a structure of their own.
        yield b"" if clear.all() else part.tobytes()


def _scale(values: Samples) -> Samples:
    centred = values - values.mean(axis=0)
    spread = centred.std(axis=0)
    flat = spread <= 1e-10 * np.abs(values).max(axis=0)
    scaled: Samples = np.where(flat, 0.0, centred / np.where(flat, 1.0, spread))
    return scaled


def _build_structure(stimuli: Stimuli, people: int, metrics: tuple[str, ...]) -> Structure:
    blank = np.random.default_rng(0).normal(50, 10, (people, len(stimuli.scene), 1))
    cells = make_cells(tabulate_ratings(stimuli, blank, metrics), metrics)
    terms = plan_terms(cells, correlated=False, reducers=True)
    design = matrices.build_design(terms.formula, cells.table)
    rows = np.empty((people, len(stimuli.scene)), np.intp)
    rows[cells.table[WHO].to_numpy(), cells.table[ITEM].to_numpy()] = np.arange(len(cells.table))
    return Structure(design, terms, rows)


def _put_metrics(structure: Structure, stimuli: Stimuli, metrics: tuple[str, ...]) -> Structure:
    """Put the metrics of stimuli into the matrices of their structure."""
    item = np.empty(structure.rows.size, np.intp)
    item[structure.rows] = np.arange(structure.rows.shape[1])
    values = {"(Intercept)": np.ones(len(item))}
    for part, table in (("_w", stimuli.within), ("_b", stimuli.between)):
        values |= {f"{name}{part}": table[item, place] for place, name in enumerate(metrics)}
    old = structure.design
    fixed = np.column_stack([values[name.strip("`")] for name in old.names])
    factors = tuple(_put_effects(factor, values) for factor in old.factors)
    return structure._replace(design=replace(old, fixed=fixed, factors=factors))


def _put_effects(factor: matrices.Factor, values: dict[str, Samples]) -> matrices.Factor:
    if factor.width == 1:
        return factor
    terms = (
        matrices.EffectGroup(
            term.names, np.column_stack([values[name.strip("`")] for name in term.names])
        )
        for term in factor.terms
    )
    return replace(factor, terms=tuple(terms))
