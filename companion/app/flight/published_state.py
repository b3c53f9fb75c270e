"""Messages of a flight: fields of the state (estimates, probabilities, route), and the track."""

import math
import re
from collections.abc import Sequence
from typing import Any

import msgspec

from companion.core.base.arrays import Floats
from companion.core.mission.actions import PublishTrack
from companion.core.mission.flight_plan import FlightPlan
from companion.core.pilot.neighbours.traffic_exchange import ALT_STD_M, POS_STD_M, VEL_STD_MPS
from companion.core.pilot.pilot import Pilot
from companion.core.separation.track import Track
from companion.core.separation.track_cells import cell_name_or_none
from companion.fleet.messages import MAX_COV_M2PS2, MAX_ROUTE_CHARS, encode_message
from companion.fleet.polyline import encode_polyline


def flight_state_fields(pilot: Pilot) -> dict[str, Any]:
    """Return the state fields: recent estimates of the pilot, and its route."""
    assessment, estimates = pilot.context.recent_assessment(), pilot.context.estimates
    wind, energy = estimates.wind, estimates.energy
    state_fields: dict[str, Any] = {
        "delivered": pilot.is_delivered,
        "home": _valid_message_id(pilot.current_home_stop_name),
    }
    if energy is not None:
        state_fields["energy_left_wh"] = energy.mean_wh
    if wind is not None and wind.valid:
        north, east = (round(float(x), 3) for x in wind.mean_to_ne_mps)
        state_fields["wind_to_n_mps"], state_fields["wind_to_e_mps"] = north, east
        state_fields["wind_cov_m2ps2"] = rounded_up_wind_cov_or_unset(wind.cov_ne_m2ps2)
    if assessment is not None:
        state_fields["margin_wh"] = assessment.margin_wh
        for name in ("p_home", "p_home_now", "p_success"):
            state_fields[name] = clip_probability(getattr(assessment, name))
        state_fields["p_home_limit"] = assessment.p_home_limit
    if pilot.flight_plan is not None:
        state_fields["outbound_route"], state_fields["return_route"] = route_polylines(
            pilot.flight_plan
        )
    return state_fields


def rounded_up_wind_cov_or_unset(
    cov_ne_m2ps2: Floats,
) -> tuple[float, float, float] | msgspec.UnsetType:
    """Return the covariance (north, north-east, east), rounded so that no direction's variance
    decreases; unset if it is no valid covariance or exceeds the message limit.
    """
    nn, ne, ee = (float(cov_ne_m2ps2[at]) for at in ((0, 0), (0, 1), (1, 1)))
    if not (math.isfinite(nn + ne + ee) and min(nn, ee) > 0.0 and ne * ne <= nn * ee):
        return msgspec.UNSET
    # Each rounding moves a number by less than 0.001: twice that on the diagonal outweighs them.
    rounded = round(nn + 0.002, 3), round(ne, 3), round(ee + 0.002, 3)
    return rounded if max(rounded) <= MAX_COV_M2PS2 else msgspec.UNSET


def route_polylines(flown: FlightPlan) -> tuple[str, str]:
    """Return outbound and return route as polylines; both empty if one is too long."""
    mission = flown.mission
    out = _route_polyline(flown, (mission.takeoff, *mission.outbound, mission.deliver))
    home = _route_polyline(flown, (mission.deliver, *mission.returning, mission.land))
    return (out, home) if max(len(out), len(home)) <= MAX_ROUTE_CHARS else ("", "")


def _route_polyline(flown: FlightPlan, items: Sequence[int]) -> str:
    spots = (flown.mission.items[index].spot for index in items)
    return encode_polyline((spot.lat_deg, spot.lon_deg) for spot in spots if spot is not None)


def _valid_message_id(name: str | None) -> str | None:
    """Replace characters of a site name that messages do not allow."""
    return None if name is None else re.sub(r"[^A-Za-z0-9._:-]", "-", name)[:64]


def clip_probability(p: float | None) -> float | None:
    """Clip a probability to 0 to 1, the range of messages."""
    return None if p is None else min(max(p, 0.0), 1.0)


def track_message_and_cell(report: PublishTrack, vehicle: str) -> tuple[bytes, str] | None:
    """Return the track message and the cell in its key; None outside of all cells."""
    cell = cell_name_or_none(report.lat_deg, report.lon_deg)
    if cell is None:
        return None
    north, east, down = report.vel_ned_mps
    track = Track(
        vehicle=vehicle,
        gnss_s=report.gnss_s,
        lat_deg=report.lat_deg,
        lon_deg=report.lon_deg,
        alt_amsl_m=report.alt_amsl_m,
        vel_n_mps=north,
        vel_e_mps=east,
        vel_d_mps=down,
        pos_std_m=POS_STD_M,
        alt_std_m=ALT_STD_M,
        vel_std_mps=VEL_STD_MPS,
        avoiding=report.on_setpoints,
        to_lat_deg=report.goal_lat_deg,
        to_lon_deg=report.goal_lon_deg,
    )
    return encode_message(track), cell
