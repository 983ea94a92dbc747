"""Options about reading: units, rows, lines passed over, offsets, standard input, time that is not known."""

from __future__ import annotations

import contextlib
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bayeq as bq
from bayeq.cli.app import main
from bayeq.cli.reading import Reading
from bayeq.cli.terminal import COMPILING, PROGRESS
from bayeq.errors import InputError
from bayeq.records.io import rows_of
from bayeq.records.names import conversion, require_unit

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")

CHANNELS = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, x**2, x**3, u"]
K = 1000.0  # N/m, of `bayeq.SYSTEMS["duffing"]`


@pytest.fixture(scope="module")
def duffing():
    return bq.simulate("duffing", seed=3, n=1500, noise=0.02)


def put(path: Path, header: str, *columns) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


def channels(record):
    return (np.asarray(record[name]) for name in "xvau")


def run(capsys, *arguments):
    code = main([*map(str, arguments)])
    out, err = capsys.readouterr()
    said = [line for line in err.splitlines() if line != COMPILING and not line.startswith(PROGRESS)]
    return code, out, said


def discovered(capsys, path, *options):
    """The equation's coefficients, the physical parameters, the data and the warnings."""
    code, out, said = run(capsys, "discover", path, *CHANNELS, "--json", *options)
    assert code == 0, said
    answer = json.loads(out)
    coef = {term["name"]: term["shown_coef"] for term in answer["equations"][0]["terms"]}
    physical = {row["symbol"]: row for row in answer.get("physical", {}).get("a", [])}
    return coef, physical, answer, said


# --- the four faults -------------------------------------------------------------------------------------------------


def test_mm_and_g_give_the_stiffness_in_newtons_per_metre(duffing, tmp_path, capsys):
    x, v, a, u = channels(duffing)
    path = put(tmp_path / "run.csv", "t,x,v,a,u", duffing.time, 1e3 * x, v, a / 9.80665, u)
    _, physical, answer, _ = discovered(
        capsys, path, "--units", "x=mm,v=m/s", "--units", "a=g,u=N", "--physical", "--holdout", "0"
    )
    assert answer["data"]["units"] == {"x": "mm", "v": "m/s", "a": "g", "u": "N"}
    assert physical["k"]["unit"] == "N/m"
    assert physical["k"]["mean"] == pytest.approx(K, rel=0.01)
    assert physical["m"]["mean"] == pytest.approx(1.0, rel=0.01)


def test_time_in_other_words_and_units_is_time(duffing, tmp_path, capsys):
    duffing = duffing.slice(0, 500)
    x, v, a, u = channels(duffing)
    plain = put(tmp_path / "plain.csv", "t,x,v,a,u", duffing.time, x, v, a, u)
    expected, _, reference, _ = discovered(capsys, plain)
    for header, scale in (("Zeit [ms]", 1e3), ("t_ms", 1e3)):
        other = put(tmp_path / "other.csv", f"{header},x,v,a,u", scale * duffing.time, x, v, a, u)
        coef, _, answer, _ = discovered(capsys, other)
        assert answer["data"]["smoothed"]
        assert answer["data"]["fs"] == pytest.approx(1000.0)
        assert answer["data"]["seconds"] == pytest.approx(0.5)
        assert set(answer["diagnostics"]["scores"]["free_run"]) == {"x", "v"}
        assert coef == pytest.approx(expected, rel=1e-6)
        assert answer["verdict"]["kind"] == reference["verdict"]["kind"]


def test_the_unit_of_time_may_be_given(duffing, tmp_path, capsys):
    x, v, a, u = channels(duffing)
    path = put(tmp_path / "run.csv", "t,x,v,a,u", 1e3 * duffing.time, x, v, a, u)
    assert discovered(capsys, path, "--units", "t=ms", "--smooth", "none")[2]["data"]["fs"] == pytest.approx(1000.0)


