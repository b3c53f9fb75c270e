"""Estimates of wind and energy, and the gate's answer from them; updated at every tick."""

import math
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace

from companion.core.base.geo import Ned
from companion.core.certificate.certificate import Certificate
from companion.core.certificate.watch import EnvelopeWatch
from companion.core.mission.events import AutopilotKind, AutopilotWind, Battery
from companion.core.mission.flight_file import Flight
from companion.core.monitor.doubts import NO_DOUBTS, Doubts
from companion.core.monitor.figures import FlightFigures
from companion.core.monitor.tally import FlightTally
from companion.core.pilot.shared_wind import WORDS, SharedWind
from companion.core.pilot.telemetry_state import (
    AIRSPEED_MAX_AGE_S,
    ATTITUDE_MAX_AGE_S,
    BATTERY_MAX_AGE_S,
    POSITION_MAX_AGE_S,
    THROTTLE_MAX_AGE_S,
    WIND_MAX_AGE_S,
    TelemetryState,
)
from companion.core.return_budget.budget import (
    Ahead,
    Assessment,
    Gate,
    GateParams,
    is_less_hopeful,
)
from companion.core.return_budget.remaining_mission import hurried
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.air import Air
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import BatteryObservation, EnergyBelief, EnergyLedger
from companion.core.vehicle.power_bias import ModelError, PowerScale
from companion.core.wind.estimator import WindBelief, WindEstimator, WindObservation
from companion.core.wind.forecast import WindAhead, WindOutlook
from companion.core.wind.observation import WindFilter
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.shared_winds import SharedWinds

BATTERY_EVERY_S = 0.2
STEADY_HEIGHT_M = 10.0
"""Above this height measured power is compared with the model's."""

IDLE_THRUST = 0.15
"""Thrust command with which no multirotor hovers (it takes 0.3 to 0.6); PX4 keeps 0.12
(MPC_THR_MIN) until it detects the landing, ArduCopter less."""

IDLE_POWER_FRAC = 0.5
"""Of the empty vehicle's hover: the best speed of a multirotor takes about 0.8 of it."""

HURRY_EVERY_S = 20.0
"""How often the fastest airspeed is searched for, where the operator asks for it."""

HURRY_HALVINGS = 4
"""To within a sixteenth of the range of airspeeds."""

FOR_OPERATORS = ("wind: heading", "battery: the pack")
"""Beginnings of the warnings that are more than notes for the log."""

RESERVE_STEP_FRAC = 0.01
"""The gate is rebuilt when the reserve moved by more than this share."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What the operator accepts; may change in flight."""

    max_loss: float
    reserve_frac: float


@dataclass(frozen=True, slots=True)
class _Answer:
    """What the gate said to one outlook, and what later decisions may risk."""

    outlook: WindAhead
    accepted_loss: float | None
    seen: Assessment

    def because(self, words: str) -> "_Answer":
        """The same; its reason says by whom the wind is known."""
        if not words:
            return self
        return replace(self, seen=replace(self.seen, reason=f"{self.seen.reason}; {words}"))


