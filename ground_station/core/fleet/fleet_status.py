"""Status of the fleet: members online, their last reports, and doubtful members.

Silence is counted on the desk's own clock; the vehicles' clocks are only displayed. A doubtful
vehicle (two companions of one name, an impossible battery) gets no assignment until an operator has
checked it. It can always be recalled.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from companion.core.base.desk_heartbeat import DeskHeartbeat, DeskMonitor
from companion.core.pilot.transitions import FLIGHT_PHASES, GROUND_PHASES
from companion.core.vehicle.airframe import Airframe
from companion.fleet.messages import State
from companion.fleet.roster import RosterDifference, roster_difference
from companion.fleet.trust import MemberTrust
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.truck_state import TRUCK

SILENT_AFTER_S = 5.0
"""A vehicle without a state for so long is silent; states are sent every second."""

STANDBY = "standby"
GROUND_PHASE_NAMES = frozenset(phase.value for phase in GROUND_PHASES)
FLIGHT_PHASE_NAMES = frozenset(phase.value for phase in FLIGHT_PHASES)
MAX_ENERGY_RISE_FRAC = 0.02
"""Energy left is an estimate: in flight it may rise by at most this share of the pack."""

MAX_ENERGY_FRAC = 1.05
CELL_RANGE_V = (2.0, 4.5)
"""Voltage range of a lithium cell: a reading outside does not fit the airframe's pack."""

CLOCK_TOLERANCE_S = 5.0

ROSTER_DELAY_S = 30.0
"""Time in which a member gets a new roster: it is published, and requested every 10 s."""


@dataclass(slots=True)
class VehicleStatus:
    """Status of one vehicle. `doubts`: conditions that bar it from assignments."""

    vehicle: str
    instance_ids: set[str] = field(default_factory=set)
    state: State | None = None
    received_s: float | None = None
    doubts: list[str] = field(default_factory=list)
    clock_offset_s: float = 0.0
    roster_doubt: str = ""
    older_roster_since_s: float | None = None

    def seconds_since_last_state(self, now_s: float) -> float | None:
        """Return the seconds since its last state; None: no state received."""
        return None if self.received_s is None else now_s - self.received_s

    def is_uniquely_online_and_reporting(self, now_s: float) -> bool:
        """Return True if exactly one companion of this name is online and its states arrive."""
        silent_s = self.seconds_since_last_state(now_s)
        return len(self.instance_ids) == 1 and silent_s is not None and silent_s <= SILENT_AFTER_S

    def is_stale_instance(self, instance_id: str) -> bool:
        """Return True if this instance is off the network while the one of the last state is on it:
        its states are replayed old ones.
        """
        before = self.state
        return (
            before is not None
            and before.instance_id in self.instance_ids
            and instance_id not in self.instance_ids
        )

    def can_take_assignment(self, now_s: float) -> bool:
        """Return True if it can take an assignment."""
        state = self.state
        idle = state is not None and state.phase == STANDBY and not state.armed
        return self.is_uniquely_online_and_reporting(now_s) and idle and not self.doubts


