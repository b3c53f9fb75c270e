"""The transition table is complete: each phase handles each event."""

import pytest

from companion.core.pilot.transitions import (
    ANY_PHASE_TRIGGERS,
    COMMANDING_PHASES,
    END_PHASES,
    FLIGHT_PHASES,
    GROUND_PHASES,
    OUTBOUND_PHASES,
    PREVIOUS_PHASE,
    RELEASED_PHASES,
    TRANSITIONS,
    Phase,
    Trigger,
    next_phase,
    transitions_as_markdown,
    transitions_as_mermaid,
)


@pytest.mark.parametrize("phase", list(Phase))
@pytest.mark.parametrize("trigger", ANY_PHASE_TRIGGERS)
def test_every_phase_has_a_row_for_what_may_happen_in_any_phase(phase, trigger):
    assert (phase, trigger) in TRANSITIONS


@pytest.mark.parametrize("phase", [*GROUND_PHASES, *FLIGHT_PHASES, Phase.RECOGNISE])
def test_safety_rule_1_another_hand_suspends_every_phase_that_commands(phase):
    assert next_phase(phase, Trigger.PILOT_OVERRIDE) is Phase.SUSPENDED
    assert not set(RELEASED_PHASES) & set(COMMANDING_PHASES)
    assert Phase.LINK_LOST not in COMMANDING_PHASES


def test_safety_rule_1_only_a_hand_back_the_landing_or_an_unanswered_hold_leaves_suspended():
    left = {
        trigger: next_phase(Phase.SUSPENDED, trigger)
        for trigger in Trigger
        if next_phase(Phase.SUSPENDED, trigger) is not Phase.SUSPENDED
    }
    assert left == {
        Trigger.HANDED_BACK: Phase.RECOGNISE,
        Trigger.LANDED: Phase.DONE,
        Trigger.HOLD_UNANSWERED: Phase.LAST_RESORT,
        Trigger.OTHER_COMPANION: Phase.PASSIVE,
    }


@pytest.mark.parametrize("phase", [*END_PHASES, Phase.PASSIVE])
def test_nothing_leads_out_of_the_end_or_back_from_another_companion(phase):
    assert all(next_phase(phase, trigger) is phase for trigger in Trigger)


def test_a_foreign_mission_is_left_on_an_operators_word_at_the_landing_or_to_another_companion():
    foreign = Phase.FOREIGN_MISSION
    assert {t: next_phase(foreign, t) for t in Trigger if next_phase(foreign, t) is not foreign} == {
        Trigger.HANDED_BACK: Phase.RECOGNISE,
        Trigger.LANDED: Phase.DONE,
        Trigger.OTHER_COMPANION: Phase.PASSIVE,
    }


def test_only_an_authorisation_leads_to_arming():
    leads = {key for key, to in TRANSITIONS.items() if to is Phase.ARM and key[0] is not Phase.ARM}
    assert leads == {(Phase.READY, Trigger.AUTHORISED)}


def test_safety_rule_2_arming_lies_behind_the_read_back():
    to_ready = {key for key, to in TRANSITIONS.items() if to is Phase.READY and key[0] is not to}
    assert to_ready == {(Phase.READ_BACK, Trigger.READ_BACK_MATCHES)}


def test_every_phase_can_be_reached():
    reached, frontier = {Phase.IDENTIFY}, [Phase.IDENTIFY]
    while frontier:
        phase = frontier.pop()
        for trigger in Trigger:
            to = next_phase(phase, trigger, interrupted_phase=phase)
            if to not in reached:
                reached.add(to)
                frontier.append(to)
    assert reached == set(Phase)


@pytest.mark.parametrize("phase", OUTBOUND_PHASES)
def test_every_outward_phase_can_turn_home_divert_and_abort(phase):
    assert next_phase(phase, Trigger.RETURN_STARTED) is Phase.RETURN
    assert next_phase(phase, Trigger.RALLY_BOUND) is Phase.DIVERT
    assert next_phase(phase, Trigger.ABORT) is Phase.RETURN


@pytest.mark.parametrize("phase", [*GROUND_PHASES, *FLIGHT_PHASES])
def test_a_lull_of_the_link_gives_back_the_very_phase_it_took(phase):
    assert next_phase(phase, Trigger.LINK_SILENT) is Phase.LINK_LOST
    assert TRANSITIONS[Phase.LINK_LOST, Trigger.LINK_BACK_SHORT] == PREVIOUS_PHASE
    assert next_phase(Phase.LINK_LOST, Trigger.LINK_BACK_SHORT, interrupted_phase=phase) is phase


def test_the_drawn_tables_name_every_phase_and_every_changing_row():
    table, diagram = transitions_as_markdown(), transitions_as_mermaid()
    changing = [key for key, to in TRANSITIONS.items() if to is not key[0]]
    assert table.count("\n") + 1 == 2 + len(changing)
    assert all(phase.value in table for phase in Phase)
    assert diagram.startswith("stateDiagram-v2")
    assert "READY --> ARM: authorised" in diagram
