"""Serves the map, in a thread of its own, until it is closed."""

import asyncio
import re
import threading
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from companion.core.base.errors import LeewayError
from ground_station.adapters.listening_socket import listening_socket
from ground_station.adapters.web.live_stream import MOST_CLIENTS, LiveStream
from ground_station.adapters.web.npm_assets import ASSETS
from ground_station.adapters.web.people import DEEDS, TokenToRead, WebPeople
from ground_station.adapters.web.tls_files import TlsFiles
from ground_station.adapters.web.web_guard import WebGuard
from ground_station.core.people.web_tokens import TokenBook

PAGE = Path(__file__).with_name("page")
MOST_CONNECTIONS = 4 * MOST_CLIENTS
"""A page opens six at most; beyond it clients are answered 503."""

END_S = 1.0
"""Who is being answered when the server ends has so long."""

STARTED_S = 10.0
TIME = re.compile(r"[0-9]{1,17}")
QUEUE = 64


@dataclass(frozen=True, slots=True)
class PastAnswers:
    """What a page that shows the past asks for; times are microseconds since 1970.

    `span()`: from when to when, `moment(t_us)`: the picture of a time; both as JSON has it.
    """

    span: Callable[[], Any]
    moment: Callable[[int], Any]
    history: Callable[[str, int], Any]
    reach: Callable[[str, int], Any]


@dataclass(frozen=True, slots=True)
class MapAnswers:
    """What the page asks for beside the stream; each is called in the server's thread.

    `history(vehicle)` and `reach(vehicle)` give what can be written as JSON, None: not known. With
    `past` the page shows the past: then the stream stays silent. Without `people` nobody may order
    anything, and who reaches the map sees it.
    """

    stream: LiveStream
    history: Callable[[str], Any]
    reach: Callable[[str], Any]
    basemap: Path | None = None
    past: PastAnswers | None = None
    people: WebPeople | None = None


class MapServer:
    """Holds the port from the beginning; `serve` begins to answer."""

    def __init__(self, host: str, port: int, tls: TlsFiles | None = None) -> None:
        """Raises LeewayError where the address cannot be had. `port` 0: any that is free."""
        self._tls = tls
        try:
            self._socket = listening_socket(host, port, QUEUE)
        except OSError as error:
            why = f"map: {host}:{port}: {error.strerror or error}"
            raise LeewayError(f"{why}: expected a free port of this machine (--port)") from error
        self.port: int = self._socket.getsockname()[1]
        shown = f"[{host}]" if ":" in host else host
        self.address = f"http://{shown}:{self.port}"
        if tls is not None:
            self.address = f"https://{tls.names[0]}:{self.port}"
        self._running: tuple[uvicorn.Server, threading.Thread, LiveStream] | None = None

    def serve(self, answers: MapAnswers) -> None:
        """Answer everybody from now on. Raises LeewayError where the server does not start."""
        server = uvicorn.Server(_config(map_app(answers, self.port, self._tls), self._tls))
        started = threading.Event()
        args = (server, answers.stream, started)
        thread = threading.Thread(target=self._run, args=args, name="map", daemon=True)
        thread.start()
        self._running = server, thread, answers.stream
        if not started.wait(STARTED_S):
            raise LeewayError("map: the server did not start")

    def close(self) -> None:
        """Give the port back; nobody is waited for longer than a second."""
        if self._running is not None:
            server, thread, stream = self._running
            server.should_exit = True
            stream.close()
            thread.join(3 * END_S)
        self._socket.close()

    def _run(self, server: uvicorn.Server, stream: LiveStream, started: threading.Event) -> None:
        async def serving() -> None:
            stream.attach(asyncio.get_running_loop())
            started.set()
            await server.serve(sockets=[self._socket])

        asyncio.run(serving())


def map_app(answers: MapAnswers, port: int, tls: TlsFiles | None = None) -> ASGIApp:
    """The application: the page, its stream, what it asks for, and what people order."""
    people = answers.people or WebPeople(TokenBook, None, is_there=False)
    page = StaticFiles(directory=PAGE)
    routes: list[BaseRoute] = [
        Route("/", _file(PAGE / "index.html")),
        Mount("/page", page),
        Mount("/assets", StaticFiles(directory=ASSETS, check_dir=False)),
        Route("/events", _events(answers.stream, people)),
        *people.routes(),
        Route("/picture.json", _picture(answers.stream)),
        *(_live(answers) if answers.past is None else _past(answers.past)),
    ]
    if answers.basemap is not None:
        routes += [Route("/basemap.pmtiles", _file(answers.basemap))]
    app = TokenToRead(Starlette(routes=routes), people)
    posts = () if people.do is None else (DEEDS,)
    if tls is None:
        return WebGuard(app, port, posts=posts)
    return WebGuard(app, port, tls.names, "https", posts)


def _live(answers: MapAnswers) -> list[BaseRoute]:
    return [
        Route("/span.json", _told(lambda: None)),
        Route("/history.json", _asked(answers.history)),
        Route("/reach.json", _asked(answers.reach)),
    ]


def _past(past: PastAnswers) -> list[BaseRoute]:
    return [
        Route("/span.json", _told(past.span)),
        Route("/moment.json", _at_time(lambda vehicle, t_us: past.moment(t_us))),
        Route("/history.json", _at_time(past.history)),
        Route("/reach.json", _at_time(past.reach)),
    ]


def _file(path: Path) -> Any:
    async def answer(request: Request) -> Response:
        return FileResponse(path)  # answers ranges, which PMTiles are read by

    return answer


def _events(stream: LiveStream, people: WebPeople) -> Any:
    async def told(request: Request) -> AsyncIterator[bytes]:
        async for event in stream.events():
            if not people.may_read(request):  # its token was revoked meanwhile
                return
            yield event

    async def answer(request: Request) -> Response:
        if stream.clients >= MOST_CLIENTS:
            return PlainTextResponse(f"{MOST_CLIENTS} windows are open\n", 503)
        return StreamingResponse(told(request), media_type="text/event-stream")

    return answer


def _picture(stream: LiveStream) -> Any:
    async def answer(request: Request) -> Response:
        frame = stream.frame
        return _json(None if frame is None else frame.picture)

    return answer


def _asked(ask: Callable[[str], Any]) -> Any:
    def answer(request: Request) -> Response:  # in a worker thread: it may take milliseconds
        return _json(ask(request.query_params.get("vehicle", "")))

    return answer


def _told(tell: Callable[[], Any]) -> Any:
    def answer(request: Request) -> Response:
        return _json(tell())

    return answer


def _at_time(ask: Callable[[str, int], Any]) -> Any:
    def answer(request: Request) -> Response:
        asked = request.query_params
        t_us = asked.get("t_us", "")
        if TIME.fullmatch(t_us) is None:
            return PlainTextResponse("t_us: expected microseconds since 1970\n", 400)
        return _json(ask(asked.get("vehicle", ""), int(t_us)))

    return answer


def _json(content: Any) -> Response:
    if content is None:
        return Response(status_code=204)  # not known: no error to a browser
    return Response(msgspec.json.encode(content), media_type="application/json")


def _config(app: ASGIApp, tls: TlsFiles | None) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        ssl_certfile=None if tls is None else tls.certificate,
        ssl_keyfile=None if tls is None else tls.key,
        loop="asyncio",
        http="h11",
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,  # nobody stands between: no word of a client is taken for its address
        limit_concurrency=MOST_CONNECTIONS,
        timeout_graceful_shutdown=round(END_S),
    )
