"""Columns of a table of orders: common headings, units, and text that is kept for people."""

import statistics
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from companion.core.base.errors import LeewayError
from ground_station.core.schema.coordinate_text import degrees_text, split_lat_lon
from ground_station.core.schema.day import FileProblem
from ground_station.core.schema.orders import ORDER_BOUNDS

REQUIRED = ("id", "lat_deg", "lon_deg", "mass_kg")
COLUMNS = (
    *("id", "lat_deg", "lon_deg", "alt_amsl_m", "mass_kg", "service", "note", "customer", "phone"),
    *("address", "window", "window_from", "window_to", "priority", "service_s"),
)
JOINED = ("note", "customer", "phone", "address")
"""Columns that a table may have several of: their cells are joined."""
LAT_LON = "lat_lon_deg"
"""Column with latitude and longitude in one cell."""
UNIT_COLUMNS = {
    "mass_g": ("mass_kg", 0.001),
    "mass_lb": ("mass_kg", 0.45359237),
    "mass_oz": ("mass_kg", 0.028349523125),
    "alt_amsl_ft": ("alt_amsl_m", 0.3048),
}
"""Columns in another unit: the documented column, and the value of one unit (SI brochure, NIST)."""


def _headings(table: Mapping[str, str]) -> dict[str, str]:
    return {heading: name for name, text in table.items() for heading in text.split()}


_MASS_WORDS = "weight mass gewicht masse poids peso vægt vikt waga"
_OF_UNIT = {
    "mass_kg": "kg",
    "mass_g": "g gr grams gramm",
    "mass_lb": "lb lbs pounds",
    "mass_oz": "oz ounces",
}
COLUMN_OF_HEADING = _headings(
    {
        "id": "order order_id order_no order_number auftrag bestellung commande pedido ordine",
        "lat_deg": "lat latitude breite breitengrad latitud latitudine breddegrad",
        "lon_deg": "lon lng long longitude länge längengrad longitud longitudine længdegrad",
        LAT_LON: "lat_lon lat,lon lat,_lon latlon lat_lng latlng lat/lon latitude_longitude"
        " latitude,_longitude latitude,longitude coordinates coordinate coords gps gps_coordinates"
        " position location koordinaten coordonnées coordenadas coordinate_gps koordinater",
        "note": "notes comment comments remark remarks bemerkung notiz hinweis commentaire nota",
        "customer": "name customer_name recipient company kunde empfänger firma client nom cliente"
        " nombre nome klient kunde_navn navn",
        "phone": "telephone phone_number mobile telefon téléphone teléfono telefono tlf",
        "address": "street house_number city town zip zip_code postcode postal_code country state"
        " region delivery_address shipping_address adresse lieferadresse straße strasse hausnummer"
        " ort stadt plz"
        " postleitzahl land rue ville code_postal pays dirección direccion calle ciudad"
        " código_postal codigo_postal país indirizzo via città cap by postnummer vej gade adres",
        "window": "delivery_window time_window time_slot timeslot slot delivery_time zeitfenster"
        " lieferfenster créneau creneau ventana fascia_oraria tidsvindue",
        "window_from": "earliest from ready_from time_from start_time window_start not_before von"
        " ab de desde dalle fra",
        "window_to": "latest to due until time_to end_time window_end not_after deadline bis à"
        " hasta alle til",
        "priority": "prio priorität prioritaet priorité priorite prioridad priorità prioritet",
    }
) | {
    heading: name
    for name, units in _OF_UNIT.items()
    for unit in units.split()
    for word in _MASS_WORDS.split()
    for heading in (f"{word}_{unit}", f"{word}_({unit})", f"{word}_[{unit}]")
}
COLUMN_OF_HEADING |= {"kg": "mass_kg", "grams": "mass_g", "lbs": "mass_lb", "oz": "mass_oz"}
"""Common headings; none for a mass without unit or a height without datum: neither is guessed."""

TEXT_HEADINGS = frozenset(("email", "e_mail", "description"))
"""Headings of further texts, which are kept in the note."""

HEIGHT_WORDS = ("alt", "altitude", "elevation", "height", "höhe", "hoehe", "altitud", "højde")
GRAMS_FROM = 20.0
"""Median from which a mass without unit is rather in grams."""


def parse_column_headings(text: str) -> dict[str, str]:
    """Return headings by column from `lat_deg=Breite,mass_g=Gewicht`. Raises LeewayError."""
    found: dict[str, str] = {}
    for part in text.split(","):
        name, is_pair, heading = (one.strip() for one in part.partition("="))
        if not is_pair or not heading:
            raise LeewayError(f"--columns: {part!r:.60}, expected COLUMN=HEADING")
        found[name] = heading
    return found


