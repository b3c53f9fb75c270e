"""Floods at a vehicle: one sender cannot use the capacity of another, and its cost is bounded.

The network is unprotected and its router is the attacker's, so the vehicle itself is the only
protection. Judged by counts, never by speed.
"""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest
import zenoh

from companion.core.base.rate_limit import RateLimit
from companion.fleet import signed_link
from companion.fleet.messages import Command, Recall, encode_message
from companion.fleet.network import MemberRequest, ReceivedTrack, RequestKind
from companion.fleet.request_queue import MAX_REQUESTS, RequestQueues
from companion.fleet.signed_link import REJECTED_BURST, REJECTED_HZ, SignedLink
from companion.fleet.topics import VehicleKeys, roster_key
from companion.fleet.zenoh_link import EVENT_REQUESTS_BURST, EVENT_REQUESTS_HZ
from ground_station.adapters.clock import monotonic_s
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import (
    GUARD,
    PATIENCE_S,
    Plain,
    answered,
    hears,
    limits,
    plain_network,
    trust_of,
)
from tests.fleet.zenoh_net import FLEET

HALF = 300
"""Requests before the desk's command, and as many after it: more than all inboxes hold."""


@pytest.fixture
def plain(tmp_path) -> Iterator[Plain]:
    with plain_network(SecureSite(tmp_path / "pki"), tmp_path) as made:
        yield made


