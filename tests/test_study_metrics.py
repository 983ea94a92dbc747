"""The metrics of section 4.1 against slow twins on matrices, and the paper's tables."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from bayeq.errors import InputError
from bayeq.inference.gram import Gram
from bayeq.study.runner import METRICS, Metrics, Result, measure, prediction_error
from bayeq.study.table import LABELS, RUNTIMES, TABLE_2, aggregate, failure_messages, runtimes
from tests.data import ROOT


def twin(D, D_test, y_test, truth, support, coef):
    """Section 4.1 on matrices, word by word."""
    S = np.diag(D.std(axis=0))
    selected = {j for j in range(len(coef)) if support[j]}
    true = {j for j in range(len(coef)) if truth[j] != 0}
    return Metrics(
        e_theta_scaled=np.linalg.norm(S @ (coef - truth)) / np.linalg.norm(S @ truth),
        e_theta=np.linalg.norm(coef - truth) / np.linalg.norm(truth),
        e_p=np.linalg.norm(y_test - D_test @ coef) / np.linalg.norm(y_test),
        fdr=len(selected - true) / len(selected) if selected else 0.0,
        exact=selected == true,
        superset=selected >= true,
    )


def problem(seed):
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(60, 5)) * 10.0 ** rng.integers(-3, 4, size=5) + rng.normal(size=5)
    truth = np.where(rng.random(5) < 0.5, rng.normal(size=5), 0.0)
    truth[0] = 1.0
    y = 0.7 + D @ truth + 0.1 * rng.normal(size=60)
    support = rng.random(5) < 0.6
    coef = np.where(support, truth + 0.1 * rng.normal(size=5), 0.0)
    return D, y, truth, support, coef


@pytest.mark.parametrize("seed", range(20))
def test_metrics_equal_their_twins_on_matrices(seed):
    D, y, truth, support, coef = problem(seed)
    fast = measure(Gram.from_data(D[:40], y[:40]), Gram.from_data(D[40:], y[40:]), truth, support, coef)
    slow = twin(D[:40], D[40:], y[40:], truth, support, coef)
    for name in METRICS:
        assert getattr(fast, name) == pytest.approx(getattr(slow, name), rel=1e-10), name


def test_the_prediction_error_has_no_intercept():
    # y = 3 exactly, one column without mean: nothing is explained, although an intercept would explain it all
    D = np.array([[1.0], [-1.0], [1.0], [-1.0]])
    assert prediction_error(Gram.from_data(D, np.full(4, 3.0)), np.zeros(1)) == 1.0


def test_an_empty_model_has_no_false_discoveries():
    D, y, truth, *_ = problem(0)
    gram = Gram.from_data(D, y)
    empty = measure(gram, gram, truth, np.zeros(5, dtype=bool), np.zeros(5))
    assert (empty.fdr, empty.exact, empty.superset, empty.e_theta, empty.e_theta_scaled) == (0, False, False, 1, 1)


def test_a_dictionary_without_true_terms_is_refused():
    D, y, *_ = problem(0)
    gram = Gram.from_data(D, y)
    with pytest.raises(InputError, match="no true term"):
        measure(gram, gram, np.zeros(5), np.zeros(5, dtype=bool), np.zeros(5))


def results(n=8, system="linear", algorithm="vb"):
    rng = np.random.default_rng(3)
    return [
        Result(
            system,
            k,
            algorithm,
            Metrics(*rng.random(4).tolist(), exact=bool(k % 2), superset=k != 3),
            seconds=0.1 + k,
            converged=k != 5,
        )
        for k in range(n)
    ]


def test_aggregates_are_means_with_monte_carlo_errors():
    rows = results()
    (row,) = aggregate([*rows, Result("linear", 8, "vb", failure="ValueError: no")], {("linear", "vb"): 12})
    assert (row["n"], row["failures"], row["unconverged"], row["missing"]) == (8, 1, 1, 3)
    e = [r.metrics.e_theta for r in rows]
    assert row["e_theta"] == pytest.approx(sum(e) / 8)
    assert row["e_theta_median"] == np.median(e)
    sd = math.sqrt(sum((v - sum(e) / 8) ** 2 for v in e) / 7)
    assert row["se"]["e_theta"] == pytest.approx(sd / math.sqrt(8))
    assert row["superset"] == 7 / 8
    assert row["se"]["superset"] == pytest.approx(math.sqrt(7 / 8 * 1 / 8 / 8))
    assert row["seconds"] == pytest.approx(3.6)
    assert set(row["se"]) == set(METRICS)


def test_rows_stand_in_the_order_of_the_paper():
    cells = [(s, a) for s in ("coulomb", "duffing", "linear") for a in ("gibbs", "rvm", "sindy", "vb", "vb-rvm")]
    rows = aggregate(r for s, a in cells for r in results(2, s, a))
    assert [row["system"] for row in rows[::5]] == ["linear", "duffing", "coulomb"]
    assert [row["algorithm"] for row in rows[:5]] == ["sindy", "rvm", "gibbs", "vb", "vb-rvm"]
    assert rows[3]["paper"]["exact"] == 0.991
    assert rows[4]["paper"] is None


def test_one_result_has_no_standard_error_and_none_no_mean():
    (row,) = aggregate(results(1))
    assert set(row["se"].values()) == {None}
    (row,) = aggregate([], {("linear", "rvm"): 4})
    assert (row["n"], row["exact"], row["missing"]) == (0, None, 4)


def test_failures_are_counted_by_message():
    failed = [Result("duffing", k, "vb", failure="ValueError: odd" if k % 2 else "KeyError: even") for k in range(5)]
    assert [(f["message"], f["count"], f["first_index"]) for f in failure_messages(failed)] == [
        ("KeyError: even", 3, 0),
        ("ValueError: odd", 2, 1),
    ]


def test_run_times_are_of_a_single_chain():
    rows = [{"algorithm": a, "n": 10, "seconds": s} for a, s in (("rvm", 0.5), ("gibbs", 8.0), ("vb", 1.0))]
    table = {row["algorithm"]: row for row in runtimes([*rows, *rows], chains=4)}
    assert table["gibbs"]["seconds"] == 2.0
    assert table["gibbs"]["seconds_all_chains"] == 8.0
    assert (table["gibbs"]["ratio_rvm"], table["gibbs"]["ratio_vb"], table["vb"]["n"]) == (4.0, 2.0, 20)
    assert table["vb"]["paper"]["ratio_rvm"] == pytest.approx(11.0)


def test_the_printed_tables_by_spot_checks():
    rows = {key: aggregate([], {key: 1})[0]["paper"] for key in TABLE_2}
    assert rows["coulomb", "vb"]["exact"] == 0.762
    assert rows["quadratic", "gibbs"]["superset"] == 0.865
    assert rows["duffing", "sindy"]["e_theta"] == 609.134
    assert rows["linear", "sindy"]["approximate"] == ["e_theta"]
    assert rows["duffing", "sindy"]["approximate"] == []
    assert (len(TABLE_2), RUNTIMES["gibbs"]) == (16, 34.23)


@pytest.mark.data
def test_the_printed_tables_are_those_of_the_paper():
    paper = ROOT.parent / "paper" / "nayek-worden-cross-spike-slab-vb.txt"
    if not paper.is_file():
        pytest.skip("the paper's text is not there")
    text = paper.read_text()
    rows = re.findall(r"^(?:(\w+)[\w ]*)?\t(SINDy|RVM|SS-MCMC|SS-VB)\t([\d$].+)$", text, flags=re.MULTILINE)
    assert len(rows) == 16
    names = {label: name for name, label in LABELS.items()}
    system = ""
    for head, label, values in rows:
        system = head.lower() or system
        about = re.sub(r"\$\\approx (\d) \\times 10\^(\d)\$", r"\1e\2", values)
        key = (system, names[label])
        assert tuple(float(v) for v in about.split("\t")) == TABLE_2[key]
        assert bool(aggregate([], {key: 1})[0]["paper"]["approximate"]) == ("approx" in values)
