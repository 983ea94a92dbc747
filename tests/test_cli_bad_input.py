"""Bad input on the command line: exit code 2, one line that says what, where and what to do, and no traceback."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from bayeq.cli.app import main
from bayeq.cli.terminal import COMPILING, PROGRESS
from tests.draws import draws

HEADER = ("t", "x", "v", "a", "u", "note")
CHANNELS = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u"]
SIMPLE = ["--dictionary", "x,v,u"]
# A tenth of the time, where it is not of the states that a test speaks.
AS_MEASURED = ["--smooth", "none"]
Rows = list[list[object]]


def rows(n: int = 60) -> Rows:
    """An oscillator, a = -9*x - 0.4*v + u, and a column that is not used."""
    rng = np.random.default_rng(1)
    t = np.arange(n) / 10
    x, v, u = np.sin(3 * t) + 0.1 * t, 3 * np.cos(3 * t) + 0.1 * t, rng.normal(size=n)
    a = -9 * x - 0.4 * v + u + 0.01 * rng.normal(size=n)
    return [[*map(float, cells), k % 7] for k, cells in enumerate(zip(t, x, v, a, u, strict=True))]


def changed(row: int, column: str, value: object, n: int = 60) -> Rows:
    """The same with one sample changed; rows are counted from 1."""
    out = rows(n)
    out[row - 1][HEADER.index(column)] = value
    return out


def filled(column: str, value: float) -> Rows:
    out = rows()
    for row in out:
        row[HEADER.index(column)] = value
    return out


def missing(count: int) -> Rows:
    """The same without the first samples of x."""
    out = rows()
    for row in out[:count]:
        row[HEADER.index("x")] = ""
    return out


def put(path: Path, table: Rows, header: Sequence[str] = HEADER) -> None:
    lines = [",".join(header), *(",".join(map(str, row)) for row in table)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    put(tmp_path / "run.csv", rows())
    return tmp_path


class Outcome:
    """What a command gave."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err


Run = Callable[..., Outcome]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: str) -> Outcome:
        code = main(list(arguments))
        return Outcome(code, *capsys.readouterr())

    return call


def assert_refused(outcome: Outcome, *parts: str) -> str:
    """Exit code 2 and one line with these parts."""
    assert outcome.code == 2, outcome.err
    assert outcome.out == ""
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("bayeq: error: ")
    assert "Traceback" not in outcome.err
    assert len(lines[0]) < 600
    for part in parts:
        assert part in lines[0]
    return lines[0]


def assert_answered(outcome: Outcome) -> str:
    """Exit code 0, a result on stdout, only warnings on stderr."""
    assert outcome.code == 0, outcome.err
    assert outcome.out.strip()
    said = [line for line in outcome.err.splitlines() if line != COMPILING and not line.startswith(PROGRESS)]
    assert all(line.startswith("bayeq: warning: ") for line in said), outcome.err
    return outcome.out


def test_columns_of_the_same_name_are_warned_of(run: Run, folder: Path) -> None:
    put(folder / "twice.csv", rows(), ("t", "x", "v", "a", "u", "x"))
    outcome = run("discover", "twice.csv", *CHANNELS, *SIMPLE, *AS_MEASURED)
    assert_answered(outcome)
    line = "bayeq: warning: twice.csv: columns 2 and 6 have the same name: they are read as x, x_2;"
    assert sum(warning.startswith(line) for warning in outcome.err.splitlines()) == 1


# --- files -----------------------------------------------------------------------------------------------------------


def test_missing_file(run: Run, folder: Path) -> None:
    assert_refused(run("discover", "rnu.csv", *CHANNELS), "no such file: rnu.csv", "did you mean 'run.csv'?")
    assert_refused(run("discover", "nowhere/run.csv", *CHANNELS), "nowhere/run.csv", "no directory nowhere")
    assert_refused(run("discover", "run.csv", "rux.csv", *CHANNELS), "no such file: rux.csv", "'run.csv'")
    assert_refused(run("discover", "\0", *CHANNELS), "FILE", "null byte")
    assert_refused(run("discover", "a" * 300, *CHANNELS), "aaa")


