"""What a vehicle's state shows about a launch: its validity runs on the vehicle's clock."""

from companion.core.pilot.transitions import END_PHASES, Phase
from companion.fleet.command_log import MAX_LAUNCH_VALIDITY_S
from companion.fleet.messages import Launch, LaunchWindow, State
from ground_station.core.fleet.fleet_status import FLIGHT_PHASE_NAMES, VehicleStatus
from ground_station.core.schema.orders import CommandRow

AIRBORNE_HEIGHT_M = 2.0
NOT_STARTING_PHASES = frozenset(phase.value for phase in (Phase.READY, *END_PHASES))


def launch_window_on_vehicle_clock(
    status: VehicleStatus, earliest_launch_s: float, now_s: float
) -> LaunchWindow | None:
    """Return the window of a launch that is sent now; None: the launch gap is not over.

    The time since the last state is a lower bound of what passed on the vehicle's clock, so a
    delayed state shortens the window.
    """
    state, silent_s = status.state, status.seconds_since_last_state(now_s)
    if state is None or silent_s is None or now_s < earliest_launch_s:
        return None
    uptime_s = state.uptime_s + silent_s
    not_before_s = max(state.uptime_s, uptime_s + earliest_launch_s - now_s)
    return LaunchWindow(
        instance_id=state.instance_id,
        not_before_s=not_before_s,
        expires_s=not_before_s + MAX_LAUNCH_VALIDITY_S,
    )


def is_airborne(state: State) -> bool:
    """Return whether a vehicle has taken off, under any control."""
    if state.height_rel_m is None:
        return state.phase in FLIGHT_PHASE_NAMES
    return bool(state.armed) and state.height_rel_m > AIRBORNE_HEIGHT_M


def is_launch_over(state: State, assignment: str, window: LaunchWindow) -> bool:
    """Return whether this state shows that a launch can no longer start a flight: its validity has
    passed on the vehicle's clock, and the vehicle is not starting.
    """
    is_valid = state.instance_id == window.instance_id and state.uptime_s <= window.expires_s
    is_starting = state.assignment == assignment and state.phase not in NOT_STARTING_PHASES
    return not (is_valid or is_starting or state.armed)


def window_of(launch: CommandRow) -> LaunchWindow | None:
    """Return the validity of a launch; None: it has not been sent."""
    action = launch.command
    window = action.window if isinstance(action, Launch) else None
    return window if isinstance(window, LaunchWindow) else None
