"""Orders from rows of text: every cell that is wrong is named, and nothing is guessed."""

import math
from collections.abc import Mapping

from companion.core.base.geo import EARTH_RADIUS_M
from companion.core.base.safe_text import safe_text
from companion.core.base.site_reach import beyond_reach
from companion.core.mission.flight_plan import frame_at
from ground_station.core.schema.day import Depot, FileProblem
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.orders import BOUNDS, Order, Service

REQUIRED = ("id", "lat_deg", "lon_deg", "mass_kg")
COLUMNS = ("id", "lat_deg", "lon_deg", "alt_amsl_m", "mass_kg", "service", "note")
HEAVIEST_PARCEL_KG = 70.0
"""The limit of parcel services (UPS: 70 kg): what is heavier is freight, or a mass in grams."""
SAME_PLACE_M = 2.0
SAME_PLACE_DEG = math.degrees(SAME_PLACE_M / EARTH_RADIUS_M)  # of latitude


def check_columns(file: str, columns: list[str]) -> list[FileProblem]:
    """What is wrong with a table's header."""
    found = [
        FileProblem(file, 1, name, f"unknown column, expected {', '.join(COLUMNS)}")
        for name in columns
        if name not in COLUMNS
    ]
    found += [
        FileProblem(file, 1, name, "column missing") for name in REQUIRED if name not in columns
    ]
    twice = sorted({name for name in columns if columns.count(name) > 1})
    return found + [FileProblem(file, 1, name, "column more than once") for name in twice]


def order_of(
    file: str,
    row: int,
    cells: Mapping[str, str],
    depot: Depot | None,
    elevation: SiteElevation | None = None,
) -> Order | list[FileProblem]:
    """One order, or everything that is wrong in its row.

    An empty `alt_amsl_m` is the ground's height by `elevation`, without it that of the depot's
    terrain, where the day states one.
    """
    problems: list[FileProblem] = []

    def wrong(column: str, words: str) -> None:
        problems.append(FileProblem(file, row, column, words))

    numbers: dict[str, float] = {}
    for name, (low, high) in BOUNDS.items():
        text = cells.get(name, "").strip()
        if not text:
            if name != "alt_amsl_m":
                wrong(name, "empty, expected a number")
            continue
        value = _number(text)
        if value is None or not low <= value <= high:
            wrong(name, f"{text!r}: expected a number from {low:g} to {high:g}")
        else:
            numbers[name] = value
    if depot is not None and {"lat_deg", "lon_deg"} <= numbers.keys():
        frame = frame_at(depot.place)
        words = beyond_reach(frame, numbers["lat_deg"], numbers["lon_deg"])
        if words:
            wrong("lat_deg", words)
    mass_kg = numbers.get("mass_kg", 0.0)
    if mass_kg > HEAVIEST_PARCEL_KG:
        words = f"{mass_kg:g} kg: expected at most {HEAVIEST_PARCEL_KG:g} kg for a parcel: grams?"
        wrong("mass_kg", words)
    service = cells.get("service", "").strip() or Service.ANY.value
    if service not in [s.value for s in Service]:
        wrong("service", f"{service!r}: expected any, drone or truck")
    if "alt_amsl_m" not in numbers and not cells.get("alt_amsl_m", "").strip():
        known = _ground_amsl_m(depot, elevation, numbers)
        if known is None:
            words = "the day's depot states no terrain, nor the day elevation"
            wrong("alt_amsl_m", f"empty, and {words}")
        elif math.isnan(known):
            wrong("alt_amsl_m", "empty, and the elevation has no height there")
        else:
            numbers["alt_amsl_m"] = known
    id_ = cells.get("id", "").strip()
    if not _is_id(id_):
        wrong("id", f"{id_!r}: expected 1 to 40 letters, digits, '.', '_' or '-'")
    note = cells.get("note", "")
    if len(note) > 500:
        wrong("note", f"{len(note)} characters, expected at most 500")
    if problems:
        return problems
    return Order(id=id_, service=Service(service), note=safe_text(note), **numbers)


def duplicates(file_rows: list[tuple[str, int, Order]]) -> list[FileProblem]:
    """Rows that repeat an id, or the same parcel to the same place."""
    problems: list[FileProblem] = []
    by_id: dict[str, str] = {}
    near: dict[tuple[int, int], list[tuple[Order, str]]] = {}
    for file, row, order in file_rows:
        here = f"{file} row {row}"
        if order.id in by_id:
            words = f"{order.id!r} is in {by_id[order.id]} already"
            problems.append(FileProblem(file, row, "id", words))
        by_id.setdefault(order.id, here)
        around = (one for cell in _cells(order, (-1, 0, 1)) for one in near.get(cell, ()))
        same = next((where for other, where in around if _is_same_parcel(order, other)), None)
        if same is not None and not problems_at(problems, file, row):
            words = f"the same parcel to the same place as {same}: one of them, or"
            words += " a note that tells them apart"
            problems.append(FileProblem(file, row, None, words))
        for cell in _cells(order, (0,)):
            near.setdefault(cell, []).append((order, here))
    return problems


def _cells(order: Order, steps: tuple[int, ...]) -> list[tuple[int, int]]:
    """Squares of `SAME_PLACE_M` around an order, by their band of latitude and place in it."""
    band = math.floor(order.lat_deg / SAME_PLACE_DEG)
    found: list[tuple[int, int]] = []
    for other in (band + step for step in steps):
        column = math.floor(order.lon_deg * _east_frac(other * SAME_PLACE_DEG) / SAME_PLACE_DEG)
        found += [(other, column + step) for step in steps]
    return found


def _east_frac(lat_deg: float) -> float:
    return math.cos(math.radians(lat_deg))


def _is_same_parcel(one: Order, other: Order) -> bool:
    north_deg = one.lat_deg - other.lat_deg
    east_deg = (one.lon_deg - other.lon_deg) * _east_frac(one.lat_deg)
    near = math.hypot(north_deg, east_deg) <= SAME_PLACE_DEG
    return near and (one.mass_kg, one.note) == (other.mass_kg, other.note)


def problems_at(problems: list[FileProblem], file: str, row: int) -> bool:
    """Whether this row has been named already."""
    return any(problem.file == file and problem.row == row for problem in problems)


def _ground_amsl_m(
    depot: Depot | None, elevation: SiteElevation | None, numbers: dict[str, float]
) -> float | None:
    """None: nobody states the ground; NaN: the elevation does not have it there."""
    if elevation is None or not {"lat_deg", "lon_deg"} <= numbers.keys():
        return _terrain_amsl_m(depot, numbers)
    height_m = elevation.at_place(numbers["lat_deg"], numbers["lon_deg"])
    return math.nan if height_m is None else round(height_m, 1)


def _terrain_amsl_m(depot: Depot | None, numbers: dict[str, float]) -> float | None:
    if depot is None or depot.terrain is None or not {"lat_deg", "lon_deg"} <= numbers.keys():
        return None
    frame = frame_at(depot.place)
    lat_rad, lon_rad = math.radians(numbers["lat_deg"]), math.radians(numbers["lon_deg"])
    north_m, east_m, _ = frame.to_ned(lat_rad, lon_rad, frame.alt_amsl_m)
    terrain = depot.terrain
    up_m = terrain.slope_north_frac * north_m + terrain.slope_east_frac * east_m
    return depot.alt_amsl_m + (up_m if terrain.kind == "plane" else 0.0)


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in text else None


def _is_id(text: str) -> bool:
    return (
        0 < len(text) <= 40
        and text.isascii()
        and text[0].isalnum()
        and all(c.isalnum() or c in "._-" for c in text)
    )
