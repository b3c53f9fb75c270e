"""The map as people use it: commands as processes over zenoh, orders from the page, identities."""

from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

from companion.fleet.messages import Recall
from companion.fleet.roles import Role
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.files.token_file import (
    generate_random_token,
    write_owner_only_tokens_atomically,
)
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.core.people.web_tokens import TokenRegistry
from tests.fleet.secure_site import SecureSite
from tests.fleet.zenoh_net import free_port
from tests.ground_station.desk.test_desk_processes import start
from tests.ground_station.web.browser import browsing, needs_chromium
from tests.ground_station.web.test_map_process import Desk, until

pytestmark = pytest.mark.timeout(240)


def tokens(file: Path, **people: Role) -> dict[str, str]:
    """Write a token for each person."""
    made = {name: generate_random_token() for name in people}
    book = TokenRegistry()
    for name, role in people.items():
        book = book.with_holder(name, role, made[name], "2026-01-01")
    write_owner_only_tokens_atomically(file, book)
    return made


def audit(url: str) -> list[tuple[str, str]]:
    store = Store(Database(url, create=False), epoch_us)
    try:
        return [
            (row.entry.who, row.entry.deed) for row in read_audit_rows_and_head(store.database)[0]
        ]
    finally:
        store.close()


def test_the_page_outlives_the_desk_and_a_recall_from_it_is_reported_done(tmp_path: Path):
    program = needs_chromium()
    with ExitStack() as held:
        desk = Desk(tmp_path, held)
        token = tokens(tmp_path / "tokens.json", anna=Role.DISPATCHER)["anna"]
        dispatching, drone = desk.desk(), desk.drone()
        desk.map("--tokens=tokens.json")
        until(desk.answers)
        page = held.enter_context(browsing(program, viewport={"width": 1280, "height": 800}))
        page.goto(desk.address)
        row = page.locator('#list [data-key="d1"]')
        row.locator(".name", has_text="Flying out").wait_for()

        dispatching.kill()
        dispatching.wait()
        page.locator("#attention .warning", has_text="Desk not responding").wait_for(timeout=20_000)
        drone.phase = "return"
        desk.desk()  # it is also the network's router
        row.locator(".name", has_text="Flying back").wait_for()
        page.locator("#attention .calm").wait_for()
        assert page.locator("#link b").inner_text() == "Live"

        page.locator("#sign-in").click()
        page.locator("#token").fill(token)
        page.keyboard.press("Enter")
        page.locator("#person", has_text="anna, dispatcher").wait_for()
        row.locator("button").click()
        recall = page.locator("#card .deed", has_text="ecall d1")
        recall.click()
        page.wait_for_timeout(400)
        recall.click()
        page.locator("#result", has_text="done").wait_for()
        row.locator(".name", has_text="Standing by").wait_for()
        page.locator("#card .deed", has_text="Release d1").wait_for()
    (deed,) = [command for command in drone.done if isinstance(command.action, Recall)]
    assert deed.by == "anna"
    assert ("anna", "hold") in audit(desk.url)


@pytest.mark.sample
def test_with_an_identity_an_order_is_the_members_who_signs_it_and_a_viewers_signs_none(
    tmp_path: Path,
):
    """The token names the author; the fleet accepts the identity's member."""
    site, url = SecureSite(tmp_path / "pki"), f"sqlite:///{tmp_path}/d.db"
    Database(url).close()
    token = tokens(tmp_path / "tokens.json", bert=Role.SUPERVISOR)["bert"]
    with ExitStack() as held:
        meeting, vehicle = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
        for one in (meeting, vehicle):
            held.callback(one.close)

        def recalled_by(member: str) -> httpx.Response:
            port = free_port()
            common = ("--fleet=harbour", f"--store={url}", "--tokens=tokens.json", f"--port={port}")
            showing = start(tmp_path, "map", *common, f"--identity={site.home(member)}")
            held.callback(showing.wait)
            held.callback(showing.kill)
            address = f"http://127.0.0.1:{port}"
            until(lambda: "Ctrl-C ends it" in (tmp_path / "map.out").read_text())
            mine = {"authorization": f"Bearer {token}"}
            deed = {"do": "recall", "vehicle": "d1"}
            answer = httpx.post(f"{address}/commands", json=deed, headers=mine, timeout=60.0)
            showing.kill()
            (tmp_path / "map.out").unlink()
            return answer

        refused = recalled_by("otto")
        assert refused.status_code == 409
        assert "viewer" in refused.json()["error"]
        assert vehicle.done == []
        done = recalled_by("anna")
        assert (done.status_code, done.json()["checks"]) == (200, []), done.json()
        assert any("done" in words for words in done.json()["messages"])
    (command,) = vehicle.done
    assert isinstance(command.action, Recall)
    assert ("bert by way of anna", "hold") in audit(url)
