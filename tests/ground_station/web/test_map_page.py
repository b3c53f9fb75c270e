"""The page in a browser, checked by its texts."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing

import pytest

from companion.fleet.messages import EventKind
from tests.ground_station.web.browser import (
    browsing,
    needs_chromium,
    running,
    wait_until,
)
from tests.ground_station.web.map_site import MapSite
from tests.ground_station.web.test_map_truth import RFC_7396

pytestmark = pytest.mark.timeout(180)


@pytest.fixture(scope="module")
def chromium() -> Iterator:
    """One browser for all windows of this module."""
    with running(needs_chromium()) as browser:
        yield browser


@pytest.fixture
def page(site: MapSite, chromium) -> Iterator:
    site.until_flying("d1")
    with browsing(chromium, viewport={"width": 1280, "height": 800}) as page:
        page.goto(site.address)
        page.wait_for_selector("#link.live")
        yield page


def cells(page, name: str) -> list[str]:
    return page.locator(f'#drones tr[data-key="{name}"] td').all_inner_texts()


def shown(page, words: str) -> None:
    """Wait until these words are on the page."""
    page.get_by_text(words, exact=False).first.wait_for()


def test_the_tables_say_what_the_store_says(site, page):
    site.fleet_link.more["d1"] = {"margin_wh": 12.34, "p_home": 0.99871}
    site.step(2)
    shown(page, "0.9987")
    assert cells(page, "d1") == ["d1", "outbound", "H-101", "depot", "12.3", "0.9987"]
    site.fleet_link.more["d1"] = {"margin_wh": 12.34, "p_home": 0.99999, "p_home_limit": 0.9}
    site.step(2)
    shown(page, "risk at most 1 in 10 (limit of evidence)")
    orders = {row.order.id: row.state.value for row in site.store.orders()}
    rows = page.locator("#orders tbody tr").all()
    assert {r.locator("td").all_inner_texts()[0]: r.locator("td").all_inner_texts()[1]
            for r in rows} == orders  # fmt: skip
    assert page.locator("#attention").inner_text() == "no alarms"
    assert page.locator("#truck").inner_text().startswith("truck: at depot, leaves in ")
    assert "waits for d1" in page.locator("#truck").inner_text()


def test_a_click_on_what_wants_an_eye_says_why_in_the_gates_words(site, page):
    drone = site.world.drones["d1"]
    assert drone.flight is not None
    why = "turn_back: P(home) 0.962 is below the accepted 0.99"
    drone.tell(EventKind.DECISION, why, assignment=drone.flight.assignment)
    site.fleet_link.more["d1"] = {"margin_wh": -2.04, "p_home": 0.962, "phase": "return"}
    site.step(2)
    page.locator("#attention button").click()
    assert page.locator("#attention").inner_text() == "! d1: 2.0 Wh short of its promise"
    shown(page, why)
    told = dict(
        zip(*(page.locator(f"#detail {tag}").all_inner_texts() for tag in ("dt", "dd")),
            strict=True)
    )  # fmt: skip
    assert told["alarm"] == "2.0 Wh short of its promise"
    assert told["P(home)"] == "0.96200"
    assert told["margin"] == "-2.0 Wh"
    page.locator("#detail svg polyline.loss").wait_for(state="attached")


def test_the_keyboard_selects_and_closes_and_goes_to_what_wants_an_eye(site, page):
    page.keyboard.press("j")
    page.locator("#detail h2").wait_for()
    assert page.locator("#detail h2").inner_text() == "d1"
    page.keyboard.press("Escape")
    page.locator("#detail").wait_for(state="hidden")
    site.fleet_link.more["d2"] = {"margin_wh": -1.0, "armed": True, "assignment": "H-102.1"}
    site.step(2)
    shown(page, "! d2")
    page.keyboard.press("a")
    page.locator("#detail h2", has_text="d2").wait_for()
    page.keyboard.press("?")
    assert page.locator("#help").is_visible()
    page.keyboard.press("Escape")


def test_a_drone_on_the_map_turns_and_moves(site, page):
    drone = page.locator('#map .drone[data-key="d1"]')
    site.fleet_link.more["d1"] = {"lat_deg": 55.47, "lon_deg": 8.45}
    site.step(2)
    before = drone.get_attribute("transform")
    site.fleet_link.more["d1"] = {"lat_deg": 55.47, "lon_deg": 8.45 + 40.0 / 63_100}
    site.step(2)
    drone.locator("path[transform='rotate(90)']").wait_for(state="attached")
    assert drone.get_attribute("transform") != before


def test_a_truck_between_stops_is_drawn_hollow_and_said_to_be_by_plan(site, page):
    while not site.world.driver.truck.is_en_route:
        site.step()
    site.step(30)
    truck = page.locator("#map .truck .by-plan")
    truck.wait_for(state="attached")
    assert "drives to stop-1, planned arrival in " in (truck.locator("text").text_content() or "")
    assert page.locator("#map .drive polyline").count() == 1
    before = truck.get_attribute("transform")
    page.wait_for_timeout(2500)
    assert truck.get_attribute("transform") != before, "it moves by the clock"
    while site.world.driver.truck.is_en_route:
        site.step()
    site.step(2)
    truck.wait_for(state="detached")


def test_ways_of_many_drones_are_one_path_and_of_the_selected_one_another(site, page):
    ways = {"outbound_route": "_p~iF~ps|U_ulLnnqC", "return_route": "_p~iF~ps|U_ulLnnqC_mqNvxq`@"}
    for name in ("d1", "d2"):
        site.fleet_link.more[name] = ways | {
            "armed": True,
            "assignment": "a.1",
            "phase": "outbound",
        }
    site.step(2)
    path = page.locator("#map .ways .way-home:not(.straight)")
    path.wait_for(state="attached")
    drawn = path.get_attribute("d")
    corners = [len(line.split(" ")) for line in drawn.split("M")[1:]]
    assert corners == [3] * len(corners)
    page.keyboard.press("j")
    page.locator("#map .ways .way-home.chosen").wait_for(state="attached")
    shown(page, "onboard route")


CHANGED = """() => {
  window.changed = new Set();
  const note = (found) => found.forEach((one) => window.changed.add(one.target));
  const all = { subtree: true, attributes: true };
  new MutationObserver(note).observe(document.querySelector('#map'), all);
}"""


def changed(page) -> int:
    """Count the map elements changed since `CHANGED`, after changes stop."""
    wait_until(page, "window.changed.size > 0")
    page.wait_for_timeout(300)
    return page.evaluate("window.changed.size")


def test_to_move_the_map_moves_one_element_and_to_zoom_draws_all_anew(page):
    page.evaluate(CHANGED)
    page.keyboard.press("ArrowLeft")
    assert changed(page) == 1
    page.evaluate(CHANGED)
    page.keyboard.press("+")
    assert changed(page) > 10


def test_what_has_not_changed_is_not_drawn_again(page):
    """`keyed` on a test list: one item of three is a different object."""
    run = """async () => {
      const { keyed } = await import('/page/dom.js');
      const list = document.createElement('ul');
      const [told, make] = [[], () => document.createElement('li')];
      const tell = (li, item, key) => told.push(key);
      const draw = (items, look) => keyed(list, Object.entries(items), make, tell, () => look);
      const items = { a: {}, b: {}, c: {} };
      draw(items, 1);
      draw(items, 1);
      draw({ ...items, b: {} }, 1);
      const before = told.join('');
      draw(items, 2);
      return [before, told.join('').slice(before.length)];
    }"""
    assert page.evaluate(run) == ["abcb", "abc"]


def test_words_from_outside_are_shown_and_do_nothing(site, page):
    words = '<img src=x onerror="window.hit=1"><b>bold</b>'
    site.fleet_link.more["d1"] = {"text": words}
    site.step(2)
    page.keyboard.press("j")
    shown(page, words)
    assert page.evaluate("window.hit") is None
    assert page.locator("#detail img, #detail b").count() == 0


def test_it_says_that_what_it_shows_is_old_and_goes_on_when_the_server_is_back(site, page):
    port = site.server.port
    site.server.close()
    page.locator("#link.lost").wait_for()
    assert "NO CONNECTION" in page.locator("#link").inner_text()
    assert cells(page, "d1")[1] == "outbound"
    site.fleet_link.more["d1"] = {"phase": "return"}
    site.start_map(port)
    site.step(2)
    page.locator("#link.live").wait_for()
    shown(page, "return")


def test_the_pages_own_merge_is_the_rfcs(page):
    run = "async ([t, p]) => (await import('/page/stream.js')).merged(t, p)"
    for target, patch, result in RFC_7396:
        assert page.evaluate(run, [target, patch]) == result


@pytest.mark.parametrize("width", [360, 1280])
@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_it_fits_a_phone_and_a_desk_dark_and_light(site, chromium, width, scheme):
    site.until_flying("d1")
    look = {"viewport": {"width": width, "height": 740}, "color_scheme": scheme}
    with browsing(chromium, **look) as page:
        page.goto(site.address)
        page.wait_for_selector("#link.live")
        wide = page.evaluate("document.documentElement.scrollWidth")
        assert wide <= width
        ground, ink = page.evaluate(
            "['backgroundColor', 'color'].map((k) => getComputedStyle(document.body)[k])"
        )
        darker = min((ground, ink), key=brightness)
        assert (darker == ground) == (scheme == "dark")


BROKEN_WORDS = """() => {
  const found = [];
  for (const cell of document.querySelectorAll('#lists th, #lists td span')) {
    const words = cell.firstChild;
    for (const { 0: word, index } of (words?.textContent ?? '').matchAll(/\\S+/g)) {
      const range = document.createRange();
      range.setStart(words, index);
      range.setEnd(words, index + word.length);
      if (range.getClientRects().length > 1) found.push(word);
    }
  }
  return found;
}"""
WHY = "no vehicle comes home from there with the accepted P(home) before its window ends"


@pytest.mark.parametrize("width", [390, 1280])
def test_long_reasons_break_no_word_of_the_lists(site, chromium, width):
    site.until_flying("d1")
    site.fleet_link.more["d1"] = {"margin_wh": -3.25, "p_home": 0.99871}
    with closing(sqlite3.connect(site.url.removeprefix("sqlite:///"))) as db:
        db.execute("UPDATE orders SET why = ? WHERE state != 'open'", (WHY,))
        db.execute("UPDATE orders SET state = 'cancelled', why = ? WHERE id = 'H-108'", (WHY,))
        db.commit()
    site.step(2, desk=False)
    with browsing(chromium, viewport={"width": width, "height": 844}) as page:
        page.goto(site.address)
        page.wait_for_selector("#link.live")
        shown(page, WHY)
        assert page.evaluate(BROKEN_WORDS) == []
        lists = "document.querySelector('#lists')"
        assert page.evaluate(f"{lists}.scrollWidth <= {lists}.clientWidth")
        for column, word in (("last-child", "x" * 300), ("first-child", "x" * 40)):
            page.locator(f"#orders td:{column} span").first.evaluate(
                "(cell, word) => { cell.textContent = word }", word
            )
            assert page.evaluate(f"{lists}.scrollWidth <= {lists}.clientWidth"), column


def brightness(colour: str) -> float:
    return sum(map(float, colour[colour.index("(") + 1 : -1].split(",")[:3]))
