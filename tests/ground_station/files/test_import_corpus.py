"""Files as people, programs and authorities write them: format, quirk, expected report, source.

A row is one small file. It is read with its importer; the result is a line with what was used, the
values of the first part, and notes, or `refused` with the reason. Each part of the expected text
(separated by ` .. `) is in that line.
"""

import json
import math
import os
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from companion.core.base.errors import LeewayError
from tests.ground_station.files.small_files import (
    RESULT,
    block,
    cells,
    circle,
    collection,
    ed318,
    headed,
    hourly,
    in_unit,
    orders_result,
    plan,
    point,
    published,
    set_at,
    sheet,
    square,
    tile,
    zone,
)
from tests.ground_station.weather.open_meteo import answer

SOURCES = {
    "semicolons": "actualbudget/actual #1769: Issue importing CSV with semicolon deliminter",
    "bom": "docling-project/docling #4097: csv: UTF-8 BOM ends up inside the first header cell",
    "sep": "PowerShell/PowerShell #7776: Import-CSV doesn't understand sep= header",
    "sep2": "mechatroner/vscode_rainbow_csv #108: Use sep= hint if present",
    "null island": "pelias/openaddresses #276: Filter out null island addresses",
    "swapped": "uwaterloo/OpenData #207: Latitudes and Longitudes are flipped",
    "null geometry": "jazzband/geojson #254: Fix coords() TypeError on Feature with null geometry",
    "mask": "CallMarcus/dji-drone-metadata-embedder #522: Estonia UAS geographical zones",
    "collection": "UASGeoZones/ED-318 #24: Allow only Feature Collections",
    "unclosed": "hauke96/simple-task-manager #191: Task creation fails (First and last Position)",
    "antimeridian": "graphhopper/graphhopper #1677: Polygons that cross the Antimeridian",
    "scale": "rasterio/rasterio #2219: Rasterio does not apply scale factor defined in GeoTIFF",
    "void": "GeoTIFF/geotiff.io #118: Handle No Data Value on SRTM Tiles from GLCF",
    "ellipsoid": "gfacciol/IS18 #3: DEM values not matching groundtruth",
    "complex": "mavlink/MAVSDK #1116: Creating/Uploading a Survey Mission",
    "plan 2": "mavlink/qgroundcontrol #4383: New V2 mission file format",
    "null hours": "open-meteo/open-meteo #71: Last three items in hourly are null",
    "old names": "open-meteo/open-meteo #236: Self Hosted and null datas",
    "DMS": "shawnlaffan/biodiverse #115: DMS lat/lon coordinates not imported",
    "suffix": "fisharebest/webtrees #3690: import of place data does not populate database table",
    "degree sign": "avniproject/avni-webapp #1192: Invalid CSV type error",
    "one cell": "heremaps/here-cli #55: import CSVs with coordinates in a (lat,lon) format",
    "colon": "mapbox/csv2geojson #16: Support for single coordinates field",
    "title rows": "adaltas/node-csv-parse #81: Skip to the line with the header",
    "own": "own",
}
"""Public issues and pull requests that were read; their files are not used."""

HEADER = "id,lat_deg,lon_deg,alt_amsl_m,mass_kg,service,note"
ROW = 'A-1,55.468,8.44,12.5,0.4,any,"Müller, 2nd floor"'
GOOD = "1 used; A-1 55.468 8.44 12.5 0.4 any (Müller, 2nd floor)"
CSV = f"{HEADER}\n{ROW}\n"
SEMICOLONS = (
    HEADER.replace(",", ";") + "\r\nA-1;55,468;8,44;12,5;0,4;any;Müller, 2nd floor\r\n;;;;;;\r\n"
)


class Case(NamedTuple):
    """A row of the corpus."""

    kind: str
    quirk: str
    content: Any
    expected: str
    source: str = "own"


