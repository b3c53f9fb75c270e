"""The end: see the vehicle down, give the autopilot its settings back, say how it ended.

Down is what several sources agree on: disarmed, and by landed-state, height and speed on the ground
(`FlightContext.against_standing`). Nothing is configured before.
"""

from dataclasses import dataclass

from companion.core.base.geo import Ned, horizontal_m
from companion.core.mission.actions import Disarm, Finished, Note, Severity
from companion.core.mission.events import Ground
from companion.core.mission.flight_plan import FlightPlan
from companion.core.monitor.figures import FlightFigures
from companion.core.pilot.context import (
    GROUND_HEIGHT_M,
    STANDING_MPS,
    Airborne,
    Disarming,
    FlightContext,
    Parcel,
    PositionWatch,
    Promise,
    SettingsRestore,
)
from companion.core.pilot.telemetry_state import STATE_MAX_AGE_S
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase, Trigger
from companion.core.routing.route_planner import Plan
from companion.core.vehicle.energy_ledger import EnergyBelief

LANDED_AFTER_S = 5.0
STILL_S = 15.0
STILL_MPS = 0.4
SINKS_M = 1.0
"""Nothing that comes down keeps its height so well for `STILL_S`: the slowest landing, 0.3 m/s,
makes 4.5 m of it."""
DRIFT_M = 3.0
"""What stands is told higher or lower by so much as its barometer drifts: 1.5 m in a quarter of an
hour behind a front (simulated)."""
STILL_ARMED_S = 40.0
BY_HAND_S = 120.0
"""Wait for a person to walk up and disarm it: only then does the autopilot get its settings back.
Its outcome is not told before, and nobody sends it off again.
"""

DISARMED_S = 1.0
"""Disarmed for so long: at 1 Hz a false heartbeat has been followed by another."""

DISARMED_ANYWHERE_S = 15.0
"""Disarmed at every heartbeat for so long it is down, wherever the ground is: without its motors
it falls from 120 m in 5 s. Needed where it stands on ground of unknown height, or where a detector
or the position says nothing true any more.
"""

DISARM_EVERY_S = 5.0
DISARMS = 3
HOME_RADIUS_M = 30.0
CRASH_HEIGHT_M = 4.0
RESTORE_LIMIT_S = 4.0


@dataclass(slots=True)
class LandingState:
    """How far down it is: since when still, and what was ordered."""

    still_since_s: float | None = None
    rest_down_m: float | None = None
    """The height that it had when it came to rest, as it was told."""
    disarm_asked_s: float | None = None
    disarms_asked: int = 0
    disarm_by_hand_said: bool = False
    landed_s: float | None = None
    energy_touched_down: EnergyBelief | None = None
    energy_landed: EnergyBelief | None = None
    landed_by_person: bool = False
    """A person had taken over, and it came down under that hand."""


