"""`discover`: from records to equations of motion, wiring the stages."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayeq.diagnostics import inspect_residuals
from bayeq.dictionary import Design, Variables, build_design, build_dictionary, evaluate_terms
from bayeq.equation import Equation, Fit, RunnerUp
from bayeq.equations import DataSummary, Equations
from bayeq.errors import (
    AmbiguityWarning,
    BayeqWarning,
    ChainError,
    ConvergenceWarning,
    CorrelatedResidualsWarning,
    DataWarning,
    InputError,
    RecordError,
    TermWarning,
    UnknownNameError,
)
from bayeq.gram import Gram
from bayeq.inference import ENGINES, Prior
from bayeq.inference.problem import Problem
from bayeq.inference.search import neighbours
from bayeq.inference.slab import learn_slab_variance, residual_scale
from bayeq.posterior import Posterior
from bayeq.records import Record
from bayeq.states import Chain, Smooth, derive_states, parse_chains

__all__ = ["discover"]

Floats = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

# With fewer rows none are held out; with fewer training rows than this there is no regression.
LEAST_ROWS_TO_HOLD_OUT = 50
LEAST_TRAINING_ROWS = 3

# Residuals smaller than this share of the target are rounding of the Gram, and correlated.
ROUNDING = 1e-6

# An equation that explains a smaller share of the target's variance is warned of.
LITTLE = 0.5

# Runner-up models within this log odds are kept; a swap within AMBIGUOUS means columns that cannot be told apart.
RUNNER_UP_WINDOW = 12.0
RUNNERS_UP = 5
AMBIGUOUS = math.log(20.0)


def discover(
    records: Record | Sequence[Record],
    *,
    chains: str | Sequence[str] | None = None,
    displacement: str | None = None,
    velocity: str | None = None,
    acceleration: str | None = None,
    force: str | None = None,
    inputs: Sequence[str] = (),
    dictionary: str | Sequence[str] = "oscillator",
    method: str = "auto",
    smooth: Smooth = "auto",
    holdout: float = 0.2,
    prior: Prior | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Equations:
    """Find the governing equations of measured motion.

    Parameters
    ----------
    records : Record or sequence of Record
        Measured channels; several records of the same system are used together.
    chains : sequence of str, optional
        A coordinate and its measured derivatives each: ``"x:v:a"``, ``"x::"``, ``"x"`` (first order).
    displacement, velocity, acceleration : str, optional
        Channels of one oscillator's chain, instead of `chains`.
    force : str, optional
        Channel of its force.
    inputs : sequence of str
        Channels of further inputs.
    dictionary : str or sequence of str
        ``"oscillator"`` (eq. (31)), ``"polynomial:3"``, a file of terms, or terms.
    method : str
        ``"auto"`` (the optimum of variational Bayes, probabilities by model averaging), ``"vb"``, ``"bma"``,
        ``"gibbs"`` (MCMC), ``"rvm"`` or ``"stlsq"`` (SINDy).
    smooth : "auto" or "none"
        How derivatives that are not measured are had, see `bayeq.states.derive_states`.
    holdout : float
        Share of the rows, the last of each record, that is not used but predicted.
    prior : Prior, optional
        By default p_0 = 0.1, a slab variance v_s that maximises the evidence (at least 10), and a vague prior of
        the noise in units of the least-squares residual. A given prior applies to standardised columns and
        those units; its v_s is used as it is.
    seed : int
        Seed of methods that draw random numbers (``"gibbs"``).
    progress : callable, optional
        Called with (stage, done, total).

    Returns
    -------
    Equations
        Coefficients in original units.

    Raises
    ------
    InputError
        Channels, chains, terms or samples that cannot be used; the message says which and what to do.

    Warns
    -----
    TermWarning, DataWarning, AmbiguityWarning, CorrelatedResidualsWarning, ConvergenceWarning
        What makes the answer less than it seems; also kept in ``warnings`` of the result.

    Examples
    --------
    >>> import bayeq as bq
    >>> rec = bq.simulate("duffing", seed=1)
    >>> eq = bq.discover(rec, displacement="x", velocity="v", acceleration="a", force="u")
    >>> eq[0].included
    ('x', 'v', 'x**3', 'u')
    """
    pieces = [records] if isinstance(records, Record) else list(records)
    if not pieces or not all(isinstance(piece, Record) for piece in pieces):
        raise InputError("discover needs a Record or a list of Records (bayeq.read, Record.from_arrays)")
    parsed = _chains(chains, displacement, velocity, acceleration)
    all_inputs = ((force,) if force is not None else ()) + tuple(inputs)
    if len(set(all_inputs)) < len(all_inputs):
        raise InputError(f"an input is named twice: {', '.join(all_inputs)}")
    if method not in ENGINES:
        raise UnknownNameError("method", method, ENGINES)
    if not 0 <= holdout < 1:
        raise InputError(f"holdout is a share of the rows, 0 <= holdout < 1, got {holdout!r}")

    step = progress or _silent
    notes = _Notes()
    states = []
    for k, piece in enumerate(pieces):
        step("states", k, len(pieces))
        states.append(derive_states(piece, parsed, all_inputs, smooth))
    variables = Variables(tuple(name for chain in parsed for name in chain.states), all_inputs)
    terms = build_dictionary(dictionary, variables)
    train, held_out = _split(
        [s.columns for s in states], holdout, notes, ", ".join(p.name or "record" for p in pieces[:3])
    )
    targets = [chain.target for chain in parsed]
    design = build_design(terms, targets, train, held_out, lambda done, total: step("dictionary", done, total))
    _check_size(design, notes)

    equations = []
    for k, chain in enumerate(parsed):
        step("inference", k, len(parsed))
        equations.append(_solve(chain, k, design, train, method, prior, seed, notes))
    step("inference", len(parsed), len(parsed))
    for message, category in notes.collected:
        warnings.warn(message, category, stacklevel=2)
    return Equations(
        equations=tuple(equations),
        inputs=all_inputs,
        method=method,
        dictionary=dictionary if isinstance(dictionary, str) else ", ".join(str(t) for t in dictionary),
        smooth=smooth,
        data=DataSummary(
            files=tuple(piece.name for piece in pieces),
            n=sum(piece.n for piece in pieces),
            n_train=round(design.train[0].n),
            n_held_out=round(design.held_out[0].n) if design.held_out else 0,
            estimated=states[0].estimated,
        ),
        dropped=design.dropped,
        warnings=tuple(message for message, _ in notes.collected),
    )


def _silent(stage: str, done: int, total: int) -> None:
    """No progress shown."""


class _Notes:
    """Warnings collected on the way: given at the end, and kept in the answer."""

    def __init__(self) -> None:
        self.collected: list[tuple[str, type[BayeqWarning]]] = []

    def warn(self, message: str, category: type[BayeqWarning]) -> None:
        self.collected.append((message, category))


def _chains(
    chains: str | Sequence[str] | None,
    displacement: str | None,
    velocity: str | None,
    acceleration: str | None,
) -> tuple[Chain, ...]:
    if chains is not None:
        if displacement or velocity or acceleration:
            raise ChainError("give either chains or displacement, velocity and acceleration, not both")
        return parse_chains([chains] if isinstance(chains, str) else list(chains))
    if displacement is None:
        raise ChainError(
            "no coordinate given: name the displacement (and, where measured, velocity and acceleration), or a chain"
            " such as x:v:a"
        )
    for role, channel in (("displacement", displacement), ("velocity", velocity), ("acceleration", acceleration)):
        if channel is not None and (not channel.strip() or ":" in channel):
            raise ChainError(
                f"{role} {channel[:60]!r} is not a channel's name; name one, or give a chain such as x:v:a instead"
            )
    return parse_chains([f"{displacement}:{velocity or ''}:{acceleration or ''}"])


def _split(
    columns: Sequence[Mapping[str, Floats]], holdout: float, notes: _Notes, where: str
) -> tuple[list[Mapping[str, Floats]], list[Mapping[str, Floats]]]:
    """Training rows and the last rows of each record, held out."""
    train: list[Mapping[str, Floats]] = []
    held_out: list[Mapping[str, Floats]] = []
    total = sum(len(next(iter(piece.values()))) for piece in columns)
    if total < LEAST_TRAINING_ROWS:
        rows = f"{total} row{'s' * (total != 1)}"
        raise RecordError(f"{where}: {rows}: too few for a regression (at least {LEAST_TRAINING_ROWS}); measure more")
    share = holdout if total >= LEAST_ROWS_TO_HOLD_OUT else 0.0
    for piece in columns:
        n = len(next(iter(piece.values())))
        cut = n - int(share * n)
        train.append({name: values[:cut] for name, values in piece.items()})
        if cut < n:
            held_out.append({name: values[cut:] for name, values in piece.items()})
    left = sum(len(next(iter(piece.values()))) for piece in train)
    if left < LEAST_TRAINING_ROWS:
        raise RecordError(f"holdout {holdout:g} leaves {left} training rows, too few for a regression; lower it")
    if holdout > 0 and share == 0:
        notes.warn(f"only {total} rows: all are used, none held out to judge the equation by", DataWarning)
    return train, held_out


def _check_size(design: Design, notes: _Notes) -> None:
    n, terms = design.train[0].n, len(design.terms)
    if n < LEAST_TRAINING_ROWS:
        raise RecordError(f"{n} training rows are too few for a regression (at least {LEAST_TRAINING_ROWS})")
    if n <= terms:
        notes.warn(
            f"{n} training rows for {terms} candidate terms: fewer rows than terms; the prior decides much, and few"
            " terms can be found",
            DataWarning,
        )
    if design.dropped:
        listed = "; ".join(f"{d.name} ({d.reason})" for d in design.dropped[:8])
        more = f" and {len(design.dropped) - 8} more" if len(design.dropped) > 8 else ""
        notes.warn(f"terms left out: {listed}{more}", TermWarning)


def _solve(
    chain: Chain,
    k: int,
    design: Design,
    train: Sequence[Mapping[str, Floats]],
    engine: str,
    prior: Prior | None,
    seed: int,
    notes: _Notes,
) -> Equation:
    """Infer one equation and inspect it."""
    gram = design.train[k]
    standard = gram.standardise(residual_scale(gram))
    if prior is None:
        prior = Prior()
        prior = replace(prior, slab_variance=learn_slab_variance(standard.gram, prior))
    method = ENGINES[engine]
    options: dict[str, Any] = {"seed": (seed, k)} if method.random else {}
    raw = method.run(standard.gram, prior, **options)
    posterior = standard.restore(raw)
    if not posterior.converged:
        chains = "" if posterior.rhat is None else f", multivariate R-hat {posterior.rhat:.3g}"
        notes.warn(f"{chain.target}: {engine} not converged after {posterior.n_iter} steps{chains}", ConvergenceWarning)
    runners_up = _runners_up(standard.gram, prior, raw) if method.spike_slab else ()
    if posterior.optimum is not None and bool((posterior.optimum != posterior.support).any()):
        other = [n for n, kept in zip(gram.names, posterior.optimum, strict=True) if kept]
        notes.warn(
            f"{chain.target}: the optimum of variational Bayes is another model ({', '.join(other) or 'no terms'});"
            " the terms shown are those with a model-averaged PIP above 0.5",
            AmbiguityWarning,
        )
    residuals = inspect_residuals([_residual(chain.target, design, posterior, piece) for piece in train])
    if posterior.average is None:
        _warn_of_ambiguity(chain.target, runners_up, notes)
    else:
        _warn_of_groups(chain.target, posterior, notes)
    train_fit = _fit(gram, posterior)
    if train_fit.r2 < LITTLE:
        estimated = " (it is estimated, not measured)" if chain.measured[-1] is None else ""
        notes.warn(
            f"{chain.target}: the terms explain only {100 * train_fit.r2:.0f} % of the target's variance{estimated}:"
            " this is hardly the law; check the channels, their derivatives and the dictionary",
            DataWarning,
        )
    if residuals.correlated and train_fit.nrmse > ROUNDING:
        notes.warn(
            f"{chain.target}: the residuals are correlated in time (lag-1 autocorrelation {residuals.lag1:.2f},"
            f" effective sample size about {residuals.n_eff:.0f} of {residuals.n}): standard deviations and intervals"
            " are too narrow, and terms may be included that only fit the correlation",
            CorrelatedResidualsWarning,
        )
    return Equation(
        chain=chain,
        terms=design.terms,
        posterior=posterior,
        train=train_fit,
        held_out=_fit(design.held_out[k], posterior) if design.held_out else None,
        residuals=residuals,
        runners_up=runners_up,
    )


def _runners_up(gram: Gram, prior: Prior, posterior: Posterior) -> tuple[RunnerUp, ...]:
    moves = neighbours(Problem.of(gram, prior), posterior.support, RUNNER_UP_WINDOW)
    names = gram.names
    return tuple(
        RunnerUp(
            leaves=None if move.leaves is None else names[move.leaves],
            enters=None if move.enters is None else names[move.enters],
            log_odds=move.gain,
        )
        for move in moves[:RUNNERS_UP]
    )


def _warn_of_ambiguity(target: str, runners_up: Sequence[RunnerUp], notes: _Notes) -> None:
    swaps = [r for r in runners_up if r.leaves and r.enters and r.log_odds > -AMBIGUOUS]
    if swaps:
        listed = "; ".join(f"{r} (odds {r.odds})" for r in swaps)
        notes.warn(f"{target}: columns that the data hardly tell apart: {listed}", AmbiguityWarning)


def _warn_of_groups(target: str, posterior: Posterior, notes: _Notes) -> None:
    assert posterior.average is not None
    for members, some in posterior.average.credible_groups():
        if some <= 0.5:
            continue  # more likely than not that none of them is in
        listed = ", ".join(f"{posterior.names[j]} (PIP {posterior.pip[j]:.2f})" for j in members)
        included = [posterior.names[j] for j in members if posterior.support[j]]
        advice = "" if len(included) == 1 else "; keep one of them in the dictionary, or decide by other knowledge"
        notes.warn(
            f"{target}: columns that the data hardly tell apart: {listed}; at least one of them is in with"
            f" probability {some:.2f}; included here: {', '.join(included) or 'none'}{advice}",
            AmbiguityWarning,
        )


def _residual(target: str, design: Design, posterior: Posterior, piece: Mapping[str, Floats]) -> Floats:
    kept = np.flatnonzero(posterior.support)
    out: Floats = piece[target] - posterior.intercept
    if len(kept):
        out = out - evaluate_terms([design.terms[j] for j in kept], piece) @ posterior.coef[kept]
    return out


def _fit(gram: Gram, posterior: Posterior) -> Fit:
    share = gram.squared_error(posterior.coef, posterior.intercept) / gram.yty if gram.yty > 0 else 1.0
    return Fit(n=round(gram.n), r2=1.0 - share, nrmse=math.sqrt(share))
