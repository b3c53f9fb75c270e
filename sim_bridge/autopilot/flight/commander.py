"""Mode, arming and home: who changes them, and who is told."""

from typing import Protocol

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.landing import LandingDetector
from sim_bridge.autopilot.state import VehicleState


class CommanderHooks(Protocol):
    """What an autopilot does when mode, arming or home change."""

    def leaving(self, mode: Mode) -> None:
        """End what the mode has under way."""
        ...

    def entered(self, mode: Mode) -> None:
        """Start what the mode is for."""
        ...

    def armed(self) -> None:
        """The motors are on."""
        ...

    def disarmed(self) -> None:
        """The motors are off."""
        ...

    def home_changed(self) -> None:
        """Home is somewhere else."""
        ...


class Commander:
    """The one writer of mode, arming, failsafe reason and home in `VehicleState`."""

    def __init__(
        self, state: VehicleState, landing: LandingDetector, hooks: CommanderHooks
    ) -> None:
        self._state = state
        self._landing = landing
        self._hooks = hooks

    def set_mode(self, mode: Mode, by: tuple[int, int] | None = None) -> None:
        """Change the mode; whether that is allowed was checked before. `by`: None is itself."""
        if mode is self._state.mode and mode is not Mode.HOLD:
            return
        self._state.mode_by = by
        self._hooks.leaving(self._state.mode)
        self.enter(mode)

    def enter(self, mode: Mode) -> None:
        """Enter a mode without leaving one, as after a reset in flight."""
        self._state.mode = mode
        self._hooks.entered(mode)

    def arm(self) -> None:
        """Motors on; home is here, unless it is locked."""
        state = self._state
        if state.is_armed:
            return
        state.is_armed = True
        state.armed_since_s = state.t_s
        state.has_flown = False
        self._landing.arm()
        if state.has_position and not state.home_is_locked:
            self.set_home(state.pos_ned_m)
        self._hooks.armed()

    def disarm(self) -> None:
        """Motors off, wherever the vehicle is."""
        if not self._state.is_armed:
            return
        self._state.is_armed = False
        self._state.failsafe_reason = None
        self._hooks.disarmed()

    def note_flying(self) -> None:
        """The vehicle is in the air."""
        self._state.has_flown = True
        self._state.landed_since_s = self._state.t_s

    def note_failsafe(self, reason: str | None) -> None:
        """Why a failsafe acts; None when it is over."""
        self._state.failsafe_reason = reason

    def set_home(self, pos_ned_m: Vec3, *, locked: bool = False) -> None:
        """Home is there; `locked` keeps arming from moving it."""
        state = self._state
        state.home_ned_m = pos_ned_m
        state.home_is_set = True
        state.home_is_locked = locked
        state.home_revision += 1
        self._hooks.home_changed()

    def find_home(self) -> None:
        """Home and the estimator's origin are at the first position."""
        state = self._state
        if state.home_is_set or not state.has_position:
            return
        state.ekf_origin_ned_m = state.pos_ned_m
        self.set_home(state.pos_ned_m)

    # --- boots --------------------------------------------------------------------------------

    def boot(self, mode: Mode) -> None:
        """A boot on the ground: disarmed, in the initial mode, without a home."""
        state = self._state
        state.mode = mode
        state.mode_by = None
        state.is_armed = False
        state.has_flown = False
        state.home_is_set = False
        state.home_ned_m = state.ekf_origin_ned_m = (0.0, 0.0, 0.0)
        self._forget()

    def boot_in_flight(self) -> None:
        """A watchdog reset in flight: armed, in the same mode, with the same home."""
        self._state.has_flown = True
        self._forget()

    def resume(self) -> None:
        """Go on flying after a watchdog reset."""
        self._state.armed_since_s = self._state.t_s - 60.0
        self.enter(self._state.mode)

    def _forget(self) -> None:
        state = self._state
        state.failsafe_reason = None
        state.armed_since_s = 0.0
        state.landed_since_s = 0.0
        state.home_is_locked = False