class Estimates:
    """Holds the estimators and the gate of one vehicle."""

    def __init__(
        self,
        flight: Flight,
        airframe: Airframe,
        route_energy: RouteEnergy,
        wind_process: WindProcessParams,
        wind_filter: WindFilter | None = None,
        doubts: Doubts = NO_DOUBTS,
        certificate: Certificate | None = None,
    ) -> None:
        """`wind_filter`: another wind estimator than ours, for a replay that compares them.
        `doubts`: what the monitor of the vehicle's service has found; believed from the start.
        `certificate`: what recorded days support of the draw; its envelope is watched.
        """
        self._flight = flight
        self._airframe = airframe
        self.route_energy = route_energy
        self.air: Air | None = None
        """The air that is flown in; `None` until it is settled, on the ground (`fly_in`)."""
        self.payload_kg = flight.vehicle.payload_kg
        self.limits = Limits(flight.mission.max_loss, flight.mission.reserve_frac)
        self._estimator = wind_filter or WindEstimator(airframe)
        in_doubt = doubts.wind_variance != 1.0
        believed = wind_process.times(doubts.wind_variance) if in_doubt else wind_process
        self._outlook = WindOutlook(believed)
        self._shared = SharedWind(believed)
        self._ledger = EnergyLedger(
            airframe,
            route_energy.hover_power_w(flight.vehicle.payload_kg),
            route_energy.density_kgpm3,
            health_frac=flight.vehicle.battery_health_frac * doubts.capacity_frac,
            temperature_c=flight.vehicle.temperature_c,
            charge_frac_stated=flight.vehicle.charge_frac_stated,
        )
        self._watch = EnvelopeWatch(certificate)
        self._scale = _believed_draw(airframe, doubts, certificate)
        self._tally = FlightTally(airframe.battery, flight.vehicle.battery_health_frac)
        # Of the file's own process: what is asked is whether that holds.
        self._stated_outlook = WindOutlook(wind_process) if in_doubt else self._outlook
        self._accepted_loss: float | None = None
        self.hurry_mps: float | None = None
        self._hurried_s: float | None = None
        self._gate: Gate | None = None
        self._gate_params: GateParams | None = None
        self.wind: WindBelief | None = None
        self._battery_s: float | None = None
        self._heard: dict[int | None, Battery] = {}
        self._left_out: set[str] = set()
        self._warned: set[str] = set()
        self.draw_change = ""
        """In words, at the tick at which the draw was found changed for good."""
        self.left_envelope: tuple[str, ...] = ()
        """In words, at the tick at which the certificate's envelope was left."""

    @property
    def energy(self) -> EnergyBelief | None:
        """Usable energy left, `None` while nothing is known."""
        return self._ledger.belief()

    def fly_in(self, air: Air) -> None:
        """Settle the air of this flight; before anything is priced, and not in flight."""
        self.air = air
        self.route_energy.fly_in(air.density_kgpm3)
        draw_w = self.route_energy.hover_power_w(self._flight.vehicle.payload_kg)
        self._ledger.fly_in(air.density_kgpm3, draw_w)

    def observe(self, now: TelemetryState, autopilot_kind: AutopilotKind) -> tuple[str, ...]:
        """Take the telemetry at a tick; returns new warnings, in words."""
        t_s = now.t_s
        self.draw_change = ""
        if self._battery_due(t_s):
            self._battery_s = t_s
            self._observe_battery(now, autopilot_kind, t_s)
        left_out = self._observe_wind(now, t_s)
        self.wind = self._estimator.belief(t_s)
        self.left_envelope = self._watch_envelope(now, t_s)
        if now.airborne:
            self._outlook.observe(self.wind)
            if self._stated_outlook is not self._outlook:
                self._stated_outlook.observe(self.wind)
            self._tally.wind(self.wind, self._stated_outlook)
            self._shared.feel(now, self.wind)
        warnings = [f"wind: {words}" for words in left_out if words not in self._left_out]
        self._left_out.update(left_out)
        energy = self.energy
        if energy is not None:
            told = (*now.pack_notes, *energy.warnings)
            kinds = {re.sub(r"[0-9.]+", "#", words): words for words in told}
            warnings += [f"battery: {w}" for kind, w in kinds.items() if kind not in self._warned]
            self._warned.update(kinds)
        return tuple(warnings)

    def hear_winds(self, winds: SharedWinds, t_s: float, age_s: float) -> None:
        """Take what the desk told of the winds that others feel, valid from `age_s` ago on."""
        self._shared.hear(winds, t_s, age_s)

    def wind_news(self, t_s: float) -> tuple[str, ...]:
        """What is new of the fleet's wind, in words."""
        return () if self.wind is None else self._shared.news(t_s, self._outlook, self.wind)

    def _watch_envelope(self, now: TelemetryState, t_s: float) -> tuple[str, ...]:
        temperature_c = None if self.air is None else self.air.known_temperature_c
        left = self._watch.settle(self.payload_kg, temperature_c)
        wind, airspeed_mps = self._wind_ne_mps, None
        if not now.airborne:
            return left
        if wind is not None and now.is_fresh(now.position, POSITION_MAX_AGE_S):
            airspeed_mps = _airspeed_mps(now, wind)
        return left + self._watch.observe(t_s, wind and math.hypot(*wind), airspeed_mps)

    @property
    def _wind_ne_mps(self) -> tuple[float, float] | None:
        """Where the air moves to, where that is known."""
        if self.wind is None or not self.wind.valid:
            return None
        north, east = (float(x) for x in self.wind.mean_to_ne_mps)
        return north, east

    @property
    def outside_envelope(self) -> tuple[str, ...]:
        """What is outside the certificate's envelope, in words."""
        return self._watch.outside

    def _model_error(self) -> ModelError:
        """Draw over the model's as the gate counts with it."""
        return self._watch.careful(self._scale.error())

    def _battery_due(self, t_s: float) -> bool:
        """Often enough, and at once where time went back."""
        last_s = self._battery_s
        return last_s is None or t_s < last_s or t_s - last_s >= BATTERY_EVERY_S - 1e-6

    def _observe_battery(
        self, now: TelemetryState, autopilot_kind: AutopilotKind, t_s: float
    ) -> None:
        battery = now.battery if now.is_fresh(now.battery, BATTERY_MAX_AGE_S) else None
        measured = battery is not None and battery.voltage_v is not None
        if not measured and self._ledger.belief() is None:
            return  # the ledger never rises: it must start from a pack that is measured
        current_a = battery.current_a if battery else None
        modelled_w = self._modelled_power_w(now)
        if battery and battery.voltage_v and current_a and modelled_w and self._is_steady(now):
            self._compare_power(battery.voltage_v * current_a, modelled_w, now.current_age_s)
        at_rest = now.state is not None and not now.armed and not now.airborne
        if battery is not None:
            volts, stands = battery.voltage_v, now.on_ground
            self._tally.battery(t_s, volts, current_a, at_rest=at_rest, on_ground=stands)
        seen = BatteryObservation(
            t_s=t_s,
            at_rest=at_rest,
            voltage_v=battery.voltage_v if battery else None,
            current_a=current_a,
            # PX4's SIH counts a percentage down by time and knows no current.
            remaining_is_timer=autopilot_kind is AutopilotKind.PX4 and current_a is None,
            temperature_c=battery.temperature_c if battery else None,
            modelled_power_w=modelled_w,
        )
        told = [new for new in now.pack_messages if new is not self._heard.get(new.pack)]
        self._heard.update({new.pack: new for new in told})
        # The first of several takes the time; the others tell their counters at the same instant.
        for one in [_told_by(seen, new) for new in told] or [seen]:
            self._ledger.observe(one)

    def _compare_power(self, measured_w: float, modelled_w: float, age_s: float) -> None:
        self._tally.compare(BATTERY_EVERY_S, measured_w, modelled_w, age_s)
        if self._scale.observe(BATTERY_EVERY_S, measured_w, modelled_w, age_s):
            error = self._scale.error()
            self.draw_change = f"draw {error.scale:.1f} +- {error.std:.1f} times the model's"

    def _is_steady(self, now: TelemetryState) -> bool:
        """In the air, above the ground's turbulence, with a valid wind estimate."""
        position = now.position
        high = position is not None and position.height_rel_m > STEADY_HEIGHT_M
        return now.airborne and high and self.wind is not None and self.wind.valid

    def _modelled_power_w(self, now: TelemetryState) -> float | None:
        if not now.armed:
            return None
        if now.on_ground or self._idles(now):
            return self._airframe.power_rotor.avionics_w
        if not now.is_fresh(now.position, POSITION_MAX_AGE_S):
            return self.route_energy.hover_power_w(self.payload_kg)
        position = now.position
        assert position is not None
        airspeed = _airspeed_mps(now, self._wind_ne_mps or (0.0, 0.0))
        return self.route_energy.power_w(self.payload_kg, airspeed, max(0.0, -position.vel_d_mps))

    def _idles(self, now: TelemetryState) -> bool:
        """Armed with motors that carry nothing, though no landing was detected.

        Two witnesses that share no sensor: the thrust command, and the current drawn.
        """
        battery, throttle = now.battery, now.throttle
        if battery is None or throttle is None or now.current_age_s > BATTERY_MAX_AGE_S:
            return False
        if not now.is_fresh(throttle, THROTTLE_MAX_AGE_S) or throttle.throttle_frac > IDLE_THRUST:
            return False
        drawn_w = (battery.voltage_v or 0.0) * (battery.current_a or 0.0)
        return 0.0 < drawn_w < IDLE_POWER_FRAC * self.route_energy.hover_power_w(0.0)

    def _observe_wind(self, now: TelemetryState, t_s: float) -> tuple[str, ...]:
        position = now.position if now.is_fresh(now.position, POSITION_MAX_AGE_S) else None
        if now.gnss is not None and not now.gnss.usable:
            position = None
        attitude = now.attitude if now.is_fresh(now.attitude, ATTITUDE_MAX_AGE_S) else None
        airspeed = now.airspeed if now.is_fresh(now.airspeed, AIRSPEED_MAX_AGE_S) else None
        wind = now.wind if now.is_fresh(now.wind, WIND_MAX_AGE_S) else None
        vehicle = self._flight.vehicle
        return self._estimator.update(
            WindObservation(
                t_s=t_s,
                airborne=now.airborne and (position is None or position.height_rel_m > 2.0),
                mass_kg=self._airframe.mass_kg(self.payload_kg),
                vel_ned_mps=(
                    (position.vel_n_mps, position.vel_e_mps, position.vel_d_mps)
                    if position
                    else None
                ),
                roll_rad=attitude.roll_rad if attitude else None,
                pitch_rad=attitude.pitch_rad if attitude else None,
                yaw_rad=attitude.yaw_rad if attitude else None,
                airspeed_mps=airspeed.forward_mps if airspeed and vehicle.pitot else None,
                airspeed_is_magnitude=airspeed is not None and airspeed.is_magnitude,
                autopilot_wind_to_ne_mps=(
                    (wind.to_n_mps, wind.to_e_mps) if wind and vehicle.autopilot_wind else None
                ),
                autopilot_wind_cov_m2ps2=_level_cov(wind),
                height_m=position.height_rel_m if position else None,
                density_kgpm3=self.route_energy.density_kgpm3,
                attitude_t_s=attitude.t_s if attitude else None,
                yaw_rate_rps=attitude.yaw_rate_rps if attitude else None,
            )
        )

    def assess(self, ahead: Ahead) -> Assessment | None:
        """Ask the gate; `None` while wind or energy are unknown."""
        energy = self.energy
        if energy is None or self.wind is None or not self.wind.valid:
            return None
        gate, wind, error = self._gate_for(energy), self.wind, self._model_error()
        accepted = self._accepted_loss

        def ask(outlook: WindAhead) -> _Answer:
            seen = gate.assess(ahead, wind, outlook, energy, error, accepted)
            return _Answer(outlook, accepted, seen)

        answer = self._in_shared_wind(ahead, wind.t_s, ask)
        if self.route_energy.speed_rule == "fastest":
            self._hurry(ahead, answer, energy)
        return answer.seen

    def _in_shared_wind(
        self, ahead: Ahead, t_s: float, ask: Callable[[WindAhead], "_Answer"]
    ) -> "_Answer":
        """The gate's answer in the wind that is believed. A front that was told counts only against
        flying on: the less hopeful answer stands.
        """
        shared = self._shared
        calm = ask(shared.outlook(ahead, self._outlook, t_s)).because(shared.used_words(t_s))
        front = shared.with_front(ahead, calm.outlook, t_s)
        if front is None:
            return calm
        behind = ask(front)
        worse = is_less_hopeful(behind.seen, calm.seen)
        return behind.because(f"{WORDS}: a front") if worse else calm

    def _hurry(self, ahead: Ahead, answer: "_Answer", energy: EnergyBelief) -> None:
        """Find the fastest airspeed that the budget allows, by bisection, now and then.

        The decisions themselves are taken with the speed of least energy: that one can still be
        flown later, whatever was flown until then.
        """
        seen = answer.seen
        if self.wind is None or (
            self._hurried_s is not None and 0.0 <= seen.t_s - self._hurried_s < HURRY_EVERY_S
        ):
            return
        self._hurried_s = seen.t_s
        slow, fast = 0.0, self.route_energy.fastest_airspeed_mps(self.payload_kg)
        for halvings in range(1 + HURRY_HALVINGS):
            speed = fast if halvings == 0 else 0.5 * (slow + fast)
            faster = self._gate_for(energy).assess(
                hurried(ahead, speed),
                self.wind,
                answer.outlook,
                energy,
                self._model_error(),
                self._accepted_loss,
                weighs_worth=False,
            )
            if _as_good(faster, seen, self.limits.max_loss):
                slow = speed
            else:
                fast = speed
            if slow >= fast:
                break
        self.hurry_mps = slow if slow > self.route_energy.slowest_airspeed_mps else None

    def depart(self, ahead: Ahead) -> Assessment | None:
        """Ask the gate for the whole mission, over the depot; settles what decisions may risk."""
        energy = self.energy
        if energy is None or self.wind is None or not self.wind.valid:
            return None
        gate, wind, error = self._gate_for(energy), self.wind, self._model_error()

        def ask(outlook: WindAhead) -> _Answer:
            return _Answer(outlook, *gate.depart(ahead, wind, outlook, energy, error))

        answer = self._in_shared_wind(ahead, wind.t_s, ask)
        self._accepted_loss = answer.accepted_loss
        return answer.seen

    def limit(self, limits: Limits) -> None:
        """The operator accepts something else from now on."""
        self.limits = limits
        self._accepted_loss = None

    def _gate_for(self, energy: EnergyBelief) -> Gate:
        reserve_wh = self.limits.reserve_frac * energy.usable_full_wh
        params = self._gate_params
        if (
            self._gate is None
            or params is None
            or params.max_loss != self.limits.max_loss
            or abs(params.reserve_wh - reserve_wh) > RESERVE_STEP_FRAC * max(reserve_wh, 1.0)
        ):
            self._gate_params = GateParams(max_loss=self.limits.max_loss, reserve_wh=reserve_wh)
            self._gate = Gate(self.route_energy, self._gate_params)
        return self._gate

    def ground_speed_mps(self, here_ned_m: Ned, to_ned_m: Ned) -> float | None:
        """Ground speed to command towards a point; `None` while the wind is unknown."""
        if self.wind is None or not self.wind.valid:
            return None
        hurry = self.hurry_mps
        leg = Leg(LegKind.CRUISE, here_ned_m, to_ned_m, self.payload_kg, airspeed_mps=hurry)
        return self.route_energy.ground_speed_mps(leg, self.wind.mean_to_ne_mps)

    def figures(self) -> FlightFigures:
        """What this flight tells the monitor of the vehicle's service, so far."""
        return self._tally.figures()

    def snapshot(self) -> dict[str, object]:
        """What the checkpoint keeps."""
        return {
            "tally": self._tally.snapshot(),
            "ledger": self._ledger.snapshot(),
            "outlook": self._outlook.snapshot(),
            "scale": self._scale.snapshot(),
            "wind": self._estimator.snapshot(),
            "payload_kg": self.payload_kg,
            "max_loss": self.limits.max_loss,
            "accepted_loss": self._accepted_loss,
            "reserve_frac": self.limits.reserve_frac,
            "air": None if self.air is None else asdict(self.air),
            "outside_envelope": self._watch.snapshot(),
        }

    def restore(self, kept: "EstimatesSnapshot") -> None:
        """Go on from a checkpoint: energy never rises, and the air is the one that was settled."""
        if kept.air is not None:
            self.fly_in(kept.air)
        self._ledger.restore(kept.ledger)
        self._outlook.restore(kept.outlook)
        self._scale.restore(kept.scale)
        self._estimator.restore(kept.wind)
        if kept.tally is not None:
            self._tally.restore(kept.tally)
        self._watch.restore(kept.outside_envelope)
        self.payload_kg = kept.payload_kg
        self.limits = Limits(kept.max_loss, kept.reserve_frac)
        self._accepted_loss = kept.accepted_loss


