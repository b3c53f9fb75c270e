"""Read the companion's MCAP decision log as a recorded flight."""

from pathlib import Path

import msgspec

from companion.adapters.logs.decision_log import EVENT_OF_TOPIC, as_event_fields, read_mcap_rows
from companion.analysis.replay.recorded_flight import LogIssue, RecordedFlight
from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from companion.core.mission.events import AutopilotDetected, Event
from companion.core.vehicle.airframe import MULTIROTOR


def read_mcap_log(path: Path) -> RecordedFlight:
    """Read the received telemetry; LeewayError if the log has none."""
    events: list[Event] = []
    autopilot: AutopilotDetected | None = None
    findings: list[LogIssue] = []
    topics: set[str] = set()
    log = read_mcap_rows(path)
    if log.error_text:
        findings.append(LogIssue("file", log.error_text, "whole messages are used"))
    for topic, row in log.rows:
        topics.add(topic)
        kind = EVENT_OF_TOPIC.get(topic)
        if kind is None:
            continue
        try:
            event = msgspec.convert(as_event_fields(topic, row), kind)
        except msgspec.ValidationError as error:
            findings.append(LogIssue(f"topic {topic}", safe_text(str(error)), "discarded"))
            continue
        if isinstance(event, AutopilotDetected):
            autopilot = event
        else:
            events.append(event)
    if not events:
        seen = safe_text(", ".join(sorted(topics))) or "none"
        raise LeewayError(
            f"{path}: topics heard_attitude, heard_position ... expected, found {seen};"
            " replay stream.tlog from the same folder instead"
        )
    events.sort(key=lambda event: event.t_s)
    return RecordedFlight(
        source="mcap",
        events=tuple(events),
        findings=tuple(findings),
        autopilot_kind=autopilot.autopilot_kind if autopilot is not None else None,
        vehicle=MULTIROTOR,
        utc_at_zero_s=log.utc_at_zero_s,
    )
