"""Help, completion, progress and explanations of the command line."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time

import pytest

import bayeq as bq
from bayeq.cli import terminal
from bayeq.cli.app import app, main
from bayeq.cli.terminal import PROGRESS, STAGES, Progress
from bayeq.equation.text import short_names, with_names

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")

OSCILLATOR = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, x**3, u"]


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "duffing.csv"
    bq.write(bq.simulate("duffing", n=400, seed=1), path)
    return path


# --- help and completion ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["", "study", "study table2", *app.commands])
def test_h_is_help(command, capsys):
    texts = []
    for flag in ("-h", "--help"):
        assert main([*command.split(), flag]) == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1]
    assert texts[0].startswith("Usage: bayeq")
    assert "-h, --help" in texts[0]


def test_options_of_discover_are_in_groups(capsys):
    assert main(["discover", "-h"]) == 0
    text = capsys.readouterr().out
    titles = [
        "What is measured:", "What is done to it first:", "What may be in the equation:", "How sure:", "What to write:",
        "Other:", "Examples:",
    ]  # fmt: skip
    places = [text.index(f"\n{title}\n") for title in titles]
    assert places == sorted(places)
    groups = dict(zip(titles, (text[a:b] for a, b in zip(places, [*places[1:], None], strict=True)), strict=True))
    for title, options in {
        "What is measured:": ["--disp", "--units", "--skip"],
        "What is done to it first:": ["--rows", "--remove-offset"],
        "What may be in the equation:": ["--dictionary", "--constraint"],
        "How sure:": ["--band", "--noise"],
        "What to write:": ["--json", "--explain"],
        "Other:": ["--verbose"],
    }.items():
        for option in options:
            assert re.search(rf"^  {option}\b", groups[title], re.MULTILINE), option
    # every option that there is
    listed = re.findall(r"^  (--[a-z-]+)", text, re.MULTILINE)
    names = [option.opts[-1] for option in app.commands["discover"].params if option.param_type_name == "option"]
    assert sorted(listed) == sorted(names)
    examples = re.findall(r"^    bayeq (\w+) ", groups["Examples:"], re.MULTILINE)
    assert examples.count("discover") == 3


def test_options_of_the_examples_are_there(capsys):
    for name in ("discover", "predict"):
        command = app.commands[name]
        text = command.epilog.replace("\\\n", " ")
        for line in re.findall(r"^    bayeq (\w+) (.*)$", text, re.MULTILINE):
            known = {opt for option in app.commands[line[0]].params for opt in option.opts}
            assert set(re.findall(r"--[a-z-]+", line[1])) <= known


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_a_script(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert f"_BAYEQ_COMPLETE={shell}_complete" in script
    if shutil.which(shell):
        assert subprocess.run([shell, "-n"], input=script, text=True, check=False).returncode == 0
    assert main(["completion", "tcsh"]) == 2


def test_commands_and_options_are_completed(monkeypatch, capsys):
    monkeypatch.setenv("_BAYEQ_COMPLETE", "bash_complete")
    for words, expected in (("bayeq pre", "plain,predict\n"), ("bayeq discover --rem", "plain,--remove-offset\n")):
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
        assert main() == 0
        assert capsys.readouterr().out == expected


# --- progress --------------------------------------------------------------------------------------------------------


def test_short_work_says_nothing(capsys):
    with Progress() as progress:
        progress("reading", 0, 1)
        progress("states", 0, 1)
    assert capsys.readouterr().err == ""


def test_long_work_says_a_line_per_stage(capsys, monkeypatch):
    monkeypatch.setattr(terminal, "PATIENCE", 0.05)
    monkeypatch.setattr(terminal, "INTERVAL", 0.3)
    with Progress() as progress:
        progress("likelihood", 0, 3)
        time.sleep(0.2)
        progress("likelihood", 1, 3)
        time.sleep(0.3)
        progress("inference", 0, 1)
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith(PROGRESS) for line in lines)
    stages = [line.removeprefix(PROGRESS).split(",")[0] for line in lines]
    likelihood = STAGES["likelihood"]
    assert stages[0] == likelihood
    assert stages[-1] == STAGES["inference"]
    # named when it has gone on, and once more after the interval, though it was looked at ten times
    assert 1 <= stages.count(likelihood) <= 3
    assert lines[0].endswith(", 0 of 3")  # nothing of a time that is no second yet


def test_nothing_is_said_after_the_end(capsys, monkeypatch):
    monkeypatch.setattr(terminal, "PATIENCE", 0.02)
    progress = Progress()
    progress("inference", 0, 1)
    progress.close()
    capsys.readouterr()
    time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_refine_shows_progress_in_a_pipe(record, capsys, monkeypatch):
    monkeypatch.setattr(terminal, "PATIENCE", 0.01)
    assert main(["discover", str(record), *OSCILLATOR, "--smooth", "none", "--refine"]) == 0
    out, err = capsys.readouterr()
    assert f"{PROGRESS}refining" in err
    assert PROGRESS not in out


def test_verbose_names_the_stages_and_times_them(record, tmp_path, capsys):
    assert main(["discover", str(record), *OSCILLATOR, "--verbose", "--save", str(tmp_path / "eq.json")]) == 0
    _, err = capsys.readouterr()
    for stage in ("reading", "states", "dictionary", "inference", "writing eq.json"):
        assert f"bayeq: {stage} ...\n" in err
        assert re.search(rf"^bayeq: {re.escape(stage)}: [\d.e-]+ s$", err, re.MULTILINE)
    assert main(["predict", str(tmp_path / "eq.json"), str(record), "--verbose"]) == 0
    assert re.search(r"^bayeq: predicting: [\d.e-]+ s$", capsys.readouterr().err, re.MULTILINE)


def test_what_took_long_is_printed_before_it_is_saved(record, tmp_path):
    command = [sys.executable, "-m", "bayeq", "discover", str(record), *OSCILLATOR, "--smooth", "none", "--verbose"]
    done = subprocess.run(
        [*command, "--save", str(tmp_path / "eq.json")],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0
    assert (tmp_path / "eq.json").exists()
    assert done.stdout.index("verdict: ") < done.stdout.index("bayeq: writing eq.json ...")


# --- what is printed -------------------------------------------------------------------------------------------------


def test_the_verdict_comes_first_and_rate_and_length_are_printed(record, capsys):
    assert main(["discover", str(record), *OSCILLATOR, "--verbose"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("verdict: ")
    assert lines[2].startswith("a = ")
    assert lines[4].startswith("| term ")
    assert any(line.startswith("400 rows at 1000 Hz, 0.4 s, of duffing.csv, ") for line in lines)


def test_the_answer_is_explained_with_its_own_numbers(record, capsys):
    assert main(["discover", str(record), *OSCILLATOR, "--explain"]) == 0
    out, _ = capsys.readouterr()
    answer, text = out.split("What this says")
    text = " ".join(text.split())
    kind = re.match(r"verdict: ([a-z ]+):", answer)[1]
    assert f"verdict '{kind}':" in text
    assert "among the 4 candidate terms" in text
    row = re.search(r"^\| x +\| .*?\| .*?\| +(\S+) \.\. (\S+) ", answer, re.MULTILINE)
    assert f"that of x between {row[1]} and {row[2]}" in text
    assert "the last 80 rows were not used" in text
    assert "1:20" not in text or "runners-up" in answer
    # nothing of what is not there
    for part, marked in (("effective:", "~"), ("refined by output error", "refined"), ("time not known", "not known")):
        assert part not in text or marked in answer
    assert main(["discover", str(record), *OSCILLATOR, "--explain", "--refine", "--holdout", "0"]) == 0
    assert "held-out rows:" not in capsys.readouterr().out
    assert main(["discover", str(record), *OSCILLATOR, "--explain", "--json"]) == 2


LONG = "{}_of_the_upper_mass_measured_by_the_laser_on_the_left_side_of_it"


def test_long_names_do_not_break_the_table(tmp_path, capsys):
    rec = bq.simulate("duffing", n=800, seed=1)
    names = [LONG.format(word) for word in ("displacement", "velocity", "acceleration", "force")]
    assert all(len(name) >= 60 for name in names)
    path = tmp_path / "long.csv"
    bq.write(bq.Record(dict(zip(names, (rec[name] for name in "xvau"), strict=True)), rec.time), path)
    roles = [part for pair in zip(("--disp", "--vel", "--acc", "--force"), names, strict=True) for part in pair]
    x, v, _, u = names
    assert main(["discover", str(path), *roles, "--verbose", "--dictionary", f"{x}, {v}, {x}**3, {x}**2*{v}, {u}"]) == 0
    out = capsys.readouterr().out
    table = [line for line in out.splitlines() if line.startswith("|")]
    assert len({len(line) for line in table}) == 1
    assert len(table[0]) < 130
    terms = [line.split("|")[1].strip() for line in table[2:]]
    assert len(set(terms)) == len(terms) >= 4
    assert any(term.endswith("**3") for term in terms)
    # the whole names are said
    assert f"is {x}" in out


def test_short_names_can_be_told_apart():
    names = [f"acceleration_of_mass_{k}_in_the_direction_of_travel" for k in range(12)]
    short = short_names(names, 12)
    assert len(set(short.values())) == 12
    assert with_names(f"{names[3]}**2*x", short) == f"{short[names[3]]}**2*x"
    assert short_names(["x", "v*abs(x)"], 12) == {}


def test_a_narrow_terminal_gets_whole_rows(record, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    eq = tmp_path / "eq.json"
    assert main(["discover", str(record), *OSCILLATOR, "--save", str(eq)]) == 0
    capsys.readouterr()
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    from bayeq.equation.text import render

    lines = re.sub(r"\x1b\[[0-9;]*m", "", render(bq.load(eq))).splitlines()
    start = next(k for k, line in enumerate(lines) if line.lstrip().startswith("term "))
    table = lines[start : lines.index("", start)]
    assert max(map(len, table)) <= 80
    assert [line.split()[0] for line in table[2:]] == ["x", "v", "x**3", "u", "intercept"]
