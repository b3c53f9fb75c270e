"""Interface of a dispatcher, which decides the next steps of a day; the desk executes them.

There are two: `DepotDispatcher` for drones that start from the depot, and `TruckDispatcher` for a
day with a truck. A dispatcher writes its decisions to the store; the desk sends the commands.
"""

from enum import Enum
from typing import Protocol

from companion.fleet.messages import State
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.orders import AssignmentRow


class CycleResult(Enum):
    """Result of one dispatcher cycle."""

    IDLE = "none"
    """No activity is in progress."""

    ACTIVE = "under way"
    """An activity is in progress: the idle time limit starts again."""

    CHANGED = "changed"
    """The store has changed: the desk runs its next cycle immediately."""


class Dispatcher(Protocol):
    """Makes the decisions of one desk. The store holds all data that must survive a restart."""

    def prepare_first_cycle(self) -> None:
        """Prepare the first cycle. Called once."""
        ...

    def on_state(self, state: State) -> None:
        """Process a state that a vehicle or the truck has published."""
        ...

    def on_vehicle_ready(self, assignment: AssignmentRow) -> None:
        """Process a vehicle that is ready on the ground with this assignment uploaded."""
        ...

    def run_decision_cycle(self, status: FleetStatus, *, has_new_messages: bool) -> CycleResult:
        """Run one decision cycle. `has_new_messages`: messages arrived since the last cycle."""
        ...

    @property
    def earliest_launch_s(self) -> float:
        """Return the end of the launch gap on the desk's monotonic clock: no launch is sent before
        it.
        """
        ...

    @property
    def is_done(self) -> bool:
        """Whether this dispatcher has no work left."""
        ...

    def undelivered_reason(self, order_id: str) -> str | None:
        """Return the reason why an order is not delivered; None: unknown to this dispatcher."""
        ...

    def close(self) -> None:
        """Stop worker processes of the dispatcher."""
        ...
