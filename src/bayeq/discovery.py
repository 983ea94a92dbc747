"""`discover`: from records to equations of motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from numbers import Integral
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from bayeq.adapters.pysindy.library import is_library, terms_of
from bayeq.dictionary import Specification, Variables, build_dictionaries, written
from bayeq.equation.build import build_equations, with_doubts
from bayeq.equation.equation import Equation
from bayeq.equation.equations import DataSummary, Equations
from bayeq.equation.several import EquationTuple
from bayeq.equation.units import channel_units
from bayeq.errors import (
    AmbiguityWarning,
    DataWarning,
    InputError,
    RecordError,
    TermWarning,
    UnknownNameError,
    WarningLog,
    require_kind,
    require_number,
    require_text,
    require_texts,
)
from bayeq.expressions import Expression
from bayeq.expressions.functions import CONSTANTS, TIME
from bayeq.inference.engines import ENGINES
from bayeq.inference.prior import SIGNED, Prior
from bayeq.likelihood.record_fit import refit_record, suits
from bayeq.records import UNKNOWN_TIME, Record, as_records, check_messages, counts_rows, with_row_numbers
from bayeq.regression.constraints import Constraints, parse_constraints
from bayeq.regression.design import Design, build_design
from bayeq.regression.joint import fit_equations, record_of
from bayeq.regression.regression import Regression
from bayeq.regression.screening import MOST_TERMS, screened
from bayeq.selection.select import Rules, select
from bayeq.selection.tolerance import TOLERANCE
from bayeq.states import (
    Motion,
    Roles,
    Smooth,
    Tails,
    check_sensors,
    estimate_motion,
    known_sensors,
    measured_apart,
    require_in_range,
    require_steps,
    require_varying,
)
from bayeq.states.missing import bridged_record, require_enough
from bayeq.states.motion import held_out_share
from bayeq.states.prepare import cleaned, divided_at_gaps

__all__ = ["discover"]

Bools = NDArray[np.bool_]
Progress = Callable[[str, int, int], None]

NO_LIKELIHOOD = (
    "the likelihood of the record could not be evaluated near its motion: the regression of smoothed rows is used"
    " instead, whose intervals and probabilities are less sure; give fewer terms"
)

NO_TAILS = (
    "tails='student' makes no difference: it is part of the likelihood of the record, which is not used here; use fewer"
    " rows or terms, or measure every coordinate"
)

# With fewer training rows there is no regression.
LEAST_TRAINING_ROWS = 3

# Channels are checked against each other with straight lines over missing samples if these are a smaller share.
MOST_BRIDGED = 0.05


# The parameters are those of the public contract; all but the records have defaults.
def discover(
    records: Any,
    *,
    chains: str | Sequence[str] | None = None,
    displacement: str | None = None,
    velocity: str | None = None,
    acceleration: str | None = None,
    force: str | None = None,
    inputs: Sequence[str] = (),
    dictionary: Specification | Any = "oscillator",
    method: str = "auto",
    smooth: Smooth = "auto",
    holdout: float = 0.2,
    max_terms: int | None = None,
    tolerance: float = TOLERANCE,
    coarsen: float = 1.0,
    prior: Prior | None = None,
    constraints: str | Sequence[str] = (),
    noise: Mapping[str, float | str] | None = None,
    gain_sd: Mapping[str, float | str] | None = None,
    tails: Tails = "gauss",
    band: tuple[float, float] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    t: Any = None,
) -> Equations:
    """Find the governing equations of measured motion.

    Parameters
    ----------
    records : Record, path, DataFrame, mapping of str to array_like, object with `u`, `y`, or sequence of such
        Measured channels (`bayeq.records.as_record`); several records of the same system are used together.
    chains : sequence of str, optional
        A coordinate and its measured derivatives each: ``"x:v:a"``, ``"x::"``, ``"x"`` (first order). In ``"::a"``,
        only the acceleration measured, the coordinate is called x; where another chain or an input has that name, as
        in ``["::a1", "::a2"]``, x_a1 and x_a2. ``"~q::a"`` names it q.
    displacement, velocity, acceleration : str, optional
        Channels of one oscillator's chain, instead of `chains`.
    force : str, optional
        Channel of its force.
    inputs : sequence of str
        Channels of further inputs.
    dictionary : str, sequence of str, mapping of str to these, or feature library of PySINDy
        ``"oscillator"`` (eq. (31)), ``"polynomial:3"``, ``"fourier:2"``, ``"neighbours"``, a file of terms, or terms;
        ``"oscillator + sin(x) - x**5"`` joins families and terms, and leaves some out. With a mapping,
        ``{"a1": "oscillator", ...}``, or ``"a1: oscillator; a2: ..."``, each equation has its own; the terms of the
        others then have probability 0 in it. See docs/terms.md for the language of terms. A feature library, as
        ``pysindy.PolynomialLibrary(3)``, is taken by the names of its features in states and inputs.
    method : str
        ``"auto"`` (the optimum of variational Bayes, probabilities by model averaging), ``"vb"``, ``"bma"``,
        ``"gibbs"`` (MCMC), ``"rvm"`` or ``"stlsq"`` (SINDy).
    smooth : "auto", "band" or "none"
        "auto" is the likelihood of the record where it can be used, "band" the regression of smoothed rows.
        How derivatives that are not measured are estimated, see `bayeq.states.estimate_motion`. Spikes, stuck and
        clipped stretches are left out first, and missing samples (NaN) are bridged; with "none" nothing is left out,
        and NaN is an error.
    holdout : float
        Share of the rows, the last of each record, that the equations of the other rows are judged by. Under the
        likelihood of the record the equations are then found once more, from all rows. 0 skips that.
    max_terms : int, optional
        Largest number of terms that are shown: the likeliest such model where the method includes more. The path of
        each equation (`Equation.path`) tells what each further term brings. Probabilities and the included terms stay;
        what is left out is listed after the equation.
    tolerance : float
        What makes no practical difference: the equation shown is the smallest whose predictions and free runs over
        windows of the training rows are worse than the full model's by no more than this share of the target's standard
        deviation and of the states' spread (`bayeq.selection.tolerance`). By default 0.5 %, half of that to which
        sensors are calibrated. Terms that are certain and yet not needed for that are listed after the equation, beside
        the full model. 0 shows the included terms.
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
        ``"x*abs(x) == 0.5*x**3"``, and signs, ``"v <= 0"`` (methods auto and bma). They concern every equation,
        or with a target in front that one, ``"a: v <= 0"``.
    noise : mapping of str to float or str, optional
        Known noise of channels: standard deviations in the channel's unit, or shares of its own such as ``"2%"``. It is
        then not learned from the record. 0 is a channel without noise.
    gain_sd : mapping of str to float, optional
        Uncertainty of the calibration of sensors, 0.01 for a factor known to 1 %: the intervals take it in.
    tails : "gauss" or "student"
        Distribution of the channels' noise: normal, or Student's t with degrees of freedom that are estimated per
        channel, for noise of many outliers. Needs the likelihood of the record. Single spikes are left out in any case.
    band : (float, float), optional
        Frequencies [Hz] between which the spectra of target and terms are fitted, as where hum or drift lie outside.
        This is the band regression, which ``smooth="auto"`` then means too; its own band, in which states follow the
        motion, is narrowed to this. Fits, free runs and the verdict are judged by the rows, all frequencies in them.
    seed : int
        Seed of methods that draw random numbers (``"gibbs"``).
    progress : callable, optional
        Called with (stage, done, total).
    t : str or array_like, optional
        The column that is time, of files and data frames, or sampling times [s] of arrays. Where no record has a time
        the number of the row is time, with a warning, and coefficients are per sample.

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
    log, step = WarningLog(), _silent if progress is None else progress
    _check_kinds(method, smooth, prior, seed, progress, constraints)
    _check_method(method)
    rules = Rules(max_terms, tolerance)
    rules.check(method)
    _check_shares(holdout, coarsen)
    roles = Roles.parse(chains, displacement, velocity, acceleration, force, inputs)
    noise, gain_sd = {} if noise is None else noise, {} if gain_sd is None else gain_sd
    check_sensors(noise, gain_sd, roles)
    _check_tails(tails, smooth)
    smooth = _smooth_in(band, smooth)
    variables = Variables(roles.states, roles.inputs, tuple(chain.states for chain in roles.chains))
    if is_library(dictionary):
        dictionary = terms_of(dictionary, variables.names)
    terms, allowed = build_dictionaries(dictionary, roles.targets, variables)
    known = [constraints] if isinstance(constraints, str) else list(constraints)
    constrained = parse_constraints(known, terms, roles.targets)  # what is wrong with them is said before the work
    measured = with_row_numbers(as_records(records, t))
    if any(map(counts_rows, measured)):
        log.warn(UNKNOWN_TIME, DataWarning)
    roles = roles.for_terms(terms)
    _require_unambiguous(terms, measured, roles)

    step("states", 0, 1)
    pieces, roles, share = _prepared(measured, roles, smooth, holdout, log)
    sensors = known_sensors(noise, gain_sd, roles, pieces, tails)
    motion = estimate_motion(pieces, roles, smooth, share, sensors, band)
    _warn_of_sensors(motion, {*noise, *gain_sd}, log)
    _inspect(motion, pieces, holdout, log)
    if len(terms) > MOST_TERMS:
        terms, allowed = _screened(terms, motion, allowed, constrained, log)
    design = build_design(terms, motion, lambda done, total: step("dictionary", done, total), allowed)
    dropped = design.dropped
    _warn_of_terms(design, log)
    _warn_of_zero(design, pieces, log)
    constrained = _constrained(known, design, method)

    step("likelihood", 0, 1)
    record = record_of(design, smooth, dictionary, prior)
    if record is None and smooth == "auto" and suits(motion, len(design.terms)):
        log.warn(NO_LIKELIHOOD, DataWarning)
    if record is None and tails == "student":
        log.warn(NO_TAILS, DataWarning)
    regressions = [Regression.of(design, k, record) for k in range(len(roles.chains))]
    step("inference", 0, len(roles.chains))
    fits = fit_equations(regressions, constrained, method, prior, coarsen, seed)
    units = _units(pieces, roles, log)
    first = WarningLog()
    selections = select(fits, rules, motion)
    equations, scores = build_equations(selections, units, first)
    whole = None
    if record is not None and motion.held_out:
        of_all = build_design(design.terms, motion.whole, allowed=design.allowed)
        # columns that a single row of those held out decides may be copies of each other there
        if of_all.names == design.names:
            whole = refit_record(motion.whole, record, of_all.terms, of_all.train)
    if whole is not None:
        step("inference", 0, len(roles.chains))
        scored, first = equations, WarningLog()
        regressions = [Regression.of(of_all, k, whole) for k in range(len(roles.chains))]
        fits = fit_equations(regressions, constrained, method, prior, coarsen, seed)
        selections = select(fits, rules, motion.whole)
        equations, _ = build_equations(selections, units, first, scored)
        _warn_of_other_terms(equations, scored, first)
    log.collected += first.collected
    step("inference", len(roles.chains), len(roles.chains))

    log.emit(stacklevel=3)
    return Equations(
        equations=EquationTuple(with_doubts(equations, selections, tolerance or TOLERANCE)),
        inputs=roles.inputs,
        method=method,
        dictionary=written(dictionary),
        smooth=smooth,
        data=DataSummary.of(pieces, motion, whole is not None),
        dropped=dropped,
        warnings=log.messages,
        constraints=tuple(known),
        scores=scores,
    )


