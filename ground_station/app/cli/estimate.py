"""`ground-station estimate`: the energy and the promise of one delivery, before it flies."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.cli.options import ForecastFile

if TYPE_CHECKING:
    from ground_station.app.planning.flight_estimate import FlightEstimate, StatedWind

NO_GO = 3

app = typer.Typer()


@app.command()
def estimate(
    flight: Annotated[
        str, typer.Argument(help="A flight/1 TOML file, or the name of a bundled flight (default).")
    ],
    wind_speed: Annotated[
        float | None,
        typer.Option(min=0.0, max=40.0, help="Wind speed at cruise height, m/s. Default: 0."),
    ] = None,
    wind_from: Annotated[
        float | None,
        typer.Option(help="Where it blows from, degrees clockwise from north. Default: 0."),
    ] = None,
    wind_std: Annotated[
        float | None,
        typer.Option(min=0.1, max=10.0, help="Its standard deviation, m/s. Default: 1.5."),
    ] = None,
    charge: Annotated[
        float | None,
        typer.Option(min=0.05, max=1.0, help="Charge at the start, as a fraction. Default: full."),
    ] = None,
    forecast: ForecastFile = None,
    at: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="With --forecast: the launch, as 2026-07-01T15:10Z."),
    ] = None,
) -> None:
    """Energy and probabilities of one delivery. Exit code 3: no go, the return budget is short.

    ground-station estimate default --wind-speed 8 --wind-from 270
    """
    from ground_station.adapters.files.params import flight_file
    from ground_station.app.planning.flight_estimate import StatedWind, estimate_flight

    path, stated = flight_file(flight), (wind_speed, wind_from, wind_std)
    if forecast is not None or at is not None:
        wind = _forecast_wind(path, forecast, at, stated)
    else:
        speed, from_deg, std = stated
        wind = StatedWind(speed or 0.0, from_deg or 0.0, 1.5 if std is None else std)
    made = estimate_flight(path, wind, charge)
    if forecast is not None:
        typer.echo(
            f"forecast for {at}: {wind.speed_mps:.1f} m/s from {wind.from_deg:.0f},"
            f" one sigma {wind.std_mps:.1f} m/s"
        )
    _print(made)
    raise typer.Exit(NO_GO if made.assessment.turn_back else 0)


def _forecast_wind(
    path: Path, forecast: Path | None, at: str | None, stated: tuple[float | None, ...]
) -> "StatedWind":
    from ground_station.app.planning.forecast_wind import forecast_wind

    if forecast is None or at is None:
        raise LeewayError("--forecast FILE and --at TIME: expected both")
    if any(figure is not None for figure in stated):
        raise LeewayError("--forecast: beside --wind-..., expected one of both")
    return forecast_wind(path, forecast, at)


def _print(made: "FlightEstimate") -> None:
    from rich.console import Console
    from rich.table import Table

    flight, plan, seen = made.flight, made.planned.plan, made.assessment
    vehicle = flight.vehicle
    table = Table(title=f"{flight.name}: {vehicle.airframe}, {vehicle.payload_kg:g} kg")
    table.add_column("what")
    table.add_column("figure", justify="right")
    for what, figure in (
        ("waypoints out / back", f"{len(plan.outbound_ned_m)} / {len(plan.return_ned_m)}"),
        ("usable energy / reserve", f"{made.energy.mean_wh:.0f} / {made.reserve_wh:.0f} Wh"),
        ("mean energy, to the ground", f"{seen.energy_need_wh:.0f} Wh"),
        ("P(home) with the gate", f"{seen.p_home:.4f}"),
        ("P(home and delivered)", f"{seen.p_success:.3f}"),
        ("accepted loss", f"{flight.mission.max_loss:g}"),
        ("return budget (gate)", "no go" if seen.turn_back else "go"),
    ):
        table.add_row(what, figure)
    for what, figure in _over_ground(made):
        table.add_row(what, figure)
    console = Console()
    console.print(table)
    console.print(seen.reason, highlight=False)


def _over_ground(made: "FlightEstimate") -> list[tuple[str, str]]:
    """Of a flight whose file brings the ground."""
    clearance_m, plan = made.clearance_m, made.planned.plan
    if clearance_m is None:
        return []
    top_m = max(-p[2] for p in (*plan.outbound_ned_m, *plan.return_ned_m))
    seen = {True: "yes", False: "no", None: "unknown"}[made.drop_in_sight]
    return [
        ("highest, above the depot", f"{top_m:.0f} m"),
        ("least over the ground, as planned", f"{clearance_m:.0f} m"),
        ("the drop in sight from the depot", seen),
    ]
