"""Facts for a new flight file: what an autopilot, or a QGroundControl plan, states."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from companion.adapters.autopilots.codec import mavlink
from companion.adapters.autopilots.mission_transfer import MissionDownload
from companion.adapters.clock import wall_s
from companion.adapters.files.qgc_plan import (
    FenceArea,
    read_plan_fence_and_rally,
    read_plan_home_and_items,
)
from companion.app.flight.autopilot_client import AutopilotClient
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import RequestParameters, RequestTelemetry
from companion.core.mission.events import AutopilotParameters, Battery, Event, VehicleState

FROM_AUTOPILOT = "autopilot"
"""The value of --init that is no plan's path."""

HOME_TIMEOUT_S, TRANSFER_TIMEOUT_S = 20.0, 60.0


@dataclass(frozen=True, slots=True)
class SiteItem:
    """A mission item: command, frame, position (0, 0: none) and height."""

    command: int
    frame: int
    lat_lon_deg: tuple[float, float]
    height_m: float


@dataclass(frozen=True, slots=True)
class SiteFacts:
    """Home, mission, fence areas and rally points, and where they are from."""

    source: str
    home: tuple[float, float, float]
    items: list[SiteItem]
    areas: list[FenceArea]
    rally_deg: list[tuple[float, float]]


@dataclass(slots=True)
class VehicleFacts:
    """What the autopilot states about the vehicle; empty without an autopilot."""

    autopilot: str = ""
    described_by: tuple[tuple[str, str, float], ...] = ()
    values: dict[str, float | None] = field(default_factory=dict)
    mav_type: int | None = None
    voltage_v: float | None = None

    def quantity(self, name: str) -> tuple[float, str] | None:
        """Return a quantity and its source; `None` if no parameter states it."""
        for quantity, parameter, factor in self.described_by:
            value = self.values.get(parameter)
            if quantity == name and value is not None and value > 0.0:
                return value * factor, f"{parameter} = {value:g}"
        return None

    def stated(self, name: str) -> str:
        """Return all parameters of a quantity with their values, as text."""
        known = [
            f"{parameter} = {value:g}"
            for quantity, parameter, _ in self.described_by
            if quantity == name and (value := self.values.get(parameter)) is not None
        ]
        return ", ".join(known) or "not known"


def ask_autopilot(
    client: AutopilotClient, timeout_s: float, *, with_site: bool
) -> tuple[VehicleFacts, SiteFacts | None] | None:
    """Return the facts of the vehicle, and with `with_site` of its site. `None`: no autopilot.

    Raises LeewayError if it answers, but not with what is needed.
    """
    facts = VehicleFacts()
    client.observe = lambda message: _note_type(facts, message)
    if _wait(client, lambda event: isinstance(event, VehicleState), timeout_s) is None:
        return None
    profile = client.port.profile
    if profile is None:
        return None
    system = f"{profile.autopilot_kind.value}, system {client.port.system_id}"
    facts.autopilot, facts.described_by = system, profile.described_by
    client.port.execute(RequestTelemetry(), client.clock.t_s)
    names = dict.fromkeys(parameter for _, parameter, _ in profile.described_by)
    client.port.execute(RequestParameters(tuple(names)), client.clock.t_s)
    found = _wait(client, lambda event: isinstance(event, AutopilotParameters), TRANSFER_TIMEOUT_S)
    if found is None or not any(value is not None for value in found.values.values()):
        raise LeewayError(f"{system}: no answer to {', '.join(names)}: nothing is written")
    facts.values = dict(found.values)
    voltage = _wait(client, lambda e: isinstance(e, Battery) and bool(e.voltage_v), HOME_TIMEOUT_S)
    facts.voltage_v = None if voltage is None else voltage.voltage_v
    return facts, _ask_site(client, system, profile.home_item_count) if with_site else None


def _note_type(facts: VehicleFacts, message: Any) -> None:
    if message.get_type() == "HEARTBEAT":
        facts.mav_type = message.type


