"""Orders, assignments and their states, shared by store and desk."""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import msgspec
from msgspec import Meta

from companion.core.base.errors import LeewayError, check_range
from companion.core.base.place import Place
from companion.fleet.messages import Answered, Deed
from ground_station.core.schema.order_states import OrderState, Service, Settled

OrderId = Annotated[
    str, Meta(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*\Z")
]


BOUNDS = {
    "lat_deg": (-85.0, 85.0),
    "lon_deg": (-180.0, 180.0),
    "alt_amsl_m": (-500.0, 9000.0),
    "mass_kg": (0.0, 500.0),
}
"""Ranges of an order's numbers."""


class Order(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One parcel to one place. `alt_amsl_m`: height of the ground there (safety rule 8).

    `note` is for people: nothing decides by it.
    """

    id: OrderId
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    mass_kg: float
    service: Service = Service.ANY
    note: Annotated[str, Meta(max_length=500)] = ""

    def __post_init__(self) -> None:
        for key, (low, high) in BOUNDS.items():
            check_range(key, getattr(self, key), low, high)


def place_of(order: Order) -> Place:
    """Where an order goes, as the customer of a flight file."""
    try:
        return Place(
            name=order.id, lat_deg=order.lat_deg, lon_deg=order.lon_deg, alt_amsl_m=order.alt_amsl_m
        )
    except LeewayError as error:
        raise LeewayError(f"order {order.id}: {error}") from error


class AssignmentState(Enum):
    """From the order to the vehicle until the end.

    While it is in force (`IN_FORCE`) it holds its order and its vehicle.
    """

    ORDERED = "ordered"
    ABOARD = "aboard"
    FLYING = "flying"
    WITHDRAWING = "withdrawing"
    DELIVERED = "delivered"
    RETURNED = "returned"
    LOST = "lost"
    REFUSED = "refused"
    WITHDRAWN = "withdrawn"


IN_FORCE = (
    AssignmentState.ORDERED,
    AssignmentState.ABOARD,
    AssignmentState.FLYING,
    AssignmentState.WITHDRAWING,
)

TAKEN = "TAKEN"
"""The outcome of a flight that a person took over and landed elsewhere."""

ATTEMPTS = 3
"""Flights that an order gets before a person has to look at it."""


@dataclass(frozen=True, slots=True)
class OrderRow:
    """An order and its state."""

    order: Order
    state: OrderState
    attempts: int
    why: str


@dataclass(frozen=True, slots=True)
class AssignmentRow:
    """An assignment: which vehicle brings which order. `confirmed_by`: who lets it be launched.

    `layer`: over the depot, from 0; None: its plan has the height.
    """

    id: str
    order_id: str
    vehicle: str
    state: AssignmentState
    delivered: bool
    why: str
    confirmed_by: str | None = None
    layer: int | None = None


@dataclass(frozen=True, slots=True)
class CommandRow:
    """A command in the outbox (no answer yet), or answered by the life `life`.

    `made_us`: when it was written down.
    """

    id: str
    vehicle: str
    assignment: str | None
    deed: Deed
    by: str
    answer: Answered | None
    reason: str
    life: str | None
    made_us: int


def assignment_id(order: str, attempt: int) -> str:
    """One for each attempt at an order: two desks that try at once use the same."""
    return f"{order}.{attempt}"


def ends_as(outcome: str, delivered: bool, home: bool) -> AssignmentState:
    """How an assignment ends, by the outcome of its flight (docs/reference/outcomes.md).

    A drone that a person has taken over and landed is no loss: that person has it.
    """
    if outcome != TAKEN and (outcome in ("DEL", "FAIL") or not home):
        return AssignmentState.LOST
    return AssignmentState.DELIVERED if delivered else AssignmentState.RETURNED


def settled_as(settled: Settled) -> tuple[AssignmentState, OrderState]:
    """How a person's word ends an assignment and its order.

    A parcel that is lost is not stuck: nobody is asked any more. One that is back goes out again.
    """
    return {
        Settled.DELIVERED: (AssignmentState.DELIVERED, OrderState.DELIVERED),
        Settled.LOST: (AssignmentState.LOST, OrderState.CANCELLED),
        Settled.BACK: (AssignmentState.RETURNED, OrderState.OPEN),
    }[settled]


def order_after(
    state: AssignmentState, delivered: bool, attempts: int, elsewhere: bool = False
) -> OrderState:
    """The state of an order when its assignment has ended.

    A parcel aboard a lost vehicle, or one that is not known to be home (`elsewhere`: it may have
    been dropped, or lies where a person landed it), is not sent again by itself: a person looks,
    and decides.
    """
    if delivered or state is AssignmentState.DELIVERED:
        return OrderState.DELIVERED
    if state is AssignmentState.LOST or elsewhere:
        return OrderState.STUCK
    if state is AssignmentState.WITHDRAWN:
        return OrderState.OPEN
    return OrderState.OPEN if attempts < ATTEMPTS else OrderState.STUCK
