"""Faults of the companion computer: it dies and comes back, or does not."""

from collections.abc import Iterator

from sim_bridge.app.faults.case import FaultCase, Play
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import comes_home, delivers, promises_nothing_false

FLYING = ("climb", "outbound", "drop", "return")
BOOT_S = (1.0, 8.0)
GROUND_S = 22.0
"""From power-up the suite's flight stands so long on its pad."""


def killed(*, comes_back: bool) -> Play:
    """SIGKILL; started again after a while, or not."""

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        craft = stage.craft
        craft.companion.kill()
        stage.lockstep.lose(craft.number - 1)
        if comes_back:
            yield from stage.wait(stage.rng.uniform(*BOOT_S))
            craft.companion.start()
            craft.companion_returns = True

    return play


def torn(name: str) -> Play:
    """Killed; of a file in its folder the last third is gone; started again."""

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        craft = stage.craft
        craft.companion.kill()
        stage.lockstep.lose(craft.number - 1)
        path = craft.run_dir / name
        data = path.read_bytes()
        path.write_bytes(data[: 2 * len(data) // 3])
        yield from stage.wait(stage.rng.uniform(*BOOT_S))
        craft.companion.start()
        craft.companion_returns = True

    return play


def rebooted(stage: Stage) -> Iterator[None]:
    """The autopilot reboots on the ground, at any moment before take-off."""
    yield from stage.wait(stage.rng.uniform(1.0, GROUND_S))
    if not stage.armed:
        stage.begin()
        stage.craft.autopilot.reboot()


SAFE = (comes_home, promises_nothing_false)
GROUP = "host"
CASES = (
    FaultCase(
        43,
        "torn-checkpoint",
        GROUP,
        "killed; its checkpoint is torn; started again",
        torn("checkpoint.json"),
        SAFE,
        FLYING,
    ),
    FaultCase(
        43,
        "torn-decision-log",
        GROUP,
        "killed; its decision log is torn; started again",
        torn("decisions.mcap"),
        SAFE,
        FLYING,
    ),
    FaultCase(
        46,
        "reboot-on-the-ground",
        GROUP,
        "the autopilot reboots at any moment before take-off",
        rebooted,
        (*SAFE, delivers),
        ("ready",),
    ),
    FaultCase(
        49,
        "killed-and-back",
        GROUP,
        "killed in mid-air, and back after some seconds",
        killed(comes_back=True),
        SAFE,
        FLYING,
    ),
    FaultCase(
        49,
        "killed-for-good",
        GROUP,
        "killed in mid-air for good: the mission aboard brings it home",
        killed(comes_back=False),
        SAFE,
        FLYING,
    ),
)
