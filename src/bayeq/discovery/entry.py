"""`discover`: from records to equations of motion."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from numbers import Integral
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np

from bayeq.adapters.pysindy.library import is_library, terms_of
from bayeq.dictionary import Specification, Variables
from bayeq.discovery.laws import check_scales, dictionaries_of, with_law_terms
from bayeq.discovery.question import NotStreamed, Question
from bayeq.discovery.streaming.checkpoint import Checkpoints, cache_folder
from bayeq.discovery.streaming.cluster import Cluster, dask_streams, is_dask
from bayeq.discovery.streaming.whole import Whole
from bayeq.discovery.streaming.work import Executor, Extent, by_threads, of_channels, stretches
from bayeq.equation.equations import Equations
from bayeq.equation.selection.select import Rules
from bayeq.errors import (
    InputError,
    UnknownNameError,
    WarningLog,
    require_kind,
    require_number,
    require_text,
    require_texts,
)
from bayeq.expressions import Expression
from bayeq.expressions.parse import EARLIER
from bayeq.inference.engines import ENGINES
from bayeq.inference.prior import Prior
from bayeq.records import Record, as_records, with_row_numbers
from bayeq.records.stream import RecordStream, Stream, open_streams, streamed_unasked
from bayeq.regression.constraints import parse_conserved, parse_constraints, parse_ties
from bayeq.regression.fit import JOINT
from bayeq.resumable import Progress, silent
from bayeq.states import Roles, Smooth, Tails, check_sensors, with_laws
from bayeq.states.derive import current
from bayeq.states.sensors import share_of_reading

# Longer records in memory [rows] are processed in units of rows, as large files are.
MOST_ROWS = 200_000

# Arguments of `discover` that say where the rows are and how they are read; the others make up the `Question`.
SOURCES = ("records", "t", "stream", "client", "checkpoint")

# ... and those that give the roles of channels, in the order of `Roles.parse`.
ROLES = ("chains", "displacement", "velocity", "acceleration", "force", "inputs", "target", "discrete")


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
    target: str | Sequence[str] | None = None,
    dictionary: Specification | Any = "oscillator",
    method: str = "auto",
    smooth: Smooth = "auto",
    holdout: float = 0.2,
    max_terms: int | None = None,
    tolerance: float | None = None,
    coarsen: float = 1.0,
    prior: Prior | None = None,
    constraints: str | Sequence[str] = (),
    conserve: str = "",
    differs: str | Sequence[str] = (),
    law: str | Sequence[str] = (),
    discrete: bool = False,
    noise: Mapping[str, float | str] | None = None,
    gain_sd: Mapping[str, float | str] | None = None,
    lag_sd: Mapping[str, float | str] | None = None,
    tails: Tails = "gauss",
    band: tuple[float, float] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    t: Any = None,
    stream: bool | None = None,
    client: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> Equations:
    """Find the governing equations of measured motion.

    Parameters
    ----------
    records : Record, path, DataFrame, mapping of str to array_like, object with `u`, `y`, or sequence of such
        Measured channels (`bayeq.records.as_record`); several records of the same system are used together.
    chains : sequence of str, optional
        Each is a coordinate with its measured derivatives: ``"x:v:a"``, ``"x::"``, ``"x"`` (first order). In ``"::a"``
        only the acceleration is measured, and the coordinate is called x; if another chain or an input has that name,
        as in ``["::a1", "::a2"]``, x_a1 and x_a2. ``"~q::a"`` names it q. ``"~r:"`` is a hidden state of first order,
        whose law is found among the terms of its own dictionary; ``"~x2::"`` is a coordinate without any channel (a
        hidden mass), which terms may contain in differences only.
    displacement, velocity, acceleration : str, optional
        Channels of one oscillator's chain, instead of `chains`.
    force : str, optional
        Channel of its force.
    inputs : sequence of str
        Channels of further inputs.
    target : str or sequence of str, optional
        Channels that are not derivatives, as the force of a damper: ``target="F", inputs=["x", "v"]``. Each has a
        static law, which is not integrated. ``"F1,F2"`` are two targets. If there are chains too, a static law may use
        their states; otherwise families of terms, as ``"polynomial:3"``, are functions of the inputs.
    dictionary : str, sequence of str, mapping of str to these, or feature library of PySINDy
        ``"oscillator"`` (eq. (31)), ``"polynomial:3"``, ``"fourier:2"``, ``"neighbours"``, a file of terms, or terms;
        ``"oscillator + sin(x) - x**5"`` joins families and terms, and leaves some out. With a mapping,
        ``{"a1": "oscillator", ...}``, or ``"a1: oscillator; a2: ..."``, each equation has its own; the terms of the
        others then have probability 0 in it. See docs/terms.md for the language of terms. A feature library, as
        ``pysindy.PolynomialLibrary(3)``, is taken by the names of its features in states and inputs.
    method : str
        ``"auto"`` (terms, coefficients and probabilities by model averaging, with the lower bound of variational
        Bayes), ``"vb"``, ``"bma"``, ``"gibbs"`` (MCMC), ``"rvm"`` or ``"stlsq"`` (SINDy).
    smooth : "auto" or "none"
        "auto" is the likelihood of the record, "none" the regression of rows as measured. Spikes, stuck and clipped
        stretches are left out first, and missing samples (NaN) are bridged; with "none" nothing is left out, and NaN is
        an error. "band", a regression that was here before, is "auto", with a DeprecationWarning.
    holdout : float
        Share of the rows, the last of each record, that the equations of the other rows are judged by. Under the
        likelihood of the record the equations are then found once more, from all rows. 0 skips that.
    max_terms : int, optional
        Largest number of terms that are shown: the likeliest such model where the method includes more. The path of
        each equation (`Equation.path`) tells what each further term brings. Probabilities and the included terms stay;
        what is left out is listed after the equation.
    tolerance : float, optional
        Size of the discrepancy, a small unknown function of the states beside the terms, as a share of the target's
        standard deviation (`bayeq.likelihood.spike`). By default it is learned under the likelihood of the record, and
        zero for rows as measured; 0: the law is exact; above 0: the discrepancy has this size, or a larger one.
        If a law is only nearly true, a term is not shown if free runs without it are worse by at most this, by default
        0.5 % of the states' spread (`bayeq.equation.selection.select`).
    coarsen : float
        Power, above 0 and at most 1, that the likelihood is raised to: each row counts as this share of one (Miller
        and Dunson 2019). It widens all intervals and asks more evidence of a term, for models that are only nearly
        true. `Equation.coarsening` shows how PIPs depend on it.
    prior : Prior, optional
        By default, under the likelihood of the record, p_0 = 0.1 (in ``polynomial``, odds that fall with the degree),
        and a slab variance at which a term explains 5 times the target's variance. For rows as measured, and with
        `coarsen` below 1 or equalities, p_0 = 0.1, a slab variance v_s that maximises the evidence (at least 10), and a
        vague prior of the noise in units of the least-squares residual. A given prior applies to standardised columns
        and those units; its v_s is used as it is.
    constraints : str or sequence of str
        What is known of the coefficients, in original units: linear equations, ``"u == 1"``,
        ``"x*abs(x) == 0.5*x**3"``, signs and bounds, ``"v <= 0"``, ``"0 <= x**3 <= 5"`` (methods auto and bma), and
        earlier estimates with standard deviation, ``"u ~ 0.1 +- 0.001"``. They apply to every equation, or to one whose
        target is in front, ``"a: v <= 0"``. ``"a1: x1-x2 == 2*(a2: x2-x1)"`` ties coefficients of two equations. A
        constraint with ``==`` that the record contradicts is dropped, with a warning.
    conserve : str
        A sum of states of first order that does not change, ``"S + I + R"``: every term is a flow between two of them,
        with opposite coefficients in their equations.
    differs : str or sequence of str
        Terms whose coefficients may differ between records, ``"x, v"``, or ``"all"``: each has a candidate difference
        ``x*run2`` in every record but the first, with a probability of its own.
    law : str or sequence of str
        Rates of hidden states, which no channel measures, ``"df = (u - f)/{tau}"``; all terms of the law are included.
        Terms of the other equations may use the state by its name. Equations without it are always fitted too.
    discrete : bool
        Whether the equations are maps: they give the next sample, ``x[+1]``, in place of the rate, and terms may have
        earlier samples, ``x[-1]``, ``u[-2]``. Each chain is a channel; time is counted in samples.
    noise : mapping of str to float or str, optional
        Known noise of channels: standard deviations in the channel's unit, or shares of its own such as ``"2%"``. It is
        then not learned from the record. 0 is a channel without noise. ``"5% of reading"`` is noise in proportion to
        what is measured, sample by sample; with ``"% of reading"`` its share is learned, and a constant part beside it.
    gain_sd : mapping of str to float, optional
        Uncertainty of the calibration of sensors, 0.01 for a factor known to 1 %. The factor is estimated from other
        channels of the chain; the intervals include its remaining uncertainty.
    lag_sd : mapping of str to float, optional
        Channels that may be late or early, with the standard deviation of their lag [s], which has mean 0: a sample at
        time t is of time t - lag, so that a late channel has a positive one. Lags are learned from the record and
        removed from the channels; their remaining uncertainty widens the intervals. Needs the likelihood of the record,
        and even sampling.
    tails : "gauss" or "student"
        Distribution of the channels' noise: normal, or Student's t with degrees of freedom that are estimated per
        channel, for noise of many outliers. Needs the likelihood of the record. Single spikes are left out in any case.
    band : (float, float), optional
        Frequencies [Hz] in which the record is trusted. Every channel may have a drift below the lower one, whose size
        is learned. Hum, spectral lines above the higher one, is removed from all channels (`bayeq.states.prepare`).
    seed : int
        Seed of methods that draw random numbers (``"gibbs"``).
    progress : callable, optional
        Called with (stage, done, total).
    t : str or array_like, optional
        Name of the time column of files and data frames, or sampling times [s] of arrays. If no record has a time, the
        row number is used, with a warning, and coefficients are per sample.
    stream : bool, optional
        Whether files are read some rows at a time, for records larger than memory: Parquet, HDF5, NPY and text. By
        default folders, all files of which are read, and files of more than 256 MB together. Noise levels, verdict and
        free runs are then those of 20 stretches of the rows, coefficients and probabilities those of all rows. See
        docs/scale.md.
    client : dask.distributed.Client, optional
        A cluster that reads the files and sums over the rows; see docs/cluster.md.
    checkpoint : path, optional
        Folder for intermediate sums over the rows, from which a killed run is resumed; by default one in the user's
        cache. They are removed at the end. If they cannot be written the run goes on without, with a warning if the
        folder is given.

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
        Limitations of the answer; also kept in ``warnings`` of the result.
    BayeqWarning
        Sums cannot be written to ``checkpoint``.

    Examples
    --------
    >>> import bayeq as bq
    >>> rec = bq.simulate("duffing", seed=1)
    >>> eq = bq.discover(rec, displacement="x", velocity="v", acceleration="a", force="u")
    >>> eq[0].included
    ('x', 'v', 'x**3', 'u')
    """
    given = dict(locals())
    asked = {name: value for name, value in given.items() if name not in SOURCES}
    try:
        question = question_of(**asked)
    except InputError as error:
        _require_channels(records, asked)
        advice = _advice(error, records, asked)
        if not advice:
            raise
        raise InputError(f"{error}; {advice}") from error
    answer, log = _answer(question, records, t, stream, client, checkpoint)
    log.emit(stacklevel=3)
    return answer


def _require_channels(records: Any, asked: Mapping[str, Any]) -> None:
    """Raise InputError for a channel that is not in the records, before errors that follow from its name."""
    try:
        channels = Roles.parse(*(asked[name] for name in ROLES)).channels
    except InputError:  # reported already
        return
    for record in records if isinstance(records, list | tuple) else [records]:
        for name in channels if isinstance(record, Record) else ():
            _ = record[name]


def _advice(error: InputError, records: Any, asked: Mapping[str, Any]) -> str:
    """Advice on an unknown name in a dictionary, that of no given channel; empty if there is none."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, UnknownNameError):
        cause = cause.__cause__
    said, given = str(error), records if isinstance(records, list | tuple) else [records]
    sought = cause is not None and "expression '" in said and f"no channel named {cause.name!r}" in said
    if cause is None or not sought or not all(isinstance(record, Record) for record in given):
        return ""
    name, targets = cause.name, asked["target"] or ()
    if name in (targets.split(",") if isinstance(targets, str) else targets):
        return f"{name} is what the law gives: leave it out of its terms"
    if any(name in record.channels for record in given):
        return f"the record has it: name it as an input, --input {name}"
    moving = asked["chains"] or asked["displacement"] or asked["velocity"] or asked["acceleration"]
    if "did you mean" in said or f"{{{name}}}" in said or asked["discrete"] or not moving:
        return ""
    return f"if it is hidden, state its rate, --law 'd{name} = ...'"


