"""The pilot close to neighbours, event by event: start and end of set-point control.

The vehicle is fake_vehicle's, and obeys velocity set-points as each autopilot does.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.mission import events as ev
from companion.core.mission.actions import (
    Decision,
    FlyVelocity,
    JumpTo,
    Order,
    PublishTrack,
    SetMode,
)
from companion.core.mission.events import AutopilotKind, Mode
from companion.core.mission.mission_items import ItemKind, Part
from companion.core.pilot.authority import OrderedMode
from companion.core.pilot.context import CurrentPlan, FlightContext, LatestAssessment, PilotOptions
from companion.core.pilot.flight_state import CurrentItem, PromisedStop, ReturnState
from companion.core.pilot.mission_progress import GroundSpeedController
from companion.core.pilot.neighbours.desired_velocity import DesiredVelocity
from companion.core.pilot.neighbours.setpoint_takeover import (
    SetpointController,
    avoidance_rank_by_name,
)
from companion.core.pilot.neighbours.traffic_exchange import TrafficExchange
from companion.core.pilot.return_course import ReturnCourseMonitor
from companion.core.pilot.transitions import Phase, Trigger
from companion.core.separation.setpoint_motion import (
    FLEET_SEPARATION,
    level_velocity_away_from_nearest,
)
from companion.core.separation.track import Track
from companion.core.separation.traffic_tracks import NeighbourReport, NeighbourTracks
from tests.companion.pilot.fake_vehicle import AIRFRAME, DEPOT, FLIGHT, M_PER_DEG, World, world

UNIX_S = 1.8e9
OPTIONS = PilotOptions(configure=True, authorise=True, separation_enabled=True, name="d1")
BOTH = pytest.mark.parametrize("autopilot_kind", list(AutopilotKind))


@dataclass
class Beside(World):
    """The vehicle, and one neighbour on a straight line (NED m about the depot, m/s)."""

    autopilot_kind: AutopilotKind = AutopilotKind.PX4
    neighbour: tuple[float, float, float] | None = None
    neighbour_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)
    neighbour_goal: tuple[float, float] | None = None
    told_velocity: tuple[float, float, float] | None = None
    check_alert_sent: bool = True
    deaf_to_jumps: bool = False

    @property
    def guided(self) -> bool:
        """Return True if it obeys set-points now."""
        if self.autopilot_kind is AutopilotKind.PX4:
            return self.mode is Mode.GUIDED
        item = self.items[self.index] if self.index < len(self.items) else None
        return item is not None and item.kind in (ItemKind.ASIDE, ItemKind.ASIDE_LIMIT)

    def process_line(self, order: Order) -> None:
        if isinstance(order, FlyVelocity):
            self.told_velocity = order.vel_ned_mps
        if not (self.deaf_to_jumps and isinstance(order, JumpTo)):
            super().process_line(order)

    def fly(self, dt_s: float) -> None:
        if self.neighbour is not None:
            moved = zip(self.neighbour, self.neighbour_vel, strict=True)
            north, east, down = (x + v * dt_s for x, v in moved)
            self.neighbour = (north, east, down)
        if not (self.armed and self.guided):
            super().fly(dt_s)
            return
        self.velocity = self.told_velocity or (0.0, 0.0, 0.0)
        self.north += self.velocity[0] * dt_s
        self.east += self.velocity[1] * dt_s
        self.height -= self.velocity[2] * dt_s

    def telemetry(self) -> list[ev.Event]:
        found = super().telemetry()
        found.append(ev.GnssTime(self.t_s, UNIX_S + self.t_s))
        if self.neighbour is not None and self.check_alert_sent and round(self.t_s * 10) % 2 == 0:
            found.append(ev.NeighbourTrackReceived(self.t_s, self.track()))
        return found

    def track(self) -> Track:
        assert self.neighbour is not None
        north, east, down = self.neighbour
        to = self.neighbour_goal
        return Track(
            vehicle="d2",
            gnss_s=UNIX_S + self.t_s,
            lat_deg=DEPOT[0] + north / M_PER_DEG,
            lon_deg=DEPOT[1] + east / M_PER_DEG / math.cos(math.radians(DEPOT[0])),
            alt_amsl_m=DEPOT[2] - down,
            vel_n_mps=self.neighbour_vel[0],
            vel_e_mps=self.neighbour_vel[1],
            vel_d_mps=self.neighbour_vel[2],
            pos_std_m=2.0,
            alt_std_m=0.5,
            vel_std_mps=0.1,
            to_lat_deg=to and DEPOT[0] + to[0] / M_PER_DEG,
            to_lon_deg=to and DEPOT[1] + to[1] / M_PER_DEG / math.cos(math.radians(DEPOT[0])),
        )

    @property
    def above_m(self) -> float:
        assert self.neighbour is not None
        return abs(self.height + self.neighbour[2])

    @property
    def away_m(self) -> float:
        assert self.neighbour is not None
        return math.dist((self.north, self.east), self.neighbour[:2])


def beside(autopilot_kind: AutopilotKind, options: PilotOptions = OPTIONS) -> Beside:
    """Return a vehicle on its outbound route, without a neighbour nearby."""
    plain = world(options=options, armed=True)
    plain.armed = False
    made = Beside(plain.pilot, plain.judge, autopilot_kind=autopilot_kind)
    made.tell(ev.VehicleState(0.0, made.mode, made.mode.value, False))
    made.tell(ev.AutopilotDetected(0.0, autopilot_kind, 1))
    made.run(lambda w: w.pilot.phase is Phase.OUTBOUND and w.north > 20.0)
    return made


def coming(w: Beside, ahead_m: float = 90.0) -> Beside:
    """Add a neighbour that approaches at the same height."""
    w.neighbour, w.neighbour_vel = (w.north + ahead_m, w.east, -w.height), (-8.0, 0.0, 0.0)
    w.run(lambda _: w.guided, 5.0)
    return w


@BOTH
def test_it_takes_over_before_a_neighbour_goes_round_it_and_hands_back(autopilot_kind):
    """A hovering neighbour in the path: all fly as announced, so it would brake as well."""
    w = coming(beside(autopilot_kind))
    assert w.away_m > 40.0
    w.neighbour_vel = (0.0, 0.0, 0.0)
    nearest = math.inf
    while w.pilot.is_on_setpoints:
        w.step()
        nearest = min(nearest, max(w.away_m / 6.0, w.above_m / 5.0))
        assert w.t_s < 120.0
    assert nearest >= 1.0
    assert "back" in w.kinds
    w.run(lambda _: not w.guided, 3.0)
    assert (w.mode, w.pilot.phase) == (Mode.MISSION, Phase.OUTBOUND)
    assert w.index == w.item.index


@BOTH
@pytest.mark.parametrize("goal_east_m", [None, 300.0, -300.0])
def test_who_hovers_with_its_goal_across_our_way_is_taken_for_one_that_goes_there(
    autopilot_kind, goal_east_m
):
    """Two vehicles that had just left their customers met: each used the other's current speed."""
    w = beside(autopilot_kind)
    w.neighbour = (w.north + 50.0, w.east + 40.0, -w.height)
    if goal_east_m is not None:
        w.neighbour_goal = (w.north + 50.0, w.east + goal_east_m)
    w.step()
    w.step()
    across = goal_east_m == -300.0
    assert w.pilot.is_on_setpoints == across


