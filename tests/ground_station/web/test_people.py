"""Orders from the map: permissions, effects, and audit entries."""

import base64
import json
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.fleet.messages import Recall
from companion.fleet.roles import Role
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.files.token_file import (
    TokenFileMonitor,
    generate_random_token,
    read_owner_only_tokens,
    write_owner_only_tokens_atomically,
)
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.web.map_server import MapDataSources, MapServer
from ground_station.adapters.web.people import MapAccess
from ground_station.app.cli.main import app
from ground_station.app.map.http_interface import openapi_document
from ground_station.app.map.map_commands import OperatorCommands
from ground_station.core.people.audit_chain import find_chain_faults
from ground_station.core.people.web_tokens import USER_ROLES, TokenRegistry
from ground_station.core.schema.order_states import OrderState
from tests.ground_station.web.browser import browsing, needs_chromium
from tests.ground_station.web.map_site import HARBOUR, MapEars, MapSite

pytestmark = pytest.mark.timeout(180)


class Line(MapEars):
    """A person's own connection to the world's network, which sends."""

    def send(self, command, wait_s: float) -> None:
        super().send(command, wait_s)
        self.world.send(command, wait_s)

    def receive(self, wait_s: float) -> list:
        return super().receive(wait_s) + self.world.receive(wait_s)


@dataclass
class Desk:
    """A map with people: anna may command, vera may view."""

    site: MapSite
    file: Path
    tokens: dict[str, str]
    lines: list[Line]
    server: MapServer

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server.port}"

    def post(self, content: object, name: str | None = "anna", **headers: str) -> httpx.Response:
        return self.post_with(None if name is None else self.tokens[name], content, **headers)

    def post_with(self, token: str | None, content: object, **headers: str) -> httpx.Response:
        if token is not None:
            headers["authorization"] = f"Bearer {token}"
        names = {name.replace("_", "-"): value for name, value in headers.items()}
        where = f"{self.address}/commands"
        if isinstance(content, str):
            return httpx.post(where, content=content, headers=names, timeout=60.0)
        return httpx.post(where, json=content, headers=names, timeout=60.0)

    def audit(self) -> list[tuple[str, str, str]]:
        """Return author, command and subject of each entry."""
        rows, head = read_audit_rows_and_head(self.site.reader.database)
        assert list(find_chain_faults(rows, head)) == []
        return [(row.entry.who, row.entry.deed, row.entry.subject) for row in rows]


def serve(site: MapSite, people: MapAccess) -> MapServer:
    server = MapServer("127.0.0.1", 0)
    feed = site.decode_bytes
    server.start_serving(
        MapDataSources(
            feed.stream,
            feed.margin_history_of,
            feed.reachable_area_boundary,
            access=people,
            order=feed.order_record_of,
            openapi=openapi_document,
        )
    )
    site.held.callback(server.close)
    return server


@pytest.fixture
def desk(site: MapSite, tmp_path: Path) -> Iterator[Desk]:
    file, book, tokens = tmp_path / "tokens.json", TokenRegistry(), {}
    for name, role in (("anna", Role.DISPATCHER), ("vera", Role.VIEWER)):
        tokens[name] = generate_random_token()
        book = book.with_holder(name, role, tokens[name], "2026-01-01")
    write_owner_only_tokens_atomically(file, book)
    lines: list[Line] = []

    def open_fleet() -> Line:
        lines.append(Line(site.world))
        return lines[-1]

    def open_store() -> Store:
        return Store(Database(site.url, create=False), epoch_us)

    deeds = OperatorCommands(lambda person: person, open_store, open_store, open_fleet, HARBOUR)
    server = serve(site, MapAccess(TokenFileMonitor(file).current_tokens, deeds.execute_command))
    return Desk(site, file, tokens, lines, server)


def test_without_people_there_is_no_way_to_send(site: MapSite):
    site.step()
    assert httpx.post(f"{site.address}/commands", json={"do": "recall"}).status_code == 405
    assert httpx.get(f"{site.address}/me.json").json() == {
        "people": False,
        "may_order": False,
        "token_to_read": False,
    }


