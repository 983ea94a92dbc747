"""The tutorials: ``python -m examples.tutorials`` runs them and keeps their pictures; names choose some."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

from examples.run_page import run_page

__all__ = ["PAGES", "draw_tutorials"]

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = [DOCS / "your_own_file.md", *sorted((DOCS / "tutorials").glob("*.md"))]


def draw_tutorials(names: list[str]) -> None:
    """Run the pages, all of them if no names are given, and put their pictures into docs/figures."""
    os.environ.setdefault("MPLBACKEND", "Agg")
    for page in PAGES:
        if names and page.stem not in names:
            continue
        print(page.stem, file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            run_page(page)
            for picture in sorted(Path(folder).glob("tutorial_*.png")):
                shutil.copy(picture, DOCS / "figures")
            os.chdir(DOCS)


if __name__ == "__main__":
    draw_tutorials(sys.argv[1:])
