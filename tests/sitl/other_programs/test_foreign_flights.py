"""`fly --link`: the companion on vehicles served by another process, as over any link.

The served vehicle is the simulated one, so that truth is available to check the companion's own
record; `fly_external_vehicles` knows only the link.
"""

import io
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import psutil
import pytest
from rich.console import Console

from companion.core.base.errors import LeewayError
from sim_bridge import main as cli
from sim_bridge.app.flight.foreign_flight import ExternalFlightOptions, fly_external_vehicles
from sim_bridge.app.flight.report import (
    VehicleStatus,
    end_reason_and_settings_messages,
    grounding_findings_or_kill_messages,
    results_table,
)
from sim_bridge.app.serve.server import Host
from sim_bridge.app.world.vehicle_host import Home, VehicleHost
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.truth.wind_field import SteadyWind, WindField
from tests.sitl.served import on_the_ground

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(240)]

ROUTE = {"customer": {"name": "customer", "east_m": -110.0, "north_m": -20.0}}
DEPOT = {"lat_deg": 55.47, "lon_deg": 8.45, "alt_amsl_m": 12.0}
ELSEWHERE = Home(lat_deg=47.397742, lon_deg=8.545594, alt_amsl_m=489.4)
PAYLOAD_KG = 0.5
SPEEDUP = 5.0


def flight_file(folder: Path, **changes: Any) -> Path:
    table = {
        "format": "flight/1",
        "name": "guest",
        "site": {"depot": DEPOT} | ROUTE,
        "vehicle": {"airframe": "m100", "payload_kg": PAYLOAD_KG},
        "mission": {"cruise_height_m": 20.0, "leg_length_m": 60.0, "time_limit_s": 600.0},
    } | changes
    path = folder / "guest.toml"
    path.write_bytes(msgspec.toml.encode(table))
    return path


def stood(autopilot_kind: AutopilotKind, home: Home | None = None) -> VehicleHost:
    wind = WindField(SteadyWind(4.0, 70.0))
    return on_the_ground(
        autopilot_kind, home=home or Home(), wind_field=wind, payload_kg=PAYLOAD_KG
    )


