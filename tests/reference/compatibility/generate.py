"""Write the fixtures of test_compatibility.py with the code of commit 3d417155.

A development tool, not a test. The fixtures are files of an earlier version: later versions never
regenerate them. A later version that adds a format adds a separate folder. To repeat the run,
check out commit 3d417155 next to the commit that added this script:

    git worktree add ../base 3d417155
    cd ../base && PYTHONPATH=$PWD python ../leeway/tests/reference/compatibility/generate.py

It flies one short flight and one day (about five minutes; `DAY_RUNS` names the runs folder of an
earlier `sim-bridge day harbour --seed 1`). Simulated vehicles send in real threads, so the
recordings differ slightly between runs; their keys do not.
"""

import gzip
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.files.airframe_toml import write_airframe
from companion.adapters.files.atomic_file import write_whole
from companion.adapters.files.certificate_file import write_certificate
from companion.adapters.files.monitor_file import write_service
from companion.adapters.files.params import read_airframe
from companion.adapters.files.vehicle_settings import write_settings
from companion.app.flight.fleet_port import Assigned
from companion.app.tools.export import ExportRequest, export
from companion.core.certificate.certify import MeasuredFlight, Scatter, certify
from companion.core.exports.export_format import ExportFormat
from companion.core.monitor.figures import FlightFigures, LogRatio
from companion.core.monitor.service import after_flight, begun_anew, reset
from companion.core.separation.track import Track
from companion.core.wind_field.shared_winds import SharedWinds, ToldFront, ToldWind
from companion.fleet import messages as m
from companion.fleet.envelope import put_in_envelope
from companion.fleet.roles import Role
from companion.fleet.roster import Roster, RosterMember, SignedRoster, roster_toml
from companion.fleet.signature import public_key_of, sign
from companion.fleet.trust import ROSTER_KIND
from ground_station.adapters.files.plan_files import write_day_plan
from ground_station.adapters.files.token_file import write_tokens
from ground_station.adapters.store.copies import backup
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.core.fleet.station_message import StationWind, encode_station
from ground_station.core.fleet.truck_state import Task, TaskKind, TruckState
from ground_station.core.people.web_tokens import TokenBook
from ground_station.core.schema.day_plan import DayPlan, Unplanned
from sim_bridge.research.planners.scenario import parse_scenario, scenario_json

HERE = Path(__file__).parent
BASE = Path.cwd()
OUT = HERE / "3d417155"
RUNS = OUT / "runs"
PARAMS = ("airframes", "autopilots", "days", "fields", "flights", "policies", "sites", "truth")
AUTHORITY, MEMBER = bytes(range(32)), bytes(range(32, 64))
"""Public test keys of the fixtures' fleet, of no use outside the test."""
KEPT_PHASES = ("ready", "outbound", "return", "land", "done")
MOST_BYTES = {"stream.tlog": 150_000}
"""A recording may end anywhere: readers use the complete records."""
AT_M = {"lat_deg": 55.47, "lon_deg": 8.45}

FULL_FLIGHT = """\
format = "flight/1"
name = "full"

[site]
depot = { name = "pad", lat_deg = 55.47, lon_deg = 8.45, alt_amsl_m = 12.0 }
customer = { name = "customer", east_m = -130.0, north_m = -35.0, up_m = 0.65 }
rally = [{ name = "quay", lat_deg = 55.471, lon_deg = 8.44, alt_amsl_m = 15.0 }]
stops = [{ name = "stop-1", east_m = 0.0, north_m = 0.0, up_m = 0.0 }]
home = "stop-1"
obstacles = "../sites/harbour.geojson"
terrain = { kind = "plane", slope_east_frac = -0.005, slope_north_frac = 0.001 }
air_temperature_c = 12.0

[vehicle]
airframe = "m100"
payload_kg = 0.6
charge_frac = [0.8, 0.9]
temperature_c = 15.0
battery_health_frac = 0.95
pitot = true
autopilot_wind = true

[mission]
max_loss = 0.01
max_loss_per_hour = 0.05
reserve_frac = 0.15
cruise_height_m = 40.0
return_height_m = 52.0
clearance_m = 20.0
drop_height_m = 6.0
leg_length_m = 150.0
wind_settle_s = 10.0
time_limit_s = 1800.0
cruise_airspeed_mps = 12.0
speed = "least_energy"
wind_process = "coast"
corner_tolerance_m = 5.0
authorised_zones = ["A1"]
from_utc = "2026-05-01T08:00:00Z"
until_utc = "2026-05-01T18:00:00Z"

[[neighbours]]
fleet = "town"
keys = { t1 = "KEY" }

[wind]
kind = "points"
points = [{ t_s = 0.0, speed_mps = 4.0, from_deg = 80.0 }]
turbulence = "dryden"

[[faults]]
kind = "companion_kill"
at_s = 20.0
phase = "outbound"
duration_s = 4.0
restart = true
vehicle = 1
"""

