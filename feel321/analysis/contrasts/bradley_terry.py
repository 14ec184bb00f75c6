"""Which of several would win a comparison, and by how much? The Bradley-Terry model of paired choices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.contrasts.duels import Duels, count_duels
from feel321.analysis.resampling import MOST_UNDEFINED, bootstrap_margin, draw_counts
from feel321.analysis.words import CONFIDENCE

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    from pandas import DataFrame

    Values = NDArray[np.float64]

ORDER = "order"
"""The term of being presented first."""

EXTREME = 12.0
"""A log odds of a pair beyond this is an estimate running away: one win in 160 000."""

STEPS = 30
CLOSE = 1e-9
RIDGE, LOOSE = 1e-10, 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class BradleyTerry:
    """A fitted Bradley-Terry model.

    Parameters
    ----------
    fixed : DataFrame, indexed by item
        ``estimate``, the ability as log odds against the reference (whose row is 0); ``se``; ``z`` and ``p``,
        Wald, two-sided; ``low`` and ``high``, the 95 % interval. With an order effect a last row ``order``:
        log odds of the first presented against an equal.
    deviance : float
        Against the model that fits every row of counts.
    df : int
        Its degrees of freedom.
    log_likelihood : float
        Binomial, constants included.
    reference : str
        The item with ability 0.
    n_comparisons, n_ties : int
        Comparisons, and how many of them were ties.
    uncertainty : str
        Where the errors come from.
    notes : tuple of str
        What is to be read with care, one sentence each.
    """

    fixed: DataFrame
    deviance: float
    df: int
    log_likelihood: float
    reference: str
    n_comparisons: float
    n_ties: int
    uncertainty: str
    notes: tuple[str, ...] = ()


def bradley_terry(
    pairs: DataFrame,
    *,
    reference: str | None = None,
    order_effect: bool = False,
    ties: str = "refuse",
    prior: float = 0,
) -> BradleyTerry:
    """Fit a Bradley-Terry model to paired comparisons.

    Parameters
    ----------
    pairs : DataFrame
        Trials, with the columns ``first``, ``second`` and ``winner``; or counts, whose first two columns name
        the pair and whose next two count the wins of each. First is what was presented first. Where that is not
        known: trials with ``winner`` and ``loser``, or a square table of the wins of rows over columns.
    reference : str, optional
        The item with ability 0; the first by alphabet if not given.
    order_effect : bool
        Whether being presented first may help, equally for all.
    ties : str
        ``refuse`` trials without a winner, or count ``half`` a win for each.
    prior : float
        Wins added to both sides of every row; 0 for maximum likelihood. With 0.5 an item that always won has
        a finite, shrunken ability.

    Returns
    -------
    BradleyTerry
        Abilities, errors and fit.

    Raises
    ------
    ValueError
        If the table is not as it must be, the reference is unknown, items were never compared with each other
        even through others, or one or more always won or lost (separation), which leaves no finite estimate.

    Notes
    -----
    Model: P(i beats j) = 1 / (1 + exp(-(λ_i - λ_j + o))), comparisons independent; o is the order effect, for
    i presented first. It is a binomial regression without intercept on ±1 contrasts, fitted by statsmodels'
    GLM. Estimates are finite exactly if, however the items are parted in two, each part won against the other
    (Ford 1957), which is checked before fitting. Half wins for ties keep the estimates sensible, but errors
    are then those of as many decided comparisons. Comparisons of one rater are not independent: the errors
    here are too small for a panel, and `bradley_terry_by_rater` is for conclusions.

    No section of the report uses it: a protocol of feel321 that asks which of two is better does not exist, and
    dissimilarities and ABX trials name no winner. It is for tables of preferences from elsewhere.

    References
    ----------
    Bradley & Terry (1952), Biometrika 39, 324-345, doi 10.1093/biomet/39.3-4.324.
    Ford (1957), Am. Math. Monthly 64, 28-33, doi 10.1080/00029890.1957.11989117.
    Turner & Firth (2012), J. Stat. Softw. 48(9), doi 10.18637/jss.v048.i09.

    Examples
    --------
    >>> import pandas as pd
    >>> pairs = pd.DataFrame({"a": ["dft321", "dft321", "pca321"], "b": ["pca321", "sax321", "sax321"],
    ...     "wins_a": [14, 18, 13], "wins_b": [6, 2, 7]})
    >>> result = bradley_terry(pairs)
    >>> result.fixed[["estimate", "se"]].round(2)
            estimate    se
    dft321      0.00  0.00
    pca321     -1.04  0.43
    sax321     -1.83  0.48
    """
    duels = count_duels(pairs, ties=ties)
    base = _find_reference(duels, reference)
    if not 0 <= prior < np.inf:
        raise ValueError(f"prior: got {prior}, allowed is 0 or more; 0.5 is usual")
    wins = duels.wins + prior
    _check_separation(duels, wins)
    design, names = _build_design(duels, base, order_effect=order_effect)
    fit = _fit_glm(wins, design, names=names)
    fixed = _tabulate(fit.params, fit.bse, names=names, reference=duels.items[base])
    return BradleyTerry(
        fixed=fixed,
        deviance=float(fit.deviance),
        df=int(fit.df_resid),
        log_likelihood=float(fit.llf),
        reference=duels.items[base],
        n_comparisons=float(duels.wins.sum()),
        n_ties=duels.n_ties,
        uncertainty="95 % Wald interval, comparisons taken for independent",
        notes=_explain(duels, prior),
    )


def bradley_terry_by_rater(
    trials: DataFrame,
    *,
    rater: str = "participant",
    reference: str | None = None,
    order_effect: bool = False,
    draws: int = 1000,
    rng: np.random.Generator,
) -> BradleyTerry:
    """Fit a Bradley-Terry model whose errors come from drawing raters anew.

    Parameters
    ----------
    trials : DataFrame
        As for `bradley_terry`, in either form, with a column that names the rater. Ties count half.
    rater : str
        That column.
    reference : str, optional
        As for `bradley_terry`.
    order_effect : bool
        As for `bradley_terry`.
    draws : int
        Number of bootstrap draws, at least 2.
    rng : Generator
        Source of randomness.

    Returns
    -------
    BradleyTerry
        The same estimates; ``se`` from the draws, and with it ``z``, ``p`` (on raters - 1 degrees of freedom)
        and the interval.

    Raises
    ------
    ValueError
        As for `bradley_terry`, or if the column is missing or names fewer than two raters.

    Notes
    -----
    With U raters and λ* an ability in a draw, se = √(U/(U - 1)) SD(λ*) and the interval is λ ± t(.975, U - 1)
    se. Draws in which an item always wins or loses, or meets no other, have no estimate; where they are more than
    a tenth, there is no interval, and a note says so. The comparisons' stimuli are taken as the only ones.

    Examples
    --------
    >>> import pandas as pd
    >>> rng = np.random.default_rng(1)
    >>> trials = pd.DataFrame({"first": ["x", "y"] * 40, "second": ["y", "x"] * 40,
    ...     "winner": rng.choice(["x", "y"], 80, p=[0.7, 0.3]), "participant": np.arange(80) // 10})
    >>> fixed = bradley_terry_by_rater(trials, draws=200, rng=rng).fixed
    >>> bool(fixed.loc["y", "high"] < 0)
    True
    """
    if draws < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(
            f"draws: got {draws}, allowed is 2 or more; use 1000 for results to be published"
        )
    people = _read_raters(trials, rater)
    judgements = trials.drop(columns=rater)
    result = bradley_terry(judgements, reference=reference, order_effect=order_effect, ties="half")
    drawn = _draw_abilities(
        judgements, people, result, order_effect=order_effect, draws=draws, rng=rng
    )
    n_raters = int(people.max()) + 1
    margins = np.array([bootstrap_margin(column, n_raters) for column in drawn.T])
    fixed = _replace_errors(result.fixed, margins, n_raters)
    lost = int(np.isnan(drawn).any(axis=1).sum())
    left_out = f"In {lost} of {draws} draws an item always won or lost, or met no other; they are left out."
    notes = [left_out] if lost else []
    if np.isnan(margins).any():
        few = "too many draws have no estimate; ask for more comparisons per rater"
        alike = "all draws gave the same, so that nothing tells how raters differ"
        notes.append(f"No interval: {few if lost > MOST_UNDEFINED * draws else alike}.")
    return BradleyTerry(
        fixed=fixed,
        deviance=result.deviance,
        df=result.df,
        log_likelihood=result.log_likelihood,
        reference=result.reference,
        n_comparisons=result.n_comparisons,
        n_ties=result.n_ties,
        uncertainty="95 % bootstrap interval over raters",
        notes=(*result.notes, *notes),
    )


def _find_reference(duels: Duels, reference: str | None) -> int:
    if reference is None:
        return 0
    name = str(reference)  # items are names, even where a table holds numbers
    if name not in duels.items:
        raise ValueError(
            f"reference: got {reference!r}, allowed is one of {', '.join(duels.items)}"
        )
    return duels.items.index(name)


def _check_separation(duels: Duels, wins: Values) -> None:
    from scipy.sparse.csgraph import connected_components

    beat = np.zeros((len(duels.items), len(duels.items)))
    np.add.at(beat, (duels.first, duels.second), wins[:, 0])
    np.add.at(beat, (duels.second, duels.first), wins[:, 1])
    n_apart, label = connected_components(beat, directed=False)
    if n_apart > 1:
        one, other = (_name(duels, label == number) for number in range(2))
        raise ValueError(
            f"pairs: got {one} never compared with {other}, even through others; fit them apart"
        )
    n_parts, label = connected_components(beat, connection="strong")
    # The smallest part that always won, or lost, is the one to name.
    for inside in (
        label == number for number in np.argsort(np.bincount(label), kind="stable") if n_parts > 1
    ):
        never_lost = not beat[np.ix_(~inside, inside)].any()
        if never_lost or not beat[np.ix_(inside, ~inside)].any():
            always = f"{_name(duels, inside)} always {'won' if never_lost else 'lost'} against all others"
            raise ValueError(
                f"pairs: got separation, {always}: no finite estimate; gather more comparisons, or use prior=0.5"
            )


def _name(duels: Duels, chosen: NDArray[np.bool_]) -> str:
    return " and ".join(
        f"'{item}'" for item, taken in zip(duels.items, chosen, strict=True) if taken
    )


def _build_design(duels: Duels, base: int, *, order_effect: bool) -> tuple[Values, list[str]]:
    names = [item for number, item in enumerate(duels.items) if number != base]
    design = np.delete(duels.contrasts(), base, axis=1)
    if not order_effect:
        return design, names
    if ORDER in duels.items:
        raise ValueError(
            f"pairs: got an item named '{ORDER}', which is the name of the order effect; rename it"
        )
    if not duels.ordered:
        raise ValueError(
            "order_effect: got pairs that do not say which was presented first; leave it out"
        )
    design = np.column_stack([design, np.ones(len(design))])
    if np.linalg.matrix_rank(design) < design.shape[1]:
        raise ValueError(
            "order_effect: got pairs always presented in one order, from which it cannot be told; leave it out"
        )
    return design, [*names, ORDER]


def _fit_glm(wins: Values, design: Values, *, names: list[str]) -> Any:  # noqa: ANN401 - statsmodels has no types
    import warnings

    import statsmodels.api as sm
    from statsmodels.tools.sm_exceptions import PerfectSeparationWarning

    # A model that fits every row has no degrees of freedom left, by which statsmodels then divides.
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
        # A model that fits every row is no separation.
        warnings.simplefilter("ignore", PerfectSeparationWarning)
        fit = sm.GLM(wins, design, family=sm.families.Binomial()).fit(tol=1e-12, maxiter=200)
    # Of a pair that met: along a chain of pairs, abilities may be far apart and yet well known.
    if np.abs(design @ fit.params).max() > EXTREME:
        worst = names[int(np.abs(fit.params).argmax())]
        raise ValueError(
            f"pairs: got separation, the estimate of '{worst}' runs away; use prior=0.5"
        )
    return fit


def _tabulate(
    estimates: ArrayLike, errors: ArrayLike, *, names: list[str], reference: str
) -> DataFrame:
    from pandas import DataFrame
    from scipy.stats import norm

    fixed = DataFrame({"estimate": estimates, "se": errors}, index=names)
    margin = float(norm.ppf((1 + CONFIDENCE) / 2)) * fixed["se"]
    fixed["z"] = fixed["estimate"] / fixed["se"]
    fixed["p"] = 2 * norm.sf(np.abs(fixed["z"]))
    fixed["low"], fixed["high"] = fixed["estimate"] - margin, fixed["estimate"] + margin
    fixed.loc[reference] = [0.0, 0.0, np.nan, np.nan, 0.0, 0.0]
    items = sorted(name for name in fixed.index if name != ORDER)
    return fixed.loc[[*items, *(name for name in fixed.index if name == ORDER)]]


def _explain(duels: Duels, prior: float) -> tuple[str, ...]:
    ties = [f"{duels.n_ties} ties count half a win for each."] if duels.n_ties else []
    added = (
        [f"{prior:g} wins are added to both sides of every row; abilities are shrunken."]
        if prior
        else []
    )
    return (*ties, *added)


def _read_raters(trials: DataFrame, rater: str) -> NDArray[np.intp]:
    from pandas import factorize

    if rater not in trials:
        raise ValueError(f"trials: column {rater} is missing; name the raters' column with rater=")
    people = factorize(trials[rater])[0]
    if (people < 0).any():
        raise ValueError(
            f"trials: got {int((people < 0).sum())} rows without a {rater}; name or leave them out"
        )
    if people.max() < 1:
        raise ValueError("trials: got one rater, allowed is two or more; use bradley_terry")
    return people


def _draw_abilities(
    judgements: DataFrame,
    people: NDArray[np.intp],
    result: BradleyTerry,
    *,
    order_effect: bool,
    draws: int,
    rng: np.random.Generator,
) -> Values:
    """Fit every draw of raters, in the order of the table's rows without the reference."""
    items = tuple(name for name in result.fixed.index if name != ORDER)
    rows = []
    for person in range(int(people.max()) + 1):
        duels = count_duels(judgements[people == person], ties="half")
        place = np.array([items.index(item) for item in duels.items])
        tally = np.zeros((len(items), len(items), 2))
        np.add.at(tally, (place[duels.first], place[duels.second]), duels.wins)
        rows.append(tally.reshape(-1, 2))
    everyone = np.stack(rows)
    met = np.flatnonzero(everyone.sum(axis=(0, 2)))
    duels = Duels(items, met // len(items), met % len(items), everyone.sum(axis=0)[met], 0)
    design, _ = _build_design(duels, items.index(result.reference), order_effect=order_effect)
    weights = draw_counts(len(rows), draws, rng=rng)
    return _fit_many(np.einsum("dr,rps->dps", weights, everyone[:, met]), design)


def _fit_many(wins: Values, design: Values) -> Values:
    """Newton's method on all draws at once; NaN where the estimate runs away."""
    first, met = wins[..., 0], wins.sum(axis=-1)
    beta = np.zeros((len(wins), design.shape[1]))
    ridge = RIDGE * np.eye(design.shape[1])  # a draw without a pair must not stop the others
    for _ in range(STEPS):
        chance = 1 / (1 + np.exp(-np.clip(beta @ design.T, -2 * EXTREME, 2 * EXTREME)))
        slope = (first - met * chance) @ design
        curvature = np.einsum("dp,pi,pj->dij", met * chance * (1 - chance), design, design) + ridge
        step = np.linalg.solve(curvature, slope[..., None])[..., 0]
        beta += np.clip(step, -2, 2)
        if np.abs(step).max() < CLOSE:
            break
    astray = (np.abs(np.where(met > 0, beta @ design.T, 0)) > EXTREME).any(axis=1)
    # Items that nothing in a draw ties to the reference would stay at 0: the ridge alone holds them.
    loose = np.linalg.eigvalsh(curvature)[:, 0] < LOOSE
    beta[astray | loose | (np.abs(step) > CLOSE**0.5).any(axis=1)] = np.nan
    return beta


def _replace_errors(fixed: DataFrame, margins: Values, n_raters: int) -> DataFrame:
    from scipy.stats import t

    table = fixed.copy()
    rows = table["se"] > 0
    error = margins / float(t.ppf((1 + CONFIDENCE) / 2, n_raters - 1))
    estimate = table.loc[rows, "estimate"]
    table.loc[rows, "se"], table.loc[rows, "z"] = error, estimate / error
    table.loc[rows, "p"] = 2 * t.sf(np.abs(estimate / error), n_raters - 1)
    table.loc[rows, "low"], table.loc[rows, "high"] = estimate - margins, estimate + margins
    return table
