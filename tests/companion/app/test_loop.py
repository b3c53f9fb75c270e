"""The main loop, in lockstep and free-running: replies, ticks on telemetry, invalid input."""

import json
import math
import os
import random
import threading
from pathlib import Path
from time import monotonic
from typing import Any

import pytest

from companion.adapters.autopilots.codec import MavlinkCodec, mavlink
from companion.adapters.files.atomic_file import write_json_atomically
from companion.adapters.files.folder_lock import FolderLock
from companion.adapters.files.params import (
    flight_configuration_digest,
    read_airframe,
    read_flight,
    read_wind_process,
)
from companion.adapters.files.signing_files import STAMPS_NAME, SigningStampStore
from companion.app.flight import run as run_module
from companion.app.flight.loaded_flight import autopilot_parameter_requirements
from companion.app.flight.loop import Loop
from companion.app.flight.recorder import Recorder
from companion.app.flight.run import GROUNDED, INTERNAL_ERROR, Run
from companion.app.flight.send_queue import SendQueue
from companion.app.flight.signing_monitor import SigningMonitor
from companion.core.mission.actions import (
    CancelOrders,
    PublishValues,
    SaveCheckpoint,
    SetGroundSpeed,
    SetMode,
)
from companion.core.mission.events import LinkSilent, Mode, Tick, UnrestoredSettings, VehicleState
from companion.core.mission.find_plan import FindPlan
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.transitions import Phase
from sim_bridge.app.world.memory_link import MemoryLink

ROOT = Path(__file__).parents[3]
FLIGHT = ROOT / "params" / "flights" / "default.toml"


class Station:
    """A loop on a tapped wire, and a sender of autopilot messages."""

    def __init__(
        self, folder: Path, system: int = 1, key: bytes | None = None, *, configure: bool = False
    ) -> None:
        flight, airframe = read_flight(FLIGHT), read_airframe("m100")
        wind_process = read_wind_process("coast")
        self.wire, self.wall_clock_s = MemoryLink(), monotonic
        self.recorder = Recorder(folder)
        self.pilot = Pilot(
            flight,
            airframe,
            wind_process,
            obstacles=None,
            requirements=autopilot_parameter_requirements,
            flight_digest=flight_configuration_digest(FLIGHT, airframe, wind_process),
            options=PilotOptions(configure=configure),
        )
        codec = MavlinkCodec(datagrams=True, signing_key=key)
        signing = None
        if key is not None:
            stamps = SigningStampStore(folder, codec)
            signing = SigningMonitor(codec, self.recorder.submit_latest_write, stamps)
        self.loop = Loop(
            self.wire,
            codec,
            self.recorder,
            self.pilot,
            system_id=None,
            silence_limit_s=1e9,
            wall_clock_s=lambda: self.wall_clock_s(),
            signing=signing,
        )
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
        self.ear = mavlink.MAVLink(None)

    def put(self, *messages: Any) -> None:
        for message in messages:
            self.wire.received.append(bytes(message.pack(self.mav)))
            self.mav.seq = (self.mav.seq + 1) % 256

    def turn(self) -> list[Any]:
        """Run the loop until its input is empty; return the messages sent."""
        while self.wire.received:
            self.loop.step()
        sent = self.wire.take_sent_datagrams()
        return [m for data in sent for m in self.ear.parse_buffer(data) or []]

    def sync(self, t_s: float) -> Any:
        return mavlink.MAVLink_timesync_message(0, round(t_s * 1e9))

    def identify(self) -> None:
        beat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
        self.put(*[beat] * 10)  # enough for an autopilot that never sends its time
        self.turn()

    def telemetry(self, ms: int) -> list[Any]:
        return [
            mavlink.MAVLink_attitude_message(ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            mavlink.MAVLink_global_position_int_message(
                ms, 554_700_000, 84_500_000, 12_000, 0, 0, 0, 0, 0
            ),
            mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 25_000, 50, 90, 0, 0, 0, 0, 0, 0),
        ]


