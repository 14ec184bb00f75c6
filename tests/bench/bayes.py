"""How good the Bayesian counterpart is: coverage of planted slopes, and ranks of prior draws among posterior draws.

Run as: python tests/bench/bayes.py coverage|ranks N. Prints a line for each study, and a summary.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import pandas as pd
from scipy.stats import kstest
from threadpoolctl import threadpool_limits

from feel321.analysis.primary import posterior
from feel321.analysis.primary.plan import make_cells, plan_terms

PEOPLE, RECORDINGS, REDUCERS = 8, 4, 4
SLOPE_SD, SPREAD = 20.0, 10.0
DRAWS = 300


def draw_frame(rng: np.random.Generator) -> pd.DataFrame:
    """Draw the metrics of a complete study, which tell reducers apart; everybody rates everything once."""
    who, where, how = (one.ravel() for one in np.indices((PEOPLE, RECORDINGS, REDUCERS)))
    levels = rng.uniform(size=(2, REDUCERS))
    values = levels[:, None, :] + rng.normal(0, 0.25, (2, RECORDINGS, REDUCERS))
    return pd.DataFrame({
        "participant": who, "recording": where, "reducer": how, "item": where * REDUCERS + how,
        "first": values[0][where, how], "second": values[1][where, how], "rating": rng.normal(50, 1, len(who)),
    })  # fmt: skip


def draw_ratings(
    prepared: posterior.Prepared, sds: np.ndarray, fixed: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw ratings from the model itself, people by stimuli."""
    layout, size = prepared.layout, len(prepared.layout.fixed)
    eye = 1e-9 * np.eye(size)
    variances = sds**2
    own = np.tensordot(variances[: len(layout.own)], layout.own, 1) + variances[-1] * np.eye(size)
    shared = np.tensordot(variances[len(layout.own) : -1], layout.shared, 1) + eye
    common = layout.fixed @ fixed + np.linalg.cholesky(shared) @ rng.standard_normal(size)
    people = rng.standard_normal((PEOPLE, size)) @ np.linalg.cholesky(own + eye).T
    return common + people


def main(what: str, number: int) -> None:
    """Fit so many studies."""
    sampler, ranks, inside, gates = None, [], [], []
    for seed in range(number):
        rng, begun = np.random.default_rng([321, seed]), time.process_time()
        frame = draw_frame(rng)
        cells = make_cells(frame, ["first", "second"])
        prepared = posterior.prepare(cells, plan_terms(cells, correlated=False, reducers=True))
        effects = prepared.layout.fixed.shape[1]
        scales = np.array([50.0, *[SLOPE_SD] * (effects - 1)])
        priors = np.full(len(prepared.names), SPREAD)
        sds = np.full(len(priors), 5.0) if what == "coverage" else np.abs(rng.normal(0, priors))
        fixed = np.array([0.0, 20.0, 0.0]) if what == "coverage" else rng.normal(0, scales[:3])
        fixed = np.concatenate([fixed, np.zeros(effects - 3)])
        if what != "coverage":
            fixed[3:] = rng.normal(0, scales[3:])
        ratings = 50 + draw_ratings(prepared, sds, fixed, rng)
        cells = make_cells(
            frame.assign(rating=ratings[frame["participant"], frame["item"]]), ["first", "second"]
        )
        layout = posterior.prepare(cells, plan_terms(cells, correlated=False, reducers=True)).layout
        sampler = sampler or posterior.Sampler(draws=DRAWS, chains=2)
        found = sampler.sample(layout, scales, priors, rng=rng)
        slopes = found.fixed[..., 1:3].reshape(-1, 2)[::3]
        ranks.append((slopes < fixed[1:3]).mean(axis=0))
        low, high = np.quantile(slopes, (0.025, 0.975), axis=0)
        inside.append((low <= fixed[1:3]) & (fixed[1:3] <= high))
        gates.append((found.rhat, found.ess, found.divergences))
        print(
            seed,
            ranks[-1],
            inside[-1],
            gates[-1],
            f"{time.process_time() - begun:.1f} s",
            flush=True,
        )
    p = [float(kstest([one[place] for one in ranks], "uniform").pvalue) for place in range(2)]
    share = np.mean(inside, axis=0)
    print(
        what,
        number,
        "coverage",
        share,
        "ranks uniform, KS p",
        p,
        "worst gates",
        np.max(gates, axis=0),
        np.min(gates, axis=0),
    )


if __name__ == "__main__":
    with threadpool_limits(limits=1, user_api="blas"):
        main(sys.argv[1], int(sys.argv[2]))
