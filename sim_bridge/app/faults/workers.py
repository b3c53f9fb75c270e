"""Faults of what the companion does beside its loop: no thread is to be had, a planner that hangs.

In lockstep the loop plans by itself, so that runs repeat; here it plans beside, as on a vehicle.
"""

from collections.abc import Iterator

from sim_bridge.app.faults.case import IN_THE_AIR, SAFE, FaultCase, from_the_start
from sim_bridge.app.faults.host import BOOT_S
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import Ask, delivers, stays_down, tells

NO_THREAD_FILE = "no_thread"
NO_THREAD = f"""\
import pathlib, sys, threading
import companion.app.flight.planning as planning
planning.PlanAtOnce = planning.PlanBeside
NONE = pathlib.Path(sys.argv[-1]) / "{NO_THREAD_FILE}"
def start(self, real=threading.Thread.start):
    if NONE.exists() or self.name in KEPT_FROM:
        raise RuntimeError("can't start new thread")
    real(self)
threading.Thread.start = start
KEPT_FROM = ()
"""
"""No thread can be started while a file lies in the run folder."""

LINK_ALONE = f'{NO_THREAD}KEPT_FROM = ("disk", "plan")\n'
"""The link's thread was the last that was to be had."""


def started_without_a_thread(stage: Stage) -> Iterator[None]:
    """Killed; as it is started again no thread is to be had, and it ends; started once more."""
    yield from stage.reached()
    craft = stage.craft
    mark = craft.run_dir / NO_THREAD_FILE
    craft.companion.kill()
    stage.lockstep.lose(craft.number - 1)
    mark.touch()
    yield from stage.wait(stage.rng.uniform(*BOOT_S))
    craft.companion.start()
    craft.companion.wait(ENDS_WITHIN_S)
    mark.unlink()
    yield from stage.wait(SERVICE_S)
    craft.companion.start()
    craft.companion_returns = True


ENDS_WITHIN_S = 60.0
"""Wall time for a process that finds no link: it loads its code and ends."""

SERVICE_S = 2.0
"""A service manager's pause before it starts a process again."""


def planner(work: str) -> str:
    """A worker beside the loop that does this instead of its `real` work."""
    return f"""\
import resource, threading
import companion.app.flight.planning as planning
planning.PlanAtOnce = planning.PlanBeside
from companion.core.mission.find_plan import FindPlan
def work(self, real=FindPlan.work):
{work}
FindPlan.work = work
"""


HANGS = planner("    threading.Event().wait()")
BREAKS = planner("    raise KeyError('a node that is not in the graph')")
LATE = planner("    threading.Event().wait(1.5)\n    return real(self)")
EATS_MEMORY = planner("""\
    page, room = resource.getpagesize(), 1 << 30
    used = int(open("/proc/self/statm").read().split()[0]) * page
    most = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (used + room, most))
    held = []
    while True:
        held.append(bytearray(1 << 26))""")

GROUP = "host"
SHORT = {"mission": {"time_limit_s": 100.0}}
"""A companion that never ends is not waited for longer than 270 s from power-up."""


def planner_row(name: str, says: str, before: str, *asks: Ask) -> FaultCase:
    """A row of the worker that plans: on the ground, from power-up."""
    return FaultCase(
        48,
        name,
        GROUP,
        says,
        from_the_start,
        asks,
        ("ready",),
        flight=SHORT,
        before_companion=before,
    )


CASES = (
    FaultCase(
        44,
        "no-threads",
        GROUP,
        "no thread can be had beside the link's: none for the record, none for the plan",
        from_the_start,
        (*SAFE, delivers, tells("record given up")),
        ("ready",),
        before_companion=LINK_ALONE,
    ),
    FaultCase(
        44,
        "back-without-a-thread",
        GROUP,
        "killed; as it is started again not one thread can be had; started once more",
        started_without_a_thread,
        SAFE,
        IN_THE_AIR,
        before_companion=NO_THREAD,
    ),
    planner_row(
        "plan-worker-hangs",
        "the worker that plans hangs: it stays on the ground, and says so",
        HANGS,
        stays_down,
        tells("no take-off: no plan within"),
    ),
    planner_row(
        "plan-worker-breaks",
        "the worker that plans breaks: it stays on the ground, and says why",
        BREAKS,
        stays_down,
        tells("no take-off: planning failed"),
    ),
    planner_row(
        "plan-worker-eats-memory",
        "the worker that plans eats all memory: it stays on the ground, and says why",
        EATS_MEMORY,
        stays_down,
        tells("no take-off: planning failed: memoryerror"),
    ),
    FaultCase(  # with its whole time: on a busy computer it plans for minutes of simulated time
        48,
        "plan-worker-late",
        GROUP,
        "the worker that plans takes its time: the loop hears on, and the flight is flown",
        from_the_start,
        (*SAFE, delivers),
        ("ready",),
        before_companion=LATE,
    ),
)
