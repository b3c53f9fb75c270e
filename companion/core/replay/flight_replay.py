"""Replay of a recorded flight through the companion's own estimators, energy ledger and gate.

The code that runs here is the code that flies: `Estimates` takes the same events in the same order
at the same times, and the gate is asked about what was ahead then. Nothing is commanded. The
decisions show what Leeway would have decided, and when.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.base.arrays import Bools, Floats
from companion.core.base.geo import LocalFrame, Ned, horizontal_m
from companion.core.mission.actions import Decision
from companion.core.mission.events import Airspeed, Attitude, AutopilotKind, AutopilotWind
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan, frame_of, make_plan, ned_of, site_map
from companion.core.mission.preflight_checks import pack_trouble
from companion.core.pilot.estimates import Estimates
from companion.core.pilot.return_decision import RecordedAssessment, beats_depot, moved_since
from companion.core.pilot.telemetry_state import (
    BATTERY_MAX_AGE_S,
    POSITION_MAX_AGE_S,
    TelemetryState,
)
from companion.core.replay.recorded_flight import LogFinding, RecordedFlight, moments
from companion.core.replay.route import Planned, Route, Unplanned
from companion.core.return_budget.budget import Assessment
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3, air_at
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.observation import WindFilter
from companion.core.wind.process import WindProcessParams

TICK_S = 0.1
"""The same as in flight."""

LEAST_HEIGHT_M = 2.0
NO_ENERGY = "nothing said about energy and the way home"


@dataclass(frozen=True, slots=True)
class ReplayTerms:
    """What is replayed with what.

    `flight`: limits, parcel and what the vehicle has. `planned`: its site is where the log was
    flown; else home is the take-off point. `with_energy` is False where nobody said which airframe
    it is: drag may be guessed, a battery may not. `wind_filter`: a new estimator for this replay,
    in the place of the one that flies.
    """

    airframe: Airframe
    flight: Flight
    wind_process: WindProcessParams
    planned: bool
    with_energy: bool
    obstacles: dict[str, object] | None = None
    gate_every_s: float = 5.0
    wind_filter: WindFilter | None = None


@dataclass(frozen=True, slots=True)
class Moment:
    """One point of the time line; energies in Wh, `None` while unknown."""

    t_s: float
    airborne: bool
    height_m: float | None
    home_m: float | None
    energy_left_wh: float | None
    energy_std_wh: float | None
    used_wh: float | None
    seen: Assessment | None


@dataclass(slots=True)
class ReplayResult:
    """`wind_*` (n,) rows at every tick from the first valid belief on; `in_air` marks those in
    flight, `flown_s` how long it had flown by then. `air_time_s`: how long the log has it flying.
    """

    wind_t_s: Floats
    wind_to_ne_mps: Floats
    wind_cov_m2ps2: Floats
    in_air: Bools
    flown_s: Floats
    max_loss: float
    reserve_wh: float | None
    air_time_s: float = 0.0
    moments: list[Moment] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    notes: list[tuple[float, str]] = field(default_factory=list)
    findings: list[LogFinding] = field(default_factory=list)


def replay(
    log: RecordedFlight, terms: ReplayTerms, progress: Callable[[float], None] | None = None
) -> ReplayResult:
    """Run the companion's judgement over a log; `progress` hears the share that is done."""
    return _Replay(_as_used(log), terms).run(progress)


def _as_used(log: RecordedFlight) -> RecordedFlight:
    """A vehicle that does not lean against the wind tells nothing by its attitude."""
    if log.flies_by_tilt:
        return log
    events = tuple(e for e in log.events if not isinstance(e, Attitude))
    said = LogFinding(
        "log", f"a {log.vehicle}, multirotor expected", "its attitude, energy and way home left out"
    )
    return replace(log, events=events, findings=(*log.findings, said))


