"""How figures look: their size, text, legends and files.

Conventions: one and a half columns wide (14 cm), which fills a page of 700 pixels with text of its body's size; every
reducer has a colour and a marker of its own, the same in all figures, and nothing else has a colour: metrics, scales
and verdicts are told apart by ink, grey, fill and line style. Files are for print; on a page `PAGE_COLOURS` follow
the reader's choice of light or dark.
"""

from __future__ import annotations

import textwrap
import warnings
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from feel321.analysis.table.schema import HIGHEST, LOWEST
from feel321.analysis.words import format_measure, format_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from numpy.typing import ArrayLike

WIDTH_CM, CM_PER_INCH = 14.0, 2.54
THIN, GREY, BLACK, PALE = 0.5, "#757575", "#000000", "#DEDEDE"

PAGE_COLOURS: Mapping[str, str] = MappingProxyType({
    BLACK: "ink", GREY: "faint", PALE: "line", "#FFFFFF": "paper",
})  # fmt: skip
"""What ink, grey, fill and paper are on a page: names of its style sheet's variables."""

OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colour-blind safe; its yellow is left out because it fades on white paper."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*", "p")
"""As many as can be told apart in print; a pair of colour and marker comes again only after 77 reducers."""

PRINT: Any = {
    "font.family": "DejaVu Sans", "font.size": 8, "axes.labelsize": 8, "axes.titlesize": 8,
    "figure.titlesize": 8.5, "figure.labelsize": 8,
    "xtick.labelsize": 8, "ytick.labelsize": 8, "legend.fontsize": 8, "axes.linewidth": 0.6,
    "axes.spines.top": False, "axes.spines.right": False, "axes.titlelocation": "left",
    "lines.markersize": 4, "lines.linewidth": 0.8, "text.parse_math": False,
    "svg.fonttype": "none", "svg.hashsalt": "feel321",
}  # fmt: skip

LETTERS_PER_CM, LINE_CM = 6.2, 0.36
"""Letters of 8 points beside each other, on average, and the height of their line."""


@dataclass(frozen=True, slots=True)
class Look:
    """Colour and marker of a reducer."""

    colour: str
    marker: str


def assign_looks(reducers: Sequence[str]) -> dict[str, Look]:
    """Give every reducer a look."""
    pairs = zip(cycle(OKABE_ITO), cycle(MARKERS), strict=False)
    return {name: Look(*pair) for name, pair in zip(reducers, pairs, strict=False)}


@contextmanager
def print_style() -> Iterator[None]:
    """Set fonts and lines for print while figures are drawn or saved."""
    from matplotlib import rc_context, rcParamsDefault

    # All settings but the window's start from the library's own: a matplotlibrc in the working folder must not
    # change a byte.
    apart = ("backend", "_")
    plain = {name: one for name, one in rcParamsDefault.items() if not name.startswith(apart)}
    with rc_context({**plain, **PRINT}), warnings.catch_warnings():
        # `list_undrawable` lists them once.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def list_undrawable(names: Iterable[str]) -> str:
    """List the characters that the figures' font does not have."""
    from matplotlib.font_manager import findfont, get_font

    known = get_font(findfont(PRINT["font.family"])).get_charmap()
    return "".join(sorted({one for name in names for one in name if ord(one) not in known}))