def test_a_stand_off_is_warned_of_and_can_be_removed(duffing, tmp_path, capsys):
    duffing = duffing.slice(0, 700)
    x, v, a, u = channels(duffing)
    path = put(tmp_path / "run.csv", "t,x,v,a,u", duffing.time, x + 0.2, v, a, u)
    _, as_it_is, _, said = discovered(capsys, path, "--physical", "--holdout", "0")
    assert any("--remove-offset x" in line for line in said)
    assert as_it_is["k"]["mean"] == pytest.approx(K, rel=0.02)
    coef, removed, _, said = discovered(capsys, path, "--physical", "--remove-offset", "x", "--holdout", "0")
    assert not any("--remove-offset" in line for line in said)
    assert removed["k"]["mean"] == pytest.approx(K, rel=0.01)
    assert coef["x"] == pytest.approx(-K, rel=0.01)
    coef, _, _, _ = discovered(capsys, path, "--remove-offset", "x=0.2", "--holdout", "0")
    assert coef["x"] == pytest.approx(-K, rel=0.01)
    assert coef["x**2"] == 0.0


def test_a_base_is_subtracted_from_an_absolute_channel(duffing, tmp_path, capsys):
    duffing = duffing.slice(0, 500)
    x, v, a, u = channels(duffing)
    known = put(tmp_path / "known.csv", "t,x,v,a,u", duffing.time, x, v, a, u)
    absolute = put(tmp_path / "run.csv", "t,x,v,a,u,Boden", duffing.time, x, v, a - u, u, -u)
    expected = discovered(capsys, known, "--smooth", "none")[0]
    found = discovered(capsys, absolute, "--remove-offset", "a=Boden", "--smooth", "none")[0]
    assert found == pytest.approx(expected, rel=1e-9)


# --- time that is not known ------------------------------------------------------------------------------------------


def test_row_numbers_are_time_where_it_is_not_known(duffing, tmp_path, capsys):
    duffing = duffing.slice(0, 500)
    x, v, a, u = channels(duffing)
    path = put(tmp_path / "run.csv", "x,v,a,u", x, v, a, u)
    coef, _, answer, said = discovered(capsys, path)
    assert any("time is not known: row numbers are used as time" in line for line in said)
    (rate,) = (float(found[1]) for line in said if (found := re.search(r"x and v go together at (\S+) samples", line)))
    assert rate == pytest.approx(1000.0, rel=0.01)
    assert any("time is not known" in line for line in answer["diagnostics"]["warnings"])
    assert (answer["data"]["fs"], answer["data"]["seconds"], answer["data"]["rows_as_time"]) == (None, None, True)
    # all channels are measured: the equation is the same
    assert coef["x"] == pytest.approx(-K, rel=0.02)
    code, out, _ = run(capsys, "discover", path, *CHANNELS, "--verbose")
    assert code == 0
    assert "500 rows, time not known, of run.csv" in out
    assert "free run over the held-out rows: normalised" in out
    code, out, said = run(capsys, "discover", path, *CHANNELS, "--physical")
    assert (code, out) == (2, "")
    assert "time is not known: give --fs" in said[0]


def test_a_saved_equation_per_sample_stays_per_sample(duffing, tmp_path, capsys):
    duffing = duffing.slice(0, 600)
    x, _, _, u = channels(duffing)
    rows = put(tmp_path / "rows.csv", "x,u", x, u)
    timed = put(tmp_path / "timed.csv", "t,x,u", duffing.time, x, u)
    eq, options = (
        tmp_path / "eq.json",
        ["--chain", "x::", "--input", "u", "--dictionary", "x, dx, x**3, u", "--holdout", "0"],
    )
    assert run(capsys, "discover", rows, *options, "--save", eq)[0] == 0
    assert bq.load(eq).data.rows_as_time
    assert bq.load(eq)[0].shown_coef["x"] == pytest.approx(-K / 1000.0**2, rel=0.03)
    assert run(capsys, "predict", eq, rows)[0] == 0
    code, out, said = run(capsys, "predict", eq, timed)
    assert (code, out) == (2, "")
    assert "the equations are per sample" in said[0]
    assert run(capsys, "discover", timed, *options, "--save", eq)[0] == 0
    code, out, said = run(capsys, "predict", eq, rows)
    assert (code, out) == (2, "")
    assert "time is not known, and the equations are per second; give" in said[0]
    assert run(capsys, "predict", eq, rows, "--fs", "1000")[0] == 0


def test_rows_in_no_order_are_not_given_a_time(duffing):
    mixed = np.random.default_rng(0).permutation(duffing.n)
    record = bq.Record({name: duffing[name][mixed] for name in "xvau"})
    with pytest.warns(UserWarning) as said:  # noqa: PT030
        eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary="x, v, x**3, u")
    assert not any("row numbers" in str(one.message) for one in said)
    assert eq[0].shown_coef["x"] == pytest.approx(-K, rel=0.02)


