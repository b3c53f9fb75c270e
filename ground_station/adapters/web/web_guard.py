"""ASGI guard of every page: which requests are accepted, and which headers restrict the browser.

Every web page open in this machine's browser can reach a server on loopback, directly or by a DNS
name that points at 127.0.0.1 (DNS rebinding). Therefore the requested host (Host) and the
requesting page (Origin, Sec-Fetch-Site) must be this server's.
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
"""No foreign sources, inline scripts or embedding frames (W3C Content Security Policy 3)."""

HEADERS = {
    "content-security-policy": CONTENT_SECURITY_POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "geolocation=(), camera=(), microphone=()",
    "cache-control": "no-store",  # browsers must not store the fleet's state on disk
}
READ_METHODS = ("GET", "HEAD")
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
DEFAULT_PORT = {"http": 80, "https": 443}
SAME_ORIGIN_SITES = (None, "same-origin", "none")
"""Sec-Fetch-Site: absent outside browsers; `none` is the address bar (W3C Fetch Metadata)."""


class RequestFilter:
    """ASGI middleware that checks each request."""

    def __init__(
        self,
        app: ASGIApp,
        port: int,
        names: Iterable[str] = LOOPBACK,
        scheme: str = "http",
        post_paths: Collection[str] = (),
    ) -> None:
        """`names`: accepted host names; `post_paths`: paths that accept a POST."""
        self._app, self._post_paths = app, post_paths
        self._hosts = {f"{name}:{port}" for name in names}
        if port == DEFAULT_PORT[scheme]:
            self._hosts |= set(names)  # browsers omit the default port
        self._origins = {f"{scheme}://{host}" for host in self._hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward the request, or refuse it with 403, 405 or 421."""
        if scope["type"] != "http":
            return
        refusal = self._refusal_response(scope["method"], scope["path"], Headers(scope=scope))
        handler = self._app if refusal is None else refusal
        await handler(scope, receive, _with_security_headers(send))

    def _refusal_response(
        self, method: str, path: str, headers: Headers
    ) -> PlainTextResponse | None:
        if headers.getlist("host") not in [[host] for host in self._hosts]:
            return PlainTextResponse("host is not this server\n", 421)
        origin = headers.get("origin")
        is_cross_origin = origin is not None and origin not in self._origins
        if is_cross_origin or headers.get("sec-fetch-site") not in SAME_ORIGIN_SITES:
            return PlainTextResponse("request from another site\n", 403)
        if method not in READ_METHODS and not (method == "POST" and path in self._post_paths):
            return PlainTextResponse("read only: expected GET or HEAD\n", 405)
        return None


def _with_security_headers(send: Send) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(HEADERS)
        await send(message)

    return send_with_headers
