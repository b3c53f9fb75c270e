"""HTTP server of the map, in its own thread."""

import asyncio
import re
import threading
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from functools import partial
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
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.listening_socket import open_server_socket
from ground_station.adapters.web.connections import REQUEST_TIMEOUT_S, limited_protocol
from ground_station.adapters.web.live_stream import MAX_CLIENTS, LiveStream
from ground_station.adapters.web.npm_assets import ASSETS
from ground_station.adapters.web.people import COMMANDS_PATH, MapAccess, TokenFilter
from ground_station.adapters.web.tls_files import TlsFiles
from ground_station.adapters.web.web_guard import RequestFilter
from ground_station.core.people.web_tokens import TokenRegistry

PAGE_FOLDER = Path(__file__).with_name("page")
MAX_CONNECTIONS = 4 * MAX_CLIENTS
"""A page opens at most six; clients beyond this limit get status 503."""

SHUTDOWN_TIMEOUT_S = 1.0
"""Time for requests in progress to finish when the server ends."""

START_TIMEOUT_S = 10.0
MAX_PICTURE_AGE_S = 5.0
TIME_PATTERN = re.compile(r"[0-9]{1,17}")
ACCEPT_QUEUE_LENGTH = 64


@dataclass(frozen=True, slots=True)
class PastDataSources:
    """Data sources of a page that shows the past; times are microseconds since 1970.

    `span()` returns first and last time, `snapshot(t_us)` the picture at a time; both as JSON data.
    """

    span: Callable[[], Any]
    snapshot: Callable[[int], Any]
    history: Callable[[str, int], Any]
    reachable_area: Callable[[str, int], Any]


@dataclass(frozen=True, slots=True)
class MapDataSources:
    """Data sources of the page besides the stream; each is called in the server's thread.

    `history(vehicle)`, `reachable_area(vehicle)` and `order(id)` return JSON data, or None if
    unknown; `openapi()` describes all. With `past` the page shows the past and the stream stays
    silent. Without `access`, commands are disabled and every client can see the map.
    """

    stream: LiveStream
    history: Callable[[str], Any]
    reachable_area: Callable[[str], Any]
    basemap: Path | None = None
    past: PastDataSources | None = None
    access: MapAccess | None = None
    order: Callable[[str], Any] = lambda order: None
    openapi: Callable[[], Any] = lambda: None


class MapServer:
    """Binds the port when it is created; `start_serving` starts to accept requests."""

    def __init__(self, host: str, port: int, tls: TlsFiles | None = None) -> None:
        """Raises LeewayError if the address cannot be bound. `port` 0: any free port."""
        self._tls = tls
        try:
            self._socket = open_server_socket(host, port, ACCEPT_QUEUE_LENGTH)
        except OSError as error:
            problem = f"map: {host}:{port}: {error.strerror or error}"
            raise LeewayError(
                f"{problem}: expected a free port of this machine (--port)"
            ) from error
        self.port: int = self._socket.getsockname()[1]
        shown = f"[{host}]" if ":" in host else host
        self.address = f"http://{shown}:{self.port}"
        if tls is not None:
            self.address = f"https://{tls.names[0]}:{self.port}"
        self._running: tuple[uvicorn.Server, threading.Thread, LiveStream] | None = None

    def start_serving(self, sources: MapDataSources) -> None:
        """Start serving. Raises LeewayError if the server does not start."""
        server = uvicorn.Server(
            _server_config(build_map_app(sources, self.port, self._tls), self._tls)
        )
        started = threading.Event()
        args = (server, sources.stream, started)
        thread = threading.Thread(
            target=self._run_server_thread, args=args, name="map", daemon=True
        )
        thread.start()
        self._running = server, thread, sources.stream
        if not started.wait(START_TIMEOUT_S):
            raise LeewayError("map: the server did not start")

    def close(self) -> None:
        """Release the port; waits about a second for requests in progress."""
        if self._running is not None:
            server, thread, stream = self._running
            server.should_exit = True
            stream.close()
            thread.join(3 * SHUTDOWN_TIMEOUT_S)
        self._socket.close()

    def _run_server_thread(
        self, server: uvicorn.Server, stream: LiveStream, started: threading.Event
    ) -> None:
        async def run_server() -> None:
            stream.set_event_loop(asyncio.get_running_loop())
            started.set()
            if self._tls is not None:  # a client may send nothing at all
                loop = asyncio.get_running_loop()
                limit = {"ssl_handshake_timeout": REQUEST_TIMEOUT_S}
                loop.create_server = partial(loop.create_server, **limit)  # pyright: ignore
            await server.serve(sockets=[self._socket])

        asyncio.run(run_server())


