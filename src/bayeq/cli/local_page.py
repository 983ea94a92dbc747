"""``bayeq app``: a local page."""

from __future__ import annotations

from pathlib import Path

import click

from bayeq.cli.options import FILE, option

__all__ = ["local_page"]


@click.command("app")
@click.argument("file", required=False, type=FILE)
@option("--port", type=int, default=0, help="Port to listen to on this computer; 0 for a free one.")
@option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
def local_page(file: Path | None, port: int, no_browser: bool) -> None:
    """Show a page in the browser: drop a file, choose roles, press Discover, read and keep the result.

    FILE is opened where it is. The page is for this computer alone: no data leave it. It needs bayeq[app].
    """
    from bayeq.app.server import serve

    serve(file, port, not no_browser, click.echo)
