"""Faults of what is aboard and where home is: edits by another station, a home that moves."""

from collections.abc import Iterator

from sim_bridge.app.faults.case import FLYING, IN_THE_AIR, SAFE, FaultCase, Play
from sim_bridge.app.faults.people import Station, dragged, foreign
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import comes_home, delivers, tells
from sim_bridge.app.link.tap import with_fields
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mission.items import MissionItem

RESET_MM = 15_000
DRAGGED_M = 1500.0
ELSEWHERE_M = 3000.0
SLOW_ROUND_S = 30.0
"""A list whose id nobody tells (ArduCopter) is read at two items a second, and rested from."""


def _aboard(stage: Stage) -> list[MissionItem]:
    return list(stage.craft.autopilot.store.mission)


def edited(stage: Stage) -> Iterator[None]:
    """The next waypoint is dragged 1.5 km away; the list is as long as before."""
    station = Station(stage)
    yield from stage.reached()
    current = stage.craft.autopilot.executor.index
    yield from station.upload(dragged(_aboard(stage), current, DRAGGED_M))


def replaced(stage: Stage) -> Iterator[None]:
    """Somebody else's mission of the same length, 3 km away."""
    station = Station(stage)
    yield from stage.reached()
    yield from station.upload(foreign(_aboard(stage), ELSEWHERE_M))


def replaced_again(stage: Stage) -> Iterator[None]:
    """The same, and once more when ours is aboard again."""
    station = Station(stage)
    yield from stage.reached()
    items = foreign(_aboard(stage), ELSEWHERE_M)
    yield from station.upload(items)
    yield from stage.until(lambda: stage.was_said("our mission is aboard again"))
    yield from station.upload(items)


def uploaded_anew(stage: Stage) -> Iterator[None]:
    """Another station writes our own list once more."""
    station = Station(stage)
    yield from stage.reached()
    yield from station.upload(_aboard(stage))


