"""Safety rule 3, event by event: home is the stop assigned by the truck, and may be moved."""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import msgspec
import pytest

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Obstacle, ObstacleMap
from companion.core.mission import events as ev
from companion.core.mission.actions import (
    Arm,
    JumpTo,
    OperatorResponse,
    ResponseStatus,
    SetHome,
    SetMode,
)
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.events import Mode
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan, build_site_map, depot_frame, make_plan
from companion.core.mission.mission_items import ItemKind, Part, ReturnByDefaultMission
from companion.core.pilot import home_watch
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.flight_state import PromisedStop
from companion.core.pilot.transitions import Phase
from companion.core.return_budget.budget import Assessment, RemainingMission
from companion.core.return_budget.remaining_from_plan import (
    remaining_delivery,
    remaining_outbound,
    remaining_return,
    remaining_to_other_home,
)
from companion.core.routing.leg_energy import LegKind, RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from tests.companion.pilot.fake_vehicle import (
    AIRFRAME,
    DEPOT,
    M_PER_DEG,
    ScriptedJudge,
    World,
    start,
    world,
)

TABLE: dict[str, Any] = tomllib.loads(
    """
    format = "flight/1"
    [site]
    depot = { lat_deg = 55.47, lon_deg = 8.45, alt_amsl_m = 12.0 }
    customer = { name = "customer", north_m = 300.0, east_m = 0.0, up_m = 3.0 }
    rally = [{ name = "quay", north_m = 150.0, east_m = 120.0 }]
    stops = [
        { name = "stop-1", north_m = 0.0, east_m = 0.0 },
        { name = "stop-2", north_m = 60.0, east_m = 90.0, up_m = 2.0 },
        { name = "stop-3", north_m = 40.0, east_m = -110.0, up_m = 1.0 },
    ]
    home = "stop-2"
    [vehicle]
    airframe = "m100"
    payload_kg = 0.6
    [mission]
    leg_length_m = 100.0
    cruise_height_m = 30.0
    return_height_m = 42.0
    wind_settle_s = 4.0
    """
)
PADS = {"stop-1": (0.0, 0.0), "stop-2": (60.0, 90.0), "stop-3": (40.0, -110.0)}  # north, east
ENERGY = RouteEnergy(AIRFRAME)


def flight(site: dict[str, Any] | None = None, **mission: Any) -> Flight:
    table = TABLE | {"site": TABLE["site"] | (site or {})}
    return msgspec.convert(table | {"mission": TABLE["mission"] | mission}, Flight)


def plan_of(of: Flight, obstacles: dict[str, Any] | None = None) -> FlightPlan | NoRoute:
    assert of.site.depot is not None
    site = build_site_map(of, depot_frame(of.site.depot), obstacles)
    return make_plan(of, site, BerPlanner(ENERGY), None, 0.1)


def planned(of: Flight, obstacles: dict[str, Any] | None = None) -> FlightPlan:
    found = plan_of(of, obstacles)
    assert isinstance(found, FlightPlan), found
    return found


@dataclass
class StopsJudge(ScriptedJudge):
    """P(home) by the requested landing, if only one is requested."""

    p_home_by: dict[str, float] = field(default_factory=dict)
    best_landing: str = "stop-2"

    def assess(self, ahead: RemainingMission) -> Assessment | None:
        seen = super().assess(ahead)
        ways = [s.return_routes for s in ahead.stages] or [ahead.current_return_routes]
        landings = {way.landing for way in ways[-1]}
        if seen is None or len(landings) > 1:
            return seen
        p_home = self.p_home_by.get(landings.pop(), 0.999)
        return replace(seen, p_home=p_home, turn_back=seen.turn_back or p_home < 0.99)


def truck_world(
    kept: Checkpoint | None = None,
    *,
    armed: bool = False,
    options: PilotOptions | None = None,
    of: Flight | None = None,
) -> World:
    of = of or flight()
    judge = StopsJudge(RouteEnergy.for_mission(AIRFRAME, of.mission, 1.225))
    return world(flight=of, kept=kept, armed=armed, judge=judge, options=options)


