"""Faults of the link between autopilot and companion: loss, silence, invalid traffic."""

from collections.abc import Iterator

import numpy as np

from sim_bridge.app.faults.fault import (
    AIRBORNE_PHASES,
    AIRBORNE_PHASES_BEFORE_LANDING,
    SAFETY_RULES,
    FaultGroup,
)
from sim_bridge.app.faults.verdict import check_delivered, check_procedure_made_note
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.link.bad_link import FaultyLink
from sim_bridge.app.link.client_messages import (
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    autopilot_heartbeat,
)
from sim_bridge.app.link.message_mutation import FIELD_MUTATIONS, MessageMutator
from sim_bridge.app.link.tap import INJECTED, SlowLine, pass_unchanged
from sim_bridge.autopilot.mavlink.codec import Encoder, Message

FAULTS = FaultGroup("link")

LOSS_FRAC = 0.3
RADIO_BYTES_PER_S = 5760.0  # 57,600 baud, ten bits a byte
RADIO_BUFFER_BYTES = 2048  # as of the 3DR/SiK radios' firmware
INDEFINITE_S = 1e9
UNREACHABLE_TEXT = "no ground station or desk reaches this companion"
UNREACHED_S = 40.0
REFUSED_NOTE = "take-off refused with the reason"
TIME_MESSAGE = "TIMESYNC"  # simulated time waits for it: it is not part of the faulty link


@FAULTS.register_procedure(50, "lossy-link", AIRBORNE_PHASES_BEFORE_LANDING)
def lose_duplicate_and_delay_messages(stage: FaultContext) -> Iterator[None]:
    """30 % of all messages are lost, 30 % duplicated; attitude is delayed at random times."""
    yield from stage.wait_for_phase_and_record_fault_start()
    rng, tap = stage.rng, stage.tap

    def randomly_lose_or_duplicate(message: Message) -> list[Message] | None:
        if message.msg_name == TIME_MESSAGE:
            return None
        return [message] * int(
            rng.choice([0, 1, 2], p=[LOSS_FRAC, 1.0 - 2.0 * LOSS_FRAC, LOSS_FRAC])
        )

    stage.expect_messages_changed()
    tap.to_companion = tap.to_autopilot = randomly_lose_or_duplicate
    while True:
        is_attitude_delayed = rng.random() < LOSS_FRAC
        tap.delay_s_by_name = {"ATTITUDE": rng.uniform(0.1, 0.4)} if is_attitude_delayed else {}
        yield


def silence_link(duration_s: float) -> FaultProcedure:
    """Return a procedure: no message passes in either direction for `duration_s`."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        link = stage.craft.link
        stage.expect_change("lost frames", lambda: link.lost_count)
        link.silent_until_s = stage.craft.t_s + duration_s

    return procedure


@FAULTS.register_procedure(
    94,
    "radio-not-forwarded",
    ("ready",),
    (*SAFETY_RULES, check_delivered, check_procedure_made_note(REFUSED_NOTE)),
    autopilots=("px4",),
    arguments=("--authorise",),
)
def stop_forwarding_of_station_link(stage: FaultContext) -> Iterator[None]:
    """PX4 does not forward the station's link for a minute: no take-off, with the reason (S9)."""
    craft, params = stage.craft, stage.craft.autopilot.state.params
    stage.record_fault_start()
    counts, station = stage.tap.sender_counts, (GROUND_SYSTEM, GROUND_COMPONENT)
    params.set("MAV_0_FORWARD", 0.0)
    yield from stage.wait(1.0)  # until what was already forwarded has arrived
    before, until_s = counts[station], stage.t_s + UNREACHED_S
    stage.expect_effect(
        f"no station is received for {UNREACHED_S:g} s",
        lambda: stage.t_s > until_s and counts[station] == before,
    )
    yield from stage.wait(stage.rng.uniform(50.0, 80.0) - 1.0)
    log = (craft.run_dir / "companion.log").read_text()
    if craft.record.takeoff_s is None and not craft.operator.accepted and UNREACHABLE_TEXT in log:
        stage.notes.append(REFUSED_NOTE)
    params.set("MAV_0_FORWARD", 1.0)


