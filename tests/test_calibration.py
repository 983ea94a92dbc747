from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from studies import calibration, reliability
from studies.calibration import calibrate_one, main, tables
from studies.overridden import overridden
from studies.reliability import Curve, draw_reliability, study_problem, table
from studies.tally import (
    BINS,
    DRAWS,
    QUANTITIES,
    TAIL,
    Tally,
    bin_p,
    correlation_time,
    holm,
    joined,
    rank,
    uniform_p,
)

from bayeq.figures.style import style
from bayeq.inference.posterior import Draws
from bayeq.numerics.settings import INFERENCE
from bayeq.study.config import STUDY_SYSTEMS, StudyConfig
from bayeq.study.runner import draw


def toy_ranks(spread, problems=4000):
    """Ranks of mu ~ N(0, 1), seen as y ~ N(mu, 1), among draws from N(y/2, spread/2): right with spread 1."""
    rng = np.random.default_rng(3)
    counts = np.zeros(DRAWS + 1, dtype=np.int64)
    for _ in range(problems):
        mu = rng.normal()
        y = mu + rng.normal()
        counts[rank(0.5 * y + np.sqrt(0.5 * spread) * rng.normal(size=DRAWS), mu, rng)] += 1
    return counts


def bins(true, stated=None, variance=None, terms=1000):
    """A tally of one problem with the same numbers in all bins."""
    stated = 500.0 if stated is None else stated
    return Tally(
        problems=1,
        sampled=0,
        terms=np.full(BINS, terms),
        stated=np.full(BINS, stated),
        true=np.full(BINS, true),
        variance=np.full(BINS, 250.0 if variance is None else variance),
        squared=np.full(BINS, (true - stated) ** 2),
        ranks=np.full((len(QUANTITIES), DRAWS + 1), 5),
        enclosed=1,
        included=10,
        covered=9,
        most_left_out=0.01,
        slowest=3.0,
        rhat=1.01,
    )


def test_ranks_of_a_right_posterior_are_uniform_and_those_of_a_wrong_one_are_not():
    assert uniform_p(toy_ranks(1.0)) > 1e-3
    assert uniform_p(toy_ranks(2.0)) < 1e-6
    assert uniform_p(toy_ranks(0.5)) < 1e-6


def test_the_interval_of_the_fifth_draws_covers_95_per_cent():
    counts = toy_ranks(1.0)
    inner = counts[TAIL : DRAWS + 1 - TAIL].sum()
    assert (DRAWS + 1 - 2 * TAIL) / (DRAWS + 1) == 0.95
    assert stats.binomtest(int(inner), int(counts.sum()), 0.95).pvalue > 1e-3


def test_ranks_with_ties_are_uniform_among_them():
    rng = np.random.default_rng(0)
    draws = np.array([-1.0, 0.0, 0.0, 0.0, 2.0])
    found = np.bincount([rank(draws, 0.0, rng) for _ in range(4000)], minlength=6)
    assert found[[0, 5]].sum() == 0
    assert stats.chisquare(found[1:5]).pvalue > 1e-3
    assert rank(draws, 1.0, rng) == 4


def test_a_bin_by_hand():
    # 30 more than stated, with a variance of 250: z = 1.897
    assert bin_p(bins(530)) == pytest.approx([2.0 * stats.norm.sf(30.0 / np.sqrt(250.0))] * BINS)
    # too few undecided terms for a test
    assert bin_p(bins(500, variance=20.0)) == [None] * BINS


def test_holm_by_hand():
    # 0.01*4, 0.03*3, then max(0.04*2, 0.09), then max(0.05, 0.09)
    assert holm([0.04, 0.01, 0.05, 0.03]) == pytest.approx([0.09, 0.04, 0.09, 0.09])
    assert holm([0.9, 0.8]) == pytest.approx([1.0, 1.0])


def test_correlation_time_of_an_autoregression():
    rng = np.random.default_rng(1)
    chains = rng.normal(size=(4, 20_000))
    assert correlation_time(chains) == pytest.approx(1.0, abs=0.1)
    for t in range(1, chains.shape[1]):
        chains[:, t] += 0.8 * chains[:, t - 1]
    # (1 + 0.8)/(1 - 0.8)
    assert correlation_time(chains) == pytest.approx(9.0, rel=0.1)
    assert correlation_time(np.ones((2, 10))) == 1.0


