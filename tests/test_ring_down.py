"""Free vibration: how motion decays is decided by terms that explain next to nothing."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq


def _ring_down(seed: int, zeta: float) -> bq.Record:
    """Six seconds of some 5 Hz, 1 % of noise."""
    rng = np.random.default_rng(seed)
    w, t = 2.0 * np.pi * 5.0 * rng.uniform(0.8, 1.2), np.arange(3000) / 500.0
    x = np.exp(-zeta * w * t) * np.cos(np.sqrt(1.0 - zeta**2) * w * t + rng.uniform(0.0, 2.0 * np.pi))
    return bq.Record.from_arrays({"x": 1e-3 * (x + 0.01 * rng.standard_normal(len(t)))}, fs=500.0)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("seed", "zeta"), [(1, 0.004), pytest.param(4, 0.001, marks=pytest.mark.slow)])
def test_damping_that_the_record_tells_is_found(seed: int, zeta: float) -> None:
    eqs = bq.discover(_ring_down(seed, zeta), chains=["x::"], holdout=0.0)
    assert eqs.verdict.kind == "found"
    assert set(eqs["ddx"].shown) == {"x", "dx"}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", [3, pytest.param(5, marks=pytest.mark.slow)])
def test_damping_that_the_record_does_not_tell_is_not_found(seed: int) -> None:
    """Three tenths of the amplitude are lost: friction and drag lose them nearly as viscous damping does."""
    eqs = bq.discover(_ring_down(seed, 0.001), chains=["x::"], holdout=0.0)
    eq = eqs["ddx"]
    damping = max(pip for term, pip in zip(eq.terms, eq.posterior.pip, strict=True) if "dx" in term.names)
    assert damping < 0.95
    assert eqs.verdict.kind == "not determined"
    assert "other equations, which predict another ddx" in str(eqs)
