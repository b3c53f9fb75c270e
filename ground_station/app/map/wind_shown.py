"""The wind that the drones in the air report, with its spread, for the map."""

from collections.abc import Iterable

import numpy as np

from companion.fleet.messages import State
from ground_station.app.map.picture import WindShown

LEAST = 3
"""Reports that make an ellipse: two are a line."""


def fleet_wind(states: Iterable[State]) -> WindShown | None:
    """Mean and sample covariance of what the armed drones report; None: too few do.

    The spread between drones is not the error of one drone's estimate: a state has no covariance.
    """
    reports = [
        (state.wind_to_n_mps, state.wind_to_e_mps)
        for state in states
        if state.armed and state.wind_to_n_mps is not None and state.wind_to_e_mps is not None
    ]
    if len(reports) < LEAST:
        return None
    winds = np.array(reports)
    north, east = winds.mean(axis=0)
    cov = np.cov(winds, rowvar=False)
    return WindShown(
        to_ne_mps=(float(north), float(east)),
        cov_m2ps2=(float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1])),
        source=f"{len(reports)} drones in the air, spread between them",
    )