def reach(phase: Phase) -> World:
    return truck_world().until(phase)


def flown_of(w: World) -> FlightPlan:
    assert w.pilot.flight_plan is not None
    return w.pilot.flight_plan


def wish(w: World, stop: str) -> OperatorResponse:
    """Request another home for the truck; return the reply."""
    actions = w.tell(ev.HomeStopRequested(w.t_s, "desk", stop))
    (answer,) = (a for a in actions if isinstance(a, OperatorResponse))
    return answer


def ended_at(w: World) -> str:
    return min(PADS, key=lambda stop: math.dist(PADS[stop], (w.north, w.east)))


def asked_landings(w: World) -> set[str]:
    """Return each landing site passed to the gate since the list was cleared."""
    judged = w.judge.asked
    ways = [
        w
        for a in judged
        for w in (*a.current_return_routes, *(x for s in a.stages for x in s.return_routes))
    ]
    return {way.landing for way in ways}


def end_of(mission: ReturnByDefaultMission, index: int) -> int:
    """Return the LAND item that the autopilot reaches: items in order, jumps followed."""
    for _ in range(2 * len(mission.items)):
        item = mission.items[index]
        if item.kind is ItemKind.LAND:
            return index
        index = int(item.value) if item.kind is ItemKind.JUMP else index + 1
    raise AssertionError("it never lands")


# --- the onboard mission -------------------------------------------------------------------------


def test_safety_rule_3_whatever_item_is_flown_without_us_the_flight_ends_at_the_promised_stop():
    flown = planned(flight())
    mission = flown.mission
    others = {i for over, down in mission.rally for i in range(over, down + 2)}
    ours = [i for i in range(mission.land + 1) if i not in others]
    assert {end_of(mission, i) for i in ours} == {mission.land}
    spot = mission.items[mission.land].spot
    assert spot is not None
    assert flown.mission_position_to_ned_m(spot) == pytest.approx((60.0, 90.0, -2.0), abs=0.05)


def test_each_other_stop_and_rally_point_is_aboard_with_a_landing_of_its_own():
    flown = planned(flight())
    grounds = {}
    for site in flown.plan.uploaded_sites_except_return_end:
        over, down = flown.overhead_and_ground_items_of_site(site.name)
        assert end_of(flown.mission, over) == down
        spot = flown.mission.items[down].spot
        assert spot is not None
        grounds[site.name] = tuple(round(x) for x in flown.mission_position_to_ned_m(spot))
    assert grounds == {"quay": (150, 120, 0), "stop-1": (0, 0, 0), "stop-3": (40, -110, -1)}


def test_the_way_out_and_the_way_back_are_flown_at_their_own_heights():
    mission = planned(flight()).mission
    height: dict[Part, set[float]] = {}
    for item in mission.items:
        if item.spot is not None and item.kind is not ItemKind.LAND:
            height.setdefault(item.part, set()).add(item.spot.height_rel_m)
    assert height[Part.TAKEOFF] == height[Part.SETTLE] == height[Part.OUTBOUND] == {30.0}
    assert height[Part.RETURN] == height[Part.RALLY] == {42.0}


@pytest.mark.parametrize("heights", [(30.0, 42.0), (42.0, 30.0)])
def test_what_stands_between_the_two_layers_is_flown_round_in_both(heights):
    ring = [(-40.0, 140.0), (40.0, 140.0), (40.0, 160.0), (-40.0, 160.0), (-40.0, 140.0)]
    per_deg = 111_194.93
    lon = per_deg * math.cos(math.radians(55.47))
    tower = {
        "type": "Feature",
        "properties": {"height_m": 28.0},  # over 30 m less the 8 m of clearance, under 42 m
        "geometry": {
            "type": "Polygon",
            "coordinates": [[[8.45 + e / lon, 55.47 + n / per_deg] for e, n in ring]],
        },
    }
    of = flight(cruise_height_m=heights[0], return_height_m=heights[1])
    flown = planned(of, {"type": "FeatureCollection", "features": [tower]})
    plan, low = flown.plan, -30.0
    out = [(0.0, 0.0, low), *plan.outbound_ned_m]
    back = [plan.outbound_ned_m[-1], *plan.return_ned_m]
    joins = [(plan.outbound_ned_m[i], plan.return_ned_m[e]) for i, e in enumerate(plan.entry)]
    for a, b in [*pairwise(out), *pairwise(back), *joins]:
        assert (
            flown.site.obstacles.first_blocking_obstacle((a[0], a[1], low), (b[0], b[1], low))
            is None
        )


