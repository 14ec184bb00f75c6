"""The public functions about reducers; light to import, their work is done in `chart`, `stress` and `advise`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from feel321.doors import as_seed, follow

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.table.items import Table
    from feel321.analysis.tradeoff.advise.page import Advice
    from feel321.analysis.tradeoff.chart.compute import Chart
    from feel321.analysis.tradeoff.stress.page import Stress
    from feel321.stimuli.recording import Recording
    from feel321.types import Progress, Reducer, Rng


def chart(
    recordings: Recording | Iterable[Recording],
    *,
    ratings: Table | DataFrame | None = None,
    full: bool = False,
    rng: Rng = 0,
    progress: Progress = False,
) -> Chart:
    """Measure the speed and accuracy of every reducer.

    Parameters
    ----------
    recordings : Recording, or iterable of Recording
        The scenes, conditioned, each with a name of its own.
    ratings : Table or DataFrame, optional
        Ratings of the scenes, to be compared with speed; a data frame has the columns participant, recording, reducer,
        scale, level and rating, and may have role, simulated and rejected.
    full : bool
        Whole recordings, 200 orientations and signals up to 10^7 samples, instead of the middle 2 s, 64 and 10^6;
        takes many times as long.
    rng : int or Generator
        A seed, or a generator from which one is drawn. The same seed gives the same accuracies; times are never the
        same twice.
    progress : bool or callable
        Whether to show a bar; or called with the numbers of steps done and to do.

    Returns
    -------
    Chart
        Every number, to be written or read as tables.

    Raises
    ------
    ValueError
        If there is no recording, two have the same name, or one cannot be compared, as where it is silent from 20 to
        1000 Hz.

    Examples
    --------
    >>> from feel321 import analysis, stimuli
    >>> taps = stimuli.make_scene("hard_taps")
    >>> found = analysis.chart(taps)  # doctest: +SKIP
    >>> page = found.write("chart")  # doctest: +SKIP
    """
    from feel321.analysis.tradeoff.chart.compute import FULL, QUICK, compute_chart

    effort = FULL if full else QUICK
    with follow(progress, "chart") as tick:
        return compute_chart(
            recordings, ratings=ratings, effort=effort, seed=as_seed(rng), progress=tick
        )


def stress(  # noqa: PLR0913 - every choice that changes the numbers has a name of its own
    recordings: Recording | Iterable[Recording] = (),
    *,
    reducers: Mapping[str, Reducer] | Iterable[str | Reducer] | None = None,
    sensor: Mapping[str, Recording] | None = None,
    takes: int = 40,
    draws: int = 16,
    rng: Rng = 0,
    progress: Progress = False,
) -> Stress:
    """Put reducers through the battery of scenes that they are known to fail on, and find recordings that come near.

    Parameters
    ----------
    recordings : Recording, or iterable of Recording
        Conditioned, as they are felt; each with a name of its own. Silent ones are left out, and noted.
    reducers : iterable of str or callable, or Mapping of str to callable, optional
        Names of `REDUCERS`, dotted names ("mylab.haptics:my321"), or functions f(acceleration, rate_hz); or a mapping
        of names to functions; all of `REDUCERS` if left out.
    sensor : Mapping of str to Recording, optional
        The same recordings as they came from the sensor, by name; needed to see offsets, clipping and steps.
    takes : int
        Takes of every scene, at least 2, each with a noise, orientations and a shift of its own.
    draws : int
        Noises per recording, at least 2.
    rng : int or Generator
        A seed, or a generator from which one is drawn.
    progress : bool or callable
        Whether to show a bar; or called with the numbers of steps done and to do.

    Returns
    -------
    Stress
        Every number, to be written or read as tables.

    Raises
    ------
    ValueError
        If two recordings have the same name, there is no reducer or one returns another number of samples, or there
        are fewer than 2 takes or draws.

    Examples
    --------
    >>> from feel321 import analysis
    >>> found = analysis.stress(reducers=["soc321"], takes=2)
    >>> found.failures[0].recording
    'ordinary_drag'
    """
    from feel321.analysis.tradeoff.stress.run import stress_reducers
    from feel321.stimuli.reducers.registry import REDUCERS

    chosen = REDUCERS.choose("all" if reducers is None else reducers)
    if not chosen:
        raise ValueError("reducers must be one or more, got none; leave them out to take all")
    with follow(progress, "stress") as tick:
        return stress_reducers(
            recordings, chosen, sensor=sensor, seeds=takes, draws=draws, seed=as_seed(rng),
            progress=tick,
        )  # fmt: skip


def advise(  # noqa: PLR0913 - every choice that changes the advice has a name of its own
    recordings: Recording | Iterable[Recording],
    *,
    online: bool = False,
    latency_ms: float | None = None,
    block_ms: float | None = None,
    device_ms: float | None = None,
    mounting: str = "any",
    axes: int = 1,
    weber: float = 0.22,
    segment_s: float | None = None,
    ratings: Table | DataFrame | None = None,
    margin: float | None = None,
    rng: Rng = 0,
    progress: Progress = False,
) -> Advice:
    """Find the simplest sufficient reducer for every recording.

    Parameters
    ----------
    recordings : Recording, or iterable of Recording
        Conditioned, each with a name of its own.
    online : bool
        Whether the reducer runs while the vibration is being made.
    latency_ms : float, optional
        The longest delay online, of reducer, block and device together, in ms; 45 if left out.
    block_ms, device_ms : float, optional
        What a block of samples and the device take of it; 1.33 (64 samples at 48 kHz) and 5 if left out.
    mounting : {"any", "recorded"}
        Whether advice must hold however the sensor is mounted, or for the mounting that was recorded.
    axes : int
        Axes that the actuator can move, 1 to 3.
    weber : float
        Largest energy change taken as imperceptible, as a Weber fraction.
    segment_s : float, optional
        Length of segments that are advised for one by one; every recording is one scene if left out.
    ratings : Table or DataFrame, optional
        Ratings of the recordings, as for `chart`: a reducer must then also be shown to feel like the one rated
        highest. Not used for segments, nor for actuators of several axes: people rated whole recordings, on one axis.
    margin : float, optional
        Points of rating that do not matter, fixed beforehand; without them ratings are not used.
    rng : int or Generator
        A seed, or a generator from which one is drawn.
    progress : bool or callable
        Whether to show a bar; or called with the numbers of scenes done and to do.

    Returns
    -------
    Advice
        The answers and the numbers they rest on, to be written or read as tables.

    Raises
    ------
    ValueError
        If there is no recording, two have the same name, none has motion, segments are too short, or the settings
        contradict each other.

    Examples
    --------
    >>> from feel321 import analysis, stimuli
    >>> scenes = [stimuli.make_scene(name, duration_s=0.5) for name in ("constrained_drag", "circular_motion")]
    >>> analysis.advise(scenes).common[0]
    'pca321_matched'
    """
    from feel321.analysis.tradeoff.advise.page import advise_recordings
    from feel321.analysis.tradeoff.advise.scene import (
        BLOCK_MS,
        DEVICE_MS,
        Context,
        Tolerance,
        judge_ratings,
    )

    context = Context(
        online=online, latency_ms=latency_ms, axes=axes, tolerance=Tolerance(weber), mounting=mounting,
        block_ms=BLOCK_MS if block_ms is None else block_ms,
        device_ms=DEVICE_MS if device_ms is None else device_ms,
    )  # fmt: skip
    judged = None if ratings is None else judge_ratings(ratings, margin=margin)
    with follow(progress, "advise") as tick:
        return advise_recordings(
            recordings,
            context,
            seed=as_seed(rng),
            segment_s=segment_s,
            ratings=judged,
            progress=tick,
        )
