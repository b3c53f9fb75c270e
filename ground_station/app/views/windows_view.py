"""Forecast of a plan as text: its wind, and the times until which orders are promised."""

from rich.console import Console

from ground_station.core.dispatch.launch_promise import (
    LaunchClosing,
    format_closing_of_orders,
    launch_closings_of_plan,
)
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import DayPlan


def print_wind_and_launch_closings(
    console: Console, data: DayData, plan: DayPlan, forecast: DayForecast
) -> None:
    """Print the forecast at the day's start, and the time after which orders are not promised."""
    height_m = data.day.mission.cruise_height_m
    wind = forecast.wind_at_day_time(0.0, height_m)
    console.print(
        f"forecast at {height_m:.0f} m, {forecast.format_utc_date_and_time(0.0)}: {wind}"
        f" (one sigma {data.day.forecast.std_mps:.1f} m/s, by {forecast.field.spread})",
        highlight=False,
    )
    for line in launch_closing_lines(launch_closings_of_plan(data, plan, forecast), forecast):
        console.print(line, highlight=False)


def launch_closing_lines(closings: list[LaunchClosing], forecast: DayForecast) -> list[str]:
    """Return a line for each time after which orders are not promised, and one for the rest."""
    groups: dict[tuple[float, float | None], list[LaunchClosing]] = {}
    for one in sorted(closings, key=lambda one: one.order):
        if one.until_s is not None:
            groups.setdefault((one.until_s, one.reopens_s), []).append(one)
    lines = [
        format_closing_of_orders(forecast, until_s, again_s, group, 0.0)
        for (until_s, again_s), group in sorted(groups.items(), key=lambda item: item[0][0])
    ]
    rest = sorted(one.order for one in closings if one.until_s is None)
    return (
        [*lines, f"may be launched until the forecast ends: {', '.join(rest)}"] if rest else lines
    )
