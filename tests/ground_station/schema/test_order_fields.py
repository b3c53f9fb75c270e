"""An order's customer, window and priority: old records read, wrong values are refused in words."""

import time
from datetime import date

import msgspec
import pytest

from companion.core.base.errors import LeewayError
from companion.fleet.messages import Assign
from ground_station.adapters.files.day_files import read_day
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.schema.order_window import format_window, parse_window
from ground_station.core.schema.orders import Order, Priority, Service
from tests.ground_station.desk.test_depot_dispatcher import HARBOUR

OLD = b'{"id":"H-1","lat_deg":55.46,"lon_deg":8.44,"alt_amsl_m":12.0,"mass_kg":0.4,"service":"any"'
PLACE = {"lat_deg": 55.468, "lon_deg": 8.44, "alt_amsl_m": 12.0, "mass_kg": 0.4}
MAY_1 = date(2026, 5, 1)
NOON_US = 1_777_629_600 * 1_000_000  # 1 May 2026, 12:00 in Copenhagen: `date -ud @1777629600`


@pytest.fixture
def in_copenhagen(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TZ", "Europe/Copenhagen")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def test_an_order_of_an_earlier_version_reads_and_has_no_window():
    order = msgspec.json.decode(OLD + b',"note":""}', type=Order)
    assert (order.customer, order.window, order.priority) == ("", (None, None), Priority.NORMAL)
    assert order.service is Service.ANY


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("customer", "Jo\x1b[31m", "customer: .* control characters"),
        ("address", "Kai 5\n6700", "address: .* expected one line of text"),
        ("phone", "1" * 41, "phone: 41 characters, expected at most 40"),
        ("service_s", float("nan"), "service_s = nan: expected a number from 0"),
        ("earliest_us", -1, "earliest_us = -1: expected a number from 0"),
        ("latest_us", 10**17, "latest_us = .*: expected a number from 0"),
    ],
)
def test_a_wrong_value_is_refused_in_words(field: str, value: object, words: str):
    with pytest.raises(LeewayError, match=words):
        Order(id="H-1", **PLACE, **{field: value})


def test_a_window_that_ends_before_it_starts_is_refused():
    with pytest.raises(LeewayError, match="ends before it starts"):
        Order(id="H-1", **PLACE, earliest_us=2_000_000, latest_us=1_000_000)


HOUR_US = 3_600_000_000


@pytest.mark.parametrize(
    ("text", "hours"),
    [
        ("14:00-15:30", (2.0, 3.5)),
        ("9:00 - 14:00", (-3.0, 2.0)),
        ("14:00\N{EN DASH}15:30", (2.0, 3.5)),
        ("-15:30", (None, 3.5)),
        ("14:00 to", (2.0, None)),
        ("2026-05-02 14:00-15:30", (26.0, 27.5)),
        ("2026-05-01 23:00-2026-05-02 01:00", (11.0, 13.0)),
        ("2026-05-01T12:00Z/2026-05-01T13:30Z", (2.0, 3.5)),
        ("2026-05-01T08:00-04:00/2026-05-01T09:30-0400", (2.0, 3.5)),
        ("2026-05-01T08:00-09:30", (-4.0, -2.5)),  # two local times, no zone of -09:30
        ("", (None, None)),
    ],
)
def test_a_window_reads_as_people_write_it(in_copenhagen, text: str, hours: tuple):
    expected = tuple(None if hour is None else NOON_US + round(hour * HOUR_US) for hour in hours)
    assert parse_window(text, MAY_1) == expected


@pytest.mark.parametrize(
    ("text", "today", "words"),
    [
        ("14:00-15:30", None, "expected a date, too"),
        ("2026-03-29 02:30-04:00", MAY_1, "does not exist here, the clocks change"),
        ("2026-02-30 10:00-11:00", MAY_1, "no such time or date"),
        ("14-15", MAY_1, "expected 14:00-15:30"),
        ("-", MAY_1, "expected 14:00-15:30"),
    ],
)
def test_a_window_that_is_not_certain_is_refused(in_copenhagen, text, today, words: str):
    with pytest.raises(LeewayError, match=words):
        parse_window(text, today)


def test_a_window_is_shown_in_local_time_with_its_date_unless_it_is_today(in_copenhagen):
    window = parse_window("14:00-15:30", MAY_1)
    assert format_window(window, NOON_US) == "14:00-15:30"
    assert format_window(window) == "2026-05-01 14:00-15:30"
    assert parse_window(format_window(window), None) == window


def test_no_contact_data_is_in_a_message_to_a_vehicle():
    data = read_day(HARBOUR)
    secret = {"customer": "Jorgen Secret", "phone": "+45 99887766", "address": "Hidden Street 5"}
    order = Order(id="H-1", **PLACE, **secret, note="Ring twice")
    flight = DepotAssigner(data.day, data.airframes).flight_table(order, data.day.drones[0].id)
    sent = msgspec.json.encode(Assign(assignment="H-1.1", order="H-1", flight=flight)).decode()
    assert '"H-1"' in sent
    assert not [text for text in (*secret.values(), order.note) if text in sent]