def test_backing_off_leads_level_away_from_the_nearest():
    heard = NeighbourTracks(FLEET_SEPARATION)
    for name, north in (("d2", 20.0), ("d3", -50.0)):
        report = NeighbourReport(name, 0.0, (north, 0.0, -30.0), (0.0, 0.0, 0.0), 2.0, 0.5, 0.1)
        heard = heard.copy_with_report_if_newer(report, 0.0)
    here, wish = np.array([0.0, 0.0, -30.0]), np.array([8.0, 0.0, 1.0])
    assert level_velocity_away_from_nearest(
        here, wish, heard.to_separation_filter_input(0.0), 2.0
    ) == pytest.approx([-2.0, 0.0, 0.0])
    nobody = NeighbourTracks(FLEET_SEPARATION).to_separation_filter_input(0.0)
    assert level_velocity_away_from_nearest(here, wish, nobody, 2.0) == pytest.approx(wish)


@BOTH
def test_px4_hears_set_points_before_it_is_asked_and_arducopter_stays_in_its_mission(
    autopilot_kind,
):
    w = coming(beside(autopilot_kind))
    told = w.sent(FlyVelocity | SetMode | JumpTo)
    first = next(k for k, a in enumerate(told) if isinstance(a, FlyVelocity))
    if autopilot_kind is AutopilotKind.PX4:
        assert SetMode(Mode.GUIDED) not in told[: first + 3]
        assert SetMode(Mode.GUIDED) in told
    else:
        assert w.mode is Mode.MISSION
        assert w.items[w.index].kind is ItemKind.ASIDE_LIMIT


