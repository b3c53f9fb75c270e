"""Sensor failures as they appear in the telemetry that the companion receives.

The kinds are those that PX4 can inject into its sensors: off, stuck, garbage, slow, delayed,
intermittent (fixed offsets have separate rows). The autopilot itself works normally.
"""

from collections.abc import Iterator

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.fault import SAFETY_RULES, FaultGroup
from sim_bridge.app.faults.verdict import check_alert_sent
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.link.tap import MessageChange, message_with_changed_fields
from sim_bridge.autopilot.mavlink.codec import Message

Ranges = dict[str, tuple[float, float]]
SENSOR_FIELDS: dict[str, dict[str, Ranges]] = {
    "attitude": {
        "ATTITUDE": {
            "roll": (-1.0, 1.0),
            "pitch": (-1.0, 1.0),
            "yaw": (-3.0, 3.0),
        },
    },
    "position": {
        "GLOBAL_POSITION_INT": {
            "lat": (554_600_000, 554_800_000),
            "lon": (84_400_000, 84_600_000),
            "alt": (0, 100_000),
            "relative_alt": (-20_000, 100_000),
            "vx": (-1500, 1500),
            "vy": (-1500, 1500),
            "vz": (-500, 500),
        },
    },
    "battery": {
        "BATTERY_STATUS": {
            "current_battery": (0, 9000),
            "current_consumed": (0, 6000),
            "battery_remaining": (0, 100),
        },
        "SYS_STATUS": {
            "voltage_battery": (18_000, 25_000),
            "current_battery": (0, 9000),
            "battery_remaining": (0, 100),
        },
    },
}
"""Telemetry of each sensor: messages, their fields that fail, and the range of each field."""

SLOW_INTERVAL_S = 2.0
DELAY_S = 2.0
OUTAGE_S, RECOVERY_S = 3.0, 3.0
"""Intermittent telemetry: duration of each outage, and of the normal period after it."""


def drop_messages(stage: FaultContext, fields_by_message: dict[str, Ranges]) -> MessageChange:
    """Drop all messages of the sensor."""
    del stage
    return lambda message: [] if message.msg_name in fields_by_message else None


def freeze_fields(stage: FaultContext, fields_by_message: dict[str, Ranges]) -> MessageChange:
    """Repeat the first value with current time stamps."""
    del stage
    first: dict[str, Message] = {}

    def freeze_to_first_values(message: Message) -> list[Message] | None:
        if message.msg_name not in fields_by_message:
            return None
        first_message = first.setdefault(message.msg_name, message)
        frozen_fields = {
            name: getattr(first_message, name) for name in fields_by_message[message.msg_name]
        }
        return [message_with_changed_fields(message, **frozen_fields)]

    return freeze_to_first_values


def randomize_fields(stage: FaultContext, fields_by_message: dict[str, Ranges]) -> MessageChange:
    """Replace each value by a random one of the sensor's range."""

    def randomize_message_fields(message: Message) -> list[Message] | None:
        if message.msg_name not in fields_by_message:
            return None
        random_fields = {
            n: stage.rng.uniform(*span) for n, span in fields_by_message[message.msg_name].items()
        }
        if message.msg_name != "ATTITUDE":
            random_fields = {name: round(value) for name, value in random_fields.items()}
        return [message_with_changed_fields(message, **random_fields)]

    return randomize_message_fields


def pass_one_message_every_2_s(
    stage: FaultContext, fields_by_message: dict[str, Ranges]
) -> MessageChange:
    """Pass one message every two seconds."""
    last_s: dict[str, float] = {}

    def drop_if_too_early(message: Message) -> list[Message] | None:
        name = message.msg_name
        if name not in fields_by_message:
            return None
        if stage.t_s - last_s.get(name, -SLOW_INTERVAL_S) < SLOW_INTERVAL_S:
            return []
        last_s[name] = stage.t_s
        return None

    return drop_if_too_early


def drop_for_3_s_in_every_6_s(
    stage: FaultContext, fields_by_message: dict[str, Ranges]
) -> MessageChange:
    """Drop messages for 3 s and pass them for 3 s, in turn."""
    start_s = stage.t_s

    def drop_during_outage(message: Message) -> list[Message] | None:
        is_outage = (stage.t_s - start_s) % (OUTAGE_S + RECOVERY_S) < OUTAGE_S
        return [] if message.msg_name in fields_by_message and is_outage else None

    return drop_during_outage


def fail_sensor(sensor: str, failure_kind: str) -> FaultProcedure:
    """Return a procedure: from now on the sensor fails permanently in this way."""
    fields_by_message = SENSOR_FIELDS[sensor]

    def procedure(stage: FaultContext) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        stage.expect_messages_changed(*fields_by_message)
        if failure_kind == "delayed":
            stage.tap.delay_s_by_name |= dict.fromkeys(fields_by_message, DELAY_S)
        else:
            stage.tap.to_companion = CHANGE_BY_KIND[failure_kind](stage, fields_by_message)

    return procedure


CHANGE_BY_KIND = {
    "off": drop_messages,
    "stuck": freeze_fields,
    "garbage": randomize_fields,
    "slow": pass_one_message_every_2_s,
    "intermittent": drop_for_3_s_in_every_6_s,
}
KIND_DESCRIPTIONS = {
    "off": "is no longer reported",
    "stuck": "is frozen, with current time stamps",
    "garbage": "has random values of the sensor's range",
    "slow": "is reported every two seconds",
    "delayed": "is reported two seconds late",
    "intermittent": "is missing for three seconds in every six",
}
ROW_NUMBERS = {"attitude": 37, "position": 36, "battery": 26}
GROUP_BY_SENSOR = {
    "attitude": "air and sensors",
    "position": "air and sensors",
    "battery": "energy",
}
ALERT_RULES = {
    ("attitude", "off"): (check_alert_sent(parameter_text="no recent attitude"),),
    ("position", "off"): (check_alert_sent(Alert.POSITION_LOST),),
    ("battery", "off"): (check_alert_sent(parameter_text="no recent battery reading"),),
}
"""Alerts that the operator must receive when a sensor is no longer reported."""

FAULTS = FaultGroup("air and sensors")
for sensor_name in SENSOR_FIELDS:
    for kind, description in KIND_DESCRIPTIONS.items():
        FAULTS.add_case(
            ROW_NUMBERS[sensor_name],
            f"{sensor_name}-{kind}",
            f"{sensor_name.capitalize()} {description}, permanently.",
            fail_sensor(sensor_name, kind),
            rules=(*SAFETY_RULES, *ALERT_RULES.get((sensor_name, kind), ())),
            group=GROUP_BY_SENSOR[sensor_name],
        )