def test_without_a_home_stops_change_nothing_and_the_launch_pad_promised_is_as_without():
    plain = planned(flight({"stops": [], "home": None}, return_height_m=None)).mission
    unpromised = planned(flight({"home": None}, return_height_m=None)).mission
    assert unpromised == plain
    only = [TABLE["site"]["stops"][0]]
    at_launch = planned(flight({"stops": only, "home": "stop-1"}, return_height_m=None)).mission
    assert at_launch == plain


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"return_height_m": 8.0}, "mission.return_height_m = 8: 5 m above the ground at customer"),
        ({"cruise_height_m": 9.0, "drop_height_m": 1.0}, ""),
    ],
)
def test_a_layer_too_low_for_a_place_is_refused_in_words(changes, words):
    found = plan_of(flight(**changes))
    reason = found.reason if isinstance(found, NoRoute) else ""
    assert reason.startswith(words)
    assert bool(reason) == bool(words)


def test_a_stop_that_bears_a_rally_points_name_is_refused():
    with pytest.raises(
        (LeewayError, msgspec.ValidationError), match="'quay' is already the name of a rally point"
    ):
        flight(
            {"stops": [*TABLE["site"]["stops"], {"name": "quay", "north_m": 1.0, "east_m": 1.0}]}
        )


# --- energy --------------------------------------------------------------------------------------


def climbed_m(legs: Any) -> float:
    return sum(max(leg.from_ned_m[2] - leg.to_ned_m[2], 0.0) for leg in legs)


def test_safety_rule_4_every_way_home_counts_its_change_of_height_to_the_ground():
    plan = planned(flight()).plan
    plan = plan.copy_with_selectable_stops("stop-3")
    out, high = plan.outbound_ned_m[1], (plan.return_ned_m[1][0], plan.return_ned_m[1][1], -42.0)
    up_from = {
        remaining_outbound(plan, (0.0, 0.0, 0.0), 0, 0.6, 6.0, 6.0, 4.0): 42.0,
        remaining_outbound(plan, out, 2, 0.6, 6.0, 6.0): 12.0,
        remaining_delivery(plan, (300.0, 0.0, -9.0), 0.6, 6.0, 6.0): 33.0,
        remaining_return(plan, high, 1, 0.0, True): 0.0,
        remaining_return(plan, high, 1, 0.0, True, "stop-3"): 0.0,
        remaining_to_other_home(plan, (0.0, 0.0, -30.0), 0, 0.6, False): 12.0,
    }
    grounds = {
        "stop-2": (60.0, 90.0, -2.0),
        "stop-3": (40.0, -110.0, -1.0),
        "quay": (150.0, 120.0, 0.0),
    }
    for ahead, up_m in up_from.items():
        for way in ahead.current_return_routes:
            assert climbed_m(way.leg_sequence) == pytest.approx(up_m, abs=0.01)
            assert way.leg_sequence[-1].kind is LegKind.LAND
            assert way.leg_sequence[-1].from_ned_m[2] == pytest.approx(-42.0)
            assert way.leg_sequence[-1].to_ned_m == pytest.approx(grounds[way.landing])
            assert all(a.to_ned_m == b.from_ned_m for a, b in pairwise(way.leg_sequence))
        for stage in ahead.stages:
            wanted = 33.0 if stage.delivers else 12.0
            assert {round(climbed_m(way.leg_sequence)) for way in stage.return_routes} == {wanted}