SHORT_FLIGHT = """\
format = "flight/1"
name = "short"
[site]
depot = { lat_deg = 55.47, lon_deg = 8.45, alt_amsl_m = 12.0 }
customer = { name = "customer", east_m = -80.0, north_m = -20.0 }
[vehicle]
airframe = "m100"
payload_kg = 0.6
[mission]
cruise_height_m = 15.0
[wind]
kind = "points"
points = [{ t_s = 0.0, speed_mps = 4.0, from_deg = 80.0 }]
"""

FULL_DAY = """\
format = "day/1"
name = "full"
fleet = "harbour"
neighbours = ["town"]
orders = ["harbour_orders.csv"]
no_fly = "../sites/harbour.geojson"
wind_limit_mps = 11.0
watch_fronts = false
rally = [{ name = "quay", lat_deg = 55.471, lon_deg = 8.44, alt_amsl_m = 15.0 }]

[depot]
lat_deg = 55.47
lon_deg = 8.45
alt_amsl_m = 12.0
terrain = { kind = "plane", slope_east_frac = -0.005, slope_north_frac = 0.0 }

[truck]
speed_mps = 8.0
detour_factor = 1.3
capacity_kg = 800.0
deliver_s = 90.0
launch_s = 60.0
recover_s = 30.0
ready_s = 60.0

[mission]
max_loss = 0.01

[forecast]
speed_mps = 4.0
from_deg = 80.0
std_mps = 2.0
air_temperature_c = 12.0

[[stations]]
id = "mast"
lat_deg = 55.47
lon_deg = 8.45
height_m = 10.0

[[drones]]
id = "d1"
airframe = "m100"
charge_frac = 0.9
temperature_c = 18.0
battery_health_frac = 0.95
"""


def put(name: str, content: str | bytes) -> None:
    """Write one fixture; a name ending in .gz is compressed."""
    path = OUT / name
    path.parent.mkdir(parents=True, exist_ok=True)
    raw = content.encode() if isinstance(content, str) else content
    path.write_bytes(gzip.compress(raw, mtime=0) if path.suffix == ".gz" else raw)


def params() -> None:
    """Copy the shipped files, and add ones that use every key."""
    for folder in (*PARAMS, "wind"):
        shutil.copytree(BASE / "params" / folder, OUT / "params" / folder)
    for path in OUT.rglob("avoid_curve.csv"):
        path.unlink()
    key = public_key_of(MEMBER)
    for path in (OUT / "params").rglob("*.toml"):  # comments cite pages that may be removed
        text = path.read_text()
        bare = re.sub(r'(^|\s+)#[^"\n]*$', "", re.sub(r"^#.*\n", "", text, flags=re.M), flags=re.M)
        assert tomllib.loads(bare) == tomllib.loads(text), path
        path.write_text(bare)
    flights = OUT / "params" / "flights"
    (flights / "full.toml").write_text(FULL_FLIGHT.replace("KEY", key))
    (flights / "short.toml").write_text(SHORT_FLIGHT)
    (OUT / "params" / "days" / "full.toml").write_text(FULL_DAY)
    for folder in ("days", "sites"):  # only those that the kept days and flights name
        for path in (OUT / "params" / folder).iterdir():
            if "harbour" not in path.name and path.name not in ("full.toml", "hills.csv"):
                path.unlink()


def vehicle() -> None:
    """Write the companion's files about a vehicle."""
    airframe = read_airframe("m100", BASE / "params")
    (OUT / "vehicle").mkdir()
    write_airframe(OUT / "vehicle/fitted.toml", airframe, ["Fitted."], {("mass", "empty_kg"): "x"})
    flights = [
        MeasuredFlight(
            f"f{day}", f"2026-05-{day:02d}", 20.2, 20.0, 150, 1.01, 5.0, 12.0, 0.25, 12.0
        )
        for day in range(1, 12)
    ]
    written = read_airframe(str(OUT / "vehicle/fitted.toml"))
    left_out = ["f12: too short"]
    certificate = certify(written, flights, Scatter(0.01, 0.03), left_out)
    write_certificate(OUT / "vehicle/fitted.toml", certificate)
    service = begun_anew("0123456789abcdef", lost=True)
    for number in range(6):
        figures = FlightFigures(LogRatio(0.02, 0.03), LogRatio(0.01, 0.055), 0, 5)
        service = after_flight(service, figures, "A", f"flight {number}", 40_000.0 * number)
    service = reset(service, "draw", "anna", "new motors", 250_000.0)
    write_service(OUT / "vehicle/monitor.json", service)
    write_settings(OUT / "vehicle/px4-1-unknown.json", {"MPC_XY_VEL_MAX": 12.0, "NAV_RCL_ACT": 2.0})


