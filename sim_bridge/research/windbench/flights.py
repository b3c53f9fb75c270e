"""Recorded flights with an anemometer, in either layout: estimator inputs and reference
values."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from companion.adapters.logs.flight_table import TABLE_NAME
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.analysis.calibration.records import Blocks
from companion.analysis.replay.recorded_flight import (
    FlightSamples,
    WindReference,
    resample_flight_on_time_grid,
)
from companion.analysis.replay.replayed_wind import wind_observations_from_samples
from companion.app.api import read_airframe
from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.air import standard_air
from companion.core.wind.observation import WindObservation
from sim_bridge.research.real_flights.folder import read_usable_flights

SAMPLE_INTERVAL_S = 0.1
WINDOW_S = 10.0
STABILIZATION_S = 30.0
MIN_WINDOWS = 3
"""Of a start in the air: fewer are hardly an RMS error."""
_MIN_SHARE = 0.8
_MAX_REFERENCE_AGE_S = 1.0


@dataclass(frozen=True, slots=True)
class Window:
    """Ten seconds in flight: rows of the samples, and the anemometer's mean reading.

    `wind_to_ne_mps`: mean of a vector reference; `None` if only a speed is known.
    """

    rows: slice
    read_mps: float
    wind_to_ne_mps: Floats | None


@dataclass(frozen=True, slots=True)
class BenchFlight:
    """One flight. Flights are grouped by day; a log without a date is a separate day.

    `blocks`: for calibration, `None` without current data; velocity (n, 2) at each row.
    """

    name: str
    day: str
    observations: tuple[WindObservation, ...]
    velocity_ne_mps: Floats
    windows: tuple[Window, ...]
    blocks: Blocks | None = None


@dataclass(frozen=True, slots=True)
class BenchFolder:
    """Flights of a folder by day, and unusable flights with reasons."""

    name: str
    flights: tuple[BenchFlight, ...]
    rejected: tuple[str, ...]

    @property
    def days(self) -> list[str]:
        """Days in order."""
        return sorted({flight.day for flight in self.flights})


def read_bench_folder(folder: Path, airframe: str) -> BenchFolder:
    """Read a folder with `parameters.csv` or of CSV logs. Raises LeewayError if none is usable."""
    if not folder.is_dir():
        raise LeewayError(f"{folder}: no such folder")
    start = read_airframe(airframe)
    flights: list[BenchFlight] = []
    rejected: list[str] = []
    if (folder / TABLE_NAME).is_file():
        read = read_usable_flights(folder.resolve(), airframe)
        rejected += read.rejected
        for one in read.flights:
            ordered = one.ordered
            blocks = one.measured.prepared.blocks if ordered.has_route else None
            flight = _build_flight(
                ordered.name,
                ordered.date,
                one.measured.samples,
                start.flying_mass_kg(ordered.payload_kg),
                one.measured.density_kgpm3,
                blocks=blocks,
            )
            if flight is None:
                rejected.append(f"flight {ordered.name}: no ten seconds of airspeed in flight")
            else:
                flights.append(flight)
    else:
        for path in sorted([*folder.glob("*.csv"), *folder.glob("*.csv.gz")]):
            try:
                flights.append(_read_csv_flight(path, start.mass.empty_kg))
            except LeewayError as error:
                rejected.append(str(error))
    if not flights:
        reason = f"; {rejected[0]}" if rejected else ""
        raise LeewayError(f"{folder}: no flight with an anemometer, CSV expected{reason}")
    return BenchFolder(folder.name, tuple(flights), tuple(rejected))


def starts_in_the_air(flight: BenchFlight, interval_s: float) -> Iterator[BenchFlight]:
    """Yield the flight without what precedes each start: every `interval_s` from take-off on."""
    t_s = np.array([seen.t_s for seen in flight.observations])
    first_s = t_s[np.argmax([seen.airborne for seen in flight.observations])]
    for start_s in np.arange(first_s + interval_s, t_s[-1], interval_s):
        begin = int(np.searchsorted(t_s, start_s))
        stable = int(np.searchsorted(t_s, start_s + STABILIZATION_S))
        windows = tuple(
            replace(w, rows=slice(w.rows.start - begin, w.rows.stop - begin))
            for w in flight.windows
            if w.rows.start >= stable
        )
        if len(windows) >= MIN_WINDOWS:
            yield replace(
                flight,
                name=f"{flight.name} from {start_s - first_s:.0f} s",
                observations=flight.observations[begin:],
                velocity_ne_mps=flight.velocity_ne_mps[begin:],
                windows=windows,
            )


def _read_csv_flight(path: Path, mass_kg: float) -> BenchFlight:
    log = read_log_of_any_format(path)
    samples = resample_flight_on_time_grid(log, SAMPLE_INTERVAL_S)
    height_m = float(samples.alt_amsl_m[np.isfinite(samples.alt_amsl_m)][:1].sum())
    air = standard_air(max(height_m, 0.0))
    flight = _build_flight(path.name, path.name, samples, mass_kg, air.density_kgpm3, log.reference)
    if flight is None:
        raise LeewayError(
            f"{path.name}: no ten seconds in the air with airspeed_mps or wind_to_*_ref_mps"
        )
    return flight


def _build_flight(
    name: str,
    day: str,
    samples: FlightSamples,
    mass_kg: float,
    density_kgpm3: float,
    reference: WindReference | None = None,
    blocks: Blocks | None = None,
) -> BenchFlight | None:
    """Return the flight with its complete windows; None without one."""
    observations = tuple(wind_observations_from_samples(samples, mass_kg, density_kgpm3))
    airborne = np.array([seen.airborne for seen in observations])
    velocity = np.stack([samples.vel_n_mps, samples.vel_e_mps], axis=1)
    wind = _reference_wind_at_times(samples.t_s, reference)
    read = samples.airspeed_mps if wind is None else np.hypot(*(velocity - wind).T)
    usable = airborne & np.isfinite(read) & np.isfinite(velocity).all(axis=1)
    windows = tuple(_complete_windows(samples.t_s, airborne, usable, read, wind))
    return BenchFlight(name, day, observations, velocity, windows, blocks) if windows else None


def _reference_wind_at_times(t_s: Floats, reference: WindReference | None) -> Floats | None:
    """Return the reference wind (n, 2) at each row; NaN if no reference time is close."""
    if reference is None:
        return None
    at = np.clip(np.searchsorted(reference.t_s, t_s), 0, len(reference.t_s) - 1)
    near = np.abs(reference.t_s[at] - t_s) <= _MAX_REFERENCE_AGE_S
    return np.where(near[:, None], reference.to_ne_mps[at], np.nan)


def _complete_windows(
    t_s: Floats, airborne: Bools, usable: Bools, read_mps: Floats, wind: Floats | None
) -> Iterator[Window]:
    """Yield consecutive windows from STABILIZATION_S after take-off; gaps exclude a window."""
    if not airborne.any():
        return
    begin_s = t_s[np.argmax(airborne)] + STABILIZATION_S
    while begin_s + WINDOW_S <= t_s[-1]:
        rows = slice(*np.searchsorted(t_s, [begin_s, begin_s + WINDOW_S]).tolist())
        begin_s += WINDOW_S
        whole = rows.stop - rows.start >= _MIN_SHARE * WINDOW_S / SAMPLE_INTERVAL_S / 2.0
        if whole and usable[rows].mean() >= _MIN_SHARE:
            mean = None if wind is None else np.nanmean(wind[rows], axis=0)
            yield Window(rows, float(np.nanmean(read_mps[rows])), mean)
