"""Physical parameters of equations: of one oscillator, of first-order equations, or of several coordinates.

The equation of x'' of an oscillator, m x'' + c x' + k x + ... = u, has the coefficients -k/m of x, -c/m of x', 1/m of
the force, -k3/m of x**3, -c2/m of x'|x'| and -Fc/m of sign(x'). The displacement may be measured from a point other
than the position of rest x_0, where all forces on the mass vanish without input: with x = x_0 + xi, theta x**p adds
binomial(p, n) theta x_0**(p - n) to the coefficient of xi**n. Stiffness means that of small motion about x_0.

Several coordinates have natural frequencies, damping ratios and mode shapes, and M, C, K where masses are known. The
linear part of their equations is ``x'' = A x + B x' + D u``. Its modes are the eigenvectors of ``[[0, I], [A, B]]``: an
eigenvalue ``lambda`` has the frequency ``|lambda|/2 pi`` and the damping ratio ``-Re(lambda)/|lambda|``. An input that
drives one coordinate alone is its force, ``1/m`` its coefficient; other masses follow from the symmetry of the
stiffness, ``m_i A_ij = m_j A_ji``. Intervals are quantiles over draws from the posterior of the coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import compress
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms, slopes_of
from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation
from bayeq.equation.quantities import Mode, PhysicalParameters, Quantity, quantity
from bayeq.equation.text import CERTAIN
from bayeq.equation.written import OscillatorUnits, quotient_unit
from bayeq.errors import InputError, some_of, whole_number
from bayeq.expressions import Binary, Expression, Node, Number, Symbol, parse
from bayeq.expressions.functions import TIME
from bayeq.expressions.nodes import jumps_of
from bayeq.figures.style import named
from bayeq.forecast.dynamics import Law, moments, normal_draws
from bayeq.numerics.distributions import Z95
from bayeq.records.names import in_si, parse_unit
from bayeq.states import Chain

# Highest power of the displacement that has a stiffness parameter, k9.
HIGHEST_POWER = 9

# Grid points on which a zero of the force is sought; how far they reach beyond the record's range, as a share of it.
PLACES, BEYOND = 2001, 0.5

# Newton steps; difference step for slopes at rest, as a share of the range; difference step for derivatives at zero.
STEPS, STEP, ZERO_STEP = 20, 1e-4, 1e-4

# A position of rest nearer to zero than this share of the record's range is set to zero.
AT_ZERO = 1e-9

# Largest share of draws that may have no position of rest.
FEW = 0.025

# Endings of units with symbols that `in_si` does not know: an input with such a unit is no force.
NO_FORCE = ("A", "V", "W", "Pa", "bar", "psi", "%")

# Draws for the parameters that are printed with every answer, and by default.
DRAWS = 10_000

# Most draws with eigenvalues, divided by the number of coordinates; least share of draws that must have as many
# oscillating modes as the mean.
MOST_DRAWS, LEAST_SHARE = 4000, 0.5


def own_parameters(eq: Answer) -> PhysicalParameters | None:
    """The parameters printed with an answer; for an equation of motion without parameters, a note that says why.

    None for other equations without parameters, and if the verdict is none or not determined: they assume the terms.
    """
    if eq.verdict.kind in ("none", "not determined"):
        return None
    try:
        return oscillator_parameters(eq, None, target=None, force=None, draws=DRAWS, seed=0)
    except InputError as error:
        moving = not eq.roles.discrete and [one.chain.order for one in eq].count(2) in (1, len(eq))
        return PhysicalParameters((), note=f"no physical parameters: {error}") if moving else None


def oscillator_parameters(
    eq: Answer, mass: float | None, *, target: str | None, force: str | None, draws: int, seed: int
) -> PhysicalParameters:
    """See `Equations.physical`."""
    if eq.roles.discrete:
        raise InputError("physical parameters are those of equations of motion, not of maps")
    if eq.data.rows_as_time:
        raise InputError(
            "physical parameters are per second, and time is not known: give the sampling rate (fs=, --fs)"
        )
    if target is None:
        laws, second = [_with_doubt(one) for one in eq], [one.target for one in eq if one.chain.order == 2]
        if 1 < len(second) == len(laws) and mass is None and force is None:
            return system_parameters(laws, eq.inputs, eq.equations[0].units, draws=draws, seed=seed)
        if all(one.chain.order == 1 for one in eq):
            hidden = {one.target: _fed_back(one, [other for other in eq if other.chain.hidden]) for one in eq}
            units = {**eq.equations[0].units, TIME: eq.data.clock}
            return first_order_parameters(laws, eq.inputs, units, without=hidden, draws=draws, seed=seed)
        if not second:
            raise InputError(
                "physical parameters are those of a second-order equation, x'' = ...; here there are only"
                f" {', '.join(f'{e.target} (order {e.chain.order})' for e in eq.equations)}"
            )
        if len(second) > 1:
            raise InputError(f"name one of the equations as target: {', '.join(second)}")
        (target,) = second
    equation = eq[named("equation", target, [one.target for one in eq])]
    name = equation.chain.names[0]
    span = eq.data.measured.ranges.get(name)
    if span and not span[0] <= 0.0 <= span[1] and equation.verdict.kind in ("none", "not determined"):
        raise InputError(
            f"the stiffness cannot be told: the verdict is {equation.verdict.kind!r}, and {name} is nowhere zero;"
            f" measure {name} from the position of rest (bayeq.remove_offset, --remove-offset {name})"
        )
    law, without = _with_doubt(equation), _fed_back(equation, [one for one in eq if one.chain.order == 1])
    return physical_parameters(
        law, eq.inputs, equation.units, mass=mass, force=force, span=span, without=without, draws=draws, seed=seed
    )


def _with_doubt(equation: Equation) -> Law:
    """The law with its intervals over models, of coefficients that depend on which terms are in the equation."""
    unlike = equation.printed_over_models
    return equation.law._replace(over_models=np.where(unlike[:, None], equation.printed_ci95, np.nan))


def _fed_back(equation: Equation, others: Sequence[Equation]) -> list[str]:
    """States of other equations, driven by this one's, that act back on it: a part of its stiffness and damping."""
    moved = set(equation.chain.states)
    for _ in others:  # a driven state may drive the next
        moved |= {z for one in others if _names(one.law) & moved for z in one.chain.states}
    return sorted(_names(equation.law) & moved - set(equation.chain.states))


