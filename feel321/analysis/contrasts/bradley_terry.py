"""Which of several would win a comparison, and by how much? The Bradley-Terry model of paired choices.

Conventions: a row is a pair in the order in which it was presented. Three forms are understood: trials, with the
columns ``first``, ``second`` and ``winner``; counts, whose first two columns name the pair and whose next two count
the wins of each; and, without an order of presentation, trials with the columns ``winner`` and ``loser``.
"""

import numpy as np
from numpy.typing import NDArray
from pandas import DataFrame
from scipy.special import gammaln, log_expit, xlogy
from scipy.stats import t

from feel321.analysis.arrays import UPPER, Values, check_columns, check_draws, read_groups
from feel321.analysis.resampling import MOST_UNDEFINED, bootstrap_margin, draw_counts
from feel321.arguments import as_rng, check_name
from feel321.records import Statistic
from feel321.types import Rng

Names = NDArray[np.str_]
Codes = NDArray[np.intp]

TRIAL = ("first", "second", "winner")
TIES = ("refuse", "half")
COUNTED = 4  # Columns of a table of counts
ORDER = "order"  # The term of being presented first
EXTREME = 12.0  # A log odds of a pair beyond this is an estimate running away: one win in 160 000
STEPS = 60
CLOSE = 1e-9
RIDGE, LOOSE = 1e-10, 1e-9


def bradley_terry(  # noqa: PLR0913 - the model's options, and those of its bootstrap
    pairs: DataFrame,
    *,
    reference: str | None = None,
    order_effect: bool = False,
    ties: str = "refuse",
    prior: float = 0,
    by_rater: bool | str = False,
    draws: int = 1000,
    rng: Rng = 0,
) -> Statistic:
    """Fit a Bradley-Terry model to paired comparisons.

    Parameters
    ----------
    pairs : DataFrame
        Trials, with the columns ``first``, ``second`` and ``winner``; or counts, whose first two columns name
        the pair and whose next two count the wins of each. First is what was presented first. Where that is not
        known: trials with ``winner`` and ``loser``.
    reference : str, optional
        The item with ability 0; the first by alphabet if not given.
    order_effect : bool
        Whether being presented first may help, equally for all.
    ties : str
        ``refuse`` trials without a winner, or count ``half`` a win for each; half by rater.
    prior : float
        Wins added to both sides of every row; 0 for maximum likelihood. With 0.5 an item that always won has
        a finite, shrunken ability.
    by_rater : bool or str
        Whether the errors come from drawing raters anew: True for those of the column ``participant``, or a column.
    draws : int
        Number of draws of raters, at least 2.
    rng : int or Generator
        Seed, or source of randomness, of these draws.

    Returns
    -------
    Statistic
        ``fixed``, indexed by item: ``estimate``, the ability as log odds against the reference (whose row is 0),
        ``se``, ``z``, ``p``, two-sided, ``low`` and ``high``, 95 %; with an order effect a last row ``order``, the log
        odds of the first presented against an equal. ``deviance`` against the model that fits every row, ``df``,
        ``log_likelihood``, ``reference``, ``n_comparisons``, ``n_ties``, ``uncertainty`` and ``notes``.

    Notes
    -----
    Model: P(i beats j) = 1 / (1 + exp(-(λ_i - λ_j + o))), comparisons independent; o is the order effect, for
    i presented first: a binomial regression without intercept on ±1 contrasts, fitted by Newton's method. Estimates
    are finite exactly if, however the items are parted in two, each part won against the other (Ford 1957). With half
    wins for ties, errors are those of as many decided comparisons.

    Comparisons of one rater are not independent: the plain errors are too small for a panel, and those by rater are
    for conclusions. With U raters and λ* an ability in a draw, se = √(U/(U - 1)) SD(λ*) and the interval is
    λ ± t(.975, U - 1) se. Draws in which an item always wins or loses, or meets no other, have no estimate; where they
    are more than a tenth, there is no interval. These stimuli are taken as the only ones.

    References
    ----------
    Bradley & Terry (1952), doi 10.1093/biomet/39.3-4.324; Ford (1957), doi 10.1080/00029890.1957.11989117; Turner &
    Firth (2012), doi 10.18637/jss.v048.i09.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> pairs = pd.DataFrame({"a": ["dft321", "dft321", "pca321"], "b": ["pca321", "sax321", "sax321"],
    ...     "wins_a": [14, 18, 13], "wins_b": [6, 2, 7]})
    >>> result = analysis.bradley_terry(pairs)
    >>> result.fixed[["estimate", "se"]].round(2)
            estimate    se
    item
    dft321      0.00  0.00
    pca321     -1.04  0.43
    sax321     -1.83  0.48
    """
    rater = "participant" if by_rater is True else str(by_rater or "")
    people = _read_raters(pairs, rater, draws)
    if rater:
        pairs, ties = pairs.drop(columns=rater), "half"
    names, every, n_ties = _read_rows(pairs, ties=ties, ordered=order_effect)
    if not 0 <= prior < np.inf:
        raise ValueError(f"prior must be 0 or more, got {prior}; 0.5 is usual")
    kept = every.sum(axis=1) > 0  # a pair that never met says nothing
    if not kept.any():
        raise ValueError("pairs must hold a comparison or more, got no win in any row")
    items, codes = np.unique(names[kept], return_inverse=True)
    # Items are names, even where a table holds numbers.
    base = check_name(str(reference or items[0]), items.tolist(), "reference")
    codes, every = codes.reshape(-1, 2), every[kept]
    duels, row = np.unique(codes, axis=0, return_inverse=True)
    fitted, wins = codes, every
    if "winner" in pairs:
        fitted, wins = duels, _count_wins(0 * people[kept], row, every)[0]
    design, terms = _build_design(fitted, items, base, order_effect=order_effect)
    (beta,), (curvature,), (is_astray,) = _fit_many(wins[None] + prior, design)
    if is_astray:
        worst = terms[int(np.abs(beta).argmax())]
        must = "pairs must have no separation: each item must win and lose, through others at least"
        do = f"the estimate of '{worst}' runs away: gather more, or use prior=0.5"
        raise ValueError(f"{must}; {do}")
    errors, freedom = np.sqrt(np.linalg.inv(curvature).diagonal()), np.inf
    source = "95 % Wald interval, comparisons taken for independent"
    notes = [f"{n_ties} ties count half a win for each."] * bool(n_ties)
    if prior:
        notes.append(f"{prior:g} wins are added to both sides of each row: abilities are shrunken.")
    if rater:
        everyone = _count_wins(people[kept], row, every)
        source, freedom = "95 % bootstrap interval over raters", float(len(everyone) - 1)
        design_met, _ = _build_design(duels, items, base, order_effect=order_effect)
        errors, more = _bootstrap_errors(everyone, design_met, draws=draws, rng=as_rng(rng))
        notes += more
    # Against the model that fits every row, and the binomial log likelihood.
    odds, wins = design @ beta, wins + prior
    logs, met = np.stack([log_expit(odds), log_expit(-odds)], axis=1), wins.sum(axis=1)[:, None]
    deviance = 2 * float((xlogy(wins, wins / met) - wins * logs).sum())
    ways = float(gammaln(met + 1).sum() - gammaln(wins + 1).sum())
    return Statistic(
        "BradleyTerry", fixed=_tabulate(beta, errors, terms=terms, reference=base, freedom=freedom),
        deviance=max(deviance, 0.0), df=len(wins) - len(terms),
        log_likelihood=ways + float((wins * logs).sum()), reference=base,
        n_comparisons=float(every.sum()), n_ties=n_ties, uncertainty=source, notes=tuple(notes),
    )  # fmt: skip


