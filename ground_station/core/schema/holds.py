"""Holds: vehicles that get no assignment and no launch until an operator releases them; and the
hand-over of a shift.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.wire_message import Name
from companion.fleet.messages import Id

ALL_DRONES = "*"
"""Scope of a hold of every drone, including later members. No vehicle has this name."""
OUT_OF_SERVICE = "out of service: "
"""Prefix of the reason of a hold of a drone that gets no part in any plan."""


def raise_if_invalid_vehicle_name(name: str) -> None:
    """Raise LeewayError if this is no valid vehicle name."""
    try:
        msgspec.convert(name, Name)
    except msgspec.ValidationError as error:
        raise LeewayError(f"vehicle {name!r}: {error}") from error


def raise_if_invalid_pack_name(pack: str) -> None:
    """Raise LeewayError if this is no valid name of a pack."""
    try:
        msgspec.convert(pack, Id)
    except msgspec.ValidationError as error:
        raise LeewayError(f"pack {pack!r}: {error}") from error


@dataclass(frozen=True, slots=True)
class Hold:
    """One hold in force. `scope`: a vehicle, or `ALL_DRONES`."""

    scope: str
    reason: str
    by: str
    set_us: int

    @property
    def subject(self) -> str:
        """The held drones as text."""
        return "every drone" if self.scope == ALL_DRONES else self.scope

    @property
    def is_out_of_service(self) -> bool:
        """Whether its drone is out of service."""
        return self.reason.startswith(OUT_OF_SERVICE)

    @property
    def text(self) -> str:
        """The hold as text."""
        return f"{self.subject} is held by {self.by}: {self.reason}"


class HandoverNote(msgspec.Struct, frozen=True):
    """A note for the next dispatcher."""

    at_us: int
    by: str
    text: str


class Handover(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The latest hand-over of a shift. `accepted_by` empty: the next dispatcher has not read it."""

    by: str
    at_us: int
    notes: list[HandoverNote] = []
    accepted_by: str = ""
    accepted_us: int = 0


def hold_of_vehicle_or_of_all(hold_list: Iterable[Hold], vehicle: str) -> Hold | None:
    """Return the hold of a vehicle, its own before one of all drones; None: it may be launched."""
    applicable = [hold for hold in hold_list if hold.scope in (vehicle, ALL_DRONES)]
    return min(applicable, key=lambda hold: hold.scope == ALL_DRONES, default=None)
