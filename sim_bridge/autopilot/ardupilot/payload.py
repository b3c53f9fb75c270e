"""ArduPilot's gripper and servo outputs, which hold and release the parcel."""

from sim_bridge.autopilot.mavlink.enums import Severity
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState

_GRIP_S = 2.0
_RELEASE_SERVO = 9
_MOTORS = 4


class ArduPilotPayload:
    """Gripper state. `release` is True when the parcel is released; the outputs are open loop."""

    def __init__(self, state: VehicleState, radio: Radio) -> None:
        self._state = state
        self._radio = radio
        self._done: tuple[str, float] | None = None
        """A text that reports the end of a grip, and when it is due."""
        self.release = False

    def start_gripper_action_if_fitted(self, action: int) -> bool:
        """DO_GRIPPER: 0 releases, 1 grabs; False if there is no gripper."""
        if self._state.params["GRIP_ENABLE"] == 0.0:
            return False
        self.release = action == 0
        progress_text, done = ("releasing", "released") if action == 0 else ("grabbing", "grabbed")
        self._radio.send_status_text(Severity.INFO, f"Gripper load {progress_text}")
        self._done = (f"Gripper load {done}", self._state.t_s + _GRIP_S)
        return True

    def set_servo_and_release_output(self, channel: int, pulse_us: int) -> bool:
        """DO_SET_SERVO: channel 9 is wired to the release; the motors' channels are refused."""
        if not 1 <= channel <= 16 or not 500 <= pulse_us <= 2500:
            return False
        if channel == _RELEASE_SERVO:
            if self._state.params["SERVO9_FUNCTION"] != 0.0:
                return False
            self.release = pulse_us > 1500
        return channel > _MOTORS

    def report_finished_grip(self) -> None:
        """Report the end of a grip."""
        if self._done is not None and self._state.t_s >= self._done[1]:
            text, self._done = self._done[0], None
            self._radio.send_status_text(Severity.INFO, text)
