"""Commands on a Ray cluster of two processors: the rows and verdicts of processes.

Skipped where the extra `ray` is not installed (200 MB): `make night` installs it.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from sim_bridge.main import app
from sim_bridge.research.campaign.scenario_generator import GeneratorParams, draw_scenario_set
from sim_bridge.research.planners.scenario import scenario_json

ray: Any = pytest.importorskip("ray", reason="the extra ray is not installed (make night has it)")

pytestmark = [
    pytest.mark.night,
    pytest.mark.timeout(600),
    pytest.mark.filterwarnings("ignore"),  # Ray's own, of its start
]


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]

    started = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        started.add_node(num_cpus=1)
        yield started.address
    finally:
        ray.shutdown()
        started.shutdown()


def json_of(out: Path, *words: str) -> Any:
    done = CliRunner().invoke(app, [*words, "--json", str(out)])
    assert done.exit_code == 0, done.output
    return json.loads(out.read_text())


def both(tmp_path: Path, address: str, *words: str) -> tuple[Any, Any]:
    """Return the command's results on one process, and on the cluster."""
    here = json_of(tmp_path / "here.json", *words, "--jobs", "1")
    return here, json_of(tmp_path / "there.json", *words, "--cluster", address)


def test_a_campaigns_rows_are_equal(tmp_path: Path, address: str) -> None:
    small = GeneratorParams(vertices=12, square_sizes_m=((500.0, 1.0),), budget_wh=35.0)
    files = []
    for scenario in draw_scenario_set(2, small, 21):
        files.append(str(tmp_path / f"{scenario.name}.json"))
        Path(files[-1]).write_bytes(scenario_json(scenario))
    words = ("research", "campaign", *files, "--planner", "rer", "--planner", "ser")
    here, there = both(tmp_path, address, *words, "--missions", "200")
    timings = ("decision_us_median", "decision_us_p99")
    for row in (*here["rows"], *there["rows"]):
        for key in timings:
            del row[key]
    assert here == there


def test_the_promises_verdict_is_equal(tmp_path: Path, address: str) -> None:
    words = ("research", "promise", "--simulated-days", "4", "--missions", "40")
    outs = ("--out", str(tmp_path / "promise"))
    here, there = both(tmp_path, address, *words, *outs)
    assert here == there


def test_faults_are_flown_alike(tmp_path: Path, address: str) -> None:
    words = ("faults", "7", "--autopilot", "px4", "--phase", "outbound")
    here, there = both(tmp_path, address, *words, "--runs", str(tmp_path / "runs"))
    for told in (here, there):
        del told["cpu_s"]
        for row in told["rows"]:
            del row["cpu_s"]
    assert here == there


def test_a_day_is_flown_alike(tmp_path: Path, address: str) -> None:
    words = ("trials", "days", "--count", "1", "--depot", "--most-drones", "1")
    few = ("--most-orders", "1", "--seed", "3", "--runs", str(tmp_path / "runs"))
    here, there = both(tmp_path, address, *words, *few)
    for told in (here, there):
        for row in told["rows"]:
            del row["told"]["cpu_s"]
    assert here == there
