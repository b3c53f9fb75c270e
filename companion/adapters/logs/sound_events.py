"""Numbers of a log that can be what they are called; the rest is left out, and that is said.

Damaged bytes still decode: to not-a-number, to a latitude of 1e30 degrees, to a time in the year
9000. Every reader's events pass here, so that the core sees from a log what it sees in flight.
"""

import math
from dataclasses import fields, replace

from companion.adapters.logs.log_time import LONGEST_S, told
from companion.core.base.errors import LeewayError
from companion.core.mission.events import Event
from companion.core.replay.recorded_flight import RecordedFlight

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
"""By the event's field. Wide: what a small multirotor and its sensors could say at all."""


def sound(flight: RecordedFlight, where: str) -> RecordedFlight:
    """The flight without what cannot be; LeewayError where nothing is left."""
    begin_s = _begin_s(flight.events)
    events: list[Event] = []
    wrong: dict[str, list[int]] = {}
    for number, event in enumerate(flight.events):
        what = _unsound(event, begin_s)
        if what is None:
            events.append(event)
        else:
            wrong.setdefault(f"{type(event).__name__}.{what} cannot be", []).append(number)
    if not events:
        raise LeewayError(f"{where}: nothing in this {flight.source} can be a flight's telemetry")
    found = [told(rows, _place, what, "left out") for what, rows in wrong.items()]
    return replace(flight, events=tuple(events), findings=(*flight.findings, *found))


def _place(number: int) -> str:
    return f"sample {number}"


def _begin_s(events: tuple[Event, ...]) -> float:
    """The middle sample's time, less a log's longest: one wild stamp at an end says nothing."""
    return events[len(events) // 2].t_s - LONGEST_S if events else 0.0


def _unsound(event: Event, begin_s: float) -> str | None:
    """The name of a field that cannot be; `None` for a sound event."""
    if not 0.0 <= event.t_s - begin_s <= 2.0 * LONGEST_S:  # NaN too
        return "t_s"
    for field in fields(event):
        limits, value = LIMITS.get(field.name), getattr(event, field.name)
        if limits is not None and value is not None and not limits[0] <= value <= limits[1]:
            return field.name
    return None
