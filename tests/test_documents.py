"""Every page is run: its Python, its commands, and what these are said to print."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from examples import tutorials
from examples.run_page import blocks, check_printed, run_page

ROOT = Path(__file__).parents[1]
PAGES = {str(page.relative_to(ROOT)): page for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]}

# Python and commands are run. The others are what is printed, lines for a shell that are not run, changes of a file,
# other languages.
RUN = {"python", "console"}
LANGUAGES = RUN | {"text", "sh", "diff", "json", "matlab", "c", "julia"}

# Pages whose blocks other tests run: on measured records, in a copy of the source, and with more to say of the result.
ELSEWHERE = {
    "docs/examples.md": "test_examples.py",
    "docs/extending.md": "test_extending.py",
    "docs/pysindy.md": "test_pysindy.py",
}

# Pages of many discoveries, whose questions other tests ask of shorter records.
LONG = {
    "docs/gallery.md",  # each picture: test_pictures
    "docs/index.md",  # as the README
    "docs/batch.md",
    "docs/commands.md",
    "docs/faq.md",
    "docs/answer.md",
    "docs/arviz.md",
    "docs/laws.md",
    "docs/matlab.md",
    "docs/tutorials/channels.md",
    "docs/tutorials/engines.md",
    "docs/tutorials/first_equation.md",
    "docs/tutorials/pysindy.md",
    "docs/tutorials/reading_pips.md",
    "docs/working.md",
    "docs/your_own_file.md",
}

HAVE_CODE = [name for name, page in PAGES.items() if RUN & {block.language for block in blocks(page)}]


def test_every_table_begins_with_the_command_that_made_it():
    for table in sorted((ROOT / "docs/tables").glob("*.csv")):
        first = table.read_text(encoding="utf-8").partition("\n")[0]
        assert re.match(r"# (bayeq study|python -m (studies|tests|examples))\b", first), table.name


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in HAVE_CODE if name not in ELSEWHERE],
)
def test_a_page_does_what_it_says(name, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="pages draw with the extra plot")
    if "import pysindy" in PAGES[name].read_text(encoding="utf-8"):
        pytest.importorskip("pysindy", reason="the page needs the extra pysindy")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo").mkdir()  # as make demo does
    run_page(PAGES[name])
    pictures = re.findall(r"\((?:\.\./)?figures/(tutorial_\w+\.png)\)", PAGES[name].read_text(encoding="utf-8"))
    for picture in pictures:
        assert (tmp_path / picture).is_file(), f"the code of the page does not draw {picture}"
        assert (ROOT / "docs" / "figures" / picture).is_file(), f"{picture} is absent: make tutorials"


@pytest.mark.parametrize("name", PAGES)
def test_blocks_name_a_language_that_is_known(name):
    languages = {block.language for block in blocks(PAGES[name])}
    assert {language for language in languages if not language.startswith("{")} <= LANGUAGES  # {note}: of the web site


def test_pages_that_are_run_elsewhere_are_there():
    for name, module in ELSEWHERE.items():
        assert name in HAVE_CODE
        assert (ROOT / "tests" / module).is_file()


def test_every_tutorial_is_listed_and_has_a_picture():
    pages = [page for page in (ROOT / "docs" / "tutorials").glob("*.md") if page.name != "index.md"]
    listed = (ROOT / "docs" / "tutorials" / "index.md").read_text(encoding="utf-8")
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert f"]({page.name})" in listed
        assert "../figures/tutorial_" in text.split("\n## ")[0], f"{page.name}: the picture comes first"


@pytest.mark.parametrize("name", PAGES)
def test_links_to_files_and_headings_lead_somewhere(name):
    page = PAGES[name]
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        file, _, heading = target.partition("#")
        other = (page.parent / file).resolve() if file else page
        assert other.exists(), f"{name}: no file {file}"
        if heading and other.suffix == ".md":
            assert heading in anchors(other), f"{name}: no heading #{heading} in {other.name}"


def anchors(page):
    """Names of the headings of a page, as GitHub makes them."""
    found = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in found}


# --- what runs the pages --------------------------------------------------------------------------------------------


def run(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "page.md").write_text(text, encoding="utf-8")
    run_page(tmp_path / "page.md")


def test_pictures_of_the_pages_chosen_are_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tutorials, "DOCS", tmp_path)
    pages = [tmp_path / "a.md", tmp_path / "b.md"]
    for page in pages:
        page.write_text(f"```python\nopen('tutorial_{page.stem}.png', 'w').close()\n```\n", encoding="utf-8")
    monkeypatch.setattr(tutorials, "PAGES", pages)
    (tmp_path / "figures").mkdir()
    tutorials.draw_tutorials(["b"])
    assert [path.name for path in (tmp_path / "figures").iterdir()] == ["tutorial_b.png"]


def test_a_command_that_prints_something_else_fails(tmp_path, monkeypatch):
    run(tmp_path, monkeypatch, "```console\n$ bayeq systems\nduffing\n```\n")
    with pytest.raises(AssertionError, match="no line with 'no such system'"):
        run(tmp_path, monkeypatch, "```console\n$ bayeq systems\nno such system\n```\n")


def test_a_command_that_fails_says_why(tmp_path, monkeypatch):
    with pytest.raises(AssertionError, match=r"exit code 2\n.*absent\.csv"):
        run(tmp_path, monkeypatch, "```console\n$ bayeq info absent.csv\n```\n")


def test_python_that_prints_something_else_fails(tmp_path, monkeypatch):
    page = "```python\nprint('k', 1000.4)\n```\n\n```text\n{}\n```\n"
    run(tmp_path, monkeypatch, page.format("k 1003"))
    with pytest.raises(AssertionError, match="no line with 'k 1100'"):
        run(tmp_path, monkeypatch, page.format("k 1100"))


def test_blocks_share_names_and_text_elsewhere_is_not_compared(tmp_path, monkeypatch):
    run(
        tmp_path,
        monkeypatch,
        "```python\na = 1\n```\n\nA file:\n\n```text\nzzz\n```\n\n```python\nassert a == 1\n```\n",
    )


def test_a_block_without_an_end_is_refused(tmp_path):
    (tmp_path / "page.md").write_text("```python\nx = 1\n", encoding="utf-8")
    with pytest.raises(ValueError, match="has no end"):
        blocks(tmp_path / "page.md")


@pytest.mark.parametrize(
    ("said", "printed", "same"),
    [
        ("a = -1003.6*x", "a = -1004.1*x", True),
        ("a = -1003.6*x", "a = 1003.6*x", False),
        ("x**3", "x**4", False),
        ("| x  | 2.0 |", "|  x |   2.3 |", False),
        ("| x  | 2.0 |", "| x |   2.03 |", True),
        ("found: ... within 7 %", "verdict: found: R2 0.9; within 7.1 % of it", True),
        ("PIP 0.0005", "PIP 0.002", False),
    ],
)
def test_numbers_agree_within_a_tolerance_and_words_exactly(said, printed, same):
    if same:
        check_printed([said], printed, "page")
    else:
        with pytest.raises(AssertionError):
            check_printed([said], printed, "page")
