"""A behaviour: one test of a vehicle, with a machine-readable result."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim_bridge.conform.subject import Subject

Value = str | float | int | bool


@dataclass(frozen=True, slots=True)
class Observation:
    """An observed result: a comparable value, and a note for human readers.

    A behaviour that could not be observed has a problem instead of a value.
    """

    value: Value | None
    note: str = ""
    problem: str = ""


class Where(Enum):
    """The state of the vehicle before a behaviour is observed."""

    GROUND = "on the ground, disarmed, without a mission"
    AIR = "hovering 20 m above home, without a mission"
    FLIGHT = "on the ground; the behaviour flies by itself"
    REBOOT = "on the ground; the behaviour reboots the autopilot"


GROUND, AIR, FLIGHT, REBOOT = Where
Probe = Callable[["Subject"], Observation | Value]


@dataclass(frozen=True, slots=True)
class Behaviour:
    """One named behaviour.

    `within` and `within_frac` (of the reference) are tolerances: two numbers match if they differ
    by at most the larger one. Texts and booleans must be equal.
    """

    name: str
    description: str
    probe: Probe
    where: Where = Where.GROUND
    unit: str = ""
    within: float = 0.0
    within_frac: float = 0.0

    @property
    def group_name(self) -> str:
        """The part of the name before the slash."""
        return self.name.partition("/")[0]

    def is_same(self, value: Value, reference: Value) -> bool:
        """Return True if two results are the same behaviour."""
        if not (_is_number(value) and _is_number(reference)):
            return value == reference
        value, reference = float(value), float(reference)
        tolerance = max(self.within, self.within_frac * abs(reference))
        return math.isclose(value, reference, rel_tol=1e-6, abs_tol=tolerance)


def acknowledgement(command_number: int, *params: float) -> Probe:
    """Return a probe that sends a COMMAND_LONG and observes the result of its COMMAND_ACK."""
    return lambda subject: subject.client.send_command_and_wait_ack(command_number, *params)


def field_of(observe: Callable[["Subject"], Any], field_name: str) -> Probe:
    """Return a probe for one field of an observation that several behaviours share."""
    return lambda subject: getattr(observe(subject), field_name)


class Behaviours(list[Behaviour]):
    """Behaviours of one module, in the order of their definition."""

    def add(
        self,
        name: str,
        description: str,
        probe: Probe,
        where: Where = Where.GROUND,
        **tolerance: Any,
    ) -> None:
        """Add a behaviour; `tolerance`: the unit and tolerances of `Behaviour`."""
        self.append(Behaviour(name, description, probe, where, **tolerance))

    def register_as_behaviour(
        self, name: str, description: str, where: Where = Where.GROUND, **tolerance: Any
    ) -> Callable[[Probe], Probe]:
        """Register a function that observes a behaviour; to be used as a decorator."""

        def register(probe: Probe) -> Probe:
            self.add(name, description, probe, where, **tolerance)
            return probe

        return register


def _is_number(value: Value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
