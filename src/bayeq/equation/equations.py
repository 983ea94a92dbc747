"""`Equations`: the answer of `discover`, one equation per coordinate."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from bayeq.equation import along
from bayeq.equation.answer import Answer
from bayeq.equation.intervals import draws_of
from bayeq.equation.plan.designs import Amplitude, conditions_of
from bayeq.errors import DataWarning, FileFormatError, InputError, as_path
from bayeq.figures.style import named
from bayeq.forecast.score import Scores
from bayeq.records import Record, with_row_numbers
from bayeq.records.io import replacing
from bayeq.regression.constraints import CONSERVED
from bayeq.resumable import Progress, silent
from bayeq.states import estimate_motion
from bayeq.states.motion import MotionRows
from bayeq.states.prepare import in_samples, numbered

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from bayeq.equation.plan.result import Plan
    from bayeq.equation.quantities import PhysicalParameters
    from bayeq.forecast.free_run import Forecast
    from bayeq.numerics.rk4 import Interpolation


@dataclass(frozen=True, eq=False)
class Equations(Answer):
    """Equations of motion with a posterior on every term.

    Indexing and iteration give single equations (`Equation`), in the order of the chains.

    Attributes
    ----------
    equations : EquationTuple
        A tuple of `Equation`; called, ``eq.equations()``, a list of the equations as strings, as they are printed.
    inputs : tuple of str
        Channels of the inputs.
    method : str
        The inference engine that gave the posterior.
    dictionary : str
        The dictionary's specification.
    smooth : str
        How derivatives that were not measured were estimated.
    data : DataSummary
    dropped : tuple of DroppedTerm
        Candidates that were left out, and why.
    warnings : tuple of str
        Warnings about the answer.
    constraints : tuple of str
        Constraints on the coefficients that were given.
    scores : Scores or None
        Errors of the single step and of the free run on the rows that were held out; None where there are none, or no
        time.
    refined : Refinement or None
        How the coefficients were refined, if they were.
    """

    def plot(self, record: Record | None = None, ax: Any = None) -> list[Axes]:
        """A quick look: probabilities and coefficients, or, with a record, the free run against the measurement.

        Parameters
        ----------
        record : Record, optional
            Times, inputs and measured states, as in `simulate`.
        ax : matplotlib Axes or array of them, optional
            One for each equation, or, with a record, for each state; by default those of a new pyplot figure.

        Returns
        -------
        list of matplotlib.axes.Axes
            The axes that were drawn on.

        Raises
        ------
        InputError
            As `simulate`, or another number of axes.
        MissingExtraError
            matplotlib is not installed.
        """
        from bayeq.equation.brief import plot_terms
        from bayeq.figures.runs import draw_states

        return plot_terms(self, ax) if record is None else draw_states(self.simulate(record), ax)

    def predict(self, record: Record, return_std: bool = False) -> Any:
        """Target(s) of a record, eqs. (29)-(30): the right-hand side at its states and inputs as `motion` gives them.

        Bad samples are left out as in `discover`; states and inputs are interpolated where samples are missing.

        Parameters
        ----------
        record : Record
            With the channels that the equations were found from; the targets of static laws are not needed.
        return_std : bool
            Also return the predictive standard deviation.

        Returns
        -------
        (n,) array, or (n, k) for k equations; with `return_std` a pair of them
            In the target's unit, row for row of the record.

        Raises
        ------
        InputError
            Not a Record, or one without the channels.

        Warns
        -----
        DataWarning
            Samples that are missing or left out, if `discover` has not said so.
        """
        (record,) = self._prepared([record], "predict")
        columns = along.rows_of_record(record, self.roles, self.smooth, self.data.sensors)
        parts = [equation.predict(columns, return_std) for equation in self.equations]
        if len(parts) == 1:
            return parts[0]
        if return_std:
            return tuple(np.column_stack(pieces) for pieces in zip(*parts, strict=True))
        return np.column_stack(parts)

    def motion(self, record: Record) -> MotionRows:
        """States, targets and inputs of a record as `discover` makes them: smoothed, bridged, estimated.

        Parameters
        ----------
        record : Record
            With the channels that the equations were found from.

        Returns
        -------
        MotionRows
            ``time`` (n,) [s]; ``columns``, mapping of every state, target and input to (n,) array; ``observed``, the
            targets as they were measured, where they were.

        Raises
        ------
        InputError
            Not a Record, or one without the channels.

        Warns
        -----
        DataWarning
            As `predict`.
        """
        (record,) = self._prepared([record], "motion")
        return estimate_motion([record], self.roles, self.smooth, sensors=self.data.sensors).records[0]

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
            sought from the measured, smoothed or estimated states there.
        draws, seed : int
            Number of runs for the bands, 0 for none, and seed: intercepts and coefficients are drawn from their normal
            posterior given the terms shown, and a random force acts on each target, with the size and the spectrum of
            its discrepancy where that is known. If the record has samples of the motion and `initial` is not given,
            the start is drawn within its error, and noise is added to inputs as far as `discover` has learned it.
        start, rows : int
            First row, and how many; by default all that follow.
        interpolation : "cubic", "linear", "hold" or "band-limited", optional
            Inputs between samples: a cubic spline, straight lines, the last sample (commands), band-limited; by default
            as `discover` found them (``data.interpolation``), else a spline.

        Returns
        -------
        Forecast
            ``mean``, ``low`` and ``high`` of every state, ``nrmse`` of those measured; ``plot()``, ``table()``. A run
            that leaves a thousand times the range of the record, or is not finite, stops: see ``blew_up_at``.

        Raises
        ------
        InputError
            No time, an input that is missing, an initial state that is neither measured nor given, rows out of range.

        Warns
        -----
        DataWarning
            As `predict`, if the record has all channels: without the response an impact in an input cannot be
            distinguished from a spike.
        """
        (record,) = self._timed([record], "simulate")
        if all(name in record.channels for name in self.roles.channels):
            (record,) = along.prepared(self, [record])
        return along.free_run(
            self, record, initial=initial, draws=draws, seed=seed, start=start, rows=rows, interpolation=interpolation
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
            Records are then divided at long gaps, as in `discover`.
        interpolation : "cubic", "linear", "hold" or "band-limited", optional
            See `simulate`.

        Returns
        -------
        Scores
            Normalised by the standard deviation of the channels on these rows.

        Raises
        ------
        InputError
            As `simulate`, and channels that are missing.

        Warns
        -----
        DataWarning
            As `predict`.
        """
        # rows that are named are counted in whole records
        pieces = self._prepared(_as_list(records, "score"), "score", divide=start is None)
        return along.scores(self, pieces, start=start, rows=rows, interpolation=interpolation)

    def refine(
        self, records: Record | Sequence[Record], *, holdout: float = 0.2, interpolation: Interpolation | None = None
    ) -> Self:
        """The same terms with coefficients by output error: those whose free run comes closest to the record.

        Multiple shooting (Bock 1981) with a segment for each sample: the likelihood of the records is maximised with
        exact inputs over the coefficients and intercepts of all equations and a path that a discrepancy (process noise)
        allows to follow the record. The discrepancy shrinks from fit to fit, until the path is a free run. An intercept
        is set to zero unless it matters (`Equation.intercept_matters`).

        Output error needs no derivatives. It gains most where these were not measured, or samples are few per period.
        It takes the inputs as exact and the terms as complete. Forces that are not in the record (noise of a measured
        one, a missing term) make residuals of runs correlated in time: covariances are then widened, and the equations
        are returned as they were unless free runs over windows of the rows used become clearly better. They are so,
        too, where these become worse.

        Constraints of `discover` hold here too: equations between coefficients exactly; a coefficient with a known sign
        or bound has the mean and standard deviation of the posterior within it, as in the regression.
        Records are prepared as in `discover`, without bad samples and divided at long gaps. Noise that was given for
        measured channels is their weight, unless runs leave clearly more; noise of inputs is not used.

        Parameters
        ----------
        records : Record or sequence of Record
            With the channels that the equations were found from, and time.
        holdout : float
            Share of the rows, the last of each record, that is not used.
        interpolation : "cubic", "linear", "hold" or "band-limited", optional
            See `simulate`; by default coefficients are averages over cubic, linear, band-limited and those that
            `discover` found.

        Returns
        -------
        Equations
            Coefficients, covariances, intercepts, noise and fits are new; terms, inclusion probabilities and runners-up
            those of the regression. ``refined`` says how.

        Raises
        ------
        InputError
            No time, too few rows, channels that are missing, no terms to refine, or all fixed by constraints, or a
            conserved sum.

        Warns
        -----
        ConvergenceWarning
            Nothing better was found, and why; free runs over the rows held out are worse than before; the fit did not
            converge.
        DataWarning
            As `predict`; residuals of runs are correlated in time, or larger than the noise given for a channel; runs
            contradict a known sign or bound.
        """
        conserved = next((text for text in self.constraints if text.endswith(CONSERVED)), None)
        if conserved is not None:
            raise InputError(f"refine: {conserved}, which output error does not keep to: leave --refine out")
        return along.refinement(self, self._timed(_as_list(records, "refine"), "refine"), holdout, interpolation)

    def _timed(self, records: Sequence[Record], purpose: str) -> list[Record]:
        """Records in the equations' units; with row numbers as time, if the equations have them and time is unknown."""
        for record in records:
            if not isinstance(record, Record):
                raise InputError(f"{purpose} needs a Record (read, Record.from_dataframe), not {type(record).__name__}")
        if self.roles.discrete:
            return [in_samples(record, self.roles) for record in records]
        records = [along.in_units_of(self, record)[0] for record in numbered(records, self.numbers)]
        return with_row_numbers(records) if self.data.rows_as_time else records

    def _prepared(self, records: Sequence[Record], purpose: str, divide: bool = False) -> list[Record]:
        """Records without bad samples; warnings that `discover` gave about them are not repeated."""
        return along.prepared(self, self._timed(records, purpose), divide, level=4)

    def plan(
        self,
        *,
        amplitude: Amplitude | Mapping[str, Amplitude] | None = None,
        band: tuple[float, float] | None = None,
        seconds: float | None = None,
        fs: float | None = None,
        noise: Mapping[str, float] | None = None,
        limits: Mapping[str, float] | None = None,
        odds: float = 100.0,
        realisations: int = 5,
        seed: int = 0,
        progress: Progress | None = None,
    ) -> Plan:
        """The excitation of a next measurement that would best distinguish the likeliest models.

        Band-limited noise, sweep and multisine, each in several bands and two amplitudes, are simulated from rest. The
        information of a design is the misfit of the wrong model, refitted to the new record, for the likeliest model of
        an equation and its closest rival, whichever is true (Atkinson and Fedorov 1975; Box and Hill 1967).
        Models within `odds` of the likeliest are compared; if there is none, the plan is for the coefficients
        (Lindley 1956; Chaloner and Verdinelli 1995).

        Parameters
        ----------
        amplitude : float, pair or mapping, optional
            Largest magnitude of the inputs, or their lowest and highest value, by input where they differ; by default
            the range in the record.
        band : (float, float), optional
            Frequencies [Hz]; by default the band that holds the power of the inputs in the record.
        seconds, fs : float, optional
            Length and sampling rate; by default those of the record, of at most 4000 samples.
        noise : mapping of str to float, optional
            Standard deviation of the noise of targets, white; by default that with which least squares on the record
            would have the intervals of the equation, which all channels gave.
        limits : mapping of str to float, optional
            Largest magnitude of states. A design whose motion would exceed one is scaled down until it keeps it.
        odds : float
            Odds at which two models count as distinguished.
        realisations, seed : int
            Number of realisations of every design, at least two, and seed.
        progress : callable, optional
            Called with (stage, done, total).

        Returns
        -------
        Plan
            Print it; ``best``, ``table()``, ``plot()``, ``write("best.csv")``.

        Raises
        ------
        InputError
            Equations without input, or whose file holds no models; maps, static laws, hidden states, coefficients that
            differ between records, terms in t or in highest derivatives; unknown names, numbers out of range.

        Warns
        -----
        DataWarning
            The verdict on the equations is ``none``.
        """
        from bayeq.equation.plan.plan import noise_of_intervals, plan_excitation

        heads = {equation.target for equation in self.equations}
        refused = {
            "a measurement is planned for equations of motion, not for maps: vary the inputs": self.roles.discrete,
            "the equations have no input: there is nothing to excite": not self.inputs,
            "a measurement is planned for equations of motion, not for static laws: vary the inputs": any(
                chain.static for chain in self.chains
            ),
            "a measurement is planned for equations without hidden states: measure them too": bool(self.roles.hidden),
            "coefficients differ between records: plan for the equations of one record": bool(self.numbers),
            "terms use t, the time: a measurement is planned for equations that do not depend on it": self.roles.timed,
            "a measurement is planned for equations whose terms hold no highest derivatives": any(
                term.names & heads for equation in self.equations for term in equation.terms
            ),
            "the likeliest models are not in the file of the equations: find and save them again": not all(
                equation.models for equation in self.equations
            ),
        }
        for why, holds in refused.items():
            if holds:
                raise InputError(why)
        if self.verdict.kind == "none":
            message = "the plan is for equations that were not found: do not rely on it; check channels and terms first"
            warnings.warn(message, DataWarning, stacklevel=2)
        conditions = conditions_of(
            self.data.measured,
            self.states,
            self.inputs,
            {one.target: noise_of_intervals(one) for one in self.equations},
            amplitude=amplitude,
            band=band,
            seconds=seconds,
            fs=fs,
            given_noise=noise or {},
            limits=limits or {},
        )
        return plan_excitation(
            self.equations,
            self.inputs,
            conditions,
            odds=odds,
            realisations=realisations,
            seed=seed,
            progress=progress or silent,
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

        For several second-order equations modes and matrices, for first-order ones time constants and gains. Stiffness
        and damping are those of small motion about the position of rest, listed as ``x0`` if it is not at zero.

        Parameters
        ----------
        mass : float, optional
            Mass in the unit that fits the channels (kg). By default it follows from the force's coefficient; without a
            force parameters are per unit of mass.
        target, force : str, optional
            The equation of one oscillator, if several are of second order, and the input that is the force, of several.
        draws, seed : int
            Number of draws from the coefficients' joint posterior, and seed.

        Returns
        -------
        PhysicalParameters
            Print it, or take its ``table()``.

        Raises
        ------
        InputError
            A map, equations of other orders, no restoring or damping term; a record whose time is not known.
        """
        from bayeq.equation.physical import oscillator_parameters

        return oscillator_parameters(self, mass, target=target, force=force, draws=draws, seed=seed)

    def to_dict(self) -> dict[str, Any]:
        """The answer as plain data, as ``bayeq discover --json`` prints it."""
        from bayeq.equation.to_json import to_dict

        return to_dict(self)

    def save(self, path: str | Path) -> None:
        """Write to a JSON file that `bayeq.load` reads.

        Parameters
        ----------
        path : str or Path
            The file; it is replaced if it exists.

        Raises
        ------
        FileFormatError
            A file that cannot be written.
        """
        from bayeq.equation.to_json import to_saved

        text = json.dumps(to_saved(self), indent=1, allow_nan=False) + "\n"
        place = as_path(path)
        try:
            with replacing(place) as part:
                part.write_text(text, encoding="utf-8")
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or type(error).__name__
            raise FileFormatError(f"{place}: cannot be written: {reason}") from None

    def to_arviz(self, target: str | None = None, *, draws: int = 1000, seed: int = 0) -> Any:
        """Independent draws of the coefficients over the models, as an ArviZ object.

        A model is drawn by its probability; coefficients and intercept are normal given the model, with the noise
        variance of the model. Without model averaging only the model of the included terms is drawn. Constants inside
        terms stay at the values that were found.

        Parameters
        ----------
        target : str, optional
            Target of the equation, if there are several.
        draws : int
            Number of draws, as one chain.
        seed : int
            Seed of the random numbers.

        Returns
        -------
        InferenceData, or DataTree from ArviZ 1.0 on
            Groups ``posterior`` (``coef`` and ``inclusion`` by ``term``, ``intercept``, ``noise_variance``) and
            ``sample_stats`` (``lp``, the logarithm of the model's probability, and ``model``, its number).

        Raises
        ------
        InputError
            Equations read from a file, which does not hold their posterior; several, and no target.
        UnknownNameError
            No equation of this target.
        MissingExtraError
            ArviZ is not installed.
        """
        targets = [equation.target for equation in self]
        if target is None and len(targets) > 1:
            raise InputError(f"to_arviz: there are several equations: say which by target= ({', '.join(targets)})")
        equation = self[named("equation", target, targets)]
        return draws_of(equation.solved(), equation.posterior, draws, seed)

    def report(
        self,
        path: str | Path,
        records: Record | Sequence[Record] | None = None,
        *,
        files: Sequence[str | Path] = (),
        command: str | None = None,
    ) -> None:
        """Write the answer as one HTML page, which loads nothing from anywhere and prints well.

        It holds the verdict, the equations and their terms, the warnings, pictures with hover values, the data and
        settings with SHA-256 hashes, and the command that gives the answer again.

        Parameters
        ----------
        path : str or Path
            The page to write.
        records : Record or sequence of Record, optional
            Records that the equations were found from; pictures show the first. Without records, only pictures of the
            equations.
        files : sequence of str or Path, optional
            Files that the records were read from, to be named with their hashes.
        command : str, optional
            The command to show that gives the answer again; by default one is made from the settings.

        Raises
        ------
        InputError
            The page, or one of `files`, cannot be written or read; records without the channels.
        MissingExtraError
            matplotlib or Bokeh is not installed.
        """
        from bayeq.equation.report.page import write_report

        pieces = [] if records is None else _as_list(records, "report")
        pieces = self._timed(pieces, "report") if self.roles.discrete else numbered(pieces, self.numbers)
        for record in pieces:
            for name in self.roles.channels:
                _ = record[name]
        write_report(as_path(path), self, pieces, [as_path(file) for file in files], command)

    def __str__(self) -> str:
        """The answer as text: in colour on a terminal, plain (Markdown) elsewhere."""
        from bayeq.equation.text import render

        return render(self)

    def _repr_html_(self) -> str:
        from bayeq.equation.brief import as_html

        return as_html(self)

    def __repr__(self) -> str:
        return f"<Equations: {'; '.join(equation.text for equation in self.equations)}>"


def _as_list(records: Record | Sequence[Record], purpose: str) -> list[Record]:
    pieces: list[Any] = [records] if isinstance(records, Record) or not isinstance(records, Iterable) else [*records]
    if not pieces or not all(isinstance(piece, Record) for piece in pieces):
        raise InputError(f"{purpose} needs a Record or a list of Records")
    return pieces
