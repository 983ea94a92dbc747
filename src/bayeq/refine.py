"""`refine`: equations whose coefficients make the free run, not the single step, come close to records."""

from __future__ import annotations

import math
import operator
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bayeq.diagnostics import inspect_residuals
from bayeq.dynamics import Dynamics, finest_step, require_time
from bayeq.equation import Equation, Fit
from bayeq.errors import ConvergenceWarning, InputError, RecordError
from bayeq.forecast import check_interpolation
from bayeq.free_run import state_range
from bayeq.integrate import Interpolation, interpolant
from bayeq.output_error import OutputError, Refinement, Unrefined, output_error
from bayeq.posterior import Posterior
from bayeq.records import Record
from bayeq.shooting import Measured, Piece
from bayeq.states import derive_all
from bayeq.states.grid import on_grid

if TYPE_CHECKING:
    from bayeq.equations import Equations

__all__ = ["refine"]

Floats = NDArray[np.float64]

# With fewer rows none are held out (as in `discover`); with fewer than this there is no free run to speak of.
LEAST_ROWS_TO_HOLD_OUT = 50
LEAST_ROWS = 8

# Rows that stand for an intercept without error.
MOST_ROWS = 1e300


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of one record, with everything known about them.

    Attributes
    ----------
    columns : mapping of str to (n,) array
        States, targets (measured, where they are) and inputs.
    channels : (n, m) array
        What was measured; NaN where a sample is missing.
    """

    time: Floats
    columns: Mapping[str, Floats]
    channels: Floats

    def part(self, rows: slice) -> _Rows:
        columns = {name: values[rows] for name, values in self.columns.items()}
        return _Rows(self.time[rows], columns, self.channels[rows])


def refine(
    equations: Equations,
    records: Record | Sequence[Record],
    *,
    segment: int | None = None,
    holdout: float = 0.2,
    intercept: bool | None = None,
    interpolation: Interpolation = "cubic",
) -> Equations:
    """Output-error estimate of the coefficients and intercepts; see `bayeq.Equations.refine`."""
    pieces = [records] if isinstance(records, Record) else list(records)
    if not pieces or not all(isinstance(piece, Record) for piece in pieces):
        raise InputError("refine needs a Record or a list of Records")
    check_interpolation(interpolation)
    if not 0 <= holdout < 1:
        raise InputError(f"holdout is a share of the rows, 0 <= holdout < 1, got {holdout!r}")
    if segment is not None and operator.index(segment) < LEAST_ROWS:
        raise InputError(f"segment is a number of rows, at least {LEAST_ROWS}, got {segment}")
    posteriors = [equation.posterior for equation in equations]
    for equation in equations:
        if not equation.included:
            raise InputError(f"{equation.target}: no terms are included, there is nothing to refine")
    dynamics = Dynamics.of(
        equations.chains,
        equations.inputs,
        posteriors,
        [e.terms for e in equations],
        [e.intercept_matters if intercept is None else intercept for e in equations],
    )
    measured_names = [name for chain in equations.chains for name in chain.measured if name is not None]
    train, held_out = _split(equations, pieces, measured_names, holdout)
    measured = _measured(dynamics, posteriors, train, measured_names, interpolation)
    found = output_error(measured, dynamics.means(posteriors), dynamics.covariance(posteriors), segment)
    if isinstance(found, Unrefined):
        warnings.warn(
            f"not refined: {found.reason}; the equations are returned as they were", ConvergenceWarning, stacklevel=3
        )
        return equations
    notes = list(equations.warnings)
    if not found.converged:
        notes.append("the output-error estimate did not converge: its steps ended at their limit")
        warnings.warn(notes[-1], ConvergenceWarning, stacklevel=3)
    refined = [
        _refined(equation, found.parameters[block], found.covariance[block, block], train, held_out, equations.inputs)
        for equation, block in zip(equations, dynamics.blocks(), strict=True)
    ]
    return replace(
        equations,
        equations=tuple(refined),
        warnings=tuple(notes),
        refined=_summary(found, pieces, measured.rows, measured_names),
    )


def _summary(found: OutputError, pieces: Sequence[Record], rows: int, names: Sequence[str]) -> Refinement:
    return Refinement(
        files=tuple(piece.name for piece in pieces),
        n=rows,
        segments=found.segments,
        longest=found.longest,
        noise_sd=dict(zip(names, found.noise_sd.tolist(), strict=True)),
        start_sd={
            name: value if math.isfinite(value) else None
            for name, value in zip(names, found.start_sd.tolist(), strict=True)
        },
        converged=found.converged,
    )


def _split(
    equations: Equations, pieces: Sequence[Record], names: Sequence[str], holdout: float
) -> tuple[list[_Rows], list[_Rows]]:
    """Training rows and the last rows of each record, held out, with the states as `discover` has them."""
    for piece in pieces:
        require_time(piece, "refine")
    share = holdout if sum(piece.n for piece in pieces) >= LEAST_ROWS_TO_HOLD_OUT else 0.0
    found = derive_all(pieces, equations.chains, equations.inputs, equations.smooth, share)
    train, held_out = [], []
    for piece, states in zip(pieces, found, strict=True):
        filled = piece if states.n == piece.n else on_grid(piece, names, equations.inputs)
        rows = _Rows(
            require_time(filled, "refine"),
            {**states.columns, **states.measured},
            np.column_stack([filled[name] for name in names]),
        )
        cut = states.n - int(share * states.n)
        if cut < LEAST_ROWS:
            raise RecordError(f"{piece.name or 'record'}: {cut} rows are too few to refine on (at least {LEAST_ROWS})")
        train.append(rows.part(slice(0, cut)))
        if cut < states.n:
            held_out.append(rows.part(slice(cut, states.n)))
    return train, held_out


def _measured(
    dynamics: Dynamics,
    posteriors: Sequence[Posterior],
    train: Sequence[_Rows],
    names: Sequence[str],
    interpolation: Interpolation,
) -> Measured:
    pieces = [
        Piece(
            rows.time,
            interpolant(
                rows.time,
                np.column_stack([rows.columns[name] for name in dynamics.inputs])
                if dynamics.inputs
                else np.empty((len(rows.time), 0)),
                interpolation,
            ),
            np.column_stack([rows.columns[name] for name in dynamics.states]),
            rows.channels,
        )
        for rows in train
    ]
    means = dynamics.means(posteriors)
    low, high = state_range(np.concatenate([piece.states for piece in pieces]))
    size = len(dynamics.states)
    places = {
        **{name: i for i, name in enumerate(dynamics.states)},
        **{t: size + k for t, k in dynamics.slopes.items()},
    }
    return Measured(
        dynamics,
        pieces,
        np.array([places[name] for name in names], dtype=np.uint32),
        min(finest_step(dynamics, means, piece.states, piece.inputs, piece.time) for piece in pieces),
        low,
        high,
    )


def _refined(
    equation: Equation,
    parameters: Floats,
    covariance: Floats,
    train: Sequence[_Rows],
    held_out: Sequence[_Rows],
    inputs: Sequence[str],
) -> Equation:
    """An equation with coefficients from output error; terms and probabilities stay."""
    before = equation.posterior
    support = before.support
    r = int(support.sum())
    coef, center = np.zeros(len(support)), np.zeros(len(support))
    coef[support], spread = parameters[-r:], covariance[-r:, -r:]
    intercept, left = 0.0, 0.0
    if len(parameters) > r:
        # intercept = target_mean - center'coef: with this center its covariance with the coefficients is what was found,
        # and what is left of its variance stands as noise_variance/n
        center[support] = -np.linalg.solve(spread, covariance[1:, 0])
        intercept = float(parameters[0])
        left = float(covariance[0, 0] - center[support] @ spread @ center[support])
    after = replace(
        before,
        coef=coef,
        covariance=spread,
        center=center,
        target_mean=intercept + float(center @ coef),
        averaged_coef=None,
        averaged_sd=None,
        draws=None,
    )
    residuals = [_residual(equation, after, rows) for rows in train]
    noise = sum(float(e @ e) for e in residuals) / max(sum(map(len, residuals)) - len(parameters), 1)
    # as many rows as make the variance of the intercept noise_variance/n; an intercept of zero is known exactly
    after = replace(after, noise_variance=noise, n=min(noise / max(left, 1e-300), MOST_ROWS))
    channels = {name: [rows.columns[name] for rows in train] for name in (*inputs, *equation.chain.states)}
    return replace(
        equation,
        posterior=after,
        train=_fit(equation, after, train),
        held_out=_fit(equation, after, held_out) if held_out else None,
        residuals=inspect_residuals(residuals, channels),
    )


def _residual(equation: Equation, posterior: Posterior, rows: _Rows) -> Floats:
    """What the equation leaves of the target at each row."""
    return rows.columns[equation.target] - replace(equation, posterior=posterior).predict(rows.columns)


def _fit(equation: Equation, posterior: Posterior, pieces: Sequence[_Rows]) -> Fit:
    target = np.concatenate([rows.columns[equation.target] for rows in pieces])
    residual = np.concatenate([_residual(equation, posterior, rows) for rows in pieces])
    variance = float(target.var())
    share = float(np.mean(residual**2)) / variance if variance > 0 else 1.0
    return Fit(n=len(target), r2=1.0 - share, nrmse=math.sqrt(share))
