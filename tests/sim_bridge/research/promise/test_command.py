"""`sim-bridge promise` from end to end, on a little simulated wind."""

from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from sim_bridge.research.cli import promise as promise_cli
from sim_bridge.research.promise import flying

ASKED = ["--simulated-days", "1", "--missions", "9", "--seed", "2", "--airspeed", "20"]


def run(tmp_path: Path, name: str, *more: str):
    out = tmp_path / name
    command = [*ASKED, *more, "--jobs", "1", "--out", str(out), "--json", f"{tmp_path}/{name}.json"]
    return CliRunner().invoke(promise_cli.app, command)


def test_a_stopped_call_goes_on_and_says_the_same(tmp_path, monkeypatch) -> None:
    # Fitting has tests of its own (test_planner.py); here it would be most of the work.
    monkeypatch.setattr(flying, "DEPARTURES", 3)
    monkeypatch.setattr(flying, "fitted_process", lambda unjudged, stretches, shipped: shipped)
    monkeypatch.setattr(flying, "fitted_spread", lambda *_: 1.0)
    whole = run(tmp_path, "whole")
    assert whole.exit_code == 0, whole.output
    fly, flown = flying.fly, []

    def until_stopped(work):
        if len(flown) == 1:
            raise KeyboardInterrupt
        flown.append(work)
        return fly(work)

    monkeypatch.setattr(flying, "fly", until_stopped)
    stopped = run(tmp_path, "again")
    assert stopped.exit_code == 130
    assert "the same command goes on" in stopped.output
    got_to = len(flown[0].missions)
    assert 0 < got_to < 9
    assert f"STOPPED after {got_to} of 9 missions" in stopped.output
    assert not (tmp_path / "again.json").exists()

    def rest(work):
        assert work not in flown  # kept, not flown again
        return fly(work)

    monkeypatch.setattr(flying, "fly", rest)
    assert run(tmp_path, "again").exit_code == 0
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "whole.json").read_bytes()
    assert not list((tmp_path / "again").glob("*.partial"))
    found = msgspec.json.decode((tmp_path / "whole.json").read_bytes())
    assert found["rules"]["gate"]["missions"] == 9
    assert found["rules"]["clairvoyant"]["home"] == found["rules"]["clairvoyant"]["go"]
    assert found["go"]["count"] == found["rules"]["gate"]["go"]
    for each in ("rules.md", "rules.csv", "reliability.md", "reliability.csv", "reliability.png"):
        assert (tmp_path / "whole" / each).stat().st_size > 0
    assert "bound: the same information" in whole.output


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (["--tier", "soft"], "--tier soft"),
        (["--wind-log", "nowhere.csv"], "nowhere.csv: cannot be read"),
    ],
)
def test_mistakes_are_refused_before_anything_is_flown(tmp_path, asked, words) -> None:
    found = run(tmp_path, "none", *asked)
    assert found.exit_code != 0
    assert words in str(found.exception)
    assert not (tmp_path / "none").exists()
