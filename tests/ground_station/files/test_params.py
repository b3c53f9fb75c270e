"""Bundled days and flights have names."""

from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.params import day_file, flight_file, params_dir


def test_a_bundled_day_is_found_by_its_name():
    assert day_file("town") == params_dir() / "days" / "town.toml"
    assert read_day(day_file("town")).day.name == "town"
    assert flight_file("default") == params_dir() / "flights" / "default.toml"


@pytest.mark.parametrize("path", ["days/town", "town.toml", "../town"])
def test_what_has_a_suffix_or_a_folder_is_a_path(path):
    assert day_file(path) == Path(path)


def test_a_file_without_a_suffix_is_a_path_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("")
    assert day_file("mine") == Path("mine")


def test_an_unknown_name_lists_the_names_in_one_line():
    names = "names: faults, harbour, town, villages; or give a file's path"
    with pytest.raises(LeewayError, match=f"^nowhere: no such day; {names}$"):
        day_file("nowhere")
    with pytest.raises(LeewayError, match=f"^twon: no such day, did you mean town\\? {names}$"):
        day_file("twon")