ROW0, HEAVY = "A-1,,55.468,8.44,12.5,0.4", "A-1,55.468,8.44,12.5,400"
HERE, NEAR = [8.44, 55.468, 12.5], square()
ORDERS = [
    ("as documented", CSV, GOOD + " |"),
    ("byte order mark", CSV.encode("utf-8-sig"), GOOD + " |", "bom"),
    ("Windows-1252", CSV.encode("cp1252"), GOOD + " | read as Windows-1252"),
    ("UTF-16 of Excel's Unicode text", CSV.encode("utf-16"), GOOD + " | read as UTF-16"),
    ("CRLF", CSV.replace("\n", "\r\n"), GOOD),
    ("CR of old Macs", CSV.replace("\n", "\r"), GOOD),
    ("semicolons", SEMICOLONS, GOOD + " | read as separated by semicolons", "semicolons"),
    ("semicolons in Windows-1252", SEMICOLONS.encode("cp1252"), "Windows-1252, separ"),
    ("tabs", SEMICOLONS.replace(";", "\t"), GOOD + " | read as separated by tabs"),
    ("vertical bars", SEMICOLONS.replace(";", "|"), GOOD + " | read as separated by ver"),
    ("sep line", "sep=;\r\n" + SEMICOLONS, GOOD, "sep"),
    ("sep line with bars", "sep=|\n" + SEMICOLONS.replace(";", "|"), GOOD, "sep2"),
    ("row after a sep line", "sep=;\nid;lat\nA;1;2\n", "refused .. row 1, column lon_deg"),
    ("trailing commas", f"{HEADER},,\n{ROW},,\n", GOOD),
    ("value beyond the header", f"{HEADER},\n{ROW},x\n", "refused .. 8 cells, expected 7"),
    ("empty column", headed("id,,lat,lon,alt_amsl_m,kg", ROW0), "1 used; A-1 55.468"),
    ("no heading", headed("id,,lat,lon,alt_amsl_m,kg", ROW0.replace(",,", ",x,")),
     "refused .. column number 2: unknown column"),
    ("decimal comma between commas", headed(HEADER, ROW.replace("55.468", '"55,468"')),
               "refused .. row 2, column lat_deg: '55,468': expected a number"),
    ("open quote", 'id,note\nA-1,"no end\n', "refused .. line 2 .. expected closed quotes"),
    ("binary", b"id,lat\0", "refused .. expected text in UTF-8"),
    ("undefined byte", b"id,lat\x81", "refused .. expected text in UTF-8"),
    ("cut UTF-16", "id,lat".encode("utf-16")[:-1], "refused .. expected text in UTF-8"),
    ("empty file", "", "refused .. column id: column missing"),
    ("id with a space", cells(id="A 1"), "refused .. row 2, column id: 'A 1': expected 1"),
    ("swapped", cells(lat_deg="8.44", lon_deg="55.468"), "refused .. swapped?", "swapped"),
    ("null island", cells(lat_deg="0", lon_deg="0"), "refused .. no position st", "null island"),
    ("sign of longitude", cells(lon_deg="-8.44"), "refused .. sign of the longitude wrong"),
    ("sign of latitude", cells(lat_deg="-55.468"), "refused .. sign of the latitude wrong"),
    ("degrees and minutes", cells(lat_deg="55 28.08 N"), "1 used; A-1 55.468 8.44"),
    ("degrees, minutes, seconds", cells(lon_deg="8°26'24''E"), "1 used; A-1 55.468 8.44", "DMS"),
    ("hemisphere as suffix", cells(lat_deg="55.468N"), "1 used; A-1 55.468 8.44", "suffix"),
    ("degree sign", cells(lat_deg="55.468°"), "1 used; A-1 55.468 8.44", "degree sign"),
    ("hemisphere of the other axis", cells(lat_deg="8.44 E"), "refused .. '8.44 E': expected a"),
    ("south", cells(lat_deg="S 55.468"), "refused .. sign of the latitude wrong"),
    ("61 minutes", cells(lat_deg="55 61 N"), "refused .. '55 61 N': expected a number"),
    ("position in one cell", headed("id,GPS,alt_amsl_m,kg", 'A-1,"55.468, 8.44",12.5,0.4'),
     "1 used; A-1 55.468 8.44 12.5 0.4"),
    ("position in brackets", headed("id,lat_lng,alt_amsl_m,kg", 'A-1,"(55.468°, 8.44°)",12.5,0.4'),
     "1 used; A-1 55.468 8.44 12.5 0.4", "one cell"),
    ("position with a colon", headed("id,Coordinates,alt_amsl_m,kg", "A-1,55.468:8.44,12.5,0.4"),
     "1 used; A-1 55.468 8.44 12.5 0.4", "colon"),
    ("position as WKT", headed("id,Location,alt_amsl_m,kg", "A-1,POINT (8.44 55.468),12.5,0.4"),
     "1 used; A-1 55.468 8.44 12.5 0.4"),
    ("position of three numbers", headed("id,GPS,alt_amsl_m,kg", 'A-1,"55.4,8.4,12",12.5,0.4'),
     "refused .. column lat_deg: '55.4,8.4,12': expected a number"),
    ("plus code", headed("id,Position,alt_amsl_m,kg", "A-1,9F7CFC9Q+5X,12.5,0.4"),
     "refused .. '9F7CFC9Q+5X': expected a number"),
    ("titles above the header", f"Orders of 1 May\n\nprinted,08:00\n{CSV}",
     GOOD + " | header in row 4: rows above it", "title rows"),
    ("title above semicolons", f"Orders\n{SEMICOLONS}", GOOD + " .. separated by semicolons"),
    ("grams in mass_kg", cells(mass_kg="400"), "refused .. 400 kg: expected at most 70 kg"),
    ("no mass", cells(mass_kg=""), "refused .. column mass_kg: empty, expected a number"),
    ("no position", cells(lat_deg=""),
     "refused .. column lat_deg: empty, expected a number (an address is not looked up)"),
    ("not a number", cells(mass_kg="nan"), "refused .. 'nan': expected a number"),
    ("digits with underscore", cells(mass_kg="1_0"), "refused .. '1_0': expected a number"),
    ("service in capitals", cells(service="DRONE"), "refused .. 'DRONE': expected any, dr"),
    ("one id twice", f"{CSV}{ROW}\n", "refused .. row 3, column id: 'A-1' is in .. row 2 already"),
    ("two parcels", CSV + ROW.replace("A-1", "A-2").replace("2nd", "3rd"), "2 used; A-1"),
    ("one parcel twice", CSV + ROW.replace("A-1", "A-2"), "refused .. row 3: the same parcel"),
    ("mass without unit, small", headed("id,lat,lon,alt_amsl_m,Weight"),
               "refused .. no unit, 0.4 to 0.4: in kg? --columns mass_kg=Weight"),
    ("mass without unit, large", headed("id,lat,lon,alt_amsl_m,Gewicht", HEAVY),
     "refused .. in g? --columns mass_g=Gewicht"),
    ("height without datum", headed("id,lat,lon,Altitude,kg"),
               "refused .. above sea level? --columns alt_amsl_m=Altitude"),
    ("unknown column", headed("id,lat,lon,alt_amsl_m,kg,Product", HEAVY + ",pump"),
     "refused .. --columns note=Product"),
    ("addresses without positions", headed("id,Street,City,kg", "A-1,Kai 5,Esbjerg,0.4"),
               "refused .. column lat_deg: column missing: addresses are not converted"),
    ("addresses beside positions", headed("id,lat,lon,alt_amsl_m,kg,Straße,PLZ,note",
     "A-1,55.468,8.44,12.5,0.4,Kai 5,6700,ring"),
               "1 used .. any (ring) {Kai 5, 6700} .. Straße as address"),
    ("customer, contact, window", headed(
     "id,lat,lon,alt_amsl_m,kg,Kunde,Telefon,Lieferadresse,Zeitfenster,Prio",
     "A-1,55.468,8.44,12.5,0.4,Jørgen,+45 12,Kai 5,2026-05-01T14:00+02:00/2026-05-01T13:30Z,High"),
     "any () {Jørgen} {+45 12} {Kai 5} {2026-05-01T12:00:00Z/2026-05-01T13:30:00Z} {urgent} |"),
    ("window in two columns", headed("id,lat,lon,alt_amsl_m,kg,Von,Bis,E-Mail",
     "A-1,55.468,8.44,12.5,0.4,2026-05-01T14:00Z,2026-05-01T15:30Z,a@b"),
     "any (E-Mail: a@b) {2026-05-01T14:00:00Z/2026-05-01T15:30:00Z} .. Von as window_from"),
    ("reversed window", cells(window="2026-05-01 15:30-14:00"), "refused .. row 2, column window"
     " .. ends before it starts, expected an end after the start"),
    ("window in words", cells(window="afternoon"), "refused .. window 'afternoon': expected 14"),
    ("time of 12 hours", cells(window_from="2:00 pm"), "refused .. expected 14:00 (24 hours)"),
    ("no such hour", cells(window="25:00-26:00"), "refused .. time '25:00': no such time or date"),
    ("control character", cells(address="Kai\x1b[2J"), "refused .. column address: .. control"),
    ("line end in an address", cells(address='"Kai 5\n6700"'), "refused .. expected one line"),
    ("overlong phone", cells(phone="1" * 41), "refused .. column phone: 41 characters, expected"),
    ("priority of unknown scale", cells(priority="1"), "refused .. '1': expected normal or urgent"),
    ("service time", cells(service_s="nan"), "refused .. 'nan': expected seconds from 0 to 7200"),
    ("feet", headed("id,lat,lon,alt_amsl_ft,kg", "A-1,55.468,8.44,100,0.4"), "8.44 30.48 "),
    ("kg and g", headed("id,lat,lon,alt_amsl_m,kg,mass_g", "A-1,55.468,8.44,12.5,0.4,400"),
               "refused .. column mass_kg: column more than once"),
]  # fmt: skip
MAPPED = [
    ("headings", ("lat_deg=North,mass_g=Parcel,note=Product",
         "id,North,lon,alt_amsl_m,Parcel,Product\nA-1,55.468,8.44,12.5,400,pump\n"),
         "1 used; A-1 55.468 8.44 12.5 0.4 any (pump) | columns read: North as lat_deg"),
    ("heading that is not there", ("lat_deg=Nord", CSV.replace("lat_deg", "y")),
         "refused .. column Nord: column missing, expected for lat_deg"),
    ("unknown column", ("latitude=North", CSV), "refused .. columns: 'latitude', exp"),
    ("no heading", ("lat_deg", CSV), "refused: --columns: 'lat_deg', expected COL"),
]  # fmt: skip
HEADINGS = {
    "id": "Order|Order-No|Auftrag|Bestellung|Commande|Pedido",
    "lat_deg": "lat|Latitude|Breite|LATITUD|Breddegrad",
    "lon_deg": "lng|Longitude|Länge|longitud|Længdegrad",
    "mass_kg": "kg|Weight (kg)|weight_kg|Gewicht [kg]|Poids (kg)|peso_kg",
}
HEADED = [
    (heading, headed("id,lat_deg,lon_deg,alt_amsl_m,mass_kg".replace(column, heading)),
     f"1 used; A-1 55.468 8.44 12.5 0.4 any .. {heading} as {column}")
    for column, names in HEADINGS.items() for heading in names.split("|")
]  # fmt: skip
MASSES = [
    (heading, headed(f"id,lat,lon,alt_amsl_m,{heading}", f"A-1,55.468,8.44,12.5,{value}"), expected)
    for heading, value, expected in (
        ("mass_g", 400, "12.5 0.4 any"), ("Gewicht (g)", 250, "12.5 0.25 any"),
        ("lbs", 2, "12.5 0.907185 any"), ("weight_oz", 16, "12.5 0.453592 any"),
    )
]  # fmt: skip