# --- rows, offsets, lines, standard input ----------------------------------------------------------------------------


def test_rows_are_taken_before_offsets(duffing, tmp_path, capsys):
    x, v, a, u = channels(duffing)
    shifted = x + np.where(np.arange(1500) < 500, 0.0, 50.0)
    path = put(tmp_path / "run.csv", "t,x,v,a,u", duffing.time, shifted, v, a, u)
    coef, _, answer, _ = discovered(capsys, path, "--rows", ":500", "--remove-offset", "x", "--holdout", "0")
    assert answer["data"]["n"] == 500
    part = bq.remove_offset(duffing.slice(0, 500), "x")
    expected = bq.discover(part, chains="x:v:a", inputs=["u"], dictionary="x, v, x**2, x**3, u", holdout=0.0)
    assert coef["x"] == pytest.approx(expected[0].shown_coef["x"], rel=1e-6)


@given(n=st.integers(1, 30), first=st.none() | st.integers(-40, 40), last=st.none() | st.integers(-40, 40))
def test_rows_are_those_of_python(n, first, last):
    text = f"{'' if first is None else first}:{'' if last is None else last}"
    record = bq.Record({"x": np.arange(float(n))}, name="run")
    reading = Reading.of({**NOTHING, "rows": text})
    wanted = np.arange(n)[first:last]
    if len(wanted):
        assert rows_of(record, reading.rows)["x"].tolist() == wanted.tolist()
    else:
        with pytest.raises(InputError, match="leaves none of"):
            rows_of(record, reading.rows)


NOTHING = {
    "time": None, "fs": None, "names": None, "group": None, "join": False, "units": (), "skip": 0, "rows": None,
    "offsets": (), "stream": None, "scales": (), "sheet": None,
}  # fmt: skip


@given(st.text(max_size=12))
def test_any_text_as_an_option_is_read_or_refused_in_one_line(text):
    for name, value in (("rows", text), ("units", (text,)), ("offsets", (text,))):
        # anything but an InputError fails
        with contextlib.suppress(InputError):
            assert isinstance(Reading.of({**NOTHING, name: value}), Reading)


def test_lines_are_passed_over(duffing, tmp_path, capsys):
    x, v, a, u = channels(duffing)
    table = put(tmp_path / "table.csv", "t,x,v,a,u", duffing.time, x, v, a, u).read_text()
    path = tmp_path / "run.csv"
    path.write_text(f"1,2\n3,4,5\n6,7,8,9,10\n{table}")
    code, _, said = run(capsys, "discover", path, *CHANNELS)
    assert code == 2
    assert len(said) == 1
    assert discovered(capsys, path, "--skip", "3", "--smooth", "none")[2]["data"]["n"] == 1500
    # lines are counted in the file
    path.write_text(f"1,2\n3,4,5\n6,7,8,9,10\n{table}".replace(f"{x[0]:.18e}", "one"))
    code, _, said = run(capsys, "discover", path, *CHANNELS, "--skip", "3")
    assert code == 2
    assert "line 5, column 'x': 'one' is not a number" in said[0]
    bq.write(duffing, tmp_path / "run.npz")
    code, _, said = run(capsys, "discover", tmp_path / "run.npz", *CHANNELS, "--skip", "3")
    assert code == 2
    assert "only lines of delimited text can be passed over" in said[0]
    with pytest.raises(InputError, match="skip"):
        bq.read(tmp_path / "run.npz", skip=1)


def test_standard_input(duffing, tmp_path, capsys, monkeypatch):
    duffing = duffing.slice(0, 500)
    x, v, a, u = channels(duffing)
    path = put(tmp_path / "run.csv", "t,x,v,a,u", duffing.time, x, v, a, u)

    class Piped:
        def __init__(self, content: bytes) -> None:
            self.buffer = io.BytesIO(content)

    monkeypatch.setattr("sys.stdin", Piped(path.read_bytes()))
    coef, _, answer, _ = discovered(capsys, "-", "--smooth", "none")
    assert answer["data"]["file"] == "standard input"
    assert coef == discovered(capsys, path, "--smooth", "none")[0]
    monkeypatch.setattr("sys.stdin", Piped(b"t,x\n0,1\n1,one\n2,3\n"))
    code, out, said = run(capsys, "discover", "-", "--disp", "x")
    assert (code, out) == (2, "")
    assert said == [
        "bayeq: error: standard input, line 3, column 'x': 'one' is not a number; if the column is not needed, name"
        " the columns to read"
    ]
    code, out, said = run(capsys, "discover", "-", "-", "--disp", "x")
    assert (code, out) == (2, "")
    assert "-: named twice" in said[0]


