"""Measurements of one recorded flight: blocks, track, resting voltage, and the wind estimate."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from companion.analysis.calibration.ground_power import (
    StandingPower,
    motors_off_power_of_flightless_log,
)
from companion.analysis.calibration.records import (
    FlightRecord,
    PreparedFlight,
    convert_record_to_blocks,
)
from companion.analysis.measured_energy.flown_track import FlownTrack, build_flown_track
from companion.analysis.replay.recorded_flight import (
    FlightSamples,
    RecordedFlight,
    first_position,
    resample_flight_on_time_grid,
)
from companion.analysis.replay.replayed_wind import (
    FilteredWind,
    replay_filter,
    wind_observations_from_samples,
)
from companion.core.base.arrays import Floats
from companion.core.mission.events import Attitude, Battery, Position
from companion.core.vehicle.air import standard_air
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w
from companion.core.wind.estimator import WindEstimator

SAMPLE_INTERVAL_S = 0.1
_RESTING_SAMPLES = 8
_COLUMNS = 9


@dataclass(frozen=True)
class FlightMeasurements:
    """One flight: samples every `SAMPLE_INTERVAL_S`, and blocks of 2 s with notes on the log.

    `payload_kg` is the payload carried, kg; `prepared.blocks` holds the air density, kg/m^3.
    """

    name: str
    payload_kg: float
    samples: FlightSamples
    prepared: PreparedFlight

    @cached_property
    def track(self) -> FlownTrack:
        """Track from power on to power off. Raises LeewayError for missing data or a long gap."""
        return build_flown_track(self.name, self.samples, self.payload_kg)

    @property
    def density_kgpm3(self) -> float:
        """Air density at the first position, kg/m^3."""
        return self.prepared.blocks.density_kgpm3

    @property
    def resting_voltage_v(self) -> float:
        """Pack voltage at the start of the log, before take-off, V."""
        known_v = self.samples.voltage_v[np.isfinite(self.samples.voltage_v)]
        return float(np.median(known_v[:_RESTING_SAMPLES]))


def measure_recorded_flight(
    flight: RecordedFlight, name: str, payload_kg: float, temperature_c: float, airframe: Airframe
) -> FlightMeasurements | StandingPower:
    """Return the measurements of a flight, or the standing power of a log without a flight.

    `payload_kg` is the payload carried, kg; `temperature_c` the air temperature at the first
    position, degrees C. `airframe` provides the expected hover power, W, and the cell count.
    Raises LeewayError with name and row if a flight has missing data or implausible units.
    """
    record = build_calibration_record(flight, name, payload_kg, temperature_c)
    hover_w = float(multirotor_power_w(airframe, airframe.flying_mass_kg(payload_kg), 0.0))
    standing = motors_off_power_of_flightless_log(record, hover_w)
    if standing is not None:
        return standing
    prepared = convert_record_to_blocks(record, hover_w, airframe.battery.cells)
    samples = resample_flight_on_time_grid(flight, SAMPLE_INTERVAL_S)
    return FlightMeasurements(name, payload_kg, samples, prepared)


def build_calibration_record(
    flight: RecordedFlight, name: str, payload_kg: float, temperature_c: float
) -> FlightRecord:
    """Return one row per event with motion, attitude or power; the rest of the row is NaN."""
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
                row[7:9] = [_nan_if_unknown(event.voltage_v), _nan_if_unknown(event.current_a)]
            case _:
                continue
        rows.append(row)
    values = np.array(rows, float).reshape(-1, _COLUMNS)
    position = first_position(flight) if flight.position_measured else None
    alt_m = position.alt_amsl_m if position is not None else 0.0
    return FlightRecord(
        name=name,
        t_s=_times_with_microsecond_offsets_s(values[:, 0]),
        vel_ned_mps=values[:, 1:4],
        roll_rad=values[:, 4],
        pitch_rad=values[:, 5],
        yaw_rad=values[:, 6],
        voltage_v=values[:, 7],
        current_a=values[:, 8],
        payload_kg=np.full(len(values), payload_kg),
        density_kgpm3=standard_air(alt_m, temperature_c).density_kgpm3,
    )


def _nan_if_unknown(value: float | None) -> float:
    return math.nan if value is None else value


def _times_with_microsecond_offsets_s(t_s: Floats) -> Floats:
    """Separate events of one instant by a microsecond: record rows need distinct times."""
    return t_s + 1e-6 * np.arange(len(t_s)) / max(len(t_s), 1) if len(t_s) else t_s


def replay_wind_estimator(
    measured: FlightMeasurements, airframe: Airframe, *, with_airspeed: bool = False
) -> FilteredWind:
    """Return the product's wind estimate at each point of the track's grid.

    The estimate is that after the latest sample; `with_airspeed` adds the log's airspeed as a
    magnitude. Raises LeewayError if the log has no track.
    """
    times_s = measured.samples.t_s
    rows = np.searchsorted(times_s, measured.track.t_s, side="right") - 1
    observations = wind_observations_from_samples(
        measured.samples,
        airframe.flying_mass_kg(measured.payload_kg),
        measured.density_kgpm3,
        with_airspeed=with_airspeed,
    )
    wind = replay_filter(WindEstimator, airframe, observations)
    assert wind.cov_ne_m2ps2 is not None
    return FilteredWind(wind.mean_ne_mps[rows], wind.cov_ne_m2ps2[rows])
