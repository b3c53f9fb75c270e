"""A behaviour: one question to a vehicle, and the machine-readable answer."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim_bridge.conform.subject import Subject

Value = str | float | int | bool


@dataclass(frozen=True, slots=True)
class Finding:
    """What a vehicle did: a value that can be compared, and a note for people."""

    value: Value
    note: str = ""


class Where(Enum):
    """The state of the vehicle before a behaviour is observed."""

    GROUND = "on the ground, disarmed, without a mission"
    AIR = "hovering 20 m above home, without a mission"
    FLIGHT = "on the ground; the behaviour flies by itself"
    REBOOT = "on the ground; the behaviour reboots the autopilot"


@dataclass(frozen=True, slots=True)
class Behaviour:
    """One named behaviour.

    `within` and `within_frac` (of the reference) are the tolerances within which two
    numbers are the same behaviour; the wider one holds. Texts and booleans have to be equal.
    """

    name: str
    says: str
    see: Callable[["Subject"], Finding | Value]
    where: Where = Where.GROUND
    unit: str = ""
    within: float = 0.0
    within_frac: float = 0.0

    @property
    def family(self) -> str:
        """The part of the name before the slash."""
        return self.name.partition("/")[0]

    def is_same(self, value: Value, reference: Value) -> bool:
        """Whether two answers are the same behaviour."""
        return same(value, reference, max(self.within, self.within_frac * _size(reference)))


def _is_number(value: Value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _size(value: Value) -> float:
    return abs(float(value)) if _is_number(value) else 0.0


def same(value: Value, reference: Value, tolerance: float) -> bool:
    """Whether two answers agree, numbers within `tolerance`."""
    if _is_number(value) and _is_number(reference):
        return math.isclose(float(value), float(reference), rel_tol=1e-6, abs_tol=tolerance)
    return value == reference
