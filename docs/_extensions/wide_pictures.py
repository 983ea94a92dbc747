"""Wide pictures: marked for the style sheet, which lets them scroll on a telephone, and linked to the whole picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.images import get_image_size

WIDE = 800  # pixels: twice what a telephone shows


def mark_wide(app: Sphinx, doctree: nodes.document) -> None:
    for image in doctree.findall(nodes.image):
        size = get_image_size(Path(app.srcdir, image["uri"]))
        if size is not None and size[0] > WIDE:
            image["classes"].append("wide")
            image["width"] = "100%"  # Sphinx links pictures with a width to the whole picture


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("doctree-read", mark_wide, priority=600)  # after Sphinx has made paths relative to the folder of pages
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