def test_a_way_back_in_the_lower_layer_sinks_first_and_is_not_cheaper_than_one_without_layers():
    lower, level = (
        planned(flight(return_height_m=22.0)).plan,
        planned(flight(return_height_m=30.0)).plan,
    )
    here = lower.outbound_ned_m[1]
    (way, *_), (flat, *_) = (
        remaining_outbound(plan, here, 2, 0.6, 6.0, 6.0).current_return_routes
        for plan in (lower, level)
    )
    assert way.leg_sequence[0].kind is LegKind.DESCEND
    assert way.leg_sequence[0].to_ned_m == (here[0], here[1], -22.0)
    assert flat.leg_sequence[0].kind is LegKind.CRUISE


# --- flights between stops -----------------------------------------------------------------------


def test_safety_rule_3_a_flight_ends_at_the_promised_stop_and_never_asks_for_another():
    w = truck_world()
    assert w.pilot.current_home_stop_name == "stop-2"
    done = w.to_the_end()
    assert (done.outcome, done.home) == ("SUC", True)
    assert math.dist((w.north, w.east), PADS["stop-2"]) < 3.0
    assert asked_landings(w) == {"stop-2", "quay"}


@pytest.mark.parametrize("phase", [Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER])
def test_safety_rule_3_dead_from_any_phase_on_it_comes_down_at_the_promised_stop(phase):
    w = reach(phase)
    for _ in range(4000):
        w.t_s = round(w.t_s + 0.1, 3)
        w.fly(0.1)  # no message is received any more
    assert not w.armed
    assert math.dist((w.north, w.east), PADS["stop-2"]) < 3.0


@pytest.mark.parametrize("phase", [Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND])
def test_an_abort_comes_home_to_the_promised_stop_and_climbs_before_it_flies_there(phase):
    w = reach(phase)
    w.tell(ev.AbortOrdered(w.t_s, "desk"))
    low = []
    while w.armed:
        w.step()
        away_m = math.hypot(w.north, w.east)
        if 5.0 < away_m < 50.0:
            low.append(w.height)
    assert math.dist((w.north, w.east), PADS["stop-2"]) < 3.0
    assert min(low) > 25.0


def refuses_every_jump(w: World) -> None:
    """The autopilot is stuck in its current item for good."""
    w.obeys_jumps = False
    w.items = tuple(
        i if i.kind is not ItemKind.JUMP else replace(i, value=float(w.index)) for i in w.items
    )
    w.judge.turn_back = lambda judge: True


def by_rtl(*, takes_home: bool = True, ordered: bool = True) -> World:
    """No jump home is obeyed: RTL is ordered, or before that its home position."""
    w = reach(Phase.MEASURE)
    w.takes_home = takes_home
    w.until(Phase.OUTBOUND)
    refuses_every_jump(w)
    return w.run(lambda w: w.mode is Mode.RTL if ordered else bool(home_and_rtl(w)), 60.0)


def climbed() -> World:
    """On the return route, at its cruise height."""
    return reach(Phase.RETURN).run(lambda w: w.height > 41.0)


def home_and_rtl(w: World) -> list[Any]:
    """Return the orders for the autopilot's home and RTL, in order."""
    rtl = w.sent(SetHome | SetMode)
    return [a for a in rtl if not (isinstance(a, SetMode) and a.mode is not Mode.RTL)]


