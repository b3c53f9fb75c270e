"""Judged blocks, missions drawn in them, and the wind that each mission meets."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from sim_bridge.research.promise.recording import Stretch
from sim_bridge.research.promise.truth import Missions, Profile, TrueMissions, TruePower

BLOCK_S = 1200
BEFORE_S = 30  # wind before the start: the vehicle sees it, and it sets the distance
TIERS = {"hard": (0.5, 1.1), "easy": (0.2, 1.1), "stress": (0.5, 1.1)}
LEAST_DISTANCE_M = 50.0


@dataclass(frozen=True, slots=True)
class Block:
    """Starts of missions from second `first` to `last` of a stretch; one cross-validation block.

    `until`: the last second that a mission from it may fly through.
    """

    stretch: int
    first: int
    last: int
    until: int


def blocks_of(stretches: tuple[Stretch, ...], longest_s: float) -> tuple[Block, ...]:
    """Blocks of about 20 minutes over every stretch, of equal length within a stretch.

    A mission starts at least BEFORE_S into its stretch and ends within it. Raises LeewayError if no
    stretch is long enough.
    """
    blocks: list[Block] = []
    reach = math.ceil(longest_s)
    for index, stretch in enumerate(stretches):
        last_start = stretch.seconds - reach
        if last_start < BEFORE_S:
            continue
        count = max(1, round((last_start + 1) / BLOCK_S))
        edges = np.linspace(BEFORE_S, last_start + 1, count + 1).round().astype(int)
        for a, b in itertools.pairwise(edges):
            blocks.append(Block(index, int(a), int(b) - 1, int(b) - 1 + reach))
    if not blocks:
        longest = max((s.seconds for s in stretches), default=0)
        raise LeewayError(
            f"the longest stretch lasts {longest} s: expected {reach + BEFORE_S} s or more,"
            " for one whole mission and what is seen before it"
        )
    return tuple(blocks)


@dataclass(frozen=True, slots=True)
class DrawnMissions:
    """Missions in order of time, with the block that each starts in."""

    block: Ints
    flown: TrueMissions
    asked_frac: Floats
    """Round-trip energy in the mean wind of the last 30 s, over the budget."""


def draw_missions(
    stretches: tuple[Stretch, ...],
    blocks: tuple[Block, ...],
    power: TruePower,
    profile: Profile,
    tier: str,
    count: int,
    rng: np.random.Generator,
) -> DrawnMissions:
    """Draw `count` missions: starts uniform over all judged seconds (stratified), directions
    uniform.
    """
    widths = np.array([b.last - b.first + 1 for b in blocks])
    edges = np.concatenate([[0], np.cumsum(widths)])
    second = np.floor((np.arange(count) + rng.random(count)) / count * edges[-1]).astype(np.int64)
    block = np.searchsorted(edges, second, side="right") - 1
    start = second - edges[block] + np.array([b.first for b in blocks])[block]
    angle = rng.uniform(0.0, 2.0 * math.pi, count)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    low, high = TIERS[tier]
    asked = rng.uniform(low, high, count)
    reach = math.ceil(power.endurance_s)
    wind = np.empty((count, reach + 1, 2))
    recent = np.empty((count, 2))
    for i in range(count):
        series = stretches[blocks[block[i]].stretch].wind_ne_mps
        wind[i] = series[start[i] : start[i] + reach + 1]
        recent[i] = series[start[i] - BEFORE_S : start[i]].mean(axis=0)
    distance = distances_m(recent, unit, asked, power)
    missions = Missions(start, unit, distance)
    return DrawnMissions(block, TrueMissions(missions, power, profile, wind), asked)


def distances_m(wind_ne_mps: Floats, unit_ne: Floats, asked: Floats, power: TruePower) -> Floats:
    """Distance (n,) whose round trip takes the share `asked` of the budget in a constant wind."""
    speed = np.hypot(wind_ne_mps[:, 0], wind_ne_mps[:, 1])
    fixed_wh = power.deliver_wh(speed) + power.land_wh(speed, loaded=False)
    per_m = power.round_trip_wh_per_m(wind_ne_mps, unit_ne)
    return np.maximum((asked * power.budget_wh - fixed_wh) / per_m, LEAST_DISTANCE_M)
