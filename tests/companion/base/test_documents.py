"""Error messages for a document of another kind and for an unknown name."""

import pytest

from companion.adapters.files.params import flight_file_path, params_dir, read_flight
from companion.core.base.documents import check_not_other_document_kind, parse_toml
from companion.core.base.errors import LeewayError
from ground_station.adapters.files.day_files import DayFilesError, read_day


def test_a_day_given_as_a_flight_is_called_a_day_with_the_commands_that_take_one():
    with pytest.raises(LeewayError, match=r"town\.toml: this is a day, for `sim-bridge day`"):
        read_flight(params_dir() / "days" / "town.toml")


def test_a_flight_given_as_a_day_is_called_a_flight_with_the_commands_that_take_one():
    with pytest.raises(DayFilesError, match=r"this is a flight, for `sim-bridge fly`"):
        read_day(params_dir() / "flights" / "default.toml")


@pytest.mark.parametrize("table", [{}, {"format": "flight/2"}, {"format": 7}, {"format": "x/1"}])
def test_what_is_of_no_other_known_kind_is_left_to_the_schema(table):
    check_not_other_document_kind(table, "flight", "f.toml")


def test_the_nearest_name_is_offered_and_none_where_nothing_is_near():
    with pytest.raises(LeewayError, match=r"^deflaut: no such flight, did you mean default\?"):
        flight_file_path("deflaut")
    with pytest.raises(LeewayError, match=r"^xyz: no such flight; names: .*default"):
        flight_file_path("xyz")


@pytest.mark.parametrize("text", ["a = " + "[" * 5000 + "]" * 5000, "a = " + "{b=" * 5000])
def test_deep_nesting_is_refused_in_one_line(text):
    with pytest.raises(LeewayError, match=r"day\.toml: nested too deeply"):
        parse_toml(text.encode(), "day.toml")
