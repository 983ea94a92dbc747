"""`plan_excitation`: simulates designs and ranks them by the information per second expected from them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.equation.equation import Equation
from bayeq.equation.plan.designs import SHARES, Conditions, Design, Motions, designs_for, shapes
from bayeq.equation.plan.information import (
    CandidateModel,
    coefficient_gain,
    seconds_to_halve,
    seconds_until,
    unexplained,
)
from bayeq.equation.plan.result import Compared, Outcome, Plan, Separation
from bayeq.equation.written import difference
from bayeq.errors import InputError, whole_number
from bayeq.forecast.dynamics import Dynamics, Law
from bayeq.inference.posterior import Posterior
from bayeq.numerics.settings import PLAN
from bayeq.resumable import Progress
from bayeq.states import Roles


@dataclass(frozen=True, eq=False)
class Rival:
    """A rival of the leading model of equation `k`, with the free runs of the system if the rival is true."""

    k: int
    model: Posterior
    compared: Compared
    log_odds: float
    motions: Motions


def plan_excitation(
    equations: Sequence[Equation],
    inputs: Sequence[str],
    conditions: Conditions,
    *,
    odds: float,
    realisations: int,
    seed: int,
    progress: Progress,
) -> Plan:
    """Compare excitations of all inputs by the information expected from them; see `bayeq.Equations.plan`."""
    if not (math.isfinite(odds) and odds > 1):
        raise InputError(f"odds must be a number above 1, not {odds!r}")
    whole_number("realisations", realisations, 2)
    whole_number("seed", seed, 0)
    roles = Roles(tuple(equation.chain for equation in equations), tuple(inputs))
    return _Planning(equations, roles, conditions, odds).plan(realisations, seed, progress)


def noise_of_intervals(equation: Equation) -> float:
    """Standard deviation of the white noise of a target that would give the intervals of the record by least squares.

    Of a term with the coefficient c and the share s of the target's sum of squares Y least squares has the variance
    c^2 sigma^2/(s Y): sigma is the geometric mean over the terms shown.
    """
    shown, residuals = equation.shown_posterior, equation.residuals
    kept, share = shown.support, np.zeros(len(shown.support)) if equation.share is None else equation.share
    relative = (shown.sd[kept] / shown.coef[kept]) ** 2 * share[kept]
    if not (len(relative) and (relative > 0.0).all() and equation.train.nrmse > 0.0):
        # the white noise that hides as much as the residuals, which may be correlated in time
        return equation.noise_sd * math.sqrt(residuals.n / residuals.n_eff)
    target_sd = equation.noise_sd / equation.train.nrmse
    return target_sd * math.sqrt(equation.train.n * math.exp(float(np.log(relative).mean())))


class _Planning:
    """Leading models and rivals of equations, and the conditions of the measurement that is to distinguish them."""

    def __init__(self, equations: Sequence[Equation], roles: Roles, conditions: Conditions, odds: float) -> None:
        self.equations, self.roles, self.conditions, self.odds = equations, roles, conditions, odds
        self.leading = [_leading(equation) for equation in equations]
        listed = [(k, model) for k, equation in enumerate(equations) for model in equation.models[1:]]
        self.listed = sorted(listed, key=lambda one: -one[1].probability / equations[one[0]].models[0].probability)
        within = [one for one in self.listed if one[1].probability * odds > equations[one[0]].models[0].probability]
        self.rivals = [self._rival(*one) for one in within[: PLAN.most_rivals]]
        if not self.rivals:  # the coefficients to learn are those of the terms shown
            self.leading = [equation.shown_posterior for equation in equations]
        self.lead = self._motions(self.leading)

    def _motions(self, models: Sequence[Posterior]) -> Motions:
        laws = [Law(e.chain, e.terms, model, e.unit_gains) for e, model in zip(self.equations, models, strict=True)]
        return Motions(Dynamics.of(laws, self.roles), self.conditions)

    def _rival(self, k: int, model: CandidateModel) -> Rival:
        equation = self.equations[k]
        found = model.posterior(equation.shown_posterior)
        return Rival(
            k=k,
            model=found,
            compared=_compared(equation, self.leading[k], model),
            log_odds=math.log(equation.models[0].probability / model.probability),
            motions=self._motions([*self.leading[:k], found, *self.leading[k + 1 :]]),
        )

    def plan(self, realisations: int, seed: int, progress: Progress) -> Plan:
        """Simulate all designs, and rank them."""
        c, inputs = self.conditions, self.roles.inputs
        largest = max(int(model.support.sum()) for model in [*self.leading, *(rival.model for rival in self.rivals)])
        designs = designs_for(c, largest)
        outcomes = []
        for k, design in enumerate(designs):
            progress("designs", k, len(designs))
            realised = [shapes(design, c, (seed, r)) for r in range(realisations)]
            most = self.lead.largest_share(realised)
            tried = [share for share in SHARES if most > 0.0 and (share < most or share == SHARES[0])]
            outcomes += [self._outcome(design, realised, min(share, most)) for share in tried]
        progress("designs", len(designs), len(designs))
        if not outcomes:
            raise InputError(
                "no excitation keeps the motion within the limits and bounded: lower the amplitude, or raise limits"
            )
        outcomes.sort(key=lambda one: -one.rate)
        best = outcomes[0]
        samples = c.offset + np.array(list(best.amplitudes.values())) * shapes(best.design, c, (seed, 0))
        decided = None
        if not self.rivals and self.listed:  # the likeliest rival of all, which is beyond the odds
            k, model = self.listed[0]
            equation = self.equations[k]
            decided = _compared(equation, equation.models[0].posterior(equation.shown_posterior), model)
        return Plan(
            purpose="models" if self.rivals else "coefficients",
            leading=tuple(_named(e, model) for e, model in zip(self.equations, self.leading, strict=True)),
            rivals=tuple(rival.compared for rival in self.rivals),
            decided=decided,
            outcomes=tuple(outcomes),
            time=np.arange(c.n) / c.fs,
            inputs=dict(zip(inputs, samples.T, strict=True)),
            offsets=dict(zip(inputs, c.offset.tolist(), strict=True)),
            odds=float(self.odds),
            conditions={
                "band": list(c.band),
                "seconds": c.seconds,
                "fs": c.fs,
                "noise": dict(zip((e.target for e in self.equations), c.noise, strict=True)),
                "limits": dict(c.limits),
                "realisations": realisations,
                "seed": seed,
            },
            units={name: unit for equation in self.equations for name, unit in equation.units.items()},
            ranges={name: max(abs(low), abs(high)) for name, (low, high) in c.ranges.items()},
        )

    def _outcome(self, design: Design, realised: Sequence[Floats], share: float) -> Outcome:
        """Information expected from realisations of a design, at a share of the amplitude that keeps the limits."""
        lead, seconds_each = self.lead, self.conditions.seconds
        runs = [run for shape in realised if (run := lead.run(shape, share)) is not None]
        peaks = {name: float(np.mean([np.abs(run[name]).max() for run in runs])) for name in self.roles.states}
        separations = [
            self._separation(rival, place, runs, [rival.motions.run(shape, share) for shape in realised])
            for place, rival in enumerate(self.rivals)
        ]
        separations.sort(key=lambda one: one.rate)
        if separations:
            rate, sd, seconds = separations[0].rate, separations[0].sd, max(one.seconds for one in separations)
        else:
            known = list(zip(self.equations, self.leading, self.conditions.noise, strict=True))
            gains = [
                np.concatenate([coefficient_gain(_columns(e, p, run), p.covariance, noise**2) for e, p, noise in known])
                for run in runs
            ]
            rates = np.array([0.5 * float(np.log1p(gain).sum()) for gain in gains]) / seconds_each
            rate, sd = float(rates.mean()), float(rates.std(ddof=1))
            seconds = max(float(np.mean([seconds_to_halve(gain, seconds_each) for gain in gains])), seconds_each)
        amplitudes = dict(zip(self.roles.inputs, (share * self.conditions.reach).tolist(), strict=True))
        return Outcome(design, amplitudes, share not in SHARES, rate, sd, seconds, peaks, tuple(separations))

    def _separation(
        self, rival: Rival, place: int, runs: Sequence[Mapping[str, Floats]], own: Sequence[Mapping[str, Floats] | None]
    ) -> Separation:
        """How well realisations distinguish a rival: `runs` of the leading model, and `own` runs of the rival."""
        equation, leading, fs = self.equations[rival.k], self.leading[rival.k], self.conditions.fs
        scale = 2.0 * self.conditions.noise[rival.k] ** 2 * self.conditions.seconds
        ahead = np.array([_inimitable(equation, leading, rival.model, run) for run in runs]) / scale
        back = [math.nan if run is None else _inimitable(equation, rival.model, leading, run) for run in own]
        behind = np.array(back) / scale
        if_rival = None if np.isnan(behind).all() else float(np.nanmean(behind))
        extra = int(rival.model.support.sum()) - int(leading.support.sum())
        wanted = math.log(self.odds)

        def until(needed: float, rate: float, occam: int) -> float:
            # the rate is that of the whole design: a part of it, from rest, may tell nothing
            seconds = seconds_until(needed, rate, occam, fs)
            return max(seconds, self.conditions.seconds) if seconds > 0.0 else 0.0

        cases = [(leading, rival.model, ahead, until(wanted - rival.log_odds, float(ahead.mean()), extra))]
        if if_rival is not None:
            seconds = until(wanted + rival.log_odds, if_rival, -extra)
            cases.append((rival.model, leading, behind[np.isfinite(behind)], seconds))
        # motion never shows that the smaller of nested models is true
        shown = [(rates, seconds) for true, other, rates, seconds in cases if not _contains(other, true)]
        by_size = [seconds for true, other, _, seconds in cases if _contains(other, true)]
        if not shown:  # the runs of the larger of nested models diverge
            shown = [(np.zeros(len(ahead)), math.inf)]
        rates = min((rates for rates, _ in shown), key=np.mean)
        return Separation(
            rival=place,
            rate=float(rates.mean()),
            sd=float(rates.std(ddof=1)) if len(rates) > 1 else 0.0,
            if_leading=float(ahead.mean()),
            if_rival=if_rival,
            seconds=max(seconds for _, seconds in shown),
            by_size=by_size[0] if by_size else None,
        )


def _leading(equation: Equation) -> Posterior:
    """The likeliest model; if it has the terms shown, with the coefficients shown, which may be refined."""
    shown, likeliest = equation.shown_posterior, equation.models[0]
    return shown if _members(shown) == likeliest.members else likeliest.posterior(shown)


def _members(model: Posterior) -> tuple[int, ...]:
    return tuple(np.flatnonzero(model.support).tolist())


def _named(equation: Equation, leading: Posterior) -> Compared:
    members = _members(leading)
    probability = next((model.probability for model in equation.models if model.members == members), None)
    return Compared(equation.target, ", ".join(equation.terms[j].text for j in members) or "no terms", probability)


def _compared(equation: Equation, leading: Posterior, model: CandidateModel) -> Compared:
    """A rival, named by the terms that it adds to the leading model and that it drops."""
    own = _members(leading)
    more = ", ".join(equation.terms[j].text for j in model.members if j not in own)
    less = ", ".join(equation.terms[j].text for j in own if j not in model.members)
    return Compared(equation.target, difference(more, less), model.probability)


def _contains(one: Posterior, other: Posterior) -> bool:
    return not (other.support & ~one.support).any()


def _inimitable(equation: Equation, true: Posterior, other: Posterior, run: Mapping[str, Floats]) -> float:
    """Residual sum of squares of the other model, fitted to the target of the true one along a free run."""
    if _contains(other, true):
        return 0.0
    y = _columns(equation, true, run) @ true.coef[true.support]
    return unexplained(y, _columns(equation, other, run))


def _columns(equation: Equation, model: Posterior, run: Mapping[str, Floats]) -> Floats:
    return evaluate_terms([*compress(equation.terms, model.support)], run)
