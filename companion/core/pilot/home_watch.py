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

from companion.core.base.geo import LocalFrame, horizontal_m, over
from companion.core.mission.actions import SetHome, Severity
from companion.core.mission.events import Event, Home, Position
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
    """Where the home has to be: where it took off, or where an RTL was led to."""
    told: Place | None = None
    """The home by the last HOME_POSITION since."""
    off_since_s: float | None = None
    moved: str = ""
    set_back_s: float | None = None
    item_then: int | None = None
    given_up: bool = False
    led_s: float | None = None
    led_from: Place | None = None
    """When an RTL was led elsewhere, until the autopilot shows that as home; and from where."""


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

    def lead_rtl(self, context: FlightContext) -> str:
        """Make the promised landing place the autopilot's home, for an RTL that is ordered next.

        Tells in words where it leads; `""`: home as ever. It leads to the launch pad all the same
        where the straight way at this height is not clear, or somebody else moves the home.
        """
        state, flown, here = self._state, context.flight_plan, context.here_ned()
        if flown is None or state.took_off_from is None:
            return ""
        name, spot = flown.landing_from(self._jumps.index)
        if spot is None:
            return ""
        place = (spot.lat_deg, spot.lon_deg, state.took_off_from[2])
        if _apart_m(place, state.took_off_from) <= DEPOT_RADIUS_M:
            return ""
        if (
            here is None
            or state.moved
            or not flown.is_clear(here, over(flown.spot_ned(spot), here))
        ):
            return f": to the launch pad, not to {name}"
        state.led_from, state.led_s, state.took_off_from = state.took_off_from, context.t_s, place
        state.off_since_s = None
        context.do(SetHome(*place))
        context.save()
        return f": to {name}, made the autopilot's home"

    def to_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"took_off_from": self._state.took_off_from}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        self._state.took_off_from = checkpoint.took_off_from

    def on_event(self, context: FlightContext, event: Event) -> None:
        """The autopilot tells where its home is."""
        state = self._state
        if not isinstance(event, Home) or state.took_off_from is None:
            return
        state.told = (event.lat_deg, event.lon_deg, state.took_off_from[2])
        if self._away_m() <= DEPOT_RADIUS_M and context.since_s(self._flight.took_off_s) <= TOLD_S:
            state.took_off_from = state.told

    def tick(self, context: FlightContext) -> None:
        """On the ground remember where it stands; in flight watch its home."""
        if context.phase in GROUND_PHASES:
            self._stand(context)
        elif self._flight.flying and context.phase in (*FLIGHT_PHASES, Phase.SUSPENDED):
            self._begin(context)
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

    # --- a home that has moved -------------------------------------------------------------------

    def _watch(self, context: FlightContext) -> None:
        state = self._state
        if self._is_being_led(context):
            return
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

    def _is_being_led(self, context: FlightContext) -> bool:
        """Tell whether a home that we have just moved is not shown yet, and may be soon.

        One that never shows was not taken: then it is where it was.
        """
        state = self._state
        if state.led_s is None or state.led_from is None:
            return False
        if self._away_m() <= MOVED_M and context.since_s(state.led_s) > TOLD_S:
            state.led_s = None
        elif context.since_s(state.led_s) > SET_BACK_S:
            state.took_off_from, state.led_s = state.led_from, None
            context.say(Severity.WARNING, "home not taken: RTL to the launch pad")
            context.decide(
                "home_not_led", "the autopilot shows its old home: RTL to the launch pad"
            )
        return state.led_s is not None

    def _away_m(self) -> float:
        """How far the home is from where it has to be, horizontally, as it was told."""
        told, place = self._state.told, self._state.took_off_from
        return 0.0 if told is None or place is None else _apart_m(told, place)

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
        assert state.took_off_from is not None
        if state.set_back_s is None:
            state.set_back_s = context.t_s
            context.do(SetHome(*state.took_off_from))
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
