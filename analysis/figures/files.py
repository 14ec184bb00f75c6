"""How figures are saved: as vector and as bitmap, the same bytes for the same data."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from analysis.figures.style import print_style

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

PNG_DPI = 300

STAMPS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    "svg": ("Date", "Creator", "Format", "Type"),
    "png": ("Software",),
    "pdf": ("CreationDate", "Creator", "Producer"),
})
"""Format -> what matplotlib writes into its files beside the drawing: its version and the hour, which differ."""


def save_figure(figure: Figure, stem: Path, *, formats: Sequence[str] = ("svg", "png")) -> None:
    """Write a figure as vector and as bitmap.

    Parameters
    ----------
    figure : Figure
        What to write.
    stem : Path
        Where, without suffix: ``.svg`` and ``.png`` (300 dpi) are added. The same figure gives the same
        bytes.
    formats : sequence of str
        Of svg, png and pdf.

    Raises
    ------
    ValueError
        If a format is none of these.
    OSError
        If a file cannot be written.
    """
    if unknown := [name for name in formats if name not in STAMPS]:
        raise ValueError(f"formats: got {unknown[0]!r}, allowed are {', '.join(STAMPS)}")
    with print_style():
        for name in formats:
            # A name may end in what looks like a suffix: dft_v1.5.
            path = stem.with_name(f"{stem.name}.{name}")
            figure.savefig(path, dpi=PNG_DPI, metadata=dict.fromkeys(STAMPS[name]))
            figure.set_layout_engine("none")  # everything has its place now, in every format
