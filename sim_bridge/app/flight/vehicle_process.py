"""One simulated vehicle as flown: physics, autopilot, operator, companion process, record."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.core.base.geo import place_ned
from companion.core.base.place import Place
from companion.core.mission.flight_file import Flight, Terrain
from companion.core.mission.flight_plan import frame_at
from sim_bridge.adapters.endpoint import bundled
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.flight.forger import Forger
from sim_bridge.app.flight.operator import Operator
from sim_bridge.app.flight.record import TruthRecord
from sim_bridge.app.link.bad_link import BadLink
from sim_bridge.app.link.tap import Tap
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from sim_bridge.truth import terrain as ground
from sim_bridge.truth.terrain_file import load_grid_terrain
from sim_bridge.truth.vehicle import Vehicle

COMPANION_LINK = 0
OPERATOR_LINK = 1
PHYSICS_STEP_S = 0.01
SETTLED_S = 5.0
CONCLUDE_WITHIN_S = 30.0  # the companion sees the landing, closes its record and ends
STUCK_ARMED_S = 60.0  # a landing that the autopilot never notices (measured on ArduCopter)
RECORD_EVERY_STEPS = 20
COMMANDING = {  # what changes the flight; telemetry and questions do not
    "COMMAND_LONG",
    "COMMAND_INT",
    "SET_MODE",
    "MISSION_COUNT",
    "MISSION_ITEM_INT",
    "MISSION_SET_CURRENT",
    "MISSION_CLEAR_ALL",
    "MISSION_WRITE_PARTIAL_LIST",
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_ATTITUDE_TARGET",
    "RC_CHANNELS_OVERRIDE",
    "MANUAL_CONTROL",
    "PARAM_SET",
}
MAV_RESULT_FAILED = 4
MISSION_CUSTOM_MODE = {"px4": 4 << 16 | 4 << 24, "ardupilot": 3}
ASKING = {410, 511, 512, 519, 520, 521}  # requests for messages and intervals
LANDING_M, LANDING_HEIGHT_M = 10.0, 20.0  # about home; above the depot
_CENTRED = [1500, 1500, 1500, 1500, 1500, 1500, 1000, 1000]
STICK_CENTRED = 1500
PILOT_CHANNELS = {
    "ardupilot": [*_CENTRED[:4], 1750, *_CENTRED[5:]],  # FLTMODE_CH 5: a switch moved to LOITER
    "px4": [1700, *_CENTRED[1:]],  # the roll stick pushed over: MAN_OVERRIDE_SPD
}


@dataclass(slots=True)
class Craft:
    """A vehicle and everything about it; `t_s` runs from power-up."""

    number: int
    autopilot_kind: str
    flight: Flight
    charge_frac: float
    depot: Place
    vehicle: Vehicle
    autopilot: Autopilot
    terrain: ground.Terrain
    operator: Operator
    companion: CompanionProcess
    run_dir: Path
    record: TruthRecord = field(default_factory=TruthRecord)
    steps: int = 0
    link_silent_until_s: float = -1.0
    bad_link: BadLink | None = None
    forger: Forger | None = None
    tap: Tap | None = None
    others: dict[int, Callable[[float, bytes], None]] = field(default_factory=dict)
    """Links of other ground stations, by number: what takes the frames that they are sent."""
    refused: frozenset[tuple[str, int]] = frozenset()
    commands: list[tuple[float, str, int]] = field(default_factory=list)
    _decoder: Decoder = field(default_factory=Decoder)
    _refusals: list[bytes] = field(default_factory=list)
    companion_returns: bool = False
    """It was started again, or goes on after a stall: its answer is waited for."""

    @property
    def t_s(self) -> float:
        """Simulated time since power-up."""
        return self.steps * PHYSICS_STEP_S

    def advance(self, steps: int) -> None:
        """Run physics and autopilot for some 100 Hz steps, recording truth at 5 Hz."""
        vehicle, autopilot = self.vehicle, self.autopilot
        for _ in range(steps):
            autopilot.step(vehicle.step(autopilot.actuation, PHYSICS_STEP_S), PHYSICS_STEP_S)
            self.steps += 1
            if self.steps % RECORD_EVERY_STEPS == 0:
                truth = vehicle.truth
                north, east, _ = truth.pos_ned_m
                up_m = self.terrain.up_m(north, east)
                self.record.add(truth, up_m, flown_by_person=autopilot.is_flown_by_person)
        for frame in self.operator.frames(self.t_s):
            autopilot.receive(OPERATOR_LINK, frame)
        if self.forger is not None:
            for frame in self.forger.to_autopilot():
                autopilot.receive(COMPANION_LINK, frame)

    @property
    def link_up(self) -> bool:
        """False while the link fault lasts."""
        return self.t_s >= self.link_silent_until_s

    def ask(self, t_ns: int) -> list[bytes]:
        """Datagrams for the companion: what the autopilot says, and TIMESYNC of `t_ns` last.

        What it says to the operator is delivered here. A silent link still carries TIMESYNC: it
        is what time stands still for, not what the vehicle says.
        """
        said = [*self._said_to_companion(), *self._refusals]
        self._refusals = []
        if self.tap is not None:
            said = self.tap.down(said, self.t_s)
        out = said if self.link_up else []
        if self.bad_link is not None and self.link_up:
            out = self.bad_link.spoil(out, self.autopilot.time_boot_ms)
        else:
            out = bundled(out)
        if self.forger is not None and self.link_up:
            out += self.forger.to_companion()
        self.autopilot.request_timesync(COMPANION_LINK, t_ns)
        return [*out, *bundled(self._said_to_companion())]

    def _said_to_companion(self) -> list[bytes]:
        frames: list[bytes] = []
        for link, frame in self.autopilot.take_outbox():
            if link == OPERATOR_LINK:
                self.operator.receive(self.t_s, frame)
            elif link in self.others:
                self.others[link](self.t_s, frame)
            else:
                frames.append(frame)
        return frames

    def pilot_takes_over(self) -> None:
        """The pilot takes the sticks: the mode switch goes to position hold."""
        self.autopilot.set_rc(PILOT_CHANNELS[self.autopilot_kind])

    def pilot_moves(self, throttle_us: int) -> None:
        """The pilot, who has taken over, holds the sticks like this."""
        channels = list(PILOT_CHANNELS[self.autopilot_kind])
        channels[:4] = [STICK_CENTRED, STICK_CENTRED, throttle_us, STICK_CENTRED]
        self.autopilot.set_rc(channels)

    def ground_takes_over(self) -> None:
        """Another ground station orders the vehicle home by mode change."""
        for frame in self.operator.mode_change(self.autopilot_kind):
            self.autopilot.receive(OPERATOR_LINK, frame)

    def receive(self, datagram: bytes) -> None:
        """A datagram from the companion."""
        if not self.link_up:
            return
        for message in self._decoder.feed(datagram):
            number = message.__dict__.get("command", 0)
            if message.msg_name in COMMANDING and number not in ASKING:
                self.commands.append((self.t_s, message.msg_name, number))
            if (message.msg_name, number) in self.refused:
                self._refuse(number)
                return
        passed = datagram if self.tap is None else self.tap.up(datagram)
        self.autopilot.receive(COMPANION_LINK, passed)

    def _refuse(self, command: int) -> None:
        """Answer a command with FAILED; what is no command (PX4's jump) is left without effect."""
        if command:
            ack = Message("COMMAND_ACK", command=command, result=MAV_RESULT_FAILED)
            self._refusals.append(Encoder(self.number, 1).encode(ack))

    @property
    def phase(self) -> str:
        """Where in the mission it truly is: start, climb, outbound, drop, return, landing, down."""
        record = self.record
        if record.took_off_s is None:
            return "start"
        if record.landed_s is not None:
            return "down"
        truth = record.rows[-1]
        away_m = math.hypot(truth[1], truth[2])
        home_m = math.dist((truth[1], truth[2]), self.home_ne_m)
        customer = place_ne_m(self.flight.site.customer, self.depot)
        if truth[-1] == 0.0:
            return "landing" if home_m < LANDING_M and -truth[3] < LANDING_HEIGHT_M else "return"
        if math.dist((truth[1], truth[2]), customer) < 15.0:
            return "drop"
        return "outbound" if away_m > 30.0 else "climb"

    @property
    def home(self) -> str | None:
        """The stop that the truck stays bound to, `None` without one: home is the launch pad.

        A promise is void once the vehicle told the ground station that it ends elsewhere.
        """
        site = self.flight.site
        told = self.operator.home in {stop.name for stop in site.stops}
        return self.operator.home if told else site.home

    @property
    def home_ne_m(self) -> tuple[float, float]:
        """That place, north and east of the launch pad."""
        return (0.0, 0.0) if self.home is None else self.stop_ne_m(self.home)

    def stop_ne_m(self, name: str) -> tuple[float, float]:
        """Where a stop's pad is, north and east of the launch pad."""
        stops = {stop.name: stop for stop in self.flight.site.stops}
        return place_ne_m(stops[name], self.depot)

    def ask_home(self, name: str) -> None:
        """The ground station asks for another stop to land at."""
        lat_rad, lon_rad, _ = frame_at(self.depot).to_geodetic((*self.stop_ne_m(name), 0.0))
        self.operator.wants_home(math.degrees(lat_rad), math.degrees(lon_rad))

    @property
    def finished(self) -> bool:
        """Down for good and the companion has ended, or it never left."""
        if self.record.landed_s is not None:
            down_s = self.t_s - self.record.landed_s
            over = self.record.crashed or not self.autopilot.is_armed
            concluded = not self.companion.running or down_s > CONCLUDE_WITHIN_S
            return (over and concluded and down_s > SETTLED_S) or down_s > STUCK_ARMED_S
        never_left = self.record.took_off_s is None
        return never_left and self.companion.starts > 0 and not self.companion.running


def place_ne_m(place: Place, depot: Place) -> tuple[float, float]:
    """A place's north and east of the depot, in metres."""
    if place.east_m is not None and place.north_m is not None:
        return place.north_m, place.east_m
    north, east, _ = place_ned(frame_at(depot), place)
    return north, east


def build_terrain(terrain: Terrain, folder: Path) -> ground.Terrain:
    """The world's ground from the flight file's table.

    LeewayError where it has heights that nobody knows: the world has none such.
    """
    if terrain.heights is not None:
        table = terrain.heights
        ups = [[up for up in row if up is not None] for row in table.up_m]
        if any(len(row) != len(table.across_m) for row in ups):
            raise LeewayError("site.terrain.heights.up_m: null, and the simulated ground has none")
        grid = ground.GridTerrain(table.along_m, table.across_m, ups)
        return ground.TurnedTerrain(grid, table.course_deg)
    if terrain.kind == "grid":
        return load_grid_terrain(folder / str(terrain.grid))
    if terrain.kind == "plane":
        return ground.PlaneTerrain(terrain.slope_north_frac, terrain.slope_east_frac)
    return ground.PlaneTerrain()
