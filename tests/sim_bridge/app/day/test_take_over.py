"""Commands after a take-over are counted from when the companion could know of it."""

import pytest

from sim_bridge.app.day.take_over import TakeOver
from sim_bridge.app.flight.operator import command_long
from sim_bridge.app.flight.vehicle_process import MISSION_CUSTOM_MODE
from sim_bridge.autopilot.mavlink.codec import Encoder, Message

JUMP = Encoder(1, 191).encode(command_long(1, 1, 224))  # MAV_CMD_DO_SET_MISSION_CURRENT
ASKS = Encoder(1, 191).encode(command_long(1, 1, 512))  # MAV_CMD_REQUEST_MESSAGE


def heartbeat(custom_mode: int) -> bytes:
    message = Message(
        "HEARTBEAT", type=2, autopilot=12, base_mode=209, custom_mode=custom_mode, system_status=4
    )
    return Encoder(1, 1).encode(message)


@pytest.fixture(params=["px4", "ardupilot"])
def taken(request) -> TakeOver:
    return TakeOver(request.param, 100.0)


def mission(taken: TakeOver) -> int:
    return MISSION_CUSTOM_MODE[taken.autopilot_kind]


def test_safety_rule_1_a_command_after_another_mode_was_heard_is_one_too_many(taken):
    taken.reaches_companion(101.0, [heartbeat(mission(taken) + 1)])
    taken.leaves_companion(102.0, JUMP)
    assert taken.commands == ["COMMAND_LONG 224 at 102.0 s"]


def test_a_command_before_the_companion_could_know_is_none(taken):
    taken.leaves_companion(100.1, JUMP)
    taken.reaches_companion(100.2, [heartbeat(mission(taken))])
    taken.leaves_companion(102.0, JUMP)
    taken.reaches_companion(103.0, [heartbeat(mission(taken) + 1)])
    taken.leaves_companion(103.1, JUMP)
    assert taken.commands == []


def test_a_question_is_no_command(taken):
    taken.reaches_companion(101.0, [heartbeat(mission(taken) + 1)])
    taken.leaves_companion(102.0, ASKS)
    assert taken.commands == []
