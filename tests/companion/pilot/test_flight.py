"""The pilot flown event by event against a vehicle of a few lines, with a scripted gate.

The vehicle obeys orders at once and follows the mission as autopilots do. Wind, energy and the
gate are scripted: how the mission acts on what they say is what is tested here.
"""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.adapters.files.params import read_airframe, read_wind_process
from companion.core.mission import events as ev
from companion.core.mission.actions import (
    Action,
    Answer,
    Arm,
    AskParameters,
    AskTelemetry,
    Configure,
    Decision,
    Disarm,
    Finished,
    JumpTo,
    MakeTable,
    Note,
    Order,
    PhaseChanged,
    Publish,
    ReadMissionBack,
    Release,
    Reply,
    SaveCheckpoint,
    Say,
    SetGroundSpeed,
    SetMode,
    UploadMission,
)
from companion.core.mission.events import Ground, Mode
from companion.core.mission.flight_file import Flight
from companion.core.mission.mission_items import ItemKind, MissionItem, differences
from companion.core.mission.preflight_checks import Finding, Requirement
from companion.core.pilot import resume as recognising
from companion.core.pilot.checkpoint import Kept
from companion.core.pilot.estimates import Limits
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.pilot_state import PilotOptions
from companion.core.pilot.transitions import COMMANDING_PHASES, Phase
from companion.core.return_budget.budget import Ahead, Assessment
from companion.core.return_budget.remaining_mission import OnTheWay
from companion.core.return_budget.value_table.mission_value import Reading
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.estimator import WindBelief

DEPOT = (55.47, 8.45, 12.0)
M_PER_DEG = 111_194.93  # one degree on a sphere of 6,371,008.8 m
FLIGHT = msgspec.convert(
    tomllib.loads(
        """
        format = "flight/1"
        [site]
        depot = { lat_deg = 55.47, lon_deg = 8.45, alt_amsl_m = 12.0 }
        customer = { name = "customer", north_m = 300.0, east_m = 0.0, up_m = 3.0 }
        rally = [{ name = "quay", north_m = 150.0, east_m = 120.0 }]
        [vehicle]
        airframe = "m100"
        payload_kg = 0.6
        [mission]
        leg_length_m = 100.0
        cruise_height_m = 30.0
        wind_settle_s = 4.0
        """
    ),
    Flight,
)
AIRFRAME = read_airframe("m100")
WIND_PROCESS = read_wind_process("coast")
CLOSED = "the return needs more than is left"


@dataclass
class ScriptedJudge:
    """Wind, energy and gate as the test says."""

    route_energy: Any
    payload_kg: float = 0.6
    limits: Limits = field(default_factory=lambda: Limits(0.01, 0.15))
    turn_back: Callable[["ScriptedJudge"], bool] = lambda judge: False
    best_landing: str = "depot"
    depot_p_home: float = 0.999
    wind_ne: tuple[float, float] = (0.0, 0.0)
    known: bool = True
    t_s: float = 0.0
    asked: list[Ahead] = field(default_factory=list)
    restored: bool = False
    table: Any = None
    p_home_by_table: float = 0.999
    tables_asked: list[OnTheWay] = field(default_factory=list)

    @property
    def energy(self) -> EnergyBelief | None:
        return EnergyBelief(self.t_s, 80.0, 2.0, 110.0, "test") if self.known else None

    @property
    def wind(self) -> WindBelief:
        return WindBelief(self.t_s, np.array(self.wind_ne), np.eye(2), ("test",), self.known)

    def observe(self, now: Any, flavour: Any) -> tuple[str, ...]:
        self.t_s = now.t_s
        return ()

    def depart(self, ahead: Ahead) -> Assessment | None:
        return self.assess(ahead)

    def limit(self, limits: Limits) -> None:
        self.limits = limits

    def assess(self, ahead: Ahead) -> Assessment | None:
        if not self.known:
            return None
        self.asked.append(ahead)
        only_depot = {way.landing for way in ahead.ways_home_now} == {"depot"}
        p_home = self.depot_p_home if only_depot else 0.999
        closed = self.turn_back(self)
        return Assessment(
            self.t_s, p_home, 0.999, 0.9, 20.0, closed, self.best_landing, None, 80.0, 60.0,
            CLOSED if closed else "open",
        )  # fmt: skip

    def reading(self, at: OnTheWay) -> Reading | None:
        home = self.p_home_by_table
        return None if self.table is None else Reading(home, home, 1.0, False)

    def table_request(self, plan: Any, at: OnTheWay, *, on_ground: bool = False) -> Any:
        self.tables_asked.append(at)
        return SimpleNamespace(plan=plan, on_ground=on_ground) if self.known else None

    def ground_speed_mps(self, here: Any, to: Any) -> float:
        return 10.0 + self.wind_ne[0]

    def snapshot(self) -> dict[str, object]:
        return {"ledger": {}, "outlook": {}, "scale": {}, "wind": {}, "payload_kg": self.payload_kg,
                "max_loss": 0.01, "accepted_loss": None, "reserve_frac": 0.15}  # fmt: skip

    def restore(self, kept: Any) -> None:
        self.restored = True
        self.payload_kg = kept.payload_kg


def one_requirement(flavour: Any, facts: Any) -> tuple[Requirement, ...]:
    """A failsafe that is off until it is configured."""
    return (
        Requirement(
            ("LOW_ACT",),
            "a low-battery action is set",
            lambda v: None if v.get("LOW_ACT") is None else v["LOW_ACT"] == 2.0,
            lambda v: {"LOW_ACT": 2.0},
            True,
        ),
    )


