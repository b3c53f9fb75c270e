"""The simulated day: drones, truck, network and desk, stepped by 0.1 s."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from sim_bridge.app.day.build import Plumbing
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.crew import GroundCrew
from sim_bridge.app.day.drone import PHYSICS_STEP_S, DayDrone
from sim_bridge.app.day.faults import Faults
from sim_bridge.app.day.judge import HandedOver, Stand, Told
from sim_bridge.app.day.store_host import StoreHost
from sim_bridge.truth.fields.front import PassingFront

STEP_S = 0.1
STEPS = round(STEP_S / PHYSICS_STEP_S)
DESK_EVERY_S = 0.5
FRONT_STEPS = 5
"""A front takes 20 s or more to pass a place."""

DESK_AWAY_S = 20.0
"""From a desk's SIGKILL to its restart by a person or a service."""

LEAST_AT_WORK_S = 5.0
LEAST_UP_S = 15.0
"""Least time in the air before a companion is killed: a kill matters in flight."""


class Seat(Protocol):
    """The desk, in this process or another."""

    def turn(self) -> None:
        """One turn of the desk's loop: receive, check, assign, send."""
        ...

    def kill(self) -> None:
        """SIGKILL: only its store remains."""
        ...

    def start(self) -> None:
        """Restart with the same command."""
        ...

    @property
    def is_done(self) -> bool:
        """Whether nothing is open or under way."""
        ...


