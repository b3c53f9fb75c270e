"""Where a vehicle is and wants to be, as it tells its neighbours."""

from typing import Annotated

from msgspec import Meta

from companion.core.base.wire_message import Name, WireMessage


class Track(WireMessage, frozen=True, kw_only=True):
    """Where a vehicle is, five times a second, for its neighbours.

    `gnss_s`: satellite time of the place, seconds since 1970, the one clock that all share.
    Errors are standard deviations, of each horizontal axis and of height. `aside`: it flies
    set-points to keep apart; `to_...`: where it wants to, for people and for actors.
    """

    vehicle: Name
    gnss_s: Annotated[float, Meta(ge=0.0)]
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    alt_amsl_m: Annotated[float, Meta(ge=-500.0, le=20_000.0)]
    vel_n_mps: float
    vel_e_mps: float
    vel_d_mps: float
    pos_std_m: Annotated[float, Meta(ge=0.0)]
    alt_std_m: Annotated[float, Meta(ge=0.0)]
    vel_std_mps: Annotated[float, Meta(ge=0.0)]
    aside: bool = False
    to_lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    to_lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
