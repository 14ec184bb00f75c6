"""2 000 studies of three designs: the quick engine, `fit_primary` and the closed form say the same."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.power import simulate
from feel321.analysis.power.draw import Scenario, draw_ratings, tabulate_ratings
from feel321.analysis.power.find import Shares, find_power, find_share
from feel321.analysis.primary.model import adjust_holm, fit_primary

if TYPE_CHECKING:
    from collections.abc import Callable

STUDIES = 2000
DESIGNS = {
    "12 people, 6 x 6": ((6, 6), {"participants": 12, "repeats": 2, "slopes": {"spectral": 40.0}}),
    "20 people, 10 x 10 x 2": ((10, 10), {"participants": 20, "repeats": 2, "slopes": {"spectral": 20.0}}),
    "30 people, 8 of 10 x 5 of 6": (
        (10, 6), {"participants": 30, "recordings": 8, "reducers": 5, "slopes": {"spectral": 30.0}},
    ),
}  # fmt: skip


def fit_whole(scenario: Scenario, place: int) -> np.ndarray:
    """Draw the study that has this place as `simulate_chunk` does, and fit it by `fit_primary`."""
    rng = np.random.default_rng([0, simulate.find_key(scenario.design), place])
    stimuli = scenario.draw(rng)
    ratings, _ = draw_ratings(scenario, stimuli, rng)
    metrics = scenario.design.metrics
    table = tabulate_ratings(stimuli, ratings[0], metrics)
    slopes = fit_primary(table, metrics, explain=False).slopes
    return slopes[["estimate", "se", "df", "p", "low", "high"]].to_numpy()


@pytest.mark.soak
@pytest.mark.parametrize("name", DESIGNS)
def test_power_by_three_ways(make_scenario: Callable[..., Scenario], name: str) -> None:
    own, changes = DESIGNS[name]
    case = make_scenario(own, **changes)
    whole = np.array([fit_whole(case, place) for place in range(STUDIES)])
    quick = simulate.simulate_studies(case.design, case.truth, studies=STUDIES)
    shares, power = Shares(quick, case.design), find_power(case.design, case.truth, studies=0)
    fitted = quick.tests[:, 0, 0, :2]
    apart = np.abs(whole[:, :, 1:3] / fitted[..., 1:] - 1).max(axis=(0, 1))
    holm = np.array([adjust_holm(row) for row in whole[..., 3].tolist()])
    theirs, ours = holm < 0.05, shares.holm[:, 0, 0] < 0.05
    known = np.isfinite(holm)
    kept = quick.kept[:, 0, :2]
    inside = (whole[..., 4] <= kept) & (kept <= whole[..., 5])
    for place, metric in enumerate(case.design.metrics):
        row = power.table.loc[place]
        full = find_share(theirs[:, place], known[:, place])
        print(  # noqa: T201 - the figures
            f"{name}, {metric}: power closed {row['power']:.3f}, full {full.share:.3f} "
            f"({full.low:.3f} to {full.high:.3f}), quick {ours[:, place].mean():.3f}; "
            f"coverage {inside[:, place].mean():.3f}; width closed {row['width']:.1f}, full "
            f"{np.median(whole[:, place, 5] - whole[:, place, 4]):.1f}; false positives "
            f"{(shares.p[:, 1, 0, place] < 0.05).mean():.3f}; verdicts apart "
            f"{(theirs != ours)[:, place].sum()}; se and df apart {apart}; {dict(quick.counts)}",
            flush=True,
        )  # fmt: skip
        assert full.low - 0.06 < row["power"] < full.high + 0.06
    assert (theirs == ours).all()
    assert (apart < 1e-4).all()
    assert (inside.mean(axis=0) > 0.92).all()
    assert (shares.p[:, 1, 0, :2] < 0.05).mean() < 0.08
