"""A recorded flight: the same telemetry events that the companion receives in flight.

The readers in companion.adapters.logs build it from PX4 ULog, ArduPilot dataflash, .tlog, MCAP of
Leeway and CSV. Times are seconds on the log's clock and never decrease. Rows that a reader excludes
or shifts for that are listed in the findings.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Bools, Floats
from companion.core.mission.events import AutopilotKind, Battery, Event, Position
from companion.core.pilot.telemetry_state import (
    AIRSPEED_MAX_AGE_S,
    ATTITUDE_MAX_AGE_S,
    POSITION_MAX_AGE_S,
    WIND_MAX_AGE_S,
    TelemetryState,
)
from companion.core.vehicle.airframe import MULTIROTOR

MAX_FILLED_GAP_S = 60.0
"""Longest gap filled with ticks, in which estimates and energy advance as in flight."""


@dataclass(frozen=True, slots=True)
class LogIssue:
    """An error in a log. `where` is a row, a time or a message; `done` is the handling.

    `t_s`: the time on the log's clock, where `where` is one.
    """

    where: str
    what: str
    done: str
    t_s: float | None = None

    @classmethod
    def at_time(cls, t_s: float, description: str, handling: str) -> "LogIssue":
        """Create a finding at a time on the log's clock."""
        return cls(f"{t_s:.1f} s", description, handling, t_s)

    def format_with_time_since(self, start_s: float) -> str:
        """Return the finding as text, with its time counted from `start_s`."""
        where = self.where if self.t_s is None else f"{self.t_s - start_s:.1f} s"
        return f"{where}: {self.what}; {self.done}"

    def __str__(self) -> str:
        return self.format_with_time_since(0.0)


@dataclass(frozen=True, slots=True)
class WindReference:
    """Wind of an anemometer in the log: direction to, (n, 2), north and east."""

    t_s: Floats
    to_ne_mps: Floats


@dataclass(frozen=True, slots=True)
class RecordedFlight:
    """A recorded flight; `events` in order of time. `vehicle` is `MULTIROTOR`, the name of another
    kind, or `None` if unknown.

    `utc_at_zero_s`: seconds since 1970 at zero of the log's clock, if known. `position_measured`:
    false for a log with velocities only, whose positions are integrated from the first row, about 0
    N 0 E. `has_battery_voltage_and_current`: the log has voltage and current. `autopilot_faults`:
    time and text of faults that the log has in other messages than telemetry.
    """

    source: str
    events: tuple[Event, ...]
    findings: tuple[LogIssue, ...] = ()
    autopilot_kind: AutopilotKind | None = None
    vehicle: str | None = None
    firmware: str | None = None
    position_measured: bool = True
    reference: WindReference | None = None
    utc_at_zero_s: float | None = None
    autopilot_faults: tuple[tuple[float, str], ...] = ()

    @property
    def start_s(self) -> float:
        """Time of the first event."""
        return self.events[0].t_s if self.events else 0.0

    @property
    def duration_s(self) -> float:
        """Time from the first event to the last."""
        return self.events[-1].t_s - self.events[0].t_s if self.events else 0.0

    def has_event(self, kind: type[Event]) -> bool:
        """Return whether the log has an event of this kind."""
        return any(isinstance(event, kind) for event in self.events)

    @property
    def has_battery_voltage(self) -> bool:
        """Whether the log has a battery voltage, which the energy ledger requires."""
        return any(isinstance(e, Battery) and e.voltage_v is not None for e in self.events)

    @property
    def has_battery_voltage_and_current(self) -> bool:
        """Whether the log has both battery voltage and current."""
        known = [e for e in self.events if isinstance(e, Battery)]
        return any(e.voltage_v is not None for e in known) and any(
            e.current_a is not None for e in known
        )

    @property
    def is_multirotor_or_unknown(self) -> bool:
        """Whether the vehicle is a multirotor, or of unknown kind."""
        return self.vehicle in (None, MULTIROTOR)


