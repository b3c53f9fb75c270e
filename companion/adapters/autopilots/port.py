"""The autopilot on a link: finds it, distinguishes PX4 from ArduPilot and sets the clock by it.

Only component 1 of the chosen system is accepted.
"""

from collections.abc import Callable
from typing import Any

from companion.adapters.autopilots.ardupilot import ArduPilot
from companion.adapters.autopilots.codec import AUTOPILOT, mavlink
from companion.adapters.autopilots.px4 import Px4
from companion.adapters.autopilots.session import AutopilotSession
from companion.adapters.autopilots.telemetry import (
    AutopilotProfile,
    events_from_message,
    message_time_since_boot_s,
    other_companion_events,
)
from companion.adapters.clock import AutopilotClock
from companion.core.mission.actions import Order
from companion.core.mission.events import (
    AutopilotDetected,
    ClockJumpedForward,
    ClockSteppedBack,
    Event,
    VehicleState,
)

HEARTBEATS_TO_TRUST = 3
"""One heartbeat may come from any sender; three identify a vehicle, two make others doubtful."""

COMPANION_DETECTION_S = 2.0
"""Time to wait for another onboard computer's heartbeat (1 Hz) before the companion sends; three
heartbeats at their usual rate take as long.
"""

HEARTBEATS_WITHOUT_TIME = 10
"""After so many, a vehicle that sends no time is accepted; retries then wait for telemetry."""

PROFILES: dict[int, type[ArduPilot] | type[Px4]] = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ArduPilot,
    mavlink.MAV_AUTOPILOT_PX4: Px4,
}
NON_VEHICLE_TYPES = (
    mavlink.MAV_TYPE_GENERIC,
    mavlink.MAV_TYPE_ANTENNA_TRACKER,
    mavlink.MAV_TYPE_GCS,
    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
)
LAST_COMMON_VEHICLE_TYPE = mavlink.MAV_TYPE_VTOL_RESERVED5
"""MAV_TYPEs after it are peripherals, except these."""

LATER_VEHICLE_TYPES = (mavlink.MAV_TYPE_DODECAROTOR, mavlink.MAV_TYPE_DECAROTOR, 43)
"""43: MAV_TYPE_GENERIC_MULTIROTOR."""


def is_vehicle_type(mav_type: int) -> bool:
    """Return whether a MAV_TYPE is a vehicle, and not a station or a peripheral."""
    is_common = mav_type <= LAST_COMMON_VEHICLE_TYPE and mav_type not in NON_VEHICLE_TYPES
    return is_common or mav_type in LATER_VEHICLE_TYPES


