"""The map's server over HTTP: what it refuses, what a browser may do, clients that hang."""

import socket
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.adapters.web.live_stream import MAX_CLIENTS
from ground_station.adapters.web.map_server import PAGE_FOLDER, MapDataSources, MapServer
from ground_station.app.cli.main import app
from tests.ground_station.web.map_site import MapSite
from tests.ground_station.web.sse_client import following

PATHS = [
    "/",
    "/page/main.js",
    "/me.json",
    "/picture.json",
    "/history.json?vehicle=d1",
    "/nothing",
    "/events",
    "/commands",
]
PATIENCE_S = 30.0


def status_of(address: str, method: str = "GET", **headers: str) -> int:
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    with httpx.stream(method, address, headers=names, timeout=PATIENCE_S) as answer:
        return answer.status_code


@pytest.mark.parametrize("path", PATHS)
def test_every_answer_forbids_scripts_and_frames_of_others(site: MapSite, path: str):
    site.step()
    with httpx.stream("GET", site.address + path, timeout=PATIENCE_S) as answer:
        policy = answer.headers["content-security-policy"].split("; ")
        assert "default-src 'none'" in policy
        assert "script-src 'self'" in policy
        assert "frame-ancestors 'none'" in policy
        assert not [rule for rule in policy if "unsafe" in rule or "http" in rule]
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["cache-control"] == "no-store"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.sample
@pytest.mark.parametrize("path", PATHS)
def test_another_name_than_its_own_is_refused(site: MapSite, path: str):
    """DNS rebinding: a page of evil.example whose name now points at this machine."""
    site.step()
    port = site.server.port
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{port + 1}"):
        assert status_of(site.address + path, host=host) == 421
    for host in (f"127.0.0.1:{port}", f"localhost:{port}"):
        assert status_of(site.address + path, host=host) in (200, 204, 404)


@pytest.mark.sample
@pytest.mark.parametrize("path", PATHS)
def test_another_page_of_this_browser_is_refused(site: MapSite, path: str):
    site.step()
    for origin in ("http://evil.example", "null", f"https://127.0.0.1:{site.server.port}"):
        assert status_of(site.address + path, origin=origin) == 403
    for mode in ("cross-site", "same-site"):
        assert status_of(site.address + path, sec_fetch_site=mode) == 403
    assert status_of(site.address + path, origin=site.address) in (200, 204, 404)


@pytest.mark.sample
@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
def test_it_takes_nothing(site: MapSite, method: str):
    for path in PATHS:
        assert status_of(site.address + path, method) == 405


@pytest.mark.parametrize("path", ["/page/../map_server.py", "/page/%2e%2e/map_server.py", "/page/"])
def test_nothing_beside_the_page_is_served(site: MapSite, path: str):
    line = socket.create_connection(("127.0.0.1", site.server.port), timeout=PATIENCE_S)
    with line:
        host = f"127.0.0.1:{site.server.port}"
        line.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
        assert b" 404 " in line.makefile("rb").readline()


def test_the_page_has_no_script_style_or_address_of_others():
    for path in PAGE_FOLDER.iterdir():
        text = path.read_text()
        foreign = [word for word in text.split() if "://" in word and "www.w3.org/2000" not in word]
        allowed = [word for word in foreign if "${location.origin}" in word]
        assert foreign == allowed, path.name
        assert "innerHTML" not in text
    index = (PAGE_FOLDER / "index.html").read_text()
    assert "style=" not in index
    assert " on" not in index.replace(" one", "").replace(" on or", "")


def test_words_from_outside_are_data_and_stay_what_they_are(site: MapSite):
    words = "<img src=x onerror=alert(1)>\"'\u2028</script>\ndata: {}\n\n"
    site.until_flying("d1")
    site.fleet_link.more["d1"] = {"text": words}
    site.step()
    with following(site.address) as client:
        client.take()
        assert client.picture["drones"]["d1"]["says"] == words
        assert client.picture == site.picture


