"""`discover`: from records to equations of motion, wiring the stages."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import Design, Variables, build_design, build_dictionary
from bayeq.equation.build import equation_of
from bayeq.equation.equations import DataSummary, Equations
from bayeq.equation.units import channel_units
from bayeq.errors import ChainError, DataWarning, InputError, RecordError, TermWarning, UnknownNameError, WarningLog
from bayeq.forecast.score import held_out_scores
from bayeq.inference import ENGINES, Prior
from bayeq.records import Record, check_messages, split_at_gaps
from bayeq.regression.constraints import parse_constraints
from bayeq.regression.filtered_terms import seen_design
from bayeq.regression.fit import Setting, infer_equation
from bayeq.selection.limits import Choice
from bayeq.selection.negligible import NEGLIGIBLE, training_rows, without_negligible
from bayeq.states import Chain, Smooth, derive_all, measured_apart, parse_chains

__all__ = ["discover"]

Floats = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

# With fewer rows none are held out; with fewer training rows than this there is no regression.
LEAST_ROWS_TO_HOLD_OUT = 50
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
    min_share: float | None = None,
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
    negligible : float
        Terms that are certain and yet make no practical difference are shown beside the equation: those that together
        explain a smaller share of the target's variance than this, and without which free runs over the training rows
        are hardly worse (`bayeq.selection.negligible`). 0 keeps them in the equation, as do `max_terms`, `min_share`,
        `constraints`.
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
    if not 0 <= negligible < 1:
        raise InputError(f"negligible is a share of the variance, 0 <= negligible < 1, got {negligible!r}")
    if not 0 < coarsen <= 1:
        raise InputError(f"coarsen is a power of the likelihood, 0 < coarsen <= 1, got {coarsen!r}")

    step = progress or _silent
    log = WarningLog()
    if smooth == "auto":
        pieces, parsed = _sorted_out(pieces, parsed, holdout, log)
    step("states", 0, len(pieces))
    share = _share(holdout, sum(piece.n for piece in pieces))
    states = derive_all(pieces, parsed, all_inputs, smooth, share)
    step("states", len(pieces), len(pieces))
    for message in check_messages(pieces, [chain.measured for chain in parsed], all_inputs):
        log.warn(message, DataWarning)
    if states[0].smoothing and any(one.fs is None for one in states[0].smoothing):
        log.warn(
            "steps of time are uneven, or differ between records: the regression goes row by row instead of in the band"
            " that the smoother follows, and small terms are harder to tell; resample evenly",
            DataWarning,
        )
    variables = Variables(tuple(name for chain in parsed for name in chain.states), all_inputs)
    terms = build_dictionary(dictionary, variables)
    train, held_out = _split(
        [{**s.columns, **{_measured(name): values for name, values in s.measured.items()}} for s in states],
        holdout,
        log,
        ", ".join(p.name or "record" for p in pieces[:3]),
    )
    # what the equation is judged by: the measured target, where there is one
    targets = [_measured(c.target) if c.target in states[0].measured else c.target for c in parsed]
    design = build_design(terms, targets, train, held_out, lambda done, total: step("dictionary", done, total))
    _check_size(design, log)
    known = [constraints] if isinstance(constraints, str) else list(constraints)
    reasons = {d.name: d.reason for d in design.dropped}
    constrained = parse_constraints(known, design.terms, [chain.target for chain in parsed], reasons)
    if method not in SIGNED and any(c.signs.any() for c in constrained):
        raise InputError(f"method {method!r} takes no signs of coefficients; take one of: {', '.join(SIGNED)}")

    smoothing = states[0].smoothing
    estimated = tuple(
        smoothing[k] if smoothing and chain.measured[-1] is None else None for k, chain in enumerate(parsed)
    )
    used = round(design.train[0].n), round(design.held_out[0].n) if design.held_out else 0
    design = seen_design(design, parsed, estimated, train, held_out)
    units, conflicts = channel_units([piece.units for piece in pieces], parsed, all_inputs)
    for message in conflicts:
        log.warn(message, DataWarning)
    setting = Setting(
        chains=parsed,
        inputs=all_inputs,
        design=design,
        train=train,
        observed=tuple(targets),
        smoothings=smoothing,
        estimated=estimated,
        method=method,
        prior=prior,
        coarsen=coarsen,
        seed=seed,
    )
    inferred = []
    for k in range(len(parsed)):
        step("inference", k, len(parsed))
        inferred.append(infer_equation(setting, k, constrained[k], choice))
    if negligible > 0 and not choice.given and ENGINES[method].spike_slab and not known:
        inferred = without_negligible(
            setting, inferred, training_rows(pieces, states, parsed, all_inputs, share), negligible
        )
    equations = [equation_of(setting, one, log) for one in inferred]
    step("inference", len(parsed), len(parsed))
    for message, category in log.collected:
        warnings.warn(message, category, stacklevel=2)
    return Equations(
        equations=tuple(replace(equation, units=units) for equation in equations),
        inputs=all_inputs,
        method=method,
        dictionary=dictionary if isinstance(dictionary, str) else ", ".join(str(t) for t in dictionary),
        smooth=smooth,
        data=DataSummary(
            files=tuple(dict.fromkeys(piece.name for piece in pieces)),
            n=sum(piece.n for piece in pieces),
            n_train=used[0],
            n_held_out=used[1],
            estimated=states[0].estimated,
        ),
        dropped=design.dropped,
        warnings=tuple(message for message, _ in log.collected),
        constraints=tuple(known),
        scores=held_out_scores(
            parsed, all_inputs, [e.posterior for e in equations], [e.terms for e in equations], pieces, states, share
        ),
    )


def _measured(target: str) -> str:
    """Name of the column that holds a target's samples beside the smoothed one."""
    return f"{target} as measured"


