"""The wind field that a desk estimates, from states as drones send them."""

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.core.wind_field.fronts import FrontUpdate, FrontWithdrawn, WindFront
from companion.fleet.messages import State, decode_message, encode_message
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.day_wind import create_site_wind
from ground_station.adapters.files.params import read_wind_process
from ground_station.core.dispatch.measured_wind import (
    measured_or_previous_launch_forecast,
    measured_or_previous_planning_forecast,
    wind_deviation_sigmas,
)
from ground_station.core.site_wind.site_field import READMISSION_S
from ground_station.core.site_wind.site_fronts import EXCLUSION_GRACE_S, FRONT_KEPT_S
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_reporters import MIN_SPAN_S, REPORT_TIMEOUT_S
from ground_station.core.site_wind.wind_texts import (
    format_front,
    format_site_wind,
    format_withdrawal,
)
from tests.ground_station.site_wind.told_air import (
    DEPOT,
    FORECAST,
    PLACES,
    Air,
    a_state,
    front_comes,
)


def test_nothing_is_known_before_a_minute_of_it_and_nothing_any_more_two_minutes_after_it():
    air = Air()
    assert format_site_wind(air.wind, 0.0) == ""
    air.blow(MIN_SPAN_S - 1.0)
    assert air.wind.depot_wind(air.t_s, 300.0, 600.0) is None
    assert measured_or_previous_planning_forecast(air.wind, air.t_s, FORECAST) == FORECAST
    air.blow(3.0)
    assert air.wind.depot_wind(air.t_s, 300.0, 600.0) is not None
    assert air.wind.depot_wind(air.t_s + REPORT_TIMEOUT_S + 1.0, 300.0, 600.0) is None


def test_it_finds_the_wind_that_blows_and_says_it_in_a_line():
    air = Air()
    air.blow(300.0)
    here = air.wind.wind_at_report_centroid(air.t_s)
    assert here is not None
    assert math.dist(here.to_ne_mps, (0.0, 6.0)) < 1.0
    assert 0.2 < here.larger_axis_std_mps < 1.2
    words = format_site_wind(air.wind, air.t_s)
    assert f"wind {here.speed_mps:.1f} +- {here.larger_axis_std_mps:.1f} m/s from" in words
    assert "at 40 m, by 4 drones" in words


def test_it_is_surer_of_now_than_of_later_and_of_where_somebody_is_than_of_far_away():
    air = Air()
    air.blow(300.0)
    now_s, near, far = air.t_s, PLACES["d2"], (0.0, 8000.0)
    at = lambda place, t_s: air.wind.wind_at(now_s, place, 40.0, t_s).larger_axis_std_mps  # noqa: E731
    assert at(near, now_s) < at(near, now_s + 60.0) < at(near, now_s + 1800.0)
    assert at(near, now_s) < at(far, now_s)
    assert air.wind.wind_at(now_s, near, 120.0, now_s).larger_axis_std_mps > at(
        near, now_s
    )  # no drone is that high


def test_a_wind_that_the_forecast_did_not_have_is_planned_with_and_its_own_error():
    air = Air()
    for mean in air.mean.values():
        mean[:] = (10.0, 0.0)
    air.blow(240.0)
    assert (
        wind_deviation_sigmas(air.wind, air.t_s, FORECAST) > 3.0
    )  # the forecast differs by 11.7 m/s
    wind = measured_or_previous_planning_forecast(air.wind, air.t_s, FORECAST)
    assert wind.speed_mps == pytest.approx(10.0, abs=1.5)
    soon = measured_or_previous_launch_forecast(air.wind, air.t_s, FORECAST)
    assert soon.std_mps < wind.std_mps
    assert wind_deviation_sigmas(air.wind, air.t_s, wind) == pytest.approx(0.0, abs=1e-6)


def test_a_covariance_that_is_not_told_counts_as_a_large_one():
    told, untold = Air(seed=3), Air(seed=3, wind_cov_m2ps2=msgspec.UNSET)
    for air in (told, untold):
        air.blow(200.0)
    assert (
        untold.wind.wind_at_report_centroid(200.0).larger_axis_std_mps
        > 1.2 * told.wind.wind_at_report_centroid(200.0).larger_axis_std_mps
    )  # type: ignore[union-attr]


@pytest.mark.parametrize("more", [
    {"armed": False}, {"armed": None}, {"height_rel_m": 9.0}, {"height_rel_m": None},
    {"lat_deg": None}, {"wind_to_n_mps": None},
])  # fmt: skip
def test_who_is_not_in_the_air_or_does_not_say_where_tells_no_wind(more: dict[str, object]):
    air = Air(**more)
    air.blow(120.0)
    assert format_site_wind(air.wind, air.t_s) == ""


