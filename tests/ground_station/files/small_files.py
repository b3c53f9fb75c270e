"""Small files for the corpus of imports, by the published formats, and their results as text."""

import io
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from companion.adapters.files.qgc_plan import read_plan_home_and_items
from companion.core.base.errors import LeewayError
from companion.core.base.import_report import ImportReport
from companion.core.base.obstacle_document import parse_obstacles, review_obstacles
from companion.core.mission.flight_plan import depot_frame
from ground_station.adapters.files.elevation import read_elevation
from ground_station.adapters.files.forecast_files import read_forecast
from ground_station.adapters.files.order_files import read_orders
from ground_station.adapters.files.params import read_json
from ground_station.adapters.files.station_file import StationFile
from ground_station.core.schema.day import Depot
from ground_station.core.schema.order_changes import order_cells
from ground_station.core.schema.order_columns import parse_column_headings
from ground_station.core.weather.forecast_field import WindAt
from tests.ground_station.weather.open_meteo import START_S, answer

DEPOT = Depot(lat_deg=55.47, lon_deg=8.45, alt_amsl_m=12.0)
FRAME = depot_frame(DEPOT.location)


def point(coordinates: Any, **properties: Any) -> dict[str, Any]:
    """Return an order as a GeoJSON feature."""
    geometry = None if coordinates is None else {"type": "Point", "coordinates": coordinates}
    values = {"id": "A-1", "mass_kg": 0.4} | properties
    return {"type": "Feature", "geometry": geometry, "properties": values}


def collection(*features: Any) -> dict[str, Any]:
    """Return a GeoJSON document."""
    return {"type": "FeatureCollection", "features": list(features)}


def square(half_deg: float = 0.05, lon: float = 8.45, lat: float = 55.47) -> list[list[float]]:
    """Return a ring around a position."""
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    return [[lon + east * half_deg, lat + north * half_deg] for east, north in signs]


def zone(*rings: Any, volume: Any = None, **changed: Any) -> dict[str, Any]:
    """A zone as ED-269 with one volume around the depot, parts of it changed."""
    limits = {"uomDimensions": "M", "lowerLimit": 0, "lowerVerticalReference": "AGL"}
    limits |= {"upperLimit": 120, "upperVerticalReference": "AGL"}
    shape = {"type": "Polygon", "coordinates": list(rings) or [square()]}
    geometry = [limits | {"horizontalProjection": shape} | (volume or {})]
    values = {"identifier": "Z1", "country": "XXX", "name": "Z1", "type": "COMMON"}
    values |= {"restriction": "PROHIBITED", "applicability": [{"permanent": "YES"}]}
    return values | {"geometry": geometry} | changed


def published(*rings: Any, **limits: Any) -> dict[str, Any]:
    """A zone as authorities publish it: GeoJSON with the limits in `properties.geometry`."""
    values = zone() | {"geometry": {"uomDimensions": "M", **limits}}
    shape = {"type": "Polygon", "coordinates": list(rings)}
    return {"type": "Feature", "geometry": shape, "properties": values}


def ed318(shape: dict[str, Any], **layer: Any) -> dict[str, Any]:
    """A zone of ED-318: a GeoJSON feature whose geometry has a layer."""
    limits = {"lower": 0, "lowerReference": "AGL", "upper": 120, "upperReference": "AGL"}
    values = {"identifier": "Z1", "country": "XXX", "type": "PROHIBITED", "variant": "COMMON"}
    values |= {"name": [{"text": "Z1", "lang": "en-GB"}], "limitedApplicability": []}
    geometry = shape | {"layer": limits | {"uom": "m"} | layer}
    return {"type": "Feature", "geometry": geometry, "properties": values}


def block(ring: Any, **properties: Any) -> dict[str, Any]:
    """Return an obstacle as a GeoJSON feature."""
    values = {"name": "silo", "height_m": 75} | properties
    shape = {"type": "Polygon", "coordinates": [ring]}
    return {"type": "Feature", "geometry": shape, "properties": values}


def circle(**changed: Any) -> dict[str, Any]:
    """Return a zone with a circle over the depot."""
    shape = {"type": "Circle", "center": [8.45, 55.47], "radius": 500} | changed
    return zone(volume={"horizontalProjection": shape})


def tile(
    crs: str | None = "EPSG:4326", value: float = 300.0, hole: float | None = None, **meta: Any
) -> Callable[[Path], None]:
    """Writer of a tile of one height, with a hole of some value over the depot."""

    def write(path: Path) -> None:
        import rasterio

        heights = np.full((120, 120), value, "float32")
        if hole is not None:
            heights[50:70, 50:70] = hole
        place = rasterio.transform.from_origin(
            meta.pop("west", 8.4), 55.52, 1.0 / 1200.0, 1.0 / 1200.0
        )
        profile = {"driver": "GTiff", "height": 120, "width": 120, "count": 1, "dtype": "float32"}
        nodata = meta.pop("nodata", None)
        with rasterio.open(path, "w", crs=crs, transform=place, nodata=nodata, **profile) as file:
            file.write(heights, 1)
            for key, one in meta.items():
                setattr(file, key, (one,))

    return write


