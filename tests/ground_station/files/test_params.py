"""Bundled days and flights can be named."""

import re
from pathlib import Path

import pytest

from companion.adapters.files import params as companion_params
from companion.core.base.errors import LeewayError
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.params import (
    params_dir,
    read_airframe,
    resolve_day_file_path,
    resolve_flight_file_path,
)


def test_a_bundled_day_is_found_by_its_name():
    assert resolve_day_file_path("town") == params_dir() / "days" / "town.toml"
    assert read_day(resolve_day_file_path("town")).day.name == "town"
    assert resolve_flight_file_path("default") == params_dir() / "flights" / "default.toml"


@pytest.mark.parametrize("path", ["days/town", "town.toml", "../town"])
def test_what_has_a_suffix_or_a_folder_is_a_path(path):
    assert resolve_day_file_path(path) == Path(path)


def test_a_file_without_a_suffix_is_a_path_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("")
    assert resolve_day_file_path("mine") == Path("mine")


def test_an_unknown_name_lists_the_names_in_one_line():
    names = "names: faults, harbour, town, villages; or give a file's path"
    with pytest.raises(LeewayError, match=f"^nowhere: no such day; {names}$"):
        resolve_day_file_path("nowhere")
    with pytest.raises(LeewayError, match=f"^twon: no such day, did you mean town\\? {names}$"):
        resolve_day_file_path("twon")


def test_an_airframe_file_is_found_beside_the_flight_that_names_it(tmp_path):
    flight = (params_dir() / "flights" / "default.toml").read_text()
    path, airframe = tmp_path / "flight.toml", tmp_path / "my.toml"
    path.write_text(flight.replace('airframe = "m100"', 'airframe = "my.toml"'))
    assert companion_params.read_flight(path).vehicle.airframe == str(airframe)
    with pytest.raises(LeewayError, match=re.escape(str(airframe))):
        read_airframe("my.toml", tmp_path)
    airframe.write_bytes((params_dir() / "airframes" / "m100.toml").read_bytes())
    assert read_airframe("my.toml", tmp_path) == read_airframe("m100", tmp_path)
