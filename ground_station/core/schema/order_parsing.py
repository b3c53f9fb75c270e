"""Orders from rows of text: every invalid cell is reported, and no value is guessed."""

import math
import re
from collections.abc import Callable, Mapping
from datetime import date

from companion.core.base.errors import LeewayError
from companion.core.base.geo import EARTH_RADIUS_M
from companion.core.base.safe_text import safe_text
from companion.core.base.site_reach import site_distance_error_text
from companion.core.mission.flight_plan import depot_frame
from ground_station.core.schema.day import Depot, FileProblem
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.order_window import Window, parse_moment, parse_window
from ground_station.core.schema.orders import (
    MAX_SERVICE_S,
    ORDER_BOUNDS,
    TEXT_LENGTHS,
    Order,
    Priority,
    Service,
    contact_text_error,
    window_error,
)

HEAVIEST_PARCEL_KG = 70.0
"""Limit of parcel services (UPS: 70 kg); a higher value is freight, or a mass in grams."""
SAME_SITE_M = 2.0
SAME_SITE_DEG = math.degrees(SAME_SITE_M / EARTH_RADIUS_M)  # of latitude
URGENT_WORDS = ("urgent", "high", "express", "eilig", "dringend", "urgente", "haster")
NORMAL_WORDS = ("", "normal", "standard", "normale")
_NO_BREAK_SPACES = re.compile("[\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}]")


def parse_order_or_problems(
    file: str,
    row_number: int,
    cell_by_column: Mapping[str, str],
    depot: Depot | None,
    elevation: SiteElevation | None = None,
    today: date | None = None,
) -> Order | list[FileProblem]:
    """Return one order, or all errors in its row.

    An empty `alt_amsl_m` is set to the ground's height by `elevation`, otherwise by the depot's
    terrain, if the day states one. `today`: the date of times without one.
    """
    problems: list[FileProblem] = []

    def add_problem(column: str, message: str) -> None:
        problems.append(FileProblem(file, row_number, column, message))

    numbers: dict[str, float] = {}
    for name, (low, high) in ORDER_BOUNDS.items():
        text = cell_by_column.get(name, "").strip()
        if not text:
            if name != "alt_amsl_m":
                hint = "" if name == "mass_kg" else " (an address is not looked up)"
                add_problem(name, f"empty, expected a number{hint}")
            continue
        value = _parse_finite_number(text)
        if value is None or not low <= value <= high:
            add_problem(name, f"{text!r}: expected a number from {low:g} to {high:g}")
        else:
            numbers[name] = value
    has_position = {"lat_deg", "lon_deg"} <= numbers.keys()
    if depot is not None and has_position:
        frame = depot_frame(depot.location)
        message = site_distance_error_text(frame, numbers["lat_deg"], numbers["lon_deg"])
        if message:
            add_problem("lat_deg", message)
    mass_kg = numbers.get("mass_kg", 0.0)
    if mass_kg > HEAVIEST_PARCEL_KG:
        message = f"{mass_kg:g} kg: expected at most {HEAVIEST_PARCEL_KG:g} kg for a parcel: grams?"
        add_problem("mass_kg", message)
    service = cell_by_column.get("service", "").strip() or Service.ANY.value
    if service not in [s.value for s in Service]:
        add_problem("service", f"{service!r}: expected any, drone or truck")
    states_height = has_position or depot is None
    if states_height and not cell_by_column.get("alt_amsl_m", "").strip():
        known = _ground_amsl_m(depot, elevation, numbers)
        if known is None:
            message = (
                "empty, expected the ground's height above sea level, m (or --day DAY)"
                if depot is None
                else "empty, and the day states no elevation, and its depot no terrain"
            )
            add_problem("alt_amsl_m", message)
        elif math.isnan(known):
            add_problem("alt_amsl_m", "empty, and the elevation has no height there")
        else:
            numbers["alt_amsl_m"] = known
    id_ = cell_by_column.get("id", "").strip()
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}", id_):
        add_problem("id", f"{id_!r}: expected 1 to 40 letters, digits, '.', '_' or '-'")
    note = cell_by_column.get("note", "")
    if len(note) > 500:
        add_problem("note", f"{len(note)} characters, expected at most 500")
    contact = _contact_texts(cell_by_column, add_problem)
    window = _window_or_problem(cell_by_column, today, add_problem)
    priority = cell_by_column.get("priority", "").strip().lower()
    if priority not in (*URGENT_WORDS, *NORMAL_WORDS):
        add_problem("priority", f"{priority!r:.60}: expected normal or urgent")
    service_text = cell_by_column.get("service_s", "").strip()
    service_s = _parse_finite_number(service_text) if service_text else None
    if service_text and (service_s is None or not 0.0 <= service_s <= MAX_SERVICE_S):
        message = f"{service_text!r:.60}: expected seconds from 0 to {MAX_SERVICE_S:g}"
        add_problem("service_s", message)
    if problems:
        return problems
    return Order(
        id=id_,
        service=Service(service),
        note=safe_text(note),
        earliest_us=window[0],
        latest_us=window[1],
        priority=Priority.URGENT if priority in URGENT_WORDS else Priority.NORMAL,
        service_s=service_s,
        customer=contact["customer"],
        phone=contact["phone"],
        address=contact["address"],
        **numbers,
    )


