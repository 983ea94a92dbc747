"""Springs and dampers of a chain of masses: to the ground, and between neighbours."""

from __future__ import annotations

from bayeq.dictionary.specification import Variables
from bayeq.errors import InputError


def terms(variables: Variables, argument: str | None = None) -> list[str]:
    """Linear and cubic springs and dampers at one mass of a row, in the order of the chains, and the inputs.

    At mass i these are its displacement and velocity (to the ground), their differences to those of the masses before
    and after it, and the cubes of all. Of the whole row, those of every mass.

    InputError: less than two chains.

    Examples
    --------
    >>> variables = Variables(("x1", "v1", "x2", "v2"), (), (("x1", "v1"), ("x2", "v2")), 0)
    >>> terms(variables)
    ['x1', 'x1**3', 'x2-x1', '(x2-x1)**3', 'v1', 'v1**3', 'v2-v1', '(v2-v1)**3']
    """
    del argument
    chains = variables.chains
    if len(chains) < 2:
        raise InputError("dictionary 'neighbours' is for two coordinates or more, a chain each; use oscillator for one")
    own = range(len(chains)) if variables.own is None else [variables.own]
    out: list[str] = []
    for i in own:
        for k, name in enumerate(chains[i]):
            out += [name, f"{name}**3"]
            for a, b in ((i - 1, i), (i, i + 1)):
                if a >= 0 and b < len(chains) and k < min(len(chains[a]), len(chains[b])):
                    difference = f"{chains[b][k]}-{chains[a][k]}"
                    out += [difference, f"({difference})**3"]
    return [*dict.fromkeys(out), *variables.inputs]