def _count_wins(people: Codes, row: Codes, wins: Values) -> Values:
    """Count the wins of every rater in every pair, (n_raters, n_pairs, 2)."""
    found = np.zeros((int(people.max()) + 1, int(row.max()) + 1, 2))
    np.add.at(found, (people, row.ravel()), wins)
    return found


def _bootstrap_errors(
    everyone: Values, design: Values, *, draws: int, rng: np.random.Generator
) -> tuple[Values, list[str]]:
    """Compute standard errors from draws of raters, with what is to be said of them."""
    n_raters = len(everyone)
    weights = draw_counts(n_raters, draws, rng=rng)
    drawn, _, astray = _fit_many(np.einsum("dr,rps->dps", weights, everyone), design)
    drawn[astray] = np.nan
    lost, notes = int(np.isnan(drawn).any(axis=1).sum()), list[str]()
    margins = np.array([bootstrap_margin(column, n_raters) for column in drawn.T])
    if lost:
        why = "an item always won or lost, or met no other"
        notes.append(f"In {lost} of {draws} draws {why}; they are left out.")
    if np.isnan(margins).any():
        few = "too many draws have no estimate; ask for more comparisons per rater"
        alike = "all draws gave the same, so that nothing shows how raters differ"
        notes.append(f"No interval: {few if lost > MOST_UNDEFINED * draws else alike}.")
    return margins / t.ppf(UPPER, n_raters - 1), notes


def _build_design(
    codes: Codes, items: Names, base: str, *, order_effect: bool
) -> tuple[Values, list[str]]:
    """Write each pair as +1 for the first item and -1 for the second, without the reference."""
    rows, place = np.arange(len(codes)), items.tolist().index(base)
    design = np.zeros((len(rows), len(items)))
    design[rows, codes[:, 0]], design[rows, codes[:, 1]] = 1, -1
    design, terms = np.delete(design, place, axis=1), np.delete(items, place).tolist()
    if not order_effect:
        return design, terms
    if ORDER in items:
        taken = f"an item named '{ORDER}', the order effect"
        raise ValueError(f"pairs must not have {taken}; rename it")
    design = np.column_stack([design, np.ones(len(design))])
    if np.linalg.matrix_rank(design) < design.shape[1]:
        raise ValueError("order_effect needs pairs presented in both orders; leave it out")
    return design, [*terms, ORDER]


