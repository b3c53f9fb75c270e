"""The mission as a table: in which phase, on what, to which phase. The docs are drawn from it."""

from enum import Enum


class Phase(Enum):
    """What the companion is doing."""

    IDENTIFY = "identify"
    CONFIGURE = "configure"
    WAIT_POSITION = "wait for position"
    PLAN = "plan"
    UPLOAD = "upload"
    READ_BACK = "read back"
    READY = "ready"
    ARM = "arm"
    CLIMB = "climb"
    MEASURE = "measure wind"
    OUTBOUND = "outbound"
    DELIVER = "deliver"
    RELEASE = "release"
    RETURN = "return"
    DIVERT = "divert"
    LAST_RESORT = "last resort"
    LAND = "land"
    DONE = "done"
    GROUNDED = "grounded"
    RECOGNISE = "recognise"
    SUSPENDED = "suspended"
    PASSIVE = "passive"
    LINK_LOST = "link lost"


class Trigger(Enum):
    """What moves the mission on; the pilot derives these from events."""

    IDENTIFIED = "autopilot identified"
    TELEMETRY_COMES = "telemetry comes"
    POSITION_USABLE = "position usable"
    PLANNED = "planned"
    UPLOADED = "uploaded"
    READ_BACK_MATCHES = "read back, same"
    READ_BACK_DIFFERS = "read back, differs"
    VERIFY = "authorised, to be verified"
    AUTHORISED = "authorised"
    ARMED = "armed by us"
    AT_HEIGHT = "at cruise height"
    GO = "gate open: go"
    CUSTOMER_REACHED = "cleared to descend"
    DROP_REACHED = "at drop height"
    DROP_OVER = "drop over"
    HOMEWARD = "homeward"
    RALLY_BOUND = "to a rally point"
    WAY_HOME_REFUSED = "way home refused"
    LANDING = "landing"
    LANDED = "landed"
    NOT_POSSIBLE = "not possible"
    AIRBORNE_AT_START = "airborne at start"
    MISSION_UNKNOWN = "mission not ours"
    STILL_ON_GROUND = "still on the ground"
    UNANSWERED = "hold that nobody answers"
    # What may happen in any phase:
    TAKEN_OVER = "mode not ours"
    HANDED_BACK = "control handed back"
    OTHER_COMPUTER = "other computer"
    LINK_SILENT = "link silent"
    LULL_OVER = "link back at once"
    LINK_BACK = "link back"
    REBOOTED = "autopilot rebooted"
    TELEMETRY_STOPPED = "telemetry stopped"
    ABORT = "abort ordered"


BEFORE = "the phase before"

GROUND_PHASES = (
    Phase.CONFIGURE,
    Phase.WAIT_POSITION,
    Phase.PLAN,
    Phase.UPLOAD,
    Phase.READ_BACK,
    Phase.READY,
    Phase.ARM,
)
"""On the ground, before we armed."""

WAITING_PHASES = GROUND_PHASES[1:-1]
"""Of those, from the first telemetry on until we arm."""

FLIGHT_PHASES = (
    Phase.CLIMB,
    Phase.MEASURE,
    Phase.OUTBOUND,
    Phase.DELIVER,
    Phase.RELEASE,
    Phase.RETURN,
    Phase.DIVERT,
    Phase.LAST_RESORT,
    Phase.LAND,
)
"""In the air under our authority."""

OUTWARD_PHASES = (Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER, Phase.RELEASE)
"""Flying away from home, or about to."""

HOMEWARD_PHASES = (Phase.RETURN, Phase.DIVERT, Phase.LAST_RESORT, Phase.LAND)

END_PHASES = (Phase.DONE, Phase.GROUNDED)

COMMANDING_PHASES = (*GROUND_PHASES, *FLIGHT_PHASES, Phase.RECOGNISE)
"""The only phases in which the autopilot may be sent an order (safety rule 1)."""

ANYTIME = (
    Trigger.TAKEN_OVER,
    Trigger.HANDED_BACK,
    Trigger.OTHER_COMPUTER,
    Trigger.LINK_SILENT,
    Trigger.LULL_OVER,
    Trigger.LINK_BACK,
    Trigger.REBOOTED,
    Trigger.ABORT,
)
"""Every phase has a row for each of these."""

Target = Phase | str


