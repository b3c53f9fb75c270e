"""Actions of the dispatcher for a day with a truck. Each action becomes one transaction."""

from dataclasses import dataclass

from companion.core.base.location import Location
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop


@dataclass(frozen=True, slots=True)
class DeployDrone:
    """Assign this sortie and have the driver put its drone on the launch pad."""

    sortie: PlannedSortie


@dataclass(frozen=True, slots=True)
class SendMission:
    """Send the mission to a drone that is on its pad."""

    assignment: str


@dataclass(frozen=True, slots=True)
class AuthoriseLaunch:
    """Authorise the launch."""

    assignment: str


@dataclass(frozen=True, slots=True)
class WithdrawAssignment:
    """Withdraw an assignment before its launch, with a reason."""

    assignment: str
    reason: str


@dataclass(frozen=True, slots=True)
class RecoverDrone:
    """Have the driver collect the drone from this pad."""

    assignment: str
    pad: Location


@dataclass(frozen=True, slots=True)
class RequestHomeChange:
    """Request a flight to land at another stop."""

    assignment: str
    stop: str
    reason: str


@dataclass(frozen=True, slots=True)
class ConfirmHomeChange:
    """Record that the flight confirmed the new landing stop: the old promise is void."""

    assignment: str
    stop: str


@dataclass(frozen=True, slots=True)
class CancelHomeChange:
    """Cancel the home change of a finished flight that did not land at the requested stop."""

    assignment: str
    stop: str


@dataclass(frozen=True, slots=True)
class DeclareOverdue:
    """Declare a flight overdue (silent for longer than it can fly): the truck no longer waits."""

    assignment: str


@dataclass(frozen=True, slots=True)
class DeclareOffSite:
    """Declare a drone landed off site, where the truck does not come: staff collect it."""

    assignment: str


@dataclass(frozen=True, slots=True)
class ServeOrder:
    """Have the driver deliver this order to its customer."""

    order: str


@dataclass(frozen=True, slots=True)
class DriveToStop:
    """Send the truck from here to its next stop."""

    from_stop: str
    stop: PlannedStop


DispatchAction = (
    DeployDrone
    | SendMission
    | AuthoriseLaunch
    | WithdrawAssignment
    | RecoverDrone
    | RequestHomeChange
    | ConfirmHomeChange
    | CancelHomeChange
    | DeclareOverdue
    | DeclareOffSite
    | ServeOrder
    | DriveToStop
)
