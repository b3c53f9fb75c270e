"""Faults about who flies: lost acknowledgements, people who disarm and take over, two computers."""

from collections.abc import Callable, Iterator
from pathlib import Path

from sim_bridge.app.faults.case import FLYING, IN_THE_AIR, FaultCase, Play
from sim_bridge.app.faults.computers import (
    SecondCompanion,
    beat,
    copied,
    payload_computer,
)
from sim_bridge.app.faults.people import Station
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import (
    USAGE,
    comes_home,
    delivers,
    hands_off,
    is_taken,
    notes,
    promises_nothing_false,
    stays_disarmed,
    tells,
)
from sim_bridge.app.link.tap import Change, as_it_is, with_fields
from sim_bridge.autopilot.mavlink.codec import Message

ARM_DISARM = 400
ARMED_FLAG = 128

TOLD_PILOT_S = 0.3
"""A mode change by the pilot is told at once: the exchange that carries it, and the next."""

TOLD_S = 1.2
"""Disarming is told in the next heartbeat, within a second, and the exchange that carries it."""


def _loses(name: str, command: int | None = None) -> Change:
    def change(message: Message) -> list[Message] | None:
        lost = message.msg_name == name and command in (None, message.command)
        return [] if lost else None

    return change


def arm_ack_lost(stage: Stage) -> Iterator[None]:
    """The acknowledgement of ARM never comes; a person disarms soon after arming."""
    stage.tap.to_companion = _loses("COMMAND_ACK", ARM_DISARM)
    station = Station(stage)
    yield from stage.until(lambda: stage.armed)
    yield from stage.wait(stage.rng.uniform(0.3, 1.5))
    stage.begin()
    station.disarm(by_force=True)
    stage.taken_over(TOLD_S)


def acks_lost(stage: Stage) -> Iterator[None]:
    """No acknowledgement of a command comes any more; then the pilot takes over."""
    yield from stage.reached()
    stage.tap.to_companion = _loses("COMMAND_ACK")
    yield from stage.wait(stage.rng.uniform(1.0, 6.0))
    stage.craft.pilot_takes_over()
    stage.taken_over(TOLD_PILOT_S)


def pilot_lands(stage: Stage) -> Iterator[None]:
    """The pilot takes over, and lands it where it is; ArduPilot's switch is set up for LOITER."""
    if stage.craft.autopilot_kind == "ardupilot":
        Station(stage).set_parameter("FLTMODE6", LOITER)
    yield from stage.reached()
    stage.craft.pilot_takes_over()
    stage.taken_over(TOLD_PILOT_S)
    yield from stage.wait(LOOKS_S)
    stage.craft.pilot_moves(throttle_us=THROTTLE_DOWN)
    yield from stage.until(lambda: stage.craft.record.landed_s is not None)
    stage.craft.pilot_moves(throttle_us=THROTTLE_OFF)


LOITER = 5.0
LOOKS_S = 3.0
"""With the sticks moved, before the pilot brings it down."""

THROTTLE_DOWN, THROTTLE_OFF = 1300, 1100
"""Down at half of what a pilot may ask for, then off, on the ground."""


def false_disarmed(stage: Stage) -> Iterator[None]:
    """One heartbeat says disarmed, and a second of silence follows."""
    yield from stage.reached()
    told: list[Message] = []

    def change(message: Message) -> list[Message] | None:
        if told or message.msg_name != "HEARTBEAT":
            return [] if told else None
        told.append(message)
        return [with_fields(message, base_mode=message.base_mode & ~ARMED_FLAG)]

    stage.tap.to_companion = change
    yield from stage.until(lambda: bool(told))
    yield from stage.wait(1.0)
    stage.tap.to_companion = as_it_is


def kill_switch(stage: Stage) -> Iterator[None]:
    """Somebody stops the motors, in the air, or on the ground as soon as they turn."""
    station = Station(stage)
    yield from stage.reached()
    yield from stage.until(lambda: stage.armed)
    stage.begin()
    station.disarm(by_force=True)
    stage.taken_over(TOLD_S)


def stalled(duration_s: float) -> Play:
    """The companion's process stands still, and the pilot takes over meanwhile."""

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        taken_after_s = stage.rng.uniform(0.1, 0.9) * duration_s
        _stand_still(stage)
        yield from stage.wait(taken_after_s)
        stage.craft.pilot_takes_over()
        stage.taken_over(TOLD_PILOT_S)
        yield from stage.wait(duration_s - taken_after_s)
        _go_on(stage)

    return play


def _stand_still(stage: Stage) -> None:
    stage.craft.companion.stall()
    stage.lockstep.lose(stage.craft.number - 1)


def _go_on(stage: Stage) -> None:
    stage.craft.companion.go_on()
    stage.craft.companion_returns = True


SECOND_STALL_S = 15.0
"""Room for a second companion to find the vehicle, read its mission and go on with the flight."""


def second_companion(folder: Callable[[Path], Path], *, replaces: bool = False) -> Play:
    """The companion stands still; a second one is started meanwhile; the first wakes beside it."""

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        _stand_still(stage)
        second = SecondCompanion(stage, folder(stage.craft.run_dir))
        second.start()
        wakes_s = stage.t_s + SECOND_STALL_S
        while stage.t_s < wakes_s and second.process.running:
            second.turn()
            yield
        if second.process.exit_code == USAGE:
            stage.notes.append(REFUSED)
        if replaces:
            stage.taken_over(0.0)
        _go_on(stage)
        while second.process.running:
            yield
            second.turn()

    return play


