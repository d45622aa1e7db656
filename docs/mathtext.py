"""Formulas as pictures that matplotlib draws, because MathJax would be loaded from the network."""

from __future__ import annotations

import base64
import io
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

# Height of the letters of the page, in points.
LETTERS = 10


def image(node: nodes.Element, *, block: bool) -> str:
    """A formula as an image element, with its source as the text for readers who do not see it."""
    from matplotlib import rc_context
    from matplotlib.font_manager import FontProperties
    from matplotlib.mathtext import math_to_image

    source = " ".join(node.astext().split())
    drawing = io.BytesIO()
    size = LETTERS * (1.2 if block else 1)
    with rc_context(
        {
            "svg.fonttype": "path",
            "mathtext.fontset": "cm",
            "svg.hashsalt": "formula",
            "savefig.facecolor": "none",
        }
    ):
        depth = math_to_image(
            f"${source}$", drawing, prop=FontProperties(size=size), format="svg"
        )
    data = base64.b64encode(drawing.getvalue()).decode()
    alternative = (
        nodes.Text(source)
        .astext()
        .replace("&", "&amp;")
        .replace("<", "&lt;")
        .replace('"', "&quot;")
    )
    return (
        f'<img class="formula" src="data:image/svg+xml;base64,{data}" alt="{alternative}" '
        f'style="vertical-align: {-depth:.1f}pt">'
    )


def visit_inline(writer: Any, node: nodes.math) -> None:
    """Write a formula in a line."""
    writer.body.append(image(node, block=False))
    raise nodes.SkipNode


def visit_block(writer: Any, node: nodes.math_block) -> None:
    """Write a formula in a line of its own."""
    writer.body.append(f'<p class="formula">{image(node, block=True)}</p>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer ``mathtext``."""
    app.add_html_math_renderer("mathtext", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