@BOTH
def test_safety_rule_1_a_person_who_takes_the_mode_keeps_it_near_neighbours(autopilot_kind):
    w = coming(beside(autopilot_kind))
    w.mode = Mode.HOLD
    w.until(Phase.SUSPENDED, 2.0)
    since_s = w.t_s
    w.steps(100)
    assert w.orders_after(since_s) == []
    assert w.mode is Mode.HOLD


@BOTH
def test_the_gate_stands_above_the_detour(autopilot_kind):
    w = coming(beside(autopilot_kind))
    w.judge.turn_back = lambda judge: True
    w.until(Phase.RETURN, 5.0)
    assert w.guided  # still near: return by set-points
    w.neighbour_vel = (8.0, 0.0, 0.0)  # it turns away
    w.run(lambda _: not w.guided, 30.0)
    assert w.pilot.phase is Phase.RETURN
    assert w.items[w.index].part is Part.RETURN


def homeward(autopilot_kind: AutopilotKind) -> Beside:
    """Turn back 20 m before an outbound waypoint, with a neighbour in the path."""
    w = beside(autopilot_kind)
    w.run(lambda w: w.north > 80.0)
    coming(w)
    w.judge.turn_back = lambda judge: True
    w.run(
        lambda w: w.pilot.phase is Phase.RETURN and w.progress.pending_jump_item_index is None, 5.0
    )
    return w


@BOTH
def test_who_has_reached_its_waypoint_by_set_points_goes_on_though_it_may_not_hand_back(
    autopilot_kind,
):
    """Without waypoint progress in the autopilot, two hovered for ever over waypoints 3 m away."""
    w = homeward(autopilot_kind)
    flown, first = w.pilot.flight_plan, w.item.index
    assert flown is not None
    assert first == flown.mission.returning[-1]
    # a neighbour above the pad is too close to its height for a hand-back there
    w.neighbour, w.neighbour_vel = (0.0, 0.0, -w.height - 8.0), (0.0, 0.0, 0.0)
    while w.item.index == first:
        w.step()
        assert max(w.away_m / 6.0, w.above_m / 5.0) >= 1.0
        assert w.t_s < 120.0
    assert w.guided
    assert math.hypot(w.north, w.east) < 5.0
    assert w.height > 10.0
    assert w.item.index == flown.mission.land
    assert w.pilot.phase is Phase.LAND
    assert flown.mission.resolve_setpoint_item_target(w.index) == flown.mission.land
    w.neighbour = None
    w.until(Phase.DONE, 90.0)


@dataclass
class PendingJump:
    """Mission progress scripted by the test: a pending jump."""

    item: CurrentItem
    pending_jump_item_index: int | None = None

    @property
    def destination_item_index(self) -> int | None:
        """Target item of the jump, otherwise the current item."""
        index = self.pending_jump_item_index
        return self.item.index if index is None else index


class NoTransition:
    """Transitions have no effect."""

    def run_phase_entry_actions(self, left: Phase, why: str) -> None:
        """No phase to enter."""

    def queue_checkpoint(self, *, routine: bool) -> None:
        """No checkpoint to save."""


