"""One drone of the simulated day: powered off on the truck, or powered on.

Each time the driver places it on a pad, it gets a charged pack and boots there with its companion.
Positions are NED metres about the day's depot. Times are the day's.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sim_bridge.app.day.clock import EPOCH_US
from sim_bridge.app.day.companion import SteppedCompanion
from sim_bridge.app.day.judge import VehicleTrack
from sim_bridge.app.link.operator import Operator
from sim_bridge.app.world.companion_link import (
    COMPANION_LINK,
    OPERATOR_LINK,
    CompanionLink,
)
from sim_bridge.app.world.safety_rules import TakeOver, format_sent_command
from sim_bridge.app.world.truth_record import TruthRecord
from sim_bridge.app.world.vehicle_host import (
    Home,
    VehicleHost,
    power_up_vehicle,
    true_reserve_wh,
)
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.kinds import AutopilotKind, LinkKind
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.terrain import Terrain
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import MeanWind
from sim_bridge.truth.wind_params import WindParams, build_wind_field

COMPANION_BOOT_S = 8.0
"""From power-on to a companion on the network. A Raspberry Pi class computer takes 10 to 20 s; this
value is shorter, to save time. The autopilot's own boot is simulated in parallel."""

BOOTED_AGE_S = 60.0
"""Time after power-on at which both autopilots' estimators are ready."""

RESTART_DELAY_S = 6.0
"""systemd's restart delay of 1 s plus start-up (deploy/leeway-companion-fleet.service)."""


MANUAL_DISARM_DELAY_S = 45.0
"""After this time the companion has stopped trying to disarm and reported it."""


@dataclass(frozen=True, slots=True)
class DelayedMeanWind:
    """The day's mean wind on the time axis of a vehicle powered on at `from_s`."""

    mean: MeanWind
    from_s: float

    def to_ne_mps(self, t_s: float) -> tuple[float, float]:
        """Return the wind towards north and east, `time_since_power_on_s` after power-on."""
        return self.mean.to_ne_mps(self.from_s + t_s)


@dataclass(frozen=True, slots=True)
class DroneWorld:
    """Data common to all drones of a day. `site`: latitude, longitude (deg), height AMSL (m).

    `air_temperature_c` None: each drone's own temperature.
    """

    site: tuple[float, float, float]
    terrain: Terrain
    wind: WindParams
    mean: MeanWind
    mavlink_loss: float = 0.0
    air_temperature_c: float | None = None


@dataclass(slots=True)
class PowerCycle:
    """One power cycle: vehicle, autopilot, pad and true trajectory in the day's time.

    `t0_s`: power-on time.
    """

    t0_s: float
    pad_ne_m: tuple[float, float]
    order: str | None
    host: VehicleHost
    link: CompanionLink
    record: TruthRecord = field(default_factory=TruthRecord)

    def __post_init__(self) -> None:
        self.host.sample = self._record_truth_sample
        self.record.has_parcel = self.vehicle.parcel_aboard

    @property
    def vehicle(self) -> Vehicle:
        """Physics of the vehicle."""
        return self.host.vehicle

    @property
    def autopilot(self) -> Autopilot:
        """Autopilot of the vehicle."""
        return self.host.autopilot

    @property
    def time_since_power_on_s(self) -> float:
        """Seconds since power-on."""
        return self.host.t_s

    @property
    def command_texts_after_takeover(self) -> list[str]:
        """Descriptions of commands sent after the companion could know of a take-over."""
        return [
            format_sent_command((self.t0_s + t_s, name, number))
            for t_s, name, number in self.link.late_commands
        ]

    def load_or_remove_parcel(self, payload_kg: float, order_id: str | None) -> None:
        """Load the parcel of another order, or none."""
        self.vehicle.load_parcel(payload_kg)
        self.order, self.record.has_parcel = order_id, self.vehicle.parcel_aboard

    def _record_truth_sample(self) -> None:
        self.record.append_sample_and_record_events(
            self.t0_s + self.time_since_power_on_s,
            self.vehicle.truth,
            self.vehicle.height_m,
            under_external_control=self.autopilot.is_under_external_control,
        )


