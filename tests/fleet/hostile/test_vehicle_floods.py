"""Floods at a vehicle: what one speaker sends takes the room of none, and costs so much, no more.

The network is a plain one whose router is the attacker's, so that nothing but the vehicle itself is
in his way. Judged by counts, never by speed.
"""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest
import zenoh

from companion.core.base.rate_limit import RateLimit
from companion.fleet import signed_link
from companion.fleet.messages import Command, Recall, encode
from companion.fleet.network import Ask, Asked, Told
from companion.fleet.signed_link import FAILED_BURST, FAILED_HZ, SignedLink
from companion.fleet.topics import VehicleKeys, roster_key
from companion.fleet.waiting_room import WaitingRoom
from companion.fleet.zenoh_link import ASKS_BURST, ASKS_HZ, COMMANDS_WAIT
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
"""Before the desk's command, and as many behind it: more than all boxes together hold."""


@pytest.fixture
def plain(tmp_path) -> Iterator[Plain]:
    with plain_network(SecureSite(tmp_path / "pki"), tmp_path) as made:
        yield made


def one_box_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """The guard taken out: as large as the largest box, and anybody's."""
    put = WaitingRoom.put

    def mixed(self: WaitingRoom, box: str, asked: Asked, most: int, **how: bool) -> None:
        put(self, "all", asked, COMMANDS_WAIT)

    monkeypatch.setattr(WaitingRoom, "put", mixed)


def commands(plain: Plain, count: int) -> None:
    """As a viewer, who may command nobody, with another id each time."""
    otto, key = trust_of(plain.site, "otto"), VehicleKeys(FLEET, "d1").command
    for number in range(count):
        raw = otto.seal("command", encode(limits(plain.d1, f"x{number}")))
        plain.rogue.get(key, lambda reply: None, payload=raw, timeout=PATIENCE_S)


def asks(plain: Plain, count: int) -> None:
    key = f"{VehicleKeys(FLEET, 'd1').event}?after=0"
    for _ in range(count):
        plain.rogue.get(key, lambda reply: None, timeout=PATIENCE_S)


def rosters(plain: Plain, count: int) -> None:
    for number in range(count):
        raw = b"%d" % number + plain.site.identity("d1").roster_file()
        block = zenoh.CongestionControl.BLOCK
        plain.rogue.put(roster_key(FLEET), raw, congestion_control=block)


FLOODS = pytest.mark.parametrize("flood", [commands, rosters], ids=lambda flood: flood.__name__)


@GUARD
@FLOODS
def test_a_flood_behind_the_router_does_not_push_out_the_desks_command(
    plain, monkeypatch, flood, guarded
):
    if not guarded:
        one_box_for_all(monkeypatch)
    d1, room = plain.d1, plain.d1.port.link.link.waiting
    d1.stop()  # one turn, later: all of it has come by then
    came = room.came
    flood(plain, HALF)
    wait_until(lambda: room.came >= came + HALF)
    plain.desk.send(limits(d1, "true"), PATIENCE_S)
    wait_until(lambda: room.came > came + HALF)
    flood(plain, HALF)
    wait_until(lambda: room.came > came + 2 * HALF)
    d1.port.turn(d1.carry_out)
    assert [command.id for command in d1.done] == (["true"] if guarded else [])
    told = hears(plain.desk, answered, PATIENCE_S) if guarded else None
    assert (told is not None and told.result is not None) is guarded


@GUARD
def test_asks_for_events_are_taken_at_a_rate_and_the_desks_command_among_them(
    plain, monkeypatch, guarded
):
    if not guarded:
        monkeypatch.setattr(RateLimit, "take", lambda *_: True)
    d1, room = plain.d1, plain.d1.port.link.link.waiting
    d1.stop()
    began_s, came = monotonic_s(), room.came
    asks(plain, HALF)
    plain.desk.send(limits(d1, "true"), PATIENCE_S)
    wait_until(lambda: any(one.ask is Ask.COMMAND for one in boxed(room)))
    d1.port.turn(d1.carry_out)
    assert [command.id for command in d1.done] == ["true"]
    most = ASKS_BURST + ASKS_HZ * (monotonic_s() - began_s) + 2  # the command, and a roster
    if not guarded:
        wait_until(lambda: room.came - came > HALF)
        most = ASKS_BURST + ASKS_HZ * (monotonic_s() - began_s) + 2
    assert (room.came - came <= most) is guarded


def boxed(room: WaitingRoom) -> list[Asked]:
    return [asked for box in list(room.boxes.values()) for _, asked in tuple(box)]


def wait_until(true: Callable[[], bool]) -> None:
    limit_s, rest = monotonic_s() + PATIENCE_S, threading.Event()
    while not true():
        assert monotonic_s() < limit_s
        rest.wait(0.01)


# --- what a flood in somebody's name costs -------------------------------------------------------


@dataclass
class ByHand:
    """A link whose requests a test puts there; time by hand."""

    waiting: list[Asked] = field(default_factory=list)
    t_s: float = 0.0

    def asked(self) -> list[Asked]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def tracks(self) -> list[Told]:
        return []

    def clock_s(self) -> float:
        return self.t_s


@GUARD
def test_of_ten_thousand_forged_commands_a_second_so_many_are_looked_at_and_anna_is_heard(
    tmp_path, monkeypatch, guarded
):
    if not guarded:
        monkeypatch.setattr(signed_link, "FAILED_HZ", 1e9)
        monkeypatch.setattr(signed_link, "FAILED_BURST", 1e9)
    site, net = SecureSite(tmp_path / "pki"), ByHand()
    link = SignedLink(net, trust_of(site, "d1"), "life", net.clock_s)  # type: ignore[arg-type]
    forger = trust_of(site, "d2")
    forger.name = "desk"
    forged, answers = forger.seal("command", b"{}"), []
    for turn in range(20):
        net.t_s = turn / 100.0
        net.waiting = [Asked(Ask.COMMAND, answers.extend, forged)] * 100
        link.asked()
    looked_at = len(answers)
    assert (looked_at <= FAILED_BURST + 0.2 * FAILED_HZ) is guarded
    true = trust_of(site, "anna").seal("command", ordered())
    net.waiting = [Asked(Ask.COMMAND, answers.extend, true)]
    assert [asked.signer for asked in link.asked() if asked.ask is Ask.COMMAND] == ["anna"]
    net.t_s += 1.0 + 1.0 / FAILED_HZ
    true = trust_of(site, "desk").seal("command", ordered())
    net.waiting = [Asked(Ask.COMMAND, answers.extend, true)]
    assert [asked.signer for asked in link.asked() if asked.ask is Ask.COMMAND] == ["desk"]
    assert link.refusals.total == 2_000


def ordered() -> bytes:
    return encode(Command(id="r", vehicle="d1", life="l", as_of_s=0.0, by="x", deed=Recall()))


def test_events_that_are_asked_for_again_and_again_are_signed_at_a_rate(tmp_path):
    site, net = SecureSite(tmp_path / "pki"), ByHand()
    link = SignedLink(net, trust_of(site, "d1"), "life", net.clock_s)  # type: ignore[arg-type]
    told: list[bytes] = []

    def ask() -> None:
        net.waiting = [Asked(Ask.EVENTS, told.extend)]
        for asked in link.asked():
            if asked.ask is Ask.EVENTS:
                asked.answer([b"event"] * 200)

    for _ in range(50):
        ask()
    assert len(told) == signed_link.TOLD_BURST
    net.t_s = 1.0
    ask()
    assert len(told) == signed_link.TOLD_BURST + 200
