"""Rows of the standing suite, drawn; and each guard taken out, so that its row breaks.

A guard is taken out by a patch of this test's in the companion's process, before its `main` runs:
the companion has no switch for it.
"""

import pytest

from sim_bridge.app.faults.case import BOTH, PHASES
from sim_bridge.app.faults.catalogue import CATALOGUE
from sim_bridge.app.faults.runner import FaultRow, FaultTask, fly_fault, tasks
from sim_bridge.app.flight import companion_process

pytestmark = pytest.mark.sitl

OPEN: dict[str, str] = {}
"""Rows that do not hold yet, and why: docs/explanation/limits.md says so too."""

AUTHORITY = "from companion.core.pilot.authority import Authority"
HOLD = "from companion.core.pilot.unanswered_hold import UnansweredHold"
GUARDS: dict[str, tuple[str, str]] = {
    "second-takes-over": ("outbound", f"{AUTHORITY}\nAuthority._is_theirs = lambda *_: False"),
    "payload-computer-flies": ("return", f"{AUTHORITY}\nAuthority._is_theirs = lambda *_: False"),
    "mission-cleared": ("return", f"{HOLD}\nUnansweredHold.tick = lambda *_: None"),
}
"""By row: the phase, and the patch that takes its guard out."""

ROWS = [
    (task.fault, task.autopilot, task.phase)
    for task in tasks(CATALOGUE, BOTH, PHASES, [1], None)
    if task.fault not in OPEN
]


def flown(tmp_path, fault: str, autopilot: str, phase: str, seed: int = 1) -> FaultRow:
    return fly_fault(FaultTask(fault, autopilot, phase, seed, tmp_path))


@pytest.mark.drawn(keep=5)  # by night every row by both autopilots in every phase
@pytest.mark.parametrize(("fault", "autopilot", "phase"), ROWS)
def test_a_fault_costs_no_vehicle(tmp_path, fault, autopilot, phase):
    row = flown(tmp_path, fault, autopilot, phase)
    assert row.held, (row.why, row.said)


@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("fault", GUARDS)
def test_without_its_guard_the_row_breaks(tmp_path, monkeypatch, fault):
    phase, patch = GUARDS[fault]
    monkeypatch.setattr(companion_process, "ENTRY", f"{patch}\n{companion_process.ENTRY}")
    assert not flown(tmp_path, fault, "px4", phase).held


def test_open_rows_are_rows():
    assert OPEN.keys() <= {case.name for case in CATALOGUE}