def test_a_hold_and_its_release_are_those_of_the_terminal(desk: Desk):
    done = desk.post({"do": "hold", "vehicle": "d2", "reason": "propeller"})
    assert (done.status_code, done.json()["messages"]) == (200, ["d2 is held by anna: propeller"])
    (hold,) = desk.site.store.holds_in_force()
    assert (hold.scope, hold.by, hold.reason) == ("d2", "anna", "propeller")
    done = desk.post({"do": "release", "vehicle": "d2"})
    assert done.json()["messages"] == ["released: d2 (was held by anna: propeller)"]
    assert desk.site.store.holds_in_force() == []
    assert desk.post({"do": "release", "vehicle": "d2"}).json()["checks"] == [
        "d2: no launch hold of its own"
    ]
    assert desk.audit()[-2:] == [("anna", "hold", "d2"), ("anna", "release", "d2")]


def test_a_settled_order_is_closed_with_who_said_it(desk: Desk):
    desk.site.until_flying("d1")
    deed = {"do": "settle", "order": "H-101", "settled": "delivered", "reason": "customer rang"}
    assert desk.post(deed).status_code == 200
    row = next(row for row in desk.site.store.orders() if row.order.id == "H-101")
    assert (row.state, row.reason) == (
        OrderState.DELIVERED,
        "delivered, says anna: customer rang",
    )
    assert ("anna", "settle", "H-101") in desk.audit()
    again = desk.post(deed)
    assert (again.status_code, again.json()["error"]) == (
        409,
        "order H-101: delivered, expected assigned or stuck or cancelled or returned",
    )


def test_a_recall_goes_out_under_the_persons_name_and_holds(desk: Desk):
    desk.site.until_flying("d1")
    done = desk.post({"do": "recall", "vehicle": "d1"})
    assert done.status_code == 200
    (line,) = desk.lines
    assert {command.vehicle for command in line.sent} == {"d1"}
    assert {command.by for command in line.sent} == {"anna"}
    assert all(isinstance(command.action, Recall) for command in line.sent)
    assert [hold.scope for hold in desk.site.store.holds_in_force()] == ["d1"]
    assert ("anna", "hold", "d1") in desk.audit()
    (check,) = done.json()["checks"]
    assert check.startswith("d1 did not accept the recall: "), "this world's drones refuse it"
    assert any("refused not now" in words for words in done.json()["messages"])


def test_a_launch_that_cannot_be_confirmed_says_why(desk: Desk):
    done = desk.post({"do": "confirm", "order": "H-108"})
    assert (done.status_code, done.json()["error"]) == (409, "order H-108: no drone is assigned")


def test_who_has_no_token_or_only_looks_orders_nothing(desk: Desk):
    deed = {"do": "hold", "vehicle": "d2", "reason": "x"}
    before = desk.audit()
    assert desk.post(deed, None).status_code == 401
    for wrong in ("x", generate_random_token(), "x" * 1000):
        assert desk.post_with(wrong, deed).status_code == 401
    refused = desk.post(deed, "vera")
    assert (refused.status_code, refused.json()["error"]) == (
        409,
        "vera is a viewer: may not command",
    )
    assert (desk.audit(), desk.site.store.holds_in_force(), desk.lines) == (before, [], [])


def test_another_page_of_the_browser_orders_nothing_even_with_a_token(desk: Desk):
    deed = {"do": "hold", "vehicle": "d2", "reason": "x"}
    assert desk.post(deed, origin="http://evil.example").status_code == 403
    assert desk.post(deed, sec_fetch_site="cross-site").status_code == 403
    assert desk.post(deed, host="evil.example").status_code == 421
    assert desk.post(json.dumps(deed), content_type="text/plain").status_code == 415
    assert desk.site.store.holds_in_force() == []
    assert desk.post(deed, origin=desk.address).status_code == 200


@pytest.mark.sample
@pytest.mark.parametrize(
    "content",
    [
        {"do": "land"},
        {"do": "hold", "vehicle": "d2"},
        {"do": "hold", "vehicle": "d2", "reason": ""},
        {"do": "hold", "vehicle": "d2", "reason": "x", "by": "somebody else"},
        {"do": "settle", "order": "H-101", "settled": "eaten", "reason": "x"},
        {"do": "recall", "vehicle": "../d1"},
        [],
        "{",
        {"do": "hold", "vehicle": "d2", "reason": "x" * 5000},
    ],
)
def test_what_is_no_order_is_refused_in_words(desk: Desk, content):
    answer = desk.post(content, content_type="application/json")
    assert answer.status_code in (400, 409, 413)
    assert answer.json()["error"]
    assert desk.site.store.holds_in_force() == []
    assert [command for line in desk.lines for command in line.sent] == []


