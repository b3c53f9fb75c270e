"""Options of a simulated day besides its orders: wind and injected faults."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sim_bridge.autopilot.kinds import AUTOPILOTS

FAULT_WINDOW_FRAC = (0.1, 0.7)
"""Range of fault times as fractions of the planned duration."""

NETWORK_CUT_RANGE_S = (15.0, 180.0)
"""Range of durations of a network cut, from brief shadowing to minutes. `loss` covers shorter gaps;
liveliness ends after 10 s."""

MEMBER_CUT_RANGE_S = (61.0, 300.0)
"""Range of durations of one member's radio outage, from a minute to a whole flight."""

STORE_OUTAGE_RANGE_S = (5.0, 180.0)
"""Range of database outages: a service restarts a server in seconds; a full disk takes longer."""


@dataclass(frozen=True, slots=True)
class DayWorldOptions:
    """Command-line options of a day's world. `truck`: a truck carries the drones; otherwise they
    start from the depot. `least_cut_s`: shortest network cut. `passing_front_mps`: strength of a
    gust front that reaches the centre of the site at `front_at_s`. `shares_wind`: the desk uses
    wind reports from drones.
    """

    wind_log: Path | None = None
    wind_table: Path | None = None
    loss: float = 0.0
    companion_kills: int = 0
    ground_kills: int = 0
    truck_late_s: float = 0.0
    network_cuts: int = 0
    take_overs: int = 0
    autopilots: tuple[str, ...] = AUTOPILOTS
    truck: bool = True
    store_outages: int = 0
    member_cuts: int = 0
    least_cut_s: float = NETWORK_CUT_RANGE_S[0]
    passing_front_mps: float = 0.0
    front_at_s: float = 900.0
    shares_wind: bool = True


DESK_KILLS, COMPANION_KILLS, TAKE_OVERS = "desk_kills", "companion_kills", "take_overs"
STORE_OUTAGES, NETWORK_CUTS, MEMBER_CUTS = "store_outages", "network_cuts", "member_cuts"

FaultTime = tuple[float, float]
"""Begin and duration of a fault (s; 0 for a fault without duration)."""


@dataclass(slots=True)
class Faults:
    """Faults to inject into a day, by kind.

    `drawn`: begins as fractions of the planned duration, by kind. `due`: pending faults, with times
    in s. `log`: times and descriptions of injected faults.
    """

    drawn: dict[str, list[FaultTime]] = field(default_factory=dict)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    due: dict[str, list[FaultTime]] = field(default_factory=dict)
    log: list[tuple[float, str]] = field(default_factory=list)
    longest_cut_s: float = 0.0
    """Duration of the longest injected cut, of the network or of a member."""

    def schedule_drawn_faults(self, makespan_s: float) -> None:
        """Convert the drawn fractions to times for this planned duration."""
        self.due = {
            kind: [(share * makespan_s, for_s) for share, for_s in drawn]
            for kind, drawn in self.drawn.items()
        }

    def next_fault_if_due(self, kind: str, t_s: float) -> FaultTime | None:
        """Return the next fault of this kind if it is due at `earliest_time_s`;
        `remove_and_log_injected_fault` removes it.
        """
        scheduled = self.due.get(kind)
        return scheduled[0] if scheduled and t_s >= scheduled[0][0] else None

    def remove_and_log_injected_fault(self, kind: str, t_s: float, description: str) -> None:
        """Record that the next fault of this kind has been injected."""
        self.due[kind].pop(0)
        self.log.append((t_s, description))

    @property
    def injected_count_by_kind(self) -> dict[str, int]:
        """Number of injected faults per kind; the others were due after the end of the day."""
        return {kind: len(drawn) - len(self.due[kind]) for kind, drawn in self.drawn.items()}


def draw_faults(world_options: DayWorldOptions, rng: np.random.Generator) -> Faults:
    """Draw the faults of one day. New kinds are drawn last, which keeps the earlier draws."""
    kinds = (
        (DESK_KILLS, world_options.ground_kills, None),
        (COMPANION_KILLS, world_options.companion_kills, None),
        (
            NETWORK_CUTS,
            world_options.network_cuts,
            (world_options.least_cut_s, NETWORK_CUT_RANGE_S[1]),
        ),
        (TAKE_OVERS, world_options.take_overs, None),
        (STORE_OUTAGES, world_options.store_outages, STORE_OUTAGE_RANGE_S),
        (MEMBER_CUTS, world_options.member_cuts, MEMBER_CUT_RANGE_S),
    )
    return Faults({kind: _draw_fault_times(rng, count, for_s) for kind, count, for_s in kinds}, rng)


def _draw_fault_times(
    rng: np.random.Generator, count: int, duration_range_s: tuple[float, float] | None
) -> list[FaultTime]:
    return sorted(
        (
            float(rng.uniform(*FAULT_WINDOW_FRAC)),
            0.0 if duration_range_s is None else float(rng.uniform(*duration_range_s)),
        )
        for _ in range(count)
    )
