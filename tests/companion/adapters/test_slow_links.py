"""Missions, parameters and commands over links with long round trips, stalls, loss, stray results.

The autopilots are the simulated ones, with their own codec and time-outs (PX4 repeats a request
after 0.25 s and gives up after 5 s, ArduPilot after 1 s and 8 s).
"""

import math
from collections import deque
from typing import Any, TypeVar

import numpy as np
import pytest

from companion.adapters.autopilots.ardupilot import ArduPilot
from companion.adapters.autopilots.codec import MavlinkCodec, mavlink
from companion.adapters.autopilots.port import AutopilotPort
from companion.adapters.autopilots.px4 import Px4
from companion.adapters.clock import AutopilotClock
from companion.core.mission import events as ev
from companion.core.mission.actions import (
    Order,
    RequestParameters,
    RequestTelemetry,
    SetParameters,
    UploadMission,
    VerifyMission,
)
from companion.core.mission.mission_items import ItemKind, MissionItem, MissionPosition, Part
from sim_bridge.autopilot.kinds import AutopilotKind
from tests.sim_bridge.autopilot.conftest import Rig

BOTH = pytest.mark.parametrize("autopilot", [AutopilotKind.ARDUPILOT, AutopilotKind.PX4])
STEP_S = 0.1
REPEAT_S = 0.5
EventT = TypeVar("EventT", bound=ev.Event)
ITEMS = (
    MissionItem(ItemKind.TAKEOFF, Part.TAKEOFF, "takeoff", MissionPosition(55.47, 8.45, 40.0)),
    *(
        MissionItem(
            ItemKind.WAYPOINT, Part.OUTBOUND, "out", MissionPosition(55.471 + 0.001 * k, 8.45, 40.0)
        )
        for k in range(10)
    ),
    MissionItem(ItemKind.LAND, Part.LAND, "land", MissionPosition(55.47, 8.45, 0.0)),
)


class SlowLink:
    """A companion's port and a simulated autopilot with a one-way delay of `delay_s`."""

    def __init__(
        self, autopilot: AutopilotKind, delay_s: float, loss: float = 0.0, seed: int = 1
    ) -> None:
        self.rig = Rig(autopilot)
        self._rng = np.random.default_rng(round(10.0 * delay_s) + seed)
        self._loss = loss
        self.clock = AutopilotClock()
        self.port = AutopilotPort(self._send, self.clock)
        self.delay_s = delay_s
        self.t_s = 0.0
        self.stalled_until_s = 0.0
        self.sent: list[Any] = []
        self.results: list[int] = []
        self._codec = MavlinkCodec(datagrams=True)
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        self._up: deque[tuple[float, bytes]] = deque()
        self._down: deque[tuple[float, bytes]] = deque()
        self.until(ev.AutopilotDetected, 60.0)

    def _send(self, message: Any) -> None:
        self.sent.append(message)
        if self._rng.random() < self._loss:
            return
        self._up.append((self.t_s + self.delay_s, bytes(message.pack(self._mav))))

    def inject(self, result: int) -> None:
        """Send the companion a MISSION_ACK that belongs to no active transfer."""
        mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        ack = mavlink.MAVLink_mission_ack_message(1, 191, result, 0)
        self._down.append((self.t_s, bytes(ack.pack(mav))))

    def step(self) -> list[ev.Event]:
        """Advance both sides by 0.1 s; a stalled companion neither reads nor sends."""
        self.t_s += STEP_S
        while self._up and self._up[0][0] <= self.t_s:
            self.rig.ap.process_received_datagram(0, self._up.popleft()[1])
        self.rig.step(STEP_S)
        for _, datagram in self.rig.ap.take_frames_to_send():
            if self._rng.random() < self._loss:
                continue
            self._down.append((self.t_s + self.delay_s, datagram))
        if self.t_s < self.stalled_until_s:
            return []
        events: list[ev.Event] = []
        while self._down and self._down[0][0] <= self.t_s:
            for message in self._codec.parse_valid_messages(self._down.popleft()[1]):
                if message.get_type() == "MISSION_ACK":
                    self.results.append(message.type)
                events += self.port.on_message(message)
        self.clock.update_from_boot_time(self.rig.ap.state.t_since_boot_s - self.delay_s)
        return events + self.port.tick(self.clock.t_s)

    def until(self, kind: type[EventT], limit_s: float) -> EventT:
        """Step until an event of this kind occurs."""
        for _ in range(round(limit_s / STEP_S)):
            found = [event for event in self.step() if isinstance(event, kind)]
            if found:
                return found[0]
        raise AssertionError(f"no {kind.__name__} within {limit_s} s")

    def order(self, order: Order) -> None:
        self.port.execute(order, self.clock.t_s)

    def is_uploaded_and_read_back(self) -> None:
        uploaded = self.until(ev.MissionUploaded, 120.0)
        assert uploaded == ev.MissionUploaded(uploaded.t_s)
        self.order(VerifyMission(ITEMS))
        read = self.until(ev.MissionVerified, 120.0)
        assert read == ev.MissionVerified(read.t_s, ())


