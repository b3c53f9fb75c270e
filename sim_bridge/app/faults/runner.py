"""Fly a row of the suite, a flight or a small day, and check its rules."""

import secrets
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.params import params_dir
from companion.adapters.files.signing_files import write_signing_key
from sim_bridge.app.faults.fault import (
    FLEET_GROUP,
    STARTUP_EFFECT_CODE,
    FaultCase,
    FaultRow,
    FaultTask,
)
from sim_bridge.app.faults.pair import had_two_faults
from sim_bridge.app.faults.verdict import FaultRunResult, p_home_of_last_go_decision
from sim_bridge.app.flight.companion_process import suite_fork_server
from sim_bridge.app.flight.fly import FlyOptions, fly_vehicles_and_evaluate
from sim_bridge.app.flight.stage import FaultContext, FaultScript
from sim_bridge.app.world.exception_files import count_tracebacks_by_file, write_exception_file

FLIGHT_FILE_NAME = "faults.toml"
LOCKSTEP_LIMIT_S = 60.0
TIGHT_CHARGE_FRAC = (0.42, 0.54)
"""Bounds of the drawn charge. Without a fault, the suite's flight is refused below the first and
delivers with ample energy at the second; slightly above the first it turns back."""

KEY_FILE_NAME, KEY_BYTES = "signing.key", 32


def fly_case(case: FaultCase, task: FaultTask) -> FaultRow:
    """Fly one row and check its rules."""
    if case.group == FLEET_GROUP:
        return _fly_day_case_catching_exceptions(case, task)
    charge_frac = _draw_tight_charge_frac(task) if task.tight else None
    flown = _fly_flight(case, task, charge_frac)
    row = _build_fault_row(
        task, case, flown, case.find_broken_rules(flown, has_tight_energy=task.tight)
    )
    return msgspec.structs.replace(row, charge_frac=charge_frac)


def _fly_day_case_catching_exceptions(case: FaultCase, task: FaultTask) -> FaultRow:
    """Fly a day. An exception of desk, companion or truck, all in this process, fails the row."""
    from sim_bridge.app.faults.day.fleet_day import EMPTY_FLIGHT_ROW, fly_small_day

    try:
        flown = fly_small_day(case, task)
    except Exception as error:  # noqa: BLE001 - a day runs in this process: an error fails it
        failure_text = write_exception_file(task.run_folder, error)
        stage = FaultContext(task.phase, np.random.default_rng(0), lambda: False)
        return _build_fault_row(
            task, case, FaultRunResult(EMPTY_FLIGHT_ROW, stage, [], 1), [failure_text]
        )
    return _build_fault_row(task, case, flown, case.find_broken_rules(flown))


def _fly_flight(case: FaultCase, task: FaultTask, charge_frac: float | None) -> FaultRunResult:
    folder = task.run_folder
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([task.seed, case.number])
    performance = FaultScript(case.procedure, task.phase, rng, end_delay_s=case.ends_after_s)
    charge_table = {} if charge_frac is None else {"vehicle": {"charge_frac": charge_frac}}
    companion_flight_file = write_changed_flight_file(
        folder / "flight.toml", case.flight, charge_table
    )
    options = FlyOptions(
        flight_file=write_changed_flight_file(
            folder / "world.toml", case.flight, charge_table, case.untold
        ),
        companion_flight_file=companion_flight_file,
        autopilot=task.autopilot,
        seed=task.seed,
        run_root=folder,
        picture=False,
        lockstep_limit_s=LOCKSTEP_LIMIT_S,
        companion_arguments=case.arguments,
        companion_startup_code=case.before_companion
        and f"{STARTUP_EFFECT_CODE}{case.before_companion}",
        fork_server=suite_fork_server(),
        battery_sensing=case.battery_sensing,
        settings=case.settings,
        signing_key=_create_signing_key(folder) if case.signed else None,
    )
    (row,) = fly_vehicles_and_evaluate(options, performance)["flights"]
    stage = performance.context
    assert stage is not None
    return FaultRunResult(
        row,
        stage,
        stage.craft.operator.received_texts,
        sum(count_tracebacks_by_file(stage.craft.run_dir).values()),
        p_home_of_last_go_decision((one["kind"], one["p_home"]) for one in row["decisions"]),
    )


def _draw_tight_charge_frac(task: FaultTask) -> float:
    flight = f"{task.fault} {task.autopilot} {task.phase}"
    rng = np.random.default_rng([task.seed, *flight.encode()])
    return round(float(rng.uniform(*TIGHT_CHARGE_FRAC)), 4)


def _create_signing_key(folder: Path) -> Path:
    """Create a signing key for this flight. It is not drawn by seed, which would make it known."""
    path = folder / KEY_FILE_NAME
    path.unlink(missing_ok=True)
    write_signing_key(path, secrets.token_bytes(KEY_BYTES))
    return path


def write_changed_flight_file(path: Path, *table_changes: dict[str, Any]) -> Path:
    """Write the suite's flight file with changed tables and return its path."""
    table = tomllib.loads((params_dir() / "flights" / FLIGHT_FILE_NAME).read_text())
    for changed in table_changes:
        table = merge_tables_recursively(table, changed)
    path.write_bytes(msgspec.toml.encode(table))
    return path


def merge_tables_recursively(table: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Return `table` with `changes` merged key by key. The table `wind` is replaced completely."""
    merged_table = dict(table)
    for key, value in changes.items():
        current = merged_table.get(key)
        if isinstance(value, dict) and isinstance(current, dict) and key != "wind":
            merged_table[key] = merge_tables_recursively(current, value)
        else:
            merged_table[key] = value
    return merged_table


def _build_fault_row(
    task: FaultTask, case: FaultCase, flown: FaultRunResult, violations: list[str]
) -> FaultRow:
    return FaultRow(
        fault=task.fault,
        group=case.group,
        autopilot=task.autopilot,
        phase=task.phase.value,
        seed=task.seed,
        outcome=flown.row["outcome"],
        home=flown.row["home"],
        delivered=flown.row["delivered"],
        margin_wh=flown.row["margin_wh"],
        p_home_last_go=flown.p_home_last_go,
        commands_after_takeover=flown.command_count_after_takeover,
        exceptions=flown.traceback_count,
        messages=flown.message_texts,
        passed=not violations,
        failure_text="; ".join(violations),
        had_two_faults=had_two_faults(flown.stage) if flown.stage.second else msgspec.UNSET,
    )
