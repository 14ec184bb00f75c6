"""The pages of reducers and metrics: for each one formula, figure, and when it fails."""

from __future__ import annotations

import inspect
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from docsite.plot import FAINT, INK
from docsite.text import table, title, write
from feel321.analysis.tradeoff.battery import BATTERY
from feel321.stimuli import (
    INVARIANTS,
    METRICS,
    REDUCERS,
    condition,
    make_scene,
    match,
    psd,
    spectral_match_bounded,
)
from feel321.stimuli.recording import Reduced
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS, WHY_NOT_STREAMING
from feel321.stimuli.synthesis import SCENES
from feel321.study import settings
from feel321.types import METRIC_INFO, REDUCER_NAMES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from matplotlib.axes import Axes

    from feel321.stimuli import Recording

WORDS = tomllib.loads((Path(__file__).parent / "methods.toml").read_text(encoding="utf-8"))
"""What registries and docstrings do not say: in a sentence, what a method does, and when it fails."""

CONTROL = "ordinary_drag"
DRAWN = (
    "say321",
    "soc321",
    "mag321",
    "pca321",
    "dft321",
    "dft321_principal",
    "pca321_matched",
    "dft321_bands",
)
"""Reducers with a figure; the others look like one of these."""

COMPARED = ("sax321", "say321", "saz321", "soc321", "mag321", "pca321", "dft321", "dft321_windowed")
"""Columns of the paper's Table 1."""

LANDIN = Path(settings.__file__).parent / "bundled" / "landin2010.toml"
"""The bundled study that holds the numbers of the paper's Table 1."""


def write_reducers(path: Path) -> None:
    """Write the page of all reducers."""
    write(
        path,
        title("Reducers"),
        "Three axes in, one out: ``REDUCERS[name](acceleration, rate_hz)``, from (..., 3, n) to (..., n). In the"
        " figures, grey is the recording (its three axes above, the sum of their spectra below) and black or white the"
        " reduced signal; both matches are at best 1.\n",
        title("The paper's table, and ours", "-"),
        "Spectral match / temporal match. Upper rows: Table 1 of Landin et al. 2010 (Figure 3: bumps, drag and taps;"
        " Figure 4: texture drag); below, the bundled scenes, conditioned as in a study. The scenes are synthetic:"
        " compare the pattern, not the digits.\n",
        table(("", *COMPARED), [*_list_paper(), *_list_scenes()]),
        *(_describe_reducer(name) for name in REDUCER_NAMES),
    )


def _list_paper() -> Iterable[list[str]]:
    """List the paper's numbers: spectral and temporal match of each transform, by figure."""
    listed = tomllib.loads(LANDIN.read_text(encoding="utf-8"))["paper"]["published"]
    for shown in dict.fromkeys(one["shown"] for one in listed):
        spectral, temporal = (one["numbers"] for one in listed if one["shown"] == shown)
        pairs = ((spectral.get(name), temporal.get(name)) for name in COMPARED)
        yield [
            f"paper, {shown}",
            *("" if one is None else f"{one:.2f} / {other:.2f}" for one, other in pairs),
        ]


def _list_scenes() -> Iterable[list[str]]:
    """List the matches of the bundled scenes."""
    for name in SCENES:
        found = match(condition(make_scene(name)), reducers=COMPARED)
        pairs = zip(found["spectral_match"], found["temporal_match"], strict=True)
        yield [f"``{name}``", *(f"{spectral:.2f} / {temporal:.2f}" for spectral, temporal in pairs)]


def _describe_reducer(name: str) -> str:
    words, scene = WORDS["reducers"][name], BATTERY[WORDS["reducers"][name]["scene"]]
    streams = f"does not: {WHY_NOT_STREAMING[name]}" if name in WHY_NOT_STREAMING else "yes"
    default = "yes" if name in DEFAULT_REDUCERS else "no"
    notes, sources = _take_notes(REDUCERS[name], words.get("formula", ""))
    code = f"from docsite.methods import draw_reducer\n\ndraw_reducer('{name}', '{scene.name}')"
    label = f"{name} in the ordinary drag and where it fails: waveforms above, spectra below"
    parts = [
        title(name, "-"),
        words["does"] + "\n",
        f"Streams: {streams}. In a study by default: {default}.\n",
        notes,
        f"**When it fails.** {words['fails']}\n",
    ]
    if name in DRAWN:
        left, right = BATTERY[CONTROL].title.lower(), f"{scene.title[0].lower()}{scene.title[1:]}"
        parts += [_plot(label, code), f"Left: {left}. Right: {right}. {scene.reason}\n"]
    return "\n".join([*parts, sources])


