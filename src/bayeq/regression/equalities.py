"""Linear equations between the coefficients of a regression, as algebra on its Gram matrix.

Each equation eliminates one coefficient. With e the eliminated and k the kept ones, theta_e = q + C theta_k, the
regression of y - D_e q on D_k + D_e C has all its statistics in those of y on D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats
from bayeq.errors import InputError
from bayeq.inference.gram import Gram
from bayeq.inference.posterior import Averaged, Draws, ModelAverage, Posterior

# A difference smaller than this share of its operands is rounding, and taken as 0.
ROUNDING = 1e-12


def _sum(a: float, b: float) -> float:
    return 0.0 if abs(a + b) <= ROUNDING * (abs(a) + abs(b)) else a + b


@dataclass(frozen=True, slots=True)
class Linear:
    """A linear combination of coefficients and a constant."""

    # factor of each coefficient by its place in the dictionary, in the order of the text; none is 0
    slopes: dict[int, float]
    constant: float

    def plus(self, other: Linear, factor: float = 1.0) -> Linear:
        """The sum of this combination and a multiple of another; terms that cancel up to rounding are dropped."""
        slopes = dict(self.slopes)
        for j, slope in other.slopes.items():
            slopes[j] = _sum(slopes.get(j, 0.0), factor * slope)
        return Linear({j: s for j, s in slopes.items() if s != 0.0}, _sum(self.constant, factor * other.constant))

    def times(self, factor: float) -> Linear:
        """This combination times a factor."""
        return Linear({}, 0.0).plus(self, factor)

    def without(self, j: int, value: Linear) -> Linear:
        """The combination with coefficient j replaced by `value`, the combination that it equals."""
        if j not in self.slopes:
            return self
        rest = {i: slope for i, slope in self.slopes.items() if i != j}
        return Linear(rest, self.constant).plus(value, self.slopes[j])


@dataclass(frozen=True, eq=False)
class Equalities:
    """Solved linear equations theta_e = q + C theta_k.

    Examples
    --------
    >>> half = Linear({0: 1.0, 1: -0.5}, 0.0)  # theta_0 - 0.5 theta_1 = 0
    >>> Equalities.solving(("x", "v", "u"), [(half, "x == 0.5*v")]).slopes
    array([[0.5, 0. ]])
    """

    names: tuple[str, ...]  # the P terms
    kept: NDArray[np.intp]  # (F,), terms that remain for inference
    eliminated: NDArray[np.intp]  # (E,), terms whose coefficients follow from those of the kept ones
    slopes: Floats  # (E, F), C
    offsets: Floats  # (E,), q

    @property
    def equations(self) -> list[tuple[dict[int, float], float]]:
        """The solved equations: factors of coefficients, the eliminated one first, by place; the value of their sum."""
        return [
            ({int(e): 1.0, **{int(self.kept[k]): -float(row[k]) for k in np.flatnonzero(row)}}, float(value))
            for e, row, value in zip(self.eliminated, self.slopes, self.offsets, strict=True)
        ]

    def basis(self, support: Bools) -> Floats:
        """Derivatives (r, f) of the coefficients of terms, `support` (P,), with respect to the kept ones among them."""
        return self._jacobian(support, support[self.kept])

    def offset(self, support: Bools) -> Floats:
        """Coefficients (r,) of terms, `support` (P,), if those of the kept ones among them are 0."""
        whole = np.zeros(len(self.names))
        whole[self.eliminated] = self.offsets
        return whole[support]

    def closed(self, support: Bools) -> bool:
        """Whether the eliminated terms in `support` (P,) are exactly those that follow from the kept terms in it."""
        return bool((self._any(support[self.kept]) == support).all())

    @classmethod
    def solving(cls, names: Sequence[str], equations: Sequence[tuple[Linear, str]]) -> Equalities:
        """Solve equations (a combination that is zero, and where it was stated), each for its first term if it can
        be; an InputError refuses those that contradict each other, or leave no term to find."""
        solved: dict[int, Linear] = {}
        for equation, where in equations:
            rest = equation
            for j, value in solved.items():
                rest = rest.without(j, value)
            first = next((j for j in (*equation.slopes, *rest.slopes) if j in rest.slopes), None)
            if first is None:
                if rest.constant != 0.0:
                    raise InputError(f"{where}: contradicts itself or the constraints before it")
                continue
            slope = rest.slopes[first]
            value = Linear({j: s for j, s in rest.slopes.items() if j != first}, rest.constant).times(-1.0 / slope)
            solved = {j: other.without(first, value) for j, other in solved.items()} | {first: value}
        if len(solved) == len(names):
            raise InputError("the constraints fix every coefficient: nothing is left to find")
        eliminated = np.array(sorted(solved), dtype=np.intp)
        kept = np.setdiff1d(np.arange(len(names)), eliminated)
        slopes = np.zeros((len(eliminated), len(names)))
        for row, j in zip(slopes, eliminated, strict=True):
            row[list(solved[int(j)].slopes)] = list(solved[int(j)].slopes.values())
        offsets = np.array([solved[int(j)].constant for j in eliminated], dtype=np.float64)
        if not (np.isfinite(slopes).all() and np.isfinite(offsets).all()):
            raise InputError("constraints: numbers too far apart to solve the equations")
        return cls(tuple(names), kept, eliminated, slopes[:, kept], offsets)

    def reduce(self, gram: Gram) -> Gram:
        """Statistics of y - D_e q on D_k + D_e C; columns that cancel up to rounding become zeros."""
        if not len(self.eliminated):
            return gram
        k, e, C, q = self.kept, self.eliminated, self.slopes, self.offsets
        cross, own = gram.DtD[np.ix_(e, k)], gram.DtD[np.ix_(e, e)]
        mixed = C.T @ cross
        DtD = gram.DtD[np.ix_(k, k)] + (mixed + mixed.T) + C.T @ (own @ C)
        Dty = gram.Dty - q @ gram.DtD[e]
        Dty = Dty[k] + C.T @ Dty[e]
        yty, moved = gram.yty, float(q @ own @ q)
        rest = yty - 2.0 * float(q @ gram.Dty[e]) + moved
        gone = np.diagonal(DtD) <= ROUNDING * (gram.diagonal[k] + gram.diagonal[e] @ C**2)
        gone &= (C != 0.0).any(axis=0)
        DtD[gone], DtD[:, gone], Dty[gone] = 0.0, 0.0, 0.0
        if rest <= ROUNDING * (yty + moved):
            rest, Dty = 0.0, np.zeros_like(Dty)
        return replace(
            gram,
            names=tuple(self.names[j] for j in k),
            mean=gram.mean[k] + C.T @ gram.mean[e],
            target_mean=gram.target_mean - float(q @ gram.mean[e]),
            DtD=DtD,
            Dty=Dty,
            yty=rest,
        )

    def expand(self, posterior: Posterior, gram: Gram) -> Posterior:
        """The posterior of all P coefficients from that of the reduced regression; `gram` is the one before `reduce`.

        An eliminated term is in where a constant or one of the terms that it follows from is.
        """
        if not len(self.eliminated):
            return posterior
        support = self._any(posterior.support)
        jacobian = self._jacobian(support, posterior.support)
        draws = None if posterior.draws is None else self._draws(posterior.draws)
        average = None if posterior.average is None else self._average(posterior.average)
        averaged, optimum = posterior.averaged, posterior.details.optimum
        if averaged is not None:
            averaged = Averaged(self._values(averaged.coef), self._averaged_sd(posterior, averaged, draws), draws)
        return replace(
            posterior,
            names=self.names,
            pip=self._pip(posterior, average, draws),
            support=support,
            coef=self._values(posterior.coef),
            covariance=jacobian @ posterior.covariance @ jacobian.T,
            constant=replace(posterior.constant, center=gram.mean, mean=gram.target_mean),
            details=replace(posterior.details, optimum=None if optimum is None else self._any(optimum)),
            averaged=averaged,
            average=average,
        )

    def _full(self, kept: NDArray[Any], eliminated: NDArray[Any]) -> NDArray[Any]:
        """Values of kept and of eliminated terms (along the last axis) in the order of all P terms."""
        out = np.empty((*kept.shape[:-1], len(self.names)), dtype=kept.dtype)
        out[..., self.kept], out[..., self.eliminated] = kept, eliminated
        return out

    def _values(self, theta: Floats) -> Floats:
        return self._full(theta, theta @ self.slopes.T + self.offsets)

    def _any(self, inside: Bools) -> Bools:
        """Which of all P terms are in, given which of the kept terms are, `inside` (..., F)."""
        linked = (self.slopes != 0.0).T.astype(np.float64)
        return self._full(inside, (inside @ linked > 0.5) | (self.offsets != 0.0))

    def _jacobian(self, rows: Bools, columns: Bools) -> Floats:
        """Derivatives of some of the coefficients with respect to some of the kept ones."""
        whole = np.zeros((len(self.names), len(self.kept)))
        whole[self.kept, np.arange(len(self.kept))] = 1.0
        whole[self.eliminated] = self.slopes
        return whole[np.ix_(rows, columns)]

    def _pip(self, posterior: Posterior, average: ModelAverage | None, draws: Draws | None) -> Floats:
        if average is not None:
            pip = np.minimum(average.probability @ average.models[:, self.eliminated], 1.0)
        elif draws is not None:
            pip = draws.pip[:, self.eliminated].mean(axis=0)
        else:
            pip = np.where(self.slopes != 0.0, posterior.pip, 0.0).max(axis=1)
        return self._full(posterior.pip, np.where(self.offsets != 0.0, 1.0, pip))

    def _averaged_sd(self, posterior: Posterior, averaged: Averaged, draws: Draws | None) -> Floats:
        sd, average = averaged.sd, posterior.average
        if draws is not None:
            found = draws.theta[..., self.eliminated].std(axis=(0, 1))
        elif average is not None and len(average.terms) == np.count_nonzero(average.models.any(axis=0)):
            C = self.slopes[:, average.terms]
            found = np.sqrt(np.maximum(np.einsum("ei,ij,ej->e", C, average.covariance, C), 0.0))
        else:
            # without covariances an upper bound, which is exact for a term that follows from one other term
            found = np.abs(self.slopes) @ sd
        return self._full(sd, found)

    def _draws(self, draws: Draws) -> Draws:
        z = self._any(draws.z)
        return replace(
            draws, z=z, theta=self._values(draws.theta), pip=self._full(draws.pip, z[..., self.eliminated].mean(axis=1))
        )

    def _average(self, average: ModelAverage) -> ModelAverage:
        listed = np.zeros(len(self.kept), dtype=np.bool_)
        listed[average.terms] = True
        among = self._any(listed)
        jacobian = self._jacobian(among, listed)
        return replace(
            average,
            models=self._any(average.models),
            terms=np.flatnonzero(among),
            covariance=jacobian @ average.covariance @ jacobian.T,
        )
