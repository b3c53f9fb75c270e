"""The routing of ArduPilot and PX4, case by case as their sources state it (see router.py)."""

import pytest

from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from sim_bridge.autopilot.mavlink.router import ArduPilotRouter, Px4Router, Routing

RADIO, COMPANION, USB = "radio", "companion", "usb"
AUTOPILOT = (1, 1)
GCS = (255, 190)
ONBOARD = (1, 191)


def from_(sender: tuple[int, int], message: Message) -> Message:
    (received,) = Decoder().decode_bytes(Encoder(*sender).encode_next_frame(message))
    return received


def heartbeat(sender: tuple[int, int]) -> Message:
    return from_(
        sender,
        Message("HEARTBEAT", type=6, autopilot=8, base_mode=0, custom_mode=0, system_status=4),
    )


def command(sender: tuple[int, int], system: int, component: int) -> Message:
    params = {f"param{number}": 0.0 for number in range(1, 8)}
    return from_(
        sender,
        Message(
            "COMMAND_LONG",
            target_system=system,
            target_component=component,
            command=400,
            confirmation=0,
            **params,
        ),
    )


def text(sender: tuple[int, int]) -> Message:
    return from_(sender, Message("STATUSTEXT", severity=6, text="hello"))


@pytest.fixture(params=[ArduPilotRouter, Px4Router])
def router(request) -> ArduPilotRouter | Px4Router:
    made = request.param(*AUTOPILOT)
    for link in (RADIO, COMPANION, USB):
        made.add_link(link)
    made.learn_sender_and_route(RADIO, heartbeat(GCS))
    made.learn_sender_and_route(COMPANION, heartbeat(ONBOARD))
    return made


def test_a_command_to_the_autopilot_goes_nowhere_else(router) -> None:
    assert router.learn_sender_and_route(RADIO, command(GCS, 1, 1)) == Routing(True, ())


def test_a_command_to_the_companion_goes_to_its_link_only(router) -> None:
    assert router.learn_sender_and_route(RADIO, command(GCS, 1, 191)).forward_to == (COMPANION,)


def test_the_answer_finds_the_ground_station(router) -> None:
    assert router.learn_sender_and_route(COMPANION, command(ONBOARD, 255, 190)) == Routing(
        False, (RADIO,)
    )


def test_a_command_to_all_components_is_handled_and_passed_on(router) -> None:
    assert router.learn_sender_and_route(RADIO, command(GCS, 1, 0)) == Routing(True, (COMPANION,))


def test_a_command_to_all_systems_is_handled_and_passed_on(router) -> None:
    assert router.learn_sender_and_route(RADIO, command(GCS, 0, 0)) == Routing(True, (COMPANION,))


def test_what_has_no_target_reaches_every_link_where_somebody_was_heard(router) -> None:
    assert router.learn_sender_and_route(COMPANION, text(ONBOARD)) == Routing(True, (RADIO,))


def test_what_is_for_a_system_never_heard_is_dropped(router) -> None:
    assert router.learn_sender_and_route(RADIO, command(GCS, 77, 1)) == Routing(False, ())


def test_a_message_never_goes_back_where_it_came_from(router) -> None:
    router.learn_sender_and_route(RADIO, heartbeat(ONBOARD))
    assert RADIO not in router.learn_sender_and_route(RADIO, command(GCS, 1, 191)).forward_to


def test_a_link_that_is_gone_gets_nothing(router) -> None:
    router.drop_link(COMPANION)
    assert router.learn_sender_and_route(RADIO, command(GCS, 1, 191)).forward_to == ()


def test_an_unknown_type_is_passed_on_like_a_broadcast(router) -> None:
    foreign = bytes([0xFD, 2, 0, 0, 7, 255, 190, 0x39, 0x30, 0]) + b"ab" + b"\x12\x34"
    (message,) = Decoder(keep_unknown=True).decode_bytes(foreign)
    assert router.learn_sender_and_route(RADIO, message).forward_to == (COMPANION,)


def test_ardupilot_passes_heartbeats_to_silent_links_too() -> None:
    router = ArduPilotRouter(*AUTOPILOT)
    for link in (RADIO, COMPANION, USB):
        router.add_link(link)
    assert router.learn_sender_and_route(COMPANION, heartbeat(ONBOARD)) == Routing(
        True, (RADIO, USB)
    )


def test_ardupilot_breaks_heartbeat_loops() -> None:
    router = ArduPilotRouter(*AUTOPILOT)
    router.learn_sender_and_route(RADIO, heartbeat(ONBOARD))
    assert router.learn_sender_and_route(COMPANION, heartbeat(ONBOARD)) == Routing(True, ())


def test_ardupilot_takes_what_is_for_a_component_of_its_own_that_nobody_claims() -> None:
    router = ArduPilotRouter(*AUTOPILOT)
    router.add_link(COMPANION)
    assert router.learn_sender_and_route(RADIO, command(GCS, 1, 191)) == Routing(True, ())
    router.learn_sender_and_route(COMPANION, heartbeat(ONBOARD))
    assert router.learn_sender_and_route(RADIO, command(GCS, 1, 191)) == Routing(
        False, (COMPANION,)
    )


def test_ardupilot_sends_another_system_what_is_for_any_of_its_components() -> None:
    router = ArduPilotRouter(*AUTOPILOT)
    router.learn_sender_and_route(USB, heartbeat((2, 1)))
    assert router.learn_sender_and_route(RADIO, command(GCS, 2, 154)) == Routing(False, (USB,))


def test_ardupilot_keeps_the_radios_own_reports() -> None:
    router = ArduPilotRouter(*AUTOPILOT)
    router.learn_sender_and_route(COMPANION, heartbeat(ONBOARD))
    report = Message(
        "RADIO_STATUS", rssi=1, remrssi=1, txbuf=90, noise=1, remnoise=1, rxerrors=0, fixed=0
    )
    assert router.learn_sender_and_route(RADIO, from_((51, 68), report)) == Routing(True, ())


def test_ardupilot_does_not_spread_a_loop_of_its_own_messages() -> None:
    router = ArduPilotRouter(*AUTOPILOT)
    router.learn_sender_and_route(COMPANION, heartbeat(ONBOARD))
    assert router.learn_sender_and_route(RADIO, text(AUTOPILOT)) == Routing(True, ())


def test_px4_needs_to_have_heard_the_very_component() -> None:
    router = Px4Router(*AUTOPILOT)
    router.learn_sender_and_route(USB, heartbeat((2, 1)))
    assert router.learn_sender_and_route(RADIO, command(GCS, 2, 154)).forward_to == ()
    assert router.learn_sender_and_route(RADIO, command(GCS, 2, 1)).forward_to == (USB,)


def test_px4_forwards_heartbeats_only_where_somebody_was_heard() -> None:
    router = Px4Router(*AUTOPILOT)
    router.add_link(USB)
    router.learn_sender_and_route(RADIO, heartbeat(GCS))
    assert router.learn_sender_and_route(COMPANION, heartbeat(ONBOARD)).forward_to == (RADIO,)
