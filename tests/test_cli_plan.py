"""`bayeq plan` from a file of equations to its text, JSON, figure and excitation."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

import bayeq as bq
from bayeq.cli.app import main
from bayeq.cli.terminal import COMPILING, PROGRESS

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")

QUICK = ["--realisations", "2", "--seconds", "0.5"]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    rec = bq.simulate("duffing", n=500, seed=1, noise=0.2)
    bq.write(rec, folder / "run.csv")
    arguments = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, x**3, u, v*abs(v)"]
    assert main(["discover", str(folder / "run.csv"), *arguments, "--save", str(folder / "eq.json")]) == 0
    return folder / "eq.json"


def run(capsys, *arguments):
    capsys.readouterr()
    code = main(["plan", *map(str, arguments)])
    out, err = capsys.readouterr()
    lines = err.replace(f"{COMPILING}\n", "").splitlines(keepends=True)
    return code, out, "".join(line for line in lines if not line.startswith(PROGRESS))


def test_from_a_file_to_an_excitation(saved, tmp_path, capsys):
    code, out, err = run(capsys, saved, *QUICK, "--figure", tmp_path / "plan.png", "--output", tmp_path / "best.csv")
    assert (code, err) == (0, "")
    sentence = out.splitlines()[0]
    assert sentence.startswith("excite u with ")
    assert " Hz: 0.5 s of it separates " in sentence
    assert "| excitation |" in out
    assert "simulated from rest: 0.5 s at 1000 Hz, noise sd a " in out
    best = pd.read_csv(tmp_path / "best.csv")
    assert list(best) == ["time", "u"]
    assert len(best) == 500
    ranges = bq.load(saved).data.measured.ranges["u"]
    assert np.abs(best["u"]).max() <= max(np.abs(ranges))
    picture = imread(tmp_path / "plan.png")
    assert min(picture.shape[:2]) > 300
    assert picture.std() > 0.05
    # the file is a record again
    assert bq.read(tmp_path / "best.csv").fs == pytest.approx(1000.0)


def test_json_is_one_object(saved, capsys):
    code, out, err = run(capsys, saved, *QUICK, "--json", "--amplitude", "50", "--band", "2:20", "--limit", "x=0.02",
                         "--noise", "a=3", "--odds", "50", "--seed", "2", "--fs", "500")  # fmt: skip
    assert (code, err) == (0, "")
    plan = json.loads(out)
    assert plan["conditions"] == {
        "band": [2.0, 20.0], "seconds": 0.5, "fs": 500.0, "noise": {"a": 3.0}, "limits": {"x": 0.02},
        "realisations": 2, "seed": 2,
    }  # fmt: skip
    assert plan["odds"] == 50
    assert plan["purpose"] == "models"
    assert plan["advice"].startswith("excite u with ")
    for design in plan["designs"]:
        assert design["amplitude"]["u"] <= 50
        assert design["peaks"]["x"] <= 0.02
        assert design["rate"] == min(rival["rate"] for rival in design["rivals"])
    same = bq.load(saved).plan(
        amplitude=50.0, band=(2, 20), limits={"x": 0.02}, noise={"a": 3.0}, odds=50, seed=2, fs=500.0,
        realisations=2, seconds=0.5,
    )  # fmt: skip
    assert json.loads(json.dumps(same.to_dict())) == plan


def test_amplitudes_by_input_and_by_range(saved, capsys):
    for given in (["--amplitude", "u=-50:50"], ["--amplitude", "50"]):
        code, out, _ = run(capsys, saved, *QUICK, "--json", *given)
        assert code == 0
        best = json.loads(out)["designs"][0]
        assert (best["amplitude"], best["offset"]) == ({"u": 50.0}, {"u": 0.0})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--band", "5"], "--band '5': give two numbers with a colon between"),
        (["--band", "a:b"], "--band: 'a' is no number"),
        (["--limit", "x"], "--limit 'x': give a name and a value"),
        (["--limit", "x=1", "--limit", "x=2"], "--limit: 'x' is given twice, 1 and 2"),
        (["--limit", "y=1"], "no state named 'y'"),
        (["--noise", "u=1"], "no target named 'u'"),
        (["--amplitude", "strong"], "--amplitude: 'strong' is no number"),
        (["--amplitude", "1", "--amplitude", "2"], "--amplitude '1': give a name and a value"),
        (["--figure", "plan.csv"], "end it in .png, .svg, .pdf"),
        (["--figure", "nowhere/plan.png"], "there is no directory nowhere"),
        (["--output", "best.png"], "end it in .csv"),
        (["--odds", "0.5"], "odds must be a number above 1"),
        (["--limit", "x=1e-12"], "no excitation keeps the motion within the limits"),
    ],
)
def test_errors_are_one_line(saved, capsys, arguments, message):
    code, out, err = run(capsys, saved, *QUICK, *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("bayeq: error: ")
    assert err.count("\n") == 1
    assert message in err


def test_files_that_hold_no_equations(saved, tmp_path, capsys):
    code, _, err = run(capsys, tmp_path / "missing.json")
    assert (code, err.count("\n")) == (2, 1)
    code, _, err = run(capsys, saved.with_name("run.csv"))
    assert (code, "not a JSON file" in err) == (2, True)
    code, _, err = run(capsys, saved, "--output", saved)
    assert code == 2


def test_equations_without_input(tmp_path, capsys):
    rec = bq.simulate("vanderpol", n=300, seed=0)
    bq.discover(rec, chains=["x", "y"], dictionary="x, y", smooth="none").save(tmp_path / "free.json")
    code, out, err = run(capsys, tmp_path / "free.json")
    assert (code, out) == (2, "")
    assert err == "bayeq: error: the equations have no input: there is nothing to excite\n"
