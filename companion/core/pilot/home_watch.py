"""Safety rule 3 in the autopilot: its home stays at the takeoff position.

Items and RTL are flown at heights above the autopilot's home, and RTL ends at its position. Both
autopilots let any station move it in flight (DO_SET_HOME), keep the current leg, and fly every
later item by the new home: 20 m lower it leads into the ground at the customer. Therefore a moved
home closes the gate, and is restored once. Until telemetry confirms it, no leg is cleared and no
jump sent. After a second move the vehicle returns by means that are safe without its home.

If the landing site is not the launch pad, an RTL of the companion or of the autopilot's failsafe is
directed to it: the declared site becomes the autopilot's home, at the height of the old one, as
soon as the current item leads there and an RTL may end there, and the home is read back. Rally
points of the autopilot would not do: RTL goes to the nearest, not to the one that is chosen.

The companion's own heights do not depend on any of this (telemetry_state.py).
"""

import math
from dataclasses import dataclass, field
from typing import Any

from companion.core.base.geo import LocalFrame, horizontal_distance_m
from companion.core.mission.actions import SetHome
from companion.core.mission.alerts import Alert
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.events import (
    SET_HOME,
    Event,
    Home,
    Mode,
    OrderAccepted,
    OrderRefused,
    Position,
)
from companion.core.mission.flight_plan import DEPOT_RADIUS_M
from companion.core.mission.jump_watch import JumpType
from companion.core.pilot.authority import OrderedMode
from companion.core.pilot.context import FlightContext
from companion.core.pilot.flight_state import CurrentItem, FlightState, ReturnState
from companion.core.pilot.ground.autopilot_settings import AutopilotSettings
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.transitions import (
    FLIGHT_PHASES,
    GROUND_PHASES,
    RESUMABLE_PHASES,
    Phase,
    Trigger,
)

HOME_TOLERANCE_M = 3.0
"""A home farther than this from its former position has moved. Autopilots keep the home set at
arming to the millimetre; the smallest clearance of a drop is several times this."""

CONFIRM_S = 1.0
"""Duration of a height difference that confirms it: ten reports of GLOBAL_POSITION_INT."""

REDIRECT_TIMEOUT_S = 3.0
"""Timeout of an RTL for its redirected home: three tries of the order."""

REDIRECT_PHASES = (Phase.OUTBOUND, Phase.DELIVER, Phase.RETURN, Phase.DIVERT)
"""Away from the launch pad, on an item of the verified mission."""

HOME_REPORT_WINDOW_S = 3.0
"""HOME_POSITION comes every 2 s: within this time the home set at arming has been reported."""

RESTORE_TIMEOUT_S = 6.0
"""Timeout of the restore: four tries at 1 Hz, and one HOME_POSITION."""


GeoPosition = tuple[float, float, float]
"""Latitude, longitude (deg), AMSL (m) of the ground."""


@dataclass(slots=True)
class HomeState:
    """Position before takeoff, home at takeoff, and the actions on a moved home."""

    start_position: Position | None = None
    takeoff_home: GeoPosition | None = None
    """Required position of the home, until an RTL is directed elsewhere."""
    reported_home: GeoPosition | None = None
    """The home from the last HOME_POSITION since takeoff."""
    displaced_since_s: float | None = None
    displacement_text: str = ""
    restore_ordered_s: float | None = None
    item_at_displacement: int | None = None
    restore_abandoned: bool = False
    redirected_home: GeoPosition | None = None
    """Substitute destination of an RTL, and then the required position of the home."""
    home_before_redirect: GeoPosition | None = None
    redirect_refused: bool = False
    """The autopilot kept its old home: no further redirect."""
    redirect_ordered_s: float | None = None
    """Time of that order, until the autopilot shows its home there; meanwhile both are valid."""
    is_rtl_pending: bool = False
    """RTL is ordered once that home is confirmed."""


