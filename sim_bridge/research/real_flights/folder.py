"""A folder of recorded flights, read once: logs, tracks, calibration blocks, and the air."""

import datetime
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from companion.adapters.files.params import read_airframe
from companion.adapters.logs.calibration_logs import as_record
from companion.adapters.logs.flight_table import TabledFlight, read_flight_table
from companion.adapters.logs.open_log import open_log
from companion.core.base.errors import LeewayError
from companion.core.base.geo import offset_m
from companion.core.calibration.records import Blocks, prepare
from companion.core.calibration.standing import ground_test
from companion.core.measured_energy.flown_track import FlownTrack, flown_track
from companion.core.replay.recorded_flight import FlightSamples, first_position, sampled
from companion.core.vehicle.air import standard_air
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

UNSTATED_C = 20.0
"""What `companion calibrate` takes where nobody states the air's temperature."""

PITTSBURGH_DEG = (40.4, -79.9)
NEAR_M = 100_000.0
"""Where the climate below holds."""


@dataclass(frozen=True, slots=True)
class ReadFlight:
    """One flight of the table with its log: every telemetry row, the track, and 2 s blocks."""

    ordered: TabledFlight
    samples: FlightSamples
    track: FlownTrack
    blocks: Blocks
    temperature_c: float
    density_kgpm3: float
    start_v: float


@dataclass(frozen=True, slots=True)
class FlightFolder:
    """All usable flights by day and hour, and what was wrong with the others, by name."""

    flights: tuple[ReadFlight, ...]
    left_out: tuple[str, ...]
    findings: tuple[str, ...]


def normal_temperature_c(date: str, hour: float) -> float:
    """The usual temperature at Pittsburgh on this day of the year and hour (local daylight time).

    A sine over the year and one over the day, through the normals of 1981 to 2010 in the daily
    climate reports of the National Weather Service (product CLIPIT): highest and lowest of 21
    February 5 and -4 C, 1 June 24 and 12, 17 September 23 and 12, 26 October 15 and 4, 9 December 5
    and -2, met within 1 degree; about the yearly mean of 11.0 C (normals of 1991 to 2020).
    """
    day = datetime.date.fromisoformat(date).timetuple().tm_yday
    season = 12.2 * math.cos(2.0 * math.pi * (day - 203) / 365.25)
    return 11.0 + season + 5.4 * math.cos(2.0 * math.pi * (hour - 15.5) / 24.0)


@lru_cache(maxsize=2)
def read_folder(folder: Path, airframe: str, climate: bool = True) -> FlightFolder:
    """Read all flights; one that cannot be used is left out and said.

    LeewayError where the table is wrong or nothing is left. `climate`: where the table has no
    temperature and the flights are near Pittsburgh, it is the usual one.
    """
    start = read_airframe(airframe)
    flights: list[ReadFlight] = []
    left_out: list[str] = []
    findings: list[str] = []
    for ordered in read_flight_table(folder):
        try:
            flight, words = read_flight(ordered, start, climate)
        except LeewayError as error:
            left_out.append(f"flight {ordered.name}: {error}")
            continue
        flights.append(flight)
        findings += [f"flight {ordered.name}: {one}" for one in words]
    if not flights:
        raise LeewayError(f"{folder}: no flight that can be used; {left_out[0]}")
    return FlightFolder(tuple(flights), tuple(left_out), tuple(findings))


def read_flight(
    ordered: TabledFlight, start: Airframe, climate: bool
) -> tuple[ReadFlight, tuple[str, ...]]:
    """One flight, and what its reader found; LeewayError where it cannot be used."""
    log = open_log(ordered.path)
    position = first_position(log)
    if position is None:
        raise LeewayError("no row with a position")
    temperature_c = ordered.temperature_c
    if temperature_c is None:
        place = (position.lat_deg, position.lon_deg)
        usual = climate and _near_pittsburgh(place)
        temperature_c = normal_temperature_c(ordered.date, ordered.hour) if usual else UNSTATED_C
    hover_w = float(multirotor_power_w(start, start.mass_kg(ordered.payload_kg), 0.0))
    record = as_record(log, ordered.name, ordered.payload_kg, temperature_c)
    if ground_test(record, hover_w) is not None:
        raise LeewayError("stands on the ground throughout: not a flight")
    prepared = prepare(record, hover_w, start.battery.cells)
    samples = sampled(log, 0.1)
    track = flown_track(ordered.name, samples, ordered.payload_kg)
    words = [*map(str, log.findings), *prepared.notes]
    if track.cut_short:
        words.append("log: ends in the air; only its wind is judged")
    air = standard_air(position.alt_amsl_m, temperature_c)
    known = samples.voltage_v[np.isfinite(samples.voltage_v)]
    read = ReadFlight(
        ordered,
        samples,
        track,
        prepared.blocks,
        temperature_c,
        air.density_kgpm3,
        float(np.median(known[:8])),
    )
    return read, tuple(words)


def _near_pittsburgh(place_deg: tuple[float, float]) -> bool:
    return math.hypot(*offset_m(*PITTSBURGH_DEG, *place_deg)) < NEAR_M
