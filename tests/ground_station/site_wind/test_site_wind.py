"""The field that a desk believes, from states as drones send them."""

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.core.wind_field.fronts import FrontAhead, FrontNews, FrontWithdrawn
from companion.fleet.messages import State, decode_state, encode
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.day_wind import site_wind_of
from ground_station.adapters.files.params import read_wind_process
from ground_station.core.dispatch.measured_wind import forecast_now, next_flights, off_sigmas
from ground_station.core.site_wind.site_belief import BACK_S
from ground_station.core.site_wind.site_fronts import FRONT_KEPT_S, OUT_S
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.tellers import KNOWN_S, LEAST_SPAN_S
from ground_station.core.site_wind.wind_words import field_words, front_words, withdrawn_words
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
    assert field_words(air.wind, 0.0) == ""
    air.blow(LEAST_SPAN_S - 1.0)
    assert air.wind.ahead(air.t_s, 300.0, 600.0) is None
    assert forecast_now(air.wind, air.t_s, FORECAST) == FORECAST
    air.blow(3.0)
    assert air.wind.ahead(air.t_s, 300.0, 600.0) is not None
    assert air.wind.ahead(air.t_s + KNOWN_S + 1.0, 300.0, 600.0) is None


def test_it_finds_the_wind_that_blows_and_says_it_in_a_line():
    air = Air()
    air.blow(300.0)
    here = air.wind.here(air.t_s)
    assert here is not None
    assert math.dist(here.to_ne_mps, (0.0, 6.0)) < 1.0
    assert 0.2 < here.std_mps < 1.2
    words = field_words(air.wind, air.t_s)
    assert f"wind {here.speed_mps:.1f} +- {here.std_mps:.1f} m/s from" in words
    assert "at 40 m, by 4 drones" in words


def test_it_is_surer_of_now_than_of_later_and_of_where_somebody_is_than_of_far_away():
    air = Air()
    air.blow(300.0)
    now_s, near, far = air.t_s, PLACES["d2"], (0.0, 8000.0)
    at = lambda place, t_s: air.wind.at(now_s, place, 40.0, t_s).std_mps  # noqa: E731
    assert at(near, now_s) < at(near, now_s + 60.0) < at(near, now_s + 1800.0)
    assert at(near, now_s) < at(far, now_s)
    assert air.wind.at(now_s, near, 120.0, now_s).std_mps > at(near, now_s)  # nobody is that high


def test_a_wind_that_the_forecast_did_not_have_is_planned_with_and_its_own_error():
    air = Air()
    for mean in air.mean.values():
        mean[:] = (10.0, 0.0)
    air.blow(240.0)
    assert off_sigmas(air.wind, air.t_s, FORECAST) > 3.0  # 11.7 m/s from it
    wind = forecast_now(air.wind, air.t_s, FORECAST)
    assert wind.speed_mps == pytest.approx(10.0, abs=1.5)
    soon = next_flights(air.wind, air.t_s, FORECAST)
    assert soon.std_mps < wind.std_mps
    assert off_sigmas(air.wind, air.t_s, wind) == pytest.approx(0.0, abs=1e-6)


def test_a_covariance_that_is_not_told_counts_as_a_large_one():
    told, untold = Air(seed=3), Air(seed=3, wind_cov_m2ps2=msgspec.UNSET)
    for air in (told, untold):
        air.blow(200.0)
    assert untold.wind.here(200.0).std_mps > 1.2 * told.wind.here(200.0).std_mps  # type: ignore[union-attr]


@pytest.mark.parametrize("more", [
    {"armed": False}, {"armed": None}, {"height_rel_m": 9.0}, {"height_rel_m": None},
    {"lat_deg": None}, {"wind_to_n_mps": None},
])  # fmt: skip
def test_who_is_not_in_the_air_or_does_not_say_where_tells_no_wind(more: dict[str, object]):
    air = Air(**more)
    air.blow(120.0)
    assert field_words(air.wind, air.t_s) == ""