@dataclass(slots=True, eq=False)
class HomeMonitor:
    """Compares the autopilot's home with that at takeoff, and restores it once."""

    _gate: ReturnState
    _item: CurrentItem
    _jumps: MissionProgressMonitor
    _flight: FlightState
    _settings: AutopilotSettings
    _modes: OrderedMode
    _state: HomeState = field(default_factory=HomeState)

    @property
    def is_home_uncertain(self) -> bool:
        """Whether the home may have moved and may still be restored."""
        return self._state.displaced_since_s is not None and not self._state.restore_abandoned

    @property
    def autopilot_home(self) -> GeoPosition | None:
        """Position of the autopilot's home as last reported, else as required."""
        state = self._state
        return state.reported_home or state.redirected_home or state.takeoff_home

    @property
    def is_rtl_pending(self) -> bool:
        """Whether RTL waits until its destination is the autopilot's home."""
        return self._state.is_rtl_pending

    def order_rtl_and_destination_text(self, context: FlightContext) -> str:
        """Order RTL, directed to the promised landing site; return its destination as text.

        `""`: the usual home. If directed elsewhere, RTL follows once the autopilot has accepted the
        site as its home, because RTL plans its path at its start.
        """
        destination_text, position = self._rtl_destination(context)
        if position is not None:
            self._redirect_home(context, position)
        self._state.is_rtl_pending = self._state.redirect_ordered_s is not None
        if self._state.is_rtl_pending:
            self._modes.record_ordered_mode(context, Mode.RTL)
        else:
            self._modes.order_mode(context, Mode.RTL)
        return destination_text

    def _redirect_home(self, context: FlightContext, position: GeoPosition) -> None:
        state = self._state
        state.home_before_redirect = state.redirected_home
        state.redirected_home = position
        state.redirect_ordered_s = context.t_s
        state.reported_home = None
        context.queue_actions(SetHome(*position))
        context.request_checkpoint()

    def to_dict(self) -> dict[str, Any]:
        """Return the checkpoint keys of this part."""
        return {"took_off_from": self._state.takeoff_home, "led_to": self._state.redirected_home}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore from a checkpoint."""
        self._state.takeoff_home = checkpoint.took_off_from
        self._state.redirected_home = checkpoint.led_to
        self._state.redirect_ordered_s = None if checkpoint.led_to is None else checkpoint.t_s

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process a reported home, or the response to a change of it."""
        state = self._state
        match event:
            case Home() if state.takeoff_home is not None:
                state.reported_home = (event.lat_deg, event.lon_deg, state.takeoff_home[2])
                is_recent = context.seconds_since(self._flight.takeoff_s) <= HOME_REPORT_WINDOW_S
                if is_recent and _home_displacement_m(self._state) <= DEPOT_RADIUS_M:
                    state.takeoff_home = state.reported_home
            case OrderAccepted() | OrderRefused() if event.order == SET_HOME:
                self._order_pending_rtl(context)
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """On the ground store the vehicle's position; in flight monitor its home."""
        if context.phase in GROUND_PHASES:
            self._record_start_position(context)
        elif self._flight.in_flight and context.phase in (*FLIGHT_PHASES, *RESUMABLE_PHASES):
            self._fix_takeoff_home(context)
            self._complete_or_abandon_redirect(context)
            self._redirect_home_to_landing_site(context)
            if context.telemetry.airborne:  # PX4 moves home to its landing position
                self._report_and_restore_displaced_home(context)

    # --- the ground that it takes off from -------------------------------------------------------

    def _record_start_position(self, context: FlightContext) -> None:
        """Store the position until the vehicle arms: its heartbeat may come in the climb."""
        context.telemetry.set_height_reference(None)
        if context.phase is not Phase.ARM:
            self._state = HomeState(start_position=context.telemetry.position)

    def _fix_takeoff_home(self, context: FlightContext) -> None:
        """Fix the ground height once: the home set at arming, if the vehicle was there."""
        state, telemetry = self._state, context.telemetry
        position = telemetry.position
        if telemetry.ground_amsl_m is not None or position is None:
            return
        if state.takeoff_home is None:
            ground_m = position.alt_amsl_m - position.height_rel_m
            start = state.start_position
            if start is not None and abs(start.alt_amsl_m - ground_m) > HOME_TOLERANCE_M:
                ground_m = start.alt_amsl_m
            stood = start or position
            state.takeoff_home = (stood.lat_deg, stood.lon_deg, ground_m)
            context.request_checkpoint()
        telemetry.set_height_reference(state.takeoff_home[2])

    # --- redirected RTL --------------------------------------------------------------------------

    def _rtl_destination(self, context: FlightContext) -> tuple[str, GeoPosition | None]:
        """Return the destination of an RTL from here, with a text; None: the autopilot's home.

        That is the launch pad if someone else moves the home, or an RTL does not suit the promised
        site.
        """
        state, flown, here = self._state, context.flight_plan, context.recent_position_ned_m()
        index = self._item.index
        if flown is None or index is None or state.takeoff_home is None:
            return "", None
        name, spot = flown.landing_name_and_position_after_item(index)
        if spot is None:
            return "", None
        position = (spot.lat_deg, spot.lon_deg, state.takeoff_home[2])
        if is_pad := _horizontal_distance_m(position, state.takeoff_home) <= DEPOT_RADIUS_M:
            position = state.takeoff_home
        present = state.redirected_home or state.takeoff_home
        if _horizontal_distance_m(position, present) <= HOME_TOLERANCE_M:
            return "" if is_pad else f": to {name}, the autopilot's home", None
        ground = flown.mission_position_to_ned_m(spot)
        is_allowed = is_pad or (here is not None and flown.is_rtl_to_site_allowed(here, ground))
        if state.displacement_text or state.redirect_refused or not is_allowed:
            return f": to the launch pad instead of {name}", None
        return f": to {name} as the autopilot's home", position

    def _redirect_home_to_landing_site(self, context: FlightContext) -> None:
        """Redirect the home to the site where the current item leads."""
        if context.phase not in REDIRECT_PHASES or self._state.redirect_ordered_s is not None:
            return
        text, position = self._rtl_destination(context)
        if position is not None:
            self._redirect_home(context, position)
            context.record_decision("home_redirected", f"a failsafe's RTL goes{text[1:]}")

    def _order_pending_rtl(self, context: FlightContext) -> None:
        """Order RTL if it is pending, unless the companion has lost control."""
        if self._state.is_rtl_pending and context.phase is Phase.LAST_RESORT:
            self._modes.order_mode(context, Mode.RTL)
        self._state.is_rtl_pending = False

    def _complete_or_abandon_redirect(self, context: FlightContext) -> None:
        """Order RTL when its home is confirmed or overdue; the reported home decides where the home
        is required to be.
        """
        state = self._state
        if state.redirect_ordered_s is None or state.redirected_home is None:
            return
        waited_s = context.seconds_since(state.redirect_ordered_s)
        reported_home = state.reported_home
        is_confirmed = (
            reported_home is not None
            and _horizontal_distance_m(reported_home, state.redirected_home) <= HOME_TOLERANCE_M
        )
        if is_confirmed or waited_s > REDIRECT_TIMEOUT_S:
            self._order_pending_rtl(context)
        if is_confirmed:
            state.redirect_ordered_s = None
        elif reported_home is not None and waited_s > RESTORE_TIMEOUT_S:
            state.redirect_ordered_s, state.redirect_refused = None, True
            state.redirected_home = state.home_before_redirect
            context.report_alert(Alert.HOME_NOT_TAKEN)
            reason = "the autopilot shows its old home: RTL to the launch pad"
            context.record_decision("home_not_led", reason)

    # --- a moved home ----------------------------------------------------------------------------

    def _report_and_restore_displaced_home(self, context: FlightContext) -> None:
        state = self._state
        displacement = _displacement_text(self._state, context)
        if not displacement:
            state.displaced_since_s = None
            if state.displacement_text:
                self._report_home_restored_and_rejoin(context)
            return
        if state.displaced_since_s is None:
            state.displaced_since_s = context.t_s
        if context.seconds_since(state.displaced_since_s) < CONFIRM_S:
            return
        if not state.displacement_text:
            self._close_gate_and_report_home_moved(context, displacement)
        if context.phase in FLIGHT_PHASES and not state.restore_abandoned:
            self._restore_home_once(context)

    def _close_gate_and_report_home_moved(
        self, context: FlightContext, displacement_text: str
    ) -> None:
        reason = f"home moved {displacement_text}"
        self._state.displacement_text = reason
        self._state.item_at_displacement = self._item.index
        self._gate.close_gate(reason)
        context.report_alert(Alert.HOME_MOVED, displacement=displacement_text)
        context.record_decision("home_moved", reason)

    def _restore_home_once(self, context: FlightContext) -> None:
        """Restore the home the first time; give up if it has no effect or does not last."""
        state = self._state
        position = state.redirected_home or state.takeoff_home
        assert position is not None
        if state.restore_ordered_s is None:
            state.restore_ordered_s = context.t_s
            context.queue_actions(SetHome(*position))
        elif context.seconds_since(state.restore_ordered_s) > RESTORE_TIMEOUT_S:
            self._abandon_home_restore(context)

    def _report_home_restored_and_rejoin(self, context: FlightContext) -> None:
        """Continue; a return leg that started at heights above the wrong home is restarted."""
        state = self._state
        state.displacement_text, state.restore_abandoned = "", False
        context.report_alert(Alert.HOME_RESTORED)
        context.record_decision("home_back", "the autopilot's home is restored")
        index = self._item.index
        homeward = context.phase in (Phase.RETURN, Phase.DIVERT)
        if homeward and index is not None and index != state.item_at_displacement:
            self._jumps.order_jump(context, index, JumpType.HOME)

    def _abandon_home_restore(self, context: FlightContext) -> None:
        """Accept the moved home. Items above a higher one are higher, above a lower one low.

        RTL never descends below the present height en route (both autopilots take the higher of
        that and their RTL altitude), so it is safe if it still leads to the right position.
        """
        state = self._state
        state.restore_abandoned = True
        context.report_alert(
            Alert.HOME_NOT_RESTORED, displacement=_displacement_text(self._state, context)
        )
        context.record_decision("home_stays_moved", state.displacement_text)
        low = context.telemetry.home_below_ground_m > HOME_TOLERANCE_M
        if (
            not low
            or _home_displacement_m(self._state) > HOME_TOLERANCE_M
            or not self._settings.is_rtl_known_safe
        ):
            return
        if context.is_outbound:
            context.apply_phase_trigger(Trigger.RETURN_STARTED, state.displacement_text)
        context.apply_phase_trigger(Trigger.RETURN_REFUSED, state.displacement_text)


