"""Plans under a forecast: each sortie in the wind of its time, with its launch window."""

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from companion.core.base.geo import location_to_ground_ned_m
from companion.core.mission.flight_plan import depot_frame
from ground_station.adapters.files.day_files import read_day, read_day_plan
from ground_station.adapters.files.forecast_files import ForecastRequest
from ground_station.app.cli.main import app
from ground_station.app.views.windows_view import launch_closing_lines
from ground_station.core.dispatch.launch_promise import launch_closings_of_plan
from ground_station.core.feasibility.reach import (
    SortieFeasibility,
    SortieGeometry,
    route_energy_model_for_day,
)
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day import DayFilesError, Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.day_state import initial_state
from ground_station.core.schema.orders import order_location
from tests.ground_station.weather.open_meteo import START_S, answer, written

pytestmark = pytest.mark.usefixtures("compiled_planner")

DAYS = Path(__file__).parents[3] / "params" / "days"
QUICK = PlanParams(trials=600)


def rising(path: Path, first_mps: float, per_hour_mps: float) -> Path:
    """Write a forecast from 80 degrees, constant over height."""
    return written(path, answer(lambda hour, _: (first_mps + per_hour_mps * hour, 80.0)))


def harbour(forecast: Path, limit_mps: float = 40.0) -> DayData:
    """Read the harbour's day with a wind-aloft limit that is never reached."""
    data = read_day(DAYS / "harbour.toml", ForecastRequest(forecast, START_S))
    return replace(data, day=msgspec.structs.replace(data.day, wind_limit_mps=limit_mps))


def affordable(data: DayData, plan: DayPlan, sortie: PlannedSortie, speed_mps: float) -> bool:
    """Return whether the desk's filter accepts a straight return flight in a constant wind."""
    frame, drone = depot_frame(data.day.depot.location), data.day.find_drone(sortie.vehicle)
    assert drone is not None
    airframe = data.airframes[drone.airframe]
    wind = Forecast(speed_mps=speed_mps, from_deg=80.0, std_mps=2.0)
    reach = SortieFeasibility(
        drone, airframe, data.day.mission, wind, route_energy_model_for_day(data.day, airframe)
    )
    order = next(order for order in data.orders if order.id == sortie.order)
    start = location_to_ground_ned_m(frame, plan.get_stop(sortie.launch).pads[sortie.vehicle])
    end = location_to_ground_ned_m(frame, plan.get_stop(sortie.home).pads[sortie.vehicle])
    height_m = sortie.outbound_height_m - start[2]
    customer = location_to_ground_ned_m(frame, order_location(order))
    return (
        reach.sortie_need_if_feasible(SortieGeometry(order.mass_kg, start, customer, end, height_m))
        is not None
    )


def test_a_window_ends_at_the_last_five_minutes_in_which_the_flight_pays(tmp_path):
    data = harbour(rising(tmp_path / "rising.json", 4.0, 3.0))
    assert data.forecast is not None
    assert data.day.forecast.speed_mps == pytest.approx(4.0)
    plan = plan_day(data, initial_state(data), QUICK)
    windows = {
        window.order: window for window in launch_closings_of_plan(data, plan, data.forecast)
    }
    ended = 0
    for sortie in plan.sorties:
        window, takes_s = windows[sortie.order], sortie.land_s - sortie.launch_s

        def pays(t_s: float, sortie=sortie, takes_s=takes_s) -> bool:
            # The rising wind costs most at the landing; the route here is straight.
            landing = 4.0 + 3.0 * (t_s + takes_s) / 3600.0
            return affordable(data, plan, sortie, landing)

        if window.until_s is None:
            assert pays(data.forecast.forecast_end_day_s - takes_s)
            continue
        ended += 1
        assert (window.until_s - sortie.launch_s) % 300.0 == pytest.approx(0.0)
        assert pays(window.until_s)
        assert not pays(window.until_s + 300.0)
        assert window.reopens_s is None
    assert ended  # the strongest wind, 19 m/s, must forbid some flight
    lines = "\n".join(launch_closing_lines(list(windows.values()), data.forecast))
    assert "after 1" in lines
    assert "may not be launched" in lines


