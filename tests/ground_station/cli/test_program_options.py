"""Options shared by the dispatcher's commands: position, settings file, and errors."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.fleet import membership
from companion.fleet.topics import VehicleKeys
from ground_station.app.cli.main import app

ORDER = ["order", "add", "H-1", "--lat", "55", "--lon", "8", "--alt", "1", "--mass", "0.4"]


def run(*arguments: str) -> str:
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, (done.output, done.exception)
    return done.output


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("at", [0, 1, 2, len(ORDER)])
@pytest.mark.parametrize("split", [False, True], ids=["--store=URL", "--store URL"])
def test_the_store_may_be_named_anywhere(here: Path, at: int, split: bool):
    option = ["--store", "sqlite:///a.db"] if split else ["--store=sqlite:///a.db"]
    run(*ORDER[:at], *option, *ORDER[at:])
    assert (here / "a.db").is_file()


def test_what_follows_two_dashes_is_no_option(here: Path):
    done = CliRunner().invoke(app, ["order", "cancel", "--reason=x", "--", "--store"])
    assert "leeway-desk.db" in str(done.exception)  # this folder's default store does not exist


def test_the_settings_of_the_folder_are_defaults(here: Path):
    (here / "leeway-desk.toml").write_text('store = "sqlite:///b.db"\nuser = "anna"\n')
    run(*ORDER)
    assert "anna" in run("audit")
    run(*ORDER, "--store", "sqlite:///c.db")
    assert {path.name for path in here.glob("*.db")} == {"b.db", "c.db"}
    (here / "other.toml").write_text('store = "sqlite:///d.db"\n')
    run(*ORDER, "--settings", "other.toml")
    assert (here / "d.db").is_file()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('stroe = "x"\n', "unknown key 'stroe'"),
        ("store = 3\n", "store: expected text"),
        ("store = \n", "leeway-desk.toml"),
        ('open_network = "yes"\n', "unknown key 'open_network'"),
    ],
)
def test_a_mistake_in_the_settings_is_named(here: Path, text: str, expected: str):
    (here / "leeway-desk.toml").write_text(text)
    done = CliRunner().invoke(app, ["order", "list"])
    assert expected in str(done.exception)


@pytest.mark.parametrize(
    "words", [["order", "list", "--user", "anna"], ["estimate", "default", "--store", "x"]]
)
def test_an_option_that_the_command_does_not_use_is_refused(here: Path, words: list[str]):
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 2
    assert words[-2] in done.output


def test_the_help_of_a_command_names_the_options_that_it_uses():
    text = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["order", "list", "--help"]).output
    assert "Database of the day" in text
    assert "--identity" not in text


def test_the_folder_of_a_group_may_stand_anywhere_in_it(here: Path):
    run("pki", "init", "harbour", "--pki", "a")
    run("pki", "--pki", "a", "add", "d1", "--role", "vehicle")
    assert "d1" in run("pki", "status", "--pki=a")


def test_a_store_on_the_command_line_precedes_a_store_file_of_the_settings(here: Path):
    (here / "store.url").write_text("sqlite:///of_file.db\n")
    (here / "store.url").chmod(0o600)
    (here / "leeway-desk.toml").write_text('store_file = "store.url"\n')
    run(*ORDER)
    run(*ORDER, "--store", "sqlite:///typed.db")
    assert {path.name for path in here.glob("*.db")} == {"of_file.db", "typed.db"}


@pytest.mark.parametrize(("typed", "fleet"), [([], "harbour"), (["--fleet", "pier"], "pier")])
def test_the_truck_joins_the_fleet_of_its_day_whatever_the_settings_name(
    here: Path, monkeypatch: pytest.MonkeyPatch, typed: list[str], fleet: str
):
    (here / "leeway-desk.toml").write_text('fleet = "other"\n')
    joined: list[str] = []

    def join(keys: VehicleKeys, *_: object) -> None:
        joined.append(keys.fleet)
        raise LeewayError("enough")

    monkeypatch.setattr(membership, "read_membership", join)
    CliRunner().invoke(app, ["truck", "harbour", *typed])
    assert joined == [fleet]
