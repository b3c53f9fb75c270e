"""Missions in the fields: the flight's own gate with own wind alone, and with the fleet's.

As in `promise` a mission flies straight out, delivers and flies straight back, and meets the wind
of one place from its start to its end; here the place is drawn over the site. Its vehicle is one of
the fleet. Each mission is flown under many accepted risks at once, so that policies can be compared
where they lose the same.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from companion.adapters.files.params import params_dir
from companion.core.base.arrays import Floats, Ints
from companion.core.wind.process import WindProcessParams
from sim_bridge.research.fleet_wind.alert_study import beliefs, front_news
from sim_bridge.research.fleet_wind.front_stages import FrontsTold, front_known
from sim_bridge.research.fleet_wind.mission_outlook import FleetForesight
from sim_bridge.research.fleet_wind.patrols import HEIGHT_M, SITE_M
from sim_bridge.research.fleet_wind.study import (
    DrawnField,
    FleetWindSetting,
    case_names,
    drawn_field,
    mean_wind_mps,
)
from sim_bridge.research.fleet_wind.worlds import FleetWorld, world_of
from sim_bridge.research.promise import flying
from sim_bridge.research.promise.blocks import BEFORE_S, TIERS, distances_m
from sim_bridge.research.promise.planner import HISTORY_S, MissionView, Planner
from sim_bridge.research.promise.rules import Ends, clairvoyant, ends_of
from sim_bridge.research.promise.truth import Missions, TrueMissions
from sim_bridge.research.promise.world import FASTEST_MPS, SLOWEST_MPS, PromiseWorld, Setting

FRONT_SHARE = 0.1
"""Fronts as they come: so many of the missions are flown in an hour with one."""

LEVELS = tuple(float(x) for x in np.geomspace(0.003, 0.6, 12))
"""Risks that a single decision may take; policies are compared at the loss that comes of them."""

OWN_ONLY, FLEET, LIED_TO = "own_only", "fleet", "lied_to"
CHUNK = 10


@dataclass(frozen=True, slots=True)
class MissionSetting:
    """How missions are flown. `draws`: fields about each case."""

    fields: FleetWindSetting
    draws: int
    missions: int
    wind_air: float
    tier: str
    max_loss: float
    lie_mps: float = 0.0
    """Flown again with a desk that adds so much tailwind for the way home to all it tells; 0: not.
    """

    def promise(self, airspeed_mps: float) -> Setting:
        """The same vehicle, as `promise` has it."""
        log = self.fields.wind_log
        return Setting(
            wind_logs=() if log is None else (log,),
            files=() if log is None else (self.fields.file,),
            simulated_days=0 if log is not None else 1,
            airspeed_mps=airspeed_mps,
            tier=self.tier,
            missions=1,
            seed=self.fields.seed,
            max_loss=self.max_loss,
            airframe="m100",
            truth_file=str(params_dir() / "truth" / "m100.toml"),
            wind_process="coast",
            pack_std_frac=0.0,
        )


@dataclass(frozen=True, slots=True)
class MissionWork:
    """Some missions of one field, with its front or without."""

    setting: MissionSetting
    case: int
    number: int
    front: bool
    first: int
    count: int


@dataclass(frozen=True, slots=True)
class MissionsFlown:
    """How some missions ended, by policy and level: codes of `END_CODES`, (missions, levels) as
    lists. `used`: share of looks at which the fleet was used.
    """

    case: int
    number: int
    front: bool
    ends: dict[str, list[list[int]]]
    clairvoyant: list[int]
    asked: int
    used: int


SUC, DEL, FAIL, ABRT = range(4)


def works_of(setting: MissionSetting) -> list[MissionWork]:
    """All missions in pieces, spread evenly over the fields; some in hours with a front."""
    cases = range(len(case_names(setting.fields)))
    fields = [(case, number) for number in range(setting.draws) for case in cases]
    fronts = round(FRONT_SHARE * setting.missions)
    work: list[MissionWork] = []
    for k, (case, number) in enumerate(fields):
        for front, total in ((False, setting.missions - fronts), (True, fronts)):
            mine = total // len(fields) + (k < total % len(fields))
            for first in range(0, mine, CHUNK):
                count = min(CHUNK, mine - first)
                work.append(MissionWork(setting, case, number, front, first, count))
    return work


def fly_missions(work: MissionWork) -> MissionsFlown:
    """Fly them by every policy."""
    site = _site(work.setting, work.case, work.number, work.front)
    rng = np.random.default_rng(
        [work.setting.fields.seed, 11, work.case, work.number, int(work.front), work.first]
    )
    drawn = _drawn(site, work, rng)
    params = flying.planner_params(site.promise, site.process, 1.0, LEVELS)
    planner = Planner(flying.believed_route_energy(site.setting), params)
    lie_mps = work.setting.lie_mps
    turns: dict[str, list[list[float]]] = {OWN_ONLY: [], FLEET: []}
    turns |= {LIED_TO: []} if lie_mps else {}
    asked = used = 0
    for k in range(work.count):
        noise = [work.setting.fields.seed, 12, work.case, work.number, work.first + k]
        seen = drawn.seen(k)
        start_s = float(drawn.flown.missions.start[k])
        place = drawn.place_ne_m[k]
        fleet = FleetForesight(site.world, site.fronts, site.process, place, start_s)
        north, east = (-lie_mps * float(x) for x in seen.unit_ne)
        told_lies = FleetForesight(
            site.world, site.fronts, site.process, place, start_s, (north, east)
        )
        by_policy = {OWN_ONLY: None, FLEET: fleet, LIED_TO: told_lies}
        for policy, by_mission in turns.items():
            decided = planner.fly(seen, np.random.default_rng(noise), by_policy[policy])
            by_mission.append([one.turn_s for one in decided])
        asked, used = asked + fleet.asked, used + fleet.used
    ends = {
        policy: np.stack(
            [_codes(_ends(drawn.flown, each)) for each in np.array(by_mission).T], axis=1
        ).tolist()
        for policy, by_mission in turns.items()
    }
    with np.errstate(invalid="ignore"):
        best = _codes(clairvoyant(drawn.flown)).tolist()
    return MissionsFlown(work.case, work.number, work.front, ends, best, asked, used)


def _ends(flown: TrueMissions, turn_s: Floats) -> Ends:
    with np.errstate(invalid="ignore"):  # who never arrives has no energy to deliver either
        return ends_of(flown, turn_s, turn_s > 0.0)


def _codes(ends: Ends) -> Ints:
    """SUC, DEL, FAIL or ABRT of each."""
    lost = np.where(ends.delivered, DEL, FAIL)
    home = np.where(ends.delivered, SUC, ABRT)
    flew = np.where(ends.home, home, lost)
    return np.where(ends.go, flew, ABRT).astype(np.int64)


# --- one field -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Site:
    """One field with all that is told in it."""

    world: FleetWorld
    fronts: FrontsTold
    process: WindProcessParams
    setting: Setting
    promise: PromiseWorld


@dataclass(frozen=True, slots=True)
class _Drawn:
    """Missions of one field: their places, and the wind there from `HISTORY_S` before the start."""

    flown: TrueMissions
    place_ne_m: Floats
    before_ne_mps: Floats

    def seen(self, k: int) -> MissionView:
        """What one mission's vehicle may see: the wind at its place."""
        flown = self.flown
        return MissionView(
            wind_ne_mps=np.concatenate([self.before_ne_mps[k], flown.wind_ne_mps[k]]),
            history_s=HISTORY_S,
            unit_ne=flown.missions.unit_ne[k],
            distance_m=float(flown.missions.distance_m[k]),
            arrival_s=float(flown.arrival_s[k]),
            out_m=flown.out_by_second(k),
        )


