"""What the play of a fleet's row has to do with: the day, one drone of it, its desks, the time."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.core.pilot.transitions import Phase
from sim_bridge.app.day.build import BuiltDay
from sim_bridge.app.day.bus import Bus
from sim_bridge.app.day.drone import DayDrone, PowerUp
from sim_bridge.app.day.world import DayWorld
from sim_bridge.app.fleet_faults.desks import Desks

STRUCK, CUSTOMER = "d1", "F-1"
"""The drone whose phase decides when the fault begins, and whose flight the row reports."""

WITHIN_S = (0.0, 3.0)
"""A fault begins so long after its phase did, drawn by seed; the play looks once a second."""

ORDER = ("aboard", "ready", "climb", "outbound", "drop", "return", "land", "down")
"""Phases by truth, in the order of a flight."""

AT_PAD_M, AT_CUSTOMER_M, LOW_M = 20.0, 15.0, 15.0


@dataclass(slots=True)
class FleetStage:
    """One day under one fault."""

    built: BuiltDay
    world: DayWorld
    desks: Desks
    rng: np.random.Generator
    phase: str
    """Where in the struck drone's flight the fault begins."""
    began_s: float | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def t_s(self) -> float:
        """The day's time."""
        return self.world.clock.t_s

    @property
    def bus(self) -> Bus:
        """The fleet's network."""
        assert self.built.plumbing.bus is not None
        return self.built.plumbing.bus

    @property
    def drone(self) -> DayDrone:
        """The one that is struck."""
        return next(drone for drone in self.built.drones if drone.name == STRUCK)

    def wait(self, duration_s: float) -> Iterator[None]:
        """Let the day's time pass."""
        until_s = self.t_s + duration_s
        while self.t_s < until_s - 1e-6:
            yield

    def until(self, true: Callable[[], bool]) -> Iterator[None]:
        """Wait for something to be so."""
        while not true():
            yield

    def reached(self) -> Iterator[None]:
        """Wait for the phase, by truth, and a moment more; the fault begins then."""
        yield from self.until(lambda: ORDER.index(self.where) >= ORDER.index(self.phase))
        yield from self.wait(self.rng.uniform(*WITHIN_S))
        self.begin()

    def begin(self) -> None:
        """Note when the fault began."""
        self.began_s = self.t_s

    @property
    def where(self) -> str:
        """Where in its flight the struck drone truly is."""
        up = self.drone.up
        if up is None:
            return "aboard" if not self.drone.past else "down"
        if not up.vehicle.is_airborne:
            return self._on_the_ground(up)
        if up.vehicle.parcel_aboard:
            return self._on_the_way(up)
        return "land" if up.vehicle.height_m < LOW_M and not self._over_customer(up) else "return"

    def _on_the_ground(self, up: PowerUp) -> str:
        if any(row[4] for row in up.rows):
            return "down"
        state = self.bus.states.get(STRUCK)
        is_ready = state is not None and state.phase == Phase.READY.value
        return "ready" if is_ready else "aboard"

    def _on_the_way(self, up: PowerUp) -> str:
        if self._over_customer(up):
            return "drop"
        away_m = math.dist(up.vehicle.pos_ned_m[:2], up.pad_ne_m)
        return "outbound" if away_m > AT_PAD_M else "climb"

    def _over_customer(self, up: PowerUp) -> bool:
        customer = self.built.customers[CUSTOMER]
        return math.dist(up.vehicle.pos_ned_m[:2], customer[:2]) < AT_CUSTOMER_M