def test_chains_take_over_where_too_much_is_left_out():
    averaged = joined([calibrate_one("correlated", 20, (8, k)) for k in range(5)])
    with overridden(INFERENCE, most_left_out=-1.0):
        sampled = joined([calibrate_one("correlated", 20, (8, k)) for k in range(5)])
    assert (averaged.sampled, sampled.sampled) == (0, 5)
    assert sampled.rhat > 0.99
    assert sampled.slowest >= 1.0
    # the same problems: the PIPs of chains are those of averaging, up to Monte Carlo error
    assert sampled.stated.sum() == pytest.approx(averaged.stated.sum(), abs=0.1)
    assert sampled.true.sum() == averaged.true.sum()


def test_draws_of_chains_are_taken_far_apart():
    theta = np.arange(4 * 4000, dtype=np.float64).reshape(4, 4000, 1)
    chains = Draws(theta != 0, theta, theta[:, :, 0], theta[:, :, 0], np.ones((4, 1)))
    chosen, noise = calibration._spread_out(chains)
    assert len(chosen) == len(noise) == DRAWS
    assert np.all(np.diff(chosen[:, 0]) == 80)
    assert np.array_equal(chosen[:, 0], noise)


def test_the_oscillator_s_own_dictionary():
    tally = calibrate_one("oscillator", 200, (1, 2, 3))
    assert tally.terms.sum() == 36
    assert tally.most_left_out <= 0.02


def test_the_tables_and_their_verdict():
    first, second = tables({("correlated", 20): bins(500), ("correlated", 50): bins(500)})
    assert [(line["design"], line["rows"]) for line in first] == [
        ("correlated", "20"),
        ("correlated", "50"),
        ("correlated", "all"),
        ("all", "all"),
    ]
    assert len(second) == 4 * BINS
    assert first[-1]["tests"] == 3 * (BINS + len(QUANTITIES))
    assert first[-1]["verdict"] == "not rejected at 1 %"
    assert first[-1]["ci95_of_included"] == "0.9000"
    # the other cell is 90/sqrt(250) = 5.7 standard deviations off, and both together 90/sqrt(500) = 4
    first, second = tables({("correlated", 20): bins(500), ("correlated", 50): bins(590)})
    assert first[-1]["verdict"] == "rejected at 1 %"
    assert [float(str(line["p_least_adjusted"])) < 0.01 for line in first] == [False, True, True, True]
    assert (second[10]["stated"], second[10]["true"], second[10]["se_robust"]) == ("0.50000", "0.59000", "0.09000")


def test_bins_of_everything_are_those_of_all_tallies_together():
    rng = np.random.default_rng(2)
    tallies = {}
    for cell in [("correlated", 20), ("correlated", 50), ("oscillator", 20)]:
        terms = rng.integers(0, 400, BINS)
        terms[0], terms[3] = 40_000, 0
        one = bins(0, terms=1)
        tallies[cell] = replace(
            one,
            terms=terms,
            stated=terms * rng.uniform(size=BINS),
            true=rng.binomial(terms, 0.4),
            variance=terms * rng.uniform(size=BINS),
            squared=terms * rng.uniform(size=BINS),
        )
    lines = tables(tallies)[1]
    found = lines[-BINS:]
    assert {(line["design"], line["rows"]) for line in found} == {("all", "all")}
    expected = [{"design": "all", "rows": "all", **line} for line in calibration._bins(joined(list(tallies.values())))]
    for line, whole in zip(found, expected, strict=True):
        assert "p" not in line
        assert line["terms"] == whole["terms"]
        assert line.keys() == whole.keys() - {"p"}
        # of numbers printed with five places
        for key in line.keys() & {"stated", "true", "se", "se_robust"}:
            assert float(line[key]) == pytest.approx(float(whole[key]), abs=2e-5)
    # and the same from the table in its file
    written = [{key: str(value) for key, value in line.items()} for line in lines[:-BINS]]
    assert calibration.pooled(written) == found


def test_the_committed_table_has_ten_bins_of_five_hundred_terms():
    path = Path(__file__).parents[1] / "docs/tables/calibration_bins.csv"
    lines = list(csv.DictReader(path.read_text().splitlines()[1:]))  # after the command that made it
    whole = [line for line in lines if line["design"] == "all"]
    derived = [{key: str(value) for key, value in line.items()} for line in calibration.pooled(lines[:-BINS])]
    assert [{key: value for key, value in line.items() if value} for line in whole] == derived
    assert min(int(line["terms"]) for line in whole) >= 500
    for line in whole:
        assert abs(float(line["stated"]) - float(line["true"])) < 4.0 * float(line["se_robust"])


