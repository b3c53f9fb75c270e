"""Faults about what a person decided meanwhile: a mode, an item or a mission that is not ours."""

from collections.abc import Iterator

from sim_bridge.app.faults.authority import HOLD_PARAMS, MAV_CMD_DO_PAUSE_CONTINUE
from sim_bridge.app.faults.case import SAFE, FaultCase
from sim_bridge.app.faults.mission_and_home import ELSEWHERE_M
from sim_bridge.app.faults.people import Station, foreign
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import comes_home, delivers, hands_off, notes, tells
from sim_bridge.app.flight.operator import GROUND_COMPONENT, GROUND_SYSTEM
from sim_bridge.app.link.tap import as_it_is
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.mavlink.codec import Message

SET_MODE, SET_ITEM, RETURN, LAND = 176, 224, 20, 21
LANDING_KEPT, HELD, OURS = "the landing item is kept", "the vehicle holds", "our mission is flown"


def _operator(stage: Stage) -> Station:
    """The operator's own station: the companion takes its orders."""
    return Station(stage, sender=(GROUND_SYSTEM, GROUND_COMPONENT))


def _hold(stage: Stage, station: Station) -> None:
    station.order(SET_MODE, *HOLD_PARAMS[stage.craft.autopilot_kind])


def _next_order(stage: Stage, name: str, command: int | None, lost: set[str]) -> Iterator[None]:
    """Wait for an order of the companion; from then on these messages to it are lost."""
    seen: list[Message] = []

    def up(message: Message) -> None:
        if message.msg_name == name and (command is None or message.command == command):
            seen.append(message)

    stage.tap.to_autopilot = up
    stage.tap.to_companion = lambda m: [] if seen and m.msg_name in lost else None
    yield from stage.until(lambda: bool(seen))
    stage.tap.to_autopilot = as_it_is


