"""The estimators that are compared: each sees velocity and levelled attitude, and the airframe.

An estimator of one's own is a class of two methods (`companion.core.wind.observation.WindFilter`)
that is made with an airframe.
"""

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.replay.reference_estimator import ReferenceEstimator
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.estimator import WindEstimator
from sim_bridge.research.wind.px4_drag_fusion import DragFusionParams, drag_fusion
from sim_bridge.research.windbench.flights import BenchFlight

OURS = "Leeway"
REFERENCE = "plain EKF (filterpy)"
PX4, PX4_DEFAULT = "PX4's drag fusion, tuned", "PX4's drag fusion, defaults"
ARDUPILOT = "ArduPilot's drag fusion, tuned"
CONSTANT = "best constant wind of each flight (hindsight)"
STILL = "still air (ground speed as airspeed)"

ARDUPILOT_STEP_S = 0.01
ARDUPILOT_WIND_NOISE_MPS2 = 0.2
"""EK3_WIND_P_NSE of ArduCopter: its variance grows by (noise x step)^2 at each step of 10 ms."""


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
        PX4: _px4,
        ARDUPILOT: _ardupilot,
        PX4_DEFAULT: lambda flight, _: _fused(flight, DragFusionParams()),
        CONSTANT: _best_constant,
        STILL: lambda flight, _: Believed(np.zeros((len(flight.heard), 2)), None),
    }
    for words in own:
        if words in found:
            raise LeewayError(f"--estimator {words}: stands there twice")
        found[words] = _replayed(_class_of(words))
    return found


def _class_of(words: str) -> Callable[[Airframe], object]:
    module, _, name = words.partition(":")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise LeewayError(
            f"--estimator {words}: MODULE:CLASS that Python can import expected ({error})"
        ) from error


def _replayed(make: Callable[[Airframe], object]) -> Estimate:
    def run(flight: BenchFlight, airframe: Airframe) -> Believed:
        filter_ = make(airframe)
        means, covs = [], []
        for seen in flight.heard:
            filter_.update(seen)  # pyright: ignore[reportAttributeAccessIssue]
            belief = filter_.belief(seen.t_s)  # pyright: ignore[reportAttributeAccessIssue]
            means.append(belief.mean_to_ne_mps)
            covs.append(belief.cov_ne_m2ps2)
        return Believed(np.array(means), np.array(covs))

    return run


def tuned(airframe: Airframe) -> DragFusionParams:
    """PX4's coefficients from the airframe's drag: EKF2_BCOEF_X, _Y and EKF2_MCOEF."""
    drag, mass_kg = airframe.drag, airframe.mass.empty_kg
    forward, right = (
        0.5 * REFERENCE_DENSITY_KGPM3 * mass_kg / max(one, 1e-4)
        for one in (drag.quadratic_forward_n_per_mps2, drag.quadratic_right_n_per_mps2)
    )
    momentum = 0.5 * (drag.linear_forward_n_per_mps + drag.linear_right_n_per_mps) / mass_kg
    return DragFusionParams(bcoef_kgpm2=forward, bcoef_right_kgpm2=right, mcoef_hz=momentum)


def _px4(flight: BenchFlight, airframe: Airframe) -> Believed:
    return _fused(flight, tuned(airframe))


def _ardupilot(flight: BenchFlight, airframe: Airframe) -> Believed:
    """The same equations with ArduPilot's noises: EK3_DRAG_M_NSE 0.5 m/s2, samples at 5 Hz."""
    own = tuned(airframe)
    return _fused(
        flight,
        DragFusionParams(
            bcoef_kgpm2=own.bcoef_kgpm2,
            bcoef_right_kgpm2=own.bcoef_right_kgpm2,
            mcoef_hz=own.mcoef_hz,
            drag_noise_m2ps4=0.5**2,
            wind_nsd_mps2_rthz=ARDUPILOT_WIND_NOISE_MPS2 * math.sqrt(ARDUPILOT_STEP_S),
            initial_std_mps=20.0,
            fusions_per_s=5.0,
            least_std_mps=0.5,
        ),
    )


def _fused(flight: BenchFlight, params: DragFusionParams) -> Believed:
    """Over the rows that tell velocity and attitude; the last belief in between."""
    rows = [
        i
        for i, s in enumerate(flight.heard)
        if s.vel_ned_mps is not None and None not in (s.roll_rad, s.pitch_rad, s.yaw_rad)
    ]
    seen = [flight.heard[i] for i in rows]
    mean, cov = drag_fusion(
        np.array([s.t_s for s in seen]),
        np.array([s.vel_ned_mps for s in seen]),
        np.array([(s.roll_rad, s.pitch_rad, s.yaw_rad) for s in seen], float),
        np.array([s.airborne for s in seen]),
        seen[0].density_kgpm3,
        params,
    )
    at = np.clip(np.searchsorted(rows, np.arange(len(flight.heard)), side="right") - 1, 0, None)
    return Believed(mean[at], cov[at])


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
