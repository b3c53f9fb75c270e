"""The row of a flight that the companion judges from its own record."""

from typing import Any

import pytest

from sim_bridge.app.flight.own_record import flight_row_from_companion_result

TOOK_OFF_S, LANDED_S = 10.0, 100.0
NORTH_MPS, EAST_MPS = -1.0, 4.0


def estimate(t_s: float, n: float, e: float) -> dict[str, float]:
    covariance = {"nn_m2ps2": 0.25, "ne_m2ps2": 0.0, "ee_m2ps2": 1.0}
    return {"t_s": t_s, "to_n_mps": n, "to_e_mps": e} | covariance


def row(*wind: dict[str, float], **options: Any) -> dict[str, Any]:
    times = {"take_off": TOOK_OFF_S, "landed": LANDED_S}
    decisions = [{"kind": kind, "t_s": t_s, "reason": ""} for kind, t_s in times.items()]
    result = {"decisions": decisions, "wind": list(wind)}
    return flight_row_from_companion_result(
        result, vehicle="m100-1", autopilot="px4", run="run", **options
    )


def test_a_wind_that_was_set_judges_the_estimate_from_30_s_of_flight_to_the_landing():
    """Closed form: 1 m/s off north at 0.5 m/s stated, 2 m/s off east at 1 m/s: 4 + 4."""
    wrong = estimate(50.0, NORTH_MPS + 1.0, EAST_MPS - 2.0)
    early, late = estimate(39.0, 90.0, 90.0), estimate(101.0, 90.0, 90.0)
    seen = row(early, wrong, late, steady_wind_to_ne_mps=(NORTH_MPS, EAST_MPS))
    assert seen["wind_rmse_mps"] == pytest.approx(5.0**0.5, abs=1e-3)
    assert seen["wind_nees"] == pytest.approx(8.0)


def test_a_wind_that_nobody_knows_judges_nothing():
    seen = row(estimate(50.0, 0.0, 0.0))
    assert seen["wind_rmse_mps"] is None
    assert seen["wind_nees"] is None
    assert row(steady_wind_to_ne_mps=(1.0, 1.0))["wind_nees"] is None
