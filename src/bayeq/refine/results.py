"""What equations keep of having been refined: `Refinement`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

__all__ = ["Refinement"]


@dataclass(frozen=True, slots=True)
class Refinement:
    """How equations were refined.

    Attributes
    ----------
    files : tuple of str
        Names of the records.
    n : int
        Rows used.
    segments, longest : int
        Free runs, and the rows of the longest.
    noise_sd : mapping of str to float
        For each measured channel the standard deviation of what the runs leave: its noise.
    interpolation : "cubic", "linear", "hold" or "band-limited"
        Of the inputs between their samples.
    converged : bool
        Whether the fit ended by itself.
    at_bound : tuple of str
        Coefficients, ``"a: v"``, for which the runs were closest at 0, the end of their known sign.
    """

    files: tuple[str, ...]
    n: int
    segments: int
    longest: int
    noise_sd: Mapping[str, float]
    interpolation: Literal["cubic", "linear", "hold", "band-limited"]
    converged: bool
    at_bound: tuple[str, ...] = ()

    def __str__(self) -> str:
        """In a line."""
        runs = "one run" if self.segments == 1 else f"{self.segments} runs"
        noise = ", ".join(f"{name} {sd:.3g}" for name, sd in self.noise_sd.items())
        bound = f"; closest with 0, the end of the known sign, for {', '.join(self.at_bound)}" if self.at_bound else ""
        return f"coefficients refined by output error: {runs} of up to {self.longest} rows, noise sd {noise}{bound}"
