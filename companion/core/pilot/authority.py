"""Safety rule 1: whose hand is on the vehicle, judged from the autopilot's heartbeats."""

from dataclasses import dataclass

from companion.core.mission.events import Mode, VehicleState
from companion.core.pilot.transitions import FLIGHT_PHASES, GROUND_PHASES, Phase


@dataclass(slots=True)
class Authority:
    """Knows which mode is ours. `ordered_from` is the mode that we are changing away from."""

    ground_mode: str | None = None
    ordered_from: str | None = None
    ordered: Mode | None = None

    def order(self, mode: Mode, now: VehicleState | None) -> None:
        """A mode change has been ordered: for now the old mode is no surprise."""
        self.ordered = mode
        self.ordered_from = now.mode_name if now is not None else None

    def forget(self) -> None:
        """No order of ours is under way."""
        self.ordered = None
        self.ordered_from = None

    def intrusion(self, phase: Phase, state: VehicleState, *, on_ground: bool) -> str | None:
        """Say why this heartbeat shows another hand, or `None`."""
        if phase in GROUND_PHASES:
            return self._on_ground(phase, state)
        flying = phase in FLIGHT_PHASES or phase is Phase.LINK_LOST
        if not flying or not state.armed or (phase is Phase.LAND and on_ground):
            return None
        return self._mode(state, (Mode.MISSION,) if phase is not Phase.LAST_RESORT else ())

    def _on_ground(self, phase: Phase, state: VehicleState) -> str | None:
        if phase is Phase.ARM:
            return self._mode(state, (Mode.MISSION,))
        if state.armed:
            return f"armed by somebody else in {state.mode_name}"
        if self.ground_mode is None:
            if state.ready_state:
                self.ground_mode = state.mode_name
            return None
        if state.mode_name != self.ground_mode:
            return f"mode changed from {self.ground_mode} to {state.mode_name}"
        return None

    def _mode(self, state: VehicleState, ours: tuple[Mode, ...]) -> str | None:
        if self.ordered is not None and state.mode is self.ordered:
            self.ordered_from = None
            return None
        if self.ordered is Mode.RTL and self.ordered_from is None and state.mode is Mode.LAND:
            return None  # RTL ends in a landing
        if state.mode in ours and (self.ordered in (None, Mode.MISSION)):
            return None
        if state.mode_name == self.ordered_from:
            return None
        return f"mode changed to {state.mode_name}"
