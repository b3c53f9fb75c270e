"""A day's plan: each order once, promises kept through replanning, limits used, and the command."""

import csv
import itertools
import json
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from companion.adapters.files.qgc_plan import read_plan_home_and_items
from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import Flight
from companion.core.mission.mission_commands import GRIPPER_RELEASE, MAV_COMMANDS
from companion.core.mission.mission_items import ItemKind
from ground_station.adapters.files.day_files import read_day, read_day_plan
from ground_station.app.cli.plan import app
from ground_station.core.dispatch.flight_tables import (
    flight_from_planned_sortie,
    sortie_flight_table,
)
from ground_station.core.dispatch.replanning import candidate_landing_pads_by_stop
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.day_state import DayState, initial_state
from ground_station.core.schema.orders import Order, Service, order_location

pytestmark = pytest.mark.usefixtures("compiled_planner")

DAYS = Path(__file__).parents[3] / "params" / "days"
QUICK = PlanParams(trials=600)


@pytest.fixture(scope="module")
def harbour() -> DayData:
    return read_day(DAYS / "harbour.toml")


@pytest.fixture(scope="module")
def harbour_plan(harbour) -> DayPlan:
    return plan_day(harbour, initial_state(harbour), QUICK)


def changed(data: DayData, **parts: object) -> DayData:
    """Return the same day with some fields replaced."""
    fields = {name: getattr(data, name) for name in DayData.__slots__}
    return DayData(**(fields | parts))  # pyright: ignore[reportArgumentType]


def by_whom(plan: DayPlan) -> list[str]:
    """Return each order as often as the plan names it, sorted."""
    served = [id_ for stop in plan.stops for id_ in stop.serves]
    return sorted(
        [*served, *(s.order for s in plan.sorties), *(line.order for line in plan.unplanned)]
    )


def assert_holds_together(data: DayData, plan: DayPlan) -> None:
    """Check times in order, one place per drone at a time, promised homes, truck there first."""
    truck = data.day.truck
    for before, after in itertools.pairwise(plan.stops):
        assert before.arrive_s <= before.depart_s <= after.arrive_s
    place = {stop.id: number for number, stop in enumerate(plan.stops)}
    assert len(place) == len(plan.stops)
    by_drone: dict[str, list[PlannedSortie]] = {}
    for sortie in plan.sorties:
        by_drone.setdefault(sortie.vehicle, []).append(sortie)
        launch, home = plan.get_stop(sortie.launch), plan.get_stop(sortie.home)
        assert place[launch.id] <= place[home.id]
        assert sortie.vehicle in launch.pads
        assert sortie.vehicle in home.pads
        assert launch.arrive_s <= sortie.launch_s <= launch.depart_s + 1e-3
        assert home.arrive_s <= sortie.land_s <= home.depart_s - truck.recover_s + 1e-3
        assert sortie.required_wh <= sortie.usable_wh
    for flown in by_drone.values():
        flown.sort(key=lambda sortie: sortie.launch_s)
        for one, following in itertools.pairwise(flown):
            ready_s = one.land_s + truck.recover_s + truck.launch_s + truck.ready_s
            assert following.launch_s >= ready_s - 1e-3
            assert place[one.home] <= place[following.launch]


def test_every_order_of_the_harbour_is_brought_once_by_who_may_bring_it(harbour, harbour_plan):
    assert by_whom(harbour_plan) == [order.id for order in harbour.orders]
    assert not harbour_plan.unplanned
    assert_holds_together(harbour, harbour_plan)
    flown = {sortie.order for sortie in harbour_plan.sorties}
    for order in harbour.orders:
        if order.service is Service.DRONE:
            assert order.id in flown
        if order.service is Service.TRUCK or order.mass_kg > 1.0:
            assert order.id not in flown


def test_the_same_day_seed_and_trials_give_the_same_plan(harbour, harbour_plan):
    assert plan_day(harbour, initial_state(harbour), QUICK) == harbour_plan


def test_the_papers_assignment_plans_the_same_day(harbour):
    plan = plan_day(harbour, initial_state(harbour), PlanParams(policy="dynamic"))
    assert by_whom(plan) == [order.id for order in harbour.orders]
    assert_holds_together(harbour, plan)


def state_at(data: DayData, plan: DayPlan, t_s: float) -> DayState:
    """Return the state at a time: airborne sorties, and stops fixed by their promised homes."""
    flying = [s for s in plan.sorties if s.launch_s <= t_s < s.land_s]
    done = [s for s in plan.sorties if s.land_s <= t_s]
    came = max(n for n, stop in enumerate(plan.stops) if stop.arrive_s <= max(t_s, 0.0))
    place = {stop.id: number for number, stop in enumerate(plan.stops)}
    last = max([came, *(place[sortie.home] for sortie in flying)])
    here = plan.stops[last]
    depart_s = max(here.arrive_s + 60.0, t_s)
    stops = [*plan.stops[:last], msgspec.structs.replace(here, depart_s=depart_s)]
    gone = {s.order for s in (*flying, *done)} | {id_ for stop in stops for id_ in stop.serves}
    recover_s = data.day.truck.recover_s
    free = {drone.id: max(t_s, here.arrive_s) for drone in data.day.drones}
    free |= {s.vehicle: max(s.land_s, here.arrive_s) + recover_s for s in flying}
    open_ = tuple(order.id for order in data.orders if order.id not in gone)
    return DayState(tuple(stops), tuple(flying), open_, free, plan.revision + 1)


