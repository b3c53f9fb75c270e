"""Identifiable flight phases: synthetic energies with known ratios and scatter."""

import numpy as np
import pytest

from companion.analysis.measured_energy.identified_phases import (
    fit_phase_power_ratios,
)
from companion.analysis.measured_energy.track_power import PhaseEnergy


def flights(fracs, scatter, modelled=(3.0, 12.0, 4.0), count=6):
    """Each flight's factor is `scatter` above or below: its standard deviation."""
    rows = []
    for number in range(count):
        factor = 1.0 + (scatter if number % 2 else -scatter)
        modelled_wh = np.array(modelled)
        rows.append(PhaseEnergy(factor * np.array(fracs) * modelled_wh, modelled_wh))
    return rows


def test_the_ratios_come_back_with_their_standard_error():
    found = fit_phase_power_ratios(flights((1.1, 1.02, 0.9), 0.04))
    assert found.table is not None
    table = found.table
    assert (table.climb_frac, table.level_frac, table.descent_frac) == pytest.approx(
        (1.1, 1.02, 0.9)
    )
    # Six factors of +-0.04 have a sample std of 0.04 sqrt(6/5); their mean's is that / sqrt(6).
    assert found.quantities[1].std == pytest.approx(1.02 * 0.04 / np.sqrt(5.0), rel=1e-3)
    assert all(q.is_identifiable for q in found.quantities)


def test_a_phase_that_was_not_flown_is_priced_as_level_flight_and_the_flight_is_named():
    found = fit_phase_power_ratios(flights((1.1, 1.02, 0.9), 0.01, modelled=(3.0, 12.0, 0.1)))
    assert found.table is not None
    assert found.table.descent_frac == found.table.level_frac == pytest.approx(1.02)
    descent = found.quantities[2]
    assert not descent.is_identifiable
    assert "come down" in descent.flight


def test_two_flights_scattered_flights_or_another_vehicle_identify_nothing():
    assert fit_phase_power_ratios(flights((1.1, 1.02, 0.9), 0.01, count=2)).table is None
    assert fit_phase_power_ratios(flights((1.1, 1.02, 0.9), 0.3)).table is None
    assert fit_phase_power_ratios(flights((1.1, 2.4, 0.9), 0.01)).table is None
    assert fit_phase_power_ratios([]).table is None