def shorter(stage: Stage) -> Iterator[None]:
    """The first half of the list is uploaded anew."""
    station = Station(stage)
    yield from stage.reached()
    items = _aboard(stage)
    yield from station.upload(items[: len(items) // 2])


def longer(stage: Stage) -> Iterator[None]:
    """The list is uploaded with somebody else's appended."""
    station = Station(stage)
    yield from stage.reached()
    items = _aboard(stage)
    yield from station.upload([*items, *foreign(items[1:], ELSEWHERE_M)])


def cleared(stage: Stage) -> Iterator[None]:
    """The mission is cleared."""
    station = Station(stage)
    yield from stage.reached()
    station.clear()


def cut_half_way(stage: Stage) -> Iterator[None]:
    """Another station begins an upload and falls silent half-way."""
    station = Station(stage)
    yield from stage.reached()
    items = _aboard(stage)
    yield from station.upload(foreign(items, ELSEWHERE_M), stop_after=len(items) // 2)


def home_moved(*, north_m: float = 0.0, up_m: float = 0.0) -> Play:
    """Home is set elsewhere by another station."""

    def play(stage: Stage) -> Iterator[None]:
        station = Station(stage)
        yield from stage.reached()
        station.set_home(north_m=north_m, up_m=up_m)

    return play


def home_kept_low(stage: Stage) -> Iterator[None]:
    """Home is set 20 m lower, and again when it was set back."""
    station = Station(stage)
    yield from stage.reached()
    station.set_home(up_m=-20.0)
    yield from stage.wait(4.0)
    station.set_home(up_m=-20.0)


def height_reset(stage: Stage) -> Iterator[None]:
    """Heights above home are told 15 m too great from now on; those above the sea are right."""
    yield from stage.reached()

    def change(message: Message) -> list[Message] | None:
        if message.msg_name != "GLOBAL_POSITION_INT":
            return None
        return [with_fields(message, relative_alt=message.relative_alt + RESET_MM)]

    stage.tap.to_companion = change


def progress_late(stage: Stage) -> Iterator[None]:
    """MISSION_CURRENT comes two seconds late, from now on."""
    yield from stage.reached()
    stage.tap.hold_back_s["MISSION_CURRENT"] = 2.0


def setting_changed(**settings: tuple[str, float]) -> Play:
    """Another station changes a setting, by autopilot: its name and value."""

    def play(stage: Stage) -> Iterator[None]:
        station = Station(stage)
        name, value = settings[stage.craft.autopilot_kind]
        yield from stage.reached()
        station.set_parameter(name, value)
        yield
        if stage.craft.autopilot.params[name] != value:
            raise ValueError(f"{name} was not taken")

    return play


GROUP = "mission and home"

RETURNS = ("--unanswered-hold=return",)
"""Chosen before the flight: PX4 holds on a mission that it cannot fly, and nobody answers."""
CASES = (
    FaultCase(
        10,
        "same-length-edit",
        GROUP,
        "another station drags one waypoint 1.5 km away; the list is as long as before",
        edited,
        (*SAFE, tells("mission", unless_down_within_s=SLOW_ROUND_S)),
        IN_THE_AIR,
    ),
    FaultCase(
        11,
        "foreign-upload",
        GROUP,
        "another station uploads a mission of the same length, 3 km away",
        replaced,
        (*SAFE, tells("mission")),
        IN_THE_AIR,
    ),
    FaultCase(
        11,
        "foreign-upload-again",
        GROUP,
        "the same, and once more when ours is aboard again",
        replaced_again,
        (*SAFE, tells("mission changed by another")),
        ("climb", "outbound"),
    ),
    FaultCase(
        11,
        "same-upload",
        GROUP,
        "another station uploads our own mission once more",
        uploaded_anew,
        (*SAFE, delivers),
        IN_THE_AIR,
    ),
    FaultCase(
        12,
        "shorter-upload",
        GROUP,
        "another station uploads the first half of the list",
        shorter,
        (*SAFE, tells("mission")),
        IN_THE_AIR,
        arguments=RETURNS,
    ),
    FaultCase(
        12,
        "longer-upload",
        GROUP,
        "another station uploads the list with another appended",
        longer,
        (*SAFE, tells("mission")),
        IN_THE_AIR,
    ),
    FaultCase(
        13,
        "mission-cleared",
        GROUP,
        "another station clears the mission",
        cleared,
        (*SAFE, tells("mission")),
        IN_THE_AIR,
        ("px4",),
        arguments=RETURNS,
    ),
    FaultCase(
        13,
        "clear-refused",
        GROUP,
        "another station clears the mission: ArduCopter refuses that in the air, nothing changes",
        cleared,
        (*SAFE, delivers),
        IN_THE_AIR,
        ("ardupilot",),
    ),
    FaultCase(
        14,
        "upload-cut",
        GROUP,
        "another station begins an upload and falls silent half-way",
        cut_half_way,
        SAFE,
        IN_THE_AIR,
    ),
    FaultCase(
        15,
        "home-up-25",
        GROUP,
        "home is set 25 m higher",
        home_moved(up_m=25.0),
        (*SAFE, tells("home")),
        IN_THE_AIR,
    ),
    FaultCase(
        16,
        "home-down-20",
        GROUP,
        "home is set 20 m lower",
        home_moved(up_m=-20.0),
        (*SAFE, tells("home")),
        IN_THE_AIR,
    ),
    FaultCase(
        16,
        "home-kept-low",
        GROUP,
        "home is set 20 m lower, and again when it was set back",
        home_kept_low,
        (*SAFE, tells("cannot set home back")),
        ("climb", "outbound"),
    ),
    FaultCase(
        17,
        "home-3-km-away",
        GROUP,
        "home is set 3 km away",
        home_moved(north_m=3000.0),
        (*SAFE, tells("home")),
        IN_THE_AIR,
    ),
    FaultCase(
        19,
        "speed-changed",
        GROUP,
        "another station lowers the speed that missions are flown at to 5 m/s",
        setting_changed(px4=("MPC_XY_VEL_MAX", 5.0), ardupilot=("WPNAV_SPEED", 500.0)),
        SAFE,
    ),
    FaultCase(
        19,
        "rtl-height-changed",
        GROUP,
        "another station sets the height of RTL to 5 m",
        setting_changed(px4=("RTL_RETURN_ALT", 5.0), ardupilot=("RTL_ALT", 500.0)),
        SAFE,
    ),
    FaultCase(
        19,
        "fence-changed",
        GROUP,
        "another station draws the fence in to 200 m: the customer lies beyond it",
        setting_changed(px4=("GF_MAX_HOR_DIST", 200.0), ardupilot=("FENCE_RADIUS", 200.0)),
        SAFE,
        arguments=RETURNS,
    ),
    FaultCase(
        18,
        "height-reset",
        GROUP,
        "heights above home are told 15 m too great; those above the sea are right",
        height_reset,
        (*SAFE, tells("home moved")),
        FLYING,
    ),
    FaultCase(
        20,
        "progress-late",
        GROUP,
        "mission progress comes two seconds late",
        progress_late,
        (comes_home, delivers),
        ("climb", "outbound"),
    ),
)