@pytest.mark.slow  # tables of any number of jobs: test_ablation
def test_the_study_is_reproducible_whatever_the_number_of_jobs(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(calibration, "PROBLEMS", {("correlated", 50): 4})
    monkeypatch.setattr(calibration, "BATCH", 2)
    for jobs in ("1", "2"):
        main(["--problems", "3", "--jobs", jobs, "--folder", str(tmp_path / jobs)])
        assert "tests, least adjusted p" in capsys.readouterr().out
    for name in ("calibration.csv", "calibration_bins.csv"):
        text = (tmp_path / "1" / name).read_text()
        assert text == (tmp_path / "2" / name).read_text()
    rows = list(csv.DictReader((tmp_path / "1" / "calibration.csv").read_text().splitlines()))
    assert [(row["rows"], row["problems"]) for row in rows] == [("50", "3"), ("all", "3"), ("all", "3")]


def test_raw_states_are_the_study_s_realisations():
    gram, true = study_problem("coulomb", "raw", 0, 3)
    known = draw(StudyConfig(seed=0), "coulomb", 3)
    assert gram.names == known.train.names
    np.testing.assert_array_equal(gram.DtD, known.train.DtD)
    np.testing.assert_array_equal(gram.Dty, known.train.Dty)
    np.testing.assert_array_equal(true, known.truth != 0)


def test_clean_states_leave_the_noise_of_the_acceleration():
    gram, true = study_problem("duffing", "clean", 0, 3)
    kept = np.flatnonzero(true)
    coef = np.linalg.solve(gram.DtD[np.ix_(kept, kept)], gram.Dty[kept])
    rest = gram.squared_error(np.bincount(kept, coef, minlength=36)) / gram.yty
    # 5 % noise: a share 0.05^2/(1 + 0.05^2) of the variance
    assert rest == pytest.approx(0.0025, rel=0.1)


def test_a_reliability_curve_by_hand():
    first = Curve.of(np.array([0.05, 0.32, 0.38, 1.0]), np.array([False, True, True, True]))
    both = first + Curve.of(np.array([0.04, 0.36, 0.99]), np.array([True, False, True]))
    assert both.terms.tolist() == [2, 0, 0, 3, 0, 0, 0, 0, 0, 2]
    assert both.true.tolist() == [1, 0, 0, 2, 0, 0, 0, 0, 0, 2]
    assert both.stated[[0, 3, 9]] == pytest.approx([0.09, 1.06, 1.99])
    # (2 - 0.70)^2 of the first realisation, (0 - 0.36)^2 of the second
    assert both.squared[3] == pytest.approx(1.3**2 + 0.36**2)


def test_the_reliability_of_a_few_realisations(tmp_path, capsys):
    reliability.main(["--realisations", "2", "--jobs", "1", "--figures", str(tmp_path)])
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert {row["system"] for row in rows} == {*STUDY_SYSTEMS, "all"}
    for states in ("raw", "clean"):
        for method in ("bma", "vb"):
            mine = [r for r in rows if (r["states"], r["method"]) == (states, method)]
            count = {s: sum(int(r["terms"]) for r in mine if r["system"] == s) for s in (*STUDY_SYSTEMS, "all")}
            assert count == dict.fromkeys(STUDY_SYSTEMS, 72) | {"all": 288}
    assert {path.name for path in tmp_path.iterdir()} == {"reliability.png", "reliability.svg"}


def test_bins_that_are_nearly_empty_are_not_drawn():
    curve = Curve.of(np.repeat([0.02, 0.55, 0.97], [20, 3, 12]), np.repeat([False, True], [23, 12]))
    curves = {
        (states, system, method): curve
        for states in ("raw", "clean")
        for system in STUDY_SYSTEMS
        for method in ("bma", "vb")
    }
    with style():
        figure = draw_reliability(curves)
    assert len(figure.axes) == 8
    points = figure.axes[0].containers[0].lines[0].get_xdata()
    assert points == pytest.approx([0.02, 0.97])
    assert table(curves | {(s, "all", m): curve for s in ("raw", "clean") for m in ("bma", "vb")})[1]["terms"] == 3
