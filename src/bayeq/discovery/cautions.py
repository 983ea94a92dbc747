"""Warnings of `discover` about channels, terms, sums of states and rows that carry less information than expected."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayeq.dictionary.families import degree
from bayeq.equation.equation import Equation
from bayeq.equation.verdict import Verdict
from bayeq.errors import AmbiguityWarning, DataWarning, TermWarning, WarningLog, in_digits, some_of
from bayeq.expressions import Binary
from bayeq.records import Record, counts_rows
from bayeq.records.names import is_time_name
from bayeq.records.validate import other_step
from bayeq.regression.design import Design
from bayeq.states import Motion, Roles, force_of_blows


def with_other_terms(equations: Sequence[Equation], refused: bool, log: WarningLog) -> tuple[Equation, ...]:
    """Equations from all rows; those that have other terms than the scored ones, of the first rows, are not "found" if
    these rows `refused` them: evidence for a term grows with the rows, and four fifths do not turn it away."""
    out = []
    for equation in equations:
        former = equation.scored
        if former is not None and set(equation.shown) != set(former.shown):
            said = "the first rows alone give other terms than all of them"
            said += f" ({some_of(former.shown or ('none',), 20)})"
            if refused and equation.verdict.kind == "found":
                equation = replace(equation, verdict=Verdict("not determined", said, "measure longer"))
            else:
                log.warn(f"{equation.target}: {said}: measure longer", AmbiguityWarning)
        out.append(equation)
    return tuple(out)


def warn_of_sensors(motion: Motion, given: Set[str], log: WarningLog) -> None:
    """Warn if the noise, gain or lag given for a channel has no effect."""
    roles, sensors = motion.roles, motion.sensors
    computed = [name for name in given if name not in roles.channels]
    if computed:
        log.warn(
            f"noise, gain or lag given of {some_of(sorted(computed), 30)} is not used: give those of the channel it was"
            " computed from",
            DataWarning,
        )
    unused = [name for name in roles.measured if sensors.noise.get(name, 0.0) > 0.0 or name in sensors.of_reading]
    if unused and not motion.smoothed:
        log.warn(
            f"the noise given of {some_of(unused, 30)} is not used: rows are taken as measured; use smooth='auto'",
            DataWarning,
        )


def warn_of_blows(
    records: Sequence[Record], inputs: Sequence[str], known: Mapping[str, float], log: WarningLog
) -> None:
    """Warn that a force window hides the noise of a hammer force, with the change that noise of 1 % would make."""
    for name in inputs:
        blows = None if name in known else force_of_blows(name, records)
        if blows is not None:
            change = float(np.abs(blows).max() / np.sqrt(blows @ blows))
            log.warn(
                f"{name} is exactly 0 between blows, its noise is not seen: give --noise {name}=SD (1 % of"
                f" peak: {change:.1g} % off)",
                DataWarning,
            )


def warn_of_rates(records: Sequence[Record], roles: Roles, log: WarningLog) -> None:
    """Warn if the given sampling rate contradicts an unused column whose name means time."""
    for record in records:
        fs = None if counts_rows(record) else record.fs
        for name in record.names:
            if fs is None or not is_time_name(name) or name in roles.channels:
                continue
            step = other_step(record[name], record.units.get(name, "s"), fs)
            if step is not None and (np.diff(record[name]) > 0.0).all():
                log.warn(f"{name} rises by {step:.4g} s a row, and fs = {fs:g} was given: check fs", DataWarning)
                return


# From record to record the motion of a system per input, in resonance and out of it, differs by less than UNLIKE; where
# units differ, either of the two differs by less than ALIKE.
UNLIKE, ALIKE = 100.0, 10.0


def warn_of_units(records: Sequence[Record], roles: Roles, log: WarningLog) -> None:
    """Warn if units seem to differ between records: motion per input differs much, motion or input alone hardly."""
    for chain, driver in itertools.product(roles.chains, roles.inputs):
        name = next(filter(None, chain.measured), driver)
        spreads = np.array([[np.nanstd(record[name]), np.nanstd(record[driver])] for record in records])
        logs = np.log(spreads[(spreads > 0.0).all(axis=1)])
        if len(logs) < 2:
            continue
        motion, force = logs[np.argmax(logs[:, 0] - logs[:, 1])] - logs[np.argmin(logs[:, 0] - logs[:, 1])]
        if motion - force > math.log(UNLIKE) and min(abs(motion), abs(force)) < math.log(ALIKE):
            ratio = in_digits(math.exp(motion - force))
            log.warn(f"{name} per {driver} differs {ratio} times between records: give their units", DataWarning)
            return


def warn_of_zero(design: Design, records: Sequence[Record], log: WarningLog) -> None:
    """Warn about a displacement that is never zero, if powers of it, which depend on its origin, are candidates."""
    for chain in design.motion.roles.chains:
        name = chain.measured[0]
        if chain.order < 2 or name is None:
            continue
        samples = np.concatenate([record[name] for record in records])
        low, high = float(np.nanmin(samples)), float(np.nanmax(samples))
        powers = [term for term in design.terms if term.text.startswith(f"{name}**")]
        if powers and not low <= 0.0 <= high:
            log.warn(
                f"{name} is nowhere zero ({low:.4g} .. {high:.4g}): measure it from rest (--remove-offset {name})",
                DataWarning,
            )


def warn_of_terms(design: Design, log: WarningLog) -> None:
    n, terms = design.train[0].n, len(design.terms)
    sums = [term for term in design.terms if isinstance(term.tree, Binary) and term.tree.op == "+"]
    if len(sums) == terms == 1:
        log.warn(f"{sums[0].text} is one term, with one coefficient: give several with commas, as in x, v", TermWarning)
    if n <= terms:
        log.warn(
            f"{n} training rows for {terms} candidate terms: fewer rows than terms; measure more, or give fewer terms",
            DataWarning,
        )
    if design.dropped:
        listed = some_of([f"{one.name} ({one.reason})" for one in design.dropped], 48, "; ")
        log.warn(f"terms left out: {listed}: measure other motion, or use other units", TermWarning)


# A sum of states changes if its means over PARTS parts of each record differ with a p value (F test) below CHANCE, and
# the standard deviation of these means is above the share MATTERS of the largest state's.
PARTS, CHANCE, MATTERS = 10, 1e-6, 0.05

# Sums of up to MOST_SUMMED states; a constant one has a standard deviation below the share STILL of a state's.
MOST_SUMMED, STILL = 6, 0.3

# Weights of a sum are whole numbers up to MOST_ATOMS, within ROUNDED.
MOST_ATOMS, ROUNDED = 4, 0.1


def change_of(conserve: str, weights: Mapping[int, float], motion: Motion) -> str | None:
    """Message if the record contradicts that a weighted sum (weights by equation number) is constant, else None."""
    found = _change(weights, motion)
    if found is None or found.chance >= CHANCE or found.slow <= MATTERS * found.largest:
        return None
    return f"the record contradicts that {conserve} does not change (sd {found.slow:.3g}): shown without; check units"


def warn_of_sums(design: Design, log: WarningLog) -> None:
    """Warn about a sum of states that is constant: a term and its product with that sum are proportional."""
    chains, states = design.motion.roles.chains, set(design.motion.roles.states)
    products = any(degree(term) > 1 and len(term.names & states) > 1 for term in design.terms)
    if not products or not 2 <= len(chains) <= MOST_SUMMED or any(one.order != 1 or one.hidden for one in chains):
        return
    for weights in _sums(design.motion):
        found = _change(weights, design.motion) if weights else None
        if found is not None and found.chance > CHANCE and found.sd < STILL * found.largest:
            texts = [f"{'' if size == 1 else f'{size:g}*'}{chains[c].names[0]}" for c, size in weights.items()]
            total = " + ".join(texts)
            log.warn(f"give --conserve '{total}', which does not change: products with it tell nothing", TermWarning)
            return


def _sums(motion: Motion) -> Iterator[dict[int, float]]:
    """Sums of states that may be constant, weights by equation number: of two states or more, and as `_balanced`."""
    equations = range(len(motion.roles.chains))
    for count in range(2, len(equations) + 1):
        yield from (dict.fromkeys(some, 1.0) for some in itertools.combinations(equations, count))
    yield _balanced(motion)


def _balanced(motion: Motion) -> dict[int, float]:
    """Small whole numbers by equation, as of a reaction, whose weighted sum of states changes least; else none."""
    names = [chain.states[0] for chain in motion.roles.chains]
    parts = [np.column_stack([rows.samples[name] for name in names]) for rows in motion.train]
    samples = np.concatenate([part - np.nanmean(part, axis=0) for part in parts])
    samples = samples[np.isfinite(samples).all(axis=1)]
    spread = samples.std(axis=0)
    if len(samples) < 3 * PARTS or not (spread > 0.0).all():
        return {}
    least = np.linalg.eigh(np.corrcoef(samples.T))[1][:, 0] / spread
    least = least / least[np.argmax(np.abs(least))]
    for top in range(1, MOST_ATOMS + 1):
        whole = np.round(top * least)
        if whole.min() >= 0.0 and np.abs(top * least - whole).max() < ROUNDED:
            return {c: float(size) for c, size in enumerate(whole) if size > 0.0}
    return {}


class _Change(NamedTuple):
    """How a sum of states changes along the training rows."""

    chance: float  # p value of the differences of its means over parts of the records
    slow: float  # standard deviation of these means
    sd: float  # standard deviation of the sum
    largest: float  # largest standard deviation of a weighted state in it


def _change(weights: Mapping[int, float], motion: Motion) -> _Change | None:
    """Changes of a weighted sum, weights by equation number; None for too few rows or an absent state."""
    from scipy.special import fdtrc

    names = {motion.roles.chains[c].states[0]: weight for c, weight in weights.items()}
    between, within, parts, left, largest = 0.0, 0.0, 0, 0, 0.0
    for rows in motion.train:
        if not names.keys() <= rows.samples.keys():
            return None
        columns = {name: weight * rows.samples[name] for name, weight in names.items()}
        total = sum(columns.values(), np.zeros(rows.n))
        total = total[np.isfinite(total)]
        if len(total) < 3 * PARTS:
            continue
        largest = max(largest, *(float(np.nanstd(column)) for column in columns.values()))
        pieces = np.array_split(total, PARTS)
        means = np.array([piece.mean() for piece in pieces])
        sizes = np.array([len(piece) for piece in pieces])
        between += float(sizes @ (means - total.mean()) ** 2)
        within += float(sum(np.sum((piece - mean) ** 2) for piece, mean in zip(pieces, means, strict=True)))
        parts, left = parts + PARTS - 1, left + len(total) - PARTS
    if not parts:
        return None
    ratio, rows_in_all = (between / parts) / max(within / left, 1e-300), left + parts
    sd = math.sqrt((between + within) / rows_in_all)
    return _Change(float(fdtrc(parts, left, ratio)), math.sqrt(between / rows_in_all), sd, largest)