def one_box_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the guard: all senders share one inbox with the capacity of the largest."""
    put = RequestQueues.add_to_queue_and_call_back

    def mixed(self: RequestQueues, box: str, asked: MemberRequest, most: int, **how: bool) -> None:
        put(self, "all", asked, MAX_REQUESTS[RequestKind.COMMAND])

    monkeypatch.setattr(RequestQueues, "add_to_queue_and_call_back", mixed)


def commands(plain: Plain, count: int) -> None:
    """Send commands as a viewer, which has no right to command, each with a new identifier."""
    otto, key = trust_of(plain.site, "otto"), VehicleKeys(FLEET, "d1").command_key
    for number in range(count):
        raw = otto.sign_in_envelope("command", encode_message(limits(plain.d1, f"x{number}")))
        plain.rogue.get(key, lambda reply: None, payload=raw, timeout=PATIENCE_S)


def asks(plain: Plain, count: int) -> None:
    key = f"{VehicleKeys(FLEET, 'd1').event_key}?after=0"
    for _ in range(count):
        plain.rogue.get(key, lambda reply: None, timeout=PATIENCE_S)


def rosters(plain: Plain, count: int) -> None:
    for number in range(count):
        raw = b"%d" % number + plain.site.identity("d1").read_roster_file()
        block = zenoh.CongestionControl.BLOCK
        plain.rogue.put(roster_key(FLEET), raw, congestion_control=block)


FLOODS = pytest.mark.parametrize("flood", [commands, rosters], ids=lambda flood: flood.__name__)


@pytest.mark.sample
@GUARD
@FLOODS
def test_a_flood_behind_the_router_does_not_push_out_the_desks_command(
    plain, monkeypatch, flood, guarded
):
    if not guarded:
        one_box_for_all(monkeypatch)
    d1, room = plain.d1, plain.d1.port.member.link.link.request_queues
    d1.stop()  # one cycle runs later, when all of it has arrived
    came = room.put_count
    flood(plain, HALF)
    wait_until(lambda: room.put_count >= came + HALF)
    plain.desk.send(limits(d1, "true"), PATIENCE_S)
    wait_until(lambda: room.put_count > came + HALF)
    flood(plain, HALF)
    wait_until(lambda: room.put_count > came + 2 * HALF)
    d1.port.process_commands(d1.carry_out)
    assert [command.id for command in d1.done] == (["true"] if guarded else [])
    told = hears(plain.desk, answered, PATIENCE_S) if guarded else None
    assert (told is not None and told.result is not None) is guarded


@GUARD
def test_asks_for_events_are_taken_at_a_rate_and_the_desks_command_among_them(
    plain, monkeypatch, guarded
):
    if not guarded:
        monkeypatch.setattr(RateLimit, "try_consume_tokens", lambda *_: True)
    d1, room = plain.d1, plain.d1.port.member.link.link.request_queues
    d1.stop()
    began_s, came = monotonic_s(), room.put_count
    asks(plain, HALF)
    plain.desk.send(limits(d1, "true"), PATIENCE_S)
    wait_until(lambda: any(one.kind is RequestKind.COMMAND for one in boxed(room)))
    d1.port.process_commands(d1.carry_out)
    assert [command.id for command in d1.done] == ["true"]
    most = (
        EVENT_REQUESTS_BURST + EVENT_REQUESTS_HZ * (monotonic_s() - began_s) + 2
    )  # the command and a roster
    if not guarded:
        wait_until(lambda: room.put_count - came > HALF)
        most = EVENT_REQUESTS_BURST + EVENT_REQUESTS_HZ * (monotonic_s() - began_s) + 2
    assert (room.put_count - came <= most) is guarded


def boxed(room: RequestQueues) -> list[MemberRequest]:
    return [asked for box in list(room.queues.values()) for _, asked in tuple(box)]


def wait_until(true: Callable[[], bool]) -> None:
    limit_s, rest = monotonic_s() + PATIENCE_S, threading.Event()
    while not true():
        assert monotonic_s() < limit_s
        rest.wait(0.01)


# --- cost of a flood in a member's name ----------------------------------------------------------


@dataclass
class ByHand:
    """A link whose requests and time are set by the test."""

    waiting: list[MemberRequest] = field(default_factory=list)
    t_s: float = 0.0

    def drain_requests(self) -> list[MemberRequest]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def tracks(self) -> list[ReceivedTrack]:
        return []

    def clock_s(self) -> float:
        return self.t_s


@GUARD
def test_of_ten_thousand_forged_commands_a_second_so_many_are_looked_at_and_anna_is_heard(
    tmp_path, monkeypatch, guarded
):
    if not guarded:
        monkeypatch.setattr(signed_link, "REJECTED_HZ", 1e9)
        monkeypatch.setattr(signed_link, "REJECTED_BURST", 1e9)
    site, net = SecureSite(tmp_path / "pki"), ByHand()
    link = SignedLink(net, trust_of(site, "d1"), "life", net.clock_s)  # type: ignore[arg-type]
    forger = trust_of(site, "d2")
    forger.name = "desk"
    forged, answers = forger.sign_in_envelope("command", b"{}"), []
    for turn in range(20):
        net.t_s = turn / 100.0
        net.waiting = [MemberRequest(RequestKind.COMMAND, answers.extend, forged)] * 100
        link.drain_requests()
    looked_at = len(answers)
    assert (looked_at <= REJECTED_BURST + 0.2 * REJECTED_HZ) is guarded
    true = trust_of(site, "anna").sign_in_envelope("command", ordered())
    net.waiting = [MemberRequest(RequestKind.COMMAND, answers.extend, true)]
    assert [
        asked.signer for asked in link.drain_requests() if asked.kind is RequestKind.COMMAND
    ] == ["anna"]
    net.t_s += 1.0 + 1.0 / REJECTED_HZ
    true = trust_of(site, "desk").sign_in_envelope("command", ordered())
    net.waiting = [MemberRequest(RequestKind.COMMAND, answers.extend, true)]
    assert [
        asked.signer for asked in link.drain_requests() if asked.kind is RequestKind.COMMAND
    ] == ["desk"]
    assert link.rejections.total == 2_000


def ordered() -> bytes:
    return encode_message(
        Command(id="r", vehicle="d1", instance_id="l", as_of_s=0.0, by="x", action=Recall())
    )


def test_events_that_are_asked_for_again_and_again_are_signed_at_a_rate(tmp_path):
    site, net = SecureSite(tmp_path / "pki"), ByHand()
    link = SignedLink(net, trust_of(site, "d1"), "life", net.clock_s)  # type: ignore[arg-type]
    told: list[bytes] = []

    def ask() -> None:
        net.waiting = [MemberRequest(RequestKind.EVENTS, told.extend)]
        for asked in link.drain_requests():
            if asked.kind is RequestKind.EVENTS:
                asked.reply([b"event"] * 200)

    for _ in range(50):
        ask()
    assert len(told) == signed_link.EVENT_REPLY_BURST
    net.t_s = 1.0
    ask()
    assert len(told) == signed_link.EVENT_REPLY_BURST + 200
