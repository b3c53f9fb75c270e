"""The suite: every behaviour on its own, in the order of the states that they need."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import Behaviour, Finding, Value, Where
from sim_bridge.conform.behaviours import (
    battery,
    guided,
    landing,
    mission,
    mission_flight,
    modes_and_arming,
    parameters,
    people,
    restart,
    telemetry,
    unknown,
    wind,
)
from sim_bridge.conform.errors import CannotSee, ConformError, VehicleSilent
from sim_bridge.conform.subject import Subject, message_id

CATALOGUE: tuple[Behaviour, ...] = (
    *telemetry.BEHAVIOURS,
    *unknown.BEHAVIOURS,
    *parameters.BEHAVIOURS,
    *people.BEHAVIOURS,
    *mission.BEHAVIOURS,
    *modes_and_arming.BEHAVIOURS,
    *battery.BEHAVIOURS,
    *wind.BEHAVIOURS,
    *guided.BEHAVIOURS,
    *mission_flight.BEHAVIOURS,
    *landing.BEHAVIOURS,
    *restart.BEHAVIOURS,
)
BY_NAME = {behaviour.name: behaviour for behaviour in CATALOGUE}
_ORDER = tuple(Where)
_LIMIT_S = 300.0
_COMMIT_DIGITS = 10


@dataclass(frozen=True, slots=True)
class VehicleIdentity:
    """Autopilot and firmware that the vehicle reports."""

    autopilot: str
    firmware: str
    hash: str


@dataclass(frozen=True, slots=True)
class BehaviourRecord:
    """What was observed of one behaviour, or why it could not be."""

    behaviour: Behaviour
    value: Value | None
    note: str = ""
    problem: str = ""


class Observer(Protocol):
    """Follows the progress of a run."""

    def begins(self, behaviour: Behaviour) -> None: ...
    def ended(self, row: BehaviourRecord) -> None: ...


def select(only: Iterable[str], *, reboots: bool) -> list[Behaviour]:
    """The behaviours of some families, names or patterns; all without any.

    Those that reboot the autopilot only if that is allowed. A word that matches none is refused.
    """
    words = list(only)
    chosen = {name for word in words for name in _named(word)} if words else set(BY_NAME)
    found = [b for b in CATALOGUE if b.name in chosen and (reboots or b.where is not Where.REBOOT)]
    return sorted(found, key=lambda behaviour: _ORDER.index(behaviour.where))


def _named(word: str) -> list[str]:
    found = [b.name for b in CATALOGUE if b.family == word or fnmatch(b.name, word)]
    if not found:
        families = ", ".join(dict.fromkeys(b.family for b in CATALOGUE))
        raise ConformError(f"--only {word}: no such behaviour; the families are {families}")
    return found


def identify(subject: Subject) -> VehicleIdentity:
    """Name, version and commit of the firmware, as AUTOPILOT_VERSION has them."""
    client = subject.client
    client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id("AUTOPILOT_VERSION"))
    version = client.hear("AUTOPILOT_VERSION", 3.0) or client.latest.get("AUTOPILOT_VERSION")
    if version is None:
        return VehicleIdentity(subject.dialect.name, "unknown", "")
    number = version.flight_sw_version
    firmware = f"{number >> 24}.{number >> 16 & 0xFF}.{number >> 8 & 0xFF}"
    custom = bytes(version.flight_custom_version)
    # PX4 sends the commit's bytes backwards, ArduPilot its first characters
    commit = bytes(reversed(custom)).hex() if subject.is_px4 else custom.decode("ascii", "replace")
    return VehicleIdentity(subject.dialect.name, firmware, commit.rstrip("\0")[:_COMMIT_DIGITS])


def run_suite(
    subject: Subject, behaviours: Sequence[Behaviour], observer: Observer
) -> list[BehaviourRecord]:
    """Observe the behaviours one after the other; a silent vehicle ends the run."""
    rows: list[BehaviourRecord] = []
    silent = ""
    for behaviour in behaviours:
        observer.begins(behaviour)
        try:
            if silent:
                row = BehaviourRecord(behaviour, None, problem=silent)
            else:
                row = _see(subject, behaviour)
        except VehicleSilent as error:
            silent = f"the vehicle fell silent: {error}"
            row = BehaviourRecord(behaviour, None, problem=silent)
        rows.append(row)
        observer.ended(row)
    return rows


def _see(subject: Subject, behaviour: Behaviour) -> BehaviourRecord:
    try:
        _prepare(subject, behaviour.where)
        subject.client.forget()
        with subject.client.limited_to(_LIMIT_S):
            seen = behaviour.see(subject)
    except VehicleSilent:
        raise
    except CannotSee as error:
        return BehaviourRecord(behaviour, None, problem=str(error))
    if isinstance(seen, Finding):
        return BehaviourRecord(behaviour, seen.value, seen.note)
    return BehaviourRecord(behaviour, seen)


def _prepare(subject: Subject, where: Where) -> None:
    if where is Where.AIR:
        subject.in_air()
    else:
        subject.on_ground()
