"""One simulated day from its orders to its verdict, and the files it leaves in its folder."""

import contextlib
import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np

from companion.adapters.clock import cpu_s
from companion.core.base.geo import LocalFrame, place_ned
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from sim_bridge.adapters.wall_clock import wall_s
from sim_bridge.app.day.build import BuiltDay, Plumb, build_day
from sim_bridge.app.day.drone import DayDrone
from sim_bridge.app.day.faults import DayWish
from sim_bridge.app.day.judge import DayFacts, DayVerdict, Pad, judge_day
from sim_bridge.app.day.picture import DayScene, draw_day
from sim_bridge.app.day.store_host import StoreHost
from sim_bridge.app.day.world import DayWorld, Seat

RESULT, PICTURE = "day.json", "day.png"
FORMAT = "simulated-day/1"
NO_FAULTS = (
    "wind_log",
    "wind_table",
    "autopilots",
    "truck",
    "least_cut_s",
    "front_at_s",
    "shares_wind",
)
"""What a wish says beside the faults."""

EXPECTED_S = 3600.0
"""Wind (s) that a day needs; beyond it, a recording's last value is held."""


class DeskSeat(Seat, Protocol):
    """A desk, and what it can be asked once the day is over."""

    @property
    def plans(self) -> list[DayPlan]:
        """All plans of the day, the first and the replans."""
        ...

    @property
    def told(self) -> dict[str, str]:
        """The desk's state of each order, and the reason."""
        ...

    @property
    def brought_by(self) -> dict[str, str]:
        """Who brought each order that the desk has as delivered; the truck among them."""
        ...

    @property
    def impossible(self) -> frozenset[str]:
        """Orders that could not be brought on this day from its start."""
        ...

    @property
    def ended_by_itself(self) -> list[str]:
        """Each time that it ended and nobody had killed it, with the reason."""
        ...

    def close(self) -> None:
        """Orderly shutdown."""
        ...


@dataclass(frozen=True, slots=True)
class DayOptions:
    """Options of one day. `limit_s`: simulated time after which it is stopped."""

    name: str
    data: DayData
    wish: DayWish
    seed: int
    folder: Path
    limit_s: float
    settings: str
    picture: bool = True


def fly_day(
    options: DayOptions,
    plumb: Plumb,
    take_seat: Callable[[BuiltDay, Path], DeskSeat],
    progress: Callable[[DayWorld], bool],
    store: StoreHost | None = None,
) -> dict[str, Any]:
    """Fly the day to its end; returns its result row, which is also written to the folder.

    `store`: the desk's, which goes away where the wish says so; None: none goes away.
    """
    folder = options.folder
    if folder.exists():
        shutil.rmtree(folder)  # left by an interrupted run; the same seed flies the same day
    folder.mkdir(parents=True)
    need_s = min(options.limit_s, EXPECTED_S)
    with contextlib.ExitStack() as stack:  # each is closed even if another fails to
        made = build_day(options.data, options.wish, options.seed, folder, need_s, plumb)
        stack.callback(made.plumbing.close)
        stack.callback(made.crew.close)
        for drone in made.drones:
            stack.callback(drone.switch_off)
        seat = take_seat(made, folder)  # plans the day: may take minutes and be interrupted
        stack.callback(seat.close)
        world = DayWorld(
            made.clock, made.plumbing, made.drones, made.crew, seat, made.faults, store, made.front
        )
        stack.callback(world.bring_store_back)
        began_wall_s, began_cpu_s = wall_s(), cpu_s()
        ended = world.run(options.limit_s, progress)
        world.bring_store_back()
        spent = {"wall_s": wall_s() - began_wall_s, "cpu_s": cpu_s() - began_cpu_s}
        row = _conclude(options, made, world, seat, ended=ended) | {"spent": spent}
    text = json.dumps(row, indent=1, allow_nan=False)
    fresh = folder / f"{RESULT}.new"
    fresh.write_text(text + "\n")
    fresh.replace(folder / RESULT)
    return row


def _conclude(
    options: DayOptions, built: BuiltDay, world: DayWorld, seat: DeskSeat, *, ended: bool
) -> dict[str, Any]:
    mission = built.data.day.mission
    tracks = [
        drone.track(up, mission.reserve_frac)
        for drone in built.drones
        for up in drone.power_ups
        if up.rows
    ]
    judged = DayFacts(
        customers=built.customers,
        drop_height_m=mission.drop_height_m,
        tracks=tracks,
        stands=world.stands,
        pads=_pads(built.frame, seat.plans) if options.wish.truck else _at_depot(built.drones),
        homes=world.homes,
        served=world.served,
        rally=[place_ned(built.frame, place)[:2] for place in built.data.day.rally],
    )
    verdict = judge_day(judged)
    if options.picture:
        _draw(options, built, world, judged, verdict)
    return _row(options, built, world, seat, verdict, ended=ended)


def _pads(frame: LocalFrame, plans: list[DayPlan]) -> list[Pad]:
    found = {
        Pad(stop.id, vehicle, place_ned(frame, place)[:2])
        for plan in plans
        for stop in plan.stops
        for vehicle, place in stop.pads.items()
    }
    return sorted(found, key=lambda pad: (pad.stop, pad.vehicle, pad.ne_m))


