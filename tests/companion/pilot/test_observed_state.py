"""Mission state, fall, landing and height: one report alone decides nothing."""

import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import (
    AlertReport,
    ContinueMission,
    Disarm,
    JumpTo,
    SetMode,
)
from companion.core.mission.alerts import Alert
from companion.core.mission.events import MissionState, Mode
from companion.core.pilot.observed_state import HEIGHT_LIMIT_M, ObservedState
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import World, world


def alerts(w: World) -> list[Alert]:
    return [report.alert for report in w.sent(AlertReport)]


@pytest.mark.parametrize("phase", [Phase.OUTBOUND, Phase.RETURN])
def test_a_paused_mission_is_a_takeover_and_a_hand_back_continues_it(phase):
    w = world().until(phase)
    fly, paused_s = w.fly, w.t_s
    w.mission_state, w.fly = MissionState.PAUSED, lambda dt_s: None  # type: ignore[method-assign]
    w.until(Phase.SUSPENDED, 1.0)
    w.steps(400)
    assert not w.orders_after(paused_s + 1.0)
    w.tell(ev.ControlHandedBack(w.t_s, "operator"))
    w.run(lambda w: w.sent(ContinueMission), 10.0)
    w.mission_state, w.fly = MissionState.ACTIVE, fly  # type: ignore[method-assign]
    assert w.to_the_end().outcome == "SUC"
    assert len(w.sent(ContinueMission)) == 1
    assert not [o for o in w.orders_after(paused_s) if isinstance(o, SetMode)]


def test_one_report_of_a_pause_is_no_takeover():
    w = world().until(Phase.RETURN)
    w.mission_state = MissionState.PAUSED
    w.step()
    w.mission_state = MissionState.ACTIVE
    assert w.to_the_end().outcome == "SUC"


@pytest.mark.parametrize(
    ("phase", "then"),
    [(Phase.OUTBOUND, Phase.SUSPENDED), (Phase.LAND, Phase.LAST_RESORT)],
)
def test_a_mission_that_is_complete_in_the_air_was_ended_by_a_person_or_needs_a_return(phase, then):
    w = world().until(phase)
    assert w.height > 10.0
    w.mission_state, w.fly = MissionState.COMPLETE, lambda dt_s: None  # type: ignore[method-assign]
    w.until(then, 1.0)


def test_a_jump_does_not_hide_that_a_person_ended_the_mission():
    """Its order is withheld after one report of the end; one on its way stops ArduCopter."""
    w = world().until(Phase.OUTBOUND)
    w.mission_state, w.fly = MissionState.NOT_STARTED, lambda dt_s: None  # type: ignore[method-assign]
    orders, end = w.sent((JumpTo, SetMode)), MissionState.COMPLETE
    w.tell(ev.MissionProgress(w.t_s, w.index, len(w.items), None, w.mission_id, end))
    w.tell(ev.AbortOrdered(w.t_s, "255/190"))
    w.until(Phase.SUSPENDED, 1.0)
    w.steps(400)
    assert w.sent((JumpTo, SetMode)) == orders


@pytest.mark.parametrize(
    ("thrust_frac", "detects", "orders"),
    [(0.45, True, 0), (0.1, True, 1), (None, True, 1), (0.1, False, 1), (0.45, False, 0)],
)
def test_a_disarm_needs_two_witnesses_of_the_ground(thrust_frac, detects, orders):
    """At rest near the ground: the landing detector and the thrust may each be wrong."""
    w = world()
    w.disarms = False
    w.run(lambda w: w.pilot.phase is Phase.LAND and w.height < 0.3)
    w.thrust_frac = thrust_frac
    if not detects:
        w.mute.add(ev.GroundState)
        w.run(lambda w, since_s=w.t_s: w.t_s > since_s + 2.0)
    w.run(lambda w, since_s=w.t_s: w.t_s > since_s + 25.0)
    assert bool(w.sent(Disarm)) is bool(orders)


def test_a_landing_detector_that_is_wrong_in_the_air_orders_no_disarm():
    w = world().until(Phase.LAND)
    w.disarms, w.thrust_frac, w.height = False, 0.45, 20.0
    fly = w.fly
    w.fly = lambda dt_s: None  # type: ignore[method-assign]
    w.mute.add(ev.GroundState)
    for _ in range(300):
        w.step()
        w.tell(ev.GroundState(w.t_s, ev.VehicleLandedState.ON_GROUND))
    assert not w.sent(Disarm)
    w.fly = fly  # type: ignore[method-assign]


def positions(*, acceleration_mps2: float, sinks: bool) -> list[ev.Position]:
    found, alt_m, speed_mps = [], 50.0, 0.0
    for k in range(12):
        found.append(ev.Position(0.1 * k, 55.0, 8.0, alt_m, alt_m, 0.0, 0.0, speed_mps))
        new_mps = speed_mps + 0.1 * acceleration_mps2
        alt_m -= 0.05 * (speed_mps + new_mps) if sinks else 0.0
        speed_mps = new_mps
    return found


@pytest.mark.parametrize(
    ("acceleration_mps2", "sinks", "falls"),
    [(9.8, True, True), (3.0, True, False), (9.8, False, False)],
)
def test_a_fall_needs_acceleration_and_a_height_that_falls_with_it(acceleration_mps2, sinks, falls):
    observed = ObservedState()
    for position in positions(acceleration_mps2=acceleration_mps2, sinks=sinks):
        observed.store_event(position, Mode.MISSION, is_armed=True)
    assert (observed.fall_s is not None) is falls


def test_a_fall_is_reported_and_the_flight_did_not_come_home():
    """The motors stop at 20 m over the pad; the autopilot disarms after the impact."""
    w = world().run(lambda w: w.pilot.phase is Phase.LAND and w.height <= 20.0)
    sink_mps = 0.0

    def fall(dt_s: float) -> None:
        nonlocal sink_mps
        before_mps, sink_mps = sink_mps, sink_mps + 9.8 * dt_s if w.height > 0.0 else 0.0
        w.height = max(0.0, w.height - 0.5 * (before_mps + sink_mps) * dt_s)
        w.velocity = (0.0, 0.0, sink_mps)
        w.armed = w.armed and (w.height > 0.0 or w.t_s < stopped_s + 8.0)

    stopped_s, w.fly = w.t_s, fall  # type: ignore[method-assign]
    w.run(lambda w: Alert.FALLING in alerts(w), 1.0)
    assert w.to_the_end().outcome == "DEL"


@pytest.mark.parametrize(
    ("error_m", "alert"),
    [(0.0, Alert.DELIVERED), (4.0, Alert.RELEASED_IN_DOUBT), (HEIGHT_LIMIT_M + 2.0, None)],
)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_no_parcel_is_released_where_the_two_heights_differ(error_m, sign, alert):
    w = world()
    w.gnss_up_m = 12.0  # a constant difference is none
    w.until(Phase.MEASURE)
    w.gnss_up_m += sign * error_m
    finished = w.to_the_end()
    assert finished.delivered is (alert is not None)
    releases = [one for one in alerts(w) if one in (Alert.DELIVERED, Alert.RELEASED_IN_DOUBT)]
    assert releases == ([] if alert is None else [alert])
    assert (Alert.HEIGHT_DOUBT in alerts(w)) is (alert is None)
    assert finished.home
    assert list(w.sent(JumpTo))
