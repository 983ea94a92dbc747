"""``Record``: measured channels of equal length, time and units; ``Truth``: model and clean signals of a simulation."""

from __future__ import annotations

import builtins
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import RecordError, UnknownNameError, require_kind
from bayeq.records import validate
from bayeq.records.columns import Columns, Request, assemble
from bayeq.records.names import conversion, unit_in_name, unit_of_clock

if TYPE_CHECKING:
    import pandas as pd


def frozen_array(values: Any) -> Floats:
    """A read-only float64 array: the one given if it is frozen, else a copy."""
    plain = isinstance(values, np.ndarray) and values.dtype == np.float64 and values.flags.c_contiguous
    if plain and _is_frozen(values):
        return values
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array


def _is_frozen(values: Floats) -> bool:
    """Whether an array and the arrays that own its memory are read-only and of one size; Arrow memory is read-only."""
    owner: Any = values
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable or owner.size != values.size:
            return False
        owner = owner.base
    return owner is None or type(owner).__module__.partition(".")[0] == "pyarrow"


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The law and the clean signals behind a simulated record.

    Parameters
    ----------
    system : str
        Name of the system.
    parameters : mapping of str to float
        The physical parameters that were used.
    coefficients : mapping of str to mapping of str to float
        Target -> term -> coefficient, in original units.
    clean : mapping of str to array_like, shape (n,)
        Channels before noise was added.
    noise_sd : mapping of str to float
        Standard deviation of the noise added to each channel.

    Examples
    --------
    >>> truth = Truth("linear", {"k": 4.0}, {"a": {"x": -4.0}}, {"x": [0.0, 1.0]}, {"x": 0.1})
    >>> truth.coefficients["a"]["x"]
    -4.0
    """

    system: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    coefficients: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    clean: Mapping[str, Floats] = field(default_factory=dict)
    noise_sd: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        frozen: dict[str, Mapping[str, Any]] = {
            "parameters": {k: float(v) for k, v in self.parameters.items()},
            "coefficients": {
                target: MappingProxyType({k: float(v) for k, v in terms.items()})
                for target, terms in self.coefficients.items()
            },
            "clean": {k: frozen_array(v) for k, v in self.clean.items()},
            "noise_sd": {k: float(v) for k, v in self.noise_sd.items()},
        }
        for name, mapping in frozen.items():
            object.__setattr__(self, name, MappingProxyType(mapping))

    def __reduce__(self) -> tuple[Any, ...]:  # a MappingProxyType cannot be pickled
        coefficients = {target: dict(terms) for target, terms in self.coefficients.items()}
        parts = (dict(self.parameters), coefficients, dict(self.clean), dict(self.noise_sd))
        return Truth, (self.system, *parts)

    def take(self, rows: Any) -> Truth:
        """The same truth for some of the rows (anything that indexes an array).

        Parameters
        ----------
        rows : slice, (n,) bool array or array of int
            Which rows.
        """
        return replace(self, clean={name: values[rows] for name, values in self.clean.items()})


# Maximum number of channels that a notebook shows.
SHOWN = 50


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Record:
    """Measured channels of equal length, read-only.

    Samples may be NaN or infinite, for measurements have gaps; `require_finite` refuses them.

    Parameters
    ----------
    channels : mapping of str to array_like, shape (n,)
        Samples; copied. A name is an identifier and no function of the term language.
    time : array_like, shape (n,), optional
        Sampling times [s], strictly increasing. Dates become seconds since the first.
    units : mapping of str to str, optional
        Unit of a channel; the key ``"t"`` is the unit of time where that is not seconds.
    name : str, optional
        File name or label, used in messages.
    truth : Truth, optional
        Equation and clean signals of a simulated record.
    begins : float, optional
        Reading of the clock at time 0 [s], for files with dates: `join` aligns records by it.

    Raises
    ------
    RecordError
        No channels, no rows, unequal lengths, not numbers, not one-dimensional, a name that terms cannot
        use, or time that does not increase strictly.

    Examples
    --------
    >>> rec = Record({"x": [0.0, 1.0, 4.0]}, time=[0.0, 0.5, 1.0], units={"x": "m"}, name="run.csv")
    >>> rec
    Record('run.csv': 3 rows at 2 Hz; x [m])
    >>> rec["x"]
    array([0., 1., 4.])
    """

    channels: Mapping[str, Floats]
    time: Floats | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    name: str = ""
    truth: Truth | None = None
    begins: float | None = None

    def __post_init__(self) -> None:
        require_kind(self.name, str, "the name of a record", "text")
        where = self.label
        require_kind(self.channels, Mapping, f"{where}: channels", "a mapping such as {'x': [...]}")
        if not self.channels:
            raise RecordError(f"{where}: no channels")
        channels = {}
        for name, values in self.channels.items():
            validate.check_name(name, where)
            channels[name] = frozen_array(validate.as_column(values, f"channel {name!r}", where))
        time = None if self.time is None else frozen_array(validate.as_time(self.time, where))
        lengths = {name: len(values) for name, values in channels.items()}
        if time is not None:
            lengths = {"time": len(time), **lengths}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {n}" for name, n in list(lengths.items())[:8])
            raise RecordError(f"{where}: channels of unequal lengths: {listed}")
        n = next(iter(lengths.values()))
        if n == 0:
            raise RecordError(f"{where}: no rows")
        if time is not None:
            validate.check_time(time, where)
        units = validate.checked_units(self.units, channels, time is not None, where)
        for name, values in (self.truth.clean if self.truth else {}).items():
            if values.shape != (n,):
                raise RecordError(f"{where}: the clean channel {name!r} has shape {values.shape}, not ({n},)")
        object.__setattr__(self, "channels", MappingProxyType(channels))
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "units", MappingProxyType(units))

    def __reduce__(self) -> tuple[Any, ...]:  # a MappingProxyType cannot be pickled
        return type(self), (dict(self.channels), self.time, dict(self.units), self.name, self.truth, self.begins)

    @classmethod
    def from_arrays(
        cls,
        mapping: Mapping[str, Any] | None = None,
        /,
        *,
        time: Any = None,
        fs: float | None = None,
        units: Mapping[str, str] | None = None,
        name: str = "",
        **channels: Any,
    ) -> Self:
        """Build a record from arrays, as keywords or as a mapping.

        Parameters
        ----------
        mapping : mapping of str to array_like, optional
            Channels; needed for one that is named like an argument of this function.
        time : array_like, shape (n,), optional
            Sampling times [s].
        fs : float, optional
            Sampling rate [Hz]; time is then ``arange(n) / fs``.
        units : mapping of str to str, optional
            Unit of each channel.
        name : str, optional
            Label used in messages.
        **channels : array_like, shape (n,)
            More channels.

        Examples
        --------
        >>> Record.from_arrays(x=[0.0, 1.0, 2.0], fs=100).time
        array([0.  , 0.01, 0.02])
        """
        require_kind({} if mapping is None else mapping, Mapping, "channels", "a mapping such as {'x': [...]}")
        require_kind(name, str, "the name of a record", "text")
        every = {**(mapping or {}), **channels}
        return cls(every, validate.time_from(every, time, fs, name or "record"), {} if units is None else units, name)

    @classmethod
    def from_dataframe(
        cls,
        df: pd.DataFrame,
        time: str | None = None,
        fs: float | None = None,
        units: Mapping[str, str] | None = None,
        columns: Sequence[str] | str | None = None,
    ) -> Self:
        """Build a record from a data frame, with the rules of `bayeq.records.read`.

        A column (or a named index) called t or time, in any usual language, or else the first rising one whose
        unit is a time, is time unless `time` names another or `fs` is given.

        Parameters
        ----------
        df : pandas.DataFrame
            One channel per column; missing values become NaN. Columns of words are left out, with a warning.
        time : str, optional
            The column that holds time [s].
        fs : float, optional
            Sampling rate [Hz].
        units : mapping of str to str, optional
            Unit of each channel.
        columns : sequence of str, optional
            Keep these channels only.

        Examples
        --------
        >>> import pandas as pd
        >>> Record.from_dataframe(pd.DataFrame({"t": [0.0, 0.1], "x [m]": [1.0, 2.0]}))
        Record('data frame': 2 rows at 10 Hz; x [m])
        """
        request = Request(columns, time=time, fs=fs)
        return cls(**assemble(Columns.from_dataframe(df, request), request, units)[0])

    @property
    def label(self) -> str:
        """The name, in messages; "record" where there is none."""
        return self.name or "record"

    def to_columns(self) -> tuple[dict[str, Floats], dict[str, str]]:
        """Columns as they are written, time first, and units; empty units where only the name of a column has one."""
        columns = dict(self.channels)
        if self.time is not None:
            name = next((name for name in ("t", "time", "Time", "timestamp") if name not in columns), None)
            if name is None:
                raise RecordError(f"{self.label}: no name is left for time; rename the channel 't'")
            columns = {name: self.time, **columns}
        return columns, {name: self.units.get(name, "") for name in columns if name in self.units or unit_in_name(name)}

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(next(iter(self.channels.values())))

    def __len__(self) -> int:
        return self.n

    @property
    def names(self) -> tuple[str, ...]:
        """The channels' names, in order."""
        return tuple(self.channels)

    def __getitem__(self, channel: str) -> Floats:
        try:
            return self.channels[channel]
        except (KeyError, TypeError):
            raise UnknownNameError("channel", str(channel), self.names, self.name) from None

    def __contains__(self, channel: object) -> bool:
        return channel in self.channels

    @property
    def dt(self) -> float | None:
        """Median time step [s], or None without time.

        For even sampling it is the mean step, for rounded times the slope of a fitted line: less affected by rounding.
        """
        if self.time is None or self.n < 2:
            return None
        return validate.even_step(self.time) or validate.usual_step(self.time)

    @property
    def fs(self) -> float | None:
        """Sampling rate ``1/dt`` [Hz], or None without time."""
        dt = self.dt
        return None if dt is None else 1.0 / dt

    @property
    def duration(self) -> float:
        """Duration [s]: number of rows over the rate, or at uneven steps last minus first time; 0 without time."""
        if self.time is None or self.fs is None:
            return 0.0
        return self.n / self.fs if self.is_uniform() else float(self.time[-1] - self.time[0])

    @property
    def clock(self) -> str:
        """Unit of time: "s", or the stated unit if it is not converted to seconds, such as "year"."""
        return "s" if "t" in self.channels else unit_of_clock(self.units.get("t", "s"))

    def is_uniform(self) -> bool:
        """Whether all time steps are the same to a thousandth; False without time."""
        return self.time is not None and (self.n < 2 or validate.even_step(self.time) is not None)

    def slice(self, start: int | None = None, stop: int | None = None, step: int | None = None) -> Record:
        """Rows from `start` up to `stop`, as Python slices.

        Parameters
        ----------
        start, stop, step : int, optional
            Row numbers from 0, as of a slice.

        Examples
        --------
        >>> Record({"x": [1.0, 2.0, 3.0]}).slice(1)["x"]
        array([2., 3.])
        """
        return self.take(builtins.slice(start, stop, step))

    def take(self, rows: Any) -> Record:
        """Some of the rows: a slice, a boolean mask or row numbers that increase.

        Parameters
        ----------
        rows : slice, (n,) bool array or array of int
            Which rows.
        """
        channels = {name: values[rows] for name, values in self.channels.items()}
        time = None if self.time is None else self.time[rows]
        return replace(self, channels=channels, time=time, truth=self.truth and self.truth.take(rows))

    def split_by(self, group: Any) -> list[Record]:
        """Split into trials, one for each run of equal consecutive values.

        Parameters
        ----------
        group : str, array_like of shape (n,), or callable
            A channel (dropped from the trials), labels, or a function of the record that returns labels.

        Examples
        --------
        >>> [trial.name for trial in Record({"x": [1.0, 2.0, 3.0]}, name="a").split_by([0, 0, 1])]
        ['a [trial 0]', 'a [trial 1]']
        """
        kept = self
        if isinstance(group, str):
            labels: Any = self[group]
            channels = {name: values for name, values in self.channels.items() if name != group}
            units = {name: unit for name, unit in self.units.items() if name != group}
            kept = replace(self, channels=channels, units=units)
        else:
            labels = group(self) if callable(group) else group
        starts = validate.trial_starts(labels, self.n, self.label)
        trials = [kept.slice(a, b) for a, b in zip(starts, [*starts[1:], self.n], strict=True)]
        return [r.renamed(f"{self.name} [trial {i}]".strip()) for i, r in enumerate(trials)]

    def renamed(self, name: str) -> Record:
        """The same record under another name.

        Parameters
        ----------
        name : str
            The new name.
        """
        return replace(self, name=name)

    def with_channels(self, mapping: Mapping[str, Any], units: Mapping[str, str] | None = None) -> Record:
        """A record with channels added, or replaced where the name exists.

        A channel that is replaced loses its unit unless `units` gives one.

        Parameters
        ----------
        mapping : mapping of str to (n,) array-like
            Samples by name.
        units : mapping of str to str, optional
            Units by name.
        """
        kept = {name: unit for name, unit in self.units.items() if name not in mapping}
        channels = {**self.channels, **mapping}
        return replace(self, channels=channels, units={**kept, **(units or {})})

    def require_finite(self, names: Sequence[str] | str | None = None) -> None:
        """Raise a RecordError if a channel (of `names`, or any) holds NaN or infinite samples.

        Parameters
        ----------
        names : str or sequence of str, optional
            Channels that are looked at; by default all.

        Raises
        ------
        RecordError
            A channel holds NaN or infinite samples.
        """
        wanted = self.names if names is None else (names,) if isinstance(names, str) else names
        for name in wanted:
            bad = np.flatnonzero(~np.isfinite(self[name]))
            if bad.size:
                raise RecordError(
                    f"{self.label}: channel {name!r} has {bad.size} NaN or infinite sample"
                    f"{'s' * (bad.size > 1)} of {self.n}, first in row {bad[0] + 1}; leave these rows out or "
                    "interpolate them"
                )

    def equals(self, other: object) -> bool:
        """Whether two records hold the same channels in the same order, time and units (NaN equals NaN).

        Parameters
        ----------
        other : Record
            The record that is compared; anything else is not equal.
        """
        if not isinstance(other, Record) or self.names != other.names or self.units != other.units:
            return False
        if self.time is None or other.time is None:
            same_time = self.time is other.time
        else:
            same_time = np.array_equal(self.time, other.time)
        return same_time and all(
            np.array_equal(values, other.channels[name], equal_nan=True) for name, values in self.channels.items()
        )

    def to_dataframe(self) -> pd.DataFrame:
        """A pandas data frame of the channels; the column ``t`` comes first if there is time."""
        import pandas as pd

        return pd.DataFrame(self.to_columns()[0])

    def _repr_html_(self) -> str:
        from bayeq.markup import join, paragraph, table

        listed = list(self.channels.items())[:SHOWN]
        rows = [(name, self.units.get(name, ""), *_numbers(values)) for name, values in listed]
        rest = len(self.channels) - len(listed)
        more = paragraph(f"and {rest} more channels") if rest else ""
        header = ("channel", "unit", "min", "max", "mean", "sd", "missing")
        return join(paragraph(repr(self), strong=True), table(header, rows, left=(0, 1)), more)

    def __repr__(self) -> str:
        shown = [f"{c} [{self.units[c]}]" if c in self.units else c for c in self.names[:8]]
        more = f", ... ({len(self.names)} channels)" if len(self.names) > 8 else ""
        rate = ""
        if self.fs is not None:
            rate = f" at {self.fs:.6g} Hz" if self.is_uniform() else f", median step {self.dt:.6g} s"
        label = f"{self.name!r}: " if self.name else ""
        return f"Record({label}{self.n} row{'s' * (self.n != 1)}{rate}; {', '.join(shown)}{more})"


