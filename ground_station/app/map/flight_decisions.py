"""What the drones decided, by the words of their events: the last of each, and where it lands."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from companion.fleet.messages import FleetEvent, State
from ground_station.adapters.store.decision_reader import HeardDecision

DIVERT = "divert"
LANDINGS = (DIVERT, "turn_back", "move_home", "onward_again", "last_resort", "landed", "finished")
"""Kinds of decision that choose where a flight lands, or end it: each voids the one before."""

DIVERTED_PHASES = ("divert", "land", "link lost", "recognise")
"""Phases in which a diversion that was decided is in force: in any other somebody else flies."""


class Decisions(Protocol):
    """Who knows what was decided."""

    def last(self, state: State | None) -> HeardDecision | None:
        """The last decision on the flight that this drone is on."""
        ...

    def diverted_to(self, state: State | None) -> str | None:
        """The name of the place that a diversion in force lands at; None: there is none."""
        ...


@dataclass(slots=True)
class FlightDecisions:
    """The decisions of a fleet, as they come."""

    _last: dict[str, HeardDecision] = field(default_factory=dict)
    _landing: dict[str, HeardDecision] = field(default_factory=dict)

    def note(self, heard: HeardDecision) -> None:
        """Take a decision; each is newer than those before it."""
        self._last[heard.event.vehicle] = heard
        if _kind(heard.event) in LANDINGS:
            self._landing[heard.event.vehicle] = heard

    def last(self, state: State | None) -> HeardDecision | None:
        """The last decision on the flight that this drone is on."""
        return _on_this_flight(self._last, state)

    def diverted_to(self, state: State | None) -> str | None:
        """The name of the place that a diversion in force lands at; None: there is none."""
        decision = _on_this_flight(self._landing, state)
        if state is None or state.phase not in DIVERTED_PHASES or decision is None:
            return None
        kind, _, words = decision.event.text.partition(": ")
        return words.removeprefix("to ").partition(":")[0] if kind == DIVERT else None


def _kind(event: FleetEvent) -> str:
    return event.text.partition(": ")[0]


def _on_this_flight(
    found: Mapping[str, HeardDecision], state: State | None
) -> HeardDecision | None:
    if state is None or state.assignment is None:
        return None
    decision = found.get(state.vehicle)
    return decision if decision and decision.event.assignment == state.assignment else None
