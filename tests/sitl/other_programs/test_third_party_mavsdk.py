"""MAVSDK flies the simulated vehicles, and its telemetry agrees with truth."""

import asyncio
import json
import math
import time
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable
from contextlib import aclosing, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkMessage
from mavsdk.asyncio.plugins.mission import MissionAsync, MissionItem, MissionPlan
from mavsdk.asyncio.plugins.mission_raw import MissionItem as RawItem
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

from companion.app.tools.export import ExportRequest, export_mission_or_track
from companion.core.exports.export_format import ExportFormat
from sim_bridge.app.serve.server import Host
from sim_bridge.app.world.vehicle_host import Home, VehicleHost
from sim_bridge.autopilot.kinds import AutopilotKind
from tests.sitl.served import free_udp_port, on_the_ground

pytestmark = [pytest.mark.third_party, pytest.mark.timeout(120)]

HOME = Home()
SPEEDUP = 8.0
CRUISE_M = 15.0
LEG_M = 60.0
METRES_PER_DEG = 111_195.0  # mean Earth radius (IUGG) times one degree
ABOUT_M = 3.0


@asynccontextmanager
async def connected(url: str) -> AsyncIterator[System]:
    config = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(config) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(timeout_s=20.0)
        assert system is not None, "MAVSDK found no autopilot"
        yield system


async def until(truth: Callable[[], bool], within_s: float) -> None:
    deadline_s = time.monotonic() + within_s
    while not truth():
        assert time.monotonic() < deadline_s, "it never came true"
        await asyncio.sleep(0.05)


async def told(stream: AsyncGenerator[Any, None], wanted: Callable[[Any], bool]) -> Any:
    """Return the first value of a subscription that is `wanted`."""
    async with asyncio.timeout(30.0), aclosing(stream):
        async for value in stream:
            if wanted(value):
                return value
    raise AssertionError("the subscription ended")


async def persistently(deed: Callable[[], Awaitable[None]], within_s: float = 20.0) -> None:
    """Try again while the vehicle refuses: it may not be ready yet."""
    deadline_s = time.monotonic() + within_s
    while True:
        try:
            return await deed()
        except Exception:
            if time.monotonic() > deadline_s:
                raise
            await asyncio.sleep(0.5)


def corners_deg() -> tuple[float, float]:
    """Return the steps in latitude and longitude of the mission: 60 m north, 60 m east."""
    north = LEG_M / METRES_PER_DEG
    return north, north / math.cos(math.radians(HOME.lat_deg))


def plan() -> MissionPlan:
    """Return the mission: take-off, 60 m north, 60 m east of that, land."""
    north, east = corners_deg()
    action = MissionItem.VehicleAction
    places = [
        (0.0, 0.0, action.TAKEOFF),
        (north, 0.0, action.NONE),
        (north, east, action.NONE),
        (north, east, action.LAND),
    ]
    return MissionPlan(
        [
            MissionItem(
                latitude_deg=HOME.lat_deg + dn,
                longitude_deg=HOME.lon_deg + de,
                relative_altitude_m=CRUISE_M,
                is_fly_through=True,
                vehicle_action=vehicle_action,
            )
            for dn, de, vehicle_action in places
        ]
    )


def raw_plan() -> list[RawItem]:
    """Return the mission for ArduPilot: item 0 is home; it rejects NaN that MAVSDK would send."""
    north, east = corners_deg()
    places = [
        (16, 0, 0.0, 0.0, HOME.alt_amsl_m),
        (22, 3, 0.0, 0.0, CRUISE_M),
        (16, 3, north, 0.0, CRUISE_M),
        (16, 3, north, east, CRUISE_M),
        (21, 3, north, east, 0.0),
    ]
    return [
        RawItem(
            seq=seq,
            frame=frame,
            command=command,
            current=int(seq == 0),
            autocontinue=1,
            param1=0.0,
            param2=0.0,
            param3=0.0,
            param4=0.0,
            x=round((HOME.lat_deg + dn) * 1e7),
            y=round((HOME.lon_deg + de) * 1e7),
            z=up,
            mission_type=0,
        )
        for seq, (command, frame, dn, de, up) in enumerate(places)
    ]


async def ask_for_telemetry(telemetry: TelemetryAsync) -> None:
    """ArduPilot sends only HEARTBEAT until telemetry is requested."""
    for set_rate in (
        telemetry.set_rate_position,
        telemetry.set_rate_landed_state,
        telemetry.set_rate_gps_info,
        telemetry.set_rate_battery,
    ):
        await set_rate(2.0)


async def keeps_a_parameter(system: System, name: str, value: int) -> None:
    """Integers travel as bits in PX4's floats and as C casts in ArduPilot's."""
    param = ParamAsync(system)
    assert await param.get_param_int(name) != value
    await param.set_param_int(name, value)
    assert await param.get_param_int(name) == value


async def set_mode_guided(system: System) -> None:
    """Without an RC receiver ArduPilot arms in GUIDED only."""
    fields = {"target_system": 1, "target_component": 1, "command": 176, "param1": 1, "param2": 4}
    ack = await MavlinkDirectAsync(system).send_command(
        MavlinkMessage(message_name="COMMAND_LONG", fields_json=json.dumps(fields))
    )
    assert json.loads(ack.fields_json)["result"] == 0


