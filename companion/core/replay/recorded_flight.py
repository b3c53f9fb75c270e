"""A recorded flight: the same telemetry events that the companion receives in flight.

The readers in companion.adapters.logs make it from PX4 ULog, ArduPilot dataflash, .tlog, our MCAP
and CSV. Times are seconds on the log's own clock and never go back. What a reader had to leave out
or shift for that is among the findings.
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

LARGEST_GAP_S = 60.0
"""Silences up to this are filled with ticks: belief and energy go on as they would in flight."""


@dataclass(frozen=True, slots=True)
class LogFinding:
    """Something wrong with a log. `where` is a row, a time or a message; `done` what we did.

    `t_s`: the time on the log's clock, where `where` is one.
    """

    where: str
    what: str
    done: str
    t_s: float | None = None

    @classmethod
    def at(cls, t_s: float, what: str, done: str) -> "LogFinding":
        """A finding at a time on the log's clock."""
        return cls(f"{t_s:.1f} s", what, done, t_s)

    def since(self, start_s: float) -> str:
        """The finding in words, its time counted from `start_s`."""
        where = self.where if self.t_s is None else f"{self.t_s - start_s:.1f} s"
        return f"{where}: {self.what}; {self.done}"

    def __str__(self) -> str:
        return self.since(0.0)


@dataclass(frozen=True, slots=True)
class WindReference:
    """What an anemometer beside the telemetry says: where the air moves to, (n, 2), north east."""

    t_s: Floats
    to_ne_mps: Floats


@dataclass(frozen=True, slots=True)
class RecordedFlight:
    """`events` in the order of their times. `vehicle` is `MULTIROTOR`, another kind's name, or
    `None` where the log does not tell.

    `utc_at_zero_s`: seconds since 1970 at zero of the log's clock, where the log states that.
    `position_measured`: false where the log has velocities only and positions are their sum from
    the first row, about 0 N 0 E. `powered`: the log tells voltage and current.
    """

    source: str
    events: tuple[Event, ...]
    findings: tuple[LogFinding, ...] = ()
    autopilot_kind: AutopilotKind | None = None
    vehicle: str | None = None
    firmware: str | None = None
    position_measured: bool = True
    reference: WindReference | None = None
    utc_at_zero_s: float | None = None

    @property
    def start_s(self) -> float:
        """Time of the first event."""
        return self.events[0].t_s if self.events else 0.0

    @property
    def duration_s(self) -> float:
        """From the first event to the last."""
        return self.events[-1].t_s - self.events[0].t_s if self.events else 0.0

    def has(self, kind: type[Event]) -> bool:
        """Tell whether the log has any event of this kind."""
        return any(isinstance(event, kind) for event in self.events)

    @property
    def has_battery(self) -> bool:
        """Tell whether the energy ledger has anything to begin with."""
        return any(isinstance(e, Battery) and e.voltage_v is not None for e in self.events)

    @property
    def powered(self) -> bool:
        """Tell whether battery voltage and current are in the log together."""
        known = [e for e in self.events if isinstance(e, Battery)]
        return any(e.voltage_v is not None for e in known) and any(
            e.current_a is not None for e in known
        )

    @property
    def flies_by_tilt(self) -> bool:
        """A multirotor, or taken for one because the log does not tell."""
        return self.vehicle in (None, MULTIROTOR)


@dataclass(frozen=True, slots=True)
class FlightSamples:
    """A recorded flight on an even grid of times, (n,) each; unknown or stale is NaN.

    Velocities NED, angles in rad, `wind_to_*` is the autopilot's own; `consumed_ah` and
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


def moments(
    flight: RecordedFlight, period_s: float, pack_v: tuple[float, float] | None = None
) -> Iterator[TelemetryState]:
    """Yield the situation about every `period_s`, when everything up to then has been heard.

    Moments fall on telemetry, as the companion's ticks do; it is one object that goes on changing.
    Silences longer than `period_s` have moments of their own, up to `LARGEST_GAP_S`.
    """
    now = TelemetryState() if pack_v is None else TelemetryState().expecting(pack_v)
    ticked_s: float | None = None
    events = flight.events
    for i, event in enumerate(events):
        now.update(event)
        following_s = events[i + 1].t_s if i + 1 < len(events) else math.inf
        if following_s <= event.t_s:
            continue
        if ticked_s is None or event.t_s - ticked_s >= period_s - 0.005:
            ticked_s = event.t_s
            yield now
        while ticked_s + 2.0 * period_s < following_s < ticked_s + LARGEST_GAP_S:
            ticked_s += period_s
            now.t_s = max(now.t_s, ticked_s)
            yield now


def sampled(flight: RecordedFlight, period_s: float = 0.2) -> FlightSamples:
    """Return the flight on a grid of times; NaN where a value is unknown or too old to use."""
    times: list[float] = []
    flags: list[tuple[bool, bool]] = []
    rows: list[list[float]] = []
    for now in moments(flight, period_s):
        times.append(now.t_s)
        flags.append((now.airborne, now.armed))
        rows.append(_row(now))
    values = np.array(rows, float).reshape(len(rows), -1)
    told = np.array(flags, bool).reshape(len(flags), 2)
    return FlightSamples(np.array(times), told[:, 0], told[:, 1], *values.T)


def _row(now: TelemetryState) -> list[float]:
    row: list[float] = []
    for name, max_age_s, fields in _MEASURED:
        sample = getattr(now, name)
        fresh = now.is_fresh(sample, max_age_s)
        for field in fields:
            value = getattr(sample, field) if fresh else None
            row.append(math.nan if value is None else value)
    return row


def first_position(flight: RecordedFlight) -> Position | None:
    """Return the first position of the log, where there is one."""
    return next((e for e in flight.events if isinstance(e, Position)), None)