@dataclass
class World:
    """A vehicle that obeys, its clock, and everything that the pilot did."""

    pilot: Pilot
    judge: ScriptedJudge
    t_s: float = 0.0
    north: float = 0.0
    east: float = 0.0
    height: float = 0.0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mode: Mode = Mode.HOLD
    armed: bool = False
    disarms: bool = True
    items: tuple[MissionItem, ...] = ()
    index: int = 0
    waited: float = 0.0
    speed: float = 10.0
    loaded: bool = True
    gripper_works: bool = True
    values: dict[str, float | None] = field(default_factory=lambda: {"LOW_ACT": 0.0})
    obeys_jumps: bool = True
    gnss: bool = True
    volts: float | None = 22.0
    mute: set[type] = field(default_factory=set)
    log: list[tuple[float, Action]] = field(default_factory=list)
    answers: list[ev.Event] = field(default_factory=list)
    rewrite: Callable[[tuple[MissionItem, ...]], tuple[MissionItem, ...]] = lambda items: items

    def tell(self, event: ev.Event) -> list[Action]:
        """Give the pilot one event; obey its orders."""
        actions = self.pilot.handle(event)
        for action in actions:
            self.log.append((self.t_s, action))
            if isinstance(action, Order):
                assert self.pilot.phase in COMMANDING_PHASES
                self.obey(action)
        return actions

    def obey(self, order: Order) -> None:
        match order:
            case AskTelemetry():
                self.answers.append(ev.StreamsAsked(self.t_s))
            case AskParameters():
                self.answers.append(ev.AutopilotParameters(self.t_s, dict(self.values)))
            case Configure():
                self.values |= order.values
                self.answers += [
                    ev.ParametersSet(self.t_s),
                    ev.AutopilotParameters(self.t_s, dict(self.values)),
                ]
            case UploadMission():
                self.items = self.rewrite(order.items)
                self.index = 0
                self.answers.append(ev.MissionUploaded(self.t_s))
            case ReadMissionBack():
                found = differences(order.items, self.items)
                self.answers.append(ev.MissionReadBack(self.t_s, found))
            case SetMode():
                self.mode = order.mode
            case Arm():
                self.armed = True
            case Disarm():
                self.armed = self.armed and not self.disarms
            case JumpTo() if self.obeys_jumps:
                self.index, self.waited = order.index, 0.0
            case SetGroundSpeed():
                self.speed = order.ground_speed_mps
            case Release():
                self.loaded = self.loaded and not self.gripper_works
            case _:
                return

    def fly(self, dt_s: float) -> None:
        """Follow the mission, by itself."""
        self.velocity = (0.0, 0.0, 0.0)
        if not self.armed or self.mode is not Mode.MISSION or self.index >= len(self.items):
            return
        item = self.items[self.index]
        match item.kind:
            case ItemKind.JUMP:
                self.index = int(item.value)
                return
            case ItemKind.RELEASE:
                self.loaded = self.loaded and not self.gripper_works
                self.index += 1
                return
            case ItemKind.SPEED:
                self.speed = item.value
                self.index += 1
                return
            case _:
                pass
        assert item.spot is not None
        goal_n = (item.spot.lat_deg - DEPOT[0]) * M_PER_DEG
        goal_e = (item.spot.lon_deg - DEPOT[1]) * M_PER_DEG * math.cos(math.radians(DEPOT[0]))
        if item.kind is ItemKind.TAKEOFF:
            goal_n, goal_e = self.north, self.east
        away = math.dist((goal_n, goal_e), (self.north, self.east))
        step = min(away, self.speed * dt_s, 0.8 * away + 0.05)
        if away > 0.0:
            north, east = (goal_n - self.north) / away * step, (goal_e - self.east) / away * step
            self.velocity = (north / dt_s, east / dt_s, 0.0)
            self.north, self.east = self.north + north, self.east + east
        if item.kind is not ItemKind.LAND or away < 2.0:
            climb = max(-3.0 * dt_s, min(3.0 * dt_s, item.spot.height_rel_m - self.height))
            self.height += climb
            self.velocity = (*self.velocity[:2], -climb / dt_s)
        if away < 2.0 and abs(self.height - item.spot.height_rel_m) < 0.3:
            if item.kind is ItemKind.LAND:
                self.armed = not self.disarms
                return
            self.waited += dt_s
            hold = item.value if item.kind in (ItemKind.LOITER_TIME, ItemKind.WAYPOINT) else 0.0
            if self.waited >= hold:
                self.index, self.waited = self.index + 1, 0.0

    def telemetry(self) -> list[ev.Event]:
        t = self.t_s
        power = 470.0 if self.loaded else 370.0
        found: list[ev.Event] = [
            ev.Attitude(t, 0.0, 0.0, 0.0),
            ev.Position(
                t,
                DEPOT[0] + self.north / M_PER_DEG,
                DEPOT[1] + self.east / M_PER_DEG / math.cos(math.radians(DEPOT[0])),
                DEPOT[2] + self.height,
                self.height,
                *self.velocity,
            ),
            ev.GnssFix(t, self.gnss),
            ev.Battery(t, voltage_v=self.volts, current_a=power / 22.0 if self.armed else 0.5),
            ev.MissionProgress(t, self.index, len(self.items) or None),
            ev.GroundState(t, Ground.IN_AIR if self.height > 0.3 else Ground.ON_GROUND),
        ]
        if round(t * 10) % 5 == 0:
            found.append(ev.VehicleState(t, self.mode, self.mode.value, self.armed))
        return [event for event in found if type(event) not in self.mute]

    def step(self, dt_s: float = 0.1) -> None:
        """One tick of the autopilot's clock."""
        self.t_s = round(self.t_s + dt_s, 3)
        self.fly(dt_s)
        answers, self.answers = self.answers, []
        for event in (*answers, *self.telemetry(), ev.Tick(self.t_s)):
            self.tell(event)

    def run(self, until: Callable[["World"], bool], limit_s: float = 300.0) -> "World":
        """Fly until something holds."""
        end_s = self.t_s + limit_s
        while not until(self):
            assert self.t_s < end_s, f"never came: {self.pilot.phase}, {self.kinds}"
            self.step()
        return self

    def until(self, phase: Phase) -> "World":
        return self.run(lambda w: w.pilot.phase is phase)

    def to_the_end(self) -> Finished:
        self.run(lambda w: any(isinstance(a, Finished) for _, a in w.log))
        return next(a for _, a in self.log if isinstance(a, Finished))

    def orders_after(self, t_s: float) -> list[Order]:
        return [a for t, a in self.log if isinstance(a, Order) and t > t_s]

    @property
    def kinds(self) -> list[str]:
        return [a.kind for _, a in self.log if isinstance(a, Decision)]

    @property
    def said(self) -> str:
        return "; ".join(a.text for _, a in self.log if isinstance(a, Say))


