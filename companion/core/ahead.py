"""From a plan and where the vehicle is to the gate's question: what is left to fly."""

from companion.core.airframe import Airframe
from companion.core.gate import Ahead
from companion.core.geo import Ned
from companion.core.planner import Plan


def ahead_outbound(
    plan: Plan,
    airframe: Airframe,
    position_ned_m: Ned,
    next_index: int,
    payload_kg: float,
    drop_height_m: float,
    drop_s: float,
    cruise_height_m: float,
    settle_left_s: float = 0.0,
) -> Ahead:
    """Still outbound, flying to `plan.outbound_ned_m[next_index]` (take-off and settle included
    when the vehicle is low over the depot). The decision points are the outbound waypoints.
    """
    raise NotImplementedError


def ahead_delivering(
    plan: Plan,
    airframe: Airframe,
    position_ned_m: Ned,
    payload_kg: float,
    drop_height_m: float,
    drop_s: float,
    cruise_height_m: float,
) -> Ahead:
    """At the customer, parcel still aboard: descend, drop, climb, return."""
    raise NotImplementedError


def ahead_returning(
    plan: Plan,
    airframe: Airframe,
    position_ned_m: Ned,
    return_index: int | None,
    payload_kg: float,
    delivered: bool,
    cruise_height_m: float,
    rally_name: str | None = None,
) -> Ahead:
    """On the way back to `plan.return_ned_m[return_index]` (None: on the last descent), or on
    the way to a rally point. `payload_kg` 0 once the release is confirmed.
    """
    raise NotImplementedError
