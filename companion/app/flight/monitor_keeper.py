"""Keeps the monitor of a vehicle's service: read before a flight, gone on with at its end."""

import hashlib
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from companion.adapters.clock import epoch_us
from companion.adapters.files.monitor_file import (
    read_service,
    service_file,
    set_aside,
    write_service,
)
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Finished
from companion.core.monitor.doubts import Doubts, doubts_of
from companion.core.monitor.promises import DRAW
from companion.core.monitor.record import UNNAMED, Service
from companion.core.monitor.service import after_flight, begun_anew, log_e, reset
from companion.core.vehicle.airframe import Airframe

Write = Callable[[Callable[[], None]], None]


@dataclass(slots=True)
class MonitorKeeper:
    """The record of one vehicle in memory, for one flight with one pack.

    `trouble` is what was wrong with the file, in words. A record that could not be read begins
    anew, with the careful belief of one that was lost.
    """

    path: Path
    pack: str
    flight: str
    service: Service
    trouble: str = ""
    epoch_s: Callable[[], float] = lambda: epoch_us() / 1e6

    @classmethod
    def open(
        cls, folder: Path, vehicle: str, airframe: Airframe, pack: str, flight: str
    ) -> "MonitorKeeper":
        """Read what earlier flights found. `flight` tells this mission from others (a digest)."""
        path = service_file(folder, _file_name(vehicle or airframe.name))
        digest = hashlib.sha256(msgspec.json.encode(airframe)).hexdigest()[:16]
        try:
            found = read_service(path)
        except LeewayError as error:
            lost = begun_anew(digest, lost=True)
            return cls(path, pack or UNNAMED, flight, lost, f"monitor begins anew: {error}")
        service = found or begun_anew(digest, lost=False)
        keeper = cls(path, pack or UNNAMED, flight, service)
        if service.airframe != digest:
            keeper._promise_anew(digest)
        return keeper

    @property
    def doubts(self) -> Doubts:
        """What this flight is to believe."""
        return doubts_of(self.service, self.pack)

    def begin(self, write: Write) -> None:
        """The flight begins: a file that could not be read is put aside, and the lost record begun,
        so that the next companion is as careful. `write` runs a deed off the flight's thread.
        """
        if not self.trouble:
            return
        path, service = self.path, self.service

        def begin_anew() -> None:
            if path.exists():
                set_aside(path)
            write_service(path, service)

        write(begin_anew)

    def take(self, finished: Finished, write: Write) -> tuple[Finished, tuple[str, ...]]:
        """The flight is over: count it; its end with the evidence, and new doubts in words."""
        if finished.figures is None:
            return finished, ()
        before, name = self.service, f"{self.flight} {finished.took_off_s}"
        after = after_flight(before, finished.figures, self.pack, name, self.epoch_s())
        self.service, path = after, self.path
        write(lambda: write_service(path, after))
        new = () if _alarms(after) == _alarms(before) else doubts_of(after, self.pack).words
        return replace(finished, evidence_nats=log_e(after.draw, DRAW)), new

    def line(self, finished: Finished) -> str:
        """The flight as it was counted, for its log."""
        seen = finished.figures
        if seen is None:
            return "monitor: not counted, it never flew"
        draw = "unknown" if seen.draw is None else f"{math.exp(seen.draw.value):.3f} of the model's"
        fall = "unknown" if seen.pack is None else f"{math.exp(seen.pack.value):.3f} of the stated"
        wind = f"{seen.wind_misses} of {seen.wind_checks} forecasts missed"
        return f"monitor: draw {draw}, charge per Wh of pack {self.pack} {fall}, {wind}"

    def _promise_anew(self, digest: str) -> None:
        """Another airframe file promises another draw: the evidence was against the one before."""
        why = "the airframe file has changed"
        anew = reset(self.service, DRAW, "companion", why, self.epoch_s())
        self.service = msgspec.structs.replace(anew, airframe=digest)


def _alarms(service: Service) -> list[object]:
    packs = [(name, kept.alarm_flight) for name, kept in service.packs.items()]
    return [service.draw.alarm_flight, service.wind.alarm_flight, *packs]


def _file_name(vehicle: str) -> str:
    """A name as files allow it."""
    return re.sub(r"[^A-Za-z0-9._-]", "-", vehicle)[:64].lstrip(".") or "vehicle"