POINTS = [
    ("as documented", collection(point(HERE)), "1 used; A-1 55.468 8.44 12.5 0.4 any"),
    ("other headings and address", collection(point(HERE, Street="Kai 5")), "() {Kai 5}"),
    ("null property", collection(point(HERE, note=None)), "1 used"),
    ("null geometry", collection(point(None)), "refused .. row 1, column geom", "null geometry"),
    ("latitude first", collection(point([55.468, 8.44, 12.5])), "refused .. swapped?", "swapped"),
    ("one feature alone", point(HERE), "refused .. expected a GeoJSON FeatureCollection"),
    ("polygon", collection(block(NEAR)), "refused .. expected a Point"),
    ("text as mass", collection(point(HERE, mass_kg="heavy")), "refused .. 'heavy'"),
    ("no properties", collection({**point(HERE), "properties": None}), "refused .. column id: col"),
    ("four coordinates", collection(point([*HERE, 1.0])), "refused .. expected a Point"),
    ("cut", json.dumps(collection(point(HERE)))[:-5], "refused .. not JSON: line 1, col"),
    ("Windows-1252", json.dumps(collection(point(HERE, note="Müller")),
         ensure_ascii=False).encode("cp1252"), "refused .. line 1: byte 0xFC is not utf-8"),
]  # fmt: skip