def world(
    *,
    options: PilotOptions | None = None,
    kept: Kept | None = None,
    flight: Flight = FLIGHT,
    armed: bool = False,
) -> World:
    """A pilot with a scripted judge beside a vehicle at the depot."""
    pilot = Pilot(
        flight,
        AIRFRAME,
        WIND_PROCESS,
        obstacles=None,
        requirements=one_requirement,
        digest="test",
        options=options or PilotOptions(configure=True, authorise=True),
    )
    judge = ScriptedJudge(pilot.judge.route_energy)
    pilot.judge = judge  # type: ignore[assignment]
    if kept is not None:
        pilot.checkpoint = kept
        recognising.restore(pilot)
    made = World(pilot, judge, armed=armed)
    if not armed:
        start(made)
    return made


def start(made: World) -> None:
    """Let the pilot recognise the autopilot."""
    made.tell(ev.VehicleState(made.t_s, made.mode, made.mode.value, made.armed))
    made.tell(ev.Identified(made.t_s, ev.Flavour.PX4, 1))


# --- the straight way ----------------------------------------------------------------------------


def test_a_flight_with_an_open_gate_delivers_and_comes_home():
    w = world()
    done = w.to_the_end()
    assert (done.outcome, done.delivered) == ("SUC", True)
    expected = ["planned", "read_back", "authorised", "take_off", "go", "onward", "descend",
                "delivered", "landed", "finished"]  # fmt: skip
    assert [k for k in expected if k in w.kinds] == expected
    assert not w.loaded
    assert math.hypot(w.north, w.east) < 3.0


def test_leave_for_the_next_leg_comes_before_the_waypoint_so_that_it_does_not_slow():
    w = world()
    w.until(Phase.OUTBOUND)
    target = w.pilot.flown.plan.outbound_ned_m[0]
    w.run(lambda w: "onward" in w.kinds)
    away = math.dist((w.north, w.east), target[:2])
    braking = 10.0**2 / (2 * AIRFRAME.speeds.accel_mps2)
    assert away > braking


def test_margin_and_p_home_are_published_once_a_second():
    w = world()
    w.until(Phase.OUTBOUND)
    seen = [a.values for _, a in w.log if isinstance(a, Publish)]
    assert {"LW_MARGIN", "LW_PHOME", "LW_PSUCC", "LW_WINDN", "LW_WINDE"} <= seen[-1].keys()
    w.log.clear()
    for _ in range(100):
        w.step()
    assert sum(isinstance(a, Publish) for _, a in w.log) == pytest.approx(10, abs=1)


def test_settings_are_configured_before_the_flight_and_put_back_after_landing():
    w = world()
    w.until(Phase.OUTBOUND)
    assert w.values["LOW_ACT"] == 2.0
    w.to_the_end()
    assert w.values["LOW_ACT"] == 0.0


def test_settings_that_stay_because_another_hand_has_the_vehicle_are_named():
    w = world()
    w.until(Phase.OUTBOUND)
    w.mode = Mode.RTL
    w.tell(ev.VehicleState(w.t_s, Mode.RTL, "RTL", w.armed))
    w.mode = Mode.MISSION  # it flies home by itself, under somebody else's authority
    w.to_the_end()
    assert w.values["LOW_ACT"] == 2.0
    assert "settings not put back: another hand has the vehicle" in w.said
    notes = [a.text for _, a in w.log if isinstance(a, Note)]
    assert any("put back by hand: LOW_ACT 0" in text for text in notes)


def test_settings_stay_while_the_autopilot_never_notices_its_landing():
    w = world()
    w.disarms = False  # measured on ArduCopter in 8 m/s of uniform wind
    w.to_the_end()
    assert w.armed
    assert w.values["LOW_ACT"] == 2.0
    assert "settings not put back: still armed" in w.said


# --- safety rule 1: authority --------------------------------------------------------------------

PHASES = [
    Phase.CONFIGURE, Phase.WAIT_POSITION, Phase.UPLOAD, Phase.READ_BACK, Phase.READY,
    Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER, Phase.RELEASE, Phase.RETURN,
    Phase.LAND,
]  # fmt: skip


def reach(phase: Phase) -> World:
    w = world(options=PilotOptions(configure=True, authorise=phase is not Phase.READY))
    return w.until(phase)


@pytest.mark.parametrize("phase", PHASES)
def test_safety_rule_1_the_pilot_takes_over_in_any_phase_and_not_one_order_follows(phase):
    w = reach(phase)
    w.step()
    w.mode = Mode.OTHER
    w.tell(ev.VehicleState(w.t_s, Mode.OTHER, "POSCTL", w.armed))
    assert w.pilot.phase is Phase.SUSPENDED
    taken_s, before = w.t_s, len(w.log)
    for _ in range(600):
        w.step()
    assert w.orders_after(taken_s) == []
    later = [a for _, a in w.log[before:]]
    assert any(isinstance(a, Publish) for a in later), "it goes on reporting"


def test_safety_rule_1_control_that_is_not_handed_back_stays_away_even_in_our_mode():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.VehicleState(w.t_s, Mode.OTHER, "POSCTL", True))
    taken_s = w.t_s
    w.mode = Mode.MISSION
    w.run(lambda w: not w.armed)
    assert w.orders_after(taken_s) == []