@pytest.fixture
def station(tmp_path):
    made = Station(tmp_path)
    yield made
    made.recorder.close()


KEY = bytes(range(32))


def signed_loop(folder: Path, autopilot_off_s: float) -> tuple[Station, list[float]]:
    """A loop with a key, an autopilot whose clock has an offset, and the wall clock."""
    folder.mkdir(exist_ok=True)
    write_json_atomically(folder / STAMPS_NAME, {"9/9/9": 1})  # of an earlier process
    made, wall = Station(folder, key=KEY), [0.0]
    made.wall_clock_s = lambda: wall[0]
    made.mav.signing.secret_key, made.mav.signing.sign_outgoing = KEY, True
    own_timestamp = MavlinkCodec(datagrams=True, signing_key=KEY).mav.signing.timestamp
    made.mav.signing.timestamp = own_timestamp + round(autopilot_off_s * 1e5)
    return made, wall


def beats(station: Station, wall: list[float], seconds: int) -> list[str]:
    """Send heartbeats at 1 Hz; return the texts sent to the operator."""
    said: list[str] = []
    for _ in range(seconds):
        station.put(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3))
        said += [m.text for m in station.turn() if m.get_type() == "STATUSTEXT"]
        wall[0] += 1.0
    return said


def test_a_check_of_an_autopilot_that_answers_no_request_ends_with_the_reason(tmp_path):
    made, wall = Station(tmp_path), [0.0]
    made.wall_clock_s = lambda: wall[0]
    lock, code = FolderLock.acquire(tmp_path), None
    run = Run(made.loop, made.recorder, made.pilot, lock, True, lambda: wall[0])
    for wall[0] in range(60):
        made.put(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3))
        if (code := run.run_cycle_and_get_exit_code()) is not None:
            break
    assert code == GROUNDED
    assert 30.0 <= wall[0] <= 45.0  # from the identification on
    run.write_result_and_close(code)
    assert "--signing-key" in "".join(getattr(message, "text", "") for message in made.turn())


def test_signed_frames_that_our_clock_refuses_are_told_within_five_seconds_with_both_times(
    tmp_path,
):
    made, wall = signed_loop(tmp_path, -3600.0)
    said = beats(made, wall, 5)
    assert "signing: autopilot clock 3600 s behind" in said
    assert any(text.startswith("autopilot signing clock: 20") for text in said)
    assert any(text.startswith("companion clock: 20") for text in said)
    assert said[-1] == "on the ground: set the clock, restart companion"
    assert beats(made, wall, 30) == []
    made.recorder.close()


def test_a_flood_of_strangers_is_told_once(station):
    station.identify()
    station.wire.rejected_packets = 7
    words = texts(flown(station, 0, 50, 10))
    assert words.count("unknown senders flood the link: theirs dropped") == 1


def texts(messages: list[Any]) -> list[str]:
    return [m.text for m in messages if m.get_type() == "STATUSTEXT"]


def ticks_of(station: Station) -> list[Tick]:
    """Return a list to which each later tick of the pilot is appended."""
    ticks: list[Tick] = []
    take = station.pilot.process_event

    def handle(event: Any) -> list[Any]:
        if isinstance(event, Tick):
            ticks.append(event)
        return take(event)

    station.pilot.process_event = handle  # type: ignore[method-assign]
    return ticks


def flown(station: Station, *tenths: int) -> list[Any]:
    """Send telemetry and a tick at each tenth of a second; return the messages sent."""
    said: list[Any] = []
    for k in range(*tenths):
        station.put(*station.telemetry(100 * k), station.sync(0.1 * k))
        said += station.turn()
    return said


@pytest.mark.parametrize("off_s", [0.0, -30.0, 3600.0])
def test_signed_frames_of_a_clock_that_agrees_or_is_ahead_are_heard(tmp_path, off_s):
    made, wall = signed_loop(tmp_path, off_s)
    said = beats(made, wall, 12)
    assert made.loop.autopilot.system_id == 1
    assert not any("signing:" in text for text in said)
    made.recorder.close()


