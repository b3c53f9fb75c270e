"""One simulated autopilot: MAVLink datagrams and sensor readings in, attitude and thrust out.

    autopilot = Autopilot(AutopilotKind.PX4, (55.7, 12.6, 30.0), read_parameters(path))
    autopilot.add_link(0)
    actuation = autopilot.step(vehicle.step(actuation, 0.01), 0.01)   # 100 times a second
    autopilot.receive(0, datagram)
    for link_id, datagram in autopilot.take_outbox(): ...

It sees readings, never the truth. This module puts the parts together and calls them in order.
What ArduCopter and PX4 do differently is in `ardupilot/` and `px4/`, which nobody else imports.
"""

from collections.abc import Mapping, Sequence

from sim_bridge.autopilot.ardupilot.behaviour import ArduPilot
from sim_bridge.autopilot.base.geodesy import LocalFrame
from sim_bridge.autopilot.base.goals import Idle
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.base.readings import AttitudeSetpoint, Readings
from sim_bridge.autopilot.behaviour import AutopilotBehaviour, AutopilotParts
from sim_bridge.autopilot.flight.battery import BatteryMonitor
from sim_bridge.autopilot.flight.control import Controller, ControlParams
from sim_bridge.autopilot.flight.guidance import Guidance
from sim_bridge.autopilot.flight.landing import LandingDetector
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.wind import WindFusion
from sim_bridge.autopilot.inbox import Inbox
from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing, LinkKind
from sim_bridge.autopilot.mavlink.codec import Signer
from sim_bridge.autopilot.mavlink.enums import Severity, VehicleType
from sim_bridge.autopilot.mavlink.parameters import Parameter, ParameterStore
from sim_bridge.autopilot.mission.executor import MissionExecutor
from sim_bridge.autopilot.mission.fence import Geofence
from sim_bridge.autopilot.mission.items import MissionStore
from sim_bridge.autopilot.px4.behaviour import Px4
from sim_bridge.autopilot.services.mission_protocol import MissionProtocol
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import STEP_S, VehicleState

_SLOW_PERIOD_S = 0.1