def test_safety_rule_1_handed_back_it_reads_the_mission_again_and_flies_on():
    w = reach(Phase.OUTBOUND)
    w.mode = Mode.OTHER
    w.step(0.5)
    w.step(0.5)
    assert w.pilot.phase is Phase.SUSPENDED
    for _ in range(20):
        w.step()
    handed_s = w.t_s
    w.tell(ev.ControlHandedBack(w.t_s, "255/190"))
    assert w.mode is Mode.MISSION
    done = w.to_the_end()
    assert done.outcome == "SUC"
    orders = w.orders_after(handed_s)
    assert any(isinstance(o, ReadMissionBack) for o in [a for _, a in w.log])
    assert not any(isinstance(o, Arm | UploadMission) for o in orders)


def test_safety_rule_1_an_operator_may_tell_it_to_keep_its_hands_off():
    w = reach(Phase.OUTBOUND)
    actions = w.tell(ev.ControlTaken(w.t_s, "255/190"))
    assert Answer(Reply.ACCEPTED) in actions
    assert w.pilot.phase is Phase.SUSPENDED


def test_safety_rule_1_it_arms_only_when_authorised_and_only_once():
    w = world(options=PilotOptions(configure=True))
    w.until(Phase.READY)
    for _ in range(600):
        w.step()
    assert not w.armed
    assert Answer(Reply.ACCEPTED) in w.tell(ev.Authorised(w.t_s, "255/190"))
    w.until(Phase.CLIMB)
    assert Answer(Reply.DENIED) in w.tell(ev.Authorised(w.t_s, "255/190"))


def test_safety_rule_1_before_it_is_ready_an_authorisation_is_put_off():
    w = world(options=PilotOptions(configure=True))
    w.until(Phase.UPLOAD)
    assert Answer(Reply.LATER) in w.tell(ev.Authorised(w.t_s, "255/190"))


def test_safety_rule_1_armed_by_somebody_else_on_the_ground_it_lets_go():
    w = world(options=PilotOptions(configure=True))
    w.until(Phase.READY)
    w.armed = True
    w.run(lambda w: w.pilot.phase is Phase.SUSPENDED, 2.0)
    assert "armed by somebody else" in w.said


def test_safety_rule_1_a_second_onboard_computer_stays_passive():
    w = world(options=PilotOptions(configure=True, authorise=True))
    w.tell(ev.OtherComputer(w.t_s, active=True))
    assert w.pilot.phase is Phase.PASSIVE
    before = w.t_s
    for _ in range(300):
        w.step()
    assert w.orders_after(before) == []


def test_safety_rule_1_in_flight_the_one_that_flies_goes_on_when_another_wakes():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.OtherComputer(w.t_s, active=False, booting=True))
    assert w.pilot.phase is Phase.OUTBOUND


def test_safety_rule_1_somebody_else_who_moves_the_mission_takes_over():
    w = reach(Phase.OUTBOUND)
    w.index = w.pilot.flown.mission.deliver
    w.step()
    w.step()
    assert w.pilot.phase is Phase.SUSPENDED


def test_one_late_message_from_before_our_own_jump_is_no_other_hand():
    # UDP reorders; MISSION_CURRENT carries no time.
    w = reach(Phase.OUTBOUND)
    before = w.index
    w.run(lambda x: x.pilot.air.leg == 1 and x.pilot.air.jump is None)
    w.tell(ev.MissionProgress(w.t_s, before, len(w.items)))
    w.tell(ev.Tick(w.t_s))
    assert w.pilot.phase is Phase.OUTBOUND
    assert w.to_the_end().outcome == "SUC"


def test_safety_rule_1_another_mission_aboard_takes_over():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.MissionProgress(w.t_s, 3, total=5))
    assert w.pilot.phase is Phase.SUSPENDED


def test_safety_rule_1_it_never_disarms_in_the_air():
    w = world()
    w.to_the_end()
    assert not any(isinstance(a, Disarm) for _, a in w.log)


# --- safety rule 2: the way home is aboard -------------------------------------------------------


def test_safety_rule_2_a_mission_that_reads_back_differently_never_takes_off():
    w = world()
    w.rewrite = lambda items: items[:-1]
    done = w.to_the_end()
    assert done.outcome == "ABRT"
    assert not any(isinstance(a, Arm) for _, a in w.log)
    assert sum(isinstance(a, UploadMission) for _, a in w.log) == 3


def test_safety_rule_2_in_flight_there_are_jumps_and_no_uploads():
    w = world()
    w.judge.turn_back = lambda judge: w.north > 150.0
    w.until(Phase.CLIMB)
    climb_s = w.t_s
    w.to_the_end()
    assert not any(isinstance(o, UploadMission) for o in w.orders_after(climb_s))


def test_safety_rule_2_a_dead_companion_costs_the_delivery_never_the_vehicle():
    w = reach(Phase.OUTBOUND)
    while w.armed:
        w.t_s += 0.1
        w.fly(0.1)
        assert w.t_s < 600.0
    assert math.hypot(w.north, w.east) < 3.0
    assert w.loaded


def test_safety_rule_2_no_mode_is_ever_set_but_the_mission():
    w = world()
    w.judge.turn_back = lambda judge: w.north > 150.0
    w.to_the_end()
    assert {a.mode for _, a in w.log if isinstance(a, SetMode)} == {Mode.MISSION}


# --- safety rule 3: home is a fixed place, RTL the last resort -----------------------------------


def test_safety_rule_3_a_closed_gate_is_one_jump_home_confirmed_by_telemetry():
    w = world()
    w.judge.turn_back = lambda judge: w.north > 150.0
    done = w.to_the_end()
    assert (done.outcome, done.delivered) == ("ABRT", False)
    turned = next(t for t, a in w.log if isinstance(a, Decision) and a.kind == "turn_back")
    jumps = [a for t, a in w.log if isinstance(a, JumpTo) and t >= turned]
    assert len(jumps) == 1
    assert jumps[0].index in w.pilot.flown.mission.returning
    assert CLOSED in w.said


