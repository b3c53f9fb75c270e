"""Decisions of the drones from their events: the latest of each, and its landing site."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from companion.core.mission.event_text import DELIVERED, DIVERT, DecisionEvent
from companion.fleet.messages import State
from ground_station.adapters.store.decision_reader import ReceivedDecision

LANDING_DECISION_KINDS = (
    DIVERT,
    "turn_back",
    "move_home",
    "onward_again",
    "last_resort",
    "landed",
    "finished",
)
"""Decision kinds that choose a landing site or end a flight: each voids the one before."""

DIVERTED_PHASES = ("divert", "land", "link lost", "recognise")
"""Phases in which a diversion is in force: in any other phase another controller flies."""


@dataclass(slots=True)
class FlightDecisions:
    """Decisions of a fleet in the order of their arrival."""

    _latest_decisions: dict[str, ReceivedDecision] = field(default_factory=dict)
    _landing_decisions: dict[str, ReceivedDecision] = field(default_factory=dict)
    releases: dict[str, ReceivedDecision] = field(default_factory=dict)
    """Confirmed releases of parcels, by assignment."""

    def record_decision(self, received: ReceivedDecision) -> None:
        """Record a decision; calls are in time order."""
        self._latest_decisions[received.event.vehicle] = received
        kind = DecisionEvent.parse(received.event.text).kind
        if kind == DELIVERED and received.event.assignment:
            self.releases[received.event.assignment] = received
        if kind in LANDING_DECISION_KINDS:
            self._landing_decisions[received.event.vehicle] = received

    def latest_decision_on_flight(self, state: State | None) -> ReceivedDecision | None:
        """Return the latest decision on the drone's current flight."""
        return _decision_on_flight(self._latest_decisions, state)

    def diversion_site_in_force(self, state: State | None) -> str | None:
        """Return the name of the landing site of a diversion in force; None: no diversion."""
        decision = _decision_on_flight(self._landing_decisions, state)
        if state is None or state.phase not in DIVERTED_PHASES or decision is None:
            return None
        return DecisionEvent.parse(decision.event.text).diversion_site


def _decision_on_flight(
    decision_by_vehicle: Mapping[str, ReceivedDecision], state: State | None
) -> ReceivedDecision | None:
    if state is None or state.assignment is None:
        return None
    decision = decision_by_vehicle.get(state.vehicle)
    return decision if decision and decision.event.assignment == state.assignment else None