@dataclass(slots=True)
class DayWorld:
    """`run` until the desk has nothing left to do, or until `limit_s`."""

    clock: DayClock
    plumbing: Plumbing
    drones: list[DayDrone]
    crew: GroundCrew
    seat: Seat
    faults: Faults
    store: StoreHost | None = None
    front: PassingFront | None = None
    homes: list[Told] = field(default_factory=list)
    _home: dict[str, str | None] = field(default_factory=dict)
    _desk_due_s: float = 0.0
    _desk_back_s: float | None = None
    _store_back_s: float | None = None
    _steps: int = 0

    def run(self, limit_s: float, progress: Callable[["DayWorld"], bool]) -> bool:
        """Run the day; returns whether it ended by itself.

        `progress` is called once per simulated second; if it returns False, the day stops.
        """
        while self.clock.t_s < limit_s:
            self.step()
            if self._steps % round(1.0 / STEP_S) == 0:
                if self.is_over:
                    return True
                if not progress(self):
                    return False
        return False

    @property
    def is_over(self) -> bool:
        """Whether desk and store are up, the desk is done, the crew has no task, nothing flies."""
        away = self._desk_back_s is not None or self._store_back_s is not None
        at_rest = not away and not any(d.is_airborne for d in self.drones)
        return at_rest and self.crew.at_rest and self.seat.is_done

    def step(self) -> None:
        """Advance by STEP_S."""
        self._steps += 1
        t_s = self.clock.t_s = self._steps * STEP_S
        self.plumbing.network.deliver(t_s)
        if self.front is not None and self._steps % FRONT_STEPS == 0:
            self._let_front_pass(self.front, t_s)
        for drone in self.drones:
            drone.advance(t_s, STEPS)
        self._note_homes(t_s)
        self.crew.turn(t_s)
        self._mind_faults(t_s)
        if self._desk_back_s is None and t_s >= self._desk_due_s:
            self._desk_due_s = t_s + DESK_EVERY_S - STEP_S / 2.0
            self.seat.turn()
        self.plumbing.pace(t_s)

    def _let_front_pass(self, front: PassingFront, t_s: float) -> None:
        """Each drone meets it at its own place."""
        for drone in self.drones:
            up = drone.power_ups[-1] if drone.power_ups else None
            if up is not None and up.rows:
                north, east = (np.array([x]) for x in up.rows[-1][1:3])
                added = front.to_ne_mps(np.array([t_s]), north, east)[0]
                up.vehicle.wind_field.front_to_ne_mps = (float(added[0]), float(added[1]))

    def _note_homes(self, t_s: float) -> None:
        for vehicle, state in self.plumbing.network.states.items():
            if self._home.get(vehicle) != state.home:
                self._home[vehicle] = state.home
                self.homes.append(Told(t_s, vehicle, state.home))

    def _mind_faults(self, t_s: float) -> None:
        faults = self.faults
        self._mind_store(t_s)
        if self._desk_back_s is not None and t_s >= self._desk_back_s:
            self._desk_back_s = None
            self.seat.start()
            at_work_s = t_s + LEAST_AT_WORK_S  # no further kill until the desk has worked this long
            faults.ground_kills_s = [max(kill_s, at_work_s) for kill_s in faults.ground_kills_s]
            faults.log.append((t_s, "desk started again"))
        if self._desk_back_s is None and faults.ground_kills_s and t_s >= faults.ground_kills_s[0]:
            faults.ground_kills_s.pop(0)
            self.seat.kill()
            self._desk_back_s = t_s + DESK_AWAY_S
            faults.log.append((t_s, "desk killed"))
        if faults.companion_kills_s and t_s >= faults.companion_kills_s[0]:
            self._kill_a_companion(t_s)
        if faults.take_overs_s and t_s >= faults.take_overs_s[0]:
            self._take_over(t_s)
        if faults.network_cuts_s and t_s >= faults.network_cuts_s[0][0]:
            self._cut_the_network(t_s)
        if faults.member_cuts_s and t_s >= faults.member_cuts_s[0][0]:
            self._cut_a_member_off(t_s)

    def _mind_store(self, t_s: float) -> None:
        """Take the desk's store away, and bring it back; one outage after another."""
        if self._store_back_s is not None and t_s >= self._store_back_s:
            self.bring_store_back()
        outages = self.faults.store_outages_s
        if self.store is None or self._store_back_s is not None or not outages:
            return
        at_s, for_s = outages[0]
        if t_s >= at_s:
            outages.pop(0)
            self._store_back_s = t_s + for_s
            self.faults.log.append((t_s, f"{self.store.take_away()} for {for_s:.0f} s"))

    def bring_store_back(self) -> None:
        """The store works again, also where the day was over before."""
        if self.store is not None and self._store_back_s is not None:
            self.store.bring_back()
            self._store_back_s = None

    def _kill_a_companion(self, t_s: float) -> None:
        """Kill one that has been in the air for LEAST_UP_S; if there is none, try again later."""
        drone = self._one_flying(t_s)
        if drone is None:
            return
        self.faults.companion_kills_s.pop(0)
        drone.kill_companion(t_s)
        self.faults.log.append((t_s, f"companion of {drone.name} killed"))

    def _take_over(self, t_s: float) -> None:
        """A person at a second ground station sends one home; if none flies, later."""
        drone = self._one_flying(t_s)
        if drone is None or drone.is_taken_over:
            return
        self.faults.take_overs_s.pop(0)
        drone.ground_takes_over(t_s)
        self.faults.log.append((t_s, f"{drone.name} taken over by a person"))

    def _one_flying(self, t_s: float) -> DayDrone | None:
        """One of those that fly with a companion, for LEAST_UP_S at least, drawn."""
        flying = [d for d in self.drones if d.is_airborne and d.companion is not None]
        flying = [d for d in flying if d.airborne_s(t_s) >= LEAST_UP_S]
        return flying[int(self.faults.rng.integers(len(flying)))] if flying else None

    def _cut_the_network(self, t_s: float) -> None:
        _, for_s = self.faults.network_cuts_s.pop(0)
        if self.plumbing.bus is not None:
            self.plumbing.bus.cut(for_s)
            self.faults.cut_s = max(self.faults.cut_s, for_s)
            self.faults.log.append((t_s, f"network cut for {for_s:.0f} s"))

    def _cut_a_member_off(self, t_s: float) -> None:
        """One of those that are switched on, drawn, a truck among them; if there is none, later."""
        bus = self.plumbing.bus
        members = sorted({link.vehicle for link in bus.links_of()}) if bus is not None else []
        if bus is None or not members:
            return
        _, for_s = self.faults.member_cuts_s.pop(0)
        member = members[int(self.faults.rng.integers(len(members)))]
        bus.cut_off(member, for_s)
        self.faults.cut_s = max(self.faults.cut_s, for_s)
        self.faults.log.append((t_s, f"{member} cut off for {for_s:.0f} s"))

    # --- record --------------------------------------------------------------------------------

    @property
    def stands(self) -> list[Stand]:
        """Where the truck stood, and from when to when."""
        found: list[Stand] = []
        here, ne_m, since_s = "depot", (0.0, 0.0), 0.0
        for drive in self.crew.drives:
            found.append(Stand(here, ne_m, since_s, drive.left_s))
            here, ne_m, since_s = drive.stop, drive.to_ne_m, drive.arrive_s
        return [*found, Stand(here, ne_m, since_s, float("inf"))]

    @property
    def served(self) -> list[HandedOver]:
        """Orders that the crew handed over."""
        return [HandedOver(order, t_s) for t_s, order in self.crew.delivered]
