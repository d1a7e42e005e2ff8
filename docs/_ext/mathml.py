"""Equations as MathML, which every current browser draws by itself: pages need no network and no script.

Sphinx's own renderers either load MathJax from the network or need LaTeX to make pictures. The package math-core
translates LaTeX to MathML when the pages are built, so that a mistake in an equation is an error of the build.
"""

from __future__ import annotations

from docutils import nodes
from math_core import LatexError, LatexToMathML
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator

MACROS = {
    "T": r"^{\mathsf{T}}",
    "dd": r"\mathrm{d}",
    "R": r"\mathbb{R}",
    "maximise": r"\operatorname*{maximise}",
    "minimise": r"\operatorname*{minimise}",
    "subjectto": r"\text{subject to}",
}
_log = logging.getLogger(__name__)
_converter = LatexToMathML(macros=MACROS, fancy_error=False)


def _convert(node: nodes.Element, display: bool) -> str:
    try:
        return _converter.convert_with_local_state(node.astext(), displaystyle=display)
    except LatexError as e:
        _log.warning("equation: %s\n%s", e, node.astext(), location=node)
        return ""


def inline(translator: HTML5Translator, node: nodes.math) -> None:
    """Math within a line."""
    translator.body.append(_convert(node, False))
    raise nodes.SkipNode


def block(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Math on lines of its own, with its number where it has a label."""
    translator.body.append(translator.starttag(node, "div", CLASS="equation"))
    if node["number"]:
        number = get_node_equation_number(translator, node)
        translator.body.append(f'<span class="eqno">({number})')
        translator.add_permalink_ref(node, "Link to this equation")
        translator.body.append("</span>")
    translator.body.append(f'<div class="formula">{_convert(node, True)}</div></div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Makes it Sphinx's renderer of equations."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
