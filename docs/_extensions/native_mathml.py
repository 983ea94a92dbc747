"""Formulas as MathML, which browsers draw by themselves; docutils makes it while the site is built."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

# LaTeX takes the first digit for the numerator, docutils all of them.
UNBRACED = re.compile(r"\\[dt]?frac\s*\d")

# Names of functions stand apart from what is before and after them, but for a bracket.
APPLIED = r"<mo>&ApplyFunction;</mo>"
BEFORE = re.compile(rf"(</m(?:i|n|frac|sub|sup|subsup|row)>\s*)(<mi[^>]*>\w+</mi>\s*{APPLIED})")
AFTER = re.compile(rf"{APPLIED}(?!\s*(?:<mrow>\s*)?<mo[^>]*>\()")
THIN = '<mspace width="0.167em"/>'

LOGGER = logging.getLogger(__name__)


def mathml(node: nodes.Element, block: bool) -> str:
    """The formula of a node; one that cannot be read is a warning, and stands as it was written."""
    text = " ".join(node.astext().split())
    if UNBRACED.search(text):
        LOGGER.warning("formula %r: write \\frac{1}{2}, not \\frac12, which is read as \\frac{12}", text, location=node)
    try:
        # a prime is a letter of its own size in MathML, not an apostrophe
        drawn = tex2mathml(text, as_block=block).replace("<mo>'</mo>", "<mo>′</mo>")
    except MathError as error:
        LOGGER.warning("formula %r cannot be drawn: %s", text, error, location=node)
        return f"<code>{nodes.unescape(text)}</code>"
    return AFTER.sub(APPLIED + THIN, BEFORE.sub(rf"\1{THIN}\2", drawn))


def visit_inline(self: HTML5Translator, node: nodes.Element) -> None:
    self.body.append(mathml(node, block=False))
    raise nodes.SkipNode


def visit_block(self: HTML5Translator, node: nodes.Element) -> None:
    self.body.append(self.starttag(node, "div", CLASS="formula"))
    self.body.append(mathml(node, block=True))
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer(
        "native_mathml", inline_renderers=(visit_inline, None), block_renderers=(visit_block, None)
    )
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
