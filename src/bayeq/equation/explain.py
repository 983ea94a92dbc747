"""The printed answer explained with its own numbers, for a reader who does not know Bayesian statistics."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

import numpy as np

from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation
from bayeq.equation.text import DOUBTFUL, MARK, left_beside_noise
from bayeq.equation.written import round_to
from bayeq.errors import in_digits
from bayeq.inference.engines import ENGINES, NOTEWORTHY_PIP

WIDTH = 100

VERDICTS = {
    "none": "no equation was found that predicts rows it has not seen: do not use the one that is printed",
    "not determined": "the record does not decide between several equations that predict different motion somewhere:"
    " the one printed is the likeliest of them",
    "nearly true": "the equation predicts well, but something moves the system that no candidate term can express, or a"
    " channel holds more than noise; trust its predictions more than the meaning of single terms",
    "found": "no test that was made speaks against the equation",
}


def explanation(eq: Answer, conditional: bool = False) -> str:
    """The printed answer in plain words; with `conditional` it was printed with the intervals given the terms shown."""
    paragraphs = ["What this says", f"verdict {eq.verdict.kind!r}: {VERDICTS[eq.verdict.kind]}."]
    for equation in eq.equations:
        if len(eq.equations) > 1:
            paragraphs.append(f"The equation of {equation.target}")
        if equation.chain.stated:
            state = equation.chain.names[0]
            paragraphs += [f"The law of {state} was stated: nothing is found of it but the constants in it."]
            paragraphs += _of_constants(equation)
            continue
        paragraphs += _of_terms(equation, ENGINES[eq.method].score)
        paragraphs += _of_intervals(equation, conditional)
        paragraphs += _of_checks(equation, eq)
    paragraphs += _of_data(eq)
    return "\n\n".join(textwrap.fill(text, WIDTH, break_long_words=False) for text in paragraphs)


def _of_terms(equation: Equation, score: str) -> Iterator[str]:
    p = equation.posterior
    included = [j for j in range(len(equation.terms)) if p.support[j]]
    n = len(equation.terms)
    if included and score == "PIP":
        least = min(included, key=lambda j: p.pip[j])
        yield (
            f"PIP, posterior inclusion probability: how probable it is that a term is in the law, among the {n}"
            " candidate terms and given this record; above 0.5 it is included. The least certain included term is"
            f" {equation.terms[least].text}, at {p.pip[least]:.3f}."
        )
    elif included:
        yield f"{score}: 1 for a term that the method keeps among the {n} candidates, 0 for others; no probability."
    others = [j for j in range(n) if not p.support[j] and p.pip[j] >= NOTEWORTHY_PIP]
    if others and score == "PIP":
        best = max(others, key=lambda j: p.pip[j])
        yield (
            f"not included: {equation.terms[best].text} has a probability of {p.pip[best]:.2g} and is left out;"
            " rows such as this one show what may yet be missing."
        )
    share = equation.share
    kept = equation.shown_posterior.support
    if share is not None and kept.any():
        largest = max(np.flatnonzero(kept), key=lambda j: share[j])
        yield (
            f"share: how much of the variation of {equation.target} is no longer explained when the term is left"
            f" out. It is largest for {equation.terms[largest].text}; a term may be small and still certain, as damping"
            " often is."
        )


def _of_intervals(equation: Equation, conditional: bool) -> Iterator[str]:
    shown = equation.shown_posterior
    kept = np.flatnonzero(shown.support)
    if not len(kept):
        return
    j = int(kept[0])
    intervals = equation.shown_ci95 if conditional else equation.printed_ci95
    low, high = (round_to(end, shown.sd[j]) for end in intervals[j])
    yield (
        f"95 % interval: where the coefficient lies with 95 % probability, if the terms are right: that of"
        f" {equation.terms[j].text} between {low} and {high}. sd is about a quarter of its width."
    )
    yield from _of_constants(equation)
    if not conditional and (equation.printed_over_models.any() or equation.intercept_over_models):
        yield (
            f"{MARK}: which other terms are in the law is not certain, and the coefficient depends on it; this"
            " interval allows for all of these equations, and is wider for it."
        )


def _of_constants(equation: Equation) -> Iterator[str]:
    for one in equation.shown_constants:
        yield (
            f"{{{one.name}}}: a constant inside {' and '.join(one.terms)}, found with the coefficients, from values of"
            f" {in_digits(one.low, 3)} to {in_digits(one.high, 3)}; its interval and theirs allow for each other. It"
            " has no probability of its own: that of the term is for any value in this range."
        )


def _of_checks(equation: Equation, eq: Answer) -> Iterator[str]:
    if equation.held_out is not None:
        fit = equation.held_out
        several = len(eq.data.files) > 1
        last = f"the last rows of each record, {fit.n} in all," if several else f"the last {fit.n} rows"
        yield (
            f"held-out rows: {last} were not used to find the equation that predicts them here. R2"
            f" {fit.r2:.3f}: it explains {100 * max(fit.r2, 0.0):.3g} % of the variance of {equation.target}; the"
            f" normalised RMS error, {in_digits(100 * fit.nrmse)} %, is the error over the standard deviation. Part of"
            " it is the noise of the channels, which no equation explains."
        )
    scores = eq.scores
    if scores is not None and any(name in scores.free_run for name in equation.chain.states):
        yield (
            "free run: the equation is started once and left to itself, driven by the measured inputs alone. Errors add"
            " up there, so that this is the hardest test; 100 % would be as bad as predicting the mean."
        )
    found = equation.residuals
    if found.correlated:
        yield (
            f"effective sample size: neighbouring residuals are alike (correlation {found.lag1:.2f}), so that the"
            f" {found.n} rows tell as much as {found.n_eff:.0f} independent ones."
        )
    left = left_beside_noise(equation)
    if left is not None:
        yield (
            "discrepancy: what it would take, beside the noise of the channels, for the equation to give exactly this"
            f" motion: {left} of the standard deviation of {equation.target}. It is what the"
            " candidate terms cannot express."
        )
    if found.driver is not None and found.driver.p_value < DOUBTFUL:
        yield (
            f"residuals follow {found.driver}: what is left over is like that channel, and not by chance; a term with"
            " it may be missing, or it is delayed against the others."
        )
    if equation.undetermined and equation.bound is not None:
        yield (
            f"too small to be seen here: {equation.undetermined[0]} and the like do not show in this record, whether"
            " they are in the law or not; at ten times its amplitude they could matter. The coefficient's magnitude is"
            " below the bound, with 95 % probability; a stronger excitation would tell."
        )
    if equation.runners_up:
        best = equation.runners_up[0]
        yield (
            "runners-up: the next equations, and their odds. 1:20 means that the printed one is twenty times as"
            f" probable, given this record. The first of them is the equation {best}, at {best.odds}."
        )


def _of_data(eq: Answer) -> Iterator[str]:
    if eq.data.estimated:
        yield (
            f"estimated: {', '.join(eq.data.estimated)} was not measured but computed from the other channels, with the"
            " noise smoothed away."
        )
    if eq.roles.discrete:
        yield "x[+1] is the next sample, x[-1] the one before: equations go from sample to sample, whatever the time."
    elif eq.data.rows_as_time:
        yield "time not known: rates and derivatives are per row, not per second, until the sampling rate is given."
    if eq.refined is not None:
        yield (
            "refined by output error: the coefficients are those whose free runs come closest to the measured channels;"
            " which terms there are was decided before."
        )
    if eq.constraints:
        yield f"constraints: {'; '.join(eq.constraints)} was given, and holds in the equation whatever the record says."
    if eq.warnings:
        yield f"warnings: {len(eq.warnings)}, on standard error or above, say what to be careful about and what to do."