def test_a_revoked_token_is_out_at_once_and_a_broken_file_lets_nobody_in(desk: Desk):
    deed = {"do": "hold", "vehicle": "d2", "reason": "x"}
    write_owner_only_tokens_atomically(
        desk.file, read_owner_only_tokens(desk.file).without_holder("anna")
    )
    assert desk.post(deed).status_code == 401
    assert desk.post(deed, "vera").status_code == 409
    desk.file.chmod(0o644)
    assert desk.post(deed, "vera").status_code == 401
    desk.file.chmod(0o600)
    assert desk.post(deed, "vera").status_code == 409
    desk.file.write_text("{")
    assert desk.post(deed, "vera").status_code == 401


def test_where_a_token_is_needed_to_read_nothing_of_the_fleet_is_told_without(desk: Desk):
    desk.site.step()
    people = MapAccess(TokenFileMonitor(desk.file).current_tokens, None, requires_token=True)
    address = f"http://127.0.0.1:{serve(desk.site, people).port}"
    mine = {"authorization": f"Bearer {desk.tokens['vera']}"}
    told = ("/picture.json", "/events", "/span.json", "/history.json?vehicle=d1", "/nothing")
    for path in told:
        with httpx.stream("GET", address + path) as answer:
            assert answer.status_code == 401, path
        with httpx.stream("GET", address + path, headers=mine) as answer:
            assert answer.status_code in (200, 204, 404), path
    for path in ("/", "/page/main.js", "/me.json"):
        assert httpx.get(address + path).status_code == 200
    with httpx.stream("GET", f"{address}/events", headers=mine, timeout=30.0) as answer:
        events = answer.iter_raw()
        next(events)
        write_owner_only_tokens_atomically(desk.file, TokenRegistry())
        for _ in range(5):
            desk.site.step()
        assert len(list(events)) < 5, "the stream has ended"


def test_the_file_has_digests_only_and_is_its_owners(tmp_path: Path):
    file = str(tmp_path / "tokens.json")
    run = CliRunner().invoke
    made = run(app, ["token", "add", "anna", "--role", "supervisor", "--tokens", file])
    token = made.stdout.splitlines()[0]
    assert len(token) >= 43, "256 bits in base64 (RFC 4648, 5)"
    assert token not in Path(file).read_text()
    assert stat.S_IMODE(Path(file).stat().st_mode) == 0o600
    person = read_owner_only_tokens(Path(file)).find_operator(token)
    assert person is not None
    assert (person.name, person.role) == ("anna", Role.SUPERVISOR)
    assert "anna" in run(app, ["token", "list", "--tokens", file]).stdout
    for options, words in (
        (["add", "anna"], "revoke it first"),
        (["add", "b o b"], "expected 1 to 40 letters"),
        (["revoke", "bob"], "bob has no token; token holders: anna"),
    ):
        assert words in str(run(app, ["token", *options, "--tokens", file]).exception)
    refused = run(app, ["token", "add", "bob", "--role", "vehicle", "--tokens", file])
    assert refused.exit_code == 2
    assert all(role.value in refused.output for role in USER_ROLES)
    assert "router" not in run(app, ["token", "--help"]).output
    with pytest.raises(LeewayError, match="expected supervisor or dispatcher or viewer"):
        TokenRegistry().with_holder("bob", Role.VEHICLE, generate_random_token(), "2026-01-01")
    assert run(app, ["token", "revoke", "anna", "--tokens", file]).exit_code == 0
    assert read_owner_only_tokens(Path(file)).find_operator(token) is None
    Path(file).chmod(0o640)
    with pytest.raises(LeewayError, match="mode 0640, expected 0600"):
        read_owner_only_tokens(Path(file))
    missing = run(app, ["token", "list", "--tokens", str(tmp_path / "none")])
    assert "token add NAME" in str(missing.exception)


