"""What excitations share: spectral lines within a band, and samples made of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError

__all__ = ["lines_within", "normalised", "synthesised"]

# A line at the end of a band belongs to it, in spite of rounding.
ROUNDING = 1e-9


def lines_within(n: int, fs: float, band: tuple[float, float], odd: bool = False) -> NDArray[np.intp]:
    """Multiples of fs/n within a band, above 0 and below fs/2; only the odd ones if asked for.

    Raises
    ------
    InputError
        There are none.
    """
    line = np.arange(1, (n + 1) // 2)
    frequency = line * fs / n
    inside = (frequency >= band[0] * (1.0 - ROUNDING)) & (frequency <= band[1] * (1.0 + ROUNDING))
    if odd:
        inside &= line % 2 == 1
    if not inside.any():
        raise InputError(
            f"no spectral line of {n / fs:g} s lies between {band[0]:g} and {band[1]:g} Hz: widen the band, or excite"
            " for longer"
        )
    return np.asarray(line[inside], dtype=np.intp)


def synthesised(n: int, lines: NDArray[np.intp], amplitudes: NDArray[np.complex128]) -> NDArray[np.float64]:
    """One period of a sum of lines with these complex amplitudes, the largest magnitude 1."""
    spectrum = np.zeros(n // 2 + 1, dtype=np.complex128)
    spectrum[lines] = amplitudes
    return normalised(np.fft.irfft(spectrum, n))


def normalised(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Samples with the largest magnitude 1."""
    return samples / np.abs(samples).max()
