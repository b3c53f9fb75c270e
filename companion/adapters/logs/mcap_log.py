"""Read our own MCAP decision log back as a recorded flight."""

from pathlib import Path

import msgspec

from companion.adapters.logs.decision_log import KINDS, as_event_fields, read_log
from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from companion.core.mission.events import Event, Identified
from companion.core.replay.recorded_flight import LogFinding, RecordedFlight
from companion.core.vehicle.airframe import MULTIROTOR


def read_mcap_log(path: Path) -> RecordedFlight:
    """Read what a companion heard; LeewayError where it did not record that."""
    events: list[Event] = []
    identified: Identified | None = None
    findings: list[LogFinding] = []
    topics: set[str] = set()
    log = read_log(path)
    if log.damage:
        findings.append(LogFinding("file", log.damage, "whole messages are used"))
    for topic, row in log.rows:
        topics.add(topic)
        kind = KINDS.get(topic)
        if kind is None:
            continue
        try:
            event = msgspec.convert(as_event_fields(topic, row), kind)
        except msgspec.ValidationError as error:
            findings.append(LogFinding(f"topic {topic}", safe_text(str(error)), "left out"))
            continue
        if isinstance(event, Identified):
            identified = event
        else:
            events.append(event)
    if not events:
        seen = safe_text(", ".join(sorted(topics))) or "none"
        raise LeewayError(
            f"{path}: topics heard_attitude, heard_position ... expected, found {seen};"
            " replay the stream.tlog beside it instead"
        )
    events.sort(key=lambda event: event.t_s)
    return RecordedFlight(
        source="mcap",
        events=tuple(events),
        findings=tuple(findings),
        autopilot_kind=identified.autopilot_kind if identified is not None else None,
        vehicle=MULTIROTOR,
        utc_at_zero_s=log.utc_at_zero_s,
    )
