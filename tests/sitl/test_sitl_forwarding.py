"""A PX4 board that does not forward between its links: the factory setting."""

import pytest

pytestmark = pytest.mark.sitl


@pytest.mark.sample
@pytest.mark.parametrize(
    ("arguments", "flies"), [(("--authorise",), False), (("--authorise", "--no-operator"), True)]
)
def test_where_no_ground_station_reaches_the_companion_it_takes_off_only_if_told_so(
    fly_case, arguments, flies
):
    flown = fly_case("px4", settings={"MAV_0_FORWARD": 0.0}, companion_arguments=arguments)
    assert flown.row["delivered"] is flies
    assert ("take_off" in flown.kinds) is flies
    assert not flown.craft.operator.accepted
    log = (flown.run_dir / "companion.log").read_text()
    assert "MAV_0_FORWARD is 0, set 1, reboot" in log
    assert ("no ground station or desk reaches this companion" in log) is not flies


@pytest.mark.sample
def test_a_companion_whose_link_does_not_forward_states_it_before_take_off(fly_case):
    flown = fly_case("px4", settings={"MAV_1_FORWARD": 0.0})
    assert (
        flown.craft.operator.received_texts == []
    )  # no companion message reached the ground station
    assert (
        "pre-flight: WARNING: messages forwarded" in (flown.run_dir / "companion.log").read_text()
    )
