"""GRIB2 as ecCodes itself writes it, from its samples."""

from pathlib import Path

import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.forecast_files import read_forecast
from ground_station.core.weather.forecast_field import (
    OutsideForecast,
    WindAt,
    ensemble_mean_and_std,
)

eccodes = pytest.importorskip("eccodes")

LAT, LON = 55.47, 8.45
START_S = 1_782_907_200.0  # 2026-07-01 12:00 UTC
U, V, GUST, HEIGHT = (2, 2), (2, 3), (2, 22), (3, 5)
LATS = np.arange(56.5, 54.4, -0.25)  # from the north, as most files have it
LONS = np.arange(7.5, 9.6, 0.25)


def plane(lat, lon, hour: float) -> np.ndarray:
    """Bilinear interpolation gives a plane back exactly."""
    return 5.0 + 2.0 * (lat - 55.0) + 1.0 * (lon - 8.0) + 0.5 * hour


def message(
    quantity, level: int, hour: int, values, kind="heightAboveGround", member=None, west=7.5
) -> bytes:
    handle = eccodes.codes_grib_new_from_samples("regular_ll_sfc_grib2")
    keys = {
        "Ni": LONS.size, "Nj": LATS.size,
        "latitudeOfFirstGridPointInDegrees": 56.5, "latitudeOfLastGridPointInDegrees": 54.5,
        "longitudeOfFirstGridPointInDegrees": west,
        "longitudeOfLastGridPointInDegrees": (west + 2.0) % 360.0,
        "iDirectionIncrementInDegrees": 0.25, "jDirectionIncrementInDegrees": 0.25,
        "dataDate": 20260701, "dataTime": 1200,
    }  # fmt: skip
    if member is not None:
        keys |= {"productDefinitionTemplateNumber": 1, "perturbationNumber": member}
    category, number = quantity
    keys |= {"discipline": 0, "parameterCategory": category, "parameterNumber": number}
    keys |= {"typeOfLevel": kind, "level": level, "indicatorOfUnitOfTimeRange": 1}
    keys |= {"forecastTime": hour, "bitsPerValue": 24}
    if kind == "surface":
        del keys["level"]
    for key, value in keys.items():
        eccodes.codes_set(handle, key, value)
    eccodes.codes_set_values(handle, np.broadcast_to(values, (LATS.size, LONS.size)).ravel())
    raw = eccodes.codes_get_message(handle)
    eccodes.codes_release(handle)
    return raw


def file_of(path: Path, messages: list[bytes]) -> Path:
    path.write_bytes(b"".join(messages))
    return path


def winds(hours=(0, 3), heights=(10, 100)) -> list[bytes]:
    """A plane to the east, nothing to the north."""
    found = []
    for hour in hours:
        east = plane(LATS[:, None], LONS[None, :], hour)
        for height in heights:
            found += [message(U, height, hour, east), message(V, height, hour, 0.0)]
    return found


def at(field, hours: float, height_m: float, lat=LAT, lon=LON) -> WindAt:
    found = field.wind_at_unix_time(START_S + 3600.0 * hours, height_m, lat, lon)
    assert isinstance(found, WindAt), found
    return found


def test_a_plane_comes_back_between_points_and_times(tmp_path):
    field = read_forecast(file_of(tmp_path / "w.grib2", winds()), LAT, LON)
    wind = at(field, 1.0, 40.0)
    assert wind.to_ne_mps == pytest.approx((0.0, plane(LAT, LON, 1.0)), abs=1e-4)
    assert wind.from_deg == pytest.approx(270.0, abs=0.01)
    assert wind.std_mps == pytest.approx(2.0)
    assert at(field, 1.0, 40.0, LAT, LON + 360.0).to_ne_mps == pytest.approx(wind.to_ne_mps)


def test_a_grid_over_the_meridian_of_greenwich_is_one_grid(tmp_path):
    east = 3.0 + (LONS - 7.5)  # 3 m/s at its western edge, one more by the degree
    made = [
        message(quantity, height, hour, values, west=359.0)
        for hour in (0, 3)
        for height in (10, 100)
        for quantity, values in ((U, east[None, :]), (V, 0.0))
    ]
    field = read_forecast(file_of(tmp_path / "w.grib2", made), 55.1, -0.1)
    assert at(field, 0.0, 40.0, 55.1, -0.1).to_ne_mps[1] == pytest.approx(3.9, abs=1e-4)
    assert at(field, 0.0, 40.0, 55.1, 0.1).to_ne_mps[1] == pytest.approx(4.1, abs=1e-4)


