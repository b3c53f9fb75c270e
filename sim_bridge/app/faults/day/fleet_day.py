"""Fly a small day under one fault: desk, store, companions, truck and network in one process."""

import contextlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.mission.event_text import DecisionEvent
from companion.core.pilot.transitions import Phase
from companion.fleet.messages import EventKind, FleetEvent
from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known
from sim_bridge.app.day.bus import Bus
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.desk import DeskDatabase, SteppedDesk, store_url
from sim_bridge.app.day.drone import DayDrone, PowerCycle
from sim_bridge.app.day.faults import DayWorldOptions
from sim_bridge.app.day.run import DayOptions, fly_day_and_write_result
from sim_bridge.app.day.world import DayWorld, SimulatedDesk
from sim_bridge.app.faults.day.small_day import (
    OffsetClock,
    SmallDayDesks,
    build_fixed_plan,
    read_bundled_day,
)
from sim_bridge.app.faults.fault import FaultCase, FaultTask
from sim_bridge.app.faults.verdict import FaultRunResult, FlownDay, p_home_of_last_go_decision
from sim_bridge.app.flight.stage import FaultContext
from sim_bridge.app.world.exception_files import count_tracebacks_by_file
from sim_bridge.app.world.flight_phase import DROP_RADIUS_M, FlightPhase, phase_in_air
from sim_bridge.autopilot.kinds import AUTOPILOTS

REPLAN_TRIALS = 50
"""Search trials for a new plan: two orders have few plans."""

FAULTED_DRONE, FAULTED_ORDER = "d1", "F-1"
"""Drone whose phase triggers the fault and whose flight the row reports; its order."""

FAULT_DELAY_S = (0.0, 3.0)
"""Bounds of the delay from phase to fault, drawn by seed. The procedure acts once a second."""

EMPTY_FLIGHT_ROW = {"outcome": "", "home": False, "delivered": False, "margin_wh": 0.0}
"""Flight row of a drone that never flew."""

CLIMB_RADIUS_M, LAND_HEIGHT_M = 20.0, 15.0
"""Phase limits for a day with short distances."""


@dataclass(slots=True)
class SmallDay:
    """The day of a fleet fault, with its world and desks."""

    world: DayWorld
    desks: SmallDayDesks

    @property
    def bus(self) -> Bus:
        """The fleet's network."""
        return self.world.bus

    @property
    def faulted_drone(self) -> DayDrone:
        """The drone that the fault acts on."""
        return next(drone for drone in self.world.drones if drone.name == FAULTED_DRONE)

    @property
    def faulted_drone_flight_phase(self) -> FlightPhase:
        """Flight phase of that drone by truth."""
        up = self.faulted_drone.power_cycle
        if up is None:
            return FlightPhase.DOWN if self.faulted_drone.ended_power_cycles else FlightPhase.STOWED
        if up.vehicle.is_airborne:
            return self._airborne_phase_from_truth(up)
        if up.record.last_airborne_s is not None:
            return FlightPhase.DOWN
        state = self.bus.states.get(FAULTED_DRONE)
        is_ready = state is not None and state.phase == Phase.READY.value
        return FlightPhase.READY if is_ready else FlightPhase.STOWED

    def _airborne_phase_from_truth(self, power_cycle: PowerCycle) -> FlightPhase:
        """Return the phase by height above ground: low without its parcel means landing."""
        position_ne_m = power_cycle.vehicle.pos_ned_m[:2]
        customer = self.world.customers[FAULTED_ORDER][:2]
        is_near_customer = math.dist(position_ne_m, customer) < DROP_RADIUS_M
        landing = (
            power_cycle.pad_ne_m if is_near_customer else position_ne_m
        )  # low over the customer means drop, not landing
        return phase_in_air(
            position_ne_m,
            power_cycle.vehicle.height_m,
            has_parcel=power_cycle.vehicle.parcel_aboard,
            pad_ne_m=power_cycle.pad_ne_m,
            customer_ne_m=customer,
            landing_ne_m=landing,
            climb_radius_m=CLIMB_RADIUS_M,
            land_height_m=LAND_HEIGHT_M,
        )


