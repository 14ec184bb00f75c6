"""Plots of signals and ratings on matplotlib axes, in the caller's own figure and style."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.contrasts.compare import profile_reducers, stimulus_means
from feel321.analysis.table.items import Table, open_tests
from feel321.analysis.table.metrics import order_reducers
from feel321.analysis.words import capitalise, format_axis, format_measure, format_name

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from matplotlib.axes import Axes
    from pandas import DataFrame

    from feel321.analysis.association.correlate import Association
    from feel321.analysis.primary.model import Primary
    from feel321.stimuli.recording import Recording, Reduced

FLOOR_DB = -80.0
"""Below the strongest: what a spectrum or spectrogram does not show."""


def plot_scatter(ratings: Table | DataFrame, metric: str, *, ax: Axes | None = None) -> Axes:
    """Plot mean ratings of test stimuli against a metric, a colour per reducer.

    Parameters
    ----------
    ratings : Table or DataFrame
        Ratings of one scale and level.
    metric : str
        Column to plot against.
    ax : Axes, optional
        Where to plot; a new figure if left out.

    Returns
    -------
    Axes
        The same, with 95 % t intervals over participants as vertical lines.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> rows = pd.DataFrame({"participant": list("aabb"), "stimulus_id": list("xyxy"), "reducer": list("uvuv"),
    ...     "recording": "tap", "level": "as_is", "role": "test", "scale": "realism", "match": [0.2, 0.9] * 2,
    ...     "rating": [20, 70, 30, 90]})
    >>> analysis.plot_scatter(rows, "match").get_xlabel()
    'Match'
    """
    rows, _ = open_tests(ratings, [metric])
    means = stimulus_means(rows)
    values = rows.drop_duplicates("stimulus_id").set_index("stimulus_id")[metric]
    ax = _find_axes(ax)
    for name in order_reducers(means["reducer"]):
        part = means[means["reducer"] == name]
        x = part["stimulus_id"].map(values).to_numpy(np.float64)
        points = ax.plot(x, part["mean"], "o", label=format_name(name))
        ax.vlines(x, part["low"], part["high"], color=points[0].get_color(), alpha=0.3)
    ax.set(xlabel=format_axis(metric), ylabel=_label_ratings(rows))
    ax.legend()
    return ax


def plot_profile(ratings: Table | DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot the mean rating of each reducer, reference and anchor with its interval over participants.

    Parameters
    ----------
    ratings : Table or DataFrame
        Ratings; several scales and levels get a colour each.
    ax : Axes, optional
        Where to plot; a new figure if left out.

    Returns
    -------
    Axes
        The same: a row per reducer, the first one on top.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> rows = pd.DataFrame({"participant": list("aabb"), "stimulus_id": list("xyxy"), "reducer": list("uvuv"),
    ...     "level": "as_is", "role": "test", "scale": "realism", "rating": [20, 70, 30, 90]})
    >>> analysis.plot_profile(rows).get_xlabel()
    'Realism rating'
    """
    profile = profile_reducers(ratings)
    names, ax = order_reducers(profile["reducer"]), _find_axes(ax)
    for (scale, level), part in profile.groupby(["scale", "level"], observed=True):
        rows = [names.index(name) for name in part["reducer"]]
        label = f"{format_name(str(scale))}, {format_name(str(level))}"
        points = ax.plot(part["mean"], rows, "o", label=label)
        ax.hlines(rows, part["low"], part["high"], color=points[0].get_color())
    ax.set_yticks(range(len(names)), [format_name(name) for name in names])
    ax.set(xlabel=_label_ratings(profile), ylim=(len(names) - 0.5, -0.5))
    ax.legend()
    return ax