def test_directory(run: Run, folder: Path) -> None:
    (folder / "data.csv").mkdir()
    assert_refused(run("discover", "data.csv", *CHANNELS), "data.csv: the folder has no file that can be streamed")


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (b"", ["bad.csv: the file is empty"]),
        (b"\n\n", ["bad.csv: the file is empty"]),
        (b"# nothing\n", ["bad.csv: the file is empty but for comments"]),
        (b"t,x,v,a,u\n", ["bad.csv: a header but no rows"]),
        (bytes(range(256)), ["bad.csv: not a text file"]),
        (b"t\n0\n1\n", ["bad.csv: no channels besides time"]),
        (b"t,x\n0,1\n1,2,3\n", ["bad.csv, line 3: 3 values where 2 are expected"]),
        (b"t,x,v\n0,1\n1,2\n", ["bad.csv, line 2: 2 values, but the header in line 1 names 3 columns"]),
        (b"t;x\n0;1,5\n1;1.000,5\n", ["bad.csv, line 2, column 'x': '1,5' is not a number", "decimal mark"]),
    ],
)
def test_files_without_a_table(run: Run, folder: Path, content: bytes, parts: list[str]) -> None:
    (folder / "bad.csv").write_bytes(content)
    assert_refused(run("discover", "bad.csv", "--chain", "x"), *parts)


@pytest.mark.parametrize("name", ["bad.npz", "bad.parquet", "bad.xlsx"])
def test_files_that_are_not_what_their_names_say(run: Run, folder: Path, name: str) -> None:
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    (folder / name).write_bytes(b"\x00PK rubbish\n" * 9)
    assert_refused(run("discover", name, *CHANNELS), name)


@pytest.mark.parametrize(
    ("table", "parts"),
    [
        (changed(5, "x", "abc"), ["line 6, column 'x': 'abc' is not a number; correct it"]),
        (changed(5, "t", "noon"), ["line 6, column 't': 'noon' is not a number"]),
        (changed(5, "u", "1_000"), ["line 6, column 'u': '1_000' is not a number"]),
        (changed(5, "t", 0.35), ["column 't'", "time must increase", "from 0.4 to 0.55", "row 6", "sort"]),
        (changed(5, "t", ""), ["column 't'", "time is missing", "row 5", "leave these rows out"]),
        (changed(5, "t", "inf"), ["column 't'", "time is infinite", "row 5"]),
        (filled("x", 1.0), ["channel 'x' is constant (1 in all 60 rows)", "leave it out"]),
        (filled("u", 0.0), ["channel 'u' is constant (0 in all 60 rows)", "leave it out"]),
        (filled("a", -9.81), ["channel 'a' is constant"]),
        (filled("x", 1.0)[:1] + filled("x", 1e200)[1:], ["channel 'x' is 1e+200 in row 2", "too large", "larger unit"]),
        (rows(1), ["1 row: too few", "at least 10"]),
        (rows(9), ["9 rows: too few", "at least 10"]),
        (missing(51), ["9 rows of 60 with a sample of every channel: too few", "at least 10"]),
    ],
)
def test_bad_samples(run: Run, folder: Path, table: Rows, parts: list[str]) -> None:
    if "0.55" in "".join(parts):
        table = changed(5, "t", 0.55)  # the row after it is earlier
        parts = ["column 't'", "time must increase", "from 0.55 to 0.5", "row 6", "sort the rows by time"]
    put(folder / "bad.csv", table)
    assert_refused(run("discover", "bad.csv", *CHANNELS), "bad.csv", *parts)


def test_channels_too_small_to_square(run: Run, folder: Path) -> None:
    table = rows()
    for row in table:
        row[1] = float(str(row[1])) * 1e-200
    put(folder / "bad.csv", table)
    assert_refused(run("discover", "bad.csv", *CHANNELS), "bad.csv: channel 'x' varies by", "smaller unit")


@pytest.mark.parametrize("cell", ["nan", "inf", "", "abc", "12:30", "é"])
def test_columns_that_are_not_used_may_hold_anything(run: Run, folder: Path, cell: str) -> None:
    put(folder / "ok.csv", changed(5, "note", cell))
    smooth = [] if cell == "abc" else AS_MEASURED  # a word, through all that is done
    assert "a = " in assert_answered(run("discover", "ok.csv", *CHANNELS, *SIMPLE, *smooth))
    assert_answered(run("discover", "ok.csv", "--chain", "x:v:a", "--input", "u", *SIMPLE, *AS_MEASURED))


def test_a_later_file_is_named(run: Run, folder: Path) -> None:
    put(folder / "second.csv", changed(3, "x", "abc"))
    assert_refused(run("discover", "run.csv", "second.csv", *CHANNELS), "second.csv", "line 4")
    put(folder / "third.csv", rows(), ["t", "x", "w", "a", "u", "note"])
    assert_refused(run("discover", "run.csv", "third.csv", *CHANNELS), "third.csv: no channel named 'v'")


