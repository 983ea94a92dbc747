"""Equations as users of notebooks and of PySINDy expect them: lines, coefficients, a figure, HTML."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import bayeq as bq
from bayeq.equation.verdict import Verdict
from bayeq.errors import InputError


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", n=800, seed=1)


@pytest.fixture(scope="module")
def duffing(record):
    few = "x, v, x**2, x**3, u"
    return bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u", dictionary=few)


@pytest.fixture(scope="module")
def lorenz():
    return bq.discover(bq.simulate("lorenz", n=500, seed=1), chains=["x", "y", "z"], dictionary="x, y, z, x*y, x*z")


@pytest.fixture
def pyplot():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.close("all")  # what pages of the documents have left open
    yield pyplot
    pyplot.close("all")


def test_equations_are_a_tuple_and_lines_when_called(duffing, lorenz):
    assert duffing.equations() == [duffing[0].text]
    assert [line.split(" = ")[0] for line in lorenz.equations()] == ["dx", "dy", "dz"]
    assert lorenz.equations[1] is lorenz["dy"]
    assert isinstance(lorenz.equations, tuple)


@pytest.mark.filterwarnings("ignore::bayeq.errors.ConvergenceWarning")  # it may not be refined, which is as well
def test_they_are_still_callable_after_all_that_makes_new_ones(duffing, record, tmp_path):
    duffing.save(tmp_path / "eq.json")
    others = [
        replace(duffing, equations=tuple(duffing.equations)),
        bq.load(tmp_path / "eq.json"),
        duffing.refine(record),
    ]
    for eq in others:
        assert [line.split(" = ")[0] for line in eq.equations()] == ["a"]
    assert copy.deepcopy(duffing.equations)() == duffing.equations()


def test_coefficients_are_those_shown(duffing, lorenz):
    assert duffing.coefficients() == {"a": duffing[0].shown_coef}
    assert duffing.coefficients()["a"]["x**3"] == pytest.approx(-1e5, rel=0.05)
    frame = pd.DataFrame(lorenz.coefficients())
    assert list(frame.columns) == ["dx", "dy", "dz"]
    assert frame.loc["x*z", "dy"] == pytest.approx(-1.0, abs=0.05)
    assert np.isnan(frame.loc["x*z", "dx"])


@pytest.mark.filterwarnings("ignore::bayeq.errors.DataWarning")  # a is no derivative of x
def test_a_constant_is_the_term_1():
    rng = np.random.default_rng(0)
    x, u = rng.normal(size=(2, 400))
    record = bq.Record({"x": x, "a": 3.0 - 2.0 * x + u + 0.01 * rng.normal(size=400), "u": u}, np.arange(400) / 10)
    eq = bq.discover(record, chains="x::a", inputs=["u"], dictionary="x, u", smooth="none")
    assert eq.coefficients()["a"]["1"] == pytest.approx(3.0, abs=0.01)
    assert ">1</td>" in eq._repr_html_()


# --- the figure ------------------------------------------------------------------------------------------------------


def test_plot_of_terms(duffing, lorenz, pyplot):
    (ax,) = duffing.plot()
    assert len(ax.patches) >= 4
    assert any("1003" in text.get_text() or "100" in text.get_text() for text in ax.texts)
    assert len(lorenz.plot()) == 3
    assert len(pyplot.get_fignums()) == 2


def test_plot_of_a_record_is_its_free_run(duffing, record, pyplot):
    axes = duffing.plot(record)
    assert [ax.get_ylabel() for ax in axes] == ["x [m]", "v [m/s]"]
    measured, run = axes[0].lines[:2]
    np.testing.assert_array_equal(measured.get_ydata(), record["x"])
    assert np.sqrt(np.mean((run.get_ydata() - record["x"]) ** 2)) < 0.2 * record["x"].std()


def test_plot_into_axes_that_are_given(lorenz, pyplot):
    figure, axes = pyplot.subplots(3)
    assert lorenz.plot(ax=axes) == list(axes)
    assert pyplot.get_fignums() == [figure.number]
    with pytest.raises(InputError, match="3 matplotlib axes are needed, one for each panel, got 1"):
        lorenz.plot(ax=axes[0])
    with pytest.raises(InputError, match="3 matplotlib axes"):
        lorenz.plot(ax=[1, 2, 3])


def test_the_caller_s_style_is_left_alone(duffing, pyplot):
    with pyplot.rc_context({"font.size": 31.0}):
        duffing.plot()
        assert pyplot.rcParams["font.size"] == 31.0


# --- HTML ------------------------------------------------------------------------------------------------------------


def test_html_begins_with_the_verdict(duffing):
    html = duffing._repr_html_()
    assert html.index("verdict: found") < html.index(duffing[0].text) < html.index("<table")
    for name in duffing[0].shown:
        assert f">{name}</td>" in html


def test_html_of_one_equation(lorenz):
    html = lorenz["dy"]._repr_html_()
    assert "verdict: " in html
    assert lorenz["dy"].text in html
    assert html.count("<table") == 1
    assert ">x*z</td>" in html


def test_html_of_hostile_names_is_harmless(duffing):
    evil = "</td><script>alert(1)</script>"
    verdict = Verdict("none", evil)
    one = replace(duffing[0], verdict=verdict, units={"x": evil, "a": evil})
    html = replace(duffing, equations=(one,), warnings=(evil,))._repr_html_()
    assert "<script" not in html
    assert html.count("&lt;script&gt;") >= 2


def test_html_of_a_record(record):
    html = record._repr_html_()
    assert "800 rows at 1000 Hz" in html
    assert html.count("<tr>") == 1 + len(record.names)
    empty = bq.Record({"x": np.array([np.nan, np.nan])}, [0.0, 1.0])
    assert ">2</td>" in empty._repr_html_()
