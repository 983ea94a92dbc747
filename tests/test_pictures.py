"""Pictures of an answer: axes are taken and returned, and what is drawn are the numbers of the answer."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from examples.gallery import PICTURES, page

import bayeq as bq
import bayeq.errors
from bayeq import figures
from bayeq.equation.report.page import Remembering
from bayeq.errors import InputError, UnknownNameError
from bayeq.figures.style import style

matplotlib_figure = pytest.importorskip("matplotlib.figure")

ROOT = Path(__file__).parents[1]
PAIRS = {"one_step", "free_run", "frequency_response"}


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", n=1200, seed=1)


@pytest.fixture(scope="module")
def eq(record):
    return bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u", dictionary="x, v, x**3, u")


@pytest.fixture(scope="module")
def source(eq):
    """The answer as a report gives it to pictures, with the runs that these share."""
    return Remembering(eq)


@pytest.fixture(scope="module")
def lorenz():
    record = bq.simulate("lorenz", n=300, seed=0)
    return record, bq.discover(record, chains=["x", "y", "z"], dictionary="x, y, z, x*y, x*z")


def given(name):
    """Axes of the caller's for a picture."""
    figure = matplotlib_figure.Figure()
    if name == "restoring_force_surface":
        return figure.add_subplot(projection="3d")
    return figure.subplots(2) if name in PAIRS else figure.subplots()


def drawn(ax, label):
    """What a line of a label shows."""
    (line,) = [line for line in ax.lines if line.get_label() == label]
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


@pytest.mark.parametrize("name", figures.__all__)
def test_axes_are_made_or_taken_returned_and_can_be_written(name, source, record, tmp_path):
    made = getattr(figures, name)(source, record)
    axes = made if name in PAIRS else (made,)
    assert len(axes) == (2 if name in PAIRS else 1)
    assert all(ax.get_xlabel() or ax.get_ylabel() or ax.images for ax in axes)
    own = given(name)
    taken = getattr(figures, name)(source, record, own)
    assert list(np.ravel(np.array(taken, dtype=object))) == list(np.ravel(np.array(own, dtype=object)))
    with style():
        np.ravel(np.array(made, dtype=object))[0].figure.savefig(tmp_path / "a.png", dpi=40)
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.parametrize("name", figures.__all__)
def test_wrong_axes_and_targets_are_refused(name, source, record):
    with pytest.raises(InputError, match="ax"):
        getattr(figures, name)(source, record, ax="here")
    options = {"channel": "q"} if name in {"free_run", "spectra", "frequency_response"} else {"target": "q"}
    with pytest.raises(UnknownNameError, match="q"):
        getattr(figures, name)(source, record, **({"states": ("x", "q")} if name == "phase_portrait" else options))


def test_bars_are_the_probabilities(eq):
    ax = figures.pip_bars(eq)
    widths = {ax.get_yticklabels()[round(bar.get_y() + 0.31)].get_text(): bar.get_width() for bar in ax.patches}
    assert widths == {
        "$x$": pytest.approx(1.0),
        "$v$": pytest.approx(1.0),
        "$x^{3}$": pytest.approx(1.0),
        "$u$": pytest.approx(1.0),
    }
    np.testing.assert_array_equal(sorted(widths.values()), sorted(eq[0].posterior.pip))


def test_the_forest_is_of_the_printed_intervals(eq, record):
    ax = figures.coefficient_forest(eq, record)
    (bars,) = ax.collections
    coef, ci = eq[0].shown_posterior.coef, eq[0].printed_ci95
    for place, segment in enumerate(bars.get_segments()):
        ends = coef[place] + abs(coef[place]) * segment[:, 0] / 100
        np.testing.assert_allclose(ends, ci[place], rtol=1e-9)
    off, _ = drawn(ax, "true")
    truth = [record.truth.coefficients["a"][term] for term in ("x", "v", "x**3", "u")]
    np.testing.assert_allclose(coef + abs(coef) * off / 100, truth, rtol=1e-9)