def _home_displacement_m(state: HomeState) -> float:
    """Return the horizontal distance of the reported home from its required position."""
    if state.reported_home is None or state.takeoff_home is None:
        return 0.0
    required_homes = [state.redirected_home or state.takeoff_home]
    if state.redirect_ordered_s is not None:
        required_homes.append(state.home_before_redirect or state.takeoff_home)
    return min(_horizontal_distance_m(state.reported_home, home) for home in required_homes)


def _displacement_text(state: HomeState, context: FlightContext) -> str:
    """Describe the distance of the home from its required position; `""` if it is there."""
    sunk_m, away_m = context.telemetry.home_below_ground_m, _home_displacement_m(state)
    if away_m > HOME_TOLERANCE_M:
        return f"{away_m:.0f} m away"
    if abs(sunk_m) > HOME_TOLERANCE_M:
        return f"{abs(sunk_m):.0f} m {'down' if sunk_m > 0.0 else 'up'}"
    return ""


def _horizontal_distance_m(a_position: GeoPosition, b_position: GeoPosition) -> float:
    """Return the horizontal distance of two positions."""
    lat_deg, lon_deg, amsl_m = b_position
    frame = LocalFrame(math.radians(lat_deg), math.radians(lon_deg), amsl_m)
    offset_ned_m = frame.to_ned(math.radians(a_position[0]), math.radians(a_position[1]), amsl_m)
    return horizontal_distance_m(offset_ned_m, (0.0, 0.0, 0.0))
