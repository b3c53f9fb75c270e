"""Tracks: reports of neighbours in this vehicle's frame, and the report of its own position."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from companion.core.base.geo import horizontal_distance_m
from companion.core.mission.actions import PublishTrack
from companion.core.mission.alerts import Alert
from companion.core.mission.events import Event, GnssTime, NeighbourTrackReceived
from companion.core.pilot.context import FlightContext
from companion.core.pilot.flight_state import CurrentItem
from companion.core.separation.policy_view import Ne
from companion.core.separation.setpoint_motion import (
    FLEET_SEPARATION,
    Floats,
    braking_velocity_to_point_ned_mps,
    vector_to_tuple,
)
from companion.core.separation.stopping_paths import Neighbours
from companion.core.separation.track import Track
from companion.core.separation.track_cells import RECEPTION_RADIUS_M
from companion.core.separation.traffic_tracks import NeighbourReport, NeighbourTracks

OWN_STD_M, OWN_ALT_STD_M = 0.8, 0.5
"""Additional position error of this vehicle relative to neighbours' reports: GNSS, barometer."""

POS_STD_M, ALT_STD_M, VEL_STD_MPS = 2.15, 0.7, 0.1
"""Reported errors: 2 m, and 0.5 m of height as in the simulated receiver and barometer, plus the
error of the vehicle's own frame."""


@dataclass(slots=True)
class TrafficState:
    """The tracks, the neighbours' goals, and which of them fly set-points."""

    tracks: NeighbourTracks = field(default_factory=lambda: NeighbourTracks(FLEET_SEPARATION))
    goals: dict[str, Ne] = field(default_factory=dict)
    on_setpoints: set[str] = field(default_factory=set)
    last_distance_m: dict[str, float] = field(default_factory=dict)
    """Distance of each at its last report."""
    satellite_offset_s: float | None = None
    """Satellite time minus the autopilot's time."""


@dataclass(slots=True, eq=False)
class TrafficExchange:
    """Keeps the neighbours' tracks, and reports this vehicle's position to them."""

    _item: CurrentItem
    _state: TrafficState = field(default_factory=TrafficState)

    @property
    def latest_report_by_name(self) -> Mapping[str, NeighbourReport]:
        """Latest report of each neighbour, by name."""
        return {name: track.report for name, track in self._state.tracks.tracks.items()}

    @property
    def goal_ne_m_by_name(self) -> Mapping[str, Ne]:
        """Reported goals of neighbours, north and east (m)."""
        return self._state.goals

    def satellite_time_s(self, context: FlightContext) -> float | None:
        """Return the present satellite time, `None` before the first one is received."""
        offset_s = self._state.satellite_offset_s
        return None if offset_s is None else context.t_s + offset_s

    def neighbours_at(self, satellite_s: float) -> Neighbours:
        """Return the neighbours at this satellite time."""
        return self._state.tracks.to_separation_filter_input(satellite_s)

    def neighbours_at_cruise_speed(self, neighbours: Neighbours, speed_mps: float) -> Neighbours:
        """Return the neighbours as if those in their missions flew to their goals this fast."""
        state, vel = self._state, neighbours.vel_ned_mps.copy()
        for column, (name, report) in enumerate(self.latest_report_by_name.items()):
            goal_ne_m, (_, _, down_m) = state.goals.get(name), report.pos_ned_m
            if goal_ne_m is not None and name not in state.on_setpoints:
                vel[0, column] = braking_velocity_to_point_ned_mps(
                    report.pos_ned_m, (*goal_ne_m, down_m), speed_mps, FLEET_SEPARATION
                )
        return replace(neighbours, vel_ned_mps=vel)

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process satellite time or a neighbour's report."""
        match event:
            case GnssTime():
                self._state.satellite_offset_s = event.unix_s - event.t_s
            case NeighbourTrackReceived():
                self._store_neighbour_track(context, event.full_vehicle_name, event.track)
            case _:
                return

    def drop_and_report_lost_neighbours(self, context: FlightContext, satellite_s: float) -> None:
        """Drop neighbours without recent reports, and report those within radio range; others have
        flown out of range.
        """
        state = self._state
        state.tracks, lost = state.tracks.copy_without_silent_and_removed_names(satellite_s)
        lost_in_range = [
            name for name in lost if state.last_distance_m.pop(name, 0.0) <= RECEPTION_RADIUS_M
        ]
        if lost_in_range:
            context.report_alert(Alert.NEIGHBOUR_LOST, names=", ".join(lost_in_range))

    def publish_own_track(
        self,
        context: FlightContext,
        satellite_s: float,
        pos_ned_m: Floats,
        vel_ned_mps: Floats,
        *,
        on_setpoints: bool,
    ) -> None:
        """Report this vehicle's position and planned motion to the neighbours."""
        flown, index = context.flight_plan, self._item.index
        assert flown is not None
        frame = flown.site.frame
        lat, lon, _ = frame.to_geodetic((pos_ned_m[0], pos_ned_m[1], 0.0))
        spot = flown.mission.position_at_or_after_item(index) if index is not None else None
        context.queue_actions(
            PublishTrack(
                satellite_s,
                math.degrees(lat),
                math.degrees(lon),
                frame.alt_amsl_m - float(pos_ned_m[2]),
                vector_to_tuple(vel_ned_mps),
                on_setpoints,
                spot.lat_deg if spot is not None else None,
                spot.lon_deg if spot is not None else None,
            )
        )

    def _store_neighbour_track(
        self, context: FlightContext, vehicle_name: str, track: Track
    ) -> None:
        """Convert a neighbour's position into this vehicle's frame.

        Heights are reported above the launch pad as flown, relative to the ground of the flight
        files: they drift less than each barometer's AMSL, and layers are planned in them.
        """
        state, flown, now_s = self._state, context.flight_plan, self.satellite_time_s(context)
        if flown is None or now_s is None:
            return
        frame = flown.site.frame
        north, east, _ = frame.to_ned(
            math.radians(track.lat_deg), math.radians(track.lon_deg), frame.alt_amsl_m
        )
        down = frame.alt_amsl_m - track.alt_amsl_m
        report = NeighbourReport(
            vehicle_name,
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
            state.goals[vehicle_name] = (goal_n, goal_e)
        if track.avoiding:
            state.on_setpoints.add(vehicle_name)
        else:
            state.on_setpoints.discard(vehicle_name)
        tracks = state.tracks.copy_with_report_if_newer(report, now_s)
        if tracks is not state.tracks:
            here = context.recent_position_ned_m()
            state.last_distance_m[vehicle_name] = (
                horizontal_distance_m((north, east, down), here) if here else 0.0
            )
        state.tracks = tracks
