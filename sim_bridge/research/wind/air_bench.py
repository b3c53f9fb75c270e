"""Flights from sea level to 3,000 m and from frost to heat: does the companion know its air?

Each is the standing suite's short flight with another depot height and another temperature of air
and pack. Judged by truth: the wind that it believed, and what it said was left of its energy.
"""

import statistics
import tomllib
from itertools import product
from pathlib import Path

import msgspec

from companion.adapters.files.params import params_dir
from sim_bridge.app.flight.fly import FlyOptions, fly
from sim_bridge.research.results.sheet import Sheet
from sim_bridge.truth.atmosphere import air_density_kgpm3

HEIGHTS_M = (0.0, 1500.0, 3000.0)
TEMPERATURES_C = (-10.0, 15.0, 40.0)
AUTOPILOTS = ("px4", "ardupilot")
LOCKSTEP_LIMIT_S = 60.0
"""As the standing suite: a slow machine is no fault of the flight."""


class AirTask(msgspec.Struct, frozen=True):
    """One flight to be flown; `stated`: its file states the temperature of the air."""

    alt_amsl_m: float
    temperature_c: float
    stated: bool
    autopilot: str
    seed: int
    folder: str


class AirRow(msgspec.Struct, frozen=True):
    """One flight as judged. `left_error_wh`: energy left as believed at the end, less the true."""

    alt_amsl_m: float
    temperature_c: float
    home: bool
    delivered: bool
    wind_rmse_mps: float | None
    wind_nees: float | None
    p_home_at_go: float | None
    left_error_wh: float | None


def tasks(seeds: int, folder: Path, *, stated: bool) -> list[AirTask]:
    """Every flight, by place, autopilot and seed."""
    return [
        AirTask(alt_m, temperature_c, stated, autopilot, seed, str(folder))
        for alt_m, temperature_c, autopilot, seed in product(
            HEIGHTS_M, TEMPERATURES_C, AUTOPILOTS, range(1, 1 + seeds)
        )
    ]


def fly_in_air(task: AirTask) -> AirRow:
    """Fly one and judge it."""
    said = "stated" if task.stated else "measured"
    place = f"{task.alt_amsl_m:.0f}m{task.temperature_c:.0f}C"
    folder = Path(task.folder) / f"{place}-{said}-{task.autopilot}-{task.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    options = FlyOptions(
        flight_file=_write_flight(task, folder),
        autopilot=task.autopilot,
        seed=task.seed,
        run_root=folder,
        picture=False,
        lockstep_limit_s=LOCKSTEP_LIMIT_S,
    )
    (row,) = fly(options)["flights"]
    believed_wh = _of(row["decisions"], "landed", "margin_wh")
    return AirRow(
        task.alt_amsl_m,
        task.temperature_c,
        row["home"],
        row["delivered"],
        row["wind_rmse_mps"],
        row["wind_nees"],
        _of(row["decisions"], "go", "p_home"),
        None if believed_wh is None else believed_wh - row["margin_wh"],
    )


def _write_flight(task: AirTask, folder: Path) -> Path:
    table = tomllib.loads((params_dir() / "flights" / "faults.toml").read_text())
    table["site"]["depot"]["alt_amsl_m"] = task.alt_amsl_m
    table["vehicle"]["temperature_c"] = task.temperature_c
    if task.stated:
        table["site"]["air_temperature_c"] = task.temperature_c
    path = folder / "flight.toml"
    path.write_bytes(msgspec.toml.encode(table))
    return path


def _of(decisions: list[dict[str, float]], kind: str, key: str) -> float | None:
    return next((d.get(key) for d in decisions if d["kind"] == kind), None)


def sheet(rows: list[AirRow], seeds: int, *, stated: bool) -> Sheet:
    """One line for each place."""
    groups: dict[tuple[float, float], list[AirRow]] = {}
    for row in rows:
        groups.setdefault((row.alt_amsl_m, row.temperature_c), []).append(row)
    how = (
        "The flight file states the air's temperature."
        if stated
        else "The air's temperature is the barometer's own, less a board's usual warmth; how warm"
        " the board is, the world draws."
    )
    return Sheet(
        "Flights from sea level to 3,000 m, in frost and heat",
        ("depot m", "air C", "kg/m3", "home", "delivered", "wind RMSE m/s",
         "NEES", "P(home) at go", "energy left, believed less true, Wh"),
        [_line(*place, group) for place, group in groups.items()],
        f"Both autopilots, seeds 1 to {seeds}, air and pack at one temperature; ideal NEES is 2."
        f" {how} Least P(home), means of the rest.",
    )  # fmt: skip


def _line(alt_m: float, temperature_c: float, rows: list[AirRow]) -> list[str]:
    return [
        f"{alt_m:.0f}",
        f"{temperature_c:.0f}",
        f"{air_density_kgpm3(alt_m, temperature_c):.3f}",
        f"{sum(row.home for row in rows)} of {len(rows)}",
        f"{sum(row.delivered for row in rows)} of {len(rows)}",
        _mean([row.wind_rmse_mps for row in rows], 2),
        _mean([row.wind_nees for row in rows], 1),
        _least([row.p_home_at_go for row in rows]),
        _mean([row.left_error_wh for row in rows], 1),
    ]


def _mean(values: list[float | None], digits: int) -> str:
    known = [value for value in values if value is not None]
    return f"{statistics.fmean(known):.{digits}f}" if known else "-"


def _least(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{min(known):.4f}" if known else "-"