async def see_it_fly(system: System, served: VehicleHost) -> None:
    """Check climb, flight and landing position, by MAVSDK's telemetry and by truth."""
    telemetry = TelemetryAsync(system)
    assert await told(telemetry.subscribe_in_air(), bool)
    high = await told(telemetry.subscribe_position(), lambda p: p.relative_altitude_m > 10.0)
    assert high.latitude_deg == pytest.approx(HOME.lat_deg, abs=2.0 * LEG_M / METRES_PER_DEG)
    assert not await told(telemetry.subscribe_in_air(), lambda in_air: not in_air)
    await told(telemetry.subscribe_armed(), lambda armed: not armed)
    assert not served.autopilot.is_armed
    assert not served.truth.airborne
    assert not served.truth.crashed
    north, east, _ = served.truth.pos_ned_m
    off_m = math.hypot(north - LEG_M, east - LEG_M)
    assert off_m < ABOUT_M, f"it landed {off_m:.1f} m off"


def fly_on_px4(served: VehicleHost) -> None:
    port = free_udp_port()

    async def body() -> None:
        async with connected(f"udpin://127.0.0.1:{port}") as system:
            mission, telemetry = MissionAsync(system), TelemetryAsync(system)
            await told(telemetry.subscribe_health_all_ok(), bool)
            await keeps_a_parameter(system, "COM_FLIGHT_UUID", 123_456_789)
            await mission.upload_mission(plan())
            assert len((await mission.download_mission()).mission_items) == 4
            await persistently(ActionAsync(system).arm)
            await mission.start_mission()
            await see_it_fly(system, served)
            assert await mission.is_mission_finished()

    with Host(SPEEDUP) as host:
        host.add_vehicle(served, onboard_urls=[f"udpout:127.0.0.1:{port}"])
        with host.serve_in_thread():
            asyncio.run(body())


def on_px4_over_udp() -> None:
    fly_on_px4(on_the_ground(AutopilotKind.PX4))


@pytest.mark.sample
def test_the_check_fails_in_a_world_that_lies_30_m_off_the_map() -> None:
    off = Home(HOME.lat_deg + 30.0 / METRES_PER_DEG, HOME.lon_deg, HOME.alt_amsl_m)
    with pytest.raises(AssertionError, match="it landed"):
        fly_on_px4(on_the_ground(AutopilotKind.PX4, home=off))


def on_ardupilot_over_tcp() -> None:
    served = on_the_ground(AutopilotKind.ARDUPILOT)

    async def body(port: str) -> None:
        async with connected(f"tcpout://127.0.0.1:{port}") as system:
            mission, action = MissionRawAsync(system), ActionAsync(system)
            telemetry = TelemetryAsync(system)
            await ask_for_telemetry(telemetry)
            await keeps_a_parameter(system, "AUTO_OPTIONS", 3)
            await mission.upload_mission(raw_plan())
            assert [item.command for item in await mission.download_mission()] == [
                item.command for item in raw_plan()
            ]
            await set_mode_guided(system)
            await persistently(action.arm)
            await action.set_takeoff_altitude(CRUISE_M)
            await action.takeoff()
            await told(telemetry.subscribe_position(), lambda p: p.relative_altitude_m > 5.0)
            await mission.start_mission()
            await see_it_fly(system, served)
            assert served.autopilot.mode.name == "AUTO"

    with Host(SPEEDUP) as host:
        (url,) = host.add_vehicle(served, gcs_urls=["tcpin:127.0.0.1:0"])
        with host.serve_in_thread():
            asyncio.run(body(url.rsplit(":", 1)[1]))


def test_mavsdk_opens_an_exported_mission_with_its_fence_and_rally_points() -> None:
    """MAVSDK's readers of QGroundControl plans and Mission Planner files find the same items."""
    default = Path("default")
    plan_text = export_mission_or_track(ExportRequest(default, ExportFormat.PLAN, "px4")).text
    wpl_text = export_mission_or_track(ExportRequest(default, ExportFormat.WPL, "ardupilot")).text
    port = free_udp_port()

    async def body() -> None:
        async with connected(f"udpin://127.0.0.1:{port}") as system:
            raw = MissionRawAsync(system)
            of_plan = await raw.import_qgroundcontrol_mission_from_string(plan_text)
            of_wpl = await raw.import_mission_planner_mission_from_string(wpl_text)
            found = [(item.command, item.x, item.y) for item in of_plan.mission_items]
            home, *rest = [(item.command, item.x, item.y) for item in of_wpl.mission_items]
            assert home == (16, 554_700_000, 84_500_000)
            assert found == rest
            assert len(found) > 30
            assert len(of_plan.rally_items) == 1
            corners = [item for item in of_plan.geofence_items if item.command == 5002]
            assert len(corners) == len(of_plan.geofence_items) == 8  # MAV_CMD 5002: keep out

    with Host(SPEEDUP) as host:
        host.add_vehicle(
            on_the_ground(AutopilotKind.PX4), onboard_urls=[f"udpout:127.0.0.1:{port}"]
        )
        with host.serve_in_thread():
            asyncio.run(body())


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("fly_it", [on_ardupilot_over_tcp, on_px4_over_udp])
def test_mavsdk_flies_a_mission(fly_it: Callable[[], None]) -> None:
    fly_it()
