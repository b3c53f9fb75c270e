"""A direct line to an autopilot over MAVSDK, past a silent companion: return to launch."""

import asyncio
from dataclasses import dataclass

from companion.core.base.errors import LeewayError

CONNECT_S = 20.0
"""MAVSDK takes up to 10 s to find a system."""


@dataclass(frozen=True, slots=True)
class Returned:
    """The autopilot accepted return to launch."""

    system: int


def return_to_launch(url: str) -> Returned:
    """Command the autopilot at `url` (udpin://HOST:PORT, tcpout://...) to fly its own RTL.

    Raises LeewayError where there is none, or it refuses.
    """
    return asyncio.run(_return_to_launch(url))


async def _return_to_launch(url: str) -> Returned:
    try:  # loads a native library: only where it is needed
        from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
        from mavsdk.asyncio.plugins.action import ActionAsync
        from mavsdk.exceptions import MavsdkError
    except ImportError as error:
        raise LeewayError(f"the direct line needs leeway-uas[ground]: {error}") from error
    config = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    try:
        async with Mavsdk(config) as mavsdk:
            await mavsdk.add_any_connection(url)
            system = await mavsdk.first_autopilot(timeout_s=CONNECT_S)
            if system is None:
                raise LeewayError(f"{url}: no autopilot heard in {CONNECT_S:.0f} s")
            await ActionAsync(system).return_to_launch()
            return Returned(await system.get_system_id())
    except MavsdkError as error:
        raise LeewayError(f"{url}: {error}") from error
