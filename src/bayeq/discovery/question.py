"""`Question`: the checked arguments of `discover`, and the steps from records to equations."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from bayeq.arrays import Bools
from bayeq.dictionary import Specification, of_equations, written
from bayeq.dictionary.ranges import constants_of
from bayeq.discovery.cautions import (
    change_of,
    warn_of_blows,
    warn_of_rates,
    warn_of_sensors,
    warn_of_sums,
    warn_of_terms,
    warn_of_units,
    warn_of_zero,
    with_other_terms,
)
from bayeq.discovery.laws import hidden_states, with_differences, without_hidden
from bayeq.discovery.streaming.whole import Whole
from bayeq.equation.answer import DataSummary, EquationTuple, HiddenState
from bayeq.equation.build import build_equations, warn_of, with_doubts
from bayeq.equation.equation import Equation
from bayeq.equation.equations import Equations
from bayeq.equation.selection.select import Rules, Selection, select
from bayeq.equation.written import arguments_with_units, channel_units, in_radians, odds_text, unlike_summands
from bayeq.errors import DataWarning, InputError, RecordError, TermWarning, WarningLog, some_of
from bayeq.expressions import Expression
from bayeq.expressions.functions import CONSTANTS, TIME
from bayeq.forecast.score import Scores
from bayeq.inference.prior import SIGNED, Prior
from bayeq.likelihood.channels import first_lags
from bayeq.likelihood.hidden import with_first_laws, with_first_paths, with_found_laws, with_values_of
from bayeq.likelihood.layout import Stated
from bayeq.likelihood.nodes import first_values
from bayeq.likelihood.record_fit import RecordFit, refit_record
from bayeq.numerics.settings import LIKELIHOOD, SELECTION
from bayeq.records import Record, counts_rows
from bayeq.records.findings import check_messages, without_copies
from bayeq.records.names import conversion
from bayeq.records.record import in_one_unit
from bayeq.records.repair import UNKNOWN_TIME
from bayeq.regression.constraints import CONSERVED, Constraints, parse_constraints, parse_ties
from bayeq.regression.design import Design, build_design, screened
from bayeq.regression.fit import fit_equations, record_of, sensors_of_design, with_model_of
from bayeq.regression.regression import regressions_of
from bayeq.resumable import Progress
from bayeq.states import Motion, Roles, Smooth, Tails, corrected, estimate_motion, known_sensors, measured_apart
from bayeq.states.bad_samples import Learned, clipped_shares
from bayeq.states.derive import require_in_range, require_samples, require_steps, require_varying
from bayeq.states.motion import cut_at, held_out_share
from bayeq.states.prepare import bridged_record, cleaned, divided_at_gaps, in_samples, require_enough, without_hum
from bayeq.states.rest import without_rest

NO_LIKELIHOOD = (
    "the full fit failed, a simpler one was used: intervals and probabilities are less sure; give fewer terms"
)

NO_TAILS = (
    "tails='student' makes no difference: it needs the full fit, which is not used here; use more rows, or fewer terms"
)

# Fewest training rows for a regression.
LEAST_TRAINING_ROWS = 3

# Equalities and ties are contradicted if the log likelihood without them is higher by at least this [nats].
CONTRADICTED = 5.0

# Hidden states are shown only if the log odds in their favour are at least this [nats].
CLEARLY = 3.0

# Most rounds of learning lags and factors; they end when none moves by this share of its standard deviation.
SENSOR_ROUNDS, SENSOR_FOUND = 8, 0.1

# For checks of channels against each other missing samples are interpolated linearly if their share is below this: the
# peaks that this cuts off reduce an estimated factor by about nine times the share.
MOST_BRIDGED = 0.005


class NotStreamed(InputError):
    """The question needs all rows in memory at once."""


@dataclass(frozen=True, eq=False)
class Question:
    """The arguments of `bayeq.discover`, checked; `known` are the constraints, `step` is the progress callback."""

    roles: Roles
    terms: tuple[Expression, ...]
    allowed: Bools
    dictionary: Specification
    method: str
    smooth: Smooth
    holdout: float
    rules: Rules
    coarsen: float
    prior: Prior | None
    known: tuple[str, ...]
    conserved: Mapping[int, float]
    conserve: str
    differs: str | Sequence[str]
    noise: Mapping[str, float | str]
    gain_sd: Mapping[str, float | str]
    lag_sd: Mapping[str, float | str]
    tails: Tails
    band: tuple[float, float] | None
    seed: int
    step: Progress
    whole: Whole | None = None  # all rows, where records are stretches of longer ones

    def answer(self, records: Sequence[Record], because: str | None = None) -> tuple[Equations, WarningLog]:
        """Equations and warnings (`because`: one about the choice of rows); NotStreamed if stretches do not suffice."""
        if self.differs:
            question, numbered = self._by_record(records)
            return question.answer(numbered, because)
        log, step, whole = WarningLog(), self.step, self.whole
        measured = [in_samples(record, self.roles) if self.roles.discrete else record for record in records]
        if whole is None:
            measured, copies = without_copies(measured, self.roles.channels)
            measured, converted = in_one_unit(measured, self.roles.channels)
            measured, rests = without_rest(measured, self.roles)
            log.extend([*copies, *converted, *rests], DataWarning)
        if because is not None:
            log.warn(because, DataWarning)
        if self.roles.states and not self.roles.discrete and any(map(counts_rows, measured)):
            log.warn(UNKNOWN_TIME, DataWarning)
        _require_unambiguous(self.terms, measured, self.roles)
        step("states", 0, 1)
        motion, pieces = self._motion(measured, log)
        if self.conserved and (changing := change_of(self.conserve, self.conserved, motion)):
            return replace(self, conserve="", conserved={}).answer(records, changing)
        before = len(log.collected)
        units = _units(pieces, motion.roles, log)
        _require_one_unit(self.terms, units, self.roles.channels)
        terms, known = _in_radians(self.terms, self.known, units, log)
        motion, *others = self._with_hidden(motion, terms)
        terms = self._with_values(with_values_of(terms, motion), motion)
        terms, allowed = self._kept(terms, known, motion, log)
        design = self._design(motion, terms, allowed)
        warn_of_terms(design, log)
        warn_of_zero(design, pieces, log)

        step("likelihood", 0, 1)
        record, known, constrained = self._record(design, known, log, others)
        if record is None and motion.smoothed:
            log.warn(NO_LIKELIHOOD, DataWarning)
        if record is None and self.tails == "student":
            log.warn(NO_TAILS, DataWarning)
        if record is None and motion.smoothing and whole is not None:  # sums over all rows need it
            raise NotStreamed(
                "the likelihood of the record could not be evaluated near its motion, and records that are read some"
                " rows at a time are fitted by it alone: give fewer terms, or use some rows (--rows)"
            )
        hidden = hidden_states(design, record, partial(self._likelihood, dictionary=self._seen_dictionary))
        if any(one.log_odds_without > -CLEARLY for one in hidden):
            return self._without_hidden(hidden, records)
        design = self._at_values(design, record)
        equations, scores, selections = self._found(self._judged(design, record), record, constrained, units)
        found, scored, gain = self._of_all_rows(design, record, log), equations, 0.0
        if found is not None and record is not None:
            other, gain = with_model_of(record, found[1])
            if other is not record:  # the equations that are printed are scored
                scored, scores, _ = self._found(self._judged(design, other), other, constrained, units)
            equations, _, selections = self._found(*found, constrained, units, scored)
        warn_of(equations, selections, log)
        for equation in equations:
            log.extend([f"{equation.target}: {message}" for message in equation.at_ends], DataWarning)
        step("inference", len(equations), len(equations))
        likelihood = record if found is None else found[1]
        if likelihood is not None:
            motion = replace(likelihood.told(motion), sensors=likelihood.learned(motion.sensors))
        log.collected[before:before] = [(one, DataWarning) for one in _channel_messages(motion, pieces, measured)]
        data = DataSummary.of(pieces, motion, found is not None)
        if whole is not None:
            data = data.of_stretches(whole.names, *whole.counts(motion.holdout), len(measured))
        tolerance, clipped = self.rules.tolerance or SELECTION.tolerance, clipped_shares(measured, self.roles.seen)
        doubted = with_doubts(equations, selections, tolerance, clipped)
        answer = Equations(
            equations=EquationTuple(with_other_terms(doubted, gain < -CLEARLY, log)),
            inputs=motion.roles.inputs,
            method=self.method,
            dictionary=written(self.dictionary),
            smooth=self.smooth,
            data=data,
            dropped=design.dropped,
            warnings=log.messages,
            constraints=(*known, self.conserve + CONSERVED) if self.conserve else known,
            scores=scores,
            hidden=hidden,
        )
        return answer, log

    def _with_hidden(self, motion: Motion, terms: Sequence[Expression]) -> list[Motion]:
        """Motions with first paths of the hidden states, one per start of the search; else the motion itself."""
        if not self.roles.hidden:
            return [motion]
        if self.whole is not None or self.smooth != "auto" or not motion.smoothing:
            raise InputError(
                "law: hidden states are found by the likelihood of the record in memory: use smooth='auto', give time"
                " and enough rows; of a long file choose some rows (--rows)"
            )
        laws = [one if one.law is None else one.with_law(terms[self.terms.index(one.law)]) for one in self.roles.hidden]
        roles = motion.roles.with_chains([*motion.roles.chains, *laws])
        starts = with_first_laws if laws[0].stated else with_first_paths
        return starts(motion, roles, terms, self.allowed)

    def _without_hidden(
        self, hidden: tuple[HiddenState, ...], records: Sequence[Record]
    ) -> tuple[Equations, WarningLog]:
        """The answer without the hidden states, which the record does not need, and terms that contain them."""
        terms, allowed = without_hidden(self.terms, self.allowed, self.roles)
        seen = replace(self, roles=self.roles.seen, terms=terms, allowed=allowed, dictionary=self._seen_dictionary)
        found, log = seen.answer(records)
        names, odds = some_of([one.state for one in hidden], 30), hidden[0].log_odds_without
        message = f" is not needed (odds without it {odds_text(odds)}): leave it out, or drive the system harder"
        if found.verdict.kind == "nearly true" and not hidden[0].stated:
            message = ": no law of it was found that makes the equations better than without it; offer it other terms"
        elif not math.isfinite(odds):
            message = " is not needed: no fit has it in an equation; leave it out, or give narrower ranges of constants"
        log.warn(f"hidden {names}{message}", DataWarning)
        return replace(found, hidden=hidden, warnings=log.messages), log

    @property
    def _seen_dictionary(self) -> Specification:
        """The dictionary of the equations of measured states."""
        given = of_equations(self.dictionary, self.roles.sought)
        return self.dictionary if given is None else {target: given[target] for target in self.roles.seen.targets}

    @property
    def _likelihood(self) -> Callable[..., RecordFit | None]:
        """The likelihood of the records of a design: `bayeq.regression.fit.record_of` with the options given."""
        tolerance = self.rules.tolerance
        return partial(record_of, smooth=self.smooth, dictionary=self.dictionary, prior=self.prior, tolerance=tolerance)

    def _record(
        self, design: Design, known: Sequence[str], log: WarningLog, others: Sequence[Motion]
    ) -> tuple[RecordFit | None, tuple[str, ...], tuple[Constraints, ...]]:
        """The likelihood of the records, and the constraints that hold, as texts and per equation.

        It is compared with the likelihood without ties and equalities; those that the record contradicts are dropped.
        """
        dropped = {term.name: term.reason for term in design.dropped}
        if not self.conserved:
            warn_of_sums(design, log)
        starts = [build_design(with_values_of(design.terms, one), one, allowed=design.allowed) for one in others]
        beside = [one for one in starts if one.names == design.names]
        fitted = partial(self._likelihood, design, conserved=self.conserved or None, others=beside)
        equal = tuple(text for text in known if "==" in text)

        @cache
        def given(applied: tuple[str, ...]) -> tuple[RecordFit | None, tuple[str, ...], tuple[Constraints, ...]]:
            some = tuple(text for text in known if text in applied or text not in equal)
            constrained = _constrained(some, design, self.method)
            ties = parse_ties(some, design.terms, design.motion.roles.targets, dropped, design.allowed)
            found = fitted(constraints=constrained, ties=[Stated(parts, value, 0.0) for _, parts, value in ties])
            needed = self.conserved or ties or any(one.stated for one in constrained)
            if needed and (found is None or self.whole is not None):
                raise InputError(
                    "constraints: ~, ties between equations and conserved sums are taken by the likelihood of the"
                    " record in memory: use smooth='auto', and choose rows (--rows) of a long file"
                )
            return found, some, constrained

        held = given(equal)
        if not equal or held[0] is None:
            return held
        free = given(())

        def lost(found: RecordFit | None) -> float:
            return math.inf if found is None or free[0] is None else free[0].of_motion - found.of_motion

        odds = lost(held[0])
        if 0.0 < odds < CONTRADICTED:
            said = f"(odds {odds_text(-odds)}): shown with it; check factors"
            log.warn(f"the record speaks against {some_of(equal, 40, '; ')} {said}", DataWarning)
        if free[0] is None or odds < CONTRADICTED:
            return held
        kept = tuple(text for text in equal if lost(given((text,))[0]) < CONTRADICTED)
        if lost(given(kept)[0]) >= CONTRADICTED:
            kept = ()
        wrong = some_of([text for text in equal if text not in kept], 40, "; ")
        log.warn(f"the record contradicts {wrong} (odds {odds_text(-odds)}): shown without; check factors", DataWarning)
        return given(kept)

    def _by_record(self, records: Sequence[Record]) -> tuple[Question, list[Record]]:
        """The question with a candidate difference of each coefficient that may differ, and records with indicators."""
        if self.whole is not None:
            raise InputError("differs: the records have to be in memory: choose some rows, --rows")
        numbered, names, terms, allowed = with_differences(self.differs, records, self.terms, self.allowed)
        roles = replace(self.roles, inputs=(*self.roles.inputs, *names))
        return replace(self, roles=roles, terms=terms, allowed=allowed, differs=()), numbered

    def _motion(self, records: list[Record], log: WarningLog) -> tuple[Motion, list[Record]]:
        """Estimated motion, and the prepared records that it describes."""
        try:
            learned = None if self.whole is None else self.whole.learned
            pieces, roles, share = _prepared(records, self.roles.seen, self.smooth, self.holdout, log, learned)
        except RecordError as error:
            if self.whole is None:
                raise
            raise RecordError(f"{error} (found in stretches of a long record: choose its rows, --rows)") from None
        sensors = known_sensors(self.noise, self.gain_sd, roles, pieces, self.tails, self.lag_sd)
        if self.band is not None:
            pieces, messages = without_hum(pieces, roles.channels, *self.band)
            log.extend(messages, DataWarning)
        motion = estimate_motion(pieces, roles, self.smooth, share, sensors, self.band)
        warn_of_rates(records, roles, log)
        warn_of_units(records, roles, log)
        warn_of_sensors(motion, {*self.noise, *self.gain_sd, *self.lag_sd}, log)
        warn_of_blows(pieces, roles.inputs, sensors.noise, log)
        motion = self._calibrated(motion, pieces)
        _inspect(motion, pieces, self.holdout, log)
        return motion, pieces

    def _calibrated(self, motion: Motion, pieces: Sequence[Record]) -> Motion:
        """Motion with the lags and factors of channels removed, as estimated by the likelihood of the record."""
        sensors = motion.sensors
        by_likelihood = self.smooth == "auto" and motion.smoothing and not any(map(counts_rows, pieces))
        if by_likelihood and self.whole is None:
            told = [name for name in motion.roles.compared if sensors.gain_sd.get(name)]
            sensors = replace(sensors, gains={name: sensors.gain(name) for name in told})
        if not self.lag_sd and not sensors.gains:
            return motion
        if self.lag_sd and self.whole is not None:
            raise NotStreamed("lag_sd: lags are learned from a record in memory: choose some rows, --rows")
        if not by_likelihood:
            raise InputError(
                "lag_sd: lags are learned by the likelihood of the record: use smooth='auto', time and more rows, or"
                " shift the channel (bayeq.correct_delay)"
            )
        if sensors.lags.keys() >= set(motion.roles.channels):
            raise InputError("lag_sd: only lags against other channels show: leave out a channel that is the clock")
        terms, known = _in_radians(self.terms, self.known, _units(pieces, motion.roles, WarningLog()), WarningLog())

        def design_of(motion: Motion) -> Design:
            motion, *_ = self._with_hidden(motion, terms)
            valued = self._with_values(with_values_of(terms, motion), motion)
            kept, allowed = self._kept(valued, known, motion, WarningLog())
            return build_design(kept, motion, allowed=allowed)

        first = design_of(motion)
        sensors, moved = replace(sensors, lags=first_lags(first.motion, first.terms)), math.inf
        for k in range(SENSOR_ROUNDS):
            self.step("sensors", k, SENSOR_ROUNDS)
            motion = estimate_motion(pieces, motion.roles, self.smooth, motion.holdout, sensors, self.band)
            if moved < SENSOR_FOUND:
                break
            sensors, moved = sensors_of_design(design_of(motion), self.dictionary, self.prior)
        return motion

    def _kept(
        self, terms: tuple[Expression, ...], known: Sequence[str], motion: Motion, log: WarningLog
    ) -> tuple[tuple[Expression, ...], Bools]:
        """Candidates and `allowed` (C, P); of too many, the constrained, the simplest, and those that explain most."""
        most = LIKELIHOOD.most_candidates // len(motion.roles.chains) - 1
        if len(terms) <= most:
            return terms, self.allowed
        constrained = parse_constraints(known, terms, motion.roles.targets)
        kept = screened(terms, motion, self.allowed, np.any([one.concerned for one in constrained], axis=0), most)
        log.warn(
            f"{len(terms):,} candidates: {len(kept):,} were kept, the simplest and those that explain most; leave out"
            " what cannot be true",
            TermWarning,
        )
        return tuple(terms[int(j)] for j in kept), self.allowed[:, kept]

    def _design(self, motion: Motion, terms: Sequence[Expression], allowed: Bools) -> Design:
        """The design of the terms; with moments of all rows of a long record if the motion is not smoothed."""
        if self.whole is None or motion.smoothing:
            return build_design(terms, motion, lambda done, total: self.step("dictionary", done, total), allowed)
        return self.whole.design(motion, terms, allowed, motion.holdout)

    def _of_all_rows(
        self, design: Design, record: RecordFit | None, log: WarningLog
    ) -> tuple[Design, RecordFit] | None:
        """Design and likelihood of all rows, held-out ones included; None if the answer is from the training rows."""
        motion, whole = design.motion, self.whole
        if record is None or not (motion.held_out or whole is not None):
            return None
        of_all = build_design(design.terms, motion.whole, allowed=design.allowed)
        # one extreme held-out row may make columns collinear, which leaves other usable terms
        if of_all.names != design.names:
            if whole is None:
                return None
            of_all = design
        if whole is not None:
            of_all = replace(of_all, motion=record.told(of_all.motion))
            return of_all, whole.record(record, motion, log)
        found = refit_record(motion.whole, record, of_all.terms, of_all.train)
        return None if found is None else (self._judged(self._at_values(of_all, found), found), found)

    def _with_values(self, terms: tuple[Expression, ...], motion: Motion) -> tuple[Expression, ...]:
        """The terms with starting values of the constants inside them."""
        unknown = next((term for term in terms if term.unknowns or term.choice), None)
        if unknown is None:
            return terms
        if self.smooth != "auto" or not motion.smoothed:
            timeless = any(rows.time is None for rows in motion.records)
            how = "give time (of rows in any order fs=1)" if timeless else "use smooth='auto', and more rows"
            raise InputError(
                f"term {unknown.text}: constants inside terms, and either-or, are found by the likelihood of the"
                f" record: {how}, or write a number"
            )
        if self.whole is not None:
            raise NotStreamed(
                f"term {unknown.text}: constants inside terms need the record in memory: choose some rows, --rows"
            )
        return first_values(terms, motion, self.allowed)

    def _at_values(self, design: Design, record: RecordFit | None) -> Design:
        """The design with the values of constants inside terms that the likelihood found."""
        if record is None:
            unknown = next((term.text for term in design.terms if term.unknowns), None)
            if unknown is not None:
                raise InputError(
                    f"term {unknown}: its constants are found by the likelihood of the record, which could not be"
                    " evaluated near its motion: give narrower ranges, write abs() where a power or a root needs it, or"
                    " fewer terms"
                )
            return design
        terms = record.task.layout.terms
        if terms == design.terms:
            return design
        found = build_design(terms, with_found_laws(design.motion, terms), allowed=design.allowed)
        if found.dropped:
            name, why = found.dropped[0].name, found.dropped[0].reason
            values = ", ".join(f"{one} = {known.value:.4g}" for one, known in constants_of(terms).items())
            advice = "write abs() where its argument changes sign" if "finite" in why else "give narrower ranges"
            raise InputError(f"term {name}: {why}, at {values}: {advice}")
        return found

    def _judged(self, design: Design, record: RecordFit | None) -> Design:
        """The design on the motion by which equations are judged."""
        motion = design.motion if record is None else record.judged(design.motion)
        if motion.records is design.motion.records:
            return replace(design, motion=motion)
        judged = build_design(design.terms, motion, allowed=design.allowed)
        return judged if judged.names == design.names else design

    def _found(
        self,
        design: Design,
        record: RecordFit | None,
        constrained: Sequence[Constraints],
        units: Mapping[str, str],
        scored: Sequence[Equation] = (),
    ) -> tuple[tuple[Equation, ...], Scores | None, list[Selection]]:
        """Equations by the likelihood or from rows as measured; with the scores of the `scored` ones, if given."""
        regressions = regressions_of(design, record)
        self.step("inference", 0, len(regressions))
        fits = fit_equations(
            regressions, constrained, self.method, self.prior, self.coarsen, self.rules.tolerance, self.seed
        )
        selections = select(fits, self.rules, design.motion, whole=bool(self.conserved))
        equations, scores = build_equations(selections, units, scored)
        return equations, scores, selections


def _prepared(
    records: list[Record], roles: Roles, smooth: Smooth, holdout: float, log: WarningLog, learned: Learned | None
) -> tuple[list[Record], Roles, float]:
    """Records without bad samples, divided at gaps; roles without channels computed from others; share to hold out."""
    share = held_out_share(holdout, sum(record.n for record in records))
    if learned is None:  # a stretch of a long record may lack a channel
        require_samples(records, roles.channels, "leave the channel or the record out")
    require_varying(records, roles.channels)
    require_steps(records)
    records, messages = cleaned(records, roles, smooth, learned)
    log.extend(messages, DataWarning)
    require_enough(records, roles)
    records, messages = divided_at_gaps(records, roles, smooth)
    still = _still(records, roles.inputs, share)
    if still:
        share = 0.0
        messages.append(f"{some_of(still, 30)}: no change but in the last rows: all rows are used, none held out")
    if smooth != "none" and not roles.discrete and all(record.time is not None for record in records):
        chains, computed = measured_apart(records, roles.chains, share)
        roles, messages = roles.with_chains(chains), messages + computed
    log.extend(messages, DataWarning)
    return records, roles, share


def _still(records: Sequence[Record], names: Sequence[str], share: float) -> list[str]:
    """Inputs that are constant over the training rows of all records."""
    cuts = [cut_at(record.n, share) for record in records]
    if not share or sum(cuts) < LEAST_TRAINING_ROWS:
        return []
    first = {name: [record[name][:cut] for record, cut in zip(records, cuts, strict=True)] for name in names}
    known = {name: np.concatenate([values[np.isfinite(values)] for values in some]) for name, some in first.items()}
    return [name for name, values in known.items() if len(values) and not np.ptp(values) > 0.0]


def _inspect(motion: Motion, records: Sequence[Record], holdout: float, log: WarningLog) -> None:
    """Refuse values out of range and too few training rows; warn if no rows can be held out."""
    for rows in motion.records:
        require_in_range(rows.columns, rows.name)
    total = sum(record.n for record in records)
    used, _ = motion.counts
    if used < LEAST_TRAINING_ROWS:
        raise RecordError(f"holdout {holdout:g} leaves {used} training rows, too few for a regression; lower it")
    if holdout > 0 and held_out_share(holdout, total) == 0:
        log.warn(f"only {total} rows: all are used, none held out to judge the equation by; measure more", DataWarning)


def _channel_messages(motion: Motion, records: Sequence[Record], read: Sequence[Record]) -> list[str]:
    """Messages about channels that contradict each other, a sentence each; about lost samples of records as `read`."""
    roles = motion.roles.seen
    if roles.discrete:
        return []
    records = [corrected(record, motion.sensors) for record in records]
    present = [bridged_record(record, roles, MOST_BRIDGED) for record in records]
    stepping = roles.targets if "hold" in motion.courses.values() else ()
    chains = [chain.measured for chain in roles.chains]
    drifting = motion.band is not None and motion.band[0] > 0.0
    return check_messages(present, chains, roles.inputs, stepping, drifting, read)


def _constrained(known: Sequence[str], design: Design, method: str) -> tuple[Constraints, ...]:
    """Constraints of each equation on usable terms; InputError for signs or bounds that the method does not take."""
    dropped = {term.name: term.reason for term in design.dropped}
    found = parse_constraints(known, design.terms, design.motion.roles.targets, dropped)
    if method not in SIGNED and any(np.isfinite(one.limits).any() for one in found):
        what = "signs" if all(one.bounds is None for one in found) else "bounds"
        raise InputError(f"method {method!r} takes no {what} of coefficients; choose one of: {', '.join(SIGNED)}")
    return found


def _units(records: Sequence[Record], roles: Roles, log: WarningLog) -> dict[str, str]:
    units, conflicts = channel_units([record.units for record in records], roles.chains, roles.inputs, records[0].clock)
    log.extend(conflicts, DataWarning)
    if any(map(counts_rows, records)) and not roles.discrete:  # estimated derivatives are per sample
        return {name: unit for name, unit in units.items() if name in roles.channels}
    if roles.timed:
        units[TIME] = records[0].clock
    return units


def _in_radians(
    terms: Sequence[Expression], known: Sequence[str], units: Mapping[str, str], log: WarningLog
) -> tuple[tuple[Expression, ...], tuple[str, ...]]:
    """Terms and constraints with degrees converted to radians; warns about this and about arguments with a unit."""
    written = tuple(in_radians(term, units) for term in terms)
    changed = [(term.text, now.text) for term, now in zip(terms, written, strict=True) if now != term]
    if changed:
        before, after = changed[0]
        others = f" ({len(changed) - 1} more alike)" if len(changed) > 1 else ""
        log.warn(f"check units: {before} is of an angle in degrees: taken of radians, as {after}{others}", TermWarning)
    for before, after in changed:
        known = [text.replace(before, after) for text in known]
    found = [(term.text, unit) for term in written for unit in arguments_with_units(term, units)]
    if found:
        text, unit = found[0]
        others = f" ({len(found) - 1} more alike)" if len(found) > 1 else ""
        log.warn(f"{text}: its argument has the unit {unit}{others}: leave it, or use a ratio without one", TermWarning)
    return written, tuple(known)


def _require_one_unit(terms: Sequence[Expression], units: Mapping[str, str], channels: Collection[str]) -> None:
    """Raise InputError for the sum or difference of channels in two units of one quantity, such as mm and m."""
    for term in terms:
        for left, right in unlike_summands(term, units):
            name, other = (left, right) if left in channels else (right, left)
            stated = f"{conversion(units[name], units[other]):.6g} {units[other]}"
            way = f", {name} by units={{{name!r}: {stated!r}}}, --units {name}='{stated}'" if name in channels else ""
            raise InputError(
                f"term {term.text!r}: {name} is in {units[name]}, {other} in {units[other]}; give both in one unit{way}"
            )


def _require_unambiguous(terms: Sequence[Expression], records: Sequence[Record], roles: Roles) -> None:
    """Raise InputError for t, pi or e in a term if the record has a channel of that name without a role."""
    for term in terms:
        written = term.names | term.constants
        for name in sorted(written.intersection({TIME, *CONSTANTS}).difference(roles.names)):
            if any(name in record.channels for record in records):
                meaning = "the time" if name == TIME else f"the number {CONSTANTS[name]:.4g}"
                raise InputError(
                    f"term {term.text!r}: {name} is {meaning}, but the record has a channel {name!r} that is no input;"
                    f" name it as one (inputs=, --input), or give the channel another name"
                )
