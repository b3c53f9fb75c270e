"""Faults of the air and of the sensors that feel it: fronts, thin air, GNSS and compass astray."""

import math
from collections.abc import Iterator

from sim_bridge.app.faults.case import FLYING, SAFE, FaultCase, Play, from_the_start
from sim_bridge.app.faults.stage import STEP_S, Stage
from sim_bridge.app.flight.vehicle_process import place_ne_m
from sim_bridge.app.link.tap import with_fields
from sim_bridge.autopilot.mavlink.codec import Message

FRONT_MPS = 7.0
"""On top of the 5 m/s of the flight: 12 m/s from ahead on the way home."""

FRONT_S = 10.0
"""A gust front's rise: tens of seconds behind a cold front, seconds in an outflow."""

JUMP_M = 30.0
DRIFT_MPS = 0.3
SPIN_RPS = math.radians(90.0)
HEADING_RAD = math.radians(30.0)
TILTED = ("roll", "pitch")


def _to_customer_ne(stage: Stage) -> tuple[float, float]:
    """The unit vector from the depot to the customer: where a headwind home blows to."""
    craft = stage.craft
    north, east = place_ne_m(craft.flight.site.customer, craft.depot)
    away_m = math.hypot(north, east)
    return north / away_m, east / away_m


def _raise_front(stage: Stage, to_mps: float, over_s: float) -> Iterator[None]:
    """Let the headwind home grow by so much over so long."""
    north, east = _to_customer_ne(stage)
    steps = max(round(over_s / STEP_S), 1)
    for step in range(1, steps + 1):
        speed = to_mps * step / steps
        stage.craft.vehicle.wind_field.front_to_ne_mps = (speed * north, speed * east)
        yield


def front(stage: Stage) -> Iterator[None]:
    """A front: the wind rises to 12 m/s, straight against the way home."""
    yield from stage.reached()
    yield from _raise_front(stage, FRONT_MPS, FRONT_S)


def gnss_jumps(stage: Stage) -> Iterator[None]:
    """All positions lie 30 m to one side for twenty seconds."""
    yield from stage.reached()
    towards = stage.rng.uniform(0.0, 2.0 * math.pi)
    sensors = stage.craft.vehicle.sensors
    sensors.gnss_offset_ned_m = (JUMP_M * math.cos(towards), JUMP_M * math.sin(towards), 0.0)
    yield from stage.wait(20.0)
    sensors.gnss_offset_ned_m = (0.0, 0.0, 0.0)


def gnss_drifts(stage: Stage) -> Iterator[None]:
    """Positions drift off by 0.3 m/s for twenty seconds, and stay off by 6 m."""
    yield from stage.reached()
    towards = stage.rng.uniform(0.0, 2.0 * math.pi)
    sensors = stage.craft.vehicle.sensors
    for step in range(1, 201):
        off_m = DRIFT_MPS * STEP_S * step
        sensors.gnss_offset_ned_m = (off_m * math.cos(towards), off_m * math.sin(towards), 0.0)
        yield


def attitude_frozen(stage: Stage) -> Iterator[None]:
    """Roll and pitch are told as they were, with fresh times, while the headwind home grows."""
    yield from stage.reached()
    first: list[Message] = []

    def change(message: Message) -> list[Message] | None:
        if message.msg_name != "ATTITUDE":
            return None
        first.append(message)
        return [with_fields(message, **{name: getattr(first[0], name) for name in TILTED})]

    stage.tap.to_companion = change
    yield from _raise_front(stage, FRONT_MPS, 60.0)


def compass_off(stage: Stage) -> Iterator[None]:
    """The compass, and with it the autopilot's heading, is 30 degrees off."""
    yield from stage.reached()
    stage.craft.vehicle.sensors.heading_bias_rad += stage.rng.choice([-1.0, 1.0]) * HEADING_RAD


def yaw_spin(stage: Stage) -> Iterator[None]:
    """It turns about itself for twenty seconds, whatever the autopilot asks."""
    yield from stage.reached()
    vehicle = stage.craft.vehicle
    vehicle.yaw_spin_rps = SPIN_RPS * stage.rng.choice([-1.0, 1.0])
    yield from stage.wait(20.0)
    vehicle.yaw_spin_rps = None


def icing(stage: Stage) -> Iterator[None]:
    """Ice: within a minute drag grows to 1.5 times and the draw to 1.4 times, and they stay."""
    yield from stage.reached()
    vehicle = stage.craft.vehicle
    steps = round(60.0 / STEP_S)
    for step in range(1, steps + 1):
        vehicle.drag_factor = 1.0 + 0.5 * step / steps
        vehicle.draw_factor = 1.0 + 0.4 * step / steps
        yield


def wind(**more: float) -> dict[str, object]:
    """The suite's steady wind with some of it changed."""
    steady = {"kind": "steady", "speed_mps": 5.0, "from_deg": 70.0, "turbulence": "dryden"}
    return {"wind": steady | more}


GROUP = "air and sensors"
HOT_AND_HIGH = {"site": {"depot": {"alt_amsl_m": 3000.0}}, "vehicle": {"temperature_c": 40.0}}


def row(number: int, name: str, says: str, play: Play, *phases: str, **flight: object) -> FaultCase:
    """A row of this group: home, and no false promise."""
    return FaultCase(number, name, GROUP, says, play, SAFE, phases, flight=dict(flight))


CASES = (
    row(
        31,
        "hot-and-high",
        "a depot at 3,000 m and 40 degrees C",
        from_the_start,
        "ready",
        **HOT_AND_HIGH,
    ),
    row(
        32,
        "front",
        "a front: the wind rises to 12 m/s against the way home within 10 s",
        front,
        "outbound",
        "drop",
        "return",
    ),
    row(
        33,
        "shear",
        "wind that grows with height as over a town (exponent 0.4)",
        from_the_start,
        "ready",
        **wind(profile_exponent=0.4),
    ),
    row(34, "yaw-spin", "it turns about itself for twenty seconds", yaw_spin, *FLYING),
    row(35, "gnss-jump", "positions lie 30 m off for twenty seconds", gnss_jumps, *FLYING),
    row(36, "gnss-drift", "positions drift off by 6 m in twenty seconds", gnss_drifts, *FLYING),
    row(
        37,
        "attitude-frozen",
        "roll and pitch are told as they were, while the headwind home grows by 7 m/s",
        attitude_frozen,
        "outbound",
        "drop",
    ),
    row(38, "compass-off", "the compass is 30 degrees off", compass_off, *FLYING),
    row(39, "icing", "ice: drag grows to 1.5 times, the draw to 1.4 times", icing, *FLYING),
)
