"""The paper is cited by the same words everywhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import bayeq as bq
from bayeq.citation import PAPER_AUTHORS, PAPER_TITLE
from bayeq.cli.app import main
from tests.data import ROOT as DATA

ROOT = Path(__file__).parents[1]


def one_line(text: str) -> str:
    return " ".join(text.replace("\n>", "\n").split())


def test_the_command_cites_the_paper_and_this_version(capsys):
    assert main(["--cite"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert f"{', '.join(PAPER_AUTHORS)}, {PAPER_TITLE}." in out
    assert f"version {bq.__version__}." in out
    entries = re.findall(r"^@(\w+)\{([\w-]+),\n((?:  \w+ = \{.+\},\n)+)\}", out, flags=re.MULTILINE)
    assert [(kind, key) for kind, key, _ in entries] == [("misc", "nayek-worden-cross"), ("software", "bayeq")]
    assert f"  author = {{{' and '.join(PAPER_AUTHORS)}}},\n" in entries[0][2]
    assert f"  version = {{{bq.__version__}}},\n" in entries[1][2]
    assert out.count("{") == out.count("}")


def test_readme_and_citation_file_name_the_same_paper():
    readme = one_line((ROOT / "README.md").read_text(encoding="utf-8"))
    assert f"{', '.join(PAPER_AUTHORS)}, *{PAPER_TITLE}*" in readme
    file = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"    title: {PAPER_TITLE}\n" in file
    given = re.findall(r"given-names: (.+)\n +family-names: (.+)\n", file)
    assert tuple(" ".join(names) for names in given) == PAPER_AUTHORS


@pytest.mark.data
def test_title_and_authors_are_those_on_the_paper():
    paper = DATA.parent / "paper" / "nayek-worden-cross-spike-slab-vb.txt"
    if not paper.is_file():
        pytest.skip("the paper's text is not there")
    text = one_line(paper.read_text(encoding="utf-8"))
    assert text.startswith(f"{PAPER_TITLE} {', '.join(PAPER_AUTHORS[:-1])}, and {PAPER_AUTHORS[-1]} Abstract")
