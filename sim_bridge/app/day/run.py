"""One simulated day from its orders to its verdict, with its result files."""

import contextlib
import json
import math
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.clock import process_cpu_time_s
from companion.adapters.files.atomic_file import write_text_atomically
from companion.core.base.geo import LocalFrame, location_to_ground_ned_m
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.order_states import OrderState
from ground_station.core.schema.orders import OrderRow
from sim_bridge.adapters.wall_clock import wall_s
from sim_bridge.app.day.build import build_day
from sim_bridge.app.day.faults import DayWorldOptions
from sim_bridge.app.day.judge import DayTruth, DayVerdict, Pad, evaluate_day
from sim_bridge.app.day.picture import write_day_picture
from sim_bridge.app.day.store_host import StoreHost
from sim_bridge.app.day.world import DayWorld, DeskRecord, SimulatedDesk
from sim_bridge.app.flight.own_record import round_or_none

RESULT, PICTURE = "day.json", "day.png"
FORMAT = "simulated-day/1"
NON_FAULT_OPTIONS = (
    "wind_log",
    "wind_table",
    "autopilots",
    "truck",
    "least_cut_s",
    "front_at_s",
    "shares_wind",
)
"""Fields of `DayWorldOptions` that are not faults."""

DAY_TIME_LIMIT_S = 5400.0
"""Time limit of a day: 1.5 times the intended maximum of one hour."""

WIND_DURATION_S = 3600.0
"""Duration of wind (s) that a day needs; a recording's last value is held afterwards."""


@dataclass(frozen=True, slots=True)
class DayOptions:
    """Options of one day. `limit_s`: simulated time after which it is stopped."""

    name: str
    data: DayData
    world_options: DayWorldOptions
    seed: int
    folder: Path
    limit_s: float = DAY_TIME_LIMIT_S
    settings: str = ""
    """Digest of all inputs but the seed, to know a finished day again."""
    picture: bool = False


def fly_day_and_write_result(
    options: DayOptions,
    start_desk: Callable[[DayWorld, Path], SimulatedDesk],
    should_continue: Callable[[DayWorld], bool],
    store_host: StoreHost | None = None,
) -> dict[str, Any]:
    """Fly the day to its end; return its result row and write it to the folder.

    `store_host`: server of the desk's database, for injected outages; None: no outages.
    """
    folder = options.folder
    if folder.exists():
        shutil.rmtree(folder)  # left by an interrupted run; the same seed flies the same day
    folder.mkdir(parents=True)
    need_s = min(options.limit_s, WIND_DURATION_S)
    with contextlib.ExitStack() as stack:  # closes each even if another fails to close
        world = build_day(options.data, options.world_options, options.seed, folder, need_s)
        world.store = store_host
        stack.callback(world.ground_handling.close)
        for drone in world.drones:
            stack.callback(drone.switch_off_and_end_power_cycle)
        world.desk = start_desk(world, folder)  # may take minutes and be interrupted: it plans
        stack.callback(world.desk.close)
        stack.callback(world.end_store_outage)
        start_wall_s, start_cpu_s = wall_s(), process_cpu_time_s()
        ended = world.run_until_over(options.limit_s, should_continue)
        world.end_store_outage()
        run_time = {"wall_s": wall_s() - start_wall_s, "cpu_s": process_cpu_time_s() - start_cpu_s}
        row = _evaluate_and_draw_day(options, world, ended=ended) | {"spent": run_time}
    text = json.dumps(row, indent=1, allow_nan=False)
    write_text_atomically(folder / RESULT, text + "\n", sync_folder=False)
    return row


def _evaluate_and_draw_day(options: DayOptions, world: DayWorld, *, ended: bool) -> dict[str, Any]:
    mission, desk = world.data.day.mission, world.desk.build_desk_record()
    tracks = [
        drone.build_vehicle_track(up, mission.reserve_frac)
        for drone in world.drones
        for up in drone.all_power_cycles
        if up.record.rows
    ]
    day_truth = DayTruth(
        customers=world.customers,
        drop_height_m=mission.drop_height_m,
        tracks=tracks,
        parked_intervals=world.truck_parked_intervals,
        pads=_planned_pads(world.frame, desk.plans)
        if options.world_options.truck
        else [  # at a depot each drone lands at its take-off position
            Pad("depot", drone.name, up.pad_ne_m)
            for drone in world.drones
            for up in drone.all_power_cycles
        ],
        home_reports=world.home_reports,
        handovers=world.ground_handling.delivered,
        rally=[
            location_to_ground_ned_m(world.frame, position)[:2] for position in world.data.day.rally
        ],
    )
    verdict = evaluate_day(day_truth)
    if options.picture:
        _draw_picture(options, world, day_truth, verdict)
    return _result_row(options, world, desk, verdict, ended=ended)


def _planned_pads(frame: LocalFrame, plans: list[DayPlan]) -> list[Pad]:
    found = {
        Pad(stop.id, vehicle, location_to_ground_ned_m(frame, position)[:2])
        for plan in plans
        for stop in plan.stops
        for vehicle, position in stop.pads.items()
    }
    return sorted(found, key=lambda pad: (pad.stop, pad.vehicle, pad.ne_m))


