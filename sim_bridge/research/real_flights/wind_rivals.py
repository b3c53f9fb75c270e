"""Others' wind estimators on the same flights."""

import numpy as np

from companion.core.replay.reference_estimator import ReferenceEstimator
from companion.core.vehicle.airframe import Airframe
from sim_bridge.research.real_flights.folder import ReadFlight
from sim_bridge.research.real_flights.wind_replay import WindReplay, observations
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
    times = [seen.t_s for seen in heard]
    at = np.clip(np.searchsorted(times, flight.track.t_s, side="right") - 1, 0, len(times) - 1)
    still = np.zeros((len(times), 2)), np.tile(np.eye(2), (len(times), 1, 1))
    found = {
        REFERENCE: replayed(ReferenceEstimator, plain, heard),
        PX4_DEFAULT: fused(heard, DragFusionParams()),
        PX4: fused(heard, tuned(plain)),
        ARDUPILOT: fused(heard, ardupilot(plain)),
        STILL: still,
    }
    return {name: WindReplay(mean[at], cov[at]) for name, (mean, cov) in found.items()}
