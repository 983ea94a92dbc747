"""The site builds without a warning, its pages are found from the first, no link is dead, nothing foreign is loaded."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from examples.pipeline import FIGURE, drawn

import bayeq as bq
from bayeq import errors, figures

DOCS = Path(__file__).parents[1] / "docs"
ADAPTERS = Path(bq.__file__).parent / "adapters"

# `python -m sphinx`, which would search its many small objects for garbage a fifth of the time.
SPHINX = "import gc, sys; gc.disable(); from sphinx.cmd.build import main; sys.exit(main(sys.argv[1:]))"

# Made by Sphinx, and reached by its search and its index.
GENERATED = {"genindex.html", "py-modindex.html", "search.html"}

# Attributes of elements that a browser follows by itself.
LOADED = {"src", "srcset", "poster", "data"}
LOADING_LINKS = {
    "stylesheet",
    "icon",
    "shortcut icon",
    "preload",
    "prefetch",
    "preconnect",
    "manifest",
    "modulepreload",
}


class Page(HTMLParser):
    """What a page is identified by, leads to and loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.formulas = 0
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.ids |= {given[name] for name in ("id", "name") if given.get(name)}
        self.formulas += tag == "math"
        self.loads += [value for name, value in attributes if name in LOADED and value]
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        elif tag == "link" and given.get("rel") in LOADING_LINKS:
            self.loads.append(given["href"])


def sphinx(source, out, *options, path=""):
    """Run Sphinx as `make site` does; skips where it is not installed."""
    for package in ("sphinx", "myst_parser", "furo", "numpydoc"):
        pytest.importorskip(package, reason="the site needs the extra docs")
    command = [sys.executable, "-c", SPHINX, "--fail-on-warning", "--keep-going", "--quiet", *options]
    paths = os.pathsep.join(filter(None, [path, os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [*command, "-d", out / "doctrees", source, out / "html"],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    done = sphinx(DOCS, out)
    assert done.returncode == 0, done.stderr
    return out / "html"


@pytest.fixture(scope="module")
def pages(site):
    return {path.relative_to(site).as_posix(): Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}


def target(page, link):
    """The file that a link of a page leads to, and the place in it; None for a link to elsewhere."""
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return None
    file = os.path.normpath(os.path.join(os.path.dirname(page), unquote(parts.path))) if parts.path else page
    return file, unquote(parts.fragment)


def test_every_page_is_found_from_the_first(pages):
    found, left = set(), ["index.html"]
    while left:
        page = left.pop()
        if page in found:
            continue
        found.add(page)
        leads = [target(page, link) for link in pages[page].links]
        left += [to[0] for to in leads if to is not None and to[0] in pages]
    sources = {path.relative_to(DOCS).with_suffix(".html").as_posix() for path in DOCS.rglob("*.md")}
    assert sources == set(pages) - GENERATED
    assert set(pages) - GENERATED <= found


def test_no_link_is_dead(site, pages):
    dead = []
    for page, content in pages.items():
        for link in [*content.links, *content.loads]:
            to = target(page, link)
            if to is None:
                continue
            file, place = to
            if not (site / file).is_file() or (place and file in pages and place not in pages[file].ids):
                dead.append(f"{page}: {link}")
    assert not dead


def test_nothing_is_loaded_from_elsewhere(site, pages):
    foreign = [
        f"{page}: {link}"
        for page, content in pages.items()
        for link in content.loads
        if target(page, link) is None and not link.startswith("data:")
    ]
    for sheet in site.rglob("*.css"):
        text = re.sub(r"/\*.*?\*/", "", sheet.read_text(encoding="utf-8"), flags=re.DOTALL)
        loads = re.findall(r"(?:url\(|@import\s+)['\"]?([^'\")\s;]+)", text)
        foreign += [f"{sheet.name}: {link}" for link in loads if re.match(r"(https?:)?//", link)]
    assert not foreign
    assert (site / "_static" / "math.woff2").is_file()


def test_every_public_name_has_one_entry(pages):
    entries = Counter(entry for content in pages.values() for entry in content.ids)
    names = {f"bayeq.{name}" for name in bq.__all__}
    names |= {f"bayeq.figures.{name}" for name in figures.__all__}
    names |= {f"bayeq.errors.{name}" for name in errors.__all__ if isinstance(getattr(errors, name), type)}
    modules = [path for path in ADAPTERS.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()]
    names |= {f"module-bayeq.adapters.{path.stem}" for path in modules if path.stem != "__init__"}
    assert {name: entries[name] for name in names} == dict.fromkeys(names, 1)


def test_the_table_of_the_front_page_is_what_was_measured():
    """Its rows are the likelihood's, against both of PySINDy's pipelines."""
    with (DOCS / "tables" / "states_only.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    ours, weak, differences = (
        [f"{float(row['exact_percent']):.0f}" for row in rows if row["method"] == method]
        for method in ("auto", "pysindy weak", "pysindy differences")
    )
    shown = re.findall(r"^\|.+%((?: \| \d+){3}) \|$", (DOCS / "index.md").read_text(encoding="utf-8"), re.MULTILINE)
    expected = [" | " + " | ".join(counts) for counts in zip(ours, weak, differences, strict=True)]
    assert shown == expected


def test_formulas_are_drawn_by_the_browser(site, pages):
    stages = [page for page in pages if page.startswith("method/")]
    assert all(pages[page].formulas for page in stages)
    for page in stages:
        text = (site / page).read_text(encoding="utf-8")
        assert not re.search(r"\\(frac|sum|left|theta)|\$\$", text), page


@pytest.mark.parametrize(("formula", "complaint"), [(r"\unheard x", "unheard"), (r"\tfrac12 x", r"write \frac{1}{2}")])
def test_a_formula_that_cannot_be_drawn_fails(formula, complaint, tmp_path):
    (tmp_path / "index.md").write_text(f"# Title\n\n$${formula}$$\n", encoding="utf-8")
    settings = 'extensions = ["myst_parser", "native_mathml"]\nmyst_enable_extensions = ["dollarmath"]\n'
    (tmp_path / "conf.py").write_text(f'{settings}html_math_renderer = "native_mathml"\n', encoding="utf-8")
    done = sphinx(tmp_path, tmp_path / "out", path=str(DOCS / "_extensions"))
    assert done.returncode != 0
    assert complaint in done.stderr
    assert "index.md:3" in done.stderr


def test_the_picture_of_the_pipeline_is_what_is_drawn():
    assert FIGURE.read_text(encoding="utf-8") == drawn()