def plot_slopes(models: Primary | Mapping[Any, Primary], *, ax: Axes | None = None) -> Axes:
    """Plot the slopes of one or several primary models with their 95 % intervals.

    Parameters
    ----------
    models : Primary or Mapping of Primary
        What `fit_primary` or `fit_attributes` returned.
    ax : Axes, optional
        Where to plot; a new figure if left out.

    Returns
    -------
    Axes
        The same: change in rating per +0.1 of a metric, a row per slope and a colour per model.
    """
    ax, rows = _find_axes(ax), list[str]()
    items = models.items() if hasattr(models, "items") else [("", models)]
    for name, model in items:
        slopes = model.slopes
        rows += [term for term in map(str, slopes.index) if term not in rows]
        places = [rows.index(str(term)) for term in slopes.index]
        label = format_name(", ".join(name) if isinstance(name, tuple) else str(name))
        points = ax.plot(slopes["tenth"], places, "o", label=label or None)
        ax.hlines(places, slopes["tenth_low"], slopes["tenth_high"], color=points[0].get_color())
    ax.axvline(0, color="0.6", linewidth=0.8)
    ax.set_yticks(range(len(rows)), [format_name(name) for name in rows])
    ax.set(xlabel="Change in rating per +0.1 of the metric", ylim=(len(rows) - 0.5, -0.5))
    if len(items) > 1:
        ax.legend()
    return ax


