"""What makes an answer less than it seems, said before or after it is found."""

from __future__ import annotations

from collections.abc import Sequence, Set

import numpy as np

from bayeq.equation.equation import Equation
from bayeq.errors import AmbiguityWarning, DataWarning, TermWarning, WarningLog
from bayeq.records import Record
from bayeq.regression.design import Design
from bayeq.states import Motion

__all__ = ["warn_of_other_terms", "warn_of_sensors", "warn_of_terms", "warn_of_zero"]


def warn_of_other_terms(equations: Sequence[Equation], scored: Sequence[Equation], log: WarningLog) -> None:
    """Say where an equation of all rows has other terms than the one that fits and verdict on the last rows are of."""
    for equation, former in zip(equations, scored, strict=True):
        if set(equation.shown) != set(former.shown):
            log.warn(
                f"{equation.target}: the terms are those that all rows ask for; without the rows held out, that"
                f" scores are of, they were {', '.join(former.shown) or 'none'}: a longer record would decide",
                AmbiguityWarning,
            )


def warn_of_sensors(motion: Motion, given: Set[str], log: WarningLog) -> None:
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
            " inputs it would be; leave it out, or use smooth='auto' with time and 10 rows or more",
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
                f"{name} is nowhere zero, it lies between {low:.4g} and {high:.4g}: terms such as {powers[0]} can"
                " hardly be told from others there, and coefficients are not those about the position of rest;"
                f" measure it from there (bayeq.remove_offset(record, {name!r}), --remove-offset {name}); physical()"
                " gives the stiffness about the position of rest",
                DataWarning,
            )


def warn_of_terms(design: Design, log: WarningLog) -> None:
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
