"""The `certificate/2` file: the loss that recorded flights of an airframe support."""

import hashlib
import math
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError, check_range
from companion.core.certificate.support import (
    COVERAGE,
    loss_upper_confidence_limit,
    supported_loss_probability,
)
from companion.core.vehicle.airframe import Airframe

MIN_DAYS = 3
"""Minimum number of days to estimate the scatter between days."""


class CertifiedDay(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One day's flights."""

    date: str
    """YYYY-MM-DD."""
    flights: int
    """Flights of that day."""
    decision_points: int
    """Instants of these flights at which the energy to home was evaluated."""
    worst_ratio: float
    """Largest measured over predicted energy to home, over all decision points of all flights."""

    def __post_init__(self) -> None:
        check_range("days.flights", self.flights, 1, 100_000)
        check_range("days.decision_points", self.decision_points, 1, 1_000_000_000)
        check_range("days.worst_ratio", self.worst_ratio, 0.2, 5.0)


class FlownEnvelope(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Conditions reached on at least two days; nothing is certified outside."""

    wind_mps: float
    """Strongest 10 s mean wind."""
    airspeed_mps: float
    """Fastest 10 s mean airspeed."""
    payload_kg: float
    """Heaviest parcel."""
    air_temperature_c: tuple[float, float] | None = None
    """Coldest and warmest air; `null` if a log's temperature is unknown: not monitored."""

    def __post_init__(self) -> None:
        check_range("envelope.wind_mps", self.wind_mps, 0.0, 100.0)
        check_range("envelope.airspeed_mps", self.airspeed_mps, 0.0, 200.0)
        check_range("envelope.payload_kg", self.payload_kg, 0.0, 500.0)
        if self.air_temperature_c is not None:
            for one in self.air_temperature_c:
                check_range("envelope.air_temperature_c", one, -60.0, 60.0)
            low, high = self.air_temperature_c
            if low > high:
                raise LeewayError("envelope.air_temperature_c: expected coldest, then warmest")


class Certificate(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `certificate/2` file, stored next to the airframe file whose draw it certifies."""

    format: Literal["certificate/2"]
    """File type and version."""
    airframe: str
    """The airframe's name."""
    airframe_digest: str
    """Digest of the airframe's parameters (`airframe_digest`)."""
    pack: str
    """Battery class, as text."""
    days: list[CertifiedDay]
    """All days in order of date."""
    draw_factor: float
    """Measured over predicted energy, geometric mean over days."""
    draw_std_frac: float
    """Standard deviation of that ratio for a flight on a new day."""
    envelope: FlownEnvelope
    """Conditions of the flights."""
    left_out: list[str]
    """Excluded logs by name, with the reason."""

    def __post_init__(self) -> None:
        if len(self.days) < MIN_DAYS:
            raise LeewayError(f"days: {len(self.days)}, at least {MIN_DAYS} expected")
        dates = [day.date for day in self.days]
        if len(set(dates)) < len(dates):
            raise LeewayError("days: duplicate date; expected each once")
        check_range("draw_factor", self.draw_factor, 0.2, 5.0)
        check_range("draw_std_frac", self.draw_std_frac, 0.0, 2.0)

    @property
    def max_measured_to_predicted_ratio(self) -> float:
        """Measured over predicted energy to home that no flight of these days exceeded at any
        decision point."""
        return max(day.worst_ratio for day in self.days)

    @property
    def supported_loss_probability(self) -> float:
        """Probability that a new day has a flight over `max_measured_to_predicted_ratio` at a
        decision point.
        """
        return supported_loss_probability(len(self.days))

    @property
    def log_draw_factor(self) -> float:
        """Logarithm of `draw_factor`."""
        return math.log(self.draw_factor)

    @property
    def summary_text(self) -> str:
        """The certified probability and its conditions, as text."""
        days, flights = len(self.days), sum(day.flights for day in self.days)
        points = sum(day.decision_points for day in self.days)
        return (
            f"on a new day, exchangeable with these {days} ({flights} flights, {points:,} decision"
            f" points), the energy to home exceeds {self.max_measured_to_predicted_ratio:.3f} of"
            f" what {self.airframe} predicts, from any decision point of any flight, with at most"
            f" {percent_text(self.supported_loss_probability)} (with {percent_text(COVERAGE)}"
            f" confidence at most {percent_text(loss_upper_confidence_limit(days))})"
        )


def percent_text(fraction: float) -> str:
    """Return a share as a percentage with two digits."""
    return f"{100.0 * fraction:.2g} %"


def airframe_digest(airframe: Airframe) -> str:
    """Return a digest of the parameters, independent of the file's comments."""
    return hashlib.sha256(msgspec.json.encode(airframe)).hexdigest()[:16]


def battery_class_text(airframe: Airframe) -> str:
    """Return the battery class of the airframe."""
    return f"{airframe.battery.cells} cells, {airframe.battery.nominal_wh:g} Wh"


_OLD_FORMAT = "certificate/1"


def certificate_from_dict(table: object, document_name: str) -> Certificate:
    """Convert parsed JSON to a certificate; LeewayError names file and key."""
    if isinstance(table, dict) and table.get("format") == _OLD_FORMAT:
        raise LeewayError(
            f"{document_name}: {_OLD_FORMAT} judged whole flights, certificate/2 every decision"
            " point: companion certify again, or remove it"
        )
    try:
        return msgspec.convert(table, Certificate)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{document_name}: {error}") from error
