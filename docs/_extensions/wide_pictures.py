"""Pictures: shown at half their pixels, for fine screens; wide ones scroll on a telephone; all lead to the whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.images import get_image_size

WIDE = 600  # pixels of the page, from which a picture is as wide as the page
FINE = 2  # pixels of a picture for one of the page, as on fine screens


def mark_wide(app: Sphinx, doctree: nodes.document) -> None:
    for image in doctree.findall(nodes.image):
        size = get_image_size(Path(app.srcdir, image["uri"]))
        if size is None:
            continue
        # Sphinx links pictures with a width to the whole picture
        image["width"] = f"{size[0] // FINE}px"
        if size[0] > FINE * WIDE or image["uri"].endswith(".svg"):
            image["classes"].append("wide")
            image["width"] = "100%"


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("doctree-read", mark_wide, priority=600)  # after Sphinx has made paths relative to the folder of pages
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