def held_again(stage: Stage) -> Iterator[None]:
    """The order that follows a hand-back is obeyed, its answer and 0.7 s of modes are lost, and the
    person selects HOLD again.
    """
    station = _operator(stage)
    yield from stage.reached()
    _hold(stage, station)
    yield from stage.wait(3.0)
    station.order_companion(MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
    yield from _next_order(
        stage, "COMMAND_LONG", SET_MODE, {"COMMAND_ACK", "HEARTBEAT", "CURRENT_MODE"}
    )
    yield from stage.until(lambda: stage.craft.autopilot.mode is Mode.AUTO)
    yield from stage.wait(0.3)
    _hold(stage, station)
    stage.taken_over(0.0)
    yield from stage.wait(0.4)
    stage.tap.to_companion = as_it_is
    yield from stage.wait(10.0)
    if stage.craft.autopilot.mode is not Mode.AUTO:
        stage.notes.append(HELD)


def item_selected(stage: Stage) -> Iterator[None]:
    """For 1.3 s after a jump no item is reported; meanwhile a person selects the landing."""
    station, craft = _operator(stage), stage.craft
    yield from stage.reached()
    by_command = craft.autopilot_kind == "ardupilot"
    name = "COMMAND_LONG" if by_command else "MISSION_SET_CURRENT"
    lost = {"COMMAND_ACK", "MISSION_CURRENT"}
    yield from _next_order(stage, name, SET_ITEM if by_command else None, lost)
    yield from stage.wait(0.5)
    items = craft.autopilot.store.mission
    landing = max(k for k, item in enumerate(items) if item.command == LAND)
    if by_command:
        station.order(SET_ITEM, float(landing))
    else:
        target = {"target_system": craft.number, "target_component": 1}
        station.send(Message("MISSION_SET_CURRENT", **target, seq=landing))
    stage.taken_over(0.0)
    yield from stage.wait(0.8)
    stage.tap.to_companion = as_it_is
    yield from stage.wait(8.0)
    if craft.autopilot.executor.index == landing:
        stage.notes.append(LANDING_KEPT)


def _replaced(stage: Stage, station: Station) -> Iterator[None]:
    yield from station.upload(foreign(list(stage.craft.autopilot.store.mission), ELSEWHERE_M))


def _places(stage: Stage) -> list[tuple[int, int, int, float]]:
    """The mission onboard; ArduCopter keeps its home as item 0."""
    return [(i.command, i.x, i.y, i.z) for i in stage.craft.autopilot.store.mission[1:]]


def _watch_list(stage: Stage, ours: list[tuple[int, int, int, float]]) -> Iterator[None]:
    """Note whether ours is onboard when the vehicle is next in its mission, armed."""
    if _places(stage) == ours:
        raise ValueError("the mission was not replaced")
    yield from stage.until(lambda: stage.armed and stage.craft.autopilot.mode is Mode.AUTO)
    if _places(stage) == ours:
        stage.notes.append(OURS)


def replaced_while_held(stage: Stage) -> Iterator[None]:
    """A person holds, another station replaces the mission, the operator hands back."""
    station = _operator(stage)
    yield from stage.reached()
    ours = _places(stage)
    _hold(stage, station)
    yield from stage.wait(2.0)
    yield from _replaced(stage, station)
    station.order_companion(MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
    yield from _watch_list(stage, ours)


def replaced_while_dead(stage: Stage) -> Iterator[None]:
    """The companion dies, the mission is replaced, and it starts again; the operator orders it."""
    station, craft = _operator(stage), stage.craft
    yield from stage.reached()
    craft.companion.kill()
    stage.lockstep.lose(craft.number - 1)
    yield from _replaced(stage, station)
    yield from stage.wait(8.0)
    craft.companion.start()
    craft.companion_returns = True
    yield from stage.until(lambda: stage.was_said("not ours"))
    if stage.rng.random() < 0.5:
        station.order_companion(RETURN)
    else:
        station.order_companion(MAV_CMD_DO_PAUSE_CONTINUE, 1.0)


def replaced_when_ready(stage: Stage) -> Iterator[None]:
    """The mission is replaced while it stands ready; it is authorised 3 s later."""
    station, operator = _operator(stage), stage.craft.operator
    operator.authorises = False
    yield from stage.until(lambda: stage.was_said("ready"))
    stage.begin()
    ours = _places(stage)
    yield from _replaced(stage, station)
    yield from stage.wait(3.0)
    operator.authorises = True
    yield from _watch_list(stage, ours)


def last_resort_refused(stage: Stage) -> Iterator[None]:
    """The mission is replaced twice, and the RTL that follows is refused for 12 s."""
    station, craft = _operator(stage), stage.craft
    yield from stage.reached()
    yield from _replaced(stage, station)
    yield from stage.until(lambda: stage.was_said("our mission is aboard again"))
    craft.refused = frozenset({("COMMAND_LONG", SET_MODE)})
    yield from _replaced(stage, station)
    yield from stage.until(lambda: stage.was_said("RTL"))
    yield from stage.wait(12.0)
    craft.refused = frozenset()


GROUP = "decisions"
ROWS = (
    (
        "held-again",
        "a person selects HOLD again 0.3 s after the hand-back; answer and modes are lost (A1)",
        held_again,
        (hands_off, notes(HELD), tells("hands off")),
        ("outbound", "return"),
    ),
    (
        "item-selected",
        "a person selects the landing while a jump is unconfirmed for 1.3 s (A2)",
        item_selected,
        (hands_off, notes(LANDING_KEPT), tells("hands off")),
        ("outbound",),
    ),
    (
        "replaced-while-held",
        "a person holds, the mission is replaced, the operator hands back (A3)",
        replaced_while_held,
        (*SAFE, notes(OURS), tells("not ours")),
        ("outbound", "return"),
    ),
    (
        "replaced-while-dead",
        "the companion is dead, the mission is replaced; restarted, it is ordered on (A4)",
        replaced_while_dead,
        (*SAFE, tells("not ours")),
        ("outbound", "return"),
    ),
    (
        "replaced-when-ready",
        "the mission is replaced while it stands ready, 3 s before it is authorised (A5)",
        replaced_when_ready,
        (comes_home, delivers, notes(OURS)),
        ("ready",),
    ),
    (
        "last-resort-refused",
        "the mission is replaced twice, and RTL is refused for 12 s (A6)",
        last_resort_refused,
        (*SAFE, tells("not in effect")),
        ("outbound",),
    ),
)
CASES = tuple(
    FaultCase(63 + k, name, GROUP, says, play, asks, phases, ends_after_s=20.0)
    for k, (name, says, play, asks, phases) in enumerate(ROWS)
)
