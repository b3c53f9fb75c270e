"""A real flight with an anemometer aboard, replayed through wind estimators.

The flight is one of New Mexico Tech, telemetry at 5 Hz; its anemometer is good to 0.7 to 1.1 m/s.
Scored are the airborne rows after the first 30 s of flight: the RMSE of the wind vector against the
centred 10 s mean, and the mean normalised error squared (NEES, 2 is ideal).
"""

import csv
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.estimator import WindEstimator, WindObservation
from companion.core.wind.observation import WindFilter

WARM_UP_S = 30.0
COLUMNS = ("t_s", "vel_n_mps", "vel_e_mps", "vel_d_mps", "roll_deg", "pitch_deg", "yaw_deg")
COLUMNS += ("airspeed_mps", "alt_m", "wind_to_n_ref_mps", "wind_to_e_ref_mps")
CLIMBED_M = 2.0
MOVING_MPS = 0.3


@dataclass(frozen=True)
class AnemometerFlight:
    """The flight's rows; `airborne` from take-off to the end."""

    observations: list[WindObservation]
    reference_ne_mps: Floats

    @property
    def t_s(self) -> Floats:
        return np.array([seen.t_s for seen in self.observations])

    @property
    def took_off_s(self) -> float:
        return next(seen.t_s for seen in self.observations if seen.airborne)

    @property
    def is_judged(self) -> NDArray[np.bool_]:
        """Airborne rows after the first 30 s of flight."""
        airborne = np.array([seen.airborne for seen in self.observations])
        return airborne & (self.t_s >= self.took_off_s + WARM_UP_S)


@dataclass(frozen=True)
class WindTrack:
    """An estimate for every row: mean (n, 2) and covariance (n, 2, 2), NaN before there is one."""

    mean_ne_mps: Floats
    cov_ne_m2ps2: Floats


@dataclass(frozen=True)
class Score:
    """RMSE of the vector (m/s) and mean normalised error squared; `rows` were judged."""

    rmse_mps: float
    nees: float
    rows: int


@dataclass(frozen=True)
class AirspeedError:
    """What an airspeed sensor makes of the true magnitude."""

    scale: float
    bias_mps: float
    noise_std_mps: float
    seed: int


def read_recording(path: Path, mass_kg: float) -> AnemometerFlight:
    """The flight in a CSV file; LeewayError names the file, the row and the column of a mistake."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise LeewayError(f"{path}: cannot be read ({error.strerror})") from error
    table = {
        name: np.array([_number(path, i, row, name) for i, row in enumerate(rows)])
        for name in COLUMNS
    }
    velocity = np.stack([table["vel_n_mps"], table["vel_e_mps"], table["vel_d_mps"]], axis=1)
    off = np.flatnonzero(
        (table["alt_m"] > table["alt_m"][0] + CLIMBED_M)
        & (np.linalg.norm(velocity, axis=1) > MOVING_MPS)
    )
    first = int(off[0]) if len(off) else len(rows)
    observations = [
        WindObservation(
            t_s=float(table["t_s"][i]),
            airborne=i >= first,
            mass_kg=mass_kg,
            vel_ned_mps=(float(velocity[i, 0]), float(velocity[i, 1]), float(velocity[i, 2])),
            roll_rad=math.radians(table["roll_deg"][i]),
            pitch_rad=math.radians(table["pitch_deg"][i]),
            yaw_rad=math.radians(table["yaw_deg"][i]),
            airspeed_mps=float(table["airspeed_mps"][i]),
            airspeed_is_magnitude=True,
        )
        for i in range(len(rows))
    ]
    reference = np.stack([table["wind_to_n_ref_mps"], table["wind_to_e_ref_mps"]], axis=1)
    return AnemometerFlight(observations, reference)


def _number(path: Path, index: int, row: dict[str, str], name: str) -> float:
    try:
        value = float(row[name])
    except (KeyError, TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise LeewayError(f"{path}: row {index + 2}: {name} = {row.get(name)!r}: expected a number")
    return value


def without_airspeed(recording: AnemometerFlight) -> Iterator[WindObservation]:
    """Attitude and velocity only."""
    return (replace(seen, airspeed_mps=None) for seen in recording.observations)


def with_airspeed(recording: AnemometerFlight, error: AirspeedError) -> Iterator[WindObservation]:
    """The anemometer's magnitude as a sensor with this error would give it."""
    rng = np.random.default_rng(error.seed)
    for seen in recording.observations:
        noise = rng.normal(0.0, error.noise_std_mps)
        true_mps = seen.airspeed_mps or 0.0
        yield replace(seen, airspeed_mps=max(error.scale * true_mps + error.bias_mps + noise, 0.0))


def replayed(
    airframe: Airframe,
    observations: Iterator[WindObservation],
    make: Callable[[Airframe], WindFilter] = WindEstimator,
) -> WindTrack:
    """A wind estimator over a flight: the companion's, or the one that `make` gives."""
    estimator = make(airframe)
    means, covs = [], []
    for seen in observations:
        estimator.update(seen)
        belief = estimator.belief(seen.t_s)
        means.append(belief.mean_to_ne_mps)
        covs.append(belief.cov_ne_m2ps2)
    return WindTrack(np.array(means), np.array(covs))


def best_constant(recording: AnemometerFlight) -> WindTrack:
    """The constant wind that is nearest to the reference on the judged rows: hindsight."""
    mean = recording.reference_ne_mps[recording.is_judged].mean(axis=0)
    rows = len(recording.observations)
    return WindTrack(np.tile(mean, (rows, 1)), np.full((rows, 2, 2), np.nan))


def score(
    recording: AnemometerFlight, track: WindTrack, where: Callable[[Floats], Floats] | None = None
) -> Score:
    """Judge a track; `where` narrows the rows by their time."""
    judged = recording.is_judged
    if where is not None:
        judged &= where(recording.t_s).astype(bool)
    error = (track.mean_ne_mps - recording.reference_ne_mps)[judged]
    cov = track.cov_ne_m2ps2[judged]
    nees = math.nan
    if np.isfinite(cov).all():
        nees = float(np.mean(np.einsum("ki,kij,kj->k", error, np.linalg.inv(cov), error)))
    return Score(float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), nees, int(judged.sum()))
