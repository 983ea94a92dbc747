"""``Truth``: what is known about a simulated record, for judging an answer against it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from bayeq.arrays import Floats


def frozen_array(values: Any) -> Floats:
    """A read-only float64 array: the one given if it is frozen, else a copy."""
    if (
        isinstance(values, np.ndarray)
        and values.dtype == np.float64
        and values.flags.c_contiguous
        and _is_frozen(values)
    ):
        return values
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array


def _is_frozen(values: Floats) -> bool:
    """Whether an array, and whatever owns its samples, is read-only and no larger; what Arrow owns never changes."""
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

        Returns
        -------
        Truth
            Of these rows.
        """
        clean = {name: values[rows] for name, values in self.clean.items()}
        return Truth(self.system, self.parameters, self.coefficients, clean, self.noise_sd)