@FAULTS.register_procedure(55, "slow-radio", ("ready", *AIRBORNE_PHASES_BEFORE_LANDING))
def limit_link_to_radio_rate(stage: FaultContext) -> Iterator[None]:
    """The companion receives the autopilot through a radio of 57,600 baud."""
    yield from stage.wait_for_phase_and_record_fault_start()
    radio = SlowLine(RADIO_BYTES_PER_S, RADIO_BUFFER_BYTES)
    stage.expect_effect("frames wait for the line", lambda: radio.queued_bytes > 0)
    stage.tap.radio = radio


def slow_down_transfers(prefix: str, max_delay_s: float, max_stall_s: float) -> FaultProcedure:
    """Return a procedure: until arming, messages of this prefix arrive a drawn time late, some are
    lost, and the companion may stall in the transfer.

    A mission can be transferred in the whole drawn space. PX4 ends an upload after 5 s without an
    item: ten losses in a row of one repeated each 0.5 s, 0.3^10 = 6e-6. ArduPilot ends it 8 s after
    the last new item, with requests at 1 Hz: at a round trip of 3 s 1e-3 for an item, 2 % for 20
    items, and two restarts 1e-5.
    """

    def procedure(stage: FaultContext) -> Iterator[None]:
        rng, tap, sent = stage.rng, stage.tap, list[Message]()
        delay_s, loss = max_delay_s * rng.uniform(0.1, 1.0), rng.choice([0.0, LOSS_FRAC])
        stall_s = rng.choice([0.0, max_stall_s])
        stage.record_fault_start()
        stage.expect_messages_changed()

        def lose_at_random(message: Message) -> list[Message] | None:
            name = message.msg_name
            if not name.startswith(prefix) or name == "MISSION_CURRENT":
                return None
            tap.delay_s_by_name[name] = delay_s
            sent.append(message)
            return [] if rng.random() < loss else None

        tap.to_companion = tap.to_autopilot = lose_at_random
        yield from stage.wait_until(lambda: bool(sent))
        if stall_s:
            yield from stage.wait(0.5)
            stage.stall_companion()
            yield from stage.wait(stall_s)
            stage.resume_companion()
        yield from stage.wait_until(lambda: stage.is_armed)
        tap.to_companion = tap.to_autopilot = pass_unchanged
        tap.delay_s_by_name = {}

    return procedure


@FAULTS.register_procedure(76, "stray-result", ("ready",), (*SAFETY_RULES, check_delivered))
def inject_stray_mission_result(stage: FaultContext) -> Iterator[None]:
    """The upload is answered with a result that belongs to no transfer (A15)."""
    counts: list[Message] = []
    stage.expect_messages_changed(INJECTED)
    stage.tap.to_autopilot = lambda m: counts.append(m) if m.msg_name == "MISSION_COUNT" else None
    yield from stage.wait_until(lambda: bool(counts))
    stage.record_fault_start()
    yield from stage.wait(stage.rng.uniform(0.0, 0.4))
    result = int(stage.rng.choice(STRAY_RESULTS))
    ack = Message(
        "MISSION_ACK",
        target_system=stage.craft.number,
        target_component=191,
        type=result,
        mission_type=0,
    )
    stage.tap.injected_frames.append(Encoder(stage.craft.number, 1).encode_next_frame(ack))
    yield from stage.wait(1.0)


STRAY_RESULTS = (1, 13, 15)
"""MAV_MISSION_ERROR, INVALID_SEQUENCE and OPERATION_CANCELLED."""

