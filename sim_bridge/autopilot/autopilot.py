"""One simulated autopilot: MAVLink datagrams and sensor readings in, attitude and thrust out.

    autopilot = Autopilot(AutopilotKind.PX4, (55.7, 12.6, 30.0), read_parameters(path))
    autopilot.add_link(0)
    actuation = autopilot.step(vehicle.step(actuation, 0.01), 0.01)   # 100 times a second
    autopilot.receive(0, datagram)
    for link_id, datagram in autopilot.take_outbox(): ...

It sees readings, never the truth. This module constructs the parts and calls them in order.
Differences between ArduCopter and PX4 are in `ardupilot/` and `px4/`, imported only here.
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
from sim_bridge.autopilot.inbox import MessageDispatcher
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
    """ArduCopter or PX4, as selected by `kind`.

    `home` is latitude, longitude (deg) and altitude AMSL (m) of the origin of the readings' NED
    frame, the depot's ground point. `parameters` come from `read_parameters`. `boot_age_s` is
    the initial time since boot.
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
            rules=firmware.rules.mission_flight_rules(params),
            boot_t_s=-boot_age_s,
        )
        self._control = control
        self._guidance = Guidance(Controller(control))
        self.landing_detector = LandingDetector(firmware.landing_lean_limit_rad)
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
                landing=self.landing_detector,
                battery=self.battery,
                wind=self.wind,
                rc=self._rc,
                geofence=self._geofence,
                store=self.store,
                reboot=self.reboot,
            )
        )
        self.behaviour.commander.reset_at_ground_boot(self.behaviour.initial_mode())
        self._protocol = MissionProtocol(
            self.state, self.radio, self.behaviour.mission, firmware.mission_rules, self.store
        )
        self._inbox = MessageDispatcher(self.state, self.radio, self.behaviour, self._protocol)
        self._resume_at_s: float | None = None
        self._next_slow_s = 0.0
        self._rules_read_at: tuple[int, ...] | None = None
        self._boot_is_read = False

    # --- inputs and outputs -------------------------------------------------------------------

    def add_link(
        self,
        link_id: int,
        kind: LinkKind = LinkKind.ONBOARD,
        *,
        is_byte_stream: bool = False,
        signer: Signer | None = None,
    ) -> None:
        """Start a link and its telemetry. `is_byte_stream` is True for byte streams such as TCP."""
        self.radio.add_link(link_id, kind, stream=is_byte_stream, signing=signer)

    def drop_link(self, link_id: int) -> None:
        """Take a link down."""
        self.radio.drop_link(link_id)

    def process_received_datagram(self, link_id: int, datagram: bytes) -> None:
        """Process bytes received on a link; an unknown link is added as an onboard one."""
        if link_id not in self.radio.links:
            self.add_link(link_id)
        messages = self.radio.decode_and_forward_received(link_id, datagram)
        if self._resume_at_s is not None:
            return
        for message in messages:
            self._inbox.handle_message_if_addressed(link_id, message)

    def take_frames_to_send(self) -> list[tuple[int, bytes]]:
        """Frames to send, in order, each with its link; the outbox is then empty."""
        return self.radio.take_outgoing_frames()

    def set_receiver_channels(self, channel_pulses_us: Sequence[int] | None) -> None:
        """Set the receiver's output from now on, in microseconds; None is no signal."""
        self._rc.set_receiver_channels(channel_pulses_us)

    def send_timesync_request(self, link_id: int, ts1_ns: int) -> None:
        """Send TIMESYNC(tc1=0, ts1) on a link, for lockstep.

        Answers appear in `last_timesync_echo_by_sender`. PX4's own 10 Hz requests are not
        simulated: with them a companion would tick at times that the bridge did not set.
        """
        self.radio.send(link_id, "TIMESYNC", tc1=0, ts1=ts1_ns)

    def reboot(self) -> None:
        """Reboot: volatile state is lost, parameters and missions stay.

        On the ground it starts disarmed, as after power-on. In flight it is a watchdog reset: after
        `WATCHDOG_S` of silence it continues armed, in the same mode, at the same item; accumulated
        values (charge, wind, intervals, boot time) restart from zero.
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
        self.wind.recreate_estimator_at_boot(None)
        self._protocol.discard_transfers()
        self._rc.clear_signal_history()
        self.radio.reset_at_reboot()
        behaviour.reset_at_reboot(in_flight=in_flight)
        if in_flight:
            behaviour.commander.reset_at_in_flight_reboot()
            self._resume_at_s = state.t_s + self.WATCHDOG_S
            return
        behaviour.commander.reset_at_ground_boot(behaviour.initial_mode())
        state.actuation = AttitudeSetpoint()
        self._guidance.reset_with_controller(Controller(self._control))
        self._copy_estimate_to_state()

    def shift_message_clock(self, by_s: float) -> None:
        """Step the clock in messages forward or (negative) back; other state is unchanged."""
        self.state.boot_t_s -= by_s

    # --- queries ------------------------------------------------------------------------------

    @property
    def actuation(self) -> AttitudeSetpoint:
        """Motor command until the next step."""
        return self.state.actuation

    @property
    def is_armed(self) -> bool:
        """Return True if the motors are armed."""
        return self.state.is_armed

    @property
    def mode(self) -> Mode:
        """The flight mode."""
        return self.state.mode

    @property
    def is_under_external_control(self) -> bool:
        """Return True if radio control or another system has set the mode."""
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
        """The mission executor."""
        return self.behaviour.executor

    @property
    def time_boot_ms(self) -> int:
        """`time_boot_ms` of the messages."""
        return self.state.time_boot_ms

    @property
    def last_timesync_echo_by_sender(self) -> dict[tuple[int, int, int], int]:
        """The latest ts1 that was echoed, by (link, system, component)."""
        return self._inbox.timesync_echoes

    @property
    def current_cruise_speed_mps(self) -> float:
        """Ground speed to fly legs at now."""
        return self._guidance.cruise_ground_speed_mps(self.state.rules.default_speed_mps)

    # --- time ---------------------------------------------------------------------------------

    def process_readings(self, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        """Process one set of readings; return the motor command until the next."""
        state = self.state
        state.t_s = readings.t_s
        state.readings = readings
        if self._resume_at_s is not None:
            if state.t_s < self._resume_at_s:
                return state.actuation
            self._resume_at_s = None
            self._resume_flight_after_watchdog()
        state.gnss_lost_s = 0.0 if readings.gnss_ok else state.gnss_lost_s + dt_s
        self.landing_detector.update_landed_state(
            readings, state.actuation, state.goal, dt_s, is_armed=state.is_armed
        )
        state.is_landed = self.landing_detector.is_landed
        if state.t_s >= self._next_slow_s:
            self._next_slow_s = state.t_s + _SLOW_PERIOD_S - 1e-6
            self._run_10hz_tasks(readings)
        self._update_goal_and_actuation(readings, dt_s)
        self.radio.send_due_messages(self.behaviour.streams)
        return state.actuation

    def _run_10hz_tasks(self, readings: Readings) -> None:
        """Run the tasks that do not need the 100 Hz rate."""
        state, behaviour = self.state, self.behaviour
        revisions = (state.params.revision, state.home_revision, self.store.areas_revision)
        if self._rules_read_at != revisions:
            self._rules_read_at = revisions
            self._update_settings_from_parameters()
        self.battery.update_from_readings(
            readings.voltage_v,
            readings.current_a,
            readings.temperature_c,
            _SLOW_PERIOD_S,
            armed=state.is_armed,
        )
        self.battery.remaining_frac = behaviour.update_remaining_battery_frac()
        if self.wind.estimator is not None and not state.is_landed:
            self.wind.estimator.update_wind_estimate(
                readings.accel_frd_mps2,
                (readings.roll_rad, readings.pitch_rad, readings.yaw_rad),
                state.vel_ned_mps,
                _SLOW_PERIOD_S,
            )
        behaviour.commander.set_home_and_origin_at_first_position()
        self._protocol.retry_or_abort_stale_transfers()
        self._rc.update_channels_and_signal_loss(state.t_s)
        behaviour.run_10hz_tasks()
        self.radio.resend_due_own_commands()

    def _update_settings_from_parameters(self) -> None:
        """Derive from parameters and fence what every step needs."""
        state, rules = self.state, self.behaviour.rules
        state.rules = rules.mission_flight_rules(state.params)
        self._guidance.set_limits(rules.controller_limits(state.params))
        self._geofence.fence = rules.fence_in_force(state, self.store)
        if not self._boot_is_read:  # drag fusion is set up once, at boot
            self._boot_is_read = True
            self.wind.recreate_estimator_at_boot(rules.drag_coefficients(state.params))

    def _update_goal_and_actuation(self, readings: Readings, dt_s: float) -> None:
        state = self.state
        if not state.is_armed:
            actuation = self._guidance.run_motors_off_step(readings, dt_s)
            state.goal = Idle()
        else:
            state.goal = self.behaviour.advance_mode_and_return_goal()
            actuation = self._guidance.run_step_towards_goal(state.goal, readings, dt_s)
        if actuation.release is not self.behaviour.is_gripper_open:
            actuation = actuation._replace(release=self.behaviour.is_gripper_open)
        state.actuation = actuation
        self._copy_estimate_to_state()

    def _copy_estimate_to_state(self) -> None:
        """Publish the controller's navigation estimate to all modules."""
        self.state.pos_ned_m = self._guidance.controller.pos_ned_m
        self.state.vel_ned_mps = self._guidance.controller.vel_ned_mps

    def _resume_flight_after_watchdog(self) -> None:
        """After a watchdog reset in the air."""
        self.radio.send_status_text(Severity.CRITICAL, "WATCHDOG RESET: resuming flight")
        self._guidance.controller.stop_motors()
        self.behaviour.executor.deactivate_keeping_item()
        self.behaviour.commander.resume_flight_after_reboot()
