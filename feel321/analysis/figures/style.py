"""How figures look: their size, text, legends and files.

Conventions: one and a half columns wide (14 cm), which fills a page of 700 pixels with text of its body's size; every
reducer has a colour and a marker of its own, the same in all figures, and nothing else has a colour: metrics, scales
and verdicts are told apart by ink, grey, fill and line style. Files are for print; on a page `PAGE_COLOURS` follow
the reader's choice of light or dark.
"""

from __future__ import annotations

import re
import warnings
from bisect import bisect_right
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from feel321.analysis.table.schema import HIGHEST, LOWEST
from feel321.analysis.words import format_measure, format_name, wrap_name
from feel321.doors import check_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path
    from xml.etree.ElementTree import Element

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from numpy.typing import ArrayLike

COLUMN_CM, WIDTH_CM = 8.5, 14.0
"""Width of a journal's column, and of figures."""

CM_PER_INCH = 2.54
THIN, GREY, BLACK, PALE = 0.5, "#757575", "#000000", "#DEDEDE"
BLUE, RED = "#0072B2", "#D55E00"

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


@dataclass(frozen=True, slots=True)
class Look:
    """Colour and marker of a reducer."""

    colour: str
    marker: str


def assign_looks(reducers: Sequence[str]) -> dict[str, Look]:
    """Give every reducer a look."""
    colours, markers = len(OKABE_ITO), len(MARKERS)
    return {
        name: Look(OKABE_ITO[i % colours], MARKERS[i % markers]) for i, name in enumerate(reducers)
    }


@contextmanager
def print_style() -> Iterator[None]:
    """Set fonts and lines for print while figures are drawn or saved."""
    from matplotlib import rc_context, rcParamsDefault

    # All settings but the window's start from the library's own: a matplotlibrc in the working folder must not
    # change a byte.
    plain = {
        name: value
        for name, value in rcParamsDefault.items()
        if not name.startswith(("backend", "_"))
    }
    with rc_context({**plain, **PRINT}), warnings.catch_warnings():
        # `list_undrawable` lists them once.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def list_undrawable(names: Iterable[str]) -> str:
    """List the characters that the figures' font does not have."""
    from matplotlib.font_manager import findfont, get_font

    known = get_font(findfont(PRINT["font.family"])).get_charmap()
    return "".join(
        sorted({letter for name in names for letter in name if ord(letter) not in known})
    )


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


# Words in figures: broken by measured width, so that no name runs off or into another.

AXIS_CM, SCALE_LETTERS = 6.0, 60
"""Length of an axis's label, and letters of a scale's name within it."""

SIZE = float(PRINT["font.size"])
POINTS_PER_CM = 72 / CM_PER_INCH
MARGIN_CM = 0.2
SNUG = 0.96
"""Share of its place that a line may take by measure: on a screen letters are up to 4 % wider."""

LONGEST = 200
"""Letters of a name that are looked at, from its start and from its end."""

TITLE_LINES = 10


def label_scale(scale: str, length_cm: float = AXIS_CM, *, level: str = "") -> str:
    """Label an axis of that length by the scale that was rated, and by the level where there are several."""
    measure = wrap_name(format_measure(scale), SCALE_LETTERS, lines=1)
    of = f", level {wrap_name(format_name(level), SCALE_LETTERS, lines=1)}" if level else ""
    return fit_text(f"Mean {measure}{of} ({LOWEST:.0f}–{HIGHEST:.0f})", length_cm, lines=3)


def fit_text(text: str, width_cm: float, *, lines: int = 2, size: float = SIZE) -> str:
    """Break a text into lines that are no wider than their place.

    lines: how many lines at most; size: of the letters, in points.

    Examples
    --------
    >>> fit_text("dft321_windowed_by_its_authors_2026", 2.0).splitlines()
    ['dft321_', 'windo…2026']
    """
    if len(text) > 2 * LONGEST:
        text = f"{text[:LONGEST]}…{text[-LONGEST:]}"
    room = SNUG * width_cm * POINTS_PER_CM
    found, parts = [""], _split(text)
    while parts:
        part = parts.pop(0)
        if not part.startswith("\n") and _measure((found[-1] + part).strip(), size) <= room:
            found[-1] += part
        elif len(found) == lines:
            found[-1] = _cut((found[-1] + part + "".join(parts)).replace("\n", " "), room, size)
            break
        elif found[-1]:
            found.append("")
            parts.insert(0, part.strip("\n"))
        else:
            fits = _count_fitting(part, room, size)
            found[-1] = part[:fits]
            parts.insert(0, part[fits:])
    return "\n".join(line.strip() for line in found)


