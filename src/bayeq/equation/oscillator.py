"""Physical parameters of whatever equations there are: of one oscillator, of first order, or of several coordinates.

Several have natural frequencies, damping ratios and mode shapes, and M, C, K where known. The linear part of their
equations is ``x'' = A x + B x' + D u``. Its modes are the eigenvectors of ``[[0, I], [A, B]]``: an eigenvalue
``lambda`` has the frequency ``|lambda|/2 pi`` and the damping ratio ``-Re(lambda)/|lambda|``. An input that drives one
coordinate alone is its force, ``1/m`` its coefficient; other masses follow from the symmetry of the stiffness,
``m_i A_ij = m_j A_ji``. Intervals are of draws of the coefficients' posterior.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation
from bayeq.equation.physical import (
    Mode,
    PhysicalParameters,
    Quantity,
    drawn_coefficients,
    first_order_parameters,
    physical_parameters,
    quantity,
)
from bayeq.equation.written import OscillatorUnits
from bayeq.errors import InputError
from bayeq.expressions import Expression
from bayeq.figures.style import named
from bayeq.forecast.dynamics import Law

# Draws of parameters that nobody has asked for.
DRAWS = 2000


def own_parameters(eq: Answer) -> PhysicalParameters | None:
    """Physical parameters; None where the equations have none, or where none was found."""
    if eq.verdict.kind == "none":
        return None
    try:
        return oscillator_parameters(eq, None, target=None, force=None, draws=DRAWS, seed=0)
    except InputError:
        return None


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
        second = [one.law for one in eq.equations if one.chain.order == 2]
        if len(second) > 1 and len(second) == len(eq.equations) and mass is None and force is None:
            return system_parameters(second, eq.inputs, eq.equations[0].units, draws=draws, seed=seed)
        if all(one.chain.order == 1 for one in eq.equations):
            laws = [one.law for one in eq.equations]
            return first_order_parameters(laws, eq.inputs, eq.equations[0].units, draws=draws, seed=seed)
    equation = _oscillator(eq, target)
    name = equation.chain.names[0]
    span = eq.data.measured.ranges.get(name)
    if span and not span[0] <= 0.0 <= span[1] and equation.verdict.kind in ("none", "not determined"):
        raise InputError(
            f"the stiffness cannot be told: the verdict is {equation.verdict.kind!r}, and {name} is nowhere zero;"
            f" measure {name} from the position of rest (bayeq.remove_offset, --remove-offset {name})"
        )
    return physical_parameters(
        equation.law, eq.inputs, equation.units, mass=mass, force=force, span=span, draws=draws, seed=seed
    )


def _oscillator(eq: Answer, target: str | None) -> Equation:
    """The equation meant, or the only one of second order."""
    if target is not None:
        return eq[named("equation", target, [equation.target for equation in eq.equations])]
    second = [equation for equation in eq.equations if equation.chain.order == 2]
    if not second:
        raise InputError(
            "physical parameters are those of a second-order equation, x'' = ...; here there are only"
            f" {', '.join(f'{e.target} (order {e.chain.order})' for e in eq.equations)}"
        )
    if len(second) > 1:
        raise InputError(f"name one of the equations as target: {', '.join(e.target for e in second)}")
    return second[0]


# Draws whose eigenvalues are taken, of one coordinate, and the least share of them that must have as many modes as the
# mean.
MOST_DRAWS, LEAST_SHARE = 4000, 0.5


def system_parameters(
    laws: Sequence[Law], inputs: Sequence[str], units: Mapping[str, str], *, draws: int, seed: int
) -> PhysicalParameters:
    """Modes of the linear part of several equations of second order, with masses, stiffnesses and dampings as known.

    There is a law per coordinate. Of at most 4000 draws over the number of coordinates the modes are taken. InputError
    for equations without a mode that oscillates.
    """
    n = len(laws)
    count = min(draws, max(MOST_DRAWS // n, 100))
    forces = [next((u for u in inputs if u in _names(law)), None) for law in laws]
    scales = [OscillatorUnits(units, law.chain, law.unit_gains, u) for law, u in zip(laws, forces, strict=True)]
    states = [law.chain.states[0] for law in laws] + [law.chain.states[1] for law in laws]
    per_state = np.concatenate([[1.0 / s.per_length for s in scales], [s.velocity / s.per_length for s in scales]])
    linear, unexplained = np.zeros((count, n, 2 * n)), list[str]()
    driven: dict[str, dict[int, Floats]] = {}
    rng = np.random.default_rng(seed)
    for i, (law, scale) in enumerate(zip(laws, scales, strict=True)):
        for term, drawn in drawn_coefficients(law, count, rng)[1].items():
            slope = _slope(term, states)
            if slope is not None:
                linear[:, i] += drawn[:, None] * slope * per_state * scale.per_length / scale.acceleration
            elif term.text in inputs:
                driven.setdefault(term.text, {})[i] = drawn * scale.scale_force()
            elif term.text not in unexplained:
                unexplained.append(term.text)
    found, modes = _modes(linear, [law.chain.names[0] for law in laws])
    found += _matrices(linear, driven, laws, scales)
    return PhysicalParameters(tuple(found), tuple(unexplained), tuple(modes))


def _names(law: Law) -> set[str]:
    return {name for term, kept in zip(law.terms, law.posterior.support, strict=True) if kept for name in term.names}


def _slope(term: Expression, states: Sequence[str]) -> Floats | None:
    """Derivatives of a term that is linear in the states; None of another."""
    if not term.names <= set(states):
        return None
    rng, size = np.random.default_rng(0), len(states)
    points = np.vstack([np.eye(size), rng.standard_normal((8, size))])
    with np.errstate(all="ignore"):
        values = evaluate_terms([term], {name: points[:, k] for k, name in enumerate(states)})[:, 0]
    slope = values[:size]
    same = np.allclose(points @ slope, values, rtol=1e-9, atol=1e-9 * float(np.abs(slope).max(initial=0.0)))
    return np.asarray(slope) if same and np.isfinite(values).all() else None


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
                    # of coordinates without a force that of one with
                    own = next((s.unit(powers, True) for s in (scales[i], *scales) if s.force is not None), None)
                    out.append(quantity(f"{symbol}_{i + 1}{j + 1}", f"{what}, row {i + 1}", values, own))
    return out


def _known(values: Floats) -> bool:
    """Whether draws are clearly not zero."""
    low, high = np.quantile(values, [0.025, 0.975])
    return bool(low > 0.0 or high < 0.0)
