"""The page against the ground truth of a simulated day with faults, in lockstep.

Vehicles, companions, truck, desk and store are those of `sim-bridge day`; the map receives their
network as a second desk would. While the page is read, the day pauses.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.web.map_server import MapDataSources, MapServer
from ground_station.app.map.fleet_receiver import FleetListener
from ground_station.app.map.map_feed import MapPublisher
from ground_station.app.map.map_view import MapView
from ground_station.core.fleet.fleet_status import FleetStatus
from tests.ground_station.web.browser import browsing, needs_chromium

pytestmark = pytest.mark.timeout(240)

SEED = 1
OLD_S = 2.0
"""A state comes once a second and is 0.02 s under way; the picture is made once a second here."""

NOISE_M = 4.0
"""Of a satellite position without corrections (the simulator's own: 1 m and a slow bias)."""

CUT_S = 25.0
SILENT_S = 16.0
"""After the lease of 10 s it is off the network (`sim_bridge.app.day.bus`)."""

DESK_AWAY_S, RESTART_S = 20.0, 6.0
"""Of a killed desk and a killed companion (`sim-bridge day`)."""

BACK_S = 5.0
"""Time until a returned member is received again."""

READ = """() => {
  const groups = (selector) => Object.fromEntries([...document.querySelectorAll(selector)]
    .map((one) => [one.dataset.key, [one.getAttribute('transform'), one.getAttribute('class')]]));
  const text = (row, part) => row.querySelector(part).innerText;
  return {
    drones: groups('#map .drone'), orders: groups('#map .order'),
    drone_rows: Object.fromEntries([...document.querySelectorAll('#list li')]
      .map((row) => [row.dataset.key, [text(row, '.name'), text(row, '.spare')]])),
    attention: document.querySelector('#attention').innerText,
    labels: [...document.querySelectorAll('#map .label.tag')].map((one) => one.textContent),
  };
}"""


def mercator(lat_deg: float) -> float:
    """Southward, of the world's width (EPSG:3857)."""
    return -math.asinh(math.tan(math.radians(lat_deg))) / (2.0 * math.pi)


def pixels(transform: str) -> tuple[float, float]:
    x, y = transform.removeprefix("translate(").removesuffix(")").split(",")
    return float(x), float(y)


@dataclass
class Watched:
    """The page next to a running day; `checked`: number of passed checks of each kind."""

    page: Any
    held: ExitStack
    checked: dict[str, int] = field(default_factory=dict)
    decode_bytes: MapPublisher | None = None
    built: Any = None
    cut_at_s: float | None = None
    killed_at_s: float | None = None
    desk_killed_at_s: float | None = None

    def take_seat(self, built: Any, folder: Path) -> Any:
        """Start the day's desk and the map next to it."""
        from sim_bridge.app.day.desk import SteppedDesk, store_url
        from sim_bridge.app.faults.day.small_day import build_fixed_plan

        seat = SteppedDesk.start_truck_desk(built, build_fixed_plan(built.data), folder, SEED, 50)
        self.built = built
        store = Store(Database(store_url(folder), create=False), built.clock.epoch_us)
        self.held.callback(store.close)
        ear = FleetListener(built.bus.add_desk(), built.clock, FleetStatus(built.data.airframes))
        view = MapView(built.data.day.fleet, built.data)
        self.decode_bytes = MapPublisher(view, ear, store, built.clock)
        server = MapServer("127.0.0.1", 0)
        self.held.callback(server.close)
        server.start_serving(
            MapDataSources(
                self.decode_bytes.stream,
                self.decode_bytes.margin_history_of,
                self.decode_bytes.reachable_area_boundary,
            )
        )
        self.decode_bytes.listen_and_publish_due_picture()
        self.page.goto(server.address)
        self.page.wait_for_selector("#link.live")
        return seat

    def goes_on(self, world: Any) -> bool:
        """Advance the checks by a second: faults, and a check every few seconds."""
        assert self.decode_bytes is not None
        self.decode_bytes.listen_and_publish_due_picture()
        t_s = world.clock.t_s
        self._do_faults(world, t_s)
        if round(t_s) % 8 == 0 or self._is_special(t_s):
            self._look(world, t_s)
        return True

    def _do_faults(self, world: Any, t_s: float) -> None:
        d1, d2 = world.drones
        if self.cut_at_s is None and d1.is_airborne and d1.time_since_takeoff_s(t_s) > 20.0:
            self.cut_at_s = t_s
            world.bus.cut_member("d1", CUT_S)
        if self.killed_at_s is None and d2.is_airborne and d2.time_since_takeoff_s(t_s) > 30.0:
            self.killed_at_s = t_s
            d2.kill_companion_and_schedule_restart(t_s)
            self.desk_killed_at_s = t_s
            world.faults.due["desk_kills"].append((t_s, 0.0))

    def _is_special(self, t_s: float) -> bool:
        """Return whether a fault is in force at this time."""
        silent = self._is_at(self.cut_at_s, SILENT_S, t_s)
        return silent or self._is_at(self.desk_killed_at_s, DESK_AWAY_S - 4.0, t_s)

    def _is_at(self, began_s: float | None, after_s: float, t_s: float) -> bool:
        return began_s is not None and t_s == pytest.approx(began_s + after_s)

    def _look(self, world: Any, t_s: float) -> None:
        wrong: list[str] = []
        for _ in range(100):
            wrong = list(self._find_violations(world, t_s, self.page.evaluate(READ)))
            if not wrong:
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"at {t_s:.0f} s: {'; '.join(wrong)}")

    def _find_violations(self, world: Any, t_s: float, shown: dict[str, Any]) -> Iterator[str]:
        place = self._places(shown)
        rows = shown["drone_rows"]
        for drone in world.drones:
            if not drone.is_airborne or drone.time_since_takeoff_s(t_s) < OLD_S:
                continue
            if drone.name not in place:
                yield f"{drone.name} flies and is not on the map"
                continue
            from_s, to_s = self._heard_within(drone.name, t_s)
            off_m = self._off_m(drone, place[drone.name], from_s, to_s)
            if off_m > NOISE_M:
                yield f"{drone.name} is shown {off_m:.0f} m from where it was"
            self._note("place")
            if drone.name == "d1" and self._is_at(self.cut_at_s, SILENT_S, t_s):
                yield from self._wrong_of_silent(drone.name, shown, rows)
            if to_s == t_s and rows[drone.name][0].endswith(("Ready", "Standing by")):
                yield f"{drone.name} flies and is said to be {rows[drone.name][0]}"
        yield from self._wrong_orders(world, shown)

    def _wrong_of_silent(
        self, name: str, shown: dict[str, Any], rows: dict[str, list[str]]
    ) -> Iterator[str]:
        self._note("silent")
        if f"No contact with {name} for " not in shown["attention"]:
            yield f"nothing says that {name} is gone: {shown['attention']}"
        if "silent" not in shown["drones"][name][1].split():
            yield f"{name} is drawn as if it were heard"
        if "No contact" not in rows[name][0] or not rows[name][1].endswith(" old"):
            yield f"the list shows {rows[name]} of {name}"
        if not any(one.startswith(name) and one.endswith(" ago") for one in shown["labels"]):
            yield f"the label of {name} has no age: {shown['labels']}"

    def _wrong_orders(self, world: Any, shown: dict[str, Any]) -> Iterator[str]:
        """Report orders shown as delivered whose parcel is not with the customer."""
        gone = {
            up.order
            for d in world.drones
            for up in d.all_power_cycles
            if up.record.released_s is not None
        }
        for order, (_, look) in shown["orders"].items():
            if look.split()[1] == "delivered" and order not in gone:
                yield f"{order} is shown as delivered, and is aboard"
        self._note("orders")

    def _heard_within(self, name: str, t_s: float) -> tuple[float, float]:
        """Return the time range of positions that the map may show: the last second or two, the
        last reception, or either just after reception resumes.
        """
        at_s = {"d1": self.cut_at_s, "d2": self.killed_at_s}[name]
        for_s = {"d1": CUT_S, "d2": RESTART_S}[name]
        if at_s is None or t_s > at_s + for_s + BACK_S:
            return t_s - OLD_S, t_s
        return at_s - OLD_S, at_s if t_s < at_s + for_s else t_s

    def _places(self, shown: dict[str, Any]) -> dict[str, tuple[float, float]]:
        """Latitude and longitude of what is drawn, by the two orders' known places."""
        one, other = self.built.data.orders[:2]
        (x, y), (_, y2) = (pixels(shown["orders"][order.id][0]) for order in (one, other))
        scale = (y - y2) / (mercator(one.lat_deg) - mercator(other.lat_deg))
        return {
            name: (
                math.degrees(
                    math.atan(
                        math.sinh(-2 * math.pi * (mercator(one.lat_deg) + (down - y) / scale))
                    )
                ),
                one.lon_deg + 360.0 * (right - x) / scale,
            )
            for name, (transform, _) in shown["drones"].items()
            for right, down in [pixels(transform)]
        }

    def _off_m(
        self, drone: Any, lat_lon_deg: tuple[float, float], from_s: float, to_s: float
    ) -> float:
        """Least distance from the true positions in this time range."""
        north, east, _ = self.built.frame.to_ned(*map(math.radians, lat_lon_deg), 0.0)
        rows = [row for row in drone.power_cycle.record.rows if from_s <= row[0] <= to_s]
        return min(math.dist((north, east), row[1:3]) for row in rows)

    def _note(self, what: str) -> None:
        self.checked[what] = self.checked.get(what, 0) + 1


