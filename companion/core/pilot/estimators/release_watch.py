"""Evidence of the parcel's release from the hover and the gripper's reports.

Compares the mean hover power and thrust command before the release with the means after it. Each
drop is weighed by its likelihood with the parcel released (the drop that the model predicts in the
present wind and air) over that with the parcel attached (none, but for noise). The gripper's
reports count as prior evidence: a mechanism that reports success may still hold the parcel.

At constant geometry hover power is proportional to mass to the power of 3/2 and the linearised
thrust command to mass (Leishman, Principles of Helicopter Aerodynamics, 2.2).
"""

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import fmean, pvariance

from companion.core.pilot.observed_state import THROTTLE_MAX_AGE_S
from companion.core.pilot.telemetry_state import (
    BATTERY_MAX_AGE_S,
    POSITION_MAX_AGE_S,
    TelemetryState,
)
from companion.core.routing.leg_energy import RouteEnergy

REFERENCE_WINDOW_S = 3.0
SETTLING_S = 0.7
RELEASED_WINDOW_S = 2.4
MIN_SAMPLES = 3
REPORTED_TEXT = "reported by the gripper"
DROP_ERROR_FRAC = 0.35
"""Relative error of the expected drop: 20 to 26 % were measured where the model expected 35 %."""

REQUIRED_NATS, GRIPPER_NATS, MAX_GRIPPER_REPORTS = 4.0, 1.25, 2
"""Log-likelihood ratio that proves a release, and that of each of the gripper's reports."""

CONTRADICTION_NATS = -1.0
"""A quantity below this contradicts a release."""

NOISE_DROP_FRAC = 0.06
"""Expected drop of hover power that may be lost in noise: the gripper's report alone proves it."""

MIN_POWER_NOISE_FRAC = 0.02
"""Change of hover power without a release: voltage, and wind that changes within seconds."""

INDEPENDENT_SAMPLES = 3
"""Gusts are correlated over about a second: independent samples in a reference or released window.
"""

THRUST_NOISE = 0.005
"""VFR_HUD reports the throttle in whole per cent. A light parcel (2 % of the mass) is one step of
it, which the throttle also makes without a parcel (seen on PX4's SIH)."""

MAX_HOVER_SPEED_MPS = 1.5
MAX_HOVER_CLIMB_MPS = 0.6


@dataclass(slots=True)
class _SampleWindow:
    """Samples of one quantity, the last half minute."""

    samples: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=600))

    def add_sample(self, t_s: float, value: float) -> None:
        if not self.samples or t_s > self.samples[-1][0]:
            self.samples.append((t_s, value))

    def mean_and_variance_of_mean(self, from_s: float, to_s: float) -> tuple[float, float] | None:
        """Mean over a span, and the variance of that mean; `None` with too few samples."""
        selected = [value for t_s, value in self.samples if from_s <= t_s <= to_s]
        if len(selected) < MIN_SAMPLES:
            return None
        return fmean(selected), pvariance(selected) / INDEPENDENT_SAMPLES


