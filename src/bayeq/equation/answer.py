"""`Answer`: the discovered equations as tables, formulas and functions, and a summary of the data they come from."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Floats
from bayeq.dictionary.ranges import ConstantEstimate
from bayeq.equation.equation import Equation
from bayeq.equation.export import Uncertainty, derivatives, to_callable, to_code
from bayeq.equation.plan.designs import Measured
from bayeq.equation.refine.refine import Refinement
from bayeq.equation.verdict import Verdict, worst
from bayeq.errors import InputError
from bayeq.expressions import Binary, Evaluator, Expression, Symbol
from bayeq.expressions.functions import TIME
from bayeq.figures.style import joined
from bayeq.forecast.dynamics import Dynamics, Law, solved_laws
from bayeq.forecast.score import Scores
from bayeq.inference.posterior import Posterior
from bayeq.numerics.rk4 import Interpolation
from bayeq.records import Record, counts_rows
from bayeq.records.names import rate_and_length
from bayeq.regression.constraints import CONSERVED, Constraints, parse_constraints
from bayeq.regression.design import DroppedTerm
from bayeq.states import Chain, Motion, Roles, Sensors, Smooth

if TYPE_CHECKING:
    import pandas as pd

# Name of the constant as a term, as in libraries of polynomials.
CONSTANT = "1"


@dataclass(frozen=True, slots=True)
class DataSummary:
    """The data that the equations were found from: records, rows, sampling and noise."""

    files: tuple[str, ...]  # names of the records
    n: int  # measured rows in all; of these, rows used (`n_train`) and rows held out
    n_train: int
    n_held_out: int
    estimated: tuple[str, ...] = ()  # derivatives that were not measured but estimated
    smoothed: bool = False  # by the kinematic smoother
    holdout: float = 0.0  # share of the rows of each record that was held out
    refitted: bool = False  # whether the equations, once scored on the rows held out, were found again from all rows
    measured: Measured = field(default_factory=Measured)  # rates and ranges, for the plan of a next measurement
    sensors: Sensors = field(default_factory=Sensors)  # noise, factors, lags and tails of the channels
    seconds: float | None = None  # length of all records together [s]; None where time is not known
    clock: str = "s"  # unit of time, of `seconds` and of 1/`fs`: "s", or "year" for records in years
    rows_as_time: bool = False  # whether row numbers replace an unknown time: coefficients are then per sample
    band: tuple[float, float] | None = None  # frequency band [Hz] to which the fit was restricted, if it was
    stretches: int = 0  # stretches of long records that give noise levels, verdict and free runs; 0: all rows do
    # interpolation of inputs between samples, as the likelihood found it; other inputs are smooth
    interpolation: Mapping[str, Interpolation] = field(default_factory=dict)
    # standard deviation of each channel's noise, in its unit, as estimated by the likelihood
    noise_sd: Mapping[str, float] = field(default_factory=dict)

    def of_stretches(self, files: Sequence[str], used: int, held_out: int, stretches: int) -> Self:
        """The summary for all rows of long records, from this one for stretches of them."""
        n = used + held_out
        seconds = None if self.seconds is None else self.seconds * n / max(self.n, 1)
        return replace(
            self,
            files=tuple(dict.fromkeys(files)),
            n=n,
            n_train=used,
            n_held_out=held_out,
            seconds=seconds,
            stretches=stretches,
        )

    @property
    def fs(self) -> float | None:
        """Sampling rate [Hz] of the longest record; None where time is not known."""
        return None if self.rows_as_time else self.measured.fs

    @property
    def sampling(self) -> tuple[str, str] | None:
        """Sampling rate and length of the records as text; None where time is not known."""
        if self.fs is None or self.seconds is None:
            return None
        return rate_and_length(f"{self.fs:.6g}", f"{self.seconds:.4g}", self.clock)

    @classmethod
    def of(cls, records: Sequence[Record], motion: Motion, refitted: bool = False) -> Self:
        """The summary of records and their motion."""
        used, held_out = motion.counts
        rows_as_time = any(map(counts_rows, records))
        return cls(
            files=tuple(dict.fromkeys(record.name for record in records)),
            n=used + held_out,
            n_train=used,
            n_held_out=held_out,
            estimated=motion.estimated,
            smoothed=bool(motion.smoothing),
            holdout=motion.holdout,
            refitted=refitted,
            measured=Measured.of(records, motion.roles.measured, motion.roles.inputs),
            sensors=motion.sensors,
            seconds=None if rows_as_time or not motion.timed else sum(record.duration for record in records),
            clock="s" if rows_as_time else records[0].clock,
            rows_as_time=rows_as_time,
            band=motion.band,
            interpolation={
                name: kind
                for name, kind in motion.courses.items()
                if any(np.ptp(rows.columns[name]) > 0.0 for rows in motion.records)
            },
            noise_sd=motion.noise_sd,
        )


class EquationTuple(tuple[Equation, ...]):
    """A tuple of `Equation` in the order of the chains; calling it gives the equations as strings.

    ``eq.equations[0]`` is an `Equation`; ``eq.equations()`` is the list of printed lines, like PySINDy's method of this
    name.
    """

    __slots__ = ()

    def __call__(self) -> list[str]:
        """The equations as text, coefficients to a tenth of their standard deviation."""
        return [equation.text for equation in self]


@dataclass(frozen=True)
class HiddenState:
    """A state that no channel measures."""

    state: str  # its name
    log_odds_without: float  # ln of the odds of the best equations without hidden states against those with them
    stated: bool = True  # whether its law was stated; otherwise the law was found from terms of a dictionary


def with_shown(chain: Chain, terms: Sequence[Expression], shown: Posterior) -> Chain:
    """The chain; for a hidden state whose law was found, with the terms shown and their coefficients as its law."""
    pairs = zip(shown.coef.tolist(), terms, shown.support, strict=True)
    return chain.with_found([(value, term) for value, term, inside in pairs if inside]) if chain.found else chain


@dataclass(frozen=True, eq=False)
class Answer:
    """The equations that were found, with their export as tables, formulas and functions; see `Equations`."""

    equations: EquationTuple
    inputs: tuple[str, ...]
    method: str
    dictionary: str
    smooth: Smooth
    data: DataSummary
    dropped: tuple[DroppedTerm, ...] = ()
    warnings: tuple[str, ...] = ()
    constraints: tuple[str, ...] = ()
    scores: Scores | None = None
    refined: Refinement | None = None
    hidden: tuple[HiddenState, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "equations", EquationTuple(self.equations))

    def __len__(self) -> int:
        return len(self.equations)

    def __iter__(self) -> Iterator[Equation]:
        return iter(self.equations)

    def __getitem__(self, key: int | str) -> Equation:
        """The equation at a position, or of the target of this name."""
        return {one.target: one for one in self.equations}[key] if isinstance(key, str) else self.equations[key]

    @property
    def chains(self) -> tuple[Chain, ...]:
        """The kinematic chains."""
        return tuple(equation.chain for equation in self.equations)

    @property
    def in_dots(self) -> tuple[Chain, ...]:
        """The chains whose derivatives may be written as dots."""
        return tuple(equation.chain for equation in self.equations if equation.in_seconds)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the first-order state vector, the order of `rhs`."""
        return tuple(name for chain in self.chains for name in chain.states)

    @property
    def units(self) -> dict[str, str]:
        """Units of all channels, as far as they are known."""
        return {name: unit for equation in self.equations for name, unit in equation.units.items()}

    @cached_property
    def roles(self) -> Roles:
        """Chains and inputs, and whether terms use the time."""
        return Roles(self.chains, self.inputs).for_terms(term for equation in self.equations for term in equation.terms)

    @property
    def differing(self) -> tuple[str, ...]:
        """Terms with a coefficient for each record: products with the indicators `numbers` are terms too, x*run2."""
        trees = [term.tree for equation in self.equations for term in equation.terms]
        numbered = [
            tree for tree in trees if isinstance(tree, Binary) and tree.op == "*" and tree.right in self._numbers
        ]
        return tuple(dict.fromkeys(Expression(tree.left).text for tree in numbered))

    @cached_property
    def numbers(self) -> tuple[str, ...]:
        """Indicator inputs of records with coefficients of their own, 1 in one record and 0 in others: run2, run3."""
        return tuple(one.name for one in self._numbers) if self.differing else ()

    @cached_property
    def _numbers(self) -> list[Symbol]:
        names = [name for name in self.inputs if re.fullmatch(r"run[1-9]\d*", name)]
        return list(map(Symbol, names)) if names == [f"run{k}" for k in range(2, len(names) + 2)] else []

    @property
    def constants(self) -> tuple[ConstantEstimate, ...]:
        """Constants inside the terms of all equations, each once."""
        return tuple({one.name: one for equation in self.equations for one in equation.constants}.values())

    @property
    def verdict(self) -> Verdict:
        """Whether the equations were found: the worst of their verdicts."""
        return worst([(equation.target, equation.verdict) for equation in self.equations])

    def known(self) -> tuple[Constraints, ...]:
        """The parsed constraints on the coefficients of each equation, without conserved sums."""
        dropped = {term.name: term.reason for term in self.dropped}
        targets = [equation.target for equation in self.equations]
        texts = [text for text in self.constraints if not text.endswith(CONSERVED)]
        return tuple(
            parse_constraints(texts, equation.terms, targets, dropped)[k] for k, equation in enumerate(self.equations)
        )

    def table(self) -> pd.DataFrame:
        """All candidates of all equations: target, term, coef, sd, ci_low, ci_high, pip, included."""
        return joined("target", [(equation.target, equation) for equation in self.equations]).reset_index(drop=True)

    def coefficients(self) -> dict[str, dict[str, float]]:
        """Coefficients of the equations shown: ``{"a": {"x": -1000.3, "v": -2.0, "u": 1.0}}``.

        The constant is the term ``"1"``, where it is written out. ``pandas.DataFrame(eq.coefficients())`` is the matrix
        that PySINDy's method of this name gives, with names; all candidates are in `table`.
        """
        out: dict[str, dict[str, float]] = {}
        for equation in self.equations:
            out[equation.target] = equation.shown_coef
            if equation.intercept_matters:
                out[equation.target][CONSTANT] = float(equation.shown_posterior.intercept)
        return out

    def to_sympy(self) -> Any:
        """`sympy.Eq`, or a list of them where there are several equations."""
        out = [equation.to_sympy() for equation in self.equations]
        return out[0] if len(out) == 1 else out

    def to_latex(self, uncertainty: Uncertainty = "none", *, aligned: bool = False) -> str:
        r"""LaTeX, one equation per line.

        Parameters
        ----------
        uncertainty : "none", "brackets" or "plus-minus"
            See `Equation.to_latex`.
        aligned : bool
            Whether the lines stand in an ``aligned`` environment, equal signs below each other.
        """
        lines = [equation.to_latex(uncertainty, self.in_dots) for equation in self.equations]
        if not aligned:
            return " \\\\\n".join(lines)
        body = " \\\\\n".join(line.replace(" = ", " &= ", 1) for line in lines)
        return f"\\begin{{aligned}}\n{body}\n\\end{{aligned}}"

    def to_callable(self, module: Literal["numpy", "jax"] = "numpy") -> Callable[..., Any]:
        """The right-hand side as a function ``f(t, y, u=None)`` for many points at once.

        Parameters
        ----------
        module : "numpy" or "jax"
            Library of the arrays. JAX computes in single precision unless ``jax_enable_x64`` is set.

        Returns
        -------
        callable
            Takes states (d,) or (d, n) in the order of `states`, inputs (m,) or (m, n), and times; returns time
            derivatives in the shape of the states. SciPy's ``solve_ivp`` takes it with ``vectorized=True``.

        Raises
        ------
        UnknownNameError
            An unknown `module`.
        MissingExtraError
            JAX is not installed.
        """
        return to_callable([equation.law for equation in self.equations], self.inputs, self.roles.timed, module)

    def to_code(self, language: str) -> str:
        """The right-hand side as source text: a function `rhs` of time, states and inputs, without dependencies.

        Parameters
        ----------
        language : "c", "julia", "matlab" or "python"
            Printed by SymPy, coefficients with 17 digits. Channels whose names the language does not allow get others.

        Raises
        ------
        UnknownNameError
            An unknown `language`.
        InputError
            Terms that the language cannot express.
        """
        return to_code([equation.law for equation in self.equations], self.inputs, self.roles.timed, language)

    def to_python(self) -> str:
        """``to_code("python")``: a function of plain Python that needs the module `math` alone."""
        return self.to_code("python")

    def rhs(self, t: float, state: ArrayLike, u: ArrayLike | None = None) -> Floats:
        """Time derivative of the state vector, as SciPy's `solve_ivp` takes it.

        Parameters
        ----------
        t : float
            Time [s], for terms that use it.
        state : (d,) array
            In the order of `states`: each coordinate and its derivatives below the highest.
        u : (m,) array or float, optional
            Inputs at this time, needed where there are inputs.

        Returns
        -------
        (d,) array
            In the unit of each state per second, even if the units of a chain's channels are inconsistent (see
            `Equation.unit_gains`). If all laws are static: their targets.
        """
        values = _numbers(state, "the state")
        if values.shape != (len(self.states),):
            raise InputError(f"the state has {len(self.states)} entries {self.states}, got shape {values.shape}")
        given = np.atleast_1d(_numbers([] if u is None else u, "u"))
        if given.shape != (len(self.inputs),):
            raise InputError(f"need {len(self.inputs)} input values {self.inputs}, got {given.size}")
        columns = dict(zip(self.states, values, strict=True)) | dict(zip(self.inputs, given, strict=True))
        if self.roles.timed:
            columns[TIME] = np.float64(t)
        evaluate, static = Evaluator(columns), not self.states
        rows = [row for law in self._laws for row in derivatives(law, columns, evaluate, static)]
        return np.array(rows, dtype=np.float64)

    @cached_property
    def _laws(self) -> list[Law]:
        """The laws; where terms hold highest derivatives, the system is solved for these."""
        return solved_laws([one.law for one in self.equations])

    def dynamics(self, intercepts: Sequence[bool] | None = None) -> Dynamics:
        """The equations shown as one system of first order; by default all have an intercept.

        Parameters
        ----------
        intercepts : sequence of bool, optional
            For each equation, whether it has an intercept.

        Returns
        -------
        Dynamics
            The system that `simulate` integrates.
        """
        return Dynamics.of([equation.law for equation in self.equations], self.roles, intercepts)


def _numbers(value: Any, what: str) -> Floats:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{what} must be numbers, not {type(value).__name__}") from None
