"""Others' wind filters over what ours hears: drag fusion as PX4 and ArduPilot have it."""

import math
from collections.abc import Callable, Iterable, Sequence

import msgspec
import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.observation import WindFilter, WindObservation
from sim_bridge.research.wind.px4_drag_fusion import DragFusionParams, drag_fusion

REFERENCE = "plain EKF (filterpy)"
PX4, PX4_DEFAULT = "PX4's drag fusion, tuned", "PX4's drag fusion, defaults"
ARDUPILOT = "ArduPilot's drag fusion, tuned"

ARDUPILOT_STEP_S = 0.01
ARDUPILOT_WIND_NOISE_MPS2 = 0.2
"""EK3_WIND_P_NSE of ArduCopter: its variance grows by (noise x step)^2 at each step of 10 ms."""


def levelled(
    heard: Sequence[WindObservation], airframe: Airframe
) -> tuple[tuple[WindObservation, ...], Airframe]:
    """What is heard with its attitude levelled by the airframe's mean trims, and the airframe
    without them: for filters that know no trim."""
    drag = airframe.drag
    trims = math.radians(drag.trim_forward_deg), math.radians(drag.trim_right_deg)
    changed = msgspec.structs.replace
    plain = changed(airframe, drag=changed(drag, trim_forward_deg=0.0, trim_right_deg=0.0))
    return tuple(seen.levelled(*trims) for seen in heard), plain


def tuned(airframe: Airframe) -> DragFusionParams:
    """PX4's coefficients from the airframe's drag: EKF2_BCOEF_X, _Y and EKF2_MCOEF."""
    drag, mass_kg = airframe.drag, airframe.mass.empty_kg
    forward, right = (
        0.5 * REFERENCE_DENSITY_KGPM3 * mass_kg / max(one, 1e-4)
        for one in (drag.quadratic_forward_n_per_mps2, drag.quadratic_right_n_per_mps2)
    )
    momentum = 0.5 * (drag.linear_forward_n_per_mps + drag.linear_right_n_per_mps) / mass_kg
    return DragFusionParams(bcoef_kgpm2=forward, bcoef_right_kgpm2=right, mcoef_hz=momentum)


def ardupilot(airframe: Airframe) -> DragFusionParams:
    """The same equations with ArduPilot's noises: EK3_DRAG_M_NSE 0.5 m/s2, samples at 5 Hz."""
    own = tuned(airframe)
    return DragFusionParams(
        bcoef_kgpm2=own.bcoef_kgpm2,
        bcoef_right_kgpm2=own.bcoef_right_kgpm2,
        mcoef_hz=own.mcoef_hz,
        drag_noise_m2ps4=0.5**2,
        wind_nsd_mps2_rthz=ARDUPILOT_WIND_NOISE_MPS2 * math.sqrt(ARDUPILOT_STEP_S),
        initial_std_mps=20.0,
        fusions_per_s=5.0,
        least_std_mps=0.5,
    )


def replayed(
    make: Callable[[Airframe], WindFilter],
    airframe: Airframe,
    heard: Iterable[WindObservation],
    rows: Ints | None = None,
) -> tuple[Floats, Floats]:
    """What a filter made with this airframe believes at each row: (n, 2) and (n, 2, 2).

    `rows`: at these alone, in their order; they may repeat.
    """
    filter_ = make(airframe)
    wanted = None if rows is None else frozenset(rows.tolist())
    means, covs, kept = [], [], []
    for row, seen in enumerate(heard):
        filter_.update(seen)
        if wanted is None or row in wanted:
            belief = filter_.belief(seen.t_s)
            kept.append(row)
            means.append(belief.mean_to_ne_mps)
            covs.append(belief.cov_ne_m2ps2)
    mean, cov = np.array(means), np.array(covs)
    if rows is None:
        return mean, cov
    at = np.searchsorted(kept, rows)
    return mean[at], cov[at]


def fused(heard: Sequence[WindObservation], params: DragFusionParams) -> tuple[Floats, Floats]:
    """Mean (n, 2) and covariance (n, 2, 2) at each row, over the rows that tell velocity and
    attitude; the last belief in between."""
    rows = [
        i
        for i, s in enumerate(heard)
        if s.vel_ned_mps is not None and None not in (s.roll_rad, s.pitch_rad, s.yaw_rad)
    ]
    seen = [heard[i] for i in rows]
    mean, cov = drag_fusion(
        np.array([s.t_s for s in seen]),
        np.array([s.vel_ned_mps for s in seen]),
        np.array([(s.roll_rad, s.pitch_rad, s.yaw_rad) for s in seen], float),
        np.array([s.airborne for s in seen]),
        seen[0].density_kgpm3,
        params,
    )
    at = np.clip(np.searchsorted(rows, np.arange(len(heard)), side="right") - 1, 0, None)
    return mean[at], cov[at]