def test_measured_against_predicted(eq, record):
    ax = figures.measured_against_predicted(eq, record)
    rows = eq.motion(record)
    x, y = drawn(ax, "rows used")
    cut = record.n - int(0.2 * record.n)
    np.testing.assert_allclose(y, record["a"][:cut])
    np.testing.assert_allclose(x, eq[0].evaluate(rows.columns)[:cut])
    assert len(drawn(ax, "rows held out")[0]) == record.n - cut


def test_one_step_has_the_predictive_band(eq, record):
    upper, lower = figures.one_step(eq, record, start=100, rows=200)
    time, measured = drawn(upper, "measured")
    np.testing.assert_array_equal(time, record.time[100:300])
    np.testing.assert_array_equal(measured, record["a"][100:300])
    _, mean = drawn(upper, "one step")
    _, residual = drawn(lower, "residual: measured less one step")
    np.testing.assert_allclose(residual, measured - mean)
    vertices = upper.collections[0].get_paths()[0].vertices
    middle = vertices[np.isclose(vertices[:, 0], time[50])][:, 1]
    assert np.ptp(middle) / 2 == pytest.approx(1.96 * eq[0].noise_sd, rel=0.02)
    with pytest.raises(InputError, match="1200"):
        figures.one_step(eq, record, start=1199, rows=5)


def test_the_free_run_is_that_of_simulate(eq, record):
    upper, lower = figures.free_run(eq, record, channel="v", draws=20)
    run = eq.simulate(record, draws=20, start=960)
    np.testing.assert_allclose(drawn(upper, "free run")[1], run.mean["v"])
    np.testing.assert_allclose(drawn(lower, "residual: measured less free run")[1], run.measured["v"] - run.mean["v"])


def test_the_restoring_force_is_the_spring_s(eq, record):
    ax = figures.restoring_force_curve(eq, record)
    x, force = drawn(ax, "discovered")
    law = eq[0].shown_coef
    p = eq[0].shown_posterior
    np.testing.assert_allclose(force, -p.intercept - law["x"] * x - law["x**3"] * x**3, rtol=1e-9)
    place, measured = drawn(ax, "measured less other terms")
    rows = eq.motion(record).columns
    expected = law["v"] * rows["v"] + law["u"] * rows["u"] - record["a"]
    np.testing.assert_allclose(measured, expected, rtol=1e-9)
    # the true spring, which the record's law knows, lies within a few times the noise of the samples
    true = record.truth.coefficients["a"]
    error = measured + true["x"] * place + true["x**3"] * place**3
    assert np.abs(np.mean(error)) < 0.1 * np.std(measured)


def test_the_damping_force_is_over_the_velocity(eq, record):
    ax = figures.restoring_force_curve(eq, record, over="v")
    v, force = drawn(ax, "discovered")
    np.testing.assert_allclose(force, -eq[0].shown_posterior.intercept - eq[0].shown_coef["v"] * v, rtol=1e-9)
    with pytest.raises(UnknownNameError):
        figures.restoring_force_curve(eq, record, over="u")


def test_the_surface_is_that_of_both(eq, record):
    ax = figures.restoring_force_surface(eq, record)
    (dots,) = [one for one in ax.collections if one.get_label() == "measured"]
    x, v, force = (np.asarray(values) for values in dots._offsets3d)
    law = eq[0].shown_coef
    expected = -eq[0].shown_posterior.intercept - law["x"] * x - law["x**3"] * x**3 - law["v"] * v
    # what is left is the noise of the equation
    assert np.std(force - expected) == pytest.approx(eq[0].noise_sd, rel=0.1)


def test_a_restoring_force_needs_an_equation_of_second_order(lorenz):
    record, eq = lorenz
    for name in ("restoring_force_surface", "restoring_force_curve"):
        with pytest.raises(InputError, match="second order"):
            getattr(figures, name)(eq, record)
    with pytest.raises(InputError, match="no input"):
        figures.frequency_response(eq, record)
    assert figures.pip_bars(eq, target="dz").get_title(loc="left") == "$dz$"
    assert len(figures.phase_portrait(eq, record, states=("x", "z")).lines) == 4  # record, its rows, run, start


