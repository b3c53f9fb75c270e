"""The first-flight tutorial: its commands print what it shows, and its flights end as it states."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.sitl, pytest.mark.sample, pytest.mark.timeout(300)]

TUTORIAL = (Path(__file__).parents[2] / "docs/tutorials/first-flight.md").read_text()
BIN = Path(sys.executable).parent
BLOCKS = [block.splitlines() for block in re.findall(r"^```\n(.*?)^```$", TUTORIAL, re.M | re.S)]
RESTORED, LEFT = "restored to", "settings not restored: someone else has control"


def normalised(lines: list[str]) -> list[str]:
    """Return lines with single spaces, without rules and the path of the run."""
    spaced = (" ".join(line.split()) for line in lines)
    return [line for line in spaced if line and not line.startswith(("─", "run folder"))]


@pytest.mark.parametrize(
    ("command", "shown", "settings"),
    [("make fly", "gate on", RESTORED), ("--gate off", "1 px4 DEL", LEFT),
     ("--autopilot ardupilot", "1 ardupilot", RESTORED)],
)  # fmt: skip
def test_a_flight_prints_what_the_tutorial_shows_and_ends_disarmed(
    command, shown, settings, tmp_path
):
    (commands,) = [block for block in BLOCKS if any(command in line for line in block)]
    (expected,) = [block for block in BLOCKS if normalised(block)[0].startswith(shown)]
    printed = ""
    for line in commands:
        line = line.partition("  #")[0].replace("make fly", ".venv/bin/sim-bridge fly")
        done = subprocess.run(
            ["bash", "-ec", line.replace(".venv/bin/", f"{BIN}/")],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        printed += done.stdout
    assert set(normalised(expected)) <= set(normalised(printed.splitlines())), printed
    (log,) = tmp_path.glob("logs/*/companion.log")
    text = log.read_text()
    assert settings in text
    assert "still armed" not in text
    assert text.splitlines()[-1].endswith("exit 0 in phase done")
