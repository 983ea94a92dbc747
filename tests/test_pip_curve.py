"""PIPs against v_s, p_0 and the power of the likelihood: each is exact, and tables and figures show it."""

from __future__ import annotations

import csv
import sys
from itertools import combinations

import numpy as np
import pytest
from scipy.special import expit, logit

import bayeq as bq
from bayeq import Prior, PriorSensitivity, SpikeSlabBMA
from bayeq.cli.app import main
from bayeq.equation.sensitivity import PipCurve, draw_pip_curves, power_sensitivity, prior_sensitivity
from bayeq.errors import ConvergenceWarning, InputError, MissingExtraError
from bayeq.inference.gram import Gram, grams_of
from tests import reference

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "smooth": "none"}
FEW = ["x", "v", "x**2", "x**3", "x*abs(x)", "v**3", "u"]


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", seed=1)


@pytest.fixture(scope="module")
def equation(record):
    return bq.discover(record, **OSCILLATOR)[0]


@pytest.fixture(scope="module")
def varied(equation):
    return equation.sensitivity()


def problem(seed, **options):
    D, y, _ = reference.random_problem(np.random.default_rng(seed), **options)
    return D, y, Gram.from_data(D, y)


# --- the numbers -----------------------------------------------------------------------------------------------------


def test_priors_against_all_models_written_out():
    D, y, gram = problem(2, P=7, n=40, noise=2.0)
    own = np.array([0.3, 0.05, 0.1, 1.0, 0.5, 0.2, 0.0])
    found = prior_sensitivity(gram, Prior(slab_variance=5.0, prior_inclusion=own), [0.5, 50.0], [0.02, 0.6])
    used = expit(logit(own[[0, 1, 2, 4, 5]]).mean())
    np.testing.assert_array_equal(found.slab_variance.values, [0.5, 5.0, 50.0])
    np.testing.assert_allclose(found.prior_inclusion.values, [0.02, used, 0.6], rtol=1e-14)
    assert found.slab_variance.current == found.prior_inclusion.current == 1
    priors = [(v_s, used) for v_s in (0.5, 5.0, 50.0)] + [(5.0, p) for p in found.prior_inclusion.values]
    for pip, (v_s, p) in zip(np.concatenate([curve.pip for curve in found]), priors, strict=True):
        shifted = expit(logit(own) + logit(p) - logit(used))
        with np.errstate(divide="ignore"):
            exact = reference.enumerate_models(D, y, v_s=v_s, p0=shifted, N=len(y) - 1)[3]
        np.testing.assert_allclose(pip, exact, atol=1e-8)
        assert (pip[3], pip[6]) == (pytest.approx(1.0), 0.0)  # forced and forbidden


def test_powers_of_the_likelihood_of_an_equation_against_all_models_written_out(record):
    equation = bq.discover(record, **OSCILLATOR, dictionary=FEW)[0]
    curve = equation.coarsening()
    np.testing.assert_array_equal(curve.pip[curve.current], equation.posterior.pip)
    np.testing.assert_allclose(
        curve.values, 2.0 ** np.arange(-9.0, 1.0)
    )  # 3,200 rows: 5 are left of 2^-9, not of 2^-10
    np.testing.assert_allclose(curve.rows, 3200 * curve.values)
    assert not curve.left_out.any()
    gram, prior = equation.fit.standard.gram, equation.fit.prior
    # rows with the same statistics, fewer than there were
    root = np.linalg.cholesky(np.block([[gram.DtD, gram.Dty[:, None]], [gram.Dty[None, :], np.array([[gram.yty]])]])).T
    for power, pip in zip(curve.values, curve.pip, strict=True):
        # exp(-t RSS / 2 sigma^2) (2 pi sigma^2)^(-t n/2): rows by the root of t, and t n of them, one for the intercept
        rows = np.sqrt(power) * root
        options = {"v_s": prior.slab_variance, "a": prior.noise_shape, "b": prior.noise_rate, "N": gram.n * power - 1.0}
        exact = reference.enumerate_models(rows[:, :-1], rows[:, -1], **options)[3]
        np.testing.assert_allclose(pip, exact, atol=1e-6)
    # discover(coarsen=t) gives the same PIPs where v_s is not learned
    prior = Prior(slab_variance=100.0)
    full, eighth = (bq.discover(record, **OSCILLATOR, dictionary=FEW, prior=prior, coarsen=t)[0] for t in (1.0, 0.125))
    np.testing.assert_allclose(full.coarsening([0.125]).pip[0], eighth.posterior.pip, atol=1e-9)


