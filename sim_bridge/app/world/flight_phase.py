"""Flight phases from ground truth, used by faults, scenario files and views."""

from enum import StrEnum
from math import dist

Ne = tuple[float, float]

DROP_RADIUS_M, LAND_RADIUS_M = 15.0, 10.0


class FlightPhase(StrEnum):
    """Phase of a flight; the values are those of the command line and of JSON."""

    STOWED = "stowed"
    """Powered off, or powered on without a flight."""
    READY = "ready"
    """On its pad before take-off."""
    CLIMB = "climb"
    OUTBOUND = "outbound"
    DROP = "drop"
    """With the parcel, near the customer."""
    RETURN = "return"
    LAND = "land"
    """Without the parcel, low over its landing site."""
    DOWN = "down"
    """On the ground after the flight."""

    def is_same_or_before(self, other_phase: "FlightPhase") -> bool:
        """Return whether `other_phase` is this phase or a later one."""
        order = list(FlightPhase)
        return order.index(other_phase) >= order.index(self)


FILE_PHASE_NAMES = {"start": FlightPhase.READY, "landing": FlightPhase.LAND}
"""Names of phases in flight files (`flight/1`) that differ from the values of `FlightPhase`."""


def parse_file_phase(name: str) -> FlightPhase:
    """Return the phase for its name in a flight file."""
    return FILE_PHASE_NAMES[name] if name in FILE_PHASE_NAMES else FlightPhase(name)


def phase_in_air(
    ne_m: Ne,
    height_m: float,
    *,
    has_parcel: bool,
    pad_ne_m: Ne,
    customer_ne_m: Ne,
    landing_ne_m: Ne,
    climb_radius_m: float = 30.0,
    land_height_m: float = 20.0,
) -> FlightPhase:
    """Return the phase of an airborne vehicle; positions north and east of a common origin (m).

    The climb is within `climb_radius_m` of the pad; a landing begins below `land_height_m`.
    """
    if not has_parcel:
        near = dist(ne_m, landing_ne_m) < LAND_RADIUS_M
        return FlightPhase.LAND if near and height_m < land_height_m else FlightPhase.RETURN
    if dist(ne_m, customer_ne_m) < DROP_RADIUS_M:
        return FlightPhase.DROP
    return FlightPhase.OUTBOUND if dist(ne_m, pad_ne_m) > climb_radius_m else FlightPhase.CLIMB
