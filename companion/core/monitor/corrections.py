"""Corrections of a flight's model parameters while the monitor has an active alarm."""

import math

import msgspec
import numpy as np

from companion.core.monitor.promises import DRAW, PACK
from companion.core.monitor.record import ServiceRecord, StoredEvidence
from companion.core.monitor.service import shift_test_of_promise

ELLIPSE_CHI2 = 5.991
"""95 % quantile of chi-square with two degrees of freedom, whose tail is exp(-x / 2)."""

MOST_WIND_VARIANCE = 9.0
"""Limit of the wind variance factor: three times the wind std stops nearly every flight."""

ASSUMED_DRAW_LOG, ASSUMED_CAPACITY_FRAC = math.log(1.10), 0.8
"""Conservative assumption after lost evidence: changes that the monitor detects reliably."""

LEAST_CAPACITY_FRAC = 0.3
"""Lower limit, as of `battery_health_frac` in a flight file."""


class MonitorCorrections(msgspec.Struct, frozen=True, kw_only=True):
    """Corrections from the monitor. The defaults change nothing."""

    draw_log: float = 0.0
    """Mean log of the draw over the model's."""
    draw_std: float = 0.0
    """Standard deviation of `draw_log`, in addition to the airframe file's."""
    capacity_frac: float = 1.0
    """Factor on the pack's stated capacity."""
    wind_variance: float = 1.0
    """Factor on the variance of the wind process."""
    findings: tuple[str, ...] = ()
    """Messages for the operator: alarm, its flight, and how to clear it."""

    @property
    def prefixed_findings(self) -> tuple[str, ...]:
        """Messages prefixed with their source."""
        return tuple(f"model monitor: {message}" for message in self.findings)


NO_CORRECTIONS = MonitorCorrections()


def monitor_corrections_for_pack(
    service_record: ServiceRecord, pack_name: str
) -> MonitorCorrections:
    """Return the corrections for the next flight with this pack.

    The draw's mean and standard deviation are those since its change
    (`ShiftTest.mean_and_std_since_change`). Capacity is one standard deviation below its mean. No
    correction improves on the stated values.
    """
    lost = service_record.lost_left > 0
    draw_log, draw_std = _log_ratio_mean_std_if_alarm(service_record.draw, DRAW)
    kept = service_record.packs.get(pack_name) or StoredEvidence()
    return MonitorCorrections(
        draw_log=max(draw_log, ASSUMED_DRAW_LOG) if lost else draw_log,
        draw_std=draw_std,
        capacity_frac=min(_cautious_capacity_frac(kept), ASSUMED_CAPACITY_FRAC if lost else 1.0),
        wind_variance=_wind_variance_factor(service_record.wind),
        findings=tuple(_finding_texts(service_record, pack_name, kept)),
    )


def _finding_texts(
    service_record: ServiceRecord, pack_name: str, pack_evidence: StoredEvidence
) -> list[str]:
    messages: list[str] = []
    if service_record.lost_left > 0:
        messages.append(
            "service record lost; assumes draw +10 % and pack 80 % for"
            f" {service_record.lost_left} flights; to clear: companion monitor reset lost"
        )
    if service_record.draw.alarm_flight is not None:
        mean, std = _log_ratio_mean_std_if_alarm(service_record.draw, DRAW)
        messages.append(
            f"draw is {math.exp(mean):.2f} +- {std:.2f} of the model's, found at flight"
            f" {service_record.draw.alarm_flight}; to clear: check motors and propellers,"
            " calibrate, companion monitor reset draw"
        )
    if pack_evidence.alarm_flight is not None:
        messages.append(
            f"pack {pack_name} has {100.0 * _cautious_capacity_frac(pack_evidence):.0f} % of its"
            f" stated capacity, found at flight {pack_evidence.alarm_flight}; to clear: fly"
            f" another pack, or companion monitor reset {pack_name}"
        )
    if service_record.wind.alarm_flight is not None:
        times = math.sqrt(_wind_variance_factor(service_record.wind))
        messages.append(
            f"wind varies {times:.1f} times as much as the wind process, found at flight"
            f" {service_record.wind.alarm_flight}; to clear: fit-wind, companion monitor reset wind"
        )
    return messages


def _log_ratio_mean_std_if_alarm(
    stored_evidence: StoredEvidence, promise: str
) -> tuple[float, float]:
    """Return (mean, std) on the next day of a subject in alarm; (0, 0) without an alarm."""
    if stored_evidence.alarm_flight is None:
        return 0.0, 0.0
    precision, score = np.array(stored_evidence.days).T
    mean, std = shift_test_of_promise(promise).mean_and_std_since_change(precision, score)
    return max(float(mean), 0.0), float(std)


def _cautious_capacity_frac(stored_evidence: StoredEvidence) -> float:
    mean, std = _log_ratio_mean_std_if_alarm(stored_evidence, PACK)
    return min(max(math.exp(-mean - std), LEAST_CAPACITY_FRAC), 1.0)


def _wind_variance_factor(stored_evidence: StoredEvidence) -> float:
    """Return the variance factor with which 5 % of the checks would fail: a two-dimensional normal
    of variance f is outside the ellipse with probability exp(-chi2 / (2 f)).
    """
    if stored_evidence.alarm_flight is None:
        return 1.0
    checks, failed = np.array(stored_evidence.days).sum(axis=0)
    share = min(max(float(failed / checks), 0.05), 0.95)
    return min(ELLIPSE_CHI2 / (-2.0 * math.log(share)), MOST_WIND_VARIANCE)
