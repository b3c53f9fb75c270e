"""Calculation of a certificate from days of flights that the airframe was not fitted to."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

from companion.core.base.errors import LeewayError
from companion.core.certificate.certificate import (
    MIN_DAYS,
    Certificate,
    CertifiedDay,
    FlownEnvelope,
    airframe_digest,
    battery_class_text,
)
from companion.core.vehicle.airframe import Airframe

_IMPLAUSIBLE_LOG_RATIO = math.log(2.0)
"""Twice or half the prediction: a log of another vehicle, or a wrong current sensor."""


@dataclass(frozen=True, slots=True)
class MeasuredFlight:
    """One whole flight. Wind and airspeed are its largest means over 10 s.

    `worst_ratio`: the largest measured over predicted energy to home, over its decision points.
    """

    name: str
    date: str
    measured_wh: float
    predicted_wh: float
    decision_points: int
    worst_ratio: float
    wind_mps: float
    airspeed_mps: float
    payload_kg: float
    air_temperature_c: float | None

    @property
    def log_measured_to_predicted_ratio(self) -> float:
        """Logarithm of measured over predicted energy."""
        return math.log(self.measured_wh / self.predicted_wh)


@dataclass(frozen=True, slots=True)
class Scatter:
    """Mean and standard deviation of the logarithm for a flight on a new day."""

    mean_log: float
    std_log: float


def create_certificate(
    airframe: Airframe,
    flights: Sequence[MeasuredFlight],
    log_ratio_scatter: Scatter,
    excluded_log_reasons: list[str],
) -> Certificate:
    """Create the certificate; LeewayError for too few days or a log of another vehicle."""
    for flight in flights:
        if abs(flight.log_measured_to_predicted_ratio) > _IMPLAUSIBLE_LOG_RATIO:
            raise LeewayError(
                f"{flight.name}: {flight.measured_wh:.1f} Wh measured, {flight.predicted_wh:.1f}"
                f" predicted by {airframe.name}: another vehicle, or a wrong current sensor"
            )
    by_day = {
        date: list(rows)
        for date, rows in groupby(sorted(flights, key=lambda f: f.date), key=lambda f: f.date)
    }
    if len(by_day) < MIN_DAYS:
        raise LeewayError(f"flights on {len(by_day)} days, at least {MIN_DAYS} expected")
    return Certificate(
        format="certificate/2",
        airframe=airframe.name,
        airframe_digest=airframe_digest(airframe),
        pack=battery_class_text(airframe),
        days=[
            CertifiedDay(
                date=date,
                flights=len(rows),
                decision_points=sum(row.decision_points for row in rows),
                worst_ratio=max(row.worst_ratio for row in rows),
            )
            for date, rows in by_day.items()
        ],
        draw_factor=math.exp(log_ratio_scatter.mean_log),
        draw_std_frac=log_ratio_scatter.std_log,
        envelope=_envelope_reached_on_two_days(list(by_day.values())),
        left_out=excluded_log_reasons,
    )


def _envelope_reached_on_two_days(flights_by_day: list[list[MeasuredFlight]]) -> FlownEnvelope:
    """Return the second largest daily value of each quantity, so that two days reached it."""
    temperatures = [[f.air_temperature_c for f in rows] for rows in flights_by_day]
    known = [[t for t in rows if t is not None] for rows in temperatures]
    whole = all(len(a) == len(b) for a, b in zip(temperatures, known, strict=True))
    span = (
        (-_second_highest(-min(t) for t in known), _second_highest(max(t) for t in known))
        if whole
        else None
    )
    return FlownEnvelope(
        wind_mps=_second_highest(max(f.wind_mps for f in rows) for rows in flights_by_day),
        airspeed_mps=_second_highest(max(f.airspeed_mps for f in rows) for rows in flights_by_day),
        payload_kg=_second_highest(max(f.payload_kg for f in rows) for rows in flights_by_day),
        air_temperature_c=span,
    )


def _second_highest(daily_maxima: Iterable[float]) -> float:
    return sorted(daily_maxima)[-2]
