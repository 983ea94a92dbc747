"""`Equation`: one discovered equation of motion, as numbers, text, SymPy and LaTeX."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Bools, Floats
from bayeq.dictionary.ranges import ConstantEstimate, Forms
from bayeq.equation import written
from bayeq.equation.export import Uncertainty, right_hand_side, sum_in_latex
from bayeq.equation.intervals import Model, OverModels, cut, over_models, unlike
from bayeq.equation.plan.information import CandidateModel
from bayeq.equation.selection.select import LeftOut
from bayeq.equation.sensitivity import (
    PipCurve,
    PriorSensitivity,
    power_sensitivity,
    prior_sensitivity,
    require_spike_slab,
)
from bayeq.equation.size_path import ParsimonyPath, parsimony_path
from bayeq.equation.verdict import Verdict
from bayeq.errors import InputError
from bayeq.expressions import Evaluator, Expression, to_sympy
from bayeq.forecast.dynamics import Law
from bayeq.inference.engines import ENGINES
from bayeq.inference.posterior import Posterior
from bayeq.markup import code, join, paragraph, table
from bayeq.numerics.distributions import Z95
from bayeq.regression.fit import RegressionFit
from bayeq.regression.residuals import Fit, Residuals
from bayeq.states import Chain

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class RunnerUp:
    """A model one move away from the chosen one."""

    leaves: str | None  # term taken out of the chosen model
    enters: str | None  # term put into it
    log_odds: float  # ln p(runner-up | y) / p(chosen | y)

    @property
    def odds(self) -> str:
        """The odds as text: ``1:7`` against, ``2:1`` for."""
        return written.odds_text(self.log_odds)

    def __str__(self) -> str:
        return written.difference(self.enters, self.leaves)


@dataclass(frozen=True, eq=False, repr=False)
class Equation:
    """One equation: target = intercept + sum of coefficient x term.

    It holds two models of the same regression. The *included* terms are those with a posterior inclusion probability
    above 0.5; the terms *shown* are those of the equation that is printed, evaluated and integrated. `why` gives the
    rules by which they differ (`bayeq.equation.selection.select`).

    Attributes
    ----------
    chain : Chain
        The coordinate whose highest derivative is the target.
    terms : tuple of Expression
        All P candidates.
    posterior : Posterior
        Inclusion probabilities, and coefficients given the included terms, in original units.
    shown_posterior : Posterior
        The same given the terms shown.
    train, held_out : Fit
        Fit of the terms shown on the rows used and on rows not used (None if none were held out).
    residuals : Residuals
        Whiteness of the training residuals of the terms shown.
    runners_up : tuple of RunnerUp
        The likeliest models one move away from the terms shown, where the engine compares models.
    fit : RegressionFit or None
        The regression and its posterior on standardised columns; None for an equation read from a file.
    share : (P,) array or None
        Share of the target's variance that each term explains: the loss of R2 on the training rows when the term is
        left out and the others are refitted by least squares. NaN for a term that is not shown.
    why : mapping of str to str
        Terms that are included or shown but not both, each with the rule that decided: ``"dependent"``,
        ``"max_terms"``, ``"tolerance"`` or ``"undecided"``.
    left_out : tuple of LeftOut
        Terms that are included and not shown.
    verdict : Verdict
        Whether an equation was found.
    units : mapping of str to str
        Units of channels and their derivatives, as far as they are known.
    unit_gains : tuple of float
        Ratio of each channel of the chain to the derivative, by seconds, of the lowest measured channel: 0.001 for v in
        m/s with x in mm. Empty where all are 1.
    scored : Equation or None
        The equation found without the rows held out, if this one was then found from all rows: fits, verdict and `path`
        are those of `scored`.
    models : tuple of CandidateModel
        The likeliest models with their coefficients, the likeliest first.
    shown_fit : RegressionFit or None
        The regression that the coefficients shown come from, if it is not `fit`.
    stored : OverModels or None
        Intervals over models of an equation that was read from a file.
    error_probability : float or None
        Probability that the law lacks a function of the states, beyond the tolerance; None for rows taken as measured.
    tau : float
        Most probable size of that function, as a share of the target's standard deviation; 0 where there is none.
    bound : (P,) array or None
        Upper 95 % bound of the magnitude of a coefficient if its term were added to the included ones; NaN for these.
    undetermined : tuple of str
        Terms that could change predictions within their bounds (`bayeq.equation.selection.alternatives`), the simplest
        first.
    constants : tuple of ConstantEstimate
        Constants inside the terms, ``{name}``: the value that terms have, and how well it is known.
    forms : mapping of str to mapping of str to float
        For each either-or, the log posteriors of its members.
    """

    chain: Chain
    terms: tuple[Expression, ...]
    posterior: Posterior
    shown_posterior: Posterior
    train: Fit
    held_out: Fit | None
    residuals: Residuals
    verdict: Verdict
    runners_up: tuple[RunnerUp, ...] = ()
    fit: RegressionFit | None = field(default=None, repr=False)
    share: Floats | None = None
    why: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[LeftOut, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    unit_gains: tuple[float, ...] = ()
    scored: Equation | None = field(default=None, repr=False)
    models: tuple[CandidateModel, ...] = ()
    shown_fit: RegressionFit | None = field(default=None, repr=False)
    stored: OverModels | None = field(default=None, repr=False)
    error_probability: float | None = None
    tau: float = 0.0
    bound: Floats | None = None
    undetermined: tuple[str, ...] = ()
    constants: tuple[ConstantEstimate, ...] = ()
    forms: Forms = field(default_factory=dict)

    @property
    def law(self) -> Law:
        """The equation with the terms shown, in the form that a free run needs."""
        return Law(self.chain, self.terms, self.shown_posterior, self.unit_gains)

    @cached_property
    def included_model(self) -> Model:
        """Coefficients given the included terms."""
        return Model.of(self.posterior, self.posterior.names)

    @cached_property
    def shown_model(self) -> Model:
        """Coefficients given the terms shown."""
        return Model.of(self.shown_posterior, self.posterior.names)

    @cached_property
    def averaged_model(self) -> Model | None:
        """Coefficients over all models, 0 in those without the term; None where no models are averaged."""
        p, ci95 = self.posterior, self.averaged_ci95
        if p.averaged is None or ci95 is None:
            return None
        known, constant = p.averaged.coef != 0.0, (self.included_model.intercept, self.included_model.intercept_sd)
        return Model(p.names, known, p.averaged.coef, p.averaged.sd, ci95, *constant)

    @cached_property
    def likelihood_model(self) -> Model | None:
        """Coefficients of the terms shown by the likelihood itself, not projected; None for rows taken as measured."""
        own = self.shown_posterior.projected
        if own is None:
            return None
        ends = own.coef[:, None] + Z95 * own.sd[:, None] * np.array([-1.0, 1.0])
        ci95 = cut(self.shown_posterior, ends)
        return replace(self.shown_model, coef=own.coef, sd=own.sd, ci95=ci95, covariance=None)

    @property
    def in_seconds(self) -> bool:
        """Whether the units of the chain are those of derivatives by seconds: none of `unit_gains` is unlike 1."""
        return bool(np.allclose(self.unit_gains, 1.0))

    @property
    def target(self) -> str:
        """Name of the left-hand side."""
        return self.chain.target

    @property
    def included(self) -> tuple[str, ...]:
        """Names of the terms whose posterior inclusion probability exceeds 0.5."""
        return self.included_model.names

    @property
    def shown_constants(self) -> tuple[ConstantEstimate, ...]:
        """Constants inside the terms of the equation that is printed."""
        return tuple(one for one in self.constants if one.sd is not None and set(one.terms) & set(self.shown))

    @property
    def at_ends(self) -> tuple[str, ...]:
        """Messages on constants at ends of their ranges, and on members of either-ors that were not compared."""
        units, p = self.constant_units, self.posterior
        ends = (
            text for one in self.shown_constants for text in written.at_end(one, units.get(one.name, ""), self.terms)
        )
        return *ends, *written.left_out_forms(self.forms, dict(zip(p.names, p.pip.tolist(), strict=True)))

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of the terms of the equation that is printed, evaluated and integrated."""
        return self.shown_model.names

    @property
    def coef(self) -> dict[str, float]:
        """Coefficient of each included term, given the included terms, in original units."""
        return self.included_model.coefficients

    @property
    def shown_coef(self) -> dict[str, float]:
        """Coefficient of each term shown, given the terms shown, in original units."""
        return self.shown_model.coefficients

    @cached_property
    def coef_units(self) -> tuple[str | None, ...]:
        """Unit of each candidate's coefficient; None where a unit is not known. The intercept has the target's unit."""
        units = {**self.units, **{f"{{{name}}}": unit for name, unit in self.constant_units.items()}}
        return tuple(written.quotient_unit(self.target, term, units) for term in self.terms)

    @cached_property
    def constant_units(self) -> dict[str, str]:
        """Unit of each constant inside the terms, by name, from its place there; unknown ones are left out."""
        return written.constant_units(self.terms, self.units)

    def with_posterior(self, posterior: Posterior, **changes: Any) -> Equation:
        """The equation with other coefficients of the terms shown; of the included terms too, where these are the same.

        Parameters
        ----------
        posterior : Posterior
            In original units.
        **changes
            Other attributes.
        """
        same = bool((self.posterior.support == posterior.support).all())
        included = posterior if same else self.posterior
        return replace(self, posterior=included, shown_posterior=posterior, **changes)

    @property
    def noise_sd(self) -> float:
        """Standard deviation of the residual that the terms shown leave of the target."""
        return float(np.sqrt(self.shown_posterior.noise_variance))

    @property
    def error_share(self) -> float | None:
        """Discrepancy of the terms shown, beside noise, as a share of the target's sd; None where it is not known."""
        return None if (own := self.shown_posterior.projected) is None else own.error_share

    @property
    def ci95(self) -> Floats:
        """95 % intervals of the coefficients given the included terms, (P, 2); 0 for a term not included."""
        return self.included_model.ci95

    @property
    def shown_ci95(self) -> Floats:
        """95 % intervals of the coefficients given the terms shown, (P, 2); 0 for a term not shown."""
        return self.shown_model.ci95

    @cached_property
    def over_models(self) -> OverModels:
        """Intervals averaged over models."""
        if self.stored is not None or self.fit is None:
            return self.stored or OverModels(None, None, None)
        return over_models(self.fit, self.posterior, self.shown_fit or self.fit, self.shown_posterior, self.left_out)

    @property
    def averaged_ci95(self) -> Floats | None:
        """95 % intervals of the coefficients over all models, 0 in those without the term, (P, 2).

        None where no models are averaged.
        """
        return None if self.posterior.averaged is None else self.over_models.averaged

    @cached_property
    def printed_ci95(self) -> Floats:
        """95 % intervals as they are printed, (P, 2): `shown_ci95`, or those over models where they are `unlike` it."""
        return np.where(self.printed_over_models[:, None], self._given_in, self.shown_ci95)

    @cached_property
    def _given_in(self) -> Floats:
        """95 % intervals over the models that hold a term, (P, 2); with constants, widened to contain `shown_ci95`."""
        given = None if self.shown_posterior.averaged is None else self.over_models.given_in
        given, own = self.shown_ci95 if given is None else given, self.shown_ci95
        around = np.column_stack([np.minimum(given[:, 0], own[:, 0]), np.maximum(given[:, 1], own[:, 1])])
        return around if self.shown_constants else given

    @cached_property
    def printed_over_models(self) -> Bools:
        """Whether the interval printed for a term is the one over all models that hold it, (P,)."""
        return self.shown_posterior.support & unlike(self._given_in, self.shown_ci95)

    @cached_property
    def printed_intercept_ci95(self) -> tuple[float, float]:
        """95 % interval of the intercept as it is printed: `intercept_ci95`, or over models if that is `unlike` it.

        It is `intercept_ci95` for an intercept that is probably zero, and with constants inside the terms.
        """
        shown, conditional = self.shown_posterior, self.intercept_ci95
        alone = shown.averaged is None or shown.constant.left_out is not None or self.shown_constants
        over = None if alone else self.over_models.intercept
        if over is None or not unlike(over[None], np.array([conditional]))[0]:
            return conditional
        return float(over[0]), float(over[1])

    @property
    def intercept_over_models(self) -> bool:
        """Whether the interval of the intercept is printed over models."""
        return self.printed_intercept_ci95 != self.intercept_ci95

    @property
    def intercept_ci95(self) -> tuple[float, float]:
        """95 % interval of the intercept of the equation shown."""
        return self.shown_model.intercept_ci95

    @property
    def intercept_matters(self) -> bool:
        """Whether the intercept is written out: its probability is over 0.5, or without one its interval excludes 0."""
        if self.shown_posterior.constant.pip is not None:
            return self.shown_posterior.constant.pip > 0.5
        low, high = self.intercept_ci95
        return low > 0 or high < 0

    def table(self) -> pd.DataFrame:
        """All candidates, a row each.

        Returns
        -------
        DataFrame
            ``term``; ``coef``, ``sd``, ``ci_low``, ``ci_high`` given the included terms; ``pip``; ``included``,
            ``shown``; ``share`` of the target's variance; ``unit`` of the coefficient (None: unknown); ``shown_coef``,
            ``shown_sd``, ``shown_ci_low``, ``shown_ci_high`` given the terms shown; ``averaged_ci_low``,
            ``averaged_ci_high`` over all models (NaN where none are averaged); ``why`` included and shown terms differ
            ("" if not); ``bound`` of the size of a coefficient that is not included. Below the terms a row for each
            constant inside those shown, ``{name}``: its value, interval and unit; it has no PIP.
        """
        import pandas as pd

        unknown, averaged = np.full(len(self.terms), np.nan), self.averaged_ci95
        averaged_low, averaged_high = (unknown, unknown) if averaged is None else averaged.T
        out = pd.DataFrame(
            {
                "term": [term.text for term in self.terms],
                **self.included_model.columns(),
                "pip": self.posterior.pip,
                "included": self.posterior.support,
                "shown": self.shown_posterior.support,
                "share": unknown if self.share is None else self.share,
                "unit": self.coef_units,
                **self.shown_model.columns("shown_"),
                "averaged_ci_low": averaged_low,
                "averaged_ci_high": averaged_high,
                "why": [self.why.get(term.text, "") for term in self.terms],
                "effective": False,  # as earlier versions had it
                "bound": unknown if self.bound is None else self.bound,
            }
        )
        if not self.shown_constants:
            return out
        rows = [written.row_of(one, self.constant_units.get(one.name)) for one in self.shown_constants]
        return pd.concat([out, pd.DataFrame(rows).reindex(columns=out.columns)], ignore_index=True)

    @property
    def summands(self) -> list[tuple[float, float, Expression | None]]:
        """Coefficients, their standard deviations and the terms shown; last the intercept, where it is written out."""
        p, sd = self.shown_posterior, self.shown_posterior.sd
        constant = [(float(p.intercept), p.intercept_sd, None)] if self.intercept_matters else []
        return [*((float(p.coef[j]), float(sd[j]), self.terms[j]) for j in np.flatnonzero(p.support)), *constant]

    @cached_property
    def text(self) -> str:
        """The equation as a line of text, coefficients to a tenth of their standard deviation."""
        if self.chain.stated:
            return f"{self.target} = {self.chain.law}"
        pieces: list[str] = []
        for value, sd, term in self.summands:
            number = written.round_to(value, sd)
            sign, size = ("-", number[1:]) if number.startswith("-") else ("+", number)
            body = size if term is None else f"{size}*{written.factor_of(term.text)}".removeprefix("1*")
            pieces.append(f"{sign} {body}" if pieces else (f"-{body}" if sign == "-" else body))
        return f"{self.target} = {' '.join(pieces) or '0'}"

    def to_sympy(self) -> Any:
        """The equation as `sympy.Eq`, with full-precision coefficients.

        The intercept is in it where `intercept_matters`; `evaluate` and `predict` always add it.
        """
        import sympy

        return sympy.Eq(sympy.Symbol(self.target), self._right_hand_side(rounded=False), evaluate=False)

    def __repr__(self) -> str:
        return f"<Equation: {self.text}>"

    def _repr_html_(self) -> str:
        """HTML for a notebook: the verdict, the equation and its terms."""
        p, ends = self.shown_posterior, self.printed_ci95
        rows = []
        for j in np.flatnonzero(p.support):
            number, _, interval = written.with_interval(p.coef[j], p.sd[j], ends[j])
            rows.append(
                (self.terms[j].text, number, interval, f"{self.posterior.pip[j]:.3f}", self.coef_units[j] or "")
            )
        header = ("term", "coefficient", "95 % interval", ENGINES[self.posterior.details.method].score, "unit")
        return join(paragraph(f"verdict: {self.verdict}", strong=True), code(self.text), table(header, rows))

    def to_latex(self, uncertainty: Uncertainty = "none", chains: Sequence[Chain] = ()) -> str:
        r"""The equation in LaTeX, derivatives of the coordinate as dots: ``\ddot{x} = - 2.0 \dot{x} ...``.

        Channels in units of their own, such as x in mm and a in g, are written by their names: dots would say another
        law.

        Parameters
        ----------
        uncertainty : "none", "brackets" or "plus-minus"
            Standard deviations of the coefficients: ``992.6(2.6)\,x`` or ``\left(992.6 \pm 2.6\right)\,x``.
        chains : sequence of Chain, optional
            Chains of other equations, whose derivatives are written with dots too.

        Raises
        ------
        InputError
            An unknown `uncertainty`.
        """
        import sympy

        if uncertainty not in get_args(Uncertainty):
            raise InputError(f"uncertainty must be one of {', '.join(get_args(Uncertainty))}, got {uncertainty!r}")
        own = [self.chain] if self.in_seconds or self.chain.discrete else []
        symbols = written.in_latex([*chains, *own], {self.target}.union(*(term.names for term in self.terms)))
        names = {sympy.Symbol(name): text for name, text in symbols.items()}
        if uncertainty == "none" or self.chain.stated:
            right = sympy.latex(self._right_hand_side(rounded=True), symbol_names=names)
        else:
            parts = []
            for value, sd, term in self.summands:
                factor = sympy.Integer(1) if term is None else to_sympy(term.named())
                text = "" if term is None else sympy.latex(factor, symbol_names=names)
                parts.append((value, sd, rf"\left({text}\right)" if factor.is_Add or text[:1] == "-" else text))
            right = sum_in_latex(parts, uncertainty)
        return f"{symbols.get(self.target) or sympy.latex(sympy.Symbol(self.target))} = {right}"

    def _right_hand_side(self, rounded: bool) -> Any:
        import sympy

        if self.chain.stated and self.chain.law is not None:
            return to_sympy(self.chain.law.named() if rounded else self.chain.law)
        total = sympy.Integer(0)
        for value, sd, term in self.summands:
            number = sympy.Float(float(written.round_to(value, sd)) if rounded else value)
            number = sympy.Integer(number) if rounded and abs(number) == 1.0 and term else number
            total += number if term is None else number * to_sympy(term.named() if rounded else term)
        return total

    def evaluate(self, columns: Mapping[str, ArrayLike]) -> Floats:
        """Predictive mean of the target (29) from columns (or numbers) of states and inputs.

        Parameters
        ----------
        columns : mapping of str to array-like
            A column of n values, or a number, for each state and input, by name and in the record's units.

        Returns
        -------
        (n,) array
            In the target's unit.
        """
        return np.asarray(right_hand_side(self.law, Evaluator(columns)), dtype=np.float64)

    def predict(self, columns: Mapping[str, Floats], return_std: bool = False) -> Any:
        """Predictive mean (29), and with `return_std` the standard deviation (30), at n rows of columns.

        Parameters
        ----------
        columns : mapping of str to (n,) array
            States and inputs by name, in the record's units.
        return_std : bool
            Also return the standard deviation.

        Returns
        -------
        (n,) array, or a pair of them
            In the target's unit.
        """
        n = len(next(iter(columns.values())))
        mean = np.broadcast_to(self.evaluate(columns), (n,)).copy()
        if not return_std:
            return mean
        evaluate, D = Evaluator(columns), np.zeros((n, len(self.terms)))
        for j in np.flatnonzero(self.shown_posterior.support):
            D[:, j] = evaluate(self.terms[j])
        return mean, self.shown_posterior.predictive_sd(D)

    def path(self, most: int | None = None) -> ParsimonyPath:
        """The likeliest model of each size, with its evidence and fit, which show where further terms stop paying.

        Parameters
        ----------
        most : int, optional
            Largest number of terms; by default 12, or three more than the equation has.

        Returns
        -------
        ParsimonyPath
            Print it for a summary; ``table()`` and ``plot()`` show all of it.

        Raises
        ------
        InputError
            An equation that was loaded from a file; `most` not a whole number, or below the number of forced terms.
        """
        judged = self.scored or self
        return parsimony_path(judged.solved(), judged.shown_posterior.support, most)

    def sensitivity(
        self, slab_variances: ArrayLike | None = None, prior_inclusions: ArrayLike | None = None
    ) -> PriorSensitivity:
        """Prior sensitivity of the PIPs: model averaging under other v_s and p_0, one at a time.

        Parameters
        ----------
        slab_variances, prior_inclusions : sequence of float, optional
            Values of v_s and of p_0 besides those used; by default v_s up to a hundred times smaller and larger, and
            p_0 from 0.01 to 0.5.

        Returns
        -------
        PriorSensitivity
            Print it for a summary; ``table()``, ``changes()`` and ``plot()`` show all of it.

        Raises
        ------
        InputError
            An equation that was loaded from a file, or by a method without spike-and-slab prior; values out of range.

        Warns
        -----
        ConvergenceWarning
            Too many models share the posterior mass to list them.
        """
        fit = self.solved()
        require_spike_slab(self.posterior.details.method)
        return prior_sensitivity(fit.standard.gram, fit.prior, slab_variances, prior_inclusions)

    def coarsening(self, powers: ArrayLike | None = None) -> PipCurve:
        """Sensitivity of the PIPs to the power of the likelihood: model averaging as each row counts for less.

        If the model is only nearly true, terms that compensate for missing ones vanish long before the others. To
        get the equation at a power, give it to `discover` as ``coarsen``.

        Parameters
        ----------
        powers : sequence of float, optional
            Powers of the likelihood that the equation was found with, above 0 and at most 1; by default halved from 1
            to 1/4096, as far as five rows are left.

        Returns
        -------
        PipCurve
            Print it for a summary; ``table()``, ``changes()`` and ``plot()`` show all of it.

        Raises
        ------
        InputError
            As for `sensitivity`.

        Warns
        -----
        ConvergenceWarning
            As for `sensitivity`.
        """
        fit = self.solved()
        require_spike_slab(self.posterior.details.method)
        return power_sensitivity(fit.standard.gram, fit.prior, powers)

    def solved(self) -> RegressionFit:
        """The regression; InputError where the equation is from a file, which does not hold it."""
        if self.fit is None:
            raise InputError("a file of equations does not hold what their posterior came from: run discover again")
        return self.fit
