"""Tracks: what neighbours tell of themselves, taken into our frame, and what we tell of us."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from companion.core.mission.actions import TellPlace
from companion.core.mission.events import GnssTime
from companion.core.separation.setpoint_motion import FLEET, Floats, three
from companion.core.separation.track import Track
from companion.core.separation.traffic_tracks import Report

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

OWN_STD_M, OWN_ALT_STD_M = 0.8, 0.5
"""What our own place is wrong by beside what neighbours tell of theirs: satellites, barometer."""

POS_STD_M, ALT_STD_M, VEL_STD_MPS = 2.15, 0.7, 0.1
"""What we tell of ours: what evaluation.md, 12, puts on it (2 m; 0.5 m of height), and our own."""


def heard_time(pilot: Pilot, event: GnssTime) -> None:
    """How far satellite time is ahead of core time."""
    pilot.apart.ahead_of_core_s = event.unix_s - event.t_s


def heard_neighbour(pilot: Pilot, track: Track) -> None:
    """Take a neighbour's place into our own frame.

    Heights are told above the pad as flown, on the ground that the flight files state: that drifts
    less than what each barometer calls AMSL, and it is what layers are planned in.
    """
    apart, flown = pilot.apart, pilot.flown
    if flown is None or apart.ahead_of_core_s is None:
        return
    frame = flown.site.frame
    north, east, _ = frame.to_ned(
        math.radians(track.lat_deg), math.radians(track.lon_deg), frame.alt_amsl_m
    )
    down = frame.alt_amsl_m - track.alt_amsl_m
    report = Report(
        track.vehicle,
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
        apart.goals[track.vehicle] = (goal_n, goal_e)
    if track.aside:
        apart.aside.add(track.vehicle)
    else:
        apart.aside.discard(track.vehicle)
    apart.tracks = apart.tracks.heard(report, pilot.now.t_s + apart.ahead_of_core_s)


def tell(pilot: Pilot, here: Floats, velocity: Floats, now_s: float) -> None:
    """Our place, as it will be flown; for the neighbours."""
    apart = pilot.apart
    assert pilot.flown is not None
    pos, vel = here, velocity
    if apart.motion is not None:
        pos, vel, _ = apart.motion.at(pilot.now.t_s, FLEET)
    lat, lon, _ = pilot.flown.site.frame.to_geodetic((pos[0], pos[1], 0.0))
    spot = pilot.flown.mission.spot_at(pilot.air.index) if pilot.air.index is not None else None
    pilot.do(
        TellPlace(
            now_s,
            math.degrees(lat),
            math.degrees(lon),
            pilot.flown.site.frame.alt_amsl_m - float(pos[2]),
            three(vel),
            apart.wanted,
            spot.lat_deg if spot is not None else None,
            spot.lon_deg if spot is not None else None,
        )
    )