def test_a_liar_that_tells_the_truth_again_is_believed_again_after_a_while():
    air = Air(seed=5)
    air.blow(150.0)
    air.mean["d4"] += (12.0, 0.0)
    air.blow(90.0)
    assert "d4" in air.wind.exclusion_reason_by_member(air.t_s)
    air.mean["d4"] -= (12.0, 0.0)
    air.blow(READMISSION_S - 30.0)
    assert "d4" in air.wind.exclusion_reason_by_member(air.t_s)
    air.blow(150.0)
    assert air.wind.exclusion_reason_by_member(air.t_s) == {}
    assert "by 4 drones" in format_site_wind(air.wind, air.t_s)


# --- fronts --------------------------------------------------------------------------------------


def test_a_front_felt_by_one_is_told_with_place_speed_and_arrival_within_ten_seconds():
    air = Air(seed=2)
    air.blow(180.0)
    began_s = air.t_s
    at = front_comes(air, (0.0, 9.0), 11.0, 10.0)
    assert [one.detections[0].member for one in air.wind.fronts] == ["d1"]
    front = air.wind.fronts[0]
    assert front.detected_s - began_s <= 10.0
    words = format_front(front, air.t_s, [(name, PLACES[name]) for name in ("d2", "d3")])
    assert "detected by d1" in words
    assert "d2 in " in words
    for name in ("d2", "d3", "d4"):
        t_s, std_s = front.arrival_time_and_std_s(PLACES[name])
        assert abs(t_s - at[name]) < 2.5 * std_s
        assert t_s > air.t_s, "it is told before it is there"
    air.t_s += FRONT_KEPT_S + 10.0
    assert air.wind.drop_expired_and_get_fronts(air.t_s) == []


@pytest.mark.parametrize("watched", [True, False])
def test_a_day_over_steep_ground_may_have_its_desk_look_for_no_fronts(watched: bool):
    day = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
    of_day = msgspec.structs.replace(day.day, watch_fronts=watched)
    said: list[str] = []
    air = Air(seed=2)
    air.wind = create_site_wind(replace(day, day=of_day), said.append)
    air.blow(180.0)
    front_comes(air, (0.0, 9.0), 11.0, 10.0)
    assert [one.detections[0].member for one in air.wind.fronts] == ["d1"] * watched
    assert air.wind.is_wind_known_by_drones(air.t_s)
    assert said == ["front detection is off: the day states watch_fronts = false"] * (not watched)


def test_a_front_that_is_told_is_in_the_wind_that_flights_to_come_are_priced_in():
    """The front is at `d1`, not yet at the depot; without it the field would give about 7 m/s."""
    air = Air(seed=2)
    air.blow(180.0)
    before = measured_or_previous_launch_forecast(air.wind, air.t_s, FORECAST)
    at = front_comes(air, (0.0, 9.0), 11.0, 25.0)
    assert air.wind.fronts != []
    assert air.t_s < at["d4"], "only one has felt it"
    soon = measured_or_previous_launch_forecast(air.wind, air.t_s, FORECAST)
    assert before.speed_mps < 8.0
    assert soon.to_ne_mps == pytest.approx((0.0, 15.0), abs=2.0 * soon.std_mps)
    assert soon.speed_mps > 11.0
    assert soon.std_mps > before.std_mps


def test_a_wind_that_changes_for_all_at_once_is_said_to_do_so():
    air = Air(seed=2)
    air.blow(180.0)
    for mean in air.mean.values():
        mean[:] = (0.0, 15.0)
    air.blow(25.0)
    words = format_front(air.wind.fronts[-1], air.t_s, [("d2", PLACES["d2"])])
    assert "detected by d1, d2, d3, d4" in words
    assert "at all members at once" in words


def test_a_gust_that_was_told_as_a_front_is_withdrawn_and_is_in_nobodys_wind():
    air, gust = Air(seed=3), np.array([0.0, 9.0])
    air.blow(150.0)
    heard, said = air.wind.update_from_state, list[FrontUpdate]()

    def hear(state: State, t_s: float) -> FrontUpdate | None:
        news = heard(state, t_s)
        if news is not None:
            said.append(news)
        return news

    air.wind.update_from_state = hear  # type: ignore[method-assign]
    air.mean["d1"] += gust
    air.blow(15.0)
    air.mean["d1"] -= gust
    later_s = air.t_s + 60.0
    assert len(air.wind.fronts) == 1
    awaited = air.wind.wind_at(air.t_s, PLACES["d2"], 40.0, later_s)
    air.blow(40.0)
    assert [type(one) for one in said] == [WindFront, FrontWithdrawn]
    assert air.wind.fronts == []
    assert air.wind.drop_expired_and_get_fronts(air.t_s) == []
    found = air.wind.wind_at(air.t_s, PLACES["d2"], 40.0, later_s)
    assert found.speed_mps < 7.5 < awaited.speed_mps
    withdrawn = said[1]
    assert isinstance(withdrawn, FrontWithdrawn)
    stood_s = withdrawn.t_s - withdrawn.front.detected_s
    assert f"FRONT withdrawn, detected by d1 {stood_s:.0f} s ago" in format_withdrawal(withdrawn)


