"""A minimal fake vehicle for the pilot, with scripted estimates.

The vehicle obeys orders immediately and follows the mission as autopilots do. Wind, energy and the
gate are scripted: the tests check the mission's reaction to their output.
"""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.params import read_airframe, read_wind_process
from companion.core.certificate.evidence import RiskEvidence
from companion.core.mission import events as ev
from companion.core.mission.actions import (
    Action,
    AlertReport,
    Arm,
    ClearMission,
    Decision,
    Disarm,
    Finished,
    JumpTo,
    LogNote,
    Order,
    ReleaseParcel,
    RequestParameters,
    RequestTelemetry,
    SaveCheckpoint,
    SetGroundSpeed,
    SetHome,
    SetMode,
    SetParameters,
    UploadMission,
    VerifyMission,
)
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.events import Mode, VehicleLandedState
from companion.core.mission.find_plan import FindPlan, PlanFound
from companion.core.mission.flight_file import Flight
from companion.core.mission.mission_items import ItemKind, MissionItem, mission_differences
from companion.core.mission.preflight_checks import ParameterRequirement
from companion.core.monitor.flight_evidence import FlightEvidence
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.estimators.flight_gate import AcceptedLimits
from companion.core.pilot.flight_state import CurrentItem
from companion.core.pilot.ground.autopilot_settings import RequirementsFunction
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.transitions import COMMANDING_PHASES, Phase
from companion.core.return_budget.budget import Assessment, RemainingMission
from companion.core.return_budget.outcomes import SiteMargin
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.air import Air
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.estimator import WindBelief

DEPOT = (55.47, 8.45, 12.0)
PACK_OHM = 0.045
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
    """Wind, energy and gate scripted by the test."""

    route_energy: Any
    payload_kg: float = 0.6
    limits: AcceptedLimits = field(default_factory=lambda: AcceptedLimits(0.01, 0.15))
    turn_back: Callable[["ScriptedJudge"], bool] = lambda judge: False
    best_landing: str = "depot"
    depot_p_home: float = 0.999
    wind_ne: tuple[float, float] = (0.0, 0.0)
    known: bool = True
    t_s: float = 0.0
    asked: list[RemainingMission] = field(default_factory=list)
    restored: bool = False
    envelope_exit_texts: tuple[str, ...] = ()
    air: Air | None = None
    evidence: RiskEvidence = field(default_factory=lambda: RiskEvidence(WIND_PROCESS))

    def fix_air_properties(self, air: Air) -> None:
        self.air = air
        self.route_energy.set_air_density_and_clear_cached_tables(air.density_kgpm3)

    @property
    def energy(self) -> EnergyBelief | None:
        return EnergyBelief(self.t_s, 80.0, 2.0, 110.0, "test") if self.known else None

    @property
    def wind(self) -> WindBelief:
        return WindBelief(self.t_s, np.array(self.wind_ne), np.eye(2), ("test",), self.known)

    def update_from_telemetry(self, now: Any, autopilot_kind: Any) -> list[LogNote | AlertReport]:
        self.t_s = now.t_s
        return []

    def new_fleet_wind_change_texts(self, t_s: float) -> tuple[str, ...]:
        return ()

    def monitor_evidence_so_far(self) -> FlightEvidence:
        return FlightEvidence()

    def assess_departure_and_fix_loss(self, ahead: RemainingMission) -> Assessment | None:
        return self.assess(ahead)

    def set_accepted_limits(self, limits: AcceptedLimits) -> None:
        self.limits = limits

    def assess(self, ahead: RemainingMission) -> Assessment | None:
        if not self.known:
            return None
        self.asked.append(ahead)
        only_depot = {way.landing for way in ahead.current_return_routes} == {"depot"}
        p_home = self.depot_p_home if only_depot else 0.999
        closed = self.turn_back(self)
        return Assessment(
            self.t_s, p_home, 0.999, 0.9, 20.0, closed, self.best_landing, None, 80.0, 60.0,
            CLOSED if closed else "open",
            sites=tuple(
                SiteMargin(way.landing, self.depot_p_home if way.landing == "depot" else 0.999,
                           20.0, None)
                for way in ahead.current_return_routes
            ),
        )  # fmt: skip

    def ground_speed_to_command_mps(self, here: Any, to: Any) -> float:
        return 10.0 + self.wind_ne[0]

    def snapshot(self) -> dict[str, object]:
        return {"ledger": {}, "outlook": {}, "scale": {}, "wind": {}, "payload_kg": self.payload_kg,
                "max_loss": 0.01, "accepted_loss": None, "reserve_frac": 0.15}  # fmt: skip

    def restore(self, kept: Any) -> None:
        self.restored = True
        self.payload_kg = kept.payload_kg


