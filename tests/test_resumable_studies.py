"""Studies that go on where they were killed: the store, the judgement, and a table of each from one record a cell."""

from __future__ import annotations

import csv
import importlib
import json
from dataclasses import replace

import numpy as np
import pytest
from studies import adverse_records, circuit, coupled, known_terms, servo, states_only, white_force
from studies.judge import coefficient_lines, judged, rates
from studies.resumable import Cell, Store, code_state, run_study

import bayeq as bq
from bayeq.expressions import Evaluator, parse

# Cells that take some seconds of each study.
QUICK = {
    "states_only": "lotka-volterra 20.0 20.0",
    "known_terms": "lotka-volterra 1.0",
    "white_force": "4000",
    "coupled": "three masses, displacements auto",
    "servo": "auto",
    "circuit": "true",
    "adverse": "few rows 60",
    "tracking": "0.0 2000",
}

# Their records are drawn below.
LONGER = ("adverse", "circuit", "coupled", "servo", "white_force")


def table(text: str) -> tuple[str, list[dict[str, str]]]:
    comment, *lines = text.splitlines()
    return comment, list(csv.DictReader(lines))


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONGER)) for name in QUICK])
def test_a_command_with_one_record_writes_its_table(name, tmp_path, capsys):
    main = importlib.import_module(f"studies.{name}").main
    words = ["--records", "1", "--first-seed", "77", "--only", QUICK[name], "--store", str(tmp_path / "store.jsonl")]
    main(words)
    out = capsys.readouterr().out
    comment, lines = table(out)
    assert comment.startswith(f"# python -m studies.{name} --records 1 --first-seed 77 --only")
    assert code_state() in comment
    assert lines
    assert {line["records"] for line in lines} == {"1"}
    # a second run measures nothing and says the same
    before = (tmp_path / "store.jsonl").read_bytes()
    main([*words, "--show"])
    assert capsys.readouterr().out == out
    assert (tmp_path / "store.jsonl").read_bytes() == before


def test_a_killed_study_goes_on_where_it_was(tmp_path, capsys):
    path, seen, killed = tmp_path / "store.jsonl", [], [True]

    def measure(seed):
        if seed == 12 and killed:
            raise KeyboardInterrupt
        seen.append(seed)
        return {"value": seed}

    def run():
        arguments = ["--first-seed", "10", "--store", str(path)]
        summary = lambda outcomes: [{"sum": sum(one["value"] for one in outcomes)}]  # noqa: E731
        run_study("none", "", [Cell({"kind": "a"}, 4, measure)], summary, arguments)

    with pytest.raises(KeyboardInterrupt):
        run()
    assert seen == [10, 11]
    whole = path.read_text()
    path.write_text(whole + '{"code": "cut')
    killed.clear()
    run()
    assert seen == [10, 11, 12, 13]
    assert path.read_text().startswith(whole)
    assert table(capsys.readouterr().out)[1] == [{"kind": "a", "records": "4", "sum": "46"}]


def test_cells_on_request_take_part_only_where_they_are_named(tmp_path, capsys):
    cells = [Cell({"rows": rows}, 1, lambda seed: {}, on_request=rows > 1) for rows in (1, 22)]
    summary = lambda outcomes: [{"n": len(outcomes)}]  # noqa: E731
    for words, rows in ((), ["1"]), (("--only", "22"), ["22"]), (("--only", "7"), []):
        run_study("none", "", cells, summary, [*words, "--store", str(tmp_path / "store.jsonl")])
        assert [line["rows"] for line in table(capsys.readouterr().out)[1]] == rows


@pytest.mark.parametrize("name", adverse_records.CASES)
def test_the_adverse_truth_is_what_moves_the_simulation(name):
    case = adverse_records.CASES[name]
    record = adverse_records.draw_record(case, 500, 3)
    clean = record.truth.clean
    true = record.truth.coefficients["a"]
    total = sum(value * Evaluator({k: clean[k] for k in "xvu"})(parse(term)) for term, value in true.items())
    # what the terms do not say: a second force, a drifting stiffness, friction that is not a sign
    other = {"stiffness drifts": 0.05, "second force of 10 %": 0.3, "second force of 30 %": 0.8, "tanh friction": 0.6}
    assert np.std(clean["a"] - total) <= other.get(name, 1e-9) * np.std(clean["a"])
    assert set(true) - {"x**3", "sign(v)"} == {"x", "v", "u"}
    spoiled = {channel for channel in "xvau" if not np.array_equal(record[channel], plain(case, 3)[channel])}
    assert spoiled == SPOILED.get(name, set())


# Channels in which a case changes what was measured.
SPOILED = {
    **{f"spike in {name}": {name} for name in "xua"},
    **{key: set("xvau") for key in ("t3 noise", "1/f noise", "noise at the resonance", "hum", "8 bit", "jitter")},
    "0.5 % of samples times 10": set("xvau"),
    "clipped at 80 %": set("xva"),
    "stuck a": {"a"},
    "gain of v": {"v"},
    "delay of u": {"u"},
    "drift of x": {"x"},
}


def plain(case, seed):
    return adverse_records.draw_record(replace(case, spoil=adverse_records.Case().spoil), 500, seed)


