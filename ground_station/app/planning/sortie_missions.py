"""Each sortie's mission as its companion would upload it, in other tools' formats."""

from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import build_mission_export
from companion.core.exports.formats import auxiliary_document_by_suffix, mission_document_text
from companion.core.exports.ground_plan import plan_flight_without_vehicle
from companion.core.mission.flight_plan import FlightPlan
from ground_station.adapters.files.atomic_file import write_file_atomically
from ground_station.core.dispatch.flight_tables import flight_from_planned_sortie
from ground_station.core.feasibility.reach import route_energy_model_for_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie


def write_missions(data: DayData, plan: DayPlan, folder: Path, file_format: ExportFormat) -> int:
    """Write a file for each sortie, named by its order, and its companion files; return the number
    of sorties. LeewayError: a sortie has no route.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LeewayError(f"{folder}: {error.strerror}") from error
    for sortie in plan.sorties:
        mission = build_mission_export(plan_sortie_as_companion(data, plan, sortie), sortie.order)
        text = mission_document_text(mission, file_format, "px4")
        write_file_atomically(folder / f"{sortie.order}{file_format.suffix}", text.encode())
        for ending, more in auxiliary_document_by_suffix(mission, file_format).items():
            write_file_atomically(folder / f"{sortie.order}{ending}", more.encode())
    return len(plan.sorties)


def plan_sortie_as_companion(data: DayData, plan: DayPlan, sortie: PlannedSortie) -> FlightPlan:
    """Return the plan of a sortie's companion on the ground, with a full pack and unknown wind."""
    flight = flight_from_planned_sortie(data, plan, sortie)
    airframe = data.airframes[flight.vehicle.airframe]
    try:
        return plan_flight_without_vehicle(
            flight, route_energy_model_for_day(data.day, airframe), data.no_fly
        )
    except LeewayError as error:
        raise LeewayError(f"{sortie.vehicle} with {sortie.order}: {error}") from error
