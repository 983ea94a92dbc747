"""What equations give along records that have been prepared (`bayeq.equation.prepare`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.equation.answer import Answer
from bayeq.equation.prepare import rows_of_record
from bayeq.forecast.run import Forecast, forecast
from bayeq.forecast.score import Scores, score_records
from bayeq.records import Record

if TYPE_CHECKING:
    from bayeq.ode.rk4 import Interpolation

__all__ = ["free_run", "predictions", "scores"]

# Share of the rows that is scored where none were held out.
LAST = 0.2


def predictions(eq: Answer, record: Record, return_std: bool) -> Any:
    """See `Equations.predict`."""
    columns = rows_of_record(record, eq.roles, eq.smooth, eq.data.sensors)
    parts = [equation.predict(columns, return_std) for equation in eq.equations]
    if len(parts) == 1:
        return parts[0]
    if return_std:
        return tuple(np.column_stack(pieces) for pieces in zip(*parts, strict=True))
    return np.column_stack(parts)


def free_run(
    eq: Answer,
    record: Record,
    *,
    initial: Mapping[str, float] | None = None,
    draws: int,
    seed: int,
    start: int = 0,
    rows: int | None = None,
    interpolation: Interpolation | None = None,
) -> Forecast:
    """See `Equations.simulate`."""
    return forecast(
        eq.dynamics(),
        record,
        eq.smooth,
        eq.data.sensors,
        initial=initial,
        draws=draws,
        seed=seed,
        start=start,
        rows=rows,
        interpolation=_between(eq, interpolation),
        units={name: unit for equation in eq.equations for name, unit in equation.units.items()},
    )


def scores(
    eq: Answer,
    records: Sequence[Record],
    *,
    start: int | None = None,
    rows: int | None = None,
    interpolation: Interpolation | None = None,
) -> Scores:
    """See `Equations.score`."""
    return score_records(
        eq.dynamics(),
        records,
        eq.smooth,
        eq.data.sensors,
        start=start,
        rows=rows,
        share=eq.data.holdout or LAST,
        interpolation=_between(eq, interpolation),
    )


def _between(eq: Answer, interpolation: Interpolation | None) -> Interpolation:
    return interpolation or (eq.refined.interpolation if eq.refined else "cubic")
