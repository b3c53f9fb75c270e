"""`companion check --init`: writes a flight file, and an airframe file, from known facts.

Each value has its source as a comment. What is not known is left out or taken from the airframe
`generic`, and the comment says so.
"""

import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.autopilots.codec import mavlink
from companion.adapters.files.airframe_toml import write_airframe
from companion.adapters.files.params import read_airframe, read_flight
from companion.adapters.files.qgc_plan import FenceArea
from companion.app.tools.vehicle_facts import SiteFacts, SiteItem, VehicleFacts
from companion.core.base.errors import LeewayError
from companion.core.base.geo import ne_offset_m
from companion.core.vehicle.airframe import Airframe, airframe_from_dict

COMMON_CELLS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 14)
RESTING_CELL_V, TYPICAL_CELL_V = (3.3, 4.4), 3.95
"""Voltages of a resting cell: range, and the typical one that selects among numbers of cells."""

ROTORS = {
    mavlink.MAV_TYPE_QUADROTOR: 4,
    mavlink.MAV_TYPE_HEXAROTOR: 6,
    mavlink.MAV_TYPE_OCTOROTOR: 8,
    mavlink.MAV_TYPE_TRICOPTER: 3,
    mavlink.MAV_TYPE_DODECAROTOR: 12,
}
SPEEDS = (
    *("cruise_airspeed_mps", "max_ground_mps", "climb_mps", "descent_mps", "landing_mps"),
    "max_tilt_deg",
)
RELATIVE = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
WAYPOINTS = (mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT)
DROPS = (mavlink.MAV_CMD_DO_GRIPPER, mavlink.MAV_CMD_NAV_PAYLOAD_PLACE)


def check_new_files(flight_file: Path) -> None:
    """Raise LeewayError if a file that would be written exists, or its folder does not."""
    if flight_file.suffix != ".toml":
        raise LeewayError(f"--mission {flight_file}: expected the path of a new .toml file")
    if not flight_file.parent.is_dir():
        raise LeewayError(f"{flight_file}: its folder does not exist")
    for path in (flight_file, airframe_file(flight_file), obstacle_file(flight_file)):
        if path.exists():
            raise LeewayError(f"{path}: exists already, and --init overwrites no file")


def airframe_file(flight_file: Path) -> Path:
    return flight_file.with_name(f"{flight_file.stem}-airframe.toml")


def obstacle_file(flight_file: Path) -> Path:
    return flight_file.with_name(f"{flight_file.stem}-fence.geojson")


def write_flight_files(
    flight_file: Path, vehicle: VehicleFacts, site: SiteFacts, airframe_name: str | None
) -> tuple[list[Path], list[str]]:
    """Write the flight file and what it names; return the paths, and notes on what is not known."""
    check_new_files(flight_file)
    paths, notes = list[Path](), list[str]()
    airframe_line = f'airframe = "{airframe_name}" # --airframe'
    if airframe_name is None:
        path = airframe_file(flight_file)
        airframe, sources = describe_airframe(vehicle, f"{flight_file.stem}-airframe")
        header = (
            "Written by `companion check --init`. Values without a source are those of generic."
        )
        write_airframe(path, airframe, [header], sources)
        paths.append(path)
        airframe_line = f'airframe = "{path.name}" # {_frame_source(vehicle)}'
        notes.append(
            f"{path}: mass, drag and power are not known to an autopilot: weigh, calibrate"
        )
    excluded = [area for area in site.areas if not area.inclusion]
    if excluded:
        paths.append(obstacle_file(flight_file))
        obstacle_file(flight_file).write_text(json.dumps(_no_fly_document(excluded), indent=1))
    if len(excluded) < len(site.areas):
        notes.append(
            f"{flight_file}: an area of the fence that may not be left is not in it; the autopilot"
            " keeps it: choose a customer inside"
        )
    customer = find_customer(site)
    if customer is None:
        notes.append(
            f"{flight_file}: site.customer is not known, because {site.source} has no waypoint:"
            " state it, then `companion check --mission`"
        )
    lines = [
        f"# Written by `companion check --init` from {vehicle.autopilot or site.source}.",
        'format = "flight/1"',
        f'name = "{flight_file.stem}"',
        "",
        "[site]",
        _location_line("depot", "", site.home, _home_source(site)),
        "# customer = { lat_deg = , lon_deg = , alt_amsl_m = } # not known: the delivery position"
        if customer is None
        else _location_line(
            "customer",
            "customer",
            (*customer[0], site.home[2]),
            f"{customer[1]}; ground height: the depot's",
        ),
        *_rally_lines(site),
        *(
            [f'obstacles = "{obstacle_file(flight_file).name}" # from the fence']
            if excluded
            else []
        ),
        "",
        "[vehicle]",
        airframe_line,
        f"payload_kg = 0.0 # not known: mass of the parcel; gripper: {vehicle.stated('gripper')}",
        "",
        "[mission]",
        _cruise_height_line(vehicle, site),
        "",
        "# Settings that stay in the autopilot; `companion check` compares them with this flight.",
        f"# RTL: {_source_or_unknown(vehicle.quantity('rtl_height_m'))}",
        f"# fence: {vehicle.stated('fence')}",
        f"# forwarding to the ground station: {vehicle.stated('forwarding')}",
    ]
    with flight_file.open("x") as file:
        file.write("\n".join(lines) + "\n")
    if customer is not None:
        read_flight(flight_file)  # what is written is valid
    return [flight_file, *paths], notes


