"""A flight's watch over its certificate: outside the envelope it says so and counts carefully."""

import math

from companion.core.certificate.certificate import Certificate
from companion.core.monitor.doubts import LOST_DRAW_LOG
from companion.core.vehicle.power_bias import ModelError

CAREFUL_SCALE, CAREFUL_STD_FRAC = math.exp(LOST_DRAW_LOG), 0.05
"""The draw assumed where no flight has been: as after lost evidence of the monitor, [est] half of
that either way."""

HOLD_S = 10.0
"""Wind and airspeed have to be outside for so long: both are means over 10 s already."""


class EnvelopeWatch:
    """One per flight. What was outside once stays outside: no flight is certified by halves."""

    def __init__(self, certificate: Certificate | None) -> None:
        self._certificate = certificate
        self._outside: dict[str, str] = {}
        self._since_s: dict[str, float] = {}

    @property
    def outside(self) -> tuple[str, ...]:
        """What is outside, in words."""
        return tuple(self._outside.values())

    def settle(self, payload_kg: float, air_temperature_c: float | None) -> tuple[str, ...]:
        """Judge what is known on the ground; returns what is newly outside, in words."""
        if self._certificate is None:
            return ()
        envelope = self._certificate.envelope
        found = []
        if payload_kg > envelope.payload_kg + 1e-6:
            found += self._leave(
                "payload", f"parcel of {payload_kg:g} kg", f"{envelope.payload_kg:g}"
            )
        if envelope.air_temperature_c is not None and air_temperature_c is not None:
            low, high = envelope.air_temperature_c
            if not low <= air_temperature_c <= high:
                span = f"{low:.0f} to {high:.0f}"
                found += self._leave("temperature", f"air of {air_temperature_c:.0f} C", span)
        return tuple(found)

    def observe(
        self, t_s: float, wind_mps: float | None, airspeed_mps: float | None
    ) -> tuple[str, ...]:
        """Judge one instant in the air, `None` is unknown; returns what is newly outside."""
        if self._certificate is None:
            return ()
        envelope = self._certificate.envelope
        return (
            *self._hold("wind", t_s, wind_mps, envelope.wind_mps),
            *self._hold("airspeed", t_s, airspeed_mps, envelope.airspeed_mps),
        )

    def _hold(self, what: str, t_s: float, value: float | None, limit: float) -> tuple[str, ...]:
        if value is None or value <= limit:
            self._since_s.pop(what, None)
            return ()
        since_s = self._since_s.setdefault(what, t_s)
        if t_s - since_s < HOLD_S:
            return ()
        return self._leave(what, f"{what} of {value:.1f} m/s", f"{limit:.1f}")

    def _leave(self, what: str, seen: str, certified: str) -> tuple[str, ...]:
        if what in self._outside:
            return ()
        words = (
            f"certificate: {seen} is outside what was flown ({certified}): draw"
            f" {CAREFUL_SCALE:.2f} +- {CAREFUL_STD_FRAC:.2f} of the model's is assumed"
        )
        self._outside[what] = words
        return (words,)

    def careful(self, learned: ModelError) -> ModelError:
        """What the gate counts with: as learned inside, never less than the careful default
        outside."""
        if not self._outside:
            return learned
        scale = max(learned.scale, CAREFUL_SCALE)
        return ModelError(scale, math.hypot(learned.std_frac, CAREFUL_STD_FRAC))

    def snapshot(self) -> dict[str, str]:
        """What a checkpoint keeps."""
        return dict(self._outside)

    def restore(self, outside: dict[str, str]) -> None:
        """Go on from a checkpoint."""
        self._outside = dict(outside) if self._certificate is not None else {}
