"""`discover`: from records to equations of motion."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

from bayeq.dictionary import Variables, build_dictionary
from bayeq.equation.build import build_equation, warn_of
from bayeq.equation.equations import DataSummary, Equations
from bayeq.equation.units import channel_units
from bayeq.equation.verdict import window_errors
from bayeq.errors import DataWarning, InputError, RecordError, TermWarning, UnknownNameError, WarningLog
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.score import held_out_scores
from bayeq.inference import ENGINES, Prior
from bayeq.records import Record, check_messages, split_at_gaps
from bayeq.regression.constraints import parse_constraints
from bayeq.regression.design import Design, build_design
from bayeq.regression.fit import fit_regression
from bayeq.regression.regression import Regression
from bayeq.selection.negligible import NEGLIGIBLE
from bayeq.selection.select import Rules, select
from bayeq.states import Motion, Roles, Smooth, estimate_motion, measured_apart
from bayeq.states.motion import held_out_share

__all__ = ["discover"]

Progress = Callable[[str, int, int], None]

# With fewer training rows there is no regression.
LEAST_TRAINING_ROWS = 3

# Methods that take signs of coefficients.
SIGNED = ("auto", "bma", "gibbs", "vb")


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
    negligible: float = NEGLIGIBLE,
    coarsen: float = 1.0,
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
        A coordinate and its measured derivatives each: ``"x:v:a"``, ``"x::"``, ``"x"`` (first order). In ``"::a"``,
        only the acceleration measured, the coordinate is called x.
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
        How derivatives that are not measured are estimated, see `bayeq.states.estimate_motion`.
    holdout : float
        Share of the rows, the last of each record, that is not used but predicted.
    max_terms : int, optional
        Largest number of terms that are shown: the likeliest such model where the method includes more. The path of
        each equation (`Equation.path`) tells what each further term brings. Probabilities and the included terms stay;
        what is left out is listed beside the equation.
    negligible : float
        Terms that are certain and yet make no practical difference are listed beside the equation: those that together
        explain a smaller share of the target's variance than this, and without which free runs over the training rows
        are hardly worse (`bayeq.selection.negligible`). 0 shows them.
    coarsen : float
        Power, above 0 and at most 1, that the likelihood is raised to: each row counts as this share of one (Miller
        and Dunson 2019). It widens all intervals and asks more evidence of a term, for models that are only nearly
        true. `Equation.coarsening` shows how PIPs depend on it.
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
    log = WarningLog()
    step = progress or _silent
    rules = Rules(max_terms, negligible)
    _check(method, rules, holdout, coarsen)
    roles = Roles.parse(chains, displacement, velocity, acceleration, force, inputs)
    terms = build_dictionary(dictionary, Variables(roles.states, roles.inputs))
    known = [constraints] if isinstance(constraints, str) else list(constraints)
    parse_constraints(known, terms, roles.targets)  # what is wrong with them is said before the work
    step("states", 0, 1)
    pieces = _as_records(records)
    share = held_out_share(holdout, sum(piece.n for piece in pieces))
    pieces, roles = _prepared(pieces, roles, smooth, share, log)
    motion = estimate_motion(pieces, roles, smooth, share)
    _check_rows(motion, pieces, holdout, log)
    for message in check_messages(pieces, [chain.measured for chain in roles.chains], roles.inputs):
        log.warn(message, DataWarning)
    step("states", 1, 1)
    design = build_design(terms, motion, lambda done, total: step("dictionary", done, total))
    _warn_of_terms(design, log)
    constrained = parse_constraints(known, design.terms, roles.targets, {d.name: d.reason for d in design.dropped})
    if method not in SIGNED and any(one.signs.any() for one in constrained):
        raise InputError(f"method {method!r} takes no signs of coefficients; choose one of: {', '.join(SIGNED)}")
    units, conflicts = channel_units([piece.units for piece in pieces], roles.chains, roles.inputs)
    for message in conflicts:
        log.warn(message, DataWarning)

    engine, fits = ENGINES[method], []
    for k in range(len(roles.chains)):
        step("inference", k, len(roles.chains))
        regression = Regression.of(design, k)
        if engine.spike_slab:
            regression = regression.thinned()
        fits.append(fit_regression(regression, constrained[k], engine, prior, coarsen, seed=(seed, k)))
    selections = select(fits, rules, motion)
    step("inference", len(roles.chains), len(roles.chains))

    posteriors = [one.fit.expanded(one.shown) for one in selections]
    dynamics = Dynamics.of(roles.chains, roles.inputs, posteriors, [design.terms] * len(posteriors))
    windows = window_errors(dynamics, dynamics.means(posteriors), motion)
    equations = []
    for k, selection in enumerate(selections):
        equation = replace(build_equation(selection, None if windows is None else windows[k]), units=units)
        warn_of(equation, selection, log)
        equations.append(equation)
    scores = held_out_scores(dynamics, dynamics.means(posteriors), motion)
    for message, category in log.collected:
        warnings.warn(message, category, stacklevel=2)
    return Equations(
        equations=tuple(equations),
        inputs=roles.inputs,
        method=method,
        dictionary=dictionary if isinstance(dictionary, str) else ", ".join(str(t) for t in dictionary),
        smooth=smooth,
        data=DataSummary.of(pieces, motion),
        dropped=design.dropped,
        warnings=tuple(message for message, _ in log.collected),
        constraints=tuple(known),
        scores=scores,
    )


def _silent(stage: str, done: int, total: int) -> None:
    """No progress shown."""


def _check(method: str, rules: Rules, holdout: float, coarsen: float) -> None:
    """Refuse numbers and names that are out of range."""
    if method not in ENGINES:
        raise UnknownNameError("method", method, ENGINES)
    if not 0 <= holdout < 1:
        raise InputError(f"holdout is a share of the rows, 0 <= holdout < 1, got {holdout!r}")
    if not 0 < coarsen <= 1:
        raise InputError(f"coarsen is a power of the likelihood, 0 < coarsen <= 1, got {coarsen!r}")
    rules.check(method)


def _as_records(records: Record | Sequence[Record]) -> list[Record]:
    pieces = [records] if isinstance(records, Record) else list(records)
    if not pieces or not all(isinstance(piece, Record) for piece in pieces):
        raise InputError("discover needs a Record or a list of Records (bayeq.read, Record.from_arrays)")
    return pieces


def _prepared(
    records: list[Record], roles: Roles, smooth: Smooth, share: float, log: WarningLog
) -> tuple[list[Record], Roles]:
    """Records divided at gaps that cannot be bridged, and chains without channels that were computed from others."""
    messages: list[str] = []
    if smooth == "auto":
        shown = [str(chain.measured[chain.lowest]) for chain in roles.chains]
        records, messages = split_at_gaps(records, shown)
        if all(record.time is not None for record in records):
            chains, computed = measured_apart(records, roles.chains, share)
            roles, messages = roles.with_chains(chains), messages + computed
    for message in messages:
        log.warn(message, DataWarning)
    return records, roles


def _check_rows(motion: Motion, records: Sequence[Record], holdout: float, log: WarningLog) -> None:
    """Refuse too few rows, and warn where rows cannot be used as they would be."""
    where, total = ", ".join(record.name or "record" for record in records[:3]), sum(record.n for record in records)
    if total < LEAST_TRAINING_ROWS:
        rows = f"{total} row{'s' * (total != 1)}"
        raise RecordError(f"{where}: {rows}: too few for a regression (at least {LEAST_TRAINING_ROWS}); measure more")
    used, _ = motion.counts
    if used < LEAST_TRAINING_ROWS:
        raise RecordError(f"holdout {holdout:g} leaves {used} training rows, too few for a regression; lower it")
    if holdout > 0 and motion.holdout == 0:
        log.warn(f"only {total} rows: all are used, none held out to judge the equation by", DataWarning)
    if any(smoothing.fs is None for smoothing in motion.smoothing):
        log.warn(
            "steps of time are uneven, or differ between records: the regression goes row by row instead of in the band"
            " that the smoother follows, and small terms are harder to find; resample evenly",
            DataWarning,
        )


def _warn_of_terms(design: Design, log: WarningLog) -> None:
    n, terms = design.train[0].n, len(design.terms)
    if n <= terms:
        log.warn(
            f"{n} training rows for {terms} candidate terms: fewer rows than terms; the prior decides much, and few"
            " terms can be found",
            DataWarning,
        )
    if design.dropped:
        listed = "; ".join(f"{d.name} ({d.reason})" for d in design.dropped[:8])
        more = f" and {len(design.dropped) - 8} more" if len(design.dropped) > 8 else ""
        log.warn(f"terms left out: {listed}{more}", TermWarning)