def _contact_texts(
    cell_by_column: Mapping[str, str], add_problem: Callable[[str, str], None]
) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, most in TEXT_LENGTHS.items():
        text = _NO_BREAK_SPACES.sub(" ", cell_by_column.get(name, "")).strip()
        if error := contact_text_error(text, most):
            add_problem(name, error)
        found[name] = safe_text(text)
    return found


def _window_or_problem(
    cell_by_column: Mapping[str, str], today: date | None, add_problem: Callable[[str, str], None]
) -> Window:
    """Return the window of `window`, or of `window_from` and `window_to`."""
    name, window = "window", (None, None)
    try:
        window = parse_window(cell_by_column.get(name, ""), today)
        for at, name in enumerate(("window_from", "window_to")):
            if text := cell_by_column.get(name, "").strip():
                if window[at] is not None:
                    raise LeewayError("stated twice: remove it, or the column window")
                end_us = parse_moment(text, today)
                window = (end_us, window[1]) if at == 0 else (window[0], end_us)
        if error := window_error(window):
            raise LeewayError(error)
    except LeewayError as error:
        add_problem(name, str(error))
    return window


def order_from_cells(
    cell_by_column: Mapping[str, str],
    depot: Depot | None,
    elevation: SiteElevation | None,
    today: date | None,
) -> Order:
    """Return one order that a person has typed. Raises LeewayError with all its errors."""
    found = parse_order_or_problems("order", 1, cell_by_column, depot, elevation, today)
    if isinstance(found, Order):
        return found
    raise LeewayError("; ".join(f"{one.column or 'order'}: {one.text}" for one in found))


def find_duplicate_orders(file_rows: list[tuple[str, int, Order]]) -> list[FileProblem]:
    """Return the rows that repeat an id, or the same parcel to the same position."""
    problems: list[FileProblem] = []
    by_id: dict[str, str] = {}
    near: dict[tuple[int, int], list[tuple[Order, str]]] = {}
    for file, row, order in file_rows:
        row_label = f"{file} row {row}"
        if order.id in by_id:
            message = f"{order.id!r} is in {by_id[order.id]} already"
            problems.append(FileProblem(file, row, "id", message))
        by_id.setdefault(order.id, row_label)
        nearby_orders = (
            one for cell in _same_site_grid_cells(order, (-1, 0, 1)) for one in near.get(cell, ())
        )
        same = next(
            (where for other, where in nearby_orders if _is_same_parcel(order, other)), None
        )
        if same is not None and not any((one.file, one.row) == (file, row) for one in problems):
            message = f"the same parcel to the same place as {same}: remove one, or"
            message += " add a note that distinguishes them"
            problems.append(FileProblem(file, row, None, message))
        for cell in _same_site_grid_cells(order, (0,)):
            near.setdefault(cell, []).append((order, row_label))
    return problems


def _same_site_grid_cells(order: Order, cell_offsets: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return squares of `SAME_SITE_M` around an order: band of latitude and index in it."""
    band = math.floor(order.lat_deg / SAME_SITE_DEG)
    found: list[tuple[int, int]] = []
    for other in (band + step for step in cell_offsets):
        column = math.floor(order.lon_deg * _longitude_scale(other * SAME_SITE_DEG) / SAME_SITE_DEG)
        found += [(other, column + step) for step in cell_offsets]
    return found


def _longitude_scale(lat_deg: float) -> float:
    return math.cos(math.radians(lat_deg))


def _is_same_parcel(first_order: Order, second_order: Order) -> bool:
    north_deg = first_order.lat_deg - second_order.lat_deg
    east_deg = (first_order.lon_deg - second_order.lon_deg) * _longitude_scale(first_order.lat_deg)
    near = math.hypot(north_deg, east_deg) <= SAME_SITE_DEG
    first, second = (
        (one.mass_kg, one.note, one.customer, one.address, one.window)
        for one in (first_order, second_order)
    )
    return near and first == second


def _ground_amsl_m(
    depot: Depot | None, elevation: SiteElevation | None, number_by_column: dict[str, float]
) -> float | None:
    """Return the ground height; None: not stated; NaN: outside the elevation data."""
    if elevation is None or not {"lat_deg", "lon_deg"} <= number_by_column.keys():
        return _terrain_amsl_m(depot, number_by_column)
    height_m = elevation.height_amsl_at(number_by_column["lat_deg"], number_by_column["lon_deg"])
    return math.nan if height_m is None else round(height_m, 1)


def _terrain_amsl_m(depot: Depot | None, number_by_column: dict[str, float]) -> float | None:
    if (
        depot is None
        or depot.terrain is None
        or not {"lat_deg", "lon_deg"} <= number_by_column.keys()
    ):
        return None
    frame = depot_frame(depot.location)
    lat_rad = math.radians(number_by_column["lat_deg"])
    lon_rad = math.radians(number_by_column["lon_deg"])
    north_m, east_m, _ = frame.to_ned(lat_rad, lon_rad, frame.alt_amsl_m)
    terrain = depot.terrain
    up_m = terrain.slope_north_frac * north_m + terrain.slope_east_frac * east_m
    return depot.alt_amsl_m + (up_m if terrain.kind == "plane" else 0.0)


def _parse_finite_number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in text else None