def test_spectra_hold_the_power(eq, record):
    ax = figures.spectra(eq, record)
    f, density = drawn(ax, "measured")
    # Parseval: the integral of the density is the variance, but for windows and means of segments
    assert np.trapezoid(density, f) == pytest.approx(np.var(record["x"]), rel=0.35)
    assert drawn(ax, "difference")[1].max() < 0.01 * density.max()


def test_the_frequency_response_is_that_of_the_oscillator():
    record = bq.simulate("linear", n=5000, seed=2, noise=0.01)
    eq = bq.discover(
        record, displacement="x", velocity="v", acceleration="a", force="u", dictionary="x, v, u", smooth="none"
    )
    upper, lower = figures.frequency_response(eq, record)
    (coherence,) = [ax for ax in upper.figure.axes if ax.get_ylabel() == "coherence"]
    assert np.nanmedian(drawn(coherence, "free run")[1]) > 0.95  # that of a linear system
    f, gain = drawn(upper, "free run")
    law = eq[0].shown_coef
    omega = 2j * np.pi * f
    exact = law["u"] / (omega**2 - law["v"] * omega - law["x"])
    above = (f > 15.0) & (f < 60.0)  # where segments resolve it: the natural frequency is 5 Hz
    np.testing.assert_allclose(gain[above], np.abs(exact[above]), rtol=0.1)
    np.testing.assert_allclose(drawn(lower, "free run")[1][above], -180.0, atol=10.0)


def test_what_no_sensor_gave_is_not_called_measured(record):
    alone = bq.Record({name: record[name] for name in "xu"}, record.time).slice(0, 800)
    eq = bq.discover(alone, chains="x::", inputs="u", dictionary="x, dx, x**3, u")
    assert figures.measured_against_predicted(eq, alone).get_ylabel().startswith("estimated")
    for name in ("one_step", "restoring_force_curve", "restoring_force_surface"):
        ax = np.ravel(np.array(getattr(figures, name)(eq, alone), dtype=object))[0]
        labels = ax.get_legend_handles_labels()[1]
        assert any(label.startswith("estimated") for label in labels)
        assert not any("measured" in label for label in labels)


def test_correlation_of_candidates(eq, record):
    ax = figures.candidate_correlation(eq, record)
    shown = np.asarray(ax.images[0].get_array())
    x, v, u = (eq.motion(record).columns[name] for name in "xvu")
    np.testing.assert_allclose(shown, np.corrcoef([x, v, x**3, u]), atol=1e-12)


def test_motion_needs_a_record(eq):
    with pytest.raises(InputError, match="Record"):
        eq.motion({"x": [1.0]})


def test_uneven_times_have_no_spectrum(eq, record):
    keep = np.arange(record.n) % 7 != 3
    with pytest.raises(InputError, match="even"):
        figures.spectra(eq, record.take(keep))


@pytest.fixture(scope="module")
def untimed(record):
    """An answer to a record without time, and the record."""
    record = bq.Record(dict(record.channels))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", bq.errors.BayeqWarning)
        eq = bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u", dictionary="x, v, u")
    assert "time is not known" in eq.warnings[0]
    return Remembering(eq), record


@pytest.mark.parametrize("name", figures.__all__)
def test_rows_without_time_are_counted(name, untimed):
    made = getattr(figures, name)(*untimed)
    labels = [ax.get_xlabel() for ax in np.ravel(np.array(made, dtype=object))]
    assert not any("[s]" in label or "[Hz]" in label for label in labels)


def test_every_picture_is_in_the_gallery():
    assert sorted(PICTURES) == figures.__all__
    text = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert text == page()
    assert all((ROOT / "docs" / "figures" / f"gallery_{name}.png").exists() for name in PICTURES)


def test_pictures_are_there_without_an_import_of_their_own():
    code = "import sys, bayeq; bayeq.figures.pip_bars; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
