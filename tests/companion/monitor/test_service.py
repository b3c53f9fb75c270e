"""The monitor through flights, days, restarts and resets; invalid figures are ignored."""

import json
import math

import msgspec
import pytest

from companion.core.base.errors import LeewayError
from companion.core.monitor.corrections import NO_CORRECTIONS, monitor_corrections_for_pack
from companion.core.monitor.flight_evidence import FlightEvidence, LogRatio
from companion.core.monitor.promises import DRAW, DRAW_STD
from companion.core.monitor.record import ServiceRecord, service_record_from_dict
from companion.core.monitor.service import (
    LOST_FLIGHTS,
    log_e_value,
    new_service_record,
    reset_evidence_of_subject,
    service_record_with_flight,
)

NAN = math.nan
HOUR_S, DAY_S = 3600.0, 86400.0


def figures(draw=0.0, pack=None, misses=0, checks=0):
    told = None if pack is None else LogRatio(pack, 0.055)
    return FlightEvidence(LogRatio(draw, DRAW_STD), told, misses, checks)


def flown(service, told, *, flights, per_day=10, pack="A", first=0):
    """Add flights with the same figures, one hour between them, on separate days."""
    for number in range(first, first + flights):
        day, hour = divmod(number, per_day)
        service = service_record_with_flight(
            service, told, pack, f"flight {number}", DAY_S * day + 0.5 * HOUR_S * hour
        )
    return service


def through_file(service: ServiceRecord) -> ServiceRecord:
    return service_record_from_dict(json.loads(json.dumps(msgspec.to_builtins(service))), "file")


def test_nothing_is_in_doubt_where_the_promises_hold():
    service = flown(
        new_service_record("m", earlier_evidence_lost=False), figures(0.01, 0.0, 0, 5), flights=100
    )
    assert monitor_corrections_for_pack(service, "A") == NO_CORRECTIONS
    assert (service.flights, service.day, service.draw.day) == (100, 10, 10)


def test_a_draw_that_rises_by_a_tenth_is_found_and_believed_since_it_rose():
    service = flown(new_service_record("m", earlier_evidence_lost=False), figures(0.0), flights=50)
    service = flown(service, figures(math.log(1.1)), flights=30, first=50)
    assert service.draw.alarm_flight is not None
    assert 50 < service.draw.alarm_flight <= 70
    doubt = monitor_corrections_for_pack(service, "A")
    assert doubt.draw_log == pytest.approx(math.log(1.1), abs=0.005)
    assert 0.018 < doubt.draw_std < 0.03
    assert "draw is 1.10" in doubt.prefixed_findings[0]
    assert "companion monitor reset draw" in doubt.prefixed_findings[0]


def test_a_draw_far_above_the_cap_of_one_flight_is_believed_as_it_is():
    service = flown(
        new_service_record("m", earlier_evidence_lost=False), figures(math.log(1.5)), flights=30
    )
    assert monitor_corrections_for_pack(service, "A").draw_log == pytest.approx(
        math.log(1.5), abs=0.01
    )


def test_an_aged_pack_is_found_within_five_flights_and_doubted_alone():
    aged = figures(0.0, pack=-math.log(0.8))
    service = flown(
        new_service_record("m", earlier_evidence_lost=False), aged, flights=5, pack="old"
    )
    service = flown(service, figures(0.0, pack=0.0), flights=5, pack="new", first=5)
    assert 0.7 < monitor_corrections_for_pack(service, "old").capacity_frac < 0.8
    assert "pack old" in monitor_corrections_for_pack(service, "old").prefixed_findings[0]
    assert monitor_corrections_for_pack(service, "new") == NO_CORRECTIONS


def test_later_packs_need_more_evidence_so_that_any_number_may_come():
    service = new_service_record("m", earlier_evidence_lost=False)
    for number in range(4):
        service = flown(service, figures(pack=0.0), flights=1, pack=f"p{number}", first=number)
    assert [kept.order for kept in service.packs.values()] == [1, 2, 3, 4]


def test_wind_that_misses_its_forecasts_widens_the_winds_process():
    service = flown(
        new_service_record("m", earlier_evidence_lost=False),
        figures(0.0, misses=3, checks=5),
        flights=200,
    )
    doubt = monitor_corrections_for_pack(service, "A")
    assert service.wind.alarm_flight is not None
    # 60 % outside: a normal of variance f leaves its 95 % ellipse with exp(-5.991 / (2 f)).
    assert math.exp(-5.991 / (2.0 * doubt.wind_variance)) == pytest.approx(0.6, abs=0.001)


