"""Refinement, physical parameters and free runs through the command."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import bayeq as bq
from bayeq import discovery
from bayeq.cli.app import main
from bayeq.cli.terminal import COMPILING, PROGRESS
from tests.uncovered import WITHOUT_PYC, uncovered

OSCILLATOR = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, x**3, u"]

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "duffing.csv"
    made = bq.simulate("duffing", n=500, seed=1, noise={"x": 0.05, "v": 0.05, "a": 0.05})
    bq.write(made, path)
    return path


@pytest.fixture(scope="module")
def eq(record):
    return bq.discover(bq.read(record), chains=["x:v:a"], inputs=["u"], dictionary=["x", "v", "x**3", "u"])


def run(capsys, *arguments):
    code = main(["discover", *map(str, arguments)])
    out, err = capsys.readouterr()
    return code, out, without_progress(err)


def without_progress(err):
    """What is said on standard error about the result."""
    lines = err.splitlines(keepends=True)
    return "".join(line for line in lines if line != f"{COMPILING}\n" and not line.startswith(PROGRESS))


def test_scores_of_the_held_out_rows_are_shown(record, eq, capsys):
    code, out, _ = run(capsys, record, *OSCILLATOR, "--verbose")
    assert code == 0
    assert "free run over the held-out rows: normalised RMS error x " in out
    brief = run(capsys, record, *OSCILLATOR)[1]
    assert "checked on 100 rows that were not used: a within " in brief
    assert ", free run within x " in brief
    code, out, _ = run(capsys, record, *OSCILLATOR, "--json")
    scores = json.loads(out)["diagnostics"]["scores"]
    assert scores["rows"] == 100
    assert set(scores["free_run"]) == {"x", "v"}
    assert scores["blew_up_at"] is None
    assert scores["one_step"]["a"] == pytest.approx(eq[0].held_out.nrmse, rel=1e-6)
    assert scores["free_run"] == dict(eq.scores.free_run)
    code, out, _ = run(capsys, record, *OSCILLATOR, "--smooth", "none", "--holdout", "0")
    assert "free run over" not in out


def test_a_free_run_that_blows_up_is_told(tmp_path, capsys):
    rng = np.random.default_rng(0)
    x = rng.uniform(0.5, 1.0, 200)
    a = x**3
    columns = pd.DataFrame({"t": np.arange(200) / 2.0, "x": x, "v": rng.normal(size=200), "a": a})
    columns.to_csv(tmp_path / "cubic.csv", index=False)
    arguments = [tmp_path / "cubic.csv", "--chain", "x:v:a", "--dictionary", "x**3, v", "--smooth", "none"]
    code, out, _ = run(capsys, *arguments, "--verbose", "--save", tmp_path / "eq.json")
    assert code == 0
    assert "free run over the held-out rows: blew up at " in out
    code, out, _ = run(capsys, *arguments, "--json")
    scores = json.loads(out)["diagnostics"]["scores"]
    assert scores["free_run"] == {"x": None, "v": None}
    again = bq.load(tmp_path / "eq.json").scores
    assert again.blew_up_at == scores["blew_up_at"]
    assert again.free_run == {"x": np.inf, "v": np.inf}


def test_refine(record, eq, tmp_path, capsys):
    code, out, err = run(capsys, record, *OSCILLATOR, "--smooth", "none", "--refine", "--save", tmp_path / "eq.json")
    assert (code, err) == (0, "")
    assert "coefficients refined by output error" in out
    saved = bq.load(tmp_path / "eq.json")
    assert saved.refined.n == 400
    code, out, _ = run(capsys, record, *OSCILLATOR, "--smooth", "none", "--refine", "--json")
    found = json.loads(out)
    assert found["diagnostics"]["refined"]["noise_sd"] == dict(saved.refined.noise_sd)
    assert found["equations"][0]["terms"][0]["coef"] == saved[0].coef["x"]
    plain = eq.to_dict()
    assert plain["equations"][0]["terms"][0]["coef"] != saved[0].coef["x"]
    assert "refined" not in plain["diagnostics"]


def test_physical(record, capsys):
    code, out, _ = run(capsys, record, *OSCILLATOR, "--physical")
    assert code == 0
    assert "physical parameters, from the equation of a" in out
    assert "damping ratio" in out
    found = json.loads(run(capsys, record, *OSCILLATOR, "--physical", "--json")[1])["physical"]["a"]
    (k,) = (q for q in found if q["symbol"] == "k")
    assert abs(k["mean"] - 1000.0) < 4.0 * k["sd"]
    assert k["ci95"][0] < k["mean"] < k["ci95"][1]
    assert (k["meaning"], k["unit"]) == ("stiffness", "N/m")


def test_physical_needs_a_force_of_an_oscillator(tmp_path, capsys):
    record = tmp_path / "duffing.csv"
    bq.write(bq.simulate("duffing", n=1000, seed=1, noise={"x": 0.05, "v": 0.05, "a": 0.05}), record)
    # the order is right, no force of an oscillator is there: the equation is printed, and why there is no more
    terms = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x*v, u"]
    code, out, err = run(capsys, record, *terms, "--smooth", "none", "--physical")
    assert code == 2
    assert "\na = " in out
    assert "neither a restoring term" in err
    code, out, err = run(capsys, record, *terms, "--smooth", "none", "--physical", "--json")
    assert code == 2
    assert json.loads(out)["equations"][0]["target"] == "a"
    assert "neither a restoring term" in err


def test_forecast_table(record, eq, tmp_path, capsys):
    file = tmp_path / "run.csv"
    assert run(capsys, record, *OSCILLATOR, "--forecast", file)[0] == 0
    table = pd.read_csv(file)
    assert list(table) == ["time", *(f"{s}{e}" for s in "xv" for e in ("", "_low", "_high", "_measured"))]
    assert len(table) == 100
    source = bq.read(record)
    np.testing.assert_allclose(table["x_measured"], source["x"][400:])
    np.testing.assert_allclose(table["x_low"], eq.simulate(source, start=400).low["x"])
    # without rows held out, the whole record
    assert run(capsys, record, *OSCILLATOR, "--smooth", "none", "--forecast", file, "--holdout", "0")[0] == 0
    assert len(pd.read_csv(file)) == 500


@pytest.mark.parametrize("suffix", ["svg", *(pytest.param(one, marks=pytest.mark.slow) for one in ("png", "pdf"))])
def test_forecast_figure(record, tmp_path, capsys, suffix):
    first, second = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    refine = ["--refine"] if suffix == "svg" else []
    for file in (first, second):
        assert run(capsys, record, *OSCILLATOR, "--smooth", "none", *refine, "--forecast", file)[0] == 0
    assert first.read_bytes() == second.read_bytes()
    assert len(first.read_bytes()) > 5000


def test_forecasts_of_several_records(record, tmp_path, capsys):
    other = tmp_path / "other.csv"
    bq.write(bq.simulate("duffing", n=500, seed=2), other)
    given = [record, other, *OSCILLATOR, "--smooth", "none"]
    assert run(capsys, *given, "--forecast", tmp_path / "run.csv")[0] == 0
    table = pd.read_csv(tmp_path / "run.csv")
    assert table["record"].value_counts().to_dict() == {"duffing.csv": 100, "other.csv": 100}
    assert run(capsys, *given, "--forecast", tmp_path / "run.svg")[0] == 0
    # two panels for each record, of two lines and a band
    assert (tmp_path / "run.svg").read_text().count('id="axes_') == 8  # a run and its residual each


def test_what_cannot_be_written_is_refused_before_the_work(record, tmp_path, capsys):
    for arguments, message in (
        (["--forecast", tmp_path / "run.txt"], "end it in .csv"),
        (["--forecast", tmp_path / "no" / "run.csv"], "there is no directory"),
        (["--forecast", record], "is a file that is read"),
        (["--forecast", tmp_path / "a.csv", "--path", tmp_path / "a.csv"], "named twice"),
    ):
        code, out, err = run(capsys, record, *OSCILLATOR, *arguments)
        assert (code, out) == (2, "")
        assert message in err
    timeless = tmp_path / "timeless.csv"
    pd.read_csv(record).iloc[:, 1:].sample(frac=1.0, random_state=0).to_csv(timeless, index=False)  # in no order
    for option in (["--refine"], ["--forecast", tmp_path / "a.csv"]):
        code, out, err = run(capsys, timeless, *OSCILLATOR, *option)
        assert (code, out) == (2, "")
        assert f"{option[0]} needs a time column or fs" in err
    code, out, _ = run(capsys, timeless, *OSCILLATOR)
    assert code == 0
    assert "free run" not in out


def test_the_equation_is_printed_although_files_cannot_be_written(record, tmp_path, capsys, monkeypatch):
    place = tmp_path / "out"
    place.mkdir()
    discover = discovery.discover

    def removes_the_folder(*arguments, **options):
        shutil.rmtree(place)
        return discover(*arguments, **options)

    monkeypatch.setattr(discovery, "discover", removes_the_folder)
    outputs = {"save": "eq.json", "sensitivity": "pips.csv", "path": "path.csv", "forecast": "run.csv"}
    files = [place / name for name in outputs.values()]
    options = [part for option, file in zip(outputs, files, strict=True) for part in (f"--{option}", file)]
    code, out, err = run(capsys, record, *OSCILLATOR, *options)
    assert code == 2
    assert "\na = " in out
    assert err.startswith(f"bayeq: error: {files[0]}: cannot be written: No such file or directory; ")
    assert err.count("\n") == 1
    for file in files:
        assert f"{file}: cannot be written: " in err
    assert ".part" not in err


def test_a_full_disk_costs_one_file_and_leaves_the_one_before(record, tmp_path):
    kept, small = tmp_path / "eq.json", tmp_path / "run.csv"
    kept.write_text("what was there before")
    arguments = ["discover", record, *OSCILLATOR, "--smooth", "none", "--save", kept, "--forecast", small, "--json"]
    command = shlex.join([sys.executable, "-m", "bayeq", *map(str, arguments)])
    # no file may grow beyond 512 bytes; compiled kernels are not written either
    limited = ["sh", "-c", f"ulimit -f 1; {command}"]
    done = subprocess.run(limited, capture_output=True, text=True, check=False, env={**uncovered(), **WITHOUT_PYC})
    assert done.returncode == 2
    assert json.loads(done.stdout)["equations"][0]["target"] == "a"
    assert without_progress(done.stderr) == (
        f"bayeq: error: {kept}: cannot be written: File too large; {small}: cannot be written: File too large\n"
    )
    assert kept.read_text() == "what was there before"
    assert list(tmp_path.iterdir()) == [kept]
