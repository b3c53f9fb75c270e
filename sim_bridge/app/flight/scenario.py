"""The simulator's half of a flight file: the true wind and the faults, checked on reading."""

from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from companion.core.base.errors import LeewayError, check_range
from companion.core.mission.flight_file import Flight
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.wind_field import MeanWind
from sim_bridge.truth.wind_log import WindLog, load_wind_log
from sim_bridge.truth.wind_params import WindParams, mean_wind, parse_wind

FaultKind = Literal[
    "link_silent",
    "companion_kill",
    "companion_stall",
    "disk_full",
    "autopilot_reboot",
    "gnss_lost",
    "pilot_takes_over",
    "ground_takes_over",
    "release_fails",
    "pitot_stuck",
    "attitude_wrong",
    "bad_link",
    "forger",
    "clock_jump",
    "jumps_refused",
    "arming_refused",
    "home_moves",
]
Phase = Literal["start", "climb", "outbound", "drop", "return", "landing"]


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One thing that goes wrong, once."""

    kind: FaultKind
    """What goes wrong."""
    at_s: float = 0.0
    """When: after take-off, or after `phase` began."""
    phase: Phase | None = None
    """Count `at_s` from the beginning of this phase."""
    duration_s: float = 0.0
    """How long it lasts; 0: for good."""
    by_s: float = 0.0
    """How far the clock jumps (back where it is negative)."""
    to: str = ""
    """The stop that the home moves to: its operator asks for it until it is taken."""
    restart: bool = True
    """A killed companion is started again after `duration_s`; a stalled one goes on in any case."""
    vehicle: int = 1
    """Which vehicle of the flight, from 1."""

    def __post_init__(self) -> None:
        check_range("faults.at_s", self.at_s, 0.0, 1e6)
        check_range("faults.duration_s", self.duration_s, 0.0, 1e6)
        check_range("faults.by_s", self.by_s, -1e4, 1e4)
        check_range("faults.vehicle", self.vehicle, 1, 250)


def read_wind(
    flight: Flight, where: Path, rng: np.random.Generator, wind_log: Path | None = None
) -> tuple[WindParams, MeanWind]:
    """The true wind: the flight file's table, or `wind_log` in its place.

    A recording starts at the table's `start_s`; where that is a range [first, last], or where
    nothing is said, the start is drawn so that the mission's time limit fits into the recording.
    """
    table: dict[str, Any] = dict(flight.wind)
    if wind_log is not None:
        table = {"kind": "log", "log": str(wind_log.absolute())}
    start = table.get("start_s")
    if isinstance(start, list) and (len(start) != 2 or not start[0] <= start[1]):
        raise LeewayError(f"{where}: wind.start_s = {start}: expected seconds, or [first, last]")
    try:
        if table.get("kind") == "log" and not isinstance(start, int | float):
            table["start_s"] = 0.0
            params = parse_wind(table)
            log = load_wind_log(where.parent / table["log"])
            first, last = start or _start_range(log, flight.mission.time_limit_s)
            table["start_s"] = float(rng.uniform(first, last))
        params = parse_wind(table)
        return params, mean_wind(params, where.parent)
    except (TruthError, TypeError, ValueError) as e:
        raise LeewayError(f"{where}: {e}") from e


def _start_range(log: WindLog, need_s: float) -> tuple[float, float]:
    first, last = log.t_s[0], log.t_s[-1] - need_s
    return first, max(last, first)


def read_faults(flight: Flight, where: Path) -> list[Fault]:
    """The flight file's faults in order of their time."""
    faults = [_convert(f, Fault, f"{where}: faults[{k}]") for k, f in enumerate(flight.faults)]
    stops = [stop.name for stop in flight.site.stops]
    for number, fault in enumerate(faults):
        if fault.kind == "home_moves" and fault.to not in stops:
            key = f"faults[{number}].to = {fault.to!r}"
            raise LeewayError(f"{where}: {key}: expected the name of one of site.stops")
    return sorted(faults, key=lambda f: f.at_s)


def _convert(value: Any, kind: Any, where: str) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as e:
        raise LeewayError(f"{where}: {e}") from e