BOWTIE = [[12.0, 57.0], [12.1, 57.1], [12.1, 57.0], [12.0, 57.1], [12.0, 57.0]]
NEAR_BOWTIE = [[8.4, 55.4], [8.5, 55.5], [8.5, 55.4], [8.4, 55.5], [8.4, 55.4]]
FAR = square(0.1, 12.0, 57.0)
WORLD = [[-180.0, -90.0], [180.0, -90.0], [180.0, 90.0], [-180.0, 90.0], [-180.0, -90.0]]
SWAPPED = [[lat, lon] for lon, lat in NEAR]
LOW, INSIDE, FREE = {"lowerLimit": 130}, "1 used, 0 skipped, depot inside", "depot free"
DISC = {"type": "Point", "coordinates": [8.45, 55.47]}
DISC |= {"extent": {"subType": "Circle", "radius": 500}}
ZONES = [
    ("as documented", zone(), INSIDE),
    ("list of zones without a type", {"title": "t", "features": [zone()]}, INSIDE),
    ("circle", circle(), INSIDE), ("circle elsewhere", circle(center=[8.5, 55.47]),
              FREE),
    ("circle without radius", circle(radius=None), "refused .. radius = None: expected metr"),
    ("circle with one coordinate", circle(center=[8.45]), "refused .. expected a centre as"),
    ("empty schedule", zone(applicability=[{"permanent": "YES", "schedule": []}]), INSIDE),
    ("unknown restriction", zone(restriction="MAYBE"), "refused .. restriction = 'MAYBE'"),
    ("no restriction", zone(restriction="NO_RESTRICTION"), f"0 used, 1 skipped, {FREE}"),
    ("no identifier", zone(identifier=None), "refused .. identifier = None: expected a text"),
    ("feet", zone(volume={"uomDimensions": "FT"}), INSIDE),
    ("flight levels", zone(volume={"uomDimensions": "FL"}), "refused .. = 'FL': expected M or"),
    ("limits in wrong order", zone(volume=LOW), "refused .. lowerLimit = 130 m: expected at m"),
    ("text as limit", zone(volume={"upperLimit": "high"}), "refused .. upperLimit = 'high'"),
    ("reference SFC", zone(volume={"upperVerticalReference": "SFC"}), "refused .. = 'SFC': ex"),
    ("no shape", zone(volume={"horizontalProjection": None}), "refused .. expected a Polygon"),
    ("no volume", zone(geometry=[]), "refused .. zone Z1: geometry: expected a list"),
    ("point without radius", {**published(NEAR), "geometry": point(HERE)["geometry"]}, "refused"),
    ("weekday X", zone(applicability=[{"schedule": [{"day": ["X"]}]}]), "refused .. schedule"),
    ("unclosed ring", zone(NEAR[:4]), "refused .. expected closed rings", "unclosed"),
    ("unclosed ring far away", zone(FAR[:4]), f"0 used, 1 skipped, {FREE}", "unclosed"),
    ("crossing ring", zone(NEAR_BOWTIE), "refused .. zone Z1: the polygon crosses itself"),
    ("crossing ring far away", zone(BOWTIE), f"0 used, 1 skipped, {FREE}"),
    ("unknown restriction far away", zone(FAR, restriction="MAYBE"), "0 used, 1 skipped, depot free"
     " .. beyond 100 km of the depot, with a defect: zone Z1: restriction = 'MAYBE'"),
    ("defect of a circle that may reach", circle(center=[12.0, 57.0], radius=None), "refused"),
    ("far and near", collection(zone(FAR), zone()), "1 used, 1 skipped, depot inside"),
    ("other country", zone(FAR), "0 of 1 zones .. is it the file of another area?"),
    ("swapped", collection(*[zone(SWAPPED)] * 12), "refused .. 0 of 12 zones and obstacles lie"
     " within 100 km of the depot; the swapped file would fit: is it [lat, lon]?", "swapped"),
    ("one swapped among others", collection(zone(), zone(SWAPPED)), "refused .. swapped?"),
    ("hole over the depot", published(square(1.0), NEAR), "depot free"),
    ("world less a country", published(WORLD, square(3.0)), f"0 used, 1 skipped, {FREE}", "mask"),
    ("mask above 120 m", published(square(3.0), lowerLimit=121, lowerVerticalReference="AGL"),
              "1 used, 0 skipped, depot inside from 121 m", "mask"),
    ("crossing hole", published(NEAR, square(0.1)), "depot inside"),
    ("three corners", zone(NEAR[:3]), "refused .. at least 4 [lon, lat]"),
    ("longitude 200", zone(square(lon=200.0)), "refused .. expected closed rings"),
    ("long edge", zone([[7.0, 55.464], [9.9, 55.464], [9.9, 56.0], [7.0, 56.0], [7.0, 55.464]]),
              INSIDE),
    ("antimeridian", zone(square(lon=-172.0)), f"0 used, 1 skipped, {FREE}", "antimeridian"),
    ("ED-318", ed318({"type": "Polygon", "coordinates": [square()]}), INSIDE),
    ("ED-318 circle", ed318(DISC), INSIDE),
    ("ED-318 circle without radius", ed318(DISC | {"extent": {"subType": "Circle"}}), "refused"),
    ("ED-318 point without extent", ed318(DISC | {"extent": None}),
     "refused .. geometry.extent: expected subType Circle with a radius"),
    ("ED-318 in feet", ed318(DISC, lower=400, lowerReference="AMSL", upper=900,
     upperReference="AMSL", uom="ft"), "depot inside from 109.92 m"),
    ("ED-318 in flight levels", ed318(DISC, uom="FL"), "refused .. layer.uom = 'FL': expected M"),
    ("order among zones", collection(zone(), point(HERE)), "1 used, 1 skipped, depot inside"
     " .. it holds orders: is it the file of orders?"),
    ("point of a mast", point(HERE, mass_kg=None) | {"properties": {}}, "refused .. expected a P"),
    ("one feature alone", json.dumps(published(NEAR)), "refused .. expected a G", "collection"),
    ("no list", {"features": {}}, "refused .. expected a GeoJSON FeatureCollection"),
    ("obstacle", block(NEAR), "1 used, 0 skipped, depot inside"),
    ("obstacle without height", block(NEAR, height_m=None), "refused .. with a number height_m"),
    ("obstacle of no height", block(NEAR, height_m=-3), "refused .. expected a height above 0"),
    ("crossing obstacle", block(NEAR_BOWTIE), "refused .. crosses itself"),
    ("unclosed obstacle", block(NEAR[:4]), "refused .. expected a closed ring", "unclosed"),
    ("null geometry", {**block(NEAR), "geometry": None}, "refused .. expected", "null geometry"),
    ("orders as zones", point(HERE), "0 used, 1 skipped .. a point with mass_kg is an order"),
    ("MultiPolygon", {**block(NEAR), "geometry": {"type": "MultiPolygon",
     "coordinates": [[FAR], [NEAR]]}}, INSIDE),
]  # fmt: skip


