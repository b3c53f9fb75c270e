"""One simulated vehicle of a run: physics, autopilot, operator, companion process, record."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.core.base.geo import location_to_ground_ned_m
from companion.core.base.location import Location
from companion.core.mission.flight_file import Flight, Terrain
from companion.core.mission.flight_plan import depot_frame
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.link.operator import Operator
from sim_bridge.app.world.companion_link import COMPANION_LINK, OPERATOR_LINK, CompanionLink
from sim_bridge.app.world.flight_phase import FlightPhase, phase_in_air
from sim_bridge.app.world.truth_record import TruthRecord
from sim_bridge.app.world.vehicle_host import VehicleHost
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.truth import terrain as ground
from sim_bridge.truth.terrain import load_grid_terrain
from sim_bridge.truth.vehicle import Vehicle

LANDED_SETTLING_S = 5.0
RESTART_LIMIT_S = 60.0
"""Time on the ground after which a killed companion is not restarted."""

COMPANION_END_LIMIT_S = 30.0  # time for the companion to close its record and exit
ARMED_AFTER_LANDING_LIMIT_S = (
    60.0  # landings that the autopilot does not detect (measured on ArduCopter)
)
_CENTRED_CHANNELS_US = [1500, 1500, 1500, 1500, 1500, 1500, 1000, 1000]
CHANNEL_CENTRE_US = 1500
PILOT_CHANNELS = {
    "ardupilot": [
        *_CENTRED_CHANNELS_US[:4],
        1750,
        *_CENTRED_CHANNELS_US[5:],
    ],  # FLTMODE_CH 5: a switch moved to LOITER
    "px4": [1700, *_CENTRED_CHANNELS_US[1:]],  # roll stick deflected: MAN_OVERRIDE_SPD
}


@dataclass(slots=True)
class Craft:
    """One vehicle of a run with all its components; `t_s` counts from power-up."""

    number: int
    autopilot_kind: str
    flight: Flight
    charge_frac: float
    depot: Location
    host: VehicleHost
    terrain: ground.Terrain
    operator: Operator
    companion: CompanionProcess
    run_dir: Path
    record: TruthRecord = field(default_factory=TruthRecord)
    started_faults: list[tuple[float, str]] = field(default_factory=list)
    """Start time and kind of the faults of the flight file."""
    is_companion_returning: bool = False
    """The companion was restarted or resumed, and its first reply is pending."""
    link: CompanionLink = field(init=False)

    def __post_init__(self) -> None:
        self.link = CompanionLink(
            self.host, self.number, {OPERATOR_LINK: self.operator.process_received_datagram}
        )
        self.host.sample = self._record_truth_sample

    @property
    def vehicle(self) -> Vehicle:
        """Physics of the vehicle."""
        return self.host.vehicle

    @property
    def autopilot(self) -> Autopilot:
        """Autopilot of the vehicle."""
        return self.host.autopilot

    @property
    def t_s(self) -> float:
        """Simulated time since power-up."""
        return self.host.t_s

    def advance_and_deliver_frames(self, physics_steps: int) -> None:
        """Run `physics_steps` 100 Hz steps, then deliver frames of the operator and the forger."""
        self.host.advance(physics_steps)
        for frame in self.operator.collect_due_frames(self.t_s):
            self.autopilot.process_received_datagram(OPERATOR_LINK, frame)
        if self.link.forger is not None:
            for frame in self.link.forger.forge_to_autopilot():
                self.autopilot.process_received_datagram(COMPANION_LINK, frame)

    def _record_truth_sample(self) -> None:
        truth = self.vehicle.truth
        self.record.append_sample_and_record_events(
            truth.t_s,
            truth,
            self.vehicle.height_m,
            under_external_control=self.autopilot.is_under_external_control,
        )

    def start_pilot_override(self) -> None:
        """Start a pilot override: set the mode switch or sticks that select position hold."""
        self.autopilot.set_receiver_channels(PILOT_CHANNELS[self.autopilot_kind])

    def set_pilot_throttle(self, throttle_us: int) -> None:
        """Set the pilot's throttle during an override, other sticks centred."""
        channels = list(PILOT_CHANNELS[self.autopilot_kind])
        channels[:4] = [CHANNEL_CENTRE_US, CHANNEL_CENTRE_US, throttle_us, CHANNEL_CENTRE_US]
        self.autopilot.set_receiver_channels(channels)

    def command_rtl_from_ground_station(self) -> None:
        """Command the vehicle home by a mode change from another ground station."""
        for frame in self.operator.rtl_command_frames(self.autopilot_kind):
            self.autopilot.process_received_datagram(OPERATOR_LINK, frame)

    @property
    def true_flight_phase(self) -> FlightPhase:
        """True flight phase."""
        record = self.record
        if record.takeoff_s is None:
            return FlightPhase.READY
        if record.landed_s is not None:
            return FlightPhase.DOWN
        _, north, east, down, *_ = record.rows[-1]
        return phase_in_air(
            (north, east),
            -down,
            has_parcel=record.has_parcel,
            pad_ne_m=(0.0, 0.0),
            customer_ne_m=location_ne_m(self.flight.site.customer, self.depot),
            landing_ne_m=self.home_ne_m,
        )

    @property
    def home_stop_name(self) -> str | None:
        """Name of the stop that is home; `None`: home is the launch pad.

        A home reported by the vehicle to the ground station replaces that of the flight file.
        """
        site = self.flight.site
        is_reported = self.operator.landing_stop in {stop.name for stop in site.stops}
        return self.operator.landing_stop if is_reported else site.home

    @property
    def home_ne_m(self) -> tuple[float, float]:
        """Home position, north and east of the launch pad."""
        return (0.0, 0.0) if self.home_stop_name is None else self.stop_ne_m(self.home_stop_name)

    def stop_ne_m(self, stop_name: str) -> tuple[float, float]:
        """Return the position of a stop's pad, north and east of the launch pad."""
        stops = {stop.name: stop for stop in self.flight.site.stops}
        return location_ne_m(stops[stop_name], self.depot)

    def request_landing_stop(self, stop_name: str) -> None:
        """Request another landing stop from the ground station."""
        lat_rad, lon_rad, _ = depot_frame(self.depot).to_geodetic((*self.stop_ne_m(stop_name), 0.0))
        self.operator.start_requesting_landing_stop(math.degrees(lat_rad), math.degrees(lon_rad))

    @property
    def is_finished(self) -> bool:
        """True if the vehicle has landed and its companion ended, or if it did not take off."""
        if self.record.landed_s is not None:
            down_s = self.t_s - self.record.landed_s
            over = self.record.crashed or not self.autopilot.is_armed
            concluded = not self.companion.is_running or down_s > COMPANION_END_LIMIT_S
            return (
                over and concluded and down_s > LANDED_SETTLING_S
            ) or down_s > ARMED_AFTER_LANDING_LIMIT_S
        if self.record.takeoff_s is not None or self.companion.start_count == 0:
            return False
        may_restart = self.companion.was_killed and self.t_s < RESTART_LIMIT_S
        return not self.companion.is_running and not may_restart


def location_ne_m(location: Location, depot: Location) -> tuple[float, float]:
    """Return north and east of a location from the depot, in metres."""
    if location.east_m is not None and location.north_m is not None:
        return location.north_m, location.east_m
    north, east, _ = location_to_ground_ned_m(depot_frame(depot), location)
    return north, east


def build_terrain(terrain: Terrain, folder: Path) -> ground.Terrain:
    """Return the ground of the simulated world from the flight file's table.

    Raise LeewayError if a height is null: the simulated ground needs all heights.
    """
    if terrain.heights is not None:
        table = terrain.heights
        ups = [[up for up in row if up is not None] for row in table.up_m]
        if any(len(row) != len(table.lateral_m) for row in ups):
            raise LeewayError(
                "site.terrain.heights.up_m: null; the simulated ground needs all heights"
            )
        grid = ground.GridTerrain(table.longitudinal_m, table.lateral_m, ups)
        return ground.RotatedTerrain(grid, table.course_deg)
    if terrain.kind == "grid":
        return load_grid_terrain(folder / str(terrain.grid))
    if terrain.kind == "plane":
        return ground.PlaneTerrain(terrain.slope_north_frac, terrain.slope_east_frac)
    return ground.PlaneTerrain()
