"""The command line of `sim-bridge fly-plan`: a QGroundControl plan, flown and recorded."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer()

_SETTINGS = {  # what lets each fly a plan without sticks, at the plan's own speeds
    "px4": {"MPC_XY_VEL_MAX": 20.0, "MPC_TILTMAX_AIR": 35.0},
    "ardupilot": {"AUTO_OPTIONS": 3, "ANGLE_MAX": 3500},
}
_NOSE_HELD = {"px4": {"MPC_YAW_MODE": 5}, "ardupilot": {"WP_YAW_BEHAVIOR": 0}}


@app.command(name="fly-plan")
def fly_plan_command(
    plan: Annotated[Path, typer.Argument(help="A .plan, as companion calibrate-plan writes.")],
    out: Annotated[Path, typer.Option(help="The log, as a ground station records it.")],
    autopilot: Annotated[str, typer.Option(help="px4 or ardupilot.")] = "px4",
    airframe: Annotated[str, typer.Option(help="m100 or octo8.")] = "m100",
    payload_kg: Annotated[float, typer.Option(min=0.0, help="Parcel aboard, kept.")] = 0.0,
    charge_frac: Annotated[float, typer.Option(min=0.3, max=1.0, help="Of a full pack.")] = 1.0,
    wind_speed_mps: Annotated[float, typer.Option(min=0.0, max=25.0, help="10 m up.")] = 0.0,
    wind_from_deg: Annotated[float, typer.Option(help="Where it blows from.")] = 0.0,
    wind_log: Annotated[
        Path | None, typer.Option(help="Recording (t_s, wind_speed_mps, wind_from_deg) instead.")
    ] = None,
    wind_start_s: Annotated[float, typer.Option(min=0.0, help="Where it starts.")] = 0.0,
    nose_held: Annotated[
        bool, typer.Option("--nose-held", help="One heading throughout: tells drag sideways.")
    ] = False,
    param: Annotated[
        list[str] | None,
        typer.Option(help="NAME=VALUE, an autopilot's parameter; repeat it for several."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Gusts follow it.")] = 1,
    vehicle_seed: Annotated[
        int,
        typer.Option(min=0, help="Sensor errors follow it: the same number is the same vehicle."),
    ] = 1,
) -> None:
    """Fly a ground station's plan on a simulated autopilot and record it, without a companion.

    Example: sim-bridge fly-plan square.plan --out 1.tlog --payload-kg 0.8 --wind-speed-mps 6
    """
    if autopilot not in _SETTINGS:
        raise LeewayError(f"--autopilot {autopilot}: px4 or ardupilot expected")

    import numpy as np
    from rich.console import Console

    from companion.adapters.files.params import params_dir
    from companion.adapters.files.qgc_plan import read_plan
    from sim_bridge.app.serve.plan_flight import fly_plan
    from sim_bridge.app.serve.server import Home, stand_up
    from sim_bridge.autopilot.kinds import AutopilotKind
    from sim_bridge.autopilot.mavlink.parameters import read_parameters
    from sim_bridge.truth.params import load_airframe
    from sim_bridge.truth.wind_params import build_wind_field, mean_wind, parse_wind

    table = {"kind": "steady", "speed_mps": wind_speed_mps, "from_deg": wind_from_deg}
    if wind_log is not None:
        table = {"kind": "log", "log": str(wind_log.absolute()), "start_s": wind_start_s}
    wind = parse_wind({**table, "turbulence": "dryden" if wind_log is None else "none"})
    mean = mean_wind(wind, Path())
    home, items = read_plan(plan)
    settings = _SETTINGS[autopilot] | (_NOSE_HELD[autopilot] if nose_held else {})
    settings |= dict(map(_setting, param or []))
    autopilot_kind = AutopilotKind(autopilot)
    served = stand_up(
        autopilot_kind,
        load_airframe(params_dir() / "truth" / f"{airframe}.toml"),
        read_parameters(params_dir() / "autopilots" / f"{autopilot}.toml", settings),
        home=Home(*home),
        wind=build_wind_field(wind, mean, np.random.default_rng(seed)),
        payload_kg=payload_kg,
        charge_frac=charge_frac,
        seed=vehicle_seed,
    )
    console = Console(highlight=False)
    with console.status("on the ground") as status:
        flown = fly_plan(
            served,
            autopilot_kind,
            items,
            out,
            progress=lambda t_s: status.update(f"{t_s:.0f} s, {served.vehicle.height_m:.0f} m up"),
        )
    console.print(
        f"{out}: {flown.duration_s:.0f} s, {flown.energy_wh:.1f} Wh by truth, mean wind"
        f" {flown.wind_mean_mps:.1f} m/s, {payload_kg:g} kg",
        soft_wrap=True,
    )


def _setting(words: str) -> tuple[str, float]:
    name, equals, value = words.partition("=")
    try:
        if not equals:
            raise ValueError
        return name, float(value)
    except ValueError:
        raise LeewayError(f"--param {words}: NAME=VALUE expected") from None
