"""Noise of Student's t: variances of single samples in the likelihood of the record."""

import numpy as np
import pytest
from scipy import stats

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import DataWarning, InputError
from bayeq.likelihood.unequal import tails_of

ROLES = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
AMONG_EIGHT = {**ROLES, "dictionary": "x, v, x**2, x**3, x*v, v**2, v*abs(v), u"}


def with_noise(draw, seed=3, n=1500):
    """A Duffing record with 3 % noise of a distribution of unit variance."""
    clean, rng = bq.simulate("duffing", n=n, noise=0.0, seed=seed), np.random.default_rng(seed)
    channels = {name: clean[name] + 0.03 * clean[name].std() * draw(rng, n) for name in clean.names}
    return bq.Record.from_arrays(channels, time=clean.time)


@pytest.mark.parametrize("freedom", [1.5, 3.0, 6.0])
def test_degrees_of_freedom_and_scale_of_errors_are_the_likeliest(freedom):
    errors = 2.5 * np.random.default_rng(1).standard_t(freedom, 20_000)
    found = tails_of(errors**2)
    assert found.freedom == freedom
    assert found.variance == pytest.approx(2.5**2, rel=0.06)
    # the fixed point is the maximum: scipy's density falls on either side
    values = [stats.t.logpdf(errors, freedom, scale=np.sqrt(found.variance * f)).sum() for f in (0.9, 1.0, 1.1)]
    assert values[1] == max(values)


def test_gaussian_errors_have_equal_variances():
    squares = np.random.default_rng(2).normal(size=5000) ** 2
    found = tails_of(squares)
    assert np.isinf(found.freedom)
    assert (found.spread(squares) == 1.0).all()


def test_intervals_under_heavy_tails_are_shorter_and_cover():
    record = with_noise(lambda rng, n: rng.standard_t(3, n) / np.sqrt(3.0), n=1200)
    with pytest.warns(DataWarning, match="left out"):
        gauss, student = (
            bq.discover(record, **AMONG_EIGHT, tails=tails, holdout=0.0) for tails in ("gauss", "student")
        )
    truth = bq.simulate("duffing", n=10, seed=3).truth.coefficients["a"]
    tables = [eq.table().set_index("term") for eq in (gauss, student)]
    assert set(student[0].included) == set(truth)
    for term, value in truth.items():
        assert abs(tables[1].coef[term] - value) < 4.0 * tables[1].sd[term]
    # the information of a t of 3 degrees of freedom about its place is twice 1/variance: 0.71 of the sd, less where
    # spikes are left out
    assert tables[1].sd["u"] < 0.9 * tables[0].sd["u"]


def test_with_gaussian_noise_nothing_changes():
    record = with_noise(lambda rng, n: rng.normal(size=n), n=800)
    gauss, student = (bq.discover(record, **AMONG_EIGHT, tails=tails, holdout=0.0)[0] for tails in ("gauss", "student"))
    assert gauss.included == student.included
    for term, value in gauss.coef.items():
        assert student.coef[term] == pytest.approx(value, rel=2e-3)


def test_is_kept_in_files_and_shown(tmp_path, capsys):
    record = with_noise(lambda rng, n: rng.normal(size=n), n=800)
    run, saved = tmp_path / "run.csv", tmp_path / "eq.json"
    bq.write(record, run)
    roles = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u"]
    assert (
        main(
            ["discover", str(run), *roles, "--dictionary", "x, v, x**3, u", "--tails", "student", "--save", str(saved)]
        )
        == 0
    )
    assert "noise: Student's t" in capsys.readouterr().out
    assert bq.load(saved).data.sensors.tails == "student"


@pytest.mark.parametrize(("given", "said"), [({"tails": "t"}, "'gauss' or 'student'"), ({"smooth": "none"}, "'none'")])
def test_what_cannot_be_is_refused(given, said):
    record = bq.simulate("duffing", n=200, seed=1)
    with pytest.raises(InputError, match=said):
        bq.discover(record, **ROLES, **{"tails": "student", **given})


@pytest.mark.filterwarnings("ignore")  # of few rows, which is not the point
def test_where_it_makes_no_difference_that_is_said(monkeypatch):
    def singular(*_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr("bayeq.likelihood.record_fit.search", singular)
    record = bq.simulate("duffing", n=300, seed=1)
    eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=["x", "v", "x**3", "u"], tails="student")
    assert any("the full fit failed, a simpler one was used" in message for message in eq.warnings)
    assert {"x", "u"} <= set(eq[0].shown)
    assert any("tails='student' makes no difference" in message for message in eq.warnings)
