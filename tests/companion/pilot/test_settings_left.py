"""Settings that an earlier flight changed on the vehicle and did not restore."""

import pytest

from companion.app.flight.run import report_vehicle_state_at_stop
from companion.core.mission import events as ev
from companion.core.mission.actions import AlertReport, LogNote, SetParameters
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.ground.autopilot_settings import SettingChange
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import World, world

OWN = {"LOW_ACT": 0.0}
CONFIGURES = PilotOptions(configure=True, authorise=True)
SETS_NOTHING = PilotOptions(configure=False, authorise=True)


def left(options: PilotOptions) -> World:
    """Return a vehicle with a flight's settings, reported to the pilot on the ground."""
    w = world(options=options)
    w.values = {"LOW_ACT": 2.0}
    w.tell(ev.UnrestoredSettings(w.t_s, OWN))
    return w


def test_they_are_put_back_after_the_flight_although_this_one_changed_nothing():
    w = left(CONFIGURES)
    w.until(Phase.OUTBOUND)
    assert w.values == {"LOW_ACT": 2.0}
    w.to_the_end()
    assert w.values == OWN
    assert w.pilot.settings.original_values_to_restore == {}


def test_they_are_put_back_where_there_is_no_take_off():
    w = left(PilotOptions(configure=True, authorise=True))
    w.takes_uploads = False
    w.to_the_end()
    assert w.values == OWN


def test_a_flight_that_may_set_nothing_says_that_they_stand_and_sets_nothing():
    w = left(SETS_NOTHING)
    w.to_the_end()
    assert not w.sent(SetParameters)
    assert "settings of an earlier flight" in w.said
    notes = [a.text for _, a in w.log if isinstance(a, LogNote)]
    assert any("LOW_ACT 0" in text for text in notes)
    assert any("companion restore" in text for text in notes)


def test_a_check_names_them_and_sets_nothing():
    w = left(PilotOptions(check_only=True))
    w.to_the_end()
    assert w.pilot.preflight_report().unrestored_settings == OWN
    assert not w.sent(SetParameters)


def test_what_could_not_be_set_is_still_to_be_put_back():
    w = left(CONFIGURES)
    w.until(Phase.LAND)
    w.run(lambda w: bool(w.answers and isinstance(w.answers[0], ev.ParametersSet)))
    w.answers[0] = ev.ParametersSet(w.t_s, ("LOW_ACT",))
    w.to_the_end()
    assert w.pilot.settings.original_values_to_restore == OWN


def test_every_setting_that_was_changed_is_told_with_the_vehicles_own_value_and_its_return():
    w = world(options=CONFIGURES)
    w.values = {"LOW_ACT": 0.0}
    w.until(Phase.OUTBOUND)
    set_to = w.values["LOW_ACT"]
    assert set_to != 0.0
    assert w.pilot.settings.setting_changes == (
        SettingChange("LOW_ACT", 0.0, set_to, restored=False),
    )
    w.to_the_end()
    assert w.pilot.settings.setting_changes == (
        SettingChange("LOW_ACT", 0.0, set_to, restored=True),
    )
    notes = [a.text for _, a in w.log if isinstance(a, LogNote)]
    assert "setting LOW_ACT: restored to 0" in notes


def test_a_setting_that_an_earlier_flight_left_is_told_without_what_that_had_set():
    w = left(CONFIGURES)
    w.to_the_end()
    assert w.pilot.settings.setting_changes == (SettingChange("LOW_ACT", 0.0, None, restored=True),)


def test_a_setting_that_the_autopilot_does_not_take_back_is_not_told_as_restored():
    w = left(CONFIGURES)
    w.until(Phase.LAND)
    w.run(lambda w: bool(w.answers and isinstance(w.answers[0], ev.ParametersSet)))
    w.answers[0] = ev.ParametersSet(w.t_s, ("LOW_ACT",))
    w.to_the_end()
    assert [change.restored for change in w.pilot.settings.setting_changes] == [False]


@pytest.mark.parametrize(
    ("phase", "text"),
    [
        (Phase.READY, "companion stopped: on the ground, disarmed"),
        (Phase.LAND, "companion stopped: on the ground, STILL ARMED"),
        (Phase.OUTBOUND, "companion stopped: vehicle stays in mission"),
    ],
)
def test_a_companion_that_is_stopped_reports_vehicle_and_settings(phase, text):
    w = left(PilotOptions(configure=True, authorise=phase is not Phase.READY))
    w.disarms = False
    w.until(phase)
    w.run(lambda w: phase is not Phase.LAND or "landed, still armed: disarm manually" in w.said)
    reports = []
    report_vehicle_state_at_stop(
        w.pilot, lambda alert, **values: reports.append(AlertReport(alert, values).text)
    )
    assert reports == [text, "settings not restored: companion stopped"]
