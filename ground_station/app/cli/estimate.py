"""`ground-station estimate`: energy and P(home) of one delivery before the flight."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.desk_options import ForecastFile

if TYPE_CHECKING:
    from companion.core.mission.flight_estimate import CruiseWind, FlightEstimate

EXIT_NO_GO = 3

app = typer.Typer()


@app.command()
def estimate(
    flight: Annotated[
        str, typer.Argument(help="A flight/1 TOML file, or a bundled flight such as `default`.")
    ],
    wind_speed: Annotated[
        float | None,
        typer.Option(min=0.0, max=40.0, help="Wind speed at cruise height, m/s. Default: 0."),
    ] = None,
    wind_from: Annotated[
        float | None,
        typer.Option(help="Wind direction (from), degrees clockwise from north. Default: 0."),
    ] = None,
    wind_std: Annotated[
        float | None,
        typer.Option(min=0.1, max=10.0, help="Standard deviation of the wind, m/s. Default: 1.5."),
    ] = None,
    charge: Annotated[
        float | None,
        typer.Option(min=0.05, max=1.0, help="Charge fraction at start. Default: the flight's."),
    ] = None,
    forecast: ForecastFile = None,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="Launch time, as 2026-07-01T15:10Z; only with --forecast."
        ),
    ] = None,
) -> None:
    """Estimate energy and probabilities of one delivery.

    Exit code 3: no go, the return budget is insufficient.

    ground-station estimate default --wind-speed 8 --wind-from 270
    """
    from companion.core.mission.flight_estimate import CruiseWind
    from ground_station.adapters.files.params import resolve_flight_file_path
    from ground_station.app.planning.flight_estimate import estimate_flight_file

    path, wind_options = resolve_flight_file_path(flight), (wind_speed, wind_from, wind_std)
    if forecast is not None or at is not None:
        wind = _forecast_wind(path, forecast, at, wind_options)
    else:
        speed, from_deg, std = wind_options
        wind = CruiseWind(speed or 0.0, from_deg or 0.0, 1.5 if std is None else std)
    result = estimate_flight_file(path, wind, charge)
    if forecast is not None:
        typer.echo(
            f"forecast for {at}: {wind.speed_mps:.1f} m/s from {wind.from_deg:.0f},"
            f" one sigma {wind.std_mps:.1f} m/s"
        )
    _print_estimate(result)
    raise typer.Exit(EXIT_NO_GO if result.assessment.turn_back else 0)


def _forecast_wind(
    path: Path,
    forecast: Path | None,
    launch_time: str | None,
    wind_options: tuple[float | None, ...],
) -> "CruiseWind":
    from ground_station.app.planning.forecast_wind import launch_wind_of_flight

    if forecast is None or launch_time is None:
        raise LeewayError("--forecast FILE and --at TIME: expected both")
    if any(value is not None for value in wind_options):
        raise LeewayError("--forecast and --wind-...: expected only one of them")
    return launch_wind_of_flight(path, forecast, launch_time)


def _print_estimate(result: "FlightEstimate") -> None:
    from rich.table import Table

    from companion.core.base.probability import home_probability_text
    from ground_station.app.views.terminal import plain_console

    flight, plan, seen = result.flight, result.planned.plan, result.assessment
    vehicle = flight.vehicle
    table = Table(title=f"{flight.name}: {vehicle.airframe}, {vehicle.payload_kg:g} kg")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    for label, value in (
        ("waypoints out / back", f"{len(plan.outbound_ned_m)} / {len(plan.return_ned_m)}"),
        ("usable energy / reserve", f"{result.energy.mean_wh:.0f} / {result.reserve_wh:.0f} Wh"),
        ("mean energy until landing", f"{seen.energy_need_wh:.0f} Wh"),
        ("P(home) with the gate", home_probability_text(seen.p_home, seen.p_home_stated)),
        ("P(home and delivered)", f"{min(seen.p_success, seen.p_home_limit):.3f}"),
        ("accepted loss of the vehicle", f"{flight.mission.max_loss:g}"),
        ("return budget (gate)", "no go" if seen.turn_back else "go"),
    ):
        table.add_row(label, value)
    for label, value in _terrain_rows(result):
        table.add_row(label, value)
    console = plain_console()
    console.print(table)
    console.print(seen.reason, highlight=False)
    if words := result.evidence.missing_support_text(flight.mission.max_loss):
        console.print(f"warning: {words}", highlight=False)


def _terrain_rows(result: "FlightEstimate") -> list[tuple[str, str]]:
    """Return the terrain rows of a flight whose file has terrain."""
    clearance_m, plan = result.min_ground_clearance_m, result.planned.plan
    if clearance_m is None:
        return []
    top_m = max(-p[2] for p in (*plan.outbound_ned_m, *plan.return_ned_m))
    seen = {True: "yes", False: "no", None: "unknown"}[result.is_drop_visible]
    return [
        ("maximum height above the depot", f"{top_m:.0f} m"),
        ("minimum height above ground", f"{clearance_m:.0f} m"),
        ("line of sight to the customer", seen),
    ]
