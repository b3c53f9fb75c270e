"""Services and states of an order; few imports, for options of the command line."""

from enum import Enum


class Service(Enum):
    """Members that may deliver an order."""

    ANY = "any"
    DRONE = "drone"
    TRUCK = "truck"


class Priority(Enum):
    """Priority of an order: urgent ones are delivered before normal ones."""

    NORMAL = "normal"
    URGENT = "urgent"


class ParcelOutcome(Enum):
    """Outcome of a parcel as reported by an operator, if no vehicle can report it."""

    DELIVERED = "delivered"
    LOST = "lost"
    BACK = "back"


class OrderState(Enum):
    """State of an order. `stuck` needs an operator: too many attempts, vehicle lost or landed
    elsewhere by a pilot, no proof of the drop, or no delivery by the driver. `returned`: goes back
    to its sender.
    """

    OPEN = "open"
    ASSIGNED = "assigned"
    DELIVERED = "delivered"
    STUCK = "stuck"
    CANCELLED = "cancelled"
    RETURNED = "returned"


CLOSED = (OrderState.DELIVERED, OrderState.CANCELLED, OrderState.RETURNED)
"""States in which no vehicle gets an order."""
