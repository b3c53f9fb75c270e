"""Launch windows for people: until when which orders are promised."""

from itertools import groupby

from rich.console import Console

from ground_station.core.planning.launch_windows import LaunchWindow, launch_windows
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import DayPlan


def show_windows(console: Console, data: DayData, plan: DayPlan, forecast: DayForecast) -> None:
    """Print the forecast at the day's beginning, and after which time what is not promised."""
    height_m = data.day.mission.cruise_height_m
    wind = forecast.wind(0.0, height_m)
    console.print(
        f"forecast at {height_m:.0f} m, {forecast.clock(0.0)}: {wind}"
        f" (one sigma {data.day.forecast.std_mps:.1f} m/s, by {forecast.field.spread})",
        highlight=False,
    )
    for line in window_lines(launch_windows(data, plan, forecast), forecast, height_m):
        console.print(line, highlight=False)


def window_lines(windows: list[LaunchWindow], forecast: DayForecast, height_m: float) -> list[str]:
    """A line for each time after which orders are not promised, and one for the rest."""

    def ends(window: LaunchWindow) -> tuple[bool, float, float]:
        until_s, again_s = window.until_s, window.again_s
        return until_s is None, until_s or 0.0, again_s or 0.0

    lines: list[str] = []
    for _, alike in groupby(sorted(windows, key=lambda w: (*ends(w), w.order)), ends):
        group = list(alike)
        orders = ", ".join(window.order for window in group)
        verb = "is" if len(group) == 1 else "are"
        until_s, again_s = group[0].until_s, group[0].again_s
        if until_s is None:
            end_s = min(window.end_s for window in group)
            lines.append(
                f"{orders} {verb} promised until {forecast.clock(end_s)}, where the look ends"
            )
            continue
        wind = forecast.wind(until_s, height_m)
        again = f"; again from {forecast.clock(again_s)}" if again_s is not None else ""
        words = f"after {forecast.clock(until_s)} ({wind} then) {orders} {verb} not promised"
        lines.append(words + again)
    return lines
