"""A service goes on: a flight is counted, an alarm comes, a person resets one."""

import math

import numpy as np
from msgspec.structs import replace

from companion.core.base.errors import LeewayError
from companion.core.monitor.e_process import Evidence, ShareTest, ShiftTest
from companion.core.monitor.figures import FlightFigures, LogRatio
from companion.core.monitor.promises import (
    DRAW,
    DRAW_TEST,
    PACK,
    PACK_TEST,
    WIND,
    WIND_TEST,
    threshold,
)
from companion.core.monitor.record import Kept, Reset, Service

LOST = "lost"
"""What is reset of a service whose record was lost: its careful belief."""

LOST_FLIGHTS = 20
"""After evidence was lost an alarm may have been among it. A draw that is 10 % higher is found
within so many flights (docs/results/monitor.md): then the careful belief has done its part."""

KEPT_DAYS = 60
"""Days that an estimate may go back: a season."""

DAY_GAP_S, DAY_S = 6 * 3600.0, 24 * 3600.0
"""A new day begins after a pause of a night, or a full day after the last began. A clock that leaps
back begins none: too few days only weaken the evidence."""


def begun_anew(airframe: str, *, lost: bool) -> Service:
    """A service without evidence. `lost`: there was some, and an alarm may have stood."""
    return Service(airframe=airframe, lost_left=LOST_FLIGHTS if lost else 0)


def after_flight(
    service: Service, figures: FlightFigures, pack: str, flight: str, epoch_s: float
) -> Service:
    """The service with one more flight, which counts once by its name `flight`."""
    if flight == service.last_flight:
        return service
    service = replace(
        _on_day(service, epoch_s),
        flights=service.flights + 1,
        last_flight=flight,
        lost_left=max(service.lost_left - 1, 0),
    )
    draw, wind, packs = service.draw, service.wind, service.packs
    if figures.draw is not None and figures.draw.is_usable:
        draw = _with_ratio(service, DRAW, draw, figures.draw)
    if figures.pack is not None and figures.pack.is_usable:
        known = packs.get(pack) or Kept(order=len(packs) + 1)
        packs = packs | {pack: _with_ratio(service, PACK, known, figures.pack)}
    if 0 <= figures.wind_misses <= figures.wind_checks and figures.wind_checks > 0:
        wind = _with_checks(service, wind, figures.wind_misses, figures.wind_checks)
    return replace(service, draw=draw, wind=wind, packs=packs)


def reset(service: Service, subject: str, by: str, why: str, epoch_s: float) -> Service:
    """The service with one subject's evidence begun anew, on record.

    `subject`: `draw`, `wind`, `lost` (the careful belief after lost evidence) or a pack's name.
    Raises LeewayError for any other.
    """
    note = Reset(subject=subject, by=by, why=why, epoch_s=epoch_s, flights=service.flights)
    service = replace(service, resets=[*service.resets, note])
    if subject == LOST:
        return replace(service, lost_left=0)
    if subject == DRAW:
        return replace(service, draw=Kept())
    if subject == WIND:
        return replace(service, wind=Kept())
    if subject not in service.packs:
        known = ", ".join([DRAW, WIND, LOST, *service.packs])
        raise LeewayError(f"{subject!r}: expected one of {known}")
    fresh = Kept(order=service.packs[subject].order)
    return replace(service, packs=service.packs | {subject: fresh})


def log_e(kept: Kept, promise: str) -> float:
    """Log of a subject's e-process; 0.0 before its first flight."""
    test = WIND_TEST if promise == WIND else shift_test(promise)
    return float(test.log_e(_evidence(kept, test)))


def shift_test(promise: str) -> ShiftTest:
    """The test of the draw or of a pack."""
    return DRAW_TEST if promise == DRAW else PACK_TEST


def _on_day(service: Service, epoch_s: float) -> Service:
    began_s, last_s = service.day_began_s, service.last_s
    night = last_s is None or epoch_s - last_s >= DAY_GAP_S
    if night or began_s is None or epoch_s - began_s >= DAY_S:
        return replace(service, day=service.day + 1, day_began_s=epoch_s, last_s=epoch_s)
    return replace(service, last_s=epoch_s)


def _with_ratio(service: Service, promise: str, kept: Kept, told: LogRatio) -> Kept:
    test = shift_test(promise)
    before = _today(service, kept, test)
    after = test.take(before, told.value, told.std)
    precision = 1.0 / told.std**2  # an estimate takes the value as it is, an alarm the capped one
    sums = precision, precision * (told.value - test.tolerance)
    kept = _kept(service, kept, after, sums)
    return _alarmed(service, promise, kept, float(test.log_e(after)))


def _with_checks(service: Service, kept: Kept, misses: int, checks: int) -> Kept:
    before = _today(service, kept, WIND_TEST)
    after = WIND_TEST.take(before, misses, checks)
    settled = float(WIND_TEST.log_e(before))
    kept = _kept(service, kept, after, (float(checks), float(misses)))
    return _alarmed(service, WIND, kept, settled)


def _today(service: Service, kept: Kept, test: ShiftTest | ShareTest) -> Evidence:
    """Its evidence on this day of the service."""
    evidence = _evidence(kept, test)
    same = kept.day > 0 and kept.seen_day == service.day
    return evidence if same else test.next_day(evidence)


def _alarmed(service: Service, promise: str, kept: Kept, log_e_now: float) -> Kept:
    if kept.alarm_flight is not None or log_e_now < threshold(promise, kept.order):
        return kept
    return replace(kept, alarm_flight=service.flights)


def _evidence(kept: Kept, test: ShiftTest | ShareTest) -> Evidence:
    if kept.day == 0:
        return test.none()
    closed = [-math.inf if log is None else log for log in kept.log_closed]
    return Evidence(kept.day, np.array(closed), np.array(kept.information), np.array(kept.score))


def _kept(service: Service, before: Kept, evidence: Evidence, sums: tuple[float, float]) -> Kept:
    """The evidence as plain numbers; the flight's sums join those of its day."""
    days = before.days
    if evidence.day == before.day:
        first, second = days[-1]
        days, sums = days[:-1], (first + sums[0], second + sums[1])
    closed = [None if math.isinf(log) else log for log in evidence.log_closed.tolist()]
    return replace(
        before,
        day=evidence.day,
        log_closed=closed,
        information=float(evidence.information),
        score=float(evidence.score),
        days=[*days, sums][-KEPT_DAYS:],
        flights=before.flights + 1,
        seen_day=service.day,
    )
