"""What is asked of a day beside its orders: its wind, and the faults that are drawn for it."""

from collections.abc import Sized
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

AUTOPILOTS = ("px4", "ardupilot")

KILLED_WITHIN = (0.1, 0.7)
"""Fault times as fractions of the planned duration, while something is running."""

CUT_S = (15.0, 180.0)
"""How long the fleet's network is cut: from a passing shadow to some minutes. Shorter gaps are what
`loss` is for; liveliness ends after 10 s."""

MEMBER_CUT_S = (61.0, 300.0)
"""How long one member is cut off: its radio, not the network; from a minute to a whole flight."""

STORE_AWAY_S = (5.0, 180.0)
"""A service starts a server again within seconds; a disk that is full waits for a person."""


@dataclass(frozen=True, slots=True)
class DayWish:
    """Command-line options of a day's world. `truck`: drones ride on one; else they start from the
    depot. `least_cut_s`: the shortest cut of the network. `passing_front_mps`: a gust front of so
    much passes over the site, reaching its middle at `front_at_s`. `shares_wind`: the desk heeds
    what drones tell of the wind.
    """

    wind_log: Path | None = None
    wind_table: Path | None = None
    loss: float = 0.0
    companion_kills: int = 0
    ground_kills: int = 0
    truck_late_s: float = 0.0
    network_cuts: int = 0
    take_overs: int = 0
    front_mps: float = 0.0
    autopilots: tuple[str, ...] = AUTOPILOTS
    truck: bool = True
    store_outages: int = 0
    member_cuts: int = 0
    least_cut_s: float = CUT_S[0]
    passing_front_mps: float = 0.0
    front_at_s: float = 900.0
    shares_wind: bool = True


Lasting = tuple[float, float]
"""When a fault begins, and how long it lasts (s)."""


@dataclass(slots=True)
class Faults:
    """Faults to inject, drawn before the day as fractions of its planned duration.

    `log`: what was done, and when. Those with a duration are pairs, the second in s.
    """

    ground_kills: list[float] = field(default_factory=list)
    companion_kills: list[float] = field(default_factory=list)
    log: list[tuple[float, str]] = field(default_factory=list)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    ground_kills_s: list[float] = field(default_factory=list)
    companion_kills_s: list[float] = field(default_factory=list)
    network_cuts: list[Lasting] = field(default_factory=list)
    """When the fleet's network is cut, and for how long (s)."""
    take_overs: list[float] = field(default_factory=list)
    store_outages: list[Lasting] = field(default_factory=list)
    """When the desk's store goes away, and for how long (s)."""
    member_cuts: list[Lasting] = field(default_factory=list)
    """When one member is cut off, and for how long (s)."""
    network_cuts_s: list[Lasting] = field(default_factory=list)
    take_overs_s: list[float] = field(default_factory=list)
    store_outages_s: list[Lasting] = field(default_factory=list)
    member_cuts_s: list[Lasting] = field(default_factory=list)

    cut_s: float = 0.0
    """The longest cut that was done, of the network or of a member."""

    def spread_over(self, makespan_s: float) -> None:
        """Convert the fractions to times, once the planned duration is known."""
        self.ground_kills_s = [share * makespan_s for share in self.ground_kills]
        self.companion_kills_s = [share * makespan_s for share in self.companion_kills]
        self.take_overs_s = [share * makespan_s for share in self.take_overs]
        self.network_cuts_s = _spread(self.network_cuts, makespan_s)
        self.store_outages_s = _spread(self.store_outages, makespan_s)
        self.member_cuts_s = _spread(self.member_cuts, makespan_s)

    @property
    def came(self) -> dict[str, int]:
        """How many of each kind were done; what is left came too late, the day was over."""
        drawn_and_left: dict[str, tuple[Sized, Sized]] = {
            "desk_kills": (self.ground_kills, self.ground_kills_s),
            "companion_kills": (self.companion_kills, self.companion_kills_s),
            "store_outages": (self.store_outages, self.store_outages_s),
            "network_cuts": (self.network_cuts, self.network_cuts_s),
            "member_cuts": (self.member_cuts, self.member_cuts_s),
            "take_overs": (self.take_overs, self.take_overs_s),
        }
        return {kind: len(drawn) - len(left) for kind, (drawn, left) in drawn_and_left.items()}


def _spread(faults: list[Lasting], makespan_s: float) -> list[Lasting]:
    return [(share * makespan_s, for_s) for share, for_s in faults]


def draw_faults(wish: DayWish, rng: np.random.Generator) -> Faults:
    """The faults of one day. What is new is drawn last: older days stay what they were."""
    ground = sorted(float(share) for share in rng.uniform(*KILLED_WITHIN, wish.ground_kills))
    companions = sorted(float(share) for share in rng.uniform(*KILLED_WITHIN, wish.companion_kills))
    cuts = _drawn(rng, wish.network_cuts, (wish.least_cut_s, CUT_S[1]))
    taken = sorted(float(share) for share in rng.uniform(*KILLED_WITHIN, wish.take_overs))
    outages = _drawn(rng, wish.store_outages, STORE_AWAY_S)
    member_cuts = _drawn(rng, wish.member_cuts, MEMBER_CUT_S)
    return Faults(
        ground,
        companions,
        rng=rng,
        network_cuts=cuts,
        take_overs=taken,
        store_outages=outages,
        member_cuts=member_cuts,
    )


def _drawn(rng: np.random.Generator, count: int, for_s: tuple[float, float]) -> list[Lasting]:
    return sorted(
        (float(rng.uniform(*KILLED_WITHIN)), float(rng.uniform(*for_s))) for _ in range(count)
    )