@dataclass(slots=True)
class OrderColumns:
    """Columns of one table. `names`: the documented column, or `note` for kept text, by cell."""

    names: list[str]
    headings: list[str]
    with_decimal_point: Callable[[str], str]
    problems: list[FileProblem] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @classmethod
    def of_table(
        cls,
        file: str,
        rows: Sequence[Sequence[str]],
        column_headings: Mapping[str, str],
        with_decimal_point: Callable[[str], str] = str,
    ) -> "OrderColumns":
        """Return the columns of a table, the header first; `problems` has all errors in it."""
        headings = [heading.strip() for heading in rows[0]] if rows else []
        mapped = {heading.strip(): name for name, heading in column_headings.items()}
        names = [mapped.get(heading) or _column_of(heading) for heading in headings]
        columns = cls(names, headings, with_decimal_point)
        columns._find_problems(file, rows, mapped)
        renamed = [
            f"{a} as {b}" for a, b in zip(headings, names, strict=True) if a != b and (a or b)
        ]
        if renamed:
            columns.notes.append(f"columns read: {', '.join(renamed)}")
        return columns

    def cell_by_column(self, cells: Sequence[str]) -> dict[str, str]:
        """Return the cells by documented column: units converted, further text in the note."""
        found: dict[str, str] = {}
        kept: list[str] = []
        for name, heading, cell in zip(self.names, self.headings, cells, strict=True):
            base, factor = UNIT_COLUMNS.get(name, (name, 1.0))
            if name == "note" and _key(heading) in TEXT_HEADINGS:
                kept += [f"{heading}: {cell.strip()}"] if cell.strip() else []
            elif name == "note":
                kept[:0] = [cell] if cell.strip() else []
            elif name in JOINED:
                found[name] = ", ".join(filter(None, (found.get(name), cell.strip())))
            elif name == LAT_LON:
                found["lat_deg"], found["lon_deg"] = split_lat_lon(cell, self.with_decimal_point)
            elif base.endswith("_deg"):
                axis = "NS" if base == "lat_deg" else "EW"
                found[base] = degrees_text(self.with_decimal_point(cell), axis)
            elif base in ORDER_BOUNDS:
                found[base] = _scaled(self.with_decimal_point(cell), factor)
            elif base:
                found[base] = cell
        return found | {"note": "; ".join(kept)}

    def _find_problems(
        self, file: str, rows: Sequence[Sequence[str]], mapped: Mapping[str, str]
    ) -> None:
        def add_problem(column: str, text: str) -> None:
            self.problems.append(FileProblem(file, 1, column, text))

        for index, (name, heading) in enumerate(zip(self.names, self.headings, strict=True)):
            values = [row[index].strip() for row in rows[1:] if index < len(row)]
            if name not in (*COLUMNS, *UNIT_COLUMNS, LAT_LON) and (heading or any(values)):
                add_problem(heading or f"number {index + 1}", self._unknown_text(heading, values))
        bases = [_documented_column(name) for name in self.names]
        bases += ["lat_deg", "lon_deg"] * bases.count(LAT_LON)
        for heading, name in mapped.items():
            if _documented_column(name) not in (*COLUMNS, LAT_LON):
                known = ", ".join((*COLUMNS, *UNIT_COLUMNS, LAT_LON))
                add_problem(heading, f"columns: {name!r:.40}, expected one of {known}")
            elif _documented_column(name) not in bases:
                add_problem(heading, f"column missing, expected for {name}")
        for name in REQUIRED:
            if name not in bases:
                is_place = name.endswith("_deg") and "address" in bases
                add_problem(name, "column missing" + (PLACE_TEXT if is_place else ""))
        for name in sorted({name for name in bases if name and bases.count(name) > 1} - {*JOINED}):
            add_problem(name, "column more than once")

    def _unknown_text(self, heading: str, values: Sequence[str]) -> str:
        """Return the error of an unknown column, with a proposal."""
        text = f"unknown column, expected {', '.join(COLUMNS)}"
        key = _key(heading)
        if key in HEIGHT_WORDS:
            return f"{text}; above sea level? --columns alt_amsl_m={heading}"
        if key not in _MASS_WORDS.split():
            return f"{text}; remove it, or keep its text: --columns note={heading}"
        numbers: list[float] = []
        for value in values:
            with suppress(ValueError):
                numbers.append(float(self.with_decimal_point(value)))
        if not numbers:
            return f"{text}; in which unit? --columns mass_kg={heading}"
        unit = "g" if statistics.median(numbers) >= GRAMS_FROM else "kg"
        span = f"{min(numbers):g} to {max(numbers):g}"
        return f"{text}; no unit, {span}: in {unit}? --columns mass_{unit}={heading}"


def is_order_header(cells: Sequence[str], column_headings: Mapping[str, str]) -> bool:
    """Return whether a row holds headings of at least two columns that an order must have."""
    mapped = {heading.strip(): name for name, heading in column_headings.items()}
    stripped = [cell.strip() for cell in cells]
    names = {_documented_column(mapped.get(cell) or _column_of(cell)) for cell in stripped}
    return len(names & {*REQUIRED, LAT_LON}) >= 2


PLACE_TEXT = ": addresses are not converted to positions, expected degrees"


def _documented_column(name: str) -> str:
    return UNIT_COLUMNS[name][0] if name in UNIT_COLUMNS else name


def _column_of(heading: str) -> str:
    """Return the column of a common heading, otherwise the heading itself."""
    key = _key(heading)
    if key in COLUMNS or key in UNIT_COLUMNS:
        return key
    return "note" if key in TEXT_HEADINGS else COLUMN_OF_HEADING.get(key, heading)


def _key(heading: str) -> str:
    return "_".join(heading.lower().replace("-", " ").replace("_", " ").split())


def _scaled(text: str, factor: float) -> str:
    """Return a number's text in the documented unit; other text unchanged, for its error."""
    if factor == 1.0:
        return text
    try:
        return f"{float(text) * factor:.9g}"
    except ValueError:
        return text
