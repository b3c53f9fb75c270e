"""Safety rule 3 in the autopilot: a home that another hand moves in flight (fake vehicle)."""

import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import JumpTo, SaveCheckpoint, SetHome, SetMode
from companion.core.mission.events import Mode
from companion.core.pilot.checkpoint import checkpoint_from_dict
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import DEPOT, FLIGHT, World, start, world

DROP_M = FLIGHT.mission.drop_height_m
FLOWN = [Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER, Phase.RETURN]


def orders(w: World, kind: type) -> list:
    return [a for _, a in w.log if isinstance(a, kind)]


def lowest_away_from_the_depot(w: World) -> float:
    """The least height while it is over 50 m from where it lands."""
    least = w.height
    while w.pilot.phase is not Phase.DONE:
        w.step()
        if abs(w.north) > 50.0:
            least = min(least, w.height)
        assert w.t_s < 600.0
    return least


@pytest.mark.parametrize("phase", FLOWN)
@pytest.mark.parametrize("up", [-20.0, 25.0])
def test_safety_rule_3_a_home_that_is_moved_in_flight_is_set_back_and_the_vehicle_comes_home(
    phase, up
):
    w = world()
    w.until(phase)
    delivered = w.pilot.delivered
    for _ in range(20):
        w.step()
    w.home_up = up
    lowest = lowest_away_from_the_depot(w)
    assert lowest >= DROP_M - 1.0
    assert [a.alt_amsl_m for a in orders(w, SetHome)] == [pytest.approx(DEPOT[2], abs=0.01)]
    assert w.home_up == pytest.approx(0.0, abs=0.01)
    words = f"home moved {abs(up):.0f} m {'down' if up < 0 else 'up'}"
    assert words in w.said
    assert {"home_moved", "home_back"} <= set(w.kinds)
    assert w.pilot.delivered is delivered
    assert abs(w.north) < 3.0


def test_safety_rule_3_no_jump_is_ordered_while_the_home_is_in_doubt():
    w = world()
    w.until(Phase.OUTBOUND)
    w.takes_home = False
    w.home_up = 25.0
    moved_s = w.t_s
    w.run(lambda w: "home_moved" in w.kinds)
    for _ in range(50):
        w.step()
    assert not [a for t, a in w.log if isinstance(a, JumpTo) and t > moved_s]


def test_safety_rule_3_a_home_far_away_closes_the_gate_and_is_set_back():
    w = world()
    w.until(Phase.OUTBOUND)
    w.home_north = 3000.0
    done = w.to_the_end()
    assert done.outcome == "ABRT"
    assert "home moved 300" in w.said
    assert w.home_north == pytest.approx(0.0, abs=0.1)


def test_safety_rule_3_below_a_home_that_stays_low_it_comes_home_by_rtl():
    w = world()
    w.until(Phase.OUTBOUND)
    w.takes_home = False
    w.home_up = -20.0
    w.until(Phase.LAST_RESORT)
    assert orders(w, SetMode)[-1] == SetMode(Mode.RTL)
    assert "cannot set home back" in w.said


def test_safety_rule_3_under_a_home_that_stays_high_the_mission_aboard_brings_it_home():
    w = world()
    w.until(Phase.OUTBOUND)
    w.takes_home = False
    w.home_up = 25.0
    w.until(Phase.RETURN)
    assert w.to_the_end().outcome == "ABRT"
    assert SetMode(Mode.RTL) not in orders(w, SetMode)


def test_safety_rule_3_a_home_that_is_moved_again_is_not_fought_over():
    w = world()
    w.until(Phase.OUTBOUND)
    w.home_up = 25.0
    w.run(lambda w: "home_back" in w.kinds)
    for _ in range(60):
        w.step()
    w.home_up = 25.0
    w.to_the_end()
    assert len(orders(w, SetHome)) == 1
    assert "cannot set home back" in w.said


def test_safety_rule_3_a_home_that_was_moved_before_take_off_is_found_after_arming():
    w = world()
    w.until(Phase.UPLOAD)
    w.home_up = 12.0  # locked there: arming does not move it
    w.until(Phase.DONE)
    assert "home moved 12 m up" in w.said
    assert not w.pilot.delivered


def test_safety_rule_1_no_home_is_set_while_another_hand_has_the_vehicle():
    w = world()
    w.until(Phase.OUTBOUND)
    w.mode = Mode.OTHER
    w.tell(ev.VehicleState(w.t_s, Mode.OTHER, "POSCTL", w.armed))
    w.home_up = -20.0
    w.run(lambda w: "home_moved" in w.kinds, 5.0)
    for _ in range(100):
        w.step()
    assert not orders(w, SetHome)


def test_one_wild_height_is_no_home_that_moved():
    w = world()
    w.until(Phase.OUTBOUND)
    w.home_up = -20.0
    for _ in range(5):
        w.step()
    w.home_up = 0.0
    assert w.to_the_end().outcome == "SUC"
    assert "home_moved" not in w.kinds


def test_a_restart_in_flight_knows_the_home_of_take_off():
    w = world()
    w.until(Phase.OUTBOUND)
    w.step()
    kept = [a.content for _, a in w.log if isinstance(a, SaveCheckpoint)][-1]
    w.home_up = -20.0
    again = world(kept=checkpoint_from_dict(kept, "test"), armed=True)
    for name in ("north", "east", "height", "items", "index", "t_s", "mode", "home_up"):
        setattr(again, name, getattr(w, name))
    start(again)
    again.run(lambda a: "home_back" in a.kinds, 60.0)
    assert again.home_up == pytest.approx(0.0, abs=0.01)


def test_heights_are_above_the_ground_of_take_off_wherever_home_is():
    telemetry = TelemetryState()
    telemetry.measure_heights_from(12.0)
    telemetry.update(ev.Position(1.0, 55.0, 8.0, 52.0, 60.0, 0.0, 0.0, 0.0))
    assert telemetry.position is not None
    assert telemetry.position.height_rel_m == pytest.approx(40.0)
    assert telemetry.home_sunk_m == pytest.approx(20.0)


def test_what_the_wire_rounds_changes_no_height():
    telemetry = TelemetryState()
    telemetry.measure_heights_from(12.0004)
    telemetry.update(ev.Position(1.0, 55.0, 8.0, 52.001, 40.0, 0.0, 0.0, 0.0))
    assert telemetry.position is not None
    assert telemetry.position.height_rel_m == 40.0