def claims(station: Station) -> list[Any]:
    """Return a second companion's frames: equal to the own ones, but from another sender."""
    said = [mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)]
    return [bytes(m.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=191))) for m in said]


def test_our_own_frames_that_the_wiring_echoes_are_nobody_else(station):
    station.identify()
    station.put(*station.telemetry(3500), station.sync(3.5))
    while station.wire.received:
        station.loop.step()
    own = list(station.wire.sent)
    phase = station.pilot.phase
    assert phase is not Phase.IDENTIFY
    station.wire.received.extend(own)
    station.turn()
    assert station.pilot.phase is phase
    station.wire.received.extend(claims(station))
    station.turn()
    assert station.pilot.phase is Phase.PASSIVE


def test_before_it_knows_the_vehicle_it_answers_timesync_and_gives_no_order(station):
    station.put(station.sync(0.1))
    said = station.turn()
    assert {m.get_type() for m in said} == {"HEARTBEAT", "TIMESYNC"}
    assert said[-1].ts1 == 100_000_000
    assert said[-1].tc1 != 0


def test_a_timesync_request_is_answered_last_after_everything_before_it_was_handled(station):
    station.identify()
    for k in range(1, 30):
        station.put(*station.telemetry(100 * k), station.sync(0.1 * k))
        said = station.turn()
        assert said[-1].get_type() == "TIMESYNC"
        assert said[-1].ts1 == round(0.1 * k * 1e9)
        assert [m.get_type() for m in said].count("TIMESYNC") == 1
        assert station.loop.clock.t_s == pytest.approx(0.1 * k)


def test_what_is_said_leaves_together_in_whole_frames_that_an_ethernet_carries(station):
    for _ in range(40):
        station.loop.send_queue.queue_message(mavlink.MAVLink_statustext_message(6, b"x" * 50))
    station.loop.send_queue.send_queued_frames()
    sent = station.wire.sent
    assert [len(data) <= 1400 for data in sent] == [True, True]  # 40 frames of 63 bytes
    assert sum(len(station.ear.parse_buffer(data) or []) for data in sent) == 40
    station.loop.send_queue.send_queued_frames()
    assert len(sent) == 2


def test_a_repeated_request_is_answered_again_but_ticks_once(station):
    station.identify()
    station.put(*station.telemetry(1000), station.sync(1.0))
    first = station.turn()
    station.put(station.sync(1.0))
    again = station.turn()
    assert len(first) > 1
    assert [m.get_type() for m in again] == ["TIMESYNC"]


def test_without_timesync_telemetry_itself_ticks_about_ten_times_a_second(station):
    station.identify()
    ticks = ticks_of(station)
    for ms in range(0, 10_000, 20):
        station.put(mavlink.MAVLink_attitude_message(ms, 0, 0, 0, 0, 0, 0))
    station.turn()
    assert 80 <= len(ticks) <= 101
    assert [tick.t_s for tick in ticks] == sorted(tick.t_s for tick in ticks)


@pytest.mark.parametrize("asked", [False, True])
def test_when_late_it_hears_everything_before_it_decides_and_orders_again(station, asked):
    # A busy computer: two seconds of telemetry wait. An order given at their start would count its
    # time-outs from there, and be found disobeyed by telemetry older than the order.
    station.identify()
    station.wall_clock_s = lambda: 0.0  # else a slow machine decides before it has read all
    ticks = ticks_of(station)
    station.wire.reports_queue_length = True
    for k in range(200):
        station.put(mavlink.MAVLink_attitude_message(10 * k, 0, 0, 0, 0, 0, 0))
        if asked and k % 10 == 0:
            station.put(station.sync(0.01 * k))
    said = station.turn()
    decided = [tick.t_s for tick in ticks if not tick.is_backlog]
    assert decided[1] >= 1.5  # the first has no predecessor, so it is not delayed
    assert len(decided) <= 6
    assert len(ticks) >= 19  # the estimators receive all ticks
    if asked:
        assert sum(m.get_type() == "TIMESYNC" for m in said) == 20


