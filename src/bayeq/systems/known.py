"""The known systems: oscillators of Nayek, Worden and Cross, chaotic flows, and coupled accelerations."""

from bayeq.systems.system import BandLimitedForce, System, oscillator

# Parts of the equations of `terms`, solved for both accelerations: pole on a cart, and double pendulum.
_CART = "(u-c*v+m*l*w**2*sin(q))/(M+m)"
_ON_CART = "(1-m/(M+m)*cos(q)**2)"
_FIRST = "m2*l2/((m1+m2)*l1)*s**2*sin(p-q)+g/l1*sin(p)"
_SECOND = "l1/l2*r**2*sin(p-q)-g/l2*sin(q)"
_OF_RODS = "(1-m2/(m1+m2)*cos(p-q)**2)"

KNOWN = (
    oscillator("linear", "Linear oscillator"),
    oscillator("duffing", "Duffing oscillator (cubic stiffness)", ("k3", 1e5, "x**3")),
    oscillator("quadratic", "Oscillator with quadratic viscous damping", ("c2", 2.0, "v*abs(v)")),
    oscillator("coulomb", "Oscillator with Coulomb friction", ("cF", 1.0, "sign(v)")),
    System(
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
    ),
    System(
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
    ),
    System(
        name="cart_pole",
        title="Pole that hangs from a cart",
        chains=("x:v:a", "q:w:b"),
        rhs={
            "x": "v",
            "v": f"({_CART}+m*g/(M+m)*sin(q)*cos(q))/{_ON_CART}",
            "q": "w",
            "w": f"-(g/l*sin(q)+cos(q)/l*{_CART})/{_ON_CART}",
        },
        terms={
            "a": {"v": "-c/(M+m)", "u": "1/(M+m)", "w**2*sin(q)": "m*l/(M+m)", "b*cos(q)": "-m*l/(M+m)"},
            "b": {"sin(q)": "-g/l", "a*cos(q)": "-1/l"},
        },
        parameters={"M": 1.0, "m": 0.4, "l": 0.5, "c": 0.3, "g": 9.81},
        fixed=("g",),
        initial={"x": 0.0, "v": 0.0, "q": 0.6, "w": 0.0},
        inputs=("u",),
        force=BandLimitedForce(1.5, (0.1, 2.0)),
        n=2000,
        fs=100.0,
        noise=0.02,
        substeps=4,
        units={"x": "m", "v": "m/s", "a": "m/s^2", "q": "rad", "w": "rad/s", "b": "rad/s^2", "u": "N"},
        citation="Lagrange's equations of a point mass on a rod that hangs from a cart",
    ),
    System(
        name="double_pendulum",
        title="Double pendulum",
        chains=("p:r:d", "q:s:b"),
        rhs={
            "p": "r",
            "r": f"-({_FIRST}+m2*l2/((m1+m2)*l1)*cos(p-q)*({_SECOND}))/{_OF_RODS}",
            "q": "s",
            "s": f"({_SECOND}+l1/l2*cos(p-q)*({_FIRST}))/{_OF_RODS}",
        },
        terms={
            "d": {"sin(p)": "-g/l1", "s**2*sin(p-q)": "-m2*l2/((m1+m2)*l1)", "b*cos(p-q)": "-m2*l2/((m1+m2)*l1)"},
            "b": {"sin(q)": "-g/l2", "r**2*sin(p-q)": "l1/l2", "d*cos(p-q)": "-l1/l2"},
        },
        parameters={"m1": 1.0, "m2": 0.8, "l1": 0.5, "l2": 0.4, "g": 9.81},
        fixed=("g",),
        initial={"p": 1.2, "r": 0.0, "q": -0.5, "s": 0.0},
        n=2000,
        fs=200.0,
        noise=0.02,
        substeps=4,
        units={"p": "rad", "r": "rad/s", "d": "rad/s^2", "q": "rad", "s": "rad/s", "b": "rad/s^2"},
        citation="Lagrange's equations of two point masses on rods",
    ),
)
