"""``simulate``: a record of a known system, with its true law and clean channels."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Floats
from bayeq.errors import InputError, UnknownNameError, require_kind, require_mapping, whole_number
from bayeq.expressions import Evaluator, Tape, parse
from bayeq.records import Record, Truth
from bayeq.systems.system import BandLimitedForce, System

if TYPE_CHECKING:
    from bayeq.numerics.rk4 import Interpolation

# Most samples of a record, and largest noise ratio; larger values are taken for typing mistakes.
MAX_SAMPLES = 100_000_000
MAX_NOISE = 1e6

# With fewer spectral lines than this inside its band, a force would be a sine, or nothing.
_LINES = 20


def simulate(
    system: str | System,
    *,
    n: int | None = None,
    fs: float | None = None,
    seed: int | Sequence[int] = 0,
    noise: float | Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
    perturb: float = 0.0,
    force: ArrayLike | None = None,
    interpolation: Interpolation = "linear",
) -> Record:
    """Simulate a known system and measure it with noise.

    Fixed-step RK4 at the sampling rate (times the system's `substeps`), the force interpolated in
    between; then white Gaussian noise on every channel. A derivative among the channels (the acceleration) is
    the right-hand side at the samples.

    Parameters
    ----------
    system : str or System
        A name from `SYSTEMS`, or a system of your own.
    n : int, optional
        Number of samples, at least 2; the system's own, or the length of `force`.
    fs : float, optional
        Sampling rate [Hz].
    seed : int or sequence of int
        Non-negative. Parameters, force and each channel's noise have streams of their own: another noise
        ratio leaves the force as it was.
    noise : float or mapping of str to float, optional
        Ratio of the noise's standard deviation to that of the clean channel, or, for systems of pooled
        noise, to that of all clean states together; one for all channels, or by channel (others 0).
    parameters : mapping of str to float, optional
        Values in place of the nominal ones; these are not perturbed.
    perturb : float
        The other perturbable parameters are multiplied by ``1 + perturb*N(0, 1)``, each by its own.
    force : (n,) or (n, inputs) array_like, optional
        The clean force samples, instead of the system's random force.
    interpolation : "linear", "hold", "cubic" or "band-limited"
        The force between its samples.

    Returns
    -------
    Record
        Noisy channels, SI units, ``time = arange(n)/fs`` [s]; `Record.truth` has the parameters used, the
        true coefficients by target and term, and the clean channels and targets.

    Raises
    ------
    UnknownNameError
        No such system, parameter or channel.
    InputError
        An argument out of range, or the simulation diverged.

    Examples
    --------
    >>> record = simulate("duffing", n=100, seed=1)
    >>> list(record.channels), record.truth.coefficients["a"]["x**3"]
    (['x', 'v', 'a', 'u'], -100000.0)
    """
    if isinstance(system, str):
        from bayeq.systems import get_system

        system = get_system(system)
    require_kind(system, System, "system", "the name of a system, or a System")
    rate = system.fs if fs is None else fs
    fs = _finite("fs", rate)
    if not 1e-12 <= fs <= 1e12:
        raise InputError(f"fs must {'be positive' if fs <= 0 else 'lie between 1e-12 and 1e12'}, not {rate!r}")
    parameter_stream, force_stream, *noise_streams = _streams(seed, 2 + len(system.channels))
    values = _parameters(system, parameters, perturb, parameter_stream)
    ratios = _ratios(system, noise)
    if force is not None:
        inputs = _own_force(system, force, n)
        n = len(inputs)
    else:
        n = whole_number("n", system.n if n is None else n, 2)
        if n > MAX_SAMPLES:
            raise InputError(f"n must be at most {MAX_SAMPLES} samples, not {n}; simulate several records instead")
        inputs = _random_force(system, n, fs, force_stream)

    known = [*system.states, *system.inputs, *system.parameters]
    rhs = {state: parse(text, known) for state, text in system.rhs.items()}
    states = _integrate(system, Tape.compile(rhs.values(), known), values, inputs, fs, interpolation)
    columns = dict(zip(system.states, states.T, strict=True))
    columns |= dict(zip(system.inputs, inputs.T, strict=True))
    evaluate = Evaluator({**values, **columns})
    for target, state in system.targets.items():
        columns[target] = evaluate(rhs[state])

    noise_sd = _noise_sd(system, ratios, columns, states)
    measured = {
        c: columns[c] + noise_sd[c] * np.random.default_rng(stream).standard_normal(n)
        for c, stream in zip(system.channels, noise_streams, strict=True)
    }
    coefficient = Evaluator(values)
    coefficients = {
        target: {term: float(coefficient(parse(text, values))) for term, text in terms.items()}
        for target, terms in system.terms.items()
    }
    return Record(
        channels=measured,
        time=np.arange(n) / fs,
        units=dict(system.units),
        name=system.name,
        truth=Truth(system.name, values, coefficients, columns, noise_sd),
    )


def _integrate(
    system: System, rhs: Tape, values: Mapping[str, float], inputs: Floats, fs: float, interpolation: Interpolation
) -> Floats:
    """States at the samples, (n, states); the tape takes states, inputs and parameters."""
    from bayeq.numerics.rk4 import Drive, check_interpolation, free_runs, interpolant

    check_interpolation(interpolation)
    n, size = len(inputs), len(system.states)
    largest = np.full(size, np.finfo(np.float64).max)
    drive = Drive(
        interpolant(np.arange(n) / fs, inputs, interpolation),
        np.full(n - 1, 1.0 / fs),
        1.0 / fs / system.substeps,
        -largest,
        largest,
    )
    start = np.array([[system.initial[s] for s in system.states]], dtype=np.float64)
    parameters = np.array([list(values.values())], dtype=np.float64)
    stopped, states = np.zeros(1, dtype=np.uint32), np.empty((1, n, size))
    free_runs(rhs.program(), drive, parameters, start, stopped, states)
    if stopped[0]:
        row = int(stopped[0]) - 1
        raise _diverged(system, f"at {row / fs:g} s (row {row})")
    return states[0]


def _diverged(system: System, where: str) -> InputError:
    return InputError(
        f"the simulation of {system.name!r} diverged {where}: raise fs, or check the parameters and the force"
    )


def _noise_sd(
    system: System, ratios: Mapping[str, float], clean: Mapping[str, Floats], states: Floats
) -> dict[str, float]:
    with np.errstate(all="ignore"):
        scales = {c: float(np.std(clean[c])) for c in system.channels}
        if system.noise_scale == "pooled":
            scales = dict.fromkeys(scales, float(np.std(states)))
    if not all(math.isfinite(scale) for scale in scales.values()):
        raise _diverged(system, "(overflow)")
    return {c: ratios[c] * scales[c] for c in system.channels}


def _streams(seed: int | Sequence[int], count: int) -> list[np.random.SeedSequence]:
    try:
        entropy = [operator.index(s) for s in seed] if isinstance(seed, Sequence) else operator.index(seed)
        return np.random.SeedSequence(entropy).spawn(count)
    except (TypeError, ValueError):
        raise InputError(f"seed must be a non-negative int or a sequence of them, not {seed!r}") from None


def _parameters(
    system: System, given: Mapping[str, float] | None, perturb: float, stream: np.random.SeedSequence
) -> dict[str, float]:
    given = {} if given is None else given
    require_mapping(given, "parameters")
    for name in given:
        if name not in system.parameters:
            raise UnknownNameError("parameter", name, system.parameters, where=f"system {system.name!r}")
    perturb = _finite("perturb", perturb)
    factors = 1.0 + perturb * np.random.default_rng(stream).standard_normal(len(system.parameters))
    values = {}
    for (name, nominal), factor in zip(system.parameters.items(), factors, strict=True):
        if name in given:
            values[name] = _finite(f"parameter {name!r}", given[name])
        else:
            values[name] = nominal if name in system.fixed else nominal * float(factor)
    return values


def _ratios(system: System, noise: float | Mapping[str, float] | None) -> dict[str, float]:
    if noise is None:
        noise = system.noise
    given = noise if isinstance(noise, Mapping) else dict.fromkeys(system.channels, noise)
    ratios = dict.fromkeys(system.channels, 0.0)
    for name, ratio in given.items():
        if name not in ratios:
            raise UnknownNameError("channel", name, ratios, where=f"noise of system {system.name!r}")
        ratios[name] = _finite("noise", ratio)
        if not 0 <= ratios[name] <= MAX_NOISE:
            raise InputError(f"noise is a ratio of the signal, from 0 to {MAX_NOISE:g}, not {ratio!r}")
    return ratios


def _own_force(system: System, force: ArrayLike, n: int | None) -> Floats:
    if not system.inputs:
        raise InputError(f"system {system.name!r} has no input: it takes no force")
    samples = np.array(force, dtype=np.float64)
    if samples.ndim == 1 and len(system.inputs) == 1:
        samples = samples[:, np.newaxis]
    rows = len(samples) if n is None and samples.ndim else n
    if samples.shape != (rows, len(system.inputs)) or len(samples) < 2:
        raise InputError(f"force must have n >= 2 samples of {len(system.inputs)} input(s), not shape {samples.shape}")
    if not np.all(np.isfinite(samples)):
        raise InputError("force has samples that are not finite")
    return samples


def _random_force(system: System, n: int, fs: float, stream: np.random.SeedSequence) -> Floats:
    inputs = np.empty((n, len(system.inputs)))
    rng = np.random.default_rng(stream)
    for column in inputs.T:
        if system.force is None:
            raise InputError(f"system {system.name!r} has no force of its own: give force=")
        column[:] = band_limited_noise(system.force, n, fs, rng)
    return inputs


def _finite(what: str, value: float) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{what} must be a number, not {str(value)[:40]!r}") from None
    if not math.isfinite(number):
        raise InputError(f"{what} must be finite, not {value!r}")
    return number


def band_limited_noise(force: BandLimitedForce, n: int, fs: float, rng: np.random.Generator) -> Floats:
    """(n,) samples of Gaussian noise with a flat spectrum inside a band, made in the frequency domain; fs in Hz.

    Zero mean and the given standard deviation in expectation; periodic, unless fewer than 20 spectral lines lie in the
    band. InputError if no frequency below ``fs/2`` does.
    """
    lo, hi = force.band
    if not 0.0 <= lo < min(hi, fs / 2):
        raise InputError(f"the force's band {lo:g} to {hi:g} Hz is not below half the sampling rate ({fs:g} Hz)")
    line = np.arange(n // 2 + 1)
    inside = (line * fs > lo * n) & (line * fs <= hi * n)
    if np.count_nonzero(inside) < _LINES:
        return _few_periods(force.std, lo / fs, min(hi, fs / 2) / fs, n, rng)
    # Lines stand for two frequencies, +f and -f, except the one at fs/2, which is real.
    paired = np.where(2 * line == n, 1.0, 2.0)
    spectrum = rng.standard_normal(len(line)) + 1j * rng.standard_normal(len(line))
    spectrum *= math.sqrt(0.5)
    if n % 2 == 0:
        spectrum[-1] = math.sqrt(2.0) * spectrum[-1].real
    spectrum *= np.where(inside, force.std * n / math.sqrt(np.sum(paired, where=inside)), 0.0)
    return np.fft.irfft(spectrum, n)


def _few_periods(std: float, lo: float, hi: float, n: int, rng: np.random.Generator) -> Floats:
    """As `band_limited_noise` for few lines: 20 sines over the band, from `lo` to `hi` in cycles per sample."""
    frequency = lo + (hi - lo) * np.arange(1, _LINES + 1) / _LINES
    phase = 2 * np.pi * np.outer(np.arange(n), frequency)
    amplitudes = std / math.sqrt(_LINES) * rng.standard_normal((2, _LINES))
    return np.cos(phase) @ amplitudes[0] + np.sin(phase) @ amplitudes[1]