@BOTH
def test_a_hand_back_does_not_undo_the_jump_of_the_same_tick(autopilot_kind):
    """Continuation was allowed when the path became free, and the previous item was ordered again:
    the pilot mistook that for an external command, and the vehicle returned undelivered."""
    w = coming(beside(autopilot_kind))
    flown = w.pilot.flight_plan
    assert flown is not None
    before, onward = flown.mission.outbound[0], flown.mission.outbound[1]
    plan = CurrentPlan(flown)
    context = FlightContext(
        FLIGHT, AIRFRAME, w.judge, OPTIONS, NoTransition(), plan, LatestAssessment()
    )
    context.telemetry.store_event(ev.AutopilotDetected(w.t_s, autopilot_kind, 1))
    context.apply_phase_trigger(Trigger.AIRBORNE_AT_START)
    context.apply_phase_trigger(Trigger.DEPARTURE_CLEARED)
    item, gone_s = CurrentItem(ReturnState(), PromisedStop(plan), before), w.t_s + 60.0
    jump = PendingJump(item)
    traffic = TrafficExchange(item)
    velocity = DesiredVelocity(item, jump, GroundSpeedController(item, jump), traffic, None)
    setpoints = SetpointController(
        item, jump, ReturnCourseMonitor(item), traffic, velocity, OrderedMode()
    )

    def tick() -> None:
        """Advance telemetry with the vehicle at rest."""
        w.t_s = round(w.t_s + 0.1, 3)
        for event in w.telemetry():
            context.telemetry.store_event(event)
            traffic.on_event(context, event)
        context.take_queued_actions()
        setpoints.tick(context)

    while not setpoints.is_requesting_setpoints:
        tick()
        assert w.t_s < gone_s
    setpoints.store_item_and_map_to_target(
        context, ev.MissionProgress(w.t_s, w.index, len(w.items))
    )
    assert setpoints.is_following_setpoints(context)
    w.check_alert_sent = False  # lost after half a minute
    while setpoints.is_requesting_setpoints:
        jump.pending_jump_item_index = onward
        tick()
        assert w.t_s < gone_s
    orders = [a for a in context.take_queued_actions() if isinstance(a, JumpTo | SetMode)]
    kept = SetMode(Mode.MISSION) if autopilot_kind is AutopilotKind.PX4 else JumpTo(onward)
    assert orders == [kept]


@pytest.mark.sample
@BOTH
def test_a_mission_that_is_not_moved_past_a_waypoint_is_handed_back_as_it_is(autopilot_kind):
    w = homeward(autopilot_kind)
    first = w.item.index
    w.neighbour, w.neighbour_vel = (0.0, 0.0, -w.height - 8.0), (0.0, 0.0, 0.0)
    w.run(lambda _: w.guided and math.hypot(w.north, w.east) < 8.0, 90.0)
    w.deaf_to_jumps = True
    w.steps(100)
    asked = [a for t, a in w.log if isinstance(a, JumpTo) and t > w.t_s - 10.0]
    flown = w.pilot.flight_plan
    assert flown is not None
    led = {flown.mission.land, flown.mission.first_setpoint_item_of_target(flown.mission.land)}
    assert len([a for a in asked if a.index in led]) == 3
    assert w.item.index == first
    w.deaf_to_jumps, w.neighbour_vel = False, (0.0, 8.0, 0.0)  # the other vehicle leaves
    w.run(lambda _: not w.guided, 30.0)
    assert w.item.index == first
    w.until(Phase.DONE, 90.0)


@BOTH
def test_who_is_held_for_four_seconds_backs_off_and_takes_the_next_layer(autopilot_kind):
    """A vehicle that is always 14 m in front prevents both passing and climbing."""
    w = coming(beside(autopilot_kind))
    height = w.height

    def stand_before(w: Beside) -> None:
        w.neighbour, w.neighbour_vel = (w.north + 14.0, w.east, -w.height), (0.0, 0.0, 0.0)

    while w.told_velocity is None or w.told_velocity[0] > -0.5:  # until it backs off
        stand_before(w)
        w.step()
        assert w.t_s < 120.0
    held_at, held_s = (w.north, w.east, w.height), w.t_s
    assert abs(w.height - height) < 6.0
    w.neighbour_vel = (0.0, 0.0, 0.0)  # it stays at its position
    while w.t_s < held_s + 4.0:
        w.step()
    assert w.north < held_at[0] - 3.0
    assert abs(w.east - held_at[1]) < 3.0
    climbed = 0.0
    while w.t_s < held_s + 20.0:
        w.step()
        climbed = max(climbed, abs(w.height - held_at[2]))
        assert max(w.away_m / 6.0, w.above_m / 5.0) >= 1.0
    assert climbed > 6.0


@BOTH
def test_a_neighbour_that_falls_silent_is_doubted_more_and_more_then_let_go(autopilot_kind):
    w = coming(beside(autopilot_kind), 120.0)
    w.check_alert_sent = False
    north = w.north
    w.steps(250)
    assert w.guided
    assert w.north < north + 60.0  # no advance to where the silent neighbour may be
    w.run(lambda w: "no reports from nearby drone: d2" in w.said, 20.0)
    w.neighbour = None
    w.run(lambda _: not w.guided, 10.0)


