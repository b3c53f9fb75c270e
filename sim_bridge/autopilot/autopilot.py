"""One simulated autopilot: MAVLink datagrams and sensor readings in, attitude and thrust out.

    autopilot = Autopilot(AutopilotKind.PX4, (55.7, 12.6, 30.0), read_parameters(path))
    autopilot.add_link(0)
    actuation = autopilot.step(vehicle.step(actuation, 0.01), 0.01)   # 100 times a second
    autopilot.receive(0, datagram)
    for link_id, datagram in autopilot.take_outbox(): ...

It sees readings, never the truth. What ArduCopter and PX4 do differently is in `ardupilot.py` and
`px4.py`; what they have in common is here and in the modules that it puts together.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from sim_bridge.autopilot.ardupilot.behaviour import ArduPilot
from sim_bridge.autopilot.flight.battery import BatteryMonitor
from sim_bridge.autopilot.flight.control import Actuation, Controller, ControlParams
from sim_bridge.autopilot.flight.failsafe import Failsafes
from sim_bridge.autopilot.flight.fence import Fence
from sim_bridge.autopilot.flight.geodesy import LocalFrame
from sim_bridge.autopilot.flight.goals import FollowLine, Goal, HoldPoint, Idle, Vec3
from sim_bridge.autopilot.flight.guidance import Guidance, heading_along
from sim_bridge.autopilot.flight.landing import LandingDetector
from sim_bridge.autopilot.flight.modes import Mode
from sim_bridge.autopilot.flight.pilot import PilotInput
from sim_bridge.autopilot.flight.readings import Readings
from sim_bridge.autopilot.flight.returning import Returning
from sim_bridge.autopilot.flight.wind import WindEstimator
from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing, LinkKind
from sim_bridge.autopilot.mavlink.codec import Signer
from sim_bridge.autopilot.mavlink.enums import MissionType, Severity, VehicleType
from sim_bridge.autopilot.mavlink.inbox import handle
from sim_bridge.autopilot.mavlink.parameters import Parameter, ParameterStore
from sim_bridge.autopilot.mavlink.radio import Radio
from sim_bridge.autopilot.mavlink.router import ArduPilotRouter, Px4Router
from sim_bridge.autopilot.mavlink.setpoints import Here, Setpoint
from sim_bridge.autopilot.mission.executor import FlightRules, Leg, MissionExecutor
from sim_bridge.autopilot.mission.mission import Item, MissionStore
from sim_bridge.autopilot.mission.mission_protocol import MissionProtocol
from sim_bridge.autopilot.mission.plan import Plan
from sim_bridge.autopilot.px4.behaviour import Px4

_SLOW_PERIOD_S = 0.1


class Autopilot:
    """ArduCopter or PX4, as `flavour` says.

    `home` is latitude, longitude (deg) and altitude AMSL (m) of the origin of the readings' NED
    frame, the depot's ground point. `parameters` come from `read_parameters`. `boot_age_s` starts
    it as one that has been running for so long.
    """

    STEP_S = 0.01
    WATCHDOG_S = 0.3

    def __init__(
        self,
        flavour: AutopilotKind,
        home: tuple[float, float, float],
        parameters: Mapping[str, Parameter],
        *,
        system_id: int = 1,
        vehicle_type: int = VehicleType.QUADROTOR,
        battery_sensing: BatterySensing = BatterySensing.POWER_MODULE,
        boot_age_s: float = 0.0,
        epoch_unix_s: float = 1_700_000_000.0,
        control: ControlParams | None = None,
    ) -> None:
        self.flavour = flavour
        self.system_id = system_id
        self.vehicle_type = int(vehicle_type)
        self.battery_sensing = battery_sensing
        self.epoch_unix_s = epoch_unix_s
        self.params = ParameterStore(flavour, parameters)
        self.frame = LocalFrame(*home)
        self.store = MissionStore()
        self.timesync_echoes: dict[tuple[int, int, int], int] = {}
        is_px4 = flavour is AutopilotKind.PX4
        self.behaviour: ArduPilot | Px4 = Px4() if is_px4 else ArduPilot()
        router = Px4Router(system_id, 1) if is_px4 else ArduPilotRouter(system_id, 1)
        self.radio = Radio(self, router)
        self.protocol = MissionProtocol(self, self.behaviour.mission_rules, self.store)
        self.executor = MissionExecutor(
            self,
            Plan(first=0 if is_px4 else 1, forever=self.behaviour.jump_forever),
            sequential=is_px4,
        )
        self._control = control
        self.guidance = Guidance(Controller(control))
        self.battery = BatteryMonitor()
        self.pilot = PilotInput()
        self.failsafes = Failsafes()
        self.landing = LandingDetector(self.behaviour.landing_lean_limit_rad)
        self.wind: WindEstimator | None = None
        self.fence = Fence()
        self.flight_rules: FlightRules = self.behaviour.rules.flight_rules(self.params)
        self.readings: Readings | None = None
        self.actuation = Actuation()
        self.t_s = 0.0
        self.mode = self.behaviour.initial_mode(self.params)
        self.is_armed = False
        self._boot_t_s = -boot_age_s
        self._resume_at_s: float | None = None
        self._rules_revision = -1
        self._boot_is_read = False
        self._forget_flight()

    def _forget_flight(self) -> None:
        """Everything that no storage keeps."""
        self.failsafe_reason: str | None = None
        self.armed_since_s = 0.0
        self.has_flown = False
        self.landed_since_s = 0.0
        self.home_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self.home_is_set = False
        self.home_is_locked = False
        self.ekf_origin_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self.gnss_lost_s = 0.0
        self.speed_override_mps: float | None = None
        self.release = False
        self.goal: Goal = Idle()
        self.mode_entered_s = self.t_s
        self.hold_point: Vec3 | None = None
        self.takeoff_down_m: float | None = None
        self.setpoint: Setpoint | None = None
        self.returning: Returning | None = None
        self._next_slow_s = self.t_s
        self._mission_due_s: float | None = None

    # --- the outside --------------------------------------------------------------------------

    def add_link(
        self,
        link_id: int,
        kind: LinkKind = LinkKind.ONBOARD,
        *,
        stream: bool = False,
        signing: Signer | None = None,
    ) -> None:
        """Bring a link up; telemetry flows from now on. `stream` for byte streams such as TCP."""
        self.radio.add_link(link_id, kind, stream=stream, signing=signing)

    def drop_link(self, link_id: int) -> None:
        """Take a link down."""
        self.radio.drop_link(link_id)

    def receive(self, link_id: int, datagram: bytes) -> None:
        """Take bytes that arrived on a link; an unknown link comes up as an onboard one."""
        if link_id not in self.radio.links:
            self.add_link(link_id)
        messages = self.radio.take_in(link_id, datagram)
        if self._resume_at_s is not None:
            return
        for message in messages:
            handle(self, link_id, message)

    def take_outbox(self) -> list[tuple[int, bytes]]:
        """Frames to send, in order, each with its link; the outbox is then empty."""
        return self.radio.take_outbox()

    def set_rc(self, channels: Sequence[int] | None) -> None:
        """What the pilot's receiver puts out from now on, in microseconds; None is no signal."""
        self.pilot.set_receiver(channels)

    def request_timesync(self, link_id: int, ts1_ns: int) -> None:
        """Send TIMESYNC(tc1=0, ts1) on a link, for lockstep, which keeps the count.

        Answers appear in `timesync_echoes` by (link, system, component). PX4's own 10 Hz requests
        are not simulated: with them a companion would tick at times that the bridge did not set.
        """
        self.radio.send(link_id, "TIMESYNC", tc1=0, ts1=ts1_ns)

    def reboot(self) -> None:
        """A reboot: volatile state is lost, parameters and missions stay.

        On the ground it comes up disarmed, as after power-on. In flight it is a watchdog reset:
        after `WATCHDOG_S` of silence it goes on armed, in the same mode, at the same item; what it
        counted (charge, wind, intervals, boot time) starts from nothing.
        """
        flying = self.is_armed and not self.is_landed
        kept = (self.home_ned_m, self.ekf_origin_ned_m, self.home_is_set, self.release)
        mode, hold = self.mode, self.hold_point
        self._forget_flight()
        self._boot_t_s = self.t_s
        self.battery.reset()
        self.wind = None
        self._boot_is_read = False
        self.failsafes = Failsafes()
        self.protocol.reset()
        self.pilot.was_present = False
        self.radio.reboot()
        self.params.revision += 1
        if flying:
            self.home_ned_m, self.ekf_origin_ned_m, self.home_is_set, self.release = kept
            self._resume_at_s = self.t_s + self.WATCHDOG_S
            self.has_flown = True
            self.mode, self.hold_point = mode, hold
            return
        self.is_armed = False
        self.executor.stop()
        self.executor.restart()
        self.mode = self.behaviour.initial_mode(self.params)
        self.actuation = Actuation()
        self.guidance = Guidance(Controller(self._control))

    def jump_clock(self, by_s: float) -> None:
        """Let the time that messages carry jump, ahead or (negative) back; nothing else changes."""
        self._boot_t_s -= by_s

    @property
    def ardupilot(self) -> ArduPilot:
        """The flavour's own part, where it is ArduPilot."""
        assert isinstance(self.behaviour, ArduPilot)
        return self.behaviour

    @property
    def px4(self) -> Px4:
        """The flavour's own part, where it is PX4."""
        assert isinstance(self.behaviour, Px4)
        return self.behaviour

    # --- time ---------------------------------------------------------------------------------

    @property
    def t_since_boot_s(self) -> float:
        """Seconds since boot."""
        return self.t_s - self._boot_t_s

    @property
    def time_boot_ms(self) -> int:
        """`time_boot_ms` of the messages."""
        return round(self.t_since_boot_s * 1000.0) & 0xFFFFFFFF

    @property
    def time_boot_ns(self) -> int:
        """The autopilot's clock as TIMESYNC has it."""
        return round(self.t_since_boot_s * 1e6) * 1000

    def step(self, readings: Readings, dt_s: float) -> Actuation:
        """Take one set of readings; returns what the motors shall do until the next."""
        self.t_s = readings.t_s
        self.readings = readings
        if self._resume_at_s is not None:
            if self.t_s < self._resume_at_s:
                return self.actuation
            self._resume_at_s = None
            self._resume_flight()
        self.gnss_lost_s = 0.0 if readings.gnss_ok else self.gnss_lost_s + dt_s
        self.landing.step(readings, self.actuation, self.goal, dt_s, is_armed=self.is_armed)
        if self.t_s >= self._next_slow_s:
            self._next_slow_s = self.t_s + _SLOW_PERIOD_S - 1e-6
            self._slow_step(readings)
        self._fly(readings, dt_s)
        self.radio.talk()
        return self.actuation

    def _slow_step(self, readings: Readings) -> None:
        """What need not be done a hundred times a second."""
        if self._rules_revision != self.params.revision:
            self._rules_revision = self.params.revision
            self._read_rules()
        self.battery.step(
            readings.voltage_v,
            readings.current_a,
            readings.temperature_c,
            _SLOW_PERIOD_S,
            armed=self.is_armed,
        )
        self.battery_remaining_frac = self.behaviour.remaining_frac(self)
        if self.wind is not None and not self.is_landed:
            self.wind.step(
                readings.accel_frd_mps2,
                (readings.roll_rad, readings.pitch_rad, readings.yaw_rad),
                self.vel_ned_mps,
                _SLOW_PERIOD_S,
            )
        self._look_for_home()
        self.protocol.step()
        if self._mission_due_s is not None and self.t_s >= self._mission_due_s:
            self._mission_due_s = None
            self.behaviour.switch_mission(self)
        self.pilot.step(self.t_s)
        self.behaviour.heed_pilot(self)
        self.failsafes.step(self)
        self.behaviour.slow_step(self)
        self.radio.repeat_own_commands()

    def _read_rules(self) -> None:
        """What parameters say, in a form for every step."""
        rules = self.behaviour.rules
        self.flight_rules = rules.flight_rules(self.params)
        self.guidance.set_limits(rules.limits(self.params))
        self.fence = rules.fence(self)
        if not self._boot_is_read:  # drag fusion is set up once, at boot
            self._boot_is_read = True
            drag = rules.drag_coefficients(self.params)
            self.wind = None if drag is None else WindEstimator(drag)

    battery_remaining_frac: float | None = None

    def _look_for_home(self) -> None:
        if self.home_is_set or not self.has_position:
            return
        self.ekf_origin_ned_m = self.pos_ned_m
        self.set_home(self.pos_ned_m)

    def _fly(self, readings: Readings, dt_s: float) -> None:
        if not self.is_armed:
            actuation = self.guidance.disarmed(readings, dt_s)
            self.goal = Idle()
        else:
            self.goal = self.behaviour.modes.goal(self)
            actuation = self.guidance.fly(self.goal, readings, dt_s)
        if actuation.release is not self.release:
            actuation = replace(actuation, release=self.release)
        self.actuation = actuation

    def _resume_flight(self) -> None:
        """After a watchdog reset in the air."""
        self.say(Severity.CRITICAL, "WATCHDOG RESET: resuming flight")
        mode = self.mode
        self.armed_since_s = self.t_s - 60.0
        self.guidance.controller.idle()
        index = self.executor.index
        self.executor.stop()
        self.executor.index = index
        self.behaviour.enter(self, mode)

    # --- state --------------------------------------------------------------------------------

    @property
    def pos_ned_m(self) -> Vec3:
        """Estimated position, NED about the site's origin."""
        return self.guidance.controller.pos_ned_m

    @property
    def vel_ned_mps(self) -> Vec3:
        """Estimated velocity over ground."""
        return self.guidance.controller.vel_ned_mps

    @property
    def is_landed(self) -> bool:
        """The landing detector's word."""
        return self.landing.is_landed

    @property
    def is_spooled(self) -> bool:
        """Whether the motors have been armed for long enough to take off."""
        return self.is_armed and self.t_s - self.armed_since_s >= self.flight_rules.spool_s

    @property
    def gnss_ok(self) -> bool:
        """Whether the receiver has a fix."""
        return self.readings is not None and self.readings.gnss_ok

    @property
    def ekf_is_ready(self) -> bool:
        """Whether the estimator has had a position since boot."""
        return self.home_is_set or self.t_since_boot_s >= self.behaviour.ekf_ready_after_s

    @property
    def has_position(self) -> bool:
        """Whether there is a horizontal position to fly by."""
        return (
            self.readings is not None
            and self.t_since_boot_s >= (0.5 if self.has_flown else self.behaviour.ekf_ready_after_s)
            and self.gnss_lost_s < self.behaviour.gnss_patience_s
        )

    @property
    def battery_voltage_v(self) -> float | None:
        """Measured voltage."""
        return self.battery.voltage_v

    @property
    def battery_current_a(self) -> float | None:
        """Measured current; PX4's SIH has none."""
        if self.battery_sensing is BatterySensing.SIH_TIMER:
            return None
        return self.battery.current_a

    def height_above_home_m(self) -> float:
        """Estimated height above home."""
        return self.home_ned_m[2] - self.pos_ned_m[2]

    def here(self) -> Here:
        """What set-points may be relative to."""
        yaw = 0.0 if self.readings is None else self.readings.yaw_rad
        return Here(
            self.t_s, self.pos_ned_m, yaw, self.home_ned_m, self.ekf_origin_ned_m, self.frame
        )

    def set_home(self, pos_ned_m: Vec3, *, locked: bool = False) -> None:
        """Home is there; `locked` keeps arming from moving it."""
        self.home_ned_m = pos_ned_m
        self.home_is_set = True
        self.home_is_locked = locked
        self._rules_revision = -1
        self.behaviour.home_changed(self)

    def navigation_target(self) -> Vec3 | None:
        """Where it is flying to, if to a place."""
        goal = self.goal
        if isinstance(goal, FollowLine):
            return goal.end
        return goal.point if isinstance(goal, HoldPoint) else None

    # --- deeds --------------------------------------------------------------------------------

    def set_mode(self, mode: Mode) -> None:
        """Go over to a mode; whether that is allowed was asked before."""
        if mode is self.mode and mode is not Mode.HOLD:
            return
        self.leave_mode()
        self.behaviour.enter(self, mode)

    def leave_mode(self) -> None:
        """End what the present mode has under way."""
        if self.mode is Mode.AUTO:
            self.executor.stop()
            self.behaviour.mission_left(self)
        self.returning = None
        self.guidance.fixed_yaw_rad = None

    def enter(self, mode: Mode) -> None:
        """Note the mode and forget what belonged to the one before."""
        self.mode = mode
        self.mode_entered_s = self.t_s
        self.hold_point = None
        self.takeoff_down_m = None
        self.returning = None

    def arm(self) -> None:
        """Motors on; home is here."""
        if self.is_armed:
            return
        self.is_armed = True
        self.armed_since_s = self.t_s
        self.has_flown = False
        self.landing.arm()
        if self.has_position and not self.home_is_locked:
            self.set_home(self.pos_ned_m)
        self.hold_point = None
        self.behaviour.armed(self)

    def disarm(self) -> None:
        """Motors off, wherever it is."""
        if not self.is_armed:
            return
        self.is_armed = False
        self.failsafe_reason = None
        self.setpoint = None
        self.behaviour.disarmed(self)

    def stopping_point(self) -> Vec3:
        """Where the vehicle comes to rest if it brakes now."""
        north, east, down = self.pos_ned_m
        vn, ve, vd = self.vel_ned_mps
        speed = math.hypot(vn, ve)
        brake = 0.6 * self.guidance.controller.params.max_accel_mps2
        ahead_s = speed / (2.0 * brake) + 0.5 if speed > 0.1 else 0.0
        return north + vn * ahead_s, east + ve * ahead_s, down + vd * min(ahead_s, 0.8)

    def hold_here(self) -> Vec3:
        """The point that a holding mode keeps: where it came to rest when it was entered."""
        if self.hold_point is None:
            self.hold_point = self.stopping_point()
        return self.hold_point

    # --- for the executor, the protocol and the returning -------------------------------------

    def send(self, link_id: int, name: str, **fields: Any) -> None:
        """Queue one message on one link."""
        self.radio.send(link_id, name, **fields)

    def say(self, severity: Severity, text: str) -> None:
        """Queue a STATUSTEXT."""
        self.radio.say(severity, text)

    def gcs_heard(self, system: int) -> None:
        """A ground station's HEARTBEAT has arrived."""
        self.failsafes.gcs_heard(self, system)

    def cruise_mps(self) -> float:
        """Ground speed to fly legs at, now."""
        speed = self.guidance.controller.params.max_speed_mps
        return min(self.speed_override_mps or self.flight_rules.default_speed_mps, speed)

    def may_take_off(self) -> bool:
        """Whether a mission may leave the ground now."""
        return self.behaviour.may_take_off(self)

    def place_of(self, item: Item) -> Vec3:
        """Where an item is, with what it leaves open filled in."""
        return self.behaviour.place_of(self, item)

    def sink_mps(self, height_m: float) -> float:
        """Descent speed of a landing at a height above home."""
        return self.behaviour.rules.sink_mps(self.params, height_m)

    def run_item(self, item: Item, seq: int) -> float:
        """Do what a non-navigating item says."""
        return self.behaviour.run_item(self, item)

    def leg_yaw_rad(self, start: Vec3, end: Vec3, item: Item) -> float | None:
        """Heading to fly a leg with."""
        return heading_along(start, end) if self.behaviour.rules.faces_legs(self.params) else None

    def plan_return(self) -> Returning:
        """A return to launch from here."""
        return Returning(self.behaviour.modes.return_plan(self), self.pos_ned_m)

    def item_started(self, item: Item, seq: int) -> None:
        """An item has become the current one."""
        self.behaviour.item_started(self, item, seq)

    def item_reached(self, seq: int) -> None:
        """An item is done."""
        self.behaviour.item_reached(self, seq)

    def begin_guided(self) -> None:
        """Set-points are obeyed from now on, as a mission item says; earlier ones are void."""
        self.setpoint = None
        self.hold_point = None
        self.takeoff_down_m = None

    def guided_in_mission(self, leg: Leg) -> Goal | None:
        """What set-points want; None when a limit of theirs is passed."""
        return self.behaviour.modes.guided_in_mission(self, leg)

    def mission_ended(self) -> None:
        """There is no further item."""
        self.behaviour.mission_ended(self)

    def home_item(self) -> Item:
        """The home position as a mission item (ArduPilot's item 0)."""
        north, east, down = self.home_ned_m
        lat, lon = self.frame.to_lat_lon_deg(north, east)
        if not self.home_is_set:
            return Item(16, 0)
        z = round((self.frame.alt_amsl_m - down) * 100.0) / 100.0
        return Item(16, 0, x=round(lat * 1e7), y=round(lon * 1e7), z=z)

    def may_clear_mission(self) -> bool:
        """Whether a mission may be cleared now."""
        return self.behaviour.may_clear_mission(self)

    def mission_written(self, mission_type: int, *, whole: bool) -> None:
        """Items have changed in storage."""
        if mission_type == MissionType.MISSION:
            self.behaviour.mission_written(self, whole=whole)
        else:
            self._rules_revision = -1

    def switch_mission_in(self, delay_s: float) -> None:
        """Take the stored mission over after a while."""
        self._mission_due_s = self.t_s + delay_s
