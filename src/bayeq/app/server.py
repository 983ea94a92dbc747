"""One page for one browser on this computer: requests need the token in the printed address."""

from __future__ import annotations

import hmac
import logging
import os
import secrets
import signal
import socket
import tempfile
import webbrowser
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from bayeq.app.choices import EQUATION, REPORT
from bayeq.app.session import LARGEST, Session, Workspace
from bayeq.errors import InputError, needing
from bayeq.resumable.posix import on_signal

# Largest size of an upload request beyond its file [bytes].
AROUND = 100_000

# The page runs its framework's scripts, talks to this server, and loads nothing from elsewhere.
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline';"
    " img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; frame-src 'self'; frame-ancestors 'self';"
    " object-src 'none'; base-uri 'none'; form-action 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Guard:
    """ASGI middleware that passes permitted requests on to `app` and answers all others with an error.

    A request must name this server, ``127.0.0.1:8000``, as its host (which prevents DNS rebinding), come from no other
    page (Origin), and bring the token: the first one in its address, later ones in the cookie that it is exchanged for.
    """

    def __init__(self, app: Any, host: str, token: str) -> None:
        self.app, self.host, self.token = app, host, token
        self.cookie = f"bayeq_app_{host.rpartition(':')[2]}"  # cookies are shared between ports

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Refuse a request, exchange its token for a cookie, or pass it on."""
        from starlette.datastructures import MutableHeaders
        from starlette.requests import HTTPConnection
        from starlette.responses import PlainTextResponse, RedirectResponse

        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return

        async def sent(message: Any) -> None:
            """Add the security headers `HEADERS`."""
            if message["type"] == "http.response.start":
                message.setdefault("headers", [])
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        request = HTTPConnection(scope)
        refusal = self._refusal(scope, request)
        if refusal is not None and scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": refusal[1][:100]})
        elif refusal is not None:
            code, words = refusal
            await PlainTextResponse(f"bayeq app: {words}\n", code)(scope, receive, sent)
        elif scope["type"] == "http" and self._is_first(request):
            cookie = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Lax"
            await RedirectResponse("/", 303, {"Set-Cookie": cookie})(scope, receive, sent)
        else:
            await self.app(scope, receive, sent)

    def _refusal(self, scope: Any, request: Any) -> tuple[int, str] | None:
        """HTTP status and message with which a request is refused; None if it is allowed."""
        if request.headers.get("host") != self.host:
            return 421, f"this page answers to {self.host} only"
        origin = request.headers.get("origin")
        if (origin is not None or scope["type"] == "websocket") and origin != f"http://{self.host}":
            return 403, "this page answers to itself only"
        if not self._is_token(request.cookies.get(self.cookie, "")) and not self._is_first(request):
            return 403, "open the address that bayeq app has printed: it holds the token of the page"
        if scope.get("method") in ("POST", "PUT", "PATCH"):
            length = request.headers.get("content-length", "")
            if not length.isdecimal():
                return 411, "the length of what is sent is missing"
            if int(length) > LARGEST + AROUND:
                return 413, f"more than {LARGEST // 1_000_000} MB; open the file by bayeq app FILE"
        return None

    def _is_first(self, request: Any) -> bool:
        """Whether the request is for ``/`` with the printed token in its query, before there is a cookie."""
        return request.scope["path"] == "/" and self._is_token(request.query_params.get("token", ""))

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self.token.encode())


# --- the server ------------------------------------------------------------------------------------------------------

#: The only address that is listened to.
HOST = "127.0.0.1"

# Time that open connections are given to close at the end [s].
GRACE = 1


def serve(file: Path | None, port: int, browser: bool, say: Callable[[str], None]) -> None:
    """Serve the page until an interrupt, on a port of this computer alone (0: a free one).

    A file is opened where it is; `say` is called with the address. InputError for a file or a port that cannot be used.
    """
    with needing("nicegui", "app", "the local page"):
        import nicegui  # noqa: F401
    from bayeq.equation.report.page import require_report

    require_report()
    if file is not None and not file.is_file():
        raise InputError(f"{file}: there is no such file")
    listening = _listening(port)
    host = f"{HOST}:{listening.getsockname()[1]}"
    token = secrets.token_urlsafe(24)
    session = Session(Workspace())
    tempfile.tempdir = str(session.workspace.path)  # where the framework stores parts of uploads
    on_signal("SIGHUP", lambda *_: signal.raise_signal(signal.SIGTERM))  # a closed terminal ends it as SIGTERM does
    address = f"http://{host}/?token={token}"

    def announce() -> None:
        say(f"{address}\nOpen this address in a browser on this computer; Ctrl-C ends it.")
        if browser:
            webbrowser.open(address)

    try:
        _run(session, file, host, token, listening, announce)
    except KeyboardInterrupt:
        say("ended")
    finally:
        session.close()
        listening.close()


def _run(
    session: Session, file: Path | None, host: str, token: str, listening: socket.socket, ready: Callable[[], None]
) -> None:
    import uvicorn
    from fastapi import FastAPI
    from fastapi.responses import FileResponse, PlainTextResponse
    from nicegui import app, background_tasks, ui

    from bayeq.app.page import build, refresh

    logging.getLogger("nicegui").setLevel(logging.ERROR)  # it warns when a busy computer is slow
    session.changed = refresh
    api = FastAPI(openapi_url=None)

    def written(name: str, kind: str) -> Any:
        if session.result is None or not (path := session.result.folder / name).is_file():
            return PlainTextResponse("there is no result yet\n", status_code=404)
        return FileResponse(path, media_type=kind, headers={"Cache-Control": "no-store"})

    for name, kind in ((REPORT, "text/html; charset=utf-8"), (EQUATION, "application/json")):
        api.get(f"/{name}")(partial(written, name, kind))
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
    if not 0 <= port <= 65535:
        raise InputError(f"--port {port}: a port is a number from 0 to 65535; leave it out for a free one")
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        why = os.strerror(error.errno or 0)
        raise InputError(f"--port {port}: {why}; leave it out for a free one") from None
