"""Evidence of an injection: effects that a fault procedure expects, and messages of the tap."""

import numpy as np
import pytest

from sim_bridge.app.flight.stage import FaultContext
from sim_bridge.app.link.tap import Tap, message_with_changed_fields
from sim_bridge.app.world.flight_phase import FlightPhase
from sim_bridge.autopilot.mavlink.codec import Encoder, Message


def stage_of(tap: Tap | None = None) -> FaultContext:
    class Link:
        pass

    class OneCraft:
        link = Link()

    OneCraft.link.tap = tap
    rng = np.random.default_rng(1)
    return FaultContext(
        FlightPhase.OUTBOUND, rng, lambda: True, craft_and_lockstep=(OneCraft(), None)
    )


def test_an_effect_counts_that_held_for_one_step_only():
    stage, held = stage_of(), [False]
    stage.expect_effect("HOLD", lambda: held[0])
    stage.continue_procedure(0.1)
    assert stage.missing_effects_text == "HOLD"
    held[0] = True
    stage.continue_procedure(0.2)
    held[0] = False
    stage.continue_procedure(0.3)
    assert stage.missing_effects_text == ""


def test_a_state_that_held_before_the_injection_is_no_evidence():
    stage = stage_of()
    stage.expect_effect("HOLD", lambda: True)
    assert "already before the injection" in stage.missing_effects_text


def test_a_fault_of_the_world_holds_from_power_up():
    stage = stage_of()
    stage.expect_effect("cold", lambda: True, is_in_world=True)
    assert stage.missing_effects_text == ""


POSITION = Message("MISSION_CURRENT", seq=3)
CHANGES = {
    "altered": (lambda message: [message_with_changed_fields(message, seq=4)], True),
    "dropped": (lambda message: [], True),
    "repeated": (lambda message: [message, message], True),
    "the same": (lambda message: [message], False),
    "passed": (lambda message: None, False),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_message_counts_that_the_tap_changes(change):
    tap = Tap(to_companion=CHANGES[change][0])
    stage = stage_of(tap)
    stage.expect_messages_changed()
    stage.expect_messages_changed("MISSION_CURRENT")
    stage.expect_messages_changed("HEARTBEAT")
    tap.transmit_to_companion([Encoder(1, 1).encode_next_frame(POSITION)], 1.0)
    missing = stage.missing_effects_text
    assert "HEARTBEAT changed" in missing
    assert ("MISSION_CURRENT changed" not in missing) is CHANGES[change][1]
    assert ("a message changed" not in missing) is CHANGES[change][1]


def test_late_and_injected_frames_are_changes():
    frame = Encoder(1, 1).encode_next_frame(POSITION)
    for tap in (Tap(delay_s_by_name={"MISSION_CURRENT": 1.0}), Tap(injected_frames=[frame])):
        stage = stage_of(tap)
        stage.expect_messages_changed()
        tap.transmit_to_companion([] if tap.injected_frames else [frame], 1.0)
        assert stage.missing_effects_text == ""
