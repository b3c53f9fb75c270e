"""Authentication of the map's clients by token, and their commands, one POST each."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

import msgspec
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp, Receive, Scope, Send

from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from companion.fleet.roles import COMMANDERS
from ground_station.core.people.map_command_messages import WebCommand
from ground_station.core.people.person import DeskOperator
from ground_station.core.people.web_tokens import TokenRegistry

COMMANDS_PATH = "/commands"
MAX_BODY_BYTES = 1 << 20
"""A file of orders, in base64."""

MAX_TOKEN_LENGTH = 256
JSON = "application/json"
BEARER = "bearer "
PUBLIC_PATHS = (
    "/",
    "/me.json",
    "/basemap.pmtiles",
    "/healthz",
    "/readyz",
    "/openapi.json",
    COMMANDS_PATH,
)
PUBLIC_FOLDERS = ("/page/", "/assets/")
"""Paths without fleet data, or that handle the token themselves."""

_command_decoder = msgspec.json.Decoder(WebCommand)

Endpoint = Callable[[Request], Awaitable[Response]]


@dataclass(frozen=True, slots=True)
class MapAccess:
    """Access rights of one map. `tokens()`: current tokens; `execute(holder, command)` carries out
    a command and may raise LeewayError, None disables commands. `requires_token`: fleet data needs
    a token. `has_users` False: the map has no users, and sign-in is disabled.
    """

    tokens: Callable[[], TokenRegistry]
    execute: Callable[[DeskOperator, WebCommand], Any] | None
    requires_token: bool = False
    has_users: bool = True

    def token_holder(self, request: Request) -> DeskOperator | None:
        """Return the holder of the request's token (RFC 6750, 2.1), None if it is not valid."""
        sent = request.headers.get("authorization", "")
        if sent[: len(BEARER)].lower() != BEARER or len(sent) > MAX_TOKEN_LENGTH:
            return None
        return self.tokens().find_operator(sent[len(BEARER) :].strip())

    def may_read_fleet_data(self, request: Request) -> bool:
        """Return whether this request may read fleet data."""
        return not self.requires_token or self.token_holder(request) is not None

    def routes(self) -> list[BaseRoute]:
        """Return the routes for identity and commands."""
        routes: list[BaseRoute] = [Route("/me.json", self._identity_response)]
        return (
            routes
            if self.execute is None
            else [*routes, Route(COMMANDS_PATH, self._command_response, methods=["POST"])]
        )

    async def _identity_response(self, request: Request) -> Response:
        holder = self.token_holder(request)
        known = {} if holder is None else {"name": holder.name, "role": holder.role.value}
        orders = self.execute is not None and holder is not None and holder.role in COMMANDERS
        return _json_response(
            known
            | {"people": self.has_users, "may_order": orders, "token_to_read": self.requires_token}
        )

    async def _command_response(self, request: Request) -> Response:
        holder = self.token_holder(request)
        if holder is None:
            return unauthorized_response()
        if request.headers.get("content-type", "").partition(";")[0].strip() != JSON:
            return _problem_response(415, f"expected {JSON}")
        body = await _read_body(request)
        if body is None:
            return _problem_response(413, f"expected at most {MAX_BODY_BYTES} bytes")
        try:
            command = _command_decoder.decode(body)
        except msgspec.DecodeError as error:
            return _problem_response(400, str(error))
        assert self.execute is not None
        try:
            return _json_response(await run_in_threadpool(self.execute, holder, command))
        except LeewayError as error:
            return _problem_response(409, str(error))


class TokenFilter:
    """ASGI middleware: if reading needs a token, fleet data is refused without one. The page itself
    is public.
    """

    def __init__(self, app: ASGIApp, access: MapAccess) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward the request, or refuse it with 401."""
        path = scope["path"]
        is_page = path in PUBLIC_PATHS or path.startswith(PUBLIC_FOLDERS)
        refused = not is_page and not self._access.may_read_fleet_data(Request(scope))
        await (unauthorized_response() if refused else self._app)(scope, receive, send)


def unauthorized_response() -> Response:
    """Return the response to a request without a valid token (RFC 6750, 3)."""
    words = "no valid token\n"
    return PlainTextResponse(words, 401, headers={"www-authenticate": 'Bearer realm="leeway map"'})


async def _read_body(request: Request) -> bytes | None:
    got = b""
    async for part in request.stream():
        got += part
        if len(got) > MAX_BODY_BYTES:
            return None
    return got


def _problem_response(status: int, message: str) -> Response:
    return _json_response({"error": safe_text(message)}, status)


def _json_response(content: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(content), status, media_type=JSON)