def flown(folder: Path, watched: Watched) -> dict[str, Any]:
    enable_compile_cache_and_check_if_known()
    from sim_bridge.app.day.faults import DayWorldOptions
    from sim_bridge.app.day.run import DayOptions, fly_day_and_write_result
    from sim_bridge.app.faults.day.small_day import read_bundled_day

    options = DayOptions(
        name="faults", data=read_bundled_day(), world_options=DayWorldOptions(), seed=SEED,
        folder=folder,
        limit_s=600.0,
    )  # fmt: skip
    return fly_day_and_write_result(options, watched.take_seat, watched.goes_on)


@pytest.fixture
def watched() -> Iterator[Watched]:
    program = needs_chromium()
    with ExitStack() as held:
        page = held.enter_context(browsing(program, viewport={"width": 1280, "height": 800}))
        yield Watched(page, held)


def test_what_is_shown_is_what_is_so_through_a_cut_a_dead_companion_and_a_dead_desk(
    watched: Watched, tmp_path: Path
):
    row = flown(tmp_path / "day", watched)
    assert watched.cut_at_s is not None
    assert watched.desk_killed_at_s is not None
    assert any("desk started again" in words for words in row["what_went_wrong"])
    assert (row["vehicles_lost"], row["delivered"]) == (0, 2)
    assert watched.checked["place"] > 20
    assert watched.checked["silent"] >= 1
    assert watched.decode_bytes is not None
    states: Callable[[], Any] = lambda: {  # noqa: E731
        order: look.split()[1] for order, (_, look) in watched.page.evaluate(READ)["orders"].items()
    }
    for _ in range(100):
        if set(states().values()) == {"delivered"}:
            break
        watched.page.wait_for_timeout(50)
    assert states() == {"F-1": "delivered", "F-2": "delivered"}


@pytest.mark.night
def test_canary_a_map_that_stands_still_is_found_out(watched: Watched, tmp_path: Path):
    """The picture stays frozen 30 s into the flights: the shown position is then wrong."""

    class Frozen(Watched):
        def goes_on(self, world: Any) -> bool:
            real = self.decode_bytes
            flying = [d for d in world.drones if d.time_since_takeoff_s(world.clock.t_s) > 30.0]
            if flying and real is not None:
                real.listen_and_publish_due_picture = lambda: None  # type: ignore[method-assign]
            return super().goes_on(world)

        def _do_faults(self, world: Any, t_s: float) -> None:
            pass

    with pytest.raises(AssertionError, match="m from where it was"):
        flown(tmp_path / "day", Frozen(watched.page, watched.held))