def _fit_many(wins: Values, design: Values) -> tuple[Values, Values, NDArray[np.bool_]]:
    """Run Newton's method on all draws at once: estimates, curvatures, and which run away."""
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
    return beta, curvature, astray | loose | (np.abs(step) > CLOSE**0.5).any(axis=1)


def _tabulate(
    estimates: Values, errors: Values, *, terms: list[str], reference: str, freedom: float
) -> DataFrame:
    fixed = DataFrame({"estimate": estimates, "se": errors}, index=terms).rename_axis("item")
    margin = float(t.ppf(UPPER, freedom)) * fixed["se"]
    fixed["z"] = fixed["estimate"] / fixed["se"]
    fixed["p"] = 2 * t.sf(np.abs(fixed["z"]), freedom)
    fixed["low"], fixed["high"] = fixed["estimate"] - margin, fixed["estimate"] + margin
    fixed.loc[reference] = [0.0, 0.0, np.nan, np.nan, 0.0, 0.0]
    return fixed.loc[sorted(fixed.index, key=lambda name: (name == ORDER, name))]


def _read_raters(pairs: DataFrame, rater: str, draws: int) -> Codes:
    """Read the number of every row's rater; that of one alone where none is asked for."""
    if not rater:
        return np.zeros(len(pairs), np.intp)
    check_draws(draws, usual=1000)
    check_columns(pairs, [rater], "trials")
    people, raters = read_groups(pairs[rater], n=len(pairs), what="row", of=rater, sort=False)
    if len(raters) < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError("trials must be of two raters or more, got one; leave by_rater out")
    return people


def _read_rows(pairs: DataFrame, *, ties: str, ordered: bool) -> tuple[Names, Values, int]:
    """Read paired comparisons: names and wins of both, (n_rows, 2), and how many were ties."""
    if not isinstance(pairs, DataFrame):
        got = type(pairs).__name__
        raise TypeError(f"pairs must be a pandas DataFrame, one row per pair or trial, got {got}")
    check_name(ties, TIES, "ties")
    columns = list(pairs.columns)
    if "winner" in pairs:
        columns = ["winner", "loser"] if "loser" in pairs else [*TRIAL]
        check_columns(pairs, columns, "pairs")
    elif len(columns) < COUNTED:
        must = f"the columns {', '.join(TRIAL)}, or two names and two counts"
        raise ValueError(f"pairs must have {must}, got {', '.join(columns)}")
    for column in columns[:2]:
        if missing := int(pairs[column].isna().sum()):
            got = f"got {missing} rows without a name; name or leave them out"
            raise ValueError(f"pairs must name an item in column '{column}', {got}")
    sides = [pairs[column].astype(str).to_numpy(dtype=np.str_) for column in columns[:2]]
    names = np.stack(sides, axis=1)
    if len(same := names[names[:, 0] == names[:, 1]]):
        got = f"got '{same[0, 0]}' against itself; leave such rows out"
        raise ValueError(f"pairs must be of two items, {got}")
    return _read_wins(pairs, names, ties=ties, ordered=ordered)


def _read_wins(
    pairs: DataFrame, names: Names, *, ties: str, ordered: bool
) -> tuple[Names, Values, int]:
    if "winner" not in pairs:
        counts = pairs.iloc[:, 2:COUNTED]
        try:
            wins = counts.to_numpy(dtype=np.float64)
        except (TypeError, ValueError):
            got = f"got text in columns {' and '.join(map(str, counts))}"
            raise ValueError(f"pairs must hold counts of wins, {got}") from None
        if not (np.isfinite(wins) & (wins >= 0)).all():
            got = "got a count of wins that is negative or not finite"
            raise ValueError(f"pairs must hold counts of wins from 0, {got}")
        return names, wins, 0
    if "loser" in pairs:
        if ordered:
            known = "pairs that say which was presented first"
            raise ValueError(f"order_effect needs {known}; leave it out")
        sides = np.sort(names, axis=1)
        return sides, (sides == names[:, :1]).astype(np.float64), 0
    named = pairs["winner"].astype(object).where(pairs["winner"].notna(), "tie")
    winner = named.astype(str).to_numpy(dtype=np.str_)
    wins = (names == winner[:, None]).astype(np.float64)
    undecided = ~wins.any(axis=1)
    if (strangers := winner[undecided & (winner != "tie")]).size:
        must = "the row's first or second, or 'tie', as winner"
        raise ValueError(f"pairs must have {must}, got the winner '{strangers[0]}'")
    if undecided.any() and ties == "refuse":
        how = "leave them out, or count them with ties='half'"
        raise ValueError(f"pairs must have a winner, got {int(undecided.sum())} ties; {how}")
    wins[undecided] = 0.5
    return names, wins, int(undecided.sum())