TILES = [
    ("as documented", tile(), "300.0 m |"),
    ("scale", tile(value=3000.0, scales=0.1), "300.0 m | .. 1 m times (0.1 value", "scale"),
    ("offset", tile(value=100.0, offsets=200.0), "300.0 m | .. + 200", "scale"),
    ("feet", tile(value=1000.0, units="ft"), "304.8 m | .. read as 0.3048 m"),
    ("metres", tile(units="metre"), "300.0 m |"),
    ("unknown unit", tile(units="fathom"), "refused .. heights in fathom, expected m or ft"),
    ("vertical CRS in feet", tile("EPSG:4326+8228", 1000.0), "304.8 m"),
    ("vertical CRS", tile("EPSG:4326+5773"), "300.0 m | .. EGM96, by the tile's CRS"),
    ("ellipsoid", tile("EPSG:4979"), "refused .. above the ellipsoid, expected", "ellipsoid"),
    ("void without tag", tile(hole=-32768.0), "unknown | .. 400 heights of -32768 m", "void"),
    ("void of -9999", tile(hole=-9999.0), "unknown | .. heights of -9999 m", "void"),
    ("void with tag", tile(hole=-9999.0, nodata=-9999.0), "unknown |  EGM96 or EGM2008 ass"),
    ("void of a large float", tile(hole=3.4e38), "unknown | .. without a nodata tag"),
    ("no CRS", tile(None), "refused .. no CRS, expected EPSG:4326"),
    ("metres of UTM", tile("EPSG:32632"), "refused .. CRS EPSG:32632, expected EPSG:4326"),
    ("text", lambda path: path.write_text("no raster"), "refused .. not a raster"),
    ("missing", lambda path: None, "refused .. no such file"),
    ("other place", tile(west=20.0), "refused .. 55.47000, 8.45000 is outside all tiles (file)"),
    ("cut", lambda path: [tile()(path), os.truncate(path, 20_000)], "refused .. damaged or unrea"),
]  # fmt: skip


