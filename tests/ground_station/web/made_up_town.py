"""A made-up town as the page receives it: eight drones, forty orders, a truck with six stops."""

import copy
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

import msgspec
import numpy as np

from companion.fleet.roles import Role
from ground_station.adapters.web.live_stream import LiveStream
from ground_station.adapters.web.map_server import MapDataSources, MapServer, PastDataSources
from ground_station.adapters.web.people import MapAccess
from ground_station.app.map.manifest import manifest_rows
from ground_station.app.map.picture import OrderShown, PlanShown, to_json_types
from ground_station.core.people.web_tokens import TokenRegistry

NOW_US = 1_780_000_000_000_000
TOKEN = "x" * 43
LAT, LON = 55.47, 8.45
PHASES = ("return", "ready", "release", "return", "outbound", "outbound", "outbound", "standby")
SILENT, WAITING, DIVERTED = "d1", "d2", "d4"


def at(east_m: float, north_m: float) -> list[float]:
    return [float(LAT + north_m / 111_320.0), float(LON + east_m / 63_100.0)]


def picture(drones: int = 8, orders: int = 40, seed: int = 1) -> dict[str, Any]:
    """Return the picture. Half of the orders are delivered; the third is stuck."""
    rng = np.random.default_rng(seed)
    spots = rng.uniform(-450.0, 450.0, (orders, 2))
    found: dict[str, Any] = {}
    for k, spot in enumerate(spots):
        state = "delivered" if k % 2 else "open"
        found[f"T-{101 + k}"] = {"at": at(*spot), "state": state, "mass_kg": 0.5}
    found["T-103"] |= {"state": "stuck", "why": "drop not proven"}
    stops, route = {}, []
    for k in range(8):
        turn = 2.0 * math.pi * k / 7.0
        east, north = (0.0, 0.0) if k in (0, 7) else (300 * math.cos(turn), 250 * math.sin(turn))
        route.append(f"stop-{k}")
        times = [NOW_US + round(6e7 * (20 * (k - 3) + m)) for m in (0, 12)]
        stops[route[-1]] = {"at": at(east, north), "arrive_us": times[0], "depart_us": times[1]}
        if k <= 3:
            stops[route[-1]]["arrived_us"] = times[0]
        if k < 3:
            stops[route[-1]]["departed_us"] = times[1]
        stops[route[-1]]["serves"] = [f"T-{101 + 5 * k}"]
    fleet = {}
    for k in range(drones):
        phase = PHASES[k % 8]
        order = f"T-{101 + 2 * (k + 2)}" if 101 + 2 * (k + 2) < 101 + orders else "T-101"
        found[order] |= {"state": "assigned", "vehicle": f"d{k + 1}"}
        spare = 40.0 + k
        fleet[f"d{k + 1}"] = drone(phase, found[order]["at"], stops["stop-3"]["at"], spare, order)
    fleet[SILENT] |= {"heard_us": NOW_US - 24_000_000, "present": False}
    fleet[DIVERTED] |= {"diverted_to": "quay", "phase": "divert", "margin_wh": 18.0, "spare_min": 3,
                        "why": "Diverts to quay: risk 1 in 26 is above the limit 1 in 100",
                        "why_us": NOW_US}  # fmt: skip
    waiting = fleet[WAITING]["order"]
    plan = {"title": "plan 3", "stops": stops, "route": route, "late_s": 120,
            "end_us": stops["stop-7"]["depart_us"], "sorties": sorties(fleet)}  # fmt: skip
    rows = manifest_rows(
        msgspec.convert(plan, PlanShown), msgspec.convert(found, dict[str, OrderShown])
    )
    return {
        "fleet": "Town", "site": {"depot": at(0, 0), "areas": areas(), "rally": {}},
        "orders": found, "drones": fleet, "max_loss": 0.01, "risk_limit": "1 in 100",
        "truck": {"phase": "at_stop", "at": stops["stop-3"]["at"], "stop": "stop-3",
                  "leaves_us": stops["stop-3"]["depart_us"], "heard_us": NOW_US},
        "plan": plan, "manifest": [to_json_types(row) for row in rows],
        "winds": [{"to_ne_mps": [0.5, 5.0], "cov_m2ps2": [1, 0, 1], "source": "forecast"},
                  {"to_ne_mps": [1.0, 7.1], "cov_m2ps2": [1, 0, 1], "source": "by 6 drones"}],
        "attention": [
            {"key": f"contact {SILENT}", "level": "warning", "who": SILENT, "since_us": NOW_US,
             "title": f"No contact with {SILENT} for 24 s", "words": "It should land at {land}.",
             "acts": ["show"], "times": {"land": NOW_US + 90_000_000}},
            {"key": f"launch {waiting}", "level": "your_turn", "who": WAITING, "since_us": NOW_US,
             "title": f"{WAITING} waits for your launch", "words": "Risk 1 in 2,400 (limit 1 in"
             " 100).", "acts": [f"launch {waiting}", "hold", "show"]},
        ],
    }  # fmt: skip