@BOTH
def test_a_far_neighbour_changes_nothing_and_places_are_told_at_common_ticks(autopilot_kind):
    w = beside(autopilot_kind)
    w.neighbour, w.neighbour_vel = (w.north + 60.0, 400.0, -30.0), (0.0, 8.0, 0.0)
    w.log.clear()
    w.steps(50)
    assert not w.pilot.is_on_setpoints
    times = [a.gnss_s for _, a in w.log if isinstance(a, PublishTrack)]
    assert len(times) == 25
    assert all(abs(t / 0.2 - round(t / 0.2)) < 1e-3 for t in times)


def test_arducopter_that_set_points_left_goes_on_with_its_mission_when_the_companion_is_back():
    """A restarted companion finds the vehicle at a set-point item: it continues immediately."""
    before = coming(beside(AutopilotKind.ARDUPILOT))
    kept = before.pilot.build_checkpoint()
    pilot = world(options=OPTIONS, kept=kept, armed=True)
    w = Beside(pilot.pilot, pilot.judge, autopilot_kind=AutopilotKind.ARDUPILOT)
    for name in ("t_s", "north", "east", "height", "items", "index", "loaded", "values", "mode"):
        setattr(w, name, getattr(before, name))
    w.armed = True
    w.tell(ev.VehicleState(w.t_s, w.mode, w.mode.value, True))
    w.tell(ev.AutopilotDetected(w.t_s, AutopilotKind.ARDUPILOT, 1))
    assert w.guided
    w.run(lambda _: not w.guided, 5.0)
    assert w.pilot.phase is Phase.OUTBOUND


@pytest.mark.parametrize("away_m", [1100.0, 900.0], ids=["out of hearing", "canary: lost"])
def test_who_has_flown_out_of_hearing_is_let_go_without_a_word(away_m):
    """Tracks are published by grid cell: only vehicles within 1 km are received reliably."""
    w = beside(AutopilotKind.PX4)
    w.neighbour, w.neighbour_vel = (w.north, w.east + away_m, -w.height), (0.0, 10.0, 0.0)
    w.steps(10)
    w.check_alert_sent = False
    w.steps(350)
    assert ("no reports from nearby drone: d2" in w.said) is (away_m < 1000.0)


NAMES = st.sampled_from(["d1", "d2", "d-2", "d_2", "d10", "north", "d"])
MEMBERS = st.sets(st.tuples(st.sampled_from(["d", "d1", "north", "north-1", "north_1"]), NAMES))


@given(MEMBERS)
def test_vehicles_of_several_fleets_find_one_order_of_dodge_heights(members: set) -> None:
    """Each names its own fleet's vehicles by name, and others by fleet and name."""
    ranks = [
        avoidance_rank_by_name(
            fleet,
            name,
            [
                other if beside == fleet else f"{beside}/{other}"
                for beside, other in members
                if (beside, other) != (fleet, name)
            ],
        )
        for fleet, name in members
    ]
    assert sorted(ranks) == list(range(len(members)))


@given(st.sets(NAMES, min_size=1))
def test_within_one_fleet_the_order_is_that_of_the_names(names: set) -> None:
    for name in names:
        others = names - {name}
        assert avoidance_rank_by_name("north", name, others) == sorted([*others, name]).index(name)


@pytest.mark.parametrize("fleet", ["north", ""], ids=["told apart", "canary: one name"])
def test_a_neighbouring_fleets_vehicle_is_told_from_ours_of_the_same_name(fleet):
    """The own fleet's d2 is far away; the other fleet's is in the path, at the same times."""
    w = beside(AutopilotKind.PX4)
    w.check_alert_sent = False
    far, near = (w.north - 900.0, w.east, -w.height), (w.north + 60.0, w.east, -w.height)
    until_s = w.t_s + 5.0
    while w.t_s < until_s and not w.pilot.is_on_setpoints:
        for place, of in ((far, ""), (near, fleet)):
            w.neighbour = place
            w.tell(ev.NeighbourTrackReceived(w.t_s, w.track(), of))
        w.step()
    assert w.pilot.is_on_setpoints is (fleet == "north")
    if fleet:
        assert any("near north/d2" in a.reason for _, a in w.log if isinstance(a, Decision))