def _silent(stage: str, done: int, total: int) -> None:
    """No progress shown."""


def _check_kinds(method: Any, smooth: Any, prior: Any, seed: Any, progress: Any, constraints: Any) -> None:
    require_text(method, "method")
    require_text(smooth, "smooth")
    require_texts(constraints, "constraints")
    if prior is not None:
        require_kind(prior, Prior, "prior", "a Prior")
    if progress is not None:
        require_kind(progress, Callable, "progress", "a function of (stage, done, total)")  # type: ignore[arg-type]
    for one in seed if isinstance(seed, Sequence) and not isinstance(seed, str) else [seed]:
        require_kind(one, Integral, "seed", "a whole number")
        if one < 0:
            raise InputError(f"a seed is a whole number, 0 or more, got {one}")


def _check_method(method: str) -> None:
    if method not in ENGINES:
        raise UnknownNameError("method", method, ENGINES)


def _check_shares(holdout: float, coarsen: float) -> None:
    require_number(holdout, "holdout")
    require_number(coarsen, "coarsen")
    if not 0 <= holdout < 1:
        raise InputError(f"holdout is a share of the rows, 0 <= holdout < 1, got {holdout!r}")
    if not 0 < coarsen <= 1:
        raise InputError(f"coarsen is a power of the likelihood, 0 < coarsen <= 1, got {coarsen!r}")


