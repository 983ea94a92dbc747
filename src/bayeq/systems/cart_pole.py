"""A pole that hangs from a cart: accelerations that hold each other."""

from bayeq.systems.system import BandLimitedForce, System

# Of the equations of `terms`, solved for both accelerations.
_CART = "(u-c*v+m*l*w**2*sin(q))/(M+m)"
_LEFT = "(1-m/(M+m)*cos(q)**2)"

CART_POLE = System(
    name="cart_pole",
    title="Pole that hangs from a cart",
    chains=("x:v:a", "q:w:b"),
    rhs={
        "x": "v",
        "v": f"({_CART}+m*g/(M+m)*sin(q)*cos(q))/{_LEFT}",
        "q": "w",
        "w": f"-(g/l*sin(q)+cos(q)/l*{_CART})/{_LEFT}",
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
)