# --- columns ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--disp", "xx"], ["no channel named 'xx'", "did you mean 'x'?"]),
        (["--disp", "x", "--vel", "vel"], ["no channel named 'vel'", "did you mean 'v'?"]),
        (["--disp", "x", "--acc", "acc"], ["no channel named 'acc'", "'a'"]),
        (["--disp", "x", "--vel", "v", "--force", "U1"], ["no channel named 'U1'", "did you mean 'u'?"]),
        (["--chain", "x", "--input", "noet"], ["no channel named 'noet'", "did you mean 'note'?"]),
        (["--chain", "x:w:a"], ["no channel named 'w'", "there are: x, v, a, u, note"]),
        ([*CHANNELS, "--time", "tt"], ["no column named 'tt'", "'t'"]),
        ([*CHANNELS, "--group", "nota"], ["no column named 'nota'", "did you mean 'note'?"]),
        ([*CHANNELS, "--names", "t,x,v"], ["names gives 3 names for 6 columns"]),
    ],
)
def test_unknown_columns(run: Run, options: list[str], parts: list[str]) -> None:
    assert_refused(run("discover", "run.csv", *options), "run.csv: ", *parts)


def test_group_with_gaps(run: Run, folder: Path) -> None:
    put(folder / "bad.csv", changed(5, "note", ""))
    assert_refused(run("discover", "bad.csv", *CHANNELS, "--group", "note"), "bad.csv, column 'note'", "row 5", "trial")


FORM = "write it as x:v:a"


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ([], ["no coordinate given", "name the displacement", "x:v:a"]),
        (["--chain", ""], ["chain ''", FORM]),
        (["--chain", ":"], ["chain ':' names no channel", FORM]),
        (["--chain", "::a", "--smooth", "none"], ["chain '::a'", "integrated", "smooth"]),
        (["--chain", "x:v:a:u:note:t"], ["order 5", "at most 4", FORM]),
        (["--chain", "x y"], ["no channel named 'x_y'", "did you mean 'x'?"]),
        (["--chain", "x;v"], ["no channel named 'x_v'"]),
        (["--chain", "x:2v"], ["no channel named '_2v'", "did you mean 'v'?"]),
        (["--chain", "lambda:v"], ["'lambda' is not a channel name (a column lambda is called lambda_)", FORM]),
        (["--chain", "::as"], ["'as' is not a channel name (a column as is called as_)", FORM]),
        (["--chain", "x" * 5000 + "-"], ["is not a channel name", FORM]),
        (["--chain", "x:x:a"], ["chain 'x:x:a' names a channel twice", FORM]),
        (["--chain", "x:v:a", "--chain", "u:v"], ["'v' occurs in chain 'x:v:a' and in chain 'u:v'"]),
        (["--disp", "x", "--vel", "x"], ["names a channel twice"]),
        (["--disp", "x", "--vel", "v", "--force", "v"], ["channel 'v' is both an input and part of a chain"]),
        (["--disp", "x", "--force", "u", "--input", "u"], ["an input is named twice: u, u"]),
        (["--disp", "x", "--chain", "x"], ["either chains or displacement", "not both"]),
        (["--disp", "x:v"], ["displacement 'x:v' is not a channel's name", "chain"]),
        (["--disp", ""], ["displacement '' is not a channel's name"]),
    ],
)
def test_bad_chains(run: Run, options: list[str], parts: list[str]) -> None:
    assert_refused(run("discover", "run.csv", *options), *parts)


def test_a_measured_derivative_that_the_chain_leaves_out(run: Run, folder: Path) -> None:
    put(folder / "bad.csv", rows(), ["t", "x", "dx", "a", "u", "note"])
    assert_refused(run("discover", "bad.csv", "--chain", "x::"), "leaves 'dx' to be estimated", "name it in the chain")


def test_derivatives_need_time(run: Run, folder: Path) -> None:
    # rows in no order
    mixed = np.random.default_rng(0).permutation(rows())
    put(folder / "bad.csv", [[row[1]] for row in mixed], ["x"])
    assert_refused(run("discover", "bad.csv", "--chain", "x::"), "bad.csv: 'dx'", "needs a time column or fs")