def _believed_draw(
    airframe: Airframe, doubts: Doubts, certificate: Certificate | None
) -> PowerScale:
    """Draw over the model's before the flight: never better than the airframe file says."""
    log, std = doubts.draw_log, airframe.power_rotor.model_std_frac
    if certificate is not None:
        log, std = max(log, certificate.draw_log), max(std, certificate.draw_std_frac)
    return PowerScale(math.hypot(std, doubts.draw_std), prior_log=log)


def _airspeed_mps(now: TelemetryState, wind_ne_mps: tuple[float, float]) -> float:
    """Horizontal; the position is known."""
    assert now.position is not None
    north, east = wind_ne_mps
    return math.hypot(now.position.vel_n_mps - north, now.position.vel_e_mps - east)


def _told_by(seen: BatteryObservation, message: Battery) -> BatteryObservation:
    """The same instant with the counters and the percentage of one message."""
    ah, joule = message.consumed_ah, message.consumed_j
    return replace(
        seen,
        consumed_mah=None if ah is None else ah * 1000.0,
        consumed_wh=None if joule is None else joule / 3600.0,
        remaining_frac=message.remaining_frac,
        source="vehicle" if message.pack is None else f"pack {message.pack}",
    )


def _as_good(faster: Assessment, seen: Assessment, max_loss: float) -> bool:
    """Whether flying faster keeps the promise, and costs no more delivery than it may lose."""
    kept = faster.p_home >= 1.0 - max_loss and faster.turn_back == seen.turn_back
    return kept and faster.p_success >= seen.p_success - max_loss


def _level_cov(wind: AutopilotWind | None) -> tuple[float, float, float] | None:
    """(nn, ne, ee) of the autopilot's wind where it says how wrong it is, the same on both axes."""
    if wind is None or wind.std_mps is None:
        return None
    return wind.std_mps**2, 0.0, wind.std_mps**2


@dataclass(frozen=True, slots=True)
class EstimatesSnapshot:
    """`Estimates.snapshot` as read from a checkpoint."""

    ledger: dict[str, object]
    outlook: dict[str, object]
    scale: dict[str, object]
    wind: dict[str, object]
    payload_kg: float
    max_loss: float
    accepted_loss: float | None
    reserve_frac: float
    air: Air | None = None
    tally: dict[str, object] | None = None
    outside_envelope: dict[str, str] = field(default_factory=dict)