def fly(
    served: VehicleHost,
    folder: Path,
    *,
    endpoint: str = "udpin::0",
    link: str = "udpout:127.0.0.1:PORT",
    watch: Callable[[list[VehicleStatus], float], None] = lambda vehicles, t_s: None,
    told: list[str] | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Serve the vehicle on `endpoint`, fly it over `link` (with PORT for the port taken).

    `told` receives the lines as the terminal shows them.
    """
    lines, file = [] if told is None else told, flight_file(folder)
    with Host(SPEEDUP) as host:
        (url,) = host.add_vehicle(served, onboard_urls=[endpoint])
        links = (link.replace("PORT", url.rsplit(":", 1)[1]),)
        with host.serve_in_thread():
            result = fly_external_vehicles(
                ExternalFlightOptions(file, links, run_root=folder / "runs", **options),
                watch,
                lines.append,
            )
    (row,) = result["flights"]
    return row


def settings(served: VehicleHost) -> dict[str, float]:
    params = served.autopilot.params
    return {name: params[name] for i in range(len(params)) if (name := params.name_at(i))}


def away_m(served: VehicleHost) -> float:
    north, east, _ = served.truth.pos_ned_m
    return math.hypot(north, east)


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize(
    ("autopilot_kind", "endpoint", "link"),
    [
        (AutopilotKind.PX4, "udpin::0", "udpout:127.0.0.1:PORT"),
        (AutopilotKind.ARDUPILOT, "tcpin::0", "tcp:127.0.0.1:PORT"),
    ],
)
def test_it_delivers_with_somebody_elses_vehicle_and_leaves_its_settings_as_they_were(
    tmp_path, autopilot_kind, endpoint, link
):
    served = stood(autopilot_kind)
    before = settings(served)
    told: list[str] = []
    row = fly(served, tmp_path, endpoint=endpoint, link=link, told=told, configure=True)
    assert row["outcome"] == "SUC", row
    assert row["judged_by"] == "companion"
    assert row["autopilot"] == autopilot_kind.value
    truth = served.truth
    assert not truth.parcel_aboard
    assert not truth.airborne
    assert away_m(served) < 12.0
    assert {n: v for n, v in settings(served).items() if before[n] != v} == {}
    assert row["settings"]
    for setting in row["settings"]:
        assert setting["restored"]
        assert setting["before"] == pytest.approx(before[setting["name"]])
        assert any(line.strip().startswith(f"setting {setting['name']}: ") for line in told)
    for decision in row["decisions"]:
        said = f"{decision['kind']}: {decision['reason']}"
        assert sum(said in line for line in told) >= 1, said
    assert end_reason_and_settings_messages(row)[0] == f"1 ended: SUC: {row['reason']}"
    # The companion's count ends at the landing; battery sensors are good to a few per cent.
    assert row["energy_used_wh"] == pytest.approx(truth.energy_used_wh, rel=0.1)
    assert row["energy_predicted_wh"] == pytest.approx(row["energy_used_wh"], rel=0.3)
    assert row["wind_rmse_mps"] is None
    assert row["clairvoyant"] is None


@pytest.mark.night
def test_without_being_asked_it_changes_no_setting_and_says_what_is_missing(tmp_path):
    served = stood(AutopilotKind.ARDUPILOT)
    before = settings(served)
    row = fly(served, tmp_path)
    assert settings(served) == before
    assert row["flight_time_s"] == 0.0
    assert away_m(served) < 1.0
    assert {f["name"] for f in row["findings"] if f["blocks"]} >= {"AUTO_OPTIONS", "GRIP_ENABLE"}
    said = "\n".join(grounding_findings_or_kill_messages(row))
    assert "MISSING  arming in AUTO" in said
    assert "--configure" in said


@pytest.mark.night
def test_a_companion_that_is_killed_in_flight_is_told_with_what_it_leaves(tmp_path):
    others = psutil.Process().children()  # the fork server of earlier flights

    def kill_when_high(vehicles, t_s):
        if any(vehicle.up_m > 10.0 for vehicle in vehicles):
            for child in psutil.Process().children():  # no restart
                if child not in others:
                    child.kill()

    served = stood(AutopilotKind.ARDUPILOT)
    row = fly(served, tmp_path, watch=kill_when_high, configure=True)
    (words,) = grounding_findings_or_kill_messages(row)
    assert words.startswith("the companion was killed (SIGKILL) with the vehicle ")
    assert "the onboard mission flies it home" in words
    assert "settings not restored, previous values: " in words


@pytest.mark.sample
def test_a_site_elsewhere_is_refused(tmp_path):
    served = stood(AutopilotKind.PX4, ELSEWHERE)
    row = fly(served, tmp_path, configure=True)
    assert row["outcome"] == "ABRT"
    assert end_reason_and_settings_messages(row)[0] == f"1 no take-off: {row['reason']}"
    assert "the vehicle is" in row["reason"]
    assert "--here" in row["reason"]


@pytest.mark.night
def test_with_here_the_site_lies_about_the_vehicle(tmp_path):
    served = stood(AutopilotKind.PX4, ELSEWHERE)
    row = fly(served, tmp_path, configure=True, here=True)
    assert row["outcome"] == "SUC", row
    assert not served.truth.parcel_aboard
    assert away_m(served) < 12.0
    ends = [d["reason"] for d in row["decisions"] if d["kind"] == "planned"]
    assert len(ends) == 1


@pytest.mark.sample
def test_the_table_shows_what_only_the_truth_could_tell_as_a_dash(tmp_path):
    served = stood(AutopilotKind.PX4)
    row = fly(served, tmp_path)
    told = io.StringIO()
    Console(file=told, width=100).print(results_table({"flights": [row]}, gate_enabled=True))
    assert "companion's record" in told.getvalue()
    line = next(line for line in told.getvalue().splitlines() if line.startswith("1 px4"))
    # vehicle, end, used, margin, time, wind RMSE, NEES, least P(home), clairvoyant: it never left
    assert line.split() == ["1", "px4", "ABRT", "-", "-", "0", "-", "-", "-", "-"]


@pytest.mark.sample
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--link", "udpin:127.0.0.1:14599", "--seed", "3"], "--seed"),
        (["--link", "udpin:127.0.0.1:14599", "--wind-log", "w.csv"], "--wind-log"),
        (["--link", "udpin:127.0.0.1:14599", "--speedup", "4"], "--speedup"),
        (["--link", "udpin:127.0.0.1:14599", "--vehicles", "2"], "--vehicles"),
        (["--link", "udpin:127.0.0.1:14599", "--autopilot", "px4"], "--autopilot"),
        (["--configure"], "--configure: expected --link"),
        (["--steady-wind", "5,80"], "--steady-wind: expected --link"),
        (["--link", "udpin:127.0.0.1:14599", "--steady-wind", "5"], "expected SPEED,FROM"),
        (["--here"], "--here: expected --link"),
        (["--link", "carrier-pigeon"], "carrier-pigeon"),
        (["--link", "tcp:127.0.0.1:5760", "--link", "tcp:127.0.0.1:5760"], "named twice"),
        (["--link", "tcp:127.0.0.1:5760", "--link", "tcp:127.0.0.1:5761"], "several --link"),
    ],
)
def test_what_makes_no_sense_with_a_link_is_refused_in_one_line(
    tmp_path, monkeypatch, capsys, arguments, words
):
    file = flight_file(tmp_path)
    runs = ["--runs", str(tmp_path / "runs")]
    monkeypatch.setattr(sys, "argv", ["sim-bridge", "fly", str(file), *runs, *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("name", ["arducopter_sitl", "px4_sih"])
def test_a_vehicle_that_only_somebody_else_simulates_is_refused_without_a_link(
    monkeypatch, capsys, name
):
    monkeypatch.setattr(sys, "argv", ["sim-bridge", "fly", name])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert f"vehicle.airframe {name}: expected a simulated airframe (m100, octo8)" in said
    assert "--link" in said


def test_faults_of_the_simulated_world_are_refused(tmp_path):
    file = flight_file(tmp_path, faults=[{"kind": "gnss_lost", "at_s": 10.0}])
    with pytest.raises(LeewayError, match=r"guest.toml: \[\[faults\]\]"):
        fly_external_vehicles(
            ExternalFlightOptions(file, ("tcp:127.0.0.1:5760",)), lambda vehicles, t_s: None
        )