def _result_row(
    options: DayOptions,
    world: DayWorld,
    desk: DeskRecord,
    verdict: DayVerdict,
    *,
    ended: bool,
) -> dict[str, Any]:
    vehicle_by_order = verdict.delivered
    orders = [order.id for order in world.data.orders]
    infeasible = desk.infeasible_orders
    undelivered = [
        {"order": id_, "feasible": id_ not in infeasible, **_order_state_fields(desk, id_)}
        for id_ in orders
        if id_ not in vehicle_by_order
    ]
    near = verdict.minimum_separation
    plans = desk.plans
    return {
        "format": FORMAT,
        "settings": options.settings,
        "day": options.name,
        "seed": options.seed,
        "ended": ended,
        "duration_s": round(world.clock.t_s, 1),
        "faults": {
            k: v
            for k, v in asdict(options.world_options).items()
            if k not in NON_FAULT_OPTIONS and v
        },
        "orders": len(orders),
        "feasible": len(orders) - len(infeasible),
        "delivered": len(vehicle_by_order),
        "by_truck": sum(carrier == "truck" for carrier in vehicle_by_order.values()),
        "undelivered": undelivered,
        "believed_otherwise": find_orders_with_wrong_desk_record(
            orders, vehicle_by_order, desk.orders, desk.delivered_by
        ),
        "vehicles": len(world.drones),
        "vehicles_lost": len(verdict.lost_flights),
        "lost": verdict.lost_flights,
        "flown_twice": verdict.duplicate_orders,
        "promises_broken": verdict.broken_promises,
        "separation_min_m": None if near is None else round(near.distance_m, 2),
        "separation_horizontal_min_m": round_or_none(verdict.nearest_horizontal_m, 2),
        "nearest": None if near is None else asdict(near),
        "margin_min_wh": round_or_none(
            min((f.margin_wh for f in verdict.flights), default=None), 2
        ),
        "energy_used_wh": round(sum(f.energy_used_wh for f in verdict.flights), 1),
        "flights": [
            {k: round(v, 2) if isinstance(v, float) else v for k, v in asdict(flight).items()}
            for flight in verdict.flights
        ],
        "truck": [
            {
                "stop": s.stop,
                "arrive_s": round(s.arrived_s, 1),
                "depart_s": round(s.left_s, 1) if math.isfinite(s.left_s) else None,
            }
            for s in world.truck_parked_intervals
        ],
        "messages": {"sent": world.bus.sent, "lost": world.bus.lost},
        "frames_lost": sum(drone.lost_frames for drone in world.drones),
        "disarmed_by_hand": sum(drone.manual_disarm_count for drone in world.drones),
        "commands_after_take_over": [
            f"{drone.name}: {message}"
            for drone in world.drones
            for up in drone.all_power_cycles
            for message in up.command_texts_after_takeover
        ],
        "ended_by_themselves": [
            f"companion of {drone.name} at {t_s:.1f} s"
            for drone in world.drones
            for t_s in drone.unexpected_exit_times_s
        ]
        + desk.unexpected_exits,
        "powered_h": round(
            sum(up.time_since_power_on_s for d in world.drones for up in d.all_power_cycles)
            / 3600.0,
            4,
        ),
        "companions_started": sum(drone.companion_start_count for drone in world.drones),
        "what_went_wrong": [f"{t_s:.0f} s: {message}" for t_s, message in world.faults.log],
        "faults_came": world.faults.injected_count_by_kind,
        "longest_cut_s": round(world.faults.longest_cut_s, 1),
        "replans": max(len(plans) - 1, 0),
        "shares_wind": world.shares_wind,
        "front": None if world.front is None else asdict(world.front),
        "plan": msgspec.to_builtins(plans[0]) if plans else None,
        "run": str(options.folder),
    }


def _order_state_fields(desk: DeskRecord, order: str) -> dict[str, str]:
    if order not in desk.orders:
        return {"state": "unknown", "why": "unknown to the desk"}
    row = desk.orders[order]
    return {"state": row.state.value, "why": f"{row.state.value} {row.reason}".strip()}


def find_orders_with_wrong_desk_record(
    orders: list[str],
    vehicle_by_order: dict[str, str],
    recorded_orders: dict[str, OrderRow],
    recorded_vehicle_by_order: dict[str, str],
) -> list[str]:
    """Return orders whose state or delivering vehicle in the desk's record differs from truth."""
    return [
        id_
        for id_ in orders
        if (id_ in vehicle_by_order)
        != (id_ in recorded_orders and recorded_orders[id_].state is OrderState.DELIVERED)
        or recorded_vehicle_by_order.get(id_) not in (None, vehicle_by_order.get(id_))
    ]


def _draw_picture(
    options: DayOptions, world: DayWorld, day_truth: DayTruth, verdict: DayVerdict
) -> None:
    delivered_count, orders = len(verdict.delivered), len(world.customers)
    flights = len(verdict.flights)
    nearest = verdict.minimum_separation
    separation_text = "" if nearest is None else f", minimum separation {nearest.distance_m:.1f} m"
    title = (
        f"{options.name}, seed {options.seed}: {delivered_count} of {orders} orders in"
        f" {world.clock.t_s / 60.0:.0f} min, {flights} flights, {len(verdict.lost_flights)}"
        f" lost{separation_text}"
    )
    write_day_picture(options.folder / PICTURE, title, world, day_truth, verdict)
