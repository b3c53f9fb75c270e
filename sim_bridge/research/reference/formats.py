"""File and message formats that have a schema, with valid examples."""

import tomllib
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.files.params import params_dir
from companion.core.certificate.certificate import Certificate
from companion.core.mission.flight_file import Flight
from companion.core.separation.track import Track
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.shared_winds import SharedWinds
from companion.fleet.messages import Command, FleetEvent, Result, State
from companion.fleet.roster import Roster
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.schema.day import Day
from ground_station.core.schema.day_plan import DayPlan
from sim_bridge.app.flight.scenario import Fault
from sim_bridge.research.planners.scenario import Scenario
from sim_bridge.research.reference.json_schema import Format
from sim_bridge.truth.fields.field_file import WindFieldParams
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.wind_params import LogWindParams, WindParams

FOLDERS = {
    "airframes": Airframe,
    "days": Day,
    "fields": WindFieldParams,
    "flights": Flight,
    "truth": AirframeTruth,
    "wind": WindProcessParams,
}
"""Folders of params, and the structures that decode their TOML files."""

WITHOUT_SCHEMA = {
    "autopilots": "autopilot-parameters/1: an autopilot's own names, as many as it has",
    "policies": "policy/1: written by `sim-bridge research train-avoid --export` only",
}
"""Folders of params whose files are not written by hand, and why they have no schema."""


def shipped_toml_files(folder: str) -> list[Path]:
    """Return the TOML files of a folder of params."""
    return sorted((params_dir() / folder).glob("*.toml"))


def list_file_formats() -> tuple[Format, ...]:
    """Return all formats, in the order of the reference."""
    tables = map(_read_toml_table, shipped_toml_files("flights"))
    winds = [msgspec.convert(table["wind"], WindParams) for table in tables if "wind" in table]
    faults = (Fault(kind="companion_kill"),)
    return (
        Format(
            "flight/1",
            Flight,
            (*_read_shipped_structs("flights"), *winds, LogWindParams(log="x.csv"), *faults),
            {
                "Flight.wind": WindParams,
                "Flight.faults": list[Fault],
                "LogWindParams.start_s": float | tuple[float, float] | None,
            },
        ),
        Format("airframe/1", Airframe, _read_shipped_structs("airframes")),
        Format("certificate/2", Certificate),
        Format("wind-process/1", WindProcessParams, _read_shipped_structs("wind")),
        Format("wind-field/1", WindFieldParams, _read_shipped_structs("fields")),
        Format("day/1", Day, _read_shipped_structs("days")),
        Format("day-plan/1", DayPlan, _read_shipped_structs("days")),
        Format("roster/1", Roster),
        Format("truth/1", AirframeTruth, _read_shipped_structs("truth")),
        Format("delivery-scenario/1", Scenario),
        Format("message state", State),
        Format("message event", FleetEvent),
        Format("message command", Command),
        Format("message result", Result),
        Format("message track", Track),
        Format("message station", StationWind),
        Format("message winds", SharedWinds),
    )


def _read_shipped_structs(folder: str) -> tuple[msgspec.Struct, ...]:
    return tuple(
        msgspec.convert(_read_toml_table(path), FOLDERS[folder])
        for path in shipped_toml_files(folder)
    )


def _read_toml_table(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))
