"""The release of the parcel: watch the hover, look for proof, ask once more, go home.

Safety rule 5: the parcel is gone when a gripper says so, or when hovering takes less.

Compares the mean hover power (or, without a current sensor, the thrust command) before the release
with the mean after it. At constant geometry hover power goes with mass to the power of 3/2 and the
linearised thrust command with mass (Leishman, Principles of Helicopter Aerodynamics, 2.2).
"""

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import fmean, pvariance
from typing import Any

from companion.core.mission.actions import Note, Release, Severity
from companion.core.mission.events import Event, ReleaseFeedback
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import FlightContext, Jumps, ReturnBudget
from companion.core.pilot.telemetry_state import (
    BATTERY_MAX_AGE_S,
    THROTTLE_MAX_AGE_S,
    TelemetryState,
)
from companion.core.pilot.transitions import Phase, Trigger
from companion.core.routing.leg_energy import RouteEnergy

RELEASE_AGAIN_S = 3.6
BEFORE_S = 3.0
SPOOL_S = 0.7
AFTER_S = 2.4
LEAST_SAMPLES = 3
SHARE, SECOND_SHARE = 0.65, 0.35
"""The first measure has to fall by this share of what is expected; the second must not deny it."""

SIGMAS = 2.0
INDEPENDENT = 3
"""Gusts are correlated over about a second: a window of BEFORE_S or AFTER_S holds so many
independent samples."""

THRUST_RESOLUTION = 0.01
"""VFR_HUD gives the throttle in whole per cent. A light parcel (2 % of the mass) is one step of it,
which the throttle also takes by itself (seen on PX4's SIH without any parcel)."""

HOVER_SPEED_MPS = 1.5
HOVER_CLIMB_MPS = 0.6


# --- proof ---------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Window:
    """Samples of one quantity, the last half minute."""

    samples: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=600))

    def add(self, t_s: float, value: float) -> None:
        if not self.samples or t_s > self.samples[-1][0]:
            self.samples.append((t_s, value))

    def mean(self, from_s: float, to_s: float) -> tuple[float, float] | None:
        """Mean over a span, and the variance of that mean; `None` with too few samples."""
        chosen = [value for t_s, value in self.samples if from_s <= t_s <= to_s]
        if len(chosen) < LEAST_SAMPLES:
            return None
        return fmean(chosen), pvariance(chosen) / INDEPENDENT


@dataclass(slots=True)
class ReleaseWatch:
    """Watches one release. `power_frac` and `thrust_frac` are the expected relative drops."""

    power_frac: float
    thrust_frac: float
    begun_s: float | None = None
    feedback: bool | None = None
    _power: _Window = field(default_factory=_Window)
    _thrust: _Window = field(default_factory=_Window)

    def observe(self, t_s: float, power_w: float | None, thrust_frac: float | None) -> None:
        """Take what the vehicle draws and its thrust command."""
        if power_w is not None:
            self._power.add(t_s, power_w)
        if thrust_frac is not None:
            self._thrust.add(t_s, thrust_frac)

    def begin(self, t_s: float) -> None:
        """The release has been ordered (again); the hover before the first order is checkpoint."""
        if self.begun_s is None:
            self.begun_s = t_s

    def evidence(self, t_s: float) -> str | None:
        """Say what shows that the parcel is gone, or `None` while nothing does."""
        if self.feedback:
            return "the gripper says so"
        if self.begun_s is None:
            return None
        # The newest hover against the one before the release.
        start_s = max(self.begun_s + SPOOL_S, t_s - AFTER_S)
        if t_s < self.begun_s + SPOOL_S + AFTER_S - 0.05:
            return None
        found = ""
        for window, expected, resolution, words in (
            (self._power, self.power_frac, 0.0, "hover power"),
            (self._thrust, self.thrust_frac, THRUST_RESOLUTION, "hover thrust"),
        ):
            loaded = window.mean(self.begun_s - BEFORE_S, self.begun_s)
            empty = window.mean(start_s, t_s)
            if loaded is None or empty is None or loaded[0] <= 0.0 or expected <= 0.0:
                continue
            drop = 1.0 - empty[0] / loaded[0]
            if drop < (SECOND_SHARE if found else SHARE) * expected:
                return None
            noise = resolution + SIGMAS * math.sqrt(loaded[1] + empty[1])
            if loaded[0] - empty[0] > noise:  # below the noise it is no evidence, either way
                report = f"{words} fell by {100 * drop:.0f} %, {100 * expected:.0f} % expected"
                found = found or report
        return found or None


