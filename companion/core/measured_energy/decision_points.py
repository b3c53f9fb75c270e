"""The energy home from every point of a recorded flight at which the gate decides.

At each second from power on to the beginning of the last descent: what the flight still drew, and
what the airframe predicts for the rest of the flown track, with the wind as it was believed there.
Route and ground speed are known before a flight, the wind is not. In the last descent nothing is
decided any more.
"""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.measured_energy.flown_track import STEP_S, FlownTrack
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

EVERY_S = 1.0
_DESCENDS_MPS = 0.5
_NEAR_GROUND_M = 5.0
"""Above the landing place; the height of such logs wanders by that much."""


@dataclass(frozen=True, slots=True)
class DecisionPoint:
    """One instant of a flight, `at_s` after power on: measured and predicted energy from there."""

    at_s: float
    measured_wh: float
    predicted_wh: float

    @property
    def ratio(self) -> float:
        """Measured over predicted."""
        return self.measured_wh / self.predicted_wh


def decision_points(
    airframe: Airframe, track: FlownTrack, wind_to_ne_mps: Floats, density_kgpm3: float
) -> tuple[DecisionPoint, ...]:
    """All of a flight, the first at power on; `wind_to_ne_mps` (n, 2) as believed on the track.

    LeewayError where it never left the ground.
    """
    left_wh = np.cumsum(track.power_w[::-1])[::-1] * STEP_S / 3600.0
    return tuple(
        DecisionPoint(
            index * STEP_S,
            float(left_wh[index]),
            _predicted_wh(airframe, track, index, wind_to_ne_mps[index], density_kgpm3),
        )
        for index in range(0, last_decision(track) + 1, round(EVERY_S / STEP_S))
    )


def last_decision(track: FlownTrack) -> int:
    """Index on the track's grid where its last descent begins; LeewayError: none."""
    height_m = track.height_m - track.height_m[-1]
    at = np.flatnonzero((track.climb_mps > -_DESCENDS_MPS) & (height_m > _NEAR_GROUND_M))
    if not len(at):
        raise LeewayError(
            f"{track.name}: never more than {_NEAR_GROUND_M:g} m above where it landed; expected a"
            " flight"
        )
    return int(at[-1])


def _predicted_wh(
    airframe: Airframe, track: FlownTrack, index: int, wind_to_ne_mps: Floats, density: float
) -> float:
    north, east = (float(one) for one in wind_to_ne_mps)
    airspeed = np.hypot(track.vel_n_mps[index:] - north, track.vel_e_mps[index:] - east)
    mass_kg = airframe.mass_kg(track.payload_kg)
    power = multirotor_power_w(airframe, mass_kg, airspeed, track.climb_mps[index:], density)
    return float(power.sum()) * STEP_S / 3600.0
