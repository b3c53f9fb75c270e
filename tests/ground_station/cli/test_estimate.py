"""`ground-station estimate`: feasibility of a delivery before any flight."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

FLIGHT = Path(__file__).parents[3] / "params" / "flights" / "default.toml"


def ask(*arguments: str) -> tuple[int, str, str]:
    code = "from ground_station.app.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "estimate", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


def need_wh(text: str) -> float:
    found = re.search(r"mean energy until landing\D+(\d+) Wh", text)
    assert found, text
    return float(found.group(1))


@pytest.mark.sample
def test_a_headwind_home_costs_more_and_a_gale_is_refused_by_the_gate():
    charge = ("--charge", "0.6")
    gale_wind = ("--wind-speed", "16", "--wind-from", "80", "--wind-std", "0.5")
    calm_code, calm, _ = ask(str(FLIGHT), *charge)
    gale_code, gale, _ = ask(str(FLIGHT), *charge, *gale_wind)
    assert (calm_code, gale_code) == (0, 3)
    assert need_wh(gale) > 1.3 * need_wh(calm)


def test_a_missing_flight_file_is_one_line_and_exit_code_2(tmp_path):
    code, out, errors = ask(str(tmp_path / "none.toml"))
    assert (code, out) == (2, "")
    assert len(errors.strip().splitlines()) == 1
    assert "none.toml" in errors


def test_over_known_ground_the_estimate_says_how_near_and_how_high():
    hills = FLIGHT.with_name("hills.toml")
    code, out, _ = ask(str(hills), "--wind-speed", "5", "--wind-from", "250")
    assert code == 0
    figures = dict(re.findall(r"│ (.+?) +│ +(.+?) │", out))
    assert figures["maximum height above the depot"] == "98 m"  # 69.7 hill, 20 clearance, 8 margin
    assert figures["minimum height above ground"] == "28 m"
    assert figures["line of sight to the customer"] == "no"  # two hills obstruct it
