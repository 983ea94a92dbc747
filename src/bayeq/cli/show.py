"""``bayeq show``: saved equations, printed as `bayeq discover` printed them."""

from __future__ import annotations

import warnings
from pathlib import Path

import click

from bayeq.cli.options import FILE, Command, option
from bayeq.errors import DataWarning, InputError

__all__ = ["show"]


@click.command(cls=Command)
@click.argument("file", metavar="EQ.json", type=FILE)
@option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
@option("--conditional", is_flag=True, help="Print the intervals given the terms shown. --json has both.")
@option("--physical", is_flag=True, help="Also mass, damping, stiffness ... of a second-order equation.")
@option("--latex", is_flag=True, help="Print the equations alone, as LaTeX.")
@option("--explain", is_flag=True, help="Explain below the answer, in plain words, what is printed.")
def show(file: Path, as_json: bool, conditional: bool, physical: bool, latex: bool, explain: bool) -> None:
    """Print saved equations as they were printed when they were found.

    EQ.json holds equations that `bayeq discover --save` has written.
    """
    if as_json and (latex or explain):
        raise InputError(f"--json and --{'latex' if latex else 'explain'} exclude each other; give one of them")
    if latex and (explain or physical):
        raise InputError("--latex prints the equations alone; leave out --explain and --physical")
    from bayeq.cli.outputs import show_equations
    from bayeq.equation.load import load

    equations = load(file)
    if latex:
        click.echo(equations.to_latex())
        return
    for message in equations.warnings:
        warnings.warn(message, DataWarning, stacklevel=1)
    show_equations(equations, as_json, conditional, physical, explain)