def describe_airframe(
    vehicle: VehicleFacts, name: str
) -> tuple[Airframe, dict[tuple[str, str], str]]:
    """Return `generic` with the vehicle's own values, and the source of each value."""
    table: dict[str, Any] = msgspec.to_builtins(read_airframe("generic")) | {"name": name}
    cell_v = float(np.mean(table["battery"]["ocv_cell_v"]))
    sources: dict[tuple[str, str], str] = {}

    def put(section: str, key: str, value: float, source: str) -> None:
        before = table[section][key]
        table[section][key] = value
        try:
            airframe_from_dict(table)
        except LeewayError as error:
            table[section][key] = before
            sources[section, key] = f"generic; {source} is not usable: {error}"
        else:
            sources[section, key] = source

    if (rotors := ROTORS.get(vehicle.mav_type or 0)) is not None:
        put("power_rotor", "rotor_count", rotors, _frame_source(vehicle))
    for key in SPEEDS:
        if (known := vehicle.quantity(key)) is not None:
            put("speeds", key, *known)
    cells = cells_and_source(vehicle)
    if cells is not None:
        put("battery", "cells", *cells)
    if (capacity := vehicle.quantity("capacity_mah")) is not None:
        wh = round(capacity[0] / 1000.0 * table["battery"]["cells"] * cell_v, 1)
        count = f"{table['battery']['cells']} cells of {cell_v:.2f} V on average"
        put("battery", "nominal_wh", wh, f"{capacity[1]} mAh, {count}")
    for key in SPEEDS:
        sources.setdefault(("speeds", key), "generic: not known")
    for key in ("cells", "nominal_wh"):
        sources.setdefault(("battery", key), "generic: not known")
    sources["mass", "empty_kg"] = "generic: not known to an autopilot; weigh the vehicle"
    return airframe_from_dict(table), sources


def cells_and_source(vehicle: VehicleFacts) -> tuple[int, str] | None:
    """Return the cells in series, from the parameter or the resting voltage; `None`: unknown."""
    if (known := vehicle.quantity("cells")) is not None:
        return round(known[0]), known[1]
    if not (volts := vehicle.voltage_v):
        return None
    low_v, high_v = RESTING_CELL_V
    possible = [n for n in COMMON_CELLS if low_v <= volts / n <= high_v]
    if not possible:
        return None
    cells = min(possible, key=lambda n: abs(volts / n - TYPICAL_CELL_V))
    return cells, f"estimated from {volts:.1f} V at rest, {volts / cells:.2f} V a cell: verify"


def find_customer(site: SiteFacts) -> tuple[tuple[float, float], str] | None:
    """Return the delivery position and its source: where the mission releases, or turns around."""
    last: tuple[int, SiteItem] | None = None
    farthest: tuple[float, tuple[int, SiteItem]] | None = None
    for number, item in enumerate(site.items, 1):
        if any(item.lat_lon_deg):
            last = number, item
        if item.command in DROPS and last is not None:
            return last[1].lat_lon_deg, f"item {last[0]} of {site.source}: before the release"
        if item.command in WAYPOINTS and last is not None and any(item.lat_lon_deg):
            distance_m = math.hypot(*ne_offset_m(*site.home[:2], *item.lat_lon_deg))
            if farthest is None or distance_m > farthest[0]:
                farthest = distance_m, last
    if farthest is None:
        return None
    number, item = farthest[1]
    return item.lat_lon_deg, f"item {number} of {site.source}: the waypoint farthest from home"


def _frame_source(vehicle: VehicleFacts) -> str:
    if vehicle.mav_type is None:
        return "generic: not known"
    name = mavlink.enums["MAV_TYPE"][vehicle.mav_type].name
    return f"HEARTBEAT.type {vehicle.mav_type} ({name}), {vehicle.stated('frame')}"


def _home_source(site: SiteFacts) -> str:
    is_plan = site.source.endswith(".plan")
    return f"plannedHomePosition of {site.source}" if is_plan else "HOME_POSITION"


def _source_or_unknown(known: tuple[float, str] | None) -> str:
    return "not known" if known is None else known[1]


def _location_line(
    key: str, name: str, position: tuple[float, float, float], source: str, end: str = ""
) -> str:
    lat_deg, lon_deg, alt_amsl_m = position
    named = f'name = "{name}", ' if name else ""
    line = f"{{ {named}lat_deg = {lat_deg:.7f}, lon_deg = {lon_deg:.7f}"
    line += f", alt_amsl_m = {alt_amsl_m:.1f} }}{end} # {source}"
    return f"{key} = {line}" if key else f"    {line}"


def _rally_lines(site: SiteFacts) -> list[str]:
    if not site.rally_deg:
        return [f"# rally = [] # {site.source}: no rally points"]
    source = "ground height: the depot's"
    points = [
        _location_line("", f"rally {n}", (*at, site.home[2]), f"rally point {n}; {source}", ",")
        for n, at in enumerate(site.rally_deg, 1)
    ]
    return ["rally = [", *points, "]"]


def _cruise_height_line(vehicle: VehicleFacts, site: SiteFacts) -> str:
    heights_m = [
        item.height_m for item in site.items if item.command in WAYPOINTS and item.frame in RELATIVE
    ]
    known = (max(heights_m), f"highest waypoint of {site.source}") if heights_m else None
    known = known or vehicle.quantity("rtl_height_m")
    if known is None or not 5.0 <= known[0] <= 500.0:
        return f"cruise_height_m = 40.0 # default; {_source_or_unknown(known)}"
    return f"cruise_height_m = {known[0]:.1f} # {known[1]}"


def _no_fly_document(areas: list[FenceArea]) -> dict[str, Any]:
    features = [
        {
            "type": "Feature",
            "properties": {"name": f"fence area {number}", "no_fly": True},
            "geometry": {
                "type": "Polygon",
                "coordinates": [[[lon, lat] for lat, lon in (*area.ring_deg, area.ring_deg[0])]],
            },
        }
        for number, area in enumerate(areas, 1)
    ]
    return {"type": "FeatureCollection", "features": features}
