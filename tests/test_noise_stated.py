"""Noise of a channel that was stated, and is not what the record has."""

import re
import warnings

import pytest

import bayeq as bq


def judged(factor, chain, noise=0.03):
    record = bq.simulate("duffing", n=600, fs=250.0, seed=3, noise=noise)
    clean = bq.simulate("duffing", n=600, fs=250.0, seed=3, noise=0.0)
    stated = factor * float((record["x"] - clean["x"]).std())
    terms = f"x, {'v' if chain == 'x:v:a' else 'dx'}, x**2, x**3, u"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(record, chains=chain, inputs="u", noise={"x": stated}, dictionary=terms)


@pytest.mark.parametrize("chain", ["x:v:a", "x::"])
@pytest.mark.parametrize(("factor", "said"), [(0.4, r"x has 2\.\d times"), (5.0, r"x has 0\.2\d? times")])
def test_noise_that_the_record_contradicts_is_named(factor, said, chain):
    verdict = judged(factor, chain).verdict
    assert verdict.kind != "found"
    assert re.search(said + " the noise that was stated: leave out --noise x", verdict.advice)


@pytest.mark.parametrize("chain", ["x:v:a", "x::"])
def test_noise_as_stated_is_not(chain):
    eq = judged(1.0, chain)
    assert eq.verdict.kind == "found"
    assert set(eq[0].shown) >= {"x", "x**3", "u"}