def test_a_window_ends_where_the_limit_of_the_wind_aloft_is_reached(tmp_path):
    data = harbour(rising(tmp_path / "rising.json", 4.0, 3.0), limit_mps=8.0)
    assert data.forecast is not None
    plan = plan_day(data, initial_state(data), QUICK)
    taken = {sortie.order: sortie.land_s - sortie.launch_s for sortie in plan.sorties}
    windows = launch_closings_of_plan(data, plan, data.forecast)
    assert windows
    for window in windows:
        assert window.until_s is not None
        lands_s = window.until_s + taken[window.order]
        assert 4.0 + 3.0 * lands_s / 3600.0 < 8.0  # the wind is strongest at the landing
        assert 4.0 + 3.0 * (lands_s + 300.0) / 3600.0 >= 8.0


def test_no_sortie_is_planned_into_a_wind_that_it_does_not_stand(tmp_path):
    steep = harbour(rising(tmp_path / "steep.json", 10.0, 40.0))
    calm_later = harbour(rising(tmp_path / "flat.json", 10.0, 0.0))
    constant = plan_day(calm_later, initial_state(calm_later), QUICK)

    def blown_away(data: DayData, plan: DayPlan) -> list[str]:
        return [
            s.order
            for s in plan.sorties
            if not affordable(data, plan, s, 10.0 + 40.0 * s.land_s / 3600.0)
        ]

    assert blown_away(calm_later, constant)  # the canary: the initial wind forbids none
    plan = plan_day(steep, initial_state(steep), QUICK)
    assert not blown_away(steep, plan)
    orders = {s.order for s in plan.sorties} | {i for stop in plan.stops for i in stop.serves}
    left = {line.order: line.reason for line in plan.unplanned}
    assert orders | set(left) == {order.id for order in steep.orders}
    assert all("the forecast is" in why for why in left.values())


def test_a_steady_forecast_plans_as_the_same_constant_wind(tmp_path):
    """Without a file no forecast is evaluated."""
    constant = read_day(DAYS / "harbour.toml")
    assert constant.forecast is None
    steady = harbour(rising(tmp_path / "steady.json", 4.0, 0.0))
    assert math.isclose(steady.day.forecast.from_deg, 80.0)
    one = plan_day(constant, initial_state(constant), QUICK)
    other = plan_day(steady, initial_state(steady), QUICK)
    assert [(s.order, s.launch, s.home) for s in one.sorties] == [
        (s.order, s.launch, s.home) for s in other.sorties
    ]
    assert [s.required_wh for s in one.sorties] == pytest.approx(
        [s.required_wh for s in other.sorties]
    )


def test_the_command_says_the_wind_and_until_when(tmp_path):
    file = rising(tmp_path / "rising.json", 4.0, 3.0)
    out = tmp_path / "plan.json"
    options = ["--forecast", str(file), "--at", "2026-07-01T14:00+02:00", "--trials", "600"]
    done = CliRunner().invoke(app, ["plan", "harbour", *options, "--out", str(out)])
    assert done.exit_code == 0, done.output
    words = " ".join(done.output.split())
    assert "forecast at 40 m, 2026-07-01 12:00 UTC: 4.0 m/s from 80 (one sigma 2.0 m/s" in words
    assert read_day_plan(out).sorties


@pytest.mark.parametrize(
    ("forecast", "at", "words"),
    [
        (
            'file = "w.json"\nspeed_mps = 4.0',
            START_S,
            "forecast.file: together with speed_mps, expected",
        ),
        ('file = "none.json"', START_S, "none.json: No such file"),
        ('file = "w.json"', START_S + 1e6, "is outside the forecast's 2026-07-01 12:00 UTC to"),
    ],
)
def test_mistakes_of_a_days_forecast_are_listed_with_the_day(tmp_path, forecast, at, words):
    rising(tmp_path / "w.json", 4.0, 0.0)
    text = (DAYS / "harbour.toml").read_text()
    stated = "speed_mps = 4.0\nfrom_deg = 80.0\nstd_mps = 2.0"
    assert stated in text
    day = tmp_path / "day.toml"
    day.write_text(
        text.replace(stated, forecast).replace('no_fly = "../sites/harbour.geojson"', "")
    )
    (tmp_path / "harbour_orders.csv").write_text((DAYS / "harbour_orders.csv").read_text())
    with pytest.raises(DayFilesError) as caught:
        read_day(day, ForecastRequest(None, at))
    (said,) = [str(problem) for problem in caught.value.problems]
    assert words in said
    assert str(day) in said
