"""The suite: every behaviour on its own, in the order of the states that they need."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from typing import Protocol

from sim_bridge.conform.behaviour import Behaviour, Observation, Where
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
from sim_bridge.conform.errors import ConformError, ObservationError, VehicleSilent
from sim_bridge.conform.subject import Subject

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


class Observer(Protocol):
    """Follows the progress of a run."""

    def on_behaviour_start(self, behaviour: Behaviour) -> None: ...
    def on_behaviour_end(self, behaviour: Behaviour, seen: Observation) -> None: ...


def select_behaviours(selectors: Iterable[str], *, include_reboots: bool) -> list[Behaviour]:
    """Select behaviours by families, names or patterns; all if none is given.

    Behaviours that reboot the autopilot only if that is allowed. A filter without a match is an
    error.
    """
    names = {name for word in selectors for name in _matching_behaviour_names(word)} or set(BY_NAME)
    found = [
        b for b in CATALOGUE if b.name in names and (include_reboots or b.where is not Where.REBOOT)
    ]
    return sorted(found, key=lambda behaviour: _ORDER.index(behaviour.where))


def _matching_behaviour_names(selector: str) -> list[str]:
    found = [b.name for b in CATALOGUE if b.group_name == selector or fnmatch(b.name, selector)]
    if not found:
        groups = ", ".join(dict.fromkeys(b.group_name for b in CATALOGUE))
        raise ConformError(f"--only {selector}: no such behaviour; the families are {groups}")
    return found


def request_vehicle_identity(subject: Subject) -> VehicleIdentity:
    """Name, version and commit of the firmware, as AUTOPILOT_VERSION has them."""
    client = subject.client
    client.request_message("AUTOPILOT_VERSION")
    version = client.wait_next_message("AUTOPILOT_VERSION", 3.0) or client.latest.get(
        "AUTOPILOT_VERSION"
    )
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
) -> dict[str, Observation]:
    """Observe the behaviours one after the other; a silent vehicle ends the run."""
    found: dict[str, Observation] = {}
    silent = ""
    for behaviour in behaviours:
        observer.on_behaviour_start(behaviour)
        try:
            seen = Observation(None, problem=silent) if silent else _observe(subject, behaviour)
        except VehicleSilent as error:
            silent = f"the vehicle fell silent: {error}"
            seen = Observation(None, problem=silent)
        except ObservationError as error:
            seen = Observation(None, problem=str(error))
        found[behaviour.name] = seen
        observer.on_behaviour_end(behaviour, seen)
    return found


def _observe(subject: Subject, behaviour: Behaviour) -> Observation:
    if behaviour.where is Where.AIR:
        subject.prepare_in_air()
    else:
        subject.prepare_on_ground()
    subject.client.clear_received()
    with subject.client.limit_duration(_LIMIT_S):
        seen = behaviour.probe(subject)
    return seen if isinstance(seen, Observation) else Observation(seen)
