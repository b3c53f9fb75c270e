"""Service monitor of a vehicle: read before a flight, updated after it."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from companion.adapters.clock import unix_time_us
from companion.adapters.files.monitor_file import (
    copy_damaged_record,
    read_service_record,
    service_record_path,
    write_service_record,
)
from companion.core.base.errors import LeewayError
from companion.core.certificate.certificate import airframe_digest
from companion.core.mission.actions import Finished
from companion.core.monitor.corrections import MonitorCorrections, monitor_corrections_for_pack
from companion.core.monitor.promises import DRAW
from companion.core.monitor.record import UNNAMED, ServiceRecord
from companion.core.monitor.service import (
    log_e_value,
    new_service_record,
    reset_evidence_of_subject,
    service_record_with_flight,
)
from companion.core.vehicle.airframe import Airframe

Write = Callable[[Callable[[], None]], None]


@dataclass(slots=True)
class MonitorKeeper:
    """The service record of one vehicle in memory, for one flight with one pack.

    `error_text` describes an error in the file. A record that cannot be read is replaced by a new
    one with the conservative prior of a lost record.
    """

    path: Path
    pack: str
    flight: str
    service: ServiceRecord
    error_text: str = ""
    epoch_s: Callable[[], float] = lambda: unix_time_us() / 1e6

    @classmethod
    def read_or_create(
        cls, folder: Path, vehicle: str, airframe: Airframe, pack_name: str, flight_digest: str
    ) -> "MonitorKeeper":
        """Read the record of earlier flights. `flight_digest` identifies this mission."""
        path = service_record_path(folder, _valid_file_name(vehicle or airframe.name))
        digest = airframe_digest(airframe)
        try:
            found = read_service_record(path)
        except LeewayError as error:
            lost = new_service_record(digest, earlier_evidence_lost=True)
            return cls(
                path, pack_name or UNNAMED, flight_digest, lost, f"monitor record reset: {error}"
            )
        service = found or new_service_record(digest, earlier_evidence_lost=False)
        keeper = cls(path, pack_name or UNNAMED, flight_digest, service)
        if service.airframe != digest:
            keeper._reset_draw_evidence(digest)
        return keeper

    @property
    def corrections(self) -> MonitorCorrections:
        """Findings that this flight must consider."""
        return monitor_corrections_for_pack(self.service, self.pack)

    def replace_damaged_record(self, run_write_job: Write) -> None:
        """Start the flight: move an unreadable file aside and write the new record, so that the
        next companion is equally conservative. `run_write_job` runs a function off the flight
        thread.
        """
        if not self.error_text:
            return
        path, service = self.path, self.service

        def copy_and_replace_record() -> None:
            if path.exists():
                copy_damaged_record(path)
            write_service_record(path, service)

        run_write_job(copy_and_replace_record)

    def record_flight_and_get_new_findings(
        self, finished: Finished, run_write_job: Write
    ) -> tuple[Finished, tuple[str, ...]]:
        """Count the finished flight; return it with the evidence, and new findings as text."""
        if finished.flight_statistics is None:
            return finished, ()
        before, name = self.service, f"{self.flight} {finished.takeoff_s}"
        after = service_record_with_flight(
            before, finished.flight_statistics, self.pack, name, self.epoch_s()
        )
        self.service, path = after, self.path
        run_write_job(lambda: write_service_record(path, after))
        new_findings = (
            ()
            if _alarm_flight_by_quantity(after) == _alarm_flight_by_quantity(before)
            else monitor_corrections_for_pack(after, self.pack).findings
        )
        return replace(finished, evidence_nats=log_e_value(after.draw, DRAW)), new_findings

    def format_log_line(self, finished: Finished) -> str:
        """Return the log line of the counted flight."""
        seen = finished.flight_statistics
        if seen is None:
            return "monitor: flight not counted, no take-off"
        draw = "unknown" if seen.draw is None else f"{math.exp(seen.draw.value):.3f} of the model's"
        charge_text = (
            "unknown" if seen.pack is None else f"{math.exp(seen.pack.value):.3f} of the stated"
        )
        wind = f"{seen.wind_misses} of {seen.wind_checks} forecasts missed"
        return f"monitor: draw {draw}, charge per Wh of pack {self.pack} {charge_text}, {wind}"

    def _reset_draw_evidence(self, digest: str) -> None:
        """Reset the draw evidence: it refers to another airframe file."""
        reset_reason = "the airframe file has changed"
        reset_service = reset_evidence_of_subject(
            self.service, DRAW, "companion", reset_reason, self.epoch_s()
        )
        self.service = msgspec.structs.replace(reset_service, airframe=digest)


def _alarm_flight_by_quantity(service: ServiceRecord) -> list[object]:
    packs = [(name, kept.alarm_flight) for name, kept in service.packs.items()]
    return [service.draw.alarm_flight, service.wind.alarm_flight, *packs]


def _valid_file_name(vehicle: str) -> str:
    """Replace characters that a file name does not allow."""
    return re.sub(r"[^A-Za-z0-9._-]", "-", vehicle)[:64].lstrip(".") or "vehicle"