def write_metrics(path: Path) -> None:
    """Write the page of all metrics."""
    write(
        path,
        title("Metrics"),
        "How well one axis stands for three: ``METRICS[name](acceleration, reduced, rate_hz)``. The first four are the"
        " match metrics; the others are their rivals. ``INVARIANTS`` has a counterpart of spectral and temporal match"
        " that does not change with the mounting of the sensor. In the figures, one second of an ordinary drag, reduced"
        " by ``dft321``, is made stronger or weaker (left) or delayed (right).\n",
        *(_describe_metric(name) for name in METRICS),
    )


def _describe_metric(name: str) -> str:
    words, info = WORDS["metrics"][name], METRIC_INFO[name]
    best = "higher is better" if info.higher == "better" else "0 is best"
    ends = f"{info.low:g} to {info.high:g}".replace("-inf to", "at most").replace(
        " to inf", " or more"
    )
    notes, sources = _take_notes(
        getattr(METRICS[name], "measure", METRICS[name]), words.get("formula", "")
    )
    code = f"from docsite.methods import draw_metric\n\ndraw_metric('{name}')"
    return "\n".join([
        title(name, "-"),
        words["does"] + "\n",
        f"Range: {' '.join(filter(None, (ends, info.unit)))}; {best}.\n",
        notes,
        f"**When it misleads.** {words['fails']}\n",
        _plot(f"{info.label}, over the gain and over the delay of the reduced signal", code),
        sources,
    ])


def _take_notes(function: Callable[..., object], formula: str) -> tuple[str, str]:
    """Take notes and sources of a docstring, and the formula where it has none."""
    lines = inspect.cleandoc(function.__doc__ or "").splitlines()[1:]
    below: dict[str, list[str]] = {}
    part = below.setdefault("Summary", [])
    for line, rule in zip(lines, [*lines, ""][1:], strict=True):
        if rule and set(rule) == {"-"}:
            part = below.setdefault(line, [])
        elif set(line) != {"-"}:
            part.append(line)
    said = (
        formula and f".. math:: {formula}\n",
        *("\n".join(below.get(key, [])) for key in ("Summary", "Notes")),
    )
    sources = below.get("References") or _find_sources(function, "\n".join(lines))
    heading = "**Source.**\n\n" if sources else ""
    return (
        _drop_footnotes("\n".join(each.strip("\n") + "\n" for each in said if each)),
        heading + _drop_footnotes("\n".join(sources)),
    )


def _drop_footnotes(text: str) -> str:
    """Make a list of footnotes: some are cited in lines that a page leaves out."""
    text = re.sub(r"\s*\[\d+\]_", "", text)
    return re.sub(r"^\.\. \[\d+\]", "-", text, flags=re.MULTILINE).replace("\n   ", "\n  ")


def _find_sources(function: Callable[..., object], text: str) -> list[str]:
    """Find in a module's docstring the sources that one of its functions cites."""
    _, _, listed = (inspect.getdoc(inspect.getmodule(function)) or "").partition(
        "References\n----------\n"
    )
    cited = set(re.findall(r"(\[\d+\])_", text))
    each = re.findall(r"^\.\. (\[\d+\]) (.*(?:\n   .*)*)", listed, re.MULTILINE)
    return [f".. {number} {source}" for number, source in each if number in cited]


def _plot(label: str, code: str) -> str:
    lines = "".join(f"   {line}".rstrip() + "\n" for line in code.splitlines())
    return f".. plot:: {label}\n\n{lines}"


