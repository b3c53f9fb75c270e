"""Who asks the map for something, by their token; and what they order, as one POST each."""

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
from companion.fleet.roles import COMMANDS
from ground_station.core.people.person import Person
from ground_station.core.people.web_deeds import WebDeed
from ground_station.core.people.web_tokens import TokenBook

DEEDS = "/deeds"
LARGEST_BYTES = 2048
LONGEST_TOKEN = 256
JSON = "application/json"
BEARER = "bearer "
OPEN = ("/", "/me.json", "/basemap.pmtiles", DEEDS)
OPEN_FOLDERS = ("/page/", "/assets/")
"""What tells nothing of the fleet, or asks for the token itself."""

_deeds = msgspec.json.Decoder(WebDeed)

Endpoint = Callable[[Request], Awaitable[Response]]


@dataclass(frozen=True, slots=True)
class WebPeople:
    """The people of one map. `book()`: the tokens now; `do(person, deed)` may raise LeewayError;
    None: nobody may order anything. `to_read`: who has no token sees nothing of the fleet.
    `is_there` False: there are no people, and nobody signs in.
    """

    book: Callable[[], TokenBook]
    do: Callable[[Person, WebDeed], Any] | None
    to_read: bool = False
    is_there: bool = True

    def person(self, request: Request) -> Person | None:
        """Whose token was sent (RFC 6750, 2.1); None: none that is valid."""
        sent = request.headers.get("authorization", "")
        if sent[: len(BEARER)].lower() != BEARER or len(sent) > LONGEST_TOKEN:
            return None
        return self.book().person(sent[len(BEARER) :].strip())

    def may_read(self, request: Request) -> bool:
        """Whether this request may see the fleet."""
        return not self.to_read or self.person(request) is not None

    def routes(self) -> list[BaseRoute]:
        """Who am I, and orders."""
        routes: list[BaseRoute] = [Route("/me.json", self._me)]
        return routes if self.do is None else [*routes, Route(DEEDS, self._order, methods=["POST"])]

    async def _me(self, request: Request) -> Response:
        person = self.person(request)
        known = {} if person is None else {"name": person.name, "role": person.role.value}
        orders = self.do is not None and person is not None and person.role in COMMANDS
        return _json(
            known | {"people": self.is_there, "may_order": orders, "token_to_read": self.to_read}
        )

    async def _order(self, request: Request) -> Response:
        person = self.person(request)
        if person is None:
            return unknown()
        if request.headers.get("content-type", "").partition(";")[0].strip() != JSON:
            return _trouble(415, f"expected {JSON}")
        body = await _body(request)
        if body is None:
            return _trouble(413, f"expected at most {LARGEST_BYTES} bytes")
        try:
            deed = _deeds.decode(body)
        except msgspec.DecodeError as error:
            return _trouble(400, str(error))
        assert self.do is not None
        try:
            return _json(await run_in_threadpool(self.do, person, deed))
        except LeewayError as error:
            return _trouble(409, str(error))


class TokenToRead:
    """An ASGI application before another one: where a token is needed to read, nothing of the
    fleet is answered without. The page itself is anybody's.
    """

    def __init__(self, app: ASGIApp, people: WebPeople) -> None:
        self._app, self._people = app, people

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or refuse with 401."""
        path = scope["path"]
        is_page = path in OPEN or path.startswith(OPEN_FOLDERS)
        refused = not is_page and not self._people.may_read(Request(scope))
        await (unknown() if refused else self._app)(scope, receive, send)


def unknown() -> Response:
    """The answer to who has no valid token (RFC 6750, 3)."""
    words = "no valid token\n"
    return PlainTextResponse(words, 401, headers={"www-authenticate": 'Bearer realm="leeway map"'})


async def _body(request: Request) -> bytes | None:
    got = b""
    async for part in request.stream():
        got += part
        if len(got) > LARGEST_BYTES:
            return None
    return got


def _trouble(status: int, words: str) -> Response:
    return _json({"trouble": safe_text(words)}, status)


def _json(content: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(content), status, media_type=JSON)