class Force(NamedTuple):
    """A term of an oscillator's equation and its parameter: coefficient = -parameter/m."""

    symbol: str
    meaning: str
    term: str
    powers: tuple[int, int]  # powers of displacement and velocity, for the unit


def forces_of(chain: Chain) -> list[Force]:
    """All forces that are recognised in the equation of an oscillator."""
    x, v = chain.states
    stiffness = {2: "quadratic", 3: "cubic", 5: "quintic"}
    return [
        Force("c", "viscous damping", v, (0, 1)),
        Force("k", "stiffness", x, (1, 0)),
        *(
            Force(f"k{n}", f"{stiffness.get(n, f'order {n}')} stiffness", f"{x}**{n}", (n, 0))
            for n in range(2, HIGHEST_POWER + 1)
        ),
        Force("c2", "quadratic damping", f"{v}*abs({v})", (0, 2)),
        Force("c3", "cubic damping", f"{v}**3", (0, 3)),
        Force("Fc", "Coulomb friction", f"sign({v})", (0, 0)),
    ]


def physical_parameters(
    law: Law,
    inputs: Sequence[str],
    units: Mapping[str, str],
    *,
    mass: float | None = None,
    force: str | None = None,
    span: tuple[float, float] | None = None,
    without: Sequence[str] = (),
    draws: int = DRAWS,
    seed: int = 0,
) -> PhysicalParameters:
    """Parameters of an oscillator given the included terms of its equation; see `bayeq.Equations.physical`.

    `span` is the smallest and largest displacement of the record; without it the position of rest is taken to be zero.
    If the effect of states is left out, `without`, the natural frequency says so, and there are no modes. InputError if
    there is neither a power of the displacement nor damping, for a mass not above 0, or inconsistent units.
    """
    coefficients, position = _read(law, draws, seed, span)
    forces = [force for force in forces_of(law.chain) if force.term in coefficients]
    if not forces:
        raise InputError(
            f"the equation of {law.chain.target} has neither a restoring term (a power of {law.chain.states[0]}) nor"
            " damping: it has no parameters of an oscillator or a drive"
        )
    driven = _force(inputs, coefficients, force)
    if driven is not None and force is None and mass is None:
        against = np.quantile(coefficients[driven], 0.975) < 0.0
        # an input with a negative coefficient, or one that is no force, does not give the mass
        driven = None if against or _is_no_force(units.get(driven, "")) else driven
    system = OscillatorUnits(units, law.chain, law.unit_gains, driven, mass is not None)
    theta = {f.symbol: coefficients[f.term] * system.scale(f.powers) for f in forces}
    mixed = [name for name in coefficients if _is_mixed(parse(name), law.chain.states, [*inputs, TIME])]
    quantities = _modal(theta, [*without, *mixed])
    weight = _mass(mass, None if driven is None else coefficients[driven] * system.scale_force(), draws)
    inertia = "moment of inertia" if system.turns else "mass"
    if weight is not None:
        quantities.append(quantity("m", inertia, weight, system.mass()))
    per, each = ("", "") if weight is not None else ("/m", f" per unit of {'inertia' if system.turns else 'mass'}")
    kept = compress(zip(law.terms, law.posterior.pip.tolist(), strict=True), law.posterior.support)
    unsure = [term for term, pip in kept if pip < CERTAIN]
    doubtful = {term.text for term in unsure}
    x, v = law.chain.states
    if any(term.names == {x} and _powers(term.tree, x, v) is None for term in unsure):  # its slope is a stiffness
        doubtful.add(x)
    for f in forces:
        values, meaning = -theta[f.symbol] * (1.0 if weight is None else weight), f.meaning + each
        meaning += ", in doubt" if f.term in doubtful else ""
        quantities.append(quantity(f.symbol + per, meaning, values, system.unit(f.powers, weight is not None)))
    if position is not None:
        quantities.append(quantity("x0", "position of rest", position * system.per_length, system.displacement()))
    known = {q.symbol: q for q in quantities}
    whole = "zeta" in known and not (without or mixed)
    modes = (Mode(known["f_n"], known["zeta"], {law.chain.states[0]: 1.0}),) if whole else ()
    left = tuple(name for name in coefficients if name not in (*(f.term for f in forces), driven))
    return PhysicalParameters(tuple(quantities), left, modes)


