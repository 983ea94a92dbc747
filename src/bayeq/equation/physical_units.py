"""Units of an oscillator's parameters, from those of its channels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction

from bayeq.errors import InputError
from bayeq.records.units import Unit, derivative_ratio, in_si, multiply_units, parse_unit, written_unit
from bayeq.states import Chain

__all__ = ["OscillatorUnits"]

# Products of SI units that have a shorter name.
SHORTER: Mapping[str, str] = {"N*s^2/m": "kg", "N*m*s^2": "kg*m^2"}


class OscillatorUnits:
    """What the numbers of channels are in consistent units, SI where these are known.

    Consistent are a displacement, its derivatives by seconds, and a force; the factors turn coefficients of the
    channels' numbers into coefficients of those.

    Parameters
    ----------
    units : mapping of str to str
        Of channels, as far as known.
    chain : Chain
        Displacement, velocity and acceleration.
    gains : sequence of float
        From `bayeq.states.unit_gains`, what the motion says of the units; empty where it says nothing.
    force : str or None
        The input that is a force.
    in_kg : bool
        The mass is given: in kg (kg m^2, if the displacement is an angle) where the displacement's unit is known.

    Raises
    ------
    InputError
        Units that are not those of a motion and its derivatives, or not those of this motion.
    """

    def __init__(
        self,
        units: Mapping[str, str],
        chain: Chain,
        gains: Sequence[float],
        force: str | None,
        in_kg: bool = False,
    ) -> None:
        x = chain.names[0]
        self.length: Unit | None = parse_unit(units[x]) if x in units else None
        self.force: Unit | None = parse_unit(units[force]) if force is not None and force in units else None
        self.per_length = self.per_force = 1.0
        # a channel's number is this ratio times the derivative's of the displacement
        self.velocity, self.acceleration = (_ratio(units, chain, k, gains[k] if gains else None) for k in (1, 2))
        if self.length is not None:
            self.per_length, self.length = in_si(self.length) or (1.0, self.length)
        if self.force is not None:
            self.per_force, self.force = in_si(self.force) or (1.0, self.force)
        elif in_kg and self.length in ({}, {"m": Fraction(1)}):
            self.force = multiply_units({"N": Fraction(1)}, {} if self.length else {"m": Fraction(1)})

    def scale(self, powers: tuple[int, int]) -> float:
        """Of the coefficient of x**p v**q in the equation of the acceleration."""
        p, q = powers
        return self.velocity**q / self.acceleration * self.per_length ** (1 - p - q)

    def scale_force(self) -> float:
        """Of the coefficient of the force."""
        return self.per_length / (self.acceleration * self.per_force)

    def displacement(self) -> str | None:
        """Unit of the displacement; None where it is not known."""
        return None if self.length is None else _written(self.length)

    def mass(self) -> str | None:
        """Unit of the mass; None where it is not known."""
        if self.length is None or self.force is None:
            return None
        return _written(multiply_units(multiply_units(dict(self.force), self.length, -1), {"s": Fraction(2)}))

    def unit(self, powers: tuple[int, int], with_mass: bool) -> str | None:
        """Unit of the parameter of x**p v**q, as a force or per unit of mass; None where it is not known."""
        p, q = powers
        if self.length is None or (with_mass and self.force is None):
            return None
        if with_mass:
            assert self.force is not None
            out = dict(self.force)
        else:
            out = multiply_units(dict(self.length), {"s": Fraction(-2)})
        multiply_units(out, self.length, -(p + q))
        return _written(multiply_units(out, {"s": Fraction(q)}))


def _ratio(units: Mapping[str, str], chain: Chain, order: int, gain: float | None) -> float:
    """Factor of a derivative's channel to the derivative of the displacement's; `gain` is what the motion says."""
    x, other = chain.names[0], chain.names[order]
    if x not in units or other not in units:
        return 1.0 if gain is None else gain
    stated, what = derivative_ratio(units[x], units[other], order), f"{'second ' * (order == 2)}derivative of {x}"
    if stated is None:
        raise InputError(f"{other} in {units[other]} is no {what} in {units[x]}: state units that fit, or none")
    if gain is not None and not math.isclose(abs(gain), stated, rel_tol=1e-9):
        raise InputError(
            f"{other} in {units[other]} should be {stated:.4g} times the {what} in {units[x]}, but it is {gain:.4g}"
            " times that: state the units that the channels have, or none"
        )
    return stated if gain is None else gain


def _written(unit: Unit) -> str:
    """``N*s/m``; a shorter name where there is one, and no text of a pure number."""
    order = sorted(unit.items(), key=lambda item: ({"N": 0, "m": 1, "s": 2}.get(item[0], -1), item[0]))
    text = written_unit(dict(order)) if unit else ""
    return SHORTER.get(text, text)
