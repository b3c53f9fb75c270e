"""One run of `promise`: winds, evaluation blocks, missions, and outcomes under each rule."""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from sim_bridge.research.promise.planner import HISTORY_S, MissionView, mission_view
from sim_bridge.research.promise.recording import Stretch, WindRecording, read_recording
from sim_bridge.research.promise.truth import TrueMissions, TruePower
from sim_bridge.research.promise.vehicle import (
    WIND_OVER_AIR,
    airspeed_for_wind_mps,
    vehicle_at_airspeed,
)
from sim_bridge.truth.wind_days import draw_day_process, draw_day_wind_series

TIERS = {"hard": (0.5, 1.1), "easy": (0.2, 1.1), "stress": (0.5, 1.1)}
"""Energy of the round trip in the wind before the start, as shares of the budget."""

PRIOR_WIND_S = 30  # wind before the start: known to the vehicle, determines the distance
BLOCK_S = 1200
DAY_S = 3600
SIMULATED_MEAN_MPS = 8.0
MAX_FOLDS = 8
UNIT_S = 300  # bootstrap unit on recordings


@dataclass(frozen=True, slots=True)
class PromiseSetting:
    """Options of a run. With `files`, the recordings' digests, it identifies the run."""

    missions: int
    seed: int
    wind_logs: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    simulated_days: int = 0
    airspeed_mps: float | None = None
    tier: str = "hard"
    max_loss: float = 0.01


@dataclass(frozen=True, slots=True)
class Block:
    """Cross-validation block: mission starts from second `first` to `last` of a stretch.

    `last_flight_second`: last second through which a mission of the block may fly.
    """

    stretch: int
    first: int
    last: int
    last_flight_second: int


def divide_into_blocks(
    stretches: tuple[Stretch, ...], longest_mission_s: float
) -> tuple[Block, ...]:
    """Divide every stretch into blocks of equal length, about 20 minutes each.

    A mission starts at least PRIOR_WIND_S into its stretch and ends within it. Raises LeewayError
    if no stretch is long enough.
    """
    blocks: list[Block] = []
    max_flight_s = math.ceil(longest_mission_s)
    for index, stretch in enumerate(stretches):
        last_start = stretch.seconds - max_flight_s
        if last_start < PRIOR_WIND_S:
            continue
        count = max(1, round((last_start + 1) / BLOCK_S))
        edges = np.linspace(PRIOR_WIND_S, last_start + 1, count + 1).round().astype(int).tolist()
        for first, end in itertools.pairwise(edges):
            blocks.append(Block(index, first, end - 1, end - 1 + max_flight_s))
    if not blocks:
        longest = max((s.seconds for s in stretches), default=0)
        raise LeewayError(
            f"the longest stretch lasts {longest} s: expected {max_flight_s + PRIOR_WIND_S} s or"
            " more, for one whole mission and the wind before it"
        )
    return tuple(blocks)


def draw_stratified_starts(
    blocks: tuple[Block, ...], count: int, rng: np.random.Generator
) -> tuple[Ints, Ints]:
    """Return block index and start second of each mission, uniform over all seconds of blocks."""
    firsts = np.array([b.first for b in blocks])
    edges = np.concatenate([[0], np.cumsum([b.last - b.first + 1 for b in blocks])])
    second = np.floor((np.arange(count) + rng.random(count)) / count * edges[-1]).astype(np.int64)
    block = np.searchsorted(edges, second, side="right") - 1
    return block, second - edges[block] + firsts[block]


def draw_missions(
    power: TruePower,
    tier: str,
    recent_ne_mps: Floats,
    wind_ne_mps: Floats,
    rng: np.random.Generator,
) -> tuple[TrueMissions, Floats]:
    """Draw missions in uniform directions, of lengths by the tier in the recent wind (n, 2).

    `wind_ne_mps` (n, seconds, 2): the wind from the start on. Returns the missions and the shares
    of the budget that they need in the recent wind.
    """
    angle = rng.uniform(0.0, 2.0 * math.pi, len(wind_ne_mps))
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    frac = rng.uniform(*TIERS[tier], len(wind_ne_mps))
    distance = power.distances_that_use_budget_frac_m(recent_ne_mps, unit, frac)
    return TrueMissions(power, unit, distance, wind_ne_mps), frac


