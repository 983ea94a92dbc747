"""PIPs under other priors: each is what a fit under that prior gives, and the figure shows it."""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import expit, logit

import bayeq as bq
from bayeq import Prior, PriorSensitivity, SpikeSlabBMA
from bayeq.cli.app import main
from bayeq.equation.prior_sensitivity import prior_sensitivity
from bayeq.errors import ConvergenceWarning, InputError, MissingExtraError
from bayeq.figures.sensitivity import spread
from bayeq.figures.style import style
from bayeq.gram import Gram
from bayeq.gram.lazy import grams_of
from bayeq.inference.sensitivity import common_inclusion, inclusion_axis, slab_axis, with_inclusion
from tests import reference

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "smooth": "none"}
RECORD = bq.simulate("duffing", seed=1)
EQ = bq.discover(RECORD, **OSCILLATOR)
VARIED = EQ[0].sensitivity()


def problem(seed, **options):
    D, y, _ = reference.random_problem(np.random.default_rng(seed), **options)
    return D, y, Gram.from_data(D, y)


# --- the numbers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("seed", "P"), [(0, 6), (1, 20)])
def test_every_pair_is_what_a_fit_under_that_prior_gives(seed, P):
    D, y, gram = problem(seed, P=P, n=80)
    found = prior_sensitivity(gram, Prior(), [1.0, 40.0], [0.05, 0.3], every_pair=True)
    np.testing.assert_array_equal(found.slab_variance, [1.0, 10.0, 40.0])
    np.testing.assert_array_equal(found.prior_inclusion, [0.05, 0.1, 0.3])
    assert found.base == (1, 1)
    assert found.listed.all()
    for v, slab_variance in enumerate(found.slab_variance):
        for q, p0 in enumerate(found.prior_inclusion):
            fit = SpikeSlabBMA(slab_variance=slab_variance, prior_inclusion=p0).fit(D, y)
            np.testing.assert_allclose(found.pip[v, q], fit.pip_, atol=1e-10)
            assert found.left_out[v, q] == pytest.approx(fit.average_.left_out, abs=1e-10)


def test_terms_with_a_prior_of_their_own_against_all_models_written_out():
    D, y, gram = problem(2, P=7, n=40, noise=2.0)
    own = np.array([0.3, 0.05, 0.1, 1.0, 0.5, 0.2, 0.0])
    prior = Prior(slab_variance=5.0, prior_inclusion=own)
    found = prior_sensitivity(gram, prior, [0.5, 50.0], [0.02, 0.6], every_pair=True)
    base = expit(logit(own[[0, 1, 2, 4, 5]]).mean())
    assert found.prior_inclusion[found.base[1]] == pytest.approx(base, rel=1e-14)
    for v, slab_variance in enumerate(found.slab_variance):
        for q, p0 in enumerate(found.prior_inclusion):
            shifted = expit(logit(own) + logit(p0) - logit(base))
            with np.errstate(divide="ignore"):
                _, _, total, exact = reference.enumerate_models(D, y, v_s=slab_variance, p0=shifted, N=len(y) - 1)
            assert np.isfinite(total)
            np.testing.assert_allclose(found.pip[v, q], exact, atol=1e-8)
    np.testing.assert_allclose(found.pip[..., 3], 1.0, atol=1e-12)
    assert not found.pip[..., 6].any()


