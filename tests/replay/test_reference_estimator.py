"""The reference estimator: a plain EKF on filterpy, against closed forms and a synthetic flight."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.adapters.files.params import read_airframe
from companion.analysis.replay.reference_estimator import ReferenceEstimator, ReferenceParams
from companion.app.cli.main import app
from companion.core.base.errors import LeewayError
from companion.core.vehicle.power import GRAVITY_MPS2
from companion.core.wind.observation import WindObservation

ROOT = Path(__file__).parents[2]
M100 = read_airframe("m100")
MASS_KG = M100.flying_mass_kg(0.0)
ANEMOMETER = ROOT.parent / "shared/data/estimator/anemometer_uav_5hz.csv"


def leaning(t_s, yaw_rad, ground_ne_mps, wind_ne_mps):
    """Return steady level flight, with the tilt that balances the airframe's drag in this wind."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    air_n, air_e = np.subtract(ground_ne_mps, wind_ne_mps)
    forward, right = cos * air_n + sin * air_e, cos * air_e - sin * air_n
    speed = math.hypot(forward, right)
    k, q = (
        M100.linear_drag_forward_right_n_per_mps(MASS_KG, 1.225),
        M100.quadratic_drag_forward_right_n_per_mps2(MASS_KG, 1.225),
    )
    drag_f = (k[0] + q[0] * speed) * forward / MASS_KG
    drag_r = (k[1] + q[1] * speed) * right / MASS_KG
    pitch = -math.atan(drag_f / GRAVITY_MPS2)
    return WindObservation(
        t_s=t_s,
        airborne=True,
        mass_kg=MASS_KG,
        vel_ned_mps=(*ground_ne_mps, 0.0),
        roll_rad=math.atan(drag_r / GRAVITY_MPS2 * math.cos(pitch)),
        pitch_rad=pitch,
        yaw_rad=yaw_rad,
    )


@pytest.mark.parametrize("wind", [(0.0, 0.0), (6.0, -3.0), (-2.0, 11.0)])
@pytest.mark.parametrize("ground", [(0.0, 0.0), (9.0, 4.0)])
def test_a_steady_wind_is_found_from_the_tilt_that_balances_it(wind, ground):
    estimator = ReferenceEstimator(M100)
    for k in range(600):
        estimator.update(leaning(0.1 * k, 0.8, ground, wind))
    belief = estimator.belief(60.0)
    np.testing.assert_allclose(belief.mean_to_ne_mps, wind, atol=0.05)
    assert belief.valid
    assert belief.sources == ("tilt",)
    assert np.linalg.eigvalsh(belief.cov_ne_m2ps2)[0] > 0.0


