"""Carries out what people order from the map: opens store and network for each deed."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk import person_deeds
from ground_station.app.desk.person_deeds import Deed
from ground_station.core.fleet.fleet_link import FleetLink
from ground_station.core.people.person import Person
from ground_station.core.people.web_deeds import (
    ConfirmLaunch,
    HoldDrone,
    RecallDrone,
    ReleaseDrone,
    SettleOrder,
    WebDeed,
)
from ground_station.core.people.web_tokens import deed_trouble
from ground_station.core.schema.order_states import Settled

WAIT_S = 10.0
"""Time-out of a recall's answers, as the terminal has it."""


@dataclass(frozen=True, slots=True)
class MapPeople:
    """`acting(person)`: who the audit names for them; it may refuse with LeewayError.

    `open_soon`: a store that is there, or StoreError without a long wait.
    """

    acting: Callable[[Person], Person]
    open_store: Callable[[], Store]
    open_soon: Callable[[], Store]
    open_fleet: Callable[[], FleetLink]

    def do(self, person: Person, deed: WebDeed) -> dict[str, Any]:
        """What was done, in words, and what is to be looked at. Raises LeewayError."""
        trouble = deed_trouble(person)
        if trouble:
            raise LeewayError(trouble)
        by = self.acting(person).name
        done = self._recall(deed, by) if isinstance(deed, RecallDrone) else self._write(deed, by)
        return {"words": done.words, "look": done.look}

    def _recall(self, deed: RecallDrone, by: str) -> Deed:
        words, look = list[str](), list[str]()
        with closing(self.open_fleet()) as fleet:
            person_deeds.recall(
                fleet, self.open_soon, deed.vehicle, by, words.append, look.append, WAIT_S
            )
        return Deed(words, look)

    def _write(self, deed: HoldDrone | ReleaseDrone | ConfirmLaunch | SettleOrder, by: str) -> Deed:
        with closing(self.open_store()) as store:
            match deed:
                case HoldDrone():
                    scopes = person_deeds.scopes_of(deed.vehicle)
                    return person_deeds.hold(store, epoch_us, scopes, deed.reason, by)
                case ReleaseDrone():
                    scopes = person_deeds.scopes_of(deed.vehicle)
                    return person_deeds.release(store, epoch_us, scopes, by)
                case ConfirmLaunch():
                    return person_deeds.confirm_launch(store, deed.order, by)
                case SettleOrder():
                    settled = Settled(deed.settled)
                    return person_deeds.settle(
                        store, epoch_us, deed.order, settled, deed.reason, by
                    )
