"""Faults of the companion's worker threads: no thread can be started, the planner hangs or fails.

In lockstep the main loop plans itself, so that runs repeat. Here a thread plans, as on a vehicle.
"""

from collections.abc import Iterator

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.fault import (
    AIRBORNE_PHASES,
    SAFETY_RULES,
    FaultGroup,
    expect_startup_effect,
    start_with_companion,
)
from sim_bridge.app.faults.host import RESTART_DELAY_S
from sim_bridge.app.faults.verdict import check_alert_sent, check_delivered, check_no_takeoff
from sim_bridge.app.flight.stage import FaultContext

FAULTS = FaultGroup("host")

NO_THREAD_FILE = "no_thread"
NO_THREAD_CODE = f"""\
import pathlib, sys, threading
import companion.app.flight.planning as planning
executor = planning.PlanningExecutor
executor.start_planning = lambda self, find_plan: self._start_thread(find_plan)
NONE = pathlib.Path(sys.argv[-1]) / "{NO_THREAD_FILE}"
def start(self, real=threading.Thread.start):
    if NONE.exists() or self.name in KEPT_FROM:
        record_fault_effect()
        raise RuntimeError("can't start new thread")
    real(self)
threading.Thread.start = start
KEPT_FROM = ()
"""
"""Python code: no thread can be started while the file `no_thread` is in the run folder."""

LINK_THREAD_ONLY_CODE = f'{NO_THREAD_CODE}KEPT_FROM = ("disk", "plan")\n'
"""Python code: the link's thread can be started, but no further one."""


@FAULTS.register_procedure(
    44, "back-without-a-thread", AIRBORNE_PHASES, before_companion=NO_THREAD_CODE
)
def kill_and_fail_one_restart_for_threads(stage: FaultContext) -> Iterator[None]:
    """The companion is killed, a restart fails as no thread can be started, the next works."""
    yield from stage.wait_for_phase_and_record_fault_start()
    craft = stage.craft
    mark = craft.run_dir / NO_THREAD_FILE
    stage.kill_companion()
    expect_startup_effect(stage)
    mark.touch()
    yield from stage.wait(stage.rng.uniform(*RESTART_DELAY_S))
    craft.companion.start()
    craft.companion.wait(EXIT_LIMIT_S)
    mark.unlink()
    yield from stage.wait(SERVICE_RESTART_DELAY_S)
    stage.restart_companion()


EXIT_LIMIT_S = 60.0
"""Wall time for a process that finds no link to load its code and exit."""

SERVICE_RESTART_DELAY_S = 2.0
"""A service manager's delay before it restarts a process."""


def python_code_that_replaces_planner_work(replacement_code: str) -> str:
    """Return code of a planner thread that runs `replacement_code`, not its `real` work."""
    return f"""\
import resource, threading
import companion.app.flight.planning as planning
executor = planning.PlanningExecutor
executor.start_planning = lambda self, find_plan: self._start_thread(find_plan)
from companion.core.mission.find_plan import FindPlan
def work(self, real=FindPlan.compute_plan):
    record_fault_effect()
{replacement_code}
FindPlan.compute_plan = work
"""


HANGING_PLANNER = python_code_that_replaces_planner_work("    threading.Event().wait()")
FAILING_PLANNER = python_code_that_replaces_planner_work(
    "    raise KeyError('a node that is not in the graph')"
)
SLOW_PLANNER = python_code_that_replaces_planner_work(
    "    threading.Event().wait(1.5)\n    return real(self)"
)
MEMORY_EXHAUSTING_PLANNER = python_code_that_replaces_planner_work("""\
    page, room = resource.getpagesize(), 1 << 30
    used = int(open("/proc/self/statm").read().split()[0]) * page
    most = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (used + room, most))
    held = []
    while True:
        held.append(bytearray(1 << 26))""")

SHORT_TIME_LIMIT = {"mission": {"time_limit_s": 100.0}}
"""Limits the wait for a companion that never ends to 270 s from power-up."""


FAULTS.add_case(
    44,
    "no-threads",
    "No thread can be started except the link's: none for the record or the planner.",
    start_with_companion,
    ("ready",),
    (*SAFETY_RULES, check_delivered, check_alert_sent(Alert.RECORD_LOST)),
    before_companion=LINK_THREAD_ONLY_CODE,
)
for name, startup_code, verb, expected_text in (
    ("hangs", HANGING_PLANNER, "hangs", "no plan within"),
    ("breaks", FAILING_PLANNER, "fails", "planning failed"),
    (
        "eats-memory",
        MEMORY_EXHAUSTING_PLANNER,
        "exhausts all memory",
        "planning failed: memoryerror",
    ),
):
    FAULTS.add_case(
        48,
        f"plan-worker-{name}",
        f"The planner thread {verb}: the vehicle stays on the ground, with an alert.",
        start_with_companion,
        ("ready",),
        (check_no_takeoff, check_alert_sent(Alert.NO_TAKE_OFF, parameter_text=expected_text)),
        flight=SHORT_TIME_LIMIT,
        before_companion=startup_code,
    )
# Full time limit: on a busy computer planning takes minutes of simulated time.
FAULTS.add_case(
    48,
    "plan-worker-late",
    "The planner thread is slow: the main loop keeps receiving, and the flight is flown.",
    start_with_companion,
    ("ready",),
    (*SAFETY_RULES, check_delivered),
    before_companion=SLOW_PLANNER,
)