def test_safety_rule_3_a_rally_point_is_taken_only_when_the_depot_breaks_the_promise():
    for depot_p_home, landing in ((0.999, "depot"), (0.90, "quay")):
        w = world()
        w.judge.turn_back = lambda judge, w=w: w.north > 120.0
        w.judge.best_landing = "quay"
        w.judge.depot_p_home = depot_p_home
        w.to_the_end()
        goal = (0.0, 0.0) if landing == "depot" else (150.0, 120.0)
        assert math.dist((w.north, w.east), goal) < 3.0
        assert ("divert" in w.kinds) == (landing == "quay")


def test_safety_rule_3_rtl_is_the_last_resort_when_no_jump_is_obeyed():
    w = reach(Phase.OUTBOUND)
    w.run(lambda w: w.north > 130.0)
    w.obeys_jumps = False
    w.items = tuple(  # an autopilot that is stuck in its item
        i if i.kind is not ItemKind.JUMP else MissionItem(i.kind, i.part, i.label, None, w.index)
        for i in w.items
    )
    w.judge.turn_back = lambda judge: True
    w.run(lambda w: w.pilot.phase is Phase.LAST_RESORT, 30.0)
    assert w.mode is Mode.RTL
    jumps = [t for t, a in w.log if isinstance(a, JumpTo)]
    assert len([t for t in jumps if t > jumps[-3] - 0.01]) == 3
    assert "RTL" in w.said
    taken_s = w.t_s
    for _ in range(50):
        w.step()
    assert w.pilot.phase is Phase.LAST_RESORT, "its own RTL is not a take-over"
    assert w.orders_after(taken_s) == []


def test_safety_rule_3_no_rtl_where_its_altitude_is_not_known_to_clear_the_obstacles():
    w = reach(Phase.OUTBOUND)
    w.pilot.ground.findings = (Finding("RTL_ALT", "an RTL above every obstacle", blocks=True),)
    w.obeys_jumps = False
    w.judge.turn_back = lambda judge: True
    w.until(Phase.LAST_RESORT)
    assert "RTL not safe" in w.said
    assert not any(isinstance(a, SetMode) and a.mode is Mode.RTL for _, a in w.log)


def test_a_position_lost_in_flight_is_said_with_where_it_was_and_promises_nothing():
    w = reach(Phase.OUTBOUND)
    w.gnss = False
    lost_s = w.t_s
    w.run(lambda x: x.t_s > lost_s + 3.0)
    assert "position lost: no satellite fix" in w.said
    (told,) = [a for _, a in w.log if isinstance(a, Decision) and a.kind == "position_lost"]
    assert f"last at {DEPOT[0] + w.north / M_PER_DEG:.2f}" in told.reason
    assert told.p_home is None
    assert w.pilot.assessment is None
    w.gnss = True
    w.run(lambda x: x.t_s > lost_s + 6.0)
    assert "position back after" in w.said
    assert w.pilot.assessment is not None


def test_an_autopilot_that_comes_down_blind_is_left_alone_and_the_operator_knows_where():
    w = reach(Phase.OUTBOUND)
    w.gnss = False
    w.run(lambda x: x.pilot.air.position_lost_s is not None)
    w.mode = Mode.LAND
    taken_s = w.t_s
    w.run(lambda x: x.pilot.phase is Phase.SUSPENDED)
    for _ in range(50):
        w.step()
    assert "coming down blind, last at 55.47" in w.said
    assert w.orders_after(taken_s + 0.1) == []


# --- safety rule 4: energy is counted and kept ---------------------------------------------------


def test_safety_rule_4_the_question_is_about_the_whole_mission_down_to_the_ground():
    w = reach(Phase.OUTBOUND)
    w.step()
    ahead = next(a for a in reversed(w.judge.asked) if a.stages)
    last = ahead.stages[-1]
    assert last.delivers
    kinds = [leg.kind.value for leg in last.legs]
    assert kinds[-2:] == ["descend", "hover"]
    for way in last.ways_home:
        assert way.legs[0].kind.value == "climb"
        assert way.legs[-1].kind.value == "land"


def test_safety_rule_4_a_restart_restores_the_ledger_from_the_checkpoint():
    w, kept = interrupted(Phase.OUTBOUND)
    again = restarted(w, kept)
    assert again.judge.restored


# --- safety rule 5: a parcel is delivered when its release is confirmed --------------------------


def test_safety_rule_5_the_fall_of_hover_power_confirms_the_release():
    w = world()
    w.until(Phase.RELEASE)
    assert w.judge.payload_kg == 0.6
    w.run(lambda w: "delivered" in w.kinds, 10.0)
    assert w.judge.payload_kg == 0.0


def test_safety_rule_5_a_stuck_gripper_returns_loaded_undelivered_and_says_so():
    w = world()
    w.gripper_works = False
    done = w.to_the_end()
    assert (done.outcome, done.delivered) == ("ABRT", False)
    assert done.drop_unproven  # it may be gone for all that: the desk has somebody look
    assert sum(isinstance(a, Release) for _, a in w.log) == 1
    assert "release_unconfirmed" in w.kinds
    assert "parcel counts as aboard" in w.said
    assert w.judge.payload_kg == 0.6


# --- safety rule 6: predict what the autopilot will do -------------------------------------------


def test_safety_rule_6_each_leg_is_commanded_the_wind_triangles_ground_speed():
    w = reach(Phase.OUTBOUND)
    w.run(lambda w: any(isinstance(a, SetGroundSpeed) for _, a in w.log))
    assert w.speed == 10.0
    w.log.clear()
    for _ in range(40):
        w.step()
    repeats = [a for _, a in w.log if isinstance(a, SetGroundSpeed)]
    assert len(repeats) <= 1, "a steady wind needs no second order on one leg"
    w.judge.wind_ne = (3.0, 0.0)
    w.run(lambda w: w.speed == 13.0, 8.0)