class AutopilotPort:
    """Receives messages and sends commands; the caller moves the bytes and the time.

    Before identification it counts heartbeats and requests the time, and executes no order. After
    it, a session with one autopilot stays to the end of the process.
    """

    def __init__(
        self,
        send: Callable[[Any], None],
        clock: AutopilotClock,
        system_id: int | None = None,
        discard_unsent: Callable[[], None] = lambda: None,
    ) -> None:
        """`discard_unsent`: discards sent messages that have not left yet."""
        self._send = send
        self._discard_unsent = discard_unsent
        self._clock = clock
        self._required_system_id = system_id
        self._heartbeats: dict[tuple[int, int, int], int] = {}
        self._autopilot_and_type: tuple[int, int] | None = None
        self._stamps: dict[int, tuple[float, float]] = {}
        self._time_request_count = 0
        self._pending_time_requests: dict[int, int] = {}
        self._responded_times_s: dict[int, float] = {}
        self._last_heartbeat_s = -1.0
        self._session: AutopilotSession | None = None

    @property
    def profile(self) -> AutopilotProfile | None:
        """Profile of the identified autopilot."""
        return self._session.profile if self._session is not None else None

    @property
    def system_id(self) -> int | None:
        """System of the identified autopilot."""
        return self._session.system_id if self._session is not None else None

    @property
    def ambiguous_systems(self) -> tuple[int, ...]:
        """Systems of several vehicles, none of which is identified without a stated system."""
        if self._required_system_id is not None or self._session is not None:
            return ()
        found = {key[0] for key, n in self._heartbeats.items() if n >= HEARTBEATS_TO_TRUST - 1}
        return tuple(sorted(found)) if len(found) > 1 else ()

    @property
    def estimates_wind(self) -> bool | None:
        """Whether the autopilot measures the wind itself; `None`: not known."""
        return self._session.estimates_wind if self._session is not None else None

    # --- receiving -----------------------------------------------------------------------------

    def on_message(self, message: Any) -> list[Event]:
        """Return the events in a message; foreign and stale messages give none."""
        system, component = message.get_srcSystem(), message.get_srcComponent()
        session = self._session
        accepted_system = self._required_system_id if session is None else self.system_id
        if component != AUTOPILOT and accepted_system in (None, system):
            return other_companion_events(message, self._clock.t_s)
        if session is None:
            return self._identify_vehicle(message, system)
        if (system, component) != (self.system_id, AUTOPILOT):
            return []
        if self.is_intruding_heartbeat(message):
            return []
        if message.get_type() == "HEARTBEAT":
            self._request_time_if_clock_stalled(system)
        events, t_s = self._update_clock_step_events_and_time(message)
        return events if t_s is None else events + session.on_message(message, t_s)

    def update_clock_from_timesync_response(self, message: Any) -> None:
        """Process the response to a TIMESYNC request of this companion: the autopilot's clock."""
        system = message.get_srcSystem()
        if (
            message.get_srcComponent() != AUTOPILOT
            or self._pending_time_requests.get(system) != message.ts1
        ):
            return
        del self._pending_time_requests[system]
        if self._session is None:
            self._responded_times_s[system] = message.tc1 / 1e9
        elif system == self.system_id:
            self._clock.update_from_sync_time(message.tc1 / 1e9)

    def _send_timesync_request(self, system: int) -> None:
        self._time_request_count += 1
        self._pending_time_requests[system] = self._time_request_count
        self._send(mavlink.MAVLink_timesync_message(0, self._time_request_count))

    def _request_time_if_clock_stalled(self, system: int) -> None:
        """Request the time if the clock did not advance: ArduPilot sends no stamp before a request.

        A clock that does not advance would prevent every retry.
        """
        if self._clock.t_s == self._last_heartbeat_s:
            self._send_timesync_request(system)
        self._last_heartbeat_s = self._clock.t_s

    def is_from_accepted_autopilot(self, message: Any) -> bool:
        """Return whether an autopilot sent it: the identified one, before that any accepted."""
        system = self._required_system_id if self._session is None else self.system_id
        return message.get_srcComponent() == AUTOPILOT and system in (
            None,
            message.get_srcSystem(),
        )

    def is_intruding_heartbeat(self, message: Any) -> bool:
        """Return True for a heartbeat with the identified autopilot's IDs from another component.

        The autopilot is the one whose HEARTBEAT.autopilot and type identified it; a router, camera
        or station with its system and component ID has other ones.
        """
        is_heartbeat = message.get_type() == "HEARTBEAT"
        if not is_heartbeat or self._autopilot_and_type is None:
            return False
        is_accepted = self.is_from_accepted_autopilot(message)
        return is_accepted and (message.autopilot, message.type) != self._autopilot_and_type

    def is_candidate_vehicle(self, message: Any) -> bool:
        """Return True for the heartbeat of a vehicle that the companion could belong to."""
        return (
            message.get_type() == "HEARTBEAT"
            and self.is_from_accepted_autopilot(message)
            and message.autopilot in PROFILES
            and is_vehicle_type(message.type)
        )

    def _identify_vehicle(self, message: Any, system: int) -> list[Event]:
        """Count heartbeats until one system is accepted as the vehicle; record how long a system
        has been received, if its messages carry time stamps.
        """
        stamp_s = message_time_since_boot_s(message)
        if stamp_s is not None and message.get_srcComponent() == AUTOPILOT:
            first_s, _ = self._stamps.get(system, (stamp_s, stamp_s))
            self._stamps[system] = (min(first_s, stamp_s), stamp_s)
        if not self.is_candidate_vehicle(message):
            return []
        key = (system, message.autopilot, message.type)
        self._heartbeats[key] = self._heartbeats.get(key, 0) + 1
        if not self._clock.is_known and system not in self._stamps:
            self._send_timesync_request(system)
        if self._heartbeats[key] < HEARTBEATS_TO_TRUST or self.ambiguous_systems:
            return []
        first_s, last_s = self._stamps.get(system, (0.0, COMPANION_DETECTION_S))
        if last_s - first_s < COMPANION_DETECTION_S or not self._set_clock_or_stop_waiting(
            system, self._heartbeats[key]
        ):
            return []
        profile: AutopilotProfile = PROFILES[message.autopilot]()
        self._session = AutopilotSession(
            self._send, self._clock, profile, system, self._discard_unsent
        )
        self._autopilot_and_type = message.autopilot, message.type
        t_s = self._clock.t_s
        state = [
            e for e in events_from_message(message, profile, {}, t_s) if isinstance(e, VehicleState)
        ]
        return [*state, AutopilotDetected(t_s, profile.autopilot_kind, system)]

    def _set_clock_or_stop_waiting(self, system: int, heartbeat_count: int) -> bool:
        """Set the clock from the vehicle's time; return False while it is worth waiting for it.

        A command sent at time 0 would look overdue at the first stamp, be sent twice, and be
        acknowledged twice (observed on PX4 1.18 and ArduCopter 4.7).
        """
        if system in self._stamps:
            self._clock.update_from_boot_time(self._stamps[system][1])
        elif system in self._responded_times_s:
            self._clock.update_from_sync_time(self._responded_times_s[system])
        return self._clock.is_known or heartbeat_count >= HEARTBEATS_WITHOUT_TIME

    def _update_clock_step_events_and_time(self, message: Any) -> tuple[list[Event], float | None]:
        stamp_s = message_time_since_boot_s(message)
        if stamp_s is None:
            return [], self._clock.t_s
        reading = self._clock.update_from_boot_time(stamp_s)
        events: list[Event] = []
        if reading.step_back_s > 0.0:
            events.append(ClockSteppedBack(self._clock.t_s, reading.step_back_s))
        if reading.step_forward_s > 0.0:
            events.append(ClockJumpedForward(self._clock.t_s, reading.step_forward_s))
        return events, reading.t_s

    # --- orders --------------------------------------------------------------------------------

    def execute(self, order: Order, t_s: float) -> None:
        """Execute an order of the core; none before the autopilot is identified."""
        if self._session is not None:
            self._session.execute(order, t_s)

    def discard_all_pending_requests(self) -> None:
        """Discard all commands, transfers and requests in progress."""
        if self._session is not None:
            self._session.discard_all_pending_requests()

    def tick(self, t_s: float) -> list[Event]:
        """Retry what is due and return the events of what ended."""
        return self._session.tick(t_s) if self._session is not None else []
