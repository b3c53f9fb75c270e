"""What survives a restart of the companion: enough to go on with the flight, never more energy."""

from typing import Any, Literal

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from companion.core.routing.route_planner import Plan


class Checkpoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A checkpoint's content. `flight` is a digest of flight file and airframe.

    `home` and `wanted`: the stop at which what is aboard ends, and the one that the truck asked
    for.

    `disarmed_by_another`: what we armed was disarmed by another hand: never armed again.
    `took_off_from`: latitude and longitude (deg) of the autopilot's home at take-off, and the AMSL
    of the ground there; `led_to`: where an RTL was led to instead.

    `authority`: the companion flew the vehicle when this was written. `authorised`: the mission's
    authorisation has been used. `settings_before` are autopilot parameters to put back.
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


def checkpoint_from_dict(table: dict[str, Any], where: str) -> Checkpoint:
    """Check a checkpoint that was read; LeewayError names the file and the key."""
    try:
        return msgspec.convert(table, Checkpoint)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{where}: {error}") from error


def checkpoint_to_dict(checkpoint: Checkpoint) -> dict[str, Any]:
    """Plain JSON-safe values."""
    return msgspec.to_builtins(checkpoint)
