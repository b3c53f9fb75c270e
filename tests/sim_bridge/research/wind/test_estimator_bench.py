"""The wind estimator measured: a real anemometer flight, PX4's drag fusion, and the bound."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe, airframe_from_dict
from sim_bridge.research.wind.anemometer_flight import (
    AirspeedError,
    AnemometerFlight,
    read_recording,
    replayed,
    score,
    with_airspeed,
    without_airspeed,
)
from sim_bridge.research.wind.envelope_flight import Condition, drag_deviates, fly_envelope
from sim_bridge.research.wind.envelope_score import judged, nees_band95, rmse_mps
from sim_bridge.research.wind.px4_drag_fusion import DragFusionParams, drag_fusion
from sim_bridge.research.wind.wind_bound import least_errors_m2ps2
from sim_bridge.truth.params import load_airframe

ROOT = Path(__file__).parents[4]
FLIGHT = ROOT.parent / "shared" / "data" / "estimator" / "anemometer_uav_5hz.csv"


def believed(name: str) -> Airframe:
    return airframe_from_dict(
        tomllib.loads((ROOT / "params" / "airframes" / f"{name}.toml").read_text())
    )


@pytest.fixture(scope="module")
def recording() -> AnemometerFlight:
    if not FLIGHT.exists():
        pytest.skip(f"{FLIGHT} is not here")
    return read_recording(FLIGHT, believed("generic").mass.empty_kg)


def test_tilt_alone_finds_the_wind_of_a_real_vehicle_that_nobody_calibrated(
    recording: AnemometerFlight,
) -> None:
    # The goal: at most 1.6 m/s, 0.2 under PX4's drag fusion with its default coefficients on the
    # same rows, mean NEES between 1 and 3.
    ours = score(recording, replayed(believed("generic"), without_airspeed(recording)))
    seen = recording.observations
    means, _ = drag_fusion(
        recording.t_s,
        np.array([o.vel_ned_mps for o in seen]),
        np.array([[o.roll_rad, o.pitch_rad, o.yaw_rad] for o in seen], dtype=float),
        np.array([o.airborne for o in seen]),
        1.09,
        DragFusionParams(fusions_per_s=15.0),
    )
    error = (means - recording.reference_ne_mps)[recording.is_judged]
    px4_mps = math.sqrt(float(np.mean(np.sum(error**2, axis=1))))
    assert ours.rmse_mps <= 1.6
    assert ours.rmse_mps <= px4_mps - 0.2
    assert 1.0 <= ours.nees <= 3.0


@pytest.mark.parametrize(("scale", "bias_mps"), [(1.0, 0.0), (1.06, 0.3), (0.92, -0.3)])
def test_a_scalar_airspeed_of_unknown_scale_and_bias_helps(
    recording: AnemometerFlight, scale: float, bias_mps: float
) -> None:
    # The goal: at most 1.1 m/s, mean NEES between 1 and 3.
    error = AirspeedError(scale, bias_mps, noise_std_mps=0.3, seed=5)
    ours = score(recording, replayed(believed("generic"), with_airspeed(recording, error)))
    assert ours.rmse_mps <= 1.1
    assert 1.0 <= ours.nees <= 3.0


def test_a_flight_without_a_column_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "cut.csv"
    path.write_text("t_s,vel_n_mps\n0.0,1.0\n")
    with pytest.raises(LeewayError, match="row 2: vel_e_mps"):
        read_recording(path, 3.5)


def test_px4s_drag_fusion_finds_the_wind_that_its_coefficients_explain() -> None:
    # Level hover in 6 m/s from the south: specific force by the very formula, without noise.
    t_s = np.arange(0.0, 120.0, 0.2)
    wind, density = 6.0, 1.225
    force = (0.5 * density * wind / 100.0 + 0.15) * wind  # pushed north, held by leaning south
    pitch = math.atan(force / 9.80665)
    attitude = np.tile([0.0, pitch, 0.0], (len(t_s), 1))
    means, covs = drag_fusion(
        t_s, np.zeros((len(t_s), 3)), attitude, np.ones(len(t_s), dtype=bool), density
    )
    np.testing.assert_allclose(means[-1], (wind, 0.0), atol=0.35)
    assert np.linalg.eigvalsh(covs[-1])[0] > 0.0


@pytest.mark.night
def test_in_gusts_the_estimator_is_near_the_bound_and_not_below_it() -> None:
    """A small sample; `sim-bridge estimator-bench` flies the whole envelope."""
    truth = load_airframe(ROOT / "params" / "truth" / "m100.toml")
    condition = Condition(10.0, 12.0)
    flown = [fly_envelope(truth, condition, np.random.default_rng([31, i])) for i in range(3)]
    errors = [judged(flight, believed("m100")) for flight in flown]
    rng = np.random.default_rng(31)
    least = least_errors_m2ps2(flown, errors[0].t_s[0], errors[0].t_s[-1], rng)
    least_mps = math.sqrt(float(least[:, 1].mean()))
    # Three flights scatter: twice the bound would be another filter, and 0.7 of it a wrong bound.
    assert 0.7 * least_mps < rmse_mps(errors) < 2.0 * least_mps
    low, high = nees_band95(len(errors))
    assert low < np.mean([e.nees.mean() for e in errors]) < high
    # What nobody can foresee of the 5 s to come, were all else known: a lower bound's lower bound.
    # Gusts along the wind, MIL-F-8785C at 30 m in 12 m/s: 2.06 m/s, 152 m; flown at 10 m/s.
    sigma, memory_s = 2.06, 152.0 / 10.0
    a = 5.0 / memory_s
    share = 2.0 / a**2 * (a - 2.0 * (1.0 - math.exp(-a)) + 0.5 * (1.0 - math.exp(-2.0 * a)))
    assert least_mps**2 > 0.25 * sigma**2 * share


def test_a_conditions_drags_fill_the_prior_evenly() -> None:
    # One in each sixteenth of the normal distribution, on each axis, and another order on each.
    drawn = drag_deviates(16, np.random.default_rng(5))
    sixteenths = np.floor(16.0 * norm.cdf(drawn)).astype(int)
    assert np.array_equal(np.sort(sixteenths, axis=0), np.tile(np.arange(16)[:, None], 3))
    assert not np.array_equal(sixteenths[:, 0], sixteenths[:, 1])
    truth = load_airframe(ROOT / "params" / "truth" / "m100.toml")
    for row in (np.zeros(3), np.array([2.0, -1.0, 1.0])):  # log gains: 0, 0; 0.07, 0.13
        flight = fly_envelope(truth, Condition(None, 0.0), np.random.default_rng(1), row)
        drag = flight.params.drag
        forward = math.log(drag.parasite_forward_m2 / truth.drag.parasite_forward_m2)
        right = math.log(drag.rotor_sideways_nspm / truth.drag.rotor_sideways_nspm)
        assert forward == pytest.approx(0.05 * row[0] + 0.03 * row[1])
        assert right == pytest.approx(0.05 * row[0] + 0.03 * row[2])
