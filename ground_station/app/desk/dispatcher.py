"""Result of a dispatcher, which decides the next steps of a day; the desk executes them.

There are two: `DepotDispatcher` for drones that start from the depot, and `TruckDispatcher` for a
day with a truck. A dispatcher writes its decisions to the store; the desk sends the commands.
"""

from enum import Enum


class CycleResult(Enum):
    """Result of one dispatcher cycle."""

    IDLE = "none"
    """No activity is in progress."""

    ACTIVE = "under way"
    """An activity is in progress: the idle time limit starts again."""

    CHANGED = "changed"
    """The store has changed: the desk runs its next cycle immediately."""