class _Replay:
    """The state of one run."""

    def __init__(self, log: RecordedFlight, terms: ReplayTerms) -> None:
        self._log, self._terms = log, terms
        speed = terms.flight.mission.cruise_airspeed_mps
        self._route_energy = RouteEnergy(terms.airframe, REFERENCE_DENSITY_KGPM3, speed)
        self._judge = Estimates(
            terms.flight,
            terms.airframe,
            self._route_energy,
            terms.wind_process,
            terms.wind_filter,
        )
        self._route: Route | None = None
        self._home: LocalFrame | None = None
        self._gates = terms.with_energy and log.flies_by_tilt and log.has_battery
        self._autopilot_kind = (
            log.autopilot_kind or AutopilotKind.ARDUPILOT
        )  # PX4's percentage may be a timer
        self._flying = False
        self._flew_s = 0.0
        self._closed = False
        self._diverted = False
        self._stage = ""
        self._noted: RecordedAssessment | None = None
        self._asked_s: float | None = None
        self._seen: Assessment | None = None
        self._pack_judged = False
        self._another_mission = False
        self._wind: list[tuple[float, ...]] = []
        self._moments: list[Moment] = []
        self._decisions: list[Decision] = []
        self._notes: list[tuple[float, str]] = []
        self._findings: list[LogFinding] = list(log.findings)
        self._say_what_is_missing(log)

    def _say_what_is_missing(self, log: RecordedFlight) -> None:
        if not log.has_battery:
            what, said = (
                "no battery voltage",
                "nothing said about energy and the way home",
            )
        elif not log.powered:
            what, said = "no battery current", "energy by the power model"
        else:
            what = said = ""
        if what and log.flies_by_tilt:
            self._findings.append(LogFinding("log", what, said))
        if not log.has(Airspeed) and not log.has(AutopilotWind):
            what = "no airspeed sensor and no wind of the autopilot's own"
            self._findings.append(LogFinding("log", what, "wind from the tilt alone"))

    def run(self, progress: Callable[[float], None] | None) -> ReplayResult:
        start_s, duration_s = self._log.start_s, max(self._log.duration_s, 1e-9)
        before_s: float | None = None
        for now in moments(self._log, TICK_S, self._terms.airframe.battery.plausible_v):
            self._tick(now, 0.0 if before_s is None else now.t_s - before_s)
            before_s = now.t_s
            if progress is not None:
                progress((now.t_s - start_s) / duration_s)
        if self._flying:
            said = "no word on the landing"
            what = "the log ends in the air, or before it says landed"
            self._findings.append(LogFinding.at(before_s or 0.0, what, said))
        rows = np.array(self._wind, float).reshape(len(self._wind), 8)
        return ReplayResult(
            rows[:, 0],
            rows[:, 1:3],
            rows[:, [3, 4, 4, 5]].reshape(-1, 2, 2),
            rows[:, 6] > 0.5,
            rows[:, 7],
            self._judge.limits.max_loss,
            self._reserve_wh(),
            self._flew_s,
            self._moments,
            self._decisions,
            self._notes,
            self._findings,
        )

    def _reserve_wh(self) -> float | None:
        energy = self._judge.energy if self._gates else None
        return None if energy is None else self._judge.limits.reserve_frac * energy.usable_full_wh

    # --- a tick --------------------------------------------------------------------------------

    def _tick(self, now: TelemetryState, dt_s: float) -> None:
        self._mind_take_off(now)
        if self._flying:
            self._flew_s += dt_s
        self._notes += [
            (now.t_s, words) for words in self._judge.observe(now, self._autopilot_kind)
        ]
        wind = self._judge.wind
        if wind is not None and (wind.valid or self._wind):
            cov = wind.cov_ne_m2ps2
            mean = wind.mean_to_ne_mps
            self._wind.append(
                (
                    now.t_s,
                    float(mean[0]),
                    float(mean[1]),
                    float(cov[0, 0]),
                    float(cov[0, 1]),
                    float(cov[1, 1]),
                    float(self._flying),
                    self._flew_s,
                )
            )
        here = self._look(now)
        every_s = self._terms.gate_every_s - 1e-6
        if self._asked_s is None or now.t_s - self._asked_s >= every_s:
            self._ask(now, here)

    def _mind_take_off(self, now: TelemetryState) -> None:
        if not now.airborne and self._gates and not self._pack_judged:
            self._judge_pack(now)
        if now.airborne and not self._flying:
            self._flying = True
            self._settle_air(now)
            self._find_home(now)
            if self._gates:
                self._decide(now.t_s, "take_off", "in the air")
        elif self._flying and not now.airborne:
            self._flying = False
            self._land(now)

    def _settle_air(self, now: TelemetryState) -> None:
        """The air at take-off, as the ground sequence settles it; unknown: the airframe file's."""
        position, heard = now.position, now.pressure
        if position is None or not self._log.position_measured:
            return
        measured = (heard.pressure_pa, heard.board_temperature_c) if heard else (None, None)
        stated_c = self._terms.flight.site.air_temperature_c
        air = air_at(position.alt_amsl_m, *measured, stated_c)
        self._judge.fly_in(air)
        self._notes.append((now.t_s, str(air)))

    def _land(self, now: TelemetryState) -> None:
        energy, reserve_wh = self._judge.energy, self._reserve_wh()
        if energy is not None and reserve_wh is not None:
            left_wh = energy.mean_wh - reserve_wh
            where = "landed"
            if self._home is not None and now.position is not None:
                away_m = horizontal_m(ned_of(self._home, now.position), (0.0, 0.0, 0.0))
                where = f"landed {away_m:.0f} m from where it took off"
            reason = f"{where}, {left_wh:+.1f} Wh above the reserve"
            self._decisions.append(Decision(now.t_s, "landed", reason, margin_wh=left_wh))
        self._closed = self._diverted = False
        self._seen, self._noted, self._route, self._stage = None, None, None, ""

    def _judge_pack(self, now: TelemetryState) -> None:
        """Another pack than the airframe's makes every number of energy wrong."""
        battery = now.battery
        if battery is None or battery.voltage_v is None:
            return
        self._pack_judged = True
        trouble = pack_trouble(self._terms.airframe.battery, battery.voltage_v)
        if trouble and not trouble.startswith("the battery is empty"):
            self._gates = False
            self._findings.append(LogFinding.at(now.t_s, trouble, NO_ENERGY))

    # --- home and the way there ----------------------------------------------------------------

    def _find_home(self, now: TelemetryState) -> None:
        position = now.position
        if position is None:
            return
        self._home = LocalFrame(
            math.radians(position.lat_deg),
            math.radians(position.lon_deg),
            position.alt_amsl_m - position.height_rel_m,
        )
        if not self._gates:
            return
        self._route = Unplanned(self._home)
        if self._terms.planned:
            flown = self._plan(now)
            if isinstance(flown, NoRoute):
                said = "home is the take-off point"
                what = f"the flight file's mission does not go: {flown.reason}"
                self._findings.append(LogFinding.at(now.t_s, what, said))
            else:
                self._route = Planned(flown, self._terms.flight, self._route_energy)

    def _plan(self, now: TelemetryState) -> FlightPlan | NoRoute:
        flight = self._terms.flight
        assert now.position is not None
        frame = frame_of(flight, now.position)
        site = site_map(flight, frame, self._terms.obstacles)
        planner = BerPlanner(self._route_energy)
        reserve_frac = self._judge.limits.reserve_frac
        return make_plan(flight, site, planner, self._judge.energy, reserve_frac)

    def _look(self, now: TelemetryState) -> Ned | None:
        """Where the vehicle is on its way; decides where it came to another part of it."""
        route = self._route
        if route is None or not self._flying or not now.is_fresh(now.position, POSITION_MAX_AGE_S):
            return None
        here = route.look(now)
        if isinstance(route, Planned):
            self._mind_mission(now, route)
            self._mind_delivery(now, route)
            stage = route.step
            if stage != self._stage and here is not None:
                self._stage_changed(now, here, stage)
        return here

    def _mind_mission(self, now: TelemetryState, route: Planned) -> None:
        aboard = route.another_mission
        if aboard is None or self._another_mission:
            return
        self._another_mission = True
        what = f"the mission aboard has {aboard} items, the flight file's plan {route.items}"
        said = "where it is on its way is told by its place"
        self._findings.append(LogFinding.at(now.t_s, what, said))

    def _mind_delivery(self, now: TelemetryState, route: Planned) -> None:
        if route.delivered and self._judge.payload_kg > 0.0:
            self._judge.payload_kg = 0.0
            self._decide(now.t_s, "delivered", route.delivered)

    def _stage_changed(self, now: TelemetryState, here: Ned, stage: str) -> None:
        """The pilot asks before each leg: so does the replay."""
        before, self._stage = self._stage, stage
        route = self._route
        assert route is not None
        if before == "settle" and stage.startswith("outbound"):
            seen = self._judge.depart(route.ahead(here, self._judge.payload_kg))
            self._take(now.t_s, seen)
            self._decide(now.t_s, "go", seen.reason if seen else "wind or energy unknown")
        elif before.startswith("outbound") and stage.startswith(("outbound", "deliver")):
            self._ask(now, here)
            kind = "onward" if stage.startswith("outbound") else "descend"
            self._decide(now.t_s, kind, self._seen.reason if self._seen else "unknown")
        elif stage in ("return", "divert", "land"):
            if before == "release" and self._judge.payload_kg > 0.0:
                said = "the parcel counts as aboard: returning loaded"
                self._decide(now.t_s, "release_unconfirmed", said)
            self._ask(now, here)
            if stage != "land":
                self._decide(now.t_s, f"flies_{stage}", "the vehicle went that way")

    # --- the gate ------------------------------------------------------------------------------

    def _ask(self, now: TelemetryState, here: Ned | None) -> None:
        self._asked_s = now.t_s
        energy = self._judge.energy if self._gates else None
        fresh: Assessment | None = None
        high = now.position is not None and now.position.height_rel_m > LEAST_HEIGHT_M
        if here is not None and self._route is not None and self._flying and high:
            heard = now.is_fresh(now.battery, BATTERY_MAX_AGE_S)
            if self._gates and heard:
                fresh = self._judge.assess(self._route.ahead(here, self._judge.payload_kg))
        self._take(now.t_s, fresh)
        if fresh is not None and here is not None:
            self._mind_rally(now.t_s, here, fresh)
        self._moments.append(
            Moment(
                now.t_s,
                self._flying,
                None if now.position is None else now.position.height_rel_m,
                self._home_m(now),
                None if energy is None else energy.mean_wh,
                None if energy is None else energy.std_wh,
                None if energy is None else energy.used_wh,
                fresh,
            )
        )

    def _mind_rally(self, t_s: float, here: Ned, seen: Assessment) -> None:
        """Say once when only a rally point keeps the promise (as the pilot's `rally_instead`)."""
        route = self._route
        if self._diverted or not isinstance(route, Planned) or seen.best_landing == route.landing:
            return
        homeward = route.stage in ("return", "divert")
        if not homeward and not (route.outward and self._closed):
            return
        if not route.sees(seen.best_landing, here):
            return
        only = route.depot_only(here, self._judge.payload_kg)
        depot = self._judge.assess(only) if only is not None else None
        if depot is None or beats_depot(seen, depot, self._judge.limits.max_loss):
            self._diverted = True
            self._decide(t_s, "divert", f"to {seen.best_landing}: the depot is out of the promise")

    def _home_m(self, now: TelemetryState) -> float | None:
        if self._home is None or now.position is None:
            return None
        return horizontal_m(ned_of(self._home, now.position), (0.0, 0.0, 0.0))

    def _take(self, t_s: float, seen: Assessment | None) -> None:
        """What the gate says now, and whether that is a decision."""
        self._seen = seen
        wind = self._judge.wind
        if seen is None or wind is None:
            return
        wind_ne = (float(wind.mean_to_ne_mps[0]), float(wind.mean_to_ne_mps[1]))
        outward = not isinstance(self._route, Planned) or self._route.outward
        if seen.turn_back and outward and not self._closed:
            self._closed = True
            self._decide(t_s, "turn_back", seen.reason)
        elif self._noted is None and not isinstance(self._route, Planned):
            self._decide(t_s, "gate_open", seen.reason)
        elif self._noted is not None and (moved := moved_since(self._noted, seen, wind_ne)):
            self._decide(t_s, "looked_again", f"{moved}: {seen.reason}")
        else:
            if self._noted is None:
                self._noted = RecordedAssessment(seen.margin_wh, wind_ne)
            return
        self._noted = RecordedAssessment(seen.margin_wh, wind_ne)

    def _decide(self, t_s: float, kind: str, reason: str) -> None:
        seen = self._seen
        self._decisions.append(
            Decision(
                t_s,
                kind,
                reason,
                seen.p_home if seen else None,
                seen.p_home_now if seen else None,
                seen.p_success if seen else None,
                seen.margin_wh if seen else None,
            )
        )