def test_half_of_every_row_is_what_half_of_the_rows_say():
    rng = np.random.default_rng(5)
    D = rng.normal(size=(60, 4))
    y = D[:, 0] + 0.3 * D[:, 1] + rng.normal(size=60)
    twice = Gram.from_data(np.vstack([D, D]), np.append(y, y)).raised(0.5)
    once = Gram.from_data(D, y)
    for name in ("n", "DtD", "Dty", "yty", "dof", "mean"):
        np.testing.assert_allclose(getattr(twice, name), getattr(once, name), rtol=1e-12, atol=1e-12)


def test_intervals_widen_by_the_root_of_the_power():
    rec = bq.simulate("linear", n=1000, seed=1)
    kwargs = {"chains": "x:v:a", "inputs": ["u"], "dictionary": ["x", "v", "u"]}
    full, quarter = (bq.discover(rec, **kwargs, coarsen=t)[0].posterior.sd for t in (1.0, 0.25))
    np.testing.assert_allclose(quarter, 2.0 * full, rtol=0.02)


def test_an_unknown_p_0_keeps_its_weight_while_its_mean_moves():
    D, y, gram = problem(3, P=8, n=40, noise=2.0)
    own = np.array([0.0, 1.0, *6 * [0.5]])  # forbidden and forced terms remain so
    found = prior_sensitivity(gram, Prior(prior_inclusion=own, inclusion_beta=(1.0, 7.0)), [], [0.5]).prior_inclusion
    np.testing.assert_array_equal(found.values, [0.125, 0.5])
    for pip, shapes in zip(found.pip, [(1.0, 7.0), (4.0, 4.0)], strict=True):
        fit = SpikeSlabBMA(prior_inclusion=own, inclusion_beta=shapes).fit(D, y)
        np.testing.assert_allclose(pip, fit.pip_, atol=1e-10)


def test_a_wide_dictionary_gives_the_same_whether_its_gram_is_lazy_or_not():
    rng = np.random.default_rng(0)
    D = rng.normal(size=(40, 520))
    y = 3 * D[:, 7] - 2 * D[:, 300] + rng.normal(size=40)
    (lazy,) = grams_of(D, y[:, None])
    assert not isinstance(lazy, Gram)
    some = (Prior(prior_inclusion=0.0005), [100.0], [0.0002])
    for found, dense in zip(
        prior_sensitivity(lazy.standardise().gram, *some),
        prior_sensitivity(Gram.from_data(D, y).standardise().gram, *some),
        strict=True,
    ):
        np.testing.assert_allclose(found.pip, dense.pip, atol=1e-8)


# --- of equations and estimators -------------------------------------------------------------------------------------


def test_the_prior_used_gives_the_pips_of_the_equation(record, equation, varied):
    of_bma = bq.discover(record, **OSCILLATOR, method="bma")[0]
    for one, found in ((equation, varied), (of_bma, of_bma.sensitivity([], []))):
        for curve in found:
            np.testing.assert_array_equal(curve.pip[curve.current], one.posterior.pip)
            assert curve.names == tuple(term.text for term in one.terms)
        v_s, p_0 = found
        assert v_s.values[v_s.current] == one.posterior.details.slab_variance
        assert p_0.values[p_0.current] == 0.1


def test_the_defaults_are_nine_values_of_v_s_and_seven_of_p_0(equation, varied):
    v_s = equation.posterior.details.slab_variance
    np.testing.assert_allclose(varied.slab_variance.values / v_s, 10.0 ** np.arange(-2.0, 2.1, 0.5), rtol=1e-12)
    np.testing.assert_array_equal(varied.prior_inclusion.values, [0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5])
    _, _, gram = problem(0, P=3)
    for own, lowest in ((1.0, 0.1), (0.01, 0.01)):  # not below 0.1, unless it is the prior's own
        assert prior_sensitivity(gram, Prior(slab_variance=own)).slab_variance.values[0] == lowest