def question_of(**asked: Any) -> Question:
    """Check the arguments of `discover` other than `SOURCES` before any record is read; returns the `Question`."""
    given = SimpleNamespace(**asked)
    _check_kinds(given)
    rules = Rules(given.max_terms, given.tolerance)
    rules.check(given.method)
    roles = with_laws(given.law, Roles.parse(*(asked[name] for name in ROLES)))
    noise, gain_sd, lag_sd = ({} if one is None else one for one in (given.noise, given.gain_sd, given.lag_sd))
    check_sensors(noise, gain_sd, roles, lag_sd)
    smooth = current(given.smooth)
    _check_tails(given.tails, smooth)
    _check_band(given.band, smooth)
    if roles.discrete:
        _check_map(smooth, given.band, lag_sd, given.differs, roles.hidden)
    variables, dictionary = _variables(roles), given.dictionary
    if is_library(dictionary):
        dictionary = terms_of(dictionary, variables.names)
    terms, allowed, roles = with_law_terms(*dictionaries_of(dictionary, roles, variables), roles)
    if gain_sd and roles.hidden:
        raise InputError(
            "gain_sd: the effect of a sensor's factor on hidden states is not known; leave it out, and scale the"
            " channel by the factor that is known"
        )
    known = (given.constraints,) if isinstance(given.constraints, str) else tuple(given.constraints)
    parse_ties(known, terms, roles.targets, allowed=allowed)
    # wrong constraints are reported before the work
    check_scales(roles, terms, allowed, parse_constraints(known, terms, roles.targets, allowed=allowed))
    if given.conserve:
        prior = given.prior and not _forces_all(given.prior)
        beside = known or given.differs or roles.hidden or given.discrete or prior or given.max_terms
        joint = given.method in JOINT and smooth == "auto"
        _check_conserve(bool(beside) or given.coarsen < 1.0, joint, terms)
    roles = roles.for_terms(terms)
    earlier = {name: found["name"] for name in roles.inputs if (found := EARLIER.fullmatch(name))}
    noise = {**noise, **{name: noise[base] for name, base in earlier.items() if base in noise}}
    return Question(
        roles=roles,
        terms=tuple(terms),
        allowed=allowed,
        dictionary=dictionary,
        method=given.method,
        smooth=smooth,
        holdout=given.holdout,
        rules=rules,
        coarsen=given.coarsen,
        prior=given.prior,
        known=known,
        conserved=parse_conserved(given.conserve, roles.chains) if given.conserve else {},
        conserve=given.conserve,
        differs=given.differs,
        noise=noise,
        gain_sd=gain_sd,
        lag_sd=lag_sd,
        tails=given.tails,
        band=given.band,
        seed=given.seed,
        step=silent if given.progress is None else given.progress,
    )


