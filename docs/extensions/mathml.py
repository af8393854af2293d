"""Formulas as MathML, which browsers show without a script and without a network."""

import re

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

FUNCTION = re.compile(r"<mi>(arctan|cos|det|ln|log|max|min|sin|sinc|tan)</mi>(?=<m[in])")
"""A function that stands before its argument without a bracket."""


def write_formula(tex: str, display: str = "inline") -> str:
    """Return a formula as MathML, with a thin space between a function and its argument."""
    return FUNCTION.sub(r'<mi>\1</mi><mspace width="0.17em"/>', convert(tex, display=display))


def visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    """Write a formula in a line."""
    translator.body.append(write_formula(node.astext()))
    raise nodes.SkipNode


def visit_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula of its own line, in a box that scrolls where it is wider than the page."""
    formula = write_formula(node.astext(), display="block")
    translator.body.append(f'<div class="formula" tabindex="0">{formula}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Name the renderer `mathml`."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