def measure(name: str, scene: Recording) -> tuple[Reduced, float, float]:
    """Reduce a scene; give the bounded spectral match, and the temporal match that no mounting changes."""
    samples, rate = scene.acceleration, scene.rate_hz
    reduced = REDUCERS[name](samples, rate)
    found = Reduced(reduced, rate, name, scene.name)
    temporal = INVARIANTS["temporal_match"](samples, reduced, rate)
    return found, spectral_match_bounded(samples, reduced, rate), temporal


def draw_reducer(name: str, failing: str) -> None:
    """Draw waveforms and spectra of the ordinary scene, and of one in which a reducer fails."""
    import matplotlib.pyplot as plt

    _, axes = plt.subplots(2, 2, figsize=(8.0, 4.6), sharex="row")
    for (above, below), key in zip(axes.T, (CONTROL, failing), strict=True):
        scene = BATTERY[key].make(1)
        reduced, spectral, temporal = measure(name, scene)
        above.set_title(
            f"{BATTERY[key].title}\nspectral match {spectral:.2f}, temporal match {temporal:.2f}"
        )
        _draw_waveforms(above, scene, reduced)
        _draw_spectra(below, scene, reduced)
    axes[0, 0].set_ylabel("m/s²")
    axes[1, 0].set_ylabel("Power (dB)")


def _draw_spectra(ax: Axes, scene: Recording, reduced: Reduced) -> None:
    """Draw power spectral densities, 60 dB of them; ticks are plain text, which is ten times as fast as powers."""
    window_s = min(0.1, scene.n_samples / scene.rate_hz)
    given, found = (psd(signal, window_s=window_s) for signal in (scene, reduced))
    for one, look in ((given, {"color": FAINT, "lw": 2.5}), (found, {"color": INK})):
        level = 10 * np.log10(np.maximum(one.density / given.density.max(), 1e-12))
        ax.plot(np.log2(np.maximum(one.frequencies_hz, 1)), level, **look)
    ticks = (20, 50, 100, 200, 500, 1000)
    ax.set_xticks(np.log2(ticks), [str(tick) for tick in ticks])
    ax.set(xlim=np.log2((20, 1000)), ylim=(-60, 10), xlabel="Frequency (Hz)")


def _draw_waveforms(ax: Axes, scene: Recording, reduced: Reduced) -> None:
    """Draw 60 ms, from a little before the strongest sample."""
    middle = int(np.argmax(np.abs(scene.acceleration).max(axis=0)))
    first = min(
        max(middle - round(0.02 * scene.rate_hz), 0), scene.n_samples - round(0.06 * scene.rate_hz)
    )
    part = slice(first, first + round(0.06 * scene.rate_hz))
    time_ms = 1000 * np.arange(part.stop - part.start) / scene.rate_hz
    ax.plot(time_ms, scene.acceleration[:, part].T, color=FAINT, lw=0.8)
    ax.plot(time_ms, reduced.samples[part], color=INK, lw=1.1)
    ax.set(xlabel="Time (ms)", xlim=(0, 60))


def draw_metric(name: str) -> None:
    """Draw a metric over the gain, and over the delay, of a good reduced signal."""
    import matplotlib.pyplot as plt

    scene = BATTERY[CONTROL].make(1)
    reduced = REDUCERS["dft321"](scene.acceleration, scene.rate_hz)
    gains_db, delays = np.linspace(-12, 12, 13), np.arange(0, 21, 2)

    def value(signal: np.ndarray) -> float:
        return METRICS[name](scene.acceleration, signal, scene.rate_hz)

    _, (left, right) = plt.subplots(1, 2, figsize=(8.0, 2.8), sharey=True)
    left.plot(
        gains_db,
        [value(reduced * 10 ** (gain / 20)) for gain in gains_db],
        color=INK,
        marker="o",
        ms=3,
    )
    left.set(
        xlabel="Gain (dB)",
        ylabel=METRIC_INFO[name].label
        + (f" ({METRIC_INFO[name].unit})" if METRIC_INFO[name].unit else ""),
    )
    right.plot(
        1000 * delays / scene.rate_hz,
        [value(np.roll(reduced, int(k))) for k in delays],
        color=INK,
        marker="o",
        ms=3,
    )
    right.set_xlabel("Delay (ms)")
