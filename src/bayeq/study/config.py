"""Configuration of a Monte Carlo study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from bayeq.errors import InputError, UnknownNameError, whole_number

# The paper's order, which is also the number of a system in the seed of its realisations: append, never reorder.
STUDY_SYSTEMS = ("linear", "duffing", "quadratic", "coulomb")

# The paper's four algorithms, and its SS-VB started from the RVM as in its section 3.2.
DEFAULT_ALGORITHMS = ("sindy", "rvm", "gibbs", "vb", "vb-rvm")


@dataclass(frozen=True, slots=True)
class StudyConfig:
    """Configuration of a study: equal configurations give the same result for a realisation, system and algorithm."""

    seed: int = 0  # a realisation is drawn from (seed, system, index)
    smooth: str = "none"  # the paper's raw noisy channels; or "auto", see `bayeq.discover`
    noise: float = 0.05  # on every channel, relative to the clean signal's standard deviation
    perturb: float = 0.1  # relative standard deviation of the parameters
    # training rows at the start of a record, and test rows at its end
    train_rows: int = 2000
    test_rows: int = 2000
    dictionary: str = "oscillator"  # eq. (31); see `bayeq.dictionary.build_dictionary`
    # the prior, see `bayeq.Prior`; on standardised columns, with the target in its own units
    slab_variance: float = 10.0
    prior_inclusion: float = 0.1
    noise_shape: float = 1e-4
    noise_rate: float = 1e-4
    # settings of the Gibbs sampler
    chains: int = 4
    samples: int = 5000
    burn_in: int = 1000
    protocol: int = 1  # raised whenever the code would give other results for the same numbers

    def validate(self) -> None:
        """Raise an InputError for a number out of range, which would otherwise fail in every realisation."""
        least = {"seed": 0, "train_rows": 3, "test_rows": 1, "chains": 1, "samples": 2, "burn_in": 0}
        for name, lowest in least.items():
            whole_number(name, getattr(self, name), lowest)
        if self.burn_in >= self.samples:
            raise InputError(f"burn_in ({self.burn_in}) must be less than samples ({self.samples})")
        for name in ("noise", "perturb"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"{name} must be a finite number, not negative, got {value!r}")
        if self.smooth not in ("auto", "none"):
            raise InputError(f"smooth must be auto or none, got {self.smooth!r}")

    def differences(self, other: Mapping[str, Any]) -> list[str]:
        """How a stored configuration differs from this one, a text per key."""
        mine, missing = asdict(self), "absent"
        return [
            f"{key} is {other.get(key, missing)!r} there and {mine.get(key, missing)!r} here"
            for key in {**mine, **other}
            if other.get(key, missing) != mine.get(key, missing)
        ]


def choose(kind: str, names: Iterable[str] | None, known: Iterable[str]) -> tuple[str, ...]:
    """The names (None: all), checked, each once, in the order of `known`; InputError without any, or for one not known.

    >>> choose("system", ["duffing", "linear", "duffing"], STUDY_SYSTEMS)
    ('linear', 'duffing')
    """
    order = tuple(known)
    wanted = order if names is None else tuple(names)
    for name in wanted:
        if name not in order:
            raise UnknownNameError(f"{kind} of the study", name, order)
    if not wanted:
        raise InputError(f"no {kind} given; there are: {', '.join(order)}")
    return tuple(name for name in order if name in wanted)
