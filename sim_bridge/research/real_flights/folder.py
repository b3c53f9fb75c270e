"""A folder of recorded flights, read once and measured."""

import datetime
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from companion.adapters.logs.flight_table import FlightTableRow, read_flight_table
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.analysis.measured_energy.flight_measurements import (
    FlightMeasurements,
    measure_recorded_flight,
)
from companion.analysis.replay.recorded_flight import first_position
from companion.app.api import read_airframe
from companion.core.base.errors import LeewayError
from companion.core.base.geo import ne_offset_m
from companion.core.vehicle.airframe import Airframe

DEFAULT_TEMPERATURE_C = 20.0
"""Air temperature if not specified, as in `companion calibrate`."""

PITTSBURGH_DEG = (40.4, -79.9)
CLIMATE_RADIUS_M = 100_000.0
"""Radius in which the climate of `climate_normal_temperature_c` is valid."""


@dataclass(frozen=True, slots=True)
class ReadFlight:
    """One flight of the table with the measurements of its log, which has a track."""

    ordered: FlightTableRow
    measured: FlightMeasurements


@dataclass(frozen=True, slots=True)
class FlightFolder:
    """Usable flights by day and hour, rejected flights with reasons, and findings, by name."""

    flights: tuple[ReadFlight, ...]
    rejected: tuple[str, ...]
    findings: tuple[str, ...]


def climate_normal_temperature_c(date: str, hour: float) -> float:
    """Return the normal temperature at Pittsburgh at this date and hour (local daylight time).

    A sine over the year and one over the day, through the normals of 1981 to 2010 in the daily
    climate reports of the National Weather Service (product CLIPIT): highest and lowest of 21
    February 5 and -4 C, 1 June 24 and 12, 17 September 23 and 12, 26 October 15 and 4, 9 December 5
    and -2, met within 1 degree; about the yearly mean of 11.0 C (normals of 1991 to 2020).
    """
    day = datetime.date.fromisoformat(date).timetuple().tm_yday
    seasonal_c = 12.2 * math.cos(2.0 * math.pi * (day - 203) / 365.25)
    return 11.0 + seasonal_c + 5.4 * math.cos(2.0 * math.pi * (hour - 15.5) / 24.0)


@lru_cache(maxsize=2)
def read_usable_flights(folder: Path, airframe: str) -> FlightFolder:
    """Read all flights; unusable flights are excluded and reported.

    Raises LeewayError if the table is invalid or no flight is left. If the table has no temperature
    and the flights are near Pittsburgh, the normal temperature is used.
    """
    start = read_airframe(airframe)
    flights: list[ReadFlight] = []
    left_out: list[str] = []
    findings: list[str] = []
    for ordered in read_flight_table(folder):
        try:
            flight, words = read_flight_and_findings(ordered, start)
        except LeewayError as error:
            left_out.append(f"flight {ordered.name}: {error}")
            continue
        flights.append(flight)
        findings += [f"flight {ordered.name}: {one}" for one in words]
    if not flights:
        raise LeewayError(f"{folder}: no usable flight; {left_out[0]}")
    return FlightFolder(tuple(flights), tuple(left_out), tuple(findings))


def read_flight_and_findings(
    table_row: FlightTableRow, start_airframe: Airframe
) -> tuple[ReadFlight, tuple[str, ...]]:
    """Return one flight and its reader's findings. Raises LeewayError if it is unusable."""
    log = read_log_of_any_format(table_row.path)
    position = first_position(log)
    if position is None:
        raise LeewayError("no row with a position")
    temperature_c = table_row.temperature_c
    if temperature_c is None:
        position_deg = (position.lat_deg, position.lon_deg)
        near = math.hypot(*ne_offset_m(*PITTSBURGH_DEG, *position_deg)) < CLIMATE_RADIUS_M
        temperature_c = (
            climate_normal_temperature_c(table_row.date, table_row.hour)
            if near
            else DEFAULT_TEMPERATURE_C
        )
    measured = measure_recorded_flight(
        log, table_row.name, table_row.payload_kg, temperature_c, start_airframe
    )
    if not isinstance(measured, FlightMeasurements):
        raise LeewayError("on the ground throughout: not a flight")
    words = [*map(str, log.findings), *measured.prepared.notes]
    if measured.track.ends_in_flight:
        words.append("log: ends in flight; only its wind is evaluated")
    return ReadFlight(table_row, measured), tuple(words)
