"""Wind stations together with drones: used at their position, and effects of faulty ones."""

import math

import pytest

from ground_station.core.dispatch.measured_wind import measured_or_previous_launch_forecast
from ground_station.core.fleet.station_message import (
    StationWind,
    decode_station_wind,
    encode_station_wind,
)
from ground_station.core.schema.day import Forecast, WindStation
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_reporters import MIN_SPAN_S, REPORT_TIMEOUT_S
from ground_station.core.site_wind.wind_stations import MAX_AGE_S, MAX_LEAD_S, StationRegistry
from ground_station.core.site_wind.wind_texts import format_site_wind
from tests.ground_station.site_wind.told_air import DEPOT, FORECAST, M_PER_DEG, Air

EPOCH_US = 1_780_000_000_000_000


def mast(name: str = "mast", east_m: float = 900.0, height_m: float = 40.0) -> WindStation:
    lon_deg = DEPOT[1] + east_m / M_PER_DEG / math.cos(math.radians(DEPOT[0]))
    return WindStation(id=name, lat_deg=DEPOT[0], lon_deg=lon_deg, height_m=height_m)


class Masts:
    """The drones' air, and stations that report every ten seconds."""

    def __init__(self, *stations: WindStation, seed: int = 1) -> None:
        self.air = Air(seed)
        self.wind: SiteWind = self.air.wind
        self.book = StationRegistry.from_day(self.wind, stations)
        self.check_alert_sent = {one.id: (6.0, 270.0) for one in stations}
        self.off_us = 0
        self.gust = 0.0

    def now_us(self) -> int:
        return EPOCH_US + round(self.air.t_s * 1e6)

    def word(self, name: str) -> StationWind:
        speed_mps, from_deg = self.check_alert_sent[name]
        self.gust = 0.15 * math.sin(self.air.t_s)  # no two reports are equal
        return StationWind(
            station=name,
            epoch_us=self.now_us() + self.off_us,
            speed_mps=speed_mps + self.gust,
            from_deg=from_deg,
        )

    def blow(self, for_s: float, *, drones: bool = True, mute: frozenset[str] = frozenset()):
        until_s = self.air.t_s + for_s
        everybody = frozenset(self.air.mean)
        while self.air.t_s < until_s:
            self.air.blow(1.0, frozenset() if drones else everybody)
            if round(self.air.t_s) % 10 == 0:
                for name in self.check_alert_sent.keys() - mute:
                    self.book.record_station_message(self.word(name), self.air.t_s, self.now_us())

    @property
    def now_s(self) -> float:
        return self.air.t_s


def test_a_station_is_heard_at_its_place_and_height_beside_the_drones():
    site = Masts(mast())
    site.blow(300.0)
    assert "by 4 drones and 1 station" in format_site_wind(site.wind, site.now_s)
    (told,) = [o for o in site.wind.latest_accepted_reports(site.now_s) if o.member == "mast"]
    assert told.position_ne_m[1] == pytest.approx(900.0, rel=0.01)
    assert told.height_m == 40.0
    assert told.mean_to_ne_mps == pytest.approx((0.0, 6.0), abs=0.2)
    # At its position the field is more certain with it than without it.
    alone = Masts(mast())
    alone.check_alert_sent.clear()
    alone.blow(300.0)
    there = (0.0, 900.0)
    with_it = site.wind.wind_at(site.now_s, there, 40.0, site.now_s).larger_axis_std_mps
    assert with_it < alone.wind.wind_at(alone.now_s, there, 40.0, alone.now_s).larger_axis_std_mps
    (note,) = site.book.station_status_lines(site.now_s)
    assert note.startswith("station mast: ")
    assert "m/s from 270 at 40 m" in note


