"""`ground-station plan --trucks`: regions and plans independent of --jobs."""

import shutil
from collections import Counter
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.day_files import read_day_plan
from ground_station.adapters.workers.side_by_side import ItemDone, ItemLost
from ground_station.app.cli.main import app
from ground_station.app.planning import region_days

pytestmark = pytest.mark.usefixtures("compiled_planner")


def divide(out: Path, *words: str) -> Result:
    command = ["plan", "town", "--trucks", "2", "--out", str(out), "--trials", "40", *words]
    return CliRunner().invoke(app, command)


@pytest.mark.sample
def test_plans_are_the_same_on_one_process_and_on_two_and_bring_every_order_once(
    tmp_path: Path,
) -> None:
    alone, paired = tmp_path / "alone", tmp_path / "paired"
    done = divide(alone, "--jobs", "1")
    assert done.exit_code == 0, done.output
    assert "separated by their companions, not by the plan" in " ".join(done.output.split())
    assert divide(paired, "--jobs", "2").exit_code == 0
    files = sorted(path.name for path in alone.iterdir())
    assert files == sorted(path.name for path in paired.iterdir())
    assert len(files) == 6
    for name in files:
        assert (alone / name).read_bytes() == (paired / name).read_bytes()
    brought: Counter[str] = Counter()
    for path in alone.glob("*_plan.json"):
        plan = read_day_plan(path)
        brought.update(sortie.order for sortie in plan.sorties)
        brought.update(id_ for stop in plan.stops for id_ in stop.serves)
        brought.update(line.order for line in plan.unplanned)
    assert len(brought) == 40
    assert set(brought.values()) == {1}


def test_windows_are_planned_from_the_departure_of_the_trucks(tmp_path: Path) -> None:
    for name in ("days", "sites"):
        shutil.copytree(Path(__file__).parents[3] / "params" / name, tmp_path / name)
    file = tmp_path / "days" / "town_orders.csv"
    header, *rows = file.read_text(encoding="utf-8").splitlines()
    opens = [f"{row},2026-07-01T15:30Z/2026-07-01T18:00Z" for row in rows[:3]]
    lines = [f"{header},window", *opens, *(f"{row}," for row in rows[3:])]
    file.write_text("\n".join(lines), encoding="utf-8")
    day, out = tmp_path / "days" / "town.toml", tmp_path / "out"
    words = ["plan", str(day), "--trucks", "2", "--out", str(out)]
    at = ["--trials", "40", "--jobs", "1", "--at", "2026-07-01T15:00Z"]
    done = CliRunner().invoke(app, [*words, *at])
    assert done.exit_code == 0, done.output
    times_s: dict[str, float] = {}
    for path in out.glob("*_plan.json"):
        plan = read_day_plan(path)
        times_s |= {one.order: one.drop_s for one in plan.sorties}
        times_s |= {id_: stop.depart_s for stop in plan.stops for id_ in stop.serves}
    assert len(times_s) == 40
    assert min(times_s[row.split(",")[0]] for row in rows[:3]) >= 1799.0


def test_a_planner_that_is_killed_costs_its_region_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(region_days, "run_parallel", one_is_lost)
    done = divide(tmp_path, "--jobs", "2")
    assert done.exit_code == 1
    assert "not planned: town-2: SIGKILL" in done.output
    assert sorted(path.name for path in tmp_path.glob("*_plan.json")) == ["town-1_plan.json"]


def one_is_lost(work, do, workers, say):
    """Replaces the workers: the worker of the second region is killed twice."""
    for index, piece in enumerate(work):
        if index == 1:
            yield ItemLost(index, piece, "SIGKILL")
        else:
            yield ItemDone(index, do(piece))


def test_trucks_are_stated_for_each_day(tmp_path: Path) -> None:
    done = divide(tmp_path, "--trucks", "1")
    assert isinstance(done.exception, LeewayError)
    assert "2 for 1 days" in str(done.exception)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "refusal"),
    [
        ("town --trucks 2", "--trucks: expected --out FOLDER"),
        ("town --trucks 2 --out x --picture p.png", "--picture: not with --trucks"),
        ("town --trucks 2 --out x --at 2026-07-01T15:10Z", "or orders with delivery windows"),
        ("town --jobs 2", "--jobs: expected with --trucks"),
        ("town harbour", "expected one DAY, or --trucks for each"),
    ],
)
def test_an_option_without_effect_is_refused(words: str, refusal: str) -> None:
    done = CliRunner().invoke(app, ["plan", *words.split()])
    assert isinstance(done.exception, LeewayError)
    assert refusal in str(done.exception)
