"""What attacks share: a network whose router is the attacker's, what is heard on it, forgeries."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

from companion.fleet.envelope import read_envelope
from companion.fleet.messages import Command, Refused, Result, SetLimits, State, encode
from companion.fleet.topics import VehicleKeys
from companion.fleet.trust import SignedCommand, Trust
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import CommandAnswered, FleetInput, StateReceived
from tests.fleet.secure_site import SecureSite
from tests.fleet.zenoh_net import CELL, FLEET, Vehicle, config_file, free_port

PATIENCE_S = 20.0
KEPT_OUT_S = 1.5
"""Who is let in is in within 0.3 s here."""

GUARD = pytest.mark.parametrize("guarded", [True, False], ids=["refused", "canary: succeeds"])


def trust_of(site: SecureSite, name: str) -> Trust:
    return site.identity(name).trust


def hears(fleet: ZenohFleet, wanted: Callable[[FleetInput], Any], wait_s: float) -> Any:
    limit_s = monotonic_s() + wait_s
    while monotonic_s() < limit_s:
        for heard in fleet.receive(0.05):
            found = wanted(heard)
            if found:
                return found
    return None


def answered(heard: FleetInput) -> CommandAnswered | None:
    return heard if isinstance(heard, CommandAnswered) else None


def limits(vehicle: Vehicle, id_: str = "c1", **more: Any) -> Command:
    port = vehicle.port
    told = {"id": id_, "vehicle": port.vehicle, "life": port.life, "as_of_s": port.uptime_s}
    return Command(**{**told, "by": "desk", "deed": SetLimits(max_loss=0.1), **more})


@dataclass(slots=True)
class Plain:
    """A desk and d1 with identities on a network whose router is the attacker's."""

    site: SecureSite
    desk: ZenohFleet
    d1: Vehicle
    rogue: zenoh.Session

    def put(self, kind: str, raw: bytes, vehicle: str = "d1") -> None:
        """None is dropped on the way: what was put last is what d1 has last."""
        kind = f"track/{CELL}" if kind == "track" else kind
        key = f"leeway/{FLEET}/vehicle/{vehicle}/{kind}"
        self.rogue.put(key, raw, congestion_control=zenoh.CongestionControl.BLOCK)

    def ask(self, payload: bytes) -> Result:
        """What d1 answers to these bytes as a command, once the attacker's line to it stands."""
        key, limit_s = VehicleKeys(FLEET, "d1").command, monotonic_s() + PATIENCE_S
        while monotonic_s() < limit_s:
            for reply in self.rogue.get(key, payload=payload, timeout=PATIENCE_S):
                assert reply.ok is not None
                envelope = read_envelope("result", reply.ok.payload.to_bytes())
                assert not isinstance(envelope, Refused)
                return decoded(envelope.message)
        raise AssertionError("no answer")


def decoded(raw: bytes) -> Result:
    return msgspec.json.decode(raw, type=Result)


def wait_for_listener(session: zenoh.Session, cell: str) -> None:
    """Somebody listens to the tracks of this cell."""
    limit_s = monotonic_s() + PATIENCE_S
    publisher = session.declare_publisher(VehicleKeys(FLEET, "d2").track(cell))
    while not publisher.matching_status.matching:
        assert monotonic_s() < limit_s
    publisher.undeclare()


@contextmanager
def plain_network(site: SecureSite, tmp_path: Path) -> Iterator[Plain]:
    """Desk and d1 on it."""
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
    """The guard taken out: whatever lies in an envelope is believed."""

    def told(self: Trust, kind: str, raw: bytes, speaker: str | None, *_: object) -> bytes:
        envelope = read_envelope(kind, raw)
        assert not isinstance(envelope, Refused)
        return envelope.message

    def commanded(self: Trust, raw: bytes) -> SignedCommand:
        return SignedCommand(told(self, "command", raw, None), "somebody")

    monkeypatch.setattr(Trust, "told", told)
    monkeypatch.setattr(Trust, "commanded", commanded)


def forged_state() -> bytes:
    return encode(
        State(
            vehicle="d1",
            life="forged",
            uptime_s=1.0,
            epoch_us=0,
            airframe="m100",
            max_payload_kg=1.0,
            phase="standby",
            log="l",
            last_seq=0,
        )
    )