def _silent(stage: str, done: int, total: int) -> None:
    """No progress shown."""


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
    if displacement is None and acceleration is None:
        raise ChainError(
            "no coordinate given: name the displacement (and, where measured, velocity and acceleration), or a chain"
            " such as x:v:a"
        )
    for role, channel in (("displacement", displacement), ("velocity", velocity), ("acceleration", acceleration)):
        if channel is not None and (not channel.strip() or ":" in channel):
            raise ChainError(
                f"{role} {channel[:60]!r} is not a channel's name; name one, or give a chain such as x:v:a instead"
            )
    return parse_chains([":".join(name or "" for name in (displacement, velocity, acceleration))])


def _share(holdout: float, rows: int) -> float:
    """Share of the rows to hold out: none of few."""
    return holdout if rows >= LEAST_ROWS_TO_HOLD_OUT else 0.0


def _sorted_out(
    records: list[Record], chains: tuple[Chain, ...], holdout: float, log: WarningLog
) -> tuple[list[Record], tuple[Chain, ...]]:
    """Records divided at gaps that are not bridged, and chains without channels that were computed from others."""
    pieces, messages = split_at_gaps(records, [str(chain.measured[chain.lowest]) for chain in chains])
    if all(piece.time is not None for piece in pieces):
        chains, computed = measured_apart(pieces, chains, _share(holdout, sum(piece.n for piece in pieces)))
        messages += computed
    for message in messages:
        log.warn(message, DataWarning)
    return pieces, chains


def _split(
    columns: Sequence[Mapping[str, Floats]], holdout: float, log: WarningLog, where: str
) -> tuple[list[Mapping[str, Floats]], list[Mapping[str, Floats]]]:
    """Training rows and the last rows of each record, held out."""
    train: list[Mapping[str, Floats]] = []
    held_out: list[Mapping[str, Floats]] = []
    total = sum(len(next(iter(piece.values()))) for piece in columns)
    if total < LEAST_TRAINING_ROWS:
        rows = f"{total} row{'s' * (total != 1)}"
        raise RecordError(f"{where}: {rows}: too few for a regression (at least {LEAST_TRAINING_ROWS}); measure more")
    share = _share(holdout, total)
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
        log.warn(f"only {total} rows: all are used, none held out to judge the equation by", DataWarning)
    return train, held_out


def _check_size(design: Design, log: WarningLog) -> None:
    n, terms = design.train[0].n, len(design.terms)
    if n < LEAST_TRAINING_ROWS:
        raise RecordError(f"{n} training rows are too few for a regression (at least {LEAST_TRAINING_ROWS})")
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