class Autopilot:
    """ArduCopter or PX4, as `kind` says.

    `home` is latitude, longitude (deg) and altitude AMSL (m) of the origin of the readings' NED
    frame, the depot's ground point. `parameters` come from `read_parameters`. `boot_age_s` starts
    it as if it had been running for so long.
    """

    STEP_S = STEP_S
    WATCHDOG_S = 0.3

    def __init__(
        self,
        kind: AutopilotKind,
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
        firmware = Px4 if kind is AutopilotKind.PX4 else ArduPilot
        params = ParameterStore(kind, parameters)
        self.state = VehicleState(
            params=params,
            frame=LocalFrame(*home),
            timing=firmware.timing,
            system_id=system_id,
            vehicle_type=int(vehicle_type),
            epoch_unix_s=epoch_unix_s,
            rules=firmware.rules.flight_rules(params),
            boot_t_s=-boot_age_s,
        )
        self._control = control
        self._guidance = Guidance(Controller(control))
        self._landing = LandingDetector(firmware.landing_lean_limit_rad)
        self._rc = RcInput()
        self._geofence = Geofence(self.state)
        self.battery = BatteryMonitor(battery_sensing)
        self.wind = WindFusion()
        self.store = MissionStore()
        self.radio = Radio(self.state, firmware.router(system_id, 1), firmware.habits)
        self.behaviour: AutopilotBehaviour = firmware(
            AutopilotParts(
                state=self.state,
                radio=self.radio,
                guidance=self._guidance,
                landing=self._landing,
                battery=self.battery,
                wind=self.wind,
                rc=self._rc,
                geofence=self._geofence,
                store=self.store,
                reboot=self.reboot,
            )
        )
        self.behaviour.commander.boot(self.behaviour.initial_mode())
        self._protocol = MissionProtocol(
            self.state, self.radio, self.behaviour.mission, firmware.mission_rules, self.store
        )
        self._inbox = Inbox(self.state, self.radio, self.behaviour, self._protocol)
        self._resume_at_s: float | None = None
        self._next_slow_s = 0.0
        self._rules_read_at: tuple[int, ...] | None = None
        self._boot_is_read = False

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
            self._inbox.handle(link_id, message)

    def take_outbox(self) -> list[tuple[int, bytes]]:
        """Frames to send, in order, each with its link; the outbox is then empty."""
        return self.radio.take_outbox()

    def set_rc(self, channels: Sequence[int] | None) -> None:
        """Set the receiver's output from now on, in microseconds; None is no signal."""
        self._rc.set_receiver(channels)

    def request_timesync(self, link_id: int, ts1_ns: int) -> None:
        """Send TIMESYNC(tc1=0, ts1) on a link, for lockstep.

        Answers appear in `timesync_echoes`. PX4's own 10 Hz requests are not simulated: with them
        a companion would tick at times that the bridge did not set.
        """
        self.radio.send(link_id, "TIMESYNC", tc1=0, ts1=ts1_ns)

    def reboot(self) -> None:
        """A reboot: volatile state is lost, parameters and missions stay.

        On the ground it comes up disarmed, as after power-on. In flight it is a watchdog reset:
        after `WATCHDOG_S` of silence it goes on armed, in the same mode, at the same item; what it
        counted (charge, wind, intervals, boot time) starts from zero.
        """
        state, behaviour = self.state, self.behaviour
        in_flight = state.is_armed and not state.is_landed
        state.gnss_lost_s = 0.0
        state.goal = Idle()
        state.boot_t_s = state.t_s
        self._next_slow_s = state.t_s
        self._rules_read_at = None
        self._boot_is_read = False
        self.battery.reset()
        self.wind.boot(None)
        self._protocol.reset()
        self._rc.reboot()
        self.radio.reboot()
        behaviour.boot(in_flight=in_flight)
        if in_flight:
            behaviour.commander.boot_in_flight()
            self._resume_at_s = state.t_s + self.WATCHDOG_S
            return
        behaviour.commander.boot(behaviour.initial_mode())
        state.actuation = AttitudeSetpoint()
        self._guidance.restart(Controller(self._control))
        self._publish_estimate()

    def jump_clock(self, by_s: float) -> None:
        """Let the time that messages carry jump, ahead or (negative) back; nothing else changes."""
        self.state.boot_t_s -= by_s

    # --- what can be asked --------------------------------------------------------------------

    @property
    def actuation(self) -> AttitudeSetpoint:
        """What the motors shall do until the next step."""
        return self.state.actuation

    @property
    def armed_for_s(self) -> float | None:
        """How long the motors have been armed; `None` while they are not."""
        since_s = self.state.armed_since_s
        return self.state.t_s - since_s if self.state.is_armed and since_s is not None else None

    @property
    def is_armed(self) -> bool:
        """Whether the motors are armed."""
        return self.state.is_armed

    @property
    def mode(self) -> Mode:
        """The flight mode."""
        return self.state.mode

    @property
    def is_flown_by_person(self) -> bool:
        """Whether the mode is by radio control or by an order from another system."""
        by = self.state.mode_by
        return by is not None and by[0] != self.state.system_id

    @property
    def t_s(self) -> float:
        """Time of the latest readings."""
        return self.state.t_s

    @property
    def params(self) -> ParameterStore:
        """The parameters."""
        return self.state.params

    @property
    def executor(self) -> MissionExecutor:
        """What flies the mission."""
        return self.behaviour.executor

    @property
    def time_boot_ms(self) -> int:
        """`time_boot_ms` of the messages."""
        return self.state.time_boot_ms

    @property
    def timesync_echoes(self) -> dict[tuple[int, int, int], int]:
        """The latest ts1 that was echoed, by (link, system, component)."""
        return self._inbox.timesync_echoes

    @property
    def cruise_mps(self) -> float:
        """Ground speed to fly legs at now."""
        return self._guidance.cruise_mps(self.state.rules.default_speed_mps)

    # --- time ---------------------------------------------------------------------------------

    def step(self, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        """Take one set of readings; returns what the motors shall do until the next."""
        state = self.state
        state.t_s = readings.t_s
        state.readings = readings
        if self._resume_at_s is not None:
            if state.t_s < self._resume_at_s:
                return state.actuation
            self._resume_at_s = None
            self._resume_flight()
        state.gnss_lost_s = 0.0 if readings.gnss_ok else state.gnss_lost_s + dt_s
        self._landing.step(readings, state.actuation, state.goal, dt_s, is_armed=state.is_armed)
        state.is_landed = self._landing.is_landed
        if state.t_s >= self._next_slow_s:
            self._next_slow_s = state.t_s + _SLOW_PERIOD_S - 1e-6
            self._slow_step(readings)
        self._fly(readings, dt_s)
        self.radio.stream(self.behaviour.streams)
        return state.actuation

    def _slow_step(self, readings: Readings) -> None:
        """What is not needed a hundred times a second."""
        state, behaviour = self.state, self.behaviour
        revisions = (state.params.revision, state.home_revision, self.store.areas_revision)
        if self._rules_read_at != revisions:
            self._rules_read_at = revisions
            self._read_rules()
        self.battery.step(
            readings.voltage_v,
            readings.current_a,
            readings.temperature_c,
            _SLOW_PERIOD_S,
            armed=state.is_armed,
        )
        self.battery.remaining_frac = behaviour.remaining_frac()
        if self.wind.estimator is not None and not state.is_landed:
            self.wind.estimator.step(
                readings.accel_frd_mps2,
                (readings.roll_rad, readings.pitch_rad, readings.yaw_rad),
                state.vel_ned_mps,
                _SLOW_PERIOD_S,
            )
        behaviour.commander.find_home()
        self._protocol.step()
        self._rc.step(state.t_s)
        behaviour.slow_step()
        self.radio.repeat_own_commands()

    def _read_rules(self) -> None:
        """Derive from parameters and fence what every step needs."""
        state, rules = self.state, self.behaviour.rules
        state.rules = rules.flight_rules(state.params)
        self._guidance.set_limits(rules.limits(state.params))
        self._geofence.fence = rules.fence(state, self.store)
        if not self._boot_is_read:  # drag fusion is set up once, at boot
            self._boot_is_read = True
            self.wind.boot(rules.drag_coefficients(state.params))

    def _fly(self, readings: Readings, dt_s: float) -> None:
        state = self.state
        if not state.is_armed:
            actuation = self._guidance.disarmed(readings, dt_s)
            state.goal = Idle()
        else:
            state.goal = self.behaviour.goal()
            actuation = self._guidance.fly(state.goal, readings, dt_s)
        if actuation.release is not self.behaviour.release:
            actuation = actuation._replace(release=self.behaviour.release)
        state.actuation = actuation
        self._publish_estimate()

    def _publish_estimate(self) -> None:
        """Let everybody know where the controller's navigation puts the vehicle."""
        self.state.pos_ned_m = self._guidance.controller.pos_ned_m
        self.state.vel_ned_mps = self._guidance.controller.vel_ned_mps

    def _resume_flight(self) -> None:
        """After a watchdog reset in the air."""
        self.radio.say(Severity.CRITICAL, "WATCHDOG RESET: resuming flight")
        self._guidance.controller.idle()
        self.behaviour.executor.stop()
        self.behaviour.commander.resume()