def airspeed_of(setting: MissionSetting) -> float:
    """The airspeed over which the mean wind of all fields is `wind_air`."""
    mean_mps = mean_wind_mps(setting.fields)
    return min(max(mean_mps / setting.wind_air, SLOWEST_MPS), FASTEST_MPS)


@lru_cache(maxsize=2)
def _vehicle(setting: MissionSetting) -> Setting:
    return setting.promise(airspeed_of(setting))


@lru_cache(maxsize=1)
def _field(setting: FleetWindSetting, case: int, number: int) -> DrawnField:
    return drawn_field(setting, case, number)


@lru_cache(maxsize=1)
def _site(setting: MissionSetting, case: int, number: int, front: bool) -> _Site:
    drawn = _field(setting.fields, case, number)
    rng = np.random.default_rng([setting.fields.seed, 14, case, number, int(front)])
    truth = drawn.truth(front=front)
    world = world_of(truth, drawn.seconds, drawn.process, drawn.ways, rng)
    told = beliefs(truth, drawn.ways, 0.0, float(drawn.seconds), rng)
    names = [way.name for way in drawn.ways]
    news = front_news(told, names, drawn.process)
    fronts = tuple(front_known(one) for one in news)
    vehicle = _vehicle(setting)
    return _Site(world, fronts, drawn.process, vehicle, flying.world_of(vehicle))


def _drawn(site: _Site, work: MissionWork, rng: np.random.Generator) -> _Drawn:
    """As `promise` draws them; the wind is the one of a place drawn over the site."""
    power, count = site.promise.power, work.count
    reach = math.ceil(power.endurance_s)
    place = rng.uniform(-SITE_M, SITE_M, (count, 2))
    start = rng.integers(HISTORY_S, site.world.seconds - reach, count)
    angle = rng.uniform(0.0, 2.0 * math.pi, count)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    asked = rng.uniform(*TIERS[work.setting.tier], count)
    wind = np.empty((count, HISTORY_S + reach + 1, 2))
    for k in range(count):
        t_s = start[k] - HISTORY_S + np.arange(wind.shape[1]) + 0.5
        wind[k] = site.world.truth.to_ne_mps(t_s, place[k, 0], place[k, 1], HEIGHT_M)
    before, after = wind[:, :HISTORY_S], wind[:, HISTORY_S:]
    recent = before[:, -BEFORE_S:].mean(axis=1)
    distance = distances_m(recent, unit, asked, power)
    missions = Missions(start.astype(np.int64), unit, distance)
    flown = TrueMissions(missions, power, site.promise.profile, after)
    return _Drawn(flown, place, before)
