"""Losses per flight hour that the operator accepts, over the planned flight's time."""

import msgspec
import pytest

from companion.core.base.errors import LeewayError
from companion.core.mission.actions import LogNote
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import FLIGHT, World, world


def planned(rate_in_file: float | None, rate_asked: float | None = None) -> World:
    mission = msgspec.structs.replace(FLIGHT.mission, max_loss_per_hour=rate_in_file)
    options = PilotOptions(configure=True, authorise=True, max_loss_per_hour=rate_asked)
    made = world(options=options, flight=msgspec.structs.replace(FLIGHT, mission=mission))
    made.until(Phase.CLIMB)
    return made


def hours(made: World) -> float:
    assert made.pilot.flight_plan is not None
    return made.pilot.flight_plan.plan.time_s / 3600.0


def test_a_rate_bounds_the_flights_loss_by_its_planned_hours_and_is_said():
    made = planned(1e-3)
    assert made.judge.limits.max_loss == pytest.approx(1e-3 * hours(made))
    assert made.judge.limits.reserve_frac == FLIGHT.mission.reserve_frac
    notes = [a.text for _, a in made.log if isinstance(a, LogNote)]
    assert any("0.001 per flight hour" in words for words in notes)


def test_the_command_line_goes_before_the_flight_file():
    assert planned(1e-3, 1e-2).judge.limits.max_loss == pytest.approx(1e-2 * hours(planned(1e-3)))


def test_a_rate_never_loosens_the_flights_own_bound_and_none_changes_nothing():
    for rate in (None, 1.0):
        assert planned(rate).judge.limits.max_loss == FLIGHT.mission.max_loss
    assert planned(1e-6).judge.limits.max_loss == 1e-6


@pytest.mark.parametrize("rate", [0.0, 1.5, -1e-3])
def test_a_rate_that_is_none_is_refused_by_its_key(rate):
    with pytest.raises(LeewayError, match=r"mission\.max_loss_per_hour"):
        msgspec.structs.replace(FLIGHT.mission, max_loss_per_hour=rate).__post_init__()
