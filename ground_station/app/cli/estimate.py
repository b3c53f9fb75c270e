"""`ground-station estimate`: the energy and the promise of one delivery, before it flies."""

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ground_station.app.planning.flight_estimate import FlightEstimate

NO_GO = 3

app = typer.Typer()


@app.command()
def estimate(
    flight: Annotated[
        str, typer.Argument(help="A flight/1 TOML file, or the name of a bundled flight (default).")
    ],
    wind_speed: Annotated[
        float, typer.Option(min=0.0, max=40.0, help="Wind speed at cruise height, m/s.")
    ] = 0.0,
    wind_from: Annotated[
        float, typer.Option(help="Where it blows from, degrees clockwise from north.")
    ] = 0.0,
    wind_std: Annotated[
        float, typer.Option(min=0.1, max=10.0, help="Its standard deviation, m/s.")
    ] = 1.5,
    charge: Annotated[
        float | None,
        typer.Option(min=0.05, max=1.0, help="Charge at the start, as a fraction. Default: full."),
    ] = None,
) -> None:
    """Energy and probabilities of one delivery. Exit code 3: no go, the return budget is short.

    ground-station estimate default --wind-speed 8 --wind-from 270
    """
    from ground_station.adapters.files.params import flight_file
    from ground_station.app.planning.flight_estimate import StatedWind, estimate_flight

    made = estimate_flight(flight_file(flight), StatedWind(wind_speed, wind_from, wind_std), charge)
    _print(made)
    raise typer.Exit(NO_GO if made.assessment.turn_back else 0)


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
