"""Large dictionaries: which candidates are kept."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from studies.overridden import overridden

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionary
from bayeq.numerics.settings import LIKELIHOOD
from bayeq.regression.design import explaining, screened
from bayeq.states import Roles, estimate_motion

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}


def unit_columns(seed, n=80, P=40):
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(n, P)) + 2.0 * rng.normal(size=(n, 1))
    D -= D.mean(axis=0)
    return D / np.linalg.norm(D, axis=0), rng


def by_least_squares(D, y, free, basis, share):
    """One column at a time: the one by which least squares leave least."""
    taken = []
    for _ in range(share):
        errors = np.full(D.shape[1], np.inf)
        for j in np.flatnonzero(free):
            if j not in taken:
                X = np.column_stack([basis, D[:, [*taken, j]]])
                errors[j] = np.sum((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2)
        taken.append(int(np.argmin(errors)))
    return taken


@pytest.mark.parametrize("seed", range(5))
def test_columns_are_taken_as_by_least_squares(seed):
    D, rng = unit_columns(seed)
    y = D[:, :6] @ rng.normal(size=6) + 0.01 * rng.normal(size=80)
    y -= y.mean()
    free = rng.random(40) < 0.8
    basis = np.linalg.qr(D[:, 30:33])[0]
    free[30:33] = False
    assert explaining(D, y, free, basis, 8).tolist() == by_least_squares(D, y, free, basis, 8)


def test_copies_and_columns_of_zeros_are_not_taken():
    D, _ = unit_columns(0)
    D[:, 1], D[:, 2] = D[:, 0], 0.0
    taken = explaining(D, D[:, 0] + 0.1 * D[:, 3], np.ones(40, dtype=bool), np.zeros((80, 0)), 20).tolist()
    assert 2 not in taken
    assert not {0, 1} <= set(taken)
    assert len(taken) == 20


LAW = {"x": -900.0, "v": -1.5, "x**3*v**2": -1e4, "u": 1.0}


def record(seed):
    """A force of degree 5 beside a linear oscillator."""
    from dataclasses import replace

    from bayeq.systems import get_system

    system = replace(
        get_system("linear"),
        rhs={"x": "v", "v": "+".join(f"({c})*{t}" for t, c in LAW.items())},
        terms={"a": {t: str(c) for t, c in LAW.items()}},
        parameters={},
    )
    return bq.simulate(system, n=2000, seed=seed, noise=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_true_terms_that_are_not_simple_are_kept(seed):
    roles = Roles.parse(**OSCILLATOR)
    motion = estimate_motion([record(seed)], roles, share=0.2)
    terms = build_dictionary("polynomial:20", Variables(roles.states, roles.inputs))
    forced = np.zeros(len(terms), dtype=bool)
    forced[-2] = True
    kept = screened(terms, motion, np.ones((1, len(terms)), dtype=bool), forced, 24)
    assert len(kept) <= 25
    assert len(terms) - 2 in kept
    names = {terms[j].text for j in kept}
    assert set(LAW) - {"x**3*v**2"} <= names
    # the simplest 12 do not hold it
    assert "x**3*v**2" in names


def test_discover_keeps_what_explains_and_says_so():
    with overridden(LIKELIHOOD, most_candidates=31), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        eq = bq.discover(
            record(1), **OSCILLATOR, dictionary="polynomial:12", smooth="none", constraints="v**12 == 0", holdout=0.0
        )
    assert set(LAW) <= {term.text for term in eq[0].terms}
    assert len(eq[0].terms) <= 31
    assert "v**12" in {term.text for term in eq[0].terms}
    message = "91 candidates: "
    assert any(message in str(one.message) for one in caught)
    assert any(message in one for one in eq.warnings)
