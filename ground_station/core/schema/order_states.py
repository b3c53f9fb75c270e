"""Who may deliver an order, and what has become of it; light, for options of the command line."""

from enum import Enum


class Service(Enum):
    """Who may deliver an order."""

    ANY = "any"
    DRONE = "drone"
    TRUCK = "truck"


class Settled(Enum):
    """What a person says has become of a parcel, where no vehicle can tell it any more."""

    DELIVERED = "delivered"
    LOST = "lost"
    BACK = "back"


class OrderState(Enum):
    """`stuck` waits for a person: too many attempts, its vehicle was lost or landed by a person
    elsewhere, or nothing proved the drop.
    """

    OPEN = "open"
    ASSIGNED = "assigned"
    DELIVERED = "delivered"
    STUCK = "stuck"
    CANCELLED = "cancelled"
