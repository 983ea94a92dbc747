"""What `discover` warns of beside the answer: channels, terms and rows that tell less than they seem to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

import numpy as np

from bayeq.equation.equation import Equation
from bayeq.errors import AmbiguityWarning, DataWarning, TermWarning, WarningLog, some_of
from bayeq.records import Record
from bayeq.regression.design import Design
from bayeq.states import Motion, force_of_blows


def warn_of_other_terms(equations: Sequence[Equation], scored: Sequence[Equation], log: WarningLog) -> None:
    """Say where an equation of all rows has other terms than the one that fits and verdict on the last rows are of."""
    for equation, former in zip(equations, scored, strict=True):
        if set(equation.shown) != set(former.shown):
            log.warn(
                f"{equation.target}: the first rows alone give other terms than all of them"
                f" ({some_of(former.shown or ('none',), 40)}): measure longer",
                AmbiguityWarning,
            )


def warn_of_sensors(motion: Motion, given: Set[str], log: WarningLog) -> None:
    """Say which of what was given of channels makes no difference."""
    roles, sensors = motion.roles, motion.sensors
    computed = [name for name in given if name not in {*roles.measured, *roles.inputs}]
    if computed:
        log.warn(
            f"what was given of {some_of(sorted(computed), 30)} is not used: give that of the channel it was computed"
            " from",
            DataWarning,
        )
    unused = [name for name in roles.measured if sensors.noisy(name)]
    if unused and not motion.smoothed:
        log.warn(
            f"the noise given of {some_of(unused, 30)} is not used: rows are taken as measured here; use smooth='auto'",
            DataWarning,
        )


def warn_of_blows(
    records: Sequence[Record], inputs: Sequence[str], known: Mapping[str, float], log: WarningLog
) -> None:
    """Say what noise would do that a force window hides: between blows there is none to be seen."""
    for name in inputs:
        blows = None if name in known else force_of_blows(name, records)
        if blows is not None:
            change = float(np.abs(blows).max() / np.sqrt(blows @ blows))
            log.warn(
                f"{name} is exactly 0 between blows, its noise is not seen: 1 % of the peak would be {change:.1g} % of"
                f" its coefficient: give --noise {name}=SD",
                DataWarning,
            )


def warn_of_zero(design: Design, records: Sequence[Record], log: WarningLog) -> None:
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
                f"{name} is nowhere zero, it lies between {low:.4g} and {high:.4g}: measure it from the position of"
                f" rest (--remove-offset {name})",
                DataWarning,
            )


def warn_of_terms(design: Design, log: WarningLog) -> None:
    n, terms = design.train[0].n, len(design.terms)
    if n <= terms:
        log.warn(
            f"{n} training rows for {terms} candidate terms: fewer rows than terms; measure more, or give fewer terms",
            DataWarning,
        )
    if design.dropped:
        listed = some_of([f"{one.name} ({one.reason})" for one in design.dropped], 60, "; ")
        log.warn(f"terms left out: {listed}: other motion, or other units, would tell", TermWarning)