@BOTH
@pytest.mark.parametrize("round_trip_s", [0.0, 0.6, 1.4, 2.0, 3.0])
def test_a_mission_is_uploaded_and_read_back_over_any_round_trip(
    autopilot: AutopilotKind, round_trip_s: float
) -> None:
    link = SlowLink(autopilot, round_trip_s / 2.0)
    link.order(UploadMission(ITEMS))
    link.is_uploaded_and_read_back()
    items = [m.seq for m in link.sent if m.get_type() == "MISSION_ITEM_INT"]
    # Until the response each item is repeated every 0.5 s: PX4 ends a transfer after 5 s.
    copies = 1 + math.floor(round_trip_s / REPEAT_S)
    assert len(items) <= copies * (len(set(items)) + 1)


LINKS = pytest.mark.parametrize(
    ("round_trip_s", "loss", "stall_s"),
    [
        (0.0, 0.0, 0.0),
        (1.4, 0.0, 2.0),
        (3.0, 0.0, 0.0),
        (0.2, 0.3, 1.6),
        (1.0, 0.3, 0.0),
        (3.0, 0.3, 0.0),
    ],
)


@BOTH
@LINKS
def test_each_transaction_ends_well_on_a_slow_and_lossy_link(
    autopilot: AutopilotKind, round_trip_s: float, loss: float, stall_s: float
) -> None:
    link = SlowLink(autopilot, round_trip_s / 2.0, loss)
    profile = Px4() if autopilot is AutopilotKind.PX4 else ArduPilot()
    names = [link.rig.ap.params.name_at(index) for index in range(27)]
    known = [name for name in names if name is not None]
    link.order(RequestParameters((*known, "NO_SUCH_NAME")))
    link.stalled_until_s = link.t_s + stall_s
    read = link.until(ev.AutopilotParameters, 400.0)
    missing = [name for name in known if read.values.get(name) is None]
    assert (missing, read.unanswered) == ([], ())
    assert read.values["NO_SUCH_NAME"] is None
    kinds = [m.get_type() for m in link.sent]
    assert kinds.count("PARAM_REQUEST_READ") < (70 if not loss else 250)
    changed = {name: float(read.values[name] or 0.0) + 1.0 for name in known[:1]}
    link.order(SetParameters(changed))
    assert link.until(ev.ParametersSet, 100.0).failed == ()
    link.order(RequestTelemetry())
    granted = link.until(ev.StreamsConfigured, 400.0)
    required = {name for name, _, _, is_required in profile.streams if is_required}
    assert not required & set(granted.refused)
    if loss:
        link.order(UploadMission(ITEMS))
        uploads = 1
        while link.until(ev.MissionUploaded, 300.0).reason and uploads < 6:
            uploads += 1
            link.order(UploadMission(ITEMS))
        assert uploads < 6


