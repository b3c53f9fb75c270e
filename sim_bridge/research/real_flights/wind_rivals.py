"""Others' wind estimators on the same flights."""

import numpy as np

from companion.core.replay.reference_estimator import ReferenceEstimator
from companion.core.vehicle.airframe import Airframe
from sim_bridge.research.real_flights.folder import ReadFlight
from sim_bridge.research.real_flights.wind_replay import WindReplay, observations, rows_of_grid
from sim_bridge.research.wind.px4_drag_fusion import DragFusionParams
from sim_bridge.research.wind.rival_filters import (
    ARDUPILOT,
    PX4,
    PX4_DEFAULT,
    REFERENCE,
    ardupilot,
    fused,
    levelled,
    replayed,
    tuned,
)

STILL = "ground speed as airspeed"
WIND_RIVALS = (REFERENCE, PX4_DEFAULT, PX4, ARDUPILOT, STILL)


def rival_winds(flight: ReadFlight, airframe: Airframe) -> dict[str, WindReplay]:
    """By each of WIND_RIVALS, over velocity and levelled attitude, on the track's grid.

    STILL has no wind at all, and states no error: its covariance is the unit matrix.
    """
    heard, plain = levelled(tuple(observations(flight, airframe, with_airspeed=False)), airframe)
    at = rows_of_grid(flight)
    still = np.zeros((len(at), 2)), np.tile(np.eye(2), (len(at), 1, 1))
    fusions = {
        PX4_DEFAULT: DragFusionParams(),
        PX4: tuned(plain),
        ARDUPILOT: ardupilot(plain),
    }
    found = {REFERENCE: replayed(ReferenceEstimator, plain, heard, at)}
    for name, params in fusions.items():
        mean, cov = fused(heard, params)
        found[name] = mean[at], cov[at]
    found[STILL] = still
    return {name: WindReplay(*belief) for name, belief in found.items()}
