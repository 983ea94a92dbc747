"""`discover`: from records to equations of motion, wiring the stages."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayeq.choice import Choice
from bayeq.coef_units import channel_units
from bayeq.constraints import Constraints, parse_constraints
from bayeq.diagnostics import Residuals, inspect_residuals
from bayeq.dictionary import Design, Variables, build_design, build_dictionary, evaluate_terms
from bayeq.equation import Equation, Fit, Regression, RunnerUp
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
<<<<<<< HEAD
from bayeq.expressions import Expression
=======
from bayeq.forecast.score import held_out_scores
>>>>>>> free-run
from bayeq.gram import Gram
from bayeq.inference import ENGINES, Prior
from bayeq.inference.path import partial_shares
from bayeq.inference.problem import Problem
from bayeq.inference.search import neighbours
from bayeq.inference.slab import learn_slab_variance, residual_scale
from bayeq.posterior import Posterior
from bayeq.propagation import propagated_covariance
from bayeq.records import Record, check_messages
from bayeq.spectral import noise_floor
from bayeq.states import Chain, ChainSmoothing, Smooth, States, derive_all, parse_chains
from bayeq.weighting import InBand, Piece, thinned_gram, weighted_gram

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

# With more candidates than this, correlation of the residuals is told of but not counted.
MOST_TERMS_TO_THIN = 500

# Methods that take signs of coefficients.
SIGNED = ("auto", "bma", "gibbs", "vb")

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
    max_terms: int | None = None,
    min_share: float | None = None,
    prior: Prior | None = None,
    constraints: str | Sequence[str] = (),
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
    max_terms : int, optional
        Show an equation of at most so many terms: the likeliest one where the method includes more. The path of
        each equation (`Equation.path`) tells what each further term brings.
    min_share : float, optional
        Leave out terms that explain a smaller share of the target's variance (see `Equation.share`), the smallest first
        and the others refitted each time. Mind that the damping of a light structure explains little and yet decides
        how its motion decays. PIPs stay what they are with either limit, and what it leaves out is listed beside the
        equation.
    prior : Prior, optional
        By default p_0 = 0.1, a slab variance v_s that maximises the evidence (at least 10), and a vague prior of
        the noise in units of the least-squares residual. A given prior applies to standardised columns and
        those units; its v_s is used as it is.
    constraints : str or sequence of str
        What is known of the coefficients, in original units: linear equations, ``"u == 1"``,
        ``"x*abs(x) == 0.5*x**3"``, and signs, ``"v <= 0"`` (but not by rvm and stlsq). They concern every equation,
        or with a target in front that one, ``"a: v <= 0"``.
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
    choice = Choice(max_terms, min_share)
    choice.check(method)

    step = progress or _silent
    notes = _Notes()
    step("states", 0, len(pieces))
    share = holdout if sum(piece.n for piece in pieces) >= LEAST_ROWS_TO_HOLD_OUT else 0.0
    states = derive_all(pieces, parsed, all_inputs, smooth, share)
    step("states", len(pieces), len(pieces))
    for message in check_messages(pieces, [chain.measured for chain in parsed], all_inputs):
        notes.warn(message, DataWarning)
    variables = Variables(tuple(name for chain in parsed for name in chain.states), all_inputs)
    terms = build_dictionary(dictionary, variables)
    train, held_out = _split(
        [{**s.columns, **{_measured(name): values for name, values in s.measured.items()}} for s in states],
        holdout,
        notes,
        ", ".join(p.name or "record" for p in pieces[:3]),
    )
    # what the equation is judged by: the measured target, where there is one
    targets = [_measured(c.target) if c.target in states[0].measured else c.target for c in parsed]
    design = build_design(terms, targets, train, held_out, lambda done, total: step("dictionary", done, total))
    _check_size(design, notes)
    known = [constraints] if isinstance(constraints, str) else list(constraints)
    reasons = {d.name: d.reason for d in design.dropped}
    constrained = parse_constraints(known, design.terms, [chain.target for chain in parsed], reasons)
    if method not in SIGNED and any(c.signs.any() for c in constrained):
        raise InputError(f"method {method!r} takes no signs of coefficients; take one of: {', '.join(SIGNED)}")

    units, conflicts = channel_units([piece.units for piece in pieces], parsed, all_inputs)
    for message in conflicts:
        notes.warn(message, DataWarning)
    equations = []
    for k, chain in enumerate(parsed):
        step("inference", k, len(parsed))
        in_band = _in_band(k, chain, states[0], design, train, all_inputs)
        equations.append(
            _solve(
                parsed,
                k,
                design,
                train,
                targets[k],
                in_band,
                states[0].smoothing,
                method,
                prior,
                constrained[k],
                choice,
                seed,
                variables,
                notes,
            )
        )
    step("inference", len(parsed), len(parsed))
    for message, category in notes.collected:
        warnings.warn(message, category, stacklevel=2)
    return Equations(
        equations=tuple(replace(equation, units=units) for equation in equations),
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
        constraints=tuple(known),
        scores=held_out_scores(
            parsed, all_inputs, [e.posterior for e in equations], [e.terms for e in equations], pieces, states, share
        ),
    )


def _measured(target: str) -> str:
    """Name of the column that holds a target's samples beside the smoothed one."""
    return f"{target} as measured"


