from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.figures.delivered import draw_delivered

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

METRICS = ("spectral_match", "temporal_match", "spectral_match_bounded")


@pytest.mark.parametrize("n", range(4))
def test_nothing_is_outside_or_over_another(
    faults: Callable[[Figure], list[str]], names: list[str], n: int
) -> None:
    rng = np.random.default_rng(n)
    items = pd.DataFrame({"reducer": names})
    for name in METRICS:
        items[name] = rng.uniform(-3, 1, len(names))
        items[f"{name}_delivered"] = items[name] - 0.1
    errors_db = rng.normal(0, 1, 0 if n == len(METRICS) else 500)
    figure = draw_delivered(items, METRICS[:n], errors_db)
    assert faults(figure) == []
    assert len(figure.axes) == n + bool(len(errors_db))
