"""A forecast that is followed: its bias by closed forms, newer files, and its end."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.followed_file import LOOK_S, FollowedFile
from ground_station.adapters.files.forecast_open_meteo import read_open_meteo
from ground_station.adapters.files.forecast_readers import ForecastPlace, InlineReader
from ground_station.core.schema.day_forecast import FORGOTTEN_S, DayForecast, ForecastBias
from ground_station.core.site_wind.followed_forecast import OUTLASTED_STD_MPS, FollowedForecast
from ground_station.core.site_wind.forecast_record import (
    EVERY_S,
    KEPT_S,
    LEAST_LOOKS,
    STALE_S,
    ForecastLook,
    ForecastRecord,
)
from ground_station.core.weather.forecast_field import OutsideForecast, WindAt
from tests.ground_station.weather.open_meteo import START_S, answer, written

HOUR_S = 3600.0


class Clock:
    """Monotonic and wall clock, an hour of the day apart from one another."""

    def __init__(self, t_s: float = 50.0) -> None:
        self.t_s = t_s

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return round((START_S + self.t_s - 50.0) * 1e6)


def followed(path: Path, clock: Clock, per_hour_mps: float = 3.0) -> FollowedForecast:
    """From the west, 4 m/s at noon and more each hour."""
    written(path, answer(lambda hour, _: (4.0 + per_hour_mps * hour, 270.0)))
    field = read_open_meteo(path, 55.47, 8.45)
    return FollowedForecast(DayForecast(field, START_S, 55.47, 8.45), clock, 40.0)


def test_the_wind_is_that_of_the_hour_and_not_that_of_when_it_was_read(tmp_path):
    clock = Clock()
    follows = followed(tmp_path / "w.json", clock)
    for hours in (0.0, 1.0, 2.5):
        clock.t_s = 50.0 + hours * HOUR_S
        assert follows.expected(clock.t_s).speed_mps == pytest.approx(4.0 + 3.0 * hours)
        assert follows.expected(clock.t_s + HOUR_S).speed_mps == pytest.approx(7.0 + 3.0 * hours)


def test_a_wall_clock_that_is_set_moves_the_hour(tmp_path):
    clock = Clock()
    follows = followed(tmp_path / "w.json", clock)
    off_us = round(HOUR_S * 1e6)
    clock.epoch_us = lambda: round(START_S * 1e6) + off_us  # type: ignore[method-assign]
    assert follows.expected(clock.t_s).speed_mps == pytest.approx(7.0)


def test_what_it_is_off_by_is_forgotten_as_an_ornstein_uhlenbeck_process():
    """Conditional mean and variance (Gardiner 1985, 4.4.4), at once and after two e-folds."""
    wind, bias = WindAt((0.0, 5.0), 2.0), ForecastBias(100.0, (3.0, -1.0), 0.5)
    now = bias.corrected(wind, 100.0)
    assert now.to_ne_mps == pytest.approx((3.0, 4.0))
    assert now.std_mps == pytest.approx(0.5)
    later = bias.corrected(wind, 100.0 + 2.0 * FORGOTTEN_S)
    share = math.exp(-2.0)
    assert later.to_ne_mps == pytest.approx((3.0 * share, 5.0 - share))
    variance = 4.0 + share**2 * (0.25 - 4.0)
    assert later.std_mps == pytest.approx(math.sqrt(variance))


def test_a_bias_beyond_the_forecasts_own_error_stays_and_its_error_grows_to_its_size():
    wind = WindAt((0.0, 5.0), 2.0)
    bias = ForecastBias(0.0, (6.0, 0.0), 0.5, lasts=True)
    later = bias.corrected(wind, 20.0 * FORGOTTEN_S)
    assert later.to_ne_mps == pytest.approx((6.0, 5.0))
    assert later.std_mps == pytest.approx(6.0)


def test_a_day_that_begins_at_another_time_has_the_same_winds(tmp_path):
    clock = Clock()
    now = replace(
        followed(tmp_path / "w.json", clock).now, bias=ForecastBias(50.0, (1.0, 0.0), 1.0)
    )
    moved = now.counted_from(START_S - 600.0)
    for t_s in (50.0, 4000.0):
        one, other = now.wind(t_s, 60.0), moved.wind(t_s - 50.0 + 600.0, 60.0)
        assert isinstance(one, WindAt)
        assert isinstance(other, WindAt)
        assert one.to_ne_mps == pytest.approx(other.to_ne_mps)
        assert one.std_mps == pytest.approx(other.std_mps)


# --- against what was felt -----------------------------------------------------------------------


def looks(record: ForecastRecord, off: list[tuple[float, float]], from_s: float = 0.0) -> float:
    t_s = from_s
    for one in off:
        record.note(ForecastLook(t_s, one, 0.4, 2.0))
        t_s += EVERY_S
    return t_s - EVERY_S


def test_bias_and_spread_are_mean_and_standard_deviation_of_the_last_half_hour():
    record = ForecastRecord()
    rng = np.random.default_rng(1)
    old = [(9.0, 9.0)] * 20
    new = [tuple(row) for row in rng.normal((1.0, -2.0), 0.8, (30, 2)).tolist()]
    now_s = looks(record, old + new)
    score = record.score(now_s)
    assert score is not None
    assert score.looks == KEPT_S / EVERY_S == 30  # the old ones are gone
    assert score.bias.ne_mps == pytest.approx(np.mean(new, axis=0))
    assert score.spread_mps == pytest.approx(math.sqrt(np.var(new, axis=0, ddof=1).mean()))
    assert not score.is_off
    assert "the forecast of the last half hour: off by" in score.words


def test_a_forecast_that_is_off_by_more_than_its_own_error_is_said_to_be():
    fine, off = ForecastRecord(), ForecastRecord()
    now_s = looks(fine, [(1.9, -1.9)] * 10)
    looks(off, [(2.1, -2.1)] * 10)
    assert not fine.score(now_s).is_off  # type: ignore[union-attr]
    score = off.score(now_s)
    assert score is not None
    assert score.is_off
    assert "FORECAST OFF: off by 3.0 m/s (north +2.1, east -2.1)" in score.words
    assert "the fleet is believed" in score.words


def test_a_few_looks_or_old_ones_say_nothing():
    record = ForecastRecord()
    now_s = looks(record, [(5.0, 0.0)] * (LEAST_LOOKS - 1))
    assert record.score(now_s) is None
    now_s = looks(record, [(5.0, 0.0)], now_s + EVERY_S)
    assert record.score(now_s) is not None
    assert record.score(now_s + STALE_S + 1.0) is None
    record.note(ForecastLook(now_s + 60.0, (math.nan, 0.0), 0.4, 2.0))
    assert record.score(now_s).bias.ne_mps == (5.0, 0.0)  # type: ignore[union-attr]


def test_a_newer_file_begins_without_a_bias_and_one_that_says_nothing_of_now_is_refused(tmp_path):
    clock = Clock()
    follows = followed(tmp_path / "w.json", clock)
    clock.t_s = 50.0 + looks(follows.record, [(3.0, 0.0)] * 10)
    assert follows.now.bias is not None
    other = read_open_meteo(
        written(tmp_path / "n.json", answer(lambda hour, _: (11.0, 90.0))), 55.47, 8.45
    )
    follows.take(other)
    assert follows.version == 1
    assert follows.now.bias is None
    assert follows.expected(clock.t_s).speed_mps == pytest.approx(11.0)
    clock.t_s += 10.0 * HOUR_S
    with pytest.raises(LeewayError, match="is outside the forecast's"):
        follows.take(read_open_meteo(tmp_path / "w.json", 55.47, 8.45))
    assert follows.version == 1


def test_after_its_end_its_last_wind_counts_with_a_larger_error(tmp_path):
    clock = Clock()
    follows = followed(tmp_path / "w.json", clock)
    clock.t_s = 50.0 + 4.9 * HOUR_S
    last = follows.expected(clock.t_s)
    assert not follows.has_ended
    clock.t_s += HOUR_S
    assert follows.has_ended
    assert isinstance(follows.now.wind(clock.t_s, 40.0), OutsideForecast)
    after = follows.expected(clock.t_s)
    assert after.speed_mps == last.speed_mps
    assert after.std_mps == OUTLASTED_STD_MPS > last.std_mps
    fresh = FollowedForecast(follows.given, clock, 40.0)  # a desk that begins after its end
    assert fresh.expected(clock.t_s).speed_mps == pytest.approx(19.0)


# --- the file on the disk ------------------------------------------------------------------------


def test_a_file_is_read_once_it_has_stopped_changing_and_what_is_wrong_with_it_is_said_once(
    tmp_path,
):
    path = written(tmp_path / "w.json", answer(lambda hour, _: (4.0, 270.0)))
    file = FollowedFile(ForecastPlace(path, 55.47, 8.45), InlineReader())
    t_s = 0.0

    def look():
        nonlocal t_s
        t_s += LOOK_S
        return file.look(t_s)

    assert [look() for _ in range(3)] == [None] * 3
    whole = path.read_text()
    written(path, answer(lambda hour, _: (9.0, 270.0)))
    whole_new = path.read_text()
    path.write_text(whole_new[: len(whole_new) // 2])
    assert look() is None  # it may be being written
    path.write_text(whole_new[: len(whole_new) // 2 + 100])
    assert look() is None  # it is
    assert file.look(t_s + 1.0) is None  # not each turn
    torn = look()
    assert isinstance(torn, LeewayError)
    assert str(path) in str(torn)
    assert look() is None  # once
    path.write_text(whole_new)
    assert look() is None
    read = look()
    assert not isinstance(read, LeewayError)
    assert read is not None
    found = read.at(START_S, 40.0, 55.47, 8.45)
    assert isinstance(found, WindAt)
    assert found.speed_mps == pytest.approx(9.0)
    path.unlink()
    assert look() is None
    gone = look()
    assert isinstance(gone, LeewayError)
    assert "No such file" in str(gone)
    path.write_text(whole)
    assert look() is None
    assert not isinstance(look(), LeewayError | type(None))


def test_the_very_file_that_was_read_is_not_read_again(tmp_path):
    path = written(tmp_path / "w.json", answer(lambda hour, _: (4.0, 270.0)))
    reads: list[Path] = []

    def read(path, lat_deg, lon_deg):
        reads.append(path)
        return read_open_meteo(path, lat_deg, lon_deg)

    file = FollowedFile(ForecastPlace(path, 55.47, 8.45), InlineReader(read))
    for k in range(10):
        file.look(k * LOOK_S)
    assert reads == []
