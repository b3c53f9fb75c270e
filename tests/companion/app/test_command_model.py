"""No reachable state sends a command after a newer decision (safety rule 1): model-based test.

Drives the real loop and pilot by encoded MAVLink against a small autopilot of its own (PX4's rules)
with losses, refusals, stalls and people. 100,000 steps:

    LEEWAY_MODEL_STEPS=100000 pytest -n0 tests/companion/app/test_command_model.py
"""

import math
import os
from functools import cache
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.autopilots.mission_wire import encode_mission_items
from companion.app.flight import loop as loop_module
from companion.core.mission import actions as orders
from companion.core.mission import events as ev
from companion.core.mission import jump_watch
from companion.core.mission.command_life_cycle import NewerDecisionMonitor
from companion.core.mission.mission_items import MissionPosition
from companion.core.pilot.authority import ControlAuthority
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.transitions import Phase
from sim_bridge.app.world.memory_link import MemoryLink
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from tests.companion.pilot.fake_vehicle import DEPOT, M_PER_DEG, World, world

STEPS = int(os.environ.get("LEEWAY_MODEL_STEPS", "200"))
STEPS_PER_FLIGHT = 50

MISSION, HOLD, RTL, LAND, POSITION = ((4, 4), (4, 3), (4, 5), (4, 6), (3, 0))
KINDS = {
    ("COMMAND_LONG", 176): "mode",
    ("COMMAND_LONG", 178): "speed",
    ("COMMAND_LONG", 211): "release",
    ("COMMAND_LONG", 400): "arm",
    ("COMMAND_INT", 179): "home",
    ("MISSION_SET_CURRENT", 0): "jump",
    ("MISSION_COUNT", 0): "upload",
    ("MISSION_ITEM_INT", 0): "upload",
    ("MISSION_CLEAR_ALL", 0): "upload",
    ("PARAM_SET", 0): "parameter",
    ("SET_POSITION_TARGET_LOCAL_NED", 0): "set-point",
}
KIND_OF_ORDER = {
    orders.SetMode: "mode",
    orders.SetGroundSpeed: "speed",
    orders.ReleaseParcel: "release",
    orders.SetHome: "home",
    orders.JumpTo: "jump",
    orders.UploadMission: "upload",
    orders.ClearMission: "upload",
}
LEG_KINDS = ("speed", "release", "jump")
VOID_BY_MODE, VOID_BY_MISSION = (*LEG_KINDS, "home", "mode"), (*LEG_KINDS, "upload")
DELAYS = st.integers(1, 4)


