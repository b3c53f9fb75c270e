"""The study over a flow that a solver computed: drones meet it, and bad grids are named first."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.main import app
from sim_bridge.research.fleet_wind.study import FleetWindSetting, drawn_field
from tests.sim_bridge.truth.fields.made_grid import grid_text

SHIPPED = Path(__file__).parents[4] / "params" / "fields" / "front.toml"


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """Wind from the west; within 100 m of the middle it is half as fast, and blows north."""
    (tmp_path / "west.txt").write_text(grid_text(lambda *_: 0.0, lambda *_: 4.0))
    path = tmp_path / "town.toml"
    path.write_text(
        SHIPPED.read_text()
        + '\nflows = [{ file = "west.txt", from_deg = 270.0, speed_mps = 8.0 }]\n'
    )
    return path


def test_drones_meet_the_flow_where_it_was_computed(town: Path) -> None:
    setting = FleetWindSetting(
        wind_log=None,
        field=str(town),
        file="",
        drones=2,
        hovering=2,
        along=4.0,
        across=13.0,
        seed=3,
    )
    drawn = drawn_field(setting, 0, 0)
    t_s = np.arange(0.0, 600.0)
    free = drawn.field.to_ne_mps(t_s, np.full(600, 20.0), np.full(600, -30.0))
    assert free[:, 1].mean() > 4.0  # from the west
    truth = drawn.truth(front=False)
    within = truth.to_ne_mps(t_s, 20.0, -30.0, 40.0)
    assert np.allclose(within[:, 0], 0.5 * free[:, 1])
    assert np.allclose(within[:, 1], -0.5 * free[:, 0])
    beyond = truth.to_ne_mps(t_s, 20.0, -300.0, 40.0)
    assert np.allclose(beyond, drawn.field.to_ne_mps(t_s, np.full(600, 20.0), np.full(600, -300.0)))


def test_what_cannot_be_judged_over_it_is_refused_first(town: Path) -> None:
    grid = town.parent / "west.txt"
    for text, words, said in (
        (grid.read_text(), ["--bound"], "ideal tests know no obstacles"),
        (grid.read_text().replace("4.0", "torn", 1), [], r"west.txt: v: expected numbers"),
    ):
        grid.write_text(text)
        result = CliRunner().invoke(
            app, ["fleet-wind", "--field", str(town), *words, "--out", str(town.parent / "out")]
        )
        assert isinstance(result.exception, LeewayError)
        assert said in str(result.exception)
        assert not (town.parent / "out").exists()