@dataclass(slots=True)
class FleetStatus:
    """Status of all vehicles of a fleet. `airframes` by name, for the limits of their batteries."""

    airframes: Mapping[str, Airframe] = field(default_factory=dict)
    vehicles: dict[str, VehicleStatus] = field(default_factory=dict)
    desks: DeskMonitor = field(default_factory=DeskMonitor)
    trust: MemberTrust | None = None
    """With the roster of this program, with which each vehicle's is compared."""

    @property
    def roster_alarm(self) -> str:
        """A roster that was refused as a fork or a rollback; empty: none."""
        return self.trust.roster_alarm if self.trust is not None else ""

    def status_of(self, vehicle: str) -> VehicleStatus:
        """Return the status of a vehicle; a new one if no state was received."""
        return self.vehicles.setdefault(vehicle, VehicleStatus(vehicle))

    def charge_frac_at_rest(self, vehicle: str) -> float | None:
        """Return the charge by resting voltage; None if unknown or armed."""
        state = self.status_of(vehicle).state
        airframe = self.airframes.get(state.airframe) if state is not None else None
        if state is None or airframe is None or not state.voltage_v or state.armed is not False:
            return None
        return airframe.battery.charge_frac_from_resting_voltage(state.voltage_v)

    def record_desk_heartbeat(self, heartbeat: DeskHeartbeat, clock: Clock) -> None:
        """Process a verified heartbeat."""
        self.desks.record_heartbeat(heartbeat, clock.monotonic_s(), clock.epoch_us())

    def record_liveliness_change(
        self, vehicle: str, instance_id: str, *, has_joined: bool
    ) -> str | None:
        """Process an instance that joined or left the network; return the operator's message."""
        status = self.status_of(vehicle)
        (status.instance_ids.add if has_joined else status.instance_ids.discard)(instance_id)
        duplicate_text = "two companions use this name"
        if len(status.instance_ids) > 1 and duplicate_text not in status.doubts:
            status.doubts.append(duplicate_text)
            return f"{vehicle}: {duplicate_text}: no new assignments"
        if len(status.instance_ids) == 1 and duplicate_text in status.doubts:
            status.doubts.remove(duplicate_text)
            return f"{vehicle}: one companion again"
        return None

    def record_state_and_new_doubts(
        self, state: State, received_s: float, epoch_us: int
    ) -> list[str]:
        """Process a state; return messages on new doubts about the vehicle."""
        status = self.status_of(state.vehicle)
        if status.is_stale_instance(state.instance_id):
            return []
        before = status.state
        new_doubts = self._new_doubts(before, state)
        roster_doubt = self._roster_doubt_or_empty(status, state, received_s)
        if roster_doubt != status.roster_doubt:
            status.doubts = [reason for reason in status.doubts if reason != status.roster_doubt]
            status.roster_doubt = roster_doubt
            new_doubts += [roster_doubt] if roster_doubt else []
        messages = [f"{state.vehicle}: {reason}" for reason in new_doubts]
        status.doubts += new_doubts
        if (
            before is None
            or before.instance_id != state.instance_id
            or before.uptime_s <= state.uptime_s
        ):
            status.state, status.received_s = state, received_s
        offset_s = (state.epoch_us - epoch_us) / 1e6
        if abs(offset_s) > CLOCK_TOLERANCE_S >= abs(status.clock_offset_s):
            messages.append(f"{state.vehicle}: its clock is off by {offset_s:.0f} s (display only)")
        status.clock_offset_s = offset_s
        return messages

    def _roster_doubt_or_empty(self, status: VehicleStatus, state: State, now_s: float) -> str:
        """Return the doubt by which a vehicle's roster differs from this program's; empty: none."""
        own = self.trust.roster_stamp if self.trust is not None else ""
        difference = RosterDifference.NONE
        if own and isinstance(state.roster, str):
            difference = roster_difference(state.roster, own)
        if difference is not RosterDifference.ROLLBACK:
            status.older_roster_since_s = None
        match difference:
            case RosterDifference.NONE:
                return ""
            case RosterDifference.FORK:
                return f"its roster {state.roster} is a fork of {own}: was the PKI restored?"
            case RosterDifference.NEWER:
                return f"its roster {state.roster} is newer than {own} here: copy roster.json here"
            case RosterDifference.ROLLBACK:
                status.older_roster_since_s = status.older_roster_since_s or now_s
                is_late = now_s - status.older_roster_since_s > ROSTER_DELAY_S
                return f"its roster {state.roster} is older than {own}" if is_late else ""

    def _new_doubts(self, previous_state: State | None, state: State) -> list[str]:
        known = self.status_of(state.vehicle).doubts
        found: list[str] = []
        airframe = self.airframes.get(state.airframe)
        if self.airframes and airframe is None and state.airframe != TRUCK:
            found.append(f"airframe {state.airframe} is not in the day's fleet")
        if airframe is not None:
            found += _battery_doubts(airframe, state)
        if (
            previous_state is not None
            and previous_state.instance_id == state.instance_id
            and previous_state.airframe != state.airframe
        ):
            found.append("changed its airframe without a restart")
        if airframe is not None and _has_energy_risen_in_flight(
            previous_state, state, airframe.battery.nominal_wh
        ):
            found.append("its energy rose in flight")
        return [reason for reason in found if reason not in known]


def _battery_doubts(airframe: Airframe, state: State) -> list[str]:
    battery = airframe.battery
    found: list[str] = []
    left_wh, voltage_v = state.energy_left_wh, state.voltage_v
    if left_wh is not None and left_wh > MAX_ENERGY_FRAC * battery.nominal_wh:
        found.append(f"reports more energy than its pack of {battery.nominal_wh:g} Wh holds")
    low_v, high_v = (battery.cells * v for v in CELL_RANGE_V)
    if voltage_v is not None and voltage_v > 0.0 and not low_v <= voltage_v <= high_v:
        found.append(f"reports a voltage that no pack of {battery.cells} cells has")
    return found


def _has_energy_risen_in_flight(
    previous_state: State | None, state: State, nominal_wh: float
) -> bool:
    if (
        previous_state is None
        or previous_state.assignment != state.assignment
        or not state.assignment
    ):
        return False
    if not (previous_state.armed and state.armed):
        return False
    if previous_state.energy_left_wh is None or state.energy_left_wh is None:
        return False
    return state.energy_left_wh - previous_state.energy_left_wh > MAX_ENERGY_RISE_FRAC * nominal_wh
