"""Sources of launch holds that the desk places and clears by itself."""

from enum import StrEnum


class HoldSource(StrEnum):
    """Source of a hold by the desk; the value is its author in the store, which no operator can be.

    Operators may release these holds; the desk releases no operator's hold. A source places and
    clears only its own holds.
    """

    WIND = "desk-wind:aloft"
    FRONT = "desk-wind:front"
    ZONE = "desk-wind:zone"
    FORECAST = "desk-wind:forecast"
    UNKNOWN = "desk-wind"
    """Any of the others: earlier versions stored all holds with this author. Never due."""


HoldKey = tuple[str, HoldSource]
"""Key of a hold by the desk: its scope (a vehicle, or `ALL_DRONES`) and its source."""
