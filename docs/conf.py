"""Sphinx's settings. Build with ``make docs``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from pygments.lexers.rust import RustLexer
from sphinx.application import Sphinx

import phugoid

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))
os.environ.setdefault("MPLBACKEND", "Agg")

project = "Phugoid"
author = "the authors of Phugoid"
copyright = author
release = version = phugoid.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
    "myst_parser",
    "sphinx_copybutton",
    "docstrings",
    "executed",
    "mathml",
]
exclude_patterns = ["_build", "gallery", "gallery/*"]
# Names in `single quotes` in docstrings are references where there is such a thing, else literals.
default_role = "py:obj"
smartquotes = False  # primes are derivatives

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "amsmath"]
myst_heading_anchors = 3
# CONTRIBUTING.md and README.md are included as they are, and link to files beside them.
suppress_warnings = ["myst.xref_missing", "config.cache"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_type_aliases = {
    "_Array": "ndarray",
    "FloatArray": "ndarray",
    "ArrayLike": "ArrayLike",
    "NDArray": "ndarray",
}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
add_module_names = False
html_math_renderer = "mathml"
math_eqref_format = "({number})"

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "filename_pattern": "/",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "abort_on_example_error": True,
    "min_reported_time": 10_000,
    "reset_modules": ("matplotlib", "examples_on_path.examples_on_path"),
    "reset_modules_order": "both",
    "within_subsection_order": "FileNameSortKey",
}

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

html_theme = "furo"
html_title = f"Phugoid {release}"
html_static_path = ["_static"]
html_css_files = ["phugoid.css"]
html_show_sphinx = False
html_show_copyright = False


def setup(app: Sphinx) -> None:
    """Names of languages that Rust's documentation knows and Pygments does not."""
    app.add_lexer("rust,no_run", RustLexer)
