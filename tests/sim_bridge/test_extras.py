"""Commands whose dependencies are not installed name the extra that has them, in one line."""

import sys

import pytest

from sim_bridge import main as cli
from sim_bridge.app.flight.stopping import FORCE_EXIT


@pytest.mark.parametrize(
    ("lacking", "command", "extra"),
    [
        ("torch", ["research", "train-avoid", "--steps", "1"], "leeway-uas[train]"),
        (
            "pyrvo",
            ["research", "avoid", "--policy", "orca", "--episodes", "1"],
            "leeway-uas[train]",
        ),
    ],
)
def test_a_missing_library_is_named_with_its_extra(
    lacking, command, extra, tmp_path, monkeypatch, capsys
):
    for loaded in [m for m in sys.modules if m.startswith("sim_bridge.research.avoidance.maddpg")]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, lacking, None)  # as if it were not installed
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "exit_on_signal", lambda number: None)  # the test's own process
    monkeypatch.setattr(sys, "argv", ["sim-bridge", *command])
    FORCE_EXIT.set()  # as if a day had been flown in this process: irrelevant for this command
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert extra in said
    assert list(tmp_path.iterdir()) == []
