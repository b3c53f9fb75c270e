"""Readers and writers of each kind of file of `test_compatibility`, as the product has them.

Names of modules and classes here follow the product's. The fixtures never change.
"""

import gzip
import json
import re
import shutil
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.files import (
    certificate_file,
    checkpoint_file,
    monitor_file,
    params,
    policy_file,
    qgc_plan,
    vehicle_settings,
)
from companion.adapters.files.airframe_toml import write_airframe
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.app.flight.fleet_port import FleetPort
from companion.core.mission.checkpoint import Checkpoint, checkpoint_to_dict
from companion.core.pilot.estimates import EstimatesSnapshot, FlightEstimates
from companion.core.routing.leg_energy import RouteEnergy
from companion.fleet import messages as fleet
from companion.fleet.identity import read_and_verify_identity
from companion.fleet.member import FleetMember
from companion.fleet.roster import roster_from_toml, roster_to_toml_text
from ground_station.adapters.files.day_files import read_day, read_day_plan, write_day_plan
from ground_station.adapters.files.token_file import (
    read_owner_only_tokens,
    write_owner_only_tokens_atomically,
)
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.check import find_store_faults
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.truck.truck_member import TruckMember
from sim_bridge.app.flight.scenario import read_faults
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from sim_bridge.research.planners.scenario import parse_scenario, scenario_json
from sim_bridge.truth.fields.field_file import load_wind_field
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.wind_params import parse_wind

ROOT = Path(__file__).parents[2]
WRITTEN = ROOT / "tests/reference/compatibility/3d417155"
SHORT = WRITTEN / "params" / "flights" / "short.toml"
MEMBER_KEY = bytes(range(32, 64))


def plain(value: Any) -> Any:
    """Return values in JSON form; a dataclass becomes a list, as its field names are no format."""
    if is_dataclass(value) and not isinstance(value, type):
        return [plain(getattr(value, one.name)) for one in fields(value)]
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    return json.loads(msgspec.json.encode(value))


ADDED = {
    *("alert", "heading_off_rad", "tilt_off_rad", "velocity_off_mps", "mission_state"),
    *("gnss_alt_m", "gnss_alt_std_m", "pack_resistance", "current_gain"),
    *("yaw_rate_rps", "tilt_rates_rps", "lat_lon_deg", "unanswered", "columns"),
    *("roster", "revoked_since", "recorded_s", "p_home_stated", "required_p_home"),
    "independent_returns",
    *("p_home_next", "p_home_onward", "p_success_onward", "sites", "p_home_stated_min"),
    *("low_spare_wh", "contact_timeout_s", "customer", "phone", "address", "earliest_us"),
    *("latest_us", "priority", "service_s"),
}
"""Keys that later versions write, too."""


def shape(value: Any, at: str = "") -> set[str]:
    """Return the set of keys of a document, regardless of values and number of rows."""
    if isinstance(value, dict):
        kept = ((key, one) for key, one in value.items() if key not in ADDED)
        return {at}.union(*(shape(one, f"{at}.{key}") for key, one in kept))
    if isinstance(value, list):
        return {f"{at}[]"}.union(*(shape(one, f"{at}[]") for one in value))
    return {at}


def content(path: Path) -> Any:
    """Return a file as plain values; for a file with a checksum, its body."""
    raw = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    name = path.name.removesuffix(".gz")
    if name.endswith(".toml"):
        return tomllib.loads(raw.decode())
    if name.endswith(".jsonl"):
        return [json.loads(line) for line in raw.splitlines()]
    if name.endswith((".kml", ".gpx")):
        return dict.fromkeys(re.findall(r"<[^/][^\s>]*|[\w:]+(?==\")", raw.decode()))
    if name.endswith(".waypoints"):
        return {(line.count("\t") or line): None for line in raw.decode().splitlines()}
    found = json.loads(raw)
    return json.loads(found["content"]) if found.keys() == {"crc32", "content"} else found


def no_link(life: str) -> Any:
    """Return no link: a member that only opens its folder does not communicate."""
    return None


def member(path: Path) -> FleetMember:
    found = FleetMember.restore_and_open_link("d1", path.parent, no_link)
    found.log.close()
    return found


def truck(path: Path) -> Any:
    at: dict[str, Any] = {"initial_stop": "?", "lat_deg": 0.0, "lon_deg": 0.0}
    clocks: dict[str, Any] = {"clock_s": lambda: 0.0, "epoch_us": lambda: 0}
    found = TruckMember.load_or_create("truck", path.parent, no_link, **at, **clocks)
    found.member.log.close()
    return found.state


def assigned(path: Path) -> Any:
    m100 = params.read_airframe("m100")
    found = FleetPort.open("d1", "m100", m100, path.parent, no_link)
    found.member.log.close()
    return found.current


def identity(path: Path) -> Any:
    (path.parent / "signing.key").write_text(MEMBER_KEY.hex())
    (path.parent / "signing.key").chmod(0o600)
    trust = read_and_verify_identity(path.parent, lambda: 0).trust
    return [trust.name, trust.fleet, sorted(trust.authority_keys), trust.signed_roster]


def checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint for its flight and restore the estimators from it."""
    shutil.copy(path, path.with_name("checkpoint.json"))
    kept = checkpoint_file.read_checkpoint(path.parent, content(path)["flight"])
    assert kept is not None
    m100, coast = params.read_airframe("m100"), params.read_wind_process("coast")
    estimates = FlightEstimates(params.read_flight(SHORT), m100, RouteEnergy(m100), coast)
    estimates.restore(msgspec.convert(kept.judgement, EstimatesSnapshot))
    assert shape(estimates.snapshot()) == shape(kept.judgement)
    return kept


def certificate(path: Path) -> Any:
    airframe = path.with_name("fitted.toml")
    return certificate_file.read_certificate(airframe, params.read_airframe(str(airframe)))


def tokens(path: Path) -> Any:
    path.chmod(0o600)
    return read_owner_only_tokens(path)


def flight(path: Path) -> Any:
    """Return the companion's part and the simulator's part (wind and faults) of a flight file."""
    found = params.read_flight_with_terrain_heights(path)
    return [found, parse_wind(found.wind), read_faults(found, path)]


def day(path: Path) -> Any:
    data = read_day(path)
    return [data.day, list(data.orders)]


def unpacked(path: Path) -> Path:
    path.with_suffix("").write_bytes(gzip.decompress(path.read_bytes()))
    path.with_suffix("").chmod(0o600)
    return path.with_suffix("")


def store(path: Path) -> Any:
    url = f"sqlite:///{unpacked(path)}"
    assert find_store_faults(url) == []
    database = Database(url, create=False)
    orders, days = Store(database, lambda: 0), DayStore(database, lambda: 0)
    rows = [orders.orders(), orders.assignments(), orders.commands(), orders.events()]
    rows += [
        orders.holds_in_force(),
        days.plans_with_reasons(),
        days.sorties(),
        days.truck_stop_visits(),
        days.day_start_us(),
    ]
    rows += [*read_audit_rows_and_head(database)]
    with database.read() as db:
        names = db.exec_driver_sql("SELECT name FROM sqlite_master WHERE type = 'table'").scalars()
        query = 'SELECT name, type, "notnull", pk FROM pragma_table_info(?)'
        tables = {name: db.exec_driver_sql(query, (name,)).all() for name in sorted(names)}
    database.close()
    return [*rows, {name: [list(row) for row in found] for name, found in tables.items()}]


def recording(path: Path) -> Any:
    events = read_log_of_any_format(unpacked(path)).events
    return sorted(Counter(type(event) for event in events).values())


READERS: dict[str, Callable[[Path], Any]] = {
    "params/flights/*.toml": flight,
    "params/days/*.toml": day,
    "params/airframes/*.toml": lambda path: params.read_airframe(str(path)),
    "params/wind/*.toml": lambda path: params.read_wind_process(str(path)),
    "params/fields/*.toml": load_wind_field,
    "params/truth/*.toml": load_airframe,
    "params/policies/*.toml": lambda path: policy_file.read_policy(str(path))[1],
    "params/autopilots/*.toml": read_parameters,
    "vehicle/fitted.toml": lambda path: params.read_airframe(str(path)),
    "vehicle/fitted.certificate.json": certificate,
    "vehicle/px4-1-unknown.json": vehicle_settings.read_original_parameters,
    "*/monitor.json": monitor_file.read_service_record,
    "*/checkpoint-*.json": checkpoint,
    "identity/roster.toml": lambda path: roster_from_toml(path.read_bytes(), path.name),
    "identity/identity.toml": identity,
    "identity/tokens.json": tokens,
    "fleet/*/commands.json": lambda path: member(path).command_log.to_storage_format(),
    "fleet/*/events.jsonl": lambda path: member(path).log.next_stored_events_after(0),
    "fleet/d1/current.json": assigned,
    "fleet/d1/flight.json": params.read_flight,
    "fleet/*/truck.json": truck,
    "scenarios/*.json": lambda path: parse_scenario(path.read_text()),
    "day-plan*.json": read_day_plan,
    "exports/mission.plan": qgc_plan.read_plan_home_and_items,
    "desk.db.gz": store,
    "flight/decisions.mcap.gz": recording,
    "flight/stream.tlog.gz": recording,
}
WRITERS: dict[str, Callable[[Path, Any], object]] = {
    "vehicle/fitted.toml": lambda path, found: write_airframe(path, found, [], {}),
    "vehicle/fitted.certificate.json": lambda path, found: certificate_file.write_certificate(
        path.with_name("fitted.toml"), found
    ),
    "vehicle/px4-1-unknown.json": vehicle_settings.write_or_remove_original_parameters,
    "*/monitor.json": monitor_file.write_service_record,
    "*/checkpoint-*.json": lambda path, found: (
        checkpoint_file.checkpoint_write_job(path.parent, checkpoint_to_dict(found))(),
        path.with_name("checkpoint.json").replace(path),
    ),
    "identity/roster.toml": lambda path, found: path.write_text(roster_to_toml_text(found)),
    "identity/tokens.json": write_owner_only_tokens_atomically,
    "fleet/*/commands.json": lambda path, found: member(path).save_command_log(),
    "fleet/*/events.jsonl": lambda path, found: path.write_bytes(
        b"\n".join(fleet.encode_message(event) for event in found)
    ),
    "scenarios/*.json": lambda path, found: path.write_bytes(scenario_json(found)),
    "day-plan*.json": write_day_plan,
}


def named(patterns: Iterable[str]) -> list[tuple[str, str]]:
    """Return (pattern, name) of every fixture."""
    found = [(one, path) for one in patterns for path in sorted(WRITTEN.glob(one))]
    return [(one, str(path.relative_to(WRITTEN))) for one, path in found]


def copied(name: str, folder: Path) -> Path:
    """Copy a fixture with its folder: readers may move, unpack and rewrite their input."""
    top = Path(name).parts[0]
    if top == name:
        return Path(shutil.copy(WRITTEN / name, folder / name))
    shutil.copytree(WRITTEN / top, folder / top)
    return folder / name