def test_records_of_another_program_or_cell_are_not_used(tmp_path):
    path = tmp_path / "store.jsonl"
    cell, other = Cell({"noise": 0.1}, 1, dict), Cell({"noise": 0.2}, 1, dict)
    Store(path, "old").add(cell, 1, {"exact": False})
    assert Store(path, "new").get(cell, 1) is None
    Store(path, "new").add(cell, 1, {"exact": True})
    assert Store(path, "new").get(cell, 1) == {"exact": True}
    assert Store(path, "new").get(other, 1) is None
    assert Store(path, "old").get(cell, 1) == {"exact": False}
    path.write_text("not a line\n" + path.read_text())
    with pytest.raises(json.JSONDecodeError):
        Store(path, "new")


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_an_answer_is_judged_by_its_terms_its_constant_and_its_intervals():
    record = states_only.draw_record("lotka-volterra", 20.0, 0.05, 3)
    eqs = bq.discover(record, chains=["x", "y"], dictionary="polynomial:2", holdout=0.0)
    truth = record.truth.coefficients
    good = judged(eqs, truth)
    assert good["exact"]
    assert good["wrong"] == []
    assert set(good["terms"]) == {"dx x", "dx x*y", "dy y", "dy x*y"}
    table = eqs.table()
    for _, row in table[table.included & (table.term != "1")].iterrows():
        error, sd, covers = good["terms"][f"{row.target} {row.term}"]
        value = truth[row.target][row.term]
        assert error == pytest.approx(row.coef - value)
        assert sd == pytest.approx(row.sd)
        assert covers == (row.ci_low <= value <= row.ci_high)
    more = judged(eqs, {"dx": {**truth["dx"], "1": 0.5}, "dy": {"y": -0.4}})
    assert not more["exact"]
    assert more["wrong"] == ["dx: -1", "dy: +x*y"]


def test_rates_are_shares_of_the_records_and_coverage_is_that_of_right_equations():
    right = {"exact": True, "wrong": [], "cpu": 1.0, "terms": {"dx x": [0.1, 0.1, True], "dx y": [-0.3, 0.1, False]}}
    half = {"exact": False, "wrong": ["dy: +x"], "cpu": 3.0, "terms": {"dx x": [0.3, 0.2, True], "dy x": [9, 9, True]}}
    none = {"exact": False, "wrong": ["LinAlgError: no"], "cpu": None, "terms": {}}
    line = rates([right, right, half, none])
    assert (line["exact"], line["exact_percent"], line["se_percent"]) == (2, "50.0", "25.0")
    assert (line["intervals"], line["covering"], line["coverage_percent"]) == (4, 2, "50.0")
    assert (line["errors"], line["median_cpu_seconds"]) == (1, "1.00")
    lines = {line["coefficient"]: line for line in coefficient_lines([right, half, none])}
    assert set(lines) == {"all", "dx x", "dx y"}
    assert lines["all"]["exact"] == 1
    assert (lines["all"]["intervals"], lines["all"]["covering"]) == (3, 2)
    assert lines["dx x"]["bias_over_sd"] == f"{0.2 / 0.15:.2f}"
    assert lines["dx x"]["rms_error_over_sd"] == f"{np.sqrt((1 + 1.5**2) / 2):.2f}"


@pytest.mark.parametrize(
    ("draw", "channels"),
    [
        (lambda seed: states_only.draw_record("roessler", 30.0, 0.1, seed), ("x", "y", "z")),
        (lambda seed: known_terms.draw_record("hindmarsh-rose", 0.1, seed), ("x", "y", "z")),
        (lambda seed: white_force.draw_record(500, seed), ("x", "v", "a", "u")),
        (lambda seed: coupled.draw_record(coupled.MASSES, seed), ("x1", "dx1", "a1", "x2", "dx2", "a2", "x3")),
        *(
            (lambda seed, case=case: adverse_records.draw_record(case, 400, seed), ("x", "v", "a", "u"))
            for case in adverse_records.CASES.values()
        ),
    ],
)
def test_records_are_those_of_their_seed(draw, channels):
    one, again, other = draw(5), draw(5), draw(6)
    assert one.names[: len(channels)] == channels
    assert one.equals(again)
    assert not one.equals(other)


@pytest.mark.parametrize("case", coupled.CASES)
def test_coupled_truth_is_what_moves_the_simulation(case):
    system, _, terms = coupled.CASES[case]
    record = coupled.draw_record(system, 1)
    clean = record.truth.clean
    evaluate = Evaluator({name: clean[name] for name in record.names})
    for target, own in record.truth.coefficients.items():
        assert set(own) <= set(terms)
        total = sum(value * evaluate(parse(term)) for term, value in own.items())
        np.testing.assert_allclose(total, clean[target], atol=1e-9 * np.abs(clean[target]).max())


def test_the_servo_follows_its_reference_on_an_encoder():
    record = servo.draw_record(1)
    steps = record["q"] / servo.ENCODER
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert -0.01 < record["q"].min() < 0.0 + 0.01
    assert 0.19 < record["q"].max() < 0.21
    # half of the time +1 and half -1 m/s^2: the force swings by twice the mass, and friction on top
    assert 2 * servo.MASS < np.ptp(record["F"]) < 8 * servo.MASS


def test_the_circuit_moves_as_much_as_it_should_and_steadily():
    record = circuit.draw_record(3)
    assert record["u"].std() == pytest.approx(1.0)
    assert record["y"].std() == pytest.approx(circuit.SPREAD, rel=0.05)
    assert record["y"].mean() == pytest.approx(circuit.OFFSET, abs=1e-3)
    # one period of an odd multisine: what is even in it is the offset and the noise
    spectrum = np.abs(np.fft.rfft(record["y"])) / record.n
    assert spectrum[2::2].max() < 0.01 * spectrum[1::2].max()