def test_a_drones_history_and_reach_are_answered_and_an_unknown_ones_are_not(site: MapSite):
    site.until_flying("d1")
    for k in range(3):
        site.fleet_link.more["d1"] = {"p_home": 0.9 + 0.01 * k, "margin_wh": 10.0 + k,
                                "energy_left_wh": 60.0}  # fmt: skip
        site.step()
    history = httpx.get(f"{site.address}/history.json?vehicle=d1").json()
    assert [one["margin_wh"] for one in history] == [10.0, 11.0, 12.0]
    assert [one["p_home"] for one in history] == pytest.approx([0.90, 0.91, 0.92])
    assert len(httpx.get(f"{site.address}/reach.json?vehicle=d1").json()) > 10
    for question in ("history", "reach"):
        assert status_of(f"{site.address}/{question}.json?vehicle=nobody") == 204
        assert status_of(f"{site.address}/{question}.json") == 204


def read_all(line: socket.socket) -> int:
    """Count the bytes waiting on a connection until it is silent."""
    line.settimeout(2.0)
    got = 0
    with suppress(TimeoutError):
        while data := line.recv(1 << 20):
            got += len(data)
    return got


@pytest.mark.sample
def test_a_client_that_hangs_slows_nobody_and_gets_the_newest_when_it_wakes(site: MapSite):
    """60 MB are sent in frames of 1 MB: the socket buffers fill after a few."""
    site.until_flying("d1")
    host = f"127.0.0.1:{site.server.port}"
    with socket.create_connection(("127.0.0.1", site.server.port), timeout=PATIENCE_S) as hung:
        hung.sendall(f"GET /events HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        with following(site.address) as client:
            for k in range(60):
                site.fleet_link.more["d1"] = {"text": f"{k:03d} " * 250_000}
                site.step()
                client.until(site.picture)
        got = read_all(hung)
    assert 1_000_000 < got < 30_000_000


def test_more_windows_than_a_desk_has_are_refused_and_those_that_close_make_room(site: MapSite):
    site.step()
    with ExitStack() as held:
        clients = [held.enter_context(following(site.address)) for _ in range(MAX_CLIENTS)]
        assert {client.take() for client in clients} == {"picture"}
        assert status_of(f"{site.address}/events") == 503
        assert status_of(site.address) == 200
    until_s = time.monotonic() + PATIENCE_S
    while site.decode_bytes.stream.clients:
        assert time.monotonic() < until_s
        site.step()  # a closed client is noticed at the next send
    with following(site.address) as client:
        assert client.take() == "picture"


def test_closing_ends_every_client_and_gives_the_port_back(site: MapSite):
    site.step()
    with following(site.address) as client:
        client.take()
        site.server.close()
        with pytest.raises((KeyError, httpx.RemoteProtocolError)):  # its end, not a time-out
            client.take()
    MapServer("127.0.0.1", site.server.port).close()


def test_a_port_that_is_taken_is_said_with_what_to_do(site: MapSite):
    with pytest.raises(LeewayError, match=r"Address already in use.*--port"):
        MapServer("127.0.0.1", site.server.port)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--fleet", "harbour", "--host", "0.0.0.0"], "add --tls CERT KEY and --tokens FILE"),
        (["--fleet", "harbour", "--host", "10.0.0.5", "--tokens", "t"], "by other machines"),
        (["--fleet", "harbour", "--host", "example.org"], "can be reached by other machines"),
        ([], "expected --day, or --fleet"),
        (["--fleet", "harbour", "--basemap", "nothing.pmtiles"], "No such file"),
    ],
)
def test_what_cannot_be_shown_is_refused_before_anything_is_opened(options, words, tmp_path: Path):
    store = ["--store", f"sqlite:///{tmp_path}/desk.db"]
    done = CliRunner().invoke(app, ["map", *options, *store])
    assert isinstance(done.exception, LeewayError)
    assert words in str(done.exception)
    assert list(tmp_path.iterdir()) == []


def test_a_base_map_is_served_by_ranges(tmp_path: Path, site: MapSite):
    """RFC 9110, 14.2: what PMTiles readers ask for."""
    town = tmp_path / "town.pmtiles"
    town.write_bytes(bytes(range(256)) * 100)
    server = MapServer("127.0.0.1", 0)
    answers = MapDataSources(
        site.decode_bytes.stream,
        site.decode_bytes.margin_history_of,
        site.decode_bytes.reachable_area_boundary,
        town,
    )
    server.start_serving(answers)
    try:
        address = f"http://127.0.0.1:{server.port}/basemap.pmtiles"
        part = httpx.get(address, headers={"Range": "bytes=300-309"})
        assert (part.status_code, part.content) == (206, bytes(range(44, 54)))
    finally:
        server.close()
    assert status_of(f"{site.address}/basemap.pmtiles") == 404