@dataclass(slots=True)
class DayDrone:
    """A drone. `number`: MAVLink system id. `power_cycle` is None while it is powered off."""

    name: str
    number: int
    autopilot_kind: str
    airframe: AirframeTruth
    temperature_c: float
    battery_health_frac: float
    pack_charge_range_frac: tuple[float, float]
    world: DroneWorld
    folder: Path
    seeds: np.random.SeedSequence
    start_companion: Callable[["DayDrone"], SteppedCompanion]
    companion: SteppedCompanion | None = None
    power_cycle: PowerCycle | None = None
    ended_power_cycles: list[PowerCycle] = field(default_factory=list)
    companion_start_count: int = 0
    companion_due_s: float | None = None
    lost_frames: int = 0
    manual_disarm_count: int = 0
    wall_clock_offset_s: float = 0.0
    """Offset of its companion's wall clock from the day's (positive: fast)."""
    unexpected_exit_times_s: list[float] = field(default_factory=list)
    """Times at which a companion ended without a kill or power-off."""
    _loss_rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        (child,) = self.seeds.spawn(1)
        self._loss_rng = np.random.default_rng(child)

    # --- ground handling -----------------------------------------------------------------------

    @property
    def carries_parcel(self) -> bool:
        """Whether the parcel is attached, as visible to the driver."""
        return self.power_cycle is not None and self.power_cycle.vehicle.parcel_aboard

    def switch_on_at_pad(
        self,
        t_s: float,
        pad_ne_m: tuple[float, float],
        payload_kg: float,
        order_id: str | None,
        *,
        already_booted: bool = False,
    ) -> None:
        """Power on at a pad, with a parcel and a charged pack.

        `already_booted`: autopilot and companion have already booted.
        """
        self.switch_off_and_end_power_cycle()
        charge_seed, gust_seed, sensor_seed = self.seeds.spawn(3)
        charge_frac = float(
            np.random.default_rng(charge_seed).uniform(*self.pack_charge_range_frac)
        )
        world = self.world
        wind = build_wind_field(
            world.wind, DelayedMeanWind(world.mean, t_s), np.random.default_rng(gust_seed)
        )
        host = power_up_vehicle(
            AutopilotKind(self.autopilot_kind),
            self.airframe,
            home=Home(*world.site),
            wind_field=wind,
            seed=sensor_seed,
            system_id=self.number,
            boot_age_s=BOOTED_AGE_S if already_booted else 0.0,
            epoch_unix_s=EPOCH_US / 1e6 + t_s,  # GNSS time is the same for all drones
            terrain=world.terrain,
            payload_kg=payload_kg,
            charge_frac=charge_frac,
            temperature_c=self.temperature_c,
            air_temperature_c=world.air_temperature_c,
            battery_health_frac=self.battery_health_frac,
            start_ne_m=pad_ne_m,
        )
        host.autopilot.add_link(COMPANION_LINK, LinkKind.ONBOARD)
        loses_frame = self._draw_and_count_frame_loss if world.mavlink_loss > 0.0 else None
        link = CompanionLink(host, self.number, draw_frame_loss=loses_frame, records_commands=False)
        self.power_cycle = PowerCycle(t_s, pad_ne_m, order_id, host, link)
        self.companion_due_s = t_s if already_booted else t_s + COMPANION_BOOT_S

    def switch_off_and_end_power_cycle(self) -> None:
        """Power off autopilot and companion; an armed autopilot is disarmed manually first."""
        self.manual_disarm_count += (
            self.power_cycle is not None and self.power_cycle.autopilot.is_armed
        )
        if self.companion is not None:
            self.companion.kill()
            self.companion = None
        self.companion_due_s = None
        if self.power_cycle is not None:
            self.ended_power_cycles.append(self.power_cycle)
            self.power_cycle = None

    # --- time ----------------------------------------------------------------------------------

    def advance_and_exchange_messages(self, end_time_s: float, physics_steps: int) -> None:
        """Advance by `physics_steps` physics steps, then exchange messages;
        `time_since_power_on_s`: time after the steps.
        """
        power_cycle = self.power_cycle
        if power_cycle is None:
            return
        power_cycle.host.advance(physics_steps)
        self._record_exit_and_start_companion_if_due(end_time_s)
        self._exchange_messages(power_cycle, end_time_s)

    def _record_exit_and_start_companion_if_due(self, t_s: float) -> None:
        if self.companion is not None and not self.companion.is_running:
            self.companion = None
            self.companion_due_s = t_s + RESTART_DELAY_S
            self.unexpected_exit_times_s.append(t_s)
        if self.companion_due_s is not None and t_s >= self.companion_due_s:
            self.companion_due_s = None
            self.companion_start_count += 1
            self.companion = self.start_companion(self)

    def _exchange_messages(self, power_cycle: PowerCycle, t_s: float) -> None:
        if self.companion is None:
            power_cycle.link.discard_companion_frames()
            return
        datagrams = power_cycle.link.take_datagrams_for_companion(
            round(power_cycle.time_since_power_on_s * 1e9)
        )
        if power_cycle.link.takeover is not None:
            power_cycle.link.takeover.record_reported_modes(
                power_cycle.time_since_power_on_s, self.autopilot_kind, datagrams
            )
        for datagram in self.companion.process_datagrams(datagrams):
            power_cycle.link.pass_datagram_to_autopilot(datagram)

    def _draw_and_count_frame_loss(self) -> bool:
        lost = self._loss_rng.random() < self.world.mavlink_loss
        self.lost_frames += lost
        return lost

    def build_vehicle_track(self, power_cycle: PowerCycle, reserve_frac: float) -> VehicleTrack:
        """Return the track of one power cycle for the verdict."""
        vehicle, takeover = power_cycle.vehicle, power_cycle.link.takeover
        reserve_wh = true_reserve_wh(
            vehicle, self.airframe, self.temperature_c, self.battery_health_frac, reserve_frac
        )
        return VehicleTrack(
            vehicle=self.name,
            autopilot=self.autopilot_kind,
            order=power_cycle.order,
            record=power_cycle.record,
            reserve_wh=reserve_wh,
            override_time_s=None
            if takeover is None or takeover.start_s is None
            else power_cycle.t0_s + takeover.start_s,
        )

    def command_rtl_from_second_station(self, t_s: float) -> None:
        """Command return to launch from a second ground station."""
        assert self.power_cycle is not None
        self.power_cycle.link.takeover = TakeOver(t_s - self.power_cycle.t0_s)
        self.power_cycle.link.records_commands = True
        self._send_frames_as_second_station(
            Operator(self.number).rtl_command_frames(self.autopilot_kind)
        )

    def _send_frames_as_second_station(self, frames: list[bytes]) -> None:
        """Send frames of a second ground station to the autopilot."""
        assert self.power_cycle is not None
        autopilot = self.power_cycle.autopilot
        autopilot.add_link(OPERATOR_LINK, LinkKind.GCS)
        for frame in frames:
            autopilot.process_received_datagram(OPERATOR_LINK, frame)

    def disarm_manually(self) -> None:
        """Disarm a landed drone that stays armed, as its attendant; it stays powered on."""
        self._send_frames_as_second_station(Operator(self.number).forced_disarm_command_frames())
        self.manual_disarm_count += 1

    def kill_companion_and_schedule_restart(self, t_s: float) -> None:
        """Kill the companion (SIGKILL); its service restarts it after RESTART_S."""
        if self.companion is not None:
            self.companion.kill()
            self.companion = None
            self.companion_due_s = t_s + RESTART_DELAY_S

    # --- state ---------------------------------------------------------------------------------

    @property
    def all_power_cycles(self) -> list[PowerCycle]:
        """All power cycles; the current one is the last."""
        return [
            *self.ended_power_cycles,
            *([self.power_cycle] if self.power_cycle is not None else []),
        ]

    @property
    def is_airborne(self) -> bool:
        """Whether it is airborne now."""
        return self.power_cycle is not None and self.power_cycle.vehicle.is_airborne

    def time_since_takeoff_s(self, t_s: float) -> float:
        """Return the time (s) since take-off; 0 on the ground."""
        since_s = None if self.power_cycle is None else self.power_cycle.record.airborne_since_s
        return 0.0 if since_s is None else t_s - since_s

    def can_driver_approach_on_ground(
        self, t_s: float, search_centre_ne_m: tuple[float, float], search_radius_m: float
    ) -> bool:
        """Return whether a driver may approach it there: disarmed, or landed for long enough.

        An ArduCopter that does not detect its landing (measured, with wind on the ground) stays
        armed at idle, and its companion reports "disarm by hand". The driver then disarms it.
        """
        power_cycle = self.power_cycle
        if power_cycle is None or self.is_airborne:
            return False
        if (
            power_cycle.autopilot.is_armed
            and self.time_since_last_airborne_s(t_s) < MANUAL_DISARM_DELAY_S
        ):
            return False
        return math.dist(power_cycle.vehicle.pos_ned_m[:2], search_centre_ne_m) <= search_radius_m

    def needs_manual_disarm(self, t_s: float) -> bool:
        """Return whether it is landed but armed, so that its companion reports "disarm by hand"."""
        power_cycle = self.power_cycle
        if power_cycle is None or self.is_airborne or not power_cycle.autopilot.is_armed:
            return False
        return (
            not power_cycle.vehicle.is_crashed
            and self.time_since_last_airborne_s(t_s) >= MANUAL_DISARM_DELAY_S
        )

    def time_since_last_airborne_s(self, t_s: float) -> float:
        """Return the time (s) since the last flight; 0 if it has not flown."""
        last = None if self.power_cycle is None else self.power_cycle.record.last_airborne_s
        return t_s - last if last is not None else 0.0
