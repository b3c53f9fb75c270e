"""Mode, arming and home: changes and their notifications."""

import math
from dataclasses import dataclass
from typing import Protocol

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.landing import LandingDetector
from sim_bridge.autopilot.state import VehicleState

_HOME_MOVE_M = 3.0
"""Distance from home at which PX4 moves it while disarmed: twice a poor fix's eph."""


class CommanderHooks(Protocol):
    """Autopilot-specific reactions to changes of mode, arming or home."""

    def on_mode_exit(self, mode: Mode) -> None:
        """End the activity of the mode that is left."""
        ...

    def on_mode_entry(self, mode: Mode) -> None:
        """Start the activity of the new mode."""
        ...

    def on_armed(self) -> None:
        """The motors are on."""
        ...

    def on_disarmed(self) -> None:
        """The motors are off."""
        ...

    def on_home_changed(self) -> None:
        """Handle a change of home."""
        ...


@dataclass(slots=True)
class Commander:
    """The one writer of mode, arming, failsafe reason and home in `VehicleState`."""

    _state: VehicleState
    _landing: LandingDetector
    _hooks: CommanderHooks

    def set_mode(self, mode: Mode, requester_ids: tuple[int, int] | None = None) -> None:
        """Change the mode; the caller has checked it. `requester_ids`: None for the autopilot."""
        if mode is self._state.mode and mode is not Mode.HOLD:
            return
        self._state.mode_by = requester_ids
        self._hooks.on_mode_exit(self._state.mode)
        self.enter_mode_without_exit_hook(mode)

    def enter_mode_without_exit_hook(self, mode: Mode) -> None:
        """Enter a mode without leaving one, as after a reset in flight."""
        self._state.mode = mode
        self._hooks.on_mode_entry(mode)

    def arm_and_set_home_if_unlocked(self) -> None:
        """Motors on; home is here, unless it is locked."""
        state = self._state
        if state.is_armed:
            return
        state.is_armed = True
        state.armed_since_s = state.t_s
        state.has_flown = False
        self._landing.reset_at_arming()
        if state.has_position and not state.home_is_locked:
            self.set_home(state.pos_ned_m)
        self._hooks.on_armed()

    def disarm(self) -> None:
        """Stop the motors, on the ground or in the air."""
        if not self._state.is_armed:
            return
        self._state.is_armed = False
        self._state.failsafe_reason = None
        self._hooks.on_disarmed()

    def record_takeoff(self) -> None:
        """Record that the vehicle is airborne."""
        self._state.has_flown = True
        self._state.landed_since_s = self._state.t_s

    def set_failsafe_reason(self, reason: str | None) -> None:
        """Store the reason for an active failsafe; None when it has ended."""
        self._state.failsafe_reason = reason

    def set_home(self, pos_ned_m: Vec3, *, keep_when_arming: bool = False) -> None:
        """Set home; `keep_when_arming` prevents arming from moving it."""
        state = self._state
        state.home_ned_m = pos_ned_m
        state.home_is_set = True
        state.home_is_locked = keep_when_arming
        state.home_revision += 1
        self._hooks.on_home_changed()

    def move_home_after_displacement(self) -> None:
        """Set home here if the vehicle has moved away from it (PX4, HomePosition.cpp, update)."""
        state = self._state
        north, east, _ = state.pos_ned_m
        away_m = math.dist((north, east), state.home_ned_m[:2])
        is_automatic = state.home_is_set and not state.home_is_locked
        if is_automatic and state.has_position and away_m > _HOME_MOVE_M:
            self.set_home(state.pos_ned_m)

    def set_home_and_origin_at_first_position(self) -> None:
        """Set home and the estimator's origin at the first position."""
        state = self._state
        if state.home_is_set or not state.has_position:
            return
        state.ekf_origin_ned_m = state.pos_ned_m
        self.set_home(state.pos_ned_m)

    # --- boots --------------------------------------------------------------------------------

    def reset_at_ground_boot(self, initial_mode: Mode) -> None:
        """A boot on the ground: disarmed, in the initial mode, without a home."""
        state = self._state
        state.mode = initial_mode
        state.mode_by = None
        state.is_armed = False
        state.has_flown = False
        state.home_is_set = False
        state.home_ned_m = state.ekf_origin_ned_m = (0.0, 0.0, 0.0)
        self._reset_flight_state()

    def reset_at_in_flight_reboot(self) -> None:
        """A watchdog reset in flight: armed, in the same mode, with the same home."""
        self._state.has_flown = True
        self._reset_flight_state()

    def resume_flight_after_reboot(self) -> None:
        """Continue the flight after a watchdog reset."""
        self._state.armed_since_s = self._state.t_s - 60.0
        self.enter_mode_without_exit_hook(self._state.mode)

    def _reset_flight_state(self) -> None:
        state = self._state
        state.failsafe_reason = None
        state.armed_since_s = 0.0
        state.landed_since_s = 0.0
        state.home_is_locked = False
