"""Failsafes and estimator faults that the autopilot reported in a recorded flight."""

from companion.analysis.replay.recorded_flight import RecordedFlight
from companion.core.mission.events import EstimatorHealth, VehicleState

MAX_FAULTS = 50
"""Faults kept of one log: a damaged one may change its state at every row."""


def autopilot_faults(log: RecordedFlight) -> list[tuple[float, str]]:
    """Return the start of each fault while armed, as (time on the log's clock, text), by time."""
    faults = list(log.autopilot_faults)
    failsafe = was_failsafe = False
    is_armed, position_ok = False, True
    for event in log.events:
        match event:
            case VehicleState():
                was_failsafe, failsafe, is_armed = failsafe, event.failsafe, event.armed
                if failsafe and not was_failsafe and is_armed:
                    faults.append((event.t_s, f"failsafe, mode {event.mode_name}"))
            case EstimatorHealth():
                if position_ok and not event.position_ok and is_armed:
                    faults.append((event.t_s, "estimator: no valid position"))
                position_ok = event.position_ok
            case _:
                pass
    return sorted(faults)[:MAX_FAULTS]
