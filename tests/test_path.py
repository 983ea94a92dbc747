"""The parsimony path: the best model of each size is what enumeration gives, and a user's limits are kept."""

from __future__ import annotations

import csv
import math
import re
import warnings

import numpy as np
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.equation.size_path import parsimony_path
from bayeq.errors import DataWarning, InputError
from bayeq.inference.collapsed import path as by_size
from bayeq.inference.collapsed.path import best_of_each_size, model_log_posterior, partial_shares
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import neighbours
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior, half_lines
from tests import reference

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "smooth": "none"}


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", seed=1)


@pytest.fixture(scope="module")
def eq(record):
    return bq.discover(record, **OSCILLATOR)


@pytest.fixture(scope="module")
def sizes(eq):
    return eq[0].path()


def discover(records, **options):
    """Without the warnings of models that miss a term on purpose."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **options)


def awkward(seed, P=None):
    """A regression whose columns are alike, and for odd seeds mixtures of each other."""
    rng = np.random.default_rng(seed)
    D, y, _ = reference.random_problem(rng, P=P, rho=rng.uniform(0.5, 0.99))
    if seed % 2:
        D = D @ (np.eye(D.shape[1]) + rng.normal(size=(D.shape[1], D.shape[1])))
    return D - D.mean(axis=0), y


def best_by_enumeration(D, y, **prior):
    models, logs, _, _ = reference.enumerate_models(D, y, N=len(y) - 1, **prior)
    size = models.sum(axis=1)
    return [logs[size == k].max() for k in range(D.shape[1] + 1)]


# --- the best model of each size -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(12))
def test_every_size_against_all_models_written_out(seed):
    D, y = awkward(seed, P=8)
    found = best_of_each_size(Problem.of(Gram.from_data(D, y), Prior()))
    assert [int(model.sum()) for model, _ in found] == list(range(9))
    np.testing.assert_allclose([value for _, value in found], best_by_enumeration(D, y), rtol=1e-9, atol=1e-7)


def test_the_search_misses_hardly_any_of_them():
    # no theorem: over 500 such problems of ten columns, 5500 sizes, it missed none; narrower (WIDTH 6) it missed three
    missed = sizes = 0
    for seed in range(30):
        D, y = awkward(1000 + seed, P=10)
        p = Problem.of(Gram.from_data(D, y), Prior())
        exact = by_size._by_enumeration(p, range(11))
        found = by_size._by_search(p, range(11), [])
        missed += sum(
            model_log_posterior(p, a) < model_log_posterior(p, b) - 1e-6 for a, b in zip(found, exact, strict=True)
        )
        sizes += len(found)
    assert sizes == 330
    assert missed <= 1


def test_no_term_more_less_or_other_improves_on_the_path_of_a_large_dictionary(eq):
    p = Problem.of(eq[0].fit.standard.gram, eq[0].fit.prior)
    found = best_of_each_size(p, 9)
    best = dict(enumerate(value for _, value in found))
    for size, (model, value) in enumerate(found):
        assert value == pytest.approx(model_log_posterior(p, model), abs=1e-8)
        for move in neighbours(p, model):
            other = int(move.apply(model).sum())
            if other in best:
                assert best[size] + move.gain <= best[other] + 1e-6


def test_forced_and_forbidden_terms_and_an_unknown_inclusion():
    D, y = awkward(3, P=7)
    p0 = np.array([0.3, 1.0, 0.05, 0.0, 0.5, 1.0, 0.1])
    p = Problem.of(Gram.from_data(D, y), Prior(prior_inclusion=p0))
    found = best_of_each_size(p)
    assert [int(model.sum()) for model, _ in found] == [2, 3, 4, 5, 6]
    with np.errstate(divide="ignore"):
        models, logs, _, _ = reference.enumerate_models(D, y, N=len(y) - 1, p0=p0)
    for model, value in found:
        assert model[[1, 5]].all()
        assert not model[3]
        assert value == pytest.approx(logs[models.sum(axis=1) == model.sum()].max(), abs=1e-7)
    for k in (2, 4):
        searched = by_size._by_search(p, range(2, 7), [])[k - 2]
        assert model_log_posterior(p, searched) == pytest.approx(found[k - 2][1], abs=1e-7)
    with pytest.raises(InputError, match="at most 1 terms are asked for, but 2 are forced in"):
        best_of_each_size(p, 1)
    # p_0 ~ Beta(a, b) weighs sizes and not models of a size
    beta = best_of_each_size(Problem.of(Gram.from_data(D, y), Prior(inclusion_beta=(1.0, 9.0))))
    plain = best_of_each_size(Problem.of(Gram.from_data(D, y), Prior()))
    np.testing.assert_array_equal([m for m, _ in beta], [m for m, _ in plain])


def test_known_signs():
    D, y = awkward(8, P=7)
    signs = np.array([0, 1, -1, 1, 0, -1, 0])
    limits = half_lines(signs)
    p = Problem.of(Gram.from_data(D, y), Prior())
    models = np.array([[bool(code >> j & 1) for j in range(7)] for code in range(128)])
    values = np.array([model_log_posterior(p, model, limits) for model in models])
    found, plain = best_of_each_size(p, limits=limits), best_of_each_size(p)
    assert any((a != b).any() for (a, _), (b, _) in zip(found, plain, strict=True))
    for k, (model, value) in enumerate(found):
        best = models[models.sum(axis=1) == k][np.argmax(values[models.sum(axis=1) == k])]
        np.testing.assert_array_equal(model, best)
        assert value == model_log_posterior(p, best, limits)
        assert (exact_posterior(p, model, limits)[0] * signs >= 0).all()


def test_what_the_search_is_told_of_is_not_lost():
    D, y = awkward(5, P=20)
    p = Problem.of(Gram.from_data(D, y), Prior())
    given = np.random.default_rng(0).random((40, 20)) < 0.3
    found = best_of_each_size(p, 20, list(given))
    for model in given:
        assert found[int(model.sum())][1] >= model_log_posterior(p, model) - 1e-9


# --- shares of variance ----------------------------------------------------------------------------------------------


def r2(D, y):
    D1 = np.column_stack([np.ones(len(y)), D])
    residual = y - D1 @ np.linalg.lstsq(D1, y, rcond=None)[0]
    return 1.0 - residual @ residual / np.sum((y - y.mean()) ** 2)


@pytest.mark.parametrize("seed", range(5))
def test_a_share_is_what_a_refit_without_the_term_loses(seed):
    D, y = awkward(seed, P=6)
    active = np.array([True, True, False, True, False, True])
    share = partial_shares(Gram.from_data(D + 3.0, y - 2.0), active)
    assert np.isnan(share[~active]).all()
    for j in np.flatnonzero(active):
        rest = active.copy()
        rest[j] = False
        assert share[j] == pytest.approx(r2(D[:, active], y) - r2(D[:, rest], y), abs=1e-9)


def test_terms_that_depend_on_each_other_and_a_constant_target_explain_nothing():
    D, y = awkward(1, P=3)
    twice = np.column_stack([D, D[:, 0] - 2 * D[:, 1]])
    share = partial_shares(Gram.from_data(twice, y), np.ones(4, dtype=bool))
    assert (share[[0, 1, 3]] < 1e-9).all()
    assert share[2] == pytest.approx(r2(D, y) - r2(D[:, :2], y), abs=1e-9)
    assert not partial_shares(Gram.from_data(D, np.ones(len(D))), np.ones(3, dtype=bool)).any()
    assert np.isnan(partial_shares(Gram.from_data(D, y), np.zeros(3, dtype=bool))).all()


def test_shares_in_the_answer(record, eq):
    share = dict(zip([t.text for t in eq[0].terms], eq[0].share, strict=True))
    columns = {"x": record["x"], "v": record["v"], "x**3": record["x"] ** 3, "u": record["u"]}
    D, y = np.column_stack(list(columns.values()))[:3200], record["a"][:3200]
    for j, name in enumerate(columns):
        assert share[name] == pytest.approx(r2(D, y) - r2(np.delete(D, j, axis=1), y), rel=1e-6)
    # the force drives it, the damping hardly shows: why a least share is no default
    assert share["u"] > 0.2
    assert 1e-3 < share["v"] < 3e-3
    assert np.isnan(share["x**2"])
    for term in eq.to_dict()["equations"][0]["terms"]:
        assert (term["share"] is None) == (not term["included"])
    assert "| share |" in re.sub(" +", " ", str(eq))


# --- the path of an equation -----------------------------------------------------------------------------------------


def test_the_path_shows_the_equation_and_its_fit(eq, sizes):
    chosen = np.flatnonzero(sizes.is_chosen)
    assert [int(sizes.size[k]) for k in chosen] == [4]
    assert sizes.target == "a"
    assert (sizes.size == np.arange(13)).all()
    assert np.argmax(sizes.log_evidence) == 4
    k = int(chosen[0])
    assert sizes.log_evidence[k] == pytest.approx(sizes.chosen_log_evidence, abs=1e-6)
    assert sizes.r2[k] == pytest.approx(eq[0].train.r2, abs=1e-12)
    assert sizes.held_out_r2[k] == pytest.approx(eq[0].held_out.r2, abs=1e-12)
    np.testing.assert_allclose(sizes.coef[k], eq[0].posterior.coef, rtol=1e-10)
    assert sizes.intercept[k] == pytest.approx(eq[0].posterior.intercept, abs=1e-10)
    np.testing.assert_allclose(sizes.share, eq[0].share, rtol=1e-12)


def test_each_model_is_what_discover_gives_when_told_its_terms(record, eq, sizes):
    table = sizes.table()
    for k in (1, 3, 6):
        terms = [name for name, kept in zip(sizes.names, sizes.models[k], strict=True) if kept]
        told = bq.Prior(prior_inclusion=np.ones(k), slab_variance=eq[0].fit.prior.slab_variance)
        one = discover(record, **OSCILLATOR, dictionary=terms, prior=told)[0]
        assert table.nrmse[k] == pytest.approx(one.train.nrmse, rel=1e-4)
        assert table.held_out_nrmse[k] == pytest.approx(one.held_out.nrmse, rel=1e-4)


def test_evidence_is_in_units_of_the_target(record, eq, sizes):
    mm = discover(record.with_channels({"a": 1e3 * record["a"]}), **OSCILLATOR)[0].path()
    dof = eq[0].train.n - 1
    np.testing.assert_allclose(sizes.log_evidence - mm.log_evidence, dof * math.log(1e3), rtol=1e-8)


def test_the_table_says_what_each_size_changes(record, sizes):
    table = sizes.table()
    assert list(table.columns) == [
        "size", "added", "removed", "log_evidence", "r2", "nrmse", "held_out_r2", "held_out_nrmse", "chosen",
    ]  # fmt: skip
    members: set[str] = set()
    for k, row in enumerate(table.itertuples()):
        members = (members - set(filter(None, row.removed.split(", ")))) | set(filter(None, row.added.split(", ")))
        assert members == {name for name, kept in zip(sizes.names, sizes.models[k], strict=True) if kept}
    assert table.chosen.tolist() == [size == 4 for size in table["size"]]
    nothing_held_out = discover(record, **OSCILLATOR, holdout=0.0)[0].path(3)
    assert len(nothing_held_out.models) == 4
    assert nothing_held_out.table().held_out_nrmse.isna().all()
    assert [t.get_text() for t in nothing_held_out.plot().legends[0].get_texts()] == [
        "log evidence", "training rows", "the equation",
    ]  # fmt: skip
    assert "->" in str(nothing_held_out)


def test_the_elbow_in_print(sizes):
    lines = str(sizes).splitlines()
    assert len(lines) == 2 + 13 + 2
    (marked,) = [line for line in lines if line.startswith("->")]
    assert marked.split()[1:3] == ["4", "0.0"]
    assert marked.endswith("+ v")
    assert lines[-1].startswith("variance that the fit loses without a term: u 26 %")


def test_an_equation_off_its_path_is_shown_beside_it(record, eq, sizes):
    # the best two terms are x*abs(x) and u
    off = parsimony_path(eq[0].fit, np.array([name in ("x", "u") for name in sizes.names]))
    assert not off.is_chosen.any()
    assert off.chosen_log_evidence < off.log_evidence[2]
    assert off.chosen_r2 == pytest.approx(r2(np.column_stack([record["x"], record["u"]])[:3200], record["a"][:3200]))
    line = [row for row in str(off).splitlines() if row.startswith("->")]
    assert [row.split("  ")[-1] for row in line] == ["the equation: x, u"]
    rings = off.plot().axes[0].lines[-1].get_xydata()
    np.testing.assert_allclose(rings, [[2.0, off.chosen_log_evidence - off.log_evidence.max()]])


def test_a_length_that_makes_no_sense(eq):
    for most, match in ((2.5, "whole number"), ("3", "whole number"), (-1, "at least 0")):
        with pytest.raises(InputError, match=match):
            eq[0].path(most)
    assert len(eq[0].path(0).models) == 1
    assert len(eq[0].path(100).models) == 37


@pytest.mark.parametrize("smooth", ["auto", "none"])
def test_known_coefficients_leave_the_errors_what_they_are(smooth, record):
    # u is given, so the regression is of a - u; its errors are still shares of a
    options = {**OSCILLATOR, "smooth": smooth, "dictionary": "x, v, x**2, x**3, x*v, v**2, v*abs(v), u"}
    known = discover(record, **options, constraints=["u == 1"])[0]
    free = discover(record, **options)[0]
    path = known.path(4)
    assert path.names == tuple(t.text for t in known.terms if t.text != "u")
    k = int(np.flatnonzero(path.is_chosen)[0])
    assert path.size[k] == 3
    # what is reported is by projection, of a discrepancy that is next to nothing
    assert path.r2[k] == pytest.approx(known.train.r2, abs=1e-8)
    assert path.held_out_r2[k] == pytest.approx(known.held_out.r2, abs=1e-8)
    without_v = free.path(4)
    assert path.r2[k - 1] == pytest.approx(without_v.r2[3], abs=1e-3)
    judged = free.scored or free
    assert path.share[path.chosen] == pytest.approx(judged.share[judged.posterior.support][:3], rel=0.02)
    assert known.path(1).chosen_r2 == pytest.approx(known.train.r2, abs=1e-8)


def test_a_loaded_equation_has_no_path(tmp_path, eq):
    eq.save(tmp_path / "eq.json")
    with pytest.raises(InputError, match="run discover again"):
        bq.load(tmp_path / "eq.json")[0].path()


def test_the_figure(sizes):
    figure = sizes.plot()
    left, right = figure.axes
    evidence = left.lines[0].get_xydata()
    np.testing.assert_array_equal(evidence[:, 0], sizes.size)
    np.testing.assert_allclose(evidence[:, 1], sizes.log_evidence - sizes.log_evidence.max())
    np.testing.assert_allclose(right.lines[0].get_ydata(), np.sqrt(1 - sizes.r2))
    np.testing.assert_allclose(right.lines[1].get_ydata(), np.sqrt(1 - sizes.held_out_r2))
    for ax in (left, right):
        rings = ax.lines[-1].get_xydata()
        assert (rings[:, 0] == 4).all()
        changes = ax.get_xticklabels(minor=True)
        assert changes[4].get_text() == "+$v$"
    # what is written below a panel ends above the name of its axis
    figure.draw_without_rendering()
    for ax in (left, right):
        label = ax.xaxis.label.get_window_extent()
        changes = ax.get_xticklabels(minor=True)
        assert all(t.get_window_extent().y0 > label.y1 for t in changes if t.get_text())
        assert label.y0 > 0


# --- units -----------------------------------------------------------------------------------------------------------


def test_units_reach_the_coefficients(tmp_path, record, eq):
    assert eq[0].units == {"x": "m", "v": "m/s", "a": "m/s^2", "u": "N"}
    units = dict(zip([t.text for t in eq[0].terms], eq[0].coef_units, strict=True))
    assert units["x"] == "1/s^2"
    assert units["v"] == "1/s"
    assert units["x**3"] == "1/m^2/s^2"
    assert units["u"] == "m/s^2/N"
    assert units["v*abs(v)"] == "1/m"
    mm = bq.Record(
        {"x": 1e3 * record["x"], **{c: record[c] for c in "vau"}}, record.time, units={"x": "mm", "a": "m/s2"}
    )
    found = discover(mm, **OSCILLATOR, dictionary=["x", "v", "x**3", "u"])
    assert found[0].coef_units == ("m/s^2/mm", None, "m/s^2/mm^3", None)
    assert found[0].coef["x"] == pytest.approx(1e-3 * eq[0].coef["x"], rel=1e-2)
    found.save(tmp_path / "mm.json")
    assert bq.load(tmp_path / "mm.json").to_dict() == found.to_dict()
    assert [t["unit"] for t in found.to_dict()["equations"][0]["terms"]] == ["m/s^2/mm", None, "m/s^2/mm^3", None]
    estimated = discover(mm.renamed("a"), chains="x:v:", inputs=["u"], dictionary=["x", "u"], smooth="none")
    assert estimated[0].units == {"x": "mm", "ddx": "mm/s^2"}


def test_records_in_different_units_are_told_of(record):
    other = bq.simulate("duffing", seed=2)
    mixed = bq.Record(other.channels, other.time, units={"x": "kg"})
    with pytest.warns(DataWarning, match="x is in kg and in m, depending on the record"):
        found = bq.discover([record, mixed], **OSCILLATOR, dictionary=["x", "v", "x**3", "u"])
    assert "x" not in found[0].units


# --- the command line ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def duffing(tmp_path_factory, record):
    file = tmp_path_factory.mktemp("path") / "duffing.csv"
    bq.write(record, file)
    return [str(file), "--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--smooth", "none"]


def test_the_path_in_a_file(duffing, tmp_path, capsys):
    table = tmp_path / "path.csv"
    assert main(["discover", *duffing, "--path", str(table)]) == 0
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["size"]) for row in rows] == list(range(13))
    assert {row["target"] for row in rows} == {"a"}
    assert [row["chosen"] for row in rows].index("True") == 4
    figure = tmp_path / "path.png"
    assert main(["discover", *duffing, "--path", str(figure)]) == 0
    assert figure.read_bytes().startswith(b"\x89PNG")
    capsys.readouterr()
    for wrong, message in (("path.txt", "is to be written as a table or a figure"), ("no/p.csv", "no directory")):
        assert main(["discover", *duffing, "--path", str(tmp_path / wrong)]) == 2
        assert message in capsys.readouterr().err
    assert main(["discover", *duffing, "--path", str(table), "--save", str(table)]) == 2
    assert "named twice" in capsys.readouterr().err
