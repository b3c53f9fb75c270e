"""The wind estimator over a recorded flight, and its airspeed against the anemometer's.

The anemometer's direction errs with heading, so that its magnitude alone is the truth. It sits in
the rotors' flow and reads `scale * airspeed + bias`: both are learned on fitting flights, from what
the very estimator that is judged believes there, leg by leg.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.measured_energy.flown_track import FlownTrack
from companion.core.replay.heard_wind import heard
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.estimator import WindEstimator
from companion.core.wind.observation import WindFilter, WindObservation
from sim_bridge.research.real_flights.folder import ReadFlight
from sim_bridge.research.wind.rival_filters import replayed

WINDOW_S = 10.0
_SETTLED_S = 2.0
"""Of a leg's ends: the anemometer's own filter has not caught up."""
_LEAST_SHARE = 0.8
_LEAST_LEGS = 6
_LEAST_SPREAD_MPS = 1.0


@dataclass(frozen=True, slots=True)
class WindReplay:
    """Belief at the track's grid: mean (n, 2), where the air moves to, and covariance (n, 2, 2)."""

    mean_ne_mps: Floats
    cov_ne_m2ps2: Floats


@dataclass(frozen=True, slots=True)
class AnemometerScale:
    """What the anemometer makes of an airspeed; `std_mps` is left over in a leg's mean."""

    scale: float
    bias_mps: float
    std_mps: float


@dataclass(frozen=True, slots=True)
class AirspeedMean:
    """One stretch: airspeed by the anemometer, by the estimator with its std, and over ground."""

    read_mps: float
    believed_mps: float
    std_mps: float
    ground_mps: float

    def as_read(self, anemometer: AnemometerScale) -> "AirspeedMean":
        """The belief as the anemometer would read it."""
        believed_mps = anemometer.scale * self.believed_mps + anemometer.bias_mps
        return replace(self, believed_mps=believed_mps, std_mps=anemometer.scale * self.std_mps)


def observations(
    flight: ReadFlight, airframe: Airframe, *, with_airspeed: bool
) -> Iterable[WindObservation]:
    """What the estimator hears: velocity and attitude, and the anemometer if asked for."""
    mass_kg = airframe.mass_kg(flight.ordered.payload_kg)
    return heard(flight.samples, mass_kg, flight.density_kgpm3, with_airspeed=with_airspeed)


def replay_wind(
    flight: ReadFlight,
    airframe: Airframe,
    *,
    with_airspeed: bool = False,
    make: type[WindFilter] = WindEstimator,
) -> WindReplay:
    """The product's estimator over one flight; its belief at each point of the track's grid."""
    seen = observations(flight, airframe, with_airspeed=with_airspeed)
    return WindReplay(*replayed(make, airframe, seen, rows_of_grid(flight)))


def rows_of_grid(flight: ReadFlight) -> Ints:
    """The sample that holds at each point of the track's grid."""
    times = flight.samples.t_s
    last = np.searchsorted(times, flight.track.t_s, side="right") - 1
    return np.clip(last, 0, len(times) - 1)


def fit_scale(legs: Sequence[AirspeedMean]) -> AnemometerScale:
    """Least squares of the reading over the airspeed believed, a leg counting once.

    LeewayError where no leg has a reading, or all have one airspeed.
    """
    air = np.array([leg.believed_mps for leg in legs])
    read = np.array([leg.read_mps for leg in legs])
    if len(air) < _LEAST_LEGS or float(np.ptp(air)) < _LEAST_SPREAD_MPS:
        raise LeewayError(
            f"anemometer: {len(air)} legs with a reading to fit its scale to, {_LEAST_LEGS} or more"
            f" expected that differ by {_LEAST_SPREAD_MPS:g} m/s of airspeed"
        )
    scale, bias = np.polyfit(air, read, 1)
    return AnemometerScale(float(scale), float(bias), float(np.std(read - scale * air - bias)))


def anemometer_mps(flight: ReadFlight) -> Floats:
    """The anemometer on the track's grid as a running 2 s mean; NaN where unknown."""
    s, track = flight.samples, flight.track
    known = np.isfinite(s.airspeed_mps)
    if known.sum() < 2:
        return np.full(len(track.t_s), np.nan)
    read = np.interp(track.t_s, s.t_s[known], s.airspeed_mps[known], left=np.nan, right=np.nan)
    width = 11
    return np.convolve(read, np.full(width, 1.0 / width), "same")


def stretches(track: FlownTrack, spans: Iterable[tuple[int, int]], step_s: float) -> list[slice]:
    """Legs without the seconds at their ends, as slices of the grid."""
    off = round(_SETTLED_S / step_s)
    return [slice(a + off, b - off) for a, b in spans if b - a > 4 * off and b <= len(track.t_s)]


def windows(span: slice, step_s: float) -> list[slice]:
    """Whole windows of WINDOW_S within a stretch."""
    width = round(WINDOW_S / step_s)
    starts = range(span.start, span.stop - width + 1, width)
    return [slice(a, a + width) for a in starts]


def airspeed_mean(flight: ReadFlight, wind: WindReplay, span: slice) -> AirspeedMean | None:
    """Means over a stretch; `None` in the anemometer's gaps."""
    read = anemometer_mps(flight)[span]
    if np.isfinite(read).mean() < _LEAST_SHARE:
        return None
    track = flight.track
    ground = np.stack([track.vel_n_mps[span], track.vel_e_mps[span]], axis=1)
    air = ground - wind.mean_ne_mps[span]
    speed = np.hypot(air[:, 0], air[:, 1])
    unit = air.mean(axis=0) / max(float(np.hypot(*air.mean(axis=0))), 1e-9)
    variance = float(unit @ wind.cov_ne_m2ps2[span].mean(axis=0) @ unit)
    return AirspeedMean(
        float(np.nanmean(read)),
        float(speed.mean()),
        math.sqrt(variance),
        float(np.hypot(ground[:, 0], ground[:, 1]).mean()),
    )
