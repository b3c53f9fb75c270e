"""Holds: vehicles that are given no work and are not launched until a person releases them."""

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.wire_message import Name

ALL = "*"
"""The scope of a hold of every drone, those that join later included. No vehicle has this name."""


def check_vehicle(name: str) -> None:
    """Raise LeewayError where this cannot be a vehicle's name."""
    try:
        msgspec.convert(name, Name)
    except msgspec.ValidationError as error:
        raise LeewayError(f"vehicle {name!r}: {error}") from error


@dataclass(frozen=True, slots=True)
class Hold:
    """One hold in force. `scope`: a vehicle, or `ALL`."""

    scope: str
    reason: str
    by: str
    set_us: int

    @property
    def is_of_one(self) -> bool:
        """Whether it holds one vehicle only."""
        return self.scope != ALL

    @property
    def words(self) -> str:
        """The hold in words."""
        name = "every drone" if self.scope == ALL else self.scope
        return f"{name} is held by {self.by}: {self.reason}"


def holding(holds: Iterable[Hold], vehicle: str) -> Hold | None:
    """The hold that a vehicle is under; its own before one of all. None: it may be launched."""
    mine = [hold for hold in holds if hold.scope in (vehicle, ALL)]
    return min(mine, key=lambda hold: hold.scope == ALL, default=None)