def test_safety_rule_3_an_rtl_leads_to_the_promised_stop_by_the_autopilots_own_home():
    w = by_rtl()
    home, rtl = home_and_rtl(w)
    assert isinstance(home, SetHome), "the place first: RTL finds its way when it begins"
    assert isinstance(rtl, SetMode)
    north_m = (home.lat_deg - DEPOT[0]) * M_PER_DEG
    east_m = (home.lon_deg - DEPOT[1]) * M_PER_DEG * math.cos(math.radians(DEPOT[0]))
    assert (north_m, east_m) == pytest.approx(PADS["stop-2"], abs=0.5)
    assert home.alt_amsl_m == pytest.approx(12.0, abs=0.01), "heights count from there as before"
    assert "RTL: to stop-2" in w.said_of("last_resort")[0]
    w.steps(300)
    assert "home_moved" not in w.kinds, "our own move is nobody else's"
    w.north, w.east, w.height = *PADS["stop-2"], 0.0
    w.run(lambda w: w.pilot.phase is Phase.LAST_RESORT and w.height == 0.0, 5.0)
    w.step()
    w.tell(ev.ModeReport(w.t_s, Mode.MISSION, "AUTO.MISSION"))  # PX4, before its heartbeat disarms
    w.mode, w.armed = Mode.MISSION, False
    assert w.to_the_end().home
    assert "companion released control" not in w.said


@pytest.mark.parametrize("takes", [True, False])
def test_an_rtl_waits_for_its_place_to_be_taken_and_not_for_long(takes, monkeypatch):
    monkeypatch.setattr(home_watch, "REDIRECT_PHASES", ())  # the line was not clear before
    w = by_rtl(takes_home=takes, ordered=False)
    assert w.mode is Mode.MISSION, "the place first"
    led_s = w.t_s
    w.run(lambda w: w.mode is Mode.RTL, 10.0)
    waited_s = w.t_s - led_s
    assert waited_s <= 0.2 if takes else 2.9 <= waited_s <= 3.2
    assert w.pilot.phase is Phase.LAST_RESORT


def test_who_takes_over_while_an_rtl_waits_gets_none(monkeypatch):
    monkeypatch.setattr(home_watch, "REDIRECT_PHASES", ())
    w = by_rtl(takes_home=False, ordered=False)
    w.mode = Mode.HOLD
    taken_s = w.t_s
    w.steps(200)
    assert w.pilot.phase is Phase.SUSPENDED
    assert w.orders_after(taken_s + 0.6) == []


def test_an_autopilot_that_does_not_take_the_stop_as_home_is_known_to_fly_to_the_launch_pad():
    w = by_rtl(takes_home=False)
    w.steps(300)
    assert w.said.count("old home kept: RTL goes to the launch pad") == 1
    assert "home_moved" not in w.kinds
    assert len([a for a in home_and_rtl(w) if isinstance(a, SetHome)]) == 1


def test_a_home_that_is_not_told_for_a_time_is_nobody_elses_move():
    w = by_rtl()
    w.mute = {ev.Home}
    w.steps(150)
    w.mute = set()
    w.steps(150)
    assert not {"home_moved", "home_not_led"} & set(w.kinds)
    assert (w.home_north, w.home_east) == pytest.approx(PADS["stop-2"], abs=0.5)


def test_a_home_that_another_hand_moves_after_that_is_still_noticed():
    w = by_rtl()
    w.steps(100)
    w.home_north += 500.0
    w.run(lambda w: "home_moved" in w.kinds, 20.0)
    w.run(lambda w: "home_back" in w.kinds, 20.0)
    assert (w.home_north, w.home_east) == pytest.approx(PADS["stop-2"], abs=0.5)


HERE, STOP_2 = (200.0, 0.0, -30.0), (60.0, 90.0, -2.0)
BETWEEN = ((110.0, 30.0), (150.0, 30.0), (150.0, 60.0), (110.0, 60.0))


@pytest.mark.parametrize(
    ("here", "ground", "obstacles", "suits"),
    [
        (HERE, STOP_2, (), True),
        (HERE, (60.0, 90.0, -9.0), (), False),  # high up: its descent would be fast
        (HERE, (-150.0, 0.0, 0.0), (), False),  # outside the fence that contained the flight
        (HERE, STOP_2, (Obstacle("tower", BETWEEN, 35.0),), False),
        (HERE, STOP_2, (Obstacle("shed", BETWEEN, 8.0),), True),
        (HERE, STOP_2, (Obstacle("ceiling", BETWEEN, math.inf, 90.0),), False),
    ],
)
def test_an_rtl_is_led_where_the_autopilots_descent_fence_and_height_suit(
    here, ground, obstacles, suits
):
    flown = planned(flight())
    site = replace(flown.site, obstacles=ObstacleMap(obstacles, 5.0, 10.0, 45.0))
    assert replace(flown, site=site).is_rtl_to_site_allowed(here, ground) is suits