def test_a_link_that_is_always_behind_does_not_keep_it_from_deciding(station, monkeypatch):
    station.identify()
    monkeypatch.setattr(MemoryLink, "queued_chunk_count", lambda self: 1_000_000)
    ticks = ticks_of(station)
    now = [100.0]
    station.wall_clock_s = lambda: now[0]
    for k in range(100):
        now[0] += 0.1
        station.put(mavlink.MAVLink_attitude_message(100 * k, 0, 0, 0, 0, 0, 0))
        station.turn()
    assert len(ticks) == 100
    assert 10 <= sum(not tick.is_backlog for tick in ticks) <= 21


class Stalled:
    """A station whose computer stalls at a wall clock set by the test."""

    def __init__(self, station: Station) -> None:
        self.station, self.wall_s = station, 100.0
        station.wall_clock_s = lambda: self.wall_s
        station.wire.reports_queue_length = True
        station.identify()
        self.ticks: list[Tick] = []
        self.told_silent = False
        station.pilot.process_event = self._handle  # type: ignore[method-assign]
        self.hear(1.0)

    def _handle(self, event: Any) -> list[Any]:
        """A pilot that releases control in any other mode, and gives no orders itself."""
        self.told_silent = self.told_silent or isinstance(event, LinkSilent)
        if isinstance(event, Tick):
            self.ticks.append(event)
        if isinstance(event, VehicleState) and event.mode is not Mode.MISSION:
            return [CancelOrders()]
        return []

    def beat(self, mode: int) -> Any:
        """A PX4 heartbeat; 4 with 4 is AUTO.MISSION, 3 is POSCTL."""
        custom = (4 << 16 | 4 << 24) if mode == 4 else mode << 16
        return mavlink.MAVLink_heartbeat_message(2, 12, 0b10000001, custom, 4, 3)

    def arrive(self, first_s: float, last_s: float, mode: int) -> None:
        """Deliver the telemetry of some seconds, with a heartbeat in each."""
        for k in range(round(10 * first_s), round(10 * last_s)):
            if k % 10 == 5:
                self.station.put(self.beat(mode))
            self.station.put(*self.station.telemetry(100 * k), self.station.sync(0.1 * k))

    def hear(self, t_s: float) -> list[Any]:
        """Deliver the telemetry of one instant; return the messages sent, except TIMESYNC."""
        self.wall_s += 0.1
        self.station.put(*self.station.telemetry(round(1000 * t_s)), self.station.sync(t_s))
        return self.commands()

    def commands(self) -> list[Any]:
        return [m for m in self.station.turn() if m.get_type().startswith(("COMMAND", "MISSION"))]


def test_safety_rule_1_after_a_stall_all_that_waited_is_heard_before_anything_is_decided(station):
    still = Stalled(station)
    still.wall_s += 6.0
    still.arrive(1.1, 7.0, mode=4)
    assert still.commands() == []
    since = [tick for tick in still.ticks if tick.t_s > 1.05]
    assert len(since) > 55  # the estimators receive all ticks
    assert all(tick.is_backlog for tick in since)
    still.hear(7.1)
    assert still.ticks[
        -1
    ].is_backlog  # no heartbeat came since: the latest one may have been dropped
    station.put(still.beat(4))
    still.hear(7.2)
    assert not still.ticks[-1].is_backlog
    assert not station.loop.backlog.is_vehicle_state_unconfirmed


def test_safety_rule_1_an_order_from_before_a_stall_does_not_leave_before_it_is_examined(station):
    still = Stalled(station)
    station.loop.execute_actions([SetMode(Mode.MISSION)])
    still.wall_s += 6.0
    still.arrive(1.1, 7.0, mode=3)  # an operator took control in the meantime
    station.loop.send_queue.send_queued_frames()
    assert still.commands() == []
    station.put(still.beat(3))
    assert [still.hear(7.0 + 0.1 * k) for k in range(1, 40)] == [[]] * 39


