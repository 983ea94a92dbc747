"""The tutorials as notebooks: they are the pages, and run from top to bottom."""

from __future__ import annotations

import json
import re

import pytest
from examples.notebooks import PAGES, notebook_of, paired

NAMES = [page.stem for page in PAGES]


def cells(page):
    return json.loads(notebook_of(page).read_text(encoding="utf-8"))["cells"]


def text(cell):
    return "".join(cell["source"])


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_a_notebook_has_the_python_of_its_page(page):
    code = re.findall(r"^```python\n(.*?)\n```$", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    found = [cell for cell in cells(page) if cell["cell_type"] == "code"]
    assert [text(cell) for cell in found] == code
    assert not any(cell["outputs"] or cell["execution_count"] for cell in found)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_a_notebook_is_the_pair_of_its_page(page):
    pytest.importorskip("jupytext", reason="needs the extra notebooks")
    expected = [(cell.cell_type, cell.source) for cell in paired(page).cells]
    assert [(cell["cell_type"], text(cell)) for cell in cells(page)] == expected, "python -m examples.notebooks"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_a_notebook_runs(page, tmp_path):
    nbclient = pytest.importorskip("nbclient", reason="needs the extra notebooks")
    pytest.importorskip("ipykernel", reason="needs the extra notebooks")
    import nbformat

    notebook = nbformat.read(notebook_of(page), as_version=4)
    nbclient.NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": tmp_path}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert not [output for output in shown if output.output_type == "error"]
    assert list(tmp_path.glob("tutorial_*.png"))
