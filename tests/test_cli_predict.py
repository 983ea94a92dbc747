"""Saved equations on the command line: `bayeq predict` and `bayeq show`."""

from __future__ import annotations

import json
import math

import numpy as np
import pandas as pd
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.cli.terminal import COMPILING, PROGRESS

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")

OSCILLATOR = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, x**3, u"]


def run(capsys, *arguments):
    code = main([*map(str, arguments)])
    out, err = capsys.readouterr()
    said = [line for line in err.splitlines() if line != COMPILING and not line.startswith(PROGRESS)]
    return code, out, said


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An equation, the record that it is from, and another one."""
    path = tmp_path_factory.mktemp("run")
    for name, seed in (("first.npz", 1), ("second.npz", 2)):
        bq.write(bq.simulate("duffing", n=1200, seed=seed), path / name)
    assert (
        main(["discover", str(path / "first.npz"), *OSCILLATOR, "--holdout", "0", "--save", str(path / "eq.json")]) == 0
    )
    return path


def test_another_record_is_predicted(folder, tmp_path, capsys):
    figure, table = tmp_path / "run.svg", tmp_path / "run.csv"
    code, out, _ = run(capsys, "predict", folder / "eq.json", folder / "second.npz", "--forecast", figure)
    assert code == 0
    first, *rest = out.splitlines()
    assert first.startswith("verdict: free runs follow the record within ")
    assert first.endswith(" %")
    assert any(line.startswith("a = ") for line in rest)
    assert "1200 rows at 1000 Hz, 1.2 s, of second.npz" in rest
    assert figure.read_text().startswith("<?xml")
    code, out, _ = run(capsys, "predict", folder / "eq.json", folder / "second.npz", "--forecast", table, "--json")
    answer = json.loads(out)
    assert answer["verdict"]["kind"] == "follows"
    assert answer["data"] == {"file": "second.npz", "n": 1200, "fs": 1000.0, "seconds": pytest.approx(1.2)}
    # scores are those of the library
    eq, record = bq.load(folder / "eq.json"), bq.read(folder / "second.npz")
    scores = eq.score(record, start=0)
    assert {n: e["nrmse"] for n, e in answer["one_step"].items()} == pytest.approx(dict(scores.one_step))
    assert {n: e["nrmse"] for n, e in answer["free_run"].items()} == pytest.approx(dict(scores.free_run))
    x = answer["free_run"]["x"]
    assert x["rms"] == pytest.approx(x["nrmse"] * record["x"].std())
    assert x["unit"] == "m"
    # bands of 95 %: of single steps, and of runs with the noise of the channels, which that of the force adds to
    mean, sd = eq.predict(record, return_std=True)
    assert answer["one_step"]["a"]["inside"] == np.mean(np.abs(record["a"] - mean) <= 1.96 * sd)
    assert 0.9 < answer["one_step"]["a"]["inside"] < 0.99
    for error in answer["free_run"].values():
        assert 0.8 < error["inside"] < 0.99
    written = pd.read_csv(table)
    assert len(written) == 1200
    assert {"time", "x", "x_low", "x_high", "x_measured"} <= set(written)


def test_an_equation_that_does_not_hold(folder, tmp_path, capsys):
    record = bq.read(folder / "second.npz")
    other = record.with_channels({"x": -3.0 * record["x"], "a": np.roll(record["a"], 300)}, record.units)
    bq.write(other, tmp_path / "other.npz")
    code, out, said = run(capsys, "predict", folder / "eq.json", tmp_path / "other.npz")
    assert code == 0
    assert out.splitlines()[0] == "verdict: worse than the mean: the equation does not hold for this record"
    assert any("beyond the" in line and "extrapolated" in line for line in said)
    code, out, _ = run(capsys, "predict", folder / "eq.json", tmp_path / "other.npz", "--json")
    assert json.loads(out)["verdict"]["kind"] == "does not hold"


def test_runs_that_blow_up(tmp_path, capsys):
    rng = np.random.default_rng(0)
    t, x = np.arange(300) / 50.0, rng.uniform(0.5, 1.0, 300)
    record = bq.Record({"x": x, "v": rng.normal(size=300), "a": 9.0 * x**3 + 5 * x}, t, name="cubic")
    eq = bq.discover(record, chains="x:v:a", dictionary="x**3, x", smooth="none")
    eq.save(tmp_path / "eq.json")
    bq.write(record, tmp_path / "run.csv")
    code, out, _ = run(capsys, "predict", tmp_path / "eq.json", tmp_path / "run.csv", "--json")
    assert code == 0
    answer = json.loads(out)
    assert answer["verdict"]["kind"] == "does not hold"
    assert answer["free_run"]["x"]["nrmse"] is None
    assert answer["blew_up_at"] > 0.0
    code, out, _ = run(capsys, "predict", tmp_path / "eq.json", tmp_path / "run.csv")
    assert "the free run blew up at " in out
    assert "blew up" in out


def test_a_chaotic_record_is_followed_for_a_period(tmp_path, capsys):
    record = bq.simulate("lorenz", n=2000, noise=0.001, seed=0)
    eq = bq.discover(record.slice(0, 1000), chains=["x", "y", "z"], dictionary="polynomial:2")
    eq.save(tmp_path / "eq.json")
    bq.write(record, tmp_path / "run.npz")
    code, out, _ = run(capsys, "predict", tmp_path / "eq.json", tmp_path / "run.npz", "--json", "--draws", "20")
    assert code == 0
    answer = json.loads(out)
    assert max(answer["windows"].values()) < 0.3
    if max(error["nrmse"] or math.inf for error in answer["free_run"].values()) >= 1.0:
        assert answer["verdict"]["kind"] == "follows for a period"
        assert "over one period" in answer["verdict"]["reason"]
    else:
        assert answer["verdict"]["kind"] in ("follows", "follows roughly")


def test_other_names_and_units(folder, tmp_path, capsys):
    record = bq.read(folder / "second.npz")
    x, v, a, u = (record[name] for name in "xvau")
    columns = np.column_stack([record.time, 1e3 * x, v, a / 9.80665, u])
    header = "Zeit [s],Weg [mm],Geschw [m/s],Beschl [g],Kraft [N]"
    np.savetxt(tmp_path / "run.csv", columns, delimiter=",", header=header, comments="")
    names = ["--channel", "x=Weg", "--channel", "v=Geschw [m/s]", "--channel", "a=Beschl", "--channel", "u=Kraft"]
    code, _, said = run(capsys, "predict", folder / "eq.json", tmp_path / "run.csv")
    assert code == 2
    assert said[0].endswith("say where it is: --channel x=NAME")
    code, out, said = run(capsys, "predict", folder / "eq.json", tmp_path / "run.csv", *names, "--json")
    assert code == 0
    assert "bayeq: warning: x was converted from mm to m" in said
    assert "bayeq: warning: a was converted from g to m/s^2" in said
    found = json.loads(out)
    code, out, _ = run(capsys, "predict", folder / "eq.json", folder / "second.npz", "--json")
    expected = json.loads(out)
    for part in ("one_step", "free_run"):
        for name, error in expected[part].items():
            assert found[part][name]["nrmse"] == pytest.approx(error["nrmse"], rel=1e-6)
            assert found[part][name]["unit"] == error["unit"]


def test_rows_and_several_records(folder, capsys):
    code, out, _ = run(
        capsys, "predict", folder / "eq.json", folder / "first.npz", folder / "second.npz", "--rows", "0:600", "--json"
    )
    assert code == 0
    answer = json.loads(out)
    assert answer["data"]["file"] == ["first.npz", "second.npz"]
    assert answer["data"]["n"] == 1200
    assert answer["data"]["seconds"] == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["nofile.json", "second.npz"], "no such file: nofile.json; did you mean 'eq.json'?"),
        (["second.npz", "second.npz"], "second.npz: not a JSON file"),
        (["eq.json"], "Missing argument 'FILE...'"),
        (["eq.json", "nofile.csv"], "no such file: nofile.csv"),
        (["eq.json", "second.npz", "second.npz"], "named twice"),
        (["eq.json", "second.npz", "--channel", "y=x"], "--channel: the equations: no channel named 'y'"),
        (["eq.json", "second.npz", "--channel", "x"], "--channel 'x': write a channel of the equations"),
        (["eq.json", "second.npz", "--channel", "x=v", "--channel", "x=a"], "--channel: 'x' is given twice, v and a"),
        (["eq.json", "second.npz", "--channel", "x=xx"], "no column named 'xx'; did you mean 'x'?"),
        (["eq.json", "second.npz", "--channel", "x=u"], "x is in N, in the equations in m: give its unit"),
        (["eq.json", "second.npz", "--rows", "0:1"], "second.npz: too few rows to predict"),
        (["eq.json", "second.npz", "--draws", "-1"], "--draws -1: give a number of runs"),
        (["eq.json", "second.npz", "--seed", "-1"], "--seed -1: a seed is a whole number"),
        (["eq.json", "second.npz", "--forecast", "a.txt"], "a.txt: is to be written as a table or a figure"),
        (["eq.json", "second.npz", "--forecast", "no/a.csv"], "there is no directory no"),
        (["eq.json", "second.npz", "--forecast", "second.npz"], "is a file that is read"),
    ],
)
def test_bad_input_is_one_line(folder, monkeypatch, capsys, arguments, part):
    monkeypatch.chdir(folder)
    code, out, said = run(capsys, "predict", *arguments)
    assert (code, out, len(said)) == (2, "", 1)
    assert part in said[0]


@pytest.mark.parametrize("empty", ["u", "x", "a"])
def test_a_channel_without_samples_is_named(folder, tmp_path, capsys, empty):
    record = bq.read(folder / "second.npz")
    columns = {name: np.full(record.n, np.nan) if name == empty else record[name] for name in record.names}
    bq.write(bq.Record(columns, record.time), tmp_path / "gone.csv")
    named = f"channel '{empty}' has no samples"
    code, out, said = run(capsys, "predict", folder / "eq.json", tmp_path / "gone.csv")
    assert (code, out, len(said)) == (2, "", 1)
    assert said[0].startswith(f"bayeq: error: gone.csv: {named}")
    equations, bad = bq.load(folder / "eq.json"), bq.read(tmp_path / "gone.csv")
    for apply in (equations.predict, equations.simulate, equations.score):
        with pytest.raises(bq.errors.RecordError, match=named):
            apply(bad)
    with pytest.raises(bq.errors.RecordError, match=f"^gone.csv: {named}"):
        bq.discover([record, bad], chains=["x:v:a"], inputs=["u"], dictionary="x, v, u")


def test_a_record_at_rest_says_nothing(folder, tmp_path, capsys):
    record = bq.read(folder / "second.npz")
    rest = record.with_channels({name: np.zeros(record.n) for name in record.names})
    bq.write(rest, tmp_path / "rest.csv")
    predicted, benchmark = ("predict", folder / "eq.json"), ("benchmark", "--train", folder / "eq.json", "--test")
    for command, rows in ((predicted, 1200), (benchmark, 1150)):
        code, out, said = run(capsys, *command, tmp_path / "rest.csv")
        assert (code, out, len(said)) == (2, "", 1)
        assert f"rest.csv: no change of x, v, a in {rows} rows" in said[0]
    code, out, _ = run(capsys, *predicted, folder / "second.npz", tmp_path / "rest.csv")
    assert code == 0
    assert out.rstrip().endswith("of 2 records")


def test_a_channel_that_the_file_lacks(folder, tmp_path, capsys):
    record = bq.read(folder / "second.npz")
    bq.write(bq.Record({"x": record["x"], "u": record["u"]}, record.time), tmp_path / "few.csv")
    code, out, said = run(capsys, "predict", folder / "eq.json", tmp_path / "few.csv")
    assert (code, out, len(said)) == (2, "", 1)
    assert "few.csv: no channel named 'v'" in said[0]


# --- show ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options", [[], ["--json"], ["--conditional"], ["--physical"], ["--physical", "--json"], ["--explain"]]
)
def test_what_is_shown_is_what_was_printed(folder, tmp_path, capsys, options):
    eq = tmp_path / "eq.json"
    # smoothed where all is printed, or all is in JSON
    smooth = [] if options in ([], ["--json"]) else ["--smooth", "none"]
    command = ["discover", folder / "first.npz", *OSCILLATOR, "--rows", "0:400", *smooth, *options]
    code, printed, said = run(capsys, *command, "--save", eq)
    assert code == 0
    code, shown, again = run(capsys, "show", eq, *options)
    assert code == 0
    if "--json" in options:
        assert json.loads(shown) == json.loads(printed)
    else:
        assert shown == printed
    assert again == said


def test_latex_alone(folder, capsys):
    code, out, _ = run(capsys, "show", folder / "eq.json", "--latex")
    assert code == 0
    assert out.strip() == bq.load(folder / "eq.json").to_latex()


def test_show_refuses_what_does_not_go_together(folder, tmp_path, capsys):
    for options in (["--json", "--latex"], ["--json", "--explain"], ["--latex", "--physical"]):
        code, out, said = run(capsys, "show", folder / "eq.json", *options)
        assert (code, out, len(said)) == (2, "", 1)
    (tmp_path / "broken.json").write_text((folder / "eq.json").read_text()[:500])
    code, out, said = run(capsys, "show", tmp_path / "broken.json")
    assert (code, out, len(said)) == (2, "", 1)
    assert "broken.json: not a JSON file" in said[0]