def test_a_restart_after_any_flight_changes_nothing():
    told = figures(0.05, pack=0.05, misses=1, checks=5)
    whole = flown(new_service_record("m", earlier_evidence_lost=False), told, flights=37)
    cut = new_service_record("m", earlier_evidence_lost=False)
    for number in range(37):
        cut = flown(through_file(cut), told, flights=1, first=number)
    assert through_file(whole) == through_file(cut)


def test_a_flight_that_a_killed_companion_tells_again_counts_once():
    service = flown(new_service_record("m", earlier_evidence_lost=False), figures(0.1), flights=1)
    assert service_record_with_flight(service, figures(0.1), "A", "flight 0", 99.0) is service


@pytest.mark.parametrize("value", [NAN, math.inf, -math.inf, 5.0, -5.0])
@pytest.mark.parametrize("std", [DRAW_STD, NAN, 0.0, -1.0])
def test_figures_that_no_flight_gives_are_not_counted_as_evidence(value, std):
    hostile = FlightEvidence(LogRatio(value, std), LogRatio(value, std), misses_above(), 3)
    service = service_record_with_flight(
        new_service_record("m", earlier_evidence_lost=False), hostile, "A", "x", 0.0
    )
    assert (service.flights, service.draw.flights, service.packs) == (1, 0, {})
    assert service.wind.flights == 0
    through_file(service)


def misses_above() -> int:
    """Return more failed checks than checks."""
    return 4


def test_flights_of_one_night_belong_to_the_day_before_and_a_clock_that_leaps_back_begins_none():
    service = new_service_record("m", earlier_evidence_lost=False)
    for number, t_s in enumerate((0.0, 2 * HOUR_S, -1e9, -1e9 + HOUR_S)):
        service = service_record_with_flight(service, figures(), "A", f"f{number}", t_s)
    assert service.day == 1
    assert service_record_with_flight(service, figures(), "A", "next", -1e9 + 9 * HOUR_S).day == 2


def test_a_service_that_flies_day_and_night_has_days_all_the_same():
    service = new_service_record("m", earlier_evidence_lost=False)
    for number in range(50):
        service = service_record_with_flight(service, figures(), "A", f"f{number}", number * HOUR_S)
    assert service.day == 3


def test_a_person_clears_an_alarm_on_record_and_the_evidence_begins_anew():
    service = flown(new_service_record("m", earlier_evidence_lost=False), figures(0.12), flights=30)
    cleared = reset_evidence_of_subject(service, "draw", "Kim", "new propellers", 5.0)
    assert monitor_corrections_for_pack(cleared, "A") == NO_CORRECTIONS
    assert log_e_value(cleared.draw, DRAW) == 0.0
    assert (cleared.resets[-1].by, cleared.resets[-1].flights) == ("Kim", 30)
    with pytest.raises(LeewayError, match="expected one of draw, wind, lost"):
        reset_evidence_of_subject(service, "no such pack", "Kim", "why", 5.0)


def test_after_lost_evidence_flights_are_careful_until_enough_have_been_counted():
    service = new_service_record("m", earlier_evidence_lost=True)
    first = monitor_corrections_for_pack(service, "A")
    assert first.draw_log == pytest.approx(math.log(1.1))
    assert first.capacity_frac == 0.8
    assert "lost" in first.prefixed_findings[0]
    service = flown(service, figures(0.0, pack=0.0), flights=LOST_FLIGHTS)
    assert monitor_corrections_for_pack(service, "A") == NO_CORRECTIONS


@pytest.mark.parametrize(
    "change",
    [
        {"information": -1.0},
        {"log_closed": [0.0]},
        {"days": []},
        {"score": "much"},
        {"unknown": 1},
    ],
)
def test_a_record_that_no_monitor_wrote_is_refused_by_name(change):
    table = msgspec.to_builtins(
        flown(new_service_record("m", earlier_evidence_lost=False), figures(), flights=3)
    )
    table["draw"] |= change
    with pytest.raises(LeewayError, match=r"file\.json"):
        service_record_from_dict(table, "file.json")