class NoRecord:
    """A recorder that records nothing."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_values, **_named: None


@cache
def flown_to(phase: Phase) -> World:
    return world().until(phase)


class Flight(RuleBasedStateMachine):
    """A flight from a restart of the companion on; each rule takes some tenths of a second."""

    violations: ClassVar[list[str]] = []

    # --- the vehicle ------------------------------------------------------------------------------

    @initialize(phase=st.sampled_from([Phase.OUTBOUND, Phase.RELEASE, Phase.RETURN]))
    def start(self, phase: Phase) -> None:
        before = flown_to(phase)
        made = world(kept=before.last_kept, armed=True)
        self.pilot, self.t_s, self.wall_s = made.pilot, before.t_s + 3.0, 0.0
        self.north, self.east, self.height = before.north, before.east, before.height
        self.own_items = self.items = encode_mission_items(
            before.items, home_item_count=0, home=MissionPosition(0, 0, 0),
            autopilot_chosen_yaw_value=math.nan,
        )  # fmt: skip
        self.index, self.mode, self.armed, self.home_up = before.index, MISSION, True, 0.0
        self.mission_id, self.receiving, self.speed_mps = 1, 0, 8.0
        self.by_person = False
        self.lost, self.lost_until_s = frozenset[str](), 0.0
        self.ack_result, self.ack_delay = 0, 0
        self.pending: list[tuple[float, Message]] = []
        self.mav, self.ear = Encoder(1, 1), Decoder()
        self.link = MemoryLink(reports_queue_length=True)
        self.loop = loop_module.Loop(
            self.link, MavlinkCodec(datagrams=True), NoRecord(), self.pilot, system_id=1,  # type: ignore[arg-type]
            silence_limit_s=1e9, wall_clock_s=lambda: self.wall_s, plan_synchronously=True,
        )  # fmt: skip
        # What the companion may not send, and its latest orders.
        self.silent = self.item_silent = ""
        self.ended: dict[str, str] = {}
        self.created: dict[str, tuple[float, Any]] = {}
        self.seen_items: list[tuple[float, int]] = []
        execute = self.loop.autopilot.execute

        def record(order: Any, t_s: float) -> None:
            if (kind := KIND_OF_ORDER.get(type(order))) is not None:
                self.created[kind] = (self.t_s, order, self.mode_shown, self.index_shown)
                self.ended.pop(kind, None)
            execute(order, t_s)

        self.loop.autopilot.execute = record  # type: ignore[method-assign]
        self.mode_shown, self.index_shown = MISSION, self.index
        self.exchange(60)

    def exchange(self, count: int, *, stalled: bool = False, suspended: bool = False) -> None:
        """Let tenths of a second pass: telemetry, then the companion's turn."""
        for _ in range(count):
            self.t_s = round(self.t_s + 0.1, 1)
            self.wall_s += 0.0 if suspended else 0.1
            self.fly()
            sent = [m for at_s, m in self.pending if at_s <= self.t_s]
            self.pending = [(at_s, m) for at_s, m in self.pending if at_s > self.t_s]
            is_lossy = self.t_s < self.lost_until_s
            for message in (*sent, *self.telemetry()):
                if not (is_lossy and message.msg_name in self.lost):
                    self.link.received.append(self.mav.encode_next_frame(message))
            sync = Message("TIMESYNC", tc1=0, ts1=round(self.t_s * 1e9))
            self.link.received.append(self.mav.encode_next_frame(sync))
            if not stalled:
                self.run_companion()

    def fly(self) -> None:
        if self.mode == LAND:
            self.height = max(0.0, self.height - 0.2)
        if self.mode != MISSION or not self.index < len(self.items):
            return
        item = self.items[self.index]
        to_n = (item.x / 1e7 - DEPOT[0]) * M_PER_DEG
        to_e = (item.y / 1e7 - DEPOT[1]) * M_PER_DEG * math.cos(math.radians(DEPOT[0]))
        away_m = math.hypot(to_n - self.north, to_e - self.east) if item.x else 0.0
        if away_m < 2.0:
            is_next = item.command not in (21, 177) and self.index + 1 < len(self.items)
            self.index += 1 if is_next and self.t_s % 2.0 < 0.05 else 0
            return
        share = min(1.0, 0.1 * self.speed_mps / away_m)
        self.north += share * (to_n - self.north)
        self.east += share * (to_e - self.east)

    def telemetry(self) -> list[Message]:
        ms, tenth = round(1000 * self.t_s), round(10 * self.t_s)
        lat = round((DEPOT[0] + self.north / M_PER_DEG) * 1e7)
        east_deg = self.east / M_PER_DEG / math.cos(math.radians(DEPOT[0]))
        lon, up_mm = round((DEPOT[1] + east_deg) * 1e7), round(1000 * self.height)
        alt_mm = round(1000 * DEPOT[2]) + up_mm
        found = [
            Message("ATTITUDE", time_boot_ms=ms, roll=0.0, pitch=0.0, yaw=0.0, rollspeed=0.0,
                    pitchspeed=0.0, yawspeed=0.0),
            Message("GLOBAL_POSITION_INT", time_boot_ms=ms, lat=lat, lon=lon, alt=alt_mm,
                    relative_alt=up_mm - round(1000 * self.home_up), vx=0, vy=0, vz=0, hdg=0),
        ]  # fmt: skip
        if tenth % 5 == 0:
            main, sub = self.mode
            custom, base = main << 16 | sub << 24, 128 if self.armed else 0
            found += [
                Message("HEARTBEAT", type=2, autopilot=12, base_mode=base | 1, custom_mode=custom,
                        system_status=4, mavlink_version=3),
                Message("EXTENDED_SYS_STATE", vtol_state=0, landed_state=2 if self.height else 1),
                Message("GPS_RAW_INT", time_usec=1000 * ms, fix_type=3, lat=lat, lon=lon,
                        alt=alt_mm, eph=60, epv=60, vel=0, cog=0, satellites_visible=14),
                Message("BATTERY_STATUS", id=0, battery_function=0, type=0, temperature=2000,
                        voltages=(4000,) * 6 + (65535,) * 4, current_battery=1700,
                        current_consumed=10, energy_consumed=-1, battery_remaining=80),
            ]  # fmt: skip
        if tenth % 10 == 0:
            found.append(self.mission_current())
        if tenth % 20 == 0:
            found.append(self.home_position())
        return found

    def mission_current(self) -> Message:
        return Message("MISSION_CURRENT", seq=self.index, total=len(self.items), mission_state=3,
                       mission_mode=1 if self.mode == MISSION else 0,
                       mission_id=self.mission_id)  # fmt: skip

    def home_position(self) -> Message:
        lat, lon = round(DEPOT[0] * 1e7), round(DEPOT[1] * 1e7)
        return Message("HOME_POSITION", latitude=lat, longitude=lon,
                       altitude=round(1000 * (DEPOT[2] + self.home_up)), x=0.0, y=0.0, z=0.0,
                       q=(1.0, 0.0, 0.0, 0.0), approach_x=0.0, approach_y=0.0,
                       approach_z=0.0)  # fmt: skip

    def reply(self, name: str, delay_s: float = 0.0, **fields: Any) -> None:
        self.pending.append((self.t_s + delay_s, Message(name, **fields)))

    def ack(self, command: int) -> bool:
        """Acknowledge as the rule `acknowledge` says; return whether it is executed."""
        if self.ack_result is not None:
            self.reply("COMMAND_ACK", self.ack_delay / 10.0, command=command,
                       result=self.ack_result, target_system=1, target_component=191)  # fmt: skip
        return self.ack_result in (0, None)

    def obey(self, m: Message) -> None:
        """Execute a message of the companion."""
        match m.msg_name:
            case "COMMAND_LONG" if self.ack(m.command) and m.command == 176:
                self.mode, self.by_person = (int(m.param2), int(m.param3)), False
            case "COMMAND_INT" if self.ack(m.command) and m.command == 179:
                self.home_up = m.z - DEPOT[2]
                self.pending.append((self.t_s, self.home_position()))
            case "MISSION_SET_CURRENT" if m.seq < len(self.items):
                self.index = m.seq
            case "MISSION_REQUEST_LIST":
                self.reply("MISSION_COUNT", target_system=1, target_component=191,
                           count=len(self.items), mission_type=0)  # fmt: skip
            case "MISSION_REQUEST_INT" if m.seq < len(self.items):
                i = self.items[m.seq]
                numbered = {f"param{n}": value for n, value in enumerate(i.params, 1)}
                self.reply("MISSION_ITEM_INT", target_system=1, target_component=191, seq=m.seq,
                           frame=i.frame, command=i.command, current=0, autocontinue=1, x=i.x,
                           y=i.y, z=i.z, mission_type=0, **numbered)  # fmt: skip
            case "MISSION_COUNT":
                self.receiving = m.count
                self.request_item(0)
            case "MISSION_ITEM_INT" if m.seq + 1 < self.receiving:
                self.request_item(m.seq + 1)
            case "MISSION_ITEM_INT" if self.receiving:
                self.items, self.receiving = self.own_items, 0
                self.mission_id += 1
                self.reply("MISSION_ACK", target_system=1, target_component=191, type=0,
                           mission_type=0)  # fmt: skip
            case "PARAM_REQUEST_READ":
                value = 2.0 if m.param_id == "LOW_ACT" else 0.0
                self.reply("PARAM_VALUE", param_id=m.param_id, param_value=value, param_type=9,
                           param_count=1, param_index=0)  # fmt: skip
            case _:
                return

    def request_item(self, seq: int) -> None:
        self.reply("MISSION_REQUEST_INT", 0.1, target_system=1, target_component=191, seq=seq,
                   mission_type=0)  # fmt: skip

    # --- what the companion may not do ------------------------------------------------------------

    def run_companion(self) -> None:
        while self.link.received:
            (message,) = self.ear.decode_bytes(self.link.received[0])
            self.note_decision(message)
            self.loop.step()
            if self.pilot.phase in (Phase.SUSPENDED, Phase.PASSIVE):
                self.silent = self.silent or f"{self.pilot.phase.value}"
            for datagram in self.link.take_sent_datagrams():
                for sent in self.ear.decode_bytes(datagram):
                    self.check(sent)
                    is_lossy = self.t_s < self.lost_until_s
                    if not (is_lossy and sent.msg_name in self.lost):
                        self.obey(sent)

    def note_decision(self, m: Message) -> None:
        """A message reaches the companion: which orders end now?"""
        match m.msg_name:
            case "HEARTBEAT":
                shown = (m.custom_mode >> 16 & 0xFF, m.custom_mode >> 24)
                if shown != self.mode_shown:
                    self.end(VOID_BY_MODE, f"mode {shown}", lambda made: made[2] != shown)
                    self.mode_handed_back = None
                self.mode_shown = shown
                ordered_s, order, *_ = self.created.get("mode", (-9.0, None))
                ours = order is not None and order.mode.value == MODE_NAMES.get(shown)
                # Selected again in the mode that was handed back, a mode shows in no telemetry.
                is_seen = self.by_person and shown not in (MISSION, self.mode_handed_back)
                if is_seen and not (ours and self.t_s - ordered_s < 6):
                    self.silent = self.silent or f"a person selected {shown}"
            case "MISSION_CURRENT":
                if m.seq != self.index_shown:
                    self.end(("speed", "release"), f"item {m.seq}", lambda made: made[3] != m.seq)
                self.index_shown = m.seq
                self.seen_items.append((self.t_s, m.seq))
                made = self.created.get("jump")
                if made is not None and made[1].index == m.seq and self.t_s - made[0] > 1.0:
                    self.end(("jump",), f"jumped to {m.seq}")
                if self.person_item == m.seq:
                    self.item_silent = f"a person selected item {m.seq}"
            case "HOME_POSITION" if "home" in self.created:
                if abs(m.altitude / 1000.0 - self.created["home"][1].alt_amsl_m) < 1.0:
                    self.end(("home",), "home reported")
            case "MISSION_ACK" if (m.target_system, m.type) == (255, 0):
                self.end(VOID_BY_MISSION, "mission written by another station")
            case _:
                return

    person_item: int | None = None
    mode_handed_back: tuple[int, int] | None = None

    def end(self, kinds: tuple[str, ...], reason: str, applies: Any = lambda made: True) -> None:
        for kind in kinds:
            if kind in self.created and applies(self.created[kind]):
                self.ended.setdefault(kind, reason)

    def check(self, sent: Message) -> None:
        number = sent.__dict__.get("command", 0) if "COMMAND" in sent.msg_name else 0
        kind = KINDS.get((sent.msg_name, number))
        if kind is None:
            return
        what = f"{self.t_s} s: {sent.msg_name} {number} ({kind})"
        assert not self.silent, f"{what} after: {self.silent}"
        assert not (kind == "jump" and self.item_silent), f"{what} after: {self.item_silent}"
        assert kind not in self.ended, f"{what} after: {self.ended[kind]}"

    # --- rules ------------------------------------------------------------------------------------

    @rule(count=DELAYS)
    def time_passes(self, count: int) -> None:
        self.exchange(count)

    @rule(mode=st.sampled_from([HOLD, RTL, LAND, POSITION]), count=DELAYS)
    def person_selects_mode(self, mode: tuple[int, int], count: int) -> None:
        self.mode, self.by_person = mode, True
        self.exchange(count)

    @rule(last=st.booleans(), count=DELAYS)
    def person_selects_item(self, last: bool, count: int) -> None:
        """An item that the mission does not reach by itself."""
        flown = self.pilot.flight_plan
        index = len(self.items) - 1 if last else 1
        recent = {seq for at_s, seq in self.seen_items if self.t_s - at_s < 4.0} | {self.index}
        if "jump" in self.created:
            recent |= {self.created["jump"][1].index}
        is_on_leg = self.mode == MISSION and self.pilot.phase in (Phase.OUTBOUND, Phase.RETURN)
        if flown is None or not is_on_leg or self.items is not self.own_items:
            return  # in a foreign list an item says nothing
        if any(flown.mission.is_item_reachable_without_jump(i, index) for i in recent):
            return
        self.index = self.person_item = index
        self.exchange(count)

    @rule(acknowledged=st.booleans(), count=DELAYS)
    def another_station_writes_the_mission(self, acknowledged: bool, count: int) -> None:
        self.items = [i if not i.x else type(i)(i.frame, i.command, i.params, i.x + 9000, i.y, i.z)
                      for i in self.items]  # fmt: skip
        self.mission_id, self.receiving = self.mission_id + 1, 0
        if acknowledged:
            self.reply("MISSION_ACK", target_system=255, target_component=190, type=0,
                       mission_type=0)  # fmt: skip
        self.exchange(count)

    @rule(up_m=st.sampled_from([-20.0, 25.0]), count=DELAYS)
    def another_station_moves_home(self, up_m: float, count: int) -> None:
        self.home_up = up_m
        self.exchange(count)

    @rule(names=st.sampled_from([
        {"HEARTBEAT"}, {"COMMAND_ACK"}, {"MISSION_CURRENT"}, {"COMMAND_ACK", "MISSION_CURRENT"},
        {"COMMAND_LONG", "COMMAND_INT", "MISSION_SET_CURRENT"}, {"MISSION_ITEM_INT"},
    ]), duration_s=st.sampled_from([1.0, 3.0, 6.0]))  # fmt: skip
    def messages_are_lost(self, names: set[str], duration_s: float) -> None:
        self.lost, self.lost_until_s = frozenset(names), self.t_s + duration_s
        self.exchange(1)

    @rule(result=st.sampled_from([0, 0, None, 1, 2, 4]), delay=st.sampled_from([0, 0, 3, 12]))
    def acknowledge(self, result: int | None, delay: int) -> None:
        """From now on: accepted, no acknowledgement, temporarily rejected, denied or failed."""
        self.ack_result, self.ack_delay = result, delay
        self.exchange(1)

    @rule(tenths=st.sampled_from([3, 12, 25]), mode=st.sampled_from([None, HOLD, POSITION]),
          suspended=st.booleans())  # fmt: skip
    def companion_stalls(self, tenths: int, mode: Any, suspended: bool) -> None:
        """Also with a clock that stands still; a person may take over meanwhile."""
        self.exchange(tenths // 3, stalled=True, suspended=suspended)
        if mode is not None:
            self.mode, self.by_person = mode, True
        self.exchange(tenths - tenths // 3, stalled=True, suspended=suspended)
        self.exchange(1)

    @rule(event=st.sampled_from([ev.ControlHandedBack, ev.AbortOrdered]), count=DELAYS)
    def operator_hands_back(self, event: Any, count: int) -> None:
        if self.link.received or self.loop.backlog.is_vehicle_state_unconfirmed:
            return
        response = self.loop.submit_event(event(self.loop.clock.t_s, "255/190"))
        if response.status is orders.ResponseStatus.ACCEPTED:
            self.silent = self.item_silent = ""
            self.person_item, self.by_person = None, False
            self.mode_handed_back = self.mode_shown
        self.exchange(count)

    @rule()
    def operator_orders_release(self) -> None:
        self.loop.submit_event(ev.ControlReleaseOrdered(self.loop.clock.t_s, "255/190"))
        self.exchange(1)


MODE_NAMES = {HOLD: "hold", RTL: "rtl", LAND: "land", MISSION: "mission"}


def run_steps(steps: int) -> None:
    run_state_machine_as_test(
        Flight,
        settings=settings(
            max_examples=max(1, steps // STEPS_PER_FLIGHT),
            stateful_step_count=STEPS_PER_FLIGHT,
            deadline=None,
            database=None,
            derandomize=steps < 10_000,
            print_blob=False,
            suppress_health_check=list(HealthCheck),
        ),
    )


def test_safety_rule_1_no_reachable_state_sends_a_command_after_a_newer_decision():
    run_steps(STEPS)


def held_back(flight: Flight) -> None:
    flight.person_selects_mode(HOLD, 4)
    flight.another_station_moves_home(-20.0, 4)
    flight.exchange(30)


def lost_speed_then_a_person_writes_the_mission(flight: Flight) -> None:
    flight.messages_are_lost({"COMMAND_ACK"}, 9.0)
    flight.ended.clear()
    flight.loop.autopilot.execute(orders.SetGroundSpeed(7.0), flight.loop.clock.t_s)
    flight.another_station_writes_the_mission(acknowledged=True, count=1)
    flight.exchange(30)


def lost_jump_then_silence(flight: Flight) -> None:
    flight.messages_are_lost({"MISSION_SET_CURRENT", "MISSION_CURRENT"}, 30.0)
    monitor = flight.pilot.parts.part_of_class(MissionProgressMonitor)
    index = flight.pilot.flight_plan.mission.returning[0]
    monitor.order_jump(flight.pilot.context, index, jump_watch.JumpType.HOME)
    flight.loop.execute_actions(flight.pilot.context.take_queued_actions())
    flight.item_silent = "no report of the item"
    flight.loop.send_queue.discard_orders()
    flight.exchange(24)


GUARDS = {
    "a mode is no takeover": (
        held_back, ControlAuthority, "_release_control_on_takeover", lambda *_: None,
    ),
    "a newer decision ends no retry": (
        lost_speed_then_a_person_writes_the_mission, NewerDecisionMonitor, "is_void_after",
        lambda *_: False,
    ),
    "a jump is repeated blindly": (
        lost_jump_then_silence, jump_watch, "UNCHANGED_MAX_AGE_S", math.inf,
    ),
}  # fmt: skip


@pytest.mark.parametrize("guard", GUARDS)
@pytest.mark.parametrize("is_removed", [True, False])
def test_the_model_sees_a_command_that_leaves_without_a_guard(monkeypatch, guard, is_removed):
    scenario, *patch = GUARDS[guard]
    flight = Flight()
    flight.start(Phase.OUTBOUND)
    if is_removed:
        monkeypatch.setattr(*patch)
        with pytest.raises(AssertionError, match="after:"):
            scenario(flight)
    else:
        scenario(flight)
