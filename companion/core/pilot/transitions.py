"""The mission as a table: phase, trigger, next phase. The documents are generated from it."""

from enum import Enum


class Phase(Enum):
    """Phase of the companion."""

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
    FOREIGN_MISSION = "foreign mission"
    PASSIVE = "passive"
    LINK_LOST = "link lost"


class Trigger(Enum):
    """Causes of transitions; the pilot derives them from events."""

    AUTOPILOT_DETECTED = "autopilot identified"
    TELEMETRY_AVAILABLE = "telemetry comes"
    POSITION_USABLE = "position usable"
    PLANNED = "planned"
    UPLOADED = "uploaded"
    READ_BACK_MATCHES = "read back, same"
    READ_BACK_DIFFERS = "read back, differs"
    VERIFY = "authorised, to be verified"
    AUTHORISED = "authorised"
    ARMED = "armed by us"
    AT_HEIGHT = "at cruise height"
    DEPARTURE_CLEARED = "gate open: go"
    CUSTOMER_REACHED = "cleared to descend"
    DROP_REACHED = "at drop height"
    DROP_OVER = "drop over"
    RETURN_STARTED = "homeward"
    RALLY_BOUND = "to a rally point"
    RETURN_REFUSED = "way home refused"
    LANDING = "landing"
    LANDED = "landed"
    NOT_POSSIBLE = "not possible"
    AIRBORNE_AT_START = "airborne at start"
    MISSION_UNKNOWN = "mission not ours"
    FLIGHT_UNKNOWN = "flight not ours"
    STILL_ON_GROUND = "still on the ground"
    HOLD_UNANSWERED = "hold that nobody answers"
    # What may happen in any phase:
    PILOT_OVERRIDE = "mode not ours"
    HANDED_BACK = "control handed back"
    OTHER_COMPANION = "other computer"
    LINK_SILENT = "link silent"
    LINK_BACK_SHORT = "link back at once"
    LINK_RECOVERED = "link back"
    REBOOTED = "autopilot rebooted"
    TELEMETRY_LOST = "telemetry stopped"
    ABORT = "abort ordered"


PREVIOUS_PHASE = "the phase before"

GROUND_PHASES = (
    Phase.CONFIGURE,
    Phase.WAIT_POSITION,
    Phase.PLAN,
    Phase.UPLOAD,
    Phase.READ_BACK,
    Phase.READY,
    Phase.ARM,
)
"""On the ground, before the companion arms."""

WAITING_PHASES = GROUND_PHASES[1:-1]
"""Those from the first telemetry on until the companion arms."""

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
"""In the air under the companion's control."""

OUTBOUND_PHASES = (Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER, Phase.RELEASE)
"""Flying away from home, or about to."""

RETURN_PHASES = (Phase.RETURN, Phase.DIVERT, Phase.LAST_RESORT, Phase.LAND)

END_PHASES = (Phase.DONE, Phase.GROUNDED)

RESUMABLE_PHASES = (Phase.SUSPENDED, Phase.FOREIGN_MISSION)
"""Without control until an operator hands it back; over a foreign mission an abort does so, too."""

RELEASED_PHASES = (*RESUMABLE_PHASES, Phase.PASSIVE)
"""Without control. PASSIVE is final: another companion flies, or this one has no plan."""

COMMANDING_PHASES = (*GROUND_PHASES, *FLIGHT_PHASES, Phase.RECOGNISE)
"""The only phases in which the autopilot may be sent an order (safety rule 1)."""

ANY_PHASE_TRIGGERS = (
    Trigger.PILOT_OVERRIDE,
    Trigger.HANDED_BACK,
    Trigger.OTHER_COMPANION,
    Trigger.LINK_SILENT,
    Trigger.LINK_BACK_SHORT,
    Trigger.LINK_RECOVERED,
    Trigger.REBOOTED,
    Trigger.ABORT,
)
"""Every phase has a row for each of these."""

Target = Phase | str