@pytest.mark.parametrize(("who", "why"), [("liar", "contradicts"), ("frozen", "the same wind")])
def test_one_that_lies_or_is_frozen_is_left_out_said_and_moves_the_plan_by_less_than_its_error(
    who: str, why: str
):
    """The same air twice: with all honest, and with d4 lying by 8 m/s or frozen."""
    honest, told = Air(seed=5), Air(seed=5)
    honest.blow(400.0)
    told.blow(200.0)
    if who == "liar":
        told.mean["d4"] += (8.0, 0.0)
        told.blow(200.0)
        assert told.wind.fronts != [], "it looked like a front once: nobody can tell"
    else:
        stuck = tuple(round(float(x), 3) for x in told.mean["d4"] + (1.0, -1.0))
        for _ in range(200):
            told.blow(1.0, silent=frozenset({"d4"}))
            told.wind.on_state(a_state("d4", told.t_s, stuck), told.t_s)  # type: ignore[arg-type]
    assert why in told.wind.left_out(told.t_s)["d4"]
    assert "left out: d4" in field_words(told.wind, told.t_s)
    one, other = (next_flights(air.wind, air.t_s, FORECAST) for air in (honest, told))
    assert math.dist(one.to_ne_mps, other.to_ne_mps) < other.std_mps
    assert other.std_mps > 0.9 * one.std_mps  # who is left out makes nobody surer


def test_a_liar_that_tells_the_truth_again_is_believed_again_after_a_while():
    air = Air(seed=5)
    air.blow(150.0)
    air.mean["d4"] += (12.0, 0.0)
    air.blow(90.0)
    assert "d4" in air.wind.left_out(air.t_s)
    air.mean["d4"] -= (12.0, 0.0)
    air.blow(BACK_S - 30.0)
    assert "d4" in air.wind.left_out(air.t_s)
    air.blow(150.0)
    assert air.wind.left_out(air.t_s) == {}
    assert "by 4 drones" in field_words(air.wind, air.t_s)


def test_a_state_that_travelled_tells_the_same():
    air, by_wire = Air(seed=7), SiteWind(read_wind_process("coast"), DEPOT, FORECAST)
    for t in range(1, 100):
        air.t_s = float(t)
        for name in PLACES:
            air.tell(name)
            raw = encode(a_state(name, air.t_s, (0.0, 6.0)))
            told = decode_state(raw)
            assert isinstance(told, State)
            by_wire.on_state(told, air.t_s)
    assert field_words(by_wire, air.t_s) == field_words(air.wind, air.t_s)


# --- fronts --------------------------------------------------------------------------------------


def test_a_front_felt_by_one_is_told_with_place_speed_and_arrival_within_ten_seconds():
    air = Air(seed=2)
    air.blow(180.0)
    began_s = air.t_s
    at = front_comes(air, (0.0, 9.0), 11.0, 10.0)
    assert [one.felt[0].member for one in air.wind.fronts] == ["d1"]
    front = air.wind.fronts[0]
    assert front.noticed_s - began_s <= 10.0
    words = front_words(front, air.t_s, [(name, PLACES[name]) for name in ("d2", "d3")])
    assert "felt by d1" in words
    assert "d2 in " in words
    for name in ("d2", "d3", "d4"):
        t_s, std_s = front.arrives(PLACES[name])
        assert abs(t_s - at[name]) < 2.5 * std_s
        assert t_s > air.t_s, "it is told before it is there"
    air.t_s += FRONT_KEPT_S + 10.0
    assert air.wind.fronts_now(air.t_s) == []


@pytest.mark.parametrize("watched", [True, False])
def test_a_day_over_steep_ground_may_have_its_desk_look_for_no_fronts(watched: bool):
    day = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
    of_day = msgspec.structs.replace(day.day, watch_fronts=watched)
    said: list[str] = []
    air = Air(seed=2)
    air.wind = site_wind_of(replace(day, day=of_day), said.append)
    air.blow(180.0)
    front_comes(air, (0.0, 9.0), 11.0, 10.0)
    assert [one.felt[0].member for one in air.wind.fronts] == ["d1"] * watched
    assert air.wind.is_known(air.t_s)
    assert said == ["fronts are not looked for: the day says watch_fronts = false"] * (not watched)


def test_a_front_that_is_told_is_in_the_wind_that_flights_to_come_are_priced_in():
    """It is at `d1` and not at the depot yet; without it the field would say some 7 m/s."""
    air = Air(seed=2)
    air.blow(180.0)
    before = next_flights(air.wind, air.t_s, FORECAST)
    at = front_comes(air, (0.0, 9.0), 11.0, 25.0)
    assert air.wind.fronts != []
    assert air.t_s < at["d4"], "only one has felt it"
    soon = next_flights(air.wind, air.t_s, FORECAST)
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
    words = front_words(air.wind.fronts[-1], air.t_s, [("d2", PLACES["d2"])])
    assert "felt by d1, d2, d3, d4" in words
    assert "everywhere at once" in words


