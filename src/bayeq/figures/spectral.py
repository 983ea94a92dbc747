"""Spectra of measured and simulated motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bayeq.errors import InputError
from bayeq.figures.answer import Answer, channel_of
from bayeq.figures.picture import bracketed, frequency_label, one_axes, picture, plain
from bayeq.figures.spectrum import cross_spectrum, even_rate, filled
from bayeq.figures.style import BLACK, BLUE, ORANGE
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["spectra"]


@picture
def spectra(eq: Answer, record: Record, ax: Any = None, *, channel: str | None = None) -> Axes:
    """Power spectral densities of a measured state, of the free run over the whole record, and of their difference.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record
        Times, evenly sampled, inputs and measured states.
    ax : matplotlib.axes.Axes, optional
        By default those of a new figure.
    channel : str, optional
        A measured state; by default the first.

    Returns
    -------
    matplotlib.axes.Axes
        Densities by Welch's method, eight segments that overlap by half.

    Raises
    ------
    InputError
        As `Equations.simulate`; no state is measured, sampling that is not even, a free run that blew up.
    UnknownNameError
        A channel that is no measured state.
    MissingExtraError
        matplotlib is not installed.
    """
    run = eq.simulate(record, draws=0)
    name = channel_of(run, channel)
    if run.blew_up_at is not None:
        raise InputError(f"the free run blew up at {run.blew_up_at:.6g} s: it has no spectrum")
    fs = even_rate(run.time, record.name or "record")
    measured, simulated = filled(run.measured[name]), run.mean[name]
    ax = one_axes(ax, left=17.0)
    curves = (
        (measured, {"color": BLACK, "linewidth": 1.3, "label": "measured"}),
        (simulated, {"color": BLUE, "linewidth": 0.9, "linestyle": (0, (4, 1.2)), "label": "free run"}),
        (measured - simulated, {"color": ORANGE, "linewidth": 0.8, "label": "difference"}),
    )
    highest = 0.0
    for values, look in curves:
        f, density = cross_spectrum(values, values, fs)
        ax.semilogy(f, density.real, **look)
        highest = max(highest, float(density.real.max()))
    low = float(ax.get_ylim()[0])
    ax.set_ylim(max(low, 1e-12 * highest), 3.0 * highest)
    ax.set_xlim(0.0, fs / 2.0)
    ax.set_xlabel(frequency_label(eq))
    unit = next((e.units[name] for e in eq.equations if name in e.units), "")
    ax.set_ylabel(plain(f"PSD of {name}" + (f" [{bracketed(unit)}²/Hz]" if unit else " [1/Hz]")))
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=3, fontsize=7, handlelength=1.8)
    return ax