def build_map_app(sources: MapDataSources, port: int, tls: TlsFiles | None = None) -> ASGIApp:
    """Build the application: page, stream, data requests and operator commands."""
    access = sources.access or MapAccess(TokenRegistry, None, has_users=False)
    page, assets = (
        StaticFiles(directory=PAGE_FOLDER),
        StaticFiles(directory=ASSETS, check_dir=False),
    )
    assets.config_checked = True  # a folder that is not fetched yet: 404, not 500
    routes: list[BaseRoute] = [
        Route("/", _file_endpoint(PAGE_FOLDER / "index.html")),
        Mount("/page", page),
        Mount("/assets", assets),
        Route("/healthz", _health_endpoint),
        Route("/readyz", _readiness_endpoint(sources)),
        Route("/events", _events_endpoint(sources.stream, access)),
        *access.routes(),
        Route("/picture.json", _picture_endpoint(sources.stream)),
        *(_live_routes(sources) if sources.past is None else _past_routes(sources.past)),
    ]
    if sources.basemap is not None:
        routes += [Route("/basemap.pmtiles", _file_endpoint(sources.basemap))]
    app = TokenFilter(Starlette(routes=routes), access)
    post_paths = () if access.execute is None else (COMMANDS_PATH,)
    if tls is None:
        return RequestFilter(app, port, post_paths=post_paths)
    return RequestFilter(app, port, tls.names, "https", post_paths)


def _live_routes(sources: MapDataSources) -> list[BaseRoute]:
    return [
        Route("/span.json", _json_endpoint(lambda: None)),
        Route("/history.json", _vehicle_json_endpoint(sources.history)),
        Route("/reach.json", _vehicle_json_endpoint(sources.reachable_area)),
        Route("/order.json", _vehicle_json_endpoint(sources.order, "order")),
        Route("/openapi.json", _json_endpoint(sources.openapi)),
    ]


def _past_routes(past: PastDataSources) -> list[BaseRoute]:
    return [
        Route("/span.json", _json_endpoint(past.span)),
        Route(
            "/moment.json",
            _vehicle_and_time_json_endpoint(lambda vehicle, t_us: past.snapshot(t_us)),
        ),
        Route("/history.json", _vehicle_and_time_json_endpoint(past.history)),
        Route("/reach.json", _vehicle_and_time_json_endpoint(past.reachable_area)),
    ]


def _file_endpoint(path: Path) -> Any:
    async def respond(request: Request) -> Response:
        return FileResponse(path)  # supports range requests, which PMTiles needs

    return respond


async def _health_endpoint(request: Request) -> Response:
    return PlainTextResponse("ok\n")  # the server's loop runs


def _readiness_endpoint(sources: MapDataSources) -> Any:
    """Ready: the page gets a picture, and it is a new one."""

    async def respond(request: Request) -> Response:
        frame = sources.stream.latest_frame
        if sources.past is not None:
            return PlainTextResponse("ready\n")
        if frame is None:
            return PlainTextResponse("not ready: no picture yet\n", 503)
        age_s = (epoch_us() - frame.t_us) / 1e6
        if age_s > MAX_PICTURE_AGE_S:
            return PlainTextResponse(f"not ready: the picture is {age_s:.0f} s old\n", 503)
        return PlainTextResponse("ready\n")

    return respond


def _events_endpoint(stream: LiveStream, access: MapAccess) -> Any:
    async def stream_events(request: Request) -> AsyncIterator[bytes]:
        async for event in stream.stream_client_events():
            if not access.may_read_fleet_data(request):  # its token was revoked
                return
            yield event

    async def respond(request: Request) -> Response:
        if stream.clients >= MAX_CLIENTS:
            return PlainTextResponse(f"too many clients, expected at most {MAX_CLIENTS}\n", 503)
        return StreamingResponse(stream_events(request), media_type="text/event-stream")

    return respond


def _picture_endpoint(stream: LiveStream) -> Any:
    async def respond(request: Request) -> Response:
        frame = stream.latest_frame
        return _json_response(None if frame is None else frame.picture)

    return respond


def _vehicle_json_endpoint(get_data: Callable[[str], Any], key: str = "vehicle") -> Any:
    def respond(request: Request) -> Response:  # in a worker thread: it may take milliseconds
        return _json_response(get_data(request.query_params.get(key, "")))

    return respond


def _json_endpoint(get_data: Callable[[], Any]) -> Any:
    def respond(request: Request) -> Response:
        return _json_response(get_data())

    return respond


def _vehicle_and_time_json_endpoint(get_data: Callable[[str, int], Any]) -> Any:
    def respond(request: Request) -> Response:
        query = request.query_params
        t_us = query.get("t_us", "")
        if TIME_PATTERN.fullmatch(t_us) is None:
            return PlainTextResponse("t_us: expected microseconds since 1970\n", 400)
        return _json_response(get_data(query.get("vehicle", ""), int(t_us)))

    return respond


def _json_response(content: Any) -> Response:
    if content is None:
        return Response(status_code=204)  # unknown: not an error for a browser
    return Response(msgspec.json.encode(content), media_type="application/json")


def _server_config(app: ASGIApp, tls: TlsFiles | None) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        ssl_certfile=None if tls is None else tls.certificate,
        ssl_keyfile=None if tls is None else tls.key,
        loop="asyncio",
        http=limited_protocol(MAX_CONNECTIONS - 1),
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,  # no proxy is expected: forwarding headers of clients are ignored
        limit_concurrency=MAX_CONNECTIONS,
        timeout_graceful_shutdown=round(SHUTDOWN_TIMEOUT_S),
    )