@dataclass(frozen=True, slots=True)
class FlightSamples:
    """A recorded flight on a uniform time grid, (n,) each; unknown or stale values are NaN.

    Velocities NED, angles in rad; `wind_to_*` is the autopilot's estimate, `consumed_ah` and
    `consumed_j` are its counters.
    """

    t_s: Floats
    airborne: Bools
    armed: Bools
    lat_deg: Floats
    lon_deg: Floats
    alt_amsl_m: Floats
    height_rel_m: Floats
    vel_n_mps: Floats
    vel_e_mps: Floats
    vel_d_mps: Floats
    roll_rad: Floats
    pitch_rad: Floats
    yaw_rad: Floats
    airspeed_mps: Floats
    wind_to_n_mps: Floats
    wind_to_e_mps: Floats
    voltage_v: Floats
    current_a: Floats
    consumed_ah: Floats
    consumed_j: Floats
    remaining_frac: Floats
    temperature_c: Floats


_MEASURED = (
    ("position", POSITION_MAX_AGE_S, ("lat_deg", "lon_deg", "alt_amsl_m", "height_rel_m",
                                      "vel_n_mps", "vel_e_mps", "vel_d_mps")),
    ("attitude", ATTITUDE_MAX_AGE_S, ("roll_rad", "pitch_rad", "yaw_rad")),
    ("airspeed", AIRSPEED_MAX_AGE_S, ("forward_mps",)),
    ("wind", WIND_MAX_AGE_S, ("to_n_mps", "to_e_mps")),
    ("battery", 5.0, ("voltage_v", "current_a", "consumed_ah", "consumed_j", "remaining_frac",
                      "temperature_c")),
)  # fmt: skip


def iterate_updated_telemetry_state(
    flight: RecordedFlight, period_s: float, pack_voltage_range_v: tuple[float, float] | None = None
) -> Iterator[TelemetryState]:
    """Yield the telemetry state about every `period_s`, after all events up to that time.

    The times are those of telemetry, as the companion's ticks; the yielded object is updated in
    place. Gaps longer than `period_s` and up to `MAX_FILLED_GAP_S` are filled with further times.
    """
    now = TelemetryState()
    if pack_voltage_range_v is not None:
        now.pack.voltage_range_v = pack_voltage_range_v
    ticked_s: float | None = None
    events = flight.events
    for i, event in enumerate(events):
        now.store_event(event)
        next_s = events[i + 1].t_s if i + 1 < len(events) else math.inf
        if next_s <= event.t_s:
            continue
        if ticked_s is None or event.t_s - ticked_s >= period_s - 0.005:
            ticked_s = event.t_s
            yield now
        while ticked_s + 2.0 * period_s < next_s < ticked_s + MAX_FILLED_GAP_S:
            ticked_s += period_s
            now.t_s = max(now.t_s, ticked_s)
            yield now


def resample_flight_on_time_grid(flight: RecordedFlight, period_s: float = 0.2) -> FlightSamples:
    """Return the flight on a time grid; NaN for an unknown or outdated value."""
    times: list[float] = []
    flags: list[tuple[bool, bool]] = []
    rows: list[list[float]] = []
    for now in iterate_updated_telemetry_state(flight, period_s):
        times.append(now.t_s)
        flags.append((now.airborne, now.armed))
        rows.append(_telemetry_values_or_nan(now))
    values = np.array(rows, float).reshape(len(rows), -1)
    flag_table = np.array(flags, bool).reshape(len(flags), 2)
    return FlightSamples(np.array(times), flag_table[:, 0], flag_table[:, 1], *values.T)


def _telemetry_values_or_nan(telemetry: TelemetryState) -> list[float]:
    row: list[float] = []
    for name, max_age_s, fields in _MEASURED:
        sample = getattr(telemetry, name)
        is_recent = telemetry.is_recent(sample, max_age_s)
        for field in fields:
            value = getattr(sample, field) if is_recent else None
            row.append(math.nan if value is None else value)
    return row


def first_position(flight: RecordedFlight) -> Position | None:
    """Return the first position of the log, if any."""
    return next((e for e in flight.events if isinstance(e, Position)), None)
