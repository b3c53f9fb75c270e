"""Logs in which the heading is temporarily wrong: the wind estimate stays correct or unknown.

Truth is the wind of the generated flight, or of the shared case.
"""

import csv
import math
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.app.cli.main import app

FOR_S = 8.0


def replayed(path, out):
    arguments = ["replay", str(path), "--airframe", "m100", "--every", "1", "--out", str(out)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return result.output, np.array(list(csv.reader(out.read_text().splitlines()))[1:], float)


def worst_sigmas(rows, wind_to_ne_mps, from_s):
    late = rows[rows[:, 0] >= from_s]
    return float(np.abs((late[:, 1:3] - np.array(wind_to_ne_mps)) / late[:, 3:5]).max())


@pytest.mark.sample
@pytest.mark.parametrize("kind", ["csv", "ulog", "dataflash", "tlog"])
@pytest.mark.parametrize("deg", [160.0, -90.0])
def test_a_heading_step_is_reported_and_the_wind_is_right_after_it(
    make, world, tmp_path, kind, deg
):
    # The track turns at its corners at once; from 65 to 80 s it is straight.
    wrong = (world.t_s >= 68.0) & (world.t_s < 68.0 + FOR_S)
    stepped = replace(world, yaw_rad=world.yaw_rad + np.radians(deg) * wrong)
    columns = make.telemetry_csv_columns(stepped)
    columns["yaw_deg"] = (columns["yaw_deg"] + 180.0) % 360.0 - 180.0
    path = tmp_path / "f"
    written = make.csv(path, columns) if kind == "csv" else getattr(make, kind)(path, stepped)
    told, rows = replayed(written, tmp_path / "w.csv")
    size = f"{round(abs(math.remainder(deg, 360.0)), -1):.0f}"
    assert f"heading stepped by {size} deg: not used" in told
    assert worst_sigmas(rows, world.wind_to_ne_mps, 68.0 + FOR_S + 5.0) < 3.0