@pytest.mark.sample
@pytest.mark.parametrize("lie", [(25.0, 270.0), (0.5, 90.0), (6.0, 90.0)])
def test_one_that_lies_is_left_out_by_the_drones_and_changes_nothing_for_the_next_flights(lie):
    honest, told = Masts(mast(), seed=5), Masts(mast(), seed=5)
    honest.check_alert_sent.clear()
    told.blow(120.0)
    honest.blow(120.0)
    told.check_alert_sent["mast"] = lie
    told.blow(120.0)
    honest.blow(120.0)
    assert "differs from the drones" in told.book.reason_by_unused_station(told.now_s)["mast"]
    assert "excluded: mast" in format_site_wind(told.wind, told.now_s)
    assert told.wind.fronts == []
    one, other = (
        measured_or_previous_launch_forecast(s.wind, s.now_s, FORECAST) for s in (honest, told)
    )
    assert math.dist(one.to_ne_mps, other.to_ne_mps) < 0.05
    assert other.std_mps == pytest.approx(one.std_mps, abs=0.05)


def test_one_drone_is_not_silenced_by_a_station_that_lies_nor_by_two():
    """With two drones alone both would be excluded: the faulty one cannot be identified."""
    site = Masts(mast("a"), mast("b", -900.0))
    site.check_alert_sent = {"a": (20.0, 90.0), "b": (20.0, 90.0)}
    for _ in range(30):
        everybody = frozenset(site.air.mean) - {"d1"}
        for _ in range(10):
            site.air.blow(1.0, everybody)
        for name in site.check_alert_sent:
            site.book.record_station_message(site.word(name), site.now_s, site.now_us())
    told = {one.member for one in site.wind.latest_accepted_reports(site.now_s)}
    assert told == {"d1"}
    assert site.wind.is_wind_known_by_drones(site.now_s)


def test_a_mute_one_is_named_after_two_minutes_and_one_that_was_never_heard_too():
    site = Masts(mast(), mast("pier", 300.0))
    del site.check_alert_sent["pier"]
    site.blow(60.0)
    assert site.book.reason_by_unused_station(site.now_s) == {}
    site.blow(REPORT_TIMEOUT_S + 40.0, mute=frozenset({"mast"}))
    troubles = site.book.reason_by_unused_station(site.now_s)
    assert troubles == {"mast": "silent for 2 min", "pier": "no message received"}
    assert "by 4 drones" in format_site_wind(site.wind, site.now_s)
    assert "station" not in format_site_wind(site.wind, site.now_s)


@pytest.mark.parametrize(
    ("off_s", "words"),
    [(-MAX_AGE_S - 2.0, "22 s old"), (MAX_LEAD_S + 4.0, "9 s ahead of the clock")],
)
def test_words_of_another_time_are_not_used(off_s, words):
    site = Masts(mast())
    site.off_us = round(off_s * 1e6)
    site.blow(120.0)
    assert site.book.reason_by_unused_station(site.now_s) == {"mast": words}
    site.off_us = 0
    site.blow(60.0)
    assert site.book.reason_by_unused_station(site.now_s) == {}, (
        "a clock that was ahead silences nothing after it"
    )


def test_what_was_told_once_counts_once_however_often_it_is_played():
    site = Masts(mast())
    site.blow(120.0)
    old = site.word("mast")
    site.blow(10.0)
    before = site.wind.latest_accepted_reports(site.now_s)
    for _ in range(50):
        assert site.book.record_station_message(old, site.now_s, site.now_us()) is None
    assert site.wind.latest_accepted_reports(site.now_s) == before


def test_a_station_that_the_day_does_not_name_is_not_used_and_its_own_place_not_looked_at():
    site = Masts(mast())
    word = site.word("mast")
    site.check_alert_sent["stranger"] = (6.0, 270.0)
    site.blow(60.0)
    assert site.book.reason_by_unused_station(site.now_s)["stranger"] == "not a station of the day"
    moved = StationWind(
        station="mast", epoch_us=site.now_us() + 10, speed_mps=word.speed_mps,
        from_deg=word.from_deg, lat_deg=0.0, lon_deg=0.0, height_m=3.0,
    )  # fmt: skip
    site.blow(9.0)
    site.book.record_station_message(moved, site.now_s, site.now_us())
    (told,) = [o for o in site.wind.latest_accepted_reports(site.now_s) if o.member == "mast"]
    assert told.position_ne_m[1] == pytest.approx(900.0, rel=0.01)


