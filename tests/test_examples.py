"""The worked examples: what they claim, and that their page is what they print."""

from __future__ import annotations

import csv
import re
import textwrap
import warnings
from pathlib import Path

import pytest
from examples import air_track, coupled, encoder, pendulum, populations, tanks
from examples.__main__ import DOCS, EXAMPLES, PAGE, main
from examples.page import Example, markers, put_blocks

from bayeq.errors import ConvergenceWarning, DataWarning
from tests.data import ROOT, measured

FENCED = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def page() -> str:
    return PAGE.read_text(encoding="utf-8")


def ran(module) -> Example:
    measured(module.FILE)
    example = Example(module.NAME)
    module.run(example, ROOT)
    return example


# --- the page -------------------------------------------------------------------------------------------------------


def test_the_page_shows_the_code_there_is():
    sources = "".join(Path(module.__file__).read_text(encoding="utf-8") for module in EXAMPLES.values())
    blocks = [text for language, text in FENCED.findall(page()) if language == "python"]
    assert len(blocks) == len(markers(page()))
    for code in blocks:
        assert textwrap.indent(code, 8 * " ") in sources


def test_every_decimal_of_the_text_is_printed_or_in_the_table():
    with (DOCS / "tables" / "examples.csv").open(encoding="utf-8") as file:
        assert next(file).startswith("# python -m examples")
        known = " ".join(row["value"] for row in csv.DictReader(file))
    known += " ".join(text for _, text in FENCED.findall(page()))
    printed = set(re.findall(r"\d+\.\d+", known))
    rounded = {f"{float(number):.{digits}f}" for number in printed for digits in (2, 3)}
    prose = re.sub(r"\[.*?\]\(.*?\)", "", FENCED.sub("", page()))
    quoted = set(re.findall(r"\d+\.\d+", prose)) - {"2.0"}  # a licence
    assert len(quoted) > 10
    assert quoted <= printed | rounded


def test_every_example_has_its_figure():
    for name in EXAMPLES:
        assert f"figures/example_{name}.png" in page()
        assert (DOCS / "figures" / f"example_{name}.png").is_file()


# --- how it is written ----------------------------------------------------------------------------------------------


def test_a_block_keeps_its_source_and_what_it_prints():
    example = Example("a")
    with example.block("b"):
        value = 2

        print(value + 1)
        warnings.warn("as it was", ConvergenceWarning, stacklevel=1)
        warnings.warn("said elsewhere", DataWarning, stacklevel=1)
    code, output = (text for _, text in FENCED.findall(example.blocks["b"]))
    assert code.startswith("value = 2\n\nprint(value + 1)\n")
    assert output == "3\nwarning: as it was\n"
    text = put_blocks("before\n<!-- begin: a b -->\nold\n<!-- end -->\nafter", [example])
    assert text == f"before\n<!-- begin: a b -->\n\n{example.blocks['b']}\n\n<!-- end -->\nafter"
    assert put_blocks(text, [example]) == text
    with pytest.raises(ValueError, match="lacks <!-- begin: a b -->"):
        put_blocks("no place", [example])


def test_absent_records_are_named(tmp_path, capsys):
    assert main(["--data", str(tmp_path), "tanks"]) == 2
    message = capsys.readouterr().err
    assert tanks.FILE in message
    assert str(tmp_path) in message
    assert main(["nothing"]) == 2
    assert "no example is called 'nothing'" in capsys.readouterr().err


# --- what is claimed ------------------------------------------------------------------------------------------------


@pytest.mark.slow  # the same record refined: test_refine
def test_refined_rates_of_the_populations():
    example = ran(populations)
    assert set(example.blocks) == {"found", "refined"}
    refined = [value for quantity, value in example.numbers.items() if quantity.endswith("refined")]
    assert len(refined) == 4
    # of the published medians, as the page says
    assert all(abs(int(re.search(r"([+-]\d+) %", value).group(1))) <= 15 for value in refined)


@pytest.mark.slow  # the same record and law: test_discovery
def test_the_air_track_s_law():
    example = ran(air_track)
    found = example.blocks["found"]
    assert re.search(r"\na = -6\.22\d*\*x\n", found)
    assert "verdict: nearly true: 1." in found
    assert "v, a: computed from x, not measured" in found
    assert "verdict: not determined" in example.blocks["exact"]


@pytest.mark.slow  # masses of a simulated row: test_between, test_physical
def test_the_coupled_masses_check_each_other():
    example = ran(coupled)
    springs = example.blocks["springs"].split("```text")[1]
    assert float(re.search(r"ratio of stiffness (\S+)", springs).group(1)) == pytest.approx(1, abs=0.03)
    errors = [float(e) for e in re.findall(r"x[12] (\d\S*) %", example.blocks["runs"].split("```text")[1])]
    assert len(errors) == 4
    assert max(errors) < 6


@pytest.mark.slow
def test_the_tanks_need_a_hidden_level():
    example = ran(tanks)
    first, second = example.blocks["found"], example.blocks["second"]
    for warning in ("left out as clipped", "no equation found", "verdict: none"):
        assert warning in first
        assert warning in second
    assert float(re.search(r"y: normalised RMS error ([\d.e+]+) %", first).group(1)) > 100
    hidden = example.blocks["hidden"]
    assert re.search(r"\ndy = 0\.01\d*\*sqrt\(abs\(h\)\) - 0\.0\d*\*sqrt\(y\)", hidden)
    assert "hidden h: odds of the equations without it 1:" in hidden
    assert float(re.search(r"y: normalised RMS error ([\d.]+) %", hidden).group(1)) < 60


@pytest.mark.slow
def test_the_encoder_s_law_is_nearly_true():
    example = ran(encoder)
    found = example.blocks["found"]
    assert re.search(r"\nddth = 64\.\d*\*sin\(th\) - 0\.30\d*\*sign\(w\)\n", found)
    assert "verdict: nearly true: 0." in found
    assert "cannot tell sign(w)" in found


@pytest.mark.slow  # a measured pendulum's sine: test_discovery; what an example claims: the populations
def test_the_pendulum_needs_friction_that_is_not_found():
    example = ran(pendulum)
    assert re.search(r"\na = -1\.33\d*\*sin\(o\)\n", example.blocks["found"])
    assert re.search(r"from o alone: a = -1\.35\d*\*sin\(o\)", example.blocks["period"])
    errors = [int(e) for e in re.findall(r"whole record: o (\d+) %", example.blocks["friction"].split("```text")[1])]
    none, viscous, quadratic, coulomb = errors
    assert max(viscous, quadratic) < 0.5 * coulomb < none