OLD_NAMES = json.dumps(answer()).replace("wind_speed", "windspeed").replace("wind_dir", "winddir")
AT_80_M = f"80 m: {math.log(800.0):.2f} m/s from 270"
METEO = [
    ("as documented", answer(), AT_80_M),
    ("byte order mark", json.dumps(answer()).encode("utf-8-sig"), AT_80_M, "bom"),
    ("names before 2023", OLD_NAMES, AT_80_M, "old names"),
    ("km/h", in_unit("km/h"), f"80 m: {math.log(800.0) / 3.6:.2f} m/s"),
    ("knots", in_unit("kn"), f"80 m: {math.log(800.0) * 1852.0 / 3600.0:.2f} m/s"),
    ("miles", in_unit("mp/h"), f"80 m: {math.log(800.0) * 0.44704:.2f} m/s"),
    ("unknown unit", in_unit("furlongs"), "refused .. 'furlongs', expected one of m/s"),
    ("null, other heights known", set_at("wind_speed_80m", 0, None), AT_80_M, "null hours"),
    ("negative", set_at("wind_speed_80m", 1, -2.0), "refused .. at 2026-07-01 13:00 UTC: -2"),
    ("text", set_at("wind_speed_10m", 2, "calm"), "refused .. 14:00 UTC: 'calm', expected a"),
    ("no time", set_at("time", 0, "noon"), "refused .. hourly.time: 'noon', expected as 2026-"),
    ("descending", hourly(lambda d: d["hourly"]["time"].reverse()), "refused .. that ascend"),
    ("no direction", hourly(lambda d: d["hourly"].pop("wind_direction_80m")),
     "refused .. hourly.wind_direction_80m: missing"),
    ("short column", hourly(lambda d: d["hourly"]["wind_speed_10m"].pop()), "refused .. numbers"),
    ("no wind", hourly(lambda d: d.update(hourly={"time": d["hourly"]["time"]})),
               "refused .. no wind at any height"),
    ("one time", hourly(lambda d: [c.__delitem__(slice(1, None)) for c in d["hourly"].values()]),
     "refused .. 1 times, expected 2"),
    ("daily", hourly(lambda d: d.pop("hourly")), "refused .. no hourly, expected Open-Meteo's"),
    ("reason of the server", {"error": True, "reason": "limit"}, "refused .. (limit)"),
    ("cut", json.dumps(answer())[:-30], "refused .. damaged, or not JSON"),
]  # fmt: skip


