"""Simulated days on the terminal: a progress line during the flight, then tables."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from sim_bridge.app.day.world import DayWorld
from sim_bridge.app.flight.report import slim_table

LINE_EVERY_S = 300.0


@dataclass(slots=True)
class DayView:
    """A bar on a terminal; on anything else a line every five minutes of the day."""

    console: Console
    bar: Progress
    task: TaskID
    _next_line_s: float = field(default=LINE_EVERY_S)

    def planning(self, done_frac: float, best_s: float) -> None:
        """Show how far the plan is."""
        self.bar.update(self.task, said=f"planning: {done_frac:.0%}, {best_s / 60.0:.1f} min")

    def expect(self, makespan_s: float) -> None:
        """The day is planned to take so long."""
        self.bar.update(self.task, total=makespan_s)

    def update(self, world: DayWorld) -> bool:
        """Show where the day is; goes on."""
        flying = [drone.name for drone in world.drones if drone.is_airborne]
        released = sum(
            up.released_s is not None for drone in world.drones for up in drone.power_ups
        )
        brought = released + len(world.crew.delivered)
        words = f"{brought} brought; in the air: {' '.join(flying) or 'none'}"
        self.bar.update(self.task, completed=world.clock.t_s, said=words)
        if not self.console.is_terminal and world.clock.t_s >= self._next_line_s:
            self._next_line_s += LINE_EVERY_S
            self.console.print(f"{world.clock.t_s / 60.0:5.0f} min: {words}", highlight=False)
        return True


@contextmanager
def watched(console: Console, name: str, expected_s: float) -> Iterator[DayView]:
    """A day's view while it is flown."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[said]}"),
        TimeElapsedColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        yield DayView(console, bar, bar.add_task(name, total=expected_s, said=""))


def print_day(console: Console, row: dict[str, Any]) -> None:
    """One day: its flights, and what it came to."""
    table = slim_table(
        f"{row['day']}, seed {row['seed']}: flights by truth",
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
    for flight in row["flights"]:
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
    for words in summary(row):
        console.print(words, highlight=False)


def summary(row: dict[str, Any]) -> list[str]:
    """What a day came to, in lines."""
    ended = "" if row["ended"] else "; BROKEN OFF at its limit"
    lines = [
        f"{row['delivered']} of {row['orders']} orders delivered ({row['by_truck']} by the truck)"
        f" in {row['duration_s'] / 60.0:.1f} min, {len(row['flights'])} flights,"
        f" {row['energy_used_wh']:.0f} Wh{ended}"
    ]
    for line in row["undelivered"]:
        kind = "NOT DELIVERED" if line["feasible"] else "never feasible"
        lines.append(f"  {line['order']}: {kind}: {line['why']}")
    near = row["nearest"]
    if near is not None:
        lines.append(
            f"nearest two in the air: {near['distance_m']:.1f} m ({near['horizontal_m']:.1f} level,"
            f" {near['vertical_m']:.1f} up), {' and '.join(near['vehicles'])} at"
            f" {near['t_s'] / 60.0:.1f} min"
        )
    for title, key in (
        ("not home", "lost"),
        ("brought or flown twice", "flown_twice"),
        ("promise broken", "promises_broken"),
        ("the desk holds something else than what was so", "believed_otherwise"),
    ):
        lines += [f"{title}: {words}" for words in row[key]]
    if row["what_went_wrong"]:
        lines.append("put into the day: " + "; ".join(row["what_went_wrong"]))
    sent, lost = row["messages"]["sent"], row["messages"]["lost"]
    if lost:
        share = lost / max(sent, 1)
        lines.append(
            f"{lost} of {sent} fleet messages lost ({share:.0%}),"
            f" {row['frames_lost']} MAVLink frames"
        )
    spent = row["spent"]
    lines.append(
        f"{row['duration_s'] / max(spent['cpu_s'], 1e-9):.1f} times real time by this process's CPU"
        f" ({spent['cpu_s']:.0f} s; {spent['wall_s']:.0f} s by the wall)"
    )
    return lines


def print_days(console: Console, rows: list[dict[str, Any]]) -> None:
    """Several days, a line each."""
    table = slim_table(
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
    for row in rows:
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