def test_an_unknown_p_0_keeps_its_weight_while_its_mean_moves():
    D, y, gram = problem(3, P=8, n=40, noise=2.0)
    found = prior_sensitivity(gram, Prior(inclusion_beta=(1.0, 7.0)), [], [0.5])
    np.testing.assert_array_equal(found.prior_inclusion, [0.125, 0.5])
    for q, shapes in enumerate([(1.0, 7.0), (4.0, 4.0)]):
        fit = SpikeSlabBMA(inclusion_beta=shapes).fit(D, y)
        np.testing.assert_allclose(found.pip[0, q], fit.pip_, atol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_more_terms_are_expected_the_likelier_they_are_beforehand(seed):
    # the posterior is an exponential family in the common log-odds eta: d E[number of terms]/d eta = its variance > 0
    D, y, gram = problem(seed, P=9, n=30, noise=2.0)
    step = 1e-4
    p0 = np.array([0.02, 0.2, 0.6])
    found = prior_sensitivity(gram, Prior(), [], np.concatenate([p0, expit(logit(p0) + step)]))
    expected = found.pip[0].sum(axis=1)
    assert np.all(np.diff(expected) > 0)
    for p in p0:
        models, logs, total, _ = reference.enumerate_models(D, y, p0=p, N=len(y) - 1)
        size, weight = models.sum(axis=1), np.exp(logs - total)
        variance = weight @ size**2 - (weight @ size) ** 2
        q = int(np.flatnonzero(found.prior_inclusion == p)[0])
        assert (expected[q + 1] - expected[q]) / step == pytest.approx(variance, rel=1e-2)


def test_shifting_the_prior_keeps_the_relation_among_terms():
    own = np.array([0.3, 0.05, 1.0, 0.1, 0.0])
    for prior in (Prior(prior_inclusion=own), Prior(prior_inclusion=own, inclusion_beta=(2.0, 3.0)), Prior()):
        for p in (0.01, 0.45, 0.99):
            other = with_inclusion(prior, 5, p)
            assert common_inclusion(other, 5) == pytest.approx(p, rel=1e-12)
            odds, before = other.log_odds(5), prior.log_odds(5)
            np.testing.assert_array_equal(np.isinf(odds), np.isinf(before))
            np.testing.assert_array_equal(odds[np.isinf(odds)], before[np.isinf(odds)])
            free = np.isfinite(odds)
            np.testing.assert_allclose(np.diff(odds[free]), np.diff(before[free]), atol=1e-12)
        assert with_inclusion(prior, 5, common_inclusion(prior, 5)) is prior
    assert with_inclusion(Prior(inclusion_beta=(2.0, 3.0)), 5, 0.8).inclusion_beta == pytest.approx((4.0, 1.0))


def test_a_wide_dictionary_gives_the_same_whether_its_gram_is_lazy_or_not():
    rng = np.random.default_rng(0)
    D = rng.normal(size=(40, 520))
    y = 3 * D[:, 7] - 2 * D[:, 300] + rng.normal(size=40)
    (lazy,) = grams_of(D, y[:, None])
    assert not isinstance(lazy, Gram)
    prior = Prior(prior_inclusion=0.0005)
    some = {"slab_variances": [100.0], "prior_inclusions": [0.0002]}
    found = prior_sensitivity(lazy.standardise().gram, prior, **some)
    dense = prior_sensitivity(Gram.from_data(D, y).standardise().gram, prior, **some)
    np.testing.assert_allclose(found.pip, dense.pip, atol=1e-8)


# --- of equations and estimators -------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["auto", "bma"])
def test_the_prior_used_gives_the_pips_of_the_equation(method):
    equation = EQ[0] if method == "auto" else bq.discover(RECORD, **OSCILLATOR, method=method)[0]
    found = equation.sensitivity()
    np.testing.assert_array_equal(found.pip[found.base], equation.posterior.pip)
    assert found.slab_variance[found.base[0]] == equation.posterior.slab_variance
    assert found.prior_inclusion[found.base[1]] == 0.1
    assert found.names == tuple(term.text for term in equation.terms)


def test_the_defaults_are_nine_values_of_v_s_and_seven_of_p_0():
    np.testing.assert_allclose(
        VARIED.slab_variance / EQ[0].posterior.slab_variance, 10.0 ** np.arange(-2.0, 2.1, 0.5), rtol=1e-12
    )
    np.testing.assert_array_equal(VARIED.prior_inclusion, [0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5])
    v, q = VARIED.base
    computed = np.isfinite(VARIED.left_out)
    assert computed.sum() == 15
    assert computed[v].all()
    assert computed[:, q].all()
    np.testing.assert_array_equal(np.isfinite(VARIED.pip), np.repeat(computed[..., None], 36, axis=2))
    assert slab_axis(Prior(slab_variance=1.0))[0][0] == 0.1  # not below
    assert slab_axis(Prior(slab_variance=0.01))[0][0] == 0.01  # unless it is the prior's own


@pytest.mark.filterwarnings("ignore:. is .* times:bayeq.errors.DataWarning")  # units that do not belong together
@pytest.mark.filterwarnings("ignore:a. no equation found:bayeq.errors.DataWarning")
def test_units_do_not_matter():
    scaled = bq.Record.from_arrays(
        x=1e3 * RECORD["x"], v=1e-2 * RECORD["v"], a=5.0 * RECORD["a"], u=RECORD["u"] / 7.0, fs=1000
    )
    terms = ["x", "v", "x**2", "x**3", "x**5", "x*abs(x)", "sign(v)", "u"]
    one, other = (bq.discover(r, **OSCILLATOR, dictionary=terms)[0].sensitivity() for r in (RECORD, scaled))
    # the evidence is flat about the v_s that maximises it: half of the digits
    np.testing.assert_allclose(one.slab_variance, other.slab_variance, rtol=1e-4)
    np.testing.assert_allclose(one.pip, other.pip, atol=1e-4)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_only_where_there_is_a_prior_to_vary(tmp_path):
    for method in ("rvm", "stlsq"):
        with pytest.raises(InputError, match=f"method '{method}' has no v_s and p_0 to vary; take one of: auto, bma"):
            bq.discover(RECORD, **OSCILLATOR, method=method)[0].sensitivity()
    vb = bq.discover(RECORD, **OSCILLATOR, method="vb")[0].sensitivity([], [])
    np.testing.assert_array_equal(vb.pip[0, 0], EQ[0].posterior.pip)
    EQ.save(tmp_path / "eq.json")
    loaded = bq.load(tmp_path / "eq.json")[0]
    assert loaded.fit is None
    with pytest.raises(InputError, match="run discover again"):
        loaded.sensitivity()


def test_what_was_solved_stays_out_of_sight(tmp_path):
    assert "fit=" not in repr(EQ[0])
    assert "DtD" not in json_of(EQ, tmp_path)
    assert replace(EQ[0], fit=None) == EQ[0]
    assert EQ[0].fit.prior.slab_variance == EQ[0].posterior.slab_variance
    assert EQ[0].fit.standard.gram.names == EQ[0].posterior.names


def json_of(eq, folder):
    eq.save(folder / "eq.json")
    return (folder / "eq.json").read_text()


def test_of_an_estimator_under_the_prior_it_was_fitted_with():
    D, y, _ = problem(4, P=6, n=60)
    both = SpikeSlabBMA(slab_variance=3.0).fit(D, np.column_stack([y, y[::-1]]))
    both.set_params(slab_variance=99.0)
    for k in (0, 1):
        found = both.sensitivity(target=k)
        np.testing.assert_allclose(found.pip[found.base], both.pip_[k], atol=1e-12)
        assert found.slab_variance[found.base[0]] == 3.0
    with pytest.raises(InputError, match="2 targets"):
        both.sensitivity()


# --- what may be asked -----------------------------------------------------------------------------------------------


def test_the_prior_s_own_values_are_always_among_them():
    values, at = inclusion_axis(Prior(prior_inclusion=0.15), 3, (0.5, 0.05, 0.05))
    assert (values.tolist(), at) == ([0.05, 0.15, 0.5], 1)
    values, at = inclusion_axis(Prior(prior_inclusion=0.3), 3, [0.1 + 0.2])  # the same but for rounding
    assert (values.tolist(), at) == ([0.3], 0)
    values, at = slab_axis(Prior(), 5)
    assert (values.tolist(), at) == ([5.0, 10.0], 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"slab_variances": [1.0, 0.0]}, "slab_variances must be positive numbers, got 0"),
        ({"slab_variances": [np.inf]}, "slab_variances must be positive numbers, got inf"),
        ({"slab_variances": [[1.0]]}, r"slab_variances must be a list of numbers, got an array of shape \(1, 1\)"),
        ({"prior_inclusions": [0.5, 1.0]}, "prior_inclusions must be greater than 0 and less than 1, got 1"),
        ({"prior_inclusions": [np.nan]}, "prior_inclusions must be greater than 0 and less than 1, got nan"),
    ],
)
def test_values_out_of_range(options, message):
    with pytest.raises(InputError, match=message):
        EQ[0].sensitivity(**options)


