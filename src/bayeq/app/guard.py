"""Who may talk to the page: the browser that was given its address, on this computer, and no other page in it."""

from __future__ import annotations

import hmac
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

__all__ = ["LARGEST", "Guard"]

#: Largest file that is taken from the browser [bytes]; larger ones are opened where they are.
LARGEST = 200_000_000

# Of an upload, beside the file [bytes].
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
    """An ASGI application in front of another one; it answers all others with an error.

    A request has to name this server, ``127.0.0.1:8000``, as its host (a foreign name that was made to point here does
    not), to come from no other page (Origin), and to bring the token: in the address at first, which is exchanged for a
    cookie.
    """

    def __init__(self, app: Any, host: str, token: str) -> None:
        self.app, self.host, self.token = app, host, token
        self.cookie = f"bayeq_app_{host.rpartition(':')[2]}"  # ports share cookies

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer a request, or hand it on."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await _answer(scope, send, *refusal)
        elif scope["type"] == "http" and scope["path"] == "/" and self._has(_asked(scope)):
            cookie = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Lax"
            await _answer(scope, send, 303, "the page", {"Location": "/", "Set-Cookie": cookie})
        else:
            await self.app(scope, receive, _with_headers(send))

    def _refusal(self, scope: Any, headers: dict[str, str]) -> tuple[int, str] | None:
        """Code and words for a request that is refused."""
        if headers.get("host") != self.host:
            return 421, f"this page answers to {self.host} only"
        origin = headers.get("origin")
        if (origin is not None or scope["type"] == "websocket") and origin != f"http://{self.host}":
            return 403, "this page answers to itself only"
        if not self._has(_cookie(headers, self.cookie)) and not (scope["path"] == "/" and self._has(_asked(scope))):
            return 403, "open the address that bayeq app has printed: it holds the token of the page"
        if scope.get("method") in ("POST", "PUT", "PATCH"):
            length = headers.get("content-length", "")
            if not length.isdecimal():
                return 411, "the length of what is sent is missing"
            if int(length) > LARGEST + AROUND:
                return 413, f"more than {LARGEST // 1_000_000} MB; open the file by bayeq app FILE"
        return None

    def _has(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.token.encode())


def _asked(scope: Any) -> str:
    """The token in the address."""
    return parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]


def _cookie(headers: dict[str, str], name: str) -> str:
    """The token in a cookie."""
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(name)
    except CookieError:
        return ""
    return found.value if found is not None else ""


async def _answer(scope: Any, send: Any, code: int, words: str, headers: dict[str, str] | None = None) -> None:
    """A short answer; a websocket is closed."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": words[:100]})
        return
    body = f"bayeq app: {words}\n".encode()
    fields = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), **(headers or {})}
    await send({"type": "http.response.start", "status": code, "headers": _encoded({**HEADERS, **fields})})
    await send({"type": "http.response.body", "body": body})


def _with_headers(send: Any) -> Any:
    """Add the headers that keep the page to itself."""

    async def sent(message: Any) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), *_encoded(HEADERS)]
        await send(message)

    return sent


def _encoded(headers: dict[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.lower().encode("latin-1"), value.encode("latin-1")) for name, value in headers.items()]
