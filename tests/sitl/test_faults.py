"""Rows of the fault suite, drawn; each row fails without its guard."""

import tomllib

import pytest

from sim_bridge.app.fault_suite.catalogue import CATALOGUE
from sim_bridge.app.fault_suite.suite import fly_fault, list_tasks
from sim_bridge.app.faults import runner
from sim_bridge.app.faults.fault import PHASES, FaultRow, FaultTask
from sim_bridge.app.faults.pair import draw_pair_task
from sim_bridge.app.flight import companion_process
from sim_bridge.app.world.flight_phase import FlightPhase
from sim_bridge.autopilot.kinds import AUTOPILOTS
from tests.sitl.fault_guards import GUARDS

pytestmark = pytest.mark.sitl


ROWS = [
    (task.fault, task.autopilot, task.phase)
    for task in list_tasks(CATALOGUE, AUTOPILOTS, PHASES, [1], None)
]


def flown(tmp_path, fault: str, autopilot: str, phase: str, seed: int = 1) -> FaultRow:
    return fly_fault(FaultTask(fault, autopilot, FlightPhase(phase), seed, tmp_path))


@pytest.mark.every_run
@pytest.mark.sample
@pytest.mark.drawn(keep=5)  # by night every row by both autopilots in every phase
@pytest.mark.parametrize(("fault", "autopilot", "phase"), ROWS)
def test_a_fault_costs_no_vehicle(tmp_path, fault, autopilot, phase):
    row = flown(tmp_path, fault, autopilot, phase)
    assert row.passed, (row.failure_text, row.messages)


@pytest.mark.sample
@pytest.mark.drawn(keep=1)  # by night 500: `make trials`
@pytest.mark.parametrize("seed", range(40))
def test_two_faults_in_one_flight_cost_no_vehicle(tmp_path, seed):
    row = fly_fault(draw_pair_task(CATALOGUE, AUTOPILOTS, PHASES, seed, tmp_path))
    assert row.passed, (row.fault, row.failure_text, row.messages)


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("fault", GUARDS)
def test_without_its_guard_the_row_breaks(tmp_path, monkeypatch, fault):
    phase, patch, autopilot = GUARDS[fault]
    monkeypatch.setattr(runner, "suite_fork_server", lambda: None)  # patched before its imports
    monkeypatch.setattr(
        companion_process, "COMPANION_CODE", f"{patch}\n{companion_process.COMPANION_CODE}"
    )
    assert not flown(tmp_path, fault, autopilot, phase).passed


@pytest.mark.sample
def test_a_tight_flight_has_a_charge_of_its_own_and_may_be_refused(tmp_path):
    rows = [
        fly_fault(FaultTask("pack-aged", "px4", FlightPhase.READY, seed, tmp_path, tight=True))
        for seed in (1, 2)
    ]
    first, second = (row.charge_frac for row in rows)
    assert first is not None
    assert second is not None
    assert 0.42 <= first != second <= 0.54
    for row in rows:
        folder = tmp_path / f"pack-aged-px4-ready-seed{row.seed}"
        told, world = (
            tomllib.loads((folder / name).read_text())["vehicle"]
            for name in ("flight.toml", "world.toml")
        )
        assert told["charge_frac"] == world["charge_frac"] == row.charge_frac
        assert "battery_health_frac" not in told
        assert world["battery_health_frac"] == 0.8
        assert row.passed, row.failure_text
