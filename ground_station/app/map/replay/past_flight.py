"""One past flight: its decision record on the desk's clock, converted to reported states."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from msgspec import UNSET, UnsetType

from companion.core.base.geo import ne_offset_m
from companion.core.mission.event_text import DecisionEvent
from companion.fleet.messages import EventKind, FleetEvent, State
from ground_station.adapters.files.flight_record import (
    ROUTE_TOPIC,
    UNIX_S,
    FlightRecord,
    Row,
    read_flight_record,
)
from ground_station.adapters.store.past_store import PastEvent
from ground_station.app.map.fleet_receiver import (
    MIN_COURSE_DISTANCE_M,
    ReturnMarginSample,
    VehicleTrack,
)
from ground_station.core.fleet.fleet_status import STANDBY

UNKNOWN_PAYLOAD_KG = 0.0
"""Maximum payload in a rebuilt state: it is not recorded, and no map shows it."""

COURSE_WINDOW_S = 20.0
"""Maximum time before the requested moment in which the course of a slow drone is determined."""


@dataclass(frozen=True, slots=True)
class FlightRecordFiles:
    """Paths of a flight's record: one file for each start of its companion."""

    vehicle: str
    assignment: str | None
    paths: tuple[Path, ...]


class PastFlight:
    """A flight and its record, which is read on first access."""

    def __init__(self, files: FlightRecordFiles, events: Iterable[PastEvent]) -> None:
        """`events`: those of its assignment, as a desk received them."""
        self.vehicle, self.assignment = files.vehicle, files.assignment
        self._paths, self._events = files.paths, list(events)

    @cached_property
    def combined_record(self) -> FlightRecord:
        """The combined record of all starts of its companion."""
        first, *more = (read_flight_record(path) for path in self._paths)
        for other in more:
            for topic, rows in other.rows.items():
                first.rows[topic] = sorted(first.rows[topic] + rows, key=lambda row: row[UNIX_S])
            first.read_error = first.read_error or other.read_error
        return first

    @property
    def record_fault_text(self) -> str | None:
        """Fault of its record, as text; None: no fault."""
        flight_label = f"{self.vehicle}{f' ({self.assignment})' if self.assignment else ''}"
        if self.combined_record.read_error is not None:
            return (
                f"{flight_label}: its record {self._paths[0].name}:"
                f" {self.combined_record.read_error}"
            )
        return (
            f"{flight_label}: its record is empty"
            if self.combined_record.first_and_last_time_s is None
            else None
        )

    @cached_property
    def _companion_to_desk_offset_us(self) -> int:
        """Offset from the companion's clock, which stamps rows and events, to the desk's: that of
        the event with the smallest transmission delay; 0 without events. Wrong for a part of a
        flight in which the companion's clock was set.
        """
        own = (one for one in self._events if one.event.vehicle == self.vehicle)
        return min((one.received_us - one.event.epoch_us for one in own), default=0)

    def _companion_unix_s(self, t_us: int) -> float:
        return 1e-6 * (t_us - self._companion_to_desk_offset_us)

    def _desk_us(self, unix_s: float) -> int:
        return self._companion_to_desk_offset_us + round(1e6 * unix_s)

    @property
    def record_time_span_us(self) -> tuple[int, int] | None:
        """First and last time of its record; None: empty."""
        span = self.combined_record.first_and_last_time_s
        if span is None:
            return None
        return self._desk_us(span[0]), self._desk_us(span[1])

    def covers_time(self, t_us: int) -> bool:
        """Whether its record covers this time."""
        span = self.record_time_span_us
        return span is not None and span[0] <= t_us <= span[1]

    def state_at(self, t_us: int, order: str | None) -> State | None:
        """Return the state as the vehicle would report it; None: before the first record."""
        unix_s, record = self._companion_unix_s(t_us), self.combined_record
        position_row = record.latest_row_at("heard_position", unix_s)
        assessed = record.latest_row_at("assessment", unix_s) or {}
        wind, phase = (
            record.latest_row_at("wind", unix_s) or {},
            record.latest_row_at("phase", unix_s),
        )
        if position_row is None and phase is None:
            return None
        position_row = position_row or {}
        return State(
            vehicle=self.vehicle,
            instance_id="record",
            uptime_s=max(float((position_row or phase or {}).get("t_s", 0.0)), 0.0),
            epoch_us=t_us,
            airframe="recorded",
            max_payload_kg=UNKNOWN_PAYLOAD_KG,
            phase=str((phase or {}).get("now", STANDBY)),
            log="record",
            last_seq=0,
            assignment=self.assignment or "flight",
            order=order,
            armed=bool((record.latest_row_at("heard_state", unix_s) or {}).get("armed", False)),
            delivered=any(
                row.get("kind") == "delivered" for row in record.rows_up_to("decision", unix_s)
            ),
            lat_deg=position_row.get("lat_deg"),
            lon_deg=position_row.get("lon_deg"),
            height_rel_m=position_row.get("height_rel_m"),
            ground_speed_mps=_speed_mps(position_row),
            energy_left_wh=(record.latest_row_at("energy", unix_s) or {}).get("left_wh"),
            wind_to_n_mps=wind.get("to_n_mps"),
            wind_to_e_mps=wind.get("to_e_mps"),
            text=str((record.latest_row_at("said", unix_s) or {}).get("text", "")),
            p_home=assessed.get("p_home"),
            p_home_limit=_p_home_limit_or_unset(assessed),
            p_home_now=assessed.get("p_home_now"),
            p_success=assessed.get("p_success"),
            margin_wh=assessed.get("margin_wh"),
        )

    def track_at(self, t_us: int) -> VehicleTrack:
        """Return its course, margins and probabilities until this time, and route."""
        unix_s = self._companion_unix_s(t_us)
        found = VehicleTrack(received_us=t_us)
        for row in self.combined_record.rows_up_to("heard_position", unix_s)[::-1]:
            position = row["lat_deg"], row["lon_deg"]
            found.course_origin = found.course_origin or position
            if unix_s - row[UNIX_S] > COURSE_WINDOW_S:
                break
            if (course_deg := _course_deg(position, found.course_origin)) is not None:
                found.course_deg = course_deg
                break
        for row in self.combined_record.rows_up_to("assessment", unix_s):
            at_us = self._desk_us(row[UNIX_S])
            found.margin_samples.append(
                ReturnMarginSample(at_us, row.get("margin_wh"), row.get("p_home"))
            )
        found.route = (self.combined_record.latest_row_at(ROUTE_TOPIC, unix_s) or {}).get("route")
        return found

    def rebuilt_decision_events(self) -> list[PastEvent]:
        """Return its decisions as a desk would receive them."""
        return [
            self._decision_event(n, row)
            for n, row in enumerate(self.combined_record.rows["decision"], 1)
        ]

    def _decision_event(self, n: int, row: Row) -> PastEvent:
        at_us = self._desk_us(row[UNIX_S])
        event = FleetEvent(
            vehicle=self.vehicle,
            log="record",
            seq=n,
            epoch_us=at_us,
            kind=EventKind.DECISION,
            text=_decision_text(row),
            assignment=self.assignment or "flight",
            p_home=row.get("p_home"),
            margin_wh=row.get("margin_wh"),
        )
        return PastEvent(at_us, event)


def _decision_text(row: Row) -> str:
    return DecisionEvent(str(row.get("kind")), str(row.get("reason"))).text


def _p_home_limit_or_unset(assessed: Row) -> float | UnsetType:
    """Return the limit of evidence where it limited P(home)."""
    p_home, stated = assessed.get("p_home"), assessed.get("p_home_stated")
    return UNSET if p_home is None or stated is None or stated >= p_home else stated


def _speed_mps(position_row: Row) -> float | None:
    north, east = position_row.get("vel_n_mps"), position_row.get("vel_e_mps")
    return None if north is None or east is None else math.hypot(north, east)


def _course_deg(
    previous_position: tuple[float, float], position: tuple[float, float]
) -> float | None:
    north_m, east_m = ne_offset_m(*previous_position, *position)
    if math.hypot(north_m, east_m) < MIN_COURSE_DISTANCE_M:
        return None
    return math.degrees(math.atan2(east_m, north_m)) % 360.0
