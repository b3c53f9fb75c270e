"""Faults of the companion computer: it dies and comes back, or does not."""

from collections.abc import Callable, Iterator

from sim_bridge.app.faults.case import FLYING, IN_THE_AIR, SAFE, FaultCase, Play, from_the_start
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import delivers, keeps_aside

BOOT_S = (1.0, 8.0)
SLOW_S = 20.0
GROUND_S = 22.0
"""From power-up the suite's flight stands so long on its pad."""


def killed(*, comes_back: bool, meanwhile: Callable[[Stage], None] = lambda stage: None) -> Play:
    """SIGKILL; started again after a while, or not. `meanwhile` is done while it is dead."""

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        craft = stage.craft
        craft.companion.kill()
        meanwhile(stage)
        stage.lockstep.lose(craft.number - 1)
        if comes_back:
            yield from stage.wait(stage.rng.uniform(*BOOT_S))
            craft.companion.start()
            craft.companion_returns = True

    return play


def torn(name: str) -> Play:
    """Killed; of a file in its folder the last third is garbage, as of blocks that the card never
    took; started again.
    """

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        craft = stage.craft
        craft.companion.kill()
        stage.lockstep.lose(craft.number - 1)
        path = craft.run_dir / name
        data = path.read_bytes()
        whole = 2 * len(data) // 3
        path.write_bytes(data[:whole] + stage.rng.bytes(len(data) - whole))
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


def disk_full(stage: Stage) -> Iterator[None]:
    """No file of the companion's can grow any more."""
    yield from stage.reached()
    stage.craft.companion.fill_disk()


def folder_gone(stage: Stage) -> Iterator[None]:
    """The folder of its record can be written no more, as when the card is pulled or goes bad."""
    yield from stage.reached()
    folder = stage.craft.run_dir
    away = folder.with_name(folder.name + ".away")
    folder.rename(away)
    stage.ends.callback(away.rename, folder)
    folder.touch()  # a file in its place: nothing can be made below it, not by root either
    stage.ends.callback(folder.unlink)


def slow_fsync(delay_s: float) -> str:
    """Each fsync of the companion's takes so long, in real time."""
    return f"""\
import os, time
def slow(fd, fsync=os.fsync):
    time.sleep({delay_s})
    fsync(fd)
os.fsync = slow
"""


def slow_computer(stage: Stage) -> Iterator[None]:
    """For twenty seconds the companion gets a tenth of the computer."""
    yield from stage.reached()
    craft, lockstep = stage.craft, stage.lockstep
    until_s = stage.t_s + SLOW_S
    while stage.t_s < until_s:
        if craft.companion.running:
            craft.companion.stall()
            lockstep.lose(craft.number - 1)
        yield from stage.wait(0.9)
        if craft.companion.running:
            craft.companion.go_on()
            craft.companion_returns = True
        yield


GROUP = "host"
CASES = (
    FaultCase(
        40,
        "disk-full",
        GROUP,
        "the disk is full",
        disk_full,
        (*SAFE, delivers),
        ("ready", *IN_THE_AIR),
    ),
    FaultCase(
        41,
        "folder-gone",
        GROUP,
        "the folder of its record can be written no more",
        folder_gone,
        (*SAFE, delivers),
        ("ready", *FLYING),
    ),
    FaultCase(
        42,
        "fsync-0.5-s",
        GROUP,
        "the disk takes 0.5 s to sync",
        from_the_start,
        (*SAFE, delivers),
        ("ready",),
        before_companion=slow_fsync(0.5),
    ),
    FaultCase(
        42,
        "fsync-3-s",
        GROUP,
        "the disk takes 3 s to sync",
        from_the_start,
        (*SAFE, delivers),
        ("ready",),
        before_companion=slow_fsync(3.0),
    ),
    FaultCase(
        42,
        "fsync-10-s",
        GROUP,
        "the disk takes 10 s to sync",
        from_the_start,
        (*SAFE, delivers),
        ("ready",),
        before_companion=slow_fsync(10.0),
    ),
    FaultCase(
        43,
        "torn-checkpoint",
        GROUP,
        "killed; its checkpoint is torn; started again",
        torn("checkpoint.json"),
        SAFE,
        IN_THE_AIR,
    ),
    FaultCase(
        43,
        "torn-decision-log",
        GROUP,
        "killed; its decision log is torn; started again",
        torn("decisions.mcap"),
        (*SAFE, keeps_aside("decisions.mcap.torn-1")),
        IN_THE_AIR,
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
        47,
        "slow-computer",
        GROUP,
        "for twenty seconds the companion gets a tenth of the computer",
        slow_computer,
        SAFE,
        FLYING,
    ),
    FaultCase(
        49,
        "killed-and-back",
        GROUP,
        "killed, and back after some seconds",
        killed(comes_back=True),
        SAFE,
        ("ready", *IN_THE_AIR),
    ),
    FaultCase(
        49,
        "killed-for-good",
        GROUP,
        "killed for good: in the air the mission aboard brings it home",
        killed(comes_back=False),
        SAFE,
        ("ready", *IN_THE_AIR),
    ),
)