def _check_tails(tails: str, smooth: str) -> None:
    require_text(tails, "tails")
    if tails not in get_args(Tails):
        raise InputError(f"tails is 'gauss' or 'student', got {tails!r}")
    if tails == "student" and smooth != "auto":
        raise InputError(f"tails='student' needs the likelihood of the record, smooth='auto', not {smooth!r}")


def _smooth_in(band: tuple[float, float] | None, smooth: Smooth) -> Smooth:
    """How motion is smoothed: where a band is given by the regression in it."""
    if band is None:
        return smooth
    if smooth == "none":
        raise InputError("band= is fitted by the band regression, smooth='band' or 'auto', not smooth='none'")
    try:
        low, high = (float(end) for end in band)
    except (TypeError, ValueError):
        raise InputError(f"band is a pair of frequencies [Hz], such as (0.5, 40), not {band!r}") from None
    if not 0.0 <= low < high < np.inf:
        raise InputError(f"band {low:g} to {high:g} Hz: give two frequencies, the lower one first, 0 or more")
    return "band"


def _prepared(
    records: list[Record], roles: Roles, smooth: Smooth, holdout: float, log: WarningLog
) -> tuple[list[Record], Roles, float]:
    """Records without bad samples, divided at gaps that cannot be bridged, chains without channels that were computed
    from others, and the share of the rows to hold out."""
    share = held_out_share(holdout, sum(record.n for record in records))
    require_varying(records, [*roles.measured, *roles.inputs])
    require_steps(records)
    records, messages = cleaned(records, roles, smooth)
    log.extend(messages, DataWarning)
    require_enough(records, roles)
    records, messages = divided_at_gaps(records, roles, smooth)
    if smooth != "none" and all(record.time is not None for record in records):
        chains, computed = measured_apart(records, roles.chains, share)
        roles, messages = roles.with_chains(chains), messages + computed
    log.extend(messages, DataWarning)
    return records, roles, share


