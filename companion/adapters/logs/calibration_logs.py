"""Flight logs of any format as calibration records."""

import math
from pathlib import Path

import numpy as np

from companion.adapters.logs.open_log import open_log
from companion.core.base.errors import LeewayError
from companion.core.calibration.records import FlightRecord
from companion.core.mission.events import Attitude, Battery, Position
from companion.core.replay.recorded_flight import RecordedFlight, first_position
from companion.core.vehicle.air import standard_air

_COLUMNS = 9


def read_calibration_log(
    path: Path, payload_kg: float, temperature_c: float
) -> tuple[FlightRecord, tuple[str, ...]]:
    """A log's telemetry with the parcel that hung below, and what its reader found wrong."""
    flight = open_multirotor_log(path)
    return as_record(flight, path.name, payload_kg, temperature_c), tuple(
        f"{path.name}: {finding}" for finding in flight.findings
    )


def open_multirotor_log(path: Path) -> RecordedFlight:
    """A log of a multirotor; LeewayError for another vehicle."""
    flight = open_log(path)
    if not flight.flies_by_tilt:
        raise LeewayError(f"{path}: a {flight.vehicle}; a multirotor expected")
    return flight


def as_record(
    flight: RecordedFlight, name: str, payload_kg: float, temperature_c: float
) -> FlightRecord:
    """One row for each event that tells motion, attitude or power; the rest of the row is NaN."""
    rows = []
    for event in flight.events:
        row = [math.nan] * _COLUMNS
        row[0] = event.t_s
        match event:
            case Position():
                row[1:4] = [event.vel_n_mps, event.vel_e_mps, event.vel_d_mps]
            case Attitude():
                row[4:7] = [event.roll_rad, event.pitch_rad, event.yaw_rad]
            case Battery():
                row[7:9] = [_known(event.voltage_v), _known(event.current_a)]
            case _:
                continue
        rows.append(row)
    values = np.array(rows, float).reshape(-1, _COLUMNS)
    position = first_position(flight) if flight.position_measured else None
    alt_m = position.alt_amsl_m if position is not None else 0.0
    return FlightRecord(
        name=name,
        t_s=_apart(values[:, 0]),
        vel_ned_mps=values[:, 1:4],
        roll_rad=values[:, 4],
        pitch_rad=values[:, 5],
        yaw_rad=values[:, 6],
        voltage_v=values[:, 7],
        current_a=values[:, 8],
        payload_kg=np.full(len(values), payload_kg),
        density_kgpm3=standard_air(alt_m, temperature_c).density_kgpm3,
    )


def _known(value: float | None) -> float:
    return math.nan if value is None else value


def _apart(t_s: np.ndarray) -> np.ndarray:
    """Events of one instant a microsecond apart: rows of a record have times of their own."""
    return t_s + 1e-6 * np.arange(len(t_s)) / max(len(t_s), 1) if len(t_s) else t_s