def test_without_a_day_it_is_where_it_says():
    site = Masts(mast())
    book = StationRegistry(site.wind)
    place = mast()
    said = StationWind(
        station="mast", epoch_us=site.now_us(), speed_mps=6.0, from_deg=270.0,
        lat_deg=place.lat_deg, lon_deg=place.lon_deg, height_m=40.0,
    )  # fmt: skip
    book.record_station_message(said, 0.0, site.now_us())
    assert [one.member for one in site.wind.latest_accepted_reports(0.0)] == ["mast"]
    nowhere = StationWind(station="x", epoch_us=site.now_us(), speed_mps=6.0, from_deg=270.0)
    book.record_station_message(nowhere, 0.0, site.now_us())
    assert book.reason_by_unused_station(0.0)["x"] == "no position"


# --- before any drone is in the air --------------------------------------------------------------


def flights_of(site: Masts) -> Forecast:
    return measured_or_previous_launch_forecast(site.wind, site.now_s, FORECAST)


def test_alone_it_may_make_the_desk_more_careful_and_never_less():
    """The forecast is 6 m/s with a standard deviation of 2."""
    more, less = Masts(mast()), Masts(mast())
    more.check_alert_sent["mast"], less.check_alert_sent["mast"] = (9.5, 270.0), (2.5, 270.0)
    for site in (more, less):
        site.blow(MIN_SPAN_S + 60.0, drones=False)
        assert site.book.reason_by_unused_station(site.now_s) == {}
        assert not site.wind.is_wind_known_by_drones(site.now_s)
    assert flights_of(more).speed_mps > 8.0
    assert flights_of(more).std_mps >= FORECAST.std_mps
    assert flights_of(less) == FORECAST


@pytest.mark.parametrize("lie", [(30.0, 270.0), (25.0, 90.0)])
def test_alone_against_the_forecast_it_stops_nothing_and_is_said(lie):
    site = Masts(mast())
    site.check_alert_sent["mast"] = lie
    site.blow(180.0, drones=False)
    assert (
        "differs from the forecast: 6.0 m/s"
        in site.book.reason_by_unused_station(site.now_s)["mast"]
    )
    assert site.wind.latest_accepted_reports(site.now_s) == []
    assert flights_of(site) == FORECAST


def test_two_stations_that_agree_on_what_the_forecast_did_not_have_are_believed():
    site = Masts(mast("a"), mast("b", -900.0))
    site.blow(60.0, drones=False)
    for name in site.check_alert_sent:
        site.check_alert_sent[name] = (12.0, 270.0)
    site.blow(480.0, drones=False)
    assert site.book.reason_by_unused_station(site.now_s) == {}
    assert flights_of(site).speed_mps > 9.0  # the forecast: 6


def test_a_jump_at_one_station_is_no_front_and_at_a_station_and_a_drone_it_is():
    alone = Masts(mast("mast", -1200.0))
    alone.blow(200.0)
    alone.check_alert_sent["mast"] = (15.0, 270.0)
    alone.blow(40.0)
    assert alone.wind.fronts == []
    both = Masts(mast("mast", -1200.0))
    both.blow(200.0)
    both.check_alert_sent["mast"] = (15.0, 270.0)
    both.blow(80.0)  # 800 m at 10 m/s
    both.air.mean["d1"] = both.air.mean["d1"] + (0.0, 9.0)
    both.blow(25.0)
    assert both.wind.fronts != []


# --- message format ------------------------------------------------------------------------------


def test_a_word_travels_and_what_is_none_is_refused():
    word = StationWind(station="mast", epoch_us=5, speed_mps=6.0, from_deg=270.0, std_mps=0.5)
    assert decode_station_wind(encode_station_wind(word)) == word
    for raw in (
        b"{}",
        b"x" * 600,
        encode_station_wind(word).replace(b'"v":2', b'"v":1'),
        encode_station_wind(word).replace(b"6.0", b"600.0"),
        encode_station_wind(word).replace(b"270.0", b"-3.0"),
        encode_station_wind(word).replace(b"mast", b"../mast"),
        encode_station_wind(word)[:-1] + b',"more":1}',
    ):
        assert hasattr(decode_station_wind(raw), "reason"), raw
