"""What stands before every page: who may ask, and what a browser may do with the answer.

A server on loopback is reached by every web page that this machine's browser has open, directly
or by a name that its owner points at 127.0.0.1 (DNS rebinding). So the name that was asked for
(Host) and the page that asks (Origin, Sec-Fetch-Site) must be our own.
"""

from collections.abc import Collection, Iterable

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",  # MapLibre's sprites and canvases
        "connect-src 'self'",
        "worker-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
"""Nothing from elsewhere, no inline script, no frame around us (W3C Content Security Policy 3)."""

HEADERS = {
    "content-security-policy": CONTENT_SECURITY_POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "geolocation=(), camera=(), microphone=()",
    "cache-control": "no-store",  # the fleet's state does not stay on the disk of a browser
}
METHODS = ("GET", "HEAD")
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
DEFAULT_PORT = {"http": 80, "https": 443}
FROM_US = (None, "same-origin", "none")
"""Sec-Fetch-Site: absent outside browsers; `none` is the address bar (W3C Fetch Metadata)."""


class WebGuard:
    """An ASGI application before another one."""

    def __init__(
        self,
        app: ASGIApp,
        port: int,
        names: Iterable[str] = LOOPBACK,
        scheme: str = "http",
        posts: Collection[str] = (),
    ) -> None:
        """`names`: by which hosts of a URL we may be asked; `posts`: paths that take a POST."""
        self._app, self._posts = app, posts
        self._hosts = {f"{name}:{port}" for name in names}
        if port == DEFAULT_PORT[scheme]:
            self._hosts |= set(names)  # a browser leaves it out
        self._origins = {f"{scheme}://{host}" for host in self._hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or refuse with 403, 405 or 421."""
        if scope["type"] != "http":
            return
        refusal = self._refusal(scope["method"], scope["path"], Headers(scope=scope))
        answer = self._app if refusal is None else refusal
        await answer(scope, receive, _with_headers(send))

    def _refusal(self, method: str, path: str, headers: Headers) -> PlainTextResponse | None:
        if headers.getlist("host") not in [[host] for host in self._hosts]:
            return PlainTextResponse("not the name of this server\n", 421)
        origin = headers.get("origin")
        foreign = origin is not None and origin not in self._origins
        if foreign or headers.get("sec-fetch-site") not in FROM_US:
            return PlainTextResponse("asked by another page\n", 403)
        if method not in METHODS and not (method == "POST" and path in self._posts):
            return PlainTextResponse("this only shows\n", 405)
        return None


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(HEADERS)
        await send(message)

    return sending
