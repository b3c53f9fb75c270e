"""Energy that flights use, by the states that their drones report."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

from companion.fleet.messages import State
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.shift.pack_store import record_flight_energy
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.orders import AssignmentRow


@dataclass(slots=True)
class EnergyUse:
    """First and last reported energy of each flight, until it is taken."""

    _wh: dict[str, tuple[float, float]] = field(default_factory=dict)

    def record_state(self, state: State) -> None:
        """Process a state."""
        id_, left_wh = state.assignment, state.energy_left_wh
        if state.armed and id_ and left_wh is not None:
            self._wh[id_] = (self._wh.get(id_, (left_wh, 0.0))[0], left_wh)

    def store_finished(
        self, database: Database, clock: Clock, in_force: Iterable[AssignmentRow]
    ) -> None:
        """Store the energy of flights that are over."""
        for id_, used_wh in self.pop_finished_wh({row.id for row in in_force}).items():
            record_flight_energy(database, clock.epoch_us(), id_, used_wh)

    def pop_finished_wh(self, in_force: Collection[str]) -> dict[str, float]:
        """Return once the energy of each flight whose assignment is not in force."""
        over = [id_ for id_ in self._wh if id_ not in in_force]
        pairs = {id_: self._wh.pop(id_) for id_ in over}
        return {id_: max(0.0, first_wh - last_wh) for id_, (first_wh, last_wh) in pairs.items()}