def hourly(change: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
    """Return an Open-Meteo response with a change."""
    document = answer()
    change(document)
    return document


def set_at(key: str, index: int, value: Any) -> dict[str, Any]:
    """Return an Open-Meteo response with one value changed."""
    return hourly(lambda d: d["hourly"][key].__setitem__(index, value))


def in_unit(unit: str) -> dict[str, Any]:
    """Return an Open-Meteo response with the wind at 80 m in a unit."""
    return hourly(lambda d: d["hourly_units"].update(wind_speed_80m=unit))


def plan(*items: Any, version: int = 1, **changed: Any) -> dict[str, Any]:
    """Return a plan of QGroundControl."""
    mission = {"version": 2, "plannedHomePosition": [55.47, 8.45, 12.0], "items": list(items)}
    return {"fileType": "Plan", "version": version, "mission": mission | changed}


def sheet(*tables: list[list[Any]]) -> bytes:
    """An .xlsx file by the Open Packaging Conventions, one sheet for each table."""
    base = "http://schemas.openxmlformats.org"
    main, rels = f"{base}/spreadsheetml/2006/main", f"{base}/package/2006/relationships"
    kind = f"{base}/officeDocument/2006/relationships"

    def links(targets: dict[str, str]) -> str:
        parts = (
            f'<Relationship Id="r{n}" Type="{kind}/{name}" Target="{target}"/>'
            for n, (target, name) in enumerate(targets.items(), 1)
        )
        return f'<Relationships xmlns="{rels}">{"".join(parts)}</Relationships>'

    def cell(value: Any) -> str:
        if isinstance(value, float):
            return f"<c><v>{value}</v></c>"
        return f'<c t="inlineStr"><is><t>{value}</t></is></c>'

    numbers = range(1, len(tables) + 1)
    names = "".join(f'<sheet name="S{n}" sheetId="{n}" r:id="r{n}"/>' for n in numbers)
    parts = {
        "_rels/.rels": links({"xl/workbook.xml": "officeDocument"}),
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{kind}"><sheets>{names}</sheets>'
        "</workbook>",
        "xl/_rels/workbook.xml.rels": links({f"{n}.xml": "worksheet" for n in numbers}),
    }
    for number, table in zip(numbers, tables, strict=True):
        rows = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in table)
        content = f'<worksheet xmlns="{main}"><sheetData>{rows}</sheetData></worksheet>'
        parts[f"xl/{number}.xml"] = content
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as file:
        for name, text in parts.items():
            file.writestr(name, '<?xml version="1.0"?>' + text)
    return packed.getvalue()


def headed(header: str, row: str = "A-1,55.468,8.44,12.5,0.4") -> str:
    """Return a table of orders with one row."""
    return f"{header}\n{row}\n"


def cells(**changed: str) -> str:
    """A table with one order, some of its cells changed."""
    row = {"id": "A-1", "lat_deg": "55.468", "lon_deg": "8.44", "alt_amsl_m": "12.5"}
    row |= {"mass_kg": "0.4"} | changed
    return f"{','.join(row)}\n{','.join(row.values())}\n"


def orders_result(path: Path, columns: str | None = None) -> str:
    headings = {} if columns is None else parse_column_headings(columns)
    orders, report = read_orders(path, DEPOT, headings)
    if not orders:
        return "0 used"
    one = orders[0]
    values = f"{one.id} {one.lat_deg:g} {one.lon_deg:g} {one.alt_amsl_m:g} {one.mass_kg:g}"
    notes = "; ".join(report.notes)
    customers = ("customer", "phone", "address", "window", "priority", "service_s")
    more = [text for name in customers if (text := order_cells(one)[name]) not in ("", "normal")]
    shown = "".join(f" {{{text}}}" for text in more)
    return f"{report.used} used; {values} {one.service.value} ({one.note}){shown} | {notes}"


def zones_result(path: Path) -> str:
    """Whether the depot is inside is found by shapely, not by the planner."""
    document = read_json(path)
    report, defects = review_obstacles(path.name, FRAME, document)
    if defects:
        raise LeewayError("; ".join(f"{row}: {text}" for row, text in defects))
    found = parse_obstacles(FRAME, document, ground_bounds_m=(0.0, 0.0))
    home = shapely.Point(0.0, 0.0)
    over = [one for one in found if shapely.Polygon(one.ring_ne_m).contains(home)]
    place = f"depot {'inside' if over else 'free'}"
    floor = f" from {over[0].bottom_m:g} m" if over and math.isfinite(over[0].bottom_m) else ""
    counts = f"{report.used} used, {len(report.skipped)} skipped"
    return "\n".join([f"{counts}, {place}{floor}", *report.lines()])


def tile_result(path: Path) -> str:
    report = ImportReport("", "tiles")
    elevation = read_elevation([path], 55.47, 8.45, 2000.0, report)
    height_m = elevation.height_amsl_at(55.47, 8.45)
    text = "unknown" if height_m is None else f"{height_m:.1f} m"
    return "\n".join([f"{text} | {' '.join(report.notes)} {elevation.datum}", *report.lines()])


def meteo_result(path: Path) -> str:
    wind = read_forecast(path, 55.47, 8.45).wind_at_unix_time(START_S, 80.0, 55.47, 8.45)
    return (
        "unknown"
        if not isinstance(wind, WindAt)
        else f"80 m: {wind.speed_mps:.2f} m/s from {wind.from_deg:.0f}"
    )


def plan_result(path: Path) -> str:
    (lat_deg, lon_deg, alt_m), items = read_plan_home_and_items(path)
    return f"{len(items)} items from {lat_deg:g} {lon_deg:g} {alt_m:g}"


def station_result(path: Path) -> str:
    winds, problems = StationFile("mast", path).read_new_winds_and_problems()
    if problems:
        raise LeewayError("; ".join(problems))
    if not winds:
        return "no whole row yet"
    return f"{winds[0].speed_mps:g} m/s from {winds[0].from_deg:g}"


RESULT = {
    "zones": zones_result,
    "tile": tile_result,
    "open-meteo": meteo_result,
    "plan": plan_result,
    "station": station_result,
}