class Landing:
    """Ends the flight."""

    def __init__(
        self,
        flight: Airborne,
        parcel: Parcel,
        promise: Promise,
        position: PositionWatch,
        settings: SettingsRestore,
        disarming: Disarming,
    ) -> None:
        self._state = LandingState()
        self._flight = flight
        self._parcel = parcel
        self._promise = promise
        self._position = position
        self._settings = settings
        self._disarming = disarming

    def tick(self, context: FlightContext) -> None:
        """See it down: disarmed, or standing still on the ground; never a forced disarm.

        Where another hand brought it down nothing is ordered, and that hand ends the flight: people
        are told that it stands there armed.
        """
        state, telemetry = self._state, context.telemetry
        if telemetry.state is None:
            return
        if not telemetry.state.armed:
            self._see_disarmed(context)
            return
        ours = context.phase in (Phase.LAND, Phase.LAST_RESORT)
        if not ours and not (context.phase is Phase.SUSPENDED and self._flight.flying):
            return
        down = telemetry.ground is not None and telemetry.ground.ground is Ground.ON_GROUND
        if not (down or self._stands_still(context)):
            state.still_since_s = state.energy_touched_down = None
            return
        if state.still_since_s is None:
            state.still_since_s = context.t_s
            state.energy_touched_down = context.estimates.energy
        waited_s = context.since_s(state.still_since_s)
        if waited_s < (LANDED_AFTER_S if down else STILL_S):
            return
        again = context.since_s(state.disarm_asked_s) > DISARM_EVERY_S
        if ours and again and state.disarms_asked < DISARMS:
            state.disarm_asked_s = context.t_s
            state.disarms_asked += 1
            context.do(Note("on the ground and still armed: plain disarm"), Disarm())
        if waited_s > STILL_ARMED_S and not state.disarm_by_hand_said:
            state.disarm_by_hand_said = True
            context.say(Severity.WARNING, "landed, still armed: disarm by hand")
        if ours and waited_s > STILL_ARMED_S + BY_HAND_S:
            self._landed(context)

    def _see_disarmed(self, context: FlightContext) -> None:
        """Disarmed: down when everything else agrees, or after long."""
        telemetry = context.telemetry
        if not telemetry.is_fresh(telemetry.state, STATE_MAX_AGE_S):
            return
        disarmed_s = context.since_s(telemetry.disarmed_since_s)
        stands = disarmed_s >= DISARMED_S - 1e-6 and not context.against_standing()
        if stands or disarmed_s >= DISARMED_ANYWHERE_S or self._state.landed_s is not None:
            self._landed(context)

    def conclude(self, context: FlightContext, why: str) -> None:
        """The mission is over: the outcome by our own record (docs/reference/outcomes.md)."""
        plan = context.flight_plan
        if not self._flight.flying or plan is None:
            self._finish(context, "ABRT", why or "never took off", home=True)
            return
        home, where = self._at_home(context, plan)
        energy = self._state.energy_landed or context.estimates.energy
        margin_wh = None
        if energy is not None:
            reserve_wh = context.estimates.limits.reserve_frac * energy.usable_full_wh
            margin_wh = energy.mean_wh - reserve_wh
            where += f", {margin_wh:.1f} Wh above the reserve"
            home = home and margin_wh >= 0.0
        outcome = self._outcome(home=home)
        figures = context.estimates.figures()
        self._finish(context, outcome, where, home=home, margin_wh=margin_wh, figures=figures)

    def _outcome(self, *, home: bool) -> str:
        """By delivery and home; where a person landed it elsewhere and whole it is no loss."""
        delivered = self._parcel.delivered
        if home:
            return "SUC" if delivered else "ABRT"
        if self._state.landed_by_person and not self._disarming.disarmed_in_air:
            return "TAKEN"
        return "DEL" if delivered else "FAIL"

    def _at_home(self, context: FlightContext, plan: FlightPlan) -> tuple[bool, str]:
        """Whether it stands where it was promised, and where it is, in words."""
        position = context.telemetry.position
        if self._disarming.disarmed_in_air:
            return False, "disarmed in the air"
        if self._position.is_lost:
            return False, f"position lost, {self._position.last_seen()}"
        if position is None:
            return False, "position unknown"
        here = plan.ned_of(position)
        places = promised_places(plan.plan, self._promise.noted_home)
        name, place = min(places, key=lambda p: horizontal_m(here, p[1]))
        away_m = horizontal_m(here, place)
        high_m = place[2] - here[2]
        home = away_m <= HOME_RADIUS_M and high_m < CRASH_HEIGHT_M
        return home, f"{away_m:.0f} m from {name}"

    def _finish(
        self,
        context: FlightContext,
        outcome: str,
        reason: str,
        *,
        home: bool,
        margin_wh: float | None = None,
        figures: FlightFigures | None = None,
    ) -> None:
        parcel = self._parcel
        context.decide("finished", f"{outcome}: {reason}")
        loaded = context.flight.vehicle.payload_kg > 0.0
        unproven = parcel.drop_begun and not parcel.delivered and loaded
        context.do(
            Finished(
                outcome,
                parcel.delivered,
                reason,
                home,
                margin_wh,
                unproven,
                took_off_s=self._flight.took_off_s,
                figures=figures,
            )
        )

    def _stands_still(self, context: FlightContext) -> bool:
        """Whether it lies where it came to rest, near the ground: that it does not move.

        Who has stood for `STILL_S` stands until it moves as nothing does that stands: what is told
        of its place goes on drifting, and a receiver at rest says 0.1 to 0.3 m/s.
        """
        state, here = self._state, context.here_ned()
        if here is None:
            state.rest_down_m = None
            return False
        stood = state.rest_down_m is not None and context.since_s(state.still_since_s) >= STILL_S
        slow = context.speed_mps() < (STANDING_MPS if stood else STILL_MPS)
        if state.rest_down_m is None:
            near = abs(context.height_m(here)) <= GROUND_HEIGHT_M
            state.rest_down_m = here[2] if slow and near else None
        elif not slow or abs(here[2] - state.rest_down_m) > (DRIFT_M if stood else SINKS_M):
            state.rest_down_m = None
        return state.rest_down_m is not None

    def _landed(self, context: FlightContext) -> None:
        """Put the autopilot's settings back (only under our own authority), then end."""
        state = self._state
        if state.landed_s is None:
            state.landed_s = context.t_s
            # At touch-down: what idles on the ground is no part of the flight.
            state.energy_landed = state.energy_touched_down or context.estimates.energy
            taken = context.phase is Phase.SUSPENDED
            state.landed_by_person = taken and not self._disarming.failsafe_flies
            context.decide("landed", "on the ground")
            if self._settings.settings_before:
                self._put_settings_back(context)
        if not self._settings.restoring or context.since_s(state.landed_s) > RESTORE_LIMIT_S:
            context.request_transition(Trigger.LANDED, "landed")

    def _put_settings_back(self, context: FlightContext) -> None:
        """Give the autopilot its own settings, or say which ones it does not get, and why."""
        state = context.telemetry.state
        armed = state is None or state.armed
        if context.phase in (*FLIGHT_PHASES, Phase.RECOGNISE) and not armed:
            self._settings.put_settings_back(context)
            return
        why = "still armed" if armed else "another hand has the vehicle"
        context.say(Severity.WARNING, f"settings not put back: {why}")
        settings = self._settings.settings_before
        before = ", ".join(f"{name} {value:g}" for name, value in settings.items())
        context.do(Note(f"settings before the flight: {before}"))
        context.do(Note("`companion restore` puts them back once it is disarmed"))


def promised_places(plan: Plan, home: str | None) -> list[tuple[str, Ned]]:
    """Where it may come down, by name: the end of what is aboard, and declared rally points."""
    stops = {stop.name for stop in plan.stops}
    places = [(s.name, s.ground_ned_m) for s in plan.sites if s.name == home or s.name not in stops]
    return places if home in dict(places) else [(plan.landing, plan.landing_ned_m), *places]