def test_nothing_to_vary_where_all_terms_are_forced_or_forbidden():
    _, _, gram = problem(0, P=2)
    for p0 in (1.0, np.array([0.0, 1.0])):
        with pytest.raises(InputError, match="every term is forced in or kept out"):
            prior_sensitivity(gram, Prior(prior_inclusion=p0))


# --- what is told ----------------------------------------------------------------------------------------------------


def test_table_and_changes_say_the_same():
    table = VARIED.table()
    assert list(table.columns) == ["slab_variance", "prior_inclusion", "term", "pip", "left_out"]
    assert len(table) == 15 * 36
    row = table[(table.slab_variance == VARIED.slab_variance[2]) & (table.term == "x**5")].iloc[0]
    assert row.prior_inclusion == 0.1
    assert row.pip == VARIED.pip[2, 3, VARIED.names.index("x**5")]
    spans = table.groupby("term").pip.agg(["min", "max"])
    changing = spans[(spans["min"] <= 0.5) & (spans["max"] > 0.5)]
    changes = VARIED.changes().set_index("term")
    assert set(changes.index) == set(changing.index)
    assert {"x**5", "x*abs(x)"} <= set(changes.index)
    assert not {"x", "v", "x**3", "u"} & set(changes.index)
    for term, line in changes.iterrows():
        assert (line.lowest, line.highest) == tuple(spans.loc[term])
        assert line.pip == EQ[0].posterior.pip[VARIED.names.index(term)]
    width = changes.highest - changes.lowest
    assert width.is_monotonic_decreasing
    assert "included by all: x, v, x**3, u\n" in str(VARIED)
    assert "x**5 (PIP 0.25, " in str(VARIED)


