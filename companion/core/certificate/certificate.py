"""The `certificate/2` file: what flights of an airframe support, in words that can be falsified."""

import hashlib
import math
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError, check_range
from companion.core.certificate.support import (
    CONFIDENCE,
    confident_loss,
    days_needed,
    days_needed_confidently,
    supported_loss,
)
from companion.core.vehicle.airframe import Airframe

LEAST_DAYS = 3
"""Fewer tell no scatter between days."""


class CertifiedDay(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One day's flights."""

    date: str
    """YYYY-MM-DD."""
    flights: int
    """Flights of that day."""
    decision_points: int
    """Instants of these flights at which the energy home was judged."""
    worst_ratio: float
    """Largest measured over predicted energy home, over all decision points of all its flights."""

    def __post_init__(self) -> None:
        check_range("days.flights", self.flights, 1, 100_000)
        check_range("days.decision_points", self.decision_points, 1, 1_000_000_000)
        check_range("days.worst_ratio", self.worst_ratio, 0.2, 5.0)


class FlownEnvelope(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What two days or more have flown in; nothing is certified outside."""

    wind_mps: float
    """Strongest 10 s mean wind."""
    airspeed_mps: float
    """Fastest 10 s mean airspeed."""
    payload_kg: float
    """Heaviest parcel."""
    air_temperature_c: tuple[float, float] | None = None
    """Coldest and warmest air; `null` where a log's temperature is not known: not watched."""

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
    """A `certificate/2` file: it lies beside the airframe file whose draw it certifies."""

    format: Literal["certificate/2"]
    """The kind of file and its version."""
    airframe: str
    """The airframe's name."""
    airframe_digest: str
    """Tells the airframe's numbers from others (`airframe_digest`)."""
    pack: str
    """The pack's class, in words."""
    days: list[CertifiedDay]
    """Every day, in the order of dates."""
    draw_factor: float
    """Measured over predicted energy, geometric mean over days."""
    draw_std_frac: float
    """Standard deviation of that of a flight on a new day."""
    envelope: FlownEnvelope
    """What was flown in."""
    left_out: list[str]
    """Logs that do not count, by name, and why."""

    def __post_init__(self) -> None:
        if len(self.days) < LEAST_DAYS:
            raise LeewayError(f"days: {len(self.days)}, at least {LEAST_DAYS} expected")
        dates = [day.date for day in self.days]
        if len(set(dates)) < len(dates):
            raise LeewayError("days: a date stands there twice; expected each once")
        check_range("draw_factor", self.draw_factor, 0.2, 5.0)
        check_range("draw_std_frac", self.draw_std_frac, 0.0, 2.0)

    @property
    def bound_ratio(self) -> float:
        """Measured over predicted energy home that no flight of these days was over, at any of its
        decision points."""
        return max(day.worst_ratio for day in self.days)

    @property
    def supported_loss(self) -> float:
        """Chance that a new day holds a flight that is over `bound_ratio` at a decision point."""
        return supported_loss(len(self.days))

    @property
    def draw_log(self) -> float:
        """Logarithm of `draw_factor`."""
        return math.log(self.draw_factor)

    @property
    def statement(self) -> str:
        """What is promised, and for what."""
        days, flights = len(self.days), sum(day.flights for day in self.days)
        points = sum(day.decision_points for day in self.days)
        return (
            f"on a new day, exchangeable with these {days} ({flights} flights, {points:,} decision"
            f" points), the way home takes over {self.bound_ratio:.3f} of what {self.airframe}"
            " predicts, from any decision point of any flight, with at most"
            f" {percent(self.supported_loss)} (with {percent(CONFIDENCE)} confidence at most"
            f" {percent(confident_loss(days))})"
        )

    def support_of(self, max_loss: float) -> str:
        """What is missing for this loss, in words; "" where the days support it."""
        if self.supported_loss <= max_loss:
            return ""
        return (
            f"{percent(max_loss)} accepted is less than {len(self.days)} days can support:"
            f" {days_needed(max_loss)} would, and {days_needed_confidently(max_loss)} without a"
            f" loss with {percent(CONFIDENCE)} confidence; until then it rests on the models"
        )


def percent(share: float) -> str:
    """Two digits, as people read it."""
    return f"{100.0 * share:.2g} %"


def airframe_digest(airframe: Airframe) -> str:
    """The same for the same numbers, whatever the file's comments."""
    return hashlib.sha256(msgspec.json.encode(airframe)).hexdigest()[:16]


def pack_class(airframe: Airframe) -> str:
    """The pack as the airframe states it."""
    return f"{airframe.battery.cells} cells, {airframe.battery.nominal_wh:g} Wh"


_OF_WHOLE_FLIGHTS = "certificate/1"


def certificate_from_dict(table: object, where: str) -> Certificate:
    """A certificate as parsed from JSON; LeewayError names file and key."""
    if isinstance(table, dict) and table.get("format") == _OF_WHOLE_FLIGHTS:
        raise LeewayError(
            f"{where}: {_OF_WHOLE_FLIGHTS} judged whole flights, certificate/2 every decision"
            " point: companion certify again, or remove it"
        )
    try:
        return msgspec.convert(table, Certificate)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{where}: {error}") from error
