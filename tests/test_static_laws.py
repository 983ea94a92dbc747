"""Static laws: a target that is no derivative, found with noise in all channels, printed, saved, applied, refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.equation.brief import brief
from bayeq.errors import BayeqError, ChainError, InputError
from bayeq.expressions import parse
from bayeq.likelihood.fit import adjoints, marginal
from bayeq.likelihood.start import start_from
from bayeq.regression.design import build_design
from bayeq.states import Roles, estimate_motion, parse_chain

TERMS = "x, v, v*abs(v), sign(v), x*v"
TRUE = {"x": 6.0, "v": 2.0, "sign(v)": 9.0}


def damper(noise: float = 0.02, rows: int = 900, **true: float) -> bq.Record:
    """A damper on a test machine, noise in all channels."""
    rng, t = np.random.default_rng(7), np.arange(rows) / 100.0
    angle = 2.0 * np.pi * 0.31 * np.arange(1, 6) * t[:, None] + rng.uniform(0.0, 6.0, 5)
    x = (np.sin(angle) / np.arange(1, 6)).sum(axis=1)
    v = 2.0 * np.pi * 0.31 * np.cos(angle).sum(axis=1)
    force = sum(c * {"x": x, "v": v, "sign(v)": np.sign(v)}[name] for name, c in TRUE.items())
    columns = {"x": x, "v": v, "F": force, "G": 3.0 * x - 0.5 * v * np.abs(v)}
    noisy = {name: one + noise * one.std() * rng.standard_normal(rows) for name, one in columns.items()}
    return bq.Record.from_arrays(noisy, fs=100.0, units={"x": "m", "v": "m/s", "F": "N"})


@pytest.fixture(scope="module")
def record() -> bq.Record:
    return damper()


@pytest.fixture(scope="module")
def answer(record: bq.Record) -> bq.Equations:
    return bq.discover(record, target="F", inputs=["x", "v"], dictionary=TERMS)


def test_the_terms_of_a_static_law_are_found_with_noise_in_all_channels(answer: bq.Equations) -> None:
    law = answer[0]
    assert set(law.included) == set(TRUE)
    table = law.table().set_index("term")
    for name, value in TRUE.items():
        assert abs(table.coef[name] - value) < 3.5 * table.sd[name]
    assert answer.verdict.kind == "found"
    assert law.text.startswith("F = ")
    assert law.coef_units[1] == "N*s/m"


@pytest.mark.filterwarnings("ignore::bayeq.errors.CorrelatedResidualsWarning")
def test_noisy_inputs_do_not_shrink_coefficients_as_they_do_in_a_regression() -> None:
    noisy = damper(noise=0.1, rows=500)
    ask = {"target": "F", "inputs": ["x", "v"], "dictionary": "x, v, sign(v)"}
    by_likelihood, by_rows = (bq.discover(noisy, smooth=how, **ask, holdout=0.0)[0] for how in ("auto", "none"))
    friction = [law.table().set_index("term").loc["sign(v)"] for law in (by_likelihood, by_rows)]
    assert abs(friction[0].coef - 9.0) < 3.5 * friction[0].sd
    assert friction[1].coef < 9.0 - 3.0 * friction[1].sd


def test_texts_speak_of_no_free_run(answer: bq.Equations) -> None:
    assert "free run" not in str(answer) + brief(answer)
    assert answer.scores is not None
    assert answer.scores.free_run == {}
    assert answer.scores.one_step["F"] < 0.2


def test_a_static_law_is_saved_under_its_chain(answer: bq.Equations, tmp_path) -> None:
    answer.save(tmp_path / "law.json")
    again = bq.load(tmp_path / "law.json")
    assert answer.to_dict()["data"]["chains"] == ["=F"]
    assert str(again) == str(answer)
    assert again.states == ()


def test_a_static_law_predicts_its_target_where_it_is_not_measured(answer: bq.Equations, record: bq.Record) -> None:
    alone = bq.Record.from_arrays({"x": record["x"], "v": record["v"]}, fs=100.0)
    predicted = answer.predict(alone)
    assert predicted == pytest.approx(answer.predict(record))
    given = np.array([record["x"], record["v"]])
    assert answer.to_callable()(0.0, [], given)[0] == pytest.approx(predicted)
    assert answer.rhs(0.0, [], given[:, 5]) == pytest.approx(predicted[5:6])


@pytest.mark.parametrize("language", ["c", "julia", "matlab", "python"])
def test_a_static_law_is_exported_as_a_function_of_its_inputs(answer: bq.Equations, language: str) -> None:
    text = answer.to_code(language)
    assert "y: none, dy: F; u: x, v" in text
    assert "dy0" in text or "dy1" in text or "dy[0]" in text or "dy(1)" in text


def test_constants_inside_terms_and_several_targets() -> None:
    t = np.arange(700) / 100.0
    rng = np.random.default_rng(3)
    v = np.sin(3.1 * t) + 0.8 * np.sin(7.3 * t + 1.0) + 0.5 * np.cos(1.7 * t)
    columns = {"v": v, "F": 5.0 * np.tanh(v / 0.3) + v, "G": -2.0 * v}
    noisy = {name: one + 0.01 * one.std() * rng.standard_normal(700) for name, one in columns.items()}
    found = bq.discover(
        bq.Record.from_arrays(noisy, fs=100.0),
        target="F, G",
        inputs=["v"],
        dictionary={"F": "v, tanh(v/{v0})", "G": "v, v**3"},
        holdout=0.0,
    )
    assert [set(law.included) for law in found] == [{"v", "tanh(v/{v0})"}, {"v"}]
    assert found[0].shown_constants[0].value == pytest.approx(0.3, rel=0.1)
    assert found.predict(bq.Record.from_arrays(noisy, fs=100.0)).shape == (700, 2)


def test_a_static_law_beside_an_equation_of_motion_is_of_its_states() -> None:
    moving = bq.simulate("duffing", n=500, seed=2)
    force = 500.0 * moving["x"] + 1.5 * moving["v"]
    force += 0.02 * force.std() * np.random.default_rng(1).standard_normal(len(force))
    both = moving.with_channels({"F": force}, {"F": "N"})
    terms = {"a": "x, v, x**3, u", "F": "x, v, x**3"}
    found = bq.discover(both, chains="x:v:a", target="F", inputs=["u"], dictionary=terms, holdout=0.0)
    assert set(found["a"].included) == {"x", "v", "x**3", "u"}
    assert set(found["F"].included) == {"x", "v"}
    assert found.rhs(0.0, [0.01, 0.2], [1.0]).shape == (2,)
    assert set(found.simulate(both).mean) == {"x", "v"}
    assert found.to_callable()(0.0, np.zeros((2, 3)), np.zeros((1, 3))).shape == (2, 3)


def test_a_static_law_needs_no_time(record: bq.Record) -> None:
    timeless = bq.Record.from_arrays({name: record[name][:500] for name in ("x", "v", "F")})
    found = bq.discover(timeless, target="F", inputs=["x", "v"], dictionary=TERMS, holdout=0.0)
    assert set(found[0].included) == set(TRUE)
    assert not [text for text in found.warnings if "per sample" in text]


def test_what_the_dictionary_lacks_is_told(record: bq.Record) -> None:
    found = bq.discover(record.slice(0, 300), target="F", inputs=["x", "v"], dictionary="x, v")
    assert found.verdict.kind == "nearly true"


def test_the_likelihood_of_static_laws_has_its_derivatives(record: bq.Record) -> None:
    roles = Roles.parse(target="F", inputs=["x", "v"])
    terms = [parse(text, roles.inputs) for text in ("x", "v", "sign(v)")]
    motion = estimate_motion([record], roles)
    design = build_design(terms, motion)
    with np.errstate(all="ignore"):
        task, ((state, *_), _) = start_from(motion, terms, design.train, np.zeros((1, 4)), None)
    levels = replace(state.levels, discrepancy=0.01 * state.levels.target)
    state, linears, precision = replace(state, levels=levels), task.linearised(state), task.precision_of(state)
    found = marginal(linears, state, levels, precision)
    slopes = levels.slopes(adjoints(linears, levels, found, found.delta, found.covariance)[0])
    assert task.layout.motion == 0
    for i, slope in enumerate(slopes):
        values = []
        for way in (1.0, -1.0):
            free = levels.free
            free[i] += way * 1e-5
            values.append(marginal(linears, state, levels.moved(free), precision, keep=False).value)
        assert (values[0] - values[1]) / 2e-5 == pytest.approx(slope, rel=2e-3, abs=2e-3)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_without_chains_families_are_made_of_the_inputs(record: bq.Record) -> None:
    found = bq.discover(record.slice(0, 200), target="F", inputs=["x", "v"], dictionary="polynomial:2", smooth="none")
    assert [term.text for term in found[0].terms] == ["x", "v", "x**2", "x*v", "v**2"]


def test_the_chain_of_a_static_law() -> None:
    chain = parse_chain(" =F")
    assert (str(chain), chain.order, chain.static) == ("=F", 0, True)
    for text in ("=", "=F:G", "=~F"):
        with pytest.raises(ChainError, match="one measured target"):
            parse_chain(text)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"target": "x", "inputs": ["x"]}, "both a target and an input"),
        ({"target": "F"}, "is to follow from nothing"),
        ({"target": "F", "chains": "F", "inputs": ["x"]}, "'F' occurs in chain"),
        ({"target": "F,F", "inputs": ["x"]}, "'F' occurs in chain"),
        ({"target": "H", "inputs": ["x"], "dictionary": "x"}, "no channel named 'H'"),
        ({"target": "", "inputs": ["x"]}, "not a channel's name"),
        ({"target": "x:v", "inputs": ["x"]}, "no channel named 'x_v'"),
        ({"target": 3, "inputs": ["x"]}, "target must be text"),
        ({"target": "F", "inputs": ["x"], "dictionary": "x, F"}, "no channel named 'F'"),
    ],
)
def test_targets_that_cannot_be_are_refused_in_one_line(record: bq.Record, asked, message: str) -> None:
    with pytest.raises(BayeqError, match=message) as caught:
        bq.discover(record, **asked)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (lambda eq, rec: eq.simulate(rec), "nothing is integrated"),
        (lambda eq, rec: eq.refine(rec), "which such laws do not have"),
        (lambda eq, rec: eq.plan(), "not for static laws"),
        (lambda eq, rec: eq.physical(), "there are only F"),
    ],
)
def test_what_needs_motion_is_refused_in_one_line(answer, record, wanted, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        wanted(answer, record)
    assert "\n" not in str(caught.value)


def test_the_command_line(record: bq.Record, tmp_path, capsys) -> None:
    file, saved = tmp_path / "damper.csv", tmp_path / "law.json"
    bq.write(record.slice(0, 300), file)
    asked = ["discover", str(file), "--target", "F", "--input", "x", "--input", "v", "--dictionary", "x, v, sign(v)"]
    assert main([*asked, "--save", str(saved)]) == 0
    assert "F = " in capsys.readouterr().out
    assert main(["predict", str(saved), str(file)]) == 0
    assert "F, single step" in capsys.readouterr().out
    for runs in ("runs.csv", "runs.png"):
        assert main(["predict", str(saved), str(file), "--forecast", str(tmp_path / runs)]) == 2
        assert "static laws: nothing is integrated" in capsys.readouterr().err
    for more, message in (
        (["--refine"], "static laws (--target) do not have"),
        (["--stream"], "static laws need the record in memory"),
    ):
        assert main([*asked, *more]) != 0
        assert message in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_intervals_beside_a_constant_hold_what_likely_models_without_it_say() -> None:
    """v*abs(v) is another where v stands for tanh(v/{v0}), and the record cannot tell these apart."""
    from studies.static_laws import draw_record

    record, truth, _ = draw_record("offered", 0.05, 300002)
    asked = {"target": "F", "inputs": ["x", "v"], "dictionary": "x, v, v*abs(v), sign(v), tanh(v/{v0})"}
    eq = bq.discover(record, **asked)[0]
    shares = dict(zip(eq.posterior.names, eq.posterior.pip, strict=True))
    assert shares["v"] + shares["tanh(v/{v0})"] > 0.99
    j = list(eq.posterior.names).index("v*abs(v)")
    low, high = eq.printed_ci95[j]
    assert low < truth["v*abs(v)"] < eq.shown_ci95[j, 0] < high
