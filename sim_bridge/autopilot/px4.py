"""PX4 where it differs from ArduCopter, row by row as measured (PX4 1.18 base)."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sim_bridge.autopilot import px4_telemetry as telemetry
from sim_bridge.autopilot.codec import Message
from sim_bridge.autopilot.commands import Command
from sim_bridge.autopilot.enums import (
    AMSL_FRAMES,
    Cmd,
    LandedState,
    MissionState,
    Result,
    Severity,
)
from sim_bridge.autopilot.executor import FlightRules, Phase
from sim_bridge.autopilot.failsafe import Failsafes
from sim_bridge.autopilot.fence import Fence, read_areas
from sim_bridge.autopilot.flavour import BatterySensing, LinkKind
from sim_bridge.autopilot.goals import (
    Descend,
    FlyVelocity,
    FollowLine,
    Goal,
    HoldPoint,
    Idle,
    Vec3,
    distance_ne_m,
)
from sim_bridge.autopilot.guidance import Limits, heading_along
from sim_bridge.autopilot.mission import (
    NO_COORDINATE,
    PLACED,
    PX4_JUMP_FOREVER,
    Item,
    Px4MissionRules,
)
from sim_bridge.autopilot.modes import (
    PILOTED,
    PX4_SWITCH_MODES,
    Mode,
    px4_base_mode,
    px4_custom_mode,
    px4_custom_mode_high_latency,
    px4_mode_of,
)
from sim_bridge.autopilot.parameters import ParameterStore
from sim_bridge.autopilot.piloted import level_descent, piloted_goal
from sim_bridge.autopilot.px4_commands import COMMANDS, can_run, request_mode
from sim_bridge.autopilot.px4_failsafe import watch
from sim_bridge.autopilot.px4_mission import mission_problem
from sim_bridge.autopilot.returning import ReturnPlan
from sim_bridge.autopilot.setpoints import Setpoint
from sim_bridge.autopilot.wind import DragCoefficients

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_SWITCH_EDGES_US = (1160, 1320, 1480, 1640, 1800)
_NEW_MISSION_AFTER_S = 1.5
"""A mission uploaded in flight takes over after 1 to 2 s (measured)."""
_GRIPPER_GIVEN_UP_S = 5.0
"""MIS_PD_TO: how long a mission waits for a gripper that does not answer."""
_OVERRIDE_AUTO, _OVERRIDE_OFFBOARD = 1, 2
_REACHED_AGAIN = 10


@dataclass(frozen=True, slots=True)
class _Later:
    """An acknowledgement that is due when an action has taken its time."""

    command: Command
    due_s: float


class Px4:
    """What `Autopilot` asks its flavour, answered as PX4 does."""

    autopilot_id = 12
    firmware_version = 0x01120000
    firmware_hash = b"83c4f4e5"
    capabilities = 1 | 4 | 8 | 16 | 64 | 128 | 256 | 2048 | 8192 | 16384 | 32768
    commands = COMMANDS
    streams = telemetry.STREAMS
    refused_interval = Result.FAILED
    refused_request = Result.DENIED
    jump_forever = PX4_JUMP_FOREVER
    landing_lean_limit_rad: float | None = None
    ekf_ready_after_s = 12.0
    gnss_patience_s = 5.0

    def __init__(self) -> None:
        self.mission_rules = Px4MissionRules()
        self.default_speed_mps = 5.0
        self.spool_s = 1.0
        self._mission_problem: str | None = None
        self._pending_speed_mps: float | None = None
        self._leg_start: Vec3 | None = None
        self._hold_yaw: float | None = None
        self._switch: int | None = None
        self._throttle_at_entry: float | None = None
        self._acts_at_s = math.inf
        self._acts_with: Mode | None = None
        self._interrupted: Mode | None = None
        self._later: list[_Later] = []
        self._reached_seq = -1
        self._reached_left = 0
        self._reached_next_s = 0.0

    # --- what it says -------------------------------------------------------------------------

    def base_mode(self, mode: Mode, armed: bool) -> int:
        """HEARTBEAT.base_mode."""
        return px4_base_mode(mode, armed)

    def custom_mode(self, mode: Mode) -> int:
        """HEARTBEAT.custom_mode."""
        return px4_custom_mode(mode)

    def high_latency_mode(self, mode: Mode) -> int:
        """HIGH_LATENCY2.custom_mode: packed otherwise."""
        return px4_custom_mode_high_latency(mode)

    def intended_mode(self, ap: "Autopilot") -> Mode:
        """The mode that a failsafe has interrupted, or the present one."""
        return self._interrupted or ap.mode

    def default_streams(self, kind: LinkKind) -> dict[str, float]:
        """The link's profile."""
        return {name: 1.0 / rate for name, rate in telemetry.DEFAULT_RATES_HZ[kind].items()}

    def data_stream(self, stream_id: int) -> tuple[str, ...]:
        """REQUEST_DATA_STREAM is not known."""
        return ()

    def status_text(self, ap: "Autopilot", text: str) -> tuple[str, list[int]]:
        """Only where a ground station's HEARTBEAT was heard; texts end with a tab."""
        return text + "\t", [link.id for link in ap.links.values() if link.has_gcs]

    def hud_airspeed_mps(self, ap: "Autopilot") -> float:
        """VFR_HUD.airspeed: NaN on a multirotor without a sensor."""
        readings = ap.readings
        if readings is None or readings.airspeed_mps is None:
            return math.nan
        return readings.airspeed_mps

    def high_latency_airspeed(self, ap: "Autopilot") -> int:
        """HIGH_LATENCY2.airspeed: always 0."""
        return 0

    def high_latency_wind(self, ap: "Autopilot") -> tuple[float, int]:
        """Speed, and where it blows TO in units of 2 degrees."""
        wind = ap.wind
        if wind is None:
            return 0.0, 0
        heading = math.degrees(math.atan2(wind.east_mps, wind.north_mps)) % 360.0
        return math.hypot(wind.north_mps, wind.east_mps), round(heading / 2.0) % 180

    def cell_voltages_mv(self, ap: "Autopilot", voltage_v: float | None) -> tuple[int, ...]:
        """Each cell's mean where their number is known, else the total in the first place."""
        count = min(int(ap.params["BAT1_N_CELLS"]), 10)
        if voltage_v is None:
            return (65535,) * 10
        if count <= 0:
            return (min(round(voltage_v * 1000.0), 65534), *(65535,) * 9)
        cells = int(ap.params["BAT1_N_CELLS"])
        return (round(voltage_v * 1000.0 / cells),) * count + (65535,) * (10 - count)

    def remaining_frac(self, ap: "Autopilot") -> float | None:
        """By voltage and counted charge; SIH's is a timer."""
        if ap.battery_sensing is BatterySensing.SIH_TIMER:
            least = ap.params["SIM_BAT_MIN_PCT"] / 100.0
            return ap.battery.sih_remaining_frac(ap.params["SIM_BAT_DRAIN"], least)
        return ap.battery.px4_remaining_frac(telemetry.cells(ap.params))

    def airborne_state(self, ap: "Autopilot") -> LandedState:
        """Taking off, landing, or in the air."""
        if isinstance(ap.goal, Descend):
            return LandedState.LANDING
        leg = ap.executor.leg
        climbing = ap.mode is Mode.AUTO and leg is not None and leg.phase is Phase.CLIMB
        if ap.mode is Mode.TAKEOFF or climbing:
            return LandedState.TAKEOFF
        return LandedState.IN_AIR

    def prearm_ok(self, ap: "Autopilot") -> bool:
        """SYS_STATUS's pre-arm bit: everything that does not depend on the mode."""
        return ap.is_armed or ap.ekf_is_ready

    # --- parameters ---------------------------------------------------------------------------

    def parameter_names(self, params: ParameterStore) -> list[str]:
        """A list begins with the checksum."""
        names = [name for i in range(len(params)) if (name := params.name_at(i)) is not None]
        return ["_HASH_CHECK", *names]

    def hash_check(self, params: ParameterStore) -> float:
        """The checksum's bytes, as a float's."""
        return params.digest_as_float()

    def set_parameter(self, ap: "Autopilot", link_id: int, message: Message) -> None:
        """The type has to be right; the stored value is sent back in any case."""
        name = message.param_id
        if name not in ap.params:
            ap.say(Severity.INFO, f"[pm] unknown param: {name}")
            return
        if not ap.params.accept(name, message.param_value, message.param_type):
            ap.say(Severity.ERROR, f"[pm] param types mismatch param: {name}")
        ap.send_parameter(link_id, name)

    def flight_rules(self, params: ParameterStore) -> FlightRules:
        """NAV_*, MIS_* and MPC_* as the executor needs them."""
        self.default_speed_mps = max(params["MPC_XY_CRUISE"], 0.1)
        self.spool_s = max(params["COM_SPOOLUP_TIME"], 0.0)
        radius = max(params["NAV_ACC_RAD"], 0.05)
        return FlightRules(
            accept_radius_m=radius,
            accept_height_m=max(params["NAV_MC_ALT_RAD"], 0.05),
            takeoff_speed_mps=max(params["MPC_TKO_SPEED"], 0.1),
            takeoff_min_height_m=max(params["MIS_TAKEOFF_ALT"], 0.0),
            corner_accel_mps2=max(params["MPC_ACC_HOR"], 0.1),
            land_above_m=2.0,
        )

    def limits(self, params: ParameterStore) -> Limits:
        """MPC_* for the controller."""
        return Limits(
            horizontal_mps=max(params["MPC_XY_VEL_MAX"], 0.1),
            up_mps=max(params["MPC_Z_V_AUTO_UP"], 0.1),
            down_mps=max(params["MPC_Z_V_AUTO_DN"], 0.1),
            accel_mps2=max(params["MPC_ACC_HOR"], 0.5),
            jerk_mps3=max(params["MPC_JERK_AUTO"], 1.0),
            tilt_rad=math.radians(min(max(params["MPC_TILTMAX_AIR"], 10.0), 60.0)),
        )

    def drag_coefficients(self, params: ParameterStore) -> DragCoefficients | None:
        """EKF2_DRAG_CTRL and its coefficients."""
        drag = DragCoefficients(
            params["EKF2_BCOEF_X"], params["EKF2_BCOEF_Y"], params["EKF2_MCOEF"]
        )
        return drag if params["EKF2_DRAG_CTRL"] == 1.0 and drag.are_usable else None

    def sink_mps(self, params: ParameterStore, height_m: float) -> float:
        """MPC_LAND_SPEED below MPC_LAND_ALT2, growing to MPC_Z_V_AUTO_DN at MPC_LAND_ALT1."""
        slow, fast = params["MPC_LAND_SPEED"], params["MPC_Z_V_AUTO_DN"]
        low, high = params["MPC_LAND_ALT2"], params["MPC_LAND_ALT1"]
        share = (height_m - low) / max(high - low, 0.1)
        return max(slow + min(max(share, 0.0), 1.0) * (fast - slow), 0.1)

    def faces_legs(self, params: ParameterStore) -> bool:
        """MPC_YAW_MODE 0: towards the waypoint."""
        return params["MPC_YAW_MODE"] == 0.0

    def read_fence(self, ap: "Autopilot") -> Fence:
        """GF_* and the uploaded areas."""
        radius, height = ap.params["GF_MAX_HOR_DIST"], ap.params["GF_MAX_VER_DIST"]
        return Fence(
            areas=read_areas(ap.store.fence, ap.frame),
            radius_m=radius if radius > 0.0 else None,
            height_m=height if height > 0.0 else None,
        )

    # --- modes --------------------------------------------------------------------------------

    def initial_mode(self, params: ParameterStore) -> Mode:
        """Without radio control it comes up in HOLD."""
        return Mode.HOLD

    def enter(self, ap: "Autopilot", mode: Mode) -> None:
        """What entering a mode starts."""
        ap.enter(mode)
        self._leg_start = None
        self._hold_yaw = None
        sticks = ap.pilot.sticks()
        self._throttle_at_entry = None if sticks is None else sticks.throttle
        if mode is Mode.TAKEOFF:
            self.take_off_to(ap, math.nan)
        if mode is Mode.AUTO and ap.is_armed:
            self._start_mission(ap)
        elif mode is Mode.RTL and ap.is_armed:
            ap.speed_override_mps = None
            ap.returning = ap.plan_return()

    def goal(self, ap: "Autopilot") -> Goal:
        """What the mode wants now (only asked while armed)."""
        match ap.mode:
            case Mode.AUTO:
                return ap.executor.step()
            case Mode.TAKEOFF:
                return self._takeoff(ap)
            case Mode.GUIDED:
                return self._offboard(ap)
            case Mode.RTL:
                return self._rtl(ap)
            case Mode.LAND:
                return self._land(ap)
            case Mode.DESCEND:
                return Idle() if ap.is_landed else level_descent(ap.params["MPC_LAND_SPEED"])
            case Mode.HOLD:
                return self._hold(ap)
            case _:
                params = ap.params
                return piloted_goal(ap, params["MPC_VEL_MANUAL"], params["MPC_Z_VEL_MAX_UP"])

    def _hold(self, ap: "Autopilot") -> Goal:
        if ap.is_landed:
            return Idle()
        point = ap.hold_here()
        start = self._leg_start
        if start is None:
            return HoldPoint(point, self._hold_yaw)
        if distance_ne_m(ap.pos_ned_m, point) < 1.0 and abs(ap.pos_ned_m[2] - point[2]) < 0.5:
            self._leg_start = None
        return FollowLine(start, point, ap.cruise_mps(), 0.0, self._hold_yaw)

    def go_to(self, ap: "Autopilot", place: Vec3, yaw_rad: float | None) -> None:
        """DO_REPOSITION, in HOLD."""
        ap.hold_point = place
        self._leg_start = ap.pos_ned_m
        self._hold_yaw = yaw_rad if yaw_rad is not None else heading_along(ap.pos_ned_m, place)

    def take_off_to(self, ap: "Autopilot", alt_amsl_m: float) -> None:
        """The altitude to take off to; at least MIS_TAKEOFF_ALT above home."""
        least = ap.home_ned_m[2] - ap.params["MIS_TAKEOFF_ALT"]
        down = least
        if math.isfinite(alt_amsl_m):
            down = min(ap.frame.alt_amsl_m - alt_amsl_m, least)
        ap.takeoff_down_m = down

    def _takeoff(self, ap: "Autopilot") -> Goal:
        if ap.takeoff_down_m is None:
            self.take_off_to(ap, math.nan)
        down = ap.takeoff_down_m
        assert down is not None
        if ap.hold_point is None or (ap.is_landed and not ap.is_spooled):
            ap.hold_point = ap.pos_ned_m
        if ap.is_landed and not ap.is_spooled:
            return Idle()
        north, east, start_down = ap.hold_point
        top = (north, east, min(down, start_down))
        if ap.pos_ned_m[2] - top[2] > 0.5:
            return FollowLine((north, east, start_down), top, ap.flight_rules.takeoff_speed_mps)
        ap.set_mode(Mode.HOLD)
        ap.hold_point = top
        return HoldPoint(top)

    def _offboard(self, ap: "Autopilot") -> Goal:
        setpoint = ap.setpoint
        if setpoint is None or not self.has_setpoints(ap):
            if ap.is_landed:
                return Idle()
            self._offboard_lost(ap)
            return HoldPoint(ap.pos_ned_m)
        pos, vel = setpoint.pos_ned_m, setpoint.vel_ned_mps
        wants_up = (pos is not None and pos[2] < ap.pos_ned_m[2] - 0.3) or (
            vel is not None and vel[2] < -0.1
        )
        if ap.is_landed and not (wants_up and ap.is_spooled):
            return Idle()
        if pos is None:
            assert vel is not None
            return FlyVelocity(vel, setpoint.yaw_rad, setpoint.yaw_rate_rps)
        return HoldPoint(pos, setpoint.yaw_rad)

    def _offboard_lost(self, ap: "Autopilot") -> None:
        """COM_OBL_RC_ACT with a pilot; without one, or where it cannot be, RTL."""
        ap.failsafe_reason = "offboard"
        ap.say(Severity.CRITICAL, "Failsafe activated: Offboard control lost")
        wanted = {
            0: Mode.LOITER,
            1: Mode.ALT_HOLD,
            2: Mode.STABILIZE,
            3: Mode.RTL,
            4: Mode.LAND,
            5: Mode.HOLD,
        }.get(int(ap.params["COM_OBL_RC_ACT"]), Mode.RTL)
        ap.set_mode(wanted if can_run(ap, wanted) else Mode.RTL)

    def _rtl(self, ap: "Autopilot") -> Goal:
        if ap.is_landed:
            return Idle()
        if ap.returning is None:
            ap.returning = ap.plan_return()
        return ap.returning.step(ap) or Idle()

    def _land(self, ap: "Autopilot") -> Goal:
        if ap.is_landed:
            return Idle()
        north, east, _ = ap.hold_here()
        return Descend((north, east), self.sink_mps(ap.params, ap.height_above_home_m()))

    def has_setpoints(self, ap: "Autopilot") -> bool:
        """Whether a set-point has come within COM_OF_LOSS_T."""
        age = math.inf if ap.setpoint is None else ap.t_s - ap.setpoint.t_s
        return age <= max(ap.params["COM_OF_LOSS_T"], 0.1)

    def take_setpoint(self, ap: "Autopilot", setpoint: Setpoint) -> None:
        """Heard in any mode: a stream has to be there before OFFBOARD."""
        ap.setpoint = setpoint

    def return_plan(self, ap: "Autopilot") -> ReturnPlan:
        """RTL_*: a cone about the destination, home or the nearest safe point."""
        params, here, home = ap.params, ap.pos_ned_m, ap.home_ned_m
        destination = (home[0], home[1])
        nearest = math.dist(here[:2], destination)
        for item in ap.store.rally:
            point = ap.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
            if math.dist(here[:2], point) < nearest:
                nearest, destination = math.dist(here[:2], point), point
        height = home[2] - here[2]
        return_alt, descend_alt = params["RTL_RETURN_ALT"], params["RTL_DESCEND_ALT"]
        angle = math.radians(min(max(params["RTL_CONE_ANG"], 0.0), 90.0))
        if params["RTL_CONE_ANG"] > 0.0:
            if nearest <= params["RTL_MIN_DIST"]:
                wanted = descend_alt
            else:
                inside = nearest / math.tan(angle) if angle < 1.57 else 0.0
                wanted = max(min(inside, return_alt), descend_alt)
        else:
            wanted = return_alt
        wanted = max(wanted, height)
        delay = params["RTL_LAND_DELAY"]
        return ReturnPlan(
            destination_ne_m=destination,
            cruise_down_m=home[2] - wanted,
            wait_down_m=home[2] - min(descend_alt, wanted),
            wait_s=math.inf if delay < 0.0 else delay,
            speed_mps=self.default_speed_mps,
            climb_mps=max(params["MPC_Z_V_AUTO_UP"], 0.1),
            descend_mps=max(params["MPC_Z_V_AUTO_DN"], 0.1),
            accept_m=min(params["NAV_ACC_RAD"], 3.0),
            faces_home=True,
        )

    # --- arming -------------------------------------------------------------------------------

    def armed(self, ap: "Autopilot") -> None:
        """Arming starts what the mode is for."""
        if ap.mode is Mode.AUTO:
            self._start_mission(ap)
        ap.say(Severity.INFO, "Armed by external command")

    def disarmed(self, ap: "Autopilot") -> None:
        """The mission keeps its place; a finished one will start again."""
        self._interrupted = None
        self._acts_with = None
        ap.executor.stop()
        ap.say(Severity.INFO, "Disarmed")

    def allow_take_off(self) -> None:
        """Nothing to allow."""

    def may_take_off(self, ap: "Autopilot") -> bool:
        """Armed is enough."""
        return True

    # --- missions -----------------------------------------------------------------------------

    def mission_total(self, count: int) -> int:
        """All items; none at all is 65535."""
        return count or 65535

    def mission_is_valid(self, ap: "Autopilot") -> bool:
        """Whether MISSION mode has something to fly."""
        return not ap.executor.plan.is_empty and self._mission_problem is None

    def mission_written(self, ap: "Autopilot", *, whole: bool) -> None:
        """Taken over as a whole; while a mission is flown, after a while."""
        if ap.is_armed and ap.mode is Mode.AUTO and ap.store.mission:
            ap.switch_mission_in(_NEW_MISSION_AFTER_S)
        else:
            self.switch_mission(ap)

    def switch_mission(self, ap: "Autopilot") -> None:
        """Fly the stored mission from now on: at the same index, or at the item marked current."""
        executor = ap.executor
        executor.load(ap.store.mission)
        marked = ap.protocol.flagged_current
        if marked is not None and marked < len(executor.plan):
            executor.index = marked
        self._mission_problem = mission_problem(ap)
        if self._mission_problem is not None and not executor.plan.is_empty:
            ap.say(Severity.CRITICAL, self._mission_problem)
        if ap.mode is not Mode.AUTO or not ap.is_armed:
            return
        if self.mission_is_valid(ap):
            executor.set_current(executor.index)
        else:
            ap.say(Severity.CRITICAL, "No valid mission available, loitering")
            ap.set_mode(Mode.HOLD)

    def _start_mission(self, ap: "Autopilot") -> None:
        executor = ap.executor
        if executor.state == MissionState.COMPLETE and ap.is_landed:
            executor.restart()
        self._mission_problem = mission_problem(ap)
        if not self.mission_is_valid(ap):
            ap.say(Severity.CRITICAL, "No valid mission available, refusing takeoff")
            ap.set_mode(Mode.HOLD)
            return
        ap.say(Severity.INFO, "Executing Mission")
        # Speed commands in front of the item are replayed, in the order of storage.
        ap.speed_override_mps = executor.plan.speed_before(executor.index)
        executor.start()

    def may_clear_mission(self, ap: "Autopilot") -> bool:
        """At any time."""
        return True

    def mission_set_current(self, ap: "Autopilot", link_id: int, seq: int) -> None:
        """MISSION_SET_CURRENT: the way to jump; MISSION_CURRENT follows."""
        if ap.executor.set_current(seq):
            self._tell_current(ap)
        else:
            ap.say(Severity.CRITICAL, "WPM: WP CURR CMD: Not in list")

    def announce_current(self, ap: "Autopilot") -> None:
        """The new current item, to everybody."""
        self._tell_current(ap)

    def _tell_current(self, ap: "Autopilot") -> None:
        fields = self.streams["MISSION_CURRENT"](ap) or {}
        ap.send_all("MISSION_CURRENT", **fields)

    def mission_left(self, ap: "Autopilot") -> None:
        """It tells cameras and gimbals to rest; a companion hears it too."""
        ap.ask_companions(Cmd.DO_TRIGGER_CONTROL, 0.0, 1.0, -1.0)
        if not ap.is_landed:
            ap.ask_companions(Cmd.DO_GIMBAL_MANAGER_CONFIGURE, -3.0, -3.0, -1.0, -1.0)
            ap.ask_companions(Cmd.DO_GIMBAL_MANAGER_PITCHYAW, math.nan, 0.0, math.nan, math.nan)

    def item_started(self, ap: "Autopilot", item: Item, seq: int) -> None:
        """MISSION_CURRENT at each change."""
        if self._pending_speed_mps is not None:
            ap.speed_override_mps = self._pending_speed_mps
            self._pending_speed_mps = None
        self._tell_current(ap)

    def item_reached(self, ap: "Autopilot", seq: int) -> None:
        """MISSION_ITEM_REACHED, and another ten times at 1 Hz."""
        ap.send_all("MISSION_ITEM_REACHED", seq=seq)
        self._reached_seq, self._reached_left = seq, _REACHED_AGAIN
        self._reached_next_s = ap.t_s + 1.0

    def mission_ended(self, ap: "Autopilot") -> None:
        """It stays in MISSION, on the ground or loitering."""
        where = "landed" if ap.is_landed else "loitering"
        ap.say(Severity.INFO, f"Mission finished, {where}")

    def place_of(self, ap: "Autopilot", item: Item) -> Vec3:
        """INT32_MAX and NaN mean here, and this altitude."""
        here = ap.pos_ned_m
        north, east, down = here
        if item.command in PLACED and NO_COORDINATE not in (item.x, item.y):
            north, east = ap.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
        if math.isfinite(item.z):
            if item.frame in AMSL_FRAMES:
                down = ap.frame.alt_amsl_m - item.z
            else:
                down = ap.home_ned_m[2] - item.z
        return north, east, down

    def run_item(self, ap: "Autopilot", item: Item) -> float:
        """Items without a place; a gripper is waited for."""
        match item.command:
            case Cmd.DO_CHANGE_SPEED:
                kind = int(item.param1) if math.isfinite(item.param1) else -1
                self.change_speed(ap, kind, item.param2)
            case Cmd.DO_GRIPPER:
                if ap.params["PD_GRIPPER_EN"] == 0.0:
                    return _GRIPPER_GIVEN_UP_S
                self.grip(ap, int(item.param2) if math.isfinite(item.param2) else 0)
                return ap.params["PD_GRIPPER_TO"]
            case Cmd.DO_SET_ACTUATOR:
                if math.isfinite(item.param1):
                    ap.release = item.param1 > 0.0
            case Cmd.NAV_RETURN_TO_LAUNCH:
                ap.set_mode(Mode.RTL)
            case _:
                pass
        return 0.0

    def change_speed(self, ap: "Autopilot", kind: int, speed_mps: float) -> None:
        """Ground speed at once, other types with the next item; nothing above 0 is the default."""
        if not speed_mps > 0.0:
            ap.speed_override_mps = None
            self._pending_speed_mps = None
        elif kind == 1:
            ap.speed_override_mps = speed_mps
        else:
            self._pending_speed_mps = speed_mps

    def grip(self, ap: "Autopilot", action: int) -> None:
        """DO_GRIPPER: open loop."""
        ap.release = action == 0

    def finish_later(self, ap: "Autopilot", command: Command, wait_s: float) -> None:
        """Acknowledge a command as done after a while."""
        self._later.append(_Later(command, ap.t_s + wait_s))

    def guided_item(self, ap: "Autopilot", link_id: int, message: Message) -> bool:
        """current = 2 means nothing here."""
        return False

    # --- people -------------------------------------------------------------------------------

    def set_mode_message(self, ap: "Autopilot", link_id: int, message: Message) -> None:
        """SET_MODE becomes DO_SET_MODE, and is acknowledged as such."""
        result = Result.DENIED
        if message.base_mode & 1:
            result = request_mode(ap, px4_mode_of(message.custom_mode))
        ap.send(
            link_id,
            "COMMAND_ACK",
            command=int(Cmd.DO_SET_MODE),
            result=int(result),
            target_system=message.src_system,
            target_component=message.src_component,
        )

    def override_channels(self, ap: "Autopilot", system: int, channels: list[int]) -> None:
        """From anybody, for as long as radio control may be silent."""
        ap.pilot.override(channels, ap.t_s + max(ap.params["COM_RC_LOSS_T"], 0.5))

    def minds_gcs(self, params: ParameterStore, system: int) -> bool:
        """Any ground station will do."""
        return True

    def heed_pilot(self, ap: "Autopilot") -> None:
        """The mode switch, if one is mapped, and sticks moved in an automatic mode."""
        slot = ap.pilot.switch(int(ap.params["RC_MAP_FLTMODE"]), _SWITCH_EDGES_US)
        if slot is not None and slot != self._switch:
            self._switch = slot
            mode = PX4_SWITCH_MODES.get(int(ap.params[f"COM_FLTMODE{slot + 1}"]))
            if mode is not None:
                request_mode(ap, mode)
        if ap.is_armed and not ap.is_landed:
            self._heed_sticks(ap)

    def _heed_sticks(self, ap: "Autopilot") -> None:
        sticks = ap.pilot.sticks()
        if sticks is None or ap.mode in PILOTED:
            return
        bit = _OVERRIDE_OFFBOARD if ap.mode is Mode.GUIDED else _OVERRIDE_AUTO
        if not int(ap.params["COM_RC_OVERRIDE"]) & bit:
            return
        if self._throttle_at_entry is None:
            self._throttle_at_entry = sticks.throttle
        moved = max(
            abs(sticks.roll),
            abs(sticks.pitch),
            abs(sticks.yaw),
            2.0 * abs(sticks.throttle - self._throttle_at_entry),
        )
        if moved > ap.params["COM_RC_STICK_OV"] / 100.0:
            self.user_took_over(ap)
            ap.set_mode(Mode.LOITER if ap.has_position else Mode.ALT_HOLD)
            ap.say(Severity.INFO, "Pilot took over using sticks")

    def user_took_over(self, ap: "Autopilot") -> None:
        """Whatever a failsafe was about to do, somebody has decided otherwise."""
        self._acts_with = None
        self._interrupted = None
        ap.failsafe_reason = None

    def watch(self, ap: "Autopilot", failsafes: Failsafes) -> None:
        """Failsafes, ten times a second while armed."""
        watch(ap, failsafes)

    def hold_then(self, ap: "Autopilot", mode: Mode, delay_s: float) -> None:
        """Hold now, act later, unless somebody takes over."""
        ap.set_mode(Mode.HOLD)
        self._acts_with = mode
        self._acts_at_s = ap.t_s + delay_s

    def fall_back(self, ap: "Autopilot", mode: Mode) -> None:
        """To a lesser mode while the present one cannot run."""
        self._interrupted = ap.mode
        ap.set_mode(mode)

    def recover(self, ap: "Autopilot") -> None:
        """Back to the mode that could not run."""
        wanted, self._interrupted = self._interrupted, None
        if wanted is not None and can_run(ap, wanted):
            ap.set_mode(wanted)

    def home_changed(self, ap: "Autopilot") -> None:
        """HOME_POSITION where it is streamed."""
        fields = self.streams["HOME_POSITION"](ap)
        if fields is None:
            return
        for link in ap.links.values():
            if link.interval_of("HOME_POSITION") is not None:
                ap.send(link.id, "HOME_POSITION", **fields)

    def slow_step(self, ap: "Autopilot") -> None:
        """Automatic disarming, delayed actions, repeated messages."""
        if not ap.is_landed:
            ap.has_flown = True
            ap.landed_since_s = ap.t_s
        if ap.is_armed and ap.is_landed:
            self._disarm_on_ground(ap)
        if self._acts_with is not None and ap.t_s >= self._acts_at_s:
            mode, self._acts_with = self._acts_with, None
            if ap.mode is Mode.HOLD and mode is not Mode.HOLD:
                ap.set_mode(mode)
        for later in [entry for entry in self._later if entry.due_s <= ap.t_s]:
            self._later.remove(later)
            ap.acknowledge(later.command, Result.ACCEPTED)
        if self._reached_left > 0 and ap.t_s >= self._reached_next_s:
            self._reached_left -= 1
            self._reached_next_s = ap.t_s + 1.0
            ap.send_all("MISSION_ITEM_REACHED", seq=self._reached_seq)

    def _disarm_on_ground(self, ap: "Autopilot") -> None:
        if ap.has_flown:
            delay = ap.params["COM_DISARM_LAND"]
            since = ap.t_s - ap.landed_since_s
        else:
            delay = ap.params["COM_DISARM_PRFLT"]
            since = ap.t_s - ap.armed_since_s
        if delay > 0.0 and since >= delay and isinstance(ap.goal, Idle):
            ap.disarm()
