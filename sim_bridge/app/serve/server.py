"""Simulated vehicles for any MAVLink client, at a chosen multiple of real time.

    with Host(speedup=5.0) as host:
        served = stand_up(AutopilotKind.PX4, airframe, read_parameters(path))
        host.add(served, onboard=["udpout:127.0.0.1:14540"], gcs=["tcpin::5760"])
        host.run(stop=lambda: False)

No lockstep: a client sees an autopilot whose clock runs fast, and may come and go as it likes.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_bridge.adapters.endpoint import EndpointSet, bundled
from sim_bridge.adapters.realtime import Pacer
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing, LinkKind
from sim_bridge.autopilot.mavlink.codec import Signer
from sim_bridge.autopilot.mavlink.parameters import Parameter
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.signals import Truth
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import SteadyWind, WindField

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
"""Settings by which each has a gripper."""

PHYSICS_STEP_S = 0.01
_LISTEN_EVERY_WALL_S = 0.01  # what a client waits at most for a reaction


@dataclass(frozen=True, slots=True)
class Home:
    """Where a vehicle is switched on."""

    lat_deg: float = 55.47
    lon_deg: float = 8.45
    alt_amsl_m: float = 12.0


@dataclass(slots=True)
class ServedVehicle:
    """One vehicle with its autopilot, as `stand_up` makes it or as the caller wishes."""

    vehicle: Vehicle
    autopilot: Autopilot

    def advance(self, steps: int) -> None:
        """Run physics and autopilot for some 100 Hz steps."""
        vehicle, autopilot = self.vehicle, self.autopilot
        for _ in range(steps):
            readings = vehicle.step(autopilot.actuation, PHYSICS_STEP_S)
            autopilot.step(readings, PHYSICS_STEP_S)

    @property
    def truth(self) -> Truth:
        """What is so, for watching."""
        return self.vehicle.truth


def stand_up(
    autopilot_kind: AutopilotKind,
    airframe: AirframeTruth,
    parameters: Mapping[str, Parameter],
    *,
    home: Home = Home(),
    wind: WindField | None = None,
    payload_kg: float = 0.0,
    charge_frac: float = 1.0,
    system_id: int = 1,
    receiver: tuple[int, ...] | None = None,
    battery_sensing: BatterySensing = BatterySensing.POWER_MODULE,
    seed: int | np.random.SeedSequence = 1,
) -> ServedVehicle:
    """A vehicle of this airframe on the ground at `home`, under this autopilot.

    `parameters` as `read_parameters` reads them. Without `wind` the air is still. `receiver`: the
    channels (us) of a radio control that is switched on; None for none.
    """
    vehicle = Vehicle(
        airframe,
        wind or WindField(SteadyWind(0.0, 0.0)),
        np.random.default_rng(seed),
        payload_kg=payload_kg,
        charge_frac=charge_frac,
        depot_alt_amsl_m=home.alt_amsl_m,
    )
    autopilot = Autopilot(
        autopilot_kind,
        (home.lat_deg, home.lon_deg, home.alt_amsl_m),
        parameters,
        system_id=system_id,
        battery_sensing=battery_sensing,
    )
    autopilot.set_rc(receiver)
    return ServedVehicle(vehicle, autopilot)


class Host:
    """Runs vehicles in real time times `speedup`, each reachable on endpoints of its own."""

    def __init__(self, speedup: float = 1.0) -> None:
        self._pacer = Pacer(speedup)
        self._steps_a_turn = max(1, round(speedup * _LISTEN_EVERY_WALL_S / PHYSICS_STEP_S))
        self._endpoints = EndpointSet([])
        self._served: list[ServedVehicle] = []
        self._owners: list[tuple[ServedVehicle, int]] = []  # by endpoint: vehicle, its link
        self._numbers: dict[tuple[int, int], int] = {}  # (vehicle, link) to endpoint
        self._steps = 0

    def add(
        self,
        served: ServedVehicle,
        *,
        onboard: Sequence[str] = (),
        gcs: Sequence[str] = (),
        signing: Signer | None = None,
    ) -> Sequence[str]:
        """Take a vehicle in, with links for companions and for ground stations.

        With `signing` its links are signed and hear only what is. Returns their URLs in this
        order, with the ports really taken.
        """
        kinds = [LinkKind.ONBOARD] * len(onboard) + [LinkKind.GCS] * len(gcs)
        for link, (url, kind) in enumerate(zip([*onboard, *gcs], kinds, strict=True)):
            served.autopilot.add_link(link, kind, signing=signing)
            self._numbers[len(self._served), link] = self._endpoints.add(url)
            self._owners.append((served, link))
        self._served.append(served)
        return self._endpoints.urls[len(self._endpoints.urls) - len(kinds) :]

    @property
    def t_s(self) -> float:
        """Simulated time since power-up."""
        return self._steps * PHYSICS_STEP_S

    @property
    def slipped_s(self) -> float:
        """Wall time by which the host has fallen behind its speed-up."""
        return self._pacer.slipped_s

    def run(self, stop: Callable[[], bool]) -> None:
        """Serve until `stop` says so (asked about every 10 ms of wall time)."""
        while not stop():
            self.turn()

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        """Serve in a thread while the block runs; what went wrong there is raised at its end."""
        stop = threading.Event()
        failures: list[BaseException] = []

        def body() -> None:
            try:
                self.run(stop.is_set)
            except BaseException as failure:  # noqa: BLE001 - handed to the owner of the thread
                failures.append(failure)

        thread = threading.Thread(target=body, name="sim-bridge serve", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()
            if failures:
                raise failures[0]

    def turn(self) -> None:
        """One round: advance the world, send, and listen until the next round is due."""
        self._steps += self._steps_a_turn
        for index, served in enumerate(self._served):
            served.advance(self._steps_a_turn)
            frames: dict[int, list[bytes]] = {}
            for link, frame in served.autopilot.take_outbox():
                frames.setdefault(link, []).append(frame)
            for link, said in frames.items():
                for datagram in bundled(said):
                    self._endpoints.send(self._numbers[index, link], datagram)
        for number, datagram in self._pacer.wait_until(self.t_s, self._endpoints):
            served, link = self._owners[number]
            served.autopilot.receive(link, datagram)

    def close(self) -> None:
        """Let the sockets go."""
        self._endpoints.close()

    def __enter__(self) -> "Host":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