def _variables(roles: Roles) -> Variables:
    """The variables of terms; for static laws alone the inputs."""
    if not roles.states:
        return Variables(roles.inputs)
    chained = tuple(chain.states for chain in roles.chains)
    targets = () if roles.discrete else roles.targets
    return Variables(roles.states, roles.inputs, chained, targets=targets, discrete=roles.discrete)


def _check_kinds(given: SimpleNamespace) -> None:
    """Raise InputError for arguments of the wrong type or out of range."""
    for name in ("method", "smooth", "conserve"):
        require_text(getattr(given, name), name)
    for name in ("constraints", "differs"):
        require_texts(getattr(given, name), name)
    if given.prior is not None:
        require_kind(given.prior, Prior, "prior", "a Prior")
    if given.progress is not None:
        require_kind(given.progress, Callable, "progress", "a function of (stage, done, total)")  # type: ignore[arg-type]
    seed = given.seed
    for one in seed if isinstance(seed, Sequence) and not isinstance(seed, str) else [seed]:
        require_kind(one, Integral, "seed", "a whole number")
        if one < 0:
            raise InputError(f"a seed is a whole number, 0 or more, got {one}")
    if given.method not in ENGINES and given.method not in ENGINES.load():
        raise UnknownNameError("method", given.method, ENGINES)
    require_number(given.holdout, "holdout")
    require_number(given.coarsen, "coarsen")
    if not 0 <= given.holdout < 1:
        raise InputError(f"holdout is a share of the rows, 0 <= holdout < 1, got {given.holdout!r}")
    if not 0 < given.coarsen <= 1:
        raise InputError(f"coarsen is a power of the likelihood, 0 < coarsen <= 1, got {given.coarsen!r}")