def first_order_parameters(
    laws: Sequence[Law],
    inputs: Sequence[str],
    units: Mapping[str, str],
    *,
    without: Mapping[str, Sequence[str]],
    draws: int,
    seed: int,
) -> PhysicalParameters:
    """Time constants and static gains of first-order states, ``tau x' = -x + gain u + ...``, linear in their own law.

    Arguments are as for `physical_parameters`, `without` by target. InputError if no state decays by a linear term.
    """
    found, other, rng = list[Quantity](), list[str](), np.random.default_rng(seed)
    for law in laws:
        (x,), gains = law.chain.states, list[Quantity]()
        values = {term.text: drawn for term, drawn in drawn_coefficients(law, draws, rng)[1].items()}
        bent = any(name != x and x in parse(name).names for name in values)
        if bent or x not in values or not np.quantile(-values[x], 0.025) > 0.0:
            other += [name for name in values if name not in other]
            continue
        rate = np.where(values[x] < 0.0, -values[x], np.nan)
        for name, own in values.items():
            if name in inputs:
                unit = quotient_unit(x, parse(name), units)
                gains.append(quantity(f"gain[{x}, {name}]", f"static gain of {x} by {name}", own / rate, unit))
            elif name != x and name not in other:
                other.append(name)
        meaning = f"time constant of {x}{_without(without[law.chain.target])}"
        found += [quantity(f"tau[{x}]", meaning, 1.0 / rate, units[TIME]), *gains]
    if not found:
        raise InputError("no state decays by a linear term of its own: there is no time constant")
    return PhysicalParameters(tuple(found), tuple(other))


