"""The simulated day: drones, truck, network and desk, in steps of 0.1 s.

`build_day` makes the world without its desk; `desk` is set before the first step.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from companion.core.base.geo import LocalFrame, Ned
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.orders import OrderRow
from sim_bridge.app.day.bus import Bus
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.crew import GroundHandling
from sim_bridge.app.day.drone import DayDrone
from sim_bridge.app.day.faults import (
    COMPANION_KILLS,
    DESK_KILLS,
    MEMBER_CUTS,
    NETWORK_CUTS,
    STORE_OUTAGES,
    TAKE_OVERS,
    Faults,
)
from sim_bridge.app.day.judge import HomeReport, ParkedInterval
from sim_bridge.app.day.store_host import StoreHost
from sim_bridge.app.world.vehicle_host import EXCHANGE_S, STEPS_PER_EXCHANGE
from sim_bridge.truth.fields.front import LinearFront

DESK_INTERVAL_S = 0.5
FRONT_STEPS = 5
"""Steps between updates of the front, which passes a position in 20 s or more."""

DESK_RESTART_DELAY_S = 20.0
"""Time from a desk's SIGKILL to its restart by an operator or a service."""

MIN_DESK_UPTIME_S = 5.0
MIN_AIRBORNE_S = 15.0
"""Minimum time in the air before a companion is killed, so that the kill occurs in flight."""


@dataclass(frozen=True, slots=True)
class DeskRecord:
    """Content of a desk's database after the day.

    `plans`: the first plan and the replans. `orders`: the orders by identifier.
    `delivered_by`: drone or truck that delivered each delivered order. `infeasible_orders`: orders
    that were infeasible from the start of the day. `unexpected_exits`: unexpected exits of a desk,
    with the reason.
    """

    plans: list[DayPlan]
    orders: dict[str, OrderRow]
    delivered_by: dict[str, str]
    infeasible_orders: frozenset[str]
    unexpected_exits: list[str]


class SimulatedDesk(Protocol):
    """The desk of a day, or several on one store."""

    def run_desk_cycle(self) -> None:
        """Run one cycle of the desk: receive, check, assign, send."""
        ...

    def kill(self) -> None:
        """End as after SIGKILL: only the database remains."""
        ...

    def restart(self) -> None:
        """Restart with the same command."""
        ...

    @property
    def is_done(self) -> bool:
        """Whether no order is open and no assignment is active."""
        ...

    def build_desk_record(self) -> DeskRecord:
        """Return the desk's record of the finished day."""
        ...

    def close(self) -> None:
        """Shut down in an orderly way."""
        ...