@pytest.mark.filterwarnings("ignore::bayeq.errors.DataWarning")  # units that do not belong together
def test_units_do_not_matter(record):
    scaled = bq.Record.from_arrays(
        x=1e3 * record["x"], v=1e-2 * record["v"], a=5.0 * record["a"], u=record["u"] / 7.0, fs=1000
    )
    both = (bq.discover(r, **OSCILLATOR, dictionary=FEW)[0] for r in (record, scaled))
    for one, other in zip(*((*equation.sensitivity(), equation.coarsening()) for equation in both), strict=True):
        # the evidence is flat about the v_s that maximises it: half of the digits
        np.testing.assert_allclose(one.values, other.values, rtol=1e-4)
        np.testing.assert_allclose(one.pip, other.pip, atol=1e-4)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_only_where_there_is_a_prior_to_vary(record, tmp_path):
    rvm = bq.discover(record, **OSCILLATOR, dictionary=FEW, method="rvm")[0]
    for vary in (rvm.sensitivity, rvm.coarsening):
        with pytest.raises(InputError, match="method 'rvm' has no v_s and p_0 to vary; take one of: auto, "):
            vary()
    bq.discover(record, **OSCILLATOR, dictionary=FEW).save(tmp_path / "eq.json")
    loaded = bq.load(tmp_path / "eq.json")[0]
    for vary in (loaded.sensitivity, loaded.coarsening):
        with pytest.raises(InputError, match="run discover again"):
            vary()


def test_what_was_solved_stays_out_of_sight(equation):
    assert "RegressionFit" not in repr(equation)


def test_of_an_estimator_under_the_prior_it_was_fitted_with():
    D, y, _ = problem(4, P=6, n=60)
    both = SpikeSlabBMA(slab_variance=3.0).fit(D, np.column_stack([y, y[::-1]]))
    both.set_params(slab_variance=99.0)
    for k in (0, 1):
        curve = both.sensitivity(target=k).slab_variance
        np.testing.assert_allclose(curve.pip[curve.current], both.pip_[k], atol=1e-12)
        assert curve.values[curve.current] == 3.0
    with pytest.raises(InputError, match="2 targets"):
        both.sensitivity()


# --- values ----------------------------------------------------------------------------------------------------------


def test_the_value_used_is_always_among_them():
    _, _, gram = problem(0, P=3)

    def values(prior, *given):
        return [curve.values.tolist() for curve in prior_sensitivity(gram, prior, *given)]

    assert values(Prior(prior_inclusion=0.15), 5, (0.5, 0.05, 0.05)) == [[5.0, 10.0], [0.05, 0.15, 0.5]]
    assert values(Prior(prior_inclusion=0.3), [], [0.1 + 0.2]) == [[10.0], [0.3]]  # the same but for rounding
    assert power_sensitivity(gram, Prior(), [1.0, 0.5]).values.tolist() == [0.5, 1.0]
    assert power_sensitivity(gram, Prior(), 0.5).values.tolist() == [0.5, 1.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"slab_variances": [1.0, 0.0]}, "slab_variances must be positive numbers, got 0"),
        ({"slab_variances": [np.inf]}, "slab_variances must be positive numbers, got inf"),
        ({"slab_variances": [[1.0]]}, r"slab_variances must be a list of numbers, got an array of shape \(1, 1\)"),
        ({"prior_inclusions": [0.5, 1.0]}, "prior_inclusions must be greater than 0 and less than 1, got 1"),
        ({"prior_inclusions": [np.nan]}, "prior_inclusions must be greater than 0 and less than 1, got nan"),
        ({"powers": [0.0]}, "powers must be greater than 0 and at most 1, got 0"),
        ({"powers": [1.5]}, "powers must be greater than 0 and at most 1, got 1.5"),
        ({"powers": [np.nan]}, "powers must be"),
    ],
)
def test_values_out_of_range(equation, options, message):
    with pytest.raises(InputError, match=message):
        (equation.coarsening if "powers" in options else equation.sensitivity)(**options)


@pytest.mark.parametrize("value", [0.0, -1.0, 1.5, np.nan])
def test_powers_that_discover_refuses(value):
    with pytest.raises(InputError, match="power"):
        bq.discover(bq.simulate("linear", n=100), **OSCILLATOR, coarsen=value)


def test_nothing_to_vary_where_all_terms_are_forced_or_forbidden():
    _, _, gram = problem(0, P=2)
    for p0 in (1.0, np.array([0.0, 1.0])):
        with pytest.raises(InputError, match="every term is forced in or kept out"):
            prior_sensitivity(gram, Prior(prior_inclusion=p0))


# --- tables and text -------------------------------------------------------------------------------------------------


