"""The vehicle under test: brought into a known state before each behaviour, and left as it was."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Any, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.client import Client, message_id
from sim_bridge.conform.dialect import PX4, Dialect, dialect_of
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.missions import Item, Uploaded
from sim_bridge.conform.parameters import Parameters

T = TypeVar("T")
HEIGHT_M = 20.0
_EARTH_RADIUS_M = 6_371_000.0
_FORCE_DISARM = 21196.0
_NEAR_M = 60.0
_READY_S = 90.0
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
"""Messages that the suite requests for its observations, after the test of default telemetry."""


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
    """A vehicle under test: its identity, its state, and the return to a known state."""

    def __init__(self, client: Client, *, allow_force_disarm: bool) -> None:
        self.client = client
        heartbeat = client.wait_first_heartbeat()
        self.dialect: Dialect = dialect_of(heartbeat.autopilot)
        self.parameters = Parameters(client, self.dialect)
        self.home: Position | None = None
        self.climbed: tuple[float, Position] | None = None
        """Altitude requested by the last take-off to HEIGHT_M, and the position where it ended."""
        self.observed: dict[str, Any] = {}
        """Observations shared by several behaviours (`observed_once`)."""
        self._allow_force_disarm = allow_force_disarm
        self._requested_streams: set[str] = set()
        self._sees = False

    # --- reported state -----------------------------------------------------------------------

    @property
    def is_px4(self) -> bool:
        """Return True for PX4."""
        return self.dialect is PX4

    @property
    def mode(self) -> str:
        """The last HEARTBEAT's mode."""
        return self.dialect.mode_name(self.client.latest["HEARTBEAT"].custom_mode)

    @property
    def is_armed(self) -> bool:
        """Return True if the latest HEARTBEAT reports armed."""
        flag = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return bool(self.client.latest["HEARTBEAT"].base_mode & flag)

    @property
    def landed_state(self) -> int:
        """EXTENDED_SYS_STATE.landed_state; 0 while unknown."""
        state = self.client.latest.get("EXTENDED_SYS_STATE")
        return 0 if state is None else state.landed_state

    @property
    def is_on_ground(self) -> bool:
        """Return True if the autopilot reports that it is on the ground."""
        return self.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND

    def wait_position(self, timeout_s: float = 5.0) -> Position:
        """Return the position from a new message; 0 N 0 E means that it is still unknown."""
        message = self.client.wait_next_message(
            "GLOBAL_POSITION_INT", timeout_s, lambda m: m.lat != 0 or m.lon != 0
        )
        if message is None:
            raise ObservationError("no GLOBAL_POSITION_INT with a position")
        return self.latest_position()

    def latest_position(self) -> Position:
        """Return the last GLOBAL_POSITION_INT, converted."""
        message = self.client.latest.get("GLOBAL_POSITION_INT")
        if message is None:
            raise ObservationError("no GLOBAL_POSITION_INT")
        return Position(
            message.lat * 1e-7,
            message.lon * 1e-7,
            message.alt * 1e-3,
            message.relative_alt * 1e-3,
            (message.vx * 0.01, message.vy * 0.01, message.vz * 0.01),
        )

    def lat_lon_deg_from_home(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Return latitude and longitude (deg) of a position relative to home."""
        home = self._home_or_first_position()
        lat = home.lat_deg + math.degrees(north_m / _EARTH_RADIUS_M)
        across = _EARTH_RADIUS_M * math.cos(math.radians(home.lat_deg))
        return lat, home.lon_deg + math.degrees(east_m / across)

    def offset_from_home_ne_m(self, position: Position) -> tuple[float, float]:
        """North and east of home."""
        home = self._home_or_first_position()
        across = _EARTH_RADIUS_M * math.cos(math.radians(home.lat_deg))
        return (
            math.radians(position.lat_deg - home.lat_deg) * _EARTH_RADIUS_M,
            math.radians(position.lon_deg - home.lon_deg) * across,
        )

    def _home_or_first_position(self) -> Position:
        if self.home is None:
            self.home = self.wait_position(_READY_S)  # an estimator that has just been switched on
        return self.home

    @property
    def home_amsl_m(self) -> float:
        """Altitude of the ground at home, as the vehicle has it now: estimates drift."""
        self._home_or_first_position()
        is_known = "GLOBAL_POSITION_INT" in self.client.latest
        here = self.latest_position() if is_known else self.wait_position(_READY_S)
        return here.amsl_m - here.rel_m

    # --- telemetry ----------------------------------------------------------------------------

    def request_stream(self, name: str, rate_hz: float) -> str:
        """Request a message at a rate; `restore_initial_state` restores its default."""
        self._requested_streams.add(name)
        return self.client.request_message_interval(message_id(name), 1e6 / rate_hz)

    def restore_stream(self, name: str) -> str:
        """Restore a message's default rate."""
        self._requested_streams.discard(name)
        return self.client.request_message_interval(message_id(name), 0.0)

    def request_working_streams_once(self) -> None:
        """Request the telemetry that the suite needs."""
        if not self._sees:
            self._sees = True
            for name, rate_hz in WORKING_HZ.items():
                self.request_stream(name, rate_hz)

    def restore_default_telemetry(self) -> None:
        """Restore the default telemetry only."""
        if self._sees:
            for name in sorted(self._requested_streams):
                self.restore_stream(name)
            self._sees = False

    def clear_requested_stream_record(self) -> None:
        """Clear the record of requested rates, which a reboot resets."""
        self._requested_streams.clear()
        self._sees = False

    # --- modes --------------------------------------------------------------------------------

    def request_mode(self, mode: str) -> str:
        """Send DO_SET_MODE; return the result of its acknowledgement as text."""
        return self.client.send_command_and_wait_ack(
            mavlink.MAV_CMD_DO_SET_MODE, *self.dialect.do_set_mode_params(mode)
        )

    def set_mode_and_wait(self, mode: str) -> None:
        """Change the mode and wait for it in HEARTBEAT."""
        response = self.request_mode(mode)
        if not self.client.wait_until(lambda: self.mode == mode, 5.0):
            raise ObservationError(
                f"mode {mode} requested ({response}), HEARTBEAT reports {self.mode}"
            )

    def arm_with_retries(self) -> None:
        """Arm; repeat until the estimator is ready."""
        end_s = self.client.t_s + _READY_S
        while not self.is_armed:
            response = self.request_arm()
            armed = response == "ACCEPTED" and self.client.wait_until(lambda: self.is_armed, 2.0)
            if not armed and self.client.t_s > end_s:
                raise ObservationError(
                    f"arming failed: {response}; {'; '.join(self.client.status_texts()[-3:])}"
                )
            if not armed:
                self.client.collect_messages(2.0)

    def request_arm(self) -> str:
        """COMPONENT_ARM_DISARM with 1."""
        return self.client.send_command_and_wait_ack(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def request_disarm(self, *, force: bool = False) -> str:
        """COMPONENT_ARM_DISARM with 0."""
        extra = _FORCE_DISARM if force else 0.0
        return self.client.send_command_and_wait_ack(
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, extra
        )

    # --- missions -----------------------------------------------------------------------------

    def upload(self, items: Sequence[Item], *, max_items: int | None = None) -> Uploaded:
        """Upload a mission, behind a home item where the autopilot has one."""
        return missions.upload(self.client, self.with_home_item(items), max_items=max_items)

    def upload_accepted(self, items: Sequence[Item]) -> None:
        """Upload a mission; ObservationError if it is not accepted."""
        ack = self.upload(items).ack
        if ack != "ACCEPTED":
            raise ObservationError(f"the mission was rejected: {ack}")

    def with_home_item(self, items: Sequence[Item]) -> list[Item]:
        """The items as this autopilot stores them."""
        home = self.item(mavlink.MAV_CMD_NAV_WAYPOINT, 0.0, 0.0, frame=0)
        return [home, *items] if self.dialect.has_home_item else list(items)

    def item(
        self, command: int, north_m: float, east_m: float, height_m: float = 0.0, **fields: float
    ) -> Item:
        """Return an item at a position relative to home."""
        position = self.lat_lon_deg_from_home(north_m, east_m)
        return Item(command, *position, height_m, **fields)  # pyright: ignore[reportArgumentType]

    def current_item_index(self) -> int:
        """MISSION_CURRENT, counted from the first real item."""
        message = self.client.latest.get("MISSION_CURRENT")
        if message is None:
            raise ObservationError("no MISSION_CURRENT comes")
        return message.seq - self.first_flown_seq()

    def first_flown_seq(self) -> int:
        """The number of the first real item."""
        return 1 if self.dialect.has_home_item else 0

    # --- known states -------------------------------------------------------------------------

    def prepare_on_ground(self) -> None:
        """Landed, disarmed, holding mode, nothing stored."""
        self._request_telemetry_and_home()
        if self.is_armed:
            self.land_and_wait_disarmed()
        self._clear_stored_lists()
        self.parameters.restore()
        if self.mode != self.dialect.hold:
            self.set_mode_and_wait(self.dialect.hold)

    def prepare_in_air(self) -> None:
        """Hovering about 20 m above home, in the holding mode, nothing stored."""
        self._request_telemetry_and_home()
        if not self.is_armed or self.is_on_ground:
            self.prepare_on_ground()
            self.take_off_and_wait()
        if self.mode != self.dialect.hold:
            self.set_mode_and_wait(self.dialect.hold)
        self._clear_stored_lists()
        self.parameters.restore()
        if self.is_px4:  # a speed that was set outlives its mission
            self.client.send_command_and_wait_ack(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, -1.0, -1.0)
        self._fly_above_home_and_stop()

    def _request_telemetry_and_home(self) -> None:
        self.request_working_streams_once()
        self.client.collect_messages(0.2)  # the next HEARTBEAT is newer than all messages sent
        self.client.wait_next_message("HEARTBEAT", 3.0)
        self._home_or_first_position()

    def _clear_stored_lists(self) -> None:
        """Clear the stored lists of every type."""
        for kind in (0, 1, 2):
            stored = missions.request_count(self.client, kind)
            if stored is not None and stored > (1 if kind == 0 and not self.is_px4 else 0):
                missions.clear_stored_list(self.client, kind)

    def take_off_and_wait(self, height_m: float = HEIGHT_M) -> None:
        """Take off with the autopilot's own procedure."""
        client = self.client
        takeoff = mavlink.MAV_CMD_NAV_TAKEOFF
        requested_m, ground_m = height_m, self.home_amsl_m
        if self.is_px4:
            requested_m += ground_m
            response = client.send_command_and_wait_ack(
                takeoff, math.nan, 0, 0, math.nan, math.nan, math.nan, requested_m
            )
            self.arm_with_retries()
        else:
            self.set_mode_and_wait("GUIDED")
            response = self._arm_and_request_takeoff(requested_m)
        if not client.wait_until(lambda: self.latest_position().rel_m > height_m - 1.5, 40.0):
            raise ObservationError(
                f"the vehicle did not climb: {response}; {'; '.join(client.status_texts()[-3:])}"
            )
        client.collect_messages(3.0)
        self.climbed = (requested_m, self.wait_position())

    def _arm_and_request_takeoff(self, takeoff_height_m: float) -> str:
        """Soon after a boot arming works some seconds before taking off does."""
        end_s = self.client.t_s + 15.0
        while True:
            self.arm_with_retries()
            command = mavlink.MAV_CMD_NAV_TAKEOFF
            response = self.client.send_command_and_wait_ack(
                command, 0, 0, 0, 0, 0, 0, takeoff_height_m
            )
            if response == "ACCEPTED" or self.client.t_s > end_s:
                return response
            self.client.collect_messages(1.0)

    def _fly_above_home_and_stop(self) -> None:
        """Fly to 20 m above home, unless about there, and come to rest."""
        here = self.wait_position()
        far = math.hypot(*self.offset_from_home_ne_m(here)) > _NEAR_M
        if far or abs(here.rel_m - HEIGHT_M) > 4.0:
            self.fly_to_and_wait(0.0)
        self.client.wait_until(lambda: math.hypot(*self.latest_position().vel_ned_mps) < 0.5, 15.0)
        self.client.collect_messages(0.5)

    def request_reposition(
        self, north_m: float, speed_mps: float = -1.0, *, change_mode: bool = True
    ) -> str:
        """Send DO_REPOSITION at HEIGHT_M in the form that both accept: COMMAND_INT, AMSL."""
        position = (*self.lat_lon_deg_from_home(north_m, 0.0), self.home_amsl_m + HEIGHT_M)
        return self.client.send_command_int_and_wait_ack(
            mavlink.MAV_CMD_DO_REPOSITION, speed_mps, float(change_mode), 0.0, math.nan,
            position=position, frame=0,
        )  # fmt: skip

    def fly_to_and_wait(self, north_m: float) -> None:
        """Fly to a position north of home, HEIGHT_M above it."""
        self.request_reposition(north_m)

        def has_arrived() -> bool:
            here = self.latest_position()
            north, east = self.offset_from_home_ne_m(here)
            return math.hypot(north - north_m, east) < 3.0 and abs(here.rel_m - HEIGHT_M) < 2.0

        if not self.client.wait_until(has_arrived, 90.0):
            raise ObservationError("the vehicle does not return to above home")

    def land_and_wait_disarmed(self) -> None:
        """Land here and be disarmed; forced, on the ground, where landing is never noticed."""
        client = self.client
        if self.is_on_ground:
            self.request_disarm()
        if self.is_armed and not client.wait_until(lambda: not self.is_armed, 2.0):
            self.set_mode_and_wait("LAND")
            client.wait_until(lambda: not self.is_armed, 120.0)
        if self.is_armed and self._allow_force_disarm:
            here = self.wait_position()
            if abs(here.vel_ned_mps[2]) < 0.2 and here.rel_m < 1.5:
                self.request_disarm(force=True)
                client.wait_until(lambda: not self.is_armed, 3.0)
        if self.is_armed:
            raise ObservationError("the vehicle does not reach landed and disarmed")
        client.wait_until(lambda: self.is_on_ground, 5.0)

    def restore_initial_state(self) -> None:
        """Restore the initial state: on the ground, disarmed, nothing stored, default rates."""
        self.prepare_on_ground()
        self.restore_default_telemetry()


def observed_once(probe: Callable[[Subject], T]) -> Callable[[Subject], T]:
    """Observe once for several behaviours of a vehicle; a failed observation is stored too."""

    @wraps(probe)
    def stored_observation(subject: Subject) -> T:
        key = f"{probe.__module__}.{probe.__qualname__}"
        if key not in subject.observed:
            try:
                subject.observed[key] = probe(subject)
            except ObservationError as error:
                subject.observed[key] = error
        found = subject.observed[key]
        if isinstance(found, ObservationError):
            raise found
        return found

    return stored_observation
