"""The posterior of the primary model: everything but the standard deviations is integrated out.

Ratings, slopes and all random effects are normal given the standard deviations, so the likelihood of these alone is
known, and NUTS draws a dozen numbers instead of a thousand. All fixed effects and some random ones are the same for
everyone: together a vector u over stimuli, u ~ N(0, B). The others are a person's own: y_p = u + e_p, e_p ~ N(0, A_p).
People who rated the same stimuli equally often share A. With Λ the sum of A_p⁻¹, h the sum of A_p⁻¹ y_p and B = LLᵀ::

    -2 log p(y) = Σ log|A_p| + Σ y_pᵀ A_p⁻¹ y_p + log|I + LᵀΛL| - hᵀ L (I + LᵀΛL)⁻¹ Lᵀ h + constant

Slopes are then drawn exactly, from their normal distribution given each draw of the standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321.analysis.primary.plan import ITEM, RATING, WHO

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from feel321.analysis.primary.plan import Cells, Terms

    Array = NDArray[np.float64]

JITTER = 1e-6
"""Added to the variance between stimuli, in points squared, so that it can always be factored."""

MIDDLE = 50.0
"""Mean of the prior of the intercept, in points."""

RESIDUAL = "residual"

ACCEPT = 0.9
"""Share of proposals that NUTS is tuned to accept."""


class Patterns(NamedTuple):
    """Ratings by pattern: people who rated the same stimuli equally often. Stimuli that a pattern lacks count as zero.

    there, counts: (patterns, stimuli); people: in each; sums: of their ratings, centred; products: of ratings with
    ratings, (patterns, stimuli, stimuli); spread, spare: squares within cells, and how many, where cells have repeats.
    """

    there: Any
    counts: Any
    people: Any
    sums: Any
    products: Any
    spread: Any
    spare: Any


class Layout(NamedTuple):
    """What the likelihood is made of, as arrays.

    own, shared: matrices over stimuli that a variance of people's own, or of everyone's, is multiplied with; fixed:
    columns of the fixed effects.
    """

    own: Any
    shared: Any
    fixed: Any
    patterns: Patterns


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A model made ready; names: of the standard deviations, people's own first, then everyone's, then the residual."""

    layout: Layout
    names: tuple[str, ...]


def prepare(cells: Cells, terms: Terms) -> Prepared:
    """Lay out ratings and matrices of the model that was planned."""
    items = cells.table.drop_duplicates(ITEM).reset_index(drop=True)
    own: dict[str, Array] = {}
    shared: dict[str, Array] = {}
    for term in terms.random:
        inner, _, group = term.strip("()").partition("||" if "||" in term else "|")
        parts = [part.strip() for part in group.strip().split(":")]
        if WHO not in parts:
            shared[":".join(parts)] = _compare_levels(items, parts)
        elif len(parts) > 1:
            own[":".join(parts)] = _compare_levels(items, [part for part in parts if part != WHO])
        else:
            own |= _list_slopes(items, [part.strip(" `") for part in inner.split("+")])
    fixed = np.column_stack([np.ones(len(items)), *(items[name] for name in terms.fixed)])
    size = len(items)
    layout = Layout(
        np.array([*own.values()]).reshape(-1, size, size), np.array([*shared.values()]).reshape(-1, size, size),
        fixed, _gather_patterns(cells, items[ITEM].tolist()),
    )  # fmt: skip
    return Prepared(layout, (*own, *shared, RESIDUAL))


def _compare_levels(items: Any, columns: list[str]) -> Array:  # noqa: ANN401 - a table of pandas
    """Mark which stimuli share a level."""
    codes = items.groupby(columns, observed=True).ngroup().to_numpy()
    same: Array = (codes[:, None] == codes).astype(np.float64)
    return same


def _list_slopes(items: Any, names: list[str]) -> dict[str, Array]:  # noqa: ANN401 - a table of pandas
    found = {}
    for name in names:
        values = np.ones(len(items)) if name == "1" else items[name].to_numpy(np.float64)
        found[WHO if name == "1" else f"{WHO}:{name}"] = np.outer(values, values)
    return found