def _wait(
    client: AutopilotClient, is_awaited: Callable[[Event], bool], timeout_s: float
) -> Any | None:
    """Return the first event that is awaited; `None` after the time-out."""
    end_s = wall_s() + timeout_s
    while wall_s() < end_s:
        events = client.port.tick(client.clock.t_s) if client.clock.is_known else []
        for event in [*events, *client.receive_events()]:
            if is_awaited(event):
                return event
    return None


def _ask_site(client: AutopilotClient, system: str, home_items: int) -> SiteFacts:
    _wait(client, lambda _: client.telemetry.home is not None, HOME_TIMEOUT_S)
    home = client.telemetry.home
    if home is None:
        raise LeewayError(f"{system}: no HOME_POSITION: wait for a GNSS fix, then repeat")
    mission = _download(client, mavlink.MAV_MISSION_TYPE_MISSION, home_items)
    fence = _download(client, mavlink.MAV_MISSION_TYPE_FENCE, 0)
    rally = _download(client, mavlink.MAV_MISSION_TYPE_RALLY, 0)
    return SiteFacts(
        "the onboard mission",
        (home.lat_deg, home.lon_deg, home.alt_amsl_m),
        [SiteItem(m.command, m.frame, _lat_lon_deg(m), float(m.z)) for m in mission],
        list(_areas_of_fence_items(fence)),
        [_lat_lon_deg(m) for m in rally],
    )


def _lat_lon_deg(message: Any) -> tuple[float, float]:
    return message.x * 1e-7, message.y * 1e-7


def _download(client: AutopilotClient, mission_type: int, home_items: int) -> tuple[Any, ...]:
    """Return the items of a list; LeewayError if the autopilot does not send it."""
    system, t_s = client.port.system_id or 0, client.clock.t_s
    download = MissionDownload(client.send, system, home_items, t_s, mission_type=mission_type)
    before = client.observe

    def observe(message: Any) -> None:
        before(message)
        if message.get_type() in ("MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"):
            download.on_message(message, client.clock.t_s)

    client.observe = observe
    end_s = wall_s() + TRANSFER_TIMEOUT_S
    while download.result_text is None and wall_s() < end_s:
        client.receive_events()
        download.tick(client.clock.t_s)
    client.observe = before
    if download.result_text == "":
        return download.received_messages_without_home
    kind = ("mission", "fence", "rally points")[mission_type]
    reason = download.result_text or "no end of the download"
    if reason == "unsupported":
        return ()
    raise LeewayError(f"system {system}: {kind} not received ({reason}): nothing is written")


def _areas_of_fence_items(messages: Iterable[Any]) -> Iterable[FenceArea]:
    """Yield the areas of fence items: polygons by their corners, and circles."""
    left = list(messages)
    while left:
        first = left.pop(0)
        if first.command in (5001, 5002):  # MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, _EXCLUSION
            others = [left.pop(0) for _ in range(min(int(first.param1) - 1, len(left)))]
            ring = tuple(_lat_lon_deg(m) for m in (first, *others))
            yield FenceArea(first.command == 5001, ring)
        elif first.command in (5003, 5004):  # MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, _EXCLUSION
            yield FenceArea.of_circle(first.command == 5003, _lat_lon_deg(first), first.param1)


def read_site_of_plan(plan: Path) -> SiteFacts:
    """Return the site of a QGroundControl plan. LeewayError names the file and the item."""
    home, items = read_plan_home_and_items(plan)
    areas, rally_deg = read_plan_fence_and_rally(plan)
    return SiteFacts(
        plan.name,
        home,
        [
            SiteItem(
                item["command"],
                item["frame"],
                (item["params"][4] or 0.0, item["params"][5] or 0.0),
                item["params"][6] or 0.0,
            )
            for item in items
        ],
        areas,
        rally_deg,
    )
