"""A simulated autopilot on a simulated vehicle, driven frame by frame without sockets."""

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.kinds import AutopilotKind, LinkKind
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from sim_bridge.autopilot.mavlink.message_table import SPECS
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import SteadyWind, WindField

PARAMS = Path(__file__).resolve().parents[3] / "params"
HOME = (55.47, 8.45, 12.0)
GCS = (255, 190)
COMPANION = (1, 191)
M100 = load_airframe(PARAMS / "truth" / "m100.toml")


def steady_wind(to_north_mps: float, to_east_mps: float) -> SteadyWind:
    """Return a wind by its direction of flow; the world's class takes the direction of origin."""
    from_deg = math.degrees(math.atan2(-to_east_mps, -to_north_mps)) % 360.0
    return SteadyWind(math.hypot(to_north_mps, to_east_mps), from_deg)


class Rig:
    """One vehicle with its autopilot and a client on link 0."""

    DT_S = 0.02

    def __init__(
        self,
        autopilot: AutopilotKind,
        settings: dict[str, float] | None = None,
        *,
        wind_to_ne_mps: tuple[float, float] = (0.0, 0.0),
        payload_kg: float = 0.0,
        pitot: bool = False,
        link: LinkKind = LinkKind.ONBOARD,
        **options: Any,
    ) -> None:
        self.vehicle = Vehicle(
            M100,
            WindField(steady_wind(*wind_to_ne_mps)),
            np.random.default_rng(1),
            depot_alt_amsl_m=HOME[2],
            payload_kg=payload_kg,
            pitot=pitot,
        )
        path = PARAMS / "autopilots" / f"{autopilot.value}.toml"
        options.setdefault("boot_age_s", 60.0)
        parameters = read_parameters(path, settings)
        self.ap = Autopilot(autopilot, HOME, parameters, **options)
        self.ap.add_link(0, link)
        self.autopilot = autopilot
        self.heard: list[Message] = []
        self._encoder = Encoder(*GCS)
        self._decoder = Decoder()

    # --- talking ------------------------------------------------------------------------------

    def send(self, name: str, *, sender: tuple[int, int] = GCS, **fields: Any) -> None:
        """Send one message; targets default to the autopilot."""
        for key, value in (("target_system", 1), ("target_component", 1)):
            if key not in fields and key in _fields_of(name):
                fields[key] = value
        encoder = Encoder(*sender) if sender != GCS else self._encoder
        self.ap.process_received_datagram(0, encoder.encode_next_frame(Message(name, **fields)))

    def hear(self) -> list[Message]:
        """Return the messages sent since the last call; all of them are kept."""
        new = []
        for link_id, datagram in self.ap.take_frames_to_send():
            if link_id == 0:
                new += self._decoder.decode_bytes(datagram)
        self.heard += new
        return new

    def all(self, name: str) -> list[Message]:
        """Return all received messages of one type."""
        self.hear()
        return [message for message in self.heard if message.msg_name == name]

    def last(self, name: str) -> Message:
        """Return the latest message of one type."""
        return self.all(name)[-1]

    def forget(self) -> None:
        """Discard the received messages."""
        self.hear()
        self.heard.clear()

    def command(self, number: int, *params: float) -> int:
        """Send COMMAND_LONG; return the result of its acknowledgement, -1 if there is none."""
        padded = (*params, *(0.0,) * (7 - len(params)))
        fields = {f"param{i + 1}": float(value) for i, value in enumerate(padded)}
        self.forget()
        self.send("COMMAND_LONG", command=number, confirmation=0, **fields)
        return self._result(number)

    def send_command_int_and_wait_ack(
        self, number: int, frame: int, north_m: float, east_m: float, z: float, *params: float
    ) -> int:
        """Send COMMAND_INT with a position; return the result."""
        padded = (*params, *(0.0,) * (4 - len(params)))
        self.forget()
        self.send(
            "COMMAND_INT",
            frame=frame,
            command=number,
            current=0,
            autocontinue=0,
            **{f"param{i + 1}": float(value) for i, value in enumerate(padded)},
            **self.at(north_m, east_m),
            z=z,
        )
        return self._result(number)

    def _result(self, number: int) -> int:
        acks = [m for m in self.hear() if m.msg_name == "COMMAND_ACK" and m.command == number]
        return acks[-1].result if acks else -1

    def set_mode(self, mode: Mode) -> int:
        """Send DO_SET_MODE with the autopilot's own mode numbers."""
        if self.autopilot is AutopilotKind.PX4:
            main, sub = _PX4[mode]
            return self.command(176, 1, main, sub)
        return self.command(176, 1, _ARDUPILOT[mode])

    def gcs_heartbeat(self) -> None:
        """Send the heartbeat of a ground station."""
        self.send("HEARTBEAT", type=6, autopilot=8, base_mode=0, custom_mode=0, system_status=4)

    def companion_heartbeat(self) -> None:
        """Send the heartbeat of a companion computer."""
        fields = {"type": 18, "autopilot": 8, "base_mode": 0, "custom_mode": 0, "system_status": 4}
        self.send("HEARTBEAT", sender=COMPANION, **fields)

    def texts(self) -> list[str]:
        """Return all STATUSTEXTs."""
        return [message.text for message in self.all("STATUSTEXT")]

    # --- missions -----------------------------------------------------------------------------

    def at(self, north_m: float, east_m: float) -> dict[str, int]:
        """Return x and y of a position."""
        lat, lon = self.ap.state.frame.to_lat_lon_deg(north_m, east_m)
        return {"x": round(lat * 1e7), "y": round(lon * 1e7)}

    def place(self, command: int, n: float, e: float, up: float, **more: Any) -> dict[str, Any]:
        """Return an item with a position, relative to home."""
        return {"command": command, "frame": 6, **self.at(n, e), "z": float(up), **more}

    def upload(self, items: list[dict[str, Any]], mission_type: int = 0) -> int:
        """Upload by the protocol, item by item as requested; return the MISSION_ACK's type.

        For ArduPilot a home item is put in front of a mission: number n becomes n + 1.
        """
        if self.autopilot is AutopilotKind.ARDUPILOT and mission_type == 0:
            items = [{"command": 16, "frame": 0}, *items]
        self.forget()
        self.send("MISSION_COUNT", count=len(items), mission_type=mission_type)
        for _ in range(2 * len(items) + 2):
            for message in self.hear():
                if message.msg_name in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                    self.send_item(message.seq, items[message.seq], mission_type)
                elif message.msg_name == "MISSION_ACK":
                    return message.type
        raise AssertionError("the upload came to no end")

    def send_item(self, seq: int, item: dict[str, Any], mission_type: int = 0) -> None:
        """Send one MISSION_ITEM_INT."""
        fields = {
            "seq": seq,
            "frame": 6,
            "command": 16,
            "current": 0,
            "autocontinue": 1,
            **dict.fromkeys(("param1", "param2", "param3", "param4", "z"), 0.0),
            "x": 0,
            "y": 0,
            "mission_type": mission_type,
        }
        self.send("MISSION_ITEM_INT", **{**fields, **item})

    def download(self, mission_type: int = 0) -> list[Message]:
        """Download all items."""
        self.forget()
        self.send("MISSION_REQUEST_LIST", mission_type=mission_type)
        count = self.last("MISSION_COUNT").count
        items = []
        for seq in range(count):
            self.forget()
            self.send("MISSION_REQUEST_INT", seq=seq, mission_type=mission_type)
            items.append(self.last("MISSION_ITEM_INT"))
        self.send("MISSION_ACK", type=0, mission_type=mission_type)
        return items

    # --- flying -------------------------------------------------------------------------------

    def step(self, seconds: float) -> None:
        """Advance the simulation."""
        for _ in range(round(seconds / self.DT_S)):
            readings = self.vehicle.advance_and_read_sensors(self.ap.actuation, self.DT_S)
            self.ap.process_readings(readings, self.DT_S)

    def until(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Advance until a condition holds; return False if it does not hold within the limit."""
        for _ in range(round(limit_s / 0.2)):
            if condition():
                return True
            self.step(0.2)
        return condition()

    @property
    def ne_m(self) -> tuple[float, float]:
        """Return the true position, north and east."""
        return self.vehicle.truth.pos_ned_m[:2]

    @property
    def height_m(self) -> float:
        """Return the true height above the depot."""
        return -self.vehicle.truth.pos_ned_m[2]

    @property
    def speed_mps(self) -> float:
        """Return the true horizontal speed."""
        north, east, _ = self.vehicle.truth.vel_ned_mps
        return float(np.hypot(north, east))

    def take_off(self, height_m: float = 20.0) -> None:
        """Take off into a hover: GUIDED for ArduPilot, HOLD for PX4."""
        self.step(0.2)
        if self.autopilot is AutopilotKind.PX4:
            assert self.command(22, 0, 0, 0, 0, 0, 0, HOME[2] + height_m) == 0
            assert self.command(400, 1) == 0
        else:
            assert self.set_mode(Mode.GUIDED) == 0
            assert self.command(400, 1) == 0
            self.step(2.2)
            assert self.command(22, 0, 0, 0, 0, 0, 0, height_m) == 0
        assert self.until(lambda: self.height_m > height_m - 0.7, 40.0)
        self.step(2.0)


_PX4 = {
    Mode.STABILIZE: (7, 0),
    Mode.ALT_HOLD: (2, 0),
    Mode.LOITER: (3, 0),
    Mode.TAKEOFF: (4, 2),
    Mode.HOLD: (4, 3),
    Mode.AUTO: (4, 4),
    Mode.RTL: (4, 5),
    Mode.LAND: (4, 6),
    Mode.GUIDED: (6, 0),
}
_ARDUPILOT = {
    Mode.STABILIZE: 0,
    Mode.ALT_HOLD: 2,
    Mode.AUTO: 3,
    Mode.GUIDED: 4,
    Mode.LOITER: 5,
    Mode.RTL: 6,
    Mode.LAND: 9,
    Mode.HOLD: 17,
}


def _fields_of(name: str) -> set[str]:
    return {item.name for item in SPECS[name].fields}


@pytest.fixture
def make_rig() -> type[Rig]:
    """Return the rig's class: `make_rig(autopilot, settings, ...)`."""
    return Rig


@pytest.fixture(scope="module")
def make_rig_class() -> type[Rig]:
    """Return the rig's class for property tests, whose fixtures have to outlive an example."""
    return Rig


_AIRBORNE: dict[tuple[AutopilotKind, float], Rig] = {}


@pytest.fixture
def airborne() -> Callable[..., Rig]:
    """Return `airborne(autopilot)`: a rig hovering 20 m over home, a copy of one flown once."""

    def give(
        autopilot: AutopilotKind,
        settings: dict[str, float] | None = None,
        *,
        height_m: float = 20.0,
    ) -> Rig:
        key = (autopilot, height_m)
        if key not in _AIRBORNE:
            rig = Rig(autopilot, payload_kg=0.5)
            rig.gcs_heartbeat()
            rig.take_off(height_m)
            rig.forget()
            _AIRBORNE[key] = rig
        rig = copy.deepcopy(_AIRBORNE[key])
        for name, value in (settings or {}).items():
            rig.ap.params.set(name, value)
        rig.step(0.2)
        rig.forget()
        return rig

    return give