def test_a_gust_that_was_told_as_a_front_is_withdrawn_and_is_in_nobodys_wind():
    air, gust = Air(seed=3), np.array([0.0, 9.0])
    air.blow(150.0)
    heard, said = air.wind.on_state, list[FrontNews]()

    def hear(state: State, t_s: float) -> FrontNews | None:
        news = heard(state, t_s)
        if news is not None:
            said.append(news)
        return news

    air.wind.on_state = hear  # type: ignore[method-assign]
    air.mean["d1"] += gust
    air.blow(15.0)
    air.mean["d1"] -= gust
    later_s = air.t_s + 60.0
    assert len(air.wind.fronts) == 1
    awaited = air.wind.at(air.t_s, PLACES["d2"], 40.0, later_s)
    air.blow(40.0)
    assert [type(one) for one in said] == [FrontAhead, FrontWithdrawn]
    assert air.wind.fronts == []
    assert air.wind.fronts_now(air.t_s) == []
    found = air.wind.at(air.t_s, PLACES["d2"], 40.0, later_s)
    assert found.speed_mps < 7.5 < awaited.speed_mps
    withdrawn = said[1]
    assert isinstance(withdrawn, FrontWithdrawn)
    stood_s = withdrawn.t_s - withdrawn.front.noticed_s
    assert f"FRONT withdrawn, felt by d1 {stood_s:.0f} s ago" in withdrawn_words(withdrawn)


def test_the_canary_gusts_alone_make_no_front():
    air = Air(seed=4)
    air.blow(600.0)
    assert air.wind.fronts == []


def test_who_comes_down_to_land_in_weaker_wind_feels_no_front():
    """From 40 m into a fifth of the wind."""
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
    """From 12 m into four times the wind; the same rise at its height is a front."""
    climbs, stays = Air(seed=2), Air(seed=2)
    for air in (climbs, stays):
        air.mean["d1"][:] = (0.0, 3.0)
        for _ in range(180):
            air.blow(1.0, silent=frozenset({"d1"}))
            air.tell("d1", height_rel_m=12.0 if air is climbs else 40.0)
        air.mean["d1"][:] = (0.0, 11.0)
        air.blow(25.0)
    assert climbs.wind.fronts == []
    assert [one.felt[0].member for one in stays.wind.fronts] == ["d1"]


@pytest.mark.parametrize("seed", [2, 3, 4, 5])
def test_a_gust_front_that_one_drone_alone_has_felt_is_told(seed):
    """Of 10 m/s within 20 s: at most 15 s after it began; the next drone lies 45 s further on."""
    air = Air(seed=seed)
    air.blow(180.0)
    for second in range(15):
        air.mean["d1"][:] = (0.0, 6.0 + min(second + 1, 20) * 0.5)
        air.blow(1.0)
    assert [one.felt[0].member for one in air.wind.fronts] == ["d1"]


def test_who_has_been_left_out_for_a_minute_raises_no_front():
    air = Air(seed=6)
    air.blow(120.0)
    air.mean["d4"] += (8.0, 0.0)
    air.blow(60.0)
    noticed = len(air.wind.fronts)  # its lie looked like a front once, and nobody can tell
    air.blow(OUT_S + 120.0)
    assert "d4" in air.wind.left_out(air.t_s)
    air.mean["d4"] -= (0.0, 14.0)
    air.blow(60.0)
    assert len(air.wind.fronts) == noticed


def test_a_wind_process_that_only_the_vehicles_have_is_said_and_keeps_no_desk_from_its_day():
    day = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
    mission = msgspec.structs.replace(day.day.mission, wind_process="/etc/leeway/moon.toml")
    said: list[str] = []
    moon = replace(day, day=msgspec.structs.replace(day.day, mission=mission))
    assert field_words(site_wind_of(moon, said.append), 0.0) == ""
    assert said == [
        "the field of the wind goes by coast: /etc/leeway/moon.toml: No such file or directory"
    ]


WILD = (0.0, -0.0, 1e-300, 1e300, -1e300, 1e6, 90.0, -90.0, 180.0, 3.0)


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
        told = decode_state(encode(a_state(name, t_s, (number(), number()), **more)))
        assert isinstance(told, State)
        wind.on_state(told, t_s)
        for one in wind.fronts_now(t_s):
            assert "FRONT" in front_words(one, t_s, [("d9", (100.0, 100.0))])
        here = wind.here(t_s)
        assert here is None or (here.speed_mps < 100.0 and 0.0 < here.std_mps < 100.0)
        wild += bool(wind.left_out(t_s))
    assert wild > 50