@pytest.mark.sample
@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(share=st.floats(0.0, 0.95), lost=st.sampled_from([None, "d1"]), seed=st.integers(0, 3))
def test_a_new_plan_keeps_every_promise_and_loses_no_order(
    harbour, harbour_plan, share, lost, seed
):
    t_s = share * harbour_plan.makespan_s
    state = state_at(harbour, harbour_plan, t_s)
    if lost is not None and all(sortie.vehicle != lost for sortie in state.airborne):
        del state.available_from_s[lost]
    plan = plan_day(harbour, state, PlanParams(trials=200, seed=seed))
    assert plan.revision == harbour_plan.revision + 1
    kept = plan.stops[: len(state.stops)]
    for promised, stop in zip(state.stops, kept, strict=True):
        assert (stop.id, stop.location, stop.serves) == (
            promised.id,
            promised.location,
            promised.serves,
        )
        assert stop.arrive_s == promised.arrive_s
        assert promised.pads.items() <= stop.pads.items()
    fresh = {stop.id for stop in plan.stops[len(state.stops) :]}
    assert not fresh & {stop.id for stop in harbour_plan.stops}
    assert plan.sorties[: len(state.airborne)] == list(state.airborne)
    for sortie in state.airborne:
        home = plan.get_stop(sortie.home)
        assert home.depart_s >= sortie.land_s + harbour.day.truck.recover_s - 1e-3
    served = [id_ for stop in plan.stops[len(state.stops) :] for id_ in stop.serves]
    news = plan.sorties[len(state.airborne) :]
    brought = [*served, *(s.order for s in news), *(line.order for line in plan.unplanned)]
    assert sorted(brought) == sorted(state.open_orders)
    for sortie in news:
        assert sortie.vehicle in state.available_from_s
        assert sortie.launch_s >= state.available_from_s[sortie.vehicle]


def far_order(id_: str, mass_kg: float, service: Service) -> Order:
    return Order(
        id=id_, lat_deg=55.56, lon_deg=8.45, alt_amsl_m=12.0, mass_kg=mass_kg, service=service
    )


def test_what_nobody_can_bring_is_named_with_why_and_what_would_help(harbour):
    orders = [
        *harbour.orders[:3],
        far_order("far", 0.5, Service.DRONE),
        far_order("heavy", 3.0, Service.DRONE),
    ]
    data = changed(harbour, orders=orders)
    plan = plan_day(data, initial_state(data), QUICK)
    said = {line.order: line for line in plan.unplanned}
    assert set(said) == {"far", "heavy"}
    assert "Wh short" in said["far"].reason
    assert "m100 carries 1 kg" in said["heavy"].reason
    assert "service any" in said["heavy"].remedy


def test_the_truck_takes_no_more_than_it_carries_and_leaves_the_heaviest(harbour):
    truck = msgspec.structs.replace(harbour.day.truck, capacity_kg=3.0)
    data = changed(harbour, day=msgspec.structs.replace(harbour.day, truck=truck))
    plan = plan_day(data, initial_state(data), QUICK)
    assert [line.order for line in plan.unplanned] == ["H-105"]
    assert "carries 3 kg in all" in plan.unplanned[0].reason


def test_the_trucks_times_are_the_road_matrix_where_there_is_one(harbour):
    names = ["depot", *(order.id for order in harbour.orders)]
    roads_s = dict.fromkeys(itertools.product(names, names), 700.0)
    data = changed(harbour, road_times_s=roads_s)
    plan = plan_day(data, initial_state(data), QUICK)
    for before, after in itertools.pairwise(plan.stops):
        assert after.arrive_s - before.depart_s == pytest.approx(700.0)


def test_without_any_drone_the_truck_brings_what_it_may(harbour):
    state = initial_state(harbour)
    state.available_from_s.clear()
    plan = plan_day(harbour, state, QUICK)
    assert not plan.sorties
    assert {line.order for line in plan.unplanned} == {"H-102", "H-107"}


def test_the_table_that_a_drone_is_assigned_is_a_flight_file(harbour, harbour_plan):
    sortie = harbour_plan.sorties[0]
    order = next(order for order in harbour.orders if order.id == sortie.order)
    stops = {stop.id: stop for stop in harbour_plan.stops}
    pads = candidate_landing_pads_by_stop(harbour_plan, sortie, stops)
    table = sortie_flight_table(
        harbour.day, harbour.day.find_drone(sortie.vehicle), order, sortie, pads
    )
    assert "obstacles" not in table["site"]
    assert json.loads(json.dumps(table)) == table
    flight = msgspec.convert(table, Flight)
    assert flight.site.home == sortie.home
    assert [stop.name for stop in flight.site.stops] == [sortie.home, *sortie.alternative_stops]
    assert flight.vehicle.charge_frac == [0.05, 1.0]
    assert flight.site.customer == order_location(order)
    assert flight.mission.cruise_height_m == sortie.outbound_height_m