REFUSED = "refused"


def _same(run_dir: Path) -> Path:
    return run_dir


def _new(run_dir: Path) -> Path:
    return run_dir.with_name(f"{run_dir.name}-second")


def payload_beats(stage: Stage) -> Iterator[None]:
    """Another onboard computer sends its heartbeat once a second, and nothing else."""
    computer = payload_computer(stage)
    yield from stage.reached()
    while True:
        beat(computer)
        yield from stage.wait(1.0)


def payload_flies(stage: Stage) -> Iterator[None]:
    """Another onboard computer says that it flies from now on, and commands a speed."""
    computer = payload_computer(stage)
    yield from stage.reached()
    since_s = stage.t_s
    stage.taken_over(TOLD_PILOT_S)
    while True:
        beat(computer, flies_since_s=since_s)
        computer.order(MAV_CMD_DO_CHANGE_SPEED, 1.0, PAYLOAD_MPS, -1.0)
        yield from stage.wait(1.0)


MAV_CMD_DO_CHANGE_SPEED = 178
PAYLOAD_MPS = 9.0
MAV_CMD_DO_SET_MODE = 176
MAV_CMD_DO_PAUSE_CONTINUE = 193
HOLD_PARAMS = {"px4": (1.0, 4.0, 3.0), "ardupilot": (1.0, 5.0, 0.0)}


def taken_back_at_once(stage: Stage) -> Iterator[None]:
    """A person takes over, hands back, and takes over again within 0.2 s."""
    station = Station(stage)
    craft = stage.craft
    yield from stage.reached()
    hold = HOLD_PARAMS[craft.autopilot_kind]
    station.order(MAV_CMD_DO_SET_MODE, *hold)
    yield from stage.wait(3.0)
    station.order_companion(MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
    yield from stage.wait(stage.rng.choice([0.1, 0.2]))
    station.order(MAV_CMD_DO_SET_MODE, *hold)
    stage.taken_over(TOLD_PILOT_S)


GROUP = "authority"
CASES = (
    FaultCase(
        1,
        "arm-ack-lost",
        GROUP,
        "the acknowledgement of ARM is lost; a person disarms 0.3 to 1.5 s after arming",
        arm_ack_lost,
        (hands_off, stays_disarmed),
        ("ready",),
        ends_after_s=20.0,
    ),
    FaultCase(
        2,
        "acks-lost",
        GROUP,
        "every acknowledgement is lost, then the pilot takes over",
        acks_lost,
        (hands_off,),
        IN_THE_AIR,
        ends_after_s=15.0,
    ),
    FaultCase(
        2,
        "pilot-lands",
        GROUP,
        "the pilot takes over and lands it where it is: no loss, and said so by the companion too",
        pilot_lands,
        (hands_off, tells("hands off"), is_taken),
        ("outbound", "drop", "return"),  # in the climb it is at home
    ),
    *(
        FaultCase(
            3,
            f"stall-{duration_s:.0f}-s",
            GROUP,
            f"the companion stands still for {duration_s:.0f} s; the pilot takes over meanwhile",
            stalled(duration_s),
            (hands_off, tells("hands off")),
            IN_THE_AIR,
            ends_after_s=duration_s + 15.0,
        )
        for duration_s in (2.0, 6.0, 20.0)
    ),
    FaultCase(
        4,
        "second-same-folder",
        GROUP,
        "it stands still; a second companion started from its folder is refused",
        second_companion(_same),
        (comes_home, promises_nothing_false, notes(REFUSED)),
        ("outbound", "return"),
    ),
    FaultCase(
        4,
        "second-new-folder",
        GROUP,
        "it stands still; a second companion that knows nothing of the flight stays passive",
        second_companion(_new),
        (comes_home, promises_nothing_false),
        ("outbound", "return"),
    ),
    FaultCase(
        4,
        "second-takes-over",
        GROUP,
        "it stands still; a second companion takes the flight up; the first wakes, hands off",
        second_companion(copied, replaces=True),
        (comes_home, hands_off, tells("passive")),
        ("outbound", "return"),
    ),
    FaultCase(
        5,
        "payload-computer",
        GROUP,
        "another onboard computer (192) sends heartbeats: harmless",
        payload_beats,
        (comes_home, delivers, promises_nothing_false),
        ("ready", *FLYING),
    ),
    FaultCase(
        5,
        "payload-computer-flies",
        GROUP,
        "another onboard computer (192) says that it flies, and commands: hands off, told once",
        payload_flies,
        (comes_home, hands_off, tells("passive", within_s=0.5)),
        FLYING,
    ),
    FaultCase(
        6,
        "taken-back-at-once",
        GROUP,
        "a person hands back and takes over again within 0.2 s",
        taken_back_at_once,
        (hands_off, tells("hands off")),
        FLYING,
        ends_after_s=25.0,
    ),
    FaultCase(
        7,
        "false-disarmed",
        GROUP,
        "one false heartbeat says disarmed, and a second of silence follows",
        false_disarmed,
        (comes_home, delivers),
        IN_THE_AIR,
    ),
    FaultCase(
        9,
        "kill-switch",
        GROUP,
        "the motors are stopped: told within 2.5 s, and nothing is commanded",
        kill_switch,
        (hands_off, tells("hands off", "disarm", within_s=2.5)),
        ("ready", *IN_THE_AIR),
        ends_after_s=15.0,
    ),
)