def test_safety_rule_6_small_moves_of_the_wind_are_not_chased():
    w = reach(Phase.OUTBOUND)
    w.run(lambda w: any(isinstance(a, SetGroundSpeed) for _, a in w.log))
    w.step()
    w.log.clear()
    leg = w.pilot.air.index
    for k in range(200):
        w.judge.wind_ne = (0.3 * math.sin(k), 0.0)
        w.step()
        if w.pilot.air.index != leg:
            break
    assert not any(isinstance(a, SetGroundSpeed) for t, a in w.log if t < w.t_s)


# --- safety rule 8: heights ----------------------------------------------------------------------


def test_safety_rule_8_drop_and_landing_heights_stand_on_their_own_ground():
    w = reach(Phase.READY)
    items = {item.label: item for item in w.items}
    assert items["drop"].spot.height_rel_m == pytest.approx(3.0 + 6.0)  # customer's ground + drop
    assert items["land"].spot.height_rel_m == 0.0
    assert items["out 0"].spot.height_rel_m == pytest.approx(30.0)


def test_safety_rule_8_a_customer_above_the_cruise_height_is_refused_on_the_ground():
    place = msgspec.structs.replace(FLIGHT.site.customer, up_m=28.0)
    flight = msgspec.structs.replace(
        FLIGHT, site=msgspec.structs.replace(FLIGHT.site, customer=place)
    )
    w = world(flight=flight)
    w.to_the_end()
    assert "mission.cruise_height_m = 30" in w.said
    assert not any(isinstance(a, Arm) for _, a in w.log)


def test_a_customer_out_of_reach_is_refused_on_the_ground():
    place = msgspec.structs.replace(FLIGHT.site.customer, north_m=9000.0)
    flight = msgspec.structs.replace(
        FLIGHT, site=msgspec.structs.replace(FLIGHT.site, customer=place)
    )
    w = world(flight=flight)
    done = w.to_the_end()
    assert "beyond reach" in done.reason
    assert not any(isinstance(a, UploadMission) for _, a in w.log)


def test_a_vehicle_that_does_not_stand_at_the_depot_is_refused():
    w = world()
    w.north = 80.0
    done = w.to_the_end()
    assert "80 m from it" in done.reason


# --- never on stale or unknown data --------------------------------------------------------------

STALE = [ev.Position, ev.Attitude, ev.Battery, ev.VehicleState, ev.GnssFix]


@pytest.mark.parametrize("kind", STALE)
def test_nothing_onward_is_commanded_on_stale_data_and_the_mission_comes_home(kind):
    w = reach(Phase.OUTBOUND)
    w.mute.add(kind)
    for _ in range(45):
        w.step()
    stale_s = w.t_s
    while w.armed and w.t_s < stale_s + 200.0:
        w.step()
    onward = {*w.pilot.flown.mission.outbound, w.pilot.flown.mission.deliver}
    jumps = [o.index for o in w.orders_after(stale_s) if isinstance(o, JumpTo)]
    assert not onward & set(jumps)
    assert w.loaded
    assert math.hypot(w.north, w.east) < 3.0


def test_unknown_wind_and_energy_give_no_leave_to_go():
    w = world()
    w.until(Phase.MEASURE)
    w.judge.known = False
    w.pilot.assessment = None
    w.run(lambda w: not w.armed)
    assert "go" not in w.kinds


def test_a_short_gnss_outage_only_delays_and_the_delivery_goes_on():
    w = reach(Phase.OUTBOUND)
    w.gnss = False
    w.run(lambda w: w.pilot.phase is Phase.RETURN)
    assert "no satellite fix" in w.said
    w.gnss = True
    done = w.to_the_end()
    assert "onward_again" in w.kinds
    assert done.outcome == "SUC"


def test_what_was_decided_against_is_not_taken_up_again():
    w = world()
    w.judge.turn_back = lambda judge: w.north > 100.0
    w.run(lambda w: w.pilot.phase is Phase.RETURN)
    w.judge.turn_back = lambda judge: False
    w.to_the_end()
    assert "onward_again" not in w.kinds


def test_over_the_time_limit_it_turns_home():
    flight = msgspec.structs.replace(
        FLIGHT, mission=msgspec.structs.replace(FLIGHT.mission, time_limit_s=30.0)
    )
    w = world(flight=flight)
    w.to_the_end()
    assert "over the time limit" in w.said


def test_with_the_gate_off_it_never_turns_back_and_says_so():
    w = world(options=PilotOptions(gate_on=False, configure=True, authorise=True))
    w.judge.turn_back = lambda judge: True
    done = w.to_the_end()
    assert done.delivered
    assert "gate off: would turn back now" in w.said


def test_an_operator_aborts_and_it_comes_home():
    w = reach(Phase.OUTBOUND)
    assert Answer(Reply.ACCEPTED) in w.tell(ev.AbortOrdered(w.t_s, "255/190"))
    done = w.to_the_end()
    assert done.outcome == "ABRT"
    assert "abort" in w.kinds


# --- link, clock, restarts -----------------------------------------------------------------------


def test_a_lull_changes_nothing():
    w = reach(Phase.OUTBOUND)
    decisions = len(w.kinds)
    w.tell(ev.LinkSilent(w.t_s))
    assert w.pilot.phase is Phase.LINK_LOST
    w.tell(ev.LinkBack(w.t_s, 0.0))
    assert w.pilot.phase is Phase.OUTBOUND
    assert len(w.kinds) == decisions


def test_after_a_silence_it_finds_out_where_it_is_and_goes_on():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.LinkSilent(w.t_s))
    for _ in range(100):
        w.t_s = round(w.t_s + 0.1, 3)
        w.fly(0.1)
    for event in w.telemetry():
        w.tell(event)
    w.tell(ev.LinkBack(w.t_s, 10.0))
    assert w.pilot.phase is Phase.RECOGNISE
    done = w.to_the_end()
    assert done.outcome == "SUC"