def _in_band(
    k: int,
    chain: Chain,
    states: States,
    design: Design,
    train: Sequence[Mapping[str, Floats]],
    inputs: Sequence[str],
) -> InBand | None:
    """The Gram of smoothed, uniformly sampled records, weighted by the spectrum of the residuals."""
    used = states.smoothing
    if not used or any(s.fs is None for s in used):
        return None
    own, target = used[k], chain.target
    pieces = [
        Piece(
            evaluate_terms(design.terms, piece),
            piece[target],
            np.column_stack([piece[name] for name in chain.states]),
            np.column_stack([np.empty((len(piece[target]), 0)), *(piece[name] for name in inputs)]),
        )
        for piece in train
    ]
    names = tuple(term.text for term in design.terms)
    driven = [j for j, term in enumerate(design.terms) if term.names & set(inputs)]
    noise = {}
    for j in driven:
        if names[j] in inputs:
            floor = noise_floor([piece[names[j]] for piece in train])
            if floor is not None:
                noise[j] = floor
    return weighted_gram(pieces, names, own, min(s.limit for s in used), driven, noise)


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
    chains: Sequence[Chain],
    k: int,
    design: Design,
    train: Sequence[Mapping[str, Floats]],
    observed: str,
    in_band: InBand | None,
    smoothings: Sequence[ChainSmoothing],
    engine: str,
    prior: Prior | None,
    constraints: Constraints,
    choice: Choice,
    seed: int,
    variables: Variables,
    notes: _Notes,
) -> Equation:
    """Infer one equation and inspect it."""
    chain, rows = chains[k], design.train[k]
    if in_band is not None:
        gram = in_band.gram
    elif ENGINES[engine].spike_slab and len(rows.names) <= MOST_TERMS_TO_THIN:
        gram = thinned_gram(rows, lambda posterior: _inspect(observed, design, rows, posterior, train))
    else:
        gram = rows
    reduced, fitted = constraints.reduce(gram), constraints.reduce(rows)
    standard = reduced.standardise(residual_scale(reduced))
    learn, prior = prior is None, constraints.prior(prior or Prior())
    if learn:
        prior = replace(prior, slab_variance=learn_slab_variance(standard.gram, prior))
    method = ENGINES[engine]
    options: dict[str, Any] = {"seed": (seed, k)} if method.random else {}
    raw = method.run(standard.gram, prior, **options)
    found = raw.support
    raw, left_out = choice.apply(standard.gram, prior, fitted, raw) if choice.given else (raw, ())
    posterior = constraints.expand(standard.restore(raw), gram)
    if in_band is not None and not constraints.given:
        posterior = _propagated(in_band, posterior, design.terms, train, chains, k, smoothings, variables.inputs)
    if not posterior.converged:
        rhat = "" if posterior.rhat is None else f", multivariate R-hat {posterior.rhat:.3g}"
        notes.warn(f"{chain.target}: {engine} not converged after {posterior.n_iter} steps{rhat}", ConvergenceWarning)
    runners_up = _runners_up(standard.gram, prior, raw) if method.spike_slab else ()
    if raw.optimum is not None and bool((raw.optimum != found).any()):
        other = [n for n, kept in zip(reduced.names, raw.optimum, strict=True) if kept]
        notes.warn(
            f"{chain.target}: the optimum of variational Bayes is another model ({', '.join(other) or 'no terms'});"
            " the terms shown are those with a model-averaged PIP above 0.5",
            AmbiguityWarning,
        )
    residuals = _inspect(observed, design, rows, posterior, train, (*variables.inputs, *variables.states))
    if posterior.average is None:
        _warn_of_ambiguity(chain.target, runners_up, notes)
    else:
        _warn_of_groups(chain.target, posterior, notes)
    train_fit = _fit(rows, posterior)
    if in_band is not None:
        posterior = replace(posterior, noise_variance=_noise_variance(rows, posterior))
    if train_fit.r2 < LITTLE:
        estimated = " (it is estimated, not measured)" if chain.measured[-1] is None else ""
        notes.warn(
            f"{chain.target}: the terms explain only {100 * train_fit.r2:.0f} % of the target's variance{estimated}:"
            " this is hardly the law; check the channels, their derivatives and the dictionary",
            DataWarning,
        )
    counted = ", which is what the rows count for" if gram.n < rows.n else ""
    if in_band is None and residuals.correlated:
        notes.warn(
            f"{chain.target}: the residuals are correlated in time (lag-1 autocorrelation {residuals.lag1:.2f},"
            f" effective sample size about {residuals.n_eff:.0f} of {residuals.n}{counted}): standard deviations and"
            " intervals may be too narrow, and terms may be included that only fit the correlation",
            CorrelatedResidualsWarning,
        )
    if residuals.driven and residuals.driver is not None:
        notes.warn(
            f"{chain.target}: the residuals follow {residuals.driver}: the equation misses dynamics, or channels are"
            " delayed against each other",
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
        regression=Regression(
            standard,
            prior,
            fitted,
            constraints.reduce(design.held_out[k]) if design.held_out else None,
            raw.support,
        ),
        share=partial_shares(rows, posterior.support),
        left_out=left_out,
    )


