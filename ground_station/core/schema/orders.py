"""Orders, assignments and their states, shared by store and desk."""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import msgspec
from msgspec import Meta

from companion.core.base.errors import LeewayError, check_range
from companion.core.base.location import Location
from companion.fleet.messages import CommandAction, CommandStatus
from ground_station.core.schema.order_states import OrderState, ParcelOutcome, Service

OrderId = Annotated[
    str, Meta(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*\Z")
]


ORDER_BOUNDS = {
    "lat_deg": (-85.0, 85.0),
    "lon_deg": (-180.0, 180.0),
    "alt_amsl_m": (-500.0, 9000.0),
    "mass_kg": (0.0, 500.0),
}
"""Ranges of an order's numbers."""


class Order(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One parcel to one destination. `alt_amsl_m`: height of the ground there (safety rule 8).

    `note` is for operators and has no effect on decisions.
    """

    id: OrderId
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    mass_kg: float
    service: Service = Service.ANY
    note: Annotated[str, Meta(max_length=500)] = ""

    def __post_init__(self) -> None:
        for key, (low, high) in ORDER_BOUNDS.items():
            check_range(key, getattr(self, key), low, high)


def order_location(order: Order) -> Location:
    """Return the destination of an order, as the customer of a flight file."""
    try:
        return Location(
            name=order.id, lat_deg=order.lat_deg, lon_deg=order.lon_deg, alt_amsl_m=order.alt_amsl_m
        )
    except LeewayError as error:
        raise LeewayError(f"order {order.id}: {error}") from error


class AssignmentState(Enum):
    """States of an assignment, from its creation to its end.

    An assignment in force (`IN_FORCE`) reserves its order and its vehicle.
    """

    ORDERED = "ordered"
    UPLOADED = "aboard"
    IN_FLIGHT = "flying"
    WITHDRAWING = "withdrawing"
    DELIVERED = "delivered"
    RETURNED = "returned"
    LOST = "lost"
    REFUSED = "refused"
    WITHDRAWN = "withdrawn"


IN_FORCE = (
    AssignmentState.ORDERED,
    AssignmentState.UPLOADED,
    AssignmentState.IN_FLIGHT,
    AssignmentState.WITHDRAWING,
)

OVERRIDE_OUTCOME = "TAKEN"
"""Outcome of a flight that a pilot took over and landed elsewhere."""

MAX_ATTEMPTS = 3
"""Flights of an order until an operator must check it."""


@dataclass(frozen=True, slots=True)
class OrderRow:
    """An order and its state."""

    order: Order
    state: OrderState
    attempts: int
    reason: str


@dataclass(frozen=True, slots=True)
class AssignmentRow:
    """An assignment of an order to a vehicle. `confirmed_by`: the operator who permits the launch.

    `layer`: over the depot, from 0; None: its plan has the height.
    """

    id: str
    order_id: str
    vehicle: str
    state: AssignmentState
    delivered: bool
    reason: str
    confirmed_by: str | None = None
    layer: int | None = None


@dataclass(frozen=True, slots=True)
class CommandRow:
    """A command in the outbox: without a response yet, or answered by the instance `instance_id`.

    `created_us`: time of its creation.
    """

    id: str
    vehicle: str
    assignment: str | None
    command: CommandAction
    issuer: str
    response: CommandStatus | None
    reason: str
    instance_id: str | None
    created_us: int


ROOT_CHARS, EPOCH_CHARS = 4, 7
"""An epoch is drawn when a store is created and when a copy is restored. Its first characters are
those of all epochs of that store, so that assignments of a lost epoch are recognised.
"""


def assignment_id(order: str, epoch: str, attempt: int) -> str:
    """Return one id for each attempt at an order: two desks that try at once use the same.

    `epoch`: of the store; empty in a store of an earlier version.
    """
    return ".".join(part for part in (order, epoch, str(attempt)) if part)


def is_assignment_of_epochs_root(assignment: str, order: str, epoch: str) -> bool:
    """Return whether an assignment of this order was issued by the store, or a lost epoch of it."""
    root = epoch[:ROOT_CHARS]
    return bool(root) and assignment.startswith(f"{order}.{root}")


def final_assignment_state(outcome: str, delivered: bool, is_home: bool) -> AssignmentState:
    """Return the end of an assignment by the outcome of its flight (docs/reference/outcomes.md).

    A drone that a pilot took over and landed is not lost: the pilot has it.
    """
    if outcome != OVERRIDE_OUTCOME and (outcome in ("DEL", "FAIL") or not is_home):
        return AssignmentState.LOST
    return AssignmentState.DELIVERED if delivered else AssignmentState.RETURNED


def assignment_and_order_state_after_outcome(
    parcel_outcome: ParcelOutcome,
) -> tuple[AssignmentState, OrderState]:
    """Return the end of an assignment and its order by an operator's report.

    The order of a lost parcel is cancelled, not stuck. A returned parcel is sent again.
    """
    return {
        ParcelOutcome.DELIVERED: (AssignmentState.DELIVERED, OrderState.DELIVERED),
        ParcelOutcome.LOST: (AssignmentState.LOST, OrderState.CANCELLED),
        ParcelOutcome.BACK: (AssignmentState.RETURNED, OrderState.OPEN),
    }[parcel_outcome]


def order_state_after_assignment(
    assignment_state: AssignmentState,
    delivered: bool,
    attempts: int,
    is_not_known_home: bool = False,
) -> OrderState:
    """Return the state of an order after the end of its assignment.

    A parcel on a lost vehicle, or one not known to be home (`is_not_known_home`: it may have been
    dropped, or is where a pilot landed it), is not sent again automatically: an operator checks and
    decides.
    """
    if delivered or assignment_state is AssignmentState.DELIVERED:
        return OrderState.DELIVERED
    if assignment_state is AssignmentState.LOST or is_not_known_home:
        return OrderState.STUCK
    if assignment_state is AssignmentState.WITHDRAWN:
        return OrderState.OPEN
    return OrderState.OPEN if attempts < MAX_ATTEMPTS else OrderState.STUCK
