"""`ground-station`: the dispatcher's commands; here: what a flight would cost, and promise."""

import math
import sys
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from companion.core.base.errors import LeewayError
from companion.core.base.place import Place
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import (
    DROP_S,
    SETTLE_SLACK_S,
    FlightPlan,
    frame_at,
    make_plan,
)
from companion.core.mission.flight_plan import site_map as site_map_of
from companion.core.return_budget.budget import Assessment, Gate, GateParams
from companion.core.return_budget.remaining_from_plan import ahead_outbound
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook
from ground_station.adapters.files.params import (
    read_airframe,
    read_json,
    read_toml,
    read_wind_process,
)

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="The dispatcher's desk, with the very energy model that the vehicles fly with.",
)


@app.command()
def estimate(
    flight: Annotated[Path, typer.Argument(help="A flight/1 TOML file.")],
    wind_speed: Annotated[
        float, typer.Option(min=0.0, max=40.0, help="Wind at cruise height, m/s.")
    ] = 0.0,
    wind_from: Annotated[
        float, typer.Option(help="Where it blows from, degrees clockwise from north.")
    ] = 0.0,
    wind_std: Annotated[
        float, typer.Option(min=0.1, max=10.0, help="How wrong that may be, m/s (one sigma).")
    ] = 1.5,
    charge: Annotated[
        float | None, typer.Option(min=0.05, max=1.0, help="Charge at the start; default: full.")
    ] = None,
) -> None:
    """Energy and promise of one delivery before anything flies; exit code 3: the gate says stay."""
    loaded = _read_flight(flight)
    airframe = read_airframe(loaded.vehicle.airframe)
    route_energy = RouteEnergy.for_mission(airframe, loaded.mission)
    energy = _energy(loaded, airframe, route_energy, charge)
    depot = loaded.site.depot
    if depot is None:
        raise LeewayError(f"{flight}: site.depot: needed for an estimate (lat_deg, lon_deg, ...)")
    planned = _plan(loaded, flight, depot, route_energy, energy)
    angle = math.radians(wind_from)
    to_ne = np.array([-wind_speed * math.cos(angle), -wind_speed * math.sin(angle)])
    belief = WindBelief(0.0, to_ne, wind_std**2 * np.eye(2), ("forecast",), True)
    outlook = WindOutlook(read_wind_process(loaded.mission.wind_process))
    outlook.observe(belief)
    reserve_wh = loaded.mission.reserve_frac * energy.usable_full_wh
    gate = Gate(route_energy, GateParams(max_loss=loaded.mission.max_loss, reserve_wh=reserve_wh))
    ahead = ahead_outbound(
        planned.plan,
        planned.plan.depot_ned_m,
        0,
        loaded.vehicle.payload_kg,
        loaded.mission.drop_height_m,
        DROP_S,
        loaded.mission.wind_settle_s + SETTLE_SLACK_S,
    )
    seen = gate.assess(ahead, belief, outlook, energy)
    _print(Console(), loaded, planned, energy, reserve_wh, seen)
    raise typer.Exit(3 if seen.turn_back else 0)


def _read_flight(path: Path) -> Flight:
    try:
        return msgspec.convert(read_toml(path), Flight)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{path}: {error}") from error


def _energy(
    flight: Flight, airframe: Airframe, route_energy: RouteEnergy, charge: float | None
) -> EnergyBelief:
    """A pack of the stated charge, as the ledger would see it after a rest."""
    vehicle, battery = flight.vehicle, airframe.battery
    draw_w = route_energy.hover_power_w(vehicle.payload_kg)
    full_wh = battery.usable_wh(draw_w, vehicle.temperature_c, vehicle.battery_health_frac)
    share = charge if charge is not None else vehicle.charge_frac_stated
    left_wh = full_wh * (share if share is not None else 1.0)
    return EnergyBelief(
        0.0, left_wh, battery.usable_std_frac * left_wh, full_wh, "charge as stated"
    )


def _plan(
    flight: Flight, path: Path, depot: Place, route_energy: RouteEnergy, energy: EnergyBelief
) -> FlightPlan:
    document: dict[str, Any] | None = None
    if flight.site.obstacles is not None:
        document = read_json(path.parent / flight.site.obstacles)
    site = site_map_of(flight, frame_at(depot), document)
    planned = make_plan(flight, site, BerPlanner(route_energy), energy, flight.mission.reserve_frac)
    if isinstance(planned, NoRoute):
        raise LeewayError(f"{path}: no route: {planned.reason}")
    return planned


def _print(
    console: Console,
    flight: Flight,
    planned: FlightPlan,
    energy: EnergyBelief,
    reserve_wh: float,
    seen: Assessment,
) -> None:
    table = Table(
        title=f"{flight.name}: {flight.vehicle.airframe}, {flight.vehicle.payload_kg:g} kg"
    )
    table.add_column("what")
    table.add_column("figure", justify="right")
    plan = planned.plan
    for what, figure in (
        ("waypoints out / back", f"{len(plan.outbound_ned_m)} / {len(plan.return_ned_m)}"),
        ("usable energy / reserve", f"{energy.mean_wh:.0f} / {reserve_wh:.0f} Wh"),
        ("mean need, to the ground", f"{seen.energy_need_wh:.0f} Wh"),
        ("P(home) under the gate", f"{seen.p_home:.4f}"),
        ("P(home and delivered)", f"{seen.p_success:.3f}"),
        ("loss accepted", f"{flight.mission.max_loss:g}"),
        ("the gate says", "stay" if seen.turn_back else "go"),
    ):
        table.add_row(what, figure)
    console.print(table)
    console.print(seen.reason, highlight=False)


def main() -> None:
    """Entry point: a mistake in the input is one line on stderr and exit code 2."""
    try:
        from ground_station.adapters.zenoh_fleet import leave_process
        from ground_station.app.cli import cluster as cluster_cli
        from ground_station.app.cli import dispatch as dispatch_cli
        from ground_station.app.cli import order as order_cli
        from ground_station.app.cli import plan as plan_cli
        from ground_station.app.cli.benchmark import benchmark
        from ground_station.app.cli.truck import truck
    except ImportError as error:  # the vehicle's install carries this script, but not the desk
        print(f"ground-station: pip install 'leeway-uas[ground]' ({error})", file=sys.stderr)
        sys.exit(2)
    app.add_typer(order_cli.app, name="order")
    app.add_typer(dispatch_cli.app)
    app.add_typer(benchmark, name="benchmark")
    app.add_typer(cluster_cli.app)
    app.add_typer(plan_cli.app)
    app.command()(truck)
    try:
        app()
    except LeewayError as error:
        print(f"ground-station: {error}", file=sys.stderr)
        leave_process(2)
    except SystemExit as end:
        leave_process(end.code if isinstance(end.code, int) else int(end.code is not None))


if __name__ == "__main__":
    main()