def identities() -> None:
    """Write a signed roster with members of two fleets, and the identity of one of them."""
    until = datetime(2099, 1, 1, tzinfo=UTC)
    key = public_key_of(MEMBER)
    members = [
        RosterMember(name="d1", role=Role.VEHICLE, key=key, not_after=until),
        RosterMember(
            name="desk", role=Role.DESK, key=key, not_after=until, address="127.0.0.1:7447"
        ),
        RosterMember(name="town", role=Role.NEIGHBOUR, key=key, not_after=until, revoked=True),
    ]
    text = roster_toml(Roster(fleet="harbour", number=3, members=members))
    authority = public_key_of(AUTHORITY)
    names = {"kind": ROSTER_KIND, "fleet": "harbour", "signer": ROSTER_KIND}
    signature = sign(AUTHORITY, raw=text.encode(), **names).hex()
    signed = SignedRoster(roster=text, signatures={authority: signature})
    put("identity/roster.toml", text)
    put("identity/roster.json", msgspec.json.encode(signed))
    put(
        "identity/identity.toml",
        f'format = "identity/1"\nfleet = "harbour"\nname = "d1"\nauthorities = ["{authority}"]\n',
    )
    book = TokenBook().added("anna", Role.DISPATCHER, "a token", "2026-05-01")
    write_tokens(OUT / "identity/tokens.json", book.added("ben", Role.VIEWER, "b", "2026-05-02"))


def wire_messages() -> None:
    """Write every message of the fleet network, once with all keys and once with the fewest."""
    told = ToldWind("d2", 3, 120, -80, 40, 350, -120, 25, 30)
    front = ToldFront(
        arrives_in_s=90.0, slow_n_spm=0.1, slow_e_spm=-0.05, std_s=12.0, slow_std_spm=0.02,
        behind_n_mps=5.0, behind_e_mps=-6.0, change_mps=7.0,
    )  # fmt: skip
    state = m.State(
        vehicle="d1", life="a1", uptime_s=12.5, epoch_us=1_777_000_000_000_000, airframe="m100",
        max_payload_kg=1.0, phase="standby", log="l1", last_seq=4,
    )  # fmt: skip
    full_state = msgspec.structs.replace(
        state, phase="outbound", assignment="o1.1", order="o1", armed=True, delivered=True,
        height_rel_m=40.0, ground_speed_mps=11.0, voltage_v=22.1, energy_left_wh=80.0,
        margin_wh=20.0, p_home=0.999, p_home_now=0.998, p_success=0.99, wind_to_n_mps=1.0,
        wind_to_e_mps=-4.0, wind_cov_m2ps2=(0.3, 0.01, 0.4), home="stop-1", stop="s1", text="t",
        doubt="draw", way_out="_p~iF~ps|U", way_home="_ulLnnqC", **AT_M,
    )  # fmt: skip
    event = m.FleetEvent(
        vehicle="d1", log="l1", seq=1, epoch_us=1, kind=m.EventKind.SAID, text="ready"
    )
    outcome = msgspec.structs.replace(
        event, kind=m.EventKind.OUTCOME, seq=2, assignment="o1.1", order="o1", p_home=0.99,
        margin_wh=21.0, outcome="SUC", delivered=True, home=True, evidence_nats=0.1,
        drop_unproven=False,
    )  # fmt: skip
    flight = {"format": "flight/1", "name": "o1"}
    deeds = [
        m.Assign(assignment="o1.1", order="o1", flight=flight, obstacles={"features": []}),
        m.Launch(assignment="o1.1"),
        m.Withdraw(assignment="o1.1"),
        m.Recall(),
        m.MoveHome(assignment="o1.1", home="stop-1"),
        m.Drive(stop="s1", **AT_M),
        m.Serve(assignment="o1.1", order="o1"),
        m.PutOut(assignment="o1.1", order="o1", vehicle="d1", **AT_M),
        m.Recover(assignment="o1.1", vehicle="d1", parcel="o1", **AT_M),
        m.HandsOff(),
        m.HandBack(),
        m.SetLimits(max_loss=0.02, reserve_frac=0.2),
    ]
    commands = [
        m.Command(id=f"c{n}", vehicle="d1", life="a1", as_of_s=3.0, by="anna", deed=deed)
        for n, deed in enumerate(deeds)
    ]
    results = [
        m.Result(id="c1", vehicle="d1", life="a1", answer=answer, reason="so")
        for answer in m.Answered
    ]
    track = Track(
        vehicle="d1", gnss_s=1.7e9, alt_amsl_m=52.0, vel_n_mps=1.0, vel_e_mps=-9.0, vel_d_mps=0.1,
        pos_std_m=1.5, alt_std_m=2.0, vel_std_mps=0.2, aside=True, to_lat_deg=55.48,
        to_lon_deg=8.44, **AT_M,
    )  # fmt: skip
    winds = SharedWinds(vehicle="d1", life="a1", as_of_s=3.0, told=[told], **AT_M)
    with_front = msgspec.structs.replace(winds, front=front)
    withdrawn = msgspec.structs.replace(winds, front=None)
    station = StationWind(
        station="mast", epoch_us=1, speed_mps=5.0, from_deg=80.0, std_mps=0.4, height_m=10.0, **AT_M
    )
    told_messages = (
        ("state", [state, full_state]),
        ("event", [event, outcome]),
        ("command", commands),
        ("result", results),
        ("track", [track]),
        ("winds", [winds, with_front, withdrawn]),
    )
    rows = [(kind, m.encode(one)) for kind, some in told_messages for one in some]
    rows.append(("station", encode_station(station)))
    sealed = [
        put_in_envelope("d1", sign(MEMBER, kind=k, fleet="harbour", signer="d1", raw=raw), raw)
        for k, raw in rows
    ]
    lines = [
        json.dumps({"kind": k, "raw": raw.decode(), "envelope": envelope.hex()})
        for (k, raw), envelope in zip(rows, sealed, strict=True)
    ]
    put("wire.jsonl.gz", "\n".join(lines) + "\n")


