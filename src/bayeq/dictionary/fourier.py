"""Harmonics of the coordinates: for angles."""

from __future__ import annotations

from bayeq.dictionary.specification import Variables

DEFAULT_HARMONICS = 1


def terms(variables: Variables, argument: str | None = None) -> list[str]:
    """sin(th), cos(th), ..., sin(k*th), cos(k*th) of each coordinate, and the inputs: ``fourier:2`` is k = 2.

    Harmonics of derivatives, and of the time, whose frequency would have to be known, are left to typed terms:
    ``fourier:2 + cos(3*t)``.

    Examples
    --------
    >>> terms(Variables(("th", "om"), ("u",), (("th", "om"),)), "2")
    ['sin(th)', 'cos(th)', 'sin(2*th)', 'cos(2*th)', 'u']
    """
    harmonics = DEFAULT_HARMONICS if argument is None else int(argument)
    out = []
    for name in variables.coordinates:
        for i in range(1, harmonics + 1):
            angle = name if i == 1 else f"{i}*{name}"
            out += [f"sin({angle})", f"cos({angle})"]
    return [*out, *variables.inputs]
