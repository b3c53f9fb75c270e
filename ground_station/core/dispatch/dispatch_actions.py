"""What the dispatcher of a day with a truck can decide. Each action becomes one transaction."""

from dataclasses import dataclass

from companion.core.base.place import Place
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop


@dataclass(frozen=True, slots=True)
class PutDroneOut:
    """Assign this sortie and have the driver put its drone on the launch pad."""

    sortie: PlannedSortie


@dataclass(frozen=True, slots=True)
class SendMission:
    """The drone stands on its pad: send it its mission."""

    assignment: str


@dataclass(frozen=True, slots=True)
class AuthoriseLaunch:
    """Authorise the launch."""

    assignment: str


@dataclass(frozen=True, slots=True)
class WithdrawAssignment:
    """Withdraw it before its launch, and why."""

    assignment: str
    why: str


@dataclass(frozen=True, slots=True)
class RecoverDrone:
    """Have the driver take the drone aboard from this pad."""

    assignment: str
    pad: Place


@dataclass(frozen=True, slots=True)
class RequestHomeChange:
    """Ask a flight to end at another stop."""

    assignment: str
    stop: str
    why: str


@dataclass(frozen=True, slots=True)
class ConfirmHomeChange:
    """The flight has confirmed that it ends there: the old promise is void."""

    assignment: str
    stop: str


@dataclass(frozen=True, slots=True)
class ForgetHomeChange:
    """The flight is over, and did not end where it was asked to: nothing waits there any more."""

    assignment: str
    stop: str


@dataclass(frozen=True, slots=True)
class DeclareOverdue:
    """Not heard for longer than it can fly: the truck waits for it no more."""

    assignment: str


@dataclass(frozen=True, slots=True)
class DeclareOffSite:
    """It is down where the truck does not come: people fetch it."""

    assignment: str


@dataclass(frozen=True, slots=True)
class ServeOrder:
    """Have the driver bring this order to its customer."""

    order: str


@dataclass(frozen=True, slots=True)
class DriveToStop:
    """Send the truck from here to its next stop."""

    here: str
    stop: PlannedStop


DispatchAction = (
    PutDroneOut
    | SendMission
    | AuthoriseLaunch
    | WithdrawAssignment
    | RecoverDrone
    | RequestHomeChange
    | ConfirmHomeChange
    | ForgetHomeChange
    | DeclareOverdue
    | DeclareOffSite
    | ServeOrder
    | DriveToStop
)