def _propagated(
    in_band: InBand,
    posterior: Posterior,
    terms: Sequence[Expression],
    train: Sequence[Mapping[str, Floats]],
    chains: Sequence[Chain],
    k: int,
    smoothings: Sequence[ChainSmoothing],
    inputs: Sequence[str],
) -> Posterior:
    """The posterior with the covariance that the noise of the channels makes, where there are terms."""
    if not posterior.support.any():
        return posterior
    covariance = propagated_covariance(in_band, posterior, terms, train, chains, smoothings, k, inputs)
    averaged = posterior.averaged_sd
    if averaged is not None:
        # within the model shown; between models it stays
        kept = posterior.support
        within = posterior.pip[kept] * np.diagonal(covariance)
        change = within - posterior.pip[kept] * np.diagonal(posterior.covariance)
        averaged = averaged.copy()
        averaged[kept] = np.sqrt(np.maximum(averaged[kept] ** 2 + change, within))
    return replace(posterior, covariance=covariance, averaged_sd=averaged)


def _runners_up(gram: Gram, prior: Prior, posterior: Posterior) -> tuple[RunnerUp, ...]:
    problem = Problem.of(gram, prior)
    if len(problem.signs):
        from bayeq.inference.signed_models import signed_neighbours

        moves = signed_neighbours(problem, posterior.support, RUNNER_UP_WINDOW)
    else:
        moves = neighbours(problem, posterior.support, RUNNER_UP_WINDOW)
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


def _inspect(
    observed: str,
    design: Design,
    rows: Gram,
    posterior: Posterior,
    train: Sequence[Mapping[str, Floats]],
    channels: Sequence[str] = (),
) -> Residuals:
    """Training residuals, against some channels; those that are rounding of the Gram count as white."""
    found = inspect_residuals(
        [_residual(observed, design, posterior, piece) for piece in train],
        {name: [piece[name] for piece in train] for name in channels},
    )
    return found if _fit(rows, posterior).nrmse > ROUNDING else Residuals(found.n, 0.0, float(found.n))


def _noise_variance(rows: Gram, posterior: Posterior) -> float:
    """Variance of the residual over the rows: what the spectrum of the band does not tell."""
    spare = max(rows.n - 1.0 - float(posterior.support.sum()), 1.0)
    return rows.squared_error(posterior.coef, posterior.intercept) / spare


def _fit(gram: Gram, posterior: Posterior) -> Fit:
    share = gram.squared_error(posterior.coef, posterior.intercept) / gram.yty if gram.yty > 0 else 1.0
    return Fit(n=round(gram.n), r2=1.0 - share, nrmse=math.sqrt(share))
