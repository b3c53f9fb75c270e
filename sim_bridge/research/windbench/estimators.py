"""The compared estimators: each receives velocity, levelled attitude and the airframe.

A plug-in is a class with the methods of `companion.WindFilter`, constructed with an airframe.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from companion.analysis.replay.reference_estimator import ReferenceEstimator
from companion.analysis.replay.replayed_wind import FilteredWind, replay_filter
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.checked_filter import checked_filter_factory
from companion.core.wind.estimator import WindEstimator
from companion.core.wind.observation import WindFilter
from sim_bridge.research.windbench.drag_fusion import (
    DragFusionParams,
    ardupilot_drag_params_from_airframe,
    px4_drag_params_from_airframe,
    replay_drag_fusion,
)
from sim_bridge.research.windbench.flights import BenchFlight

Estimate = Callable[[BenchFlight, Airframe], FilteredWind]


def estimators_by_name(custom_class_paths: tuple[str, ...] = ()) -> dict[str, Estimate]:
    """Return estimators by name; `custom_class_paths`: plug-ins. LeewayError: no such plug-in."""
    found: dict[str, Estimate] = {
        "Leeway": _build_replay_estimator(WindEstimator),
        "plain EKF (filterpy)": _build_replay_estimator(ReferenceEstimator),
        "PX4's drag fusion, tuned": lambda flight, airframe: replay_drag_fusion(
            flight.observations, px4_drag_params_from_airframe(airframe)
        ),
        "ArduPilot's drag fusion, tuned": lambda flight, airframe: replay_drag_fusion(
            flight.observations, ardupilot_drag_params_from_airframe(airframe)
        ),
        "PX4's drag fusion, defaults": lambda flight, _: replay_drag_fusion(
            flight.observations, DragFusionParams()
        ),
        "best constant wind of each flight (hindsight)": _fit_best_constant_wind,
        "still air (ground speed as airspeed)": lambda flight, _: _constant(flight, np.zeros(2)),
    }
    for words in custom_class_paths:
        if words in found:
            raise LeewayError(f"--estimator {words}: given more than once")
        found[words] = _build_replay_estimator(checked_filter_factory(words))
    return found


def _build_replay_estimator(filter_factory: Callable[[Airframe], WindFilter]) -> Estimate:
    return lambda flight, airframe: replay_filter(filter_factory, airframe, flight.observations)


def _fit_best_constant_wind(flight: BenchFlight, _: Airframe) -> FilteredWind:
    """Fit the constant wind with the least error on the evaluated windows."""
    reference_winds = [w.wind_to_ne_mps for w in flight.windows if w.wind_to_ne_mps is not None]
    if reference_winds:
        return _constant(flight, np.mean(reference_winds, axis=0))
    read = np.array([w.read_mps for w in flight.windows])

    def airspeed_residuals_mps(wind: Floats) -> Floats:
        air = np.hypot(*(flight.velocity_ne_mps - wind).T)
        return np.array([np.nanmean(air[w.rows]) for w in flight.windows]) - read

    starts = (1.0, 1.0), (-1.0, -1.0)
    solutions = [least_squares(airspeed_residuals_mps, start) for start in starts]
    return _constant(flight, min(solutions, key=lambda one: one.cost).x)


def _constant(flight: BenchFlight, wind_ne_mps: Floats) -> FilteredWind:
    return FilteredWind(np.tile(wind_ne_mps, (len(flight.observations), 1)), None)