def _table() -> dict[tuple[Phase, Trigger], Target]:
    p, t = Phase, Trigger
    table: dict[tuple[Phase, Trigger], Target] = {
        # the straight way
        (p.IDENTIFY, t.IDENTIFIED): p.CONFIGURE,
        (p.IDENTIFY, t.AIRBORNE_AT_START): p.RECOGNISE,
        (p.IDENTIFY, t.MISSION_UNKNOWN): p.PASSIVE,
        (p.CONFIGURE, t.TELEMETRY_COMES): p.WAIT_POSITION,
        (p.WAIT_POSITION, t.POSITION_USABLE): p.PLAN,
        (p.PLAN, t.PLANNED): p.UPLOAD,
        (p.UPLOAD, t.UPLOADED): p.READ_BACK,
        (p.READ_BACK, t.READ_BACK_MATCHES): p.READY,
        (p.READ_BACK, t.READ_BACK_DIFFERS): p.UPLOAD,
        (p.READY, t.VERIFY): p.READ_BACK,
        (p.READY, t.AUTHORISED): p.ARM,
        (p.ARM, t.ARMED): p.CLIMB,
        (p.CLIMB, t.AT_HEIGHT): p.MEASURE,
        (p.MEASURE, t.GO): p.OUTBOUND,
        (p.OUTBOUND, t.CUSTOMER_REACHED): p.DELIVER,
        (p.DELIVER, t.DROP_REACHED): p.RELEASE,
        (p.RELEASE, t.DROP_OVER): p.RETURN,
        (p.RETURN, t.LANDING): p.LAND,
        (p.DIVERT, t.LANDING): p.LAND,
        (p.LAST_RESORT, t.LANDING): p.LAND,
        # the way home taken early, changed, or refused
        **{(phase, t.HOMEWARD): p.RETURN for phase in OUTWARD_PHASES},
        **{(phase, t.RALLY_BOUND): p.DIVERT for phase in (*OUTWARD_PHASES, p.RETURN)},
        (p.DIVERT, t.HOMEWARD): p.RETURN,
        (p.RETURN, t.GO): p.OUTBOUND,
        (p.RETURN, t.CUSTOMER_REACHED): p.DELIVER,
        **{(phase, t.WAY_HOME_REFUSED): p.LAST_RESORT for phase in (p.RETURN, p.DIVERT, p.LAND)},
        (p.SUSPENDED, t.UNANSWERED): p.LAST_RESORT,
        **{(phase, t.LANDED): p.DONE for phase in (*FLIGHT_PHASES, p.SUSPENDED)},
        **{(phase, t.NOT_POSSIBLE): p.GROUNDED for phase in GROUND_PHASES},
        **{(phase, t.TELEMETRY_STOPPED): p.CONFIGURE for phase in WAITING_PHASES},
        # picking the flight up again
        (p.RECOGNISE, t.STILL_ON_GROUND): p.CONFIGURE,
        (p.RECOGNISE, t.MISSION_UNKNOWN): p.PASSIVE,
        (p.RECOGNISE, t.TELEMETRY_COMES): p.CLIMB,
        (p.RECOGNISE, t.AT_HEIGHT): p.MEASURE,
        (p.RECOGNISE, t.GO): p.OUTBOUND,
        (p.RECOGNISE, t.CUSTOMER_REACHED): p.DELIVER,
        (p.RECOGNISE, t.DROP_REACHED): p.RELEASE,
        (p.RECOGNISE, t.HOMEWARD): p.RETURN,
        (p.RECOGNISE, t.RALLY_BOUND): p.DIVERT,
        (p.RECOGNISE, t.LANDING): p.LAND,
        (p.RECOGNISE, t.LANDED): p.DONE,
        (p.RECOGNISE, t.WAY_HOME_REFUSED): p.LAST_RESORT,
    }
    # what may happen in any phase
    for phase in Phase:
        over = phase in END_PHASES
        passive = phase is p.PASSIVE
        waiting = phase in (p.SUSPENDED, p.LINK_LOST)
        early = phase is p.IDENTIFY
        table[phase, t.TAKEN_OVER] = phase if (over or passive or early) else p.SUSPENDED
        resumes = phase in (p.SUSPENDED, p.PASSIVE)  # over a foreign mission, see authority.py
        table[phase, t.HANDED_BACK] = p.RECOGNISE if resumes else phase
        table[phase, t.OTHER_COMPUTER] = phase if over else p.PASSIVE
        stays = over or passive or waiting or early
        table[phase, t.LINK_SILENT] = phase if stays else p.LINK_LOST
        table[phase, t.LULL_OVER] = BEFORE if phase is p.LINK_LOST else phase
        table[phase, t.REBOOTED] = phase if stays else p.RECOGNISE
        table[phase, t.LINK_BACK] = table[phase, t.REBOOTED]
        table[phase, t.ABORT] = phase
    table[p.LINK_LOST, t.LINK_BACK] = p.RECOGNISE
    table[p.LINK_LOST, t.REBOOTED] = p.RECOGNISE
    for phase in OUTWARD_PHASES:
        table[phase, t.ABORT] = p.RETURN
    for phase in GROUND_PHASES:
        table[phase, t.ABORT] = p.GROUNDED
        table[phase, t.REBOOTED] = p.CONFIGURE
        table[phase, t.LINK_BACK] = p.CONFIGURE
    return table


TABLE = _table()


def next_phase(phase: Phase, trigger: Trigger, before: Phase | None = None) -> Phase:
    """Return the phase that follows; a trigger that means nothing in this phase changes nothing."""
    target = TABLE.get((phase, trigger), phase)
    if isinstance(target, Phase):
        return target
    return before if before is not None else Phase.RECOGNISE


def as_markdown() -> str:
    """Return the table for the docs: a row for each phase and trigger that changes the phase."""
    lines = ["| in | on | to |", "| --- | --- | --- |"]
    for (phase, trigger), target in TABLE.items():
        if target is not phase:
            name = target.value if isinstance(target, Phase) else target
            lines.append(f"| {phase.value} | {trigger.value} | {name} |")
    return "\n".join(lines)


def as_mermaid() -> str:
    """Return a state diagram of the straight way (what may happen anytime is left out)."""
    lines = ["stateDiagram-v2", f"    [*] --> {Phase.IDENTIFY.name}"]
    for (phase, trigger), target in TABLE.items():
        if trigger not in ANYTIME and isinstance(target, Phase) and target is not phase:
            lines.append(f"    {phase.name} --> {target.name}: {trigger.value}")
    lines += [f"    {phase.name} --> [*]" for phase in END_PHASES]
    return "\n".join(lines)
