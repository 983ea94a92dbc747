from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayeq import Record, discover, simulate
from bayeq.errors import ChainError, InputError, RecordError, UnknownNameError
from bayeq.states import Roles, parse_chain, parse_chains
from bayeq.states.derive import current, derive_states, require_varying
from bayeq.systems.system import BandLimitedForce, System


@pytest.mark.parametrize(
    ("text", "names", "order"),
    [
        ("x:v:a", ("x", "v", "a"), 2),
        ("x::", ("x", "dx", "ddx"), 2),
        ("x:v:", ("x", "v", "ddx"), 2),
        ("x::a", ("x", "dx", "a"), 2),
        ("x", ("x", "dx"), 1),
        ("x:xdot", ("x", "xdot"), 1),
        ("::a", ("x", "dx", "a"), 2),
        ("::x", ("x_x", "dx_x", "x"), 2),
        (":v:a", ("x", "v", "a"), 2),
        ("~q::a", ("q", "dq", "a"), 2),
        (" x : v : a ", ("x", "v", "a"), 2),
    ],
)
def test_chains(text, names, order):
    chain = parse_chain(text)
    assert chain.names == names
    assert chain.order == order
    assert chain.target == names[-1]
    assert parse_chain(str(chain)) == chain


@pytest.mark.parametrize("text", ["", ":", "::", "::dx", "x:x", "x:v:a:b:c:d", "lambda"])
def test_wrong_chains(text):
    with pytest.raises(ChainError):
        parse_chain(text)


@given(st.text(max_size=30))
def test_any_text_is_a_chain_or_a_chain_error(text):
    try:
        chain = parse_chain(text)
    except ChainError:
        return
    assert len(chain.names) == chain.order + 1


def test_coordinates_that_are_not_measured_are_told_apart_by_their_channels():
    def names(texts, inputs=()):
        return [chain.names for chain in parse_chains(texts, inputs)]

    assert names(["::a"]) == [("x", "dx", "a")]
    assert names(["::a1", "::a2"]) == [("x_a1", "dx_a1", "a1"), ("x_a2", "dx_a2", "a2")]
    assert names(["x:v:", ":w:a"]) == [("x", "v", "ddx"), ("x_w", "w", "a")]
    assert names(["::a"], ["x"]) == [("x_a", "dx_a", "a")]
    # what clashes with nothing, and what has a name, keeps it
    assert names(["q::", "::a"]) == [("q", "dq", "ddq"), ("x", "dx", "a")]
    assert names(["~q::a1", "::a2"]) == [("q", "dq", "a1"), ("x", "dx", "a2")]
    # saved chains mean the same when they are read alone
    for chain in parse_chains(["::a1", "::a2"]):
        assert parse_chain(str(chain)) == chain


def test_two_masses_of_which_only_accelerations_are_measured():
    system = System(
        name="two",
        title="two masses",
        chains=("p:v:a1", "q:w:a2"),
        rhs={"p": "v", "q": "w", "v": "u-700*p+200*q-2*v", "w": "200*p-500*q-2*w"},
        terms={
            "a1": {"x_a1": "-700", "dx_a1": "-2", "x_a2": "200", "u": "1"},
            "a2": {"x_a1": "200", "x_a2": "-500", "dx_a2": "-2"},
        },
        parameters={},
        initial={"p": 0.0, "q": 0.0, "v": 0.0, "w": 0.0},
        inputs=("u",),
        force=BandLimitedForce(10.0, (1.0, 20.0)),
        n=600,
        fs=200.0,
        substeps=2,
        noise=0.01,
        citation="",
    )
    record = simulate(system, seed=1)
    found = discover(record, chains=["::a1", "::a2"], inputs=["u"], dictionary="polynomial:1")
    for equation, target in zip(found.equations, ("a1", "a2"), strict=True):
        assert equation.target == target
        assert equation.coef == pytest.approx(record.truth.coefficients[target], rel=0.01)


def test_names_of_several_chains_are_distinct():
    assert [c.target for c in parse_chains(["x", "y:dy"])] == ["dx", "dy"]
    with pytest.raises(ChainError, match="'x' occurs"):
        parse_chains(["x", "x:v:a"])
    with pytest.raises(ChainError, match="a colon too many"):
        parse_chains(["x::a:"])
    with pytest.raises(ChainError):
        parse_chains([])


def motion(n=2000, fs=200.0, noise=0.0, seed=0):
    t = np.arange(n) / fs
    x, v, a = np.sin(5 * t), 5 * np.cos(5 * t), -25 * np.sin(5 * t)
    rng = np.random.default_rng(seed)
    return Record.from_arrays(time=t, x=x + noise * rng.normal(size=n), v=v, a=a, u=np.cos(t)), (x, v, a)


def test_measured_channels_are_used_as_they_are():
    rec, _ = motion(noise=0.1)
    states = derive_states(rec, parse_chains(["x:v:a"]), ["u"])
    assert list(states) == ["x", "v", "a", "u"]
    for name in states:
        np.testing.assert_array_equal(states[name], rec[name])


def test_missing_derivatives_of_clean_motion():
    rec, (_, v, a) = motion()
    states = derive_states(rec, parse_chains(["x::"]))
    inner = slice(20, -20)
    assert np.max(np.abs(states["dx"] - v)[inner]) < 0.25
    assert np.max(np.abs(states["ddx"] - a)[inner]) < 1.25


def test_what_cannot_be_used_is_refused():
    rec, _ = motion(n=50)
    x = np.array(rec["x"])
    with pytest.raises(UnknownNameError, match="'V'"):
        derive_states(rec, parse_chains(["x:V:a"]))
    with pytest.raises(InputError, match="smooth"):
        current("much")
    with pytest.warns(DeprecationWarning, match="is now smooth='auto'"):
        assert current("band") == "auto"
    with pytest.raises(ChainError, match="both an input"):
        Roles.parse("x:v:a", inputs=["v"])
    with pytest.raises(RecordError, match="channel 'q' is constant"):
        require_varying([Record.from_arrays(time=rec.time, x=x, q=np.ones(50))], ["x", "q"])
    with pytest.raises(RecordError, match="varies by 1e-200 only"):
        require_varying([Record({"x": [0.0, 1e-200]})], ["x"])
    with pytest.raises(RecordError, match="too large to square"):
        derive_states(Record({"x": [0.0, 1e200]}), parse_chains(["x:v"])[:0], ["x"])
    with pytest.raises(RecordError, match="time"):
        derive_states(Record.from_arrays(x=x), parse_chains(["x"]))
    with pytest.raises(RecordError, match="too few"):
        derive_states(Record.from_arrays(x=x[:4], fs=1.0), parse_chains(["x"]))
    with pytest.raises(ChainError, match="dx"):
        derive_states(Record.from_arrays(x=x, dx=x, fs=1.0), parse_chains(["x"]))
    x[7] = np.nan
    with pytest.raises(RecordError, match="'x'"):
        derive_states(Record.from_arrays(x=x, fs=1.0), parse_chains(["x"]))
