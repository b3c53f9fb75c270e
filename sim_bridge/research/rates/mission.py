"""One delivery as a function of standard normal numbers: its wind, its sensor, its pack.

The world is `promise`'s on simulated days: the truth's power and wind process, straight out,
deliver, straight back, decided by the flight's own gate. What is drawn: the day's mean wind, the
wind's parts second by second, the noise of the wind as seen, the pack's content, and how much of
the budget the trip asks for. The accepted loss is the operator's rate times the trip's hours.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtr

from companion.adapters.files.params import params_dir, read_wind_process
from companion.core.base.arrays import Floats, Ints
from companion.core.routing.leg_energy import RouteEnergy
from sim_bridge.research.promise.blocks import TIERS, distances_m
from sim_bridge.research.promise.flying import believed_route_energy, planner_params, world_of
from sim_bridge.research.promise.planner import (
    HISTORY_S,
    MissionView,
    Planner,
    PlannerParams,
)
from sim_bridge.research.promise.truth import Missions, Profile, TrueMissions, TruePower
from sim_bridge.research.promise.world import SIMULATED_MEAN_MPS, WIND_OVER_AIR, Setting
from sim_bridge.truth.wind_days import EDDY_LENGTH_M

TIER = "hard"
PACK_STD_FRAC = 0.02
EVERY_S = 150.0
"""Between decisions: a delivery has four or five."""
RECENT_S = 30
MOST = 5.0
_PARTS = 3
_SCALARS = 4  # day's wind, direction, what is asked for, pack
_DAY_STDS, _DAY_MEMORIES_S = (0.10, 0.09, 0.165), (1200.0, 180.0)


@dataclass(frozen=True, slots=True)
class DeliveryOutcome:
    """`shortfall`: energy that it needed over what it had, less 1; -1 where it did not go."""

    shortfall: float
    flown_h: float
    went: bool
    delivered: bool


class DeliveryWorld:
    """Deliveries under one accepted rate of losses per flight hour."""

    def __init__(self, max_loss_per_hour: float) -> None:
        self._rate = max_loss_per_hour
        self._power, self._profile, self._energy, self._params = _shared()
        self._seconds = int(self._power.endurance_s) + 60

    @property
    def dimensions(self) -> int:
        """Numbers that a delivery is drawn from."""
        rows = HISTORY_S + self._seconds + 1
        return _SCALARS + 2 * rows * (_PARTS + 1)

    def shortfall(self, normal: Floats) -> float:
        """For a simulation of rare events: above 0 is a loss."""
        return self.fly(normal).shortfall

    def fly(self, normal: Floats) -> DeliveryOutcome:
        """One delivery."""
        day, turn, asked, pack = normal[:_SCALARS]
        rows = HISTORY_S + self._seconds + 1
        parts = normal[_SCALARS : _SCALARS + 2 * rows * _PARTS].reshape(_PARTS, rows, 2)
        noise = normal[_SCALARS + 2 * rows * _PARTS :].reshape(rows, 2)
        wind = wind_on_day(float(day), parts)
        angle = 2.0 * math.pi * float(ndtr(turn))
        unit = np.array([math.cos(angle), math.sin(angle)])
        recent = wind[HISTORY_S - RECENT_S : HISTORY_S].mean(axis=0)
        low, high = TIERS[TIER]
        share = low + (high - low) * float(ndtr(asked))
        distance = float(distances_m(recent[None], unit[None], np.array([share]), self._power)[0])
        if not math.isfinite(distance) or distance <= 0.0:
            return DeliveryOutcome(-1.0, 0.0, False, False)
        zero: Ints = np.zeros(1, np.int64)
        missions = Missions(zero, unit[None], np.array([distance]))
        flown = TrueMissions(missions, self._power, self._profile, wind[None, HISTORY_S:])
        has_wh = self._power.budget_wh * (1.0 + PACK_STD_FRAC * float(pack))
        return self._decided(flown, wind, noise, distance, has_wh)

    def _decided(
        self, flown: TrueMissions, wind: Floats, noise: Floats, distance: float, has_wh: float
    ) -> DeliveryOutcome:
        arrival_s = float(flown.arrival_s[0])
        seen = MissionView(
            wind, HISTORY_S, flown.missions.unit_ne[0], distance, arrival_s, flown.out_by_second(0)
        )
        hours = 2.0 * distance / self._profile.airspeed_mps / 3600.0
        accepted = min(max(self._rate * hours, 1e-9), 0.5)
        planner = Planner(self._energy, replace(self._params, accepted=(accepted,)))
        (decided,) = planner.fly(seen, _Noise(noise))  # pyright: ignore[reportArgumentType]
        if not decided.go:
            return DeliveryOutcome(-1.0, 0.0, False, False)
        delivers = math.isinf(decided.turn_s)
        if delivers:
            needed_wh = float(flown.delivering_wh()[0])
        else:
            needed_wh = float(flown.turning_wh(np.array([decided.turn_s]))[0])
        shortfall = min(needed_wh / has_wh - 1.0, MOST) if math.isfinite(needed_wh) else MOST
        mean_w = 0.5 * (self._power.loaded_w + self._power.empty_w)
        flown_h = min(needed_wh if math.isfinite(needed_wh) else has_wh, has_wh) / mean_w
        return DeliveryOutcome(shortfall, flown_h, True, delivers and shortfall <= 0.0)


class _Noise:
    """Stands for a generator: the planner's sensor noise is a part of what is drawn."""

    def __init__(self, normal: Floats) -> None:
        self._normal = normal

    def standard_normal(self, shape: tuple[int, ...]) -> Floats:
        """The drawn numbers; the shape is the wind's."""
        return self._normal.reshape(shape)


def wind_on_day(day: float, parts: Floats) -> Floats:
    """(rows, 2): a day's mean, and its parts as exact Ornstein-Uhlenbeck steps of a second."""
    speed = SIMULATED_MEAN_MPS * (0.75 + 0.5 * float(ndtr(day)))
    memories: tuple[float, ...] = (*_DAY_MEMORIES_S, EDDY_LENGTH_M / speed)
    wind = np.tile([speed, 0.0], (parts.shape[1], 1))
    for frac, memory, steps in zip(_DAY_STDS, memories, parts, strict=True):
        keep = math.exp(-1.0 / memory)
        driven = math.sqrt(1.0 - keep * keep) * steps
        driven[0] = steps[0]
        wind += frac * speed * np.asarray(lfilter([1.0], [1.0, -keep], driven, axis=0))
    return wind


@lru_cache(maxsize=1)
def _shared() -> tuple[TruePower, Profile, RouteEnergy, PlannerParams]:
    """Power, profile, the believed energy model, and the planner's parameters."""
    airspeed_mps = SIMULATED_MEAN_MPS / WIND_OVER_AIR[TIER]
    setting = Setting(
        (), (), 1, airspeed_mps, TIER, 1, 1, 0.01, "m100",
        str(params_dir() / "truth" / "m100.toml"), "coast", PACK_STD_FRAC,
    )  # fmt: skip
    world = world_of(setting)
    params = planner_params(world, read_wind_process("coast"), 1.0, (0.01,))
    energy = believed_route_energy(setting)
    return world.power, world.profile, energy, replace(params, every_s=EVERY_S)
