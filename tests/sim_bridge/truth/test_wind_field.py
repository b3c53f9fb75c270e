"""Mean wind, its profile, ramps, and the axes of gusts."""

import math
from pathlib import Path

import numpy as np
import pytest

from sim_bridge.truth.dryden import DrydenTurbulence
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.wind_field import RampedWind, RecordedWind, SteadyWind, WindField
from sim_bridge.truth.wind_log import WindLog, wind_to_ne_mps
from sim_bridge.truth.wind_params import (
    LogWindParams,
    build_mean_wind,
    build_wind_field,
    parse_wind,
)


@pytest.mark.parametrize(
    ("from_deg", "north", "east"), [(0, -1, 0), (90, 0, -1), (180, 1, 0), (270, 0, 1)]
)
def test_a_wind_from_the_north_moves_air_to_the_south(from_deg, north, east) -> None:
    assert SteadyWind(7.0, from_deg).to_ne_mps(0.0) == pytest.approx((7 * north, 7 * east))


def _log() -> WindLog:
    vectors = [wind_to_ne_mps(6.0, 350.0), wind_to_ne_mps(6.0, 10.0), wind_to_ne_mps(0.0, 10.0)]
    norths, easts = zip(*vectors, strict=True)
    return WindLog((100.0, 101.0, 103.0), norths, easts)


def test_a_recording_is_interpolated_as_a_vector_through_north() -> None:
    """Between 350 and 10 degrees the air goes due south at 6 cos 10, never through 180."""
    wind = RecordedWind(_log())
    assert wind.to_ne_mps(0.5) == pytest.approx((-6 * math.cos(math.radians(10)), 0.0))


def test_a_recording_starts_where_it_is_told_and_holds_its_last_sample() -> None:
    wind = RecordedWind(_log(), start_s=101.0)
    assert wind.to_ne_mps(0.0) == pytest.approx(wind_to_ne_mps(6.0, 10.0))
    assert wind.to_ne_mps(1.0) == pytest.approx(wind_to_ne_mps(3.0, 10.0))
    assert wind.to_ne_mps(500.0) == pytest.approx((0.0, 0.0))
    assert wind.remaining_s == 2.0


@pytest.mark.parametrize("start_s", [99.9, 103.0, math.nan])
def test_a_start_outside_the_recording_is_refused(start_s: float) -> None:
    with pytest.raises(TruthError, match="start_s"):
        RecordedWind(_log(), start_s)


def test_replay_passes_through_every_sample() -> None:
    """Brute force: numpy.interp of both components."""
    rng = np.random.default_rng(2)
    t_s = np.cumsum(rng.uniform(0.2, 3.0, 200))
    north, east = rng.normal(0, 5, (2, 200))
    wind = RecordedWind(WindLog(tuple(t_s), tuple(north), tuple(east)))
    for t in rng.uniform(0, t_s[-1] + 10, 300):
        expected = [np.interp(t + t_s[0], t_s, part) for part in (north, east)]
        assert wind.to_ne_mps(t) == pytest.approx(expected)


def test_a_ramp_is_linear_and_held_outside_its_points() -> None:
    wind = RampedWind([(10.0, 2.0, 90.0), (20.0, 6.0, 90.0)])
    speeds = [-wind.to_ne_mps(t)[1] for t in (0.0, 10.0, 15.0, 20.0, 99.0)]
    assert speeds == pytest.approx([2.0, 2.0, 4.0, 6.0, 6.0])


def test_a_veer_keeps_its_speed_and_goes_the_way_that_is_written() -> None:
    """350 to 370 turns by 20 degrees through north."""
    wind = RampedWind([(0.0, 5.0, 350.0), (10.0, 5.0, 370.0)])
    for t in np.linspace(0, 10, 7):
        north, east = wind.to_ne_mps(t)
        assert math.hypot(north, east) == pytest.approx(5.0)
        assert north < 0
    assert wind.to_ne_mps(5.0) == pytest.approx((-5.0, 0.0), abs=1e-12)


def test_points_out_of_order_are_refused() -> None:
    with pytest.raises(TruthError, match="rising"):
        RampedWind([(1.0, 2.0, 0.0), (1.0, 3.0, 0.0)])