ITEM = {"type": "SimpleItem", "command": 16, "frame": 3, "params": [0, 0, 0, None, 55.47, 8.45, 20]}
PLANS = [
    ("as documented", plan(ITEM), "1 items from 55.47 8.45 12"),
    ("version 42", plan(ITEM, version=42), "refused .. version = 42: expected 1", "plan 2"),
    ("mission version 1", {**plan(ITEM), "mission": {"version": 1}},
     "refused .. mission.version = 1: expected 2", "plan 2"),
    ("no mission", {"fileType": "Plan", "version": 1}, "refused .. a mission"),
    ("survey", plan(ITEM, {"type": "ComplexItem", "complexItemType": "survey"}),
         "refused .. item 2: ComplexItem survey, expected a SimpleItem", "complex"),
    ("six params", plan({**ITEM, "params": [0] * 6}), "refused .. item 1: params: expected 7"),
    ("text as command", plan({**ITEM, "command": "TAKEOFF"}), "refused .. 'TAKEOFF', expected"),
    ("text as param", plan({**ITEM, "params": ["0"] * 7}), "refused .. item 1: params = "),
    ("no items", plan(), "refused .. expected at least one item"),
    ("no home", plan(ITEM, plannedHomePosition=[]), "refused .. plannedHomePosition: expect"),
    ("waypoint file", "QGC WPL 110\n0\t1\t0", "refused .. not JSON: it begins with 'Q'"),
]  # fmt: skip

