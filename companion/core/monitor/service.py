"""Updates of a service record: add a flight, raise an alarm, reset a subject."""

import math

import numpy as np
from msgspec.structs import replace

from companion.core.base.errors import LeewayError
from companion.core.monitor.e_process import Evidence, ShareTest, ShiftTest
from companion.core.monitor.flight_evidence import FlightEvidence, LogRatio
from companion.core.monitor.promises import (
    DRAW,
    DRAW_TEST,
    PACK,
    PACK_TEST,
    WIND,
    WIND_TEST,
    alarm_log_e_threshold,
)
from companion.core.monitor.record import Reset, ServiceRecord, StoredEvidence

LOST = "lost"
"""Subject of the reset that ends the conservative assumptions after a lost record."""

LOST_FLIGHTS = 20
"""Flights with conservative assumptions after evidence, possibly with an alarm, was lost. A draw
that is 10 % higher is detected within this number of flights (docs/results/promise.md)."""

MAX_ESTIMATE_DAYS = 60
"""Maximum number of days in an estimate."""

DAY_GAP_S, DAY_S = 6 * 3600.0, 24 * 3600.0
"""A new day starts after a pause of `DAY_GAP_S`, or `DAY_S` after the start of the last day. A
clock that jumps back starts none: too few days only weaken the evidence."""


def new_service_record(airframe_digest: str, *, earlier_evidence_lost: bool) -> ServiceRecord:
    """Return a service without evidence. `earlier_evidence_lost`: perhaps with an alarm."""
    return ServiceRecord(
        airframe=airframe_digest, lost_left=LOST_FLIGHTS if earlier_evidence_lost else 0
    )


def service_record_with_flight(
    service_record: ServiceRecord,
    flight_evidence: FlightEvidence,
    pack_name: str,
    flight_name: str,
    epoch_s: float,
) -> ServiceRecord:
    """Return the service with one more flight. A repeated `flight_name` is ignored."""
    if flight_name == service_record.last_flight:
        return service_record
    service_record = replace(
        _start_day_if_due(service_record, epoch_s),
        flights=service_record.flights + 1,
        last_flight=flight_name,
        lost_left=max(service_record.lost_left - 1, 0),
    )
    draw, wind, packs = service_record.draw, service_record.wind, service_record.packs
    if flight_evidence.draw is not None and flight_evidence.draw.is_usable:
        draw = _add_log_ratio(service_record, DRAW, draw, flight_evidence.draw)
    if flight_evidence.pack is not None and flight_evidence.pack.is_usable:
        known = packs.get(pack_name) or StoredEvidence(order=len(packs) + 1)
        packs = packs | {
            pack_name: _add_log_ratio(service_record, PACK, known, flight_evidence.pack)
        }
    if (
        0 <= flight_evidence.wind_misses <= flight_evidence.wind_checks
        and flight_evidence.wind_checks > 0
    ):
        wind = _add_wind_checks(
            service_record, wind, flight_evidence.wind_misses, flight_evidence.wind_checks
        )
    return replace(service_record, draw=draw, wind=wind, packs=packs)


def reset_evidence_of_subject(
    service_record: ServiceRecord, subject: str, operator_name: str, reason: str, epoch_s: float
) -> ServiceRecord:
    """Return the service with one subject's evidence reset, and a record of the reset.

    `subject`: `draw`, `wind`, `lost` (conservative assumptions after lost evidence) or a
    pack's name. Raises LeewayError for any other.
    """
    note = Reset(
        subject=subject,
        by=operator_name,
        reason=reason,
        epoch_s=epoch_s,
        flights=service_record.flights,
    )
    service_record = replace(service_record, resets=[*service_record.resets, note])
    if subject == LOST:
        return replace(service_record, lost_left=0)
    if subject == DRAW:
        return replace(service_record, draw=StoredEvidence())
    if subject == WIND:
        return replace(service_record, wind=StoredEvidence())
    if subject not in service_record.packs:
        known = ", ".join([DRAW, WIND, LOST, *service_record.packs])
        raise LeewayError(f"{subject!r}: expected one of {known}")
    cleared = StoredEvidence(order=service_record.packs[subject].order)
    return replace(service_record, packs=service_record.packs | {subject: cleared})


