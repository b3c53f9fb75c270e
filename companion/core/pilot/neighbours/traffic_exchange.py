"""Tracks: what neighbours report of themselves, taken into our frame, and what we report of us."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from companion.core.base.geo import horizontal_m
from companion.core.mission.actions import Severity, TellPlace
from companion.core.mission.events import Event, GnssTime, NeighbourHeard
from companion.core.pilot.context import FlightContext, ItemProgress
from companion.core.separation.policy_view import Ne
from companion.core.separation.setpoint_motion import FLEET, Floats, three
from companion.core.separation.stopping_paths import Neighbours
from companion.core.separation.track import Track
from companion.core.separation.track_cells import HEARD_M
from companion.core.separation.traffic_tracks import NeighbourTracks, Report

OWN_STD_M, OWN_ALT_STD_M = 0.8, 0.5
"""What our own place is wrong by beside what neighbours report of theirs: satellites, barometer."""

POS_STD_M, ALT_STD_M, VEL_STD_MPS = 2.15, 0.7, 0.1
"""What we report of ours: 2 m and 0.5 m of height as the simulated receiver and barometer have,
and the error of our own frame."""


@dataclass(slots=True)
class TrafficState:
    """The tracks, where neighbours want to go, and which of them fly set-points."""

    tracks: NeighbourTracks = field(default_factory=lambda: NeighbourTracks(FLEET))
    goals: dict[str, Ne] = field(default_factory=dict)
    on_setpoints: set[str] = field(default_factory=set)
    away_m: dict[str, float] = field(default_factory=dict)
    """How far each was when it was last heard."""
    ahead_of_core_s: float | None = None
    """Satellite time less the autopilot's."""


class TrafficExchange:
    """Keeps the neighbours' tracks, and reports our own place to them."""

    def __init__(self, progress: ItemProgress) -> None:
        self._state = TrafficState()
        self._progress = progress

    @property
    def reports(self) -> Mapping[str, Report]:
        """Newest report of each neighbour, by name."""
        return {name: track.report for name, track in self._state.tracks.tracks.items()}

    @property
    def goals(self) -> Mapping[str, Ne]:
        """Where neighbours say that they want to, north and east (m)."""
        return self._state.goals

    @property
    def on_setpoints(self) -> Collection[str]:
        """Neighbours who fly set-points."""
        return self._state.on_setpoints

    def satellite_s(self, context: FlightContext) -> float | None:
        """Satellite time now, `None` before any was heard."""
        ahead_s = self._state.ahead_of_core_s
        return None if ahead_s is None else context.t_s + ahead_s

    def neighbours_at(self, satellite_s: float) -> Neighbours:
        """Where they are at this satellite time."""
        return self._state.tracks.at(satellite_s)

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Satellite time, or a neighbour's report."""
        match event:
            case GnssTime():
                self._state.ahead_of_core_s = event.unix_s - event.t_s
            case NeighbourHeard():
                self._take(context, event.name, event.track)
            case _:
                return

    def drop_lost(self, context: FlightContext, satellite_s: float) -> None:
        """Drop the neighbours who have been silent for too long, and say which should have been
        heard: farther off they have flown out of hearing.
        """
        state = self._state
        state.tracks, lost = state.tracks.without_lost(satellite_s)
        missed = [name for name in lost if state.away_m.pop(name, 0.0) <= HEARD_M]
        if missed:
            context.say(Severity.WARNING, f"neighbour lost: {', '.join(missed)}")

    def report(
        self,
        context: FlightContext,
        satellite_s: float,
        pos_ned_m: Floats,
        vel_ned_mps: Floats,
        *,
        on_setpoints: bool,
    ) -> None:
        """Our place, as it will be flown; for the neighbours."""
        flown, index = context.flight_plan, self._progress.index
        assert flown is not None
        frame = flown.site.frame
        lat, lon, _ = frame.to_geodetic((pos_ned_m[0], pos_ned_m[1], 0.0))
        spot = flown.mission.spot_at(index) if index is not None else None
        context.do(
            TellPlace(
                satellite_s,
                math.degrees(lat),
                math.degrees(lon),
                frame.alt_amsl_m - float(pos_ned_m[2]),
                three(vel_ned_mps),
                on_setpoints,
                spot.lat_deg if spot is not None else None,
                spot.lon_deg if spot is not None else None,
            )
        )

    def _take(self, context: FlightContext, name: str, track: Track) -> None:
        """Take a neighbour's place into our own frame.

        Heights are reported above the pad as flown, on the ground that the flight files state: that
        drifts less than what each barometer calls AMSL, and it is what layers are planned in.
        """
        state, flown, now_s = self._state, context.flight_plan, self.satellite_s(context)
        if flown is None or now_s is None:
            return
        frame = flown.site.frame
        north, east, _ = frame.to_ned(
            math.radians(track.lat_deg), math.radians(track.lon_deg), frame.alt_amsl_m
        )
        down = frame.alt_amsl_m - track.alt_amsl_m
        report = Report(
            name,
            track.gnss_s,
            (north, east, down),
            (track.vel_n_mps, track.vel_e_mps, track.vel_d_mps),
            math.hypot(track.pos_std_m, OWN_STD_M),
            math.hypot(track.alt_std_m, OWN_ALT_STD_M),
            track.vel_std_mps,
        )
        if track.to_lat_deg is not None and track.to_lon_deg is not None:
            goal_n, goal_e, _ = frame.to_ned(
                math.radians(track.to_lat_deg), math.radians(track.to_lon_deg), frame.alt_amsl_m
            )
            state.goals[name] = (goal_n, goal_e)
        if track.aside:
            state.on_setpoints.add(name)
        else:
            state.on_setpoints.discard(name)
        tracks = state.tracks.heard(report, now_s)
        if tracks is not state.tracks:
            here = context.here_ned()
            state.away_m[name] = horizontal_m((north, east, down), here) if here else 0.0
        state.tracks = tracks
