"""Faults of the companion computer: crashes, disk errors, slow execution."""

from collections.abc import Callable, Iterator

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.fault import (
    AIRBORNE_PHASES,
    AIRBORNE_PHASES_BEFORE_LANDING,
    SAFETY_RULES,
    FaultGroup,
    start_with_companion,
)
from sim_bridge.app.faults.verdict import check_delivered, check_file_exists_in_run_folder
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure

FAULTS = FaultGroup("host")

RESTART_DELAY_S = (1.0, 8.0)
SLOW_COMPANION_S = 20.0
TIME_ON_PAD_S = 22.0
"""Time from power-up to take-off of the suite's flight."""


def kill_companion_and_restart_if(
    *, restarts: bool, during_outage: Callable[[FaultContext], None] = lambda stage: None
) -> FaultProcedure:
    """Return a procedure: SIGKILL, then `during_outage`, then a restart if `restarts`."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        stage.kill_companion()
        during_outage(stage)
        if restarts:
            yield from stage.wait(stage.rng.uniform(*RESTART_DELAY_S))
            stage.restart_companion()

    return procedure


def kill_companion_and_corrupt_file(file_name: str) -> FaultProcedure:
    """Return a procedure: the companion is killed, the last third of a file in its folder becomes
    garbage, as of blocks that never reached the SD card, and it restarts.
    """

    def procedure(stage: FaultContext) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        stage.kill_companion()
        path = stage.craft.run_dir / file_name
        data = path.read_bytes()
        intact_bytes = 2 * len(data) // 3
        damaged = data[:intact_bytes] + stage.rng.bytes(len(data) - intact_bytes)
        path.write_bytes(damaged)
        yield from stage.wait(stage.rng.uniform(*RESTART_DELAY_S))
        stage.expect_effect(
            "the companion replaces the damaged file", lambda: path.read_bytes() != damaged
        )
        stage.restart_companion()

    return procedure


@FAULTS.register_procedure(46, "reboot-on-the-ground", ("ready",), (*SAFETY_RULES, check_delivered))
def reboot_autopilot_before_takeoff(stage: FaultContext) -> Iterator[None]:
    """The autopilot reboots at a random time before take-off."""
    yield from stage.wait(stage.rng.uniform(1.0, TIME_ON_PAD_S))
    if not stage.is_armed:
        stage.record_fault_start()
        autopilot = stage.craft.autopilot
        stage.expect_change("another boot", lambda: autopilot.state.boot_t_s)
        autopilot.reboot()


@FAULTS.register_procedure(
    40, "disk-full", ("ready", *AIRBORNE_PHASES), (*SAFETY_RULES, check_delivered)
)
def fill_companion_disk(stage: FaultContext) -> Iterator[None]:
    """The disk is full."""
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_effect(
        "a lost record", lambda: stage.has_operator_received_alert(Alert.RECORD_LOST)
    )
    stage.craft.companion.simulate_full_disk()


@FAULTS.register_procedure(
    41, "folder-gone", ("ready", *AIRBORNE_PHASES_BEFORE_LANDING), (*SAFETY_RULES, check_delivered)
)
def make_run_folder_unwritable(stage: FaultContext) -> Iterator[None]:
    """The run folder becomes unwritable."""
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_effect(
        "a lost record", lambda: stage.has_operator_received_alert(Alert.RECORD_LOST)
    )
    folder = stage.craft.run_dir
    renamed_folder = folder.with_name(folder.name + ".away")
    folder.rename(renamed_folder)
    stage.resources.callback(renamed_folder.rename, folder)
    folder.touch()  # a file of this name: not even root can create files below it
    stage.resources.callback(folder.unlink)


def python_code_that_delays_fsync(delay_s: float) -> str:
    """Return Python code that delays each fsync by `delay_s` of real time."""
    return f"""\
import os, time
def slow(fd, fsync=os.fsync):
    record_fault_effect()
    time.sleep({delay_s})
    fsync(fd)
os.fsync = slow
"""


@FAULTS.register_procedure(47, "slow-computer", AIRBORNE_PHASES_BEFORE_LANDING)
def slow_down_companion_for_20_s(stage: FaultContext) -> Iterator[None]:
    """The companion gets a tenth of the CPU time for 20 s."""
    yield from stage.wait_for_phase_and_record_fault_start()
    companion, until_s = stage.craft.companion, stage.t_s + SLOW_COMPANION_S
    while stage.t_s < until_s:
        if companion.is_running:
            stage.stall_companion()
        yield from stage.wait(0.9)
        if companion.is_running:
            stage.resume_companion()
        yield


for delay_s in (0.5, 3.0, 10.0):
    FAULTS.add_case(
        42,
        f"fsync-{delay_s:g}-s",
        f"Each fsync takes {delay_s:g} s.",
        start_with_companion,
        ("ready",),
        (*SAFETY_RULES, check_delivered),
        before_companion=python_code_that_delays_fsync(delay_s),
    )
FAULTS.add_case(
    43,
    "torn-checkpoint",
    "The companion is killed, its checkpoint is damaged, and it restarts.",
    kill_companion_and_corrupt_file("checkpoint.json"),
    AIRBORNE_PHASES,
)
FAULTS.add_case(
    43,
    "torn-decision-log",
    "The companion is killed, its decision log is damaged, and it restarts.",
    kill_companion_and_corrupt_file("decisions.mcap"),
    AIRBORNE_PHASES,
    (*SAFETY_RULES, check_file_exists_in_run_folder("decisions.mcap.torn-1")),
)
for name, outcome, restarts in (
    ("killed-and-back", "restarts after some seconds", True),
    ("killed-for-good", "stays dead: in the air the onboard mission flies home", False),
):
    FAULTS.add_case(
        49,
        name,
        f"The companion is killed and {outcome}.",
        kill_companion_and_restart_if(restarts=restarts),
        ("ready", *AIRBORNE_PHASES),
    )