def test_where_an_rtl_does_not_suit_the_promised_stop_it_goes_to_the_launch_pad_and_says_so():
    stops = [{"name": "stop-2", "north_m": 60.0, "east_m": 90.0, "up_m": 9.0}]
    w = truck_world(of=flight({"stops": stops})).until(Phase.OUTBOUND)
    refuses_every_jump(w)
    w.run(lambda w: w.mode is Mode.RTL, 60.0)
    assert not w.sent(SetHome)
    assert w.said_of("last_resort") == ["RTL: to the launch pad instead of stop-2"]


def test_landed_on_the_launch_pad_it_is_not_home():
    w = reach(Phase.RETURN)
    w.run(lambda w: w.height > 41.0)
    w.tell(ev.VehicleState(w.t_s, ev.Mode.OTHER, "POSCTL", True))  # a pilot flies it there
    w.mode = ev.Mode.OTHER
    w.north = w.east = w.height = 0.0
    w.armed = False
    done = w.to_the_end()
    assert (done.outcome, done.home) == ("TAKEN", False)


# --- home moves ----------------------------------------------------------------------------------


def test_safety_rule_3_moved_on_the_way_out_home_stays_until_the_autopilot_flies_elsewhere():
    w = reach(Phase.OUTBOUND)
    assert wish(w, "stop-3").status is ResponseStatus.ACCEPTED
    w.judge.asked.clear()
    homes = [w.pilot.current_home_stop_name]
    while w.pilot.phase is not Phase.RETURN:
        w.step()
        homes.append(w.pilot.current_home_stop_name)
    assert set(homes) == {"stop-2"}  # the old home is binding for the truck until the jump is seen
    assert asked_landings(w) == {"stop-2", "stop-3", "quay"}
    w.run(lambda w: w.pilot.current_home_stop_name == "stop-3")
    over, _ = flown_of(w).overhead_and_ground_items_of_site("stop-3")
    assert w.index == over
    w.judge.asked.clear()
    done = w.to_the_end()
    assert asked_landings(w) == {"stop-3"}
    assert (done.outcome, done.home, ended_at(w)) == ("SUC", True, "stop-3")


def test_moved_on_the_way_home_it_turns_at_once_and_may_be_moved_again():
    w = climbed()
    assert wish(w, "stop-3").status is ResponseStatus.ACCEPTED
    w.run(lambda w: w.pilot.current_home_stop_name == "stop-3", 3.0)
    assert wish(w, "stop-1").status is ResponseStatus.ACCEPTED
    w.run(lambda w: w.pilot.current_home_stop_name == "stop-1", 3.0)
    assert (
        wish(w, "stop-2").status is ResponseStatus.ACCEPTED
    )  # back to the end of the return route
    w.run(lambda w: w.pilot.current_home_stop_name == "stop-2", 3.0)
    assert w.pilot.phase is Phase.RETURN
    done = w.to_the_end()
    assert (done.outcome, ended_at(w)) == ("SUC", "stop-2")
    assert w.kinds.count("home_moved") == 3


def test_low_over_the_customer_it_climbs_out_before_it_turns_to_another_stop():
    w = reach(Phase.RETURN)
    assert w.height < 20.0
    assert wish(w, "stop-3").status is ResponseStatus.ACCEPTED
    w.run(lambda w: w.pilot.current_home_stop_name == "stop-3")
    assert w.height > 42.0 - 5.5
    assert math.dist((w.north, w.east), (300.0, 0.0)) < 5.0