def _gather_patterns(cells: Cells, items: list[Any]) -> Patterns:
    """Gather the ratings of people who rated the same stimuli equally often."""
    groups = cells.table.groupby([WHO, ITEM], observed=True)[RATING]
    means = groups.mean().unstack().reindex(columns=items).to_numpy()
    counts = groups.size().unstack(fill_value=0).reindex(columns=items).to_numpy(np.float64)
    centred = np.nan_to_num(means - MIDDLE)
    kinds, which = np.unique(counts, axis=0, return_inverse=True)
    own = [centred[which.ravel() == kind] for kind in range(len(kinds))]
    within = cells.table[RATING] - groups.transform("mean")
    return Patterns(
        (kinds > 0).astype(np.float64), np.maximum(kinds, 1.0), np.array([float(len(one)) for one in own]),
        np.array([one.sum(axis=0) for one in own]), np.array([one.T @ one for one in own]),
        float((within**2).sum()), float((counts[counts > 0] - 1).sum()),
    )  # fmt: skip


def log_likelihood(sds: Any, layout: Layout, scales: Any) -> Any:  # noqa: ANN401 - arrays of jax
    """Find the log likelihood of standard deviations, but for a constant."""
    import jax.numpy as jnp
    from jax.scipy.linalg import solve_triangular

    data, told = layout.patterns, _reduce(sds, layout, scales)
    logs = jnp.log(jnp.diagonal(told.roots, axis1=1, axis2=2)).sum(axis=1)
    fitted = solve_triangular(told.inner, told.lower.T @ told.pull, lower=True)
    twice = 2 * (data.people * logs).sum() + (told.inverse * data.products).sum()
    twice += 2 * jnp.log(jnp.diagonal(told.inner)).sum() - fitted @ fitted
    # Squares within cells of unequal repeats know of the residual alone.
    twice += data.spread / jnp.square(sds[-1]) + 2 * data.spare * jnp.log(jnp.abs(sds[-1]))
    return -twice / 2


def find_fixed(sds: Any, layout: Layout, scales: Any) -> Any:  # noqa: ANN401 - arrays of jax
    """Find mean and covariance of the fixed effects given standard deviations."""
    import jax.numpy as jnp
    from jax.scipy.linalg import cho_solve

    told = _reduce(sds, layout, scales)
    left = told.lower @ cho_solve((told.inner, True), told.lower.T)
    weights = jnp.square(scales)[:, None] * layout.fixed.T
    mean = weights @ (told.pull - told.precision @ (left @ told.pull))
    spread = told.precision - told.precision @ left @ told.precision
    return mean, jnp.diag(jnp.square(scales)) - weights @ spread @ weights.T


class _Reduced(NamedTuple):
    """L, the factors and inverses of A by pattern, Λ, h, and the factor of I + LᵀΛL."""

    lower: Any
    roots: Any
    inverse: Any
    precision: Any
    pull: Any
    inner: Any


def _reduce(sds: Any, layout: Layout, scales: Any) -> _Reduced:  # noqa: ANN401 - arrays of jax
    import jax.numpy as jnp
    from jax.scipy.linalg import cho_solve

    data = layout.patterns
    lower, roots, both = _factor(sds, layout, scales)
    eye = jnp.broadcast_to(jnp.eye(roots.shape[-1]), roots.shape)
    inverse = cho_solve((roots, True), eye) * both
    precision = jnp.tensordot(data.people, inverse, 1)
    inner = jnp.linalg.cholesky(jnp.eye(len(lower)) + lower.T @ precision @ lower)
    return _Reduced(
        lower, roots, inverse, precision, jnp.einsum("kij,kj->i", inverse, data.sums), inner
    )