# --- units -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--units", "x"], "--units 'x': write a channel and its unit, such as x=mm"),
        (["--units", "x=mm,x=m"], "--units: 'x' is given twice, mm and m"),
        (["--units", "x=mmm"], "'mmm' is no unit that is known; did you mean mm"),
        (["--units", "y=mm"], "run.csv: no column named 'y'; there are: t, x, v, a, u"),
        (["--rows", "1-5"], "--rows '1-5': write A:B as in Python"),
        (["--rows", "9999:"], "run.csv: --rows 9999: leaves none of 1500 rows"),
        (["--skip", "-1"], "--skip -1: give a number of lines"),
        (["--skip", "99999"], "run.csv: the file has no data after the 99999 skipped lines"),
        (["--remove-offset", "y"], "run.csv: no channel named 'y'"),
        (["--remove-offset", "x=0.2mm"], "--remove-offset x: '0.2mm' is no number"),
        (["--remove-offset", "x=base"], "run.csv: no channel named 'base'"),
        (["--units", "x=mm,a=g", "--remove-offset", "x=a"], "run.csv: x is in mm, a in g: no difference of these"),
        (["--remove-offset", "x=x"], "run.csv: x less itself is nothing"),
        (["--remove-offset", "x="], "write a channel, x, or a channel and what is subtracted, x=0.2 or a1=base"),
        (["--remove-offset", "x=nan"], "an offset must be a finite number"),
        (["--remove-offset", "x", "--remove-offset", "x"], "--remove-offset: 'x' is named twice"),
    ],
)
def test_bad_options_are_one_line(duffing, tmp_path, capsys, options, part):
    path = put(tmp_path / "run.csv", "t,x,v,a,u", duffing.time, *channels(duffing))
    code, out, said = run(capsys, "discover", path, *CHANNELS, *options)
    assert (code, out, len(said)) == (2, "", 1)
    assert part in said[0]


@pytest.mark.parametrize("unit", ["mm", "m/s^2", "m/s²", "g", "kN", "deg/s", "%", "-", "µm", "V", "1/s", "N*m", "rpm"])
def test_units_that_measurements_are_labelled_with_are_known(unit):
    require_unit(unit, "--units")


@given(
    st.sampled_from(["m", "mm", "um", "in", "ft", "m/s", "mm/s", "g", "m/s^2", "N", "kN", "deg", "rad", "rpm", "N/m"]),
    st.sampled_from(
        ["m", "mm", "um", "in", "ft", "m/s", "mm/s", "g", "m/s^2", "N", "kN", "deg", "rad", "rpm", "kN/mm"]
    ),
)
def test_conversions_there_and_back(one, other):
    there, back = conversion(one, other), conversion(other, one)
    assert (there is None) == (back is None)
    if there is not None and back is not None:
        assert there * back == pytest.approx(1.0)
    assert conversion(one, one) == 1.0
    assert conversion("kN/mm", "N/m") == pytest.approx(1e6)


def test_units_of_files_that_are_joined(duffing, tmp_path, capsys):
    x, v, a, u = channels(duffing)
    first = put(tmp_path / "motion.csv", "t,x,v,a", duffing.time, 1e3 * x, v, a)
    second = put(tmp_path / "force.csv", "t,u", duffing.time, u)
    arguments = ["discover", first, second, "--join", *CHANNELS, "--smooth", "none", "--json"]
    code, out, _ = run(capsys, *arguments, "--units", "x=mm,u=N")
    assert code == 0
    assert json.loads(out)["data"]["units"] == {"x": "mm", "u": "N"}
    code, _, said = run(capsys, *arguments, "--units", "w=mm")
    assert code == 2
    assert "--units: no channel named 'w'" in said[0]
