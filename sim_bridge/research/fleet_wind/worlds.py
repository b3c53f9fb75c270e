"""The winds of a study: truths that carry one half of a recording, beliefs fitted to the other."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.tellings import WindTelling
from companion.core.wind_fit.fit import fit_process, ten_second_means
from sim_bridge.research.fleet_wind.patrols import HEIGHT_M, Patrol
from sim_bridge.research.promise.recording import read_recording
from sim_bridge.truth.fields.site_wind import SiteWind

LEAST_HALF_S = 1200
TOLD_EVERY_S = 10
TOLD_STD_MPS = 0.5
"""New each time, on each axis: what a belief's 10 s mean is off by."""


@dataclass(frozen=True, slots=True)
class Half:
    """Wind (n, 2) at whole seconds that is judged, and the process fitted to the other half."""

    name: str
    wind_ne_mps: Floats
    process: WindProcessParams


def halves_of(path: Path) -> tuple[Half, Half]:
    """Both halves of a recording's longest stretch, each with the process of the other.

    Raises LeewayError where it is too short.
    """
    stretch = max(read_recording(path).stretches, key=lambda one: one.seconds)
    middle = stretch.wind_ne_mps.shape[0] // 2
    if middle < LEAST_HALF_S:
        raise LeewayError(
            f"{path}: the longest stretch lasts {stretch.seconds} s:"
            f" expected {2 * LEAST_HALF_S} s or more, one half to fit and one to judge"
        )
    first, second = stretch.wind_ne_mps[:middle], stretch.wind_ne_mps[middle:]
    return (
        Half(f"{stretch.name}, first half", first, fitted(second)),
        Half(f"{stretch.name}, second half", second, fitted(first)),
    )


def fitted(wind_ne_mps: Floats) -> WindProcessParams:
    """The process of wind at whole seconds, as `companion fit-wind` finds it."""
    seconds = np.arange(wind_ne_mps.shape[0], dtype=np.float64)
    return fit_process(ten_second_means(seconds, wind_ne_mps), "other half").process


@dataclass(frozen=True, slots=True)
class FleetWorld:
    """One draw: the truth, the drones in it, and what each tells every 10 s.

    `told` (drones, tellings, 2) at `told_s`: means of the seconds before, with noise.
    """

    truth: SiteWind
    seconds: int
    process: FieldProcess
    drones: list[Patrol]
    told_s: Floats
    told: Floats

    def telling(self, number: int, index: int) -> WindTelling:
        """One drone's telling."""
        t_s = float(self.told_s[index])
        north, east = self.drones[number].at(np.array([t_s]))[0]
        wind = self.told[number, index]
        variance = TOLD_STD_MPS**2
        return WindTelling(
            self.drones[number].name,
            t_s,
            (float(north), float(east)),
            HEIGHT_M,
            (float(wind[0]), float(wind[1])),
            (variance, 0.0, variance),
        )

    def mean_truth(self, place_ne_m: Floats, first_s: float, last_s: float) -> Floats:
        """True mean wind (2,) at a place over some seconds."""
        count = max(math.ceil(last_s - first_s), 1)
        t_s = np.linspace(first_s, last_s, count, endpoint=False) + 0.5
        return self.truth.to_ne_mps(t_s, place_ne_m[0], place_ne_m[1], HEIGHT_M).mean(axis=0)


def world_of(
    truth: SiteWind,
    seconds: int,
    process: WindProcessParams,
    ways: list[Patrol],
    rng: np.random.Generator,
) -> FleetWorld:
    """What the drones tell in a truth."""
    every = np.arange(TOLD_EVERY_S, seconds + 1, TOLD_EVERY_S)
    within = np.arange(every[-1]) + 0.5
    told = np.empty((len(ways), every.size, 2))
    for number, way in enumerate(ways):
        place = way.at(within)
        wind = truth.to_ne_mps(within, place[:, 0], place[:, 1], HEIGHT_M)
        told[number] = wind.reshape(every.size, TOLD_EVERY_S, 2).mean(axis=1)
    told += TOLD_STD_MPS * rng.standard_normal(told.shape)
    return FleetWorld(truth, seconds, FieldProcess(process), ways, every.astype(float), told)
