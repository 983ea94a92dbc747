"""What a plan says: designs compared, the best first."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayeq.plan.outcome import Compared, Outcome, Separation

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Plan"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """Designs compared by simulation, the one that tells most per second first.

    Attributes
    ----------
    purpose : "models" or "coefficients"
        What the next measurement is to tell.
    leading : tuple of Compared
        The likeliest model of each equation.
    rivals : tuple of Compared
        The models that these are to be told from.
    decided : Compared or None
        The likeliest rival where none is within the odds, so that the coefficients are planned for.
    outcomes : tuple of Outcome
    time : (n,) array
        Of the best excitation [s].
    inputs : mapping of str to (n,) array
        The best excitation, its first realisation.
    offsets : mapping of str to float
        Middle of each input.
    odds : float
        That are wanted.
    conditions : mapping
        Band, seconds, fs, noise, limits, realisations, seed.
    units : mapping of str to str
        Of channels, as far as they are known.
    ranges : mapping of str to float
        Largest magnitude of the channels of the record.
    """

    purpose: Literal["models", "coefficients"]
    leading: tuple[Compared, ...]
    rivals: tuple[Compared, ...]
    decided: Compared | None
    outcomes: tuple[Outcome, ...]
    time: Floats = field(repr=False)
    inputs: Mapping[str, Floats] = field(repr=False)
    offsets: Mapping[str, float]
    odds: float
    conditions: Mapping[str, Any]
    units: Mapping[str, str]
    ranges: Mapping[str, float]

    @property
    def best(self) -> Outcome:
        """The design that tells most per second."""
        return self.outcomes[0]

    def closest(self, outcome: Outcome) -> Compared | None:
        """The rival that a design tells least of; None where coefficients are planned for.

        Parameters
        ----------
        outcome : Outcome
            Of one design.

        Returns
        -------
        Compared or None
            What the design is expected to tell about that rival.
        """
        return self.rivals[outcome.separations[0].rival] if outcome.separations else None

    @cached_property
    def text(self) -> str:
        """The advice, and a table of the designs."""
        from bayeq.plan.text import render

        return render(self)

    def __str__(self) -> str:
        return self.text

    def table(self) -> pd.DataFrame:
        """All designs, the best first: ``kind``, ``low`` and ``high`` of the band [Hz], ``amplitude`` (a column per
        input where there are several), ``rate`` and ``sd`` [nats/s], ``seconds``, ``closest`` rival, ``limited``."""
        import pandas as pd

        rows = []
        for one in self.outcomes:
            closest = self.closest(one)
            alone = len(one.amplitudes) == 1
            rows.append(
                {
                    "kind": one.design.kind,
                    "low": one.design.band[0],
                    "high": one.design.band[1],
                    **{"amplitude" if alone else f"amplitude_{name}": size for name, size in one.amplitudes.items()},
                    "rate": one.rate,
                    "sd": one.sd,
                    "seconds": one.seconds,
                    "closest": "" if closest is None else closest.name,
                    "limited": one.limited,
                }
            )
        return pd.DataFrame(rows)

    def to_dict(self) -> dict[str, Any]:
        """The plan as plain data; an infinite time is null."""
        from bayeq.plan.text import advice

        def finite(value: float | None) -> float | None:
            return value if value is not None and math.isfinite(value) else None

        def pair(one: Separation) -> dict[str, Any]:
            rival = self.rivals[one.rival]
            return {
                **asdict(one),
                "target": rival.target,
                "rival": rival.name,
                "seconds": finite(one.seconds),
                "by_size": finite(one.by_size),
            }

        return {
            "advice": advice(self),
            "purpose": self.purpose,
            "odds": self.odds,
            "conditions": dict(self.conditions),
            "leading": [asdict(model) for model in self.leading],
            "rivals": [asdict(model) for model in self.rivals],
            "designs": [
                {
                    "kind": one.design.kind,
                    "band": list(one.design.band),
                    "amplitude": dict(one.amplitudes),
                    "offset": dict(self.offsets),
                    "limited": one.limited,
                    "rate": one.rate,
                    "sd": one.sd,
                    "seconds": finite(one.seconds),
                    "peaks": dict(one.peaks),
                    "rivals": [pair(separation) for separation in one.separations],
                }
                for one in self.outcomes
            ],
        }

    def to_json(self) -> str:
        """`to_dict` as a JSON object."""
        return json.dumps(self.to_dict(), allow_nan=False)

    def plot(self) -> Figure:
        """Information by second of the designs, beside the spectrum and the first part of the best excitation."""
        from bayeq.plan.figure import draw_plan

        return draw_plan(self)

    def write(self, file: str | Path) -> None:
        """Write the best excitation as CSV: ``time`` [s] and the inputs.

        Parameters
        ----------
        file : str or Path
            The file; it is replaced if it exists.
        """
        import pandas as pd

        from bayeq.records.files import replacing

        with replacing(Path(file)) as part:
            pd.DataFrame({"time": self.time, **self.inputs}).to_csv(part, index=False)
