"""Safety rule 3 in the autopilot: its home stays where it was when the vehicle took off.

Items and RTL are flown at heights above the autopilot's home, and RTL to its place. Both autopilots
let anybody move it in flight (DO_SET_HOME), keep the leg that is being flown, and fly every later
item by the new home: 20 m lower it leads into the ground at the customer. So a home that has moved
closes the gate, and is set back once. Until telemetry shows it where it was, there is no leave and
no jump. Who moves it again means it: then the vehicle comes home by what is safe without it.

Where the promised landing place is not the launch pad, an RTL of ours is led to it: the place is
made the autopilot's home, at the height of the old one, just before RTL is ordered.

Our own heights do not depend on any of this (telemetry_state.py).
"""

import math
from dataclasses import dataclass
from typing import Any

from companion.core.base.geo import LocalFrame, horizontal_m
from companion.core.mission.actions import SetHome, SetMode, Severity
from companion.core.mission.events import (
    Event,
    Home,
    Mode,
    OrderAccepted,
    OrderRefused,
    Position,
)
from companion.core.mission.flight_plan import DEPOT_RADIUS_M
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import Airborne, FlightContext, GateState, Jumps, Preflight
from companion.core.pilot.transitions import (
    FLIGHT_PHASES,
    GROUND_PHASES,
    OUTWARD_PHASES,
    Phase,
    Trigger,
)

MOVED_M = 3.0
"""A home farther than this from where it was has been moved. What the autopilot sets at arming it
keeps to the millimetre; the least clearance of a drop is several times this."""

SURE_S = 1.0
"""A height that disagrees for so long is a fact: ten reports of GLOBAL_POSITION_INT."""

LEAD_S = 3.0
"""An RTL waits so long for the place that it is led to: three tries of the order."""

SET_HOME = "set home"
"""What the autopilot's answer calls the order."""

TOLD_S = 3.0
"""HOME_POSITION comes every 2 s: by then the home that arming has set was told."""

SET_BACK_S = 6.0
"""Setting it back is given up after so long: four tries a second apart, and one HOME_POSITION."""


Place = tuple[float, float, float]
"""Latitude, longitude (deg), AMSL (m) of the ground."""


@dataclass(slots=True)
class HomeState:
    """Where the vehicle stood, its home at take-off, and what was done about one that moved."""

    stood: Position | None = None
    took_off_from: Place | None = None
    """Where the home has to be, until an RTL is led elsewhere."""
    told: Place | None = None
    """The home by the last HOME_POSITION since."""
    off_since_s: float | None = None
    moved: str = ""
    set_back_s: float | None = None
    item_then: int | None = None
    given_up: bool = False
    led_to: Place | None = None
    """Where an RTL was led to; the home has to be there."""
    led_s: float | None = None
    """When, until the autopilot shows its home there: it may be at either place."""
    rtl_waits: bool = False
    """RTL is ordered once that place is taken."""


