"""The interface of a dispatcher: it decides what happens next, the desk does the rest.

There are two: `DepotDispatcher` for drones that start from the depot, and `TruckDispatcher` for a
day with a truck. A dispatcher writes its decisions to the store; the desk sends the commands.
"""

from enum import Enum
from typing import Protocol

from companion.fleet.messages import State
from ground_station.core.fleet.desk_figures import ReplanFigures
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.orders import AssignmentRow


class Progress(Enum):
    """What one turn of a dispatcher came to."""

    NONE = "none"
    """Nothing is under way."""

    UNDER_WAY = "under way"
    """The day goes on: this counts against the desk's idle limit."""

    CHANGED = "changed"
    """It has changed the store: the desk takes its next turn at once."""


class Dispatcher(Protocol):
    """Decides for one desk. Whatever must survive a restart is in the store, not here."""

    def begin(self) -> None:
        """Called once, before the first turn."""
        ...

    def on_state(self, state: State) -> None:
        """Take a state that a vehicle or the truck has published."""
        ...

    def on_ready(self, assignment: AssignmentRow) -> None:
        """A vehicle is ready on the ground with this assignment aboard."""
        ...

    def turn(self, status: FleetStatus, *, changed: bool) -> Progress:
        """Decide what is due. `changed`: news has come since the last turn."""
        ...

    @property
    def is_done(self) -> bool:
        """Whether nothing is left that this dispatcher can do."""
        ...

    @property
    def replans(self) -> ReplanFigures | None:
        """The plans made anew; None: this dispatcher has no plan."""
        ...

    def why_left(self, order_id: str) -> str | None:
        """Why an order is not brought, if this dispatcher knows."""
        ...

    def close(self) -> None:
        """Stop work that runs beside the desk."""
        ...
