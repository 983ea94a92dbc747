"""Lorenz's convection model."""

from bayeq.systems.system import System

LORENZ = System(
    name="lorenz",
    title="Lorenz 63",
    chains=("x", "y", "z"),
    rhs={"x": "sigma*(y-x)", "y": "x*(rho-z)-y", "z": "x*y-beta*z"},
    terms={
        "dx": {"x": "-sigma", "y": "sigma"},
        "dy": {"x": "rho", "y": "-1", "x*z": "-1"},
        "dz": {"z": "-beta", "x*y": "1"},
    },
    parameters={"sigma": 10.0, "rho": 28.0, "beta": 8 / 3},
    initial={"x": -8.0, "y": 8.0, "z": 27.0},
    n=1000,
    fs=100.0,
    noise=0.05,
    noise_scale="pooled",
    citation=(
        "E. N. Lorenz, Deterministic nonperiodic flow, J. Atmos. Sci. 20 (1963) 130-141; "
        "set up as in L. Fung, ODR-BINDy (2025)"
    ),
)
