"""The directive `plot`: the figures that its code leaves open, in the colours of the page."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from feel321.analysis.figures import inline_svg

if TYPE_CHECKING:
    from sphinx.application import Sphinx

INK, FAINT = "#010203", "#8a8b8c"
"""Stand for colours of the page, which are light or dark."""

COLOURS = {
    INK: "currentColor",
    "#000000": "currentColor",
    FAINT: "var(--color-foreground-muted)",
    "#ffffff": "var(--color-background-primary)",
}
STYLE: dict[str, Any] = {
    "svg.fonttype": "none", "font.family": "sans-serif", "figure.figsize": (7.0, 3.0), "figure.facecolor": "none",
    "axes.facecolor": "none", "axes.edgecolor": INK, "axes.labelcolor": INK, "text.color": INK, "xtick.color": INK,
    "ytick.color": INK, "legend.frameon": False, "axes.spines.top": False, "axes.spines.right": False,
    "figure.constrained_layout.use": True, "axes.titlelocation": "left", "font.size": 11, "axes.titlesize": 11,
    "lines.linewidth": 0.9, "figure.dpi": 150, "svg.hashsalt": "feel321",
}  # fmt: skip


class Plot(SphinxDirective):
    """Runs the code and shows its figures."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Give the figures; the argument describes them for those who do not see them."""
        name = f"plot{self.env.new_serialno('plot')}"
        drawn = draw("\n".join(self.content), self.arguments[0], name=name)
        return [nodes.raw("", each, format="html") for each in drawn]


def draw(code: str, label: str, *, name: str) -> list[str]:
    """Run code and give its figures as HTML."""
    import matplotlib as mpl

    mpl.use("svg")
    import matplotlib.pyplot as plt

    plt.close("all")
    with mpl.rc_context(STYLE), tempfile.TemporaryDirectory() as folder:
        exec(compile(code, label, "exec"), {})  # noqa: S102 - a page's own code
        drawn = []
        for number in plt.get_fignums():
            path = Path(folder) / f"{number}.svg"
            plt.figure(number).savefig(path, metadata={"Date": None})
            drawn.append(
                f"<figure class='plot'>{colour(inline_svg(f'{name}-{number}', label, path))}</figure>"
            )
    plt.close("all")
    if not drawn:
        raise ValueError(f"plot {label!r}: the code draws no figure; leave one open")
    return drawn


def colour(svg: str) -> str:
    """Replace what stands for the page's colours, and leave fonts to the page."""
    for given, taken in COLOURS.items():
        svg = re.sub(given, taken, svg, flags=re.IGNORECASE)
    return re.sub(r"(font: [\d.]+px) [^;\"]*", r"\1 sans-serif", svg)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("plot", Plot)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