def test_safety_rule_1_dropped_orders_that_are_encoded_already_do_not_leave(station):
    still = Stalled(station)
    station.loop.execute_actions([SetGroundSpeed(8.0), SetMode(Mode.MISSION), CancelOrders()])
    assert [still.hear(1.0 + 0.1 * k) for k in range(1, 20)] == [[]] * 19


@pytest.mark.parametrize("is_guarded", [True, False])
def test_safety_rule_1_an_order_of_the_tick_in_the_read_with_a_takeover_does_not_leave(
    station, monkeypatch, is_guarded
):
    still = Stalled(station)
    handle = station.pilot.process_event

    def order_at_tick(event: Any) -> list[Any]:
        return [SetMode(Mode.MISSION)] if isinstance(event, Tick) else handle(event)

    station.pilot.process_event = order_at_tick
    if not is_guarded:
        monkeypatch.setattr(SendQueue, "discard_orders", lambda self: None)
    station.wire.received.append(
        b"".join(bytes(m.pack(station.mav)) for m in (station.sync(1.2), still.beat(3)))
    )
    assert bool(still.commands()) is not is_guarded


INTRUDERS = [(30, 8), (2, 8), (26, 8), (6, 8), (0, 12), (1, 12), (2, 3)]


@pytest.mark.parametrize(("mav_type", "mav_autopilot"), INTRUDERS)
@pytest.mark.parametrize("is_first", [True, False])
def test_a_second_heartbeat_with_the_autopilots_ids_is_reported_once_and_ignored(
    station, mav_type, mav_autopilot, is_first
):
    intruder = mavlink.MAVLink_heartbeat_message(mav_type, mav_autopilot, 0, 0, 4, 3)
    own = mavlink.MAVLink_heartbeat_message(2, 12, 129, 4 << 16 | 4 << 24, 4, 3)
    for _ in range(12):
        station.put(*([intruder, own] if is_first and mav_autopilot == 8 else [own]))
    said = texts(station.turn())
    for k in range(1, 40):
        station.put(own, intruder, *station.telemetry(100 * k), station.sync(0.1 * k))
        said += texts(station.turn())
    state = station.pilot.context.telemetry.state
    assert (state.armed, state.mode) == (True, Mode.MISSION)
    assert len([text for text in said if "uses the autopilot's IDs" in text]) == 1
    assert not any("released" in text for text in said)


def test_an_order_from_before_a_stall_is_sent_again_where_it_is_still_wanted(station):
    still = Stalled(station)
    station.loop.execute_actions([SetGroundSpeed(8.0)])
    still.wall_s += 6.0
    still.arrive(1.1, 7.0, mode=4)
    assert still.commands() == []
    station.put(still.beat(4))
    sent = [m for k in range(1, 20) for m in still.hear(7.0 + 0.1 * k)]
    assert mavlink.MAV_CMD_DO_CHANGE_SPEED in {m.command for m in sent}


def test_a_stall_during_which_the_vehicles_time_stood_still_changes_nothing(station):
    # Lockstep on a busy machine: the simulation waits, and the same seed gives the same decisions.
    still = Stalled(station)
    station.loop.execute_actions([SetMode(Mode.MISSION)])
    still.wall_s += 6.0
    assert len(still.hear(1.1)) == 1
    assert not still.ticks[-1].is_backlog


def test_a_stall_of_our_own_is_no_silence_of_the_link(station):
    still = Stalled(station)
    still.wall_s += 20.0
    still.arrive(1.1, 3.0, mode=4)
    station.loop.step()
    assert not still.told_silent


