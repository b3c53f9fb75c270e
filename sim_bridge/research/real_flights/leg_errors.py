"""What the error of the airspeed on legs is made of: days, flights, legs, and fast air.

The mean error of a day or a flight can be known in hindsight only. What is left without it is what
an estimator would still err by that knew every constant of that day or flight: drag, trims, and
what the anemometer makes of an airspeed.
"""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from sim_bridge.research.real_flights.fold import JudgedFlight
from sim_bridge.research.real_flights.wind_replay import AirspeedMean

FAST_MPS = 12.0
"""Airspeeds beyond it were flown on few days: where one of them is left out, drag up there is not
measured."""


class LegErrors(msgspec.Struct, frozen=True):
    """RMS of the error on some legs, m/s."""

    of: str
    legs: int
    rmse_mps: float


def leg_errors(flights: Sequence[JudgedFlight]) -> list[LegErrors]:
    """Of all legs, of parts of them, and with means known in hindsight."""
    legs = [(f.date, f.name, m) for f in flights for m in f.winds["tilt"].legs]
    rows = [
        ("all", [_error(m) for _, _, m in legs]),
        (f"read at most {FAST_MPS:g} m/s", [_error(m) for *_, m in legs if m.read_mps <= FAST_MPS]),
        (f"read over {FAST_MPS:g} m/s", [_error(m) for *_, m in legs if m.read_mps > FAST_MPS]),
    ]
    found = [LegErrors(of, len(e), float(np.sqrt(np.mean(np.square(e))))) for of, e in rows if e]
    for of, key in (
        ("without the mean error of each day", lambda leg: leg[0]),
        ("without the mean error of each flight", lambda leg: leg[:2]),
    ):
        found += _in_hindsight(of, legs, key)
    return found


def _error(mean: AirspeedMean) -> float:
    return mean.believed_mps - mean.read_mps


def _in_hindsight(
    of: str,
    legs: Sequence[tuple[str, str, AirspeedMean]],
    key: Callable[[tuple[str, str, AirspeedMean]], object],
) -> list[LegErrors]:
    """Scatter within groups, by the degrees of freedom that their means leave."""
    groups: dict[object, list[float]] = {}
    for leg in legs:
        groups.setdefault(key(leg), []).append(_error(leg[2]))
    free = len(legs) - len(groups)
    if free <= 0:
        return []
    squares = sum(float(np.sum((np.array(e) - np.mean(e)) ** 2)) for e in groups.values())
    return [LegErrors(of, len(legs), float(np.sqrt(squares / free)))]
