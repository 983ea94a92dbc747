"""`Equations`: the answer of `discover`, one equation per coordinate."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.dictionary import DroppedTerm
from bayeq.equation import Equation
from bayeq.errors import InputError
from bayeq.files import replacing
from bayeq.output_error import Refinement
from bayeq.records import Record
from bayeq.states import Chain, Smooth, derive_all

if TYPE_CHECKING:
    import pandas as pd

    from bayeq.forecast import Forecast, Scores
    from bayeq.integrate import Interpolation
    from bayeq.physical import PhysicalParameters

__all__ = ["DataSummary", "Equations"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DataSummary:
    """What the equations were found from.

    Attributes
    ----------
    files : tuple of str
        Names of the records.
    n, n_train, n_held_out : int
        Rows in all, used, and held out.
    estimated : tuple of str
        Derivatives that were not measured but estimated.
    """

    files: tuple[str, ...]
    n: int
    n_train: int
    n_held_out: int
    estimated: tuple[str, ...] = ()


@dataclass(frozen=True)
class Equations:
    """Equations of motion with a posterior on every term.

    Indexing and iteration give the single `Equation`s, in the order of the chains.

    Attributes
    ----------
    equations : tuple of Equation
    inputs : tuple of str
        Channels of the inputs.
    method : str
        The engine that the numbers come from.
    dictionary : str
        The dictionary's specification.
    smooth : str
        How derivatives that were not measured were had.
    data : DataSummary
    dropped : tuple of DroppedTerm
        Candidates that were left out, and why.
    warnings : tuple of str
        What makes the answer less than it seems.
    constraints : tuple of str
        What was known of the coefficients.
    refined : Refinement or None
        How the coefficients were refined, if they were.
    """

    equations: tuple[Equation, ...]
    inputs: tuple[str, ...]
    method: str
    dictionary: str
    smooth: Smooth
    data: DataSummary
    dropped: tuple[DroppedTerm, ...] = ()
    warnings: tuple[str, ...] = ()
    constraints: tuple[str, ...] = ()
    refined: Refinement | None = None

    def __len__(self) -> int:
        return len(self.equations)

    def __iter__(self) -> Iterator[Equation]:
        return iter(self.equations)

    def __getitem__(self, key: int | str) -> Equation:
        """By position, or by the name of the target."""
        if isinstance(key, str):
            for equation in self.equations:
                if equation.target == key:
                    return equation
            raise KeyError(key)
        return self.equations[key]

    @property
    def chains(self) -> tuple[Chain, ...]:
        """The kinematic chains."""
        return tuple(equation.chain for equation in self.equations)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the first-order state vector, the order of `rhs`."""
        return tuple(name for chain in self.chains for name in chain.states)

    def table(self) -> pd.DataFrame:
        """All candidates of all equations: target, term, coef, sd, ci_low, ci_high, pip, included."""
        import pandas as pd

        tables = []
        for equation in self.equations:
            one = equation.table()
            one.insert(0, "target", equation.target)
            tables.append(one)
        return pd.concat(tables, ignore_index=True)

    def to_sympy(self) -> Any:
        """`sympy.Eq`, or a list of them where there are several equations."""
        out = [equation.to_sympy() for equation in self.equations]
        return out[0] if len(out) == 1 else out

    def to_latex(self) -> str:
        """LaTeX, one equation per line."""
        return " \\\\\n".join(equation.to_latex() for equation in self.equations)

    def rhs(self, t: float, state: ArrayLike, u: ArrayLike | None = None) -> Floats:
        """Time derivative of the state vector, as SciPy's `solve_ivp` takes it.

        Parameters
        ----------
        t : float
            Time; the equations are autonomous.
        state : (d,) array
            In the order of `states`: each coordinate and its derivatives below the highest.
        u : (m,) array or float, optional
            Inputs at this time, needed where there are inputs.

        Returns
        -------
        (d,) array
        """
        del t
        values = np.asarray(state, dtype=np.float64)
        if values.shape != (len(self.states),):
            raise InputError(f"the state has {len(self.states)} entries {self.states}, got shape {values.shape}")
        given = np.atleast_1d(np.asarray([] if u is None else u, dtype=np.float64))
        if given.shape != (len(self.inputs),):
            raise InputError(f"need {len(self.inputs)} input values {self.inputs}, got {given.size}")
        columns = dict(zip(self.states, values, strict=True)) | dict(zip(self.inputs, given, strict=True))
        out: list[float] = []
        for equation in self.equations:
            out.extend(columns[name] for name in equation.chain.states[1:])
            out.append(float(equation.evaluate(columns)))
        return np.array(out)

    def predict(self, record: Record, return_std: bool = False) -> Any:
        """Target(s) of a record, eqs. (29)-(30): the right-hand side at its measured states and inputs.

        Parameters
        ----------
        record : Record
            With the channels that the equations were found from.
        return_std : bool
            Also return the predictive standard deviation.

        Returns
        -------
        (n,) array, or (n, k) for k equations; with `return_std` a pair of them
        """
        columns = derive_all([record], self.chains, self.inputs, self.smooth)[0].columns
        parts = [equation.predict(columns, return_std) for equation in self.equations]
        if len(parts) == 1:
            return parts[0]
        if return_std:
            return tuple(np.column_stack(pieces) for pieces in zip(*parts, strict=True))
        return np.column_stack(parts)

    def simulate(
        self,
        record: Record,
        *,
        initial: Mapping[str, float] | None = None,
        draws: int = 200,
        seed: int = 0,
        start: int = 0,
        rows: int | None = None,
        interpolation: Interpolation = "cubic",
    ) -> Forecast:
        """Free run of all equations together, driven by the inputs of a record.

        Classical Runge-Kutta steps on the record's times, several to a sampling interval where one is too coarse (until
        half the step would change the states by less than 1e-6 of their spread in most intervals).

        Parameters
        ----------
        record : Record
            Times and inputs; measured states where there are any.
        initial : mapping of str to float, optional
            States at the first row. Those not given are the record's, as `discover` has them: measured, smoothed or
            estimated.
        draws : int
            Further runs with intercepts and coefficients drawn from their normal posterior given the included terms,
            for the bands; 0 for none. The initial state is the same for all.
        seed : int
            Of the draws.
        start, rows : int
            First row, and how many; by default all that follow.
        interpolation : "cubic", "linear" or "hold"
            Of the inputs between their samples: a cubic spline, for forces that are smooth; straight lines; the last
            sample held, for commands that are switched.

        Returns
        -------
        Forecast
            ``mean``, ``low`` and ``high`` of every state, ``nrmse`` of those measured; ``plot()``. A run that leaves a
            thousand times the range of the record, or is not finite, stops: see ``blew_up_at`` and ``blown``.

        Raises
        ------
        InputError
            No time, an input that is missing, an initial state that is neither measured nor given, rows out of range.
        """
        from bayeq.dynamics import Dynamics
        from bayeq.forecast import forecast

        posteriors = [equation.posterior for equation in self.equations]
        dynamics = Dynamics.of(self.chains, self.inputs, posteriors, [e.terms for e in self.equations])
        units = {name: unit for equation in self.equations for name, unit in equation.units.items()}
        return forecast(
            dynamics,
            posteriors,
            record,
            self.smooth,
            initial=initial,
            draws=draws,
            seed=seed,
            start=start,
            rows=rows,
            interpolation=interpolation,
            units=units,
        )

    def score(
        self,
        record: Record,
        *,
        start: int | None = None,
        rows: int | None = None,
        interpolation: Interpolation = "cubic",
    ) -> Scores:
        """Errors of the single step and of the free run, by default on the rows that `discover` held out.

        Parameters
        ----------
        record : Record
            With the channels that the equations were found from.
        start, rows : int, optional
            First row, and how many; by default the last ones, the share of the rows that was held out of the fit (a
            fifth, if none were).
        interpolation : "cubic", "linear" or "hold"
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
        from bayeq.forecast import Scores, normalised_error

        if start is None:
            share = self.data.n_held_out / self.data.n if self.data.n_held_out else 0.2
            start = record.n - max(int(share * record.n), 2)
        run = self.simulate(record, draws=0, start=start, rows=rows, interpolation=interpolation)
        n = len(run.time)
        states = derive_all([record], self.chains, self.inputs, self.smooth)[0]
        first = start if states.n == record.n else round(start * (states.n - 1) / (record.n - 1))
        window = slice(first, first + n)
        columns = {name: values[window] for name, values in states.columns.items()}
        one_step = {
            e.target: normalised_error(
                e.predict(columns), states.measured.get(e.target, states.columns[e.target])[window]
            )
            for e in self.equations
        }
        return Scores(start, n, one_step, run.nrmse, run.blew_up_at)

    def refine(
        self,
        records: Record | Sequence[Record],
        *,
        segment: int | None = None,
        holdout: float = 0.2,
        intercept: bool | None = None,
        interpolation: Interpolation = "cubic",
    ) -> Equations:
        """The same terms with coefficients by output error: those whose free run comes closest to what was measured.

        Multiple shooting: a record is divided into segments, each a free run from an initial state of its own, which is
        fitted with the coefficients and intercepts of all equations to every measured channel (Bock 1981).
        Channels are weighted by the noise that the fit itself finds in them. Segments get longer from fit to fit, up to
        the whole record, as long as the last quarter of the rows is forecast as well by it.

        Output error takes the inputs as exact and the channels as noisy; it needs no derivatives. It gains most where
        these were not measured, or samples are few per period. Where the input is noisy it may know less than the
        regression did: then the equations are returned as they were.

        Parameters
        ----------
        records : Record or sequence of Record
            With the channels that the equations were found from, and time.
        segment : int, optional
            Rows of a segment, instead of finding how long one may be.
        holdout : float
            Share of the rows, the last of each record, that is not used.
        intercept : bool, optional
            Estimate the intercepts, or set them to zero; by default each is zero unless its interval excludes that, so
            that the equation is what is written.
        interpolation : "cubic", "linear" or "hold"
            Of the inputs, see `simulate`.

        Returns
        -------
        Equations
            With coefficients, covariances and intercepts by output error, noise and fits anew; terms, inclusion
            probabilities and runners-up are those of the regression. ``refined`` says how.

        Raises
        ------
        InputError
            No time, too few rows, channels that are missing, no terms to refine.

        Warns
        -----
        ConvergenceWarning
            Nothing better was found, and why: the equations are returned as they were.
        """
        from bayeq.refine import refine

        return refine(self, records, segment=segment, holdout=holdout, intercept=intercept, interpolation=interpolation)

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
            Where it is known, in the unit that goes with the channels (kg, for m and N). Otherwise it follows from the
            force's coefficient; with neither, parameters are per unit of mass.
        target : str, optional
            Left-hand side of the equation meant, where several are of second order.
        force : str, optional
            The input that is a force, where several inputs are in the equation.
        draws : int
            From the joint posterior of the coefficients.
        seed : int
            Of the draws.

        Returns
        -------
        PhysicalParameters
            Print it, or take ``table()``.

        Raises
        ------
        InputError
            An equation that is not of second order, or without a restoring term; see `bayeq.physical`.
        """
        from bayeq.physical import physical_parameters

        equation = self._oscillator(target)
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

    def _oscillator(self, target: str | None) -> Equation:
        if target is not None:
            return self[target]
        second = [equation for equation in self.equations if equation.chain.order == 2]
        if not second:
            raise InputError(
                "physical parameters are those of a second-order equation, x'' = ...; here there are only"
                f" {', '.join(f'{e.target} (order {e.chain.order})' for e in self.equations)}"
            )
        if len(second) > 1:
            raise InputError(f"name one of the equations as target: {', '.join(e.target for e in second)}")
        return second[0]

    def to_dict(self) -> dict[str, Any]:
        """What ``bayeq discover --json`` prints."""
        from bayeq.storage import to_dict

        return to_dict(self)

    def save(self, path: str | Path) -> None:
        """Write to a JSON file that `bayeq.load` reads."""
        from bayeq.storage import to_saved

        text = json.dumps(to_saved(self), indent=1, allow_nan=False) + "\n"
        with replacing(Path(path)) as part:
            part.write_text(text, encoding="utf-8")

    def __str__(self) -> str:
        """The answer as a person reads it: in colour on a terminal, plain (Markdown) elsewhere."""
        from bayeq.render import render

        return render(self)

    def __repr__(self) -> str:
        return f"<Equations: {'; '.join(equation.text for equation in self.equations)}>"
