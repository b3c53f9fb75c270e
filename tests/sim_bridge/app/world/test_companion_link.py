"""The companion's link: commands after a take-over, and commands that the autopilot refuses."""

from types import SimpleNamespace
from typing import Any

import pytest

from sim_bridge.app.link.client_messages import command_long, heartbeat_custom_mode
from sim_bridge.app.world.companion_link import CompanionLink
from sim_bridge.app.world.safety_rules import TakeOver, format_sent_command
from sim_bridge.autopilot.mavlink.codec import Encoder, Message

JUMP = Encoder(1, 191).encode_next_frame(command_long(1, 1, 224))  # MAV_CMD_DO_SET_MISSION_CURRENT
ASKS = Encoder(1, 191).encode_next_frame(command_long(1, 1, 512))  # MAV_CMD_REQUEST_MESSAGE
OURS, OTHER = 0, 1
"""The mission's mode in a heartbeat, and another."""


def heartbeat(mode: int) -> bytes:
    message = Message(
        "HEARTBEAT", type=2, autopilot=12, base_mode=209, custom_mode=mode, system_status=4
    )
    return Encoder(1, 1).encode_next_frame(message)


@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
@pytest.mark.parametrize(
    ("steps", "late"),
    [
        ([(101.0, OTHER), (102.0, JUMP)], ["COMMAND_LONG 224 at 102.0 s"]),
        ([(100.1, JUMP), (100.2, OURS), (102.0, JUMP), (103.0, OTHER), (103.1, JUMP)], []),
        ([(101.0, OTHER), (102.0, ASKS)], []),
    ],
    ids=["a command after another mode", "commands before it could know", "a request"],
)
def test_safety_rule_1_a_command_after_another_mode_was_heard_is_late(autopilot_kind, steps, late):
    mission = heartbeat_custom_mode(autopilot_kind, "mission")
    autopilot = SimpleNamespace(process_received_datagram=lambda link, datagram: None)
    host: Any = SimpleNamespace(t_s=100.0, autopilot=autopilot)
    taken = TakeOver(100.0)
    link = CompanionLink(host, 1, takeover=taken)
    for host.t_s, what in steps:
        if isinstance(what, bytes):
            link.pass_datagram_to_autopilot(what)
        else:
            taken.record_reported_modes(host.t_s, autopilot_kind, [heartbeat(mission + what)])
    assert [format_sent_command(one) for one in link.late_commands] == late
    assert link.late_commands_text == (f"1 commands after the take-over, {late[0]}" if late else "")


@pytest.mark.parametrize("refuses", [True, False])
def test_a_refused_command_leaves_the_rest_of_its_datagram(refuses: bool):
    text = Encoder(1, 191).encode_next_frame(
        Message("STATUSTEXT", severity=2, text="mission not usable: companion commands RTL")
    )
    received: list[bytes] = []
    autopilot = SimpleNamespace(
        process_received_datagram=lambda link, datagram: received.append(datagram)
    )
    host: Any = SimpleNamespace(t_s=100.0, autopilot=autopilot)
    link = CompanionLink(host, 1)
    link.refused = frozenset({("COMMAND_LONG", 224)} if refuses else ())
    link.pass_datagram_to_autopilot(text + JUMP + ASKS)
    assert received == [text + ASKS if refuses else text + JUMP + ASKS]
    assert [format_sent_command(one) for one in link.commands] == ["COMMAND_LONG 224 at 100.0 s"]