def _numbers(values: Floats) -> tuple[str, ...]:
    """Minimum, maximum, mean and standard deviation of a channel, and how many samples are missing, as text."""
    known = values[np.isfinite(values)]
    missing = str(len(values) - len(known) or "")
    if not len(known):
        return "", "", "", "", missing
    with np.errstate(over="ignore"):  # squares of huge numbers
        numbers = known.min(), known.max(), known.mean(), known.std()
    return (*(f"{value:.4g}" for value in numbers), missing)


def with_samples(record: Record, samples: Mapping[str, Any]) -> Record:
    """The record with the `samples` of some channels replaced and their units kept; itself if there are none."""
    if not samples:
        return record
    return record.with_channels(samples, {name: record.units[name] for name in samples if name in record.units})


def without_samples(record: Record, masks: Mapping[str, Bools]) -> Record:
    """The record with NaN in place of the samples of some channels in the mask of each, (n,)."""
    return with_samples(record, {name: np.where(mask, np.nan, record[name]) for name, mask in masks.items()})


def in_units(record: Record, wanted: Mapping[str, str]) -> tuple[Record, list[str], list[str]]:
    """The record with channels in the `wanted` units, a note on each conversion, and channels not convertible."""
    stated = {name: record.units[name] for name in wanted if name in record.channels and name in record.units}
    factors = {name: conversion(unit, wanted[name]) for name, unit in stated.items()}
    samples = {name: factor * record[name] for name, factor in factors.items() if factor is not None and factor != 1.0}
    notes = [f"{name} was converted from {stated[name]} to {wanted[name]}" for name in samples]
    if samples:
        record = record.with_channels(samples, {name: wanted[name] for name in samples})
    return record, notes, [name for name, factor in factors.items() if factor is None]


def in_one_unit(records: Sequence[Record], names: Iterable[str]) -> tuple[list[Record], list[str]]:
    """The records with channels `names` in the units of the first record, and a note on each conversion."""
    out, said, first = list(records[:1]), list[str](), records[0].units
    for k, record in enumerate(records[1:], 2):
        record, notes, _ = in_units(record, {name: first[name] for name in names if name in first})
        out.append(record)
        said += [f"{record.name or f'record {k}'}: {note}" for note in notes]
    return out, said


def with_only(record: Record, names: Iterable[str]) -> Record:
    """The record with only these channels and its time, and without its `truth`."""
    channels = {name: record[name] for name in names}
    units = {name: unit for name, unit in record.units.items() if name in channels or name == "t"}
    return replace(record, channels=channels, units=units, truth=None)