@dataclass(slots=True)
class DayWorld:
    """World of a day. `run_until_over` steps it until the desk is done, or until `limit_s`."""

    data: DayData
    frame: LocalFrame
    clock: DayClock
    bus: Bus
    drones: list[DayDrone]
    ground_handling: GroundHandling
    faults: Faults
    customers: dict[str, Ned]
    front: LinearFront | None = None
    shares_wind: bool = True
    store: StoreHost | None = None
    """Host of the desk's database, if outages are injected."""
    desk: SimulatedDesk = field(init=False)
    home_reports: list[HomeReport] = field(default_factory=list)
    _last_home: dict[str, str | None] = field(default_factory=dict)
    _desk_due_s: float = 0.0
    _desk_restart_s: float | None = None
    _store_outage_end_s: float | None = None
    _steps: int = 0

    def run_until_over(self, limit_s: float, should_continue: Callable[["DayWorld"], bool]) -> bool:
        """Run the day; return whether it finished before `limit_s`.

        `should_continue` is called once per simulated second; if it returns False, the day stops.
        """
        while self.clock.t_s < limit_s:
            self.advance_one_exchange()
            if self._steps % round(1.0 / EXCHANGE_S) == 0:
                if self.is_over:
                    return True
                if not should_continue(self):
                    return False
        return False

    @property
    def is_over(self) -> bool:
        """Whether desk and store are up, desk and staff are done, and no drone is airborne."""
        has_outage = self._desk_restart_s is not None or self._store_outage_end_s is not None
        is_idle = not has_outage and not any(d.is_airborne for d in self.drones)
        return is_idle and self.ground_handling.is_idle and self.desk.is_done

    def advance_one_exchange(self) -> None:
        """Advance by EXCHANGE_S."""
        self._steps += 1
        t_s = self.clock.t_s = self._steps * EXCHANGE_S
        self.bus.advance_and_run_due_calls(t_s)
        if self.front is not None and self._steps % FRONT_STEPS == 0:
            self._set_front_wind_at_drones(self.front, t_s)
        for drone in self.drones:
            drone.advance_and_exchange_messages(t_s, STEPS_PER_EXCHANGE)
        for vehicle, state in self.bus.states.items():
            if self._last_home.get(vehicle) != state.home:
                self._last_home[vehicle] = state.home
                self.home_reports.append(HomeReport(t_s, vehicle, state.home))
        self.ground_handling.run_due_tasks(t_s)
        self._inject_due_faults(t_s)
        if self._desk_restart_s is None and t_s >= self._desk_due_s:
            self._desk_due_s = t_s + DESK_INTERVAL_S - EXCHANGE_S / 2.0
            self.desk.run_desk_cycle()

    def _set_front_wind_at_drones(self, front: LinearFront, t_s: float) -> None:
        """Set the front's wind at the position of each drone."""
        for drone in self.drones:
            up = drone.all_power_cycles[-1] if drone.all_power_cycles else None
            if up is not None and up.record.rows:
                north, east = (np.array([x]) for x in up.record.rows[-1][1:3])
                added = front.added_wind_to_ne_mps(np.array([t_s]), north, east)[0]
                up.vehicle.wind_field.front_to_ne_mps = (float(added[0]), float(added[1]))

    def _inject_due_faults(self, t_s: float) -> None:
        self._end_or_start_store_outage_if_due(t_s)
        self._restart_or_kill_desk_if_due(t_s)
        for kind, inject in (
            (COMPANION_KILLS, self._kill_random_airborne_companion),
            (TAKE_OVERS, self._command_rtl_of_random_airborne_drone),
            (NETWORK_CUTS, self._cut_network_and_describe),
            (MEMBER_CUTS, self._cut_random_member_from_network),
        ):
            due = self.faults.next_fault_if_due(kind, t_s)
            description = None if due is None else inject(t_s, due[1])
            if description is not None:
                self.faults.remove_and_log_injected_fault(kind, t_s, description)

    def _restart_or_kill_desk_if_due(self, t_s: float) -> None:
        """Restart a killed desk when due, and kill the desk when a kill is due."""
        faults = self.faults
        if self._desk_restart_s is not None and t_s >= self._desk_restart_s:
            self._desk_restart_s = None
            self.desk.restart()
            earliest_s = t_s + MIN_DESK_UPTIME_S
            kills = faults.due.get(DESK_KILLS, [])
            faults.due[DESK_KILLS] = [(max(at_s, earliest_s), for_s) for at_s, for_s in kills]
            faults.log.append((t_s, "desk started again"))
        if self._desk_restart_s is None and faults.next_fault_if_due(DESK_KILLS, t_s) is not None:
            self.desk.kill()
            self._desk_restart_s = t_s + DESK_RESTART_DELAY_S
            faults.remove_and_log_injected_fault(DESK_KILLS, t_s, "desk killed")

    def _end_or_start_store_outage_if_due(self, t_s: float) -> None:
        """Start and end outages of the desk's store; they never overlap."""
        if self._store_outage_end_s is not None and t_s >= self._store_outage_end_s:
            self.end_store_outage()
        outage = self.faults.next_fault_if_due(STORE_OUTAGES, t_s)
        if self.store is None or self._store_outage_end_s is not None or outage is None:
            return
        self._store_outage_end_s = t_s + outage[1]
        description = f"{self.store.start_outage_and_describe()} for {outage[1]:.0f} s"
        self.faults.remove_and_log_injected_fault(STORE_OUTAGES, t_s, description)

    def end_store_outage(self) -> None:
        """End an active outage of the store; also called at the end of the day."""
        if self.store is not None and self._store_outage_end_s is not None:
            self.store.end_outage()
            self._store_outage_end_s = None

    # Each returns a description of the injected fault, or None if it is not possible yet.

    def _kill_random_airborne_companion(self, t_s: float, duration_s: float) -> str | None:
        """Kill the companion of a drone that has been airborne for LEAST_UP_S."""
        drone = self._draw_airborne_drone(t_s)
        if drone is None:
            return None
        drone.kill_companion_and_schedule_restart(t_s)
        return f"companion of {drone.name} killed"

    def _command_rtl_of_random_airborne_drone(self, t_s: float, duration_s: float) -> str | None:
        """Command return to launch of one drone from a second ground station."""
        drone = self._draw_airborne_drone(t_s)
        if drone is None or drone.power_cycle is None or drone.power_cycle.link.takeover:
            return None
        drone.command_rtl_from_second_station(t_s)
        return f"{drone.name} taken over by a person"

    def _draw_airborne_drone(self, t_s: float) -> DayDrone | None:
        """Draw one drone that has a companion and has been airborne for LEAST_UP_S."""
        airborne = [d for d in self.drones if d.is_airborne and d.companion is not None]
        airborne = [d for d in airborne if d.time_since_takeoff_s(t_s) >= MIN_AIRBORNE_S]
        return airborne[int(self.faults.rng.integers(len(airborne)))] if airborne else None

    def _cut_network_and_describe(self, t_s: float, duration_s: float) -> str:
        self.bus.cut_network(duration_s)
        self.faults.longest_cut_s = max(self.faults.longest_cut_s, duration_s)
        return f"network cut for {duration_s:.0f} s"

    def _cut_random_member_from_network(self, t_s: float, duration_s: float) -> str | None:
        """Cut off a drawn member that is powered on; it may be the truck."""
        members = sorted({link.vehicle for link in self.bus.links_of()})
        if not members:
            return None
        member = members[int(self.faults.rng.integers(len(members)))]
        self.bus.cut_member(member, duration_s)
        self.faults.longest_cut_s = max(self.faults.longest_cut_s, duration_s)
        return f"{member} cut off for {duration_s:.0f} s"

    # --- record --------------------------------------------------------------------------------

    @property
    def truck_parked_intervals(self) -> list[ParkedInterval]:
        """Stops at which the truck was parked, with arrival and departure."""
        found: list[ParkedInterval] = []
        stop, ne_m, since_s = "depot", (0.0, 0.0), 0.0
        for drive in self.ground_handling.drives:
            found.append(ParkedInterval(stop, ne_m, since_s, drive.left_s))
            stop, ne_m, since_s = drive.stop, drive.to_ne_m, drive.arrive_s
        return [*found, ParkedInterval(stop, ne_m, since_s, float("inf"))]
