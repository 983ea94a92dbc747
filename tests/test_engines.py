"""A row of the table of engines is all that the library and the command line need."""

from __future__ import annotations

import pytest

import bayeq as bq
from bayeq.errors import UnknownNameError
from bayeq.inference.engines import ENGINES, Engine


def test_a_new_row_is_an_engine_that_discover_offers(monkeypatch):
    monkeypatch.setitem(ENGINES, "mine", Engine("rvm:rvm", "a title of mine", score="relevance"))
    record = bq.simulate("linear", n=500, seed=0, noise=0.01)
    eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary="x, v, u, x*v", method="mine", smooth="none")
    assert eq.method == "mine"
    assert "method: mine" in str(eq)
    assert "relevance" in str(eq)


def test_an_unknown_engine_is_refused_by_name():
    record = bq.simulate("linear", n=50, seed=0)
    with pytest.raises(UnknownNameError, match="no method named 'vbb'; did you mean 'vb'"):
        bq.discover(record, chains="x:v:a", inputs=["u"], method="vbb")
