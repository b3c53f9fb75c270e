"""Our own MCAP: what the companion heard, written at each tick as it was judged, and read back."""

from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.logs.decision_log import read_rows
from companion.core.base.errors import LeewayError
from companion.core.mission.events import (
    Airspeed,
    Attitude,
    AutopilotWind,
    Battery,
    Event,
    GnssFix,
    GroundState,
    Home,
    Identified,
    MissionProgress,
    Position,
    Throttle,
    VehicleState,
)
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.replay.recorded_flight import MULTIROTOR, LogFinding, RecordedFlight

HEARD: dict[str, tuple[str, type[Event]]] = {
    "state": ("heard_state", VehicleState),
    "ground": ("heard_ground", GroundState),
    "attitude": ("heard_attitude", Attitude),
    "position": ("heard_position", Position),
    "gnss": ("heard_gnss", GnssFix),
    "home": ("heard_home", Home),
    "battery": ("heard_battery", Battery),
    "throttle": ("heard_throttle", Throttle),
    "airspeed": ("heard_airspeed", Airspeed),
    "wind": ("heard_wind", AutopilotWind),
    "progress": ("heard_progress", MissionProgress),
}
"""Part of the situation: the topic that it is recorded on, and its event."""

IDENTIFIED = "heard_autopilot"
KINDS = dict(HEARD.values()) | {IDENTIFIED: Identified}


class HeardRows:
    """Tells what is new in the situation since the last time, as rows for the decision log."""

    def __init__(self) -> None:
        self._last: dict[str, Event] = {}

    def new(self, now: TelemetryState) -> list[tuple[str, dict[str, Any]]]:
        """Return (topic, row) of every sample that came since the last call."""
        rows: list[tuple[str, dict[str, Any]]] = []
        for name, (topic, _) in HEARD.items():
            sample: Event | None = getattr(now, name)
            if sample is not None and sample is not self._last.get(name):
                self._last[name] = sample
                rows.append((topic, msgspec.to_builtins(sample)))
        return rows


def read_mcap_log(path: Path) -> RecordedFlight:
    """Read what a companion heard; LeewayError where it did not record that."""
    events: list[Event] = []
    identified: Identified | None = None
    findings: list[LogFinding] = []
    topics: set[str] = set()
    for topic, row in read_rows(path):
        topics.add(topic)
        kind = KINDS.get(topic)
        if kind is None:
            continue
        try:
            event = msgspec.convert(row, kind)
        except msgspec.ValidationError as error:
            findings.append(LogFinding(f"topic {topic}", str(error), "left out"))
            continue
        if isinstance(event, Identified):
            identified = event
        else:
            events.append(event)
    if not events:
        seen = ", ".join(sorted(topics)) or "none"
        raise LeewayError(
            f"{path}: topics heard_attitude, heard_position ... expected, found {seen};"
            " replay the stream.tlog beside it instead"
        )
    events.sort(key=lambda event: event.t_s)
    return RecordedFlight(
        source="mcap",
        events=tuple(events),
        findings=tuple(findings),
        flavour=identified.flavour if identified is not None else None,
        vehicle=MULTIROTOR,
    )