@pytest.mark.parametrize("instead", ["stop-2", "stop-1"])
def test_a_wish_taken_back_before_it_was_flown_leaves_everything_as_it_was(instead):
    w = reach(Phase.OUTBOUND)
    wish(w, "stop-3")
    assert wish(w, instead).status is ResponseStatus.ACCEPTED
    w.judge.asked.clear()
    w.steps(20)
    assert asked_landings(w) == {"stop-2", instead, "quay"}, "stop-3 is no landing place any more"
    if instead == "stop-2":
        w.to_the_end()
        assert ended_at(w) == "stop-2"
        assert "home_moved" not in w.kinds


def test_while_it_turns_to_one_stop_it_takes_no_other_wish():
    w = climbed()
    wish(w, "stop-3")
    w.mute.add(ev.MissionProgress)  # the jump is ordered, but not seen yet
    w.run(lambda w: "move_home" in w.kinds, 3.0)
    assert wish(w, "stop-2") == OperatorResponse(
        ResponseStatus.LATER, "turning to another landing site"
    )
    w.mute.clear()
    w.run(lambda w: w.pilot.current_home_stop_name == "stop-3", 3.0)
    assert wish(w, "stop-2").status is ResponseStatus.ACCEPTED


REFUSALS: list[tuple[str, Phase, str, Callable[[World], None], ResponseStatus, str]] = [
    ("no such stop", Phase.OUTBOUND, "stop-9", lambda w: None, ResponseStatus.DENIED,
        "unknown stop"),
    ("a rally point", Phase.OUTBOUND, "quay", lambda w: None, ResponseStatus.DENIED,
        "unknown stop"),
    ("on the ground", Phase.READY, "stop-3", lambda w: None, ResponseStatus.DENIED,
        "in phase ready"),
    ("landing", Phase.LAND, "stop-3", lambda w: None, ResponseStatus.DENIED, "in phase land"),
    (
        "the gate, on the way out", Phase.OUTBOUND, "stop-3",
        lambda w: w.judge.p_home_by.update({"stop-3": 0.95}),  # type: ignore[attr-defined]
        ResponseStatus.DENIED, "P(home) at stop-3: 0.9500",
    ),
    (
        "the gate, on the way home", Phase.RETURN, "stop-3",
        lambda w: w.judge.p_home_by.update({"stop-3": 0.95}),  # type: ignore[attr-defined]
        ResponseStatus.DENIED, "P(home) 0.950 at stop-3 is below 0.990",
    ),
    (
        "no wind known", Phase.OUTBOUND, "stop-3",
        lambda w: setattr(w.judge, "known", False), ResponseStatus.LATER, "wind or energy unknown",
    ),
]  # fmt: skip


@pytest.mark.parametrize("case", REFUSALS, ids=[case[0] for case in REFUSALS])
def test_a_move_that_cannot_be_is_refused_with_its_reason_and_changes_nothing(case):
    _, phase, stop, change, reply, words = case
    options = PilotOptions(configure=True, authorise=phase is not Phase.READY)
    w = truck_world(options=options).until(phase)
    change(w)
    plan = flown_of(w).plan
    answer = wish(w, stop)
    assert answer.status is reply
    assert answer.reason.startswith(words)
    assert w.pilot.current_home_stop_name == "stop-2"
    assert flown_of(w).plan == plan


def test_a_flight_without_stops_refuses_to_move_its_home():
    w = world().until(Phase.OUTBOUND)
    assert wish(w, "stop-3") == OperatorResponse(
        ResponseStatus.DENIED, "this flight does not end at a truck stop"
    )


def test_a_promise_that_fails_on_the_way_is_not_flown_and_the_old_home_is():
    w = reach(Phase.OUTBOUND)
    assert wish(w, "stop-3").status is ResponseStatus.ACCEPTED
    w.judge.p_home_by["stop-3"] = 0.9  # type: ignore[attr-defined]
    done = w.to_the_end()
    assert (done.home, ended_at(w)) == (True, "stop-2")
    assert "not yet diverting to stop-3" in w.said


