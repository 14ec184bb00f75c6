"""The figure of a certificate: each coil's response without its filter and with it, and its distortion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures import style
from feel321.study.actuator.response import find_inside

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from feel321.study.actuator.certificate import Certificate, CoilCertificate

PANEL_CM = 4.2
FLOOR_DB = -60.0
LEGEND: Any = {"frameon": False, "handlelength": 1.5, "columnspacing": 1.2}


def draw_certificate(certificate: Certificate, stem: Path) -> None:
    """Draw the coils of a certificate, one panel each, and save them as vector."""
    style.save_figure(make_figure(certificate), stem, formats=("svg",))


def make_figure(certificate: Certificate) -> Figure:
    """Make the figure of a certificate by measurement."""
    coils = list(certificate.coils.values())
    with style.print_style():
        figure = style.new_canvas(PANEL_CM * len(coils) + 0.5)
        panels = figure.subplots(len(coils), sharex=True, squeeze=False)[:, 0]
        for axes, coil in zip(panels, coils, strict=True):
            _draw_coil(axes, coil, certificate=certificate)
        panels[-1].set_xlabel("Frequency (Hz)")
        low, high = certificate.band_hz
        round_hz = [digit * 10**power for power in range(5) for digit in (1, 2, 5)]
        shown = [one for one in round_hz if low <= one <= high]
        panels[-1].set_xticks(shown, [f"{one:g}" for one in shown])
        panels[-1].set_xticks([], minor=True)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3, **LEGEND)
        passed = "passed" if certificate.passed else "did not pass"
        style.add_title(figure, f"{certificate.id} ({certificate.method}): {passed}")
    return figure


def _draw_coil(axes: Axes, coil: CoilCertificate, *, certificate: Certificate) -> None:
    inside = find_inside(coil.frequency_hz, band_hz=certificate.band_hz)
    frequency_hz = coil.frequency_hz[inside]

    def plot(size: ArrayLike, name: str, colour: str) -> None:
        level_db = 20 * np.log10(np.maximum(np.abs(size), 1e-9))
        axes.plot(frequency_hz, np.maximum(level_db, FLOOR_DB), color=colour, label=name)

    axes.axhline(0, color=style.GREY, linewidth=style.THIN)
    plot(coil.response[inside] / coil.target, "without filter", style.RED)
    plot(coil.equalised[inside] / coil.target, "with filter", style.BLUE)
    plot(coil.distortion[inside], "harmonics", style.GREY)
    axes.set_xscale("log")
    axes.margins(x=0)
    axes.set_ylim(FLOOR_DB - 2, None)
    axes.set_ylabel("Level (dB)")
    axes.set_title(
        f"{coil.name}: {coil.target:.3g} m/s² at full scale, within {coil.largest_db:.1f} dB"
    )
