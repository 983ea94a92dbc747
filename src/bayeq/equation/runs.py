"""The methods of `Equations` that integrate them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Self

from bayeq.equation.data import EquationsBase
from bayeq.equation.equation import Equation
from bayeq.errors import ConvergenceWarning, InputError, UnknownNameError
from bayeq.records import Record

if TYPE_CHECKING:
    from bayeq.equation.physical import PhysicalParameters
    from bayeq.forecast.results import Scores
    from bayeq.forecast.run import Forecast
    from bayeq.ode.rk4 import Interpolation

__all__ = ["EquationsRuns"]

LAST = 0.2  # scored where no rows were held out


class EquationsRuns(EquationsBase):
    """Free run, scores, output error and physical parameters; a part of `Equations`."""

    def simulate(
        self,
        record: Record,
        *,
        initial: Mapping[str, float] | None = None,
        draws: int = 200,
        seed: int = 0,
        start: int = 0,
        rows: int | None = None,
        interpolation: Interpolation | None = None,
    ) -> Forecast:
        """Free run of all equations together, driven by the inputs of a record.

        Parameters
        ----------
        record : Record
            Times and inputs; states where they are measured.
        initial : mapping of str to float, optional
            States at the first row; by default those with which the run follows the first period of the record best,
            looked for from what was measured, smoothed or estimated there.
        draws, seed : int
            Further runs with intercepts and coefficients drawn from their normal posterior given the included terms,
            for the bands; 0 for none. The initial state is the same for all.
        start, rows : int
            First row, and how many; by default all that follow.
        interpolation : "cubic", "linear" or "hold", optional
            Inputs between their samples: a cubic spline (by default, unless refined with another), straight lines, the
            last sample (commands).

        Returns
        -------
        Forecast
            ``mean``, ``low`` and ``high`` of every state, ``nrmse`` of those measured; ``plot()``, ``table()``. A run
            that leaves a thousand times the range of the record, or is not finite, stops: see ``blew_up_at``.

        Raises
        ------
        InputError
            No time, an input that is missing, an initial state that is neither measured nor given, rows out of range.
        """
        from bayeq.forecast.dynamics import Dynamics
        from bayeq.forecast.run import forecast

        posteriors = [equation.posterior for equation in self.equations]
        return forecast(
            Dynamics.of(self.chains, self.inputs, posteriors, [e.terms for e in self.equations]),
            posteriors,
            record,
            self.smooth,
            initial=initial,
            draws=draws,
            seed=seed,
            start=start,
            rows=rows,
            interpolation=_between(self, interpolation),
            units={name: unit for equation in self.equations for name, unit in equation.units.items()},
        )

    def score(
        self,
        records: Record | Sequence[Record],
        *,
        start: int | None = None,
        rows: int | None = None,
        interpolation: Interpolation | None = None,
    ) -> Scores:
        """Errors of the single step and of the free run, by default on the rows held out.

        Parameters
        ----------
        records : Record or sequence of Record
            With the channels that the equations were found from.
        start, rows : int, optional
            First row, and how many; by default the last of each record, as many as were held out (a fifth, if none).
        interpolation : "cubic", "linear" or "hold", optional
            See `simulate`.

        Returns
        -------
        Scores
            Normalised by the standard deviation of the channels on these rows.

        Raises
        ------
        InputError
            As `simulate`, and channels that are missing.
        """
        from bayeq.forecast.dynamics import Dynamics
        from bayeq.forecast.score import score_records

        posteriors = [equation.posterior for equation in self.equations]
        dynamics = Dynamics.of(self.chains, self.inputs, posteriors, [e.terms for e in self.equations])
        # half a row more: what is rounded down then is the number of rows that were held out
        share = (self.data.n_held_out + 0.5) / self.data.n if self.data.n_held_out else LAST
        return score_records(
            dynamics,
            dynamics.means(posteriors),
            _as_list(records, "score"),
            self.smooth,
            start=start,
            rows=rows,
            share=share,
            interpolation=_between(self, interpolation),
        )

    def refine(
        self,
        records: Record | Sequence[Record],
        *,
        segment: int | None = None,
        holdout: float = 0.2,
        intercept: bool | None = None,
        interpolation: Interpolation | None = None,
    ) -> Self:
        """The same terms with coefficients by output error: those whose free run comes closest to what was measured.

        Multiple shooting (Bock 1981): a record is divided into segments, each a free run from an initial state of its
        own, fitted with the coefficients and intercepts of all equations to every measured channel. Segments get longer
        from fit to fit, up to the whole record, while their runs follow it. The noise of the channels, and forces that
        the record does not show (noise in a measured one), are then estimated with the coefficients: a Kalman filter
        leads the runs along the record where such forces drive it away.

        Output error needs no derivatives. It gains most where these were not measured, or samples are few per period.
        Where it knows no more than the regression does, the equations are returned as they were.

        Parameters
        ----------
        records : Record or sequence of Record
            With the channels that the equations were found from, and time.
        segment : int, optional
            Rows of a segment, instead of the longest with which runs follow the record.
        holdout : float
            Share of the rows, the last of each record, that is not used.
        intercept : bool, optional
            Estimate the intercepts, or set them to zero; by default each is zero unless its interval excludes that.
        interpolation : "cubic", "linear" or "hold", optional
            See `simulate`; by default a cubic spline or straight lines, whichever runs follow better.

        Returns
        -------
        Equations
            Coefficients, covariances, intercepts, noise and fits are new; terms, inclusion probabilities and runners-up
            those of the regression. ``refined`` says how.

        Raises
        ------
        InputError
            No time, too few rows, channels that are missing, no terms to refine, constraints.

        Warns
        -----
        ConvergenceWarning
            Nothing better was found, and why.
        """
        from bayeq.forecast.rows import check_interpolation, whole_number
        from bayeq.refine.output_error import Unrefined
        from bayeq.refine.refine import LEAST_ROWS, refine

        pieces = _as_list(records, "refine")
        check_interpolation(interpolation)
        if not 0 <= holdout < 1:
            raise InputError(f"holdout is a share of the rows, 0 <= holdout < 1, got {holdout!r}")
        if segment is not None:
            whole_number("segment, a number of rows,", segment, LEAST_ROWS)
        if self.constraints:
            raise InputError(f"refine cannot keep to what is known of coefficients: {'; '.join(self.constraints)}")
        for equation in self.equations:
            if not equation.included:
                raise InputError(f"{equation.target}: no terms are included, there is nothing to refine")
        found = refine(
            self.chains,
            self.inputs,
            [equation.posterior for equation in self.equations],
            [equation.terms for equation in self.equations],
            pieces,
            smooth=self.smooth,
            intercepts=[e.intercept_matters if intercept is None else intercept for e in self.equations],
            segment=segment,
            holdout=holdout,
            interpolation=interpolation,
        )
        if isinstance(found, Unrefined):
            message = f"not refined: {found.reason}; the equations are returned as they were"
            warnings.warn(message, ConvergenceWarning, stacklevel=2)
            return self
        notes = self.warnings
        if not found.summary.converged:
            notes = (*notes, "the output-error estimate did not converge: its steps ended at their limit")
            warnings.warn(notes[-1], ConvergenceWarning, stacklevel=2)
        return replace(
            self,
            equations=tuple(
                replace(old, posterior=new.posterior, train=new.train, held_out=new.held_out, residuals=new.residuals)
                for old, new in zip(self.equations, found.equations, strict=True)
            ),
            warnings=notes,
            scores=found.scores,
            refined=found.summary,
        )

    def physical(
        self,
        mass: float | None = None,
        *,
        target: str | None = None,
        force: str | None = None,
        draws: int = 10_000,
        seed: int = 0,
    ) -> PhysicalParameters:
        """Mass, damping, stiffness, natural frequency and damping ratio of an oscillator, with intervals.

        Parameters
        ----------
        mass : float, optional
            In the unit that goes with the channels (kg). By default it follows from the force's coefficient; without a
            force parameters are per unit of mass.
        target, force : str, optional
            The equation meant, where several are of second order, and the input that is the force, of several.
        draws, seed : int
            Of the coefficients' joint posterior.

        Returns
        -------
        PhysicalParameters
            Print it, or take its ``table()``.

        Raises
        ------
        InputError
            An equation that is not of second order, or without a restoring term.
        """
        from bayeq.equation.physical import physical_parameters

        equation = _oscillator(self, target)
        return physical_parameters(
            equation.chain,
            self.inputs,
            equation.terms,
            equation.posterior,
            equation.units,
            mass=mass,
            force=force,
            draws=draws,
            seed=seed,
        )


def _between(equations: EquationsBase, interpolation: Interpolation | None) -> Interpolation:
    return interpolation or (equations.refined.interpolation if equations.refined else "cubic")


def _as_list(records: Record | Sequence[Record], purpose: str) -> list[Record]:
    pieces = [records] if isinstance(records, Record) else list(records)
    if not pieces or not all(isinstance(piece, Record) for piece in pieces):
        raise InputError(f"{purpose} needs a Record or a list of Records")
    return pieces


def _oscillator(equations: EquationsBase, target: str | None) -> Equation:
    """The equation meant, or the only one of second order."""
    if target is not None:
        if target not in {equation.target for equation in equations}:
            raise UnknownNameError("equation", target, [equation.target for equation in equations])
        return equations[target]
    second = [equation for equation in equations if equation.chain.order == 2]
    if not second:
        raise InputError(
            "physical parameters are those of a second-order equation, x'' = ...; here there are only"
            f" {', '.join(f'{e.target} (order {e.chain.order})' for e in equations)}"
        )
    if len(second) > 1:
        raise InputError(f"name one of the equations as target: {', '.join(e.target for e in second)}")
    return second[0]
