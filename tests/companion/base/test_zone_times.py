"""Applicability periods of zones, against the calendar evaluated minute by minute."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.base.errors import LeewayError
from companion.core.base.zone_times import DAYS, UtcSpan, ZonePeriod, parse_zone_periods

FRIDAY = datetime(2026, 5, 1, tzinfo=UTC)  # a Friday, by the calendar
MINUTE = timedelta(minutes=1)


def clock(minutes: int) -> str:
    return f"{minutes // 60:02d}:{minutes % 60:02d}:00Z"


def schedule(day: list[str], start: int, end: int) -> ZonePeriod:
    table = {"day": day, "startTime": clock(start), "endTime": clock(end)}
    (period,) = parse_zone_periods("applicability", [{"schedule": [table]}])
    return period


def in_force(moment: datetime, day: list[str], start: int, end: int) -> bool:
    """Return True if the moment is in the day's hours, or in those that started the day before."""
    minute = moment.hour * 60 + moment.minute
    today, before = DAYS[moment.weekday()], DAYS[(moment.weekday() - 1) % 7]
    on, was_on = ({"ANY", name} & set(day) for name in (today, before))
    if start < end:
        return (bool(on) and start <= minute <= end) or (
            bool(was_on) and end == 1440 and minute == 0
        )
    return (bool(on) and minute >= start) or (bool(was_on) and minute <= end)


@given(
    st.lists(st.sampled_from([*DAYS, "ANY"]), min_size=1, max_size=4),
    st.integers(0, 1439),
    st.integers(0, 1440),
    st.integers(0, 14 * 1440),
    st.integers(0, 300),
)
def test_a_schedule_is_in_force_when_the_calendar_says_so(
    day: list[str], start: int, end: int, at: int, length: int
) -> None:
    moments = [FRIDAY + (at + k) * MINUTE for k in range(length + 1)]
    span = UtcSpan(moments[0].timestamp(), moments[-1].timestamp())
    expected = any(in_force(moment, day, start, end) for moment in moments)
    assert schedule(day, start, end).overlaps(span) == expected


def span(start: str, end: str) -> UtcSpan:
    return UtcSpan(*(datetime.fromisoformat(text).timestamp() for text in (start, end)))


def test_a_permanent_zone_is_in_force_whatever_its_dates_say() -> None:
    table = {"permanent": "YES", "endDateTime": "2020-01-01T00:00:00Z"}
    (period,) = parse_zone_periods("applicability", [table])
    assert period.overlaps(span("2026-05-01T10:00:00Z", "2026-05-01T11:00:00Z"))


def test_dates_bound_a_zone_and_both_ends_belong_to_it() -> None:
    table = {"startDateTime": "2026-05-01T12:00:00+02:00", "endDateTime": "2026-05-01T11:00:00Z"}
    (period,) = parse_zone_periods("applicability", [table])
    assert period.overlaps(span("2026-05-01T09:00:00Z", "2026-05-01T10:00:00Z"))
    assert not period.overlaps(span("2026-05-01T09:00:00Z", "2026-05-01T09:59:59Z"))
    assert not period.overlaps(span("2026-05-01T11:00:01Z", "2026-05-01T12:00:00Z"))


def test_an_offset_moves_a_schedule_to_utc() -> None:
    table = {"day": ["FRI"], "startTime": "00:30:00+02:00", "endTime": "01:00:00+02:00"}
    (period,) = parse_zone_periods("applicability", [{"schedule": [table]}])
    assert period.overlaps(span("2026-04-30T22:30:00Z", "2026-04-30T22:40:00Z"))
    assert not period.overlaps(span("2026-05-01T00:30:00Z", "2026-05-01T00:40:00Z"))


@pytest.mark.parametrize(
    ("start", "end", "noon"),
    [
        ("00:30:00Z", "01:00:00+02:00", True),  # ends at 23:00 UTC
        ("23:00:00-05:00", "01:00:00Z", False),  # Saturday 4:00 UTC until Sunday 1:00
        ("23:00:00-05:00", "05:00:00Z", False),  # an hour of Saturday
    ],
)
def test_a_start_and_an_end_may_have_offsets_of_their_own(start: str, end: str, noon: bool) -> None:
    table = {"day": ["FRI"], "startTime": start, "endTime": end}
    (period,) = parse_zone_periods("applicability", [{"schedule": [table]}])
    for hours, is_in_force in ((12.0, noon), (28.5, not noon)):
        at_s = (FRIDAY + timedelta(hours=hours)).timestamp()
        assert period.overlaps(UtcSpan(at_s, at_s)) == is_in_force


def test_sunrise_and_sunset_are_not_known_and_count_as_all_that_day() -> None:
    table = {"day": ["FRI"], "startEvent": "SR", "endEvent": "SS"}
    (period,) = parse_zone_periods("limitedApplicability", [{"schedule": [table]}])
    assert period.overlaps(span("2026-05-01T00:00:00Z", "2026-05-01T00:01:00Z"))
    assert not period.overlaps(span("2026-05-04T00:00:00Z", "2026-05-04T00:01:00Z"))


TIMES = {"day": ["MON"], "startTime": "08:00Z", "endTime": "16:00Z"}


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({}, "applicability: expected a list"),
        (["always"], r"applicability\[0\]: expected startDateTime"),
        (
            [{"startDateTime": "2026-05-01T10:00:00"}],
            r"\[0\]\.startDateTime = .*expected a time as",
        ),
        (
            [{"startDateTime": "2026-05-02T00:00:00Z", "endDateTime": "2026-05-01T00:00:00Z"}],
            r"\[0\]\.endDateTime = .*after startDateTime",
        ),
        ([{"permanent": "MAYBE"}], r"\[0\]\.permanent = 'MAYBE': expected YES or NO"),
        ([{"permanent": []}], r"\[0\]\.permanent"),
        ([{"schedule": "ANY"}], r"\[0\]\.schedule: expected a list"),
        ([{"schedule": [TIMES | {"day": ["MONDAY"]}]}], r"schedule\[0\]\.day = .*expected ANY"),
        ([{"schedule": [TIMES | {"startTime": "25:00Z"}]}], r"startTime = '25:00Z': expected hh"),
        ([{"schedule": [TIMES | {"startTime": "08:61Z"}]}], r"startTime = '08:61Z'"),
        ([{"schedule": [TIMES | {"endTime": "16:00"}]}], r"endTime = '16:00': expected hh:mm:ss"),
        ([{"schedule": [{"day": "ANY"}]}], r"startTime = None"),
    ],
)
def test_a_wrong_time_is_named_with_its_key(value: object, words: str) -> None:
    with pytest.raises(LeewayError, match=words) as caught:
        parse_zone_periods("applicability", value)
    assert "\n" not in str(caught.value)