def _read(law: Law, draws: int, seed: int, span: tuple[float, float] | None) -> tuple[dict[str, Floats], Floats | None]:
    """Draws of each included coefficient, about the position of rest if it is not zero, and draws of that position."""
    chain = law.chain
    if chain.order != 2:
        raise InputError(
            f"physical parameters are those of a second-order equation, but that of {chain.target} is of order"
            f" {chain.order}"
        )
    count = whole_number("draws", draws, 100)
    x, v = chain.states
    constant, coefficients = drawn_coefficients(law, count, np.random.default_rng(seed))
    for term, values in list(coefficients.items()):  # x - u adds to the coefficient of x
        slope = slopes_of(term, chain.states) if len(term.names) > 1 else None
        for name, part in zip(chain.states, (0.0, 0.0) if slope is None else slope, strict=True):
            if part:
                coefficients[parse(name)] = coefficients.get(parse(name), 0.0) + part * values
    position, p = None, law.posterior
    has_constant = p.constant.pip > 0.5 if p.constant.pip is not None else abs(p.intercept) > Z95 * p.intercept_sd
    if span is not None and _is_displaced(coefficients, has_constant, x, v, span):
        position, coefficients = _about_rest(coefficients, constant, x, v, span)
    # |v|*v is v*|v|
    same = {parse(f"abs({v})*{v}"): f"{v}*abs({v})"}
    return {same.get(term, term.text): values for term, values in coefficients.items()}, position


def drawn_coefficients(law: Law, count: int, rng: np.random.Generator) -> tuple[Floats, dict[Expression, Floats]]:
    """Draws of the intercept of a law and of the coefficient of each included term, (count,) each.

    Both sides of a distribution are stretched to the ends of an interval over models.
    """
    mean, covariance = moments(law.posterior)
    drawn = normal_draws(mean, covariance, count, rng)
    if law.over_models is not None:
        apart, sd = drawn[:, 1:] - mean[1:], np.sqrt(np.diagonal(covariance)[1:])
        reach = np.abs(law.over_models[law.posterior.support] - mean[1:, None])
        low, high = np.fmax(reach / (Z95 * sd)[:, None], 1.0).T
        drawn[:, 1:] = mean[1:] + np.where(apart < 0.0, low, high) * apart
    constant, *columns = drawn.T
    return constant, dict(zip(compress(law.terms, law.posterior.support), columns, strict=True))


def _force(inputs: Sequence[str], coefficients: Mapping[str, Floats], force: str | None) -> str | None:
    """The input that is the force: the only one that enters linearly, or the one named."""
    if force is not None:
        if named("input", force, inputs) not in coefficients:
            raise InputError(f"{force} is not in the equation: its coefficient says nothing of the mass")
        return force
    linear = [name for name in inputs if name in coefficients]
    return linear[0] if len(linear) == 1 else None


def _mass(mass: float | None, per_force: Floats | None, draws: int) -> Floats | None:
    """Draws of the mass, given or 1 over the force's coefficient; None if neither is known."""
    if mass is not None:
        if not (math.isfinite(mass) and mass > 0):
            raise InputError(f"mass must be positive and finite, got {mass!r}")
        return np.full(draws, float(mass))
    if per_force is None:
        return None
    if not (per_force.mean() > 0 and np.quantile(per_force, 0.025) > 0):
        raise InputError(
            "the force's coefficient, 1/m, is not positive with any certainty: check the sign of the force, or give the"
            " mass"
        )
    return np.asarray(1.0 / per_force)


def _without(names: Sequence[str]) -> str:
    return f" without {', '.join(names)}" if names else ""


def _modal(theta: Mapping[str, Floats], without: Sequence[str]) -> list[Quantity]:
    """Natural frequency and damping ratio of the linear part; empty if its stiffness is not clearly positive."""
    if "k" not in theta or not np.quantile(-theta["k"], 0.025) > 0:
        return []
    square = np.where(theta["k"] < 0, -theta["k"], np.nan)
    omega, but = np.sqrt(square), _without(without)
    out = [
        quantity("omega_n", f"natural frequency{but}", omega, "rad/s"),
        quantity("f_n", f"natural frequency{but}", omega / (2.0 * math.pi), "Hz"),
    ]
    if "c" in theta:
        out.append(quantity("zeta", f"damping ratio{but}", -theta["c"] / (2.0 * omega), ""))
    return out


