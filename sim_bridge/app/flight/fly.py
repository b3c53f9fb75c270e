"""`sim-bridge fly`: run simulated vehicles and their companions to the end of a mission."""

import contextlib
import os
import shutil
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.params import (
    read_airframe,
    read_flight,
    read_obstacle_document,
    read_obstacles,
)
from companion.core.base.errors import LeewayError
from companion.core.return_budget.budget import reserve_margin_text
from companion.core.vehicle.airframe import Airframe
from sim_bridge.adapters.endpoint import EndpointSet
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.adapters.realtime import Pacer
from sim_bridge.adapters.wall_clock import wall_s
from sim_bridge.app.flight.clairvoyant import ClairvoyantResult
from sim_bridge.app.flight.clairvoyant_flight import compute_clairvoyant_result_of_craft
from sim_bridge.app.flight.craft_building import FlyOptions, build_craft, read_true_airframe
from sim_bridge.app.flight.faults import build_fault_scripts
from sim_bridge.app.flight.judge import (
    FlightVerdict,
    NearestGround,
    evaluate_flight,
    find_minimum_clearance_away_from_sites,
)
from sim_bridge.app.flight.own_record import decisions_and_least_p_home, round_or_none
from sim_bridge.app.flight.run_folder import create_unique_run_dir, mark_if_interrupted
from sim_bridge.app.flight.scenario import read_faults, read_or_draw_true_wind
from sim_bridge.app.flight.stage import Script
from sim_bridge.app.flight.vehicle_process import Craft, location_ne_m
from sim_bridge.app.world.vehicle_host import EXCHANGE_S, STEPS_PER_EXCHANGE, true_reserve_wh

COMPANION_BOOT_LIMIT_S = 60.0
CRASHED_EXIT_CODE = 1


def fly_vehicles_and_evaluate(options: FlyOptions, *scripts: Script) -> dict[str, Any]:
    """Fly and evaluate; return `{"flights": [...]}` as in docs/reference/flight-json.md.

    `scripts`: events and observers in addition to the faults of the flight file.
    """
    flight = read_flight(options.flight_file)
    airframe = read_airframe(flight.vehicle.airframe)
    seeds = np.random.SeedSequence(options.seed)
    wind_seed, *vehicle_seeds = seeds.spawn(1 + options.vehicles)
    wind, mean = read_or_draw_true_wind(
        flight, options.flight_file, np.random.default_rng(wind_seed), options.wind_log
    )
    mean = options.mean_wind or mean
    faults = read_faults(flight, options.flight_file)
    gate = "" if options.gate else "-gate-off"
    stem = f"{flight.name}-{options.autopilot}-seed{options.seed}{gate}"
    run_dir = create_unique_run_dir(options.run_root, stem)
    with contextlib.ExitStack() as stack:
        endpoints = stack.enter_context(EndpointSet(["udpin:127.0.0.1:0"] * options.vehicles))
        crafts: list[Craft] = []
        for index in range(options.vehicles):
            port = endpoints.urls[index].rsplit(":", 1)[1]
            craft = build_craft(
                options,
                flight,
                wind,
                mean,
                index,
                vehicle_seeds[index],
                f"udpout:127.0.0.1:{port}",
                run_dir,
                has_kill_fault=any(fault.kind == "companion_kill" for fault in faults),
            )
            crafts.append(craft)
            stack.callback(craft.companion.terminate_or_kill)
        all_scripts = [*build_fault_scripts(faults, options.vehicles), *scripts]
        for script in all_scripts:
            stack.callback(script.undo_at_run_end)
        with mark_if_interrupted(run_dir):
            _run_lockstep_until_finished(options, crafts, endpoints, all_scripts)
        for craft in crafts:
            craft.companion.terminate_or_kill()
            if options.estimator is not None and craft.companion.exit_code == CRASHED_EXIT_CODE:
                _, _, reason = craft.companion.read_output().rpartition("internal error: ")
                log = craft.run_dir / "companion.log"
                raise LeewayError(f"{reason.partition(chr(10))[0]}; the companion's log: {log}")
    rows = [_save_truth_and_evaluate_flight(options, craft, airframe) for craft in crafts]
    result = {"flights": rows}
    (run_dir / "flights.json").write_bytes(msgspec.json.format(msgspec.json.encode(result)))
    return result