def _inspect(motion: Motion, records: Sequence[Record], holdout: float, log: WarningLog) -> None:
    """Refuse too few rows, and warn of channels that do not fit each other and of rows that cannot be used in full."""
    for rows in motion.records:
        require_in_range(rows.columns, rows.name)
    total = sum(record.n for record in records)
    used, _ = motion.counts
    if used < LEAST_TRAINING_ROWS:
        raise RecordError(f"holdout {holdout:g} leaves {used} training rows, too few for a regression; lower it")
    if holdout > 0 and motion.holdout == 0:
        log.warn(f"only {total} rows: all are used, none held out to judge the equation by; measure more", DataWarning)
    present = [bridged_record(record, motion.roles, MOST_BRIDGED) for record in records]
    log.extend(
        check_messages(present, [chain.measured for chain in motion.roles.chains], motion.roles.inputs), DataWarning
    )
    if any(smoothing.fs is None for smoothing in motion.smoothing):
        log.warn(
            "steps of time are uneven, or differ between records: the regression goes row by row instead of in the band"
            " that the smoother follows, and small terms are harder to find; resample evenly, all records at one rate",
            DataWarning,
        )


def _constrained(known: Sequence[str], design: Design, method: str) -> tuple[Constraints, ...]:
    """What is known of the coefficients of each equation, among the terms that can be used."""
    dropped = {term.name: term.reason for term in design.dropped}
    found = parse_constraints(known, design.terms, design.motion.roles.targets, dropped)
    if method not in SIGNED and any(one.signs.any() for one in found):
        raise InputError(f"method {method!r} takes no signs of coefficients; choose one of: {', '.join(SIGNED)}")
    return found


def _screened(
    terms: Sequence[Expression], motion: Motion, allowed: Bools, constrained: Sequence[Constraints], log: WarningLog
) -> tuple[tuple[Expression, ...], Bools]:
    """The candidates of a large dictionary that explain most, and those that something is known of."""
    forced = np.any([one.concerned for one in constrained], axis=0)
    kept = screened(terms, motion, allowed, forced, MOST_TERMS)
    targets = ", ".join(motion.roles.targets)
    log.warn(
        f"{len(terms):,} candidates: {len(kept):,} were kept, the simplest and those that explain most of {targets}"
        " beside them; probabilities are among these. Leave out what cannot be in the equation, and all are compared",
        TermWarning,
    )
    return tuple(terms[int(j)] for j in kept), allowed[:, kept]