def add_title(figure: Figure, text: str) -> None:
    """Write above a figure what it finds, then what it shows, and give it the height that this takes."""
    size = PRINT["figure.titlesize"]
    fitted = fit_text(text, WIDTH_CM - 2 * MARGIN_CM, lines=TITLE_LINES, size=size)
    title = figure.suptitle(fitted, x=MARGIN_CM / WIDTH_CM, ha="left")
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + title.get_window_extent().height / figure.dpi)


def _split(text: str) -> list[str]:
    """Part a text where a line may break: before line breaks, after spaces and underscores."""
    return re.findall(r"\n[^\s_]*_*[^\S\n]*|[^\s_]+_*[^\S\n]*|_+[^\S\n]*|[^\S\n]+", text)


def _count_fitting(text: str, room: float, size: float) -> int:
    """Count the letters of a word that fit into a line, one at least."""
    return max(
        1, bisect_right(range(1, len(text)), room, key=lambda count: _measure(text[:count], size))
    )


def _cut(text: str, room: float, size: float) -> str:
    """Leave the middle out."""

    def shorten(kept: int) -> str:
        tail = kept // 2
        return f"{text[: kept - tail].rstrip()}…{text[len(text) - tail :].lstrip()}"

    kept = (
        bisect_right(range(len(text)), room, key=lambda count: _measure(shorten(count), size)) - 1
    )
    return shorten(max(0, kept))


def _measure(text: str, size: float) -> float:
    """Find how wide a text is, in points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(family=PRINT["font.family"], size=size)
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])


# Names beside the axes, and legends below a figure.

END_CM, ROW_CM = 3.6, 0.38
"""Width of a name beside the axes, and the least distance between two."""


def label_ends(
    axes: Axes, heights: Mapping[str, float], looks: Mapping[str, Look], *, height_cm: float
) -> bool:
    """Name reducers at the right of axes of that height, each at its own; return False if there are too many."""
    if not heights or len(heights) * ROW_CM > height_cm:
        return False
    order = sorted(heights, key=lambda name: -heights[name])
    low, high = axes.get_ylim()
    places = spread([heights[name] for name in order], (high - low) * ROW_CM / height_cm, low=low)
    of_axes = axes.get_yaxis_transform()
    for name, place in zip(order, places, strict=True):
        strokes: dict[str, Any] = {"transform": of_axes, "clip_on": False, "linewidth": THIN}
        axes.plot([1.0, 1.025], [heights[name], place], color=GREY, **strokes)
        mark: dict[str, Any] = {"transform": of_axes, "clip_on": False, "size": 5.0}
        plot_marks(axes, [1.04], [place], look=looks[name], **mark)
        axes.text(1.055, place, fit_text(name, END_CM, lines=1), transform=of_axes, va="center")
    return True


def spread(falling: Sequence[float], apart: float, *, low: float) -> list[float]:
    """Move heights, from the highest down, until each is so far below the one before, and the last not below low."""
    places: list[float] = []
    for height in falling:
        places.append(min(height, places[-1] - apart) if places else height)
    floor = low
    for number in range(len(places) - 1, -1, -1):
        places[number] = max(places[number], floor)
        floor = places[number] + apart
    return places


# Legends below a figure.

COLUMNS, LETTERS = 5, 30


def add_legend(figure: Figure, shown: Mapping[str, Artist]) -> None:
    """Give the legend of names as many columns as there is room for, and the figure the height that it takes."""
    tight: dict[str, Any] = {"loc": "outside lower center", "handletextpad": 0}
    tight |= {"columnspacing": 0.6, "frameon": False}
    labels = [wrap_name(name, LETTERS) for name in shown]
    for columns in range(COLUMNS, 0, -1):
        legend = figure.legend(list(shown.values()), labels, ncols=columns, **tight)
        size = legend.get_window_extent()
        if size.width <= figure.bbox.width or columns == 1:
            break
        legend.remove()
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + size.height / figure.dpi)


def make_handles(looks: Mapping[str, Look]) -> dict[str, Artist]:
    """Make what stands for each name in a legend."""
    from matplotlib.lines import Line2D

    rim: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white", "markeredgewidth": THIN}
    return {
        name: Line2D([], [], color=look.colour, marker=look.marker, **rim)
        for name, look in looks.items()
    }


# How figures are saved: as vector and as bitmap, the same bytes for the same data.

PNG_DPI = 300

STAMPS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    "svg": ("Date", "Creator", "Format", "Type"),
    "png": ("Software",),
    "pdf": ("CreationDate", "Creator", "Producer"),
})
"""Format -> what matplotlib writes into its files beside the drawing: its version and the hour, which differ."""


def save_figure(figure: Figure, stem: Path, *, formats: Sequence[str] = ("svg", "png")) -> None:
    """Write a figure as vector and as bitmap."""
    for name in formats:
        check_name(name, STAMPS, "formats")
    with print_style():
        if engine := figure.get_layout_engine():
            # Everything gets its place once, for every format, and nothing is drawn for that.
            engine.execute(figure)
            figure.set_layout_engine(None)
        for name in formats:
            # A name may end in what looks like a suffix: dft_v1.5.
            path = stem.with_name(f"{stem.name}.{name}")
            figure.savefig(path, dpi=PNG_DPI, metadata=dict.fromkeys(STAMPS[name]))
            if name == "svg":
                shorten_svg(path)


SVG, LINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
INHERITED = {
    "font-family": f"'{PRINT['font.family']}', Verdana, sans-serif", "stroke-linejoin": "round",
    "stroke-linecap": "butt",
}  # fmt: skip
"""What all parts of a drawing inherit. Fonts of the same widths: text is kept as text, for search, screen readers and
small files."""

KEPT = "points-"
"""Marks whose group has a name that begins like this keep it in the SVG file, for a page's script."""


