"""Airspeed of a wind estimate along a recorded flight, against the anemometer.

The anemometer's direction error depends on heading, so that only its magnitude is a reference. It
is mounted in the rotors' flow and reads `scale * airspeed + bias`. Both are fitted on fitting
flights, to the leg means of the evaluated estimator.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.analysis.measured_energy.flown_track import FlownTrack
from companion.analysis.replay.replayed_wind import FilteredWind
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from sim_bridge.research.real_flights.folder import ReadFlight

WINDOW_S = 10.0
_SETTLED_S = 2.0
"""Excluded time at both ends of a leg, while the anemometer's filter settles."""
_MIN_SHARE = 0.8
_MIN_LEG_COUNT = 6
_MIN_SPREAD_MPS = 1.0


@dataclass(frozen=True, slots=True)
class AnemometerScale:
    """Anemometer reading as a function of airspeed."""

    scale: float
    bias_mps: float


@dataclass(frozen=True, slots=True)
class AirspeedMean:
    """Means over one stretch: anemometer airspeed, estimated airspeed with std, ground speed."""

    read_mps: float
    believed_mps: float
    std_mps: float
    ground_mps: float

    def as_anemometer_reading(self, anemometer: AnemometerScale) -> "AirspeedMean":
        """Return the estimate converted to the anemometer's reading."""
        estimated_mps = anemometer.scale * self.believed_mps + anemometer.bias_mps
        return replace(self, believed_mps=estimated_mps, std_mps=anemometer.scale * self.std_mps)


def airspeed_std_mps(air_velocity_ne_mps: Floats, wind_cov_ne_m2ps2: Floats) -> float:
    """Return the std of the airspeed: wind std along the mean flow."""
    mean = np.nanmean(air_velocity_ne_mps, axis=0)
    unit = mean / max(float(np.hypot(*mean)), 1e-9)
    return math.sqrt(max(float(unit @ wind_cov_ne_m2ps2.mean(axis=0) @ unit), 1e-9))


def fit_anemometer_scale(leg_averages: Sequence[AirspeedMean]) -> AnemometerScale:
    """Fit the reading to the estimated airspeed by least squares, with equal weight per leg.

    Raises LeewayError with too few legs, or if all have the same airspeed.
    """
    air = np.array([leg.believed_mps for leg in leg_averages])
    read = np.array([leg.read_mps for leg in leg_averages])
    if len(air) < _MIN_LEG_COUNT or float(np.ptp(air)) < _MIN_SPREAD_MPS:
        raise LeewayError(
            f"anemometer: {len(air)} legs with a reading to fit its scale to, {_MIN_LEG_COUNT} or"
            f" more expected that differ by {_MIN_SPREAD_MPS:g} m/s of airspeed"
        )
    scale, bias = np.polyfit(air, read, 1)
    return AnemometerScale(float(scale), float(bias))


def anemometer_airspeed_running_mean_mps(flight: ReadFlight) -> Floats:
    """Return the anemometer's running 2 s mean on the track's grid; NaN where unknown."""
    s, track = flight.measured.samples, flight.measured.track
    known = np.isfinite(s.airspeed_mps)
    if known.sum() < 2:
        return np.full(len(track.t_s), np.nan)
    read = np.interp(track.t_s, s.t_s[known], s.airspeed_mps[known], left=np.nan, right=np.nan)
    width = 11
    return np.convolve(read, np.full(width, 1.0 / width), "same")


def slices_without_leg_ends(
    track: FlownTrack, spans: Iterable[tuple[int, int]], step_s: float
) -> list[slice]:
    """Return the legs without the seconds at their ends, as slices of the grid."""
    off = round(_SETTLED_S / step_s)
    return [slice(a + off, b - off) for a, b in spans if b - a > 4 * off and b <= len(track.t_s)]


def complete_window_slices(span: slice, step_s: float) -> list[slice]:
    """Return the complete windows of WINDOW_S in a stretch."""
    width = round(WINDOW_S / step_s)
    first_indices = range(span.start, span.stop - width + 1, width)
    return [slice(a, a + width) for a in first_indices]


def mean_airspeed_over_span(
    flight: ReadFlight, wind: FilteredWind, span: slice
) -> AirspeedMean | None:
    """Return the means over a stretch; `None` in gaps of the anemometer."""
    read = anemometer_airspeed_running_mean_mps(flight)[span]
    if np.isfinite(read).mean() < _MIN_SHARE:
        return None
    track = flight.measured.track
    ground = np.stack([track.vel_n_mps[span], track.vel_e_mps[span]], axis=1)
    air = ground - wind.mean_ne_mps[span]
    speed = np.hypot(air[:, 0], air[:, 1])
    assert wind.cov_ne_m2ps2 is not None
    return AirspeedMean(
        float(np.nanmean(read)),
        float(speed.mean()),
        airspeed_std_mps(air, wind.cov_ne_m2ps2[span]),
        float(np.hypot(ground[:, 0], ground[:, 1]).mean()),
    )
