"""Recorded flights with an anemometer, in either layout, as what an estimator hears and is judged
by."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from companion.adapters.files.params import read_airframe
from companion.adapters.logs.flight_table import TABLE
from companion.adapters.logs.open_log import open_log
from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError
from companion.core.calibration.records import Blocks
from companion.core.replay.heard_wind import heard
from companion.core.replay.recorded_flight import FlightSamples, WindReference, sampled
from companion.core.vehicle.air import standard_air
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.observation import WindObservation
from sim_bridge.research.real_flights.folder import read_folder

SAMPLED_EVERY_S = 0.1
WINDOW_S = 10.0
WARM_UP_S = 30.0
EVERY_S = 60.0
"""Between cold starts."""
_LEAST_SHARE = 0.8
_FRESH_S = 1.0


@dataclass(frozen=True, slots=True)
class Window:
    """Ten seconds in the air: rows of the samples, and what the anemometer read.

    `wind_to_ne_mps` is the mean of a reference that tells the vector; `None`: a speed alone.
    """

    rows: slice
    read_mps: float
    wind_to_ne_mps: Floats | None


@dataclass(frozen=True, slots=True)
class BenchFlight:
    """One flight. Flights of one day share its air; a log without a date is a day of its own.

    `blocks` for calibration, `None` where the log has no current; velocity (n, 2) at each row.
    """

    name: str
    day: str
    heard: tuple[WindObservation, ...]
    velocity_ne_mps: Floats
    windows: tuple[Window, ...]
    blocks: Blocks | None = None

    @property
    def t_s(self) -> Floats:
        """(n,)"""
        return np.array([seen.t_s for seen in self.heard])


@dataclass(frozen=True, slots=True)
class BenchFolder:
    """A folder's flights by day, and what could not be used, by name."""

    name: str
    flights: tuple[BenchFlight, ...]
    left_out: tuple[str, ...]

    @property
    def days(self) -> list[str]:
        """Days in order."""
        return sorted({flight.day for flight in self.flights})


def read_bench_folder(folder: Path, airframe: str) -> BenchFolder:
    """A folder with `parameters.csv`, or one of CSV logs; LeewayError where nothing can be used."""
    if not folder.is_dir():
        raise LeewayError(f"{folder}: no such folder")
    if (folder / TABLE).is_file():
        return _campaign(folder, airframe)
    mass_kg = read_airframe(airframe).mass.empty_kg
    flights, left_out = [], []
    for path in sorted([*folder.glob("*.csv"), *folder.glob("*.csv.gz")]):
        try:
            flights.append(_log(path, mass_kg))
        except LeewayError as error:
            left_out.append(str(error))
    return _checked(folder, flights, left_out)


def _checked(folder: Path, flights: list[BenchFlight], left_out: list[str]) -> BenchFolder:
    if not flights:
        why = f"; {left_out[0]}" if left_out else ""
        raise LeewayError(f"{folder}: no flight with an anemometer, CSV expected{why}")
    return BenchFolder(folder.name, tuple(flights), tuple(left_out))


def _campaign(folder: Path, airframe: str) -> BenchFolder:
    read = read_folder(folder.resolve(), airframe)
    flights, left_out = [], list(read.left_out)
    start = read_airframe(airframe)
    for flight in read.flights:
        mass_kg = start.mass_kg(flight.ordered.payload_kg)
        seen = tuple(heard(flight.samples, mass_kg, flight.density_kgpm3))
        windows = windows_of(flight.samples, seen, None)
        if not windows:
            left_out.append(f"flight {flight.ordered.name}: no ten seconds of airspeed in the air")
            continue
        name, date = flight.ordered.name, flight.ordered.date
        blocks = flight.blocks if flight.ordered.has_route else None
        flights.append(BenchFlight(name, date, seen, _velocity(flight.samples), windows, blocks))
    return _checked(folder, flights, left_out)


