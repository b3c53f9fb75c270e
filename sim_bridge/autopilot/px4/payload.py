"""PX4's gripper and actuator outputs, which hold and release the parcel.

Source: PX4 1.18, src/modules/payload_deliverer/payload_deliverer.cpp.
"""

import math
from dataclasses import dataclass

from sim_bridge.autopilot.mavlink.commands import Command
from sim_bridge.autopilot.mavlink.enums import MavResult
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState


@dataclass(frozen=True, slots=True)
class _PendingAck:
    """An acknowledgement that is due after the action's duration."""

    command: Command
    due_s: float


class Px4Payload:
    """Gripper state. `release` is True when the parcel is released; the outputs are open loop."""

    def __init__(self, state: VehicleState, radio: Radio) -> None:
        self._state = state
        self._radio = radio
        self._pending: list[_PendingAck] = []
        self.release = False

    @property
    def has_gripper(self) -> bool:
        """PD_GRIPPER_TYPE: -1 none, 0 servo (the default)."""
        return self._state.params["PD_GRIPPER_TYPE"] >= 0.0

    def set_gripper(self, gripper_action: int) -> None:
        """DO_GRIPPER: 0 releases, 1 grabs."""
        self.release = gripper_action == 0

    def set_release_by_actuator_value(self, actuator_value: float) -> None:
        """DO_SET_ACTUATOR: above 0 releases; NaN leaves it as it is."""
        if math.isfinite(actuator_value):
            self.release = actuator_value > 0.0

    def schedule_ack(self, command: Command, wait_s: float) -> None:
        """Acknowledge a command as complete after its duration."""
        self._pending.append(_PendingAck(command, self._state.t_s + wait_s))

    def is_command_ack_pending(self, command_number: int) -> bool:
        """Return True while such a command is not complete."""
        return any(pending.command.number == command_number for pending in self._pending)

    def send_due_acks(self) -> None:
        """Acknowledge completed commands."""
        for pending in [entry for entry in self._pending if entry.due_s <= self._state.t_s]:
            self._pending.remove(pending)
            self._radio.send_command_ack(pending.command, MavResult.ACCEPTED)
