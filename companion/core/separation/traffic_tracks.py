"""Tracks of the neighbours from their reports, as input for the separation filter.

Reports may be late, jump, freeze, be wrong or stop. None of that is repaired by guessing: what does
not fit widens the neighbour's error, and the filter keeps away by that much more.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.separation.stopping_paths import Neighbours, SeparationParams

LOST_S = 30.0  # without a report for so long, a neighbour is down, or no longer near its last place
DOUBT_S = 10.0  # how long what did not fit is remembered
EARLY_S = 0.5  # a report from farther ahead than this comes from a wrong clock
FROZEN_SPEED_MPS = 1.0  # who says so fast and stays in place has a stuck position


@dataclass(frozen=True, slots=True)
class Report:
    """What a neighbour published: its time, place and velocity (local NED), and their errors."""

    name: str
    t_s: float
    pos_ned_m: tuple[float, float, float]
    vel_ned_mps: tuple[float, float, float]
    pos_std_m: float = 2.0
    alt_std_m: float = 0.5
    vel_std_mps: float = 0.1


@dataclass(frozen=True, slots=True)
class NeighbourTrack:
    """The last report that was taken, and how far the reports contradicted each other."""

    report: Report
    doubt_m: float = 0.0
    doubt_t_s: float = 0.0


@dataclass(frozen=True)
class NeighbourTracks:
    """All neighbours heard of; `heard` and `without_lost` give a new one."""

    params: SeparationParams = field(default_factory=SeparationParams)
    tracks: Mapping[str, NeighbourTrack] = field(default_factory=dict)

    def heard(self, report: Report, t_s: float) -> "NeighbourTracks":
        """With this report, received at `t_s`; older, impossible or mangled ones change nothing."""
        known = self.tracks.get(report.name)
        if not _sound(report, t_s) or (known and report.t_s <= known.report.t_s):
            return self
        bounded = _bounded(report, self.params)
        doubt_m, doubt_t_s = _doubt(known, bounded, self.params) if known else (0.0, t_s)
        track = NeighbourTrack(bounded, doubt_m, doubt_t_s)
        return replace(self, tracks={**self.tracks, report.name: track})

    def without_lost(self, t_s: float) -> tuple["NeighbourTracks", tuple[str, ...]]:
        """Without those unheard for `LOST_S`, and their names: the operator is to be told."""
        lost = tuple(n for n, track in self.tracks.items() if t_s - track.report.t_s > LOST_S)
        kept = {n: track for n, track in self.tracks.items() if n not in lost}
        return replace(self, tracks=kept), lost

    def at(self, t_s: float) -> Neighbours:
        """All of them as neighbours of one vehicle (1, J) at `t_s`."""
        tracks = list(self.tracks.values())
        reports = [track.report for track in tracks]

        def column(values: list[float]) -> np.ndarray:
            return np.array([values]).reshape(1, len(tracks))

        doubt = column([_doubt_at(track, t_s) for track in tracks])
        k = self.params.error_sigmas
        return Neighbours(
            np.array([[r.pos_ned_m for r in reports]]).reshape(1, len(tracks), 3),
            np.array([[r.vel_ned_mps for r in reports]]).reshape(1, len(tracks), 3),
            column([max(t_s - r.t_s, 0.0) for r in reports]),
            column([r.pos_std_m for r in reports]) + doubt / k,
            column([r.alt_std_m for r in reports]) + doubt / k,
            column([r.vel_std_mps for r in reports]) + doubt / k / DOUBT_S,
            np.ones((1, len(tracks)), dtype=bool),
        )


def _sound(report: Report, t_s: float) -> bool:
    numbers = (report.t_s, *report.pos_ned_m, *report.vel_ned_mps)
    spreads = (report.pos_std_m, report.alt_std_m, report.vel_std_mps)
    finite = bool(np.isfinite(numbers).all() and np.isfinite(spreads).all())
    return finite and min(spreads) >= 0.0 and report.t_s <= t_s + EARLY_S


def _bounded(report: Report, p: SeparationParams) -> Report:
    """No one flies faster than the fleet can: a greater speed is cut, and the rest is doubt."""
    speed = float(np.hypot(*report.vel_ned_mps[:2]))
    share = min(1.0, p.max_speed_mps / max(speed, 1e-9))
    north, east, down = report.vel_ned_mps
    down = float(np.clip(down, -p.max_climb_mps, p.max_climb_mps))
    wrong = speed * (1.0 - share)
    return replace(
        report,
        vel_ned_mps=(north * share, east * share, down),
        vel_std_mps=report.vel_std_mps + wrong / p.error_sigmas,
    )


def _doubt(known: NeighbourTrack, report: Report, p: SeparationParams) -> tuple[float, float]:
    """How far this report lies from where the last one let the neighbour be, and since when."""
    last = known.report
    after = report.t_s - last.t_s
    reached = np.array(last.pos_ned_m) + np.array(last.vel_ned_mps) * after
    off = float(np.linalg.norm(np.array(report.pos_ned_m) - reached))
    unsure = p.error_sigmas * (last.pos_std_m + report.pos_std_m + last.vel_std_mps * after)
    jump = max(off - unsure - 0.5 * p.accel_mps2 * after**2, 0.0)
    moved = float(np.linalg.norm(np.subtract(report.pos_ned_m, last.pos_ned_m)))
    said = float(np.linalg.norm(report.vel_ned_mps))
    if moved == 0.0 and said > FROZEN_SPEED_MPS:
        jump = max(jump, said * after + known.doubt_m)  # it flies, its position does not
    old = _doubt_at(known, report.t_s)
    return (jump, report.t_s) if jump > old else (known.doubt_m, known.doubt_t_s)


def _doubt_at(track: NeighbourTrack, t_s: float) -> float:
    """What is left of a doubt: all of it at first, nothing after `DOUBT_S`."""
    return track.doubt_m * max(1.0 - (t_s - track.doubt_t_s) / DOUBT_S, 0.0)
