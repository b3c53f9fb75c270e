"""Every file and message that has a schema, with examples of it that are valid."""

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
"""Folders of params, and what reads the TOML files in them."""

WITHOUT_SCHEMA = {
    "autopilots": "autopilot-parameters/1: an autopilot's own names, as many as it has",
    "policies": "policy/1: written by `sim-bridge research export-avoid`, and by nobody else",
}
"""Folders of params whose files people do not write, and why they have no schema."""


def shipped(folder: str) -> list[Path]:
    """The TOML files of a folder of params."""
    return sorted((params_dir() / folder).glob("*.toml"))


def formats() -> tuple[Format, ...]:
    """All of them, in the order of the reference."""
    winds = tuple(_winds())
    faults = (Fault(kind="companion_kill"),)
    return (
        Format(
            "flight/1",
            Flight,
            (*_read("flights"), *winds, *faults),
            {
                "Flight.wind": WindParams,
                "Flight.faults": list[Fault],
                "LogWindParams.start_s": float | tuple[float, float] | None,
            },
        ),
        Format("airframe/1", Airframe, _read("airframes")),
        Format("certificate/2", Certificate),
        Format("wind-process/1", WindProcessParams, _read("wind")),
        Format("wind-field/1", WindFieldParams, _read("fields")),
        Format("day/1", Day, _read("days")),
        Format("day-plan/1", DayPlan, _read("days")),
        Format("roster/1", Roster),
        Format("truth/1", AirframeTruth, _read("truth")),
        Format("delivery-scenario/1", Scenario),
        Format("message state", State),
        Format("message event", FleetEvent),
        Format("message command", Command),
        Format("message result", Result),
        Format("message track", Track),
        Format("message station", StationWind),
        Format("message winds", SharedWinds),
    )


def _read(folder: str) -> tuple[msgspec.Struct, ...]:
    return tuple(msgspec.convert(_table(path), FOLDERS[folder]) for path in shipped(folder))


def _winds() -> list[Any]:
    tables = [table["wind"] for path in shipped("flights") if "wind" in (table := _table(path))]
    return [*(msgspec.convert(table, WindParams) for table in tables), LogWindParams(log="x.csv")]


def _table(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))
