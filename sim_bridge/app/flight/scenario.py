"""Simulator part of a flight file: true wind and faults, validated on reading."""

from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from companion.core.base.errors import LeewayError, check_range
from companion.core.mission.flight_file import Flight
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.wind_field import MeanWind
from sim_bridge.truth.wind_log import WindLog, load_wind_log
from sim_bridge.truth.wind_params import WindParams, build_mean_wind, parse_wind

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
PhaseInFile = Literal["start", "climb", "outbound", "drop", "return", "landing"]


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One fault, which occurs once."""

    kind: FaultKind
    """Kind of the fault."""
    at_s: float = 0.0
    """Start time, in seconds after take-off or after the start of `phase`."""
    phase: PhaseInFile | None = None
    """Count `at_s` from the start of this phase."""
    duration_s: float = 0.0
    """Duration; 0: permanent."""
    by_s: float = 0.0
    """Size of the clock jump; negative: backwards."""
    to: str = ""
    """Stop that becomes the new home; the operator repeats the request until it is accepted."""
    restart: bool = True
    """Restart a killed companion after `duration_s`. A stalled one always resumes."""
    vehicle: int = 1
    """Number of the vehicle, from 1."""

    def __post_init__(self) -> None:
        check_range("faults.at_s", self.at_s, 0.0, 1e6)
        check_range("faults.duration_s", self.duration_s, 0.0, 1e6)
        check_range("faults.by_s", self.by_s, -1e4, 1e4)
        check_range("faults.vehicle", self.vehicle, 1, 250)


def read_or_draw_true_wind(
    flight: Flight, flight_file: Path, rng: np.random.Generator, wind_log: Path | None = None
) -> tuple[WindParams, MeanWind]:
    """Return the true wind from the flight file's table or, if given, from `wind_log`.

    A recording starts at the table's `start_s`. If that is a range [first, last], the start is
    drawn from it; without it, from all starts at which the mission's time limit fits.
    """
    table: dict[str, Any] = dict(flight.wind)
    if wind_log is not None:
        table = {"kind": "log", "log": str(wind_log.absolute())}
    start = table.get("start_s")
    if isinstance(start, list) and (len(start) != 2 or not start[0] <= start[1]):
        raise LeewayError(
            f"{flight_file}: wind.start_s = {start}: expected seconds, or [first, last]"
        )
    try:
        if table.get("kind") == "log" and not isinstance(start, int | float):
            table["start_s"] = 0.0
            params = parse_wind(table)
            log = load_wind_log(flight_file.parent / table["log"])
            first, last = start or _recording_start_range_s(log, flight.mission.time_limit_s)
            table["start_s"] = float(rng.uniform(first, last))
        params = parse_wind(table)
        return params, build_mean_wind(params, flight_file.parent)
    except (TruthError, TypeError, ValueError) as e:
        raise LeewayError(f"{flight_file}: {e}") from e


def _recording_start_range_s(log: WindLog, needed_duration_s: float) -> tuple[float, float]:
    first, last = log.t_s[0], log.t_s[-1] - needed_duration_s
    return first, max(last, first)


def read_faults(flight: Flight, flight_file: Path) -> list[Fault]:
    """Return the faults of the flight file, sorted by time."""
    faults = [
        _convert(f, Fault, f"{flight_file}: faults[{k}]") for k, f in enumerate(flight.faults)
    ]
    stops = [stop.name for stop in flight.site.stops]
    for number, fault in enumerate(faults):
        if fault.kind == "home_moves" and fault.to not in stops:
            key = f"faults[{number}].to = {fault.to!r}"
            raise LeewayError(f"{flight_file}: {key}: expected a name from site.stops")
    return sorted(faults, key=lambda f: f.at_s)


def _convert(value: Any, target_type: Any, location_text: str) -> Any:
    try:
        return msgspec.convert(value, target_type)
    except msgspec.ValidationError as e:
        raise LeewayError(f"{location_text}: {e}") from e