def test_a_rebooted_autopilot_is_read_again_and_no_energy_is_won():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.ClockStepped(w.t_s, 100.0))
    assert w.pilot.phase is Phase.RECOGNISE
    assert "rebooted" in w.said
    back_s = w.t_s - 0.01
    done = w.to_the_end()
    kinds = {type(o) for o in w.orders_after(back_s)}
    assert {AskTelemetry, ReadMissionBack} <= kinds
    assert not {Arm, UploadMission} & kinds
    assert done.outcome == "SUC"


def interrupted(phase: Phase) -> tuple[World, Kept]:
    """A flight whose companion is killed in a phase; its last checkpoint."""
    w = reach(phase)
    w.step()
    w.pilot.save()
    content = [a.content for _, a in w.log if isinstance(a, SaveCheckpoint)]
    w.pilot._out.clear()
    return w, msgspec.convert(content[-1], Kept)


def restarted(w: World, kept: Kept, *, mode: Mode | None = None) -> World:
    """A new companion process beside the same vehicle, some seconds later."""
    for _ in range(30):
        w.t_s = round(w.t_s + 0.1, 3)
        w.fly(0.1)
    again = world(kept=kept, armed=True)
    for name in ("t_s", "north", "east", "height", "items", "index", "waited", "loaded", "values"):
        setattr(again, name, getattr(w, name))
    again.mode = mode or w.mode
    start(again)
    return again


@pytest.mark.parametrize("phase", [Phase.CLIMB, Phase.OUTBOUND, Phase.DELIVER, Phase.RETURN])
def test_killed_in_mid_air_and_restarted_it_picks_the_flight_up_without_arming(phase):
    w, kept = interrupted(phase)
    again = restarted(w, kept)
    done = again.to_the_end()
    assert "recognised" in again.kinds
    assert done.outcome == "SUC"
    assert not any(isinstance(a, Arm | UploadMission) for _, a in again.log)


@pytest.mark.parametrize("phase", [Phase.RETURN, Phase.LAND])
def test_killed_in_the_air_and_restarted_on_its_pad_it_ends_the_flight_and_never_flies_again(phase):
    """A town's day with faults flew an order twice: the companion was killed while it landed."""
    w, kept = interrupted(phase)
    again = world(kept=kept, armed=False)
    again.t_s, again.items, again.loaded = w.t_s + 20.0, w.items, w.loaded
    start(again)
    done = again.to_the_end()
    assert (done.outcome, done.delivered, done.home) == ("SUC", True, True)
    assert not any(isinstance(a, Arm | UploadMission) for _, a in again.log)


@pytest.mark.parametrize(
    ("phase", "unproven"),
    [(Phase.OUTBOUND, False), (Phase.DELIVER, True), (Phase.RELEASE, True), (Phase.RETURN, False)],
)
def test_killed_over_the_customer_nobody_knows_of_the_parcel_and_it_says_so(phase, unproven):
    w, kept = interrupted(phase)
    again = world(kept=kept, armed=False)  # the mission aboard dropped it, and went home
    again.t_s, again.items, again.loaded = w.t_s + 60.0, w.items, False
    start(again)
    assert again.to_the_end().drop_unproven == unproven


def test_restarted_beside_a_pilot_who_has_taken_over_it_sends_nothing():
    w, kept = interrupted(Phase.OUTBOUND)
    again = restarted(w, kept, mode=Mode.OTHER)
    assert again.pilot.phase is Phase.SUSPENDED
    for _ in range(100):
        again.step()
    assert not any(isinstance(a, Order) for _, a in again.log)


def test_restarted_after_it_was_suspended_it_stays_suspended_in_our_own_mode():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.VehicleState(w.t_s, Mode.OTHER, "POSCTL", True))
    content = [a.content for _, a in w.log if isinstance(a, SaveCheckpoint)]
    again = restarted(w, msgspec.convert(content[-1], Kept), mode=Mode.MISSION)
    assert again.pilot.phase is Phase.SUSPENDED
    assert not any(isinstance(a, Order) for _, a in again.log)


def test_restarted_over_a_mission_that_is_not_ours_it_stays_passive():
    w, kept = interrupted(Phase.OUTBOUND)
    w.items = w.items[:-3]
    again = restarted(w, kept)
    again.run(lambda a: a.pilot.phase is Phase.PASSIVE, 10.0)


def test_started_beside_an_armed_vehicle_that_it_does_not_know_it_stays_passive():
    w = world(armed=True)
    w.height = 30.0
    start(w)
    assert w.pilot.phase is Phase.PASSIVE
    for _ in range(50):
        w.step()
    assert not any(isinstance(a, Order) for _, a in w.log)


def test_a_restart_on_the_ground_needs_a_new_authorisation():
    w = reach(Phase.READY)
    w.tell(ev.Authorised(w.t_s, "255/190"))
    content = [a.content for _, a in w.log if isinstance(a, SaveCheckpoint)]
    kept = msgspec.convert(content[-1], Kept)
    assert kept.authorised
    again = world(kept=kept, options=PilotOptions(configure=True, authorise=True))
    again.until(Phase.READY)
    for _ in range(100):
        again.step()
    assert not again.armed


# --- the pre-flight ------------------------------------------------------------------------------


def test_a_missing_failsafe_refuses_the_take_off_in_words():
    w = world(options=PilotOptions())
    w.until(Phase.READY)
    assert Answer(Reply.DENIED) in w.tell(ev.Authorised(w.t_s, "255/190"))
    assert "a low-battery action is set" in w.said
    assert not w.armed


def test_with_authorise_on_the_command_line_a_missing_failsafe_ends_the_run():
    w = world(options=PilotOptions(authorise=True))
    done = w.to_the_end()
    assert done.outcome == "ABRT"
    assert "low-battery" in done.reason
    assert not w.armed


