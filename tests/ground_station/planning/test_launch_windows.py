"""Plans under a forecast: each sortie in the wind of its time, and until when it is promised."""

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from companion.core.base.geo import place_ned
from companion.core.mission.flight_plan import frame_at
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.forecast_files import ForecastWanted
from ground_station.adapters.files.plan_files import read_day_plan
from ground_station.app.cli.main import app
from ground_station.app.views.windows_view import window_lines
from ground_station.core.feasibility.reach import Reach, day_energy
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.planning.launch_windows import launch_windows
from ground_station.core.schema.day import DayFilesError, Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.day_state import first_state
from ground_station.core.schema.orders import place_of
from tests.ground_station.weather.open_meteo import START_S, answer, written

pytestmark = pytest.mark.usefixtures("compiled_planner")

DAYS = Path(__file__).parents[3] / "params" / "days"
QUICK = PlanParams(trials=600)


def rising(path: Path, first_mps: float, per_hour_mps: float) -> Path:
    """From 80 degrees, the same at all heights."""
    return written(path, answer(lambda hour, _: (first_mps + per_hour_mps * hour, 80.0)))


def harbour(forecast: Path, limit_mps: float = 40.0) -> DayData:
    """With a limit of the wind aloft that nothing reaches."""
    data = read_day(DAYS / "harbour.toml", ForecastWanted(forecast, START_S))
    return replace(data, day=msgspec.structs.replace(data.day, wind_limit_mps=limit_mps))


def affordable(data: DayData, plan: DayPlan, sortie: PlannedSortie, speed_mps: float) -> bool:
    """By the desk's filter, straight there and back, in a constant wind."""
    frame, drone = frame_at(data.day.depot.place), data.day.drone(sortie.vehicle)
    assert drone is not None
    airframe = data.airframes[drone.airframe]
    wind = Forecast(speed_mps=speed_mps, from_deg=80.0, std_mps=2.0)
    reach = Reach(drone, airframe, data.day.mission, wind, day_energy(data.day, airframe))
    order = next(order for order in data.orders if order.id == sortie.order)
    start = place_ned(frame, plan.stop(sortie.launch).pads[sortie.vehicle])
    end = place_ned(frame, plan.stop(sortie.home).pads[sortie.vehicle])
    height_m = sortie.outbound_height_m - start[2]
    customer = place_ned(frame, place_of(order))
    return reach.affordable(order.mass_kg, start, customer, end, height_m) is not None


def test_a_window_ends_at_the_last_five_minutes_in_which_the_flight_pays(tmp_path):
    data = harbour(rising(tmp_path / "rising.json", 4.0, 3.0))
    assert data.forecast is not None
    assert data.day.forecast.speed_mps == pytest.approx(4.0)
    plan = plan_day(data, first_state(data), QUICK)
    windows = {window.order: window for window in launch_windows(data, plan, data.forecast)}
    ended = 0
    for sortie in plan.sorties:
        window, takes_s = windows[sortie.order], sortie.land_s - sortie.launch_s

        def pays(t_s: float, sortie=sortie, takes_s=takes_s) -> bool:
            # The rising wind asks for most at the landing; the way here is straight.
            landing = 4.0 + 3.0 * (t_s + takes_s) / 3600.0
            return affordable(data, plan, sortie, landing)

        if window.until_s is None:
            assert pays(window.end_s)
            continue
        ended += 1
        assert window.until_s % 300.0 == pytest.approx(0.0)
        assert pays(window.until_s)
        assert not pays(window.until_s + 300.0)
        assert window.again_s is None
    assert ended  # the strongest wind, 19 m/s, must forbid something
    lines = "\n".join(window_lines(list(windows.values()), data.forecast, 40.0))
    assert "after 2026-07-01 1" in lines
    assert "not promised" in lines


def test_a_window_ends_where_the_limit_of_the_wind_aloft_is_reached(tmp_path):
    data = harbour(rising(tmp_path / "rising.json", 4.0, 3.0), limit_mps=8.0)
    assert data.forecast is not None
    plan = plan_day(data, first_state(data), QUICK)
    taken = {sortie.order: sortie.land_s - sortie.launch_s for sortie in plan.sorties}
    windows = launch_windows(data, plan, data.forecast)
    assert windows
    for window in windows:
        assert window.until_s is not None
        lands_s = window.until_s + taken[window.order]
        assert 4.0 + 3.0 * lands_s / 3600.0 < 8.0  # it is strongest at the landing
        assert 4.0 + 3.0 * (lands_s + 300.0) / 3600.0 >= 8.0


def test_no_sortie_is_planned_into_a_wind_that_it_does_not_stand(tmp_path):
    steep = harbour(rising(tmp_path / "steep.json", 10.0, 40.0))
    calm_later = harbour(rising(tmp_path / "flat.json", 10.0, 0.0))
    constant = plan_day(calm_later, first_state(calm_later), QUICK)

    def blown_away(data: DayData, plan: DayPlan) -> list[str]:
        return [
            s.order
            for s in plan.sorties
            if not affordable(data, plan, s, 10.0 + 40.0 * s.land_s / 3600.0)
        ]

    assert blown_away(calm_later, constant)  # the canary: the wind of the beginning forbids none
    plan = plan_day(steep, first_state(steep), QUICK)
    assert not blown_away(steep, plan)
    orders = {s.order for s in plan.sorties} | {i for stop in plan.stops for i in stop.serves}
    left = {line.order: line.why for line in plan.unplanned}
    assert orders | set(left) == {order.id for order in steep.orders}
    assert all("the forecast is" in why for why in left.values())


def test_a_steady_forecast_plans_as_the_same_constant_wind(tmp_path):
    """And without a file nothing of it is looked at."""
    constant = read_day(DAYS / "harbour.toml")
    assert constant.forecast is None
    steady = harbour(rising(tmp_path / "steady.json", 4.0, 0.0))
    assert math.isclose(steady.day.forecast.from_deg, 80.0)
    one = plan_day(constant, first_state(constant), QUICK)
    other = plan_day(steady, first_state(steady), QUICK)
    assert [(s.order, s.launch, s.home) for s in one.sorties] == [
        (s.order, s.launch, s.home) for s in other.sorties
    ]
    assert [s.sure_wh for s in one.sorties] == pytest.approx([s.sure_wh for s in other.sorties])


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
        ('file = "w.json"\nspeed_mps = 4.0', START_S, "forecast.file: beside speed_mps, expected"),
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
        read_day(day, ForecastWanted(None, at))
    (said,) = [str(problem) for problem in caught.value.problems]
    assert words in said
    assert str(day) in said