def test_the_variance_is_that_of_the_riccati_equation():
    # A wind vector received at a steady rate and a random walk: P before a correction solves P^2 /
    # (P + R) = Q (the scalar algebraic Riccati equation; Bar-Shalom et al. 2001, 5.2.5).
    params = ReferenceParams()
    estimator = ReferenceEstimator(M100, params)
    for k in range(4000):
        estimator.update(
            WindObservation(0.5 * k, False, MASS_KG, autopilot_wind_to_ne_mps=(3.0, 4.0))
        )
    q = params.wind_diffusion_m2ps3 * 0.5
    r = 2.0 * params.autopilot_memory_s * params.autopilot_std_mps**2 / 0.5
    before = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
    after = before * r / (before + r)
    belief = estimator.belief(0.5 * 3999)
    np.testing.assert_allclose(belief.cov_ne_m2ps2, after * np.eye(2), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(belief.mean_to_ne_mps, (3.0, 4.0), atol=1e-3)


def test_waiting_adds_the_random_walk_and_nothing_else():
    params = ReferenceParams()
    estimator = ReferenceEstimator(M100, params)
    for k in range(100):
        estimator.update(leaning(0.1 * k, 0.0, (0.0, 0.0), (5.0, 0.0)))
    now, later = estimator.belief(9.9), estimator.belief(19.9)
    np.testing.assert_array_equal(later.mean_to_ne_mps, now.mean_to_ne_mps)
    added = later.cov_ne_m2ps2 - now.cov_ne_m2ps2
    np.testing.assert_allclose(added, params.wind_diffusion_m2ps3 * 10.0 * np.eye(2), atol=1e-9)
    assert not estimator.belief(9.9 + params.stale_after_s + 1.0).valid


@pytest.mark.parametrize("kind", ["forward", "magnitude", "both axes"])
def test_an_airspeed_is_taken_as_it_reads(kind):
    wind, ground, yaw = (4.0, -2.0), (8.0, 0.0), 0.3
    cos, sin = math.cos(yaw), math.sin(yaw)
    air_n, air_e = np.subtract(ground, wind)
    forward, right = cos * air_n + sin * air_e, cos * air_e - sin * air_n
    heard = {
        "forward": {"airspeed_mps": forward},
        "magnitude": {"airspeed_mps": math.hypot(forward, right), "airspeed_is_magnitude": True},
        "both axes": {"airspeed_fr_mps": (forward, right)},
    }[kind]
    with_it, without = ReferenceEstimator(M100), ReferenceEstimator(M100)
    for k in range(400):
        seen = leaning(0.1 * k, yaw, ground, wind)
        without.update(seen)
        with_it.update(replace(seen, **heard))
    belief = with_it.belief(39.9)
    # The scalar along the nose is the level airspeed times the cosine of the pitch (3 deg here).
    np.testing.assert_allclose(belief.mean_to_ne_mps, wind, atol=0.1)
    assert belief.sources == ("pitot", "tilt")
    assert np.trace(belief.cov_ne_m2ps2) < np.trace(without.belief(39.9).cov_ne_m2ps2)


def test_it_goes_on_from_its_snapshot():
    estimator, other = ReferenceEstimator(M100), ReferenceEstimator(M100)
    for k in range(100):
        estimator.update(leaning(0.1 * k, 0.0, (0.0, 0.0), (5.0, 1.0)))
    other.restore(json.loads(json.dumps(estimator.snapshot())))
    np.testing.assert_array_equal(
        other.belief(12.0).mean_to_ne_mps, estimator.belief(12.0).mean_to_ne_mps
    )
    np.testing.assert_array_equal(
        other.belief(12.0).cov_ne_m2ps2, estimator.belief(12.0).cov_ne_m2ps2
    )
    with pytest.raises(LeewayError, match="reference-estimator/1"):
        other.restore({"format": "wind-estimator/4"})
    with pytest.raises(LeewayError, match="checkpoint"):
        other.restore({"format": "reference-estimator/1", "t_s": 1.0, "x": [0.0]})


# --- companion replay --estimator ---------------------------------------------------------------


def run(*arguments):
    return CliRunner().invoke(app, ["replay", *map(str, arguments)])


def test_replay_with_the_reference_finds_the_wind_and_keeps_the_records_keys(make, world, tmp_path):
    path = make.csv(tmp_path / "f.csv", make.telemetry_csv_columns(world))
    records = {}
    for name, asked in (("usual", ()), ("reference", ("--estimator", "reference"))):
        out = tmp_path / f"{name}.json"
        said = run(path, "--airframe", "m100", "--json", out, *asked)
        assert said.exit_code == 0, said.output
        assert ("reference estimator" in said.output) is (name == "reference")
        records[name] = json.loads(out.read_text())
    assert set(records["reference"]) - set(records["usual"]) == {"estimator"}
    assert records["reference"]["estimator"] == "reference"
    rows = [r for r in records["reference"]["timeline"] if 60.0 < r["t_s"] < 140.0]
    north = np.mean([r["wind_to_n_mps"] for r in rows])
    east = np.mean([r["wind_to_e_mps"] for r in rows])
    assert math.dist((north, east), world.wind_to_ne_mps) < 1.0
    usual = [r["wind_to_n_mps"] for r in records["usual"]["timeline"] if 60.0 < r["t_s"] < 140.0]
    assert usual != [r["wind_to_n_mps"] for r in rows]


def test_without_filterpy_the_reference_says_what_to_install(make, world, tmp_path, monkeypatch):
    for name in [m for m in sys.modules if m.split(".")[0] == "filterpy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "companion.analysis.replay.reference_estimator")
    monkeypatch.setitem(sys.modules, "filterpy", None)
    path = make.csv(tmp_path / "f.csv", make.telemetry_csv_columns(world))
    said = run(path, "--estimator", "reference")
    assert said.exit_code == 2
    assert "[replay]" in said.output


@pytest.mark.sample
def test_what_flies_and_a_usual_replay_import_no_filterpy(make, world, tmp_path):
    path = make.csv(tmp_path / "f.csv", make.telemetry_csv_columns(world))
    code = (
        "import sys; import companion.app.flight.run, companion.app.flight.fleet_run\n"
        "import companion.app.flight.standby, companion.app.cli.replay\n"
        "from typer.testing import CliRunner; from companion.app.cli.main import app\n"
        f"assert CliRunner().invoke(app, ['replay', {str(path)!r}]).exit_code == 0\n"
        "print([m for m in sys.modules if m.split('.')[0] == 'filterpy'])"
    )
    seen = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert seen.stdout.strip().endswith("[]"), seen.stderr


@pytest.mark.sample
def test_ours_is_ahead_of_the_reference_on_a_real_flight(tmp_path):
    # The flight with an anemometer: the improvement from the states for trim, gain and gusts.
    if not ANEMOMETER.exists():
        pytest.skip(f"{ANEMOMETER} is not here")
    rmse = {}
    for name in ("leeway", "reference"):
        out = tmp_path / f"{name}.json"
        assert run(ANEMOMETER, "--json", out, "--estimator", name).exit_code == 0
        rmse[name] = json.loads(out.read_text())["reference"]["rmse_mps"]
    assert rmse["leeway"] < rmse["reference"]
