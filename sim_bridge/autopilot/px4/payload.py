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
class _Pending:
    """An acknowledgement that is due when an action has taken its time."""

    command: Command
    due_s: float


class Px4Payload:
    """`release` says whether the parcel is let go; the outputs are open loop."""

    def __init__(self, state: VehicleState, radio: Radio) -> None:
        self._state = state
        self._radio = radio
        self._pending: list[_Pending] = []
        self.release = False

    @property
    def has_gripper(self) -> bool:
        """PD_GRIPPER_TYPE: -1 none, 0 servo (the default)."""
        return self._state.params["PD_GRIPPER_TYPE"] >= 0.0

    def grip(self, action: int) -> None:
        """DO_GRIPPER: 0 releases, 1 grabs."""
        self.release = action == 0

    def set_actuator(self, value: float) -> None:
        """DO_SET_ACTUATOR: above 0 releases; NaN leaves it as it is."""
        if math.isfinite(value):
            self.release = value > 0.0

    def finish_later(self, command: Command, wait_s: float) -> None:
        """Acknowledge a command as done after a while."""
        self._pending.append(_Pending(command, self._state.t_s + wait_s))

    def is_busy_with(self, number: int) -> bool:
        """Whether such a command is not yet done."""
        return any(pending.command.number == number for pending in self._pending)

    def step(self) -> None:
        """Acknowledge what is done by now."""
        for pending in [entry for entry in self._pending if entry.due_s <= self._state.t_s]:
            self._pending.remove(pending)
            self._radio.acknowledge(pending.command, MavResult.ACCEPTED)
