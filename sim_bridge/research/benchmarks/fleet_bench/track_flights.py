"""Drones that tell their places, each by the companion's own zenoh link, and count what they hear.

No physics: straight flights within a square. A process for every 25.
"""

import json
import os
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from companion.adapters.clock import wall_s
from companion.core.base.arrays import Floats
from companion.core.base.geo import moved_deg
from companion.core.mission.flight_file import NeighbourFleet
from companion.core.separation import track_cells
from companion.core.separation.track import Track
from companion.core.separation.track_cells import HEARD_M, cell_of
from companion.fleet import zenoh_link
from companion.fleet.envelope import put_in_envelope
from companion.fleet.messages import encode
from companion.fleet.network import Told
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_config
from companion.fleet.zenoh_link import ZenohLink

FLEET = "bench"
CORNER = (55.4, 8.4)
"""The square's south-west corner."""

SPEED_MPS = 15.0
TRACK_HZ = 5.0
WARM_TICKS = 25
"""Of five a second, before anything is counted: the network learns who listens where."""

LATE_TICKS = 5
"""After the last that is counted, for what is still on its way."""

TRACKS_EACH = 1000
"""What comes while a busy machine lets this process wait is counted, too."""

UNSIGNED = bytes(64)
"""A signature's room: messages are as long as signed ones, and nobody spends time on signing."""


@dataclass(frozen=True, slots=True)
class TrackFlights:
    """Where all drones are: straight on, and back at the square's edges."""

    drones: int
    across_m: float
    seed: int
    fleets: int = 1
    """How many they are of, by turns."""

    def fleet_of(self, number: int) -> str:
        """The fleet of a drone."""
        return f"{FLEET}-{number % self.fleets + 1}"

    @property
    def names(self) -> list[str]:
        """Of the fleets."""
        return [self.fleet_of(number) for number in range(self.fleets)]

    def ne_m(self, tick: int) -> Floats:
        """North and east of the corner, (drones, 2)."""
        rng = np.random.default_rng(self.seed)
        begun_m = rng.uniform(0.0, self.across_m, (self.drones, 2))
        course_rad = rng.uniform(0.0, 2.0 * np.pi, self.drones)
        way = np.column_stack([np.cos(course_rad), np.sin(course_rad)])
        along = begun_m + SPEED_MPS * tick / TRACK_HZ * way
        return self.across_m - np.abs(along % (2.0 * self.across_m) - self.across_m)

    def near(self, tick: int) -> Floats:
        """Who is within a kilometre of whom, (drones, drones), itself excepted."""
        places = self.ne_m(tick)
        away_m = np.linalg.norm(places[:, None] - places[None], axis=2)
        return (away_m <= HEARD_M) & ~np.eye(self.drones, dtype=bool)


class _Stamp(msgspec.Struct):
    gnss_s: float


_stamp = msgspec.json.Decoder(_Stamp)


@dataclass(slots=True)
class TrackCounts:
    """Of some drones: messages and bytes that came; of what was told within a kilometre, how many
    came, and how many were due.
    """

    messages: int = 0
    payload_bytes: int = 0
    most: int = 0
    """Messages of the drone that heard most."""
    near: int = 0
    near_due: int = 0


@dataclass(slots=True)
class _Teller:
    number: int
    link: ZenohLink
    heard: dict[tuple[int, int], int] = field(default_factory=dict)
    """Bytes of each message by teller and tick."""

    def tell(self, tick: int, place_deg: tuple[float, float]) -> None:
        lat_deg, lon_deg = place_deg
        self.link.hear_near(lat_deg, lon_deg)
        track = Track(
            vehicle=_name(self.number), gnss_s=1.8e9 + tick / TRACK_HZ,
            lat_deg=lat_deg, lon_deg=lon_deg, alt_amsl_m=42.3,
            vel_n_mps=8.123456789, vel_e_mps=12.61234567, vel_d_mps=-0.0123456789,
            pos_std_m=2.15, alt_std_m=0.7, vel_std_mps=0.1,
            to_lat_deg=lat_deg, to_lon_deg=lon_deg,
        )  # fmt: skip
        raw = put_in_envelope(track.vehicle, UNSIGNED, encode(track))
        self.link.publish_track(raw, cell_of(lat_deg, lon_deg) or "")

    def hear(self) -> None:
        for told in self.link.tracks():
            self.heard[int(told.speaker[1:]), _tick_of(told)] = len(told.raw)


def _tick_of(told: Told) -> int:
    message = told.raw[told.raw.index(b"{") :]
    return round((_stamp.decode(message).gnss_s - 1.8e9) * TRACK_HZ)


def _name(number: int) -> str:
    return f"v{number}"


def serve(
    numbers: range,
    flights: TrackFlights,
    config_file: Path,
    ticks: int,
    *,
    cells: bool,
    neighbours: bool = True,
) -> None:
    """Join; fly from the moment that a line names, and count over so many ticks. Without `cells`
    all are near, wherever they are; without `neighbours` each hears its own fleet only.
    """
    if not cells:
        track_cells.cells_within = lambda lat_deg, lon_deg, within_m: frozenset({"*/*"})
    zenoh_link.TRACKS_EACH = TRACKS_EACH
    config = read_config(config_file)
    tellers = [
        _Teller(n, ZenohLink(config, VehicleKeys(flights.fleet_of(n), _name(n)), "a", lambda: None))
        for n in numbers
    ]
    for teller in tellers if neighbours else []:
        teller.link.hear_fleets([NeighbourFleet(fleet=name) for name in flights.names])
    print("loaded", flush=True)
    begun_s, rest = float(sys.stdin.readline()), threading.Event()
    for tick in range(WARM_TICKS + ticks + LATE_TICKS):
        places = moved_deg(*CORNER, *flights.ne_m(tick).T)
        rest.wait(max(0.0, begun_s + tick / TRACK_HZ - wall_s()))
        for teller in tellers:
            teller.tell(tick, (float(places[0][teller.number]), float(places[1][teller.number])))
            teller.hear()
    counted = range(WARM_TICKS, WARM_TICKS + ticks)
    print(json.dumps(msgspec.to_builtins(_counted(tellers, flights, counted))), flush=True)
    os._exit(0)


def _counted(tellers: list[_Teller], flights: TrackFlights, ticks: range) -> TrackCounts:
    counts = TrackCounts()
    for teller in tellers:
        heard = {at: size for at, size in teller.heard.items() if at[1] in ticks}
        counts.messages += len(heard)
        counts.payload_bytes += sum(heard.values())
        counts.most = max(counts.most, len(heard))
    for tick in ticks:
        near = flights.near(tick)
        for teller in tellers:
            due = np.flatnonzero(near[teller.number])
            counts.near_due += len(due)
            counts.near += sum((other, tick) in teller.heard for other in due.tolist())
    return counts
