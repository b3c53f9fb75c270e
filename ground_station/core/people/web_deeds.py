"""What a person may order from the map."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Name = Annotated[str, Meta(min_length=1, max_length=64)]
Reason = Annotated[str, Meta(min_length=1, max_length=200)]


class _Deed(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="do"):
    """One order of a person. `vehicle` None: every drone."""


class RecallDrone(_Deed, frozen=True, kw_only=True, tag="recall"):
    """Recall a drone, or all that are heard, and hold what is recalled."""

    vehicle: Name | None = None


class HoldDrone(_Deed, frozen=True, kw_only=True, tag="hold"):
    """Hold a drone on the ground, or all."""

    reason: Reason
    vehicle: Name | None = None


class ReleaseDrone(_Deed, frozen=True, kw_only=True, tag="release"):
    """Lift the hold of a drone, or that of all."""

    vehicle: Name | None = None


class ConfirmLaunch(_Deed, frozen=True, kw_only=True, tag="confirm"):
    """Let the drone that has this order be launched, once."""

    order: Name


class SettleOrder(_Deed, frozen=True, kw_only=True, tag="settle"):
    """Close an order whose vehicle cannot tell what has become of it."""

    order: Name
    settled: Literal["delivered", "lost", "back"]
    reason: Reason


WebDeed = RecallDrone | HoldDrone | ReleaseDrone | ConfirmLaunch | SettleOrder