@dataclass(slots=True)
class ReleaseMonitor:
    """Monitors one release. `power_frac` and `thrust_frac` are the expected relative drops."""

    power_frac: float
    thrust_frac: float
    release_ordered_s: float | None = None
    gripper_reports: int = 0
    """Reports of the gripper or its command that the parcel is released."""
    _power: _SampleWindow = field(default_factory=_SampleWindow)
    _thrust: _SampleWindow = field(default_factory=_SampleWindow)

    def add_hover_sample(
        self, t_s: float, power_w: float | None, thrust_frac: float | None
    ) -> None:
        """Add a sample of power and thrust command."""
        if power_w is not None:
            self._power.add_sample(t_s, power_w)
        if thrust_frac is not None:
            self._thrust.add_sample(t_s, thrust_frac)

    def record_release_order(self, t_s: float) -> None:
        """Record an order of the release; the hover before the first order is the reference."""
        if self.release_ordered_s is None:
            self.release_ordered_s = t_s

    def release_evidence_text(self, t_s: float) -> str | None:
        """Return the evidence of the release, or `None` without enough."""
        # Compares the latest hover with the one before the release.
        ordered_s = self.release_ordered_s
        if ordered_s is None or t_s < ordered_s + SETTLING_S + RELEASED_WINDOW_S - 0.05:
            return None
        start_s = max(ordered_s + SETTLING_S, t_s - RELEASED_WINDOW_S)
        weighed: list[tuple[float, str]] = []
        for window, expected, noise, noise_frac, quantity in (
            (self._power, self.power_frac, 0.0, MIN_POWER_NOISE_FRAC, "hover power"),
            (self._thrust, self.thrust_frac, THRUST_NOISE, 0.0, "hover thrust"),
        ):
            loaded = window.mean_and_variance_of_mean(ordered_s - REFERENCE_WINDOW_S, ordered_s)
            empty = window.mean_and_variance_of_mean(start_s, t_s)
            if loaded is None or empty is None or loaded[0] <= 0.0 or expected <= 0.0:
                continue
            drop = 1.0 - empty[0] / loaded[0]
            std = math.hypot(noise_frac, math.sqrt(loaded[1] + empty[1] + noise**2) / loaded[0])
            text = f"{quantity} fell by {100 * drop:.0f} %, {100 * expected:.0f} % expected"
            weighed.append((_release_nats(drop, expected, std), text))
        gripper_nats = GRIPPER_NATS * min(self.gripper_reports, MAX_GRIPPER_REPORTS)
        if not weighed:
            return REPORTED_TEXT if self.gripper_reports else None
        if min(weighed)[0] <= CONTRADICTION_NATS:
            return None
        nats, text = max(weighed)
        if nats + gripper_nats >= REQUIRED_NATS:
            return text
        is_drop_in_noise = nats < -CONTRADICTION_NATS and self.power_frac < NOISE_DROP_FRAC
        return REPORTED_TEXT if gripper_nats and is_drop_in_noise else None


def _release_nats(drop: float, expected: float, noise_std: float) -> float:
    """Return the log-likelihood ratio of released over attached for a relative drop."""
    released_std = math.hypot(noise_std, DROP_ERROR_FRAC * expected)
    released = ((drop - expected) / released_std) ** 2
    return 0.5 * ((max(drop, 0.0) / noise_std) ** 2 - released) - math.log(released_std / noise_std)


def build_release_monitor(
    route_energy: RouteEnergy, payload_kg: float, wind_mps: float
) -> ReleaseMonitor:
    """Return the monitor of the release, with the drops that the power model expects in a hover in
    this wind.
    """
    loaded_w, empty_w = (
        route_energy.steady_flight_power_w(mass_kg, wind_mps) for mass_kg in (payload_kg, 0.0)
    )
    mass_kg = route_energy.airframe.flying_mass_kg(payload_kg)
    return ReleaseMonitor(1.0 - empty_w / loaded_w, payload_kg / mass_kg)


def add_hover_samples_from_telemetry(
    release_monitor: ReleaseMonitor, telemetry: TelemetryState
) -> None:
    """Pass recent samples to the monitor while the vehicle hovers: motion changes the power too."""
    position = telemetry.recent_or_none(telemetry.position, POSITION_MAX_AGE_S)
    if position is None:
        return
    speed_mps = math.hypot(position.vel_n_mps, position.vel_e_mps)
    if speed_mps >= MAX_HOVER_SPEED_MPS or abs(position.vel_d_mps) >= MAX_HOVER_CLIMB_MPS:
        return
    battery = telemetry.recent_or_none(telemetry.battery, BATTERY_MAX_AGE_S)
    if battery is not None and battery.voltage_v is not None and battery.current_a is not None:
        release_monitor.add_hover_sample(battery.t_s, battery.voltage_v * battery.current_a, None)
    throttle = telemetry.recent_or_none(telemetry.throttle, THROTTLE_MAX_AGE_S)
    if throttle is not None:
        release_monitor.add_hover_sample(throttle.t_s, None, throttle.throttle_frac)