def _check_map(smooth: Smooth, band: Any, lag_sd: Any, differs: Any, law: Any) -> None:
    """Raise InputError for options that maps (equations for the next sample) do not have."""
    given = {
        "smooth='none'": smooth == "none",
        "band": band is not None,
        "lag_sd": bool(lag_sd),
        "differs": bool(differs),
        "law": bool(law),
    }
    refused = [name for name, is_given in given.items() if is_given]
    if refused:
        raise InputError(f"discrete: a map has no {refused[0]}; leave it out")


def _forces_all(prior: Prior) -> bool:
    """Whether a prior has every term in and knows no signs, which leaves a conserved sum as it is."""
    return bool(np.all(np.asarray(prior.prior_inclusion) == 1.0)) and prior.signs is None and prior.bounds is None


def _check_conserve(beside: bool, joint: bool, terms: Sequence[Expression]) -> None:
    if beside or not joint:
        raise InputError(
            "conserve: takes methods auto and bma with smooth='auto', no constraints, differs, law, discrete, prior,"
            " coarsen or max_terms beside it: leave these out"
        )
    unknown = next((term.text for term in terms if term.unknowns or term.choice), None)
    if unknown is not None:
        raise InputError(f"conserve: term {unknown}: takes no constants inside terms, and no either-or: write numbers")


