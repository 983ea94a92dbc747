"""Derivatives of the log determinant: the part -1/2 ln |H| of a Laplace approximation, by coefficients and paths.

With the path z of the states integrated out, ln p(y | theta) = -J(theta, z) - 1/2 ln |H(theta, z)| at the likeliest z,
and H, the curvature of J along the path, changes with the coefficients in two ways: on a fixed path, and because the
path moves with them, by dz/dtheta = -H^-1 d2J/(dz dtheta). Where noise of an input hides the path, the first corrects
coefficients that are too small. Where a law without random force determines the path, the second cancels the first but
for little: the first alone moved coefficients by several standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.likelihood.adjoint import Adjoint
from bayeq.likelihood.layout import NOTHING, Layout
from bayeq.likelihood.linear import Linear, derivatives_along
from bayeq.likelihood.steps import integrate

# Steps of the finite differences along the path, in its standard deviations.
STEP = 1e-4


class Determinant(NamedTuple):
    """Derivatives of the log determinant's part of the log likelihood."""

    slopes: Floats  # (C, P + 1), by every coefficient, on a fixed path
    pulls: tuple[Floats, ...]  # of each record (n, S), by the states on its path, or (0, S) if they are 0

    def beside(self, linears: Sequence[Linear]) -> list[Linear]:
        """The models with the log determinant as a further part of the log likelihood of their paths."""
        return [linear._replace(pull=pull) for linear, pull in zip(linears, self.pulls, strict=True)]


def determinant_of(layout: Layout, linears: Sequence[Linear], found: Sequence[Adjoint]) -> Determinant:
    """The derivatives at the linearisation, from adjoints that are `curved`."""
    slopes = np.zeros((layout.chains, len(layout.terms) + 1))
    for linear, adj in zip(linears, found, strict=True):
        slopes += derivatives_along(linear, adj.at_samples, adj.between)
    return Determinant(slopes, tuple(_pull(linear, adj) for linear, adj in zip(linears, found, strict=True)))


def _pull(linear: Linear, adj: Adjoint) -> Floats:
    """Derivatives by the states, (n, S): the curvature of each target along the directions of the adjoint.

    Those between samples are taken at the samples that they lie between.
    """
    path, between = linear.path, np.zeros_like(adj.at_samples)
    if linear.steps.discrete:
        between[:-1] = adj.between
    else:
        between[:-1] = 0.5 * adj.between
        between[1:] += 0.5 * adj.between
    spread, out = path.std(axis=0), np.zeros(path.shape)
    directions = np.where(spread > 0.0, adj.at_samples + between, 0.0)
    for c, bends in enumerate(np.ptp(linear.gradient[:, : directions.shape[1]], axis=0).any(axis=1)):
        along = directions[:, c]
        sizes = (np.abs(along) / np.where(spread > 0.0, spread, 1.0)).max(axis=1, keepdims=True)
        if bends and sizes.any():
            step = STEP / np.where(sizes > 0.0, sizes, 1.0)
            ahead, behind = (_gradient(linear, path + way * step * along, c) for way in (1.0, -1.0))
            finite = np.isfinite(ahead) & np.isfinite(behind)  # sqrt(x) has no derivative beside 0
            out += np.subtract(ahead, behind, out=np.zeros(path.shape), where=finite) / (2.0 * step)
    return out if out.any() else out[:0]


def _gradient(linear: Linear, path: Floats, c: int) -> Floats:
    """Derivatives of target c by the states on another path, (n, S): rates as of a map, which is not integrated."""
    (n, size), chains = path.shape, len(linear.discrepancy)
    rates = linear.steps._replace(discrete=True, substeps=np.ones(n, dtype=np.int64))
    target, gradient, sources = np.empty((n, chains)), np.empty((n, chains, size)), np.empty((n, rates.motion, 0))
    nothing, order = np.empty((0, 0)), np.arange(n)
    integrate(rates, NOTHING, False, path, order, 0, nothing, nothing[:, :, None], sources, target, gradient)
    return gradient[:, c]
