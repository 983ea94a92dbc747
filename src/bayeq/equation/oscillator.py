"""Physical parameters of whatever equations there are: of one oscillator, of several, or of first order."""

from __future__ import annotations

from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation
from bayeq.equation.modes import system_parameters
from bayeq.equation.physical import PhysicalParameters, first_order_parameters, physical_parameters
from bayeq.errors import InputError, UnknownNameError

__all__ = ["oscillator_parameters", "own_parameters"]

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
        by_target = {equation.target: equation for equation in eq.equations}
        if target not in by_target:
            raise UnknownNameError("equation", target, list(by_target))
        return by_target[target]
    second = [equation for equation in eq.equations if equation.chain.order == 2]
    if not second:
        raise InputError(
            "physical parameters are those of a second-order equation, x'' = ...; here there are only"
            f" {', '.join(f'{e.target} (order {e.chain.order})' for e in eq.equations)}"
        )
    if len(second) > 1:
        raise InputError(f"name one of the equations as target: {', '.join(e.target for e in second)}")
    return second[0]