def test_a_forecast_temperature_is_stated_in_every_flight_file(harbour, harbour_plan):
    forecast = msgspec.structs.replace(harbour.day.forecast, air_temperature_c=31.0)
    day = msgspec.structs.replace(harbour.day, forecast=forecast)
    sortie, data = harbour_plan.sorties[0], replace(harbour, day=day)
    order = next(order for order in harbour.orders if order.id == sortie.order)
    stops = {stop.id: stop for stop in harbour_plan.stops}
    pads = candidate_landing_pads_by_stop(harbour_plan, sortie, stops)
    table = sortie_flight_table(day, day.find_drone(sortie.vehicle), order, sortie, pads)
    assert msgspec.convert(table, Flight).site.air_temperature_c == 31.0
    assert flight_from_planned_sortie(data, harbour_plan, sortie).site.air_temperature_c == 31.0
    assert flight_from_planned_sortie(harbour, harbour_plan, sortie).site.air_temperature_c is None


@pytest.mark.sample
def test_the_command_writes_plan_picture_and_missions(tmp_path):
    out, picture, qgc = tmp_path / "plan.json", tmp_path / "map.png", tmp_path / "qgc"
    done = CliRunner().invoke(
        app,
        f"{DAYS}/harbour.toml --trials 200 --out {out} --picture {picture} --missions {qgc}",
        env={"COLUMNS": "120"},
    )
    assert done.exit_code == 0, done.output
    assert "unplanned" in done.output
    plan = read_day_plan(out)
    assert picture.stat().st_size > 10_000
    assert {file.stem for file in qgc.iterdir()} == {sortie.order for sortie in plan.sorties}
    for sortie in plan.sorties:
        home, items = read_plan_home_and_items(qgc / f"{sortie.order}.plan")
        pad = plan.get_stop(sortie.launch).pads[sortie.vehicle]
        assert home[:2] == pytest.approx((pad.lat_deg, pad.lon_deg), abs=2e-7)
        numbers = {item["doJumpId"] for item in items}
        jumps = [item["params"][0] for item in items if item["command"] == 177]
        assert jumps
        assert numbers.issuperset(jumps)
        takeoff = next(item for item in items if item["command"] == 22)
        assert takeoff["params"][6] == pytest.approx(sortie.outbound_height_m, abs=0.02)


def test_a_plan_file_that_is_none_is_refused_in_one_line(tmp_path):
    path = tmp_path / "plan.json"
    path.write_text('{"format": "day-plan/2"}')
    with pytest.raises(LeewayError, match=r"plan\.json: .*day-plan"):
        read_day_plan(path)


def test_the_town_has_forty_orders_and_most_of_them_are_for_drones():
    with (DAYS / "town_orders.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 40
    assert sum(row["service"] == "drone" for row in rows) >= 25
    assert len(read_day(DAYS / "town.toml").day.drones) == 8


def test_no_stop_of_the_villages_reaches_all_so_drones_launch_and_land_at_several():
    data = read_day(DAYS / "villages.toml")
    plan = plan_day(data, initial_state(data), QUICK)
    assert_holds_together(data, plan)
    assert by_whom(plan) == sorted(order.id for order in data.orders)
    assert plan.unplanned == []
    assert len({sortie.launch for sortie in plan.sorties}) >= 3
    assert len({sortie.home for sortie in plan.sorties}) >= 3


def test_mission_commands_are_numbered_as_pymavlink_numbers_them():
    from pymavlink.dialects.v20 import common as mavlink

    names = {
        ItemKind.TAKEOFF: mavlink.MAV_CMD_NAV_TAKEOFF,
        ItemKind.WAYPOINT: mavlink.MAV_CMD_NAV_WAYPOINT,
        ItemKind.LOITER_TIME: mavlink.MAV_CMD_NAV_LOITER_TIME,
        ItemKind.LAND: mavlink.MAV_CMD_NAV_LAND,
        ItemKind.SPEED: mavlink.MAV_CMD_DO_CHANGE_SPEED,
        ItemKind.JUMP: mavlink.MAV_CMD_DO_JUMP,
        ItemKind.RELEASE: mavlink.MAV_CMD_DO_GRIPPER,
        ItemKind.ASIDE_LIMIT: mavlink.MAV_CMD_DO_GUIDED_LIMITS,
        ItemKind.ASIDE: mavlink.MAV_CMD_NAV_GUIDED_ENABLE,
    }
    assert names == MAV_COMMANDS
    assert mavlink.GRIPPER_ACTION_RELEASE == GRIPPER_RELEASE
