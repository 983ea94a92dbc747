"""Van der Pol's oscillator as two first-order equations."""

from bayeq.systems.system import System

VANDERPOL = System(
    name="vanderpol",
    title="Van der Pol oscillator",
    chains=("x", "y"),
    rhs={"x": "y", "y": "mu*(1-x**2)*y-x"},
    terms={"dx": {"y": "1"}, "dy": {"x": "-1", "y": "mu", "x**2*y": "-mu"}},
    parameters={"mu": 0.5},
    initial={"x": -2.0, "y": 1.0},
    n=1000,
    fs=100.0,
    noise=0.05,
    noise_scale="pooled",
    citation=(
        "B. van der Pol, On relaxation-oscillations, Phil. Mag. 2 (1926) 978-992; "
        "set up as in L. Fung, ODR-BINDy (2025)"
    ),
)
