"""Remaining energy at each point of a recorded flight at which the gate decides.

At each second from power on to the start of the last descent: measured remaining energy, and the
airframe's prediction for the rest of the flown track with the wind estimate at that point. Route
and ground speed are known before a flight, the wind is not. The last descent has no decisions.
"""

from dataclasses import dataclass

import numpy as np

from companion.analysis.measured_energy.flown_track import STEP_S, FlownTrack
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

DECISION_INTERVAL_S = 1.0
_MIN_DESCENT_MPS = 0.5
_NEAR_GROUND_M = 5.0
"""Above the landing point; the height of such logs drifts by that much."""


@dataclass(frozen=True, slots=True)
class DecisionPoint:
    """Measured and predicted remaining energy of a flight at `at_s` after power on."""

    at_s: float
    measured_wh: float
    predicted_wh: float

    @property
    def measured_to_predicted_ratio(self) -> float:
        """Measured over predicted."""
        return self.measured_wh / self.predicted_wh


def remaining_energy_at_decision_points(
    airframe: Airframe, track: FlownTrack, wind_to_ne_mps: Floats, density_kgpm3: float
) -> tuple[DecisionPoint, ...]:
    """Return all points of a flight from power on; `wind_to_ne_mps` (n, 2) is the estimate.

    Raises LeewayError if the vehicle never left the ground.
    """
    remaining_wh = np.cumsum(track.power_w[::-1])[::-1] * STEP_S / 3600.0
    return tuple(
        DecisionPoint(
            index * STEP_S,
            float(remaining_wh[index]),
            _predicted_remaining_energy_wh(
                airframe, track, index, wind_to_ne_mps[index], density_kgpm3
            ),
        )
        for index in range(
            0, last_descent_start_index(track) + 1, round(DECISION_INTERVAL_S / STEP_S)
        )
    )


def last_descent_start_index(track: FlownTrack) -> int:
    """Return the grid index of the last descent's start. Raises LeewayError if there is none."""
    height_m = track.height_m - track.height_m[-1]
    at = np.flatnonzero((track.climb_mps > -_MIN_DESCENT_MPS) & (height_m > _NEAR_GROUND_M))
    if not len(at):
        raise LeewayError(
            f"{track.name}: never more than {_NEAR_GROUND_M:g} m above the landing; expected a"
            " flight"
        )
    return int(at[-1])


def _predicted_remaining_energy_wh(
    airframe: Airframe,
    track: FlownTrack,
    start_index: int,
    wind_to_ne_mps: Floats,
    density_kgpm3: float,
) -> float:
    north, east = (float(one) for one in wind_to_ne_mps)
    airspeed = np.hypot(track.vel_n_mps[start_index:] - north, track.vel_e_mps[start_index:] - east)
    mass_kg = airframe.flying_mass_kg(track.payload_kg)
    power = multirotor_power_w(
        airframe, mass_kg, airspeed, track.climb_mps[start_index:], density_kgpm3
    )
    return float(power.sum()) * STEP_S / 3600.0
