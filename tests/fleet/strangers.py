"""Shared parts of attack tests: a network with the attacker's router, receivers and forgeries."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

from companion.fleet.envelope import decode_envelope
from companion.fleet.messages import Command, Refused, Result, SetLimits, encode_message
from companion.fleet.topics import VehicleKeys
from companion.fleet.trust import MemberTrust, SignedCommand
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import CommandResponse, FleetInput, StateReceived
from tests.fleet.secure_site import SecureSite
from tests.fleet.zenoh_net import CELL, FLEET, Vehicle, config_file, free_port
from tests.ground_station.desk_parts import a_state

PATIENCE_S = 20.0
KEPT_OUT_S = 1.5
"""An accepted member connects within 0.3 s here."""

GUARD = pytest.mark.parametrize("guarded", [True, False], ids=["refused", "canary: succeeds"])


def trust_of(site: SecureSite, name: str) -> MemberTrust:
    return site.identity(name).trust


def hears(fleet: ZenohFleet, wanted: Callable[[FleetInput], Any], wait_s: float) -> Any:
    limit_s = monotonic_s() + wait_s
    while monotonic_s() < limit_s:
        for heard in fleet.receive(0.05):
            found = wanted(heard)
            if found:
                return found
    return None


def answered(heard: FleetInput) -> CommandResponse | None:
    return heard if isinstance(heard, CommandResponse) else None


def limits(vehicle: Vehicle, id_: str = "c1", **more: Any) -> Command:
    port = vehicle.port
    told = {
        "id": id_,
        "vehicle": port.member.vehicle,
        "instance_id": port.member.instance_id,
        "as_of_s": port.member.uptime_s,
    }
    return Command(**{**told, "by": "desk", "action": SetLimits(max_loss=0.1), **more})


@dataclass(slots=True)
class Plain:
    """A desk and d1 with identities on a network whose router is the attacker's."""

    site: SecureSite
    desk: ZenohFleet
    d1: Vehicle
    rogue: zenoh.Session

    def put(self, kind: str, raw: bytes, vehicle: str = "d1") -> None:
        """Publish without drops: the last message published is the last that d1 receives."""
        kind = f"track/{CELL}" if kind == "track" else kind
        key = f"leeway/{FLEET}/vehicle/{vehicle}/{kind}"
        self.rogue.put(key, raw, congestion_control=zenoh.CongestionControl.BLOCK)

    def ask(self, payload: bytes) -> Result:
        """Return d1's reply to these bytes as a command, once the attacker is connected to it."""
        key, limit_s = VehicleKeys(FLEET, "d1").command_key, monotonic_s() + PATIENCE_S
        while monotonic_s() < limit_s:
            for reply in self.rogue.get(key, payload=payload, timeout=PATIENCE_S):
                assert reply.ok is not None
                envelope = decode_envelope("result", reply.ok.payload.to_bytes())
                assert not isinstance(envelope, Refused)
                return decoded(envelope.message)
        raise AssertionError("no answer")


def decoded(raw: bytes) -> Result:
    return msgspec.json.decode(raw, type=Result)


def wait_for_listener(session: zenoh.Session, cell: str) -> None:
    """Wait for a subscriber to the tracks of this cell."""
    limit_s = monotonic_s() + PATIENCE_S
    publisher = session.declare_publisher(VehicleKeys(FLEET, "d2").track_key(cell))
    while not publisher.matching_status.matching:
        assert monotonic_s() < limit_s
    publisher.undeclare()


@contextmanager
def plain_network(site: SecureSite, tmp_path: Path) -> Iterator[Plain]:
    """Start a desk and d1 on a network with the attacker's router."""
    port = free_port()
    router = {"mode": "router", "scouting": {"multicast": {"enabled": False}, "delay": 0}}
    router["listen"] = {"endpoints": [f"tcp/127.0.0.1:{port}"]}
    client = config_file(tmp_path / "client.json5", connect=port, mode="client", listen=None)
    rogue = zenoh.open(zenoh.Config.from_json5(json.dumps(router)))
    desk = site.person("desk", client)
    d1 = site.vehicle("d1", tmp_path / "d1", zenoh=client)
    assert hears(desk, lambda h: isinstance(h, StateReceived), PATIENCE_S)
    wait_for_listener(rogue, CELL)
    try:
        yield Plain(site, desk, d1, rogue)
    finally:
        d1.close()
        desk.close()
        rogue.close()


def believe_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the guard: the content of every envelope is accepted."""

    def told(self: MemberTrust, kind: str, raw: bytes, speaker: str | None, *_: object) -> bytes:
        envelope = decode_envelope(kind, raw)
        assert not isinstance(envelope, Refused)
        return envelope.message

    def commanded(self: MemberTrust, raw: bytes) -> SignedCommand:
        return SignedCommand(told(self, "command", raw, None), "somebody")

    monkeypatch.setattr(MemberTrust, "verify_message_of_signer", told)
    monkeypatch.setattr(MemberTrust, "verify_command", commanded)
    monkeypatch.setattr(MemberTrust, "authority_error_or_empty", lambda *_: "")


def forged_state() -> bytes:
    return encode_message(a_state(instance_id="forged", uptime_s=1.0))