class HomeWatch:
    """Compares the autopilot's home with that at take-off, and sets it back once."""

    def __init__(
        self, gate: GateState, jumps: Jumps, flight: Airborne, preflight: Preflight
    ) -> None:
        self._state = HomeState()
        self._gate = gate
        self._jumps = jumps
        self._flight = flight
        self._preflight = preflight

    @property
    def in_doubt(self) -> bool:
        """The home has moved, or perhaps, and may still be set back."""
        return self._state.off_since_s is not None and not self._state.given_up

    @property
    def rtl_waits(self) -> bool:
        """RTL is ordered once the place that it is led to is the autopilot's home."""
        return self._state.rtl_waits

    def order_rtl(self, context: FlightContext) -> str:
        """Order RTL, led to the promised landing place; tells in words where it leads.

        `""`: home as ever. Where it is led, RTL follows once the autopilot has taken the place as
        its home: it finds its way when it begins.
        """
        words, place = self._where_to(context)
        if place is None:
            context.do(SetMode(Mode.RTL))
            return words
        state = self._state
        state.led_to, state.led_s, state.told, state.rtl_waits = place, context.t_s, None, True
        context.do(SetHome(*place))
        context.save()
        return words

    def to_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"took_off_from": self._state.took_off_from, "led_to": self._state.led_to}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        self._state.took_off_from = checkpoint.took_off_from
        self._state.led_to = checkpoint.led_to

    def on_event(self, context: FlightContext, event: Event) -> None:
        """The autopilot tells where its home is, or answers that it moves it."""
        state = self._state
        match event:
            case Home() if state.took_off_from is not None:
                state.told = (event.lat_deg, event.lon_deg, state.took_off_from[2])
                fresh = context.since_s(self._flight.took_off_s) <= TOLD_S
                if fresh and self._away_m() <= DEPOT_RADIUS_M:
                    state.took_off_from = state.told
            case OrderAccepted() | OrderRefused() if event.order == SET_HOME and state.rtl_waits:
                self._rtl_now(context)
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """On the ground remember where it stands; in flight watch its home."""
        if context.phase in GROUND_PHASES:
            self._stand(context)
        elif self._flight.flying and context.phase in (*FLIGHT_PHASES, Phase.SUSPENDED):
            self._begin(context)
            self._see_led(context)
            self._watch(context)

    # --- the ground that it takes off from -------------------------------------------------------

    def _stand(self, context: FlightContext) -> None:
        """Remember where it stands, until it is armed: a late heartbeat shows that in the climb."""
        context.telemetry.measure_heights_from(None)
        if context.phase is not Phase.ARM:
            self._state = HomeState(stood=context.telemetry.position)

    def _begin(self, context: FlightContext) -> None:
        """Fix the ground once: the home that arming has set, if that is where the vehicle stood."""
        state, telemetry = self._state, context.telemetry
        position = telemetry.position
        if telemetry.ground_amsl_m is not None or position is None:
            return
        if state.took_off_from is None:
            ground_m, stood = position.alt_amsl_m - position.height_rel_m, state.stood or position
            if state.stood is not None and abs(state.stood.alt_amsl_m - ground_m) > MOVED_M:
                ground_m = state.stood.alt_amsl_m
            state.took_off_from = (stood.lat_deg, stood.lon_deg, ground_m)
            context.save()
        telemetry.measure_heights_from(state.took_off_from[2])

    # --- an RTL that is led ----------------------------------------------------------------------

    def _where_to(self, context: FlightContext) -> tuple[str, Place | None]:
        """Where an RTL from here is led to, and in words; None: where the autopilot's home is.

        That is the launch pad where somebody else moves the home, or an RTL does not suit the
        promised place.
        """
        state, flown, here = self._state, context.flight_plan, context.here_ned()
        index = self._jumps.index
        if flown is None or index is None or state.took_off_from is None:
            return "", None
        name, spot = flown.landing_from(index)
        if spot is None:
            return "", None
        place = (spot.lat_deg, spot.lon_deg, state.took_off_from[2])
        if _apart_m(place, state.took_off_from) <= DEPOT_RADIUS_M:
            return "", None
        ground = flown.spot_ned(spot)
        if state.moved or here is None or not flown.suits_rtl(here, ground):
            return f": to the launch pad, not to {name}", None
        return f": to {name}, made the autopilot's home", place

    def _rtl_now(self, context: FlightContext) -> None:
        """Unless the vehicle is no longer ours to send home."""
        self._state.rtl_waits = False
        if context.phase is Phase.LAST_RESORT:
            context.do(SetMode(Mode.RTL))

    def _see_led(self, context: FlightContext) -> None:
        """RTL, when its place is taken or waited for long; what the autopilot shows decides where
        the home has to be.
        """
        state = self._state
        if state.led_s is None or state.led_to is None or state.took_off_from is None:
            return
        waited_s, told = context.since_s(state.led_s), state.told
        taken = told is not None and _apart_m(told, state.led_to) <= MOVED_M
        if state.rtl_waits and (taken or waited_s > LEAD_S):
            self._rtl_now(context)
        if taken:
            state.led_s = None
        elif told is not None and waited_s > SET_BACK_S:
            state.led_s = state.led_to = None
            context.say(Severity.WARNING, "home not taken: RTL to the launch pad")
            words = "the autopilot shows its old home: RTL to the launch pad"
            context.decide("home_not_led", words)

    # --- a home that has moved -------------------------------------------------------------------

    def _watch(self, context: FlightContext) -> None:
        state = self._state
        words = self._how(context)
        if not words:
            state.off_since_s = None
            if state.moved:
                self._is_back(context)
            return
        if state.off_since_s is None:
            state.off_since_s = context.t_s
        if context.since_s(state.off_since_s) < SURE_S:
            return
        if not state.moved:
            self._has_moved(context, words)
        if context.phase in FLIGHT_PHASES and not state.given_up:
            self._set_back(context)

    def _away_m(self) -> float:
        """How far the home is from where it has to be, horizontally, as it was told."""
        state = self._state
        if state.told is None or state.took_off_from is None:
            return 0.0
        away_m = _apart_m(state.told, state.led_to or state.took_off_from)
        taken = state.led_s is None
        return away_m if taken else min(away_m, _apart_m(state.told, state.took_off_from))

    def _how(self, context: FlightContext) -> str:
        """How far the home is from where it has to be, in words; `""`: it is there."""
        sunk_m, away_m = context.telemetry.home_sunk_m, self._away_m()
        if away_m > MOVED_M:
            return f"home moved {away_m:.0f} m away"
        if abs(sunk_m) > MOVED_M:
            return f"home moved {abs(sunk_m):.0f} m {'down' if sunk_m > 0.0 else 'up'}"
        return ""

    def _has_moved(self, context: FlightContext, words: str) -> None:
        self._state.moved = words
        self._state.item_then = self._jumps.index
        self._gate.close(words)
        context.say(Severity.CRITICAL, f"{words} by another")
        context.decide("home_moved", words)

    def _set_back(self, context: FlightContext) -> None:
        """Order it back the first time; give it up when that does not show, or not last."""
        state = self._state
        place = state.led_to or state.took_off_from
        assert place is not None
        if state.set_back_s is None:
            state.set_back_s = context.t_s
            context.do(SetHome(*place))
        elif context.since_s(state.set_back_s) > SET_BACK_S:
            self._give_up(context)

    def _is_back(self, context: FlightContext) -> None:
        """Go on; a leg home that was begun at heights above the wrong home is begun again."""
        state = self._state
        state.moved, state.given_up = "", False
        context.say(Severity.NOTICE, "home is where it was again")
        context.decide("home_back", "the autopilot's home is where it was at take-off")
        index = self._jumps.index
        homeward = context.phase in (Phase.RETURN, Phase.DIVERT)
        if homeward and index is not None and index != state.item_then:
            self._jumps.jump_home(context, index)

    def _give_up(self, context: FlightContext) -> None:
        """It stays moved. A higher home only leads higher, but items above a lower one lead low.

        RTL never goes below the present height on the way (both autopilots take the higher of that
        and their RTL altitude), so that is the way home where it still leads to the right place.
        """
        state = self._state
        state.given_up = True
        context.say(Severity.CRITICAL, f"cannot set home back: {state.moved}")
        context.decide("home_stays_moved", state.moved)
        low = context.telemetry.home_sunk_m > MOVED_M
        if not low or self._away_m() > MOVED_M or not self._preflight.rtl_is_safe:
            return
        if context.phase in OUTWARD_PHASES:
            context.request_transition(Trigger.HOMEWARD, state.moved)
        context.request_transition(Trigger.WAY_HOME_REFUSED, state.moved)


def _apart_m(place: Place, other: Place) -> float:
    """How far apart two places are, horizontally."""
    lat_deg, lon_deg, amsl_m = other
    frame = LocalFrame(math.radians(lat_deg), math.radians(lon_deg), amsl_m)
    there = frame.to_ned(math.radians(place[0]), math.radians(place[1]), amsl_m)
    return horizontal_m(there, (0.0, 0.0, 0.0))