def test_u_and_v_in_one_message_are_two_fields(tmp_path):
    path, sections = tmp_path / "w.grib2", [winds()[n : n + 2] for n in range(0, 8, 2)]
    with path.open("wb") as file:
        for pair in sections:
            both = eccodes.codes_grib_multi_new()
            for raw in pair:  # section 4 (product) begins what differs between the two
                handle = eccodes.codes_new_from_message(raw)
                eccodes.codes_grib_multi_append(handle, 4, both)
                eccodes.codes_release(handle)
            eccodes.codes_grib_multi_write(both, file)
            eccodes.codes_grib_multi_release(both)
    eccodes.codes_grib_multi_support_off()  # writing has switched it on
    assert path.read_bytes().count(b"7777GRIB") == 3  # four messages
    wind = at(read_forecast(path, LAT, LON), 1.0, 40.0)
    assert wind.to_ne_mps == pytest.approx((0.0, plane(LAT, LON, 1.0)), abs=1e-4)


def test_members_give_mean_and_spread(tmp_path):
    rng = np.random.default_rng(5)
    speeds = rng.normal(8.0, 2.0, (10, 2))
    made = [
        message(quantity, height, hour, speeds[member][axis], member=member)
        for hour in (0, 3)
        for height in (10, 100)
        for member in range(10)
        for axis, quantity in enumerate((V, U))
    ]
    field = read_forecast(file_of(tmp_path / "w.grib2", made), LAT, LON)
    mean, std = ensemble_mean_and_std(speeds[:, None, :])
    wind = at(field, 2.0, 30.0)
    assert field.spread == "10 members"
    assert wind.to_ne_mps == pytest.approx(tuple(mean[0]), abs=1e-4)
    assert wind.std_mps == pytest.approx(float(std[0]), abs=1e-4)
    assert wind.std_mps == pytest.approx(np.sqrt(speeds.var(axis=0, ddof=1).mean()), abs=1e-4)


def test_pressure_levels_lie_over_the_models_ground_and_gusts_widen(tmp_path):
    made = [message(HEIGHT, 0, 0, 60.0, kind="surface")]
    for hour in (0, 3):
        made += [
            message(U, 10, hour, 6.0), message(V, 10, hour, 0.0),
            message(GUST, 10, hour, 6.0 + 9.0),
            message(U, 1000, hour, 0.0, kind="isobaricInhPa"),
            message(V, 1000, hour, 9.0, kind="isobaricInhPa"),
            message(HEIGHT, 1000, hour, 160.0, kind="isobaricInhPa"),
        ]  # fmt: skip
    field = read_forecast(file_of(tmp_path / "w.grib2", made), LAT, LON)
    assert at(field, 0.0, 100.0).to_ne_mps == pytest.approx((9.0, 0.0), abs=1e-3)
    assert at(field, 0.0, 100.0).std_mps == pytest.approx(3.0, abs=1e-3)
    outside = field.wind_at_unix_time(START_S, 101.0, LAT, LON)
    assert isinstance(outside, OutsideForecast)
    assert "10 to 100 m above ground" in outside.reason


MISTAKES = {
    "damaged, expected complete GRIB2": lambda: [b"".join(winds())[:-40]],
    "no GRIB message, expected GRIB2": lambda: [b"hello" * 50],
    "no wind at any height": lambda: [message((0, 0), 2, hour, 280.0) for hour in (0, 3)],
    "u at 100 m, 2026-07-01 15:00 UTC: missing, expected u and v": lambda: [
        *winds(hours=(0,)), *winds(hours=(3,), heights=(10,)), message(V, 100, 3, 0.0),
    ],
    "u at 10 m, 2026-07-01 12:00 UTC: duplicate": lambda: [*winds(), winds()[0]],
    "wind at 1000 hPa without the height of the surface": lambda: [
        *winds(hours=(0, 3)),
        *(message(q, 1000, h, 9.0, kind="isobaricInhPa") for q in (U, V, HEIGHT) for h in (0, 3)),
    ],
    "1 times, expected 2": lambda: winds(hours=(0,)),
}  # fmt: skip


@pytest.mark.parametrize("words", MISTAKES)
def test_a_mistake_is_one_line_with_the_file(tmp_path, words):
    path = file_of(tmp_path / "w.grib2", MISTAKES[words]())
    with pytest.raises(LeewayError) as caught:
        read_forecast(path, LAT, LON)
    said = str(caught.value)
    assert said.startswith(str(path))
    assert words in said
    assert "\n" not in said


def test_a_place_outside_the_grid_is_named(tmp_path):
    path = file_of(tmp_path / "w.grib2", winds())
    with pytest.raises(
        LeewayError, match=r"latitude 57.00000 is outside the grid's 54.500 to 56.5"
    ):
        read_forecast(path, 57.0, LON)
    with pytest.raises(LeewayError, match=r"longitude 12.00000 is outside the grid's 7.500 to 9.5"):
        read_forecast(path, LAT, 12.0)


