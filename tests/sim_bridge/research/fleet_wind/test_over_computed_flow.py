"""The study over a computed flow: drones meet it, and invalid grids are reported first."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from sim_bridge.main import app
from sim_bridge.research.fleet_wind.fields import FleetWindSetting, draw_field
from tests.sim_bridge.truth.fields.made_grid import grid_text

SHIPPED = Path(__file__).parents[4] / "params" / "fields" / "front.toml"


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """Wind from the west; within 100 m of the middle it has half the speed, and blows north."""
    (tmp_path / "west.txt").write_text(grid_text(lambda *_: 0.0, lambda *_: 4.0))
    path = tmp_path / "town.toml"
    path.write_text(
        SHIPPED.read_text()
        + '\nflows = [{ file = "west.txt", from_deg = 270.0, speed_mps = 8.0 }]\n'
    )
    return path


@pytest.mark.night
def test_drones_meet_the_flow_where_it_was_computed(town: Path) -> None:
    setting = FleetWindSetting(None, str(town), "", drones=2, hovering=2, seed=3)
    drawn = draw_field(setting, 0, 0)
    t_s = np.arange(0.0, 600.0)
    free = drawn.field.to_ne_mps(t_s, np.full(600, 20.0), np.full(600, -30.0))
    assert free[:, 1].mean() > 4.0  # from the west
    truth = drawn.true_wind(with_front=False)
    within = truth.to_ne_mps(t_s, 20.0, -30.0, 40.0)
    assert np.allclose(within[:, 0], 0.5 * free[:, 1])
    assert np.allclose(within[:, 1], -0.5 * free[:, 0])
    beyond = truth.to_ne_mps(t_s, 20.0, -300.0, 40.0)
    assert np.allclose(beyond, drawn.field.to_ne_mps(t_s, np.full(600, 20.0), np.full(600, -300.0)))


def test_what_cannot_be_judged_over_it_is_refused_first(town: Path) -> None:
    grid = town.parent / "west.txt"
    grid.write_text(grid.read_text().replace("4.0", "torn", 1))
    result = CliRunner().invoke(
        app, ["research", "fleet-wind", "--field", str(town), "--out", str(town.parent / "out")]
    )
    assert isinstance(result.exception, LeewayError)
    assert "west.txt: v: expected numbers" in str(result.exception)
    assert not (town.parent / "out").exists()