def test_in_the_page_an_order_takes_two_clicks_and_a_revoked_token_is_said(desk: Desk):
    program = needs_chromium()
    desk.site.until_flying("d1")
    with browsing(program, viewport={"width": 1280, "height": 800}) as page:
        page.goto(desk.address)
        page.wait_for_selector("#link.live")
        page.keyboard.press("j")
        page.locator("#card h2", has_text="d1").wait_for()
        assert page.locator(".deed, .all").count() == 0
        page.locator("#sign-in").click()
        page.locator("#token").fill("wrong")
        page.keyboard.press("Enter")
        page.locator("#who-trouble", has_text="no valid token").wait_for()
        page.locator("#token").fill(desk.tokens["anna"])
        page.locator("#use-token").click()
        page.locator("#person", has_text="anna, dispatcher").wait_for()
        page.keyboard.press("j")
        page.locator("#card footer", has_text="Hold").locator("[data-do=ask]").click()
        page.get_by_label("Other", exact=True).check()
        page.get_by_label("Other reason").fill("jam of j and k")
        hold = page.locator("#card .deed", has_text="old d1")
        desk.site.step()
        page.wait_for_selector("#link.live")
        hold.click()
        page.locator("#card .deed.armed", has_text="Again to hold d1").wait_for()
        assert desk.site.store.holds_in_force() == []
        page.wait_for_timeout(400)
        desk.site.step()  # commands need recent data
        hold.click()
        page.locator("#result", has_text="d1 is held by anna: jam of j and k").wait_for()
        assert [one.scope for one in desk.site.store.holds_in_force()] == ["d1"]
        assert page.locator("#card h2").inner_text().startswith("d1"), "typing is no key of the map"
        write_owner_only_tokens_atomically(
            desk.file, read_owner_only_tokens(desk.file).without_holder("anna")
        )
        page.locator("#person", has_text="the token of anna is no longer valid").wait_for()
        assert page.locator(".deed").count() == 0
        desk.site.step(5)  # the day paused for long: a busy machine counts it as lost
        page.wait_for_selector("#link.live")


CSV = "\ufeffid;lat_deg;lon_deg;mass_kg\r\nN-1;55,4702;8,4510;0,4\r\nN-2;55,4703;8,4490;0,3\r\n"


def test_orders_are_checked_added_imported_and_cancelled_with_a_reason(desk: Desk):
    cells = {"id": "N-9", "lat_deg": "55.4710", "lon_deg": "8.4520", "mass_kg": "0.4"}
    checked = desk.post({"do": "add", "cells": cells, "check": True})
    assert "N-9: can be flown from the depot" in checked.json()["messages"][0]
    assert "N-9" not in {row.order.id for row in desk.site.store.orders()}
    far = desk.post({"do": "add", "cells": cells | {"lat_deg": "55.90"}, "check": True})
    assert "cannot be flown" in far.json()["checks"][0]
    assert desk.post({"do": "add", "cells": cells}).status_code == 200
    again = desk.post({"do": "add", "cells": cells}).json()["messages"][0]
    assert again == "0 orders imported, 1 imported before"
    assert desk.post({"do": "add", "cells": cells | {"mass_kg": "0.3"}}).status_code == 409
    content = base64.b64encode(CSV.encode("utf-8")).decode()
    file = {"do": "import", "file": "orders.csv", "content": content}
    assert desk.post(file | {"check": True}).json()["messages"][0] == "2 orders can be added"
    assert desk.post(file).json()["messages"][0] == "2 orders imported"
    orders = {row.order.id: row.order for row in desk.site.store.orders()}
    assert (orders["N-1"].lat_deg, orders["N-2"].mass_kg) == (55.4702, 0.3)
    assert orders["N-9"].alt_amsl_m == pytest.approx(12.0, abs=2.0), "the day's terrain"
    wrong = base64.b64encode(CSV.replace("0,3", "heavy").encode()).decode()
    refused = desk.post(file | {"content": wrong})
    assert refused.status_code == 409
    assert "orders.csv, row 3, column mass_kg: 'heavy'" in refused.json()["error"]
    moved = {"do": "change", "order": "N-9", "cells": {"mass_kg": "0.5", "phone": "12"}}
    assert "mass 0.4 -> 0.5" in desk.post(moved).json()["messages"][0]
    wrong_cell = desk.post(moved | {"cells": {"mass_kg": "-1"}})
    assert (wrong_cell.status_code, "mass_kg" in wrong_cell.json()["error"]) == (409, True)
    assert desk.post({"do": "cancel", "order": "N-9", "reason": ""}).status_code == 400
    assert desk.post({"do": "cancel", "order": "N-9", "reason": "Wrong address"}).status_code == 200
    row = next(row for row in desk.site.store.orders() if row.order.id == "N-9")
    assert (row.state, row.reason) == (OrderState.CANCELLED, "Wrong address, by anna")


