"""`ground-station doctor`: what is missing is named with what to do."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ground_station.adapters.clock import epoch_us
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.app.cli.doctor import EXIT_TO_DO, fleet_findings
from ground_station.app.cli.main import app
from ground_station.app.desk.operator_commands import add_orders
from ground_station.core.schema.orders import Order

pytestmark = pytest.mark.timeout(60)


def findings(*args: str) -> dict[str, dict[str, str]]:
    done = CliRunner().invoke(app, ["doctor", *args, "--json"])
    assert done.exit_code == EXIT_TO_DO, done.output
    return {one["subject"]: one for one in json.loads(done.stdout)}


def test_without_a_store_the_command_that_creates_one_is_named(tmp_path: Path):
    found = findings("harbour", "--store", f"sqlite:///{tmp_path}/none.db")
    assert found["day"]["to_do"] == ""
    assert "order import" in found["store"]["to_do"]
    assert not (tmp_path / "none.db").exists()


def test_a_day_that_cannot_be_read_is_named_and_the_rest_is_checked(tmp_path: Path):
    (tmp_path / "day.toml").write_text("fleet = 3\n")
    found = findings(str(tmp_path / "day.toml"), "--store", f"sqlite:///{tmp_path}/none.db")
    assert found["day"]["to_do"]
    assert "store" in found


def test_a_network_without_members_and_a_readable_store(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/desk.db"
    store = Store(Database(url), epoch_us)
    order = Order(id="A-1", lat_deg=55.47, lon_deg=8.45, alt_amsl_m=3.0, mass_kg=0.4)
    add_orders(store, [order], "anna")
    store.close()
    found = findings("harbour", "--store", url, "--fleet", "nobody", "--seconds", "1")
    assert found["store"] == {"subject": "store", "text": f"{url}: 1 open", "to_do": ""}
    assert "no member of nobody within 1 s" in found["network"]["text"]
    assert "ground-station dispatch" in found["desk"]["to_do"]
    (tmp_path / "desk.db").chmod(0o644)
    faulty = findings("harbour", "--store", url, "--fleet", "nobody", "--seconds", "1")
    assert "mode 0644, expected 0600" in faulty["store"]["text"]
    assert faulty["store"]["to_do"]


def test_items_of_the_attention_list_are_findings_and_calm_vehicles_are_ok():
    item = {"key": "idle d2", "who": "d2", "title": "d2 gets no orders", "words": "34 m away."}
    launch = {"key": "launch A-7", "who": "d1", "title": "d1 waits for your launch",
              "words": "Launch by {by}.", "times": {"by": 1_000_000}}  # fmt: skip
    picture = {
        "drones": {"d3": {}, **{name: {"heard_us": 1} for name in ("d1", "d2", "d4")}},
        "desk_heard_us": 1,
        "attention": [item, launch],
    }
    found = {one.subject: one for one in fleet_findings("harbour", picture, 5.0)}
    assert found["network"].text == "drones of harbour in contact: 3"
    assert [found[d].to_do for d in ("d4", "d2")] == ["", "34 m away."]
    assert re.fullmatch(
        r"Launch by \d\d:\d\d.*\. ground-station order launch A-7", found["d1"].to_do
    )
    assert found["d2"].text == "d2 gets no orders."
