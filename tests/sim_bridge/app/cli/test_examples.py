"""`sim-bridge examples`: copied files work unchanged, and no file of the user is lost."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.adapters.files.params import params_dir, read_flight, read_obstacle_document
from companion.core.base.errors import LeewayError
from ground_station.adapters.files.day_files import read_day
from sim_bridge.main import app


def copied(folder: Path) -> str:
    done = CliRunner().invoke(app, ["examples", str(folder)])
    assert done.exit_code == 0, done.output
    return done.output


def test_every_flight_and_day_is_copied_and_read_with_what_it_names(tmp_path: Path):
    folder = tmp_path / "town"
    said = copied(folder)
    for kind in ("flights", "days", "sites", "layouts"):
        shipped = {path.name for path in (params_dir() / kind).iterdir()}
        assert {path.name for path in (folder / kind).iterdir()} == shipped
    for path in sorted((folder / "flights").glob("*.toml")):
        flight = read_flight(path)
        assert (read_obstacle_document(flight, path) is None) == (flight.site.obstacles is None)
    for path in sorted((folder / "days").glob("*.toml")):
        assert read_day(path).orders
        assert f"days/{path.name}" in said
    assert f"  sim-bridge fly {folder}/flights/default.toml\n" in said


def test_no_file_is_written_over_and_then_none_at_all(tmp_path: Path):
    mine = tmp_path / "days" / "town.toml"
    mine.parent.mkdir()
    mine.write_text("mine")
    done = CliRunner().invoke(app, ["examples", str(tmp_path)])
    assert isinstance(done.exception, LeewayError)
    assert "days/town.toml: there already" in str(done.exception)
    assert mine.read_text() == "mine"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [mine]


@pytest.mark.parametrize("at", ["file", "file/below"])
def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path, at: str):
    (tmp_path / "file").touch()
    done = CliRunner().invoke(app, ["examples", str(tmp_path / at)])
    assert isinstance(done.exception, LeewayError)
    assert str(tmp_path / at) in str(done.exception)


def test_a_copy_names_no_schema_that_does_not_lie_there(tmp_path: Path):
    copied(tmp_path)
    assert not any("#:schema" in path.read_text() for path in tmp_path.rglob("*.toml"))
