"""Whole days drawn from a seed: desk, store, truck or depot, drones, network and faults.

Each case is one day of `sim-bridge day`, in one process with one clock. It is monitored during the
run and evaluated from truth at the end. The case contains all inputs of the day.
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from companion.core.pilot.transitions import FLIGHT_PHASES, Phase
from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known
from sim_bridge.app.day.rules import STUCK, describe_day_violations
from sim_bridge.app.day.world import DayWorld
from sim_bridge.app.trials.day_case import (
    MAX_ORDERS_PER_VEHICLE,
    MAX_VEHICLES,
    MIN_ORDERS_WITH_ALL_FAULTS,
    SQLITE,
    DayCase,
    draw_case,
    with_at_least_one_fault_of_each_kind,
)
from sim_bridge.app.trials.trial import TrialRow, build_row_and_delete_passed_folder
from sim_bridge.app.world.exception_files import count_tracebacks_by_file, write_exception_file
from sim_bridge.app.world.safety_rules import RemainingEnergyRule

AIRBORNE_PHASES = {phase.value for phase in (*FLIGHT_PHASES, Phase.SUSPENDED)}


@dataclass(slots=True)
class DayMonitor:
    """Checks the rules for every second of a day; `violation` is the first violation."""

    violation: str | None = None
    _energy_rules: dict[tuple[str, float], RemainingEnergyRule] = field(default_factory=dict)
    """By vehicle and power-on time."""

    def check_rules_and_continue(self, world: DayWorld) -> bool:
        """Check once per second; return False after a violation, which stops the day."""
        for drone in world.drones:
            up, state = drone.power_cycle, world.bus.states.get(drone.name)
            if up is None:
                continue
            if drone.is_airborne and state is not None and state.phase in AIRBORNE_PHASES:
                key = (state.vehicle, up.t0_s)
                rule = self._energy_rules.setdefault(key, RemainingEnergyRule())
                if state.energy_left_wh is not None and (
                    rise := rule.describe_rise(world.clock.t_s, state.energy_left_wh)
                ):
                    self._record_first_violation(f"{state.vehicle}: {rise}")
            if late := up.command_texts_after_takeover:
                self._record_first_violation(f"{drone.name}: {late[0]} after the pilot override")
        return self.violation is None

    def _record_first_violation(self, message: str) -> None:
        self.violation = self.violation or message


def collect_day_violations(
    result_row: dict[str, Any], monitor: DayMonitor, folder: Path
) -> list[str]:
    """Return all violations of a day; a stopped day has exactly one."""
    if monitor.violation is not None:
        return [monitor.violation]
    violations = describe_day_violations(result_row)
    store = [f"the store is inconsistent: {message}" for message in result_row["store_faults"]]
    exceptions = [f"an exception: {name}" for name in count_tracebacks_by_file(folder)]
    return violations + store + exceptions


def run_case(case: DayCase, folder: Path) -> TrialRow:
    """Fly one day and evaluate it."""
    enable_compile_cache_and_check_if_known()  # before the planner's first import
    from sim_bridge.app.trials.day_flight import fly_day_case_and_check_store

    monitor = DayMonitor()
    try:
        row = fly_day_case_and_check_store(case, folder, monitor.check_rules_and_continue)
    except Exception as error:  # noqa: BLE001 - desk, truck, companions run here: a finding
        return TrialRow.for_case(case, write_exception_file(folder, error))
    return build_row_and_delete_passed_folder(
        case, folder, collect_day_violations(row, monitor, folder), day_metrics(row, case)
    )


def day_metrics(result_row: dict[str, Any], case: DayCase) -> dict[str, Any]:
    """Return the metrics of a day."""
    flights = result_row["flights"]
    flown_s = sum((f["land_s"] or result_row["duration_s"]) - f["launch_s"] for f in flights)
    return {
        "program": result_row["settings"],
        "kind": f"{case.store}, {'truck' if case.truck else 'depot'}",
        "minutes": round(result_row["duration_s"] / 60.0, 1),
        "vehicle_h": result_row["powered_h"],
        "flown_h": round(flown_s / 3600.0, 4),
        "flights": len(flights),
        "delivered": result_row["delivered"],
        "orders": result_row["orders"],
        "taken_over": sum(flight["taken"] for flight in flights),
        **result_row["faults_came"],
        "longest_cut_s": result_row["longest_cut_s"],
        "wrong_went": result_row["what_went_wrong"],
        "stuck": [line for line in result_row["undelivered"] if line["state"] == STUCK],
        "nearest_m": result_row["separation_min_m"],
        "margin_min_wh": result_row["margin_min_wh"],
        "cpu_s": round(result_row["spent"]["cpu_s"], 1),
    }


@dataclass(frozen=True, slots=True)
class DayCaseGenerator:
    """Generator of day cases. `truck` None: drawn for each day."""

    seed: int
    store_kinds: tuple[str, ...] = (SQLITE,)
    truck: bool | None = None
    all_faults: bool = False
    max_vehicles: int = MAX_VEHICLES
    max_orders_per_vehicle: int = MAX_ORDERS_PER_VEHICLE

    def generate_endless_cases(self) -> Iterator[DayCase]:
        """Yield an endless sequence of cases; each day once for each store."""
        for number in itertools.count():
            case = self._draw_case(number)
            yield from (msgspec.structs.replace(case, store=store) for store in self.store_kinds)

    def _draw_case(self, case_number: int) -> DayCase:
        min_orders = MIN_ORDERS_WITH_ALL_FAULTS if self.all_faults else 1
        bounds = (self.max_vehicles, self.max_orders_per_vehicle, min_orders)
        case = draw_case(self.seed, case_number, *bounds, has_truck=self.truck)
        return with_at_least_one_fault_of_each_kind(case) if self.all_faults else case


def rows_until_vehicle_hours(
    rows: Iterable[TrialRow], max_vehicle_hours: float | None
) -> Iterator[TrialRow]:
    """Yield rows until the vehicles have been powered for `max_vehicle_hours` hours in total."""
    total_h = 0.0
    for row in rows:
        yield row
        total_h += row.metrics.get("vehicle_h", 0.0)
        if max_vehicle_hours is not None and total_h >= max_vehicle_hours:
            return
