"""One page for one browser on this computer."""

from __future__ import annotations

import logging
import secrets
import signal
import socket
import tempfile
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bayeq.app.guard import Guard
from bayeq.app.session import Session, Workspace
from bayeq.errors import InputError, MissingExtraError
from bayeq.posix import POSIX, on_signal

__all__ = ["HOST", "serve"]

#: The only address that is listened to.
HOST = "127.0.0.1"

# Windows that are open are waited for so long at the end [s].
GRACE = 1


def serve(file: Path | None, port: int, browser: bool, say: Callable[[str], None]) -> None:
    """Show the page until it is interrupted, on a port of this computer alone (0: a free one).

    A file is opened where it is; `say` is called with the address.

    Raises
    ------
    MissingExtraError
        The framework, or what reports need, is not installed.
    InputError
        The file is not there, or the port is in use.
    """
    _require_extra()
    if file is not None and not file.is_file():
        raise InputError(f"{file}: there is no such file")
    listening = _listening(port)
    host = f"{HOST}:{listening.getsockname()[1]}"
    token = secrets.token_urlsafe(24)
    session = Session(Workspace())
    tempfile.tempdir = str(session.workspace.path)  # also of what the framework stores of a file that arrives
    on_signal("SIGHUP", lambda *_: signal.raise_signal(signal.SIGTERM))  # a closed terminal ends it as any end does
    address = f"http://{host}/?token={token}"
    try:
        _run(session, file, host, token, listening, lambda: _announce(address, browser, say))
    except KeyboardInterrupt:
        say("ended")
    finally:
        session.close()
        listening.close()


def _announce(address: str, browser: bool, say: Callable[[str], None]) -> None:
    say(f"{address}\nOpen this address in a browser on this computer; Ctrl-C ends it.")
    if browser:
        webbrowser.open(address)


def _run(
    session: Session, file: Path | None, host: str, token: str, listening: socket.socket, ready: Callable[[], None]
) -> None:
    """Serve until the end."""
    import uvicorn
    from fastapi import FastAPI
    from fastapi.responses import FileResponse, PlainTextResponse
    from nicegui import app, background_tasks, ui

    from bayeq.app.page import build, refresh

    logging.getLogger("nicegui").setLevel(logging.ERROR)  # it warns where a busy computer is slow
    session.changed = refresh
    api = FastAPI(openapi_url=None)

    def written(name: str, kind: str) -> Any:
        path = getattr(session.result, name, None)
        if path is None or not path.is_file():
            return PlainTextResponse("there is no result yet\n", status_code=404)
        return FileResponse(path, media_type=kind, headers={"Cache-Control": "no-store"})

    api.get("/report.html")(lambda: written("report", "text/html; charset=utf-8"))
    api.get("/equation.json")(lambda: written("equation", "application/json"))
    ui.page("/")(lambda: build(session))

    @app.on_startup
    def started() -> None:
        ready()
        if file is not None:
            background_tasks.create(session.open(file.resolve(), file.name))

    app.on_shutdown(session.close)
    ui.run_with(api, title="bayeq", favicon="📈", language="en-US", tailwind=False, show_welcome_message=False)
    api.add_middleware(Guard, host=host, token=token)
    config = uvicorn.Config(api, log_level="error", access_log=False, timeout_graceful_shutdown=GRACE)
    uvicorn.Server(config).run(sockets=[listening])


def _listening(port: int) -> socket.socket:
    """A socket on this computer's own address."""
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if POSIX:  # a port that has just been left can be used again
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((HOST, port))
    except (OSError, OverflowError) as error:
        made.close()
        why = getattr(error, "strerror", None) or "a port is a number from 0 to 65535"
        raise InputError(f"--port {port}: {why}; leave it out for a free one") from None
    made.listen()
    return made


def _require_extra() -> None:
    """Check that the page can be shown and a report be made."""
    try:
        import nicegui  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("nicegui", "app", "the local page") from error
    from bayeq.equation.report.page import require_report

    require_report()
