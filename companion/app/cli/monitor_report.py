"""Text report of a vehicle's service record."""

import math

from companion.adapters.clock import format_unix_time_us
from companion.core.base.safe_text import safe_text
from companion.core.monitor.corrections import monitor_corrections_for_pack
from companion.core.monitor.promises import DRAW, PACK, WIND, alarm_log_e_threshold
from companion.core.monitor.record import ServiceRecord, StoredEvidence
from companion.core.monitor.service import log_e_value


def service_report_lines(vehicle: str, service: ServiceRecord) -> list[str]:
    """Return lines on flights, evidence per quantity, alarms and resets."""
    lines = [f"{vehicle}: {service.flights} flights on {service.day} days"]
    lines += [
        _evidence_line("draw", service.draw, DRAW),
        _evidence_line("wind", service.wind, WIND),
    ]
    lines += [_evidence_line(f"pack {name}", kept, PACK) for name, kept in service.packs.items()]
    notices = [
        words
        for pack in [*service.packs, ""]
        for words in monitor_corrections_for_pack(service, pack).prefixed_findings
    ]
    lines += [safe_text(words) for words in dict.fromkeys(notices)] or ["nothing is in doubt"]
    lines += [
        safe_text(
            f"{format_unix_time_us(int(reset.epoch_s * 1e6))}: {reset.subject} reset after flight"
            f" {reset.flights} by {reset.by}: {reset.reason}"
        )
        for reset in service.resets
    ]
    return lines


def _evidence_line(name: str, stored_evidence: StoredEvidence, monitored_quantity: str) -> str:
    """Return the e-value as a factor (1: no evidence) with the alarm threshold."""
    factor = math.exp(min(log_e_value(stored_evidence, monitored_quantity), 100.0))
    alarm = math.exp(alarm_log_e_threshold(monitored_quantity, stored_evidence.order))
    label = "ALARM" if stored_evidence.alarm_flight is not None else "ok   "
    return (
        f"{label}  {name}: {stored_evidence.flights} flights, evidence {factor:.3g} (alarm at"
        f" {alarm:.0f})"
    )
