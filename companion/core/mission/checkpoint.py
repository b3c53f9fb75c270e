"""State that survives a restart: enough to continue the flight, never more energy."""

from typing import Any, Literal

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from companion.core.routing.route_planner import Plan


class Checkpoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Content of a checkpoint. `flight` is a digest of flight file and airframe.

    `home` and `wanted`: the stop at which the uploaded mission ends, and the stop that the truck
    requested.

    `disarmed_by_another`: the vehicle was armed by the companion and disarmed by someone else:
    never re-armed. `took_off_from`: latitude and longitude (deg) of the autopilot's home at
    takeoff, and the AMSL height of the ground there; `led_to`: substitute destination of an RTL.

    `authority`: the companion had control when this was written. `authorised`: the mission's
    authorisation has been used. `settings_before` are autopilot parameters to restore.
    """

    format: Literal["companion-checkpoint/1"] = "companion-checkpoint/1"
    flight: str
    t_s: float
    phase: str
    authority: bool
    authorised: bool
    flying: bool
    finished: bool
    delivered: bool
    gate_closed: str
    leg: int
    took_off_s: float | None
    plan: Plan | None
    frame: LocalFrame | None
    rally: str | None
    home: str | None = None
    wanted: str | None = None
    asides: bool = False
    drop_begun: bool = False
    disarmed_by_another: bool = False
    took_off_from: tuple[float, float, float] | None = None
    led_to: tuple[float, float, float] | None = None
    settings_before: dict[str, float]
    judgement: dict[str, Any]


def checkpoint_from_dict(table: dict[str, Any], document_name: str) -> Checkpoint:
    """Validate a checkpoint; LeewayError names the file and the key."""
    try:
        return msgspec.convert(table, Checkpoint)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{document_name}: {error}") from error


def checkpoint_to_dict(checkpoint: Checkpoint) -> dict[str, Any]:
    """Return the checkpoint as JSON-compatible values."""
    return msgspec.to_builtins(checkpoint)
