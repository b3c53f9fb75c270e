"""Simulated vehicles for any MAVLink client, at a chosen multiple of real time.

    with Host(speedup=5.0) as host:
        served = power_up_vehicle(AutopilotKind.PX4, airframe)
        host.add_vehicle(served, onboard_urls=["udpout:127.0.0.1:14540"])
        host.serve_until(lambda: False)

There is no lockstep: the autopilot's clock runs fast, and a client may connect at any time.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from sim_bridge.adapters.endpoint import EndpointSet, bundle_frames
from sim_bridge.adapters.realtime import Pacer
from sim_bridge.adapters.wall_clock import mavlink_signing_time_10us
from sim_bridge.app.world.vehicle_host import PHYSICS_STEP_S, VehicleHost
from sim_bridge.autopilot.kinds import AutopilotKind, LinkKind
from sim_bridge.autopilot.mavlink.codec import Signer

SITL_RECEIVER: Mapping[AutopilotKind, tuple[int, ...] | None] = {
    AutopilotKind.PX4: None,
    AutopilotKind.ARDUPILOT: (1500, 1500, 1000, 1500, 1800, 1000, 1000, 1800),
}
"""Channels (us) of the receiver that each autopilot's own simulator has. PX4's SIH has none,
ArduPilot's SITL one with the throttle down and the mode switch at STABILIZE: RC_CHANNELS of
ArduCopter 4.7-dev (commit 90700977c5)."""

SITL_SETTINGS: Mapping[AutopilotKind, Mapping[str, float]] = {
    AutopilotKind.PX4: {},
    AutopilotKind.ARDUPILOT: {"GRIP_ENABLE": 1.0},
}
"""Settings that give each simulator a gripper."""

_LISTEN_INTERVAL_WALL_S = 0.01  # maximum wait of a client for a reaction


class Host:
    """Runs vehicles at `speedup` times real time, each on its own endpoints."""

    def __init__(self, speedup: float = 1.0) -> None:
        self._pacer = Pacer(speedup)
        self._steps_per_cycle = max(1, round(speedup * _LISTEN_INTERVAL_WALL_S / PHYSICS_STEP_S))
        self._endpoints = EndpointSet([])
        self._vehicles: list[VehicleHost] = []
        self._links_by_endpoint: list[
            tuple[VehicleHost, int]
        ] = []  # by endpoint: vehicle, its link
        self._endpoint_by_link: dict[tuple[int, int], int] = {}  # (vehicle, link) to endpoint
        self._steps = 0

    def add_vehicle(
        self,
        vehicle_host: VehicleHost,
        *,
        onboard_urls: Sequence[str] = (),
        gcs_urls: Sequence[str] = (),
        signer: Signer | None = None,
    ) -> Sequence[str]:
        """Add a vehicle, with links for companions and for ground stations.

        With `signer` its links sign their frames and accept only signed ones. Returns their URLs
        in this order, with the ports in use.
        """
        kinds = [LinkKind.ONBOARD] * len(onboard_urls) + [LinkKind.GCS] * len(gcs_urls)
        for link, (url, kind) in enumerate(zip([*onboard_urls, *gcs_urls], kinds, strict=True)):
            vehicle_host.autopilot.add_link(link, kind, signer=signer)
            self._endpoint_by_link[len(self._vehicles), link] = self._endpoints.open_and_add(url)
            self._links_by_endpoint.append((vehicle_host, link))
        self._vehicles.append(vehicle_host)
        return self._endpoints.urls[len(self._endpoints.urls) - len(kinds) :]

    @property
    def t_s(self) -> float:
        """Simulated time since power-up."""
        return self._steps * PHYSICS_STEP_S

    @property
    def wall_time_behind_s(self) -> float:
        """Wall time by which the host has fallen behind its speed-up."""
        return self._pacer.slipped_s

    def serve_until(self, should_stop: Callable[[], bool]) -> None:
        """Serve until `should_stop` returns True (called about every 10 ms of wall time)."""
        while not should_stop():
            self.run_cycle()

    @contextlib.contextmanager
    def serve_in_thread(self) -> Iterator[None]:
        """Serve in a thread while the block runs; raise the thread's exception at its end."""
        stop = threading.Event()
        with ThreadPoolExecutor(1, "sim-bridge serve") as thread:
            served = thread.submit(self.serve_until, stop.is_set)
            try:
                yield
            finally:
                stop.set()
                served.result()

    def run_cycle(self) -> None:
        """Run one cycle: advance the world, send, and receive until the next cycle is due."""
        self._steps += self._steps_per_cycle
        for index, vehicle_host in enumerate(self._vehicles):
            vehicle_host.advance(self._steps_per_cycle)
            if (signing := vehicle_host.autopilot.radio.signing) is not None:
                signing.advance_clock_to(mavlink_signing_time_10us())  # as satellite time does
            for link, frames in vehicle_host.take_sent_frames_by_link().items():
                for datagram in bundle_frames(frames):
                    self._endpoints.send(self._endpoint_by_link[index, link], datagram)
        for number, datagram in self._pacer.receive_until_due(self.t_s, self._endpoints):
            vehicle_host, link = self._links_by_endpoint[number]
            vehicle_host.autopilot.process_received_datagram(link, datagram)

    def close(self) -> None:
        """Close the sockets."""
        self._endpoints.close()

    def __enter__(self) -> "Host":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
