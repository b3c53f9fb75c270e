"""A crossing reported: a row of figures, tables, and the loop over seeds."""

import json
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sim_bridge.app.crossing.crossing import LIMIT_S, Crosser, Crossing, CrossOptions
from sim_bridge.app.crossing.judge import nearest_of, outcome_of
from sim_bridge.app.flight.run_folder import new_run_dir, saved_on_interrupt

BROKEN_EVERY_S = 5


def cross_seeds(
    options: CrossOptions, seeds: Iterable[int], console: Console, json_out: Path | None
) -> list[dict[str, Any]]:
    """Fly the scene with each seed; every row is written as soon as it is flown."""
    rows: list[dict[str, Any]] = []
    deaf = options.fleets > 1 and not options.neighbours
    is_canary = deaf or not (options.separation_filter and options.keep_apart)  # one meeting is all
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        for seed in seeds:
            task = progress.add_task(f"seed {seed}", total=LIMIT_S)

            def watch(scene: Crossing, task: Any = task, seed: int = seed) -> bool:
                words = f"seed {seed}: {scene.clock.t_s:.0f} s, {_flying(scene)} in the air"
                progress.update(task, completed=scene.clock.t_s, description=words)
                return not (is_canary and _is_broken(scene))

            row = cross(replace(options, seed=seed), watch)
            progress.remove_task(task)
            rows.append(row)
            console.print(seed_words(row), highlight=False)
            if json_out is not None:
                json_out.write_text(json.dumps({"crossings": rows}, indent=1) + "\n")
    return rows


def cross(options: CrossOptions, watch: Any) -> dict[str, Any]:
    """One flight of all, judged by truth."""
    stem = f"cross-{options.vehicles}-{options.autopilot}-seed{options.seed}"
    folder = new_run_dir(options.run_root, stem)
    scene = Crossing(options, folder)
    with saved_on_interrupt(folder):
        scene.run(watch)
    return row_of(scene)


def _flying(scene: Crossing) -> int:
    return sum(c.drone.is_airborne for c in scene.crossers)


def _is_broken(scene: Crossing) -> bool:
    if round(scene.clock.t_s) % BROKEN_EVERY_S:
        return False
    near = nearest_of(_flown(scene))
    return near is not None and near.separations < 1.0


def _flown(scene: Crossing) -> dict[str, np.ndarray]:
    return {c.name: np.array(c.truth).reshape(-1, 5) for c in scene.crossers}


def row_of(scene: Crossing) -> dict[str, Any]:
    """What the scene came to."""
    flown = _flown(scene)
    for crosser in scene.crossers:
        np.save(crosser.drone.folder / "truth.npy", flown[crosser.name])
    nearest = nearest_of(flown)
    options = scene.options
    return {
        "vehicles": options.vehicles,
        "autopilot": options.autopilot,
        "seed": options.seed,
        "late_s": options.late_s,
        "off_m": options.off_m,
        "fleets": options.fleets,
        "neighbours": options.neighbours,
        "keep_apart": options.keep_apart,
        "separation_filter": options.separation_filter,
        "policy": options.policy,
        "kept": nearest is None or nearest.separations >= 1.0,
        "nearest": None if nearest is None else asdict(nearest),
        "flights": [_flight(c, flown[c.name]) for c in scene.crossers],
        "run": str(scene.folder),
    }


def _flight(crosser: Crosser, rows: np.ndarray) -> dict[str, Any]:
    drone = crosser.drone
    up = drone.up
    assert up is not None
    truth = up.vehicle.truth
    outcome = outcome_of(
        rows,
        crosser.pad_ne_m,
        crosser.customer_ne_m,
        up.released_ned_m,
        crashed=truth.crashed,
    )
    return {
        "vehicle": crosser.name,
        "autopilot": drone.autopilot_kind,
        "outcome": outcome,
        "flight_time_s": round(0.1 * float(rows[:, 4].sum()), 1),
        "set_points_s": round(crosser.aside_s, 1),
        "energy_used_wh": round(truth.energy_used_wh, 2),
    }


def seed_words(row: dict[str, Any]) -> str:
    """One line of a seed."""
    near = row["nearest"]
    outcomes = [flight["outcome"] for flight in row["flights"]]
    told = ", ".join(f"{outcomes.count(o)} {o}" for o in sorted(set(outcomes)))
    if near is None:
        return f"seed {row['seed']}: nobody flew together; {told}"
    word = "kept" if row["kept"] else "[red]BROKEN[/red]"
    one, other = near["who"]
    return (
        f"seed {row['seed']}: {word}, {near['separations']:.2f} separations:"
        f" {one} and {other} at {near['horizontal_m']:.1f} m and {near['vertical_m']:.1f} m of"
        f" height, {near['t_s']:.0f} s; {told}"
    )


def flights_table(row: dict[str, Any]) -> Table:
    """Each vehicle of one seed."""
    table = Table("vehicle", "autopilot", "outcome", "flight s", "set-points s", "Wh")
    for flight in row["flights"]:
        table.add_row(
            flight["vehicle"],
            flight["autopilot"],
            flight["outcome"],
            f"{flight['flight_time_s']:.0f}",
            f"{flight['set_points_s']:.0f}",
            f"{flight['energy_used_wh']:.1f}",
        )
    return table


def verdict_words(rows: list[dict[str, Any]]) -> str:
    """All seeds in a line."""
    broken = [str(row["seed"]) for row in rows if not row["kept"]]
    least = min((row["nearest"]["separations"] for row in rows if row["nearest"]), default=None)
    flights = [flight for row in rows for flight in row["flights"]]
    good = sum(flight["outcome"] == "SUC" for flight in flights)
    said = "separation kept" if not broken else f"separation broken, seeds {', '.join(broken)}"
    worst = "" if least is None else f", least {least:.2f} separations"
    return f"{len(rows)} seeds: {said}{worst}; {good} of {len(flights)} flights SUC"
