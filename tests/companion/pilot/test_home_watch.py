"""Safety rule 3: the autopilot's home is moved externally in flight (fake vehicle)."""

import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import JumpTo, SetHome, SetMode
from companion.core.mission.events import Mode
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import DEPOT, FLIGHT, World, start, world

DROP_M = FLIGHT.mission.drop_height_m
FLOWN = [Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER, Phase.RETURN]


def lowest_away_from_the_depot(w: World) -> float:
    """Return the least height while it is over 50 m from its landing position."""
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
    w = world().until(phase)
    delivered = w.pilot.is_delivered
    w.steps(20)
    w.home_up = up
    lowest = lowest_away_from_the_depot(w)
    assert lowest >= DROP_M - 1.0
    assert [a.alt_amsl_m for a in w.sent(SetHome)] == [pytest.approx(DEPOT[2], abs=0.01)]
    assert w.home_up == pytest.approx(0.0, abs=0.01)
    words = f"home moved {abs(up):.0f} m {'down' if up < 0 else 'up'}"
    assert words in w.said
    assert {"home_moved", "home_back"} <= set(w.kinds)
    assert w.pilot.is_delivered is delivered
    assert abs(w.north) < 3.0


def test_safety_rule_3_a_home_far_away_closes_the_gate_and_is_set_back():
    w = world().until(Phase.OUTBOUND)
    w.home_north = 3000.0
    done = w.to_the_end()
    assert done.outcome == "ABRT"
    assert "home moved 300" in w.said
    assert w.home_north == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("up", [-20.0, 25.0])
def test_safety_rule_3_under_a_home_that_stays_moved_it_comes_home_by_what_is_safe(up):
    """Home too low: return by RTL. Too high: the onboard mission only leads higher."""
    w = world().until(Phase.OUTBOUND)
    w.takes_home, w.home_up = False, up
    moved_s = w.t_s
    w.run(lambda w: "home_moved" in w.kinds)
    w.steps(50)
    assert not w.sent(JumpTo, moved_s), "no jump while the home is in doubt"
    if up < 0.0:
        w.until(Phase.LAST_RESORT)
        assert w.sent(SetMode)[-1] == SetMode(Mode.RTL)
        assert "autopilot does not restore home" in w.said
    else:
        w.until(Phase.RETURN)
        assert w.to_the_end().outcome == "ABRT"
        assert SetMode(Mode.RTL) not in w.sent(SetMode)


def test_safety_rule_3_a_home_that_is_moved_again_is_not_fought_over():
    w = world().until(Phase.OUTBOUND)
    w.home_up = 25.0
    w.run(lambda w: "home_back" in w.kinds)
    w.steps(60)
    w.home_up = 25.0
    w.to_the_end()
    assert len(w.sent(SetHome)) == 1
    assert "autopilot does not restore home" in w.said


def test_safety_rule_3_a_home_that_was_moved_before_take_off_is_found_after_arming():
    w = world().until(Phase.UPLOAD)
    w.home_up = 12.0  # arming does not move a locked home
    w.until(Phase.DONE)
    assert "home moved 12 m up" in w.said
    assert not w.pilot.is_delivered


def test_safety_rule_1_no_home_is_set_while_another_hand_has_the_vehicle():
    w = world().until(Phase.OUTBOUND)
    w.mode = Mode.OTHER
    w.tell(ev.VehicleState(w.t_s, Mode.OTHER, "POSCTL", w.armed))
    w.home_up = -20.0
    w.run(lambda w: "home_moved" in w.kinds, 5.0)
    w.steps(100)
    assert not w.sent(SetHome)


def test_one_wild_height_is_no_home_that_moved():
    w = world().until(Phase.OUTBOUND)
    w.home_up = -20.0
    w.steps(5)
    w.home_up = 0.0
    assert w.to_the_end().outcome == "SUC"
    assert "home_moved" not in w.kinds


def test_a_restart_in_flight_knows_the_home_of_take_off():
    w = world().until(Phase.OUTBOUND)
    w.step()
    kept = w.last_kept
    w.home_up = -20.0
    again = w.with_pilot_of(world(kept=kept, armed=True), "home_up")
    start(again)
    again.run(lambda a: "home_back" in a.kinds, 60.0)
    assert again.home_up == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("ground_m", "told_amsl_m", "told_rel_m", "sunk_m"),
    [(12.0, 52.0, 60.0, 20.0), (12.0004, 52.001, 40.0, 0.0)],  # moved; within wire rounding
)
def test_heights_are_above_the_ground_of_take_off_wherever_home_is(
    ground_m, told_amsl_m, told_rel_m, sunk_m
):
    telemetry = TelemetryState()
    telemetry.set_height_reference(ground_m)
    telemetry.store_event(ev.Position(1.0, 55.0, 8.0, told_amsl_m, told_rel_m, 0.0, 0.0, 0.0))
    assert telemetry.position is not None
    assert telemetry.position.height_rel_m == 40.0
    assert telemetry.home_below_ground_m == sunk_m


def test_a_home_that_px4_moves_to_the_landing_position_is_no_other_stations():
    w = world()
    w.disarms = False  # it stays in its landing phase while the home is reported
    w.run(lambda w: w.pilot.phase is Phase.LAND and w.height < 0.3)
    w.home_north, w.home_east = 300.0, 50.0
    w.steps(80)
    assert w.pilot.phase is Phase.LAND
    assert "home_moved" not in w.kinds
