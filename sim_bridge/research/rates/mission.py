"""One delivery as a function of standard normal numbers: wind, sensor noise, pack.

The world is that of `promise` on simulated days: the truth's power and wind process, straight out,
deliver, straight back, with the flight gate. Drawn are the day's mean wind, the wind components at
each second, the noise of the observed wind, the pack's energy, and the share of the budget that the
trip needs. The accepted loss is the operator's rate times the flight hours.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from companion.adapters.files.params import read_wind_process
from companion.core.base.arrays import Floats
from sim_bridge.research.promise.planner import (
    COUNTER_STD_FRAC,
    HISTORY_S,
    MissionView,
    Planner,
    mission_view,
)
from sim_bridge.research.promise.truth import TrueMissions
from sim_bridge.research.promise.vehicle import WIND_OVER_AIR, vehicle_at_airspeed
from sim_bridge.research.promise.world import PRIOR_WIND_S, SIMULATED_MEAN_MPS, TIERS
from sim_bridge.truth.wind_days import build_day_process, day_wind_series

TIER = "hard"
PACK_STD_FRAC = 0.02
DECISION_INTERVAL_S = 150.0
"""Interval between decisions: a delivery has four or five."""
MAX_SHORTFALL = 5.0
_PARTS = 3
_SCALARS = 4  # day's wind, direction, budget share, pack


@dataclass(frozen=True, slots=True)
class DeliveryOutcome:
    """`shortfall`: needed over available energy, minus 1; -1 if it did not depart."""

    shortfall: float
    flown_h: float
    departed: bool
    delivered: bool


class DeliveryWorld:
    """Deliveries under one accepted rate of losses per flight hour."""

    def __init__(self, max_loss_per_hour: float) -> None:
        self._rate = max_loss_per_hour
        self._vehicle = vehicle_at_airspeed(SIMULATED_MEAN_MPS / WIND_OVER_AIR[TIER])
        self._power = self._vehicle.power
        self._process = read_wind_process("coast")
        self._rows = HISTORY_S + int(self._power.endurance_s) + 61

    @property
    def random_variable_count(self) -> int:
        """Number of standard normal variables per delivery."""
        return _SCALARS + 2 * self._rows * (_PARTS + 1)

    def simulate_delivery(self, standard_normals: Floats) -> DeliveryOutcome:
        """Simulate one delivery; its shortfall is the performance function: above 0 is a loss."""
        day, turn, budget_draw, pack = standard_normals[:_SCALARS].tolist()
        series = standard_normals[_SCALARS:].reshape(_PARTS + 1, self._rows, 2)
        speed = SIMULATED_MEAN_MPS * (0.75 + 0.5 * float(ndtr(day)))
        wind = day_wind_series(build_day_process(speed, 0.0), series[:_PARTS])
        noise = series[_PARTS]
        angle = 2.0 * math.pi * float(ndtr(turn))
        unit = np.array([[math.cos(angle), math.sin(angle)]])
        recent = wind[None, HISTORY_S - PRIOR_WIND_S : HISTORY_S].mean(axis=1)
        low, high = TIERS[TIER]
        share = np.array([low + (high - low) * float(ndtr(budget_draw))])
        distance_m = self._power.distances_that_use_budget_frac_m(recent, unit, share)
        flown = TrueMissions(self._power, unit, distance_m, wind[None, HISTORY_S:])
        available_wh = self._power.budget_wh * (1.0 + PACK_STD_FRAC * pack)
        view = mission_view(flown, 0, wind[:HISTORY_S], noise)
        return self._fly_mission(flown, view, available_wh)

    def _fly_mission(
        self, flown: TrueMissions, view: MissionView, available_wh: float
    ) -> DeliveryOutcome:
        hours = 2.0 * view.distance_m / flown.profile.airspeed_mps / 3600.0
        planner = Planner(
            self._vehicle,
            self._process,
            (min(max(self._rate * hours, 1e-9), 0.5),),
            pack_std_frac=math.hypot(PACK_STD_FRAC, COUNTER_STD_FRAC),
            decision_interval_s=DECISION_INTERVAL_S,
        )
        (decisions,) = planner.fly_mission(view)
        if not decisions.go:
            return DeliveryOutcome(-1.0, 0.0, False, False)
        delivers = decisions.turn_back_s is None
        (needed_wh,) = (
            flown.delivery_energy_wh()
            if delivers
            else flown.return_energy_wh(np.array([decisions.turn_s]))
        ).tolist()
        needed_wh = needed_wh if math.isfinite(needed_wh) else math.inf  # NaN: it never arrives
        shortfall = min(needed_wh / available_wh - 1.0, MAX_SHORTFALL)
        mean_w = 0.5 * (self._power.loaded_w + self._power.empty_w)
        flown_h = min(needed_wh, available_wh) / mean_w
        return DeliveryOutcome(shortfall, flown_h, True, delivers and shortfall <= 0.0)