def test_what_the_readme_says_of_the_demo():
    (equation,) = bq.discover(RECORD, displacement="x", velocity="v", acceleration="a", force="u")
    found = equation.sensitivity()
    table = found.table()
    true = table.term.isin(["x", "v", "x**3", "u"])
    assert table[true].pip.min() > 0.5
    others = table[(table.pip > 0.5) & ~true]
    assert len(others)
    few = others.slab_variance < 0.11 * equation.posterior.slab_variance
    assert (few | (others.prior_inclusion == 0.5)).all()
    assert np.isfinite(found.left_out).sum() == 15


def made(pip, left_out):
    return PriorSensitivity(
        names=("p", "q"),
        slab_variance=np.array([1.0, 10.0]),
        prior_inclusion=np.array([0.1]),
        base=(0, 0),
        pip=np.array(pip)[:, None, :],
        left_out=np.array(left_out)[:, None],
    )


def test_priors_whose_models_were_not_listed_do_not_count():
    all_listed = made([[0.9, 0.2], [0.4, 0.8]], [0.0, 0.01])
    assert all_listed.changes().term.tolist() == ["q", "p"]
    one = made([[0.9, 0.2], [0.4, 0.8]], [0.0, 0.3])
    assert one.listed.tolist() == [[True], [False]]
    assert one.changes().empty
    assert str(one).splitlines()[1:] == [
        "included by all: p",
        "included by some: none",
        "not counted: 1 priors under which too many models share the posterior mass",
    ]
    assert one.table().left_out.tolist() == [0.0, 0.0, 0.3, 0.3]
    none = made([[0.9, 0.2], [0.4, 0.8]], [0.1, 0.3])
    assert none.changes().empty
    assert "included by all: none" in str(none)


def test_a_prior_whose_models_cannot_be_listed_is_warned_of():
    _, _, gram = problem(0, n=25, P=40, rho=0.9, noise=3.0)
    with pytest.warns(ConvergenceWarning, match="too many models share the posterior mass"):
        found = prior_sensitivity(gram, Prior(prior_inclusion=0.4), [], [0.5])
    assert not found.listed.any()
    with style():
        assert "too many models to list" in [t.get_text() for t in found.plot().legends[0].get_texts()]


# --- the figure ------------------------------------------------------------------------------------------------------


def beside(ax):
    """Labels beside a panel, with the terms that share one apart."""
    return [t.get_text() for t in ax.texts if not t.get_text().startswith("used: ")]


def test_the_figure_labels_the_terms_and_marks_the_prior_used():
    figure = VARIED.plot()
    assert [ax.get_xlabel() for ax in figure.axes] == ["slab variance $v_s$", "prior inclusion probability $p_0$"]
    noteworthy = np.nanmax(VARIED.pip, axis=(0, 1)) > 0.05
    for ax, axis, base in zip(
        figure.axes,
        (VARIED.slab_variance, VARIED.prior_inclusion),
        (f"{VARIED.slab_variance[4]:.4g}", "0.1"),
        strict=True,
    ):
        labels = beside(ax)
        assert "$x$, $v$, $x^{3}$, $u$" in labels  # alike, all near 1
        assert {"$x^{5}$", r"$x\,|x|$", r"$\mathrm{sgn}(x)$"} <= set(labels)
        assert len(", ".join(labels).split(", ")) == noteworthy.sum()
        assert f"used: {base}" in [t.get_text() for t in ax.texts]
        curves = [line for line in ax.lines if len(line.get_xdata()) == len(axis)]
        assert len(curves) == noteworthy.sum()
        for line in curves:
            np.testing.assert_array_equal(line.get_xdata(), axis)
    j = VARIED.names.index("x**5")
    for ax, pip in zip(figure.axes, (VARIED.pip[:, 3, j], VARIED.pip[4, :, j]), strict=True):
        assert sum(np.array_equal(line.get_ydata(), pip) for line in ax.lines) == 1


