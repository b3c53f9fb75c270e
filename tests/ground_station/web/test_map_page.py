"""The page in a browser with a real desk's day, checked by its texts."""

from collections.abc import Iterator

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
    with browsing(chromium, viewport={"width": 1440, "height": 900}) as page:
        page.goto(site.address)
        page.wait_for_selector("#link.live")
        yield page


def row(page, name: str) -> list[str]:
    parts = (".name", ".where", ".spare")
    return [page.locator(f'#list [data-key="{name}"] {part}').inner_text() for part in parts]


def shown(page, words: str) -> None:
    """Wait until these words are on the page."""
    page.get_by_text(words, exact=False).first.wait_for()


def test_list_board_and_bar_say_what_the_store_says(site, page):
    site.fleet_link.more["d1"] = {"margin_wh": 12.34, "p_home": 0.99871}
    site.step(2)
    shown(page, "+12 Wh")
    assert row(page, "d1")[:2] == ["d1 Flying out", "H-101"]
    assert page.locator("#attention .calm").inner_text() == "Nothing needs you"
    assert page.locator(".figures").inner_text().count("depot") == 1
    page.keyboard.press("2")
    states = {row.order.id: row.state.value for row in site.store.orders()}
    words = {"open": "open", "assigned": {"air", "van"}, "delivered": "delivered"}
    page.locator("#board tbody").first.wait_for()
    for id_, state in states.items():
        look = page.locator(f'#board tr[data-key="{id_}"]').get_attribute("class").split()[0]
        assert look in words[state], id_
    delivered = sum(state == "delivered" for state in states.values())
    assert page.locator(".figure.wide dd").inner_text() == f"{delivered} of {len(states)}"
    site.fleet_link.more["d1"] = {"p_home": 0.99999, "p_home_limit": 0.9}
    site.step(2)
    page.locator('#list [data-key="d1"] .name').click()
    shown(page, "at most 1 in 10 (limit of evidence)")


def test_an_item_is_gone_within_two_seconds_of_its_cause(site, page):
    drone = site.world.drones["d1"]
    assert drone.flight is not None
    why = "turn_back: P(home) 0.962 is below the accepted 0.99"
    drone.tell(EventKind.DECISION, why, assignment=drone.flight.assignment)
    site.fleet_link.more["d1"] = {"margin_wh": -2.04, "p_home": 0.962, "phase": "return"}
    site.step(2)
    page.locator("#attention .warning [data-do=show]").first.click()
    shown(page, "d1 is 2.0 Wh short of coming home")
    shown(page, "Turns back: risk 1 in 26 is above the limit 1 in 100")
    assert page.locator("#card .big.risk").inner_text().split("\n")[0].startswith("1 in 26")
    assert page.title().startswith("(1) harbour")
    site.fleet_link.more["d1"] = {"margin_wh": 20.0, "phase": "return"}
    site.step(1)
    page.locator("#attention .calm").wait_for(timeout=2000)
    assert not page.title().startswith("(")


def test_a_drone_on_the_map_turns_and_moves(site, page):
    drone = page.locator('#map .drone[data-key="d1"]')
    site.fleet_link.more["d1"] = {"lat_deg": 55.47, "lon_deg": 8.45}
    site.step(2)
    page.wait_for_timeout(400)
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
    page.locator("#map .label.truck-tag", has_text="to stop-1, by plan, arrives").wait_for()
    assert page.locator("#map .drive polyline").count() == 1
    before = truck.get_attribute("transform")
    for _ in range(5):
        page.wait_for_timeout(400)
        site.step()
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
    path = page.locator("#map .ways .way.home:not(.straight)")
    path.wait_for(state="attached")
    corners = [len(line.split(" ")) for line in path.get_attribute("d").split("M")[1:]]
    assert corners == [3] * len(corners)
    page.keyboard.press("j")
    page.locator("#map .ways .way.home.chosen").wait_for(state="attached")
    shown(page, "as uploaded")


CHANGED = """() => {
  window.changed = new Set();
  const note = (found) => found.forEach((one) => window.changed.add(one.target));
  const all = { subtree: true, attributes: true };
  new MutationObserver(note).observe(document.querySelector('#map'), all);
}"""


def test_while_the_map_moves_one_element_moves_and_then_all_is_drawn_again(page):
    page.wait_for_timeout(400)
    page.evaluate(CHANGED)
    page.keyboard.press("ArrowLeft")
    wait_until(page, "window.changed.size > 0")
    first = page.evaluate("[...window.changed].map((one) => one.id)")
    assert first[0] == "map"
    wait_until(page, "window.changed.size > 10")


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


def test_an_update_keeps_elements_focus_and_typed_text(page):
    """`morph` on a test list: the second of three is removed, the third keeps its input."""
    run = """async () => {
      const { html, morph } = await import('/page/dom.js');
      const list = document.createElement('ul');
      document.body.append(list);
      const field = () => html('input', { type: 'text' });
      const item = (key, words) => html('li', { 'data-key': key }, words, field());
      morph(list, [item('a', '1'), item('b', '2'), item('c', '3')]);
      const [, , third] = list.children;
      third.lastChild.value = 'typed';
      third.lastChild.focus();
      morph(list, [item('c', '4'), item('a', '1')]);
      return [list.textContent, list.firstChild === third, document.activeElement.value];
    }"""
    assert page.evaluate(run) == ["41", True, "typed"]


def test_words_from_outside_are_shown_and_do_nothing(site, page):
    words = '<img src=x onerror="window.hit=1"><b>bold</b>'
    site.fleet_link.more["d1"] = {"text": words}
    site.step(2)
    page.keyboard.press("j")
    shown(page, words)
    assert page.evaluate("window.hit") is None
    assert page.locator("#card img, #card dd b").count() == 0


def test_without_data_a_band_comes_within_five_seconds_and_goes_with_new_data(site, page):
    port = site.server.port
    site.server.close()
    page.locator("#link.lost").wait_for(timeout=5000)
    assert page.locator("#band").inner_text().startswith("No data for ")
    gray = "getComputedStyle(document.querySelector('#map')).filter"
    assert page.evaluate(gray) == "grayscale(1)"
    assert row(page, "d1")[0] == "d1 Flying out", "the last picture stays"
    site.fleet_link.more["d1"] = {"phase": "return"}
    site.start_map(port)
    site.step(2)
    page.locator("#link.live").wait_for()
    shown(page, "Flying back")
    assert page.locator("#band").is_hidden()


def test_the_pages_own_merge_is_the_rfcs(page):
    run = "async ([t, p]) => (await import('/page/stream.js')).merged(t, p)"
    for target, patch, result in RFC_7396:
        assert page.evaluate(run, [target, patch]) == result
