"""Orders, assignments and their states, shared by store and desk."""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import msgspec
from msgspec import Meta

from companion.core.base.errors import LeewayError, check_range
from companion.core.base.location import Location
from companion.core.base.safe_text import flatten_to_one_line
from companion.fleet.messages import CommandAction, CommandStatus
from ground_station.core.schema.order_states import OrderState, ParcelOutcome, Priority, Service
from ground_station.core.schema.order_window import Window, format_window

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
TEXT_LENGTHS = {"customer": 100, "phone": 40, "address": 200}
"""Maximum lengths of the contact data."""
MAX_EPOCH_US, MAX_SERVICE_S = 10**16, 7200.0


class Order(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One parcel to one destination. `alt_amsl_m`: height of the ground there (safety rule 8).

    `customer`, `phone`, `address` and `note` are for people and have no effect on decisions; no
    vehicle receives them. `earliest_us`, `latest_us`: the delivery window. `service_s`: the
    driver's time at the customer, in place of the day's `deliver_s`.
    """

    id: OrderId
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    mass_kg: float
    service: Service = Service.ANY
    note: Annotated[str, Meta(max_length=500)] = ""
    customer: str = ""
    phone: str = ""
    address: str = ""
    earliest_us: int | None = None
    latest_us: int | None = None
    priority: Priority = Priority.NORMAL
    service_s: float | None = None

    def __post_init__(self) -> None:
        for key, (low, high) in ORDER_BOUNDS.items():
            check_range(key, getattr(self, key), low, high)
        if self.service_s is not None:
            check_range("service_s", self.service_s, 0.0, MAX_SERVICE_S)
        for key, most in TEXT_LENGTHS.items():
            if error := contact_text_error(getattr(self, key), most):
                raise LeewayError(f"{key}: {error}")
        for key in ("earliest_us", "latest_us"):
            check_range(key, getattr(self, key) or 0, 0, MAX_EPOCH_US)
        if error := window_error(self.window):
            raise LeewayError(error)

    @property
    def window(self) -> Window:
        """Earliest and latest delivery, epoch microseconds."""
        return self.earliest_us, self.latest_us

    @property
    def is_urgent(self) -> bool:
        """Whether it is delivered before normal orders."""
        return self.priority is Priority.URGENT


def contact_text_error(text: str, max_length: int) -> str:
    """Return the error of contact data; empty: it is one line of visible characters."""
    if len(text) > max_length:
        return f"{len(text)} characters, expected at most {max_length}"
    if flatten_to_one_line(text) != text:
        return f"{flatten_to_one_line(text)!r}: control characters, expected one line of text"
    return ""


def window_error(window: Window) -> str:
    """Return the error of a window that ends before it starts; empty: it is correct."""
    earliest_us, latest_us = window
    if earliest_us is None or latest_us is None or earliest_us < latest_us:
        return ""
    text = f"window {format_window(window)}: ends before it starts"
    return f"{text}, expected an end after the start (across midnight: with both dates)"


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


class DeliveryProof(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The confirmed release of a parcel. `vehicle` empty: a person reported it. Without `lat_deg`
    and `lon_deg` its position is not reported. `photo`: a path and its digest.
    """

    at_us: int
    evidence: str
    vehicle: str = ""
    lat_deg: float | None = None
    lon_deg: float | None = None
    photo: str = ""


class HistoryEntry(msgspec.Struct, frozen=True):
    """A change of an order: time, a person's or vehicle's name if known, and text."""

    at_us: int
    by: str
    text: str


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
    waits_for_person: bool = False,
) -> OrderState:
    """Return the state of an order after the end of its assignment.

    A parcel on a lost vehicle, or one that `waits_for_person` (it may have been dropped, is where a
    pilot landed it, or the driver could not deliver it), is not sent again automatically: an
    operator checks and decides.
    """
    if delivered or assignment_state is AssignmentState.DELIVERED:
        return OrderState.DELIVERED
    if assignment_state is AssignmentState.LOST or waits_for_person:
        return OrderState.STUCK
    if assignment_state is AssignmentState.WITHDRAWN:
        return OrderState.OPEN
    return OrderState.OPEN if attempts < MAX_ATTEMPTS else OrderState.STUCK
