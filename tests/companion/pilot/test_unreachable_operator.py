"""No take-off if neither a ground station nor a desk is connected."""

from companion.core.mission import events as ev
from companion.core.mission.actions import Arm
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import World, world

BY_COMMAND_LINE = PilotOptions(configure=True, authorise=True)
ALONE = PilotOptions(configure=True, authorise=True, without_operator=True)


def unheard(options: PilotOptions = BY_COMMAND_LINE) -> World:
    w = world(options=options)
    w.station = False
    return w


def armed(w: World) -> bool:
    return any(isinstance(action, Arm) for _, action in w.log)


def test_without_a_ground_station_an_authorised_flight_does_not_take_off():
    w = unheard()
    done = w.to_the_end()
    assert (done.outcome, done.delivered) == ("ABRT", False)
    assert "no ground station or desk reaches this companion" in done.reason
    assert "waiting: no ground station" in w.said
    assert not armed(w)


def test_it_takes_off_once_a_ground_station_is_received():
    w = unheard()
    w.until(Phase.READY)
    w.steps(300)
    assert not armed(w)
    w.station = True
    assert w.to_the_end().outcome == "SUC"


def test_a_ground_station_that_fell_silent_before_take_off_does_not_count():
    w = world(options=PilotOptions(configure=True)).until(Phase.UPLOAD)
    w.station = False
    w.until(Phase.READY)
    w.steps(110)
    assert "operator" in [finding.name for finding in w.pilot.preflight_report().findings]


def test_the_order_of_an_operator_shows_that_one_is_there():
    w = world(options=PilotOptions(configure=True))
    w.station = False
    w.until(Phase.READY)
    w.tell(ev.MissionAuthorised(w.t_s, "255/190"))
    assert w.to_the_end().outcome == "SUC"


def test_an_operator_may_state_that_nobody_is_to_be_reached():
    assert unheard(ALONE).to_the_end().outcome == "SUC"


def test_in_flight_a_ground_station_that_is_lost_changes_nothing():
    w = world().until(Phase.OUTBOUND)
    w.station = False
    assert w.to_the_end().outcome == "SUC"