def shorten_svg(path: Path) -> None:
    """Leave out of an SVG file what a browser does not need: groups, names, repeated styles, precision, white space."""
    from xml.etree import ElementTree as ET

    for prefix, space in (("", SVG), ("xlink", LINK)):
        ET.register_namespace(prefix, space)
    text = path.read_text(encoding="utf-8")
    root = ET.fromstring(text)  # noqa: S314 - matplotlib's own file
    for name, value in INHERITED.items():
        root.set(name, value)
    # Names that matplotlib makes of the last digits of a place differ between processes.
    used = dict.fromkeys(re.findall(r'(?:url\(|href=")#([\w-]+)', text))
    names = {name: f"n{number}" for number, name in enumerate(used)}
    for node in root.iter():
        _shorten_node(node, names)
    _unwrap(root)
    path.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8", newline="")


def _shorten_node(node: Element, names: Mapping[str, str]) -> None:
    for key, value in list(node.attrib.items()):
        if key == "id":
            if value in names or not value.startswith(KEPT):
                del node.attrib["id"]
            if value in names:
                node.set("id", names[value])
            continue
        short = _round(value if key != "style" else value.replace(FAMILY, ""))
        node.set(key, REFERENCE.sub(lambda found: names[found[0]], short))
    if node.get("transform", "").startswith("rotate(-0 "):
        del node.attrib["transform"]
    node.text = node.text if node.text and node.text.strip() else None
    node.tail = None


REFERENCE = re.compile(r"(?:(?<=url\(#)|(?<=^#))[\w-]+")
FAMILY = f"font-family: '{PRINT['font.family']}'; "


def _round(value: str) -> str:
    """Round to a hundredth of a point, and leave needless white space out."""
    short = re.sub(
        r"-?\d+\.\d{3,}", lambda found: f"{float(found[0]):.2f}".rstrip("0").rstrip("."), value
    )
    return re.sub(r"\s+", " ", re.sub(r"(?<=[:;]) |\s*\n\s*(?=[A-Za-z])", "", short)).strip()


def _unwrap(node: Element) -> None:
    """Put what is in groups without a meaning in their place; style sheets of a drawing would style its whole page."""
    children: list[Element] = []
    for child in node:
        _unwrap(child)
        bare = child.tag == f"{{{SVG}}}g" and not child.attrib
        empty = child.tag in {f"{{{SVG}}}{name}" for name in ("metadata", "style")} or (
            child.tag == f"{{{SVG}}}defs" and not len(child)
        )
        for one in list(child) if bare else [] if empty else [child]:
            if not (children and _join(children[-1], one)):
                children.append(one)
    node[:] = children
    styles = {child.get("style") for child in children}
    if len(children) > 1 and len(styles) == 1 and None not in styles and node.get("style") is None:
        node.set("style", str(styles.pop()))
        for child in children:
            del child.attrib["style"]


def _join(first: Element, second: Element) -> bool:
    """Join open lines of the same look, such as bars, into one path; return whether that was done."""
    own, other = dict(first.attrib), dict(second.attrib)
    one, more = own.pop("d", ""), other.pop("d", "")
    if not (
        one and more and own == other and "id" not in own and "fill:none" in own.get("style", "")
    ):
        return False
    first.set("d", f"{one} {more}")
    return True
