"""Plausibility limits for a log's values; implausible events are removed and reported.

Damaged bytes still decode: to NaN, to a latitude of 1e30 degrees, to a time in the year 9000. The
events of every reader are filtered here, so that the core sees the same as in flight.
"""

import math
from dataclasses import fields, replace

from companion.adapters.logs.log_time import MAX_DURATION_S, summarise_rows_as_issue
from companion.analysis.replay.recorded_flight import RecordedFlight
from companion.core.base.errors import LeewayError
from companion.core.mission.events import Event

ANGLE = (-2.0 * math.pi, 2.0 * math.pi)
SPEED = (-150.0, 150.0)
HEIGHT = (-1_000.0, 20_000.0)
LIMITS: dict[str, tuple[float, float]] = {
    "roll_rad": ANGLE,
    "pitch_rad": ANGLE,
    "yaw_rad": ANGLE,
    "lat_deg": (-90.0, 90.0),
    "lon_deg": (-180.0, 180.0),
    "alt_amsl_m": HEIGHT,
    "height_rel_m": HEIGHT,
    "vel_n_mps": SPEED,
    "vel_e_mps": SPEED,
    "vel_d_mps": SPEED,
    "forward_mps": SPEED,
    "to_n_mps": SPEED,
    "to_e_mps": SPEED,
    "std_mps": (0.0, 150.0),
    "voltage_v": (0.0, 1_000.0),
    "current_a": (-1_000.0, 2_000.0),
    "consumed_ah": (0.0, 1e4),
    "consumed_j": (0.0, 1e9),
    "remaining_frac": (0.0, 1.0),
    "temperature_c": (-100.0, 200.0),
    "throttle_frac": (-1.0, 1.5),
    "satellites": (0, 1_000),
    "index": (0, 1_000_000),
    "total": (0, 1_000_000),
}
"""Limits by event field. Wide: the physical range of a small multirotor and its sensors."""


def drop_implausible_events(flight: RecordedFlight, error_prefix: str) -> RecordedFlight:
    """Return the flight without implausible events; LeewayError if none remains."""
    begin_s = _earliest_start_s(flight.events)
    events: list[Event] = []
    wrong: dict[str, list[int]] = {}
    for number, event in enumerate(flight.events):
        description = _implausible_field(event, begin_s)
        if description is None:
            events.append(event)
        else:
            wrong.setdefault(f"{type(event).__name__}.{description} out of range", []).append(
                number
            )
    if not events:
        raise LeewayError(f"{error_prefix}: no plausible telemetry in this {flight.source}")
    found = [
        summarise_rows_as_issue(rows, "sample {}".format, description, "discarded")
        for description, rows in wrong.items()
    ]
    return replace(flight, events=tuple(events), findings=(*flight.findings, *found))


def _earliest_start_s(events: tuple[Event, ...]) -> float:
    """Return the median sample's time less the maximum duration; robust to wrong stamps."""
    return events[len(events) // 2].t_s - MAX_DURATION_S if events else 0.0


def _implausible_field(event: Event, earliest_start_s: float) -> str | None:
    """Return the name of an implausible field; `None` for a plausible event."""
    if not 0.0 <= event.t_s - earliest_start_s <= 2.0 * MAX_DURATION_S:  # NaN too
        return "t_s"
    for field in fields(event):
        limits, value = LIMITS.get(field.name), getattr(event, field.name)
        if limits is not None and value is not None and not limits[0] <= value <= limits[1]:
            return field.name
    return None
