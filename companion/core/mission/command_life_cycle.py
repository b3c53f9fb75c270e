"""The life cycle of every command to the autopilot, as a table; the documents show it.

A command that moves, arms or configures the vehicle, or changes its mission, is created by a
decision of the pilot and sent. It ends with its effect in telemetry (or its acknowledgement, where
no telemetry shows the effect), with its time limit, or at once with a newer decision by a person or
another station. It is repeated by one mechanism only: the adapter, or the part of the pilot that
ordered it. When control is released all commands are void, encoded ones included (send_queue.py).
"""

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field
from enum import Enum

from companion.core.mission.events import (
    Event,
    Home,
    MissionProgress,
    MissionWriteDetected,
    ModeReport,
    OtherStationModeCommand,
    VehicleState,
)

UNCHANGED_MAX_AGE_S = 0.3
"""Maximum age of a report of the unchanged state that permits the pilot to repeat a command. After
that, a person may have changed the state (selecting a mode or item takes 0.2 s and more)."""


class CommandState(Enum):
    """States of a command; a command in one of the last two is never sent again."""

    CREATED = "created"
    SENT = "sent"
    ACKNOWLEDGED = "acknowledged"
    EFFECTIVE = "effective"
    VOID = "void"


STATE_TRANSITIONS = (
    (CommandState.CREATED, "transmission", CommandState.SENT),
    (CommandState.SENT, "repetition: interval passed, no newer decision", CommandState.SENT),
    (CommandState.SENT, "accepted by the autopilot", CommandState.ACKNOWLEDGED),
    (CommandState.SENT, "effect in telemetry", CommandState.EFFECTIVE),
    (CommandState.ACKNOWLEDGED, "effect in telemetry", CommandState.EFFECTIVE),
    (CommandState.CREATED, "newer decision, or control released", CommandState.VOID),
    (CommandState.SENT, "newer decision, refusal, limit, or control released", CommandState.VOID),
    (CommandState.ACKNOWLEDGED, "newer decision, limit, or control released", CommandState.VOID),
)
"""State, event, next state."""


class NewerDecision(Enum):
    """What a person or another station may decide, as telemetry shows it."""

    MODE = "mode"
    ITEM = "mission item"
    MISSION = "mission"
    HOME = "home"
    PARAMETER = "parameter"
    ARMED = "armed state"


class Repeater(Enum):
    """The mechanism that repeats a kind of command."""

    ADAPTER = "adapter"
    PILOT = "pilot"
    NONE = "-"


@dataclass(frozen=True, slots=True)
class LifeCycle:
    """One row. `interval_s`: interval of repetitions; `max_tries`: transmissions, 0: no limit.

    `response_timeout_s`: wait after the last one. `effect`: evidence that ends the command.
    `voided_by`: reports of a newer decision that end it. `lane`: commands of one lane are sent one
    after the other; `supersedes`: a new one replaces them.
    """

    effect: str
    interval_s: float
    max_tries: int
    voided_by: tuple[NewerDecision, ...] = ()
    response_timeout_s: float = 1.0
    repeater: Repeater = Repeater.ADAPTER
    lane: str = ""
    supersedes: bool = False

    @property
    def adapter_tries(self) -> int:
        """Transmissions of one order."""
        return self.max_tries if self.repeater is Repeater.ADAPTER else 1

    @property
    def adapter_timeout_s(self) -> float:
        """Wait of the adapter for a response to the last transmission of an order."""
        return self.limit_s if self.repeater is Repeater.PILOT else self.response_timeout_s

    @property
    def limit_s(self) -> float:
        """Time from the first transmission to the end of the command."""
        last_wait_s = max(self.interval_s, self.response_timeout_s)
        return self.interval_s * (self.max_tries - 1) + last_wait_s


_D, _PILOT = NewerDecision, Repeater.PILOT
_LEG = (_D.MODE, _D.ITEM, _D.MISSION)
_MODE_SHOWN = "mode in HEARTBEAT or CURRENT_MODE"
_ACKNOWLEDGED = "acknowledgement"


