"""Direct MAVSDK connection to an autopilot whose companion is silent: commands return to launch."""

import asyncio

from companion.core.base.errors import LeewayError

CONNECT_TIMEOUT_S = 20.0
"""Connection time-out. MAVSDK takes up to 10 s to find a system."""


def connect_and_command_return_to_launch(url: str) -> int:
    """Command the autopilot at `url` (udpin://HOST:PORT, tcpout://...) to return to launch (RTL).

    Returns its MAVLink system id. Raises LeewayError if none is found or it rejects the command.
    """
    return asyncio.run(_connect_and_command_return_to_launch(url))


async def _connect_and_command_return_to_launch(url: str) -> int:
    try:  # loads a native library: imported only when used
        from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
        from mavsdk.asyncio.plugins.action import ActionAsync
        from mavsdk.exceptions import MavsdkError
    except ImportError as error:
        raise LeewayError(
            f"direct line: MAVSDK is not installed, expected leeway-uas[ground]: {error}"
        ) from error
    config = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    try:
        async with Mavsdk(config) as mavsdk:
            await mavsdk.add_any_connection(url)
            system = await mavsdk.first_autopilot(timeout_s=CONNECT_TIMEOUT_S)
            if system is None:
                raise LeewayError(f"{url}: no autopilot found in {CONNECT_TIMEOUT_S:.0f} s")
            await ActionAsync(system).return_to_launch()
            return await system.get_system_id()
    except MavsdkError as error:
        raise LeewayError(f"{url}: {error}") from error
