"""Every phase has one name; a flight file's spellings are mapped in one module."""

from typing import get_args

import pytest

from sim_bridge.app.faults.fault import PHASES
from sim_bridge.app.flight.scenario import PhaseInFile
from sim_bridge.app.world.flight_phase import FlightPhase, parse_file_phase, phase_in_air

PAD, CUSTOMER = (0.0, 0.0), (0.0, -300.0)


def test_flight_files_and_the_command_line_name_the_same_phases():
    assert [parse_file_phase(name) for name in get_args(PhaseInFile)] == [*map(FlightPhase, PHASES)]


PHASES_IN_AIR = (
    ((0.0, -5.0), 20.0, True, FlightPhase.CLIMB),
    ((0.0, -31.0), 30.0, True, FlightPhase.OUTBOUND),
    ((10.0, -290.0), 30.0, True, FlightPhase.DROP),
    ((10.0, -290.0), 30.0, False, FlightPhase.RETURN),
    ((0.0, -5.0), 25.0, False, FlightPhase.RETURN),
    ((0.0, -5.0), 15.0, False, FlightPhase.LAND),
)


@pytest.mark.parametrize(("ne_m", "up_m", "has_parcel", "phase"), PHASES_IN_AIR)
def test_the_phase_in_the_air_follows_from_place_height_and_parcel(ne_m, up_m, has_parcel, phase):
    sites = {"pad_ne_m": PAD, "customer_ne_m": CUSTOMER, "landing_ne_m": PAD}
    assert phase_in_air(ne_m, up_m, has_parcel=has_parcel, **sites) is phase  # type: ignore[arg-type]