class CommandKind(Enum):
    """Every kind of command."""

    MODE = LifeCycle(_MODE_SHOWN, *(1.0, 1, (_D.MODE,), 3.0, Repeater.NONE, "mode", True))
    # One order: a person may select another mode before a repetition, or the former one. The
    # next rows are orders that the pilot repeats where telemetry shows that nothing was selected.
    START_MODE = LifeCycle(_MODE_SHOWN, *(3.0, 30, (_D.MODE, _D.ARMED), 3.0, _PILOT, "mode"))
    RESUME_MODE = LifeCycle(_MODE_SHOWN, *(5.0, 1, (_D.MODE,), 5.0, Repeater.NONE, "mode"))
    SETPOINT_MODE = LifeCycle(_MODE_SHOWN, *(1.5, 0, (_D.MODE,), 1.5, _PILOT, "mode"))
    LAST_RESORT_MODE = LifeCycle(_MODE_SHOWN, *(2.0, 0, (_D.MODE,), 2.0, _PILOT, "mode"))
    # The last resort has no limit: after 10 orders LAND and RTL alternate, with alarms.
    ARM = LifeCycle(
        "armed in HEARTBEAT", *(0.1, 3, (_D.MODE, _D.MISSION), 3.0, Repeater.ADAPTER, "arm")
    )
    # Repeated only faster than a person can disarm (flown: a disarm 0.3 s after arming).
    # Heartbeats, which show its effect, come at 1 Hz and lag by up to a second.
    DISARM = LifeCycle("disarmed in HEARTBEAT", *(5.0, 3, (_D.MODE,), 5.0, _PILOT, "arm", True))
    JUMP = LifeCycle("item in MISSION_CURRENT", *(1.5, 5, _LEG, 1.0, _PILOT, "jump", True))
    # PX4 sends MISSION_CURRENT at 1 Hz, and acknowledges no jump.
    SPEED = LifeCycle(_ACKNOWLEDGED, *(1.0, 4, _LEG, 1.0, Repeater.ADAPTER, "speed", True))
    RELEASE = LifeCycle(_ACKNOWLEDGED, *(1.0, 4, _LEG, 1.0, Repeater.ADAPTER, "release"))
    HOME = LifeCycle(
        "HOME_POSITION", *(1.0, 4, (_D.MODE, _D.HOME), 1.0, Repeater.ADAPTER, "home", True)
    )
    PARAMETER = LifeCycle("value in PARAM_VALUE", *(1.0, 60, (_D.PARAMETER, _D.ARMED)))
    # The interval doubles while nothing answers; a name that stays unanswered while others are
    # answered counts as absent earlier (parameters.py).
    UPLOAD = LifeCycle("MISSION_ACK, then the read-back", *(0.5, 30, (_D.MISSION,)))
    CLEAR = LifeCycle("MISSION_ACK", *(0.5, 30, (_D.MISSION,)))
    # Transmissions of each message of the transfer (mission_transfer.py).
    SETPOINT = LifeCycle("velocity", *(0.1, 1, _LEG, 0.1, Repeater.NONE))
    REQUEST = LifeCycle("the requested message", 1.0, 10)
    # With 30 % of the frames lost in each direction, one request in 800 then stays unanswered.

    @property
    def title(self) -> str:
        """Name in the documents."""
        return self.name.lower().replace("_", " ")


def reported_values(event: Event) -> Iterator[tuple[NewerDecision, Hashable]]:
    """Yield the states in an event that decisions of people or stations change.

    `None`: a decision that is newer than every command, whatever the state.
    """
    match event:
        case VehicleState():
            yield NewerDecision.MODE, event.mode_name
            yield NewerDecision.ARMED, event.armed
        case ModeReport():
            yield NewerDecision.MODE, event.mode_name
        case MissionProgress():
            yield NewerDecision.ITEM, -1 if event.index is None else event.index
            yield NewerDecision.MISSION, (event.total, event.mission_id)
        case OtherStationModeCommand():
            yield NewerDecision.MODE, None
        case MissionWriteDetected():
            yield NewerDecision.MISSION, None
        case Home():
            yield NewerDecision.HOME, (event.lat_deg, event.lon_deg, event.alt_amsl_m)
        case _:
            return


@dataclass(slots=True)
class NewerDecisionMonitor:
    """Detects reports of a newer decision: a state that differs from that at creation.

    Create it with the states reported before the command. The mission and the home, whose reports
    may be late (1 and 0.5 Hz), are those of the first report after it.
    """

    life_cycle: LifeCycle
    before: dict[NewerDecision, Hashable] = field(default_factory=dict)

    def is_void_after(self, event: Event) -> bool:
        """Process a report that does not show the effect; return whether it ends the command."""
        return any(
            decision in self.life_cycle.voided_by
            and (value is None or self.before.setdefault(decision, value) != value)
            for decision, value in reported_values(event)
        )


def life_cycle_as_markdown() -> str:
    """Return the tables for the docs: states of a command, and a row for each kind."""
    lines = ["| in | on | to |", "| --- | --- | --- |"]
    lines += [f"| {state.value} | {event} | {to.value} |" for state, event, to in STATE_TRANSITIONS]
    lines += [
        "",
        "| command | effect shown by | repeated by | interval (s) | transmissions | limit (s)"
        " | void with a newer |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for kind in CommandKind:
        row = kind.value
        decisions = ", ".join(decision.value for decision in row.voided_by) or "-"
        limits = f"{row.max_tries} | {row.limit_s:g}" if row.max_tries else "- | -"
        lines.append(
            f"| {kind.title} | {row.effect} | {row.repeater.value} | {row.interval_s:g}"
            f" | {limits} | {decisions} |"
        )
    return "\n".join(lines)
