"""The estimator with one of its states held, or one of its hypotheses left out."""

from collections.abc import Callable
from dataclasses import replace

import msgspec

from companion.core.vehicle.airframe import Airframe
from companion.core.wind.estimator import WindEstimator, WindEstimatorParams, params_for

HELD = 1e-6
"""A standard deviation that is none, and lets the covariance be inverted."""

Changed = Callable[[WindEstimatorParams], WindEstimatorParams]


def _held(**drag: float) -> Callable[[Airframe], Airframe]:
    changed = msgspec.structs.replace
    return lambda airframe: changed(airframe, drag=changed(airframe.drag, **drag))


_PARAMS: dict[str, Changed] = {
    "without gusts": lambda p: replace(p, gust_frac=1e-3),
    "without trims": lambda p: replace(p, trim_walk_rad2ps=0.0),
    "without drag gains": lambda p: replace(p, gain_walk_per_s=0.0),
    "without heading error": lambda p: replace(
        p, prior_heading_std_rad=HELD, heading_walk_rad2ps=0.0
    ),
    "without cross-flow share": lambda p: replace(p, cross_flow_std=HELD),
    "without calm air": lambda p: replace(p, weighs_calm=False),
    "without turbulence learned": lambda p: replace(p, learns_turbulence=False),
}
_AIRFRAMES: dict[str, Callable[[Airframe], Airframe]] = {
    "without trims": _held(trim_std_deg=0.05),
    "without drag gains": _held(gain_std_frac=0.01, axis_gain_std_frac=0.0),
}
ABLATIONS = tuple(_PARAMS)
"""By name: trims and gains are held to the least that an airframe file may state, 0.05 degrees and
1 %. The lagged mean and the velocity's noises stay: what is told is made of the one, and without
the others there would have to be a low-pass. The airspeed's scale and bias are not heard of here.
"""


def without(name: str) -> Callable[[Airframe], WindEstimator]:
    """An estimator that lacks one of ABLATIONS."""
    params, airframe_of = _PARAMS[name], _AIRFRAMES.get(name)

    def make(airframe: Airframe) -> WindEstimator:
        own = airframe if airframe_of is None else airframe_of(airframe)
        return WindEstimator(own, params(params_for(airframe)))

    return make