# --- options ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--method", "lasso"], ["--method", "'lasso' is not one of 'auto', 'vb'"]),
        (["--smooth", "maybe"], ["--smooth", "'maybe' is not one of 'auto', 'band', 'none'"]),
        (["--holdout", "1"], ["holdout is a share of the rows, 0 <= holdout < 1, got 1.0"]),
        (["--holdout", "-0.1"], ["holdout", "got -0.1"]),
        (["--holdout", "nan"], ["holdout", "got nan"]),
        (["--holdout", "half"], ["--holdout", "valid float"]),
        (["--fs", "0"], ["run.csv: the sampling rate fs must be positive and finite, not 0.0"]),
        (["--fs", "nan"], ["fs must be positive and finite, not nan"]),
        (["--fs", "1e-320"], ["sampling rate", "out of range for 60 rows"]),
        (["--fs", "10", "--time", "t"], ["time and fs are both given; give one of them"]),
        (["--seed", "x"], ["--seed", "valid integer"]),
        (["--save", "."], [".: is a directory; name a file in it"]),
        (["--save", "nowhere/eq.json"], ["nowhere/eq.json: cannot be written", "no directory nowhere"]),
        (["--sensitivity", "."], [".: is a directory; name a file in it"]),
        (["--sensitivity", "nowhere/pip.csv"], ["nowhere/pip.csv: cannot be written", "no directory nowhere"]),
        (["--sensitivity", "pip.xls"], ["pip.xls: is to be written as a table or a figure", ".csv, .png"]),
        (["--sensitivity", "run.csv"], ["run.csv: is a file that is read; name another file"]),
        (["--sensitivity", "pip.csv", "--save", "pip.csv"], ["pip.csv: named twice"]),
        (["--sensitivity", "pip.csv", "--method", "rvm"], ["method 'rvm' has no v_s and p_0", "auto, vb, bma"]),
        (["--forze", "u"], ["No such option", "--forze", "--force"]),
        (["--dictionary"], ["--dictionary", "requires an argument"]),
        (["--disp"], ["--disp", "requires an argument"]),
    ],
)
def test_bad_options(run: Run, options: list[str], parts: list[str]) -> None:
    assert_refused(run("discover", "run.csv", *CHANNELS, *options), *parts)


def test_bad_commands(run: Run) -> None:
    assert_refused(run(), "no command given; there are: info, discover, batch, show, predict, plan, simulate", "--help")
    assert_refused(run("discover"), "Missing argument 'FILE...'")
    assert_refused(run("discouver", "run.csv"), "No such command 'discouver'")
    assert_refused(run("--forze"), "No such option", "--forze")


# --- dictionaries ----------------------------------------------------------------------------------------------------

LANGUAGE = "there are numbers, names, + - * / **"