def _check_tails(tails: str, smooth: str) -> None:
    require_text(tails, "tails")
    if tails not in get_args(Tails):
        raise InputError(f"tails is 'gauss' or 'student', got {tails!r}")
    if tails == "student" and smooth != "auto":
        raise InputError(f"tails='student' needs the likelihood of the record, smooth='auto', not {smooth!r}")


def _check_band(band: tuple[float, float] | None, smooth: Smooth) -> None:
    if band is None:
        return
    if smooth == "none":
        raise InputError("band= needs the likelihood of the record, smooth='auto', not smooth='none'")
    try:
        low, high = (float(end) for end in band)
    except (TypeError, ValueError):
        raise InputError(f"band is a pair of frequencies [Hz], such as (0.5, 40), not {band!r}") from None
    if not 0.0 <= low < high < np.inf:
        raise InputError(f"band {low:g} to {high:g} Hz: give two frequencies, the lower one first, 0 or more")


def _answer(
    question: Question,
    records: Any,
    t: Any,
    stream: bool | None,
    client: Any,
    checkpoint: str | os.PathLike[str] | None,
) -> tuple[Equations, WarningLog]:
    """Answer a question from records that are read whole or, if they are long, some rows at a time."""
    channels = [name for name in question.roles.channels if not EARLIER.fullmatch(name)]
    executor = by_threads if client is None else Cluster(client).map
    if is_dask(records):
        if client is None:
            raise InputError("Dask collections are read by a cluster: give client=, a dask.distributed.Client")
        records = _whole_streams(dask_streams(records, client, channels, t))
    extents = extents_of(records, t, stream, clustered=client is not None)
    required = extents is not None and (stream or client is not None)
    if extents is None:
        measured = with_row_numbers(as_records(records, t))
        long = sum(record.n for record in measured) > MOST_ROWS and not question.roles.discrete
        if not (long and (question.smooth == "auto" or (client is not None and question.smooth == "none"))):
            return question.answer(measured)
        extents, checkpoint = _whole_streams(map(RecordStream, measured)), None
    extents = of_channels(extents, channels)
    try:
        return _of_all_rows(question, _whole(question, extents, executor, checkpoint))
    except NotStreamed as why:
        if required:
            raise
        some = stretches(extents)
        used, given = sum(record.n for record in some), sum(one.n for one in extents)
        return question.answer(some, because=f"{used:,} of {given:,} rows are used, {len(some)} stretches: {why}")