class PromiseWorld:
    """Winds, missions and true outcomes; identical in every process for the same setting."""

    def __init__(self, setting: PromiseSetting) -> None:
        """Raises LeewayError unless the wind is either recorded or simulated, and long enough."""
        if bool(setting.wind_logs) == bool(setting.simulated_days):
            raise LeewayError("expected either --wind-log or --simulated-days")
        self.setting = setting
        self.recordings: tuple[WindRecording, ...] = tuple(
            read_recording(Path(name)) for name in setting.wind_logs
        )
        simulated = draw_simulated_wind_days(
            setting.simulated_days, setting.seed, SIMULATED_MEAN_MPS
        )
        self.stretches = simulated or tuple(s for r in self.recordings for s in r.stretches)
        speeds = [np.hypot(s.wind_ne_mps[:, 0], s.wind_ne_mps[:, 1]) for s in self.stretches]
        self.mean_wind_mps = float(np.concatenate(speeds).mean())
        self.vehicle = vehicle_at_airspeed(
            setting.airspeed_mps
            or airspeed_for_wind_mps(self.mean_wind_mps, WIND_OVER_AIR[setting.tier])
        )
        self.power = self.vehicle.power
        self.blocks = divide_into_blocks(self.stretches, self.power.endurance_s)
        self._draw_missions(np.random.default_rng([setting.seed, 1]))

    def _draw_missions(self, rng: np.random.Generator) -> None:
        """Draw missions in chronological order, in uniform directions."""
        count = self.setting.missions
        self.block, self.start_s = draw_stratified_starts(self.blocks, count, rng)
        flight_s = math.ceil(self.power.endurance_s) + 1
        wind = np.stack([self._wind(i, 0, flight_s) for i in range(count)])
        recent = np.stack([self._wind(i, -PRIOR_WIND_S, 0).mean(axis=0) for i in range(count)])
        self.flown, self.budget_frac = draw_missions(
            self.power, self.setting.tier, recent, wind, rng
        )

    def _wind(self, mission_index: int, first_s: int, end_s: int) -> Floats:
        """Return the wind from `first_s` until before `end_s` after the start of a mission."""
        start = int(self.start_s[mission_index])
        stretch = self.stretches[self.blocks[self.block[mission_index]].stretch]
        return stretch.wind_ne_mps[start + first_s : start + end_s]

    def mission_view(self, mission_index: int) -> MissionView:
        """Return the planner's inputs for one mission, with wind at 1 s intervals."""
        history = self._wind(mission_index, -min(HISTORY_S, int(self.start_s[mission_index])), 0)
        noise = np.random.default_rng([self.setting.seed, 5, mission_index])
        return mission_view(self.flown, mission_index, history, noise)

    @cached_property
    def block_indices_by_fold(self) -> tuple[tuple[int, ...], ...]:
        """Block indices of each fold: one block each, or at most MAX_FOLDS groups of blocks."""
        count = len(self.blocks)
        folds = min(count, MAX_FOLDS)
        groups = np.arange(count) * folds // count
        return tuple(tuple(np.nonzero(groups == fold)[0].tolist()) for fold in range(folds))

    @cached_property
    def bootstrap_unit_by_mission(self) -> Ints:
        """Bootstrap unit of each mission: 300 s of a recording, or a simulated day, as a number."""
        stretch = np.array([self.blocks[k].stretch for k in self.block])
        if not self.recordings:
            return stretch
        part = self.start_s // UNIT_S
        return stretch * (1 + int(part.max())) + part


@lru_cache(maxsize=1)
def cached_promise_world(setting: PromiseSetting) -> PromiseWorld:
    """The world of a setting, built once per process."""
    return PromiseWorld(setting)


def draw_simulated_wind_days(
    day_count: int, seed: int, mean_wind_mps: float
) -> tuple[Stretch, ...]:
    """Draw independent days of wind with the given mean speed."""
    days: list[Stretch] = []
    for day in range(day_count):
        rng = np.random.default_rng([seed, 3, day])
        process = draw_day_process(mean_wind_mps, rng)
        days.append(Stretch(0.0, draw_day_wind_series(process, DAY_S, rng)))
    return tuple(days)