for number, name, description, arguments in (
    (88, "slow-upload", "Mission messages have a round trip of 0.3 to 3 s, 0 or 30 % are lost; the"
     " companion may stall for 2 s (S1).", ("MISSION_", 3.0, 2.0)),
    (92, "slow-parameters", "Parameter messages arrive 0.3 to 3 s late, 0 or 30 % are lost (S6).",
     ("PARAM_", 3.0, 0.0)),
):  # fmt: skip
    procedure, rules = slow_down_transfers(*arguments), (*SAFETY_RULES, check_delivered)
    FAULTS.add_case(number, name, description, procedure, ("ready",), rules)


@FAULTS.register_procedure(8, "namesake", AIRBORNE_PHASES_BEFORE_LANDING)
def inject_vehicle_with_same_system_id(stage: FaultContext) -> Iterator[None]:
    """Another vehicle with the same system ID, mode POSITION, 1 km away, is on the link."""
    yield from stage.wait_for_phase_and_record_fault_start()
    encoder, craft = Encoder(stage.craft.number, 1), stage.craft
    stage.expect_messages_changed(INJECTED)
    lat_deg, lon_deg = (craft.depot.lat_deg or 0.0) + 0.009, craft.depot.lon_deg or 0.0
    while True:
        heartbeat = autopilot_heartbeat(craft.autopilot_kind, "position", base_mode=209)
        position = Message(
            "GLOBAL_POSITION_INT",
            time_boot_ms=craft.autopilot.time_boot_ms,
            lat=round(lat_deg * 1e7),
            lon=round(lon_deg * 1e7),
            alt=80_000,
            relative_alt=68_000,
            vx=0,
            vy=0,
            vz=0,
            hdg=0,
        )
        stage.tap.injected_frames += [
            encoder.encode_next_frame(heartbeat),
            encoder.encode_next_frame(position),
        ]
        yield from stage.wait(1.0)


@FAULTS.register_procedure(
    52,
    "strangers",
    ("ready", *AIRBORNE_PHASES_BEFORE_LANDING),
    (*SAFETY_RULES, check_delivered),
    arguments=("--system=1",),  # of several vehicles on the link at the start, none is chosen
)
def inject_invalid_traffic(stage: FaultContext) -> Iterator[None]:
    """The link carries garbage, truncated frames, other systems and invalid fields."""
    yield from stage.wait_for_phase_and_record_fault_start()
    seed = int(stage.rng.integers(2**31))
    link = FaultyLink(stage.craft.number, np.random.default_rng(seed))
    stage.expect_change("disturbed exchanges", lambda: link.disturbed_exchange_count)
    stage.craft.link.bad_link = link


@FAULTS.register_procedure(53, "fields-mutated", AIRBORNE_PHASES)
def mutate_message_fields_at_random(stage: FaultContext) -> Iterator[None]:
    """For 3 to 10 s one message in twenty has extreme, NaN, offset or random fields."""
    yield from stage.wait_for_phase_and_record_fault_start()
    mutator = MessageMutator(stage.rng, MUTATED_SHARE, tuple(FIELD_MUTATIONS), active=True)
    stage.expect_messages_changed()
    stage.tap.to_companion = mutator.mutate_random_share_of_messages
    yield from stage.wait(stage.rng.uniform(*MUTATED_FOR_S))
    stage.tap.to_companion = pass_unchanged


MUTATED_SHARE = 0.05
MUTATED_FOR_S = (3.0, 10.0)

for name, description, duration_s, rules in (
    ("1-s", "A second of silence.", 1.0, (*SAFETY_RULES, check_delivered)),
    ("10-s", "Ten seconds of silence.", 10.0, SAFETY_RULES),
    ("60-s", "A minute of silence.", 60.0, SAFETY_RULES),
    (
        "for-good",
        "Permanent silence: the onboard mission flies the vehicle home.",
        INDEFINITE_S,
        SAFETY_RULES,
    ),
):
    FAULTS.add_case(
        51, f"silence-{name}", description, silence_link(duration_s), AIRBORNE_PHASES, rules
    )
