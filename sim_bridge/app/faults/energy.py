"""Faults of energy: batteries that say what is not so, a gripper that lies."""

from collections.abc import Iterator

from sim_bridge.app.faults.case import FLYING, SAFE, FaultCase, Play, from_the_start
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import (
    FlownFault,
    claims_no_delivery,
    delivers,
    tells,
)
from sim_bridge.app.link.tap import as_it_is, with_fields
from sim_bridge.autopilot.mavlink.codec import Message

BATTERY = "BATTERY_STATUS"
LATE_S = 4.0
WILD_MAH = 4_000_000
FAR = {
    "site": {"customer": {"name": "customer", "east_m": -900.0, "north_m": -60.0, "up_m": 4.5}},
    "vehicle": {"charge_frac": 0.5},
}
"""With 1.7 times the draw it ends under the reserve unless the way home begins at once."""

SMALL_TOLD_S = 60.0
"""Of 1.4 times, in a flight of which a minute is left: half are reported within 20 s, nine of ten
within 40 s."""

LEVEL_TOLD_S, TOLD_S = 10.0, 25.0
"""A change of draw by more than a half is told within: in level flight, and where a climb or a
descent of up to 15 s, whose power no model knows so well, hides it."""


def packs_apart(points: int) -> Play:
    """A second pack is reported in turns with the first, so many points lower."""

    def play(stage: Stage) -> Iterator[None]:
        def change(message: Message) -> list[Message] | None:
            if message.msg_name != BATTERY:
                return None
            whole = round(100.0 * stage.craft.vehicle.battery.charge_frac)
            return [
                with_fields(message, battery_remaining=whole),
                with_fields(message, id=1, battery_remaining=max(whole - points, 0)),
            ]

        stage.tap.to_companion = change
        stage.begin()
        yield

    return play


def battery_late(stage: Stage) -> Iterator[None]:
    """One battery message comes four seconds late, behind younger ones."""
    yield from stage.reached()
    stage.tap.hold_back_s[BATTERY] = LATE_S
    yield from stage.wait(0.6)
    del stage.tap.hold_back_s[BATTERY]


def once(**fields: int) -> Play:
    """One battery message says this, once."""

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        told: list[Message] = []

        def change(message: Message) -> list[Message] | None:
            if told or message.msg_name != BATTERY:
                return None
            told.append(message)
            return [with_fields(message, **fields)]

        stage.tap.to_companion = change
        yield from stage.until(lambda: bool(told))
        stage.tap.to_companion = as_it_is

    return play


def counter_reset(stage: Stage) -> Iterator[None]:
    """The counters of charge and energy begin again from zero."""
    yield from stage.reached()
    first: list[Message] = []

    def change(message: Message) -> list[Message] | None:
        if message.msg_name != BATTERY:
            return None
        first.append(message)
        used = ("current_consumed", "energy_consumed")
        return [
            with_fields(
                message, **{n: max(getattr(message, n) - getattr(first[0], n), 0) for n in used}
            )
        ]

    stage.tap.to_companion = change


def parcel_sticks(stage: Stage) -> Iterator[None]:
    """The parcel does not leave; the gripper reports success."""
    stage.craft.vehicle.release_fails = True
    stage.begin()
    yield


def draw_rises(times: float) -> Play:
    """The same flight draws so many times the power from now on: ice, a worn motor, a sail."""

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        stage.craft.vehicle.draw_factor = times

    return play


def tells_draw(flown: FlownFault) -> str | None:
    """The operator hears that the draw has changed, in time."""
    limit_s = LEVEL_TOLD_S if flown.stage.phase == "outbound" else TOLD_S
    return tells("draw", within_s=limit_s)(flown)


def cell_lost(stage: Stage) -> Iterator[None]:
    """One cell of the pack is shorted: a sixth of the voltage, and of the energy, is gone."""
    yield from stage.reached()
    stage.craft.vehicle.battery.lose_cell()


PLAIN = (*SAFE, delivers)
GROUP = "energy"
CASES = (
    FaultCase(
        21,
        "draw-1.25",
        GROUP,
        "the draw rises to 1.25 times",
        draw_rises(1.25),
        SAFE,
        FLYING,
    ),
    FaultCase(
        21,
        "draw-1.4",
        GROUP,
        "the draw rises to 1.4 times: told within a minute",
        draw_rises(1.4),
        (*SAFE, tells("draw", within_s=SMALL_TOLD_S)),
        ("outbound",),
    ),
    FaultCase(
        22,
        "draw-1.7",
        GROUP,
        "the draw rises to 1.7 times",
        draw_rises(1.7),
        (*SAFE, tells_draw),
        FLYING,
    ),
    FaultCase(
        22,
        "draw-1.7-far",
        GROUP,
        "the draw rises to 1.7 times where there is no energy to spare for it",
        draw_rises(1.7),
        (*SAFE, tells_draw),
        ("outbound",),
        flight=FAR,
    ),
    FaultCase(
        23,
        "draw-2",
        GROUP,
        "the draw rises to 2 times",
        draw_rises(2.0),
        (*SAFE, tells_draw),
        FLYING,
    ),
    FaultCase(
        24,
        "cell-lost",
        GROUP,
        "one cell of the pack is shorted",
        cell_lost,
        SAFE,
        FLYING,
    ),
    FaultCase(
        25,
        "packs-5-apart",
        GROUP,
        "two packs whose percentages are 5 points apart",
        packs_apart(5),
        PLAIN,
        ("ready",),
    ),
    FaultCase(
        25,
        "packs-20-apart",
        GROUP,
        "two packs whose percentages are 20 points apart",
        packs_apart(20),
        SAFE,
        ("ready",),
    ),
    FaultCase(
        26,
        "counter-late",
        GROUP,
        "one battery message comes four seconds late",
        battery_late,
        PLAIN,
        FLYING,
    ),
    FaultCase(
        26,
        "counter-reset",
        GROUP,
        "the counters of charge and energy begin again from zero",
        counter_reset,
        SAFE,
        FLYING,
    ),
    FaultCase(
        26,
        "counter-wild",
        GROUP,
        "one wild counter",
        once(current_consumed=WILD_MAH, energy_consumed=WILD_MAH),
        PLAIN,
        FLYING,
    ),
    FaultCase(
        27,
        "percentage-0-once",
        GROUP,
        "the battery is said to be empty, once",
        once(battery_remaining=0),
        PLAIN,
        FLYING,
    ),
    FaultCase(
        27,
        "percentage-100-once",
        GROUP,
        "the battery is said to be full, once",
        once(battery_remaining=100),
        PLAIN,
        FLYING,
    ),
    FaultCase(
        28,
        "pack-cold",
        GROUP,
        "a pack at -10 degrees C that nobody has stated",
        from_the_start,
        SAFE,
        ("ready",),
        untold={"vehicle": {"temperature_c": -10.0}},
    ),
    FaultCase(
        29,
        "pack-aged",
        GROUP,
        "a pack with 80 % of its capacity that nobody has stated",
        from_the_start,
        SAFE,
        ("ready",),
        untold={"vehicle": {"battery_health_frac": 0.8}},
    ),
    FaultCase(
        30,
        "parcel-sticks",
        GROUP,
        "the parcel does not leave, and the gripper reports success",
        parcel_sticks,
        (*SAFE, claims_no_delivery),
        ("drop",),
    ),
)
