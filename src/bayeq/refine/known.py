"""What is known of the parameters of free runs: linear equations between them, and signs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.forecast.dynamics import Dynamics
from bayeq.inference.prior import Prior
from bayeq.regression.constraints import Constraints

__all__ = ["Known"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Known:
    """Parameters theta = offset + basis phi of `Dynamics`, by the free ones among them.

    Attributes
    ----------
    offset, basis : (p,), (p, f) arrays
        Equations between coefficients, solved.
    free : (p,) bool array
        The parameters that phi is.
    signs : (f,) int array
        Known signs of phi, 0 for unknown.
    """

    offset: Floats
    basis: Floats
    free: NDArray[np.bool_]
    signs: NDArray[np.int64]

    @classmethod
    def nothing(cls, size: int) -> Self:
        """All of `size` parameters are free."""
        return cls(np.zeros(size), np.eye(size), np.ones(size, dtype=np.bool_), np.zeros(size, dtype=np.int64))

    @classmethod
    def of(cls, dynamics: Dynamics, constraints: Sequence[Constraints]) -> Self:
        """What constraints, one per equation, say of the terms that the equations have.

        Raises
        ------
        InputError
            Terms that do not go together with the constraints, or nothing is left free.
        """
        size = dynamics.size
        offset, basis = np.zeros(size), np.zeros((size, size))
        free, signs = np.ones(size, dtype=np.bool_), np.zeros(size, dtype=np.int64)
        for block, law, one in zip(dynamics.blocks(), dynamics.laws, constraints, strict=True):
            support, equalities = law.posterior.support, one.equalities
            if not equalities.closed(support):
                raise InputError(
                    f"{law.chain.target}: the terms shown do not keep to the constraints: find the equations again"
                )
            rows = np.arange(block.stop - int(support.sum()), block.stop)  # the intercept, in front of them, is free
            kept = np.isin(np.flatnonzero(support), equalities.kept)
            basis[block.start : rows[0], block.start : rows[0]] = 1.0
            basis[np.ix_(rows, rows[kept])] = equalities.basis(support)
            offset[rows], free[rows] = equalities.offset(support), kept
            known = one.prior(Prior()).known_signs
            if known is not None:
                signs[rows[kept]] = known[support[equalities.kept]]
        if not free.any():
            raise InputError("refine: the constraints fix every coefficient: there is nothing to refine")
        return cls(offset, basis[:, free], free, signs[free])

    def full(self, phi: Floats) -> Floats:
        """All parameters, (p,)."""
        return np.asarray(self.offset + self.basis @ phi)

    def start(self, theta: Floats) -> Floats:
        """Free parameters to start from: those of theta (p,), 0 where they have not their sign."""
        phi = theta[self.free]
        return np.where(phi * self.signs < 0.0, 0.0, phi)

    def at_bound(self, phi: Floats) -> NDArray[np.bool_]:
        """Free parameters that are at the end of their range, (f,)."""
        return np.asarray((self.signs != 0) & (phi == 0.0))