def test_an_fsync_that_hangs_delays_no_answer(station, monkeypatch):
    hangs = threading.Event()
    monkeypatch.setattr(os, "fsync", lambda _: hangs.wait())
    station.identify()
    answered = 0
    for k in range(1, 300):
        station.put(*station.telemetry(100 * k), station.sync(0.1 * k))
        station.loop.execute_actions([SaveCheckpoint({"k": k}, routine=k % 50 > 0)])
        answered += sum(m.get_type() == "TIMESYNC" for m in station.turn())
    assert answered == 299
    assert not (station.recorder.run_dir / "checkpoint.json").exists()  # the disk still hangs
    hangs.set()
    station.recorder.wait_until_stored()
    kept = json.loads((station.recorder.run_dir / "checkpoint.json").read_text())
    assert json.loads(kept["content"]) == {"k": 299}


def test_that_a_record_is_given_up_is_said_once(tmp_path):
    (tmp_path / "file").write_text("no folder")
    station = Station(tmp_path / "file" / "run")
    station.recorder.wait_until_stored()
    station.identify()
    said = texts(flown(station, 1, 30))
    words = "recording stopped, companion.log: Not a directory"
    assert [text for text in said if "record" in text] == [words]
    station.recorder.close()


def test_its_heartbeat_comes_once_a_second_as_an_onboard_controller_of_the_vehicles_system(
    tmp_path,
):
    station = Station(tmp_path, system=7)
    station.identify()
    beats = [m for m in flown(station, 100) if m.get_type() == "HEARTBEAT"]
    station.recorder.close()
    assert 9 <= len(beats) <= 13  # one more at each change of phase
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in beats} == {(7, 191)}
    assert {(m.type, m.autopilot) for m in beats} == {(18, 8)}


def test_named_values_leave_one_a_tick_so_that_the_autopilots_log_keeps_them_all(station):
    # PX4's ULog kept LW_ENERGY and LW_PSUCC, the last of each burst, and nothing else (flown).
    station.identify()
    wanted = {f"LW_{k}": float(k) for k in range(7)}
    station.loop.execute_actions([PublishValues(wanted)])
    heard: list[list[Any]] = []
    for k in range(1, 10):
        station.put(station.sync(0.1 * k))
        heard.append([m for m in station.turn() if m.get_type() == "NAMED_VALUE_FLOAT"])
    assert max(len(said) for said in heard) == 1
    told = {m.name: m.value for said in heard for m in said}
    assert {name: told[name] for name in wanted} == wanted


def test_safety_rule_1_beside_another_computer_it_stands_by_and_only_reports(station):
    station.wire.received.extend(claims(station))
    station.identify()
    said = flown(station, 60)
    assert station.pilot.phase is Phase.PASSIVE
    kinds = {m.get_type() for m in said}
    assert kinds <= {"HEARTBEAT", "TIMESYNC", "NAMED_VALUE_FLOAT", "STATUSTEXT"}
    assert {m.system_status for m in said if m.get_type() == "HEARTBEAT"} == {3}


def test_garbage_foreigners_nan_and_torn_frames_change_nothing_that_it_says(tmp_path):
    def attitude(ms: int, roll_rad: float, mav: Any) -> bytes:
        return bytes(mavlink.MAVLink_attitude_message(ms, roll_rad, 0, 0, 0, 0, 0).pack(mav))

    def flight(folder: Path, noisy: bool) -> list[dict[str, Any]]:
        station, rng = Station(folder), random.Random(3)
        foreign = mavlink.MAVLink(None, srcSystem=9, srcComponent=1)
        station.identify()
        said: list[dict[str, Any]] = []
        for k in range(150):
            for message in station.telemetry(100 * k):
                station.put(message)
                if noisy:
                    whole = station.wire.received[-1]
                    station.wire.received += [
                        rng.randbytes(rng.randint(1, 300)),
                        whole[: rng.randint(1, len(whole) - 1)],
                        whole,  # duplicate
                        attitude(999_999, math.nan, foreign),
                        bytes(mavlink.MAVLink_heartbeat_message(2, 3, 128, 5, 4, 3).pack(foreign)),
                        attitude(100 * k, math.inf, station.mav),
                    ]
            station.put(station.sync(0.1 * k))
            said += [m.to_dict() for m in station.turn()]
        station.recorder.close()
        return said

    assert flight(tmp_path / "noisy", True) == flight(tmp_path / "quiet", False)