@pytest.mark.parametrize("template", ["{}", "x,{}", "{},x"])
@pytest.mark.parametrize(
    ("term", "parts"),
    [
        ("__import__('os').system('touch hacked')", ["not allowed"]),
        ("().__class__.__bases__", ["not allowed"]),
        ("(lambda: 1)()", ["not allowed", LANGUAGE]),
        ("[x for x in y]", ["'[' at column 1 is not allowed", LANGUAGE]),
        ("sin[3*x]", ["'[' at column 4 is not allowed: arguments stand in round brackets, sin(...)"]),
        ("x if v else u", ["the word 'if' is not allowed", LANGUAGE]),
        ('f"{x}"', ["""'"' at column 2 is not allowed""", LANGUAGE]),
        ("x;v", ["';' at column 2 is not allowed", LANGUAGE]),
        ("x := 1", ["':' at column 3 is not allowed"]),
        ("x == v", ["'==' at column 3 is not allowed", "conditions of where"]),
        ("x = v", ["'=' at column 3 is not allowed", "right-hand side"]),
        ("where(x, 1, 2)", ["where needs a condition at column 7"]),
        ("sin(x", ["missing ')' at column"]),
        ("x\n+v", ["a term is one line"]),
        ("x**", ["malformed"]),
        ("x)", ["')' at column 2 closes no bracket"]),
        ("2x", ["'2x' is not a number"]),
        ("x\0", [r"'\x00'", "not allowed"]),
        ("\x1b[31mx*v", ["not allowed"]),
        ("qqq(x)", ["no function 'qqq'", "there are: sin, cos"]),
        ("sinn(x)", ["no function 'sinn'", "did you mean 'sin'?"]),
        ("sin(x, v)", ["sin takes exactly one argument, not 2"]),
        ("sin()", ["exactly one argument"]),
        ("sin", ["sin is a function and needs its argument"]),
        ("k*x", ["no channel named 'k'", "there are: x, v, u"]),
        ("(" * 5000 + "x" + ")" * 5000, ["longer than 1000 characters"]),
        ("(" * 400 + "x" + ")" * 400, []),
        ("sin(" * 90 + "x" + ")" * 90, ["nested deeper than"]),
        ("-" * 900 + "x", ["nested deeper than"]),
        ("+x" * 450, ["nested deeper than"]),
        ("1e999*x", ["a number is too large"]),
    ],
)
def test_terms_that_are_no_terms(run: Run, folder: Path, template: str, term: str, parts: list[str]) -> None:
    text = template.format(term)
    line = assert_refused(run("discover", "run.csv", *CHANNELS, "--dictionary", text), "dictionary", *parts)
    assert "\x1b" not in line
    if template == "x,{}":
        assert "term 2" in line
    assert not (folder / "hacked").exists()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("oscilator", ["no dictionary named 'oscilator'; did you mean 'oscillator'?"]),
        ("polynom:3", ["no dictionary named 'polynom:3'", "did you mean 'polynomial"]),
        ("polynomial:0", ["'polynomial:0'", "whole number from 1 to 20", "as in polynomial:3"]),
        ("polynomial:x", ["'polynomial:x'", "whole number from 1 to 20"]),
        ("polynomial:999", ["'polynomial:999'", "whole number from 1 to 20"]),
        ("polynomial:0000000000000012345", ["whole number from 1 to 20"]),
        ("polynomial:", ["whole number from 1 to 20"]),
        ("polynomial:-1", ["whole number from 1 to 20"]),
        ("oscillator:²", ["whole number from 1 to 20"]),
        ("nosuch", ["no dictionary named 'nosuch'", "oscillator, polynomial", "terms of x, v, u"]),
        ("", ["no dictionary named ''", "oscillator"]),
        ("x.__class__", ["no such file of terms: 'x.__class__'", "not a term", "no attributes"]),
        ("tirms.txt", ["no such file of terms: 'tirms.txt'; did you mean 'terms.txt'?"]),
        ("nowhere/terms.txt", ["no such file of terms: 'nowhere/terms.txt'", "no directory nowhere"]),
        (".", [".: is a directory; name a file of terms"]),
        ("a" * 400 + ".txt", ["not"]),
        ("x,,v", ["term 2: empty", "comma"]),
        (",", ["term 1: empty"]),
        ("x,v,x", ["term 3: term 'x' was already given (dictionary, term 1)"]),
        ("x,v,x+0*q", ["column 5: no channel named 'q'"]),
        ("oscillator - x**9", ["no term named 'x**9'", "nothing to leave out"]),
        ("oscillator + q", ["no channel named 'q'"]),
        ("oscilator + x", ["did you mean the dictionary 'oscillator'?"]),
        ("neighbours", ["two coordinates or more"]),
        ("a: oscillator; b: x", ["no equation named 'b'"]),
        ("b: x; v", ["'v': write the target of its equation in front"]),
        ("a,x", ["a would stand on both sides"]),
        ("1,2", ["no usable term", "1: constant on the data"]),
        ("1/0", ["no usable term", "not finite"]),
        ("9**9**9**9**9", ["no usable term", "not finite"]),
    ],
)
def test_bad_dictionaries(run: Run, folder: Path, text: str, parts: list[str]) -> None:
    (folder / "terms.txt").write_text("x\n")
    assert_refused(run("discover", "run.csv", *CHANNELS, "--dictionary", text), *parts)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--chain", "x", "--dictionary", "x; v; u"], "brackets and functions, and commas between terms"),
        (["--chain", "x", "--dictionary", "x, where(v => {c}, 1, 0)"], "'=>' at column 9 is not allowed: write >="),
        (["--chain", "x", "--dictionary", "x, v"], "has it: name it as an input, --input v"),
        (["--chain", "x", "--dictionary", "x, q"], "if it is hidden, state its rate, --law 'dq = ...'"),
        (["--target", "a", "--input", "x", "--dictionary", "x, v"], "has it: name it as an input, --input v"),
        (["--target", "a", "--input", "x", "--dictionary", "x, a"], "a is what the law gives: leave it out"),
        (["--chain", "x", "--dictionary", "x, x[1]", "--discrete"], "earlier samples of maps are x[-1] to x[-20]"),
        (["--chain", "x", "--dictionary", "x, x(-1)", "--discrete"], "an earlier sample of a map is written x[-1]"),
        (["--chain", "x", "--dictionary", "x, x(k-2)", "--discrete"], "an earlier sample of a map is written x[-2]"),
        (["--chain", "x", "--chain", "v", "--conserve", "x, v"], "conserve 'x, v': write the sum alone: x + v"),
        (["--chain", "x", "--chain", "v", "--conserve", "x+v = 1"], "conserve 'x+v = 1': write the sum alone: x+v"),
        (["--chain", "x", "--chain", "v", "--conserve", ""], "--conserve is empty: write a sum, 'S + I', or"),
        (["--chain", "x", "--differs", " "], "--differs is empty: write terms, 'x, v', or all, or leave it out"),
    ],
)  # fmt: skip
def test_what_was_meant_is_told(run: Run, options: list[str], said: str) -> None:
    assert_refused(run("discover", "run.csv", *options), said)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ("df = (u - f)/tau", "law df: expression '(u - f)/tau', column 9: no channel named 'tau'"),
        ("df = (u - f)/tau", "an unknown constant is written {tau}"),
        ("df = (u - f)/{tau", "law df: expression"),
        ("df == (u - f)/{tau}", "with one ="),
        ("ddf = (u - f)/{tau}", "it is of first order; write two laws, df = g and dg = ..."),
    ],
)
def test_a_law_that_is_none_is_told_as_one(run: Run, law: str, said: str) -> None:
    options = ["--chain", "x::", "--input", "u", "--dictionary", "x, dx, f", "--law", law]
    assert_refused(run("discover", "run.csv", *options), said)