def _at_depot(drones: list[DayDrone]) -> list[Pad]:
    """Without a truck each lands where it took off."""
    return [Pad("depot", drone.name, up.pad_ne_m) for drone in drones for up in drone.power_ups]


def _row(
    options: DayOptions,
    built: BuiltDay,
    world: DayWorld,
    seat: DeskSeat,
    verdict: DayVerdict,
    *,
    ended: bool,
) -> dict[str, Any]:
    told, by = seat.told, verdict.delivered
    orders = [order.id for order in built.data.orders]
    infeasible = seat.impossible
    undelivered = [
        {
            "order": id_,
            "feasible": id_ not in infeasible,
            "why": told.get(id_, "unknown to the desk"),
        }
        for id_ in orders
        if id_ not in by
    ]
    near = verdict.nearest
    plans = seat.plans
    return {
        "format": FORMAT,
        "settings": options.settings,
        "day": options.name,
        "seed": options.seed,
        "ended": ended,
        "duration_s": round(world.clock.t_s, 1),
        "faults": _faults(options.wish),
        "orders": len(orders),
        "feasible": len(orders) - len(infeasible),
        "delivered": len(by),
        "by_truck": sum(who == "truck" for who in by.values()),
        "undelivered": undelivered,
        "believed_otherwise": believed_otherwise(orders, by, told, seat.brought_by),
        "vehicles": len(built.drones),
        "vehicles_lost": len(verdict.lost),
        "lost": verdict.lost,
        "flown_twice": verdict.twice,
        "promises_broken": verdict.broken,
        "separation_min_m": None if near is None else round(near.distance_m, 2),
        "separation_horizontal_min_m": _rounded(verdict.nearest_horizontal_m),
        "nearest": None if near is None else asdict(near),
        "margin_min_wh": _rounded(min((f.margin_wh for f in verdict.flights), default=None)),
        "energy_used_wh": round(sum(f.energy_used_wh for f in verdict.flights), 1),
        "flights": [_flight_row(asdict(flight)) for flight in verdict.flights],
        "truck": [
            {"stop": s.stop, "arrive_s": round(s.arrived_s, 1), "depart_s": _time(s.left_s)}
            for s in world.stands
        ],
        "messages": {"sent": built.plumbing.network.sent, "lost": built.plumbing.network.lost},
        "frames_lost": sum(drone.lost_frames for drone in built.drones),
        "disarmed_by_hand": sum(drone.disarmed_by_hand for drone in built.drones),
        "commands_after_take_over": [
            f"{drone.name}: {words}"
            for drone in built.drones
            for up in drone.power_ups
            if up.taken is not None
            for words in up.taken.commands
        ],
        "ended_by_themselves": [
            f"companion of {drone.name} at {t_s:.1f} s"
            for drone in built.drones
            for t_s in drone.ended_by_itself
        ]
        + seat.ended_by_itself,
        "powered_h": round(sum(up.t_s for d in built.drones for up in d.power_ups) / 3600.0, 4),
        "companions_started": sum(drone.companion_starts for drone in built.drones),
        "what_went_wrong": [f"{t_s:.0f} s: {words}" for t_s, words in world.faults.log],
        "faults_came": world.faults.came,
        "longest_cut_s": round(world.faults.cut_s, 1),
        "replans": max(len(plans) - 1, 0),
        "shares_wind": built.shares_wind,
        "front": None if built.front is None else asdict(built.front),
        "plan": msgspec.to_builtins(plans[0]) if plans else None,
        "run": str(options.folder),
    }


def believed_otherwise(
    orders: list[str], by: dict[str, str], told: dict[str, str], brought_by: dict[str, str]
) -> list[str]:
    """Orders whose state at the desk, or who it says brought them, differs from the truth."""
    return [
        id_
        for id_ in orders
        if (id_ in by) != told.get(id_, "").startswith("delivered")
        or brought_by.get(id_) not in (None, by.get(id_))
    ]


def _flight_row(flight: dict[str, Any]) -> dict[str, Any]:
    return {k: round(v, 2) if isinstance(v, float) else v for k, v in flight.items()}


def _faults(wish: DayWish) -> dict[str, Any]:
    return {k: v for k, v in asdict(wish).items() if k not in NO_FAULTS and v}


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


def _time(t_s: float) -> float | None:
    return None if t_s == float("inf") else round(t_s, 1)


def _draw(
    options: DayOptions, built: BuiltDay, world: DayWorld, judged: DayFacts, verdict: DayVerdict
) -> None:
    rings = built.data.obstacles(built.frame)
    brought, orders = len(verdict.delivered), len(built.customers)
    flights = len(verdict.flights)
    nearest = verdict.nearest
    apart = "" if nearest is None else f", never nearer than {nearest.distance_m:.1f} m"
    drawn = DayScene(
        title=f"{options.name}, seed {options.seed}: {brought} of {orders} orders in"
        f" {world.clock.t_s / 60.0:.0f} min, {flights} flights, {len(verdict.lost)} lost{apart}",
        customers=built.customers,
        tracks=judged.tracks,
        drives=built.crew.drives,
        stands=world.stands,
        tasks=built.crew.done,
        verdict=verdict,
        ended_s=world.clock.t_s,
        faults=world.faults.log,
        no_fly_ne_m=[np.array(ring.ring_ne_m) for ring in rings],
    )
    draw_day(options.folder / PICTURE, drawn)
