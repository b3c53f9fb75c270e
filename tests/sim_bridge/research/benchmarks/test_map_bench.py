"""The benchmark of the live map measures a map that publishes."""

import json
from pathlib import Path

from sim_bridge.research.benchmarks.map_bench import bench


def test_it_measures_pictures_that_a_window_was_sent(tmp_path: Path):
    load = bench(4, 10, 1, 1.0, 1, tmp_path / "map.json")
    assert json.loads((tmp_path / "map.json").read_text())["drones"] == 4
    assert load.pictures_hz > 0.0
    assert load.whole_kb > load.change_kb > 0.0
