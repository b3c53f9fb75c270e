"""Monitor of the certificate's envelope in flight: reports an exit and assumes a higher draw."""

import math

from companion.core.certificate.certificate import Certificate
from companion.core.monitor.corrections import ASSUMED_DRAW_LOG
from companion.core.vehicle.power_bias import ModelError

OUTSIDE_SCALE, OUTSIDE_STD_FRAC = math.exp(ASSUMED_DRAW_LOG), 0.05
"""Assumed draw outside the envelope: as after lost evidence of the monitor, [est] with half of that
as its error."""

MIN_OUTSIDE_S = 10.0
"""Minimum time of wind and airspeed outside: both are means over 10 s already."""


class EnvelopeMonitor:
    """Monitor of one flight. An exit is final: the flight is then not certified."""

    def __init__(self, certificate: Certificate | None) -> None:
        self._certificate = certificate
        self._outside: dict[str, str] = {}
        self._since_s: dict[str, float] = {}

    @property
    def envelope_exit_texts(self) -> tuple[str, ...]:
        """The exits of the envelope, as text."""
        return tuple(self._outside.values())

    def record_exits_on_ground(
        self, payload_kg: float, air_temperature_c: float | None
    ) -> tuple[str, ...]:
        """Check the values known on the ground; returns new exits."""
        if self._certificate is None:
            return ()
        envelope = self._certificate.envelope
        found = []
        if payload_kg > envelope.payload_kg + 1e-6:
            found += self._record_first_exit(
                "payload", f"parcel of {payload_kg:g} kg", f"{envelope.payload_kg:g}"
            )
        if envelope.air_temperature_c is not None and air_temperature_c is not None:
            low, high = envelope.air_temperature_c
            if not low <= air_temperature_c <= high:
                span = f"{low:.0f} to {high:.0f}"
                found += self._record_first_exit(
                    "temperature", f"air of {air_temperature_c:.0f} C", span
                )
        return tuple(found)

    def record_exits_in_flight(
        self, t_s: float, wind_ne_mps: tuple[float, float] | None, airspeed_mps: float | None
    ) -> tuple[str, ...]:
        """Check one instant in the air, `None` is unknown; returns new exits."""
        if self._certificate is None:
            return ()
        envelope = self._certificate.envelope
        wind_mps = None if wind_ne_mps is None else math.hypot(*wind_ne_mps)
        return (
            *self._record_exit_if_sustained("wind", t_s, wind_mps, envelope.wind_mps),
            *self._record_exit_if_sustained("airspeed", t_s, airspeed_mps, envelope.airspeed_mps),
        )

    def _record_exit_if_sustained(
        self, quantity: str, t_s: float, value: float | None, limit: float
    ) -> tuple[str, ...]:
        if value is None or value <= limit:
            self._since_s.pop(quantity, None)
            return ()
        since_s = self._since_s.setdefault(quantity, t_s)
        if t_s - since_s < MIN_OUTSIDE_S:
            return ()
        return self._record_first_exit(quantity, f"{quantity} of {value:.1f} m/s", f"{limit:.1f}")

    def _record_first_exit(
        self, quantity: str, observed_text: str, certified_range_text: str
    ) -> tuple[str, ...]:
        if quantity in self._outside:
            return ()
        message = (
            f"{observed_text} (certified: {certified_range_text}): assuming draw"
            f" {OUTSIDE_SCALE:.2f} +- {OUTSIDE_STD_FRAC:.2f} of the model's"
        )
        self._outside[quantity] = f"certificate: {message}"
        return (message,)

    def model_error_widened_outside(self, learned_model_error: ModelError) -> ModelError:
        """Return the gate's model error: the learned one, outside at least the assumed one."""
        if not self._outside:
            return learned_model_error
        scale = max(learned_model_error.scale, OUTSIDE_SCALE)
        return ModelError(scale, math.hypot(learned_model_error.std_frac, OUTSIDE_STD_FRAC))

    def snapshot(self) -> dict[str, str]:
        """Return the contents of a checkpoint."""
        return dict(self._outside)

    def restore(self, exit_text_by_quantity: dict[str, str]) -> None:
        """Restore a checkpoint."""
        self._outside = dict(exit_text_by_quantity) if self._certificate is not None else {}