def _run_lockstep_until_finished(
    options: FlyOptions,
    crafts: list[Craft],
    endpoints: EndpointSet,
    scripts: Sequence[Script],
) -> None:
    lockstep = Lockstep(
        endpoints,
        range(len(crafts)),
        lambda number, t_ns: crafts[number].link.take_datagrams_for_companion(t_ns),
        limit_s=options.lockstep_limit_s,
        is_alive=lambda number: crafts[number].companion.is_running,
    )
    pacer = Pacer(options.speedup) if options.speedup else None
    stall_pacer: Pacer | None = None
    for craft in crafts:
        craft.companion.start()
    first = lockstep.wait_until_clients_respond(1, COMPANION_BOOT_LIMIT_S)
    for number in first.timed_out:
        output = crafts[number].companion.last_output_lines()
        raise LeewayError(f"companion {number + 1} did not start; its last output:\n{output}")
    _deliver_companion_datagrams(crafts, first.received)
    step = 0
    limit_s = 120.0 + crafts[0].flight.mission.time_limit_s * 1.5
    while not all(craft.is_finished for craft in crafts):
        step += 1
        t_s = step * EXCHANGE_S
        if t_s > limit_s:
            return
        for craft in crafts:
            if not craft.is_finished:
                craft.advance_and_deliver_frames(STEPS_PER_EXCHANGE)
        for script in scripts:
            script.apply_step(crafts, t_s, lockstep)
        _await_returning_companions(crafts, lockstep, t_s)
        sent_s = wall_s()
        gathered = lockstep.exchange_one_step(round(t_s * 1e9))
        reply_wall_s = wall_s() - sent_s
        _deliver_companion_datagrams(crafts, gathered.received)
        stall_pacer = _real_time_pacer_during_stall(crafts, stall_pacer)
        if (pace := pacer or stall_pacer) is not None:
            _deliver_companion_datagrams(crafts, pace.receive_until_due(t_s, endpoints))
        for script in scripts:
            script.on_step_completed(crafts, t_s, reply_wall_s)
        if not all(script.should_continue(t_s) for script in scripts):
            return


def _real_time_pacer_during_stall(
    crafts: list[Craft], previous_pacer: Pacer | None
) -> Pacer | None:
    """Return a real-time pacer during a stall: the companion measures it by its own clock."""
    stalled = any(craft.companion.stalled for craft in crafts)
    return (previous_pacer or Pacer(1.0)) if stalled else None


def _await_returning_companions(crafts: list[Craft], lockstep: Lockstep, t_s: float) -> None:
    """Hold simulated time while a restarted companion boots, or a resumed one reads its backlog, so
    that runs are repeatable."""
    numbers = [index for index, craft in enumerate(crafts) if craft.is_companion_returning]
    if numbers:
        gathered = lockstep.wait_until_clients_respond(
            round(t_s * 1e9), COMPANION_BOOT_LIMIT_S, client_numbers=numbers
        )
        for number in numbers:
            crafts[number].is_companion_returning = False
        _deliver_companion_datagrams(crafts, gathered.received)


def _deliver_companion_datagrams(crafts: list[Craft], received: list[tuple[int, bytes]]) -> None:
    for number, datagram in received:
        crafts[number].link.pass_datagram_to_autopilot(datagram)


def _save_truth_and_evaluate_flight(
    options: FlyOptions, craft: Craft, airframe: Airframe
) -> dict[str, Any]:
    flight, site = craft.flight, craft.flight.site
    truth_airframe = read_true_airframe(flight)
    reserve_wh = true_reserve_wh(
        craft.vehicle,
        truth_airframe,
        flight.vehicle.temperature_c,
        flight.vehicle.battery_health_frac,
        flight.mission.reserve_frac,
    )
    result = craft.companion.read_result_json_or_empty()
    np.save(craft.run_dir / "truth.npy", np.asarray(craft.record.rows, float))
    landing_sites_ne_m = [
        craft.home_ne_m,
        *(location_ne_m(location, craft.depot) for location in site.rally),
    ]
    customer = location_ne_m(site.customer, craft.depot)
    verdict = evaluate_flight(
        craft.record,
        landing_sites_ne_m=landing_sites_ne_m,
        customer_ne_m=customer,
        drop_height_m=flight.mission.drop_height_m,
        reserve_wh=reserve_wh,
        wind_estimates=result.get("wind", []),
    )
    document = read_obstacle_document(flight, options.flight_file)
    nearest = find_minimum_clearance_away_from_sites(
        craft.record, craft.terrain, _low_flight_points_ne_m(craft)
    )
    clairvoyant_result = compute_clairvoyant_result_of_craft(
        craft, airframe, truth_airframe, reserve_wh, result.get("plan"), document
    )
    if options.picture:
        _draw_picture(options, craft, verdict, result, reserve_wh, airframe)
    return _result_row(craft, verdict, clairvoyant_result, result, nearest)


