"""Each sortie's mission as its companion would upload it, in other tools' formats."""

from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import mission_export
from companion.core.exports.formats import mission_text, texts_beside
from companion.core.exports.ground_plan import plan_on_the_ground
from companion.core.mission.flight_plan import FlightPlan
from ground_station.adapters.files.plan_files import write_text
from ground_station.core.dispatch.flight_tables import planned_flight
from ground_station.core.feasibility.reach import day_energy
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie


def write_missions(data: DayData, plan: DayPlan, folder: Path, file_format: ExportFormat) -> int:
    """Write a file for each sortie, named by its order, and what belongs beside it; how many
    sorties. LeewayError: one has no route.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LeewayError(f"{folder}: {error.strerror}") from error
    for sortie in plan.sorties:
        mission = mission_export(companion_plan(data, plan, sortie), sortie.order)
        text = mission_text(mission, file_format, "px4")
        write_text(folder / f"{sortie.order}{file_format.suffix}", text)
        for ending, more in texts_beside(mission, file_format).items():
            write_text(folder / f"{sortie.order}{ending}", more)
    return len(plan.sorties)


def companion_plan(data: DayData, plan: DayPlan, sortie: PlannedSortie) -> FlightPlan:
    """The sortie as its companion plans it on the ground, with a full pack and unknown wind."""
    flight = planned_flight(data, plan, sortie)
    airframe = data.airframes[flight.vehicle.airframe]
    try:
        return plan_on_the_ground(flight, day_energy(data.day, airframe), data.no_fly)
    except LeewayError as error:
        raise LeewayError(f"{sortie.vehicle} with {sortie.order}: {error}") from error
