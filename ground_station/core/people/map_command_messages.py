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
    """Hold one drone or all drones on the ground."""

    reason: Reason
    vehicle: Name | None = None


class ReleaseDrone(_WebCommand, frozen=True, kw_only=True, tag="release"):
    """Release the hold of one drone, or the hold of all."""

    vehicle: Name | None = None


class ConfirmLaunch(_WebCommand, frozen=True, kw_only=True, tag="confirm"):
    """Permit one launch of the drone with this order."""

    order: Name


class SettleOrder(_WebCommand, frozen=True, kw_only=True, tag="settle"):
    """Close an order whose vehicle cannot report the outcome."""

    order: Name
    settled: Literal["delivered", "lost", "back"]
    reason: Reason


WebCommand = RecallDrone | HoldDrone | ReleaseDrone | ConfirmLaunch | SettleOrder
