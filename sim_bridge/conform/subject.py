"""The vehicle under test: brought into a known state before each behaviour, and left as it was."""

import contextlib
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.client import Client, Message
from sim_bridge.conform.dialect import PX4, Dialect, dialect_of
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.missions import Item, Uploaded

HEIGHT_M = 20.0
_EARTH_RADIUS_M = 6_371_000.0
_FORCE_DISARM = 21196.0
_NEAR_M = 60.0
_READY_S = 90.0
_INTEGER_TYPES = {
    mavlink.MAV_PARAM_TYPE_INT8: "<b",
    mavlink.MAV_PARAM_TYPE_UINT8: "<B",
    mavlink.MAV_PARAM_TYPE_INT16: "<h",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
}
WORKING_HZ = {
    "GLOBAL_POSITION_INT": 10.0,
    "LOCAL_POSITION_NED": 10.0,
    "ATTITUDE": 5.0,
    "VFR_HUD": 5.0,
    "EXTENDED_SYS_STATE": 5.0,
    "SYS_STATUS": 2.0,
    "BATTERY_STATUS": 2.0,
    "MISSION_CURRENT": 2.0,
    "HOME_POSITION": 1.0,
    "RC_CHANNELS": 5.0,
}
"""What the suite asks for to see by, once the unasked telemetry has been looked at."""


_NEWER_MESSAGES = {"CURRENT_MODE": 436}
"""Messages of the common set that pymavlink's older releases do not have."""


def message_id(name: str) -> int:
    """The number of a message."""
    return _NEWER_MESSAGES.get(name) or getattr(mavlink, f"MAVLINK_MSG_ID_{name}")


@dataclass(frozen=True, slots=True)
class Position:
    """GLOBAL_POSITION_INT in degrees and metres; velocity NED over ground."""

    lat_deg: float
    lon_deg: float
    amsl_m: float
    rel_m: float
    vel_ned_mps: tuple[float, float, float]

    @property
    def speed_mps(self) -> float:
        """Horizontal ground speed."""
        return math.hypot(*self.vel_ned_mps[:2])