def test_an_autopilot_that_does_not_jump_to_the_new_stop_goes_to_the_old_one_and_no_rtl_is_asked():
    w = climbed()
    wish(w, "stop-3")
    w.obeys_jumps = False
    done = w.to_the_end()
    assert (done.home, ended_at(w), w.pilot.current_home_stop_name) == (True, "stop-2", "stop-2")
    assert "home_stays" in w.kinds
    assert not any(isinstance(a, SetMode) and a.mode is ev.Mode.RTL for _, a in w.log)


def test_an_operator_without_a_desk_names_the_stop_by_where_its_pad_is():
    w = reach(Phase.OUTBOUND)
    lat = 55.47 + 41.0 / M_PER_DEG
    lon = 8.45 - 111.0 / (M_PER_DEG * math.cos(math.radians(55.47)))
    w.tell(ev.HomeStopRequested(w.t_s, "255/190", None, lat, lon))
    assert w.pilot.parts.part_of_class(PromisedStop).requested_stop == "stop-3"
    actions = w.tell(ev.HomeStopRequested(w.t_s, "255/190", None, 55.48, 8.45))
    assert [a.status for a in actions if isinstance(a, OperatorResponse)] == [ResponseStatus.DENIED]


@pytest.mark.parametrize("seen", [False, True])
def test_safety_rule_3_a_wish_and_a_moved_home_outlive_a_restart_of_the_companion(seen):
    w = climbed() if seen else reach(Phase.OUTBOUND)
    wish(w, "stop-3")
    if seen:
        w.run(lambda w: w.pilot.current_home_stop_name == "stop-3")
    again = w.with_pilot_of(truck_world(w.last_kept, armed=True))
    assert again.pilot.current_home_stop_name == ("stop-3" if seen else "stop-2")
    start(again)
    done = again.to_the_end()
    assert (done.outcome, ended_at(again)) == ("SUC", "stop-3")
    assert not again.sent(Arm)


def test_a_stop_that_no_longer_keeps_the_promise_is_left_for_a_rally_point_that_does():
    w = climbed()
    wish(w, "stop-3")
    w.run(lambda w: w.pilot.current_home_stop_name == "stop-3")
    w.judge.p_home_by["stop-3"] = 0.9  # type: ignore[attr-defined]
    w.run(lambda w: w.pilot.current_home_stop_name == "quay", 5.0)
    assert "stop-3: P(home) 0.900 below 0.990; quay 0.9990" in w.said
    assert w.sent(JumpTo)[-1].index == flown_of(w).overhead_and_ground_items_of_site("quay")[0]


def home_of(w: World) -> tuple[float, float]:
    return w.home_north, w.home_east


def test_safety_rule_3_a_failsafes_rtl_ends_where_the_flight_ends_at_every_moment():
    w = reach(Phase.OUTBOUND)
    w.steps(40)
    assert home_of(w) == pytest.approx(PADS["stop-2"], abs=0.5)
    w.until(Phase.RETURN).run(lambda w: w.height > 41.0)
    wish(w, "stop-3")
    w.run(lambda w: w.pilot.current_home_stop_name == "stop-3")
    w.steps(40)
    assert home_of(w) == pytest.approx(PADS["stop-3"], abs=0.5)
    w.judge.p_home_by["stop-3"] = 0.9  # type: ignore[attr-defined]
    w.run(lambda w: w.pilot.current_home_stop_name == "quay", 5.0)
    w.steps(40)
    quay = next(r for r in flown_of(w).plan.rally if r.name == "quay").ground_ned_m
    assert home_of(w) == pytest.approx(quay[:2], abs=0.5)
    assert SetMode(Mode.RTL) not in w.sent(SetMode), "no last resort"
    assert "by another station" not in w.said
    assert w.to_the_end().home


def test_a_home_that_the_autopilot_does_not_take_is_tried_once_and_the_flight_goes_on():
    w = reach(Phase.MEASURE)
    w.takes_home = False
    assert w.to_the_end().outcome == "SUC"
    assert len(w.sent(SetHome)) == 1
    assert w.said.count("old home kept: RTL goes to the launch pad") == 1
