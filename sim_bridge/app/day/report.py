"""Terminal output of simulated days: a progress line during the flight, then tables."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from sim_bridge.app.day.world import DayWorld
from sim_bridge.app.flight.report import borderless_table

LINE_INTERVAL_S = 300.0


@dataclass(slots=True)
class DayView:
    """Progress bar on a terminal; otherwise a line every five minutes of the day."""

    console: Console
    bar: Progress
    task: TaskID
    _next_line_s: float = field(default=LINE_INTERVAL_S)

    def show_progress_and_continue(self, world: DayWorld) -> bool:
        """Show the progress of the day. Returns True: the day continues."""
        airborne = [drone.name for drone in world.drones if drone.is_airborne]
        released = sum(
            up.record.released_s is not None
            for drone in world.drones
            for up in drone.all_power_cycles
        )
        delivered_count = released + len(world.ground_handling.delivered)
        message = f"{delivered_count} delivered; airborne: {' '.join(airborne) or 'none'}"
        self.bar.update(self.task, completed=world.clock.t_s, said=message)
        if not self.console.is_terminal and world.clock.t_s >= self._next_line_s:
            self._next_line_s += LINE_INTERVAL_S
            self.console.print(f"{world.clock.t_s / 60.0:5.0f} min: {message}", highlight=False)
        return True


@contextmanager
def day_progress_view(
    console: Console, day_title: str, expected_duration_s: float
) -> Iterator[DayView]:
    """Yield the progress view of a day while it is flown."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[said]}"),
        TimeElapsedColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        yield DayView(console, bar, bar.add_task(day_title, total=expected_duration_s, said=""))


def print_day_flights_and_summary(console: Console, result_row: dict[str, Any]) -> None:
    """Print one day: its flights and its summary."""
    table = borderless_table(
        f"{result_row['day']}, seed {result_row['seed']}: flights by truth",
        ("drone", "left"),
        ("autopilot", "left"),
        ("order", "left"),
        ("up\nmin", "right"),
        ("down\nmin", "right"),
        ("landed at", "left"),
        ("outcome", "left"),
        ("used\nWh", "right"),
        ("above\nreserve", "right"),
    )
    for flight in result_row["flights"]:
        land_s = flight["land_s"]
        table.add_row(
            flight["vehicle"],
            flight["autopilot"],
            flight["order"] or "-",
            f"{flight['launch_s'] / 60.0:.1f}",
            "-" if land_s is None else f"{land_s / 60.0:.1f}",
            flight["stop"] or "NOWHERE",
            flight["outcome"],
            f"{flight['energy_used_wh']:.0f}",
            f"{flight['margin_wh']:+.0f}",
        )
    console.print(table)
    for message in day_summary_lines(result_row):
        console.print(message, highlight=False)


def day_summary_lines(result_row: dict[str, Any]) -> list[str]:
    """Return the summary of a day as lines."""
    ended = "" if result_row["ended"] else "; STOPPED at the time limit"
    lines = [
        f"{result_row['delivered']} of {result_row['orders']} orders delivered"
        f" ({result_row['by_truck']} by the truck)"
        f" in {result_row['duration_s'] / 60.0:.1f} min, {len(result_row['flights'])} flights,"
        f" {result_row['energy_used_wh']:.0f} Wh{ended}"
    ]
    for line in result_row["undelivered"]:
        kind = "NOT DELIVERED" if line["feasible"] else "never feasible"
        lines.append(f"  {line['order']}: {kind}: {line['why']}")
    near = result_row["nearest"]
    if near is not None:
        lines.append(
            f"minimum separation: {near['distance_m']:.1f} m ("
            f"{near['horizontal_m']:.1f} horizontal, {near['vertical_m']:.1f} vertical),"
            f" {' and '.join(near['vehicles'])} at {near['t_s'] / 60.0:.1f} min"
        )
    for title, key in (
        ("lost flight", "lost"),
        ("delivered or flown twice", "flown_twice"),
        ("promise broken", "promises_broken"),
        ("desk record differs from truth", "believed_otherwise"),
    ):
        lines += [f"{title}: {message}" for message in result_row[key]]
    if result_row["what_went_wrong"]:
        lines.append("injected faults: " + "; ".join(result_row["what_went_wrong"]))
    sent, lost = result_row["messages"]["sent"], result_row["messages"]["lost"]
    if lost:
        share = lost / max(sent, 1)
        lines.append(
            f"{lost} of {sent} fleet messages lost ({share:.0%}),"
            f" {result_row['frames_lost']} MAVLink frames"
        )
    run_time = result_row["spent"]
    lines.append(
        f"{result_row['duration_s'] / max(run_time['cpu_s'], 1e-9):.1f} times real time by this"
        f" process's CPU ({run_time['cpu_s']:.0f} s; {run_time['wall_s']:.0f} s wall time)"
    )
    return lines


def print_days_table(console: Console, result_rows: list[dict[str, Any]]) -> None:
    """Print several days, one line each."""
    table = borderless_table(
        "simulated days by truth",
        ("seed", "right"),
        ("delivered\nof feasible", "right"),
        ("by\ntruck", "right"),
        ("flights", "right"),
        ("lost", "right"),
        ("twice", "right"),
        ("promises\nbroken", "right"),
        ("nearest\nm", "right"),
        ("least above\nreserve Wh", "right"),
        ("minutes", "right"),
        ("x real\ntime", "right"),
    )
    for row in result_rows:
        near, margin = row["separation_min_m"], row["margin_min_wh"]
        table.add_row(
            str(row["seed"]),
            f"{row['delivered']} of {row['feasible']}",
            str(row["by_truck"]),
            str(len(row["flights"])),
            str(row["vehicles_lost"]),
            str(len(row["flown_twice"])),
            str(len(row["promises_broken"])),
            "-" if near is None else f"{near:.1f}",
            "-" if margin is None else f"{margin:+.1f}",
            f"{row['duration_s'] / 60.0:.1f}" + ("" if row["ended"] else " CUT"),
            f"{row['duration_s'] / max(row['spent']['cpu_s'], 1e-9):.1f}",
        )
    console.print(table)