class Subject:
    """A vehicle, by its client: what it is, where it is, and the way back to a known state."""

    def __init__(self, client: Client, *, may_force: bool) -> None:
        self.client = client
        beat = client.find()
        self.dialect: Dialect = dialect_of(beat.autopilot)
        self.home: Position | None = None
        self.climbed: tuple[float, Position] | None = None
        """The altitude that the last take-off to HEIGHT_M asked for, and where it ended."""
        self.memory: dict[str, object] = {}
        """What one behaviour has seen and others ask about too."""
        self._may_force = may_force
        self._asked: set[str] = set()
        self._sees = False
        self._originals: dict[str, tuple[float, int]] = {}

    # --- what it says -------------------------------------------------------------------------

    @property
    def is_px4(self) -> bool:
        """Whether it is PX4."""
        return self.dialect is PX4

    @property
    def mode(self) -> str:
        """The last HEARTBEAT's mode."""
        return self.dialect.mode_name(self.client.latest["HEARTBEAT"].custom_mode)

    @property
    def is_armed(self) -> bool:
        """The last HEARTBEAT's word."""
        flag = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return bool(self.client.latest["HEARTBEAT"].base_mode & flag)

    @property
    def landed_state(self) -> int:
        """EXTENDED_SYS_STATE.landed_state; 0 while unknown."""
        state = self.client.latest.get("EXTENDED_SYS_STATE")
        return 0 if state is None else state.landed_state

    @property
    def is_on_ground(self) -> bool:
        """The autopilot's own word for it."""
        return self.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND

    def beat(self) -> None:
        """Wait for a HEARTBEAT that is newer than all that was said, lag included."""
        self.client.collect(0.2)
        self.client.hear("HEARTBEAT", 3.0)

    def position(self, within_s: float = 5.0) -> Position:
        """Where it is, by a message that is new; 0 N 0 E means that it does not know yet."""
        message = self.client.hear("GLOBAL_POSITION_INT", within_s, _knows_where)
        if message is None:
            raise CannotSee("no GLOBAL_POSITION_INT with a position")
        return position_in(message)

    def place(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Latitude and longitude (deg) of a place relative to home."""
        home = self._home()
        lat = home.lat_deg + math.degrees(north_m / _EARTH_RADIUS_M)
        across = _EARTH_RADIUS_M * math.cos(math.radians(home.lat_deg))
        return lat, home.lon_deg + math.degrees(east_m / across)

    def from_home_m(self, position: Position) -> tuple[float, float]:
        """North and east of home."""
        home = self._home()
        across = _EARTH_RADIUS_M * math.cos(math.radians(home.lat_deg))
        return (
            math.radians(position.lat_deg - home.lat_deg) * _EARTH_RADIUS_M,
            math.radians(position.lon_deg - home.lon_deg) * across,
        )

    def _home(self) -> Position:
        if self.home is None:
            self.home = self.position(_READY_S)  # an estimator that has just been switched on
        return self.home

    @property
    def home_amsl_m(self) -> float:
        """Altitude of the ground at home, as the vehicle has it now: estimates drift."""
        self._home()
        latest = self.client.latest.get("GLOBAL_POSITION_INT")
        here = self.position(_READY_S) if latest is None else position_in(latest)
        return here.amsl_m - here.rel_m

    # --- seeing -------------------------------------------------------------------------------

    def stream(self, name: str, rate_hz: float) -> str:
        """Ask for a message at a rate; `clean_up` puts it back."""
        self._asked.add(name)
        return self.client.ask_interval(message_id(name), 1e6 / rate_hz)

    def unstream(self, name: str) -> str:
        """A message's own rate again."""
        self._asked.discard(name)
        return self.client.ask_interval(message_id(name), 0.0)

    def see(self) -> None:
        """Have the telemetry that the suite works with, from now on."""
        if not self._sees:
            self._sees = True
            for name, rate_hz in WORKING_HZ.items():
                self.stream(name, rate_hz)

    def see_as_found(self) -> None:
        """Have only what comes by itself."""
        if self._sees:
            for name in sorted(self._asked):
                self.unstream(name)
            self._sees = False

    def forget_intervals(self) -> None:
        """A reboot has put the rates back by itself."""
        self._asked.clear()
        self._sees = False

    # --- parameters ---------------------------------------------------------------------------

    def read_raw(self, name: str) -> Message | None:
        """The PARAM_VALUE of a parameter; None if there is no answer."""
        self.client.send("PARAM_REQUEST_READ", param_id=name.encode(), param_index=-1)
        return self.client.hear("PARAM_VALUE", 3.0, lambda m: m.param_id == name)

    def write_raw(self, name: str, wire_value: float, kind: int) -> Message | None:
        """PARAM_SET as given; the PARAM_VALUE that answers, if one does."""
        self.client.send(
            "PARAM_SET", param_id=name.encode(), param_value=wire_value, param_type=kind
        )
        return self.client.hear("PARAM_VALUE", 3.0, lambda m: m.param_id == name)

    def parameter(self, name: str) -> float | None:
        """A parameter's value, as this autopilot puts it on the wire; None if there is none."""
        message = self.read_raw(name)
        if message is None:
            return None
        return self.from_wire(message.param_value, message.param_type)

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter until `restore`; CannotSee if it does not take the value."""
        before = self.read_raw(name)
        if before is None:
            raise CannotSee(f"there is no parameter {name}")
        self.keep(before)
        wire = self.to_wire(value, before.param_type)
        after = self.write_raw(name, wire, before.param_type)
        if after is None or self.from_wire(after.param_value, after.param_type) != _float32(value):
            raise CannotSee(f"{name} does not take {value}")

    def keep(self, message: Message) -> None:
        """Note a parameter's PARAM_VALUE, for `restore`."""
        self._originals.setdefault(message.param_id, (message.param_value, message.param_type))

    def to_wire(self, value: float, kind: int) -> float:
        """PX4 puts an integer's bytes into the float."""
        if self.is_px4 and kind in _INTEGER_TYPES:
            data = struct.pack(_INTEGER_TYPES[kind], int(value)).ljust(4, b"\0")
            return struct.unpack("<f", data)[0]
        return value

    def from_wire(self, wire_value: float, kind: int) -> float:
        """The other way round."""
        if self.is_px4 and kind in _INTEGER_TYPES:
            code = _INTEGER_TYPES[kind]
            data = struct.pack("<f", wire_value)[: struct.calcsize(code)]
            return float(struct.unpack(code, data)[0])
        return wire_value

    def restore(self) -> None:
        """Put back every parameter that was changed."""
        for name, (wire_value, kind) in list(self._originals.items()):
            answer = self.write_raw(name, wire_value, kind)
            if answer is not None:
                del self._originals[name]

    # --- modes --------------------------------------------------------------------------------

    def set_mode(self, mode: str) -> str:
        """DO_SET_MODE; the word of its acknowledgement."""
        return self.client.command(mavlink.MAV_CMD_DO_SET_MODE, *self.dialect.mode_params(mode))

    def enter(self, mode: str, within_s: float = 5.0) -> None:
        """Change the mode and see it in HEARTBEAT."""
        answer = self.set_mode(mode)
        if not self.client.until(lambda: self.mode == mode, within_s):
            raise CannotSee(f"mode {mode} was asked ({answer}), HEARTBEAT says {self.mode}")

    def arm(self, within_s: float = _READY_S) -> None:
        """Arm, as often as it takes an estimator to be ready."""
        end_s = self.client.t_s + within_s
        while not self.is_armed:
            answer = self.arm_once()
            armed = answer == "ACCEPTED" and self.client.until(lambda: self.is_armed, 2.0)
            if not armed and self.client.t_s > end_s:
                raise CannotSee(f"it does not arm: {answer}; {'; '.join(self.client.texts()[-3:])}")
            if not armed:
                self.client.collect(2.0)

    def arm_once(self) -> str:
        """COMPONENT_ARM_DISARM with 1."""
        return self.client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def disarm_once(self, *, force: bool = False) -> str:
        """COMPONENT_ARM_DISARM with 0."""
        extra = _FORCE_DISARM if force else 0.0
        return self.client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, extra)

    # --- missions -----------------------------------------------------------------------------

    def upload(self, items: Sequence[Item], *, only: int | None = None) -> Uploaded:
        """Upload a mission, behind a home item where the autopilot has one."""
        return missions.upload(self.client, self.with_home(items), only=only)

    def with_home(self, items: Sequence[Item]) -> list[Item]:
        """The items as this autopilot stores them."""
        home = Item(mavlink.MAV_CMD_NAV_WAYPOINT, *self.place(0.0, 0.0), 0.0, frame=0)
        return [home, *items] if self.dialect.has_home_item else list(items)

    def first_seq(self) -> int:
        """The number of the first real item."""
        return 1 if self.dialect.has_home_item else 0

    # --- known states -------------------------------------------------------------------------

    def on_ground(self) -> None:
        """Landed, disarmed, holding mode, nothing stored."""
        self._sights()
        if self.is_armed:
            self.land()
        self._forget_missions()
        self.restore()
        if self.mode != self.dialect.hold:
            self.enter(self.dialect.hold)

    def in_air(self) -> None:
        """Hovering about 20 m above home, in the holding mode, nothing stored."""
        self._sights()
        if not self.is_armed or self.is_on_ground:
            self.on_ground()
            self.take_off()
        if self.mode != self.dialect.hold:
            self.enter(self.dialect.hold)
        self._forget_missions()
        self.restore()
        if self.is_px4:  # a speed that was set outlives its mission
            self.client.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, -1.0, -1.0)
        self._come_back()

    def _sights(self) -> None:
        self.see()
        self.beat()
        self._home()

    def _forget_missions(self) -> None:
        """Nothing stored, of any kind."""
        for kind in (0, 1, 2):
            stored = missions.count(self.client, kind)
            if stored is not None and stored > (1 if kind == 0 and not self.is_px4 else 0):
                missions.clear(self.client, kind)

    def take_off(self, height_m: float = HEIGHT_M) -> None:
        """Climb as each autopilot does it."""
        client = self.client
        takeoff = mavlink.MAV_CMD_NAV_TAKEOFF
        asked_m = height_m
        if self.is_px4:
            asked_m = self.home_amsl_m + height_m
            answer = client.command(takeoff, math.nan, 0, 0, math.nan, math.nan, math.nan, asked_m)
            self.arm()
        else:
            self.enter("GUIDED")
            answer = self._take_off_armed(asked_m)
        if not client.until(lambda: self._rel_m() > height_m - 1.5, 40.0):
            raise CannotSee(f"it did not climb: {answer}; {'; '.join(client.texts()[-3:])}")
        client.collect(3.0)
        self.climbed = (asked_m, self.position())

    def _take_off_armed(self, asked_m: float) -> str:
        """Soon after a boot arming works some seconds before taking off does."""
        end_s = self.client.t_s + 15.0
        while True:
            self.arm()
            command = mavlink.MAV_CMD_NAV_TAKEOFF
            answer = self.client.command(command, 0, 0, 0, 0, 0, 0, asked_m)
            if answer == "ACCEPTED" or self.client.t_s > end_s:
                return answer
            self.client.collect(1.0)

    def _rel_m(self) -> float:
        message = self.client.latest.get("GLOBAL_POSITION_INT")
        return 0.0 if message is None else message.relative_alt * 1e-3

    def _come_back(self) -> None:
        """Fly to 20 m above home, unless about there, and come to rest."""
        here = self.position()
        far = math.hypot(*self.from_home_m(here)) > _NEAR_M
        if far or abs(here.rel_m - HEIGHT_M) > 4.0:
            self.go_to(0.0, 0.0, HEIGHT_M)
        self.client.until(lambda: self._speed_mps() < 0.5, 15.0)
        self.client.collect(0.5)

    def _speed_mps(self) -> float:
        message = self.client.latest["GLOBAL_POSITION_INT"]
        return math.hypot(message.vx, message.vy, message.vz) * 0.01

    def go_to(self, north_m: float, east_m: float, height_m: float) -> None:
        """DO_REPOSITION by a way that both autopilots understand: AMSL, as COMMAND_INT."""
        lat, lon = self.place(north_m, east_m)
        place = (lat, lon, self.home_amsl_m + height_m)
        self.client.command_int(
            mavlink.MAV_CMD_DO_REPOSITION, -1.0, 1.0, 0.0, math.nan, place=place, frame=0
        )

        def is_there() -> bool:
            here = position_in(self.client.latest["GLOBAL_POSITION_INT"])
            north, east = self.from_home_m(here)
            return (
                math.hypot(north - north_m, east - east_m) < 3.0
                and abs(here.rel_m - height_m) < 2.0
            )

        if not self.client.until(is_there, 90.0):
            raise CannotSee("it does not come back to above home")

    def land(self) -> None:
        """Land here and be disarmed; forced, on the ground, where landing is never noticed."""
        client = self.client
        if self.is_on_ground:
            self.disarm_once()
        if self.is_armed and not client.until(lambda: not self.is_armed, 2.0):
            self.enter("LAND")
            client.until(lambda: not self.is_armed, 120.0)
        if self.is_armed and self._may_force and self._rests():
            self.disarm_once(force=True)
            client.until(lambda: not self.is_armed, 3.0)
        if self.is_armed:
            raise CannotSee("it does not come to be landed and disarmed")
        client.until(lambda: self.is_on_ground, 5.0)

    def _rests(self) -> bool:
        here = self.position()
        return abs(here.vel_ned_mps[2]) < 0.2 and here.rel_m < 1.5

    @contextlib.contextmanager
    def parameter_set(self, name: str, value: float) -> Iterator[None]:
        """A parameter at a value while the block runs."""
        self.set_parameter(name, value)
        try:
            yield
        finally:
            self.restore()

    def remember(self, key: str, see: Callable[[], object]) -> object:
        """Look once at what several behaviours ask about; what could not be seen stays so."""
        if key not in self.memory:
            try:
                self.memory[key] = see()
            except CannotSee as error:
                self.memory[key] = error
        found = self.memory[key]
        if isinstance(found, CannotSee):
            raise found
        return found

    def clean_up(self) -> None:
        """Leave it as it was found: on the ground, disarmed, nothing stored, rates its own."""
        self.on_ground()
        self.see_as_found()


def _float32(value: float) -> float:
    return struct.unpack("<f", struct.pack("<f", value))[0]


def _knows_where(message: Message) -> bool:
    return message.lat != 0 or message.lon != 0


def position_in(message: Message) -> Position:
    """A GLOBAL_POSITION_INT, converted."""
    return Position(
        message.lat * 1e-7,
        message.lon * 1e-7,
        message.alt * 1e-3,
        message.relative_alt * 1e-3,
        (message.vx * 0.01, message.vy * 0.01, message.vz * 0.01),
    )
