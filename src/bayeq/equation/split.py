"""Equations of one record scored by a free run over another, as official splits of data ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayeq.equation.equations import Equations
from bayeq.errors import InputError
from bayeq.records import Record

# Rows from which an initial state can be estimated.
LEAST_ROWS = 10


@dataclass(frozen=True, slots=True)
class TestError:
    """The error of a free run over a record that the equations have not seen.

    Attributes
    ----------
    record : str
        Name of the record.
    channel : str
        The state that was measured.
    skip, rows : int
        Rows at the beginning that the initial state is estimated from; those after them, which are scored.
    rmse : float
        Root mean squared error in the unit of the channel; infinite of a run that blew up.
    nrmse : float
        The same over the standard deviation of the channel in these rows.
    unit : str or None
        Of the channel.
    """

    __test__ = False  # for pytest: this is no class of tests

    record: str
    channel: str
    skip: int
    rows: int
    rmse: float
    nrmse: float
    unit: str | None

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit not in (None, "1") else ""
        share = f"{100 * self.nrmse:.3g} % of its standard deviation"
        return (
            f"{self.record}: free run over {self.rows} rows, {self.channel} from row {self.skip} on:"
            f" RMSE {self.rmse:.4g}{unit} ({share})"
        )


def test_errors(equations: Equations, records: Sequence[Record], skip: int) -> list[TestError]:
    """Errors of free runs over records, one for each measured state.

    Each run is driven by the inputs of the record alone. It begins at the first row, in the state with which it follows
    the first `skip` rows best; the states of later rows are not looked at.

    Parameters
    ----------
    equations : Equations
        Found in other records.
    records : sequence of Record
        With time, inputs and states.
    skip : int
        Rows that are not scored, at least 10.

    Raises
    ------
    InputError
        Fewer rows than that before or after, or a channel is missing.
    """
    out: list[TestError] = []
    for number, record in enumerate(records):
        name = record.name or f"record {number + 1}"
        if not LEAST_ROWS <= skip <= record.n - 2:
            raise InputError(
                f"{name}: the initial state is estimated from the rows that are skipped: skip at least {LEAST_ROWS} of"
                f" its {record.n} rows, and leave some; got {skip}"
            )
        begin = equations.simulate(record.slice(0, skip), draws=0)
        start = {state: float(values[0]) for state, values in begin.mean.items()}
        inputs = {channel: record[channel] for channel in equations.inputs}
        units = {channel: unit for channel, unit in record.units.items() if channel in inputs}
        driven = Record.from_arrays(inputs or {"t_": np.zeros(record.n)}, time=record.time, units=units, name=name)
        run = equations.simulate(driven, initial=start, draws=0)
        out += [_error(name, state, skip, record, run.mean) for state in start if state in record.channels]
    return out


def _error(name: str, state: str, skip: int, record: Record, run: Mapping[str, np.ndarray]) -> TestError:
    measured, found = np.asarray(record[state])[skip:], np.asarray(run[state])
    there = np.isfinite(measured)
    rmse = math.inf
    if len(found) == record.n and np.isfinite(found).all():
        rmse = float(np.sqrt(np.mean((found[skip:] - measured)[there] ** 2)))
    sd = float(np.std(measured[there]))
    nrmse = rmse / sd if sd > 0.0 else math.inf
    return TestError(name, state, skip, int(there.sum()), rmse, nrmse, record.units.get(state))
