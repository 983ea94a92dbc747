"""Two rods that hang from each other: accelerations that hold each other."""

from bayeq.systems.system import System

# Of the equations of `terms`, solved for both accelerations.
_FIRST = "m2*l2/((m1+m2)*l1)*s**2*sin(p-q)+g/l1*sin(p)"
_SECOND = "l1/l2*r**2*sin(p-q)-g/l2*sin(q)"
_LEFT = "(1-m2/(m1+m2)*cos(p-q)**2)"

DOUBLE_PENDULUM = System(
    name="double_pendulum",
    title="Double pendulum",
    chains=("p:r:d", "q:s:b"),
    rhs={
        "p": "r",
        "r": f"-({_FIRST}+m2*l2/((m1+m2)*l1)*cos(p-q)*({_SECOND}))/{_LEFT}",
        "q": "s",
        "s": f"({_SECOND}+l1/l2*cos(p-q)*({_FIRST}))/{_LEFT}",
    },
    terms={
        "d": {
            "sin(p)": "-g/l1",
            "s**2*sin(p-q)": "-m2*l2/((m1+m2)*l1)",
            "b*cos(p-q)": "-m2*l2/((m1+m2)*l1)",
        },
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
)