@pytest.mark.parametrize("seed", range(5))
def test_many_absent_names_are_known_as_absent_on_a_lossy_link(seed: int) -> None:
    link = SlowLink(AutopilotKind.ARDUPILOT, 0.1, 0.3, seed=seed)
    absent = tuple(f"NAME_{k}" for k in range(11))
    link.order(RequestParameters(("WPNAV_SPEED", *absent)))
    for _ in range(3):  # the pilot requests again what was not answered
        read = link.until(ev.AutopilotParameters, 300.0)
        if not read.unanswered:
            break
        link.order(RequestParameters(read.unanswered))
    assert {read.values[name] for name in absent} == {None}
    assert link.t_s < 180.0


def test_a_silent_link_is_asked_rarely_and_its_names_are_reported_as_awaited() -> None:
    link = SlowLink(AutopilotKind.ARDUPILOT, 0.1)
    link.order(RequestParameters(tuple(f"NAME_{k}" for k in range(27))))
    link.sent.clear()
    link._loss = 1.0
    assert len(link.until(ev.ParametersAwaited, 60.0).names) >= 27
    ended = link.until(ev.AutopilotParameters, 430.0)
    assert len(ended.unanswered) >= 27
    assert sum(m.get_type() == "PARAM_REQUEST_READ" for m in link.sent) < 60


@BOTH
@pytest.mark.parametrize("stall_s", [1.6, 2.0])
@pytest.mark.parametrize("after_s", [0.3, 0.9, 1.5])
def test_a_stalled_companion_goes_on_with_its_upload(
    autopilot: AutopilotKind, stall_s: float, after_s: float
) -> None:
    link = SlowLink(autopilot, 0.1)
    link.order(UploadMission(ITEMS))
    for _ in range(round(after_s / STEP_S)):
        link.step()
    link.stalled_until_s = link.t_s + stall_s
    link.is_uploaded_and_read_back()


@BOTH
@pytest.mark.parametrize(
    "result",
    [
        mavlink.MAV_MISSION_INVALID_SEQUENCE,
        mavlink.MAV_MISSION_ERROR,
        mavlink.MAV_MISSION_OPERATION_CANCELLED,
    ],
)
def test_a_stray_result_ends_no_transfer(autopilot: AutopilotKind, result: int) -> None:
    link = SlowLink(autopilot, 0.05)
    link.order(UploadMission(ITEMS))
    for _ in range(4):
        link.step()
    link.inject(result)
    link.is_uploaded_and_read_back()
    assert [m.get_type() for m in link.sent].count("MISSION_COUNT") <= 2


@BOTH
def test_a_mission_is_read_back_with_several_requests_at_a_time(autopilot: AutopilotKind) -> None:
    link = SlowLink(autopilot, 0.0)
    link.order(UploadMission(ITEMS))
    link.is_uploaded_and_read_back()
    took: dict[int, float] = {}
    for window in (1, 6):
        began_s = link.t_s
        link.order(VerifyMission(ITEMS, pending_requests=window))
        read = link.until(ev.MissionVerified, 20.0)
        assert read == ev.MissionVerified(read.t_s, ())
        took[window] = link.t_s - began_s
    if autopilot is AutopilotKind.ARDUPILOT:
        assert took[6] < 0.5 * took[1]


@BOTH
def test_requests_of_a_transfer_that_was_dropped_are_discarded(autopilot: AutopilotKind) -> None:
    link = SlowLink(autopilot, 0.7)
    link.order(UploadMission(ITEMS[:4]))
    for _ in range(40):
        link.step()
    link.port.discard_all_pending_requests()
    link.order(UploadMission(ITEMS))
    link.is_uploaded_and_read_back()


@BOTH
def test_an_upload_after_a_refusal_waits(autopilot: AutopilotKind) -> None:
    link = SlowLink(autopilot, 0.05)
    link.order(UploadMission(ITEMS))
    link.inject(mavlink.MAV_MISSION_INVALID_PARAM1)
    refused = link.until(ev.MissionUploaded, 5.0)
    assert refused == ev.MissionUploaded(refused.t_s, "invalid param1")
    link.sent.clear()
    link.order(UploadMission(ITEMS))
    for _ in range(15):
        link.step()
    assert "MISSION_COUNT" not in [m.get_type() for m in link.sent]
    link.is_uploaded_and_read_back()