@pytest.mark.parametrize("unrestored", [{}, {"LOW_ACT": 0.0}])
def test_an_error_inside_ends_with_code_1_a_word_and_the_result_on_disk(tmp_path, unrestored):
    station = Station(tmp_path, configure=True)
    station.identify()
    station.pilot.process_event(UnrestoredSettings(0.0, unrestored))

    def broken(event: Any) -> list[Any]:
        raise RuntimeError("boom")

    station.pilot.process_event = broken  # type: ignore[method-assign]
    station.put(*station.telemetry(1000), station.sync(1.0))
    run = run_module.Run(station.loop, station.recorder, station.pilot, FolderLock(None))
    assert run_module.run_until_exit_and_return_code(run) == INTERNAL_ERROR
    log = (tmp_path / "companion.log").read_text()
    assert "boom" in log
    assert "Traceback" in log
    sent = [m for data in station.wire.sent for m in station.ear.parse_buffer(data) or []]
    expected = ["companion failed: it sends no more commands"]
    expected += ["settings not restored: companion failed"] * bool(unrestored)
    assert texts(sent) == expected
    assert json.loads((tmp_path / "result.json").read_text())["phase"] == "configure"


def test_nothing_is_ticked_while_the_clock_is_in_doubt(station):
    station.identify()
    station.put(*station.telemetry(10_000), station.sync(10.0))
    station.turn()
    station.put(mavlink.MAVLink_attitude_message(900_000, 0, 0, 0, 0, 0, 0), station.sync(10.1))
    said = station.turn()
    assert [m.get_type() for m in said] == ["TIMESYNC"]
    station.put(*station.telemetry(10_200), station.sync(10.2))
    station.turn()
    assert station.loop.clock.t_s == pytest.approx(10.2)


def fix(ms: int) -> list[object]:
    """The messages that the companion needs to accept a position estimate."""
    return [
        mavlink.MAVLink_gps_raw_int_message(
            1000 * ms, 3, 554_700_000, 84_500_000, 12_000, 60, 60, 0, 0, 14
        ),
        mavlink.MAVLink_extended_sys_state_message(0, 1),
        mavlink.MAVLink_battery_status_message(
            0, 0, 0, 0, [4100] * 6 + [65535] * 4, 50, 10, -1, 90
        ),
    ]


def test_the_loop_ticks_and_beats_while_a_plan_takes_long(station, monkeypatch):
    """The vehicle receives heartbeats throughout; the plan takes effect when it is complete."""
    begun, go_on, finished = threading.Event(), threading.Event(), threading.Event()
    real = FindPlan.compute_plan

    def slow(asked: FindPlan):
        begun.set()
        assert go_on.wait(60.0)
        try:
            return real(asked)
        finally:
            finished.set()

    monkeypatch.setattr(FindPlan, "compute_plan", slow)
    station.identify()

    def second(number: int) -> list[str]:
        heard: list[str] = []
        for tenth in range(10):
            ms = 1000 * number + 100 * tenth
            beat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
            station.put(beat, *station.telemetry(ms), *fix(ms), station.sync(ms / 1000.0))
            heard += [message.get_type() for message in station.turn()]
        return heard

    number = next(n for n in range(1, 60) if second(n) and begun.is_set())
    assert station.pilot.phase is Phase.PLAN
    for _ in range(5):
        number += 1
        heard = second(number)
        assert heard.count("HEARTBEAT") == 1
        assert heard.count("TIMESYNC") == 10
    assert station.pilot.flight_plan is None
    go_on.set()
    assert finished.wait(60.0)
    for _ in range(60):
        number += 1
        second(number)
        if station.pilot.flight_plan is not None:
            return
    raise AssertionError("the plan never came")
