"""Lost missions of the gate, each with the wind that it met after its last decision."""

import numpy as np
from msgspec import Struct

from companion.core.base.arrays import Floats
from sim_bridge.research.promise.rules import MissionOutcomes
from sim_bridge.research.promise.truth import TrueMissions, ground_speed_mps

BEFORE_S = 30
"""Time before the last decision over which its wind is averaged."""

WIND_CHANGED = "wind changed after the last decision"
TOO_FAR = "too far for the wind at the last decision"
NO_PROGRESS = "no progress against the wind"


class Loss(Struct, frozen=True):
    """One lost mission.

    `start_of_return_s`: turn or arrival, the last decision. `p_home`: stated at departure, half way
    out and over the customer, None if not reached. Headwinds on the way home: mean of 30 s before
    the last decision, and from it to the end. `steady_margin_wh`: energy that had been left if the
    wind before the last decision had continued.
    """

    mission: int
    delivered: bool
    p_home: list[float | None]
    start_of_return_s: float
    shortage_wh: float | None
    headwind_before_mps: float
    headwind_after_mps: float
    steady_margin_wh: float
    cause: str


def find_losses(
    flown: TrueMissions, outcomes: MissionOutcomes, turn_s: Floats, p_home: Floats
) -> list[Loss]:
    """Return the losses; `turn_s` (n,): inf where the mission delivers; `p_home` (n, 3)."""
    return [
        _loss(flown, outcomes, int(k), float(turn_s[k]), p_home[k])
        for k in np.flatnonzero(outcomes.lost)
    ]


def _loss(
    flown: TrueMissions, outcomes: MissionOutcomes, k: int, turn_s: float, p_home: Floats
) -> Loss:
    delivers, power, profile = not np.isfinite(turn_s), flown.power, flown.profile
    start_s = float(flown.arrival_s[k]) if delivers else turn_s
    last = flown.wind_ne_mps.shape[1] - 1
    at = int(min(start_s, last)) if np.isfinite(start_s) else last
    end = min(max(int(outcomes.flight_h[k] * 3600.0), at + 1), last)
    headwind = flown.wind_ne_mps[k] @ flown.unit_ne[k]
    before = flown.wind_ne_mps[k, max(at - BEFORE_S, 0) : at + 1].mean(axis=0)
    after_mps = float(headwind[at : end + 1].mean())
    back_mps = float(ground_speed_mps(profile.airspeed_mps, before, -flown.unit_ne[k]))
    speed = np.array([np.hypot(*before)])
    left_wh = power.budget_wh - power.loaded_w * at / 3600.0
    if delivers:
        left_wh -= float(power.customer_energy_wh(speed)[0])
    distance_m = min(float(flown.out_m[k, at]), float(flown.distance_m[k]))
    cruise_w = power.empty_w if delivers else power.loaded_w
    cruise_wh = cruise_w * distance_m / back_mps / 3600.0 if back_mps > 0.0 else np.inf
    landing_wh = float(power.landing_energy_wh(speed, loaded=not delivers)[0])
    steady_wh = left_wh - cruise_wh - landing_wh
    shortage_wh = -float(outcomes.margin_wh[k])
    cause = WIND_CHANGED if steady_wh >= 0.0 else TOO_FAR
    if not np.isfinite(shortage_wh):
        cause = NO_PROGRESS
    return Loss(
        mission=k,
        delivered=bool(outcomes.delivered[k]),
        p_home=[float(p) if np.isfinite(p) else None for p in p_home],
        start_of_return_s=float(at),
        shortage_wh=shortage_wh if np.isfinite(shortage_wh) else None,
        headwind_before_mps=float(before @ flown.unit_ne[k]),
        headwind_after_mps=after_mps,
        steady_margin_wh=max(steady_wh, -power.budget_wh),
        cause=cause,
    )