def test_dictionaries_of_equations(run: Run) -> None:
    one, two = ("--dictionary", "x, v, u"), ("--dictionary", "oscillator:2")
    assert_refused(run("discover", "run.csv", *CHANNELS, *one, *two), "--dictionary is given more than once")
    of_a = ["--dictionary", "a: polynomial:1 + sin(x)"]
    assert "a = " in assert_answered(run("discover", "run.csv", *CHANNELS, *of_a, *AS_MEASURED))


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (b"", ["terms.txt: no terms in the file; write one per line"]),
        (b"# none\n\n", ["terms.txt: no terms in the file"]),
        (b"\x00\xff\xfe\x80", ["terms.txt: not a text file", "one term per line"]),
        (b"x\n# c\n\nv**\n", ["terms.txt, line 4: expression 'v**': malformed"]),
        (b"x\n\x00\n", ["terms.txt, line 2", "not allowed"]),
        (b"x\nk\n", ["terms.txt, line 2", "no channel named 'k'"]),
        (b"x\nv\nx\n", ["terms.txt, line 3: term 'x' was already given (terms.txt, line 1)"]),
        (b"x, v\n", ["terms.txt, line 1", "',' at column 2 is not allowed"]),
        (b"x\n__import__('os')\n", ["terms.txt, line 2", "not allowed"]),
        (b"x" * 1_000_001, ["terms.txt: larger than 1000000 bytes"]),
    ],
)
def test_bad_files_of_terms(run: Run, folder: Path, content: bytes, parts: list[str]) -> None:
    (folder / "terms.txt").write_bytes(content)
    assert_refused(run("discover", "run.csv", *CHANNELS, "--dictionary", "terms.txt"), *parts)


@pytest.mark.parametrize(
    "text", ["x", "x**2*v", "x/v", "x,v,sin(x)", " x , v ", "terms.txt", "polynomial:2", "9**9**9,x"]
)
def test_dictionaries_that_are_fine(run: Run, folder: Path, text: str) -> None:
    (folder / "terms.txt").write_text("x  # stiffness\n\nv\n")
    assert_answered(run("discover", "run.csv", *CHANNELS, "--dictionary", text, *AS_MEASURED))


# --- simulate --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["dufing", "-o", "r.csv"], ["no system named 'dufing'; did you mean 'duffing'?"]),
        (["", "-o", "r.csv"], ["no system named ''", "linear", "duffing"]),
        (["duffing"], ["Missing option '--output'"]),
        (["-o", "r.csv"], ["Missing argument 'SYSTEM'"]),
        (["duffing", "-o", "r.csv", "--n", "0"], ["n must be at least 2, not 0"]),
        (["duffing", "-o", "r.csv", "--n", "-3"], ["n must be at least 2, not -3"]),
        (["duffing", "-o", "r.csv", "--n", "1.5"], ["--n", "valid integer"]),
        (["duffing", "-o", "r.csv", "--fs", "0"], ["fs must be positive, not 0.0"]),
        (["duffing", "-o", "r.csv", "--fs", "nan"], ["fs must be finite, not nan"]),
        (["duffing", "-o", "r.csv", "--fs", "0.001"], ["diverged", "raise fs"]),
        (["duffing", "-o", "r.csv", "--noise", "-1"], ["noise is a ratio of the signal, from 0 to 1e+06, not -1.0"]),
        (["duffing", "-o", "r.csv", "--noise", "inf"], ["noise must be finite, not inf"]),
        (["duffing", "-o", "r.csv", "--perturb", "nan"], ["perturb must be finite, not nan"]),
        (["duffing", "-o", "r.csv", "--seed", "-1"], ["seed must be a non-negative int", "not -1"]),
        (["duffing", "-o", "r.xyz"], ["r.xyz: no format for the suffix '.xyz'", ".csv, .tsv"]),
        (["duffing", "-o", "r"], ["r: no format for the suffix ''", ".csv"]),
        (["duffing", "-o", "nowhere/r.csv"], ["nowhere/r.csv: cannot be written", "No such file or directory"]),
        (["duffing", "-o", "dir.csv"], ["dir.csv: cannot be written", "directory"]),
    ],
)
def test_bad_simulations(run: Run, folder: Path, arguments: list[str], parts: list[str]) -> None:
    (folder / "dir.csv").mkdir()
    n = [] if "--n" in arguments else ["--n", "100"]
    assert_refused(run("simulate", *arguments, *n), *parts)
    assert not (folder / "r.csv").exists()