def test_table_and_changes_say_the_same(equation, varied):
    table = varied.table()
    assert list(table.columns) == ["slab_variance", "prior_inclusion", "term", "pip", "left_out"]
    assert len(table) == 15 * 36  # the prior used once
    assert table.term.tolist() == 15 * list(varied.slab_variance.names)
    names, v_s, p_0 = varied.slab_variance.names, varied.slab_variance, varied.prior_inclusion
    for row in table[table.term == "x**5"].itertuples():
        other = row.slab_variance != equation.posterior.details.slab_variance
        curve, value = (v_s, row.slab_variance) if other else (p_0, row.prior_inclusion)
        assert row.pip == curve.pip[list(curve.values).index(value), names.index("x**5")]
    spans = table.groupby("term").pip.agg(["min", "max"])
    changes = varied.changes().set_index("term")
    assert set(changes.index) == set(spans[(spans["min"] <= 0.5) & (spans["max"] > 0.5)].index)
    assert {"x**5", "x*abs(x)"} <= set(changes.index)
    for term, line in changes.iterrows():
        assert (line.lowest, line.highest) == tuple(spans.loc[term])
        assert line.pip == equation.posterior.pip[names.index(term)]
    assert (changes.highest - changes.lowest).is_monotonic_decreasing
    assert str(varied).splitlines().count("always: x, v, x**3, u") == 2


def test_the_table_of_the_power_of_the_likelihood():
    _, _, gram = problem(0, P=3, n=60)
    curve = power_sensitivity(gram, Prior(), [0.5])
    table = curve.table()
    assert list(table.columns) == ["coarsen", "rows", "term", "pip", "left_out"]
    assert table.rows.tolist() == 3 * [30.0] + 3 * [60.0]
    assert table.pip.tolist() == curve.pip.ravel().tolist()


def test_what_the_readme_says_of_the_demo(record):
    (equation,) = bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u")
    table = equation.sensitivity().table()
    true = table.term.isin(["x", "v", "x**3", "u"])
    assert table[true].pip.min() > 0.5
    others = table[(table.pip > 0.5) & ~true]
    assert (others.slab_variance < 0.034 * equation.posterior.details.slab_variance).all()


def made(pip, left_out, current=0):
    pip = np.array(pip)
    return PipCurve("slab_variance", ("p", "q"), 10.0 ** np.arange(len(pip)), pip, np.array(left_out), current)


def test_in_print():
    curve = made([[0.9, 0.2], [0.4, 0.8], [0.9, 0.2]], [0.0, 0.01, 0.0])
    assert curve.changes().to_dict("list") == {
        "term": ["q", "p"], "pip": [0.2, 0.9], "lowest": [0.2, 0.4], "highest": [0.8, 0.9],
    }  # fmt: skip
    assert str(curve).splitlines() == [
        "included (PIP > 0.5), slab variance v_s from 1 to 100 (used: 1)",
        "always: none",
        "p: 1, 100; PIP 0.90 as used",
        "q: 10; PIP 0.20 as used",
    ]


def test_values_whose_models_were_not_listed_do_not_count():
    one = made([[0.9, 0.2], [0.4, 0.8]], [0.0, 0.3])
    assert one.listed.tolist() == [True, False]
    assert one.changes().empty
    assert str(one).splitlines()[1:] == [
        "always: p",
        "not counted: 1 values at which too many models share the posterior mass",
    ]
    assert one.table().left_out.tolist() == [0.0, 0.0, 0.3, 0.3]
    none = made([[0.9, 0.2], [0.4, 0.8]], [0.1, 0.3])
    assert none.changes().empty
    assert "always: none" in str(none)


def test_a_prior_whose_models_cannot_be_listed_is_warned_of():
    _, _, gram = problem(0, n=25, P=40, rho=0.9, noise=3.0)
    prior = Prior(prior_inclusion=0.4)
    with pytest.warns(ConvergenceWarning, match="too many models share the posterior mass"):
        found = prior_sensitivity(gram, prior, [], [0.5])
    with pytest.warns(ConvergenceWarning, match="too many models share the posterior mass"):
        power_sensitivity(gram, prior, [])
    assert not any(curve.listed.any() for curve in found)
    assert "too many models to list" in legend(found.plot().axes[-1])