def test_the_canary_gusts_alone_make_no_front():
    air = Air(seed=4)
    air.blow(600.0)
    assert air.wind.fronts == []


def test_who_comes_down_to_land_in_weaker_wind_feels_no_front():
    """Descent from 40 m into a fifth of the wind."""
    air = Air(seed=2)
    for mean in air.mean.values():
        mean[:] = (0.0, 13.0)
    air.blow(180.0)
    air.mean["d1"][:] = (0.0, 3.0)
    for _ in range(25):
        air.blow(1.0, silent=frozenset({"d1"}))
        air.tell("d1", height_rel_m=12.0)
    assert air.wind.fronts == []


def test_who_climbs_out_of_weaker_wind_feels_no_front():
    """Climb from 12 m into four times the wind; the same rise at constant height is a front."""
    climbs, stays = Air(seed=2), Air(seed=2)
    for air in (climbs, stays):
        air.mean["d1"][:] = (0.0, 3.0)
        for _ in range(180):
            air.blow(1.0, silent=frozenset({"d1"}))
            air.tell("d1", height_rel_m=12.0 if air is climbs else 40.0)
        air.mean["d1"][:] = (0.0, 11.0)
        air.blow(25.0)
    assert climbs.wind.fronts == []
    assert [one.detections[0].member for one in stays.wind.fronts] == ["d1"]


def test_who_has_been_left_out_for_a_minute_raises_no_front():
    air = Air(seed=6)
    air.blow(120.0)
    air.mean["d4"] += (8.0, 0.0)
    air.blow(60.0)
    noticed = len(air.wind.fronts)  # its error may first look like a front
    air.blow(EXCLUSION_GRACE_S + 120.0)
    assert "d4" in air.wind.exclusion_reason_by_member(air.t_s)
    air.mean["d4"] -= (0.0, 14.0)
    air.blow(60.0)
    assert len(air.wind.fronts) == noticed


def test_a_wind_process_that_only_the_vehicles_have_is_said_and_keeps_no_desk_from_its_day():
    day = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
    mission = msgspec.structs.replace(day.day.mission, wind_process="/etc/leeway/moon.toml")
    said: list[str] = []
    moon = replace(day, day=msgspec.structs.replace(day.day, mission=mission))
    assert format_site_wind(create_site_wind(moon, said.append), 0.0) == ""
    assert said == [
        "wind field uses process coast: /etc/leeway/moon.toml: No such file or directory"
    ]


WILD = (0.0, -0.0, 1e-300, 1e300, -1e300, 1e6, 90.0, -90.0, 180.0, 3.0)


@pytest.mark.sample
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seed", range(6))
def test_whatever_numbers_members_tell_the_field_is_a_wind_or_nothing(seed):
    rng = np.random.default_rng(seed)
    wind = SiteWind(read_wind_process("coast"), DEPOT, FORECAST if seed % 2 else None)

    def number() -> float:
        return float(rng.choice(WILD) if rng.random() < 0.4 else rng.uniform(-20.0, 20.0))

    t_s, wild = 0.0, 0
    for _ in range(200):
        t_s += float(rng.choice([0.0, 0.1, 1.0, 10.0, 100.0]))
        nn, ee = (float(rng.choice([0.01, 1e-12, 4.0, 400.0])) for _ in range(2))
        more = {
            "lat_deg": 55.47 + float(rng.choice([0.0, 0.001, 1.0, -30.0])) * rng.random(),
            "height_rel_m": abs(number()),
            "wind_cov_m2ps2": (nn, float(rng.choice([0.0, 400.0, -1.0])), ee),
        }
        name = str(rng.choice(list(PLACES)))
        told = decode_message(
            State, encode_message(a_state(name, t_s, (number(), number()), **more))
        )
        assert isinstance(told, State)
        wind.update_from_state(told, t_s)
        for one in wind.drop_expired_and_get_fronts(t_s):
            assert "FRONT" in format_front(one, t_s, [("d9", (100.0, 100.0))])
        here = wind.wind_at_report_centroid(t_s)
        assert here is None or (here.speed_mps < 100.0 and 0.0 < here.larger_axis_std_mps < 100.0)
        wild += bool(wind.exclusion_reason_by_member(t_s))
    assert wild > 50
