"""Reports of crossings: result rows, tables and the loop over seeds."""

import math
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sim_bridge.adapters.json_result import write_json_result
from sim_bridge.app.crossing.crossing import (
    DROP_HEIGHT_M,
    TIME_LIMIT_S,
    TRACK_DELAY_S,
    TRACK_ERROR_STD_M,
    Crossing,
    CrossingVehicle,
    CrossOptions,
)
from sim_bridge.app.crossing.judge import find_minimum_separation
from sim_bridge.app.day.judge import DayFlight, DayTruth, Pad, ParkedInterval, evaluate_day
from sim_bridge.app.flight.run_folder import create_unique_run_dir, mark_if_interrupted

SEPARATION_CHECK_INTERVAL_S = 5


def fly_crossings(
    options: CrossOptions, seeds: Iterable[int], console: Console, json_out: Path | None
) -> list[dict[str, Any]]:
    """Fly the scene with each seed; write each row as soon as it is available."""
    rows: list[dict[str, Any]] = []
    ignores_neighbours = options.fleets > 1 and not options.neighbours
    is_canary = (
        ignores_neighbours or not options.separation_filter
    )  # the first violation ends a canary
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        for seed in seeds:
            task = progress.add_task(f"seed {seed}", total=TIME_LIMIT_S)

            def update_progress_and_check(
                scene: Crossing, task: Any = task, seed: int = seed
            ) -> bool:
                airborne = sum(crosser.drone.is_airborne for crosser in scene.crossers)
                words = f"seed {seed}: {scene.clock.t_s:.0f} s, {airborne} in the air"
                progress.update(task, completed=scene.clock.t_s, description=words)
                return not (is_canary and _is_separation_broken_at_check(scene))

            row = fly_crossing(replace(options, seed=seed), update_progress_and_check)
            progress.remove_task(task)
            rows.append(row)
            console.print(format_seed_result(row), highlight=False)
            if json_out is not None:
                write_json_result(json_out, {"crossings": rows}, indent=1)
    return rows


def fly_crossing(options: CrossOptions, should_continue: Any) -> dict[str, Any]:
    """Fly one crossing and return its result row from ground truth."""
    stem = f"cross-{options.vehicles}-mixed-seed{options.seed}"
    folder = create_unique_run_dir(options.run_root, stem)
    scene = Crossing(options, folder)
    with mark_if_interrupted(folder):
        scene.run_until_over(should_continue)
    return save_truth_and_build_result_row(scene)


def _is_separation_broken_at_check(scene: Crossing) -> bool:
    if round(scene.clock.t_s) % SEPARATION_CHECK_INTERVAL_S:
        return False
    near = find_minimum_separation([c.build_vehicle_track() for c in scene.crossers])
    return near is not None and near.separations < 1.0


def save_truth_and_build_result_row(scene: Crossing) -> dict[str, Any]:
    """Return the result row of a finished scene; save each vehicle's ground truth."""
    tracks = [crosser.build_vehicle_track() for crosser in scene.crossers]
    for crosser, track in zip(scene.crossers, tracks, strict=True):
        np.save(crosser.drone.folder / "truth.npy", np.asarray(track.record.rows, float))
    nearest = find_minimum_separation(tracks)
    options = scene.options
    day_truth = DayTruth(
        customers={c.name: (*c.customer_ne_m, 0.0) for c in scene.crossers},
        drop_height_m=DROP_HEIGHT_M,
        tracks=tracks,
        parked_intervals=[ParkedInterval("truck", (0.0, 0.0), 0.0, math.inf)],
        pads=[Pad("truck", c.name, c.pad_ne_m) for c in scene.crossers],
        home_reports=[],
        handovers=[],
    )
    flights = {flight.vehicle: flight for flight in evaluate_day(day_truth).flights}
    return {
        "vehicles": options.vehicles,
        "autopilot": "mixed",
        "seed": options.seed,
        "late_s": TRACK_DELAY_S,
        "off_m": TRACK_ERROR_STD_M,
        "fleets": options.fleets,
        "neighbours": options.neighbours,
        "separation_filter": options.separation_filter,
        "kept": nearest is None or nearest.separations >= 1.0,
        "nearest": None if nearest is None else asdict(nearest),
        "flights": [_flight_row(c, flights.get(c.name), scene.clock.t_s) for c in scene.crossers],
        "run": str(scene.folder),
    }


def _flight_row(crosser: CrossingVehicle, flight: DayFlight | None, end_s: float) -> dict[str, Any]:
    """Return the row of a vehicle; `flight` None: it did not take off."""
    up = crosser.drone.power_cycle
    assert up is not None
    flown_s = 0.0 if flight is None else (flight.land_s or end_s) - flight.launch_s
    return {
        "vehicle": crosser.name,
        "autopilot": crosser.drone.autopilot_kind,
        "outcome": "NONE" if flight is None else flight.outcome,
        "flight_time_s": round(flown_s, 1),
        "set_points_s": round(crosser.setpoint_time_s, 1),
        "energy_used_wh": round(up.vehicle.truth.energy_used_wh, 2),
    }


def format_seed_result(result_row: dict[str, Any]) -> str:
    """Format the result of one seed as a line."""
    near = result_row["nearest"]
    outcomes = [flight["outcome"] for flight in result_row["flights"]]
    outcome_text = ", ".join(f"{outcomes.count(o)} {o}" for o in sorted(set(outcomes)))
    if near is None:
        return f"seed {result_row['seed']}: no two vehicles airborne at once; {outcome_text}"
    word = "kept" if result_row["kept"] else "[red]BROKEN[/red]"
    one, other = near["who"]
    return (
        f"seed {result_row['seed']}: {word}, {near['separations']:.2f} separations:"
        f" {one} and {other} at {near['horizontal_m']:.1f} m horizontal, {near['vertical_m']:.1f} m"
        f" vertical, {near['t_s']:.0f} s; {outcome_text}"
    )


def flights_table(result_row: dict[str, Any]) -> Table:
    """Return a table of the vehicles of one seed."""
    table = Table("vehicle", "autopilot", "outcome", "flight s", "set-points s", "Wh")
    for flight in result_row["flights"]:
        table.add_row(
            flight["vehicle"],
            flight["autopilot"],
            flight["outcome"],
            f"{flight['flight_time_s']:.0f}",
            f"{flight['set_points_s']:.0f}",
            f"{flight['energy_used_wh']:.1f}",
        )
    return table


def format_overall_result(result_rows: list[dict[str, Any]]) -> str:
    """Format the results of all seeds as a line."""
    broken = [str(row["seed"]) for row in result_rows if not row["kept"]]
    least = min(
        (row["nearest"]["separations"] for row in result_rows if row["nearest"]), default=None
    )
    flights = [flight for row in result_rows for flight in row["flights"]]
    good = sum(flight["outcome"] == "SUC" for flight in flights)
    separation_text = (
        "separation kept" if not broken else f"separation broken, seeds {', '.join(broken)}"
    )
    worst = "" if least is None else f", least {least:.2f} separations"
    return (
        f"{len(result_rows)} seeds: {separation_text}{worst}; {good} of {len(flights)} flights SUC"
    )
