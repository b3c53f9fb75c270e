"""The wind that the drones in the air report, with its uncertainty, for the map."""

from collections.abc import Iterable, Mapping

import numpy as np

from companion.core.base.arrays import Floats
from companion.fleet.messages import State
from ground_station.app.map.fleet_ear import VehicleTrack
from ground_station.app.map.picture import WindShown
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_words import field_words

LEAST = 3
"""Reports that make an ellipse where their own errors are not told: two are a line."""


def fleet_wind(
    states: Iterable[State], tracks: Mapping[str, VehicleTrack] | None = None
) -> WindShown | None:
    """Mean of what the armed drones report, and how unsure it is; None: too few do.

    Where all tell the covariance of their own estimate, that of one drone's wind drawn at random:
    the mean of theirs and the spread between them (law of total covariance). Else the sample
    covariance, which is no drone's own error.
    """
    told = [
        (state.vehicle, (state.wind_to_n_mps, state.wind_to_e_mps))
        for state in states
        if state.armed and state.wind_to_n_mps is not None and state.wind_to_e_mps is not None
    ]
    winds = np.array([wind for _, wind in told])
    tracks = tracks or {}
    errors = [t.wind_cov_m2ps2 for name, _ in told if (t := tracks.get(name)) is not None]
    known = [error for error in errors if error is not None]
    count = f"{len(told)} drone{'s' if len(told) > 1 else ''} in the air"
    if told and len(known) == len(told):
        spread = np.cov(winds, rowvar=False, bias=True)
        nn, ne, ee = np.mean(known, axis=0)
        cov = spread + np.array([[nn, ne], [ne, ee]])
        whose = "their own errors and the spread between them" if len(told) > 1 else "its own error"
        return _shown(winds, cov, f"{count}, by {whose}")
    if len(told) < LEAST:
        return None
    return _shown(winds, np.cov(winds, rowvar=False), f"{count}, spread between them")


def field_shown(wind: SiteWind, now_s: float) -> WindShown | None:
    """The field that is believed, in the middle of those who tell it; None: nobody does."""
    here = wind.here(now_s)
    if here is None:
        return None
    return WindShown(
        to_ne_mps=here.to_ne_mps, cov_m2ps2=here.cov_m2ps2, source=field_words(wind, now_s)
    )


def _shown(winds: Floats, cov: Floats, source: str) -> WindShown:
    north, east = winds.mean(axis=0)
    return WindShown(
        to_ne_mps=(float(north), float(east)),
        cov_m2ps2=(float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1])),
        source=source,
    )
