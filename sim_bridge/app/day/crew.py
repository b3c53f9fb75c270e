"""Ground handling of a simulated day: its interface, and the staff of a depot.

Positions are NED metres about the day's depot.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from companion.app.flight.fleet_port import STANDBY
from companion.core.pilot.transitions import GROUND_PHASES, Phase
from companion.fleet.messages import State
from sim_bridge.app.day.clock import EPOCH_US
from sim_bridge.app.day.drone import MANUAL_DISARM_DELAY_S, DayDrone
from sim_bridge.app.day.judge import Handover
from sim_bridge.app.day.truck import PAD_SEARCH_RADIUS_M, Drive, DriverTask

PAD_RING_RADIUS_M = 21.0
"""Radius of the ring of pads about the depot. Six pads are 21 m from each other, so that two drones
may climb and descend at once (`ground_station.core.deconfliction.pads`; a pad's radius is 30 m)."""

CHECK_INTERVAL_S = 0.5
"""Interval of checks; a companion takes seconds from its assignment until it is ready."""

PRE_ARM_PHASES = frozenset({STANDBY, *(p.value for p in GROUND_PHASES if p is not Phase.ARM)})
"""Reported phases in which a drone may be handled."""

FETCH_SPEED_MPS = 3.0
"""Average speed to a drone that landed off its pad: on foot across fields, or by road."""

SILENT_DRONE_DELAY_S = 30.0
"""A landed drone without a state report is fetched this long after `MANUAL_DISARM_DELAY_S`."""


class GroundHandling(Protocol):
    """Places drones, loads parcels, fetches landed drones: a truck driver or depot staff."""

    drives: list[Drive]
    finished_tasks: list[DriverTask]
    delivered: list[Handover]
    """Orders that the staff delivered without a drone."""

    def run_due_tasks(self, t_s: float) -> None:
        """Carry out the tasks that are due at `t_s`."""
        ...

    @property
    def is_idle(self) -> bool:
        """Whether no task is open."""
        ...

    def close(self) -> None:
        """Release resources at the end of the day."""
        ...


@dataclass(slots=True)
class DepotHandling:
    """Staff of a depot without a truck; each drone has its own attendant.

    A drone waits on its pad, powered on with a charged pack. Its parcel is loaded as soon as it
    has an assignment, because with `--auto-launch` the desk waits for no confirmation. After a
    flight it is powered off where it landed. It is back on its pad, with another pack, after
    `turnaround_s` plus the transport time. Each pack is used for one flight. `states`: last
    reported states by name. `parcel_missing_by_order`: by order, whether the parcel was missing
    from the fetched drone.
    """

    drones: list[DayDrone]
    payload_kg: Mapping[str, float]
    states: Mapping[str, State]
    turnaround_s: float
    drives: list[Drive] = field(default_factory=list)
    finished_tasks: list[DriverTask] = field(default_factory=list)
    delivered: list[Handover] = field(default_factory=list)
    parcel_missing_by_order: dict[str, bool] = field(default_factory=dict)
    _return_due_s: dict[str, float] = field(default_factory=dict)
    """Time at which each powered-off drone is back on its pad."""
    _next_check_s: float = 0.0

    @property
    def is_idle(self) -> bool:
        """Always True: tasks follow from the drones, not from requests."""
        return True

    def close(self) -> None:
        """Do nothing: no resources are held."""

    def run_due_tasks(self, t_s: float) -> None:
        """Handle each drone on the ground, at most once per `CHECK_INTERVAL_S`."""
        if t_s < self._next_check_s:
            return
        self._next_check_s = t_s + CHECK_INTERVAL_S - 0.05
        for number, drone in enumerate(self.drones):
            if drone.power_cycle is None:
                if t_s >= self._return_due_s.get(drone.name, 0.0):
                    drone.switch_on_at_pad(t_s, self._pad_ne_m(number), 0.0, None)
            elif not drone.is_airborne and not drone.power_cycle.vehicle.is_crashed:
                self._disarm_fetch_or_load_drone(drone, t_s)

    def _pad_ne_m(self, pad_index: int) -> tuple[float, float]:
        angle_rad = 2.0 * math.pi * pad_index / len(self.drones)
        return PAD_RING_RADIUS_M * math.cos(angle_rad), PAD_RING_RADIUS_M * math.sin(angle_rad)

    def _disarm_fetch_or_load_drone(self, drone: DayDrone, t_s: float) -> None:
        assert drone.power_cycle is not None
        state = self._last_state_if_sent_since(drone, drone.power_cycle.t0_s)
        if drone.needs_manual_disarm(t_s) and drone.can_driver_approach_on_ground(
            t_s, (0.0, 0.0), PAD_RING_RADIUS_M + PAD_SEARCH_RADIUS_M
        ):
            drone.disarm_manually()
        if drone.time_since_last_airborne_s(t_s) > 0.0:
            if self._is_flight_over(drone, state, t_s):
                self._switch_off_and_schedule_return(drone, t_s)
        elif (
            state is not None
            and state.phase in PRE_ARM_PHASES
            and state.order != drone.power_cycle.order
        ):
            payload_kg = self.payload_kg.get(state.order or "", 0.0)
            drone.power_cycle.load_or_remove_parcel(payload_kg, state.order)
            self.parcel_missing_by_order.pop(state.order or "", None)

    def _last_state_if_sent_since(self, drone: DayDrone, since_s: float) -> State | None:
        """Return its last reported state if it was sent after `since_s`, or None."""
        state = self.states.get(drone.name)
        wall_off_us = round(drone.wall_clock_offset_s * 1e6)
        if state is None or state.epoch_us - wall_off_us - EPOCH_US < since_s * 1e6:
            return None
        return state

    def _is_flight_over(self, drone: DayDrone, state: State | None, t_s: float) -> bool:
        """Return whether it has landed and reports standby, or has been silent on the ground."""
        assert drone.power_cycle is not None
        if not drone.can_driver_approach_on_ground(
            t_s, drone.power_cycle.vehicle.pos_ned_m[:2], PAD_SEARCH_RADIUS_M
        ):
            return False
        reports_standby = (
            drone.companion is not None and state is not None and state.phase == STANDBY
        )
        return (
            reports_standby
            or drone.time_since_last_airborne_s(t_s) > MANUAL_DISARM_DELAY_S + SILENT_DRONE_DELAY_S
        )

    def _switch_off_and_schedule_return(self, drone: DayDrone, t_s: float) -> None:
        assert drone.power_cycle is not None
        distance_m = math.hypot(*drone.power_cycle.vehicle.pos_ned_m[:2])
        round_trip_s = (
            0.0 if distance_m <= PAD_SEARCH_RADIUS_M else 2.0 * distance_m / FETCH_SPEED_MPS
        )
        self._return_due_s[drone.name] = t_s + round_trip_s + self.turnaround_s
        if drone.power_cycle.order is not None:
            self.parcel_missing_by_order[drone.power_cycle.order] = not drone.carries_parcel
        self.finished_tasks.append(
            DriverTask(
                "fetch", "depot", drone.power_cycle.order, drone.name, t_s, t_s + round_trip_s
            )
        )
        drone.switch_off_and_end_power_cycle()
