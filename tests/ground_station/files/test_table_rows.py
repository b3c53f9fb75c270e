"""Tables of orders in the dialects of spreadsheets."""

from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.order_files import read_orders
from ground_station.adapters.files.table_rows import read_text_table
from ground_station.core.schema.day import DayFilesError

HEADER = "id,lat_deg,lon_deg,alt_amsl_m,mass_kg,service,note"
ROW = 'A-1,55.468,8.44,12.5,0.4,any,"Müller, 2nd floor"'
SEMICOLONS = (
    HEADER.replace(",", ";") + "\r\nA-1;55,468;8,44;12,5;0,4;any;Müller, 2nd floor\r\n;;;;;;\r\n"
)
GERMAN = "Auftrag\tBreite\tLänge\talt_amsl_m\tGewicht (kg)\tBemerkung\n" + (
    "A-1\t55,468\t8,44\t12,5\t0,4\tMüller, 2nd floor\n"
)
TRAILING = f"{HEADER},,\n{ROW},,\n"


@pytest.mark.parametrize(
    ("raw", "dialect"),
    [
        (f"{HEADER}\n{ROW}\n".encode(), ""),
        (f"{HEADER}\n{ROW}\n".encode("utf-8-sig"), ""),
        (f"{HEADER}\n{ROW}\n".encode("cp1252"), "Windows-1252"),
        (f"{HEADER}\n{ROW}\n".encode("utf-16"), "UTF-16"),
        (SEMICOLONS.encode("utf-8-sig"), "separated by semicolons"),
        (SEMICOLONS.encode("cp1252"), "Windows-1252, separated by semicolons"),
        (GERMAN.encode(), "separated by tabs"),
        (TRAILING.encode(), ""),
    ],
)
def test_a_table_of_any_dialect_gives_the_same_order(
    tmp_path: Path, raw: bytes, dialect: str
) -> None:
    path = tmp_path / "orders.csv"
    path.write_bytes(raw)
    (order,), report = read_orders(path)
    notes = report.notes
    assert (order.id, order.lat_deg, order.lon_deg) == ("A-1", 55.468, 8.44)
    assert (order.alt_amsl_m, order.mass_kg, order.note) == (12.5, 0.4, "Müller, 2nd floor")
    assert bool(notes) == bool(dialect)
    assert dialect in "".join(notes)


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (b"id,lat\0", "expected text in UTF-8"),
        (b"id,lat\x81", "expected text in UTF-8"),
        ("id,lat".encode("utf-16")[:-1], "expected text in UTF-8"),
        (b'id,note\nA-1,"no end\n', "line 2"),
    ],
)
def test_what_is_no_table_is_refused_with_the_reason(
    tmp_path: Path, raw: bytes, words: str
) -> None:
    path = tmp_path / "orders.csv"
    path.write_bytes(raw)
    with pytest.raises(LeewayError, match=words):
        read_text_table(path)


def test_a_mass_without_unit_and_a_value_beyond_the_header_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "orders.csv"
    path.write_text(HEADER.replace("mass_kg", "weight") + f"\n{ROW}\n")
    with pytest.raises(DayFilesError, match="weight: unknown column"):
        read_orders(path, None)
    path.write_text(f"{HEADER},\n{ROW},x\n")
    with pytest.raises(DayFilesError, match="8 cells, expected 7"):
        read_orders(path, None)


def test_headings_are_reported_and_a_note_keeps_its_commas(tmp_path: Path) -> None:
    path = tmp_path / "orders.csv"
    path.write_text("Order;lat;lon;alt_amsl_m;kg;comment\n1,5;55,468;8,44;12;0,4;2,5\n")
    with pytest.raises(DayFilesError, match="'1,5': expected 1 to 40 letters"):
        read_orders(path, None)
    path.write_text(path.read_text().replace("1,5;", "A;"))
    (order,), report = read_orders(path)
    notes = report.notes
    assert order.note == "2,5"
    assert "columns read: Order as id, lat as lat_deg, lon as lon_deg, kg as mass_kg" in notes[-1]


def test_a_height_without_datum_and_a_decimal_comma_between_commas_are_refused(
    tmp_path: Path,
) -> None:
    path = tmp_path / "orders.csv"
    path.write_text(HEADER.replace("alt_amsl_m", "altitude") + f"\n{ROW}\n")
    with pytest.raises(DayFilesError, match="altitude: unknown column"):
        read_orders(path, None)
    path.write_text(f"{HEADER}\n{ROW.replace('55.468', chr(34) + '55,468' + chr(34))}\n")
    with pytest.raises(DayFilesError, match="'55,468': expected a number"):
        read_orders(path, None)
