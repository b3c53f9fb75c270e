"""Tracks of the neighbours from their reports, as input of the separation filter.

Reports may be late, jump, freeze, be wrong or stop. An inconsistent report widens the neighbour's
position error, and the filter increases the separation by that amount.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.separation.stopping_paths import Neighbours, SeparationParams

TRACK_LIFETIME_S = (
    30.0  # without a report for this time a neighbour landed or left its last position
)
INCONSISTENCY_DECAY_S = 10.0  # decay time of an inconsistency
MAX_FUTURE_S = 0.5  # a report from further in the future comes from a wrong clock
FROZEN_SPEED_MPS = 1.0  # reported speed above which an unchanged position is frozen


@dataclass(frozen=True, slots=True)
class NeighbourReport:
    """Report of a neighbour: time, position and velocity (local NED), and their errors."""

    name: str
    t_s: float
    pos_ned_m: tuple[float, float, float]
    vel_ned_mps: tuple[float, float, float]
    pos_std_m: float = 2.0
    alt_std_m: float = 0.5
    vel_std_mps: float = 0.1


@dataclass(frozen=True, slots=True)
class NeighbourTrack:
    """Last accepted report, and the inconsistency of the reports (m) with its time."""

    report: NeighbourReport
    inconsistency_m: float = 0.0
    inconsistency_t_s: float = 0.0


@dataclass(frozen=True)
class NeighbourTracks:
    """Tracks of all received neighbours. Immutable: `copy_with_report_if_newer` and
    `copy_without_silent_and_removed_names` return a copy.
    """

    params: SeparationParams = field(default_factory=SeparationParams)
    tracks: Mapping[str, NeighbourTrack] = field(default_factory=dict)

    def copy_with_report_if_newer(
        self, report: NeighbourReport, received_s: float
    ) -> "NeighbourTracks":
        """Return the tracks with a report received at `received_s`; ignore old or invalid ones."""
        known = self.tracks.get(report.name)
        if not _is_finite_and_not_from_future(report, received_s) or (
            known and report.t_s <= known.report.t_s
        ):
            return self
        bounded = _limit_speed_and_widen_error(report, self.params)
        inconsistency_m, inconsistency_t_s = (
            _updated_inconsistency_and_time(known, bounded, self.params)
            if known
            else (0.0, received_s)
        )
        track = NeighbourTrack(bounded, inconsistency_m, inconsistency_t_s)
        return replace(self, tracks={**self.tracks, report.name: track})

    def copy_without_silent_and_removed_names(
        self, current_time_s: float
    ) -> tuple["NeighbourTracks", tuple[str, ...]]:
        """Return the tracks without those silent for `TRACK_LIFETIME_S`, and the names of these."""
        lost = tuple(
            n
            for n, track in self.tracks.items()
            if current_time_s - track.report.t_s > TRACK_LIFETIME_S
        )
        kept = {n: track for n, track in self.tracks.items() if n not in lost}
        return replace(self, tracks=kept), lost

    def to_separation_filter_input(self, t_s: float) -> Neighbours:
        """Return the tracks as neighbours (1, J) of one vehicle at `received_s`."""
        tracks = list(self.tracks.values())
        reports = [track.report for track in tracks]

        def to_row_vector(values: list[float]) -> np.ndarray:
            return np.array([values]).reshape(1, len(tracks))

        inconsistency = to_row_vector([_decayed_inconsistency_m(track, t_s) for track in tracks])
        k = self.params.error_sigmas
        return Neighbours(
            np.array([[r.pos_ned_m for r in reports]]).reshape(1, len(tracks), 3),
            np.array([[r.vel_ned_mps for r in reports]]).reshape(1, len(tracks), 3),
            to_row_vector([max(t_s - r.t_s, 0.0) for r in reports]),
            to_row_vector([r.pos_std_m for r in reports]) + inconsistency / k,
            to_row_vector([r.alt_std_m for r in reports]) + inconsistency / k,
            to_row_vector([r.vel_std_mps for r in reports])
            + inconsistency / k / INCONSISTENCY_DECAY_S,
            np.ones((1, len(tracks)), dtype=bool),
        )


def _is_finite_and_not_from_future(report: NeighbourReport, received_s: float) -> bool:
    numbers = (report.t_s, *report.pos_ned_m, *report.vel_ned_mps)
    spreads = (report.pos_std_m, report.alt_std_m, report.vel_std_mps)
    finite = bool(np.isfinite(numbers).all() and np.isfinite(spreads).all())
    return finite and min(spreads) >= 0.0 and report.t_s <= received_s + MAX_FUTURE_S


def _limit_speed_and_widen_error(report: NeighbourReport, p: SeparationParams) -> NeighbourReport:
    """Limit the report's speed to the fleet's maximum and add the excess to its error."""
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


def _updated_inconsistency_and_time(
    previous_track: NeighbourTrack, report: NeighbourReport, p: SeparationParams
) -> tuple[float, float]:
    """Return the inconsistency (m) of this report with the last one, and its time."""
    last = previous_track.report
    after = report.t_s - last.t_s
    reached = np.array(last.pos_ned_m) + np.array(last.vel_ned_mps) * after
    off = float(np.linalg.norm(np.array(report.pos_ned_m) - reached))
    uncertainty = p.error_sigmas * (last.pos_std_m + report.pos_std_m + last.vel_std_mps * after)
    jump = max(off - uncertainty - 0.5 * p.accel_mps2 * after**2, 0.0)
    moved = float(np.linalg.norm(np.subtract(report.pos_ned_m, last.pos_ned_m)))
    reported_mps = float(np.linalg.norm(report.vel_ned_mps))
    if moved == 0.0 and reported_mps > FROZEN_SPEED_MPS:
        jump = max(jump, reported_mps * after + previous_track.inconsistency_m)  # frozen position
    old = _decayed_inconsistency_m(previous_track, report.t_s)
    return (
        (jump, report.t_s)
        if jump > old
        else (previous_track.inconsistency_m, previous_track.inconsistency_t_s)
    )


def _decayed_inconsistency_m(track: NeighbourTrack, t_s: float) -> float:
    """Return the inconsistency at `t_s`, decaying linearly to 0 over `INCONSISTENCY_DECAY_S`."""
    return track.inconsistency_m * max(
        1.0 - (t_s - track.inconsistency_t_s) / INCONSISTENCY_DECAY_S, 0.0
    )