def system_parameters(
    laws: Sequence[Law], inputs: Sequence[str], units: Mapping[str, str], *, draws: int, seed: int
) -> PhysicalParameters:
    """Modes of the linear part of several second-order equations; stiffness and damping where a mass is known.

    Modes are left out if a term makes the linear part depend on an input, the time or an acceleration. InputError if
    no mode oscillates.
    """
    n = len(laws)
    count = min(draws, max(MOST_DRAWS // n, 100))
    forces = [next((u for u in inputs if u in _names(law)), None) for law in laws]
    scales = [OscillatorUnits(units, law.chain, law.unit_gains, u) for law, u in zip(laws, forces, strict=True)]
    states = [law.chain.states[0] for law in laws] + [law.chain.states[1] for law in laws]
    per_state = np.concatenate([[1.0 / s.per_length for s in scales], [s.velocity / s.per_length for s in scales]])
    linear, unexplained = np.zeros((count, n, 2 * n)), list[str]()
    driven: dict[str, dict[int, Floats]] = {}
    rng, others = np.random.default_rng(seed), [*inputs, TIME, *(law.chain.target for law in laws)]
    for i, (law, scale) in enumerate(zip(laws, scales, strict=True)):
        for term, drawn in drawn_coefficients(law, count, rng)[1].items():
            slope = slopes_of(term, states)
            tangent = _tangent(term, states) if slope is None and term.names <= set(states[:n]) else slope
            if tangent is not None:
                linear[:, i] += drawn[:, None] * tangent * per_state * scale.per_length / scale.acceleration
            if slope is not None:
                continue
            if term.text in inputs:
                if not _is_no_force(units.get(term.text, "")):
                    driven.setdefault(term.text, {})[i] = drawn * scale.scale_force()
            elif term.text not in unexplained:
                unexplained.append(term.text)
    mixed = [name for name in unexplained if _is_mixed(parse(name), states, others)]
    note = f"no modes: they would depend on inputs or accelerations, by {some_of(mixed)}" if mixed else ""
    found, modes = ([], []) if mixed else _modes(linear, [law.chain.names[0] for law in laws])
    found += _matrices(linear, driven, laws, scales)
    return PhysicalParameters(tuple(found), tuple(unexplained), tuple(modes), note)


def _is_no_force(unit: str) -> bool:
    """Whether an input's unit is that of base motion, a current, a voltage, a power or a pressure, not of a force."""
    si = in_si(parse_unit(unit)) if unit else None
    return unit.endswith(NO_FORCE) if si is None else not si[1].get("N")


def _names(law: Law) -> set[str]:
    return {name for term in compress(law.terms, law.posterior.support) for name in term.names}


def _tangent(term: Expression, states: Sequence[str]) -> Floats | None:
    """Slopes at zero of a term of displacements, by extrapolated central differences, (2 n,); None if not finite."""
    steps = np.eye(len(states))
    ends = np.concatenate([share * ZERO_STEP * steps for share in (1.0, -1.0, 0.5, -0.5)])
    with np.errstate(all="ignore"):
        values = evaluate_terms([term], dict(zip(states, ends.T, strict=True)))[:, 0].reshape(4, -1)
    whole, half = (values[0] - values[1]) / 2.0, values[2] - values[3]
    out = (4.0 * half - whole) / (3.0 * ZERO_STEP)
    return np.asarray(out) if np.isfinite(out).all() else None


def _is_mixed(term: Expression, states: Sequence[str], others: Sequence[str]) -> bool:
    """Whether a term's derivatives by the states depend on `others`: inputs, the time, accelerations."""
    return bool(term.names & set(others)) and bool(term.names & set(states)) and slopes_of(term, states) is None


def _modes(linear: Floats, names: Sequence[str]) -> tuple[list[Quantity], list[Mode]]:
    """Frequency, damping ratio and shape of each mode that oscillates, the slowest first."""
    count, n = linear.shape[:2]
    whole = np.zeros((count + 1, 2 * n, 2 * n))
    whole[:, :n, n:] = np.eye(n)
    whole[:, n:] = np.concatenate([linear.mean(axis=0)[None], linear])
    values, vectors = np.linalg.eig(whole)
    order = np.argsort(np.where(values.imag > 0.0, np.abs(values), np.inf), axis=1)
    values = np.take_along_axis(values, order, axis=1)
    vectors = np.take_along_axis(vectors[:, :n], order[:, None, :], axis=2)
    counts = (values.imag > 0.0).sum(axis=1)
    same = counts == counts[0]
    if not counts[0] or same[1:].mean() < LEAST_SHARE:
        raise InputError("the linear part of the equations has no modes that oscillate: no natural frequencies")
    values, vectors, out, modes = values[same], vectors[same], list[Quantity](), list[Mode]()
    for k in range(int(counts[0])):
        omega, number = np.abs(values[1:, k]), k + 1
        largest = int(np.argmax(np.abs(vectors[0, :, k])))
        shape = (vectors[1:, :, k] / vectors[1:, largest, k, None]).real
        frequency = quantity(f"f_{number}", f"natural frequency of mode {number}", omega / (2.0 * math.pi), "Hz")
        ratio = quantity(f"zeta_{number}", f"damping ratio of mode {number}", -values[1:, k].real / omega, "")
        modes.append(Mode(frequency, ratio, dict(zip(names, shape.mean(axis=0).tolist(), strict=True))))
        out += [frequency, ratio]
        out += [
            quantity(f"phi_{number}[{names[i]}]", f"mode {number}, {names[i]} over {names[largest]}", shape[:, i], "")
            for i in range(n)
            if i != largest
        ]
    return out, modes


def _matrices(
    linear: Floats, driven: Mapping[str, Mapping[int, Floats]], laws: Sequence[Law], scales: Sequence[OscillatorUnits]
) -> list[Quantity]:
    """Masses, and the rows of stiffness and damping of coordinates whose mass is known."""
    n = len(laws)
    masses: dict[int, Floats] = {}
    for by_equation in driven.values():
        if len(by_equation) == 1:
            ((i, per_force),) = by_equation.items()
            if np.quantile(per_force, 0.025) > 0.0:
                masses[i] = 1.0 / per_force
    unit = next((scales[i].mass() for i in masses), None)
    known = list(masses)
    for i in known:  # grows: masses follow from one another by symmetry
        for j in range(n):
            there, back = linear[:, i, j], linear[:, j, i]
            if j not in masses and (_known(there) and _known(back) and np.all(there * back > 0.0)):
                masses[j] = masses[i] * there / back
                known.append(j)
    out = [quantity(f"m_{i + 1}", f"mass of {laws[i].chain.names[0]}", masses[i], unit) for i in sorted(masses)]
    for symbol, what, first, powers in (("k", "stiffness", 0, (1, 0)), ("c", "damping", n, (0, 1))):
        for i in sorted(masses):
            for j in range(n):
                values = -masses[i] * linear[:, i, first + j]
                if (j >= i or j not in masses) and np.any(values):
                    # a coordinate without a force takes the unit of one that has a force
                    own = next((s.unit(powers, True) for s in (scales[i], *scales) if s.force is not None), None)
                    out.append(quantity(f"{symbol}_{i + 1}{j + 1}", f"{what}, row {i + 1}", values, own))
    return out


def _known(values: Floats) -> bool:
    """Whether the 95 % interval of draws excludes zero."""
    low, high = np.quantile(values, [0.025, 0.975])
    return bool(low > 0.0 or high < 0.0)


def _is_displaced(
    coefficients: Mapping[Expression, Floats], constant: bool, x: str, v: str, span: tuple[float, float]
) -> bool:
    """Whether rest may be off zero (a constant force, a span without zero), or the spring is no polynomial."""
    alone = [term for term in coefficients if term.names == {x}]
    forced = any(abs(float(evaluate_terms([term], {x: np.zeros(1)})[0, 0])) > 0.0 for term in alone)
    bent = any(_powers(term.tree, x, v) is None and not any(jumps_of(term.tree)) for term in alone)
    return bool(alone) and (constant or forced or bent or not span[0] <= 0.0 <= span[1])


def _about_rest(
    coefficients: Mapping[Expression, Floats], constant: Floats, x: str, v: str, span: tuple[float, float]
) -> tuple[Floats, dict[Expression, Floats]]:
    """The position of rest (n,) of n draws, and the coefficients about it, (n,) each.

    Terms in `x` alone that are no powers add their slope at rest to the coefficient of `x`; other terms that are not
    monomials stay. InputError if there is no stable position of rest in or near the span of the record.
    """
    alone = {term: values for term, values in coefficients.items() if term.names == {x}}
    width = span[1] - span[0]
    low, high = span[0] - BEYOND * width, span[1] + BEYOND * width
    not_at_rest = InputError(
        f"the equation has no certain position of rest near the record's range of {x}, {span[0]:.4g} to {span[1]:.4g}:"
        f" measure {x} from the position of rest (bayeq.remove_offset, --remove-offset {x}) and look again"
    )

    def force(position: Floats, thetas: Mapping[Expression, Floats], level: Floats) -> Floats:
        columns = evaluate_terms(list(thetas), {x: position})
        return np.zeros(position.shape) + level + sum(theta * columns[:, j] for j, theta in enumerate(thetas.values()))

    places = np.linspace(low, high, PLACES)
    mean = {term: np.asarray(values.mean()) for term, values in alone.items()}
    along = force(places, mean, np.asarray(constant.mean()))
    stable = places[np.flatnonzero((along[:-1] > 0.0) & (along[1:] <= 0.0))]
    if not len(stable):
        raise not_at_rest
    # of those that were passed the one nearest to zero: a pendulum that turns over rests after every turn
    passed = stable[(stable >= span[0]) & (stable <= span[1])]
    nearest = min(passed, key=abs) if len(passed) else min(stable, key=lambda x: abs(x - 0.5 * (span[0] + span[1])))
    position, step = np.full(len(constant), nearest), STEP * width

    def slope(position: Floats, thetas: Mapping[Expression, Floats]) -> Floats:
        nothing = np.zeros(len(position))
        return (force(position + step, thetas, nothing) - force(position - step, thetas, nothing)) / (2.0 * step)

    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            position = position - force(position, alone, constant) / slope(position, alone)
    position = np.where((position > low) & (position < high), position, np.nan)
    position = np.where(np.abs(position) > AT_ZERO * width, position, 0.0 * position)
    if np.isnan(position).mean() > FEW:
        raise not_at_rest

    moved: dict[Expression, Floats] = {}
    others: dict[Expression, Floats] = {}
    for term, theta in coefficients.items():
        powers = _powers(term.tree, x, v)
        if powers is None:
            others[term] = theta
            continue
        p, q = powers
        for n in range(p + 1):
            if n + q > 0:
                key = parse(
                    "*".join(name if power == 1 else f"{name}**{power}" for name, power in ((x, n), (v, q)) if power)
                )
                moved[key] = moved.get(key, 0.0) + math.comb(p, n) * theta * position ** (p - n)
    bent = {term: theta for term, theta in others.items() if term in alone}
    if bent:
        key = parse(x)
        moved[key] = moved.get(key, 0.0) + slope(position, bent)
    return position, {**moved, **others}


def _powers(node: Node, x: str, v: str) -> tuple[int, int] | None:
    """Powers of displacement and velocity in a monomial; None for other terms."""
    match node:
        case Symbol(name) if name in (x, v):
            return (1, 0) if name == x else (0, 1)
        case Binary("**", Symbol(name), Number(int(power))) if name in (x, v):
            return (power, 0) if name == x else (0, power)
        case Binary("*", left, right):
            one, other = _powers(left, x, v), _powers(right, x, v)
            return None if one is None or other is None else (one[0] + other[0], one[1] + other[1])
        case _:
            return None
