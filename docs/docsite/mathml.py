"""Formulas as MathML, which browsers draw themselves: no script, no network, and screen readers read them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator


def _convert(formula: str, *, as_block: bool = False) -> str:
    """Convert a formula; an accent is grouped first, or docutils puts the index below it instead of beside it."""
    return tex2mathml(re.sub(r"(\\(?:tilde|hat|bar)\s*\w)", r"{\1}", formula), as_block=as_block)


def _visit_inline(writer: HTML5Translator, node: nodes.math) -> None:
    writer.body.append(_convert(node.astext()))
    raise nodes.SkipNode


def _visit_block(writer: HTML5Translator, node: nodes.math_block) -> None:
    formula = _convert(" ".join(node.astext().split()), as_block=True)
    writer.body.append(
        f'<div class="formula" tabindex="0" role="group" aria-label="Formula">{formula}</div>'
    )
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer that conf.py names."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
