"""`sim-bridge promise` from end to end, on a short simulated wind."""

from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from sim_bridge.main import app
from sim_bridge.research.promise import gate_evaluation, report

ASKED = ["--simulated-days", "1", "--missions", "9", "--seed", "2", "--airspeed", "20"]


def run(tmp_path: Path, name: str, *more: str):
    outs = ["--jobs", "1", "--out", str(tmp_path / name), "--json", f"{tmp_path}/{name}.json"]
    return CliRunner().invoke(app, ["research", "promise", *ASKED, *more, *outs])


@pytest.mark.sample
def test_a_stopped_call_goes_on_and_says_the_same(tmp_path, monkeypatch) -> None:
    # Fitting has separate tests (test_planner.py); here it would be most of the work.
    monkeypatch.setattr(gate_evaluation, "DEPARTURES", 3)
    monkeypatch.setattr(
        gate_evaluation, "fit_training_process", lambda unjudged, stretches, shipped: shipped
    )
    monkeypatch.setattr(gate_evaluation, "fit_spread", lambda *_: 1.0)
    whole = run(tmp_path, "whole")
    assert whole.exit_code == 0, whole.output
    fly, flown = report.fly_missions, []

    def until_stopped(work):
        if len(flown) == 1:
            raise KeyboardInterrupt
        flown.append(work)
        return fly(work)

    monkeypatch.setattr(report, "fly_missions", until_stopped)
    stopped = run(tmp_path, "again")
    assert stopped.exit_code == 130
    assert "run the same command to resume" in stopped.output
    assert 0 < len(flown[0].missions) < 9
    assert not (tmp_path / "again.json").exists()

    def rest(work):
        assert work not in flown  # kept, not flown again
        return fly(work)

    monkeypatch.setattr(report, "fly_missions", rest)
    assert run(tmp_path, "again").exit_code == 0
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "whole.json").read_bytes()
    assert not list((tmp_path / "again").glob("*.partial"))
    found = msgspec.json.decode((tmp_path / "whole.json").read_bytes())
    assert found["rules"]["gate"]["missions"] == 9
    assert found["rules"]["clairvoyant"]["home"] == found["rules"]["clairvoyant"]["go"]
    assert found["go"]["count"] == found["rules"]["gate"]["go"]
    for each in ("rules.md", "rules.csv", "reliability.md", "reliability.csv"):
        assert (tmp_path / "whole" / each).stat().st_size > 0


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (["--tier", "soft"], "'--tier'"),
        (["--missions", "0"], "'--missions'"),
        (["--max-loss", "0"], "'--max-loss'"),
        (["--airspeed", "50"], "'--airspeed'"),
        (["--simulated-days", "0"], "either --wind-log or --simulated-days"),
        (["--wind-log", "nowhere.csv"], "nowhere.csv: cannot be read"),
    ],
)
def test_mistakes_are_refused_before_anything_is_flown(tmp_path, asked, words) -> None:
    found = run(tmp_path, "none", *asked)
    assert found.exit_code != 0
    assert words in f"{found.exception} {found.output}"
    assert not (tmp_path / "none").exists()
