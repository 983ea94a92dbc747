"""Every system in the table: its law equals the sum of its true terms, and its records are what they say."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayeq.expressions import Evaluator, parse
from bayeq.systems import SYSTEMS, System, get_system, simulate
from tests.draws import draws

pytestmark = pytest.mark.parametrize("system", SYSTEMS.load().values(), ids=list(SYSTEMS))


def test_the_table_is_keyed_by_name(system: System) -> None:
    assert get_system(system.name) is system
    assert system.name.isidentifier()
    assert system.title
    assert system.citation


def test_names_fit_together(system: System) -> None:
    assert set(system.terms) == set(system.targets)
    assert set(system.targets.values()) <= set(system.states)
    assert set(system.initial) == set(system.states)
    assert set(system.states) | set(system.inputs) <= set(system.channels)
    assert len(set(system.channels)) == len(system.channels)
    assert set(system.fixed) <= set(system.parameters)
    assert set(system.units) <= set(system.channels)
    assert not set(system.parameters) & set(system.channels)
    # In a chain each name but the first is the derivative of the one before.
    for chain in system.chains:
        names = chain.split(":")
        for lower, higher in itertools.pairwise(names[:-1]):
            assert system.rhs[lower] == higher


def test_terms_are_canonical_and_known(system: System) -> None:
    for terms in system.terms.values():
        for term, coefficient in terms.items():
            assert parse(term, [*system.states, *system.inputs, *system.targets]).text == term
            assert parse(coefficient, system.parameters).text == coefficient
    for text in system.rhs.values():
        assert parse(text, [*system.states, *system.inputs, *system.parameters]).text == text


@settings(max_examples=draws(50), deadline=None)
@given(data=st.data())
def test_the_law_is_the_sum_of_the_true_terms(system: System, data: st.DataObject) -> None:
    number = st.floats(-3, 3)
    factor = st.one_of(st.just(1.0), st.floats(0.5, 1.5))
    point = {name: data.draw(number) for name in (*system.states, *system.inputs)}
    parameters = {name: value * data.draw(factor) for name, value in system.parameters.items()}
    right = Evaluator({**point, **parameters})
    laws = {target: right(parse(system.rhs[state])) for target, state in system.targets.items()}
    evaluate = Evaluator({**point, **laws, **parameters})  # terms may hold targets of other equations
    for target, law in laws.items():
        parts = [
            float(evaluate(parse(term))) * float(evaluate(parse(coefficient)))
            for term, coefficient in system.terms[target].items()
        ]
        assert float(law) == pytest.approx(sum(parts), rel=1e-12, abs=1e-12 * sum(map(abs, parts)) + 1e-300)


@pytest.mark.parametrize("perturb", [0.0, 0.1])
def test_a_record_is_finite_deterministic_and_complete(system: System, perturb: float) -> None:
    record = simulate(system, seed=3, perturb=perturb)
    again = simulate(system.name, seed=3, perturb=perturb)
    other = simulate(system, seed=4, perturb=perturb)
    truth = record.truth
    assert truth is not None
    assert tuple(record.channels) == system.channels
    assert record.name == truth.system == system.name
    assert set(truth.parameters) == set(system.parameters)
    assert set(truth.noise_sd) == set(system.channels)
    assert set(truth.clean) == {*system.channels, *system.targets}
    assert record.time is not None
    np.testing.assert_array_equal(record.time, np.arange(system.n) / system.fs)
    for name, samples in record.channels.items():
        assert samples.shape == (system.n,)
        assert np.all(np.isfinite(samples))
        assert samples.tobytes() == again.channels[name].tobytes()
        assert samples.tobytes() != other.channels[name].tobytes()
        noise = samples - truth.clean[name]
        assert np.std(noise) == pytest.approx(truth.noise_sd[name], rel=0.15)
    # The coefficients are those of the parameters used, and explain the clean targets exactly.
    evaluate = Evaluator(truth.clean)
    for target, terms in truth.coefficients.items():
        law = sum(coefficient * evaluate(parse(term)) for term, coefficient in terms.items())
        scale = np.max(np.abs(truth.clean[target]))
        np.testing.assert_allclose(law, truth.clean[target], rtol=0, atol=1e-11 * scale)


def test_targets_are_the_derivatives_of_the_states(system: System) -> None:
    fine = simulate(system, n=2000, fs=10 * system.fs, noise=0.0)
    clean = fine.truth.clean if fine.truth else {}
    h = 1 / (10 * system.fs)
    for target, state in system.targets.items():
        central = (clean[state][2:] - clean[state][:-2]) / (2 * h)
        error = np.abs(central - clean[target][1:-1])
        # A jump of the law (friction) spoils the few samples beside it.
        assert np.quantile(error, 0.9) < 1e-2 * np.std(clean[target])