def new_canvas(height_cm: float) -> Figure:
    """Make a figure without axes."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH_CM / CM_PER_INCH, height_cm / CM_PER_INCH), layout="constrained")


def new_figure(height_cm: float) -> tuple[Figure, Axes]:
    """Make a figure with one pair of axes."""
    figure = new_canvas(height_cm)
    return figure, figure.add_subplot()


def plot_marks(
    axes: Axes,
    x: ArrayLike,
    y: ArrayLike,
    *,
    look: Look,
    size: float = 4.0,
    filled: bool = True,
    **style: Any,  # noqa: ANN401 - whatever a line takes
) -> Line2D:
    """Draw points, with a white rim that keeps neighbours apart, or hollow."""
    rim, face = ("white", look.colour) if filled else (look.colour, "white")
    return axes.plot(x, y, **{
        "marker": look.marker, "markersize": size, "linestyle": "none", "color": look.colour, "markerfacecolor": face,
        "markeredgecolor": rim, "markeredgewidth": THIN if filled else 0.8, "zorder": 3, **style,
    })[0]  # fmt: skip


# Words in figures: broken by the number of letters, so that no name runs off or into another.


def fit_text(text: str, width_cm: float, *, lines: int = 2) -> str:
    """Break a text into lines that are about as wide as their place; what does not fit loses its middle."""
    room = max(4, int(width_cm * LETTERS_PER_CM))
    parts = (textwrap.wrap(part.replace("_", "_ "), room) or [""] for part in text.split("\n"))
    found = [line.replace("_ ", "_") for part in parts for line in part]
    if len(found) > lines:
        parted = (line if line.endswith("_") else f"{line} " for line in found[lines - 1 :])
        rest = "".join(parted).rstrip()
        kept, tail = (room - 1) // 2, room // 2
        found[lines - 1 :] = [f"{rest[:kept].rstrip()}…{rest[-tail:].lstrip()}"]
    return "\n".join(found)


def label_scale(scale: str, length_cm: float = 6.0, *, level: str = "") -> str:
    """Label an axis of that length by the scale that was rated, and by the level where there are several."""
    of = f", level {format_name(level)}" if level else ""
    text = f"Mean {format_measure(scale)}{of} ({LOWEST:.0f}–{HIGHEST:.0f})"
    return fit_text(text, length_cm, lines=3)


def add_title(figure: Figure, text: str) -> None:
    """Write above a figure what it shows, and give it the height that this takes."""
    fitted = fit_text(text, WIDTH_CM - 1.0, lines=8)
    figure.suptitle(fitted, x=0.2 / WIDTH_CM, ha="left")
    grow(figure, LINE_CM * (1 + fitted.count("\n")))


def add_legend(figure: Figure, shown: Mapping[str, Artist]) -> None:
    """Put the legend of names below, in as many columns as there is room for."""
    if not shown:
        return
    labels = [fit_text(name, WIDTH_CM / 2, lines=1) for name in shown]
    columns = max(1, int(WIDTH_CM / (max(map(len, labels)) / LETTERS_PER_CM + 0.9)))
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": columns, "frameon": False}
    figure.legend(list(shown.values()), labels, handletextpad=0, columnspacing=0.8, **place)
    grow(figure, 0.45 * -(-len(labels) // columns))


def grow(figure: Figure, height_cm: float) -> None:
    """Make a figure higher."""
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + height_cm / CM_PER_INCH)


def make_handles(looks: Mapping[str, Look]) -> dict[str, Artist]:
    """Make what stands for each name in a legend."""
    from matplotlib.lines import Line2D

    rim: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white", "markeredgewidth": THIN}
    return {
        name: Line2D([], [], color=look.colour, marker=look.marker, **rim)
        for name, look in looks.items()
    }


# How figures are saved: as vector and as bitmap, the same bytes for the same data.

PNG_DPI = 200
STAMPS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    "svg": ("Date", "Creator", "Format", "Type"), "png": ("Software",),
})  # fmt: skip
"""Format -> what matplotlib writes into its files beside the drawing: its version and the hour, which differ."""


def save_figure(figure: Figure, stem: Path) -> None:
    """Write a figure as vector and as bitmap."""
    with print_style():
        if engine := figure.get_layout_engine():
            # Everything gets its place once, for every format, and nothing is drawn for that.
            engine.execute(figure)
            figure.set_layout_engine(None)
        for name, stamps in STAMPS.items():
            # A name may end in what looks like a suffix: dft_v1.5.
            path = stem.with_name(f"{stem.name}.{name}")
            figure.savefig(path, dpi=PNG_DPI, metadata=dict.fromkeys(stamps))
