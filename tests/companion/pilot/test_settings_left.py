"""Settings that an earlier flight changed on the vehicle, and died before it put them back."""

from companion.core.mission import events as ev
from companion.core.mission.actions import Configure, Note
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.ground_sequence import SettingChange
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import World, world

OWN = {"LOW_ACT": 0.0}
CONFIGURES = PilotOptions(configure=True, authorise=True)
SETS_NOTHING = PilotOptions(configure=False, authorise=True)


def left(options: PilotOptions) -> World:
    """The vehicle still has what a flight had set, and we are told so on the ground."""
    w = world(options=options)
    w.values = {"LOW_ACT": 2.0}
    w.tell(ev.SettingsLeft(w.t_s, OWN))
    return w


def test_they_are_put_back_after_the_flight_although_this_one_changed_nothing():
    w = left(CONFIGURES)
    w.until(Phase.OUTBOUND)
    assert w.values == {"LOW_ACT": 2.0}
    w.to_the_end()
    assert w.values == OWN
    assert w.pilot.settings_before == {}


def test_they_are_put_back_where_there_is_no_take_off():
    w = left(PilotOptions(configure=True, authorise=True))
    w.takes_uploads = False
    w.to_the_end()
    assert w.values == OWN


def test_a_flight_that_may_set_nothing_says_that_they_stand_and_sets_nothing():
    w = left(SETS_NOTHING)
    w.to_the_end()
    assert not [a for _, a in w.log if isinstance(a, Configure)]
    assert "settings of an earlier flight stand" in w.said
    notes = [a.text for _, a in w.log if isinstance(a, Note)]
    assert any("LOW_ACT 0" in text for text in notes)
    assert any("companion restore" in text for text in notes)


def test_a_check_names_them_and_sets_nothing():
    w = left(PilotOptions(check_only=True))
    w.to_the_end()
    assert w.pilot.preflight().settings_left == OWN
    assert not [a for _, a in w.log if isinstance(a, Configure)]


def test_what_could_not_be_set_is_still_to_be_put_back():
    w = left(CONFIGURES)
    w.until(Phase.LAND)
    w.run(lambda w: bool(w.answers and isinstance(w.answers[0], ev.ParametersSet)))
    w.answers[0] = ev.ParametersSet(w.t_s, ("LOW_ACT",))
    w.to_the_end()
    assert w.pilot.settings_before == OWN


def test_every_setting_that_was_changed_is_told_with_the_vehicles_own_value_and_its_return():
    w = world(options=CONFIGURES)
    w.values = {"LOW_ACT": 0.0}
    w.until(Phase.OUTBOUND)
    set_to = w.values["LOW_ACT"]
    assert set_to != 0.0
    assert w.pilot.setting_changes == (SettingChange("LOW_ACT", 0.0, set_to, restored=False),)
    w.to_the_end()
    assert w.pilot.setting_changes == (SettingChange("LOW_ACT", 0.0, set_to, restored=True),)
    notes = [a.text for _, a in w.log if isinstance(a, Note)]
    assert "setting LOW_ACT: back to 0" in notes


def test_a_setting_that_an_earlier_flight_left_is_told_without_what_that_had_set():
    w = left(CONFIGURES)
    w.to_the_end()
    assert w.pilot.setting_changes == (SettingChange("LOW_ACT", 0.0, None, restored=True),)


def test_a_setting_that_the_autopilot_does_not_take_back_is_not_told_as_restored():
    w = left(CONFIGURES)
    w.until(Phase.LAND)
    w.run(lambda w: bool(w.answers and isinstance(w.answers[0], ev.ParametersSet)))
    w.answers[0] = ev.ParametersSet(w.t_s, ("LOW_ACT",))
    w.to_the_end()
    assert [change.restored for change in w.pilot.setting_changes] == [False]