def drone(phase: str, customer: list, pad: list, spare_wh: float, order: str) -> dict[str, Any]:
    share = {"standby": 0.0, "ready": 0.0, "release": 1.0}.get(phase, 0.6)
    here = [a + share * (b - a) for a, b in zip(pad, customer, strict=True)]
    flies = phase not in ("standby", "ready")
    times = {"launch_us": NOW_US - 60_000_000, "land_us": NOW_US + 150_000_000} if flies else {}
    return times | {
        "phase": phase, "present": True, "at": here, "course_deg": 120.0, "heard_us": NOW_US,
        "height_rel_m": 40.0, "ground_speed_mps": 9.0, "order": order, "home": "stop-3",
        "armed": flies, "delivered": phase == "return", "margin_wh": spare_wh, "spare_min": 7.0,
        "p_home": 1 - 1 / 2400, "risk": "1 in 2,400", "risk_now": "1 in 40,000",
        "energy_left_wh": 60.0 + spare_wh, "energy_needed_wh": 60.0, "full_wh": 130.0,
        "reserve_wh": 20.0, "way": {"out": [pad, customer], "home": [customer, pad]},
    }  # fmt: skip


def sorties(fleet: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        {"order": one["order"], "vehicle": name, "launch": "stop-3", "home": "stop-3",
         "launch_us": one.get("launch_us", NOW_US + 60_000_000),
         "land_us": one.get("land_us", NOW_US + 240_000_000),
         "state": "flying" if "land_us" in one else "planned"}
        for name, one in fleet.items()
    ]  # fmt: skip


def areas() -> list[dict[str, Any]]:
    square = [(-180, 190), (-180, 230), (-140, 230), (-140, 190)]
    church = {"name": "church", "ring": [at(*p) for p in square], "height_m": 62.0}
    field = {"name": "helipad", "ring": [at(x + 480, y - 500) for x, y in square]}
    return [church, field]


@contextmanager
def served(
    shown: dict[str, Any],
    execute: Callable[[Any, Any], Any] | None = None,
    *,
    clock_us: Callable[[], int] = lambda: NOW_US,
    update: Callable[[], None] = lambda: None,
    is_past: bool = False,
) -> Iterator[str]:
    """Serve this picture twice a second, `update()` before each; return the address."""
    stream, server, end = LiveStream(), MapServer("127.0.0.1", 0), Event()
    book = TokenRegistry().with_holder("anna", Role.DISPATCHER, TOKEN, "2026-01-01")
    history = [{"t_us": NOW_US - 10**6 * k, "margin_wh": 36.0} for k in range(60, 0, -1)]
    span = {"from_us": NOW_US, "to_us": NOW_US + 60_000_000, "marks": []}
    past = PastDataSources(lambda: span, lambda t: shown, lambda v, t: history, lambda v, t: None)
    access = MapAccess(
        lambda: book, execute or (lambda who, deed: {"messages": ["ok"], "checks": []})
    )
    server.start_serving(
        MapDataSources(
            stream, lambda v: history, lambda v: reach(), None, past if is_past else None, access
        )
    )

    def publish() -> None:
        while not end.wait(0.4):
            update()
            stream.publish(copy.deepcopy(shown), clock_us())

    stream.publish(copy.deepcopy(shown), clock_us())
    pump = Thread(target=publish, daemon=True)
    pump.start()
    try:
        yield f"http://127.0.0.1:{server.port}"
    finally:
        end.set()
        pump.join()
        server.close()


def reach() -> list[list[float]]:
    turns = [2.0 * math.pi * k / 48 for k in range(48)]
    return [at(400 * math.cos(turn), 350 * math.sin(turn)) for turn in turns]


def sign_in(page: Any) -> None:
    """Give the page its token before it loads."""
    page.add_init_script(f"sessionStorage.setItem('leeway token', '{TOKEN}')")
