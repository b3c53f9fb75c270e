"""Runs the conformance suite against a simulated flavour in this process: waiting is simulating.

The bytes are those that would go over a socket; there is only no socket, so that a run is the same
every time and as fast as the machine.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sim_bridge.app.serve import Home, Served
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.flavour import BatterySensing, Flavour
from sim_bridge.autopilot.parameters import read_parameters
from sim_bridge.conform.behaviour import Behaviour
from sim_bridge.conform.client import Client
from sim_bridge.conform.reference import Result, as_result
from sim_bridge.conform.subject import Subject
from sim_bridge.conform.suite import Row, identify, run_suite
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import SteadyWind, WindField

PARAMS = Path(__file__).parents[2] / "params"
STEPS_A_TURN = 2
HOME = Home()
SENSING = {Flavour.PX4: BatterySensing.SIH_TIMER, Flavour.ARDUPILOT: BatterySensing.POWER_MODULE}
WIND = SteadyWind(4.0, from_deg=270.0)  # as the references were recorded


class InProcess:
    """A link whose other end is an autopilot in this process."""

    def __init__(self, served: Served) -> None:
        self._served = served
        served.autopilot.add_link(0)

    def send(self, data: bytes) -> None:
        self._served.autopilot.receive(0, data)

    def receive(self, timeout_s: float) -> bytes:
        self._served.advance(STEPS_A_TURN)
        return b"".join(data for _, data in self._served.autopilot.take_outbox())

    def now_s(self) -> float:
        return self._served.autopilot.t_s

    def close(self) -> None:
        pass


class Watcher:
    """Prints what pytest shows for a run that failed."""

    def begins(self, behaviour: Behaviour) -> None:
        pass

    def ended(self, row: Row) -> None:
        seen = row.problem and f"NOT SEEN: {row.problem}"
        print(f"{row.behaviour.name}: {row.behaviour.says} {seen or row.value} ({row.note})")


def stood(flavour: Flavour) -> Served:
    """A flavour on the ground, in the wind of the references."""
    airframe = load_airframe(PARAMS / "truth" / "m100.toml")
    vehicle = Vehicle(
        airframe,
        WindField(WIND),
        np.random.default_rng(1),
        payload_kg=0.5,
        depot_alt_amsl_m=HOME.alt_amsl_m,
    )
    autopilot = Autopilot(
        flavour,
        (HOME.lat_deg, HOME.lon_deg, HOME.alt_amsl_m),
        read_parameters(PARAMS / "autopilots" / f"{flavour.value}.toml"),
        battery_sensing=SENSING[flavour],
    )
    return Served(vehicle, autopilot)


def ask(served: Served, behaviours: Sequence[Behaviour]) -> Result:
    """What a vehicle answers; it is left as it was found."""
    client = Client(InProcess(served))
    subject = Subject(client, may_force=True)
    vehicle = identify(subject)
    try:
        rows = run_suite(subject, behaviours, Watcher())
    finally:
        subject.clean_up()
    return as_result(vehicle, rows)
