"""Every excitation in the table: amplitude, band, length, seed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayeq.equation.plan.designs import EXCITATIONS
from bayeq.errors import InputError
from tests.draws import draws

pytestmark = pytest.mark.parametrize("kind", EXCITATIONS.values(), ids=list(EXCITATIONS))


@st.composite
def settings_of(draw):
    """n, fs and a band that holds twenty lines or more, anywhere up to half the sampling rate."""
    n, fs = draw(st.integers(200, 3000)), draw(st.sampled_from([0.5, 50.0, 1000.0]))
    width = draw(st.floats(20.0 / n, 0.5))
    low = draw(st.floats(0.0, 0.5 - width))
    return n, fs, (low * fs, (low + width) * fs)


@settings(max_examples=draws(60), deadline=None)
@given(given=settings_of(), seed=st.integers(0, 1000))
def test_amplitude_length_and_band_are_kept(kind, given, seed):
    n, fs, (low, high) = given
    samples = kind.samples(n, fs, (low, high), np.random.default_rng(seed))
    assert samples.shape == (n,)
    assert np.abs(samples).max() == pytest.approx(1.0, abs=1e-12)
    power, frequency = np.abs(np.fft.rfft(samples)) ** 2, np.arange(n // 2 + 1) * fs / n
    tolerance = 1e-9 * fs
    inside = (frequency >= low - tolerance) & (frequency <= high + tolerance)
    assert power[inside].sum() >= 0.95 * power.sum()


def test_the_seed_alone_decides(kind):
    first, again, other = (kind.samples(500, 100.0, (2.0, 20.0), np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1


def test_a_band_without_lines_is_refused(kind):
    with pytest.raises(InputError, match=r"no spectral line of 1 s lies between 2\.2 and 2\.8 Hz"):
        kind.samples(100, 100.0, (2.2, 2.8), np.random.default_rng(0))


def test_it_has_a_title(kind):
    assert kind.title
