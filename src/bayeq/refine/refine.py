"""`refine`: posteriors of coefficients that make the free run, not the single step, come close to records."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import RecordError
from bayeq.expressions import Expression
from bayeq.forecast.dynamics import Dynamics, finest_step
from bayeq.forecast.free_run import state_range
from bayeq.forecast.results import Refinement, Scores
from bayeq.forecast.rows import Rows, predicted_target, rows_of
from bayeq.forecast.score import score_rows
from bayeq.inference.posterior import Posterior
from bayeq.ode.rk4 import Drive, Interpolation
from bayeq.records import Record
from bayeq.refine.measured import Measured, Piece
from bayeq.refine.output_error import OutputError, Unrefined, follows_better, output_error
from bayeq.regression.residuals import Fit, Residuals, inspect_residuals
from bayeq.states import Chain, Roles, Smooth, estimate_motion
from bayeq.states.motion import held_out_share

__all__ = ["LEAST_ROWS", "RefinedEquation", "RefinedEquations", "refine"]

Floats = NDArray[np.float64]

# With fewer rows there is no free run to speak of.
LEAST_ROWS = 8

# Rows that stand for an intercept without error.
MOST_ROWS = 1e300


@dataclass(frozen=True, eq=False)
class RefinedEquation:
    """What output error changes of an equation; see the attributes of `bayeq.Equation`."""

    posterior: Posterior
    train: Fit
    held_out: Fit | None
    residuals: Residuals


@dataclass(frozen=True, eq=False)
class RefinedEquations:
    """The equations in their order, how they were refined, and how they do on the rows held out."""

    equations: tuple[RefinedEquation, ...]
    summary: Refinement
    scores: Scores | None


def refine(
    dynamics: Dynamics,
    records: Sequence[Record],
    *,
    smooth: Smooth,
    segment: int | None,
    holdout: float,
    interpolation: Interpolation | None,
) -> RefinedEquations | Unrefined:
    """Output-error estimate of the coefficients and intercepts.

    Parameters
    ----------
    dynamics : Dynamics
        The equations, by regression; an intercept that they lack is zero.
    records : sequence of Record
        With the channels that the equations were found from.
    smooth
        As `discover` takes it.
    segment, holdout, interpolation
        See `bayeq.Equations.refine`.

    Raises
    ------
    InputError
        Channels that are missing, no time, too few rows.
    """
    chains, inputs, means = dynamics.chains, dynamics.inputs, dynamics.mean
    names = [name for chain in chains for name in chain.measured if name is not None]
    rows = _rows(chains, inputs, records, smooth, holdout, interpolation or "cubic")
    measured = _measured(dynamics, means, rows, names)
    if interpolation is None and inputs:
        straight = [(whole.interpolated(inputs, "linear"), cut) for whole, cut in rows]
        other = _measured(dynamics, means, straight, names)
        interpolation = "linear" if follows_better(other, measured, means, segment) else "cubic"
        rows, measured = (straight, other) if interpolation == "linear" else (rows, measured)
    found = output_error(measured, means, dynamics.covariance, segment)
    if isinstance(found, Unrefined):
        return found
    train = [whole.part(slice(0, cut)) for whole, cut in rows]
    held_out = [whole.part(slice(cut, whole.n)) for whole, cut in rows if cut < whole.n]
    refined = []
    for k, block in enumerate(dynamics.blocks()):
        parameters, covariance = found.parameters[block], found.covariance[block, block]
        residuals = [_residual(chains[k].target, dynamics.terms[k], parameters, rows) for rows in train]
        noise = sum(float(e @ e) for e in residuals) / max(sum(map(len, residuals)) - len(parameters), 1)
        channels = {name: [rows.columns[name] for rows in train] for name in (*inputs, *chains[k].states)}
        fits = [_fit(chains[k].target, dynamics.terms[k], parameters, part) for part in (train, held_out)]
        assert fits[0] is not None
        refined.append(
            RefinedEquation(
                _posterior(dynamics.laws[k].posterior, parameters, covariance, noise),
                fits[0],
                fits[1],
                inspect_residuals(residuals, channels),
            )
        )
    return RefinedEquations(
        tuple(refined),
        _summary(found, chains, records, measured.rows, names, interpolation or "cubic"),
        score_rows(dynamics, found.parameters, held_out) if held_out else None,
    )


def _summary(
    found: OutputError,
    chains: Sequence[Chain],
    pieces: Sequence[Record],
    rows: int,
    names: Sequence[str],
    interpolation: Interpolation,
) -> Refinement:
    return Refinement(
        files=tuple(piece.name for piece in pieces),
        n=rows,
        segments=found.segments,
        longest=found.longest,
        noise_sd=dict(zip(names, found.noise_sd.tolist(), strict=True)),
        unseen_sd=dict(zip((chain.target for chain in chains), found.unseen_sd.tolist(), strict=True)),
        interpolation=interpolation,
        converged=found.converged,
    )


def _rows(
    chains: Sequence[Chain],
    inputs: Sequence[str],
    pieces: Sequence[Record],
    smooth: Smooth,
    holdout: float,
    interpolation: Interpolation,
) -> list[tuple[Rows, int]]:
    """Rows of each record, with the states as `discover` has them, and the first of those that are held out."""
    share = held_out_share(holdout, sum(piece.n for piece in pieces))
    motion = estimate_motion(pieces, Roles(tuple(chains), tuple(inputs)), smooth, share)
    out = []
    for piece, rows, cut in zip(pieces, rows_of(motion, "refine", interpolation), motion.cuts, strict=True):
        if cut < LEAST_ROWS:
            raise RecordError(f"{piece.name or 'record'}: {cut} rows are too few to refine on (at least {LEAST_ROWS})")
        out.append((rows, cut))
    return out


def _measured(dynamics: Dynamics, means: Floats, whole: Sequence[tuple[Rows, int]], names: Sequence[str]) -> Measured:
    pieces = [
        Piece(
            rows.time,
            rows.driven,
            rows.stack(dynamics.states),
            np.column_stack([rows.samples[name] for name in names]),
        )
        for rows in (each.part(slice(0, cut)) for each, cut in whole)
    ]
    size = len(dynamics.states)
    places = {
        **{name: i for i, name in enumerate(dynamics.states)},
        **{target: size + k for k, target in enumerate(dynamics.targets)},
    }
    limits = state_range(np.concatenate([piece.states for piece in pieces]))
    return Measured(
        dynamics,
        pieces,
        np.array([places[name] for name in names], dtype=np.uint32),
        min(finest_step(dynamics, means, p.states, Drive.over(p.time, p.inputs, *limits)) for p in pieces),
        *limits,
    )


def _posterior(before: Posterior, parameters: Floats, covariance: Floats, noise: float) -> Posterior:
    """A posterior with coefficients and intercept from output error; terms and probabilities stay."""
    support = before.support
    r = int(support.sum())
    coef, center = np.zeros(len(support)), np.zeros(len(support))
    coef[support], spread = parameters[-r:], covariance[-r:, -r:]
    intercept, left = 0.0, 0.0
    if len(parameters) > r:
        # intercept = target_mean - center'coef: with this center its covariance with the coefficients is what was
        # found, and what is left of its variance stands as noise_variance/n
        center[support] = -np.linalg.solve(spread, covariance[1:, 0])
        intercept = float(parameters[0])
        left = float(covariance[0, 0] - center[support] @ spread @ center[support])
    return replace(
        before,
        coef=coef,
        covariance=spread,
        center=center,
        target_mean=intercept + float(center @ coef),
        noise_variance=noise,
        # as many rows as make the variance of the intercept noise_variance/n; an intercept of zero is known exactly
        n=min(noise / max(left, 1e-300), MOST_ROWS),
        averaged_coef=None,
        averaged_sd=None,
        draws=None,
    )


def _residual(target: str, terms: Sequence[Expression], parameters: Floats, rows: Rows) -> Floats:
    """What the equation leaves of the target at each row."""
    return np.asarray(rows.columns[target] - predicted_target(terms, parameters, rows.columns))


def _fit(target: str, terms: Sequence[Expression], parameters: Floats, pieces: Sequence[Rows]) -> Fit | None:
    if not pieces:
        return None
    whole = np.concatenate([rows.columns[target] for rows in pieces])
    residual = np.concatenate([_residual(target, terms, parameters, rows) for rows in pieces])
    variance = float(whole.var())
    share = float(np.mean(residual**2)) / variance if variance > 0 else 1.0
    return Fit(n=len(whole), r2=1.0 - share, nrmse=math.sqrt(share))
