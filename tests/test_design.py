"""The dictionary on the rows of records."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.errors import InputError
from bayeq.inference.gram import Gram
from bayeq.regression import design as design_module
from bayeq.regression.design import build_design
from bayeq.states import Roles, estimate_motion, parse_chains

OSCILLATOR = Variables(("x", "v"), ("u",))
ROLES = Roles(parse_chains(["x:v:a"]), ("u",))


def columns(n=500, seed=0):
    rng = np.random.default_rng(seed)
    return {name: rng.normal(size=n) for name in ("x", "v", "a", "u")}


def motion(*pieces, roles=ROLES, share=0.0):
    """Rows taken as they are."""
    return estimate_motion([bq.Record.from_arrays(piece) for piece in pieces], roles, "none", share)


def test_unusable_terms_are_left_out_by_name():
    c = columns()
    c["x"] = np.abs(c["x"])
    c["v"][3] = -1.0
    terms = build_dictionary(["x", "abs(x)", "v", "log(v)", "x-x+3", "2*x+1", "u", "sign(x)"], OSCILLATOR)
    design = build_design(terms, motion(c))
    assert [t.text for t in design.terms] == ["x", "v", "u"]
    assert design.train[0].names == ("x", "v", "u")
    np.testing.assert_array_equal(design.columns(0), np.column_stack([c["x"], c["v"], c["u"]]))
    reasons = {d.name: d.reason for d in design.dropped}
    assert reasons["abs(x)"] == "a copy of x on the data"
    assert reasons["2*x+1"] == "a copy of x on the data"
    assert reasons["x-x+3"] == reasons["sign(x)"] == "constant on the data"
    assert "not finite" in reasons["log(v)"]
    assert "500 rows" in reasons["log(v)"]
    with pytest.raises(InputError, match="no usable term"):
        build_design(build_dictionary(["sign(x)"], OSCILLATOR), motion(c))


def test_copies_are_judged_whatever_the_units():
    for scale in (1e-9, 1.0, 1e9):
        c = columns()
        c["x"] = c["x"] * scale
        kept = build_design(build_dictionary("oscillator", OSCILLATOR), motion(c)).terms
        assert len(kept) == 36


@pytest.mark.parametrize("most_kept", [10**9, 0])
def test_records_and_held_out_rows(monkeypatch, most_kept):
    monkeypatch.setattr(design_module, "MOST_KEPT", most_kept)
    monkeypatch.setattr(design_module, "BLOCK_ROWS", 64)
    c, other = columns(seed=1), columns(n=77, seed=2)
    terms = build_dictionary("polynomial:2", OSCILLATOR)
    roles = Roles(parse_chains(["x:v:a"]), ("u",))
    seen = []
    found = build_design(terms, motion(c, other, roles=roles, share=0.2), lambda *done: seen.append(done))
    train = {name: np.concatenate([c[name][:400], other[name][:62]]) for name in c}
    rest = {name: np.concatenate([c[name][400:], other[name][62:]]) for name in c}
    for gram, part in ((found.train[0], train), (found.held_out[0], rest)):
        direct = Gram.from_data(evaluate_terms(terms, part), part["a"], [t.text for t in terms])
        np.testing.assert_allclose(gram.DtD, direct.DtD, rtol=1e-10, atol=1e-9)
        np.testing.assert_allclose(gram.Dty, direct.Dty, rtol=1e-9, atol=1e-9)
        assert gram.n == direct.n
    assert seen[-1] == (577, 577)
    assert [len(found.columns(i)) for i in range(2)] == [400, 62]
