"""Attacks on the map's server, and on the age of a desk: each with a canary."""

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import pytest
from uvicorn.protocols.http.h11_impl import H11Protocol

from companion.core.base.desk_heartbeat import SILENT_AFTER_S, DeskHeartbeat, DeskMonitor
from companion.fleet.messages import encode_message
from companion.fleet.topics import desk_key
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.web import connections, map_server
from ground_station.adapters.web.map_server import MAX_CONNECTIONS, MapDataSources, MapServer
from ground_station.core.fleet.fleet_link import DeskHeartbeatReceived
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import GUARD, KEPT_OUT_S, PATIENCE_S, hears, plain_network, trust_of
from tests.fleet.zenoh_net import FLEET

CALLS = [2 * MAX_CONNECTIONS, pytest.param(1_000, marks=pytest.mark.night)]
LIMIT_S = 0.5


@pytest.fixture
def held() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def serving(held: ExitStack) -> MapServer:
    server = MapServer("127.0.0.1", 0)
    held.callback(server.close)
    server.start_serving(MapDataSources(map_server.LiveStream(), lambda _: None, lambda _: None))
    return server


def unguarded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_server, "limited_protocol", lambda _: H11Protocol)


def call(held: ExitStack, server: MapServer, raw: bytes = b"") -> socket.socket:
    one = held.enter_context(socket.create_connection(("127.0.0.1", server.port)))
    one.settimeout(PATIENCE_S)
    one.sendall(raw)
    return one


@pytest.mark.parametrize("calls", CALLS)
@GUARD
def test_idle_connections_refuse_nobody(held, monkeypatch, calls, guarded):
    if not guarded:
        unguarded(monkeypatch)
    server = serving(held)
    for _ in range(calls):
        call(held, server)
    status = httpx.get(f"{server.address}/healthz", timeout=PATIENCE_S).status_code
    assert status == (200 if guarded else 503)


UNFINISHED = {
    "nothing": b"",
    "half a request": b"GET / HTTP/1.1\r\nHost: ",
    "half a body": b"POST /commands HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n{",
}


@pytest.mark.parametrize("raw", UNFINISHED.values(), ids=UNFINISHED)
@GUARD
def test_a_request_that_never_ends_is_ended(held, monkeypatch, raw, guarded):
    monkeypatch.setattr(connections, "REQUEST_TIMEOUT_S", LIMIT_S)
    if not guarded:
        unguarded(monkeypatch)
    one = call(held, serving(held), raw)
    one.settimeout(3.0 * LIMIT_S)
    try:
        while one.recv(1000):
            pass
        ended = True
    except ConnectionResetError:
        ended = True
    except TimeoutError:
        ended = False
    assert ended is guarded


def test_a_trickle_of_bytes_does_not_move_the_limit(held, monkeypatch):
    monkeypatch.setattr(connections, "REQUEST_TIMEOUT_S", LIMIT_S)
    one, began_s = call(held, serving(held), b"GET /"), monotonic_s()
    with suppress(ConnectionError):
        while monotonic_s() - began_s < PATIENCE_S:
            one.sendall(b"x")
            time.sleep(0.05)
    assert monotonic_s() - began_s < 6.0 * LIMIT_S


def test_health_readiness_and_missing_assets_are_answered_without_an_error(
    held, monkeypatch, tmp_path: Path
):
    monkeypatch.setattr(map_server, "ASSETS", tmp_path / "not-fetched")
    server = MapServer("127.0.0.1", 0)
    held.callback(server.close)
    stream = map_server.LiveStream()
    server.start_serving(MapDataSources(stream, lambda _: None, lambda _: None))

    def status(path: str) -> int:
        return httpx.get(server.address + path, timeout=PATIENCE_S).status_code

    assert [status("/healthz"), status("/readyz"), status("/assets/x.js")] == [200, 503, 404]
    stream.publish({}, map_server.epoch_us())
    assert status("/readyz") == 200
    stream.publish({}, map_server.epoch_us() - 6_000_000)
    assert status("/readyz") == 503


# --- the desk's heartbeat ------------------------------------------------------------------------


def heartbeat(uptime_s: float, desk: str = "desk") -> DeskHeartbeat:
    return DeskHeartbeat(desk=desk, instance_id="a0", uptime_s=uptime_s, epoch_us=0)


@GUARD
def test_a_repeated_heartbeat_does_not_hide_a_dead_desk(guarded):
    monitor = DeskMonitor()
    monitor.record_heartbeat(heartbeat(5.0), 0.0)
    assert monitor.alarm_text(1.0) == ""
    for t_s in range(1, 11):
        repeated = heartbeat(5.0 if guarded else 5.0 + t_s)  # canary: its uptime advances
        monitor.record_heartbeat(repeated, float(t_s))
    assert monitor.alarm_text(10.0) == ("no heartbeat of desk for 10 s" if guarded else "")
    assert SILENT_AFTER_S < 10.0


def test_a_delayed_heartbeat_is_late():
    monitor = DeskMonitor()
    monitor.record_heartbeat(heartbeat(5.0), 0.0, 60_000_000)
    assert monitor.alarm_text(0.0) == "heartbeat of desk is 60 s late, or a clock is wrong"


@GUARD
def test_a_heartbeat_that_a_vehicle_signs_counts_neither_at_a_desk_nor_at_a_vehicle(
    tmp_path, monkeypatch, guarded
):
    site = SecureSite(tmp_path / "pki")
    forged = encode_message(heartbeat(1e6))
    author = trust_of(site, "d2" if guarded else "desk")
    with plain_network(site, tmp_path) as plain:
        raw = author.sign_in_envelope("desk", forged)

        def put(heard: object) -> bool:
            plain.rogue.put(desk_key(FLEET, "desk"), raw)
            return isinstance(heard, DeskHeartbeatReceived)

        counted = hears(plain.desk, put, KEPT_OUT_S if guarded else PATIENCE_S)
        assert bool(counted) is not guarded
        assert (plain.d1.port.member.desks.received_s is None) is guarded


def test_a_vehicle_says_once_that_its_desk_is_silent_and_that_it_is_back(tmp_path):
    site = SecureSite(tmp_path / "pki")
    with plain_network(site, tmp_path) as plain:
        plain.d1.stop()
        port, member = plain.d1.port, plain.d1.port.member
        now_s = [member.clock_s()]
        member.clock_s = lambda: now_s[0]
        member.desks.record_heartbeat(heartbeat(1.0), now_s[0])
        for _ in range(20):
            now_s[0] += 1.0
            port.process_commands(plain.d1.carry_out)
        member.desks.record_heartbeat(heartbeat(2.0), now_s[0])
        port.process_commands(plain.d1.carry_out)
        texts = [event.text for event in member.log.next_stored_events_after(0)]
    assert [text for text in texts if "desk" in text] == [
        "no heartbeat of desk for 9 s",
        "desk is received again",
    ]
