"""Safety rule 7, checked by separate geometry: sampled flights with delays and turn-backs."""

import itertools
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.core.base.location import Location
from ground_station.adapters.files.day_files import read_day
from ground_station.core.deconfliction.separation import OperationalVolume, launch_conflict_reason
from ground_station.core.planning.airspace import Airspace
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.day_state import initial_state

pytestmark = [pytest.mark.sample, pytest.mark.usefixtures("compiled_planner")]

TOWN = Path(__file__).parents[3] / "params" / "days" / "town.toml"
LATE_S = 30.0
METRES_PER_DEGREE = 6_371_008.8 * math.pi / 180.0


@pytest.fixture(scope="module")
def town() -> DayData:
    return read_day(TOWN)


@pytest.fixture(scope="module")
def plan(town) -> DayPlan:
    return plan_day(town, initial_state(town), PlanParams(trials=4_000))


class OwnGeometry:
    """Metres around the depot on a sphere, heights above it; flights as polylines over time."""

    def __init__(self, data: DayData, plan: DayPlan) -> None:
        self.data, self.plan = data, plan
        self.orders = {order.id: order for order in data.orders}

    def enu(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> np.ndarray:
        depot = self.data.day.depot
        east = (lon_deg - depot.lon_deg) * math.cos(math.radians(depot.lat_deg))
        north = lat_deg - depot.lat_deg
        up_m = alt_amsl_m - depot.alt_amsl_m
        return np.array([METRES_PER_DEGREE * east, METRES_PER_DEGREE * north, up_m])

    def pad(self, sortie: PlannedSortie, stop: str) -> np.ndarray:
        return self.place(self.plan.get_stop(stop).pads[sortie.vehicle])

    def place(self, place: Location) -> np.ndarray:
        assert place.lat_deg is not None
        assert place.lon_deg is not None
        assert place.alt_amsl_m is not None
        return self.enu(place.lat_deg, place.lon_deg, place.alt_amsl_m)

    def flight(self, sortie: PlannedSortie, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
        """Return times and positions of the corners: on time or late, complete or turned back."""
        order = self.orders[sortie.order]
        start, home = self.pad(sortie, sortie.launch), self.pad(sortie, sortie.home)
        customer = self.enu(order.lat_deg, order.lon_deg, order.alt_amsl_m)
        out_m = start[2] + sortie.outbound_height_m
        back_m = start[2] + sortie.return_height_m
        turned = rng.random() < 0.3
        reached = start + (customer - start) * (rng.random() if turned else 1.0)
        corners = [start, at(start, out_m), at(reached, out_m)]
        if not turned:
            corners += [at(customer, customer[2] + 6.0)]
        corners += [at(reached, back_m), at(home, back_m), home]
        shares = np.cumsum([0.0, *rng.uniform(0.2, 1.0, len(corners) - 1)])
        late_s = rng.uniform(0.0, LATE_S)
        lasts_s = (sortie.land_s - sortie.launch_s) * (rng.uniform(0.4, 1.0) if turned else 1.0)
        times_s = sortie.launch_s + late_s + lasts_s * shares / shares[-1]
        return times_s, np.array(corners)


def at(point: np.ndarray, up_m: float) -> np.ndarray:
    return np.array([point[0], point[1], up_m])


def nearest_m(geometry: OwnGeometry, rng: np.random.Generator) -> float:
    """Return the least distance between two airborne drones, sampled every half second."""
    flights = [geometry.flight(sortie, rng) for sortie in geometry.plan.sorties]
    least_m = math.inf
    for (a_s, a), (b_s, b) in itertools.combinations(flights, 2):
        both_s = np.arange(max(a_s[0], b_s[0]), min(a_s[-1], b_s[-1]), 0.5)
        if len(both_s):
            apart = [
                np.interp(both_s, a_s, a[:, axis]) - np.interp(both_s, b_s, b[:, axis])
                for axis in range(3)
            ]
            least_m = min(least_m, float(np.sqrt(np.square(apart).sum(axis=0)).min()))
    return least_m


def test_late_and_turned_back_drones_of_a_plan_never_come_within_10_metres(town, plan):
    geometry = OwnGeometry(town, plan)
    rng = np.random.default_rng(3)
    assert len(plan.sorties) > 20
    assert min(nearest_m(geometry, rng) for _ in range(30)) >= 10.0


def test_the_checker_finds_drones_that_share_a_layer_or_a_time(town, plan):
    rng = np.random.default_rng(3)
    flat = [
        msgspec.structs.replace(
            s, outbound_height_m=40.0, return_height_m=40.0, launch_s=0.0, land_s=200.0
        )
        for s in plan.sorties
    ]
    wrong = OwnGeometry(town, msgspec.structs.replace(plan, sorties=flat))
    assert min(nearest_m(wrong, rng) for _ in range(5)) < 10.0


def test_pads_of_a_stop_are_20_metres_apart_and_clear_of_what_stands_there(town, plan):
    geometry = OwnGeometry(town, plan)
    assert town.no_fly is not None
    for stop in plan.stops:
        pads = [geometry.place(pad) for pad in stop.pads.values()]
        for a, b in itertools.combinations(pads, 2):
            assert math.dist(a, b) >= 20.0
        for feature in town.no_fly["features"]:
            ring = np.array(feature["geometry"]["coordinates"][0])
            corners = np.array([geometry.enu(lat, lon, 12.0)[:2] for lon, lat in ring])
            low, high = corners.min(axis=0), corners.max(axis=0)
            for pad in pads:
                beyond = np.maximum(np.maximum(low - pad[:2], pad[:2] - high), 0.0)
                assert np.hypot(*beyond) >= 14.5


def test_layers_stay_below_120_metres_above_every_ground_they_stand_on(town, plan):
    geometry = OwnGeometry(town, plan)
    for sortie in plan.sorties:
        order = geometry.orders[sortie.order]
        start = geometry.pad(sortie, sortie.launch)
        grounds_m = [start[2], geometry.pad(sortie, sortie.home)[2]]
        grounds_m.append(order.alt_amsl_m - town.day.depot.alt_amsl_m)
        for height_m in (sortie.outbound_height_m, sortie.return_height_m):
            assert start[2] + height_m - min(grounds_m) <= 120.01
            assert start[2] + height_m - max(grounds_m) >= 9.99


def test_the_desks_last_check_passes_the_plan_and_stops_what_is_put_off_into_another(town, plan):
    airspace = Airspace(town)
    stops = {stop.id: stop for stop in plan.stops}
    refused = 0
    for number, sortie in enumerate(plan.sorties):
        in_air = [
            other
            for other in plan.sorties[:number]
            if other.launch_s <= sortie.launch_s < other.land_s
        ]
        assert airspace.launch_conflict(sortie, in_air, stops) is None, sortie.order
        others = [s for s in plan.sorties if s.vehicle != sortie.vehicle]
        refused += airspace.launch_conflict(sortie, others, stops) is not None
    assert refused > len(plan.sorties) / 2


def volume(
    vehicle: str, ends: tuple[tuple[float, float], tuple[float, float]], up_m: float
) -> OperationalVolume:
    return OperationalVolume(vehicle, f"o-{vehicle}", ends, ends, up_m, up_m, 0.0, 100.0)


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (volume("d2", ((0.0, 30.0), (400.0, 30.0)), 40.0), None),
        (volume("d2", ((0.0, 10.0), (400.0, 300.0)), 64.0), "climb and descend too close"),
        (volume("d2", ((200.0, -300.0), (200.0, 300.0)), 51.0), "layers that are too close"),
        (volume("d2", ((200.0, -300.0), (200.0, 300.0)), 52.0), None),
        (volume("d2", ((0.0, -300.0), (0.0, 300.0)), 28.0), "flies where the other climbs"),
        (volume("d2", ((0.0, -300.0), (0.0, 300.0)), 52.0), None),
        (volume("d1", ((0.0, 900.0), (0.0, 990.0)), 52.0), "in the air already"),
    ],
)
def test_who_may_be_in_the_air_with_a_drone_that_flies_north_at_40_metres(other, reason):
    said = launch_conflict_reason(volume("d1", ((0.0, 0.0), (400.0, 0.0)), 40.0), [other])
    assert said is None if reason is None else reason in (said or "")