def flight() -> None:
    """Fly once with a monitor, and keep a checkpoint of each phase."""
    RUNS.mkdir()
    env = os.environ | {"STATE_DIRECTORY": str(RUNS / "state"), "PYTHONPATH": str(BASE)}
    code = "from sim_bridge.main import main; main()"
    asked = ["fly", str(OUT / "params" / "flights" / "short.toml"), "--seed", "1", "--no-picture"]
    asked += ["--speedup", "8", "--runs", str(RUNS)]
    flown = subprocess.Popen([sys.executable, "-c", code, *asked], env=env)
    run = RUNS / "short-px4-seed1"
    kept: dict[str, str] = {}
    while flown.poll() is None:
        time.sleep(0.02)
        path = run / "checkpoint.json"
        if path.exists():
            text = path.read_text()
            kept[json.loads(json.loads(text)["content"])["phase"]] = text
    assert flown.returncode == 0, "the flight failed"
    assert {"outbound", "return"} < set(kept), kept.keys()
    for phase, text in kept.items():
        if phase in KEPT_PHASES:
            put(f"flight/checkpoint-{phase}.json", text)
    for name in ("decisions.mcap", "stream.tlog", "result.json", "flights.json", "mission.plan"):
        put(f"flight/{name}.gz", (run / name).read_bytes()[: MOST_BYTES.get(name)])
    for path in RUNS.rglob("m100.json"):
        shutil.copy(path, OUT / "flight/monitor.json")


