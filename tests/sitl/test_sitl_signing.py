"""Signing on, in both flavours: a signed flight beside a forger who lacks the key."""

import contextlib
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import pytest

from sim_bridge.app.serve import Host, Served, stand_up
from sim_bridge.autopilot.codec import Encoder, Message
from sim_bridge.autopilot.flavour import Flavour
from sim_bridge.autopilot.parameters import read_parameters
from sim_bridge.autopilot.signing import Signing
from sim_bridge.truth.params import load_airframe

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(280)]

PARAMS = Path(__file__).parents[2] / "params"
COMMAND = Path(sys.executable).with_name("companion")
KEY = bytes(range(32))
SPEEDUP = 3.0
SIGNING_EPOCH_S = 1_420_070_400  # 2015-01-01, mavlink.io/en/guide/message_signing.html
RTL = {"px4": (4, 5), "ardupilot": (6, 0)}


@dataclass
class Relay:
    """The wire between vehicle and companion, with a forger on it who lacks the key.

    To the companion it says, as the autopilot, that the mode is RTL and the mission another; to
    the autopilot, as the companion, to return to launch and to clear the mission.
    """

    flavour: str
    forged: int = 0
    _companion: socket.socket = field(init=False)
    _vehicle: socket.socket = field(init=False)
    _stop: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self._companion, self._vehicle = _bound(), _bound()
        self._to_companion: tuple[str, int] | None = None
        self._to_vehicle: tuple[str, int] | None = None

    def ports(self) -> tuple[int, int]:
        """Where the companion calls, and where the vehicle does."""
        return self._companion.getsockname()[1], self._vehicle.getsockname()[1]

    @contextlib.contextmanager
    def running(self):
        threads = [threading.Thread(target=work) for work in (self._up, self._down, self._forge)]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self._stop.set()
            for thread in threads:
                thread.join()
            self._companion.close()
            self._vehicle.close()

    def _up(self) -> None:
        for data, peer in self._heard(self._companion):
            self._to_companion = peer
            if self._to_vehicle is not None:
                self._vehicle.sendto(data, self._to_vehicle)

    def _down(self) -> None:
        for data, peer in self._heard(self._vehicle):
            self._to_vehicle = peer
            if self._to_companion is not None:
                self._companion.sendto(data, self._to_companion)

    def _heard(self, wire: socket.socket):
        while not self._stop.is_set():
            with contextlib.suppress(TimeoutError):
                yield wire.recvfrom(65536)

    def _forge(self) -> None:
        """Every tenth of a second, in both directions."""
        autopilot, companion = Encoder(1, 1), Encoder(1, 191)
        main, sub = RTL[self.flavour]
        custom = main << 16 | sub << 24 if self.flavour == "px4" else main
        while not self._stop.wait(0.1):
            lie = _heartbeat(12 if self.flavour == "px4" else 3, custom)
            another = Message("MISSION_CURRENT", seq=1, total=3)
            if self._to_companion is not None:
                self._companion.sendto(autopilot.encode(lie), self._to_companion)
                self._companion.sendto(autopilot.encode(another), self._to_companion)
            if self._to_vehicle is not None:
                order = _long(176, 1.0, float(main), float(sub))
                clear = Message("MISSION_CLEAR_ALL", target_system=1, target_component=1)
                self._vehicle.sendto(companion.encode(order), self._to_vehicle)
                self._vehicle.sendto(companion.encode(clear), self._to_vehicle)
                self.forged += 1


def _bound() -> socket.socket:
    wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    wire.bind(("127.0.0.1", 0))
    wire.settimeout(0.1)
    return wire


def _heartbeat(autopilot: int, custom: int) -> Message:
    return Message(
        "HEARTBEAT",
        type=2,
        autopilot=autopilot,
        base_mode=129,
        custom_mode=custom,
        system_status=4,
        mavlink_version=3,
    )


def _long(command: int, *params: float) -> Message:
    full = (*params, *(0.0,) * (7 - len(params)))
    return Message(
        "COMMAND_LONG",
        target_system=1,
        target_component=1,
        command=command,
        confirmation=0,
        **{f"param{k + 1}": value for k, value in enumerate(full)},
    )


def stand(flavour: str) -> Served:
    parameters = read_parameters(PARAMS / "autopilots" / f"{flavour}.toml")
    airframe = load_airframe(PARAMS / "truth" / "m100.toml")
    return stand_up(Flavour(flavour), airframe, parameters, payload_kg=0.5, charge_frac=0.8)


def fly(flavour: str, tmp_path: Path, table: dict, *, signed: bool) -> tuple[Served, Relay, str]:
    """Fly the short flight beside the forger; the vehicle afterwards, and what was said."""
    served, relay = stand(flavour), Relay(flavour)
    mission, key = tmp_path / "flight.toml", tmp_path / "key"
    mission.write_bytes(msgspec.toml.encode(table))
    key.write_bytes(KEY)
    at_companion, at_vehicle = relay.ports()
    stamp = int((time.time() - SIGNING_EPOCH_S) * 1e5)
    signing = Signing(KEY, stamp).on_link(0) if signed else None
    command = [str(COMMAND), "run", f"--link=udpout:127.0.0.1:{at_companion}"]
    command += [f"--mission={mission}", f"--run-dir={tmp_path / 'run'}"]
    command += ["--configure", "--authorise"]
    command += [f"--signing-key={key}"] if signed else []
    with Host(SPEEDUP) as host:
        host.add(served, onboard=[f"udpout:127.0.0.1:{at_vehicle}"], signing=signing)
        with host.running(), relay.running():
            done = subprocess.run(command, capture_output=True, text=True, timeout=230, check=False)
    return served, relay, done.stdout + done.stderr


@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_signed_it_delivers_whatever_a_forger_without_the_key_says(flavour, tmp_path, short_flight):
    served, relay, said = fly(flavour, tmp_path, short_flight({}), signed=True)
    assert relay.forged > 50
    assert "finished: SUC" in said, said
    assert not served.truth.parcel_aboard
    assert not served.truth.airborne
    assert not served.truth.crashed


def test_the_check_fails_where_nothing_is_signed(tmp_path, short_flight):
    # The very same forger is believed by both ends: the flight does not get anywhere.
    _, relay, said = fly("px4", tmp_path, short_flight({}), signed=False)
    assert relay.forged > 0
    assert "finished: SUC" not in said, said