def plot_correlations(found: Association | DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot correlations with their 95 % two-way intervals, and the noise ceiling of each.

    Parameters
    ----------
    found : Association or DataFrame
        What `correlate` returned, or `tabulate_correlations`: a row each.
    ax : Axes, optional
        Where to plot; a new figure if left out.

    Returns
    -------
    Axes
        The same: a row per correlation, the first on top; vertical lines are ceilings.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> rows = pd.DataFrame({"metric": ["match"], "value": [0.7], "low": [0.4], "high": [0.9], "ceiling": [0.95]})
    >>> analysis.plot_correlations(rows).get_xlabel()
    'Correlation with mean ratings'
    """
    import pandas as pd

    frame = (found if isinstance(found, pd.DataFrame) else found.to_frame()).reset_index()
    ax, rows = _find_axes(ax), np.arange(len(frame))
    points = ax.plot(frame["value"], rows, "o", label="correlation")
    ax.hlines(rows, frame["low"], frame["high"], color=points[0].get_color())
    ax.vlines(frame["ceiling"], rows - 0.3, rows + 0.3, color="0.4", label="noise ceiling")
    ax.axvline(0, color="0.6", linewidth=0.8)
    keys = [key for key in ("scale", "level", "metric", "method") if key in frame]
    if len(frame) > 1:
        keys = [key for key in keys if key == "metric" or len(set(frame[key])) > 1]
    labels = [
        ", ".join(format_name(str(name)) for name in own)
        for own in zip(*(frame[key] for key in keys), strict=True)
    ]
    ax.set_yticks(rows, labels)
    ax.set(xlabel="Correlation with mean ratings", ylim=(len(frame) - 0.5, -0.5))
    ax.legend()
    return ax


def plot(result: object, *, ax: Axes | None = None) -> Axes:
    """Plot whatever there is one obvious plot of, in one line of a notebook.

    Parameters
    ----------
    result : object
        A Primary, what `fit_attributes` returned, an Association, a table of correlations or of ratings, a recording or
        a reduced signal.
    ax : Axes, optional
        Where to plot; a new figure if left out.

    Returns
    -------
    Axes
        Those of `plot_slopes`, `plot_correlations`, `plot_profile` or `plot_recording`.

    Raises
    ------
    TypeError
        If there is no obvious plot of it.

    Examples
    --------
    >>> from feel321 import analysis, stimuli
    >>> analysis.plot(stimuli.make_scene("hard_taps")).get_ylabel()
    'Acceleration (m/s²)'
    """
    columns = set(getattr(result, "columns", ()))
    kinds: tuple[tuple[bool, Callable[..., Axes]], ...] = (
        (isinstance(result, Table) or {"participant", "rating"} <= columns, plot_profile),
        ({"value", "ceiling"} <= (columns or set(dir(result))), plot_correlations),
        (hasattr(result, "rate_hz"), plot_recording),
        (hasattr(result, "slopes") or (hasattr(result, "items") and not columns), plot_slopes),
    )
    for fits, draw in kinds:
        if fits:
            return draw(result, ax=ax)
    raise TypeError(
        "result must be a Primary, an Association, a table of correlations or ratings, or a recording; got "
        f"{type(result).__name__}: call a plot_... function, or draw its to_frame()"
    )


def plot_recording(signal: Recording | Reduced, *, ax: Axes | None = None) -> Axes:
    """Plot a recording's axes, or a reduced signal, over time.

    Parameters
    ----------
    signal : Recording or Reduced
        Samples with their rate.
    ax : Axes, optional
        Where to plot; a new figure if left out.

    Returns
    -------
    Axes
        The same, in seconds and m/s².

    Examples
    --------
    >>> from feel321 import analysis, stimuli
    >>> analysis.plot_recording(stimuli.make_scene("hard_taps")).get_xlabel()
    'Time (s)'
    """
    from feel321.stimuli.recording import as_signal

    given, rate_hz = as_signal(signal)
    samples, ax = np.atleast_2d(np.asarray(given, np.float64)), _find_axes(ax)
    times = np.arange(samples.shape[-1]) / rate_hz
    for one, label in zip(samples, "xyz" if len(samples) > 1 else [_name(signal)], strict=True):
        ax.plot(times, one, label=label, linewidth=0.6)
    ax.set(xlabel="Time (s)", ylabel="Acceleration (m/s²)")
    ax.legend()
    return ax


def plot_spectrum(
    *signals: Recording | Reduced, window_s: float = 0.25, ax: Axes | None = None
) -> Axes:
    """Plot power spectral densities, summed over axes, to compare signals with their recording.

    Parameters
    ----------
    *signals : Recording or Reduced
        Samples with their rate, such as a recording and what a reducer made of it.
    window_s : float
        Length of Welch's windows, in s.
    ax : Axes, optional
        Where to plot; a new figure if left out.

    Returns
    -------
    Axes
        The same: both axes logarithmic, from 10 Hz on.

    Examples
    --------
    >>> from feel321 import analysis, stimuli
    >>> analysis.plot_spectrum(stimuli.make_scene("hard_taps")).get_xscale()
    'log'
    """
    from feel321.stimuli.spectra import psd

    ax = _find_axes(ax)
    for signal in signals:
        found = psd(signal, window_s=window_s)
        ax.loglog(found.frequencies_hz[1:], found.density[1:], label=_name(signal))
    ax.set(xlabel="Frequency (Hz)", ylabel="Power spectral density ((m/s²)²/Hz)", xlim=(10, None))
    ax.legend()
    return ax


def plot_spectrogram(
    signal: Recording | Reduced, *, window_s: float = 0.035, ax: Axes | None = None
) -> Axes:
    """Plot a spectrogram, summed over axes, in dB under its strongest point.

    Parameters
    ----------
    signal : Recording or Reduced
        Samples with their rate.
    window_s : float
        Length of a window, in s; windows overlap by half.
    ax : Axes, optional
        Where to plot; a new figure if left out.

    Returns
    -------
    Axes
        The same: frequencies up to 1000 Hz over time.

    Examples
    --------
    >>> from feel321 import analysis, stimuli
    >>> analysis.plot_spectrogram(stimuli.make_scene("hard_taps")).get_ylabel()
    'Frequency (Hz)'
    """
    from feel321.stimuli.spectra import spectrogram

    ax, found = _find_axes(ax), spectrogram(signal, window_s=window_s)
    strongest = found.density.max() or 1.0  # a silent signal is at the floor throughout
    level = 10 * np.log10(np.maximum(found.density / strongest, 10 ** (FLOOR_DB / 10)))
    ax.pcolormesh(found.times_s, found.frequencies_hz, level, shading="auto", vmin=FLOOR_DB, vmax=0)
    ax.set(xlabel="Time (s)", ylabel="Frequency (Hz)", ylim=(0, min(1000, signal.rate_hz / 2)))
    ax.set_title(_name(signal))
    return ax


def _find_axes(ax: Axes | None) -> Axes:
    import matplotlib.pyplot as plt

    return plt.subplots()[1] if ax is None else ax


def _label_ratings(rows: DataFrame) -> str:
    scales = sorted(rows["scale"].unique()) if "scale" in rows else []
    return capitalise(format_measure(str(scales[0]))) if len(scales) == 1 else "Rating"


def _name(signal: Recording | Reduced) -> str:
    names = (getattr(signal, name, "") for name in ("reducer", "name", "recording"))
    return format_name(next((str(name) for name in names if name), "signal"))
