"""Plots of signals and ratings on matplotlib axes, in the caller's own figure and style."""

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from pandas import DataFrame, concat

from feel321.analysis import figures
from feel321.analysis.contrasts.compare import participant_means, profile_reducers, stimulus_means
from feel321.analysis.figures import assign_looks, make_handles
from feel321.analysis.primary.model import Primary
from feel321.analysis.table.columns import order_reducers
from feel321.analysis.table.items import Table, open_tests
from feel321.analysis.words import capitalise, format_measure, format_name
from feel321.stimuli.recording import Recording, Reduced, as_signal
from feel321.stimuli.spectra import psd


def plot_scatter(ratings: Table | DataFrame, metric: str, *, ax: Axes | None = None) -> Axes:
    """Plot mean ratings of test stimuli, with 95 % t intervals over participants, against a metric.

    Parameters
    ----------
    ratings : Table or DataFrame
        Ratings of one scale and level.
    metric : str
        Column to plot against.
    ax : Axes, optional
        Where to plot; a new figure if left out.
    """
    rows, _ = open_tests(ratings, [metric])
    values = rows.drop_duplicates("stimulus_id").set_index("stimulus_id")[[metric]]
    stimuli = stimulus_means(rows).join(values, on="stimulus_id")
    ax, looks = _find_axes(ax), assign_looks(order_reducers(stimuli["reducer"]))
    shown = figures.plot_stimuli(ax, stimuli, metric, looks=looks)
    ax.set_ylabel(_label_ratings(rows))
    ax.legend(shown.values(), map(format_name, shown))
    return ax


def plot_profile(ratings: Table | DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot mean, interval and participants of each reducer, reference and anchor, the highest on top.

    Parameters
    ----------
    ratings : Table or DataFrame
        Ratings; of several scales and levels the means alone, a mark each.
    ax : Axes, optional
        Where to plot; a new figure if left out.
    """
    profile, ax = profile_reducers(ratings), _find_axes(ax)
    names = order_reducers(profile["reducer"])
    part = profile["scale"].map(format_name) + ", " + profile["level"].map(format_name)
    if len(part.unique()) == 1:
        figures.plot_profile(ax, profile, participant_means(ratings), looks=assign_looks(names))
    else:
        looks = assign_looks(sorted(part.unique()))
        frame = profile.assign(part=part, name=profile["reducer"].map(format_name))
        frame = frame.sort_values("reducer", key=lambda own: own.map(names.index), kind="stable")
        ends = "mean low high"
        figures.plot_forest(ax, frame, columns=ends, series="part", looks=looks, include=())
        ax.legend(handles=list(make_handles(looks).values()), labels=list(looks))
    ax.set_xlabel(_label_ratings(profile))
    return ax


def plot_slopes(models: Primary | Mapping[Any, Primary], *, ax: Axes | None = None) -> Axes:
    """Plot the slopes of one or several primary models, per +0.1 of a metric, with their 95 % intervals.

    Parameters
    ----------
    models : Primary or Mapping of Primary
        What `fit_primary` or `fit_attributes` returned.
    ax : Axes, optional
        Where to plot; a new figure if left out.
    """
    ax, items = _find_axes(ax), {"": models} if isinstance(models, Primary) else models
    tables = []
    for key, model in items.items():
        name = ", ".join(map(format_name, key)) if isinstance(key, tuple) else format_name(str(key))
        tables.append(model.slopes.reset_index().assign(model=name, filled=not model.fit.singular))
    frame = concat(tables)
    frame["name"] = frame["metric"].map(format_name)
    figures.plot_forest(
        ax, frame, columns="tenth tenth_low tenth_high", series="metric",
        looks=figures.look_up(frame["metric"]), heading="model" if any(frame["model"]) else "",
    )  # fmt: skip
    ax.set_xlabel("Change in rating per +0.1 of the metric")
    return ax


def plot_recording(signal: Recording | Reduced, *, ax: Axes | None = None) -> Axes:
    """Plot a recording's axes, or a reduced signal, over time, in seconds and m/s².

    Parameters
    ----------
    signal : Recording or Reduced
        Samples with their rate.
    ax : Axes, optional
        Where to plot; a new figure if left out.

    Examples
    --------
    >>> from feel321 import analysis, stimuli
    >>> analysis.plot_recording(stimuli.make_scene("hard_taps")).get_ylabel()
    'Acceleration (m/s²)'
    """
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
    """Plot power spectral densities, summed over axes, from 10 Hz on, to compare signals with their recording.

    Parameters
    ----------
    *signals : Recording or Reduced
        Samples with their rate, such as a recording and what a reducer made of it.
    window_s : float
        Length of Welch's windows, in s.
    ax : Axes, optional
        Where to plot; a new figure if left out.
    """
    ax = _find_axes(ax)
    for signal in signals:
        found = psd(signal, window_s=window_s)
        ax.loglog(found.frequencies_hz[1:], found.density[1:], label=_name(signal))
    ax.set(xlabel="Frequency (Hz)", ylabel="Power spectral density ((m/s²)²/Hz)", xlim=(10, None))
    ax.legend()
    return ax


def _find_axes(ax: Axes | None) -> Axes:
    return plt.subplots()[1] if ax is None else ax


def _label_ratings(rows: DataFrame) -> str:
    scales = sorted(rows["scale"].unique()) if "scale" in rows else []
    return capitalise(format_measure(str(scales[0]))) if len(scales) == 1 else "Rating"


def _name(signal: Recording | Reduced) -> str:
    names = (getattr(signal, name, "") for name in ("reducer", "name", "recording"))
    return format_name(next((str(name) for name in names if name), "signal"))