def day() -> None:
    """Fly a day; keep the desk's store and the files of a drone and of the truck."""
    runs = Path(os.environ.get("DAY_RUNS", RUNS))  # of a day that was flown earlier
    if runs == RUNS:
        code = "from sim_bridge.main import main; main()"
        asked = ["day", "harbour", "--seed", "1", "--no-picture", "--runs", str(RUNS)]
        env = os.environ | {"PYTHONPATH": str(BASE)}
        subprocess.run([sys.executable, "-c", code, *asked], env=env, check=True)
    run = next(runs.glob("day-*"))
    (OUT / "fleet/d1").mkdir(parents=True)
    (OUT / "fleet/truck").mkdir()
    drone = next(path.parent for path in run.rglob("commands.json") if path.parent.name == "d1")
    truck = next(run.rglob("truck.json")).parent
    for folder, name in ((drone, "d1"), (truck, "truck")):
        for file in ("commands.json", "events.jsonl", "truck.json"):
            if (folder / file).exists():
                shutil.copy(folder / file, OUT / "fleet" / name / file)
    flown = sorted(drone.glob("assignment-*"))[-1]
    shutil.copy(flown / "flight.json", OUT / "fleet/d1/flight.json")
    shutil.copy(flown / "checkpoint.json", OUT / "flight/checkpoint-of-a-stop.json")
    tasks = [
        Task(kind=kind, id=f"o{n}.1", order=f"o{n}", vehicle="d1", parcel=f"o{n}", **AT_M)
        for n, kind in enumerate(TaskKind)
    ]
    at_work = TruckState(stop="s1", driving=True, tasks=tasks, done=["serve:o9.1"], **AT_M)
    (OUT / "fleet/truck-at-work").mkdir()
    write_whole(OUT / "fleet/truck-at-work/truck.json", msgspec.to_builtins(at_work))
    assigned = Assigned(assignment="o1.1", order="o1")
    write_whole(OUT / "fleet/d1/current.json", msgspec.to_builtins(assigned))
    store = next(path for path in run.rglob("*.db"))
    copy = OUT / "desk.db"
    shutil.copy(store, copy)
    database = Database(f"sqlite:///{copy}")
    holds = HoldStore(database, itertools.count(2_000_000_000_000_000).__next__)
    holds.set(["d1", "d2"], "checks", "anna")
    holds.release(["d2"], "ben")
    with database.read() as db:
        (plan,) = db.exec_driver_sql("SELECT content FROM plans ORDER BY revision LIMIT 1").one()
    database.close()
    backup(f"sqlite:///{copy}", OUT / "desk.db.copy")
    put("desk.db.gz", (OUT / "desk.db.copy").read_bytes())
    for path in OUT.glob("desk.db*"):
        if path.suffix != ".gz":
            path.unlink()
    made = msgspec.json.decode(plan, type=DayPlan)
    write_day_plan(OUT / "day-plan.json", made)
    left = [Unplanned(order="o9", why="too far", remedy="a longer day")]
    write_day_plan(
        OUT / "day-plan-2.json", msgspec.structs.replace(made, unplanned=left, revision=1)
    )


def exports() -> None:
    """Write a mission in every format."""
    for file_format in ExportFormat:
        wanted = ExportRequest(BASE / "params/flights/default.toml", file_format)
        done = export(wanted)
        put(f"exports/mission{file_format.suffix}", done.text)
        for ending, text in done.beside.items():
            put(f"exports/mission{ending}", text)


def scenarios() -> None:
    """Write scenarios of the planners' experiments, with both kinds of wind."""
    chain = {
        "kind": "chain", "states_en_mps": [[1, 2], [0, 1]], "rate_per_s": [[-1, 1], [1, -1]],
        "initial": [0.5, 0.5],
    }  # fmt: skip
    log = {"kind": "log", "t_s": [0, 1], "wind_en_mps": [[1, 2], [2, 3]], "start_s": [0, 1]}
    rest: dict[str, Any] = {
        "format": "delivery-scenario/1", "name": "a", "depot": 0, "target": 1, "budget_wh": 100,
        "vertices_m": [[0, 0, 0], [10, 20, 3], [5, 5, 5]], "edges": [[0, 1], [1, 0], [1, 2]],
        "airspeed_mps": 15.0, "power_w": {"loaded": 2000.0, "empty": 1100.0},
    }  # fmt: skip
    for wind in (chain, log):
        scenario = parse_scenario(json.dumps({**rest, "wind": wind}))
        put(f"scenarios/{wind['kind']}.json", scenario_json(scenario))


def readings() -> None:
    """Write the values that this version reads in the files, with the readers of `kept_formats`."""
    sys.path.append(str(HERE.parents[2]))  # after the base's, so that only `tests` is found there
    from tests.house import kept_formats as kept

    found: dict[str, Any] = {}
    for pattern, name in kept.named(kept.READERS):
        with tempfile.TemporaryDirectory() as folder:
            path = kept.copied(name, Path(folder))
            found[name] = kept.plain(kept.READERS[pattern](path))
    put("readings.json.gz", json.dumps(found, sort_keys=True))


if __name__ == "__main__":
    import companion

    assert Path(companion.__file__).is_relative_to(BASE), companion.__file__
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    for write in (params, vehicle, identities, wire_messages, scenarios, exports, flight, day):
        write()
        print(write.__name__, flush=True)
    shutil.rmtree(RUNS)
    readings()