def _transition_table() -> dict[tuple[Phase, Trigger], Target]:
    p, t = Phase, Trigger
    table: dict[tuple[Phase, Trigger], Target] = {
        # the nominal sequence
        (p.IDENTIFY, t.AUTOPILOT_DETECTED): p.CONFIGURE,
        (p.IDENTIFY, t.AIRBORNE_AT_START): p.RECOGNISE,
        (p.IDENTIFY, t.FLIGHT_UNKNOWN): p.PASSIVE,
        (p.CONFIGURE, t.TELEMETRY_AVAILABLE): p.WAIT_POSITION,
        (p.WAIT_POSITION, t.POSITION_USABLE): p.PLAN,
        (p.PLAN, t.PLANNED): p.UPLOAD,
        (p.UPLOAD, t.UPLOADED): p.READ_BACK,
        (p.READ_BACK, t.READ_BACK_MATCHES): p.READY,
        (p.READ_BACK, t.READ_BACK_DIFFERS): p.UPLOAD,
        (p.READY, t.VERIFY): p.READ_BACK,
        (p.READY, t.AUTHORISED): p.ARM,
        (p.ARM, t.ARMED): p.CLIMB,
        (p.CLIMB, t.AT_HEIGHT): p.MEASURE,
        (p.MEASURE, t.DEPARTURE_CLEARED): p.OUTBOUND,
        (p.OUTBOUND, t.CUSTOMER_REACHED): p.DELIVER,
        (p.DELIVER, t.DROP_REACHED): p.RELEASE,
        (p.RELEASE, t.DROP_OVER): p.RETURN,
        (p.RETURN, t.LANDING): p.LAND,
        (p.DIVERT, t.LANDING): p.LAND,
        (p.LAST_RESORT, t.LANDING): p.LAND,
        # an early, changed or refused return
        **{(phase, t.RETURN_STARTED): p.RETURN for phase in OUTBOUND_PHASES},
        **{(phase, t.RALLY_BOUND): p.DIVERT for phase in (*OUTBOUND_PHASES, p.RETURN)},
        (p.DIVERT, t.RETURN_STARTED): p.RETURN,
        (p.RETURN, t.DEPARTURE_CLEARED): p.OUTBOUND,
        (p.RETURN, t.CUSTOMER_REACHED): p.DELIVER,
        **{(phase, t.RETURN_REFUSED): p.LAST_RESORT for phase in (p.RETURN, p.DIVERT, p.LAND)},
        (p.SUSPENDED, t.HOLD_UNANSWERED): p.LAST_RESORT,
        **{(phase, t.LANDED): p.DONE for phase in (*FLIGHT_PHASES, *RESUMABLE_PHASES)},
        **{(phase, t.NOT_POSSIBLE): p.GROUNDED for phase in GROUND_PHASES},
        **{(phase, t.TELEMETRY_LOST): p.CONFIGURE for phase in WAITING_PHASES},
        # resuming the flight
        (p.RECOGNISE, t.STILL_ON_GROUND): p.CONFIGURE,
        (p.RECOGNISE, t.MISSION_UNKNOWN): p.FOREIGN_MISSION,
        (p.RECOGNISE, t.FLIGHT_UNKNOWN): p.PASSIVE,
        (p.RECOGNISE, t.TELEMETRY_AVAILABLE): p.CLIMB,
        (p.RECOGNISE, t.AT_HEIGHT): p.MEASURE,
        (p.RECOGNISE, t.DEPARTURE_CLEARED): p.OUTBOUND,
        (p.RECOGNISE, t.CUSTOMER_REACHED): p.DELIVER,
        (p.RECOGNISE, t.DROP_REACHED): p.RELEASE,
        (p.RECOGNISE, t.RETURN_STARTED): p.RETURN,
        (p.RECOGNISE, t.RALLY_BOUND): p.DIVERT,
        (p.RECOGNISE, t.LANDING): p.LAND,
        (p.RECOGNISE, t.LANDED): p.DONE,
        (p.RECOGNISE, t.RETURN_REFUSED): p.LAST_RESORT,
    }
    # what may happen in any phase
    for phase in Phase:
        over = phase in END_PHASES
        passive = phase in (p.FOREIGN_MISSION, p.PASSIVE)
        waiting = phase in (p.SUSPENDED, p.LINK_LOST)
        early = phase is p.IDENTIFY
        table[phase, t.PILOT_OVERRIDE] = phase if (over or passive or early) else p.SUSPENDED
        table[phase, t.HANDED_BACK] = p.RECOGNISE if phase in RESUMABLE_PHASES else phase
        table[phase, t.OTHER_COMPANION] = phase if over else p.PASSIVE
        stays = over or passive or waiting or early
        table[phase, t.LINK_SILENT] = phase if stays else p.LINK_LOST
        table[phase, t.LINK_BACK_SHORT] = PREVIOUS_PHASE if phase is p.LINK_LOST else phase
        table[phase, t.REBOOTED] = phase if stays else p.RECOGNISE
        table[phase, t.LINK_RECOVERED] = table[phase, t.REBOOTED]
        table[phase, t.ABORT] = phase
    table[p.LINK_LOST, t.LINK_RECOVERED] = p.RECOGNISE
    table[p.LINK_LOST, t.REBOOTED] = p.RECOGNISE
    for phase in OUTBOUND_PHASES:
        table[phase, t.ABORT] = p.RETURN
    for phase in GROUND_PHASES:
        table[phase, t.ABORT] = p.GROUNDED
        table[phase, t.REBOOTED] = p.CONFIGURE
        table[phase, t.LINK_RECOVERED] = p.CONFIGURE
    return table


TRANSITIONS = _transition_table()


def next_phase(phase: Phase, trigger: Trigger, interrupted_phase: Phase | None = None) -> Phase:
    """Return the next phase; a trigger without a row leaves the phase unchanged."""
    target = TRANSITIONS.get((phase, trigger), phase)
    if isinstance(target, Phase):
        return target
    return interrupted_phase if interrupted_phase is not None else Phase.RECOGNISE


def transitions_as_markdown() -> str:
    """Return the table for the docs: a row for each phase and trigger that changes the phase."""
    lines = ["| in | on | to |", "| --- | --- | --- |"]
    for (phase, trigger), target in TRANSITIONS.items():
        if target is not phase:
            name = target.value if isinstance(target, Phase) else target
            lines.append(f"| {phase.value} | {trigger.value} | {name} |")
    return "\n".join(lines)


def transitions_as_mermaid() -> str:
    """Return a state diagram of the nominal sequence (triggers of any phase are omitted)."""
    lines = ["stateDiagram-v2", f"    [*] --> {Phase.IDENTIFY.name}"]
    for (phase, trigger), target in TRANSITIONS.items():
        if trigger not in ANY_PHASE_TRIGGERS and isinstance(target, Phase) and target is not phase:
            lines.append(f"    {phase.name} --> {target.name}: {trigger.value}")
    lines += [f"    {phase.name} --> [*]" for phase in END_PHASES]
    return "\n".join(lines)
