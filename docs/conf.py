"""How Sphinx builds the site: `make site` writes it into build/site, and takes every warning for an error."""

from __future__ import annotations

import logging
import sys
from importlib.metadata import version as installed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "bayeq"
author = "The bayeq developers"
copyright = author
release = version = installed("bayeq")

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "native_mathml", "wide_pictures"]

# Pages are Markdown, with formulas between dollars, and links to headings as on GitHub.
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
# A pattern of the start page may match no page yet; Sphinx gives this warning no type that could be suppressed.
logging.getLogger("sphinx.sphinx.directives.other").addFilter(lambda record: "toctree glob pattern" not in record.msg)

# The reference is made of docstrings. Names between single backticks are links, or code where there is no such name.
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # units and shapes stand in the docstring
numpydoc_show_class_members = False
numpydoc_validation_checks = {"GL07", "GL10", "PR01", "PR02", "PR03", "PR04", "PR07", "PR10", "RT03", "YD01"}
# Results list what they hold, and are not made by users.
numpydoc_validation_overrides = {"PR01": [r"Attributes\s+-", "Attributes are those of"]}
# Scikit-learn's own methods.
ROUTING = ", ".join(
    ["get_metadata_routing", *(f"set_{one}_request" for one in ("fit", "partial_fit", "predict", "score"))]
)
autodoc_default_options = {"exclude-members": ROUTING}
python_maximum_signature_line_length = 90

html_theme = "furo"
html_title = f"bayeq {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_math_renderer = "native_mathml"
pygments_style = "friendly"


def hide_constructor(app, what, name, obj, options, signature, returns):
    """No signature for results: what they hold is listed below it, and users do not make them."""
    text = obj.__doc__ or ""
    return ("", None) if what == "class" and "Attributes" in text and "Parameters\n" not in text else None


def link_to_contributing(app, name, source):
    """CONTRIBUTING.md is a page of the site, under a name of its own."""
    up = "../" * name.count("/")
    source[0] = source[0].replace(f"]({up}../CONTRIBUTING.md", f"]({up}contributing.md")


def setup(app):
    app.connect("autodoc-process-signature", hide_constructor)
    app.connect("source-read", link_to_contributing)