def test_nothing_overlaps_or_is_clipped():
    rng = np.random.default_rng(0)
    names = tuple(f"displacement_of_floor_{k}**2" if k % 2 else f"Displ. {k} ($m)" for k in range(30))
    pip = np.sort(rng.random((3, 3, 30)) ** 2, axis=2)
    crowded = PriorSensitivity(
        names=names,
        slab_variance=np.array([1.0, 2.0, 3.0]),
        prior_inclusion=np.array([0.1, 0.11, 0.12]),
        base=(0, 2),
        pip=pip,
        left_out=np.full((3, 3), 0.1) * np.eye(3),
    )
    for figure in (VARIED.plot(), crowded.plot()):
        with style():
            figure.draw_without_rendering()
        for ax in figure.axes:
            box = ax.get_tightbbox()
            assert box.x0 >= 0
            assert box.y0 >= 0
            assert box.x1 <= figure.bbox.x1
            low, high = ax.get_xlim()
            ticks = [t.label1.get_window_extent() for t in ax.xaxis.get_major_ticks() if low <= t.get_loc() <= high]
            assert len(ticks) >= 2
            assert not any(a.overlaps(b) for a, b in combinations(ticks, 2))
            labels = [t.get_window_extent() for t in ax.texts]
            # boxes of letters with a descender touch by a hair
            assert not any(min(a.y1, b.y1) - max(a.y0, b.y0) > 2 and a.overlaps(b) for a, b in combinations(labels, 2))
        legend = figure.legends[0].get_window_extent()
        assert not any(legend.overlaps(t.get_window_extent()) for ax in figure.axes for t in ax.texts)


@pytest.mark.parametrize("seed", range(20))
def test_labels_are_moved_as_little_as_they_can_be(seed):
    rng = np.random.default_rng(seed)
    heights = rng.uniform(0.02, 0.1, size=rng.integers(1, 9))
    wanted = np.sort(rng.random(len(heights)))
    at = spread(wanted, heights, -10.0, 10.0)
    room = np.diff(at) - 0.5 * (heights[1:] + heights[:-1])
    assert np.all(room > -1e-12)
    best = minimize(
        lambda c: np.sum((c - wanted) ** 2),
        np.cumsum(heights),
        constraints={"type": "ineq", "fun": lambda c: np.diff(c) - 0.5 * (heights[1:] + heights[:-1])},
        options={"ftol": 1e-12, "maxiter": 500},
    )
    np.testing.assert_allclose(at, best.x, atol=1e-4)
    inside = spread(wanted, heights, 0.0, 1.0)
    assert np.all(np.diff(inside) - 0.5 * (heights[1:] + heights[:-1]) > -1e-12)
    assert inside[0] - heights[0] / 2 >= -1e-12
    assert inside[-1] + heights[-1] / 2 <= 1 + 1e-12


def test_without_matplotlib(monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[plot\]"):
        VARIED.plot()


# --- on the command line ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lorenz(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "lorenz.csv"
    bq.write(bq.simulate("lorenz", n=300, seed=0), path)
    return path


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_a_table_or_a_figure_of_all_equations(lorenz, tmp_path):
    arguments = ["discover", str(lorenz), "--chain", "x", "--chain", "y", "--dictionary", "x,y,x**2,x*y"]
    assert main([*arguments, "--sensitivity", str(tmp_path / "pip.csv")]) == 0
    with (tmp_path / "pip.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["target", "slab_variance", "prior_inclusion", "term", "pip", "left_out"]
    direct = bq.discover(bq.read(lorenz), chains=["x", "y"], dictionary="x,y,x**2,x*y")
    expected = [(e.target, *row) for e in direct for row in e.sensitivity().table().itertuples(index=False)]
    assert [(r["target"], r["term"]) for r in rows] == [(e[0], e[3]) for e in expected]
    np.testing.assert_allclose([float(r["pip"]) for r in rows], [e[4] for e in expected], atol=1e-12)
    for suffix, start in (("png", b"\x89PNG"), ("svg", b"<?xml"), ("PDF", b"%PDF")):
        path = tmp_path / f"pip.{suffix}"
        assert main([*arguments, "--sensitivity", str(path)]) == 0
        assert path.read_bytes().startswith(start)
    # the same bytes every time, though SVG and PDF have room for dates and names by chance
    for path in (tmp_path / "pip.svg", tmp_path / "pip.PDF"):
        first = path.read_bytes()
        assert main([*arguments, "--sensitivity", str(path)]) == 0
        assert path.read_bytes() == first
