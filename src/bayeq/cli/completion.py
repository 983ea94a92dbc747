"""``bayeq completion``: the script by which a shell completes commands and options."""

from __future__ import annotations

import os

import click
from click.shell_completion import get_completion_class, shell_complete

__all__ = ["complete", "completion"]

#: The variable in which the script asks for completions, after click's rule.
VARIABLE = "_BAYEQ_COMPLETE"


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script by which SHELL completes commands and options.

    Load it where the shell starts: eval "$(bayeq completion bash)" in ~/.bashrc, the same with zsh in ~/.zshrc, or
    bayeq completion fish > ~/.config/fish/completions/bayeq.fish.
    """
    found = get_completion_class(shell)
    assert found is not None
    click.echo(found(context.find_root().command, {}, "bayeq", VARIABLE).source())


def complete(app: click.Command) -> int | None:
    """Answer a shell that asks for completions; None if none does.

    Parameters
    ----------
    app : click.Command
        The command line.
    """
    asked = os.environ.get(VARIABLE)
    if not asked:
        return None
    return shell_complete(app, {}, "bayeq", VARIABLE, asked)