# --- what is allowed -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [pytest.param(20, marks=pytest.mark.slow), 30])
def test_few_rows_are_answered_with_warnings(run: Run, folder: Path, n: int) -> None:
    put(folder / "few.csv", rows(n))
    outcome = run("discover", "few.csv", *CHANNELS, *AS_MEASURED)
    assert_answered(outcome)
    assert f"bayeq: warning: only {n} rows" in outcome.err
    assert re.search(rf"bayeq: warning: {n} training rows for \d+ candidate terms: fewer rows than terms", outcome.err)


@pytest.mark.parametrize("cell", ["", *(pytest.param(cell, marks=pytest.mark.slow) for cell in ("nan", "NA"))])
def test_missing_samples_are_answered_with_a_warning(run: Run, folder: Path, cell: str) -> None:
    table = changed(5, "x", cell)
    table[29][3] = cell
    put(folder / "gaps.csv", table)
    outcome = run("discover", "gaps.csv", *CHANNELS, *SIMPLE)
    assert_answered(outcome)
    assert "bayeq: warning: x: 1 sample is missing (row 5: 1.7 %)" in outcome.err
    assert "bayeq: warning: a: 1 sample is missing (row 30: 1.7 %)" in outcome.err
    assert_refused(run("discover", "gaps.csv", *CHANNELS, "--smooth", "none"), "channel 'x' has 1 NaN", "row 5")


def test_files_of_one_column(run: Run, folder: Path) -> None:
    x = [[row[1]] for row in rows()]
    put(folder / "one.csv", x, ["x [m]"])
    for options in (["--chain", "x"], ["--disp", "x"], ["--chain", "x::", "--smooth", "none"]):
        assert_answered(run("discover", "one.csv", *options, "--fs", "10", "--dictionary", "x"))
    (folder / "bare.txt").write_text("".join(f"{value}\n" for [value] in x))
    assert_answered(run("discover", "bare.txt", "--chain", "y", "--names", "y", "--fs", "10", *AS_MEASURED))
    assert_answered(run("discover", "bare.txt", "--chain", "c1", "--fs", "10", *AS_MEASURED))
    assert_refused(run("discover", "bare.txt", "--chain", "x", "--fs", "10"), "no channel named 'x'; there are: c1")
    assert_refused(run("discover", "one.csv", "--chain", "x", "--time", "x"), "one.csv", "time must increase")


def test_json_is_one_object(run: Run, folder: Path) -> None:
    put(folder / "few.csv", rows(20))
    outcome = run("discover", "few.csv", *CHANNELS, *AS_MEASURED, "--json")
    answer = json.loads(assert_answered(outcome))
    assert outcome.out.count("\n") == 1
    assert answer["data"]["n"] == 20
    assert outcome.err
    assert "NaN" not in outcome.out
    assert "Infinity" not in outcome.out


# --- the real command ------------------------------------------------------------------------------------------------


def command(*arguments: str | bytes, **options: str) -> Outcome:
    done = subprocess.run(
        [sys.executable, "-m", "bayeq", *arguments],
        capture_output=True,
        encoding="utf-8",
        errors="surrogateescape",
        timeout=60,
        check=False,
        env={**os.environ, **options},
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


def test_the_command_itself() -> None:
    assert_refused(command("discover", "rnu.csv", *CHANNELS), "did you mean 'run.csv'?")


def test_a_closed_pipe() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "bayeq", "discover", "run.csv", *CHANNELS, *SIMPLE, *AS_MEASURED, "--json"],
            stdout=writing,
            stderr=subprocess.PIPE,
            timeout=60,
            check=False,
        )
    finally:
        os.close(writing)
    assert done.returncode == 0
    # the rows are no motion under the force, of which it may warn
    said = [line for line in done.stderr.decode().splitlines() if line != COMPILING and not line.startswith(PROGRESS)]
    assert all(line.startswith("bayeq: warning: ") for line in said)


