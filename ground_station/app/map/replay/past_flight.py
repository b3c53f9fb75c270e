"""One past flight: its decision record on the desk's clock, as the states that it would tell."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from companion.core.base.geo import offset_m
from companion.fleet.messages import EventKind, FleetEvent, State
from ground_station.adapters.files.flight_record import (
    ROUTE,
    FlightRecord,
    Row,
    read_flight_record,
)
from ground_station.adapters.store.past_store import PastEvent
from ground_station.app.map.fleet_ear import MOVED_M, PromiseSample, VehicleTrack, WindCov

PAYLOAD_KG = 0.0
"""Heaviest parcel of a state that is rebuilt: no record tells it, and no map shows it."""

COURSE_BACK_S = 20.0
"""So far back a drone that hardly moves is looked for its course."""


@dataclass(frozen=True, slots=True)
class RecordFiles:
    """Where a flight's record lies: one file for each life of its companion."""

    vehicle: str
    assignment: str | None
    paths: tuple[Path, ...]


class PastFlight:
    """A flight and its record, which is read when it is first asked for."""

    def __init__(self, files: RecordFiles, events: Iterable[PastEvent]) -> None:
        """`events`: those of its assignment, as a desk heard them."""
        self.vehicle, self.assignment = files.vehicle, files.assignment
        self._paths, self._events = files.paths, list(events)

    @cached_property
    def record(self) -> FlightRecord:
        """The record of all lives of its companion."""
        first, *more = (read_flight_record(path) for path in self._paths)
        for other in more:
            for topic, rows in other.rows.items():
                first.rows[topic] = sorted(first.rows[topic] + rows, key=lambda row: row["t_s"])
            first.damage = first.damage or other.damage
        return first

    @property
    def trouble(self) -> str | None:
        """What is wrong with its record, for people; None: nothing."""
        where = f"{self.vehicle}{f' ({self.assignment})' if self.assignment else ''}"
        if self.record.damage is not None:
            return f"{where}: its record {self._paths[0].name}: {self.record.damage}"
        return f"{where}: its record is empty" if self.record.span_s is None else None

    @cached_property
    def offset_us(self) -> int:
        """What is added to the autopilot's time for the desk's: by the decisions that both have,
        else by the record's own stamps, else by when its file was written last.
        """
        heard = {one.event.text: one.heard_us for one in reversed(self._events)}
        apart = [
            heard[words] - round(1e6 * row["t_s"])
            for row in self.record.rows["decision"]
            if (words := f"{row.get('kind')}: {row.get('reason')}") in heard
        ]
        if apart:
            return min(apart)  # the least delay on the way to the desk
        if self.record.wall_offset_s is not None:
            return round(1e6 * self.record.wall_offset_s)
        _, last_s = self.record.span_s or (0.0, 0.0)
        return round(1e6 * (_written_s(self._paths) - last_s))

    @property
    def span_us(self) -> tuple[int, int] | None:
        """First and last time of its record; None: it is empty."""
        span = self.record.span_s
        if span is None:
            return None
        return self.offset_us + round(1e6 * span[0]), self.offset_us + round(1e6 * span[1])

    def covers(self, t_us: int) -> bool:
        """Whether its record tells of this time."""
        span = self.span_us
        return span is not None and span[0] <= t_us <= span[1]

    def state(self, t_us: int, order: str | None) -> State | None:
        """What it would have told; None: nothing is recorded yet."""
        t_s, record = (t_us - self.offset_us) / 1e6, self.record
        place, assessed = record.at("heard_position", t_s), record.at("assessment", t_s) or {}
        wind, phase = record.at("wind", t_s) or {}, record.at("phase", t_s)
        if place is None and phase is None:
            return None
        place = place or {}
        return State(
            vehicle=self.vehicle,
            life="record",
            uptime_s=max(t_s, 0.0),
            epoch_us=t_us,
            airframe="recorded",
            max_payload_kg=PAYLOAD_KG,
            phase=str((phase or {}).get("now", "standby")),
            log="record",
            last_seq=0,
            assignment=self.assignment or "flight",
            order=order,
            armed=bool((record.at("heard_state", t_s) or {}).get("armed", False)),
            delivered=any(row.get("kind") == "delivered" for row in record.until("decision", t_s)),
            lat_deg=place.get("lat_deg"),
            lon_deg=place.get("lon_deg"),
            height_rel_m=place.get("height_rel_m"),
            ground_speed_mps=_speed_mps(place),
            energy_left_wh=(record.at("energy", t_s) or {}).get("left_wh"),
            wind_to_n_mps=wind.get("to_n_mps"),
            wind_to_e_mps=wind.get("to_e_mps"),
            text=str((record.at("said", t_s) or {}).get("text", "")),
            p_home=assessed.get("p_home"),
            p_home_now=assessed.get("p_home_now"),
            p_success=assessed.get("p_success"),
            margin_wh=assessed.get("margin_wh"),
        )

    def track(self, t_us: int) -> VehicleTrack:
        """Where it moved to, its promise so far, its route, how sure it was of the wind."""
        t_s = (t_us - self.offset_us) / 1e6
        found = VehicleTrack(heard_us=t_us)
        for row in self.record.until("heard_position", t_s)[::-1]:
            here = row["lat_deg"], row["lon_deg"]
            found.from_ = found.from_ or here
            if t_s - row["t_s"] > COURSE_BACK_S:
                break
            if (course_deg := _course_deg(here, found.from_)) is not None:
                found.course_deg = course_deg
                break
        for row in self.record.until("assessment", t_s):
            at_us = self.offset_us + round(1e6 * row["t_s"])
            found.promises.append(PromiseSample(at_us, row.get("margin_wh"), row.get("p_home")))
        found.route = (self.record.at(ROUTE, t_s) or {}).get("route")
        found.wind_cov_m2ps2 = _cov(self.record.at("wind", t_s) or {})
        return found

    def decisions(self) -> list[PastEvent]:
        """Its decisions, as a desk would have heard them."""
        return [self._event(n, row) for n, row in enumerate(self.record.rows["decision"], 1)]

    def _event(self, n: int, row: Row) -> PastEvent:
        at_us = self.offset_us + round(1e6 * row["t_s"])
        event = FleetEvent(
            vehicle=self.vehicle,
            log="record",
            seq=n,
            epoch_us=at_us,
            kind=EventKind.DECISION,
            text=f"{row.get('kind')}: {row.get('reason')}",
            assignment=self.assignment or "flight",
            p_home=row.get("p_home"),
            margin_wh=row.get("margin_wh"),
        )
        return PastEvent(at_us, event)


def _written_s(paths: tuple[Path, ...]) -> float:
    try:
        return max(path.stat().st_mtime for path in paths)
    except OSError:
        return 0.0


def _speed_mps(place: Row) -> float | None:
    north, east = place.get("vel_n_mps"), place.get("vel_e_mps")
    return None if north is None or east is None else math.hypot(north, east)


def _cov(wind: Row) -> WindCov | None:
    nn, ne, ee = (wind.get(name) for name in ("nn_m2ps2", "ne_m2ps2", "ee_m2ps2"))
    return None if nn is None or ne is None or ee is None else (nn, ne, ee)


def _course_deg(before: tuple[float, float], here: tuple[float, float]) -> float | None:
    north_m, east_m = offset_m(*before, *here)
    if math.hypot(north_m, east_m) < MOVED_M:
        return None
    return math.degrees(math.atan2(east_m, north_m)) % 360.0
