"""The comparison with the peers runs, and tells what it should; times are not judged."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from perf import compare as comparison
from perf.accuracy import Accuracy, assess, evidence_over, together
from perf.optimum import count_better, random_problem, read_counts, write_counts
from perf.peers import CONTESTANTS
from perf.problems import CASES, LARGEST_CORRELATION, TRUE_TERMS, Data, Fitted, correlated
from perf.rows import Row, machine, read_rows, write_rows
from perf.table import BEGIN, END, duration, markdown_tables, put_between
from perf.worker import run_apart

import bayeq as bq
from bayeq.inference.collapsed.path import model_log_posterior
from bayeq.inference.collapsed.problem import Problem

# SBR and millipede bring runtimes of hundreds of megabytes: `perf.compare` runs them, the tests do not.
LIGHT = [name for name, contestant in CONTESTANTS.items() if not contestant.apart]


def easy_problem():
    """Independent columns of unlike units, three plain terms."""
    rng = np.random.default_rng(7)
    D = rng.standard_normal((400, 6)) * [1.0, 10.0, 0.1, 1.0, 5.0, 1.0]
    coef = np.array([2.0, 0.0, -30.0, 0.0, 0.5, 0.0])
    return Data(D, D @ coef + 0.05 * rng.standard_normal(400), coef)


@pytest.fixture(scope="module")
def rows():
    chosen = [CONTESTANTS[name] for name in ("vb", "lstsq", "lasso")]
    return comparison.measure_case(CASES["linear"], chosen, seeds=2)


def test_smallest_case(rows):
    vb, lstsq, lasso = rows
    assert [row.contestant for row in rows] == ["vb", "lstsq", "lasso"]
    for row in rows:
        assert (row.case, row.rows, row.columns, row.status) == ("linear", 2000, 36, "ok")
        assert row.problems == 2
        assert row.rounds >= 1
        assert 0 < row.seconds < 10
        assert math.isnan(row.peak_mb)
    # least squares selects all 36 terms, 3 of them true; the truth's evidence is that of the terms SS-VB selects
    assert (lstsq.exact, lstsq.false, lstsq.missed) == (0.0, 33.0, 0.0)
    assert (vb.exact, vb.false, vb.missed, vb.evidence) == (1.0, 0.0, 0.0, 0.0)
    assert vb.error < 0.01 < lstsq.error
    assert lasso.missed == 0
    assert lstsq.evidence < lasso.evidence < 0


@pytest.mark.parametrize("name", LIGHT)
def test_contestants_solve_an_easy_problem_in_its_own_units(name):
    contestant = CONTESTANTS[name]
    if not contestant.installed:
        pytest.skip(f"{contestant.package} is not installed")
    data = easy_problem()
    fitted = contestant(data.D, data.y, 0.1)
    assert fitted.support.dtype == bool
    assert fitted.support[data.true].all()
    np.testing.assert_allclose(fitted.coef[data.true], data.coef[data.true], rtol=0.05)
    small = np.abs(fitted.coef[~data.true] * data.D.std(axis=0)[~data.true])
    assert small.max() < 0.05


def test_absent_contestants_are_recorded():
    ghost = replace(CONTESTANTS["lstsq"], name="ghost", package="no_such_package_of_that_name")
    (row,) = comparison.measure_case(CASES["p36"], [ghost], seeds=1)
    assert row.status == "not installed"
    assert math.isnan(row.seconds)


def test_failures_are_recorded():
    def fail(D, y, p0):
        raise ValueError("no")

    (row,) = comparison.measure_case(CASES["p36"], [replace(CONTESTANTS["lstsq"], fit=fail)], seeds=1)
    assert row.status == "failed: ValueError: no"


def test_process_of_its_own_tells_memory():
    case = CASES["n20000"]
    outcome = run_apart(case, CONTESTANTS["lstsq"], limit=60.0, patience=0.0)
    assert outcome.status == "ok"
    assert len(outcome.seconds) == len(outcome.answers) == 1
    data_mb = case.rows * case.columns * 8 / 2**20
    # LAPACK works on a copy of D
    assert data_mb < outcome.peak_mb
    assert 0.5 * data_mb < outcome.extra_mb < 20 * data_mb


def test_failure_in_a_process_of_its_own_is_recorded():
    contestant = CONTESTANTS["millipede"]
    if contestant.installed:
        pytest.skip("millipede is installed")
    outcome = run_apart(CASES["p36"], contestant, limit=60.0, patience=0.0)
    assert outcome.status.startswith("failed: ModuleNotFoundError")
    assert outcome.answers == []


def test_time_limit_is_recorded_and_not_tried_on_a_larger_case():
    # no process starts a fit and ends it in a millisecond on 200,000 rows
    (row,) = comparison.measure_case(CASES["n200000"], [CONTESTANTS["lasso"]], limit=1e-3)
    assert row.status == "> 0.001 s"
    (larger,) = comparison.measure_case(CASES["n2000000"], [CONTESTANTS["lasso"]], limit=1e-3, earlier=[row])
    assert larger.status == "not tried, for n200000: > 0.001 s"


def test_correlations_are_as_told():
    data = correlated(20_000, 36, seed=0)
    r = np.corrcoef(data.D, rowvar=False)
    # blocks of 12: neighbours at 0.5, 0.74 and 0.98, second neighbours at the squares, other blocks at 0; 5 sd of r
    for block, expected in enumerate((0.5, 0.74, LARGEST_CORRELATION)):
        inside = r[12 * block : 12 * block + 12, 12 * block : 12 * block + 12]
        np.testing.assert_allclose(np.diagonal(inside, 1), expected, atol=5 / np.sqrt(20_000))
        np.testing.assert_allclose(np.diagonal(inside, 2), expected**2, atol=5 / np.sqrt(20_000))
    assert np.abs(r[:12, 12:]).max() < 5 / np.sqrt(20_000)
    assert data.true.sum() == TRUE_TERMS
    assert np.std(data.y - data.D @ data.coef) == pytest.approx(1.0, abs=0.03)


def test_evidence_of_few_columns_is_that_of_all():
    data = correlated(300, 40, seed=1)
    rng = np.random.default_rng(0)
    a, b = rng.random(40) < 0.2, rng.random(40) < 0.2
    prior = bq.Prior(prior_inclusion=0.03)
    problem = Problem.of(bq.Gram.from_data(data.D, data.y).standardise().gram, prior)
    expected = model_log_posterior(problem, a) - model_log_posterior(problem, b)
    assert evidence_over(data, a, b, prior) == pytest.approx(expected, abs=1e-6)
    assert evidence_over(data, a, a, prior) == 0.0


def test_accuracy_by_hand():
    D = np.array([[1.0, 2.0], [-1.0, 2.0], [1.0, -2.0], [-1.0, -2.0]])  # standard deviations 1 and 2
    data = Data(D, D @ [3.0, 0.0], np.array([3.0, 0.0]))
    answer = assess(data, Fitted(np.array([3.0, 0.75]), np.array([True, True])), 0.1)
    assert (answer.exact, answer.false, answer.missed) == (0.0, 1.0, 0.0)
    assert answer.error == pytest.approx(2 * 0.75 / 3)
    assert answer.evidence < 0
    both = together([answer, Accuracy(1.0, 0.0, 0.0, 0.0, 0.0)])
    assert (both.exact, both.false) == (0.5, 0.5)
    assert both.error == pytest.approx(0.25)


@pytest.mark.slow  # that the search misses hardly any model: test_path
def test_nobody_has_a_better_model(tmp_path):
    steps = []
    counts = count_better(8, 1, steps.append)
    assert steps == list(range(1, 13))
    assert counts[0].candidate == "truth"
    for count in counts:
        assert count.problems + count.failed == 12
        assert count.above_bma == 0
        # the optimum of the ELBO need not be that of ln p(y, z), but is near it
        assert count.most_above_vb < 3.0
    assert counts[0].same > 0
    write_counts(tmp_path / "optimum.csv", ["where"], counts)
    assert read_counts(tmp_path / "optimum.csv") == counts


def test_random_problems_are_their_seed():
    a, b, c = random_problem(3), random_problem(3), random_problem(4)
    np.testing.assert_array_equal(a.D, b.D)
    assert a.D.shape != c.D.shape or not np.array_equal(a.D, c.D)


def test_table_survives_its_file(rows, tmp_path):
    path = tmp_path / "compare.csv"
    some = [*rows, Row("p2000", 20_000, 2000, "lasso", "> 60 s")]
    write_rows(path, machine(1), some)
    remarks, back = read_rows(path)
    assert remarks == machine(1)
    for ours, theirs in zip(some, back, strict=True):
        assert (ours.case, ours.contestant, ours.status, ours.rounds) == (
            theirs.case,
            theirs.contestant,
            theirs.status,
            theirs.rounds,
        )
        np.testing.assert_allclose(
            [ours.seconds, ours.error, ours.evidence, ours.peak_mb],
            [theirs.seconds, theirs.error, theirs.evidence, theirs.peak_mb],
            rtol=1e-3,
        )


def test_markdown(rows):
    text = markdown_tables(["here"], [*rows, Row("p2000", 20_000, 2000, "lasso", "> 60 s")])
    assert "- here" in text
    assert f"| **SpikeSlabVB** | {duration(rows[0].seconds)} |" in text
    assert "| numpy.linalg.lstsq | 0/2 (33, 0) |" in text
    assert "| scikit-learn LassoCV | > 60 s |" in text


def test_markers_stay():
    page = f"a\n{BEGIN}\nold\n{END}\nb\n"
    once = put_between(page, "new")
    assert once == f"a\n{BEGIN}\n\nnew\n\n{END}\nb\n"
    assert put_between(once, "new") == once


def test_chart(rows, tmp_path):
    pytest.importorskip("matplotlib")
    from perf.chart import write_chart

    grown = [replace(row, case="p36") for row in rows] + [Row("n200000", 200_000, 36, "lasso", "> 60 s")]
    paths = write_chart([*rows, *grown], tmp_path / "performance")
    assert [path.name for path in paths] == ["performance.png", "performance.svg"]
    assert all(path.stat().st_size > 10_000 for path in paths)


def test_command(capsys):
    comparison.main(["--sizes", "p36", "--contestants", "lstsq", "--limit", "30"])
    out = capsys.readouterr()
    assert "p36        lstsq" in out.out
    assert "P=36, N=2,000" in out.err
