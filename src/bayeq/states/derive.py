"""States from measured channels without a smoother (smooth='none', or too few rows for one), and checks of channels.

Here measured channels are used as they are. A derivative that is not measured is computed from the highest measured one
below it by central differences.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Literal, cast, get_args

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import ChainError, InputError, RecordError
from bayeq.numerics.settings import STATES
from bayeq.records import Record
from bayeq.states.roles import Chain

Smooth = Literal["auto", "band", "none"]

# Least number of rows for central differences.
LEAST_ROWS_TO_DIFFERENTIATE = 5

# Channels with samples beyond LARGEST, or that vary by less than its inverse, are refused, since squares of their cubes
# leave the floating-point range; so are time steps [s] beyond LONGEST_STEP or its inverse.
LARGEST = 1e50
LONGEST_STEP = 1e20


def derive_states(record: Record, chains: Sequence[Chain], inputs: Sequence[str] = ()) -> dict[str, Floats]:
    """States, targets and inputs of a record by name, each (n,).

    Raises an UnknownNameError for a channel that is missing; a ChainError for one that is named like a derivative; a
    RecordError for samples that are not finite, no time where derivatives are needed, or too few rows.
    """
    wanted = [*(m for chain in chains for m in chain.measured if m is not None), *inputs]
    require_usable(record, wanted)
    columns = {name: record[name] for name in wanted}
    for chain in chains:
        for order, name in enumerate(chain.names):
            if chain.measured[order] is not None:
                continue
            if name in columns or (name in record.channels and chain.own_name(order) is None):
                raise ChainError(
                    f"chain {str(chain)!r} leaves {name!r} to be estimated, but the record has a channel of that"
                    " name: name it in the chain, or rename it"
                )
            below = max(k for k in range(order) if chain.measured[k] is not None)
            columns[name] = _derivative(record, chain.names[below], name, order - below)
    return columns


def current(smooth: str) -> Smooth:
    """The present name of a smoothing mode ("auto" for "band"); an InputError refuses other texts."""
    if smooth not in get_args(Smooth):
        raise InputError(f"smooth must be one of {', '.join(get_args(Smooth))}, got {smooth!r}")
    if smooth != "band":
        return cast(Smooth, smooth)
    warnings.warn("smooth='band' is now smooth='auto', which fits the likelihood", DeprecationWarning, stacklevel=4)
    return "auto"


def known(values: Floats) -> Floats:
    """Samples that are not missing."""
    return values[~np.isnan(values)]


def usable(values: Floats) -> bool:
    """Whether samples are finite, vary, and have squares in floating point."""
    if not len(values) or not np.isfinite(values).all() or np.abs(values).max() > LARGEST:
        return False
    return bool(values.max() - values.min() >= 1 / LARGEST)


def require_samples(records: Sequence[Record], names: Sequence[str], advice: str) -> None:
    """Raise a RecordError, with advice, for a channel of which a record has no sample."""
    for record in records:
        for name in names:
            if np.isnan(record[name]).all():
                raise RecordError(f"{record.label}: channel {name!r} has no samples: every one is missing; {advice}")


def require_varying(records: Sequence[Record], names: Sequence[str]) -> None:
    """Raise unless each channel varies, though not in every record: in a free decay the force is zero throughout.

    Missing samples, NaN, are passed over. A RecordError names a channel that is the same in all rows of all records,
    varies by too little to have a square, or lies too far from zero; an UnknownNameError one that a record lacks.
    """
    where = records[0].label if len(records) == 1 else f"{len(records)} records"
    rows = sum(record.n for record in records)
    for name in names:
        samples = [values for record in records if len(values := known(record[name]))]
        if not samples:
            raise RecordError(f"{where}: channel {name!r} has no samples: every one is missing; leave the channel out")
        low = float(np.min([values.min() for values in samples]))
        high = float(np.max([values.max() for values in samples]))
        if rows > 1 and low == high:
            raise RecordError(
                f"{where}: channel {name!r} is constant ({low:g} in all {rows} rows): nothing can be learned from it;"
                " leave it out"
            )
        if rows > 1 and high - low < 1 / LARGEST:
            raise RecordError(
                f"{where}: channel {name!r} varies by {high - low:g} only, too little to square and cube; give the"
                " channel in a smaller unit"
            )
        far = max(abs(low), abs(high))
        if rows > 1 and far > STATES.farthest * (high - low):
            raise RecordError(
                f"{where}: channel {name!r} lies {far / (high - low):.0e} times its range from zero, which leaves too"
                f" few digits for its variation; subtract the offset (bayeq.remove_offset(record, {name!r}),"
                f" --remove-offset {name})"
            )


def require_steps(records: Sequence[Record]) -> None:
    """Raise a RecordError if powers of the time steps would leave the floating-point range."""
    for record in records:
        step = record.dt
        if step is not None and not 1 / LONGEST_STEP <= step <= LONGEST_STEP:
            raise RecordError(
                f"{record.label}: steps of time are about {step:g} s, out of range; check the time column or"
                " fs, or give time in another unit"
            )


def require_in_range(columns: Mapping[str, Floats], where: str) -> None:
    """Raise unless states that were estimated are neither too large nor too small to square."""
    for name, values in columns.items():
        size = float(np.abs(values).max(initial=0.0))
        if not (size <= LARGEST and (size == 0.0 or size >= 1 / LARGEST)):
            raise RecordError(
                f"{where or 'record'}: {name!r} is about {size:g}, out of range; give its channel or time in another"
                " unit"
            )


def require_usable(record: Record, names: Sequence[str]) -> None:
    """Raise unless a record has the channels, and their samples are finite and have squares."""
    for name, values in {name: record[name] for name in names}.items():
        if values.min() >= -LARGEST and values.max() <= LARGEST:  # false for NaN
            continue
        record.require_finite(name)
        row = int(np.argmax(np.abs(values)))
        if abs(values[row]) > LARGEST:
            raise RecordError(
                f"{record.label}: channel {name!r} is {values[row]:g} in row {row + 1}, too large to square"
                " and cube; correct it, or give the channel in a larger unit"
            )


def _derivative(record: Record, source: str, name: str, order: int) -> Floats:
    """The `order`-th derivative, `name`, of a measured channel."""
    where = record.label
    if record.time is None:
        raise RecordError(f"{where}: {name!r} has to be estimated from {source!r}, which needs a time column or fs")
    if record.n < LEAST_ROWS_TO_DIFFERENTIATE:
        raise RecordError(
            f"{where}: {record.n} rows are too few to estimate {name!r} (at least {LEAST_ROWS_TO_DIFFERENTIATE})"
        )
    with np.errstate(all="ignore"):
        values = record[source]
        for _ in range(order):
            values = np.gradient(values, record.time)
    if not (np.abs(values) <= LARGEST).all():
        raise RecordError(
            f"{where}: {name!r}, estimated from {source!r}, is out of range: steps of time are about {record.dt:g} s;"
            " check the time column or fs"
        )
    return values
