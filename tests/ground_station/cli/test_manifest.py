"""The manifest: the same rows as page and CSV, and the end-of-day report's delivery windows."""

import csv
import re
from html import unescape
from pathlib import Path

import msgspec
from typer.testing import CliRunner

from ground_station.adapters.store.day_store import DayStore
from ground_station.app.cli.main import app
from ground_station.app.views.day_report import day_report_of
from tests.ground_station.hand_made_day import PLAN
from tests.ground_station.store.test_order_changes import released
from tests.ground_station.store.test_order_store import an_order, an_outcome, flown, opened
from tests.ground_station.web.map_site import HARBOUR

CUSTOMER = "Jo <b>Hansen"


def manifest(url: str, path: Path) -> str:
    done = CliRunner().invoke(app, ["manifest", "--out", str(path), "--store", url])
    assert done.exit_code == 0, done.output
    return path.read_text(encoding="utf-8-sig")


def test_html_and_csv_have_the_same_rows_in_the_order_of_the_stops(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    named = {"customer": CUSTOMER, "phone": "+45 12", "note": "=1+1"}
    orders = [
        msgspec.structs.replace(one, **(named if one.id == "H-105" else {}))
        for one in HARBOUR.orders
    ]
    with opened(url) as store:
        store.add_orders_unless_conflict(orders)
        assert DayStore(store.database, lambda: 1).try_store_active_plan(PLAN, "given")
    _, *rows = csv.reader(manifest(url, tmp_path / "m.csv").splitlines())
    page = manifest(url, tmp_path / "m.html")
    shown = [
        [unescape(cell) for cell in re.findall("<td>(.*?)</td>", row)]
        for row in re.findall("<tr><td>.*?</tr>", page)
    ]
    assert [row[:12] for row in shown] == [row[:12] for row in rows]
    assert "size: A4" in page
    assert CUSTOMER not in page
    done = [(row[0], row[3], row[4], row[5]) for row in rows]
    assert done[:4] == [
        ("depot", "load", "H-101", "d1"),
        ("depot", "load", "H-102", "d2"),
        ("depot", "wait for", "H-101", "d1"),
        ("stop-1", "deliver", "H-105", ""),
    ]
    assert (rows[3][9], rows[3][11], rows[3][12]) == (CUSTOMER, "+45 12", "'=1+1")


def test_without_a_truck_it_lists_the_drones_loads_then_what_waits(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
        store.assign_order("o2", "d1", {"format": "flight/1"}, None, "desk")
    _, *rows = csv.reader(manifest(url, tmp_path / "m.csv").splitlines())
    assert [row[3:6] for row in rows] == [["load", "o2", "d1"], ["waiting", "o1", ""]]


def test_the_report_of_the_day_counts_windows_that_were_kept(store_url):
    order = msgspec.structs.replace(an_order("o1"), latest_us=4_000_000, customer="Jo")
    with opened(store_url) as store:
        store.add_orders_unless_conflict([order])
        id_ = flown(store)
        store.record_event_batches([([released(id_), an_outcome(id_, "SUC", 2)], False)])
        report = day_report_of(store)
    assert report["windows"] == {"late": 1}
    assert (report["proofs"][0]["kept"], report["proofs"][0]["customer"]) == ("1 min late", "Jo")