def one_requirement(autopilot_kind: Any, facts: Any) -> tuple[ParameterRequirement, ...]:
    """Return a failsafe requirement that is off until configured."""
    return (
        ParameterRequirement(
            ("LOW_ACT",),
            "a low-battery action is set",
            lambda v: None if v.get("LOW_ACT") is None else v["LOW_ACT"] == 2.0,
            lambda v: {"LOW_ACT": 2.0},
            True,
        ),
    )


@dataclass
class World:
    """A vehicle that obeys, its clock, and a log of all pilot actions."""

    pilot: Pilot
    judge: ScriptedJudge
    t_s: float = 0.0
    north: float = 0.0
    east: float = 0.0
    height: float = 0.0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mode: Mode = Mode.HOLD
    armed: bool = False
    failsafe: bool = False
    disarms: bool = True
    items: tuple[MissionItem, ...] = ()
    mission_id: int | None = None
    mission_state: ev.MissionState | None = None
    gnss_up_m: float | None = None
    """Error of the receiver's height; None: the receiver reports no height."""
    thrust_frac: float | None = None
    reads: int = 0
    takes_uploads: bool = True
    index: int = 0
    waited: float = 0.0
    speed: float = 10.0
    loaded: bool = True
    gripper_works: bool = True
    values: dict[str, float | None] = field(default_factory=lambda: {"LOW_ACT": 0.0})
    obeys_jumps: bool = True
    gnss: bool = True
    alt_amsl_m: float = DEPOT[2]
    pressure_pa: float = 101_180.0
    barometer_m: float = 0.0
    """What its drift adds to the height that is told."""
    board_temperature_c: float = 30.0
    streams: bool = True
    station: bool = True
    """A ground station's heartbeats reach the companion."""
    home_north: float = 0.0
    home_east: float = 0.0
    home_up: float = 0.0
    takes_home: bool = True
    leg: tuple[int, float] | None = None
    """The item that is flown, and the height above the depot that it had when it began."""
    volts: float | None = 22.0
    mute: set[type] = field(default_factory=set)
    log: list[tuple[float, Action]] = field(default_factory=list)
    answers: list[ev.Event] = field(default_factory=list)
    rewrite: Callable[[tuple[MissionItem, ...]], tuple[MissionItem, ...]] = lambda items: items

    def tell(self, event: ev.Event) -> list[Action]:
        """Pass the pilot one event; obey its orders."""
        actions = self.pilot.process_event(event)
        for action in actions:
            self.log.append((self.t_s, action))
            if isinstance(action, FindPlan):
                self.answers.append(
                    PlanFound(self.t_s, action.request_number, action.compute_plan())
                )
            if isinstance(action, Order):
                assert self.pilot.phase in COMMANDING_PHASES
                self.process_line(action)
        return actions

    def process_line(self, order: Order) -> None:
        match order:
            case RequestTelemetry():
                self.streams = True
                self.answers.append(ev.StreamsConfigured(self.t_s))
            case RequestParameters():
                self.answers.append(ev.AutopilotParameters(self.t_s, dict(self.values)))
            case SetParameters():
                self.values |= order.values
                self.answers += [
                    ev.ParametersSet(self.t_s),
                    ev.AutopilotParameters(self.t_s, dict(self.values)),
                ]
            case UploadMission() if not self.takes_uploads:
                self.answers.append(ev.MissionUploaded(self.t_s, "error"))
            case UploadMission():
                self.items = self.rewrite(order.items)
                self.index = self.index if self.armed else 0
                self.leg = None
                self.mission_id = None if self.mission_id is None else self.mission_id + 10
                self.answers.append(ev.MissionUploaded(self.t_s))
            case ClearMission():
                self.items = ()
                self.answers.append(ev.MissionUploaded(self.t_s))
            case VerifyMission():
                found = mission_differences(order.items, self.items)
                self.reads += 1
                self.answers.append(ev.MissionVerified(self.t_s, found))
            case SetMode():
                self.mode = order.mode
            case Arm():
                self.armed = True
            case Disarm():
                self.armed = self.armed and not self.disarms
            case JumpTo() if self.obeys_jumps:
                self.index, self.waited, self.leg = order.index, 0.0, None
            case SetHome() if self.takes_home:
                self.answers.append(ev.OrderAccepted(self.t_s, "set home"))
                self.home_up = order.alt_amsl_m - DEPOT[2]
                self.home_north = (order.lat_deg - DEPOT[0]) * M_PER_DEG
                east_deg = order.lon_deg - DEPOT[1]
                self.home_east = east_deg * M_PER_DEG * math.cos(math.radians(DEPOT[0]))
            case SetGroundSpeed():
                self.speed = order.ground_speed_mps
            case ReleaseParcel():
                self.loaded = self.loaded and not self.gripper_works
            case _:
                return

    def goal_height(self, item_height: float) -> float:
        """Return the goal height: above home at the item's start, as in both autopilots."""
        if self.leg is None or self.leg[0] != self.index:
            self.leg = (self.index, item_height + self.home_up)
        return self.leg[1]

    def fly(self, dt_s: float) -> None:
        """Follow the mission autonomously; in mode LAND descend on the spot."""
        self.velocity = (0.0, 0.0, 0.0)
        if self.armed and self.mode is Mode.LAND:
            down = min(2.0 * dt_s, self.height)
            self.height -= down
            self.velocity = (0.0, 0.0, down / dt_s)
            self.armed = self.height > 0.0 or not self.disarms
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
        goal_up = self.goal_height(item.spot.height_rel_m)
        if item.kind is ItemKind.LAND:
            goal_up = item.spot.height_rel_m  # down to the ground, for any home height
        away = math.dist((goal_n, goal_e), (self.north, self.east))
        step = min(away, self.speed * dt_s, 0.8 * away + 0.05)
        if away > 0.0:
            north, east = (goal_n - self.north) / away * step, (goal_e - self.east) / away * step
            self.velocity = (north / dt_s, east / dt_s, 0.0)
            self.north, self.east = self.north + north, self.east + east
        if item.kind is not ItemKind.LAND or away < 2.0:
            climb = max(-3.0 * dt_s, min(3.0 * dt_s, goal_up - self.height))
            self.height += climb
            self.velocity = (*self.velocity[:2], -climb / dt_s)
        if away < 2.0 and abs(self.height - goal_up) < 0.3:
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
        # A working sensor varies, and a pack under load sags.
        current = (power / 22.0 if self.armed else 0.5) + 0.02 * (round(t * 10) % 3)
        volts = None if self.volts is None else self.volts - PACK_OHM * current * self.armed
        found: list[ev.Event] = [
            ev.Attitude(t, 0.0, 0.0, 0.0),
            ev.Position(
                t,
                DEPOT[0] + self.north / M_PER_DEG,
                DEPOT[1] + self.east / M_PER_DEG / math.cos(math.radians(DEPOT[0])),
                self.alt_amsl_m + self.height + self.barometer_m,
                self.height - self.home_up + self.barometer_m,
                *self.velocity,
            ),
            ev.GnssFix(
                t,
                self.gnss,
                gnss_alt_m=None
                if self.gnss_up_m is None
                else self.alt_amsl_m + self.height + self.gnss_up_m,
            ),
            ev.Battery(t, voltage_v=volts, current_a=current),
            ev.MissionProgress(
                t, self.index, len(self.items), None, self.mission_id, self.mission_state
            ),
            ev.GroundState(
                t, VehicleLandedState.IN_AIR if self.height > 0.3 else VehicleLandedState.ON_GROUND
            ),
        ]
        if round(t * 10) % 5 == 0:
            found.append(ev.VehicleState(t, self.mode, self.mode.value, self.armed, self.failsafe))
        if self.thrust_frac is not None:
            found.append(ev.Throttle(t, self.thrust_frac))
        if not self.streams:
            found = [event for event in found if isinstance(event, ev.VehicleState)]
        if round(t * 10) % 10 == 0:
            found.append(ev.AirPressure(t, self.pressure_pa, self.board_temperature_c))
        if round(t * 10) % 20 == 0:
            lat_deg = DEPOT[0] + self.home_north / M_PER_DEG
            east_m_per_deg = M_PER_DEG * math.cos(math.radians(DEPOT[0]))
            lon_deg = DEPOT[1] + self.home_east / east_m_per_deg
            found.append(ev.Home(t, lat_deg, lon_deg, DEPOT[2] + self.home_up))
        if self.station and round(t * 10) % 10 == 0:
            found.append(ev.OperatorMessageReceived(t))
        return [event for event in found if type(event) not in self.mute]

    def reboot(self, mode: Mode) -> None:
        """Change the mode, and send no messages until they are requested again."""
        self.mode, self.armed, self.streams, self.answers = mode, False, False, []

    def with_pilot_of(self, again: "World", *also: str) -> "World":
        """Return the same vehicle with another companion process."""
        kept = ("t_s", "north", "east", "height", "items", "index", "waited", "loaded", "values")
        for name in (*kept, "mode", *also):
            setattr(again, name, getattr(self, name))
        return again

    @property
    def progress(self) -> MissionProgressMonitor:
        """Return the pilot's monitor of the mission's progress."""
        return self.pilot.parts.part_of_class(MissionProgressMonitor)

    @property
    def item(self) -> CurrentItem:
        """The mission item that is flown."""
        return self.pilot.parts.part_of_class(CurrentItem)

    @property
    def last_kept(self) -> Checkpoint:
        """Return the latest saved checkpoint."""
        return msgspec.convert(self.sent(SaveCheckpoint)[-1].content, Checkpoint)

    def said_of(self, kind: str) -> list[str]:
        """Return the reasons of the decisions of this kind."""
        return [a.reason for a in self.sent(Decision) if a.kind == kind]

    def step(self, dt_s: float = 0.1) -> None:
        """Advance by one tick of the autopilot's clock."""
        self.t_s = round(self.t_s + dt_s, 3)
        self.fly(dt_s)
        answers, self.answers = self.answers, []
        for event in (*answers, *self.telemetry(), ev.Tick(self.t_s)):
            self.tell(event)

    def run(self, until: Callable[["World"], bool], limit_s: float = 300.0) -> "World":
        """Fly until a condition is true."""
        end_s = self.t_s + limit_s
        while not until(self):
            assert self.t_s < end_s, f"never came: {self.pilot.phase}, {self.kinds}"
            self.step()
        return self

    def steps(self, count: int) -> None:
        for _ in range(count):
            self.step()

    def until(self, phase: Phase, limit_s: float = 300.0) -> "World":
        return self.run(lambda w: w.pilot.phase is phase, limit_s)

    def to_the_end(self) -> Finished:
        self.run(lambda w: w.sent(Finished))
        return next(a for _, a in self.log if isinstance(a, Finished))

    def sent(self, kind: Any, after_s: float = -1.0) -> list[Any]:
        """Return the actions of a kind after this time."""
        return [a for t, a in self.log if isinstance(a, kind) and t > after_s]

    def orders_after(self, t_s: float) -> list[Order]:
        return self.sent(Order, t_s)

    @property
    def kinds(self) -> list[str]:
        return [a.kind for _, a in self.log if isinstance(a, Decision)]

    @property
    def said(self) -> str:
        return "; ".join(a.text for _, a in self.log if isinstance(a, AlertReport))


def world(
    *,
    options: PilotOptions | None = None,
    kept: Checkpoint | None = None,
    flight: Flight = FLIGHT,
    armed: bool = False,
    judge: "ScriptedJudge | None" = None,
    requirements: RequirementsFunction = one_requirement,
) -> World:
    """Return a pilot with a scripted judge and a vehicle at the depot."""
    judge = judge or ScriptedJudge(RouteEnergy.for_mission(AIRFRAME, flight.mission, 1.225))
    pilot = Pilot(
        flight,
        AIRFRAME,
        WIND_PROCESS,
        obstacles=None,
        requirements=requirements,
        flight_digest="test",
        options=options or PilotOptions(configure=True, authorise=True),
        checkpoint=kept,
        estimates=judge,
    )
    made = World(pilot, judge, armed=armed)
    if not armed:
        start(made)
    return made


def start(made: World) -> None:
    """Let the pilot recognise the autopilot."""
    made.tell(ev.VehicleState(made.t_s, made.mode, made.mode.value, made.armed))
    made.tell(ev.AutopilotDetected(made.t_s, ev.AutopilotKind.PX4, 1))