def test_a_check_changes_nothing_and_says_what_is_missing():
    w = world(options=PilotOptions(check_only=True))
    w.to_the_end()
    orders = {type(a) for _, a in w.log if isinstance(a, Order)}
    assert orders == {AskTelemetry, AskParameters}
    assert [f.blocks for f in w.pilot.ground.findings] == [True]
    assert not any(isinstance(a, SaveCheckpoint) for _, a in w.log)


@pytest.mark.parametrize(
    ("volts", "words"),
    [
        (14.8, "14.8 V does not fit a pack of 6 cells"),  # four cells at their nominal 3.7 V
        (33.6, "33.6 V does not fit a pack of 6 cells"),  # eight full ones of 4.2 V
        (19.9, "the battery is empty: 19.9 V at rest, 3.32 V a cell"),
    ],
)
def test_a_pack_that_does_not_fit_or_is_empty_grounds_it_and_nothing_is_set(volts, words):
    w = world()
    w.volts = volts
    done = w.to_the_end()
    assert done.outcome == "ABRT"
    assert words in done.reason
    assert words in w.said
    assert not any(isinstance(a, Configure | UploadMission | Arm) for _, a in w.log)


@pytest.mark.parametrize("volts", [20.5, 22.8, 26.1, None])
def test_a_pack_that_fits_or_that_nobody_measures_is_no_reason_to_stay(volts):
    # From a low charge to the TB48D's 26.1 V when full (DJI data sheet).
    w = world()
    w.volts = volts
    w.until(Phase.CLIMB)


def test_an_autopilot_that_refuses_to_arm_ends_grounded_and_disarmed():
    class Stubborn(World):
        def obey(self, order: Order) -> None:
            if isinstance(order, Arm):
                self.answers.append(ev.OrderRefused(self.t_s, "arm", "denied"))
            else:
                super().obey(order)

    made = world()
    w = Stubborn(made.pilot, made.judge)
    start(w)
    done = w.to_the_end()
    assert done.outcome == "ABRT"
    assert "does not arm" in done.reason
    assert "arm refused: denied" in w.said


# --- replay --------------------------------------------------------------------------------------


def test_the_same_events_give_the_same_actions():
    def flight() -> list[tuple[float, Action]]:
        w = world()
        w.judge.turn_back = lambda judge: w.north > 200.0
        w.to_the_end()
        return w.log

    assert flight() == flight()


# --- value tables --------------------------------------------------------------------------------


def made_table(**changes: Any) -> Any:
    known = {"wind_known": True, "made_for_en_mps": (0.0, 0.0), "payload_kg": 0.6, "max_loss": 0.01}
    more = {"size_bytes": 3_000_000, "loss_weight": 8.0, "keeps_nothing": False}
    return SimpleNamespace(**{**known, **more, **changes})


def tables_asked(w: World) -> list[float]:
    return [t for t, a in w.log if isinstance(a, MakeTable)]


def test_a_table_is_asked_for_on_the_ground_and_again_when_the_wind_is_known():
    w = world()
    w.until(Phase.CLIMB)
    assert len(tables_asked(w)) == 1
    w.tell(ev.TableMade(w.t_s, made_table(wind_known=False)))
    w.until(Phase.OUTBOUND).run(lambda w: len(tables_asked(w)) == 2, 3.0)
    asked = tables_asked(w)
    settled_s = next(t for t, a in w.log if isinstance(a, PhaseChanged) and a.now == "measure wind")
    assert asked[1] >= settled_s + FLIGHT.mission.wind_settle_s - 0.2
    w.tell(ev.TableMade(w.t_s, made_table()))
    assert w.to_the_end().outcome == "SUC"
    assert len(tables_asked(w)) == 2, "nothing had moved"


@pytest.mark.parametrize(
    "changes", [{"made_for_en_mps": (0.0, 2.5)}, {"payload_kg": 0.3}, {"max_loss": 0.05}]
)
def test_a_table_that_was_made_for_something_else_is_made_again(changes):
    w = reach(Phase.OUTBOUND)
    w.tell(ev.TableMade(w.t_s, made_table(**changes)))
    before = len(tables_asked(w))
    w.run(lambda w: len(tables_asked(w)) > before, 30.0)


def test_a_table_whose_policy_loses_more_than_is_accepted_from_here_is_made_again():
    w = reach(Phase.OUTBOUND)
    w.judge.p_home_by_table = 0.9
    w.tell(ev.TableMade(w.t_s, made_table()))
    before = len(tables_asked(w))
    w.run(lambda w: len(tables_asked(w)) > before, 30.0)


def test_without_any_table_the_flight_goes_on_and_it_is_said_once():
    w = world()
    w.until(Phase.CLIMB)
    for _ in range(6):
        w.run(lambda w: w.pilot.tables.asked is not None or w.pilot.phase is Phase.RETURN)
        w.tell(ev.TableMade(w.t_s, None, "the worker died"))
    assert w.to_the_end().outcome == "SUC"
    assert w.said.count("no value table") == 1
    assert len(tables_asked(w)) == 3, "then it is left alone"


def test_a_table_for_another_plan_is_not_used():
    w = reach(Phase.OUTBOUND)
    assert w.pilot.tables.asked is not None
    w.pilot.tables.asked = SimpleNamespace(plan="another")  # type: ignore[assignment]
    w.tell(ev.TableMade(w.t_s, made_table()))
    assert w.judge.table is None


def test_restarted_in_mid_air_it_flies_without_a_table_and_asks_for_a_new_one():
    w, kept = interrupted(Phase.OUTBOUND)
    again = restarted(w, kept)
    assert again.judge.table is None
    again.run(lambda w: len(tables_asked(w)) == 1, 30.0)
    assert again.to_the_end().outcome == "SUC"


def test_a_check_makes_no_table():
    w = world(options=PilotOptions(check_only=True))
    w.run(lambda w: any(isinstance(a, Finished) for _, a in w.log))
    assert not tables_asked(w)
