"""METRICS: the one list of metrics, the match metrics first, then their rivals; and matches by reducer and metric."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from feel321.arguments import Registry, coerce_real, name_of
from feel321.stimuli.match import (
    spectral_match,
    spectral_match_bounded,
    temporal_match,
    temporal_match_windowed,
)
from feel321.stimuli.own_methods import find_metric
from feel321.stimuli.recording import Reduced, Signal, as_pair, check_acceleration
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.types import MATCHES, METRIC_INFO, WRITTEN, Metric, Reducer, Samples

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.stimuli.rivals import Pair


@dataclass(frozen=True, slots=True)
class RivalMetric:
    """A rival metric, which is imported when it is first called: a build without rivals needs none."""

    name: str

    @property
    def __name__(self) -> str:
        """The name."""
        return self.name

    @property
    def measure(self) -> Callable[[Pair], Samples]:
        """What measures it on pairs."""
        from feel321.stimuli.rivals import RIVALS

        return RIVALS[self.name].measure

    def __call__(
        self, acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
    ) -> float:
        """Compare three axes, (3, n), with one, (n,)."""
        from feel321.stimuli.rivals import make_pair

        return float(self.measure(make_pair(acceleration, reduced, rate_hz)))


METRICS: Registry[Metric] = Registry(
    "metric",
    {
        "spectral_match": spectral_match,
        "temporal_match": temporal_match,
        "spectral_match_bounded": spectral_match_bounded,
        "temporal_match_windowed": temporal_match_windowed,
        **{name: RivalMetric(name) for name in METRIC_INFO if name not in WRITTEN},
    },
    find=find_metric,
)
"""Name -> metric, called as `METRICS[name](acceleration, reduced, rate_hz)`. The only list of names."""


def match(
    recording: Signal,
    reduced: ArrayLike | None = None,
    *,
    rate_hz: float | None = None,
    reducers: str | Reducer | Iterable[str | Reducer] = "all",
    metrics: str | Metric | Iterable[str | Metric] = MATCHES,
) -> DataFrame:
    """Match a recording with one reduced signal, or with the output of each reducer.

    Parameters
    ----------
    recording : Recording, or array_like of shape (3, n_samples)
        Acceleration; plain samples need `rate_hz`.
    reduced : array_like of shape (n_samples,), or Reduced, optional
        A reduced signal; if left out, the outputs of `reducers`.
    rate_hz : float, optional
        Sampling rate of plain samples in Hz.
    reducers : "all", or a list of str or callables
        Names of `REDUCERS`, dotted names ("mylab.haptics:my321"), or functions f(acceleration, rate_hz);
        or one function, or a mapping of names to functions.
    metrics : "all", or a list of str or callables
        Names of `METRICS`, dotted names, or functions f(acceleration, reduced, rate_hz); the match metrics if left out,
        and "all" for their rivals too.

    Returns
    -------
    DataFrame
        A row per reducer, a column per metric.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> scene = stimuli.make_scene("bumps", duration_s=1)
    >>> stimuli.match(scene, reducers=["say321", "dft321"], metrics=["spectral_match"]).round(2)
             spectral_match
    reducer
    say321             0.49
    dft321             1.00
    >>> stimuli.match(scene, scene.acceleration[0]).columns.tolist()
    ['spectral_match', 'temporal_match', 'spectral_match_bounded']
    """
    import pandas as pd

    given, rate = as_pair(recording, reduced, rate_hz)
    samples = check_acceleration(given)
    measures = METRICS.choose(metrics)
    if isinstance(reduced, str) or callable(reduced):
        do = f"for a reducer, write reducers=[{name_of(reduced)}]"
        raise TypeError(f"reduced must be a signal; {do}")
    if reduced is None:
        functions = REDUCERS.choose(reducers)
        outputs = {name: function(samples, rate) for name, function in functions.items()}
    else:
        name = reduced.reducer if isinstance(reduced, Reduced) else "reduced"
        outputs = {name: coerce_real(reduced, "reduced")}
    rows = [
        [measure(samples, output, rate) for measure in measures.values()]
        for output in outputs.values()
    ]
    return pd.DataFrame(rows, pd.Index(outputs, name="reducer"), columns=list(measures))
