"""Lists on a terminal of 80 columns: identifiers of any length are shown in full."""

import re
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.database import Database
from ground_station.app.cli.main import app
from ground_station.app.views.day_content import DayShown, DisplayRows
from ground_station.app.views.terminal import plain_console, plain_table
from ground_station.app.views.watch_view import watch_view
from ground_station.core.fleet.fleet_status import FleetStatus
from tests.ground_station.desk_parts import a_state
from tests.ground_station.hand_made_day import flight
from tests.ground_station.store.test_order_store import an_order, opened
from tests.ground_station.views.test_plan_view import plan_with, shown

IDS = [f"Harbour-East-2026-11-25-0000000000000-{k:02d}" for k in range(3)]
WHY = "no drone can lift it from the depot: 3.1 kg is more than 1.0 kg, and the truck is gone"


def on_80_columns(*arguments: str) -> list[str]:
    done = CliRunner().invoke(app, arguments, env={"COLUMNS": "80", "TERM": "dumb"})
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    assert max(map(len, lines)) <= 80
    return lines


def column(lines: list[str], name: str) -> str:
    """Return the text below a heading, its lines joined without spaces."""
    head = next(line for line in lines if re.search(rf"(^|  ){name}(  |$)", line))
    begin = head.index(name)
    after = re.search(r"  \S", head[begin:])
    end = None if after is None else begin + after.end() - 2
    return "".join(line[begin:end] for line in lines[lines.index(head) + 2 :]).replace(" ", "")


@pytest.fixture
def long_ids(tmp_path: Path) -> str:
    """A store whose orders have identifiers of 40 characters, the maximum."""
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        store.add_orders_unless_conflict([an_order(id_) for id_ in IDS], "anna")
    for id_ in IDS:
        on_80_columns("order", "cancel", id_, "--reason", "x", "--store", url, "--user", "anna")
    return url


def test_the_list_of_orders_has_each_id_in_full(long_ids: str):
    lines = on_80_columns("order", "list", "--store", long_ids)
    assert column(lines, "order").startswith("".join(IDS))
    assert lines[-1] == "3 cancelled"


def test_the_audit_has_each_id_in_full(long_ids: str):
    lines = on_80_columns("audit", "--store", long_ids)
    database = Database(long_ids)
    rows, _ = read_audit_rows_and_head(database)
    database.close()
    subjects = "".join(row.entry.subject for row in rows)
    assert column(lines, "to what") == subjects.replace(" ", "")
    assert not any("…" in line for line in lines)


def test_a_long_reason_leaves_the_ids_whole():
    console = plain_console(width=80)
    table = plain_table("order", "state", "why")
    for id_ in IDS:
        table.add_row(id_, "cancelled", WHY)
    with console.capture() as captured:
        console.print(table)
    lines = captured.get().splitlines()
    assert column(lines, "order") == "".join(IDS)
    assert column(lines, "why") == WHY.replace(" ", "") * len(IDS)


def test_a_plan_of_long_names_folds_them():
    lines = shown(plan_with(["depot", *IDS]), 80)
    assert max(map(len, lines)) <= 80
    assert column(lines, "stop").startswith("depot" + "".join(IDS))


def test_a_watched_drone_of_a_long_name_is_read_in_full_beside_its_figures():
    name, stop = "drone-hexacopter-of-south-depot-000000017", "south-stop-000000000000000000000"
    told = {"margin_wh": 69.3, "p_home": 0.9987, "text": WHY}
    state = a_state(name, phase="outbound", armed=True, **told)
    status = FleetStatus()
    status.record_state_and_new_doubts(state, 100.0, 0)
    base = flight("d1", "stop-1", 60.0, 60.0)
    held = replace(base.assignment, vehicle=name, order_id=IDS[0])
    sortie = msgspec.structs.replace(base.sortie, vehicle=name, order=IDS[0], home=stop)
    row = replace(base, assignment=held, sortie=sortie, promised_stop=stop)
    day = DayShown(plan_with(["depot", stop]), [row], 0, 100_000_000)
    console = plain_console(width=80)
    with console.capture() as captured:
        console.print(watch_view(status, DisplayRows([row.assignment], [], day, []), 100.0))
    lines = captured.get().splitlines()
    table = lines[1 : 3 + next(k for k, line in enumerate(lines[3:]) if "WARNING" in line)]
    assert max(map(len, table)) <= 80
    top = next(k for k, line in enumerate(table) if line.startswith("drone-"))
    assert re.search(r"outbound .* 69.3  0.9987 +- +0  no drone", table[top])
    for whole in (name, IDS[0], stop):
        begin = table[top].rindex(whole[:6])
        end = begin + len(table[top][begin:].split()[0])
        cells = "".join(line[begin:end] for line in table[top:])
        assert cells.replace(" ", "").startswith(whole)
