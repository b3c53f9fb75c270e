"""One day of one folder: the airframe from the folder's other days, then every estimator."""

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np

from companion.adapters.files.params import read_airframe
from companion.core.base.arrays import Floats
from companion.core.calibration.airframe_fit import calibrate
from companion.core.calibration.drag import DragPriors
from companion.core.vehicle.airframe import Airframe
from sim_bridge.research.real_flights.fold import as_reported
from sim_bridge.research.windbench.estimators import BOARD, COLD_STARTS, Believed, in_study
from sim_bridge.research.windbench.flights import (
    BenchFlight,
    BenchFolder,
    Window,
    cold_starts,
    levelled,
    read_bench_folder,
)
from sim_bridge.research.windbench.score import LEAST_DAYS, Scored

CALIBRATED_FLIGHTS = 12
"""Spread evenly over the other days: drag to 3 %, in two seconds."""


@dataclass(frozen=True, slots=True)
class BenchDay:
    """What is judged: a day of a folder, by these estimators (those of the study, and `own`).

    `symmetric`: the folder's airframe looks alike from ahead and from the side.
    """

    folder: Path
    day: str
    airframe: str
    own: tuple[str, ...]
    study: str = BOARD
    symmetric: bool = False


class DayResult(msgspec.Struct, frozen=True):
    """Windows by estimator."""

    rows: dict[str, list[Scored]]


_read = lru_cache(maxsize=4)(read_bench_folder)


def run_day(asked: BenchDay) -> DayResult:
    """Judge one day; nothing of it is fitted to."""
    folder = _read(asked.folder, asked.airframe)
    priors = DragPriors.symmetric() if asked.symmetric else None
    airframe = calibrated(folder, asked.day, read_airframe(asked.airframe), priors)
    found: dict[str, list[Scored]] = {}
    contestants = in_study(asked.study, asked.own)
    for flight in (f for f in folder.flights if f.day == asked.day):
        level, plain = levelled(flight, airframe), as_reported(airframe)
        for piece in cold_starts(level) if asked.study == COLD_STARTS else (level,):
            for name, estimate in contestants.items():
                believed = estimate(piece, plain)
                rows = [_scored(folder.name, piece, w, believed) for w in piece.windows]
                found.setdefault(name, []).extend(rows)
    return DayResult(found)


def calibrated(
    folder: BenchFolder, day: str, start: Airframe, priors: DragPriors | None = None
) -> Airframe:
    """The start airframe fitted to the folder's other days; as it is where they are too few."""
    others = [f for f in folder.flights if f.day != day and f.blocks is not None]
    if len({f.day for f in others}) < LEAST_DAYS - 1:
        return start
    chosen = sorted({round(i) for i in np.linspace(0, len(others) - 1, CALIBRATED_FLIGHTS)})
    blocks = [others[i].blocks for i in chosen]
    known = [b for b in blocks if b is not None]
    return calibrate(known, start, leave_out=False, priors=priors).airframe


def _scored(folder: str, flight: BenchFlight, window: Window, believed: Believed) -> Scored:
    air = flight.velocity_ne_mps[window.rows] - believed.mean_ne_mps[window.rows]
    std, vector = None, None
    if believed.cov_ne_m2ps2 is not None:
        std = _std_mps(air, believed.cov_ne_m2ps2[window.rows])
    if window.wind_to_ne_mps is not None:
        error = believed.mean_ne_mps[window.rows].mean(axis=0) - window.wind_to_ne_mps
        vector = float(np.hypot(*error))
    speed = float(np.nanmean(np.hypot(air[:, 0], air[:, 1])))
    return Scored(folder, flight.day, flight.name, window.read_mps, speed, std, vector)


def _std_mps(air: Floats, cov: Floats) -> float:
    """Of the airspeed: the wind's along the mean flow."""
    mean = np.nanmean(air, axis=0)
    unit = mean / max(float(np.hypot(*mean)), 1e-9)
    return math.sqrt(max(float(unit @ cov.mean(axis=0) @ unit), 1e-9))