def watch_for(route_energy: RouteEnergy, payload_kg: float) -> ReleaseWatch:
    """The watch over the release of this parcel, with what the power model expects of it."""
    loaded_w, empty_w = route_energy.hover_power_w(payload_kg), route_energy.hover_power_w(0.0)
    mass_kg = route_energy.airframe.mass_kg(payload_kg)
    return ReleaseWatch(1.0 - empty_w / loaded_w, payload_kg / mass_kg)


def observe_hover(watch: ReleaseWatch, now: TelemetryState) -> None:
    """Show the watch what is fresh, while the vehicle hovers: motion changes the power too."""
    position = now.position
    if position is None or not now.is_fresh(position, 1.0):
        return
    speed_mps = math.hypot(position.vel_n_mps, position.vel_e_mps)
    if speed_mps >= HOVER_SPEED_MPS or abs(position.vel_d_mps) >= HOVER_CLIMB_MPS:
        return
    battery = now.battery if now.is_fresh(now.battery, BATTERY_MAX_AGE_S) else None
    if battery is not None and battery.voltage_v is not None and battery.current_a is not None:
        watch.observe(battery.t_s, battery.voltage_v * battery.current_a, None)
    if now.throttle is not None and now.is_fresh(now.throttle, THROTTLE_MAX_AGE_S):
        watch.observe(now.throttle.t_s, None, now.throttle.throttle_frac)


# --- the controller ------------------------------------------------------------------------------


@dataclass(slots=True)
class ParcelState:
    """What has become of the parcel."""

    delivered: bool = False
    drop_begun: bool = False
    """The gripper was told to open: without proof nobody knows where the parcel is."""
    watch: ReleaseWatch | None = None
    asked_again: bool = False

    def to_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"delivered": self.delivered, "drop_begun": self.drop_begun}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Over the customer at that time: the mission aboard has gone on by itself since."""
        over_customer = (Phase.DELIVER.value, Phase.RELEASE.value)
        self.delivered = checkpoint.delivered
        self.drop_begun = checkpoint.drop_begun or checkpoint.phase in over_customer

    @property
    def untouched(self) -> bool:
        """Aboard, and no release has been watched yet."""
        return not self.delivered and self.watch is None


class ParcelRelease:
    """Looks for proof of the release over the customer."""

    def __init__(self, state: ParcelState, jumps: Jumps, budget: ReturnBudget) -> None:
        self._state = state
        self._jumps = jumps
        self._budget = budget

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Take what a gripper reports."""
        if isinstance(event, ReleaseFeedback) and self._state.watch is not None:
            self._state.watch.feedback = event.released

    def observe(self, context: FlightContext) -> None:
        """Show the watch the hover over the customer."""
        over_customer = context.phase in (Phase.DELIVER, Phase.RELEASE)
        if over_customer and context.flight.vehicle.payload_kg > 0.0:
            observe_hover(self._watch(context), context.telemetry)

    def begin(self, context: FlightContext) -> None:
        """The mission aboard releases the parcel now."""
        self._state.drop_begun = True
        self._watch(context).begin(context.t_s)

    def tick(self, context: FlightContext) -> None:
        """Look for proof that the parcel is gone; ask once more; then home."""
        state = self._state
        if context.flight_plan is None or self._jumps.jump_index is not None or state.delivered:
            return
        if context.flight.vehicle.payload_kg <= 0.0:
            self._delivered(context, "there was no parcel to weigh")
            return
        evidence = self._watch(context).evidence(context.t_s)
        if evidence is not None:
            self._delivered(context, evidence)
            return
        if not state.asked_again and context.phase_s > RELEASE_AGAIN_S:
            state.asked_again = True
            if not context.telemetry.troubles():
                context.do(Release())
                context.do(Note("no proof of the release yet: asked once more"))

    def end(self, context: FlightContext) -> None:
        """Leaving without proof: the parcel counts as aboard (safety rule 5)."""
        if not self._state.delivered:
            words = "the parcel counts as aboard: returning loaded"
            context.decide("release_unconfirmed", words)
            context.say(Severity.ERROR, "release not confirmed: parcel counts as aboard")

    def _watch(self, context: FlightContext) -> ReleaseWatch:
        if self._state.watch is None:
            payload_kg = context.flight.vehicle.payload_kg
            self._state.watch = watch_for(context.estimates.route_energy, payload_kg)
        return self._state.watch

    def _delivered(self, context: FlightContext, evidence: str) -> None:
        plan = context.flight_plan
        assert plan is not None
        self._state.delivered = True
        context.estimates.payload_kg = 0.0
        context.assessment = None
        self._budget.assess(context, 0.0)
        context.decide("delivered", evidence)
        context.say(Severity.NOTICE, f"delivered: {evidence}")
        context.save()
        if not context.telemetry.troubles():
            self._jumps.jump_home(context, plan.mission.returning[0])
            context.request_transition(Trigger.DROP_OVER, "delivered")