def _factor(sds: Any, layout: Layout, scales: Any) -> Any:  # noqa: ANN401 - arrays of jax
    import jax.numpy as jnp

    variances, data, n_own = jnp.square(sds), layout.patterns, len(layout.own)
    own = jnp.tensordot(variances[:n_own], layout.own, 1)
    shared = jnp.tensordot(variances[n_own:-1], layout.shared, 1)
    shared += (layout.fixed * jnp.square(scales)) @ layout.fixed.T
    lower = jnp.linalg.cholesky(shared + JITTER * jnp.eye(len(shared)))
    # A stimulus that a pattern lacks has variance 1 there and shares nothing: it adds nothing.
    both = data.there[:, :, None] * data.there[:, None, :]
    noise = jnp.where(data.there > 0, variances[-1] / data.counts, 1.0)
    roots = jnp.linalg.cholesky(both * own + noise[:, :, None] * jnp.eye(len(own)))
    return lower, roots, both


@dataclass(frozen=True, slots=True)
class Sampled:
    """Draws by chain: standard deviations (chains, draws, sds), fixed effects (chains, draws, effects); and gates."""

    sds: Array
    fixed: Array
    rhat: float
    ess: float
    divergences: int


class Sampler:
    """NUTS for one layout of a model, compiled once for all data of its shape."""

    def __init__(self, *, draws: int, chains: int, warmup: int = 500) -> None:
        """Make the sampler; draws and warmup: of each chain."""
        import jax
        import jax.numpy as jnp
        from numpyro import distributions, factor, infer, sample

        with jax.enable_x64(True):  # noqa: FBT003 - the only form that it has

            def model(layout: Layout, scales: Any, priors: Any) -> None:  # noqa: ANN401 - arrays of jax
                # A half-normal, reflected: variances are smooth where a spread is nearly zero, logarithms are not.
                signs = sample("sds", distributions.Normal(0.0, jnp.ones_like(priors)).to_event(1))
                sds = priors * signs
                factor("ratings", log_likelihood(sds, layout, scales))

            kernel = infer.NUTS(
                model, target_accept_prob=ACCEPT, init_strategy=infer.init_to_median
            )
            self._mcmc = infer.MCMC(
                kernel, num_warmup=warmup, num_samples=draws, num_chains=chains,
                chain_method="sequential", progress_bar=False, jit_model_args=True,
            )  # fmt: skip
            self._fixed = jax.jit(jax.vmap(find_fixed, in_axes=(0, None, None)))

    def sample(
        self, layout: Layout, scales: Array, priors: Array, *, rng: np.random.Generator
    ) -> Sampled:
        """Draw from the posterior; scales: of the normal priors of fixed effects; priors: of the half-normal ones."""
        import jax
        from numpyro import diagnostics

        with jax.enable_x64(True):  # noqa: FBT003 - the only form that it has
            own = jax.tree.map(jax.numpy.asarray, layout)
            key = jax.random.PRNGKey(int(rng.integers(2**31)))
            self._mcmc.run(key, own, scales, priors, extra_fields=("diverging", "num_steps"))
            sds = np.abs(np.asarray(self._mcmc.get_samples(group_by_chain=True)["sds"])) * priors
            diverging = int(np.asarray(self._mcmc.get_extra_fields()["diverging"]).sum())
            flat = sds.reshape(-1, sds.shape[-1])
            means, spreads = map(np.asarray, self._fixed(flat, own, scales))
        fixed = _draw_fixed(means, spreads, rng).reshape(*sds.shape[:2], -1)
        both = np.moveaxis(np.concatenate([sds, fixed], axis=2), 2, 0)
        rhat = max(float(diagnostics.split_gelman_rubin(one)) for one in both)
        ess = min(float(diagnostics.effective_sample_size(one)) for one in both)
        return Sampled(sds, fixed, rhat, ess, diverging)


def _draw_fixed(means: Array, spreads: Array, rng: np.random.Generator) -> Array:
    """Draw fixed effects from their normal distribution given each draw of the standard deviations."""
    roots = np.linalg.cholesky((spreads + np.swapaxes(spreads, 1, 2)) / 2)
    fixed: Array = means + np.einsum("tij,tj->ti", roots, rng.standard_normal(means.shape))
    fixed[:, 0] += MIDDLE
    return fixed