STATION = "time_utc,wind_speed_mps,wind_from_deg\n"
STATIONS = [
    ("as documented", STATION + "2026-05-01T10:00:00Z,5,270\n", "5 m/s from 270"),
    ("byte order mark", "\ufeff" + STATION + "2026-05-01T10:00:00Z,5,270\n", "5 m/s", "bom"),
    ("no offset", STATION + "2026-05-01T10:00:00,5,270\n", "refused .. expected as 2026-07"),
    ("km/h", STATION.replace("mps", "kmh") + "1,5,270\n", "refused .. expected time_utc"),
    ("semicolons", STATION.replace(",", ";") + "1;5,5;270\n", "5.5 m/s from 270"),
    ("tabs", STATION.replace(",", "\t") + "1\t5.5\t270\n", "5.5 m/s from 270"),
    ("negative", STATION + "2026-05-01T10:00:00Z,-5,270\n", "refused .. invalid row"),
]  # fmt: skip


NUMBERS = ["A-1", 55.468, 8.44, 12.5, 0.4]
NAMES = ["id", "lat", "lon", "alt_amsl_m", "kg"]
SHEETS = [
    ("numbers", sheet([NAMES, NUMBERS]), "1 used; A-1 55.468 8.44 12.5 0.4 any .. S1"),
    ("title row", sheet([["Orders"], [], NAMES, NUMBERS]), "1 used; A-1 55.468 .. header in row 3"),
    ("numeric id", sheet([NAMES, [1001.0, *NUMBERS[1:]]]), "1 used; 1001 55.468"),
    ("text with decimal comma", sheet([NAMES, ["A-1", "55,468", *NUMBERS[2:]]]),
         "1 used; A-1 55.468 8.44"),
    ("empty first sheet", sheet([], [NAMES, NUMBERS]), "sheet S2 of 2 sheets, the first"),
    ("only empty sheets", sheet([]), "refused .. all sheets are empty"),
    ("cut", sheet([NAMES, NUMBERS])[:300], "refused .. damaged or of another kind"),
    ("other ZIP archive", b"PK\x03\x04rest", "refused .. damaged or of another kind"),
]  # fmt: skip


def as_document(zones: Any) -> Any:
    """Return a single zone as a document; other content unchanged."""
    return zones if isinstance(zones, str) or "features" in zones else collection(zones)


TABLES = {
    "orders": [*ORDERS, *HEADED, *MASSES], "mapped": MAPPED, "points": POINTS,
    "zones": [(row[0], as_document(row[1]), *row[2:]) for row in ZONES],
    "tile": TILES, "open-meteo": METEO, "plan": PLANS, "station": STATIONS, "sheet": SHEETS,
}  # fmt: skip
CORPUS = [Case(kind, *row) for kind, rows in TABLES.items() for row in rows]
PACKAGE = {"tile": "rasterio", "sheet": "python_calamine"}


def test_the_corpus_is_large_and_each_quirk_has_its_source() -> None:
    assert len(CORPUS) >= 150
    assert len({(case.kind, case.quirk) for case in CORPUS}) == len(CORPUS)
    assert {case.source for case in CORPUS} == SOURCES.keys()


@pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")
@pytest.mark.parametrize("case", CORPUS, ids=lambda case: f"{case.kind}: {case.quirk}")
def test_a_file_gives_the_expected_report(tmp_path: Path, case: Case) -> None:
    if (package := PACKAGE.get(case.kind)) and find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    path, content = tmp_path / "file", case.content
    columns, content = content if isinstance(content, tuple) else (None, content)
    if isinstance(content, dict):
        content = json.dumps(content)
    if callable(content):
        content(path)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    read = RESULT.get(case.kind) or partial(orders_result, columns=columns)
    try:
        result = read(path)
    except LeewayError as error:
        result = f"refused: {str(error).replace(str(tmp_path), '')}"
    assert result.startswith("refused") == case.expected.startswith("refused"), result
    for part in case.expected.split(" .. "):
        assert part in result, result