def test_the_profile_is_a_power_law() -> None:
    """V(80)/V(10) = 8^(1/7) = 1.346."""
    field = WindField(SteadyWind(5.0, 180.0), profile_exponent=1 / 7)
    assert field.mean_wind_to_ne_mps(0.0, 10.0) == pytest.approx((5.0, 0.0))
    assert field.mean_wind_to_ne_mps(0.0, 80.0) == pytest.approx((5.0 * 1.34590, 0.0), rel=1e-4)
    assert field.mean_wind_to_ne_mps(0.0, 0.0) == field.mean_wind_to_ne_mps(0.0, 1.0)


@pytest.mark.sample
def test_gust_axes_follow_the_mean_wind() -> None:
    """Along-wind gusts have the longer memory, L_u against L_w: here wind towards the east."""
    field = WindField(
        SteadyWind(10.0, 270.0), turbulence=DrydenTurbulence(np.random.default_rng(4))
    )
    samples = np.array(
        [field.advance_and_get_wind_ned_mps(t, 1.0, 50.0, 10.0) for t in range(40_000)]
    )
    north, east, down = samples.T
    assert east.mean() == pytest.approx(10.0, abs=0.2)
    # MIL-F-8785C autocorrelation of u over 10 m: exp(-x / L_u), L_u = 202.3 m at 164 ft
    memory = [np.corrcoef(part[1:], part[:-1])[0, 1] for part in (north, east, down)]
    assert memory[1] == pytest.approx(math.exp(-10 / 202.3), abs=0.01)
    assert memory[1] > memory[0] > memory[2]


def test_same_generator_same_gusts_and_other_vehicles_other_gusts() -> None:
    def gusts(seed: int) -> list[tuple[float, float, float]]:
        params = parse_wind(
            {"kind": "steady", "speed_mps": 8.0, "from_deg": 0.0, "turbulence": "dryden"}
        )
        mean = build_mean_wind(params, Path())
        field = build_wind_field(params, mean, np.random.default_rng(seed))
        return [field.advance_and_get_wind_ned_mps(0.01 * k, 0.01, 30.0, 8.0) for k in range(50)]

    assert gusts(1) == gusts(1)
    assert gusts(1) != gusts(2)


def test_an_empty_table_is_still_air() -> None:
    params = parse_wind({})
    assert build_mean_wind(params, Path()).to_ne_mps(5.0) == pytest.approx((0.0, 0.0))


def test_a_log_is_found_beside_its_flight_file_and_brings_no_profile(tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text("t_s,wind_speed_mps,wind_from_deg\n0,5,180\n9,5,180\n")
    params = parse_wind({"kind": "log", "log": "w.csv", "start_s": 1.0})
    assert isinstance(params, LogWindParams)
    field = build_wind_field(params, build_mean_wind(params, tmp_path), np.random.default_rng(0))
    assert field.advance_and_get_wind_ned_mps(0.0, 0.01, 90.0, 5.0) == pytest.approx(
        (5.0, 0.0, 0.0)
    )


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ({"kind": "gale"}, "kind"),
        ({"kind": "steady", "speed_mps": 5.0}, "from_deg"),
        ({"kind": "steady", "speed_mps": 5.0, "from_deg": 0.0, "gusts": 1}, "gusts"),
        ({"kind": "steady", "speed_mps": -5.0, "from_deg": 0.0}, "wind.speed_mps"),
        ({"kind": "steady", "speed_mps": math.nan, "from_deg": 0.0}, "wind.speed_mps"),
        ({"kind": "points", "points": []}, "wind.points"),
        ({"kind": "log", "log": "w.csv", "turbulence": "lots"}, "turbulence"),
    ],
)
def test_a_mistake_in_the_wind_table_is_named(table: dict, named: str) -> None:
    with pytest.raises(TruthError, match=named):
        parse_wind(table)


def test_a_front_adds_to_the_mean_and_grows_with_height_as_it_does() -> None:
    field = WindField(SteadyWind(5.0, from_deg=180.0), profile_exponent=1.0 / 7.0)
    calm = field.advance_and_get_wind_ned_mps(0.0, 0.1, 40.0, 0.0)
    field.front_to_ne_mps = (0.0, 12.0)
    north, east, down = field.advance_and_get_wind_ned_mps(0.1, 0.1, 40.0, 0.0)
    assert (north, down) == (calm[0], 0.0)
    assert east == pytest.approx(12.0 * 4.0 ** (1.0 / 7.0))
