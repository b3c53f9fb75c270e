"""Signing keys are set on both simulated autopilots, which then reject unsigned commands."""

import stat
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.adapters.autopilots.codec import MavlinkCodec, mavlink
from companion.adapters.autopilots.link import Incoming
from companion.app.tools.provision_signing import Provisioning, read_or_create_key
from companion.core.base.errors import LeewayError
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mavlink.codec import Encoder, Message
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from sim_bridge.autopilot.mavlink.signing import SignatureCheck, Signing
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import WindField
from tests.sim_bridge.autopilot.conftest import HOME, M100, PARAMS, steady_wind

KINDS = (AutopilotKind.PX4, AutopilotKind.ARDUPILOT)


class World:
    """A link to a simulated autopilot on its pad: each wait is 0.1 s of its time."""

    datagrams = True
    rejected_packets = 0

    def __init__(self, kind: AutopilotKind) -> None:
        still = WindField(steady_wind(0.0, 0.0))
        self.vehicle = Vehicle(M100, still, np.random.default_rng(1), depot_alt_amsl_m=HOME[2])
        parameters = read_parameters(PARAMS / "autopilots" / f"{kind.value}.toml")
        self.ap = Autopilot(kind, HOME, parameters, boot_age_s=60.0)
        self.ap.add_link(0)
        self.t_s = 0.0
        self.sent: list[bytes] = []
        self._waiting: deque[bytes] = deque()

    def receive(self, timeout_s: float) -> Incoming | None:
        if not self._waiting:
            self.pass_time(timeout_s)
        return Incoming(self._waiting.popleft()) if self._waiting else None

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.ap.process_readings(
                self.vehicle.advance_and_read_sensors(self.ap.actuation, 0.01), 0.01
            )
        self.t_s += seconds
        self._waiting.extend(data for _, data in self.ap.take_frames_to_send())

    def send(self, data: bytes) -> None:
        self.sent.append(data)
        self.ap.process_received_datagram(0, data)

    def acknowledged(self, order: bytes) -> bool:
        """Return True if the autopilot acknowledges the order."""
        self.ap.take_frames_to_send()
        self.ap.process_received_datagram(0, order)
        ear = MavlinkCodec(datagrams=True)
        heard = [
            m for _, data in self.ap.take_frames_to_send() for m in ear.parse_valid_messages(data)
        ]
        return any(m.get_type() == "COMMAND_ACK" for m in heard)

    def clock_s(self) -> float:
        return self.t_s

    def queued_chunk_count(self) -> int:
        return 0

    def wait_until_arrived_data_queued(self) -> None: ...
    def interrupt_receive(self) -> None: ...
    def set_reply_peer(self, peer: Any) -> None: ...
    def close(self) -> None: ...


KEY = bytes(range(32))


def order(signing: Signing | None) -> bytes:
    """A ground station's order: return to launch."""
    encoder = Encoder(255, 190, signing=None if signing is None else signing.link_signer(7))
    fields = {f"param{n}": 0.0 for n in range(1, 8)}
    return encoder.encode_next_frame(
        Message(
            "COMMAND_LONG", target_system=1, target_component=1, command=20, confirmation=0,
            **fields,
        )
    )  # fmt: skip


def provisioned(kind: AutopilotKind) -> tuple[World, int]:
    """Return the world after provisioning, and the time of the key's clock."""
    world = World(kind)
    assert Provisioning(world, world.clock_s).send_signing_key_and_verify(KEY) == 1
    codec = MavlinkCodec(datagrams=True, signing_key=KEY)
    return world, codec.mav.signing.timestamp


@pytest.mark.parametrize("kind", KINDS)
def test_a_key_that_is_handed_over_is_the_one_that_the_autopilot_signs_with(kind):
    world, _ = provisioned(kind)
    world.pass_time(1.0)
    right, wrong = (MavlinkCodec(datagrams=True, signing_key=k) for k in (KEY, bytes(32)))
    frames = [world.receive(0.1) for _ in range(20)]
    assert any(right.parse_valid_messages(frame.data) for frame in frames if frame is not None)
    assert not any(wrong.parse_valid_messages(frame.data) for frame in frames if frame is not None)


@pytest.mark.parametrize("kind", KINDS)
def test_then_unsigned_replayed_and_re_signed_orders_reach_nobody(kind):
    world, now = provisioned(kind)
    true = order(Signing(KEY, now + 1000))
    assert not world.acknowledged(order(None)), "unsigned"
    assert not world.acknowledged(order(Signing(bytes(32), now + 1000))), "signed by another key"
    assert world.acknowledged(true)
    assert not world.acknowledged(true), "replayed"


def believes_any_key(self: Signing, frame: bytes) -> SignatureCheck:
    return SignatureCheck.ACCEPTED


def believes_any_time(self: Signing, frame: bytes) -> SignatureCheck:
    self._latest_timestamps.clear()
    return CHECK(self, frame)


CHECK = Signing.check


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("check", [believes_any_key, believes_any_time])
def test_canary_an_autopilot_that_looks_at_no_key_or_keeps_no_time_obeys(kind, check, monkeypatch):
    world, now = provisioned(kind)
    monkeypatch.setattr(Signing, "check", check)
    key = KEY if check is believes_any_time else bytes(32)
    forged = order(Signing(key, now + 1000))
    assert world.acknowledged(forged)
    if check is believes_any_time:
        assert world.acknowledged(forged), "a replay"


@pytest.mark.parametrize("kind", KINDS)
def test_canary_before_a_key_is_given_anybodys_order_is_answered(kind):
    world = World(kind)
    world.pass_time(0.1)
    assert world.acknowledged(order(None))


def test_the_key_leaves_once_it_is_known_to_whom_and_never_to_an_armed_vehicle():
    world = World(AutopilotKind.ARDUPILOT)
    world.ap.state.is_armed = True
    with pytest.raises(LeewayError, match="armed"):
        Provisioning(world, world.clock_s).send_signing_key_and_verify(KEY)
    heard = [
        m for data in world.sent for m in MavlinkCodec(datagrams=True).parse_valid_messages(data)
    ]
    assert {m.get_type() for m in heard} == {"HEARTBEAT"}


def test_an_autopilot_that_takes_no_key_is_told_of(monkeypatch):
    world = World(AutopilotKind.PX4)
    monkeypatch.setattr(type(world.ap.radio), "enable_signing", lambda *_: None)
    with pytest.raises(LeewayError, match="did not begin to sign"):
        Provisioning(world, world.clock_s).send_signing_key_and_verify(KEY)


def test_what_the_companion_relays_is_nothing_and_what_it_signs_is_its_own():
    """A stranger's incoming frame is never relayed with the companion's signature."""
    codec = MavlinkCodec(datagrams=True, signing_key=KEY)
    assert codec.parse_valid_messages(order(None)) == []
    beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3)
    (own,) = MavlinkCodec(datagrams=True).parse_valid_messages(codec.pack(beat))
    assert (own.get_srcSystem(), own.get_srcComponent()) == (1, 191)


def test_a_key_is_made_once_at_random_for_its_owner_only(tmp_path: Path):
    path = tmp_path / "key"
    key, is_new = read_or_create_key(path)
    assert (is_new, len(key)) == (True, 32)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert read_or_create_key(path) == (key, False)
    assert read_or_create_key(tmp_path / "other")[0] != key
