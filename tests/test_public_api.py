"""The public contract: names that users and checks rely on."""

from __future__ import annotations

import inspect

import pytest

import bayeq as bq


def test_public_names():
    assert set(bq.__all__) == {
        "RVM",
        "STLSQ",
        "SYSTEMS",
        "Equation",
        "Equations",
        "Finding",
        "Forecast",
        "Gram",
        "ParsimonyPath",
        "PhysicalParameters",
        "Posterior",
        "Prior",
        "PriorSensitivity",
        "Record",
        "Refinement",
        "Scores",
        "SpikeSlabBMA",
        "SpikeSlabGibbs",
        "SpikeSlabVB",
        "System",
        "Truth",
        "check_record",
        "correct_delay",
        "discover",
        "load",
        "read",
        "remove_offset",
        "simulate",
        "write",
    }
    assert set(bq.__all__) <= set(dir(bq))
    for name in bq.__all__:
        assert getattr(bq, name) is not None
    with pytest.raises(AttributeError, match="nothing"):
        bq.nothing  # noqa: B018


def test_every_public_name_is_documented():
    for name in bq.__all__:
        thing = getattr(bq, name)
        if callable(thing):
            assert inspect.getdoc(thing), name
            assert len(inspect.getdoc(thing)) > 40, name


def parameters(function):
    return list(inspect.signature(function).parameters)


def test_signatures():
    assert parameters(bq.discover)[:10] == [
        "records",
        "chains",
        "displacement",
        "velocity",
        "acceleration",
        "force",
        "inputs",
        "dictionary",
        "method",
        "smooth",
    ]
    assert parameters(bq.simulate)[:2] == ["system", "n"]
    assert parameters(bq.read)[0] == "path"
    for name in ("table", "to_sympy", "to_latex", "rhs", "predict", "simulate", "score", "refine", "physical", "save"):
        assert callable(getattr(bq.Equations, name))


@pytest.mark.parametrize(
    ("name", "value"),
    [("slab_variance", 10.0), ("prior_inclusion", 0.1), ("noise_shape", 1e-4), ("noise_rate", 1e-4)],
)
def test_the_paper_s_prior_is_the_default(name, value):
    assert bq.SpikeSlabVB().get_params()[name] == value
    assert getattr(bq.Prior(), name) == value
