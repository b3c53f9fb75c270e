"""A followed forecast: its bias by closed forms, newer files, and its end."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.forecast_open_meteo import read_open_meteo_forecast
from ground_station.adapters.files.watched_file import (
    POLL_INTERVAL_S,
    ForecastFileMonitor,
    ForecastLocation,
    create_inline_reader,
    read_forecast_at,
)
from ground_station.adapters.workers.beside import InlineWorker
from ground_station.core.schema.day_forecast import BIAS_DECAY_S, DayForecast, ForecastBias
from ground_station.core.site_wind.corrected_forecast import AFTER_END_STD_MPS, ForecastTracker
from ground_station.core.site_wind.forecast_record import (
    INTERVAL_S,
    MIN_COMPARISONS,
    STALE_S,
    WINDOW_S,
    ForecastComparison,
    ForecastRecord,
)
from ground_station.core.weather.forecast_field import OutsideForecast, WindAt
from tests.ground_station.desk_parts import HandClock
from tests.ground_station.weather.open_meteo import START_S, answer, written

HOUR_S = 3600.0


def a_clock() -> HandClock:
    return HandClock(50.0, START_S - 50.0)


def followed(path: Path, clock: HandClock, per_hour_mps: float = 3.0) -> ForecastTracker:
    """Follow a forecast from the west: 4 m/s at noon, rising each hour."""
    written(path, answer(lambda hour, _: (4.0 + per_hour_mps * hour, 270.0)))
    field = read_open_meteo_forecast(path, 55.47, 8.45)
    return ForecastTracker(DayForecast(field, START_S, 55.47, 8.45), clock, 40.0)


def test_the_wind_is_that_of_the_hour_and_not_that_of_when_it_was_read(tmp_path):
    clock = a_clock()
    follows = followed(tmp_path / "w.json", clock)
    for hours in (0.0, 1.0, 2.5):
        clock.t_s = 50.0 + hours * HOUR_S
        assert follows.expected_cruise_wind(clock.t_s).speed_mps == pytest.approx(4.0 + 3.0 * hours)
        assert follows.expected_cruise_wind(clock.t_s + HOUR_S).speed_mps == pytest.approx(
            7.0 + 3.0 * hours
        )


def test_a_wall_clock_that_is_set_moves_the_hour(tmp_path):
    clock = a_clock()
    follows = followed(tmp_path / "w.json", clock)
    off_us = round(HOUR_S * 1e6)
    clock.epoch_us = lambda: round(START_S * 1e6) + off_us  # type: ignore[method-assign]
    assert follows.expected_cruise_wind(clock.t_s).speed_mps == pytest.approx(7.0)


def test_what_it_is_off_by_is_forgotten_as_an_ornstein_uhlenbeck_process():
    """Conditional mean and variance (Gardiner 1985, 4.4.4), at once and after two time scales."""
    wind, bias = WindAt((0.0, 5.0), 2.0), ForecastBias(100.0, (3.0, -1.0), 0.5)
    now = bias.corrected_wind(wind, 100.0)
    assert now.to_ne_mps == pytest.approx((3.0, 4.0))
    assert now.std_mps == pytest.approx(0.5)
    later = bias.corrected_wind(wind, 100.0 + 2.0 * BIAS_DECAY_S)
    share = math.exp(-2.0)
    assert later.to_ne_mps == pytest.approx((3.0 * share, 5.0 - share))
    variance = 4.0 + share**2 * (0.25 - 4.0)
    assert later.std_mps == pytest.approx(math.sqrt(variance))


def test_a_bias_beyond_the_forecasts_own_error_stays_and_its_error_grows_to_its_size():
    wind = WindAt((0.0, 5.0), 2.0)
    bias = ForecastBias(0.0, (6.0, 0.0), 0.5, is_persistent=True)
    later = bias.corrected_wind(wind, 20.0 * BIAS_DECAY_S)
    assert later.to_ne_mps == pytest.approx((6.0, 5.0))
    assert later.std_mps == pytest.approx(6.0)


def test_a_day_that_begins_at_another_time_has_the_same_winds(tmp_path):
    clock = a_clock()
    now = replace(
        followed(tmp_path / "w.json", clock).current_forecast_with_bias,
        bias=ForecastBias(50.0, (1.0, 0.0), 1.0),
    )
    moved = now.with_day_start(START_S - 600.0)
    for t_s in (50.0, 4000.0):
        one, other = (
            now.wind_at_day_time(t_s, 60.0),
            moved.wind_at_day_time(t_s - 50.0 + 600.0, 60.0),
        )
        assert isinstance(one, WindAt)
        assert isinstance(other, WindAt)
        assert one.to_ne_mps == pytest.approx(other.to_ne_mps)
        assert one.std_mps == pytest.approx(other.std_mps)


# --- against measured wind -----------------------------------------------------------------------


def looks(record: ForecastRecord, off: list[tuple[float, float]], from_s: float = 0.0) -> float:
    t_s = from_s
    for one in off:
        record.add_comparison(ForecastComparison(t_s, one, 0.4, 2.0))
        t_s += INTERVAL_S
    return t_s - INTERVAL_S


def test_bias_and_spread_are_mean_and_standard_deviation_of_the_last_half_hour():
    record = ForecastRecord()
    rng = np.random.default_rng(1)
    old = [(9.0, 9.0)] * 20
    new = [tuple(row) for row in rng.normal((1.0, -2.0), 0.8, (30, 2)).tolist()]
    now_s = looks(record, old + new)
    score = record.score_of_recent_comparisons(now_s)
    assert score is not None
    assert score.comparison_count == WINDOW_S / INTERVAL_S == 30  # older entries are dropped
    assert score.bias.ne_mps == pytest.approx(np.mean(new, axis=0))
    assert score.spread_mps == pytest.approx(math.sqrt(np.var(new, axis=0, ddof=1).mean()))
    assert not score.is_bias_above_stated_error
    assert "the forecast of the last half hour: off by" in score.score_text


def test_a_forecast_that_is_off_by_more_than_its_own_error_is_said_to_be():
    fine, off = ForecastRecord(), ForecastRecord()
    now_s = looks(fine, [(1.9, -1.9)] * 10)
    looks(off, [(2.1, -2.1)] * 10)
    assert not fine.score_of_recent_comparisons(now_s).is_bias_above_stated_error  # type: ignore[union-attr]
    score = off.score_of_recent_comparisons(now_s)
    assert score is not None
    assert score.is_bias_above_stated_error
    assert "FORECAST OFF: off by 3.0 m/s (north +2.1, east -2.1)" in score.score_text
    assert "using the fleet's wind" in score.score_text


def test_a_few_looks_or_old_ones_say_nothing():
    record = ForecastRecord()
    now_s = looks(record, [(5.0, 0.0)] * (MIN_COMPARISONS - 1))
    assert record.score_of_recent_comparisons(now_s) is None
    now_s = looks(record, [(5.0, 0.0)], now_s + INTERVAL_S)
    assert record.score_of_recent_comparisons(now_s) is not None
    assert record.score_of_recent_comparisons(now_s + STALE_S + 1.0) is None
    record.add_comparison(ForecastComparison(now_s + 60.0, (math.nan, 0.0), 0.4, 2.0))
    assert record.score_of_recent_comparisons(now_s).bias.ne_mps == (5.0, 0.0)  # type: ignore[union-attr]


def test_a_newer_file_begins_without_a_bias_and_one_that_says_nothing_of_now_is_refused(tmp_path):
    clock = a_clock()
    follows = followed(tmp_path / "w.json", clock)
    clock.t_s = 50.0 + looks(follows.record, [(3.0, 0.0)] * 10)
    assert follows.current_forecast_with_bias.bias is not None
    other = read_open_meteo_forecast(
        written(tmp_path / "n.json", answer(lambda hour, _: (11.0, 90.0))), 55.47, 8.45
    )
    follows.replace_forecast_and_clear_record(other)
    assert follows.version == 1
    assert follows.current_forecast_with_bias.bias is None
    assert follows.expected_cruise_wind(clock.t_s).speed_mps == pytest.approx(11.0)
    clock.t_s += 10.0 * HOUR_S
    with pytest.raises(LeewayError, match="is outside the forecast's"):
        follows.replace_forecast_and_clear_record(
            read_open_meteo_forecast(tmp_path / "w.json", 55.47, 8.45)
        )
    assert follows.version == 1


def test_after_its_end_its_last_wind_counts_with_a_larger_error(tmp_path):
    clock = a_clock()
    follows = followed(tmp_path / "w.json", clock)
    clock.t_s = 50.0 + 4.9 * HOUR_S
    last = follows.expected_cruise_wind(clock.t_s)
    assert not follows.has_forecast_ended
    clock.t_s += HOUR_S
    assert follows.has_forecast_ended
    assert isinstance(
        follows.current_forecast_with_bias.wind_at_day_time(clock.t_s, 40.0), OutsideForecast
    )
    after = follows.expected_cruise_wind(clock.t_s)
    assert after.speed_mps == last.speed_mps
    assert after.std_mps == AFTER_END_STD_MPS > last.std_mps
    fresh = ForecastTracker(follows.base_forecast, clock, 40.0)  # a desk that starts after its end
    assert fresh.expected_cruise_wind(clock.t_s).speed_mps == pytest.approx(19.0)


# --- file on disk --------------------------------------------------------------------------------


def test_a_file_is_read_once_it_has_stopped_changing_and_what_is_wrong_with_it_is_said_once(
    tmp_path,
):
    path = written(tmp_path / "w.json", answer(lambda hour, _: (4.0, 270.0)))
    file = ForecastFileMonitor(ForecastLocation(path, 55.47, 8.45), create_inline_reader())
    t_s = 0.0

    def look():
        nonlocal t_s
        t_s += POLL_INTERVAL_S
        return file.start_read_if_changed_and_take_result(t_s)

    assert [look() for _ in range(3)] == [None] * 3
    whole = path.read_text()
    written(path, answer(lambda hour, _: (9.0, 270.0)))
    whole_new = path.read_text()
    path.write_text(whole_new[: len(whole_new) // 2])
    assert look() is None  # a write may be in progress
    path.write_text(whole_new[: len(whole_new) // 2 + 100])
    assert look() is None  # it is
    assert file.start_read_if_changed_and_take_result(t_s + 1.0) is None  # not in each cycle
    torn = look()
    assert isinstance(torn, LeewayError)
    assert str(path) in str(torn)
    assert look() is None  # reported once
    path.write_text(whole_new)
    assert look() is None
    read = look()
    assert not isinstance(read, LeewayError)
    assert read is not None
    found = read.wind_at_unix_time(START_S, 40.0, 55.47, 8.45)
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

    def read(place):
        reads.append(place.path)
        return read_forecast_at(place)

    file = ForecastFileMonitor(ForecastLocation(path, 55.47, 8.45), InlineWorker(read))
    for k in range(10):
        file.start_read_if_changed_and_take_result(k * POLL_INTERVAL_S)
    assert reads == []
