"""Missions in the fields: the flight gate with own wind only, and with fleet wind.

As in `promise`, a mission flies straight out, delivers, flies straight back, and meets the wind of
one position throughout; here the position is drawn over the site. The vehicle is a fleet member.
Each mission is flown under many accepted risks at once, so that policies can be compared at equal
loss.

The risk of a policy is calibrated on fields that do not evaluate it: those of the other half of the
recording (for a synthetic field, those of the other parity). It is the risk at which the policy
lost `max_loss` there. Between two flown risks, each mission is assigned one of them at random.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.wind.process import WindProcessParams
from sim_bridge.research.fleet_wind.fields import (
    HEIGHT_M,
    SITE_M,
    FleetWindSetting,
    FleetWorld,
    draw_field,
    read_cases,
)
from sim_bridge.research.fleet_wind.foresight import FleetForecaster
from sim_bridge.research.fleet_wind.fronts import KnownFronts, simulate_detected_fronts
from sim_bridge.research.promise.calibrating import level_and_share_at_loss
from sim_bridge.research.promise.planner import HISTORY_S, Planner, mission_view
from sim_bridge.research.promise.rules import (
    MissionOutcomes,
    clairvoyant_outcomes,
    outcomes_of_turn_times,
)
from sim_bridge.research.promise.truth import TrueMissions, TruePower
from sim_bridge.research.promise.vehicle import (
    StudyVehicle,
    airspeed_for_wind_mps,
    vehicle_at_airspeed,
)
from sim_bridge.research.promise.world import PRIOR_WIND_S, draw_missions
from sim_bridge.research.study.sheet import Sheet

FRONT_SHARE = 0.1
"""Share of the missions that are flown in an hour with a front."""

LEVELS = tuple(float(x) for x in np.geomspace(0.003, 0.6, 12))
"""Accepted risks per decision; policies are compared at the resulting loss."""

OWN_ONLY, FLEET = "own_only", "fleet"
NAMES = {OWN_ONLY: "own wind alone", FLEET: "the fleet's wind", "clairvoyant": "clairvoyant"}
SUC, DEL, FAIL, ABRT = range(4)
CODES = {"SUC": SUC, "DEL": DEL, "FAIL": FAIL, "ABRT": ABRT}
CHUNK = 10


@dataclass(frozen=True, slots=True)
class MissionSetting:
    """Mission options. `draws`: number of fields per case."""

    fields: FleetWindSetting
    draws: int
    missions: int
    wind_over_air: float
    tier: str
    max_loss: float


@dataclass(frozen=True, slots=True)
class MissionWork:
    """Work item: missions of one field, with or without its front."""

    setting: MissionSetting
    case: int
    number: int
    front: bool
    first_mission: int
    count: int


@dataclass(frozen=True, slots=True)
class MissionsFlown:
    """Mission outcomes by policy and level: codes SUC, DEL, FAIL, ABRT as lists (missions, levels).
    `decision_count`: number of decisions; `fleet_used_count`: number of those that used fleet wind.
    """

    case: int
    number: int
    outcomes: dict[str, list[list[int]]]
    clairvoyant: list[int]
    decision_count: int
    fleet_used_count: int


def split_missions_into_work_items(setting: MissionSetting) -> list[MissionWork]:
    """Return work items spread evenly over the fields, a share of them with a front."""
    cases = range(len(read_cases(setting.fields)))
    fields = [(case, number) for number in range(setting.draws) for case in cases]
    fronts = round(FRONT_SHARE * setting.missions)
    work: list[MissionWork] = []
    for k, (case, number) in enumerate(fields):
        for front, total in ((False, setting.missions - fronts), (True, fronts)):
            field_missions = total // len(fields) + (k < total % len(fields))
            for first in range(0, field_missions, CHUNK):
                count = min(CHUNK, field_missions - first)
                work.append(MissionWork(setting, case, number, front, first, count))
    return work


def fly_missions_under_each_policy(work: MissionWork) -> MissionsFlown:
    """Fly the missions of a work item under every policy."""
    setting, key = work.setting, [work.setting.fields.seed, work.case, work.number]
    world, fronts, process = _build_site(setting.fields, work.case, work.number, work.front)
    vehicle = mission_vehicle(setting)
    rng = np.random.default_rng([key[0], 11, *key[1:], int(work.front), work.first_mission])
    flown, start_s, position_ne_m, before = _draw_missions(world, vehicle.power, work, rng)
    planner = Planner(vehicle, process, LEVELS)
    turn_times_s: dict[str, list[list[float]]] = {OWN_ONLY: [], FLEET: []}
    requested = used = 0
    for k in range(work.count):
        noise = np.random.default_rng([key[0], 12, *key[1:], work.first_mission + k])
        view = mission_view(flown, k, before[k], noise)
        fleet = FleetForecaster(world, fronts, process, position_ne_m[k], float(start_s[k]))
        for policy, forecaster in ((OWN_ONLY, None), (FLEET, fleet)):
            decisions = planner.fly_mission(view, forecaster)
            turn_times_s[policy].append([one.turn_s for one in decisions])
        requested, used = requested + fleet.decision_count, used + fleet.fleet_used_count
    with np.errstate(invalid="ignore"):  # a vehicle that never arrives has NaN delivery energy
        ends = {
            policy: np.stack(
                [
                    _outcome_codes(outcomes_of_turn_times(flown, turn_s, turn_s > 0.0))
                    for turn_s in np.array(by_mission).T
                ],
                axis=1,
            ).tolist()
            for policy, by_mission in turn_times_s.items()
        }
        best = _outcome_codes(clairvoyant_outcomes(flown)).tolist()
    return MissionsFlown(work.case, work.number, ends, best, requested, used)


def _outcome_codes(outcomes: MissionOutcomes) -> Ints:
    """Return SUC, DEL, FAIL or ABRT of each mission."""
    lost = np.where(outcomes.delivered, DEL, FAIL)
    home = np.where(outcomes.delivered, SUC, ABRT)
    flew = np.where(outcomes.returned_home, home, lost)
    return np.where(outcomes.go, flew, ABRT).astype(np.int64)


# --- one field -----------------------------------------------------------------------------------


def mission_vehicle(setting: MissionSetting) -> StudyVehicle:
    """Return the vehicle for which mean wind over airspeed is `wind_over_air`, within limits."""
    mean_mps = float(np.mean([case.mean_mps for case in read_cases(setting.fields)]))
    return vehicle_at_airspeed(airspeed_for_wind_mps(mean_mps, setting.wind_over_air))


_cached_field = lru_cache(maxsize=1)(draw_field)


@lru_cache(maxsize=1)
def _build_site(
    setting: FleetWindSetting, case_index: int, draw_index: int, with_front: bool
) -> tuple[FleetWorld, KnownFronts, WindProcessParams]:
    """Return one field with its wind, front reports and assumed process."""
    drawn = _cached_field(setting, case_index, draw_index)
    rng = np.random.default_rng([setting.seed, 14, case_index, draw_index, int(with_front)])
    world = drawn.draw_world_with_reports(rng, with_front=with_front)
    fronts = simulate_detected_fronts(drawn, rng, with_front=with_front)
    return world, fronts, drawn.case.process


def _draw_missions(
    world: FleetWorld, power: TruePower, work: MissionWork, rng: np.random.Generator
) -> tuple[TrueMissions, Ints, Floats, Floats]:
    """Draw missions as in `promise`, with the wind of positions drawn over the site.

    Returns the missions, their start times, their positions (n, 2), and the wind there from
    `HISTORY_S` before the start (n, HISTORY_S, 2).
    """
    count, max_flight_s = work.count, math.ceil(power.endurance_s)
    position_ne_m = rng.uniform(-SITE_M, SITE_M, (count, 2))
    start = rng.integers(HISTORY_S, world.seconds - max_flight_s, count)
    wind = np.empty((count, HISTORY_S + max_flight_s + 1, 2))
    for k, (north, east) in enumerate(position_ne_m):
        t_s = start[k] - HISTORY_S + np.arange(wind.shape[1]) + 0.5
        wind[k] = world.truth.to_ne_mps(t_s, north, east, HEIGHT_M)
    before, after = wind[:, :HISTORY_S], wind[:, HISTORY_S:]
    recent = before[:, -PRIOR_WIND_S:].mean(axis=1)
    flown, _ = draw_missions(power, work.setting.tier, recent, after, rng)
    return flown, start, position_ne_m, before


# --- verdict -------------------------------------------------------------------------------------


def evaluate_missions(
    flown: Sequence[MissionsFlown], setting: MissionSetting
) -> tuple[Sheet, dict[str, Any]]:
    """Return table and JSON keys of the missions."""
    row = outcome_counts_by_policy(flown, setting.fields.seed, setting.max_loss)
    used = sum(one.fleet_used_count for one in flown) / max(
        sum(one.decision_count for one in flown), 1
    )
    return mission_sheet(row, used, setting), {
        "missions": row,
        "missions_flown": {
            "wind_air": setting.wind_over_air,
            "tier": setting.tier,
            "max_loss": setting.max_loss,
            "front_share": FRONT_SHARE,
            "fleet_used_share": used,
        },
    }


def mission_sheet(
    outcome_counts: dict[str, dict[str, int]], fleet_used_frac: float, setting: MissionSetting
) -> Sheet:
    """Return the table of mission outcomes by policy."""
    note = (
        f"Wind/air {setting.wind_over_air:g}, {setting.tier}; loss accepted"
        f" {100 * setting.max_loss:g} %"
        f" of the missions, each policy's risk set on the other half's fields. {setting.draws}"
        f" fields about each half; one mission in {1.0 / FRONT_SHARE:.0f} in an hour with a front."
        f" The fleet was used at {100 * fleet_used_frac:.0f} % of the decisions."
    )
    columns = {
        "wind known by": lambda policy: NAMES[policy],
        "count": lambda policy: f"{sum(outcome_counts[policy].values())}",
        **{
            f"{name} %": lambda policy, name=name: (
                f"{100.0 * outcome_counts[policy][name] / sum(outcome_counts[policy].values()):.1f}"
            )
            for name in CODES
        },
    }
    return Sheet.from_objects("Missions", outcome_counts, columns, note)


def outcome_counts_by_policy(
    flown: Sequence[MissionsFlown], seed: int, max_loss: float
) -> dict[str, dict[str, int]]:
    """Return the JSON object `missions`: outcome counts by policy."""
    best = np.concatenate([np.array(one.clairvoyant) for one in flown])
    several_cases = len({one.case for one in flown}) > 1
    folds = [one.case if several_cases else one.number % 2 for one in flown]
    fold = np.repeat(folds, [len(one.clairvoyant) for one in flown])
    random_values = np.random.default_rng([seed, 13]).uniform(size=best.size)
    outcomes_by_policy: dict[str, Ints] = {}
    for policy in flown[0].outcomes:
        codes = np.concatenate([np.array(one.outcomes[policy]) for one in flown])
        outcomes = np.empty(best.size, np.int64)
        for number in np.unique(fold):
            here = fold == number
            others = codes[~here] if (~here).any() else codes
            level, share = fit_risk_level_and_share(others, max_loss)
            above = min(level + 1, codes.shape[1] - 1)
            is_above = random_values[here] < share
            outcomes[here] = np.where(is_above, codes[here, above], codes[here, level])
        outcomes_by_policy[policy] = outcomes
    return {
        policy: {name: int((codes == code).sum()) for name, code in CODES.items()}
        for policy, codes in {**outcomes_by_policy, "clairvoyant": best}.items()
    }


def fit_risk_level_and_share(outcome_codes_by_level: Ints, max_loss: float) -> tuple[int, float]:
    """Return the lower level and the mission share at the next level that lose `max_loss`."""
    loss_by_level = np.isin(outcome_codes_by_level, (DEL, FAIL)).mean(axis=0)
    return level_and_share_at_loss(loss_by_level, max_loss)
