"""Terms that depend on each other, such as x1, x2 and x1 - x2, any two of which say the same."""

from __future__ import annotations

import pytest

import bayeq as bq
from bayeq.errors import AmbiguityWarning


def test_an_equation_is_not_written_with_more_terms_than_it_needs() -> None:
    record = bq.simulate("linear", n=700, seed=2, noise=0.02)
    with pytest.warns(
        AmbiguityWarning, match=r"^a: .* can be written by the terms shown; either may be in: give fewer"
    ):
        (eq,) = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=["x", "v", "x+v", "u", "x**3"])
    assert len(eq.shown) == 3
    assert "u" in eq.shown
    assert all(0.0 < sd < 10.0 for sd in eq.shown_posterior.sd[eq.shown_posterior.support])
    assert (eq.posterior.support == (eq.posterior.pip > 0.5)).all()
    [name] = eq.why
    assert eq.why == {name: "dependent"}
    assert name not in eq.shown
    assert not any("x+v" in line for line in str(eq).splitlines() if line.startswith("too small"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("term", ["v+0.01*x**2", "x+0.001*v*abs(v)"])
def test_terms_that_hardly_differ_do_not_depend_on_each_other(term: str) -> None:
    record = bq.simulate("linear", n=1500, seed=2, noise=0.02)
    (eq,) = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=["x", "v", "u", term], smooth="none")
    assert "dependent" not in eq.why.values()


@pytest.mark.filterwarnings("ignore")
def test_terms_that_are_hardly_ever_in_together_are_not_shown_together() -> None:
    # v and v + 0.01 x^2 hardly differ: each has a PIP of a half and more, a model of both 4 %
    record = bq.simulate("linear", n=1500, seed=2, noise=0.02)
    dictionary = ["x", "v", "u", "v+0.01*x**2"]
    (eq,) = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=dictionary, smooth="none")
    assert {"v", "v+0.01*x**2"} <= set(eq.included)
    average = eq.posterior.average
    both = average.probability @ average.models[:, [1, 3]].all(axis=1)
    assert both < 0.05
    assert len({"v", "v+0.01*x**2"} & set(eq.shown)) == 1
    assert list(eq.why.values()) == ["undecided"]