def _of_all_rows(question: Question, whole: Whole) -> tuple[Equations, WarningLog]:
    """Answer from sums over all rows; their checkpoints are kept until it is found."""
    try:
        found = replace(question, whole=whole).answer(stretches(whole.extents))
    except KeyboardInterrupt as stop:
        if (folder := whole.checkpoints.kept) is not None:
            stop.add_note(f"sums over the rows are kept in {folder}; the same command continues")
        raise
    whole.checkpoints.clear()
    return found


def extents_of(records: Any, t: Any, stream: bool | None, clustered: bool = False) -> tuple[Extent, ...] | None:
    """Extents of files that are read some rows at a time (on a cluster: all files); None for records read whole."""
    several = isinstance(records, Sequence) and not isinstance(records, (str, bytes))
    items = list(records) if several else [records]
    if items and all(isinstance(one, Extent) for one in items):
        return tuple(items)
    paths = [one for one in items if isinstance(one, (str, os.PathLike))]
    if len(paths) < len(items) or not items or stream is False:
        if stream:
            raise InputError("stream=True is for files and folders; these are data in memory")
        return None
    if not (stream or clustered or streamed_unasked(paths)):
        return None
    if clustered:  # workers have other working directories
        paths = [Path(path).absolute() for path in paths]
    if t is not None and not isinstance(t, str):
        raise InputError("t names the column that is time, of a file")
    return _whole_streams(open_streams(paths, time=t))


def _whole_streams(streams: Iterable[Stream]) -> tuple[Extent, ...]:
    return tuple(Extent(one, 0, one.bounds[-1]) for one in streams)


def _whole(question: Question, extents: tuple[Extent, ...], executor: Executor, folder: Any) -> Whole:
    if question.roles.hidden:
        raise NotStreamed("hidden states need the record in memory; choose some rows (--rows)")
    if question.roles.discrete:
        raise NotStreamed("maps need the record in memory; choose some rows (--rows)")
    if any(chain.static for chain in question.roles.chains):
        raise NotStreamed("static laws need the record in memory; choose some rows (--rows)")
    if question.roles.timed:
        raise NotStreamed("a term uses t, the time, and needs the record in memory; choose some rows (--rows)")
    proportional = any(share_of_reading(amount) is not None for amount in question.noise.values())
    if question.band is not None or question.tails == "student" or proportional:
        raise NotStreamed(
            "records that are read some rows at a time are fitted with tails='gauss', equal noise of all samples and"
            " in no band; use some rows (--rows), or leave these options out"
        )
    if folder is not None:
        _require_folder(Path(folder))
    kept = Checkpoints.of(extents, cache_folder() if folder is None else Path(folder), asked=folder is not None)
    return Whole(extents, executor, question.step, kept)


def _require_folder(folder: Path) -> None:
    """Make the folder that the user named for checkpoints; InputError if it cannot be written to."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(
            f"{folder}: no checkpoints can be kept there ({error.strerror or error}); name another folder"
        ) from None