def _log(path: Path, mass_kg: float) -> BenchFlight:
    log = open_log(path)
    samples = sampled(log, SAMPLED_EVERY_S)
    height_m = float(samples.alt_amsl_m[np.isfinite(samples.alt_amsl_m)][:1].sum())
    air = standard_air(max(height_m, 0.0))
    seen = tuple(heard(samples, mass_kg, air.density_kgpm3))
    windows = windows_of(samples, seen, log.reference)
    if not windows:
        raise LeewayError(
            f"{path.name}: no ten seconds in the air with airspeed_mps or wind_to_*_ref_mps"
        )
    return BenchFlight(path.name, path.name, seen, _velocity(samples), windows)


def _velocity(samples: FlightSamples) -> Floats:
    return np.stack([samples.vel_n_mps, samples.vel_e_mps], axis=1)


def windows_of(
    samples: FlightSamples, heard: tuple[WindObservation, ...], reference: WindReference | None
) -> tuple[Window, ...]:
    """Whole windows one after another, from WARM_UP_S in the air on; gaps end a window."""
    aloft = np.array([seen.airborne for seen in heard])
    if not aloft.any():
        return ()
    velocity, wind = _velocity(samples), _reference(samples.t_s, reference)
    read = samples.airspeed_mps
    if wind is not None:
        read = np.hypot(*(velocity - wind).T)
    usable = aloft & np.isfinite(read) & np.isfinite(velocity).all(axis=1)
    return tuple(_cut(samples.t_s, aloft, usable, read, wind))


def _reference(t_s: Floats, reference: WindReference | None) -> Floats | None:
    """(n, 2) at each row, NaN away from the reference's own times."""
    if reference is None:
        return None
    at = np.clip(np.searchsorted(reference.t_s, t_s), 0, len(reference.t_s) - 1)
    near = np.abs(reference.t_s[at] - t_s) <= _FRESH_S
    return np.where(near[:, None], reference.to_ne_mps[at], np.nan)


def _cut(
    t_s: Floats, aloft: Bools, usable: Bools, read_mps: Floats, wind: Floats | None
) -> list[Window]:
    found = []
    begin_s = t_s[np.argmax(aloft)] + WARM_UP_S
    while begin_s + WINDOW_S <= t_s[-1]:
        rows = slice(*np.searchsorted(t_s, [begin_s, begin_s + WINDOW_S]).tolist())
        begin_s += WINDOW_S
        whole = rows.stop - rows.start >= _LEAST_SHARE * WINDOW_S / SAMPLED_EVERY_S / 2.0
        if not whole or usable[rows].mean() < _LEAST_SHARE:
            continue
        mean = None if wind is None else np.nanmean(wind[rows], axis=0)
        found.append(Window(rows, float(np.nanmean(read_mps[rows])), mean))
    return found


def cold_starts(flight: BenchFlight) -> list[BenchFlight]:
    """The flight begun anew at each full minute in the air: heard from there on, and judged for the
    minute that begins half a minute later."""
    t_s = flight.t_s
    aloft = np.array([seen.airborne for seen in flight.heard])
    found = []
    begin_s = float(t_s[np.argmax(aloft)])
    for minute in range(int((float(t_s[-1]) - begin_s) / EVERY_S) + 1):
        first = int(np.searchsorted(t_s, begin_s + EVERY_S * minute))
        last = int(np.searchsorted(t_s, t_s[first] + WARM_UP_S + EVERY_S + 1e-6))
        windows = tuple(
            replace(w, rows=slice(w.rows.start - first, w.rows.stop - first))
            for w in flight.windows
            if t_s[w.rows.start] >= t_s[first] + WARM_UP_S - 1e-6 and w.rows.stop <= last
        )
        if windows:
            piece = replace(
                flight,
                name=f"{flight.name}, begun {minute} min after take-off",
                heard=flight.heard[first:last],
                velocity_ne_mps=flight.velocity_ne_mps[first:last],
                windows=windows,
            )
            found.append(piece)
    return found


def levelled(flight: BenchFlight, airframe: Airframe) -> BenchFlight:
    """The flight with its attitude levelled by the airframe's mean trims."""
    drag = airframe.drag
    trims = math.radians(drag.trim_forward_deg), math.radians(drag.trim_right_deg)
    return replace(flight, heard=tuple(seen.levelled(*trims) for seen in flight.heard))