SOUTH_POLE = (-39.25, 18.0)
"""Latitude and longitude of the rotated south pole, as in COSMO and HIRLAM grids."""


def rotated_message(quantity, values, hour, *, is_relative: bool, scan: dict[str, int]) -> bytes:
    """A field on a rotated grid; rotated 0, 0 lies at 50.75 N, 18 E."""
    handle = eccodes.codes_grib_new_from_samples("rotated_ll_sfc_grib2")
    first, last = (6.0, 3.0) if not scan["jScansPositively"] else (3.0, 6.0)
    west, east = (-7.0, -4.0) if not scan["iScansNegatively"] else (-4.0, -7.0)
    keys = scan | {
        "Ni": 31, "Nj": 31,
        "latitudeOfFirstGridPointInDegrees": first, "latitudeOfLastGridPointInDegrees": last,
        "longitudeOfFirstGridPointInDegrees": west % 360.0,
        "longitudeOfLastGridPointInDegrees": east % 360.0,
        "iDirectionIncrementInDegrees": 0.1, "jDirectionIncrementInDegrees": 0.1,
        "latitudeOfSouthernPoleInDegrees": SOUTH_POLE[0],
        "longitudeOfSouthernPoleInDegrees": SOUTH_POLE[1],
        "uvRelativeToGrid": int(is_relative), "dataDate": 20260701, "dataTime": 1200,
        "discipline": 0, "parameterCategory": quantity[0], "parameterNumber": quantity[1],
        "typeOfLevel": "heightAboveGround", "level": 10, "forecastTime": hour, "bitsPerValue": 24,
    }  # fmt: skip
    for key, value in keys.items():
        eccodes.codes_set(handle, key, value)
    eccodes.codes_set_values(handle, np.zeros(31 * 31))  # sets the number of points
    lats = eccodes.codes_get_array(handle, "latitudes")
    lons = eccodes.codes_get_array(handle, "longitudes")
    eccodes.codes_set_values(handle, values(lats, lons))
    raw = eccodes.codes_get_message(handle)
    eccodes.codes_release(handle)
    return raw


def bearing_of_rotated_north_rad(lat_deg: float, lon_deg: float) -> float:
    """Direction of the rotated north pole, clockwise from north (spherical trigonometry)."""
    pole_lat, pole_lon = np.radians(-SOUTH_POLE[0]), np.radians(SOUTH_POLE[1] - 180.0)
    lat, dlon = np.radians(lat_deg), pole_lon - np.radians(lon_deg)
    return np.arctan2(
        np.sin(dlon) * np.cos(pole_lat),
        np.cos(lat) * np.sin(pole_lat) - np.sin(lat) * np.cos(pole_lat) * np.cos(dlon),
    )


@pytest.mark.parametrize("is_relative", [False, True], ids=["to north", "to the grid"])
@pytest.mark.parametrize("down", [0, 1], ids=["from the north", "from the south"])
@pytest.mark.parametrize("left", [0, 1], ids=["from the west", "from the east"])
def test_a_rotated_grid_gives_the_wind_by_north(tmp_path, is_relative, down, left):
    lat, lon = 55.2, 9.4  # within the rotated window
    scan = {"iScansNegatively": left, "jScansPositively": down}
    turn = bearing_of_rotated_north_rad(lat, lon) if is_relative else 0.0
    assert not is_relative or abs(turn) > np.radians(3.0)

    def east(lats, lons):
        return 5.0 + 2.0 * (lats - lat) + 1.0 * (lons - lon)

    def along_rows(lats, lons):  # a wind to the east, in the grid's directions
        return east(lats, lons) * np.cos(turn)

    def along_columns(lats, lons):
        return east(lats, lons) * np.sin(turn)

    messages = [
        rotated_message(quantity, values, hour, is_relative=is_relative, scan=scan)
        for hour in (0, 3)
        for quantity, values in ((U, along_rows), (V, along_columns))
    ]
    field = read_forecast(file_of(tmp_path / "r.grib2", messages), lat, lon)
    for off in (0.0, 0.03):
        found = at(field, 0.0, 10.0, lat + off, lon - off)
        expected_mps = 5.0 + 2.0 * off - off
        assert found.to_ne_mps == pytest.approx((0.0, expected_mps), abs=0.02)


def test_a_position_at_the_edge_of_a_rotated_grid_is_refused(tmp_path):
    scan = {"iScansNegatively": 0, "jScansPositively": 0}
    messages = [
        rotated_message(quantity, lambda lats, lons: 0.0 * lats, 0, is_relative=True, scan=scan)
        for quantity in (U, V)
    ]
    path = file_of(tmp_path / "r.grib2", messages)
    with pytest.raises(LeewayError, match="outside the grid, or at its edge"):
        read_forecast(path, 60.0, 9.4)
