"""The tutorials as notebooks: ``python -m examples.notebooks`` pairs pages of docs/tutorials with docs/notebooks.

Jupytext reads `docs/jupytext.toml`, so that a page or its notebook may be changed in Jupyter. Nothing printed is kept.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1] / "docs"
PAGES = sorted(page for page in (DOCS / "tutorials").glob("*.md") if page.name != "index.md")

__all__ = ["PAGES", "notebook_of", "paired"]

KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def notebook_of(page: Path) -> Path:
    """The notebook of a page."""
    return DOCS / "notebooks" / f"{page.stem}.ipynb"


def paired(page: Path) -> Any:
    """A page as a notebook: its Python are cells, everything else is text; cells are numbered."""
    import jupytext

    notebook = jupytext.reads(page.read_text(encoding="utf-8"), fmt="md")
    notebook.metadata = {"kernelspec": KERNEL}
    for number, cell in enumerate(notebook.cells):
        cell["id"], cell["metadata"] = f"{page.stem}-{number}", {}
    return notebook


def main() -> None:
    """Write all notebooks."""
    import nbformat

    for page in PAGES:
        notebook_of(page).parent.mkdir(exist_ok=True)
        nbformat.write(paired(page), notebook_of(page))


if __name__ == "__main__":
    main()
