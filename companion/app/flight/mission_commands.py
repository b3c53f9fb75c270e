"""A dispatcher's commands to a running mission, as the events of an operator's MAVLink commands
(`operator_port`), so that the pilot alone enforces safety rule 1.
"""

from collections.abc import Callable

from companion.core.mission.actions import OperatorResponse, ResponseStatus
from companion.core.mission.events import (
    AbortOrdered,
    ControlHandedBack,
    ControlReleaseOrdered,
    Event,
    HomeStopRequested,
    LimitsChanged,
    MissionAuthorised,
)
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.transitions import GROUND_PHASES, Phase
from companion.fleet.command_log import CommandReply
from companion.fleet.messages import (
    Assign,
    Command,
    CommandStatus,
    Launch,
    MoveHome,
    Recall,
    ReleaseControl,
    ReturnControl,
    SetLimits,
    Withdraw,
)

COMMAND_STATUS_BY_RESPONSE = {
    ResponseStatus.ACCEPTED: CommandStatus.DONE,
    ResponseStatus.LATER: CommandStatus.LATER,
    ResponseStatus.DENIED: CommandStatus.REFUSED,
}


def execute_mission_command(
    command: Command,
    loaded_assignment: str | None,
    pilot: Pilot,
    t_s: float,
    submit_event: Callable[[Event], OperatorResponse],
) -> CommandReply:
    """Execute a command during a mission; `loaded_assignment`: None for a local mission."""
    action, by, phase = command.action, command.by, pilot.phase
    loaded = loaded_assignment or "a local mission"
    match action:
        case Assign() if action.assignment == loaded_assignment:
            return CommandReply(CommandStatus.DONE, "already loaded")
        case Assign():
            return CommandReply(CommandStatus.REFUSED, f"busy with {loaded}")
        case Launch() | Withdraw() | MoveHome() if action.assignment != loaded_assignment:
            return CommandReply(CommandStatus.REFUSED, f"{loaded} is loaded")
        case Withdraw() if phase not in (Phase.IDENTIFY, *GROUND_PHASES):
            return CommandReply(CommandStatus.REFUSED, f"in phase {phase.value}: use recall")
        case Launch():
            event = MissionAuthorised(t_s, by)
        case Recall() | Withdraw():
            event = AbortOrdered(t_s, by)
        case MoveHome():
            event = HomeStopRequested(t_s, by, action.home)
        case ReleaseControl():
            event = ControlReleaseOrdered(t_s, by)
        case ReturnControl():
            event = ControlHandedBack(t_s, by)
        case SetLimits():
            event = LimitsChanged(t_s, action.max_loss, action.reserve_frac)
        case _:
            return CommandReply(CommandStatus.REFUSED, "command not supported by this vehicle")
    response = submit_event(event)
    if isinstance(action, Withdraw) and pilot.phase is Phase.IDENTIFY:
        return CommandReply(CommandStatus.LATER, "no autopilot detected yet")
    return CommandReply(
        COMMAND_STATUS_BY_RESPONSE[response.status], response.reason or f"phase {pilot.phase.value}"
    )