def _low_flight_points_ne_m(craft: Craft) -> list[tuple[float, float]]:
    """Return positions with low flight: pad, customer and all declared landing sites."""
    site = craft.flight.site
    locations = (site.customer, *site.rally, *site.stops)
    return [(0.0, 0.0), *(location_ne_m(location, craft.depot) for location in locations)]


def _result_row(
    craft: Craft,
    verdict: FlightVerdict,
    clairvoyant_result: ClairvoyantResult,
    companion_result: dict[str, Any],
    nearest: NearestGround | None,
) -> dict[str, Any]:
    outcome = verdict.outcome
    return {
        "vehicle": f"{craft.flight.vehicle.airframe}-{craft.number}",
        "autopilot": craft.autopilot_kind,
        "judged_by": "truth",
        "charge_frac": round(craft.charge_frac, 3),
        "outcome": outcome.code,
        "delivered": outcome.delivered,
        "home": outcome.home,
        "energy_used_wh": round(outcome.energy_used_wh, 3),
        "margin_wh": round(outcome.margin_wh, 3),
        "flight_time_s": round(verdict.flight_time_s, 2),
        "wind_rmse_mps": round_or_none(verdict.wind_rmse_mps, 4),
        "wind_nees": round_or_none(verdict.wind_nees, 4),
        "least_clearance_m": None if nearest is None else round(nearest.clearance_m, 1),
        "least_clearance_at": None if nearest is None else nearest.rounded_position_for_json,
        "clairvoyant": clairvoyant_result.outcome,
        "clairvoyant_margin_wh": round(clairvoyant_result.margin_wh, 3),
        "run": os.path.relpath(craft.run_dir),
        **decisions_and_least_p_home(companion_result),
    }


def _draw_picture(
    options: FlyOptions,
    craft: Craft,
    verdict: FlightVerdict,
    companion_result: dict[str, Any],
    reserve_wh: float,
    airframe: Airframe,
) -> None:
    from sim_bridge.app.flight.picture import (
        FILE_NAME,
        build_true_flight_track,
        write_flight_picture,
    )

    site = craft.flight.site
    locations = {"depot": (0.0, 0.0)}
    shown = [("customer", site.customer), *((p.name or "rally", p) for p in site.rally)]
    for name, location in [*shown, *((stop.name, stop) for stop in site.stops)]:
        north, east = location_ne_m(location, craft.depot)
        locations[name] = (east, north)
    obstacles = read_obstacles(craft.flight, options.flight_file, craft.depot)
    hills = craft.terrain if site.terrain.kind == "grid" else None
    gate = "" if options.gate else ", gate off"
    title_text = f"{craft.flight.name}, {airframe.name} on {craft.autopilot_kind}"
    outcome_text = f"{verdict.outcome.code} in {verdict.flight_time_s:.0f} s"
    margin_text = f"{reserve_margin_text(verdict.outcome.margin_wh)} at the end"
    write_flight_picture(
        craft.run_dir / FILE_NAME,
        title=f"{title_text}, seed {options.seed}{gate}: {outcome_text}, {margin_text}",
        track=build_true_flight_track(craft.record, reserve_wh, hills),
        companion_result=companion_result,
        locations_en_m=locations,
        polygons_en_m=[np.array([(e, n) for n, e in o.ring_ne_m]) for o in obstacles],
        max_loss=craft.flight.mission.max_loss,
        clearance_m=craft.flight.mission.clearance_m,
    )
    with contextlib.suppress(OSError):
        shutil.copy(options.flight_file, craft.run_dir / "flight.source.toml")
