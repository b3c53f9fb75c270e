"""Plans that an autopilot refuses: the ground station names the item."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sim_bridge.main import app


def item(command: int, lat_deg: float = 55.4701) -> dict[str, object]:
    place = [lat_deg, 8.4502, 20.0]
    return {"type": "SimpleItem", "command": command, "frame": 3, "params": [0, 0, 0, None, *place]}


@pytest.mark.sitl
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_refused_plan_names_the_item_by_its_number_in_the_file(
    tmp_path: Path, autopilot: str
) -> None:
    # MAV_CMD 5999 is not defined; item 3 of the file for both, though ArduPilot counts home as 0.
    mission = {
        "version": 2,
        "plannedHomePosition": [55.47, 8.45, 12.0],
        "items": [item(22), item(16), item(5999), item(21)],
    }
    plan = tmp_path / "odd.plan"
    plan.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}))
    out = ("--out", str(tmp_path / "f.tlog"), "--autopilot", autopilot)
    done = CliRunner().invoke(app, ["serve", "--fly", str(plan), *out])
    assert done.exit_code != 0
    text = done.output + str(done.exception)
    assert "mission upload: item 3, command 5999: refused: UNSUPPORTED" in text