def test_in_the_page_an_order_is_checked_before_it_is_saved_then_cancelled(
    desk: Desk, tmp_path: Path
):
    program = needs_chromium()
    desk.site.step(3)
    file = tmp_path / "new.csv"
    file.write_bytes(CSV.encode("utf-8"))
    with browsing(program, viewport={"width": 1440, "height": 900}) as page:
        page.add_init_script(f"sessionStorage.setItem('leeway token', '{desk.tokens['anna']}')")
        page.goto(desk.address)
        page.wait_for_selector("#link.live")
        page.locator("#person", has_text="anna").wait_for()
        page.keyboard.press("n")
        page.locator("#card [name=mass_kg]").fill("0,4")
        save = page.locator("[data-do=save-order]")
        assert save.is_disabled()
        box = page.locator("#place").bounding_box()
        page.mouse.click(box["x"] + box["width"] * 0.4, box["y"] + box["height"] * 0.45)
        page.locator("#card .verdict", has_text="can be flown from the depot").wait_for()
        page.locator("#card [name=id]").fill("N-7")
        page.locator("#card .verdict", has_text="N-7").wait_for()
        save.click()
        page.locator("#result", has_text="1 orders imported").wait_for()
        desk.site.step(2, desk=False)
        page.locator("#card h2", has_text="N-7").wait_for()
        page.locator("#card [data-do=ask]", has_text="Edit").click()
        for name, text in {"customer": "Jo Hansen", "phone": "+45 12", "mass_kg": "0,5"}.items():
            page.locator(f"#card [name={name}]").fill(text)
        page.locator("#card [name=window_from]").fill("2026-05-01T14:00")
        page.locator("#card [name=priority]").select_option("urgent")
        page.locator("#card [name=window_to]").fill("2026-05-01T15:30")
        page.locator("[data-do=save-change]").click()
        page.locator("#result", has_text="customer none -> Jo Hansen").wait_for()
        desk.site.step(2, desk=False)
        page.locator("#card h2", has_text="Jo Hansen").wait_for()
        page.locator("#card .facts", has_text="14:00\u201315:30").wait_for()
        assert page.locator("#card a[href='tel:+4512']").inner_text() == "+45 12"
        page.locator("#card .why", has_text="anna: change: ").wait_for()
        page.locator("#card", has_text="Cancel order").locator("footer .danger").click()
        page.get_by_label("Wrong address").check()
        cancel = page.locator("#card .deed", has_text="ancel N-7")
        cancel.click()
        page.wait_for_timeout(400)
        cancel.click()
        page.locator("#result", has_text="N-7: cancelled").wait_for()
        page.locator("#card form").wait_for(state="detached")
        page.keyboard.press("2")
        page.locator("#board tr", has_text="H-103").locator("td").nth(3).click()
        page.locator("#card h2", has_text="H-103").wait_for()
        page.locator("#board [data-with=import]").click()
        page.locator("#file").set_input_files(file)
        page.locator("#card .verdict", has_text="2 orders can be added").wait_for()
        page.locator("[data-do=save-file]").click()
        page.locator("#result", has_text="2 orders imported").wait_for()
    row = next(row for row in desk.site.store.orders() if row.order.id == "N-7")
    order, hour_us = row.order, 3600 * 10**6
    assert (order.phone, order.mass_kg, order.is_urgent) == ("+45 12", 0.5, True)
    assert (order.latest_us or 0) - (order.earliest_us or 0) == 1.5 * hour_us
    assert row.reason == "Wrong address, by anna"
