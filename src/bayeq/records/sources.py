"""``as_records``: what `bayeq.discover` takes for records: paths, data frames, arrays, and objects that hold them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayeq.errors import InputError
from bayeq.records.assemble import assemble
from bayeq.records.columns import Columns, Headers
from bayeq.records.io import read
from bayeq.records.record import Record

__all__ = ["as_record", "as_records"]


def as_records(source: Any, t: Any = None) -> list[Record]:
    """One record or several, from whatever holds them.

    Parameters
    ----------
    source : object
        What `as_record` takes, or a sequence of such.
    t : str or array_like, optional
        The column that is time, or sampling times [s]; see `as_record`. A sequence of sources takes one for all.

    Raises
    ------
    InputError
        No record, or something that cannot be one.
    """
    if isinstance(source, Sequence) and not isinstance(source, (str, bytes)) and not _is_data(source):
        records = [as_record(one, t) for one in source]
    else:
        records = [as_record(source, t)]
    if not records:
        raise InputError("no Record is given")
    return records


def as_record(source: Any, t: Any = None) -> Record:
    """A record from a path, a data frame, a mapping of arrays, or an object with `u`, `y` and `sampling_time`.

    Parameters
    ----------
    source : Record, path, DataFrame, mapping of str to array_like, or object
        Headers of data frames and mappings are read as those of files: ``"x [mm]"`` is the channel x in mm. Of an
        object with attributes `u` and `y` (several inputs or outputs as columns) the channels are u and y, or u1, u2
        and so on; `sampling_time` [s] is its time step.
    t : str or array_like, optional
        The column that is time, or sampling times [s] of shape (n,) for arrays.

    Returns
    -------
    Record

    Raises
    ------
    InputError
        Anything else; a `t` that does not go with it.

    Examples
    --------
    >>> as_record({"t": [0.0, 0.5, 1.0], "x [mm]": [1.0, 2.0, 4.0]})
    Record(3 rows at 2 Hz; x [mm])
    >>> as_record({"x": [1.0, 2.0, 4.0]}, t=[0.0, 0.1, 0.2])
    Record(3 rows at 10 Hz; x)
    """
    column = t if isinstance(t, str) else None
    if isinstance(source, Record):
        if t is not None:
            raise InputError("t is for arrays and files; a Record has its own time")
        return source
    if t is not None and column is None and (isinstance(source, (str, os.PathLike)) or _is_data_frame(source)):
        raise InputError("t names the column that is time, of a file or a data frame")
    if isinstance(source, (str, os.PathLike)):
        return read(source, time=column)
    if _is_data_frame(source):
        return Record.from_dataframe(source, time=column)
    if isinstance(source, Mapping):
        return _from_mapping(source, t)
    if _is_data(source):
        return _from_data(source, t)
    raise InputError(
        f"no record can be made of {type(source).__name__}: give a Record, the path of a file, a data frame, a mapping"
        " of arrays, or a list of these"
    )


def _is_data_frame(source: Any) -> bool:
    return hasattr(source, "iloc") and hasattr(source, "columns")


def _is_data(source: Any) -> bool:
    """Whether an object holds inputs and outputs, as the nonlinear benchmarks' ``Input_output_data`` does."""
    return all(hasattr(source, name) for name in ("u", "y", "sampling_time"))


def _from_mapping(source: Mapping[Any, Any], t: Any) -> Record:
    keys = list(source)
    if not all(isinstance(key, str) for key in keys):
        raise InputError("a mapping of arrays needs text as keys, the names of the channels")
    headers = Headers.parse(keys, "arrays")
    data = Columns.build(headers, lambda i: np.asarray(source[keys[i]]))
    if t is None or isinstance(t, str):
        return Record(*assemble(data, time=t, name="")[0])
    units = {name: unit for name, unit in zip(data.names, data.headers.units, strict=True) if unit}
    return Record(dict(zip(data.names, data.values, strict=True)), np.asarray(t), units)


def _from_data(source: Any, t: Any) -> Record:
    if isinstance(t, str):
        raise InputError("t of an object with u and y is an array of sampling times")
    channels: dict[str, Any] = {}
    for name in ("u", "y"):
        values = getattr(source, name)
        if values is None:
            continue
        array = np.asarray(values)
        columns = array.T if array.ndim == 2 else [array]
        for k, column in enumerate(columns, 1):
            channels[name if len(columns) == 1 else f"{name}{k}"] = column
    step = source.sampling_time
    if t is None and step is not None and not (isinstance(step, (int, float, np.number)) and 0 < step < np.inf):
        raise InputError(f"sampling_time is the time step [s], a positive number, not {step!r}")
    fs = None if t is not None or step is None else 1.0 / float(step)
    return Record.from_arrays(channels, time=t, fs=fs, name=str(getattr(source, "name", None) or ""))