@pytest.mark.skipif(sys.platform != "linux", reason="file names of any bytes")
def test_names_that_the_terminal_cannot_show(folder: Path) -> None:
    odd = os.fsencode(folder) + b"/\xff \xc2\xb5.csv"
    table = [",".join(("t", "µ", "v", "a", "u")), *(",".join(map(str, row[:5])) for row in rows())]
    with open(odd, "w", encoding="utf-8") as file:
        file.write("\n".join(table) + "\n")
    channels = ["--disp", "μ", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "μ,v,u"]
    assert_answered(command("discover", odd, *channels, *AS_MEASURED, PYTHONIOENCODING="ascii"))
    assert_refused(command("discover", odd, "--disp", "ü", PYTHONIOENCODING="ascii"), r"no channel named '\xfc'")


# --- fuzz ------------------------------------------------------------------------------------------------------------

BRIEF = settings(
    max_examples=draws(25),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
cells = st.sampled_from(
    ["0", "1", "-2.5", "1e9", "1e150", "1e308", "1e-300", "5e-324", "-0.0", "nan", "inf", "", "abc", '"', '"a"', "1,5"]
) | st.floats().map(repr)
words = st.sampled_from(
    ["x", "v", "a", "u", "t", "", "x:v:a", "x::", "x", "::", "note", "0", "1", "nan", "inf", "-1", "1e-310", "1e300"]
) | st.text(max_size=6)
options = st.sampled_from(
    [
        "disp",
        "vel",
        "acc",
        "force",
        "chain",
        "input",
        "time",
        "fs",
        "names",
        "group",
        "dictionary",
        "method",
        "smooth",
        "holdout",
        "seed",
        "json",
    ]
).flatmap(lambda name: st.just([f"--{name}"]) if name == "json" else words.map(lambda word: [f"--{name}", word]))


@st.composite
def tables(draw: st.DrawFn) -> str:
    width = draw(st.integers(1, 4))
    mark = draw(st.sampled_from([",", ";", "\t", " "]))
    table = draw(st.lists(st.lists(cells, min_size=width, max_size=width), max_size=12))
    header = draw(st.sampled_from([["t", "x", "v", "a"][:width], ["x", "t", "v", "u"][:width], []]))
    if draw(st.booleans()):
        table = [[repr(k / 8), *row[1:]] for k, row in enumerate(table)]
    return "\n".join(mark.join(row) for row in [header, *table] if row)


def assert_decent(outcome: Outcome) -> None:
    """Exit code 0 or 2; one line for an error; no traceback."""
    assert outcome.code in (0, 2), outcome.err
    assert "Traceback" not in outcome.err
    if outcome.code == 2:
        said = outcome.err.replace(f"{COMPILING}\n", "")
        errors = [line for line in said.splitlines() if not line.startswith("bayeq: warning: ")]
        assert len(errors) == 1, outcome.err
        assert errors[0].startswith("bayeq: error: ")
        assert outcome.out == ""


@BRIEF
@given(text=tables() | st.text(max_size=80))
def test_fuzzed_files(run: Run, folder: Path, text: str) -> None:
    (folder / "fuzz.csv").write_text(text, encoding="utf-8", errors="replace")
    for chosen in (["--disp", "x", "--vel", "v", "--acc", "a"], ["--chain", "x"], ["--chain", "x::", "--fs", "8"]):
        assert_decent(run("discover", "fuzz.csv", *chosen, "--dictionary", "polynomial:2"))


@BRIEF
@given(chosen=st.lists(options, max_size=5))
@example(chosen=[["--chain", "x::"], ["--fs", "1e300"]])
@example(chosen=[["--chain", "x::"], ["--fs", "1e-300"]])
@example(chosen=[["--chain", "x"], ["--smooth", "none"], ["--fs", "1e-300"]])
def test_fuzzed_options(run: Run, folder: Path, chosen: list[list[str]]) -> None:
    put(folder / "fuzz.csv", rows(12))
    arguments = [word for pair in chosen for word in pair]
    if "--dictionary" not in arguments:
        arguments += SIMPLE
    assert_decent(run("discover", "fuzz.csv", *arguments))
    assert_decent(run("discover", "fuzz.csv", *CHANNELS, *arguments))
