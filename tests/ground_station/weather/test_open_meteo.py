"""Open-Meteo's JSON: wind at a time, height and position, and errors."""

import math

import numpy as np
import pytest

from ground_station.adapters.files.forecast_files import read_forecast
from ground_station.core.weather.forecast_field import OutsideForecast, WindAt
from tests.ground_station.weather.open_meteo import HOURS, START_S, answer, shear, written

LAT, LON = 55.47, 8.45


def read(tmp_path, document):
    return read_forecast(written(tmp_path / "wind.json", document), LAT, LON)


def at(field, hours: float, height_m: float) -> WindAt:
    found = field.wind_at_unix_time(START_S + 3600.0 * hours, height_m, LAT, LON)
    assert isinstance(found, WindAt), found
    return found


@pytest.mark.parametrize("height_m", [10.0, 40.0, 95.5, 180.0])
def test_a_log_profile_comes_back_exactly_at_every_height_and_half_hour(tmp_path, height_m):
    field = read(tmp_path, answer())
    wind = at(field, 2.5, height_m)
    assert wind.speed_mps == pytest.approx(2.25 * math.log(height_m / 0.1), abs=1e-9)
    assert wind.from_deg == pytest.approx(270.0)
    assert wind.to_ne_mps == pytest.approx((0.0, wind.speed_mps), abs=1e-9)  # to the east
    assert wind.std_mps == pytest.approx(2.0)


def test_local_times_and_unix_times_are_the_same_moments(tmp_path):
    local = answer()
    local["utc_offset_seconds"] = 7200
    local["hourly"]["time"] = [f"2026-07-01T{14 + h}:00" for h in range(HOURS)]
    unix = answer()
    unix["utc_offset_seconds"] = 7200  # not applied to unixtime, which is UTC
    unix["hourly_units"]["time"] = "unixtime"
    unix["hourly"]["time"] = [int(START_S) + 3600 * h for h in range(HOURS)]
    for document in (answer(), local, unix):
        assert read(tmp_path, document).t_s.tolist() == [START_S + 3600 * h for h in range(HOURS)]


def test_members_give_mean_and_spread(tmp_path):
    document = answer()
    rng = np.random.default_rng(3)
    speeds = rng.normal(10.0, 1.5, (20, HOURS))
    for height in (10, 80, 120, 180):
        for member in range(20):
            name = f"{height}m_member{member + 1:02d}"
            document["hourly"][f"wind_speed_{name}"] = speeds[member].tolist()
            document["hourly"][f"wind_direction_{name}"] = [270.0] * HOURS
            document["hourly_units"] |= {f"wind_speed_{name}": "m/s", f"wind_direction_{name}": "°"}
        document["hourly"][f"wind_speed_{height}m"] = [10.0] * HOURS  # the control
    field = read(tmp_path, document)
    assert field.spread == "21 members"
    wind = at(field, 1.0, 80.0)
    east = np.append(speeds[:, 1], 10.0)
    assert wind.speed_mps == pytest.approx(east.mean())
    # No crosswind: the variance of a component is half of that along the wind.
    assert wind.std_mps == pytest.approx(np.sqrt(0.5 * east.var(ddof=1)))


def test_strong_gusts_widen_what_has_no_members(tmp_path):
    document = answer()
    document["hourly"]["wind_gusts_10m"] = [v + 12.0 for v in document["hourly"]["wind_speed_10m"]]
    document["hourly_units"]["wind_gusts_10m"] = "m/s"
    assert at(read(tmp_path, document), 1.0, 40.0).std_mps == pytest.approx(4.0)


def test_pressure_levels_lie_at_their_height_above_the_ground(tmp_path):
    document = answer(heights=(10,))
    document["hourly"] |= {
        "wind_speed_1000hPa": [9.0] * HOURS,
        "wind_direction_1000hPa": [180.0] * HOURS,
        "geopotential_height_1000hPa": [112.0 + 10.0 * h for h in range(HOURS)],
    }
    document["hourly_units"] |= {
        "wind_speed_1000hPa": "m/s", "wind_direction_1000hPa": "°",
        "geopotential_height_1000hPa": "m",
    }  # fmt: skip
    field = read(tmp_path, document)
    assert at(field, 0.0, 100.0).to_ne_mps == pytest.approx((9.0, 0.0), abs=1e-9)  # to the north
    outside = field.wind_at_unix_time(START_S, 101.0, LAT, LON)
    assert isinstance(outside, OutsideForecast)
    assert "10 to 100 m above ground" in outside.reason
    assert at(field, 1.0, 101.0)


def test_unknown_is_none_and_outside_says_so(tmp_path):
    document = answer()
    for height in (10, 80, 120, 180):
        document["hourly"][f"wind_speed_{height}m"][3] = None
    field = read(tmp_path, document)
    assert field.wind_at_unix_time(START_S + 3 * 3600.0, 40.0, LAT, LON) is None
    assert at(field, 2.0, 40.0)
    for t_s, height_m, lat, words in (
        (START_S - 1.0, 40.0, LAT, "outside the forecast's 2026-07-01 12:00 UTC to"),
        (START_S, 9.0, LAT, "9 m is outside the forecast's heights, 10 to 180 m"),
        (START_S, 40.0, LAT + 1.0, "km from the forecast's point 55.480, 8.440"),
    ):
        found = field.wind_at_unix_time(t_s, height_m, lat, LON)
        assert isinstance(found, OutsideForecast)
        assert words in found.reason


def test_of_several_places_the_nearest_is_taken(tmp_path):
    far = answer(lambda hour, height_m: (20.0, 0.0)) | {"latitude": 56.5}
    field = read(tmp_path, [far, answer()])
    assert at(field, 0.0, 80.0).speed_mps == pytest.approx(shear(0, 80.0)[0])
