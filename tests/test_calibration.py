from __future__ import annotations

import csv

import numpy as np
from scipy import stats

from bayeq.study.calibration import DESIGNS, ROWS, Outcome, calibrate_one, main, summary


def test_probabilities_are_right_on_problems_drawn_from_the_prior():
    """A small run of the study: simulation-based calibration and the reliability of the PIPs, one test at 0.1 %."""
    outcomes = [calibrate_one("correlated", 20, (5, 0, k)) for k in range(300)]
    pip = np.concatenate([o.pip for o in outcomes])
    true = np.concatenate([o.true for o in outcomes])
    # the number of true terms against its expectation and spread if the stated probabilities are right
    z = (true.sum() - pip.sum()) / np.sqrt(np.sum(pip * (1 - pip)))
    undecided = (pip > 0.05) & (pip < 0.95)
    z_undecided = (true - pip)[undecided].sum() / np.sqrt(np.sum((pip * (1 - pip))[undecided]))
    ranks = [
        stats.kstest((np.array([getattr(o, name) for o in outcomes]) + 0.5) / 100, "uniform").pvalue
        for name in ("theta_rank", "noise_rank")
    ]
    assert abs(z) < 3.6
    assert abs(z_undecided) < 3.6
    assert min(ranks) > 0.00025
    assert 0.90 < np.mean([o.covered for o in outcomes]) < 0.99


def test_a_wrong_posterior_would_be_seen():
    # the same reading of outcomes whose PIPs are pushed towards 0 and 1, as a variational w is
    outcomes = [calibrate_one("correlated", 20, (5, 0, k)) for k in range(300)]
    pip = np.concatenate([o.pip for o in outcomes])
    true = np.concatenate([o.true for o in outcomes])
    pushed = np.clip(np.round(pip), 0.02, 0.98)
    assert np.mean((true - pushed) ** 2) > np.mean((true - pip) ** 2)


def test_the_oscillator_s_own_dictionary():
    outcome = calibrate_one(DESIGNS[1], ROWS[2], (1, 2, 3))
    assert isinstance(outcome, Outcome)
    assert outcome.pip.shape == (36,)
    line = summary(DESIGNS[1], ROWS[2], [outcome] * 3)
    assert sum(int(line[f"bin{k}_n"]) for k in range(10)) == 108


def test_the_table_is_reproducible(capsys, monkeypatch):
    monkeypatch.setattr("bayeq.study.calibration.ROWS", (50,))
    monkeypatch.setattr("bayeq.study.calibration.DESIGNS", ("correlated",))
    tables = []
    for jobs in ("1", "1"):
        main(["--problems", "4", "--jobs", jobs])
        tables.append(capsys.readouterr().out)
    assert tables[0] == tables[1]
    assert [row["rows"] for row in csv.DictReader(tables[0].splitlines())] == ["50", "0"]