def _units(records: Sequence[Record], roles: Roles, log: WarningLog) -> dict[str, str]:
    units, conflicts = channel_units([record.units for record in records], roles.chains, roles.inputs)
    log.extend(conflicts, DataWarning)
    if any(map(counts_rows, records)):  # derivatives that are not measured are per sample
        return {name: unit for name, unit in units.items() if name in roles.channels}
    if roles.timed:
        units[TIME] = "s"
    return units


def _require_unambiguous(terms: Sequence[Expression], records: Sequence[Record], roles: Roles) -> None:
    """Check that t, pi and e of terms are no channels of records that are neither in a chain nor an input."""
    for term in terms:
        written = term.names | term.constants
        for name in sorted(written.intersection({TIME, *CONSTANTS}).difference(roles.names)):
            if any(name in record.channels for record in records):
                meaning = "the time" if name == TIME else f"the number {CONSTANTS[name]:.4g}"
                raise InputError(
                    f"term {term.text!r}: {name} is {meaning}, but the record has a channel {name!r} that is no input;"
                    f" name it as one (inputs=, --input), or give the channel another name"
                )


def _warn_of_other_terms(equations: Sequence[Equation], scored: Sequence[Equation], log: WarningLog) -> None:
    """Say where an equation of all rows has other terms than the one that fits and verdict on the last rows are of."""
    for equation, former in zip(equations, scored, strict=True):
        if set(equation.shown) != set(former.shown):
            log.warn(
                f"{equation.target}: the terms are those that all rows ask for; without the rows held out, that"
                f" scores are of, they were {', '.join(former.shown) or 'none'}: a longer record would decide",
                AmbiguityWarning,
            )


def _warn_of_sensors(motion: Motion, given: Set[str], log: WarningLog) -> None:
    """Say which of what was given of channels makes no difference."""
    roles, sensors = motion.roles, motion.sensors
    computed = [name for name in given if name not in {*roles.measured, *roles.inputs}]
    if computed:
        log.warn(
            f"what was given of {', '.join(sorted(computed))} is not used: computed, not measured; give that of the"
            " channel that it was computed from",
            DataWarning,
        )
    unused = [name for name in roles.measured if sensors.noisy(name)]
    if unused and not motion.smoothing:
        log.warn(
            f"the noise given of {', '.join(unused)} is not used: states and targets are taken as measured here; of"
            " inputs it would be; leave it out, or use smooth='auto' with time and 40 rows, which takes 1 % or more",
            DataWarning,
        )


def _warn_of_zero(design: Design, records: Sequence[Record], log: WarningLog) -> None:
    """Say which displacements are nowhere zero: where terms that depend on where zero is hardly differ."""
    for chain in design.motion.roles.chains:
        name = chain.measured[0]
        if chain.order < 2 or name is None:
            continue
        samples = np.concatenate([record[name] for record in records])
        low, high = float(np.nanmin(samples)), float(np.nanmax(samples))
        powers = [term for term in design.terms if term.text.startswith(f"{name}**")]
        if powers and not low <= 0.0 <= high:
            log.warn(
                f"{name} is nowhere zero, it lies between {low:.4g} and {high:.4g}: terms such as {powers[0]} can"
                " hardly be told from others there, and coefficients are not those about the position of rest;"
                f" measure it from there (bayeq.remove_offset(record, {name!r}), --remove-offset {name}); physical()"
                " gives the stiffness about the position of rest",
                DataWarning,
            )


def _warn_of_terms(design: Design, log: WarningLog) -> None:
    n, terms = design.train[0].n, len(design.terms)
    if n <= terms:
        log.warn(
            f"{n} training rows for {terms} candidate terms: fewer rows than terms; the prior decides much, and few"
            " terms can be found; measure more rows, or give fewer terms",
            DataWarning,
        )
    if design.dropped:
        listed = "; ".join(f"{d.name} ({d.reason})" for d in design.dropped[:8])
        more = f" and {len(design.dropped) - 8} more" if len(design.dropped) > 8 else ""
        log.warn(
            f"terms left out: {listed}{more}; one that is needed asks for other motion, or for units in which it is"
            " finite",
            TermWarning,
        )