# --- the figure ------------------------------------------------------------------------------------------------------


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_the_figure_names_the_terms_and_marks_the_value_used(varied):
    figure = varied.plot()
    assert [ax.get_xlabel() for ax in figure.axes] == ["slab variance $v_s$", "prior inclusion probability $p_0$"]
    named = legend(figure.axes[-1])
    assert named[0] == "always: $x$, $v$, $x^{3}$, $u$"
    assert {"$x^{5}$", r"$x\,|x|$", r"$\mathrm{sgn}(x)$"} <= set(named)
    for ax, curve in zip(figure.axes, varied, strict=True):
        assert [t.get_text() for t in ax.texts] == [f"used: {curve.values[curve.current]:.4g}"]
        curves = [line.get_ydata() for line in ax.lines if len(line.get_xdata()) == len(curve.values)]
        noteworthy = np.concatenate([one.pip for one in varied]).max(axis=0) > 0.05
        assert len(curves) == noteworthy.sum()
        for pip in curve.pip[:, noteworthy].T:
            assert any(np.array_equal(pip, drawn) for drawn in curves)


def test_nothing_overlaps_or_is_clipped(varied, equation):
    rng = np.random.default_rng(0)
    names = tuple(f"displacement_of_floor_{k}**2" if k % 2 else f"Displ. {k} ($m)" for k in range(30))
    crowded = PriorSensitivity(
        *(
            PipCurve(axis, names, np.array(values), rng.random((3, 30)) ** 2, np.array([0.1, 0.0, 0.1]), current)
            for axis, values, current in (("slab_variance", [1, 2, 3], 0), ("prior_inclusion", [0.1, 0.11, 0.12], 2))
        )
    )
    for figure in (
        varied.plot(),
        equation.coarsening().plot(),
        draw_pip_curves({"Acc. of floor 1 [$m/s^2]": crowded, "y": crowded}),
    ):
        boxes = [ax.get_legend().get_window_extent() for ax in figure.axes if ax.get_legend()]
        for ax in figure.axes:
            box = ax.get_tightbbox()
            assert box.x0 >= 0
            assert box.y0 >= 0
            assert box.x1 <= figure.bbox.x1
            assert box.y1 <= figure.bbox.y1
            low, high = ax.get_xlim()
            ticks = [t.label1.get_window_extent() for t in ax.xaxis.get_major_ticks() if low <= t.get_loc() <= high]
            assert len(ticks) >= 2
            boxes += [
                *ticks,
                *(t.get_window_extent() for t in (*ax.texts, ax.xaxis.label, ax.yaxis.label, ax._left_title)),
            ]
        assert not any(a.overlaps(b) for a, b in combinations([box for box in boxes if box.width > 0], 2))


def test_without_matplotlib(varied, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[plot\]"):
        varied.plot()


# --- on the command line ---------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_a_table_or_a_figure_of_all_equations(tmp_path):
    path = tmp_path / "lorenz.csv"
    bq.write(bq.simulate("lorenz", n=300, seed=0), path)
    arguments = ["discover", str(path), "--chain", "x", "--chain", "y", "--dictionary", "x,y,x**2,x*y"]
    arguments += ["--smooth", "none"]
    assert main([*arguments, "--sensitivity", str(tmp_path / "pip.csv")]) == 0
    with (tmp_path / "pip.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["target", "slab_variance", "prior_inclusion", "term", "pip", "left_out"]
    direct = bq.discover(bq.read(path), chains=["x", "y"], dictionary="x,y,x**2,x*y", smooth="none")
    expected = [(e.target, *row) for e in direct for row in e.sensitivity().table().itertuples(index=False)]
    assert [(r["target"], r["term"]) for r in rows] == [(e[0], e[3]) for e in expected]
    np.testing.assert_allclose([float(r["pip"]) for r in rows], [e[4] for e in expected], atol=1e-12)
    assert main([*arguments, "--sensitivity", str(tmp_path / "pip.png")]) == 0
    assert (tmp_path / "pip.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
@pytest.mark.parametrize(("suffix", "start"), [("svg", b"<?xml"), pytest.param("PDF", b"%PDF", marks=pytest.mark.slow)])
def test_a_figure_has_the_same_bytes_every_time(suffix, start, tmp_path):
    # though SVG and PDF have room for dates and names by chance
    bq.write(bq.simulate("lorenz", n=300, seed=0), tmp_path / "lorenz.csv")
    asked = ["discover", str(tmp_path / "lorenz.csv"), "--chain", "x", "--dictionary", "x,y", "--smooth", "none"]
    written = []
    for _ in range(2):
        assert main([*asked, "--input", "y", "--sensitivity", str(tmp_path / f"pip.{suffix}")]) == 0
        written.append((tmp_path / f"pip.{suffix}").read_bytes())
    assert written[0].startswith(start)
    assert written[1] == written[0]