def log_e_value(stored_evidence: StoredEvidence, promise: str) -> float:
    """Return the log of a subject's e-process; 0.0 before its first flight."""
    test = WIND_TEST if promise == WIND else shift_test_of_promise(promise)
    return float(test.log_e_value(_to_evidence(stored_evidence, test)))


def shift_test_of_promise(promise: str) -> ShiftTest:
    """Return the test of the draw or of a pack."""
    return DRAW_TEST if promise == DRAW else PACK_TEST


def _start_day_if_due(service_record: ServiceRecord, epoch_s: float) -> ServiceRecord:
    day_start_s, last_s = service_record.day_start_s, service_record.last_s
    night = last_s is None or epoch_s - last_s >= DAY_GAP_S
    if night or day_start_s is None or epoch_s - day_start_s >= DAY_S:
        return replace(
            service_record, day=service_record.day + 1, day_start_s=epoch_s, last_s=epoch_s
        )
    return replace(service_record, last_s=epoch_s)


def _add_log_ratio(
    service_record: ServiceRecord, promise: str, stored_evidence: StoredEvidence, measured: LogRatio
) -> StoredEvidence:
    test = shift_test_of_promise(promise)
    before = _evidence_today(service_record, stored_evidence, test)
    after = test.with_added_flight(before, measured.value, measured.std)
    precision = 1.0 / measured.std**2  # the estimate uses the value, the test the clipped one
    sums = precision, precision * (measured.value - test.tolerance)
    stored_evidence = _to_stored_evidence(service_record, stored_evidence, after, sums)
    return _record_alarm_if_reached(
        service_record, promise, stored_evidence, float(test.log_e_value(after))
    )


def _add_wind_checks(
    service_record: ServiceRecord,
    stored_evidence: StoredEvidence,
    failed_check_count: int,
    check_count: int,
) -> StoredEvidence:
    before = _evidence_today(service_record, stored_evidence, WIND_TEST)
    after = WIND_TEST.with_added_flight(before, failed_check_count, check_count)
    settled = float(WIND_TEST.log_e_value(before))
    stored_evidence = _to_stored_evidence(
        service_record, stored_evidence, after, (float(check_count), float(failed_check_count))
    )
    return _record_alarm_if_reached(service_record, WIND, stored_evidence, settled)


def _evidence_today(
    service_record: ServiceRecord, stored_evidence: StoredEvidence, test: ShiftTest | ShareTest
) -> Evidence:
    """Return the evidence, advanced to the current day of the service."""
    evidence = _to_evidence(stored_evidence, test)
    same = stored_evidence.day > 0 and stored_evidence.seen_day == service_record.day
    return evidence if same else test.start_next_day(evidence)


def _record_alarm_if_reached(
    service_record: ServiceRecord, promise: str, stored_evidence: StoredEvidence, log_e_now: float
) -> StoredEvidence:
    if stored_evidence.alarm_flight is not None or log_e_now < alarm_log_e_threshold(
        promise, stored_evidence.order
    ):
        return stored_evidence
    return replace(stored_evidence, alarm_flight=service_record.flights)


def _to_evidence(stored_evidence: StoredEvidence, test: ShiftTest | ShareTest) -> Evidence:
    if stored_evidence.day == 0:
        return test.initial_evidence()
    closed = [-math.inf if log is None else log for log in stored_evidence.log_closed]
    return Evidence(
        stored_evidence.day,
        np.array(closed),
        np.array(stored_evidence.information),
        np.array(stored_evidence.score),
    )


def _to_stored_evidence(
    service_record: ServiceRecord,
    previous_stored_evidence: StoredEvidence,
    evidence: Evidence,
    flight_sums: tuple[float, float],
) -> StoredEvidence:
    """Return the evidence as plain numbers, with the flight's sums added to those of its day."""
    days = previous_stored_evidence.days
    if evidence.day == previous_stored_evidence.day:
        first, second = days[-1]
        days, flight_sums = days[:-1], (first + flight_sums[0], second + flight_sums[1])
    closed = [None if math.isinf(log) else log for log in evidence.log_closed.tolist()]
    return replace(
        previous_stored_evidence,
        day=evidence.day,
        log_closed=closed,
        information=float(evidence.information),
        score=float(evidence.score),
        days=[*days, flight_sums][-MAX_ESTIMATE_DAYS:],
        flights=previous_stored_evidence.flights + 1,
        seen_day=service_record.day,
    )