@dataclass(slots=True)
class FleetFaultRun:
    """Runs one fault procedure during its day."""

    case: FaultCase
    task: FaultTask
    day: SmallDay | None = None
    stage: FaultContext | None = None

    def open_desk_and_fault_context(self, world: DayWorld, folder: Path) -> SimulatedDesk:
        """Create the day's desks, with a separate clock, and the stage of the procedure."""
        clock = OffsetClock(world.clock)
        plan, seed = build_fixed_plan(world.data), self.task.seed
        first = SteppedDesk.start_truck_desk(world, plan, folder, seed, REPLAN_TRIALS, clock)
        day = self.day = SmallDay(world, SmallDayDesks([first], clock))
        phase = self.task.phase
        rng = np.random.default_rng([seed, self.case.number])
        self.stage = FaultContext(
            phase,
            rng,
            lambda: phase.is_same_or_before(day.faulted_drone_flight_phase),
            FAULT_DELAY_S,
        )
        self.stage.remaining_steps = self.case.procedure(self.stage, day)
        return day.desks

    def advance_procedure_and_continue(self, world: DayWorld) -> bool:
        """Advance the procedure by one second. Returns True: the day continues."""
        assert self.stage is not None
        assert self.day is not None
        self.day.desks.is_procedure_running = self.stage.continue_procedure(world.clock.t_s)
        return True


def fly_small_day(case: FaultCase, task: FaultTask) -> FaultRunResult:
    """Fly the day to its end and collect its result."""
    enable_compile_cache_and_check_if_known()  # before the planner's first import
    fault_run, folder = FleetFaultRun(case, task), task.run_folder
    row = _fly_day_with_fault(fault_run, folder)
    assert fault_run.stage is not None
    assert fault_run.day is not None
    with contextlib.closing(DeskDatabase.open(store_url(folder), DayClock())) as database:
        events, assignments = database.store.events(), database.store.assignments()
    drone_row = next(
        (one for one in row["flights"] if one["vehicle"] == FAULTED_DRONE), EMPTY_FLIGHT_ROW
    )
    return FaultRunResult(
        drone_row,
        fault_run.stage,
        read_desk_log_entries(folder),
        sum(count_tracebacks_by_file(folder).values()),
        find_p_home_at_last_go_decision(events),
        FlownDay(row, fault_run.day.world.drones, folder, assignments),
    )


def _fly_day_with_fault(fault_run: FleetFaultRun, folder: Path) -> dict[str, Any]:
    task = fault_run.task
    others = [kind for kind in AUTOPILOTS if kind != task.autopilot]
    options = DayOptions(
        name=fault_run.case.name,
        data=read_bundled_day(),
        world_options=DayWorldOptions(autopilots=(task.autopilot, *others)),
        seed=task.seed,
        folder=folder,
        limit_s=fault_run.case.day_s,
    )
    return fly_day_and_write_result(
        options, fault_run.open_desk_and_fault_context, fault_run.advance_procedure_and_continue
    )


def read_desk_log_entries(folder: Path) -> list[tuple[float, str]]:
    """Return the log lines of all desks with the day's times, in order."""
    lines = [line for log in folder.glob("*.log") for line in log.read_text().splitlines()]
    split = [line.split(maxsplit=1) for line in lines]
    return sorted(((float(t_s), text) for t_s, text in split), key=lambda entry: entry[0])


def find_p_home_at_last_go_decision(events: list[FleetEvent]) -> float | None:
    """Return P(home) of the drone with the fault at its last outbound go decision."""
    return p_home_of_last_go_decision(
        (DecisionEvent.parse(event.text).kind, event.p_home)
        for event in events
        if event.vehicle == FAULTED_DRONE and event.kind is EventKind.DECISION
    )
