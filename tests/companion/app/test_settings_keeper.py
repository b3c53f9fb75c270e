"""Original values of settings are stored under the vehicle that they belong to."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from companion.adapters.files.vehicle_settings import read_original_parameters
from companion.app.flight.settings_keeper import SettingsKeeper
from companion.core.mission.events import AutopilotKind

OWN, EARLIER = {"A": 1.0, "B": 2.0}, {"B": 5.0, "C": 3.0}


@pytest.fixture
def keeper(tmp_path):
    profile = SimpleNamespace(autopilot_kind=AutopilotKind.PX4)
    autopilot = cast(Any, SimpleNamespace(profile=profile, system_id=1))
    return SettingsKeeper(tmp_path, autopilot, lambda run: run(), lambda text: None)


def stored(folder) -> dict[str, dict[str, float]]:
    return {file.stem: read_original_parameters(file) for file in sorted(folder.glob("*.json"))}


@pytest.mark.parametrize("earlier", [{}, EARLIER])
def test_values_stored_before_the_board_answers_move_to_its_file(tmp_path, keeper, earlier):
    if earlier:
        keeper.read_unrestored_settings("42")
        keeper.store_original_values_if_changed(earlier)
    late = SettingsKeeper(tmp_path, keeper.autopilot, keeper.write, keeper.note)
    late.store_original_values_if_changed(OWN)
    assert stored(tmp_path)["px4-1-unknown"] == OWN
    assert late.read_unrestored_settings("42") == earlier
    assert stored(tmp_path) == {"px4-1-42": OWN | earlier}
    late.store_original_values_if_changed({})
    assert stored(tmp_path) == {}


def test_a_board_that_answers_twice_changes_nothing(tmp_path, keeper):
    keeper.read_unrestored_settings("42")
    keeper.store_original_values_if_changed(OWN)
    assert keeper.read_unrestored_settings("42") == {}
    assert stored(tmp_path) == {"px4-1-42": OWN}


def test_a_damaged_record_is_noted_and_does_not_hide_own_values(tmp_path, keeper):
    (tmp_path / "px4-1-42.json").write_text("{")
    notes: list[str] = []
    keeper.note = notes.append
    keeper.store_original_values_if_changed(OWN)
    assert keeper.read_unrestored_settings("42") == {}
    assert "px4-1-42.json" in notes[0]
    assert stored(tmp_path) == {"px4-1-42": OWN}
