"""A certificate from the days of flights that an airframe was not fitted to."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

from companion.core.base.errors import LeewayError
from companion.core.certificate.certificate import (
    LEAST_DAYS,
    Certificate,
    CertifiedDay,
    FlownEnvelope,
    airframe_digest,
    pack_class,
)
from companion.core.vehicle.airframe import Airframe

_ODD_LOG = math.log(2.0)
"""Twice the prediction, or half of it: another vehicle's log or a wrong current sensor."""


@dataclass(frozen=True, slots=True)
class MeasuredFlight:
    """One whole flight. Wind and airspeed are its largest means over 10 s.

    `worst_ratio`: the largest measured over predicted energy home, of all its decision points.
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
    def log_ratio(self) -> float:
        """Logarithm of measured over predicted energy."""
        return math.log(self.measured_wh / self.predicted_wh)


@dataclass(frozen=True, slots=True)
class Scatter:
    """Mean and standard deviation of the logarithm for a flight on a new day."""

    mean_log: float
    std_log: float


def certify(
    airframe: Airframe, flights: Sequence[MeasuredFlight], scatter: Scatter, left_out: list[str]
) -> Certificate:
    """What these flights support; LeewayError for too few days or a log of another vehicle."""
    for flight in flights:
        if abs(flight.log_ratio) > _ODD_LOG:
            raise LeewayError(
                f"{flight.name}: {flight.measured_wh:.1f} Wh measured, {flight.predicted_wh:.1f}"
                f" predicted by {airframe.name}: another vehicle, or a wrong current sensor"
            )
    by_day = {
        date: list(rows)
        for date, rows in groupby(sorted(flights, key=lambda f: f.date), key=lambda f: f.date)
    }
    if len(by_day) < LEAST_DAYS:
        raise LeewayError(f"flights on {len(by_day)} days, at least {LEAST_DAYS} expected")
    return Certificate(
        format="certificate/2",
        airframe=airframe.name,
        airframe_digest=airframe_digest(airframe),
        pack=pack_class(airframe),
        days=[
            CertifiedDay(
                date=date,
                flights=len(rows),
                decision_points=sum(row.decision_points for row in rows),
                worst_ratio=max(row.worst_ratio for row in rows),
            )
            for date, rows in by_day.items()
        ],
        draw_factor=math.exp(scatter.mean_log),
        draw_std_frac=scatter.std_log,
        envelope=_envelope(list(by_day.values())),
        left_out=left_out,
    )


def _envelope(days: list[list[MeasuredFlight]]) -> FlownEnvelope:
    """The largest that two days have reached, each by itself."""
    temperatures = [[f.air_temperature_c for f in rows] for rows in days]
    known = [[t for t in rows if t is not None] for rows in temperatures]
    whole = all(len(a) == len(b) for a, b in zip(temperatures, known, strict=True))
    span = (-_second(-min(t) for t in known), _second(max(t) for t in known)) if whole else None
    return FlownEnvelope(
        wind_mps=_second(max(f.wind_mps for f in rows) for rows in days),
        airspeed_mps=_second(max(f.airspeed_mps for f in rows) for rows in days),
        payload_kg=_second(max(f.payload_kg for f in rows) for rows in days),
        air_temperature_c=span,
    )


def _second(largest_of_days: Iterable[float]) -> float:
    return sorted(largest_of_days)[-2]
