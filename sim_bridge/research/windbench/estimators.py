"""The estimators that are compared: each sees velocity and levelled attitude, and the airframe.

An estimator of one's own is a class of two methods (`companion.core.wind.observation.WindFilter`)
that is made with an airframe.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.replay.reference_estimator import ReferenceEstimator
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.estimator import WindEstimator
from companion.core.wind.observation import WindFilter
from sim_bridge.research.wind.ablation import ABLATIONS, without
from sim_bridge.research.wind.px4_drag_fusion import DragFusionParams
from sim_bridge.research.wind.rival_filters import (
    ARDUPILOT,
    PX4,
    PX4_DEFAULT,
    REFERENCE,
    ardupilot,
    fused,
    replayed,
    tuned,
)
from sim_bridge.research.windbench.flights import BenchFlight

OURS = "Leeway"
CONSTANT = "best constant wind of each flight (hindsight)"
STILL = "still air (ground speed as airspeed)"


BOARD, STATES, COLD_STARTS = "board", "states", "cold-starts"
STUDIES = (BOARD, STATES, COLD_STARTS)


@dataclass(frozen=True, slots=True)
class Believed:
    """Wind at each row (n, 2), where the air moves to, and its covariance (n, 2, 2) where known."""

    mean_ne_mps: Floats
    cov_ne_m2ps2: Floats | None


Estimate = Callable[[BenchFlight, Airframe], Believed]


def estimators(own: tuple[str, ...] = ()) -> dict[str, Estimate]:
    """All by name; `own` are MODULE:CLASS of others'. LeewayError where one cannot be had."""
    found: dict[str, Estimate] = {
        OURS: _replayed(WindEstimator),
        REFERENCE: _replayed(ReferenceEstimator),
        PX4: lambda flight, airframe: _fused(flight, tuned(airframe)),
        ARDUPILOT: lambda flight, airframe: _fused(flight, ardupilot(airframe)),
        PX4_DEFAULT: lambda flight, _: _fused(flight, DragFusionParams()),
        CONSTANT: _best_constant,
        STILL: lambda flight, _: Believed(np.zeros((len(flight.heard), 2)), None),
    }
    for words in own:
        if words in found:
            raise LeewayError(f"--estimator {words}: stands there twice")
        found[words] = _replayed(_class_of(words))
    return found


def in_study(study: str, own: tuple[str, ...] = ()) -> dict[str, Estimate]:
    """Who takes part in one of STUDIES; `own` as in `estimators`. LeewayError: no such study."""
    if study == STATES:
        found = {OURS: _replayed(WindEstimator)}
        return found | {name: _replayed(without(name)) for name in ABLATIONS}
    if study == COLD_STARTS:
        everybody = estimators(own)
        return {name: everybody[name] for name in (OURS, REFERENCE, PX4_DEFAULT, *own)}
    if study == BOARD:
        return estimators(own)
    raise LeewayError(f"--study {study}: expected one of {', '.join(STUDIES)}")


def _class_of(words: str) -> Callable[[Airframe], WindFilter]:
    module, _, name = words.partition(":")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise LeewayError(
            f"--estimator {words}: MODULE:CLASS that Python can import expected ({error})"
        ) from error


def _replayed(make: Callable[[Airframe], WindFilter]) -> Estimate:
    return lambda flight, airframe: Believed(*replayed(make, airframe, flight.heard))


def _fused(flight: BenchFlight, params: DragFusionParams) -> Believed:
    return Believed(*fused(flight.heard, params))


def _best_constant(flight: BenchFlight, _: Airframe) -> Believed:
    """The constant wind that is nearest to what was read on the judged windows."""
    told = [w.wind_to_ne_mps for w in flight.windows if w.wind_to_ne_mps is not None]
    if told:
        wind = np.mean(told, axis=0)
    else:
        read = np.array([w.read_mps for w in flight.windows])

        def left(wind: Floats) -> Floats:
            air = np.hypot(*(flight.velocity_ne_mps - wind).T)
            return np.array([np.nanmean(air[w.rows]) for w in flight.windows]) - read

        starts = [least_squares(left, start) for start in ((1.0, 1.0), (-1.0, -1.0))]
        wind = min(starts, key=lambda one: one.cost).x
    return Believed(np.tile(wind, (len(flight.heard), 1)), None)
