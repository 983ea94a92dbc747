"""What makes a study the study it is."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from bayeq.errors import InputError, UnknownNameError, whole_number

# The paper's order, which is also the number of a system in the seed of its realisations: append, never reorder.
STUDY_SYSTEMS = ("linear", "duffing", "quadratic", "coulomb")

# The paper's four, and its SS-VB started literally as it says.
DEFAULT_ALGORITHMS = ("sindy", "rvm", "gibbs", "vb", "vb-rvm")


@dataclass(frozen=True, slots=True)
class StudyConfig:
    """The numbers of a study: two studies agree in a realisation if and only if they agree in these.

    Which systems, which algorithms and how many realisations is not part of it: those are added to a store as
    they are asked for.

    Parameters
    ----------
    seed : int
        Seed of the study; a realisation is drawn from (seed, system, index).
    smooth : "auto" or "none"
        See `bayeq.states.derive_states`; "none" is the paper's raw noisy channels.
    noise : float
        Noise on every channel, relative to the clean signal's standard deviation.
    perturb : float
        Relative standard deviation of the parameters (the paper's 0.1).
    train_rows, test_rows : int
        The first and the last rows of a record.
    dictionary : str
        See `bayeq.dictionary.build_dictionary`; "oscillator" is eq. (31).
    slab_variance, prior_inclusion, noise_shape, noise_rate : float
        The prior, see `bayeq.inference.Prior`; on standardised columns, with the target in its own units.
    chains, samples, burn_in : int
        Of the Gibbs sampler.
    protocol : int
        Raised whenever the code would give other results for the same numbers.
    """

    seed: int = 0
    smooth: str = "none"
    noise: float = 0.05
    perturb: float = 0.1
    train_rows: int = 2000
    test_rows: int = 2000
    dictionary: str = "oscillator"
    slab_variance: float = 10.0
    prior_inclusion: float = 0.1
    noise_shape: float = 1e-4
    noise_rate: float = 1e-4
    chains: int = 4
    samples: int = 5000
    burn_in: int = 1000
    protocol: int = 1

    def validate(self) -> None:
        """Raise an InputError for a number that is out of range, which would only fail in every realisation."""
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
        mine = asdict(self)
        keys = [*mine, *(key for key in other if key not in mine)]
        missing = "absent"
        return [
            f"{key} is {other.get(key, missing)!r} there and {mine.get(key, missing)!r} here"
            for key in keys
            if other.get(key, missing) != mine.get(key, missing)
        ]


def choose(kind: str, names: Iterable[str], known: Iterable[str]) -> tuple[str, ...]:
    """The names, checked, each once, in the order of `known`; an InputError without names, or for one not known.

    Examples
    --------
    >>> choose("system", ["duffing", "linear", "duffing"], STUDY_SYSTEMS)
    ('linear', 'duffing')
    """
    order = tuple(known)
    wanted = set()
    for name in names:
        if name not in order:
            raise UnknownNameError(f"{kind} of the study", name, order)
        wanted.add(name)
    if not wanted:
        raise InputError(f"no {kind} given; there are: {', '.join(order)}")
    return tuple(name for name in order if name in wanted)
