"""Commands that an operator may give on the map."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Name = Annotated[str, Meta(min_length=1, max_length=64)]
Reason = Annotated[str, Meta(min_length=1, max_length=200)]


class _WebCommand(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="do"
):
    """One command of an operator. `vehicle` None: every drone."""


class RecallDrone(_WebCommand, frozen=True, kw_only=True, tag="recall"):
    """Recall a drone, or all online drones, and hold the recalled ones."""

    vehicle: Name | None = None


class HoldDrone(_WebCommand, frozen=True, kw_only=True, tag="hold"):
    """Hold one drone or all drones on the ground. `is_out`: the drone is out of service; its order
    on the ground goes to another one. `spare`: a drone that joins in its place.
    """

    reason: Reason
    vehicle: Name | None = None
    is_out: bool = msgspec.field(default=False, name="out_of_service")
    spare: Name | None = None


class ReleaseDrone(_WebCommand, frozen=True, kw_only=True, tag="release"):
    """Release the hold of one drone, or the hold of all."""

    vehicle: Name | None = None


class ConfirmLaunch(_WebCommand, frozen=True, kw_only=True, tag="confirm"):
    """Permit one launch of the drone with this order. `pack`: fitted to it."""

    order: Name
    pack: Name | None = None


class SettleOrder(_WebCommand, frozen=True, kw_only=True, tag="settle"):
    """Close an order whose vehicle cannot report the outcome."""

    order: Name
    settled: Literal["delivered", "lost", "back"]
    reason: Reason


class AddOrder(_WebCommand, frozen=True, kw_only=True, tag="add"):
    """Add an order from its cells, as a row of an order file. `check`: only report whether a drone
    can deliver it.
    """

    cells: dict[Name, Annotated[str, Meta(max_length=500)]]
    check: bool = False


class ImportOrders(_WebCommand, frozen=True, kw_only=True, tag="import"):
    """Add all orders of a file, or none. `check`: only report what would be added."""

    file: Annotated[str, Meta(pattern=r"^[^/\\]{1,80}\.(csv|txt|tsv|xlsx|geojson)\Z")]
    content: bytes
    check: bool = False


class ChangeOrder(_WebCommand, frozen=True, kw_only=True, tag="change"):
    """Change fields of an order: cells of an order file, by column; an empty one clears it."""

    order: Name
    cells: dict[Name, Annotated[str, Meta(max_length=500)]]


class CancelOrder(_WebCommand, frozen=True, kw_only=True, tag="cancel"):
    """Cancel an order that is not in the air; on the ground its assignment is withdrawn.
    `to_sender`: its parcel goes back to the sender.
    """

    order: Name
    reason: Reason
    to_sender: bool = False


class HandOver(_WebCommand, frozen=True, kw_only=True, tag="hand_over"):
    """Hand over the shift, with a note for the next dispatcher."""

    note: Reason


class AcceptHandover(_WebCommand, frozen=True, kw_only=True, tag="accept"):
    """Accept the shift that another dispatcher has handed over."""


OrderCommand = AddOrder | ImportOrders | ChangeOrder | CancelOrder
ShiftCommand = HandOver | AcceptHandover
WebCommand = (
    RecallDrone
    | HoldDrone
    | ReleaseDrone
    | ConfirmLaunch
    | SettleOrder
    | OrderCommand
    | ShiftCommand
)
